"""Devices and programs: choosing, probing in a child, build errors, and the shared helpers of kernels."""

import json
import os
import shutil
import subprocess
import sys
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pyopencl as cl
import pytest
from device_infos import GPU, INTEL, OLD_GPU, POCL

from gffe_cl import GffeError
from gffe_cl.engine.opencl import device as device_module
from gffe_cl.engine.opencl import probing, runtimes
from gffe_cl.engine.opencl.device import best_of, select
from gffe_cl.engine.opencl.probing import run_child
from gffe_cl.engine.opencl.program import build, built_program, expand, first_error, kernel_folder, with_files_named


def test_selection():
    assert select([POCL, INTEL, GPU], "intel") == [INTEL]
    assert select([POCL, INTEL, GPU], "PoCL") == [POCL]
    assert select([POCL, INTEL, GPU], "xeon") == [POCL, INTEL]
    assert select([POCL, INTEL, GPU], "gpu") == [GPU]
    assert select([POCL, INTEL, GPU], "0:0") == [POCL]
    assert select([POCL], "nvidia") == []
    assert best_of([POCL, INTEL]) is INTEL and best_of([POCL, INTEL, GPU]) is GPU


def test_noise_does_not_choose_the_default():
    for factor in (0.7, 1, 1.4):
        as_fast = replace(POCL, megapixels_per_second=factor * INTEL.megapixels_per_second)
        assert best_of([as_fast, INTEL]) is INTEL and best_of([INTEL, as_fast]) is INTEL
        again = replace(INTEL, index="1:1", megapixels_per_second=as_fast.megapixels_per_second)
        assert best_of([POCL, INTEL, again]) is INTEL
    clearly_faster = replace(POCL, megapixels_per_second=1.6 * INTEL.megapixels_per_second)
    assert best_of([clearly_faster, INTEL]) is clearly_faster
    assert best_of([clearly_faster, INTEL, GPU]) is GPU


def test_the_default_is_the_fastest_of_any_kind():
    """A GPU that is clearly slower than the CPU is not chosen; one that is about as fast is, either way."""
    assert best_of([OLD_GPU, POCL, INTEL]) is INTEL and best_of([OLD_GPU, INTEL, GPU]) is GPU
    assert best_of([POCL, OLD_GPU]) is OLD_GPU and best_of([OLD_GPU]) is OLD_GPU
    for factor in (0.7, 1, 1.4):
        as_fast = replace(OLD_GPU, megapixels_per_second=factor * INTEL.megapixels_per_second)
        assert best_of([INTEL, as_fast]) is as_fast and best_of([POCL, as_fast, INTEL]) is as_fast


@pytest.mark.parametrize("slow", ["kernel", "copy"])
def test_the_figure_counts_arithmetic_and_memory(device, monkeypatch, slow):
    """It is less where either takes longer."""

    class Timed:
        def __init__(self, nanoseconds):
            self.profile = type("Profile", (), {"start": 0, "end": nanoseconds})

        def wait(self):
            pass

    monkeypatch.setattr(probing, "_RANKING_SECONDS", 0)
    copy, kernel, found = cl.enqueue_copy, cl.Kernel, []
    for kernel_time, copy_time in ((100, 1600), (300, 1600) if slow == "kernel" else (100, 4800)):

        class Launched:
            def __init__(self, *given):
                self.kernel = kernel(*given)

            def __call__(self, *given, taken=kernel_time):
                self.kernel(*given).wait()
                return Timed(taken)

        def copied(queue, to, of, taken=copy_time, **more):
            done = copy(queue, to, of, **more)
            return done if isinstance(to, np.ndarray) else Timed(taken)

        monkeypatch.setattr(cl, "Kernel", Launched)
        monkeypatch.setattr(cl, "enqueue_copy", copied)
        found.append(probing._run_probe_kernel(device.context, device.queue))
    assert found[1] < 0.8 * found[0]


