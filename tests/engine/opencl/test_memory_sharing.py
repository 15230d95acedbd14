"""Sharing with Vulkan: what drivers say of it, and the calls, by a fake driver behind the real types of C. Its buffers
and events are the real device's, so that pipelines work with them."""

import ctypes as ct
from dataclasses import replace

import numpy as np
import pyopencl as cl
import pytest
from tiny_frames import H, W, frames

from gffe_cl import Device, GffeError, MemorySharing, Options, Pipeline, SharingSupport, sharing_support
from gffe_cl.engine.frame.rendered_frame import host_arrays
from gffe_cl.engine.opencl import sharing

SLOTS = 3  # of rendered frames: two are in use while the third is written
P, INT, UINT, SIZE, ULONG = ct.c_void_p, ct.c_int32, ct.c_uint32, ct.c_size_t, ct.c_uint64
SEMAPHORES = 0x5000
INVALID_VALUE, INVALID_OPERATION = -30, -59
TAKE, GIVE = "clEnqueueAcquireExternalMemObjectsKHR", "clEnqueueReleaseExternalMemObjectsKHR"


def real(name, handle):
    """A call of the real loader that takes one handle: retains what it is of."""
    function = getattr(sharing._loader(), name)
    function.argtypes = [P]
    assert function(handle) == 0


class FakeDriver:
    """Keeps what belongs to whom: `acquired`, buffers that OpenCL may use. `calls`: (name, what it was about)."""

    def __init__(self, device):
        self.device, self.calls, self.memory, self.acquired, self.events = device, [], {}, set(), []
        self.signaled = {}  # semaphores of the other API, by name; OpenCL's handles are those + SEMAPHORES
        self.functions = {
            "clGetDeviceInfo": (INT, (P, UINT, SIZE, P, P), self.device_info),
            "clCreateBufferWithProperties": (P, (P, P, ULONG, SIZE, P, P), self.with_properties),
            "clCreateSemaphoreWithPropertiesKHR": (P, (P, P, P), self.semaphore),
            "clReleaseSemaphoreKHR": (INT, (P,), self.drop_semaphore),
            "clEnqueueWaitSemaphoresKHR": (INT, (P, UINT, P, P, UINT, P, P), self.switch(False)),
            "clEnqueueSignalSemaphoresKHR": (INT, (P, UINT, P, P, UINT, P, P), self.switch(True)),
        }
        for call in (TAKE, GIVE):
            self.functions[call] = (INT, (P, UINT, P, UINT, P, P), self.mover(call))
        self.callbacks = {
            name: ct.CFUNCTYPE(result, *given)(call) for name, (result, given, call) in self.functions.items()
        }

    def address(self, platform, name):
        assert platform == self.device.cl_device.platform
        return ct.cast(self.callbacks[name], P).value if name in self.callbacks else None

    def device_info(self, device, what, room, values, nbytes):
        assert device == self.device.cl_device.int_ptr
        types = {0x204F: (UINT * 3)(0x2067, 0x9999, 0x2060), 0x204D: (UINT * 2)(0x2058, 0x2055)}[what]
        assert room >= ct.sizeof(types)
        ct.memmove(values, types, ct.sizeof(types))
        SIZE.from_address(nbytes).value = ct.sizeof(types)
        return 0

    def with_properties(self, context, properties, flags, nbytes, host, error):
        told = list((ULONG * 3).from_address(properties))
        assert host is None
        self.calls.append(("with properties", (told, flags, nbytes)))
        memory = self.memory.get(told[1])
        INT.from_address(error).value = 0 if memory else INVALID_VALUE
        if not memory:
            return None
        assert memory.context.int_ptr == context and nbytes == memory.size
        real("clRetainMemObject", memory.int_ptr)
        return memory.int_ptr

    def mover(self, call):
        def move(queue, count, buffers, waits, events, event):
            given = set((P * count).from_address(buffers)) if count else set()
            awaited = [cl.Event.from_int_ptr(e, retain=True) for e in (P * waits).from_address(events)] if waits else []
            self.calls.append((call, (count, waits)))
            if (call == TAKE and given & self.acquired) or (call == GIVE and not given <= self.acquired):
                return INVALID_OPERATION
            self.acquired = self.acquired | given if call == TAKE else self.acquired - given
            return self._marked(queue, awaited, event)

        return move

    def semaphore(self, context, properties, error):
        told = list((ULONG * 5).from_address(properties))
        INT.from_address(error).value = 0 if told[3] in self.signaled else INVALID_VALUE
        assert told[:3] == [0x203D, 1, 0x2055] and told[4] == 0
        return SEMAPHORES + told[3]

    def drop_semaphore(self, handle):
        del self.signaled[handle - SEMAPHORES]
        return 0

    def switch(self, to):
        def switch(queue, count, semaphores, payload, waits, events, event):
            (name,) = [handle - SEMAPHORES for handle in (P * count).from_address(semaphores)]
            assert payload is None and not waits
            if self.signaled[name] == to:
                return INVALID_OPERATION
            self.signaled[name] = to
            return self._marked(queue, [], event)

        return switch

    def _marked(self, queue, awaited, event):
        self.events.append(cl.enqueue_marker(cl.CommandQueue.from_int_ptr(queue, retain=True), wait_for=awaited))
        real("clRetainEvent", self.events[-1].int_ptr)
        P.from_address(event).value = self.events[-1].int_ptr
        return 0

    def lend(self, context, name, nbytes):
        """Memory of the other API."""
        self.memory[name] = cl.Buffer(context, cl.mem_flags.READ_WRITE, nbytes)
        return self.memory[name]


