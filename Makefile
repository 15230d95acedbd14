# make demo   install into .venv, then render, extrapolate and measure a scene into out/demo
# make test   install what the tests need too, then run all of them

PYTHON ?= python3
VENV := .venv
PIP := $(VENV)/bin/python -m pip install --quiet --disable-pip-version-check -c constraints.txt

.PHONY: demo test clean

demo: $(VENV)/.installed
	$(VENV)/bin/gffe demo

test: $(VENV)/.installed-for-tests
	$(VENV)/bin/python -m pytest

$(VENV)/.installed: pyproject.toml constraints.txt Makefile
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "error: $(PYTHON) must be Python 3.11 or newer (make PYTHON=python3.12 …)" >&2; exit 2; }
	@$(PYTHON) -m venv $(VENV) || { test "$$(id -u)" = 0 && apt-get install -y python3-venv && $(PYTHON) -m venv $(VENV); }
	$(PIP) --editable .
	@$(MAKE) --no-print-directory runtime
	@touch $@

$(VENV)/.installed-for-tests: $(VENV)/.installed
	$(PIP) --editable '.[test,train]'
	@touch $@

# An OpenCL runtime on which a kernel really runs: a GPU's driver if there is one; else Intel's CPU runtime from PyPI
# (x86-64, no root); else PoCL, where root can install it.
.PHONY: runtime
runtime:
	@$(VENV)/bin/gffe devices --kind gpu >/dev/null 2>&1 \
		|| { test "$$(uname -sm)" = "Linux x86_64" && $(PIP) --editable '.[intel]' && $(VENV)/bin/gffe devices >/dev/null 2>&1; } \
		|| $(VENV)/bin/gffe devices >/dev/null 2>&1 \
		|| { test "$$(id -u)" = 0 && apt-get install -y pocl-opencl-icd; } \
		|| true
	@$(VENV)/bin/gffe devices

clean:
	rm -rf $(VENV) out build *.egg-info
