"""Rendered frames of other libraries' tensors."""

import numpy as np
import pytest
from synthetic import camera

from gffe_cl import GffeError, RenderedFrame
from gffe_cl.engine.frame.rendered_frame import host_arrays

W, H = 6, 4


class TensorOnGpu:
    """A tensor that NumPy cannot read in place, as PyTorch's and CuPy's on a GPU: DLPack copies it to the host."""

    def __init__(self, array, lost=False):
        self.array, self.lost = array, lost

    def __array__(self, *_, **__):
        raise TypeError("can't convert a tensor of device cuda:0 to NumPy")

    def __dlpack_device__(self):
        return 2, 0

    def __dlpack__(self, dl_device=None, **more):
        if self.lost:
            raise BufferError("the device is lost")
        assert dl_device == (1, 0)
        return self.array.__dlpack__(dl_device=dl_device, **more)


def test_tensors_of_other_libraries(monkeypatch):
    random = np.random.default_rng(3)
    color, depth = random.random((H, W, 3), np.float32), random.random((H, W), np.float32)
    motion = random.random((H, W, 2), np.float32)
    given = [TensorOnGpu(array) for array in (color, depth, motion)]
    arrays = host_arrays(RenderedFrame(*given, camera(W, H), time=0.0), H, W)
    for found, expected in zip((arrays.color, arrays.depth, arrays.motion), (color, depth, motion), strict=True):
        assert np.array_equal(found, expected)
    given[1] = TensorOnGpu(depth, lost=True)
    said = r"^frame: depth must be an array of numbers, got a TensorOnGpu \("
    with pytest.raises(GffeError, match=said + r"BufferError: the device is lost\)$"):
        host_arrays(RenderedFrame(*given, camera(W, H), time=0.0), H, W)
    given[0] = color
    monkeypatch.setattr(np, "__version__", "2.0.2")
    with pytest.raises(GffeError, match=said + r"tensors of a GPU need NumPy 2.1 or newer, this is 2.0.2\)$"):
        host_arrays(RenderedFrame(*given, camera(W, H), time=0.0), H, W)
