# make demo       install into .venv, then render, extrapolate, show and measure a scene into out/demo
# make test       install what the tests need too, then run all of them but the long ones
# make test-all   those, and then the long ones
# make quality    what a change of kernels does to the quality of new frames: five minutes, and ten more the first time;
#                 ARGS="--quick": under a minute; docs/tools/quality.py has more
# make recorded   what is recorded of kernels, anew, after a change of them: 20 minutes or so; PICTURES=1: after one that
#                 changes pictures, also what each part is worth and the pictures of the documentation: hours;
#                 CHECK=1: only lists the records that are older than the kernels
# make docs       the documentation as a site, into out/docs
# PYTHON=…        another interpreter than python3
# WORKERS=…       processes that run tests, 2 if not given; a file of tests is run by one of them

PYTHON ?= python3
WORKERS ?= 2
VENV := .venv
LOG := $(VENV)/pip.log
PYTEST := $(VENV)/bin/python -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder --max-worker-restart 0
PIP := $(VENV)/bin/python -m pip install --disable-pip-version-check -c constraints.txt
# What pip says is shown only if it fails.
QUIETLY = >$(LOG) 2>&1 || { cat $(LOG) >&2; echo "error: pip failed, see above" >&2; exit 2; }

.PHONY: demo test test-all quality recorded docs clean

demo: $(VENV)/.installed
	@echo "demo: half a minute"
	@$(VENV)/bin/gffe demo

test: $(VENV)/.installed-for-tests
	$(PYTEST) -m "not long"

test-all: test $(VENV)/.installed-for-examples
	$(PYTEST) -m long

quality: $(VENV)/.installed-for-tests
	$(VENV)/bin/python docs/tools/quality.py $(ARGS)

# Bits, bytes and instructions, costs on GPUs (where GFFE_GPU_COMPILERS names the compilers), then the tables from them.
recorded: $(VENV)/.installed-for-tests $(if $(PICTURES),$(VENV)/.installed-for-examples)
ifdef CHECK
	$(VENV)/bin/python docs/tools/pages.py --check
else
	$(VENV)/bin/python docs/tools/record_selftest.py
	$(VENV)/bin/python tests/test_recorded_sequences.py
	$(VENV)/bin/python docs/tools/count_traffic.py --lanes 1,8 --write
	test -z "$(GFFE_GPU_COMPILERS)" || $(VENV)/bin/python docs/tools/gpu_compilers.py
ifdef PICTURES
	$(VENV)/bin/python docs/tools/measure_deviations.py --write
	$(VENV)/bin/python docs/tools/make_pictures.py
	$(VENV)/bin/python docs/tools/make_stage_pictures.py
	$(VENV)/bin/python docs/tools/make_symptoms.py
	$(VENV)/bin/python docs/tools/make_live.py
endif
	$(VENV)/bin/python docs/tools/make_lessons.py
	$(VENV)/bin/python docs/tools/make_performance.py
	$(VENV)/bin/python docs/tools/make_tables.py
endif

# Every warning is an error, links inside the site and names in signatures included; nothing is fetched.
docs: $(VENV)/.installed-for-docs
	$(VENV)/bin/python -m sphinx -q -E -W --keep-going -n docs out/docs
	@echo "documentation: out/docs/index.html"

$(VENV)/.installed: pyproject.toml setup.py constraints.txt Makefile
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "error: $(PYTHON) must be Python 3.11 or newer (make PYTHON=python3.12 …)" >&2; exit 2; }
	@echo "environment: $(VENV), a few seconds"
	@$(PYTHON) -m venv $(VENV) || { test "$$(id -u)" = 0 && apt-get install -y python3-venv && $(PYTHON) -m venv $(VENV); }
	@echo "packages: 650 MB on disk, 1 to 3 minutes"
	@$(PIP) --editable '.[lab,video]' $(QUIETLY)
	@$(MAKE) --no-print-directory runtime
	@touch $@

$(VENV)/.installed-for-tests: $(VENV)/.installed
	@echo "packages of the tests, PyTorch among them: 1.5 GB on disk, 1 to 4 minutes"
	@$(PIP) --editable '.[test,train,opencv]' $(QUIETLY)
	@touch $@

$(VENV)/.installed-for-examples: $(VENV)/.installed-for-tests
	@echo "Panda3D, for the live example: 170 MB on disk"
	@$(PIP) --editable '.[examples]' $(QUIETLY)
	@touch $@

$(VENV)/.installed-for-docs: $(VENV)/.installed
	@echo "packages of the documentation: 70 MB on disk, a few seconds"
	@$(PIP) --editable '.[docs]' $(QUIETLY)
	@touch $@

# An OpenCL runtime on which a kernel really runs: a GPU's driver if there is one; else Intel's CPU runtime from PyPI
# (x86-64, no root); else PoCL, where root can install it.
.PHONY: runtime
runtime:
	@echo "OpenCL: looking for a GPU; else a runtime for the CPU (280 MB to download, 800 MB on disk, 1 to 2 minutes)"
	@$(VENV)/bin/gffe devices --kind gpu >/dev/null 2>&1 \
		|| { test "$$(uname -sm)" = "Linux x86_64" && $(PIP) --editable '.[intel]' >$(VENV)/runtime.log 2>&1 \
			&& $(VENV)/bin/gffe devices >/dev/null 2>&1; } \
		|| $(VENV)/bin/gffe devices >/dev/null 2>&1 \
		|| { test "$$(id -u)" = 0 && apt-get install -y pocl-opencl-icd; } \
		|| cat $(VENV)/runtime.log >&2 || true
	@$(VENV)/bin/gffe devices

clean:
	rm -rf $(VENV) out build *.egg-info
