"""Built programs: kept, recalled, and never a reason to wait or to fail."""

import numpy as np
import pyopencl as cl
import pytest
from pyopencl.characterize import has_src_build_cache

from gffe_cl.opencl import program_cache
from gffe_cl.opencl.program_cache import built_program

pytestmark = pytest.mark.device
SOURCE = "__kernel void twice(__global float *x) { x[get_global_id(0)] *= FACTOR; }"
OPTIONS = ("-cl-kernel-arg-info", "-DFACTOR=2.0f")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("GFFE_DEVICE_CACHE", str(tmp_path))
    return tmp_path / "kernels"


@pytest.fixture
def keeping(device, monkeypatch):
    """Keeps programs for every device, also where drivers do."""
    monkeypatch.setattr(program_cache, "has_src_build_cache", lambda _: False)
    return device


def result(device, program):
    x = np.arange(4, dtype=np.float32)
    buffer = cl.Buffer(device.context, cl.mem_flags.COPY_HOST_PTR, hostbuf=x)
    program.twice(device.queue, x.shape, None, buffer)
    cl.enqueue_copy(device.queue, x, buffer)
    return x.tolist()


def test_what_was_built_is_kept(keeping, folder):
    device = keeping
    for options, factor in ((OPTIONS, 2), (OPTIONS, 2), (("-DFACTOR=3.0f",), 3)):
        program = built_program(device.context, device.cl_device, SOURCE, options)
        assert result(device, program) == [0, factor, 2 * factor, 3 * factor]
    kept = list(folder.iterdir())
    assert len(kept) == 2 and all(path.suffix == ".bin" for path in kept)


def test_what_is_kept_is_used(keeping, folder, monkeypatch):
    device = keeping
    built_program(device.context, device.cl_device, SOURCE, OPTIONS)
    plain = cl.Program

    def without_source(context, *rest):
        assert len(rest) == 2, "built from source"
        return plain(context, *rest)

    monkeypatch.setattr(cl, "Program", without_source)
    assert result(device, built_program(device.context, device.cl_device, SOURCE, OPTIONS)) == [0, 2, 4, 6]


def test_a_spoilt_file_is_replaced(keeping, folder):
    device = keeping
    built_program(device.context, device.cl_device, SOURCE, OPTIONS)
    (path,) = folder.iterdir()
    path.write_bytes(b"")
    assert result(device, built_program(device.context, device.cl_device, SOURCE, OPTIONS)) == [0, 2, 4, 6]
    assert path.stat().st_size > 0


def test_a_folder_that_cannot_be_written_is_no_error(keeping, tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    for chosen in (tmp_path / "file", "off"):
        monkeypatch.setenv("GFFE_DEVICE_CACHE", str(chosen))
        assert result(keeping, built_program(keeping.context, keeping.cl_device, SOURCE, OPTIONS)) == [0, 2, 4, 6]
    assert (tmp_path / "file").read_bytes() == b""


def test_where_the_driver_keeps_them_we_do_not(device, folder):
    built_program(device.context, device.cl_device, SOURCE, OPTIONS)
    assert folder.exists() != bool(has_src_build_cache(device.context.devices[0]))


def test_a_lock_that_a_killed_process_left_holds_nobody_up(device, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("GFFE_DEVICE_CACHE", "off")
    built_program(device.context, device.cl_device, SOURCE, OPTIONS)
    assert not (tmp_path / "pyopencl").exists()
