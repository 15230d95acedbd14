"""CUDA's memory as buffers of OpenCL, without a copy: what one API writes, the other reads, and new frames have the
same bits. Needs an NVIDIA GPU. PyTorch and CuPy see the same memory through `__cuda_array_interface__`."""

import ctypes as ct

import numpy as np
import pyopencl as cl
import pytest

from gffe_cl import GffeError, MemorySharing, Options, Pipeline, RenderedFrame
from gffe_cl.engine.frame.rendered_frame import host_arrays
from gffe_cl.engine.selftest.scene import frames

pytestmark = [pytest.mark.device, pytest.mark.gpu]

W, H = 320, 180
PINNED, DESCRIPTOR, READ_WRITE = 1, 1, 3  # kind of memory, of handle, of access (cuda.h)
ULONG, SIZE = ct.c_ulonglong, ct.c_size_t


class Location(ct.Structure):  # CUmemLocation
    _fields_ = [("type", ct.c_int), ("id", ct.c_int)]


class Properties(ct.Structure):  # CUmemAllocationProp
    _fields_ = [
        ("type", ct.c_int),
        ("handle_types", ct.c_int),
        ("location", Location),
        ("win32", ct.c_void_p),
        ("flags", ct.c_ubyte * 8),
    ]


class Access(ct.Structure):  # CUmemAccessDesc
    _fields_ = [("location", Location), ("flags", ct.c_int)]


class Cuda:
    """The first CUDA device, through the driver's own library."""

    def __init__(self):
        try:
            self.library = ct.CDLL("libcuda.so.1")
        except OSError as error:
            pytest.skip(f"no CUDA: {error}")
        number, context = ct.c_int(), ct.c_void_p()
        self.call("cuInit", 0)
        self.call("cuDeviceGet", ct.byref(number), 0)
        self.call("cuDevicePrimaryCtxRetain", ct.byref(context), number)
        self.call("cuCtxSetCurrent", context)

    def call(self, name, *arguments):
        code = getattr(self.library, name)(*arguments)
        assert code == 0, f"{name}: CUDA error {code}"


class CudaMemory:
    """Memory of CUDA that other APIs may import: `pointer` for CUDA, `descriptor` for them."""

    def __init__(self, cuda, array):
        self.cuda = cuda
        properties = Properties(PINNED, DESCRIPTOR, Location(1, 0))
        grain, handle = SIZE(), ULONG()
        self.pointer, self.descriptor = ULONG(), ct.c_int(-1)
        cuda.call("cuMemGetAllocationGranularity", ct.byref(grain), ct.byref(properties), 0)
        self.nbytes = array.nbytes
        size = SIZE(-(-self.nbytes // grain.value) * grain.value)
        cuda.call("cuMemCreate", ct.byref(handle), size, ct.byref(properties), ULONG(0))
        cuda.call("cuMemExportToShareableHandle", ct.byref(self.descriptor), handle, DESCRIPTOR, ULONG(0))
        cuda.call("cuMemAddressReserve", ct.byref(self.pointer), size, SIZE(0), ULONG(0), ULONG(0))
        cuda.call("cuMemMap", self.pointer, size, SIZE(0), handle, ULONG(0))
        cuda.call("cuMemSetAccess", self.pointer, size, ct.byref(Access(Location(1, 0), READ_WRITE)), SIZE(1))
        self.write(array)

    def write(self, array):
        array = np.ascontiguousarray(array)
        self.cuda.call("cuMemcpyHtoD_v2", self.pointer, array.ctypes.data_as(ct.c_void_p), SIZE(array.nbytes))
        self.cuda.call("cuCtxSynchronize")

    def read(self, array):
        self.cuda.call("cuMemcpyDtoH_v2", array.ctypes.data_as(ct.c_void_p), self.pointer, SIZE(array.nbytes))
        return array


@pytest.fixture(scope="module")
def sharing(device):
    try:
        found = MemorySharing(device)
    except GffeError as error:
        pytest.skip(str(error))
    if "opaque_fd" not in found.types:
        pytest.skip(f"{device.info.name}: the driver imports {', '.join(found.types)}, no opaque_fd")
    return found


@pytest.fixture(scope="module")
def cuda(sharing):
    return Cuda()


def imported(sharing, memory):
    return sharing.buffer("opaque_fd", memory.descriptor.value, memory.nbytes)


def test_each_api_reads_what_the_other_wrote(device, sharing, cuda):
    numbers = np.arange(2 * W * H, dtype=np.uint32)
    memory = CudaMemory(cuda, numbers)
    buffer, seen = imported(sharing, memory), np.empty_like(numbers)
    sharing.acquire([buffer]).wait()
    cl.enqueue_copy(device.queue, seen, buffer)
    assert np.array_equal(seen, numbers)
    cl.enqueue_fill_buffer(device.queue, buffer, np.uint32(0x3C003C00), 0, numbers.nbytes)
    sharing.release([buffer]).wait()
    assert (memory.read(seen) == 0x3C003C00).all()


def test_frames_in_cuda_memory_give_the_same_bits(device, sharing, cuda):
    options = Options(shading_correction=False)
    shared, alone = (Pipeline(device, W, H, options) for _ in range(2))
    for frame in frames(W, H, count=4, samples=1):
        host = host_arrays(frame).in_device_layout()
        memories = [CudaMemory(cuda, array) for array in (host.color, host.depth, host.motion)]
        buffers = [imported(sharing, memory) for memory in memories]
        taken = sharing.acquire(buffers)
        given = RenderedFrame(*buffers, frame.camera, time=frame.time, reset=frame.reset)
        shared.submit(given, wait_for=[taken])
        alone.submit(frame)
        here, there = shared.extrapolate(), alone.extrapolate()
        for name in ("color", "depth", "motion", "filled_by"):
            assert np.array_equal(here.numpy(name), there.numpy(name), equal_nan=True), (frame.time, name)
    assert shared.copied_bytes == 0


def test_torch_writes_into_the_same_memory(device, sharing, cuda):
    torch = pytest.importorskip("torch", reason="needs PyTorch")
    if not torch.cuda.is_available():
        pytest.skip("this PyTorch has no CUDA")
    memory = CudaMemory(cuda, np.zeros((H, W, 4), np.float16))
    shape = {"shape": (H, W, 4), "typestr": "<f2", "data": (memory.pointer.value, False), "version": 3}
    tensor = torch.as_tensor(type("Shared", (), {"__cuda_array_interface__": shape})(), device="cuda")
    tensor[...] = 0.25
    torch.cuda.synchronize()
    buffer, seen = imported(sharing, memory), np.empty((H, W, 4), np.float16)
    sharing.acquire([buffer]).wait()
    cl.enqueue_copy(device.queue, seen, buffer)
    sharing.release([buffer]).wait()
    assert (seen == 0.25).all()