def test_a_crashing_driver_is_blamed_and_survived(monkeypatch):
    """The child dies at the second of three devices: each is probed alone, and that one is marked."""

    def child(command, **_):
        (asked,) = command[4:] or [""]
        lines, code = [], 0
        for device in (POCL, INTEL, GPU):
            if asked in ("", "--list", device.index):
                lines.append(json.dumps(asdict(device) | {"works": False, "megapixels_per_second": 0.0}))
                if asked == "--list":
                    continue
                if device is INTEL:
                    code = -11
                    break
                lines.append(json.dumps(asdict(device)))
        return subprocess.CompletedProcess(command, code, "\n".join([*lines, *["probed"] * (not code)]), "")

    monkeypatch.setattr(subprocess, "run", child)
    found = {d.index: d for d in device_module.list_devices(refresh=True)}
    assert found["0:0"].works and found["2:0"].works and not found["1:0"].works
    assert "crashed" in found["1:0"].problem


BROKEN = """
#include <stdlib.h>
#include <unistd.h>
__attribute__((constructor)) static void load(void) { FAULT; }
"""
FAULTS = {"crash": "abort()", "hang": "for (;;) pause()"}


@pytest.mark.parametrize(
    ("fault", "said", "seconds"), [("crash", "driver crashed", 6), ("hang", "driver hangs (0.3 s)", 0.3)]
)
def test_a_driver_that_crashes_or_hangs_when_it_is_listed_is_survived(tmp_path, fault, said, seconds):
    """In a process of its own: one line names the drivers' files, and what to do."""
    compiler = shutil.which("cc")
    if compiler is None:
        assert not os.environ.get("CI"), "CI must have a C compiler"
        pytest.skip("no C compiler to make a broken driver with")
    (tmp_path / "broken.c").write_text(BROKEN)
    library = tmp_path / "libbroken.so"
    subprocess.run(
        [compiler, "-shared", "-fPIC", f"-DFAULT={FAULTS[fault]}", "-o", library, tmp_path / "broken.c"], check=True
    )
    (tmp_path / "broken.icd").write_text(f"{library}\n")
    code = (
        f"from gffe_cl.engine.opencl import probing; probing._FIRST_SECONDS = probing._LIST_SECONDS = {seconds};"
        "import gffe_cl; print([info.works for info in gffe_cl.list_devices()]); gffe_cl.open_device()"
    )
    environment = os.environ | {"OCL_ICD_VENDORS": str(tmp_path)}
    environment.pop("GFFE_DEVICE", None)
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)
    assert child.stdout.strip() == "[False]"
    last = child.stderr.strip().splitlines()[-1]
    assert "GffeError: no OpenCL device runs a kernel" in last and said in last and f"{tmp_path}/broken.icd" in last


@pytest.mark.parametrize(("load", "niceness", "factor"), [(0.3, 15, 1), (3, 0, 3), (2, 2, 3.125), (2, 19, 10)])
def test_child_processes_get_more_time_on_a_busy_machine(monkeypatch, load, niceness, factor):
    """Load per core counts, and this process's share of it; an idle machine changes nothing."""
    monkeypatch.setattr(os, "getloadavg", lambda: (load * os.cpu_count(), 0, 0))
    monkeypatch.setattr(os, "nice", lambda step: niceness)
    limits = []
    done = subprocess.CompletedProcess([], 0, "", "")
    monkeypatch.setattr(subprocess, "run", lambda *_, timeout, **__: limits.append(timeout) or done)
    assert run_child("any", [], 6.0) == ("", "")
    assert limits == [pytest.approx(6 * factor)]


def test_intels_runtime_in_a_folder_with_a_space_is_left_out(tmp_path, monkeypatch):
    library = tmp_path / "my env" / "lib" / "libintelocl.so"
    library.parent.mkdir(parents=True)
    library.touch()
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "my env"))
    monkeypatch.delenv(runtimes.VENDORS, raising=False)
    with pytest.warns(UserWarning, match="does not work in a folder whose name has a space"):
        runtimes.expose_installed_runtimes()
    assert runtimes.VENDORS not in os.environ


def _of_another_user(home, folder):
    shutil.chown(home, 12345)


def _with_a_driver_of_others(home, folder):
    (folder / "zz.icd").write_text("/tmp/libevil.so\n")


def _open_to_others(home, folder):
    folder.chmod(0o777)


def _a_link(home, folder):
    folder.rename(home / "elsewhere")
    folder.symlink_to(home / "elsewhere")


