"""Images of foreign captures: what is read is what was written; what is hostile is told in a line, at once."""

import io
import os
import struct
import time
import tracemalloc

import numpy as np
import pytest
from foreign import write_exr, write_parts
from PIL import Image

from gffe_cl import GffeError
from gffe_cl.captures.formats.folder import check_planes, read_planes

W, H = 23, 17
RNG = np.random.default_rng(4)


@pytest.mark.parametrize("channels", ["RGB", "RGBA", "Y"])
def test_png_of_16_bits(tmp_path, channels):
    cv2 = pytest.importorskip("cv2", reason="no OpenCV")
    image = RNG.integers(0, 65536, (H, W, len(channels))).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "a.png"), image[..., [2, 1, 0, 3][: len(channels)] if len(channels) > 1 else [0]])
    found = read_planes(tmp_path / "a.png", channels, "a", (W, H))
    assert found.dtype == np.uint16
    np.testing.assert_array_equal(found, image)
    np.testing.assert_array_equal(read_planes(tmp_path / "a.png", channels[::-1], "a", (W, H)), image[..., ::-1])


def test_png_of_8_bits_and_palettes(tmp_path):
    image = RNG.integers(0, 256, (H, W, 4)).astype(np.uint8)
    Image.fromarray(image).save(tmp_path / "a.png")
    np.testing.assert_array_equal(read_planes(tmp_path / "a.png", "RGBA", "a", (W, H)), image)
    Image.fromarray(image[..., 0]).save(tmp_path / "gray.png")
    gray = read_planes(tmp_path / "gray.png", "RGB", "a", (W, H))
    np.testing.assert_array_equal(gray, np.repeat(image[..., :1], 3, -1))
    few = (image[..., :3] // 128 * 255).astype(np.uint8)
    Image.fromarray(few).quantize(16).save(tmp_path / "few.png")
    np.testing.assert_array_equal(read_planes(tmp_path / "few.png", "RGB", "a", (W, H)), few)
    Image.fromarray(image[..., 0] > 99).save(tmp_path / "bit.png")
    np.testing.assert_array_equal(read_planes(tmp_path / "bit.png", "R", "a", (W, H))[..., 0] > 0, image[..., 0] > 99)


@pytest.mark.parametrize("dtype", ["<f4", ">f4", "<f2", "<f8", "|u1", "<u2", ">i4"])
def test_numpy_files(tmp_path, dtype):
    image = (RNG.normal(size=(H, W, 3)) * 50 + 100).astype(dtype)
    np.save(tmp_path / "a.npy", image)
    np.save(tmp_path / "f.npy", np.asfortranarray(image))
    for path in ("a.npy", "f.npy"):
        np.testing.assert_array_equal(read_planes(tmp_path / path, "RGB", "a", (W, H)), image)
        np.testing.assert_array_equal(read_planes(tmp_path / path, "2", "a", (W, H)), image[..., 2:])


def test_exr_layers(tmp_path):
    image = {name: RNG.normal(size=(H, W)).astype(np.float32) for name in ("R", "G", "Z")}
    write_parts(tmp_path / "parts.exr", {"other": {"R": image["G"]}, "beauty": {n: image[n] for n in "RG"}})
    found = read_planes(tmp_path / "parts.exr", ["beauty.R", "beauty.G", "other.R"], "a", (W, H))
    np.testing.assert_array_equal(found, np.stack([image["R"], image["G"], image["G"]], -1))
    write_exr(tmp_path / "one.exr", {"Depth.Z": image["Z"]})
    np.testing.assert_array_equal(read_planes(tmp_path / "one.exr", ["R"], "a", (W, H))[..., 0], image["Z"])


def fault(path, names="R"):
    """The message, which both checking and reading give, quickly and without much memory."""
    said = []
    for read in (check_planes, read_planes):
        tracemalloc.start()
        start = time.thread_time()
        with pytest.raises(GffeError) as error:
            read(path, names, path.name, (W, H))
        assert time.thread_time() - start < 1 and tracemalloc.get_traced_memory()[1] < 50e6
        tracemalloc.stop()
        said.append(str(error.value))
    assert said[0] == said[1] and said[0].startswith(path.name) and "\n" not in said[0]
    return said[0]


def test_images_of_another_size_are_not_decoded(tmp_path):
    """Bombs: a small file that would become gigabytes."""
    bomb = struct.pack(">4sIIBBBBB", b"IHDR", 60000, 60000, 16, 2, 0, 0, 0)
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n\0\0\0\x0d" + bomb)
    assert "60000×60000 pixels, expected 23×17" in fault(tmp_path / "a.png")

    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (90000, 90000)})
    (tmp_path / "a.npy").write_bytes(header.getvalue())
    assert "damaged NPY file" in fault(tmp_path / "a.npy")


def test_numpy_files_with_python_in_them(tmp_path):
    marker = tmp_path / "was run"

    class Evil:
        def __reduce__(self):
            return os.mkdir, (str(marker),)

    objects = np.full((H, W), Evil(), object)
    np.save(tmp_path / "a.npy", objects, allow_pickle=True)
    assert "damaged NPY file" in fault(tmp_path / "a.npy")
    assert not marker.exists()
    (tmp_path / "b.npy").write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", 2000) + b"(" * 2000)
    assert "damaged NPY file" in fault(tmp_path / "b.npy")
    (tmp_path / "c.npy").write_bytes(b"\x93NUMPY\x02\x00" + struct.pack("<I", 2**31) + b" " * 2000)
    assert "damaged NPY file" in fault(tmp_path / "c.npy")


@pytest.mark.parametrize("name", ["a.exr", "a.png", "a.npy"])
def test_cut_off_anywhere(tmp_path, name):
    image = RNG.integers(0, 200, (H, W, 3)).astype(np.uint8)
    path = tmp_path / name
    if name == "a.exr":
        write_exr(path, {n: image[..., 0].astype(np.float32) for n in "RGB"})
    elif name == "a.png":
        Image.fromarray(image).save(path)
    else:
        np.save(path, image)
    whole = path.read_bytes()
    for length in (0, 3, 9, 20, 40, 90, len(whole) // 2, len(whole) - 30):
        path.write_bytes(whole[:length])
        with pytest.raises(GffeError, match=f"^{name}"):
            read_planes(path, "RGB", name, (W, H))
    path.unlink()
    with pytest.raises(GffeError, match="no such file"):
        read_planes(path, "RGB", name, (W, H))


@pytest.mark.parametrize(("names", "words"), [("RGA", "no channel 'A'"), (["7"], "no channel '7'")])
def test_missing_channels(tmp_path, names, words):
    image = np.zeros((H, W, 3), np.uint8)
    Image.fromarray(image).save(tmp_path / "a.png")
    np.save(tmp_path / "a.npy", image)
    write_exr(tmp_path / "a.exr", {n: image[..., 0].astype(np.float32) for n in "RGB"})
    for name in ("a.png", "a.npy", "a.exr"):
        assert words in fault(tmp_path / name, names)