@pytest.fixture
def driver(device, monkeypatch):
    fake = FakeDriver(device)
    monkeypatch.setattr(sharing, "_address", fake.address)
    says = "cl_khr_external_memory", "cl_khr_external_semaphore"
    monkeypatch.setattr(sharing, "_extensions", lambda own: says if own.platform == device.cl_device.platform else ())
    return fake


def loop(driver, shared):
    """An engine's frames: rendered into shared memory, and shown from shared memory. Returns what it shows."""
    device, context, shown = shared.device, shared.device.context, []
    pipeline = Pipeline(device, W, H, Options(shading_correction=False))
    sizes, other = (8 * W * H, 4 * W * H, 8 * W * H), cl.CommandQueue(context)
    slots = []
    for slot in range(SLOTS):
        for part, nbytes in enumerate(sizes):
            driver.lend(context, 10 * slot + part + 1, nbytes)
        slots.append([shared.buffer("opaque_fd", 10 * slot + part + 1, nbytes) for part, nbytes in enumerate(sizes)])
    driver.lend(context, 99, sizes[0])
    out = shared.buffer("opaque_fd", 99, sizes[0])
    driver.calls.clear()
    for k, frame in enumerate(frames(4)):
        buffers, before = slots[k % SLOTS], slots[(k - 1) % SLOTS] if k else []
        host = host_arrays(frame, H, W).in_device_layout()
        for part, array in enumerate((host.color, host.depth, host.motion)):  # the other API renders
            assert not driver.acquired
            cl.enqueue_copy(other, driver.memory[10 * (k % SLOTS) + part + 1], array)
        in_use = [*buffers, *before, out]
        taken = shared.acquire(in_use, wait_for=[cl.enqueue_marker(other)])
        pipeline.submit(replace(frame, color=buffers[0], depth=buffers[1], motion=buffers[2]), wait_for=[taken])
        made = pipeline.extrapolate()
        copied = cl.enqueue_copy(device.queue, out, made.color)
        shared.release(in_use, wait_for=[copied.int_ptr]).wait()
        picture = np.empty((H, W, 4), np.float16)  # the other API shows it
        cl.enqueue_copy(other, picture, driver.memory[99])
        shown.append(picture[..., :3].tobytes())
        assert driver.calls == [(call, (len(in_use), 1)) for call in (TAKE, GIVE)] and not driver.acquired
        driver.calls.clear()
    return shown


def expected(device):
    pipeline, shown = Pipeline(device, W, H, Options(shading_correction=False)), []
    for frame in frames(4):
        pipeline.submit(frame)
        shown.append(pipeline.extrapolate().numpy("color").tobytes())
    return shown


def test_frames_of_vulkan(device, driver):
    own = Device.from_context(cl.Context([device.cl_device]))
    shared = MemorySharing(own)
    assert sharing_support(own) == SharingSupport(("opaque_fd", "dma_buf"), ("opaque_fd",))
    assert loop(driver, shared) == expected(device)
    shared.buffer("dma_buf", 99, 8 * W * H)
    assert driver.calls == [("with properties", ([0x2067, 99, 0], 1, 8 * W * H))]