@pytest.mark.parametrize("spoil", [_of_another_user, _with_a_driver_of_others, _open_to_others, _a_link])
def test_drivers_are_loaded_from_folders_of_this_user(tmp_path, monkeypatch, spoil):
    """The loader loads the library of each `.icd` file there: with sudo, as root."""
    if not (Path(sys.prefix) / "lib" / "libintelocl.so").exists():
        pytest.skip("no runtime of Intel's in this environment")
    home = tmp_path / "home"
    home.mkdir()
    monkeypatch.setattr(runtimes.tempfile, "tempdir", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(home))
    monkeypatch.setenv(runtimes.VENDORS, "")
    runtimes.prepare_runtimes()
    folder = Path(os.environ[runtimes.VENDORS])
    names = sorted(path.name for path in folder.iterdir())
    assert folder.is_relative_to(home) and names
    try:
        spoil(home, folder)
    except PermissionError:
        pytest.skip("only root gives files away")
    monkeypatch.setenv(runtimes.VENDORS, "")
    runtimes.prepare_runtimes()
    other = Path(os.environ[runtimes.VENDORS])
    assert not other.is_relative_to(home) and sorted(path.name for path in other.iterdir()) == names
    assert other.stat().st_mode & 0o777 == 0o700
    assert Path(os.environ["XDG_CACHE_HOME"]).is_relative_to(home) == (spoil is not _of_another_user)  # PoCL's, too


