"""Built programs: kept, recalled, and never a reason to wait or to fail."""

import shutil
import stat

import foreign_files
import numpy as np
import pyopencl as cl
import pytest
from pyopencl.characterize import has_src_build_cache

from gffe_cl.engine.opencl import program as program_module
from gffe_cl.engine.opencl.program import built_program

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
    monkeypatch.setattr(program_module, "has_src_build_cache", lambda _: False)
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


@pytest.fixture
def given(monkeypatch):
    """What the driver was given, a word each time: "source" or "binary"."""
    given, plain = [], cl.Program

    def program(context, *rest):
        given.append("binary" if len(rest) == 2 else "source")
        return plain(context, *rest)

    monkeypatch.setattr(cl, "Program", program)
    return given


def test_what_is_kept_is_used(keeping, folder, given):
    device = keeping
    for _ in range(2):
        assert result(device, built_program(device.context, device.cl_device, SOURCE, OPTIONS)) == [0, 2, 4, 6]
    assert given == ["source", "binary"]


def test_a_driver_told_otherwise_builds_again(keeping, folder, given, monkeypatch):
    """Its variables choose the instruction set that it builds for."""
    device = keeping
    for architecture in ("core-avx2", "corei7", "core-avx2"):
        monkeypatch.setenv("CL_CONFIG_CPU_TARGET_ARCH", architecture)
        built_program(device.context, device.cl_device, SOURCE, OPTIONS)
    assert given == ["source", "source", "binary"]


def flipped(content, place):
    return content[:place] + bytes([content[place] ^ 4]) + content[place + 1 :]


DAMAGED = {
    "empty": lambda content: b"",
    "cut off": lambda content: content[:-1],
    "bit in the middle": lambda content: flipped(content, len(content) // 2),
    "without a digest": lambda content: content[32:],
}


@pytest.mark.parametrize("damage", DAMAGED)
def test_the_driver_never_sees_a_damaged_file(keeping, folder, given, damage):
    """It would crash."""
    device = keeping
    built_program(device.context, device.cl_device, SOURCE, OPTIONS)
    (path,) = folder.iterdir()
    path.write_bytes(DAMAGED[damage](path.read_bytes()))
    for _ in range(2):
        assert result(device, built_program(device.context, device.cl_device, SOURCE, OPTIONS)) == [0, 2, 4, 6]
    assert given == ["source", "source", "binary"]


def test_a_file_of_another_program_is_replaced(keeping, folder, given):
    device = keeping
    for options in (OPTIONS, ("-DFACTOR=3.0f",)):
        built_program(device.context, device.cl_device, SOURCE, options)
    one, other = folder.iterdir()
    content = [one.read_bytes(), other.read_bytes()]
    one.write_bytes(content[1])
    other.write_bytes(content[0])
    assert result(device, built_program(device.context, device.cl_device, SOURCE, OPTIONS)) == [0, 2, 4, 6]
    assert given == ["source"] * 3


@pytest.mark.parametrize("kind", foreign_files.KINDS)
def test_regular_files_only(keeping, folder, kind):
    device = keeping
    built_program(device.context, device.cl_device, SOURCE, OPTIONS)
    (path,) = folder.iterdir()
    foreign_files.put(path, kind)
    build = lambda: built_program(device.context, device.cl_device, SOURCE, OPTIONS)  # noqa: E731
    assert result(device, foreign_files.within(30, build)) == [0, 2, 4, 6]
    assert path.is_file() == (kind != "folder") and (kind == "folder" or path.stat().st_size < 1 << 24)


def open_to_others(folder):
    folder.chmod(0o770)


def link(folder):
    folder.rename(folder.with_name("elsewhere"))
    folder.symlink_to(folder.with_name("elsewhere"))


def another_users(folder):
    try:
        shutil.chown(folder, 12345)
    except PermissionError:
        pytest.skip("only root gives files away")


@pytest.mark.parametrize("spoil", [open_to_others, link, another_users])
def test_no_code_from_a_folder_that_others_can_write_to(keeping, folder, given, spoil):
    device = keeping
    built_program(device.context, device.cl_device, SOURCE, OPTIONS)
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    (path,) = folder.iterdir()
    spoil(folder)
    before = path.stat()
    assert result(device, built_program(device.context, device.cl_device, SOURCE, OPTIONS)) == [0, 2, 4, 6]
    assert given == ["source", "source"] and path.stat() == before


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