def test_semaphores_of_vulkan(device, driver):
    """Each is signaled by one API and waited for by the other, in turns."""
    shared = MemorySharing(Device.from_context(cl.Context([device.cl_device])))
    driver.signaled |= {3: True, 4: False}
    rendered, shown = (shared.semaphore("opaque_fd", name) for name in (3, 4))
    for _ in range(2):
        shared.wait(rendered)
        shared.signal(shown).wait()
        assert driver.signaled == {3: False, 4: True}
        driver.signaled |= {3: True, 4: False}
    shared.wait(rendered)
    with pytest.raises(GffeError, match="clEnqueueWaitSemaphoresKHR failed: OpenCL error -59"):
        shared.wait(rendered)
    with pytest.raises(GffeError, match=r"semaphore must be one of .*, got 3"):
        shared.signal(3)
    with pytest.raises(GffeError, match="clCreateSemaphoreWithPropertiesKHR failed: OpenCL error -30"):
        shared.semaphore("opaque_fd", 5)
    del rendered
    assert list(driver.signaled) == [4]
    shared.semaphore_types = ()
    with pytest.raises(GffeError, match=r"the driver does not offer semaphores \(cl_khr_external_semaphore\)"):
        shared.semaphore("opaque_fd", 4)


def test_references_are_the_callers_own(device, driver):
    shared = MemorySharing(Device.from_context(cl.Context([device.cl_device])))
    memory = driver.lend(shared.device.context, 5, 64)
    count = lambda: memory.get_info(cl.mem_info.REFERENCE_COUNT)  # noqa: E731
    buffer = shared.buffer("opaque_fd", 5, 64)
    assert count() == 2
    shared.acquire([buffer]).wait()
    shared.release([buffer]).wait()
    del buffer
    shared.device.queue.finish()
    assert count() == 1


def test_wrong_calls(device, driver):
    shared = MemorySharing(Device.from_context(cl.Context([device.cl_device])))
    driver.lend(shared.device.context, 5, 64)
    buffer = shared.buffer("opaque_fd", 5, 64)
    foreign = cl.UserEvent(device.context)

    def refused(text, call, *arguments):
        with pytest.raises(GffeError, match=text) as told:
            call(*arguments)
        assert "\n" not in str(told.value)

    refused("kind must be one of opaque_fd, dma_buf, got", shared.buffer, "opaque_win32", 5, 64)
    refused("handle must be a whole number", shared.buffer, "opaque_fd", -1, 64)
    refused("nbytes must be a whole number from 1", shared.buffer, "opaque_fd", 5, 0)
    refused("clCreateBufferWithProperties failed: OpenCL error -30", shared.buffer, "opaque_fd", 6, 64)
    refused("buffers must be a list of pyopencl.Buffers, got 5", shared.acquire, 5)
    refused(r"wait_for\[0\] belongs to another OpenCL context", shared.acquire, [buffer], [foreign])
    shared.acquire([buffer])
    refused(f"{TAKE} failed: OpenCL error -59", shared.acquire, [buffer])
    shared.release([buffer])
    refused(f"{GIVE} failed: OpenCL error -59", shared.release, [buffer])
    driver.callbacks.pop(TAKE)
    refused("neither the driver .* nor the OpenCL loader has clEnqueueAcq", shared.acquire, [buffer])
    refused("device must be an open Device", sharing_support, shared.device.context)


def test_what_drivers_say(device):
    """... and where they offer nothing, one line says so."""
    support, extensions = sharing_support(device), device.cl_device.extensions.split()
    assert bool(support.memory) == ("cl_khr_external_memory" in extensions)
    if not support.memory:
        with pytest.raises(GffeError, match=r"does not offer external memory \(cl_khr_\w+, see sharing_support\)"):
            MemorySharing(device)


def test_functions_are_found_in_the_real_loader(device):
    """The real clCreateBufferWithProperties makes a buffer, where no property asks for another API's memory."""
    platform, error = device.cl_device.platform, INT()
    create = sharing._function(platform, "clCreateBufferWithProperties", P, P, P, ULONG, SIZE, P, P)
    made = create(device.context.int_ptr, (ULONG * 1)(0), int(cl.mem_flags.READ_WRITE), 256, None, ct.byref(error))
    assert error.value == 0
    assert cl.Buffer.from_int_ptr(made, retain=False).size == 256
    with pytest.raises(GffeError, match="nor the OpenCL loader has clNoSuchFunctionKHR"):
        sharing._function(platform, "clNoSuchFunctionKHR", INT)