def test_probing_is_in_a_child_that_files_of_the_working_folder_do_not_disturb(tmp_path, monkeypatch):
    """This process runs no kernel of a device that it does not know."""
    monkeypatch.setattr(probing, "_run_probe_kernel", None)
    for name in ("copy", "json", "select", "numpy"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('not the module that was meant')\n")
    monkeypatch.chdir(tmp_path)
    infos = device_module.list_devices(refresh=True)
    assert any(info.works for info in infos) and all(info.index != "–" for info in infos)


@pytest.fixture
def sources(tmp_path, monkeypatch):
    """A folder of kernels of our own, with the real header."""
    (tmp_path / "common.h").write_text((kernel_folder() / "common.h").read_text())
    monkeypatch.setenv("GFFE_KERNELS", str(tmp_path))
    return tmp_path


def test_build_errors_name_file_and_line(device, sources):
    (sources / "broken.cl").write_text(
        '#include "common.h"\n\n__kernel void f(__global float *a) {\n    a[0] = nonsense;\n}\n'
    )
    with pytest.raises(GffeError) as caught:
        build(device, "broken")
    assert "kernels/broken.cl does not build" in str(caught.value)
    assert "broken.cl:4" in str(caught.value) and "nonsense" in str(caught.value)
    assert "\\n" not in str(caught.value) and "broken.cl:4" in caught.value.log.split("\n", 1)[1]


@pytest.mark.parametrize(
    ("log", "told"),
    [
        ("w.cl:1:2: warning: odd\nw.cl:9:1: error: x\n  9 | x\n", "w.cl:9:1: error: x"),
        ("1 error generated.\nerror: w.cl:9:1: x\nDevice failed", "error: w.cl:9:1: x"),
        ("w.h: cannot read", "w.h: cannot read"),
        ("", ""),
    ],
)
def test_the_first_error_of_a_log(log, told):
    assert first_error(log) == told


def test_builds_with_warnings_are_silent(device, capfd):
    """clang counts its warnings on descriptor 2, whatever Python makes of the log."""
    source = "#warning noticed\n__kernel void warn(__global int *a) { *a = 1; }"
    built_program(device.context, device.cl_device, source)
    assert capfd.readouterr().err == ""


def test_lines_of_the_expanded_source_are_named():
    """NVIDIA's compiler ignores `#line`."""
    source = expand("copy.cl").splitlines()
    at = next(k for k, line in enumerate(source, 1) if line.startswith("__kernel"))
    lines = (kernel_folder() / "copy.cl").read_text().splitlines()
    own = next(k for k, line in enumerate(lines, 1) if "__kernel" in line)
    log = f"<kernel>:{at}:3: error: x\n<kernel>:2:1: note: y"
    assert with_files_named(log, "\n".join(source)) == f"copy.cl:{own}:3: error: x\ncopy.cl:1:1: note: y"


def test_build_errors_in_the_header_too(device, sources):
    text = (sources / "common.h").read_text().splitlines()
    (sources / "common.h").write_text("\n".join([*text, "int half_a_declaration("]))
    (sources / "fine.cl").write_text('#include "common.h"\n__kernel void f(__global float *a) { a[0] = 1.0f; }\n')
    with pytest.raises(GffeError, match=r"common\.h:\d+|fine\.cl:\d+"):
        build(device, "fine")


def test_missing_source(sources):
    with pytest.raises(GffeError, match=r"absent\.cl: cannot read"):
        expand("absent.cl")


ARITHMETIC = """
#include "common.h"
DEFINE_ROOT(float, root)
__kernel void quotients(const int n, __global const float *a, __global const float *b, __global float *q,
                        __global float *roots) {
    const int i = get_global_id(0);
    if (i < n) q[i] = divide(a[i], b[i]);
    if (i < n) roots[i] = root(a[i]);
}
"""


@pytest.mark.parametrize("exact", [False, True], ids=["corrected", "plain"])
def test_division_and_roots_are_correctly_rounded(device, sources, exact, monkeypatch):
    """`divide` and `root` against NumPy's: equal, but for one in a hundred thousand that may be off by one ulp."""
    if exact and not device.exact_division:
        pytest.skip("this device's division is not exact")
    monkeypatch.setitem(device.__dict__, "exact_division", exact)
    (sources / "arithmetic.cl").write_text(ARITHMETIC)
    program = build(device, "arithmetic")
    rng = np.random.default_rng(3)
    n = 400_000
    a = (rng.normal(size=n) * 10 ** rng.uniform(-6, 6, n)).astype(np.float32)
    b = (rng.normal(size=n) * 10 ** rng.uniform(-6, 6, n)).astype(np.float32)
    a[:8], b[:8] = (0, 1, 3, 6, -7, 1e-30, 5, 1), (5, 3, 3, 3, 7, 1e5, np.inf, 1e-20)
    flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
    buffers = [cl.Buffer(device.context, flags, hostbuf=x) for x in (a, b)]
    made = {"q": device.buffer(4 * n), "roots": device.buffer(4 * n)}
    program.launch(device.queue, "quotients", (n,), None, {"n": n, "a": buffers[0], "b": buffers[1]} | made)
    q, roots = np.empty(n, np.float32), np.empty(n, np.float32)
    cl.enqueue_copy(device.queue, q, made["q"])
    cl.enqueue_copy(device.queue, roots, made["roots"])
    with np.errstate(invalid="ignore"):
        pairs = (q, a / b), (roots, np.sqrt(a))
    for found, expected in pairs:
        different = (found != expected) & ~(np.isnan(found) & np.isnan(expected))
        assert different.sum() <= n // 100_000
        np.testing.assert_allclose(found[different], expected[different], rtol=2e-7)
    assert q[2] == 1 and q[3] == 2 and q[4] == -1 and q[0] == 0 and q[6] == 0


def test_too_large_an_allocation_is_one_line(device):
    with pytest.raises(GffeError, match="cannot allocate"):
        device.buffer(1 << 50)


@pytest.mark.parametrize("first", ["gffe_cl", "pyopencl"])
def test_order_of_imports_does_not_matter(first):
    """Devices are found, listed and opened alike in a fresh process, whatever was imported first."""
    code = (
        f"import {first}; import gffe_cl; from gffe_cl.engine.opencl.device import list_devices, open_info;"
        "[open_info(i) for i in list_devices() if i.works]; print(gffe_cl.open_device().info.name)"
    )
    child = in_fresh_process(code)
    assert child.returncode == 0, child.stderr


def test_platforms_that_were_listed_before(tmp_path):
    """Without the installed runtime's, which then comes too late: one line names what to call before."""
    if not (Path(sys.prefix) / "lib" / "libintelocl.so").exists():
        pytest.skip("Intel's runtime is not installed in this environment")
    listed = "import pyopencl as cl, contextlib\nwith contextlib.suppress(cl.Error): cl.get_platforms()\n"
    opened = "import gffe_cl; print(gffe_cl.open_device('intel').info.platform)"
    child = in_fresh_process(listed + opened)
    assert child.returncode == 1 and "gffe_cl.prepare_runtimes()" in child.stderr.splitlines()[-1]
    child = in_fresh_process(f"import gffe_cl; gffe_cl.prepare_runtimes()\n{listed}{opened}")
    assert child.returncode == 0 and "Intel" in child.stdout, child.stderr


def in_fresh_process(code):
    """Run it where nothing is chosen."""
    environment = {k: v for k, v in os.environ.items() if k not in ("OCL_ICD_VENDORS", "GFFE_DEVICE")}
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)


@pytest.mark.parametrize(
    ("value", "reason"), [("empty", "where there is no .icd file"), ("nowhere", "which is not there")]
)
def test_a_variable_that_hides_all_drivers_is_named(tmp_path, monkeypatch, value, reason):
    (tmp_path / "empty").mkdir()
    monkeypatch.setenv("OCL_ICD_VENDORS", str(tmp_path / value))
    told = str(device_module.none_works([]))
    assert f"OCL_ICD_VENDORS is {tmp_path / value}, {reason} (expected a folder of them" in told and "pip" not in told
    assert "PoCL crashes" in str(device_module.none_works([replace(POCL, works=False, problem="PoCL crashes")]))


def test_a_driver_whose_library_is_gone_is_named(tmp_path, monkeypatch):
    (tmp_path / "driver.icd").write_text(f"{tmp_path}/libdriver.so\n")
    monkeypatch.setenv("OCL_ICD_VENDORS", str(tmp_path))
    assert f"driver.icd names {tmp_path}/libdriver.so, which is not there" in str(device_module.none_works([]))
    (tmp_path / "driver.icd").write_text("libdriver.so.1\n")  # the loader looks it up
    for chosen in (tmp_path, tmp_path / "driver.icd"):
        monkeypatch.setenv("OCL_ICD_VENDORS", str(chosen))
        told = str(device_module.none_works([]))
        assert f"OCL_ICD_VENDORS is {chosen}, whose .icd files bring no platform" in told
        assert "driver.icd names libdriver.so.1 (expected a folder of them" in told and "pip" not in told


@pytest.mark.parametrize("foreign", ["", "pocl", "pocl/kcache", "mesa_shader_cache"])
def test_caches_of_drivers_that_cannot_be_written_are_elsewhere(tmp_path, monkeypatch, foreign):
    """... not only where the folder above them cannot be."""
    home = tmp_path / "home"
    (home / (foreign or "pocl")).mkdir(parents=True)
    monkeypatch.setenv("XDG_CACHE_HOME", str(home))
    monkeypatch.delenv("POCL_CACHE_DIR", raising=False)
    runtimes.redirect_unwritable_caches()
    assert os.environ["XDG_CACHE_HOME"] == str(home)
    allowed = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != home / foreign and allowed(path, mode))
    runtimes.redirect_unwritable_caches()
    assert os.environ["XDG_CACHE_HOME"] != str(home)


def test_a_cache_that_the_user_named_and_that_cannot_be_written(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("POCL_CACHE_DIR", str(tmp_path / "file" / "pocl"))
    with pytest.warns(UserWarning, match="POCL_CACHE_DIR is .*file/pocl, which cannot be written: PoCL keeps"):
        runtimes.redirect_unwritable_caches()
    assert os.environ["POCL_CACHE_DIR"] == str(runtimes.cache_folder() / "pocl")
    monkeypatch.setenv("POCL_CACHE_DIR", str(tmp_path / "mine"))
    runtimes.redirect_unwritable_caches()
    assert os.environ["POCL_CACHE_DIR"] == str(tmp_path / "mine")


_HUGE = r"""
import re, sys
from pathlib import Path
import pyopencl as cl
import gffe_cl
device, size = gffe_cl.open_device(sys.argv[1]), 64 << 20
held = cl.UserEvent(device.context)
cl.enqueue_marker(device.queue, wait_for=[held])
buffer = device.buffer(size)
held.set_status(cl.command_execution_status.COMPLETE)
cl.enqueue_fill_buffer(device.queue, buffer, b"\1", 0, size).wait()
kilobytes = map(int, re.findall(r"AnonHugePages: +(\d+)", Path("/proc/self/smaps").read_text()))
print(sum(kilobytes) << 10)
"""


def test_large_buffers_ask_for_huge_pages(device):
    """... of Linux, on CPUs, although the device is at work; in a process that has freed no memory yet."""
    setting = Path("/sys/kernel/mm/transparent_hugepage/enabled")
    if not (device.works_in_host_memory and setting.exists()) or "[never]" in setting.read_text():
        pytest.skip("no huge pages here")
    child = subprocess.run(
        [sys.executable, "-c", _HUGE, device.info.index], capture_output=True, text=True, timeout=300
    )
    assert child.returncode == 0, child.stderr
    assert int(child.stdout) >= 32 << 20
