"""In an engine's own OpenCL context: its queue, its buffers by handle, events that order the work, arrays in place."""

import ctypes as ct
import ctypes.util
import time
import weakref
from dataclasses import replace
from functools import partial

import numpy as np
import pyopencl as cl
import pytest
import scn_models
import tiny_frames

from gffe_cl import Device, GffeError, Options, Overlays, Pipeline, RenderedFrame, open_device
from gffe_cl.engine.frame.rendered_frame import host_arrays

W, H = 64, 48
frames = partial(tiny_frames.frames, width=W, height=H)
PLAIN = Options(shading_correction=False)
NO_WAIT = replace(PLAIN, cut_detection=False)
OUT_OF_ORDER = cl.command_queue_properties.OUT_OF_ORDER_EXEC_MODE_ENABLE
NAMES = ("color", "depth", "motion", "filled_by")


@pytest.fixture
def context(device):
    return cl.Context([device.cl_device])


@pytest.fixture
def engine(context):
    """A device in the context of somebody else, whose queue has no profiling."""
    return Device.from_context(context, cl.CommandQueue(context))


def buffers_of(frame, context):
    """Device buffers of color, depth and motion."""
    host, flags = host_arrays(frame, H, W).in_device_layout(), cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
    return [cl.Buffer(context, flags, hostbuf=array) for array in (host.color, host.depth, host.motion)]


def by_handle(frame, buffers):
    return replace(frame, **{name: b.int_ptr for name, b in zip(NAMES[:3], buffers, strict=True)})


def bits(made):
    return [made.numpy(name).tobytes() for name in NAMES]


def expected_bits(device):
    pipeline = Pipeline(device, W, H, PLAIN)
    for frame in frames():
        pipeline.submit(frame)
    return bits(pipeline.extrapolate())


def references(thing, info):
    return thing.get_info(info.REFERENCE_COUNT)


# ---- context and queue -------------------------------------------------------------------------------------


def test_an_engines_context_and_buffers_give_the_same_bits(device, context):
    """All of it by handles; without profiling there are no timings, and buffers that come again are used again."""
    queue = cl.CommandQueue(context)
    own = Device.from_context(context.int_ptr, queue.int_ptr)
    assert (own.context, own.queue, own.profiles) == (context, queue, False)
    assert own.exact_division == device.exact_division and own.lanes == device.lanes
    pipeline, kept = Pipeline(own, W, H, PLAIN), []
    for frame in frames():
        kept.append(buffers_of(frame, context))
        pipeline.submit(by_handle(frame, kept[-1]))
    assert bits(pipeline.extrapolate()) == expected_bits(device)
    assert pipeline.copied_bytes == 0
    for take in (pipeline.take_timings, pipeline.take_kernel_timings):
        with pytest.raises(
            GffeError, match=r"^take_\w*timings: .* has no profiling .expected open_device.profiling=True"
        ):
            take()


def test_handles_of_another_loader(device):
    """An engine has a libOpenCL of its own, not that of pyopencl's wheel."""
    found = ctypes.util.find_library("OpenCL")
    if found is None:
        pytest.skip("no OpenCL loader of the system's")
    loader, pointer, error = ct.CDLL(found), ct.c_void_p, ct.c_int()
    for name in ("clCreateContext", "clCreateCommandQueue"):
        getattr(loader, name).restype = pointer
    loader.clCreateCommandQueue.argtypes = [pointer, pointer, ct.c_uint64, pointer]
    platforms, wanted, name = (pointer * 16)(), device.cl_device.platform.name, ct.create_string_buffer(256)
    count = ct.c_uint()
    assert loader.clGetPlatformIDs(16, platforms, ct.byref(count)) == 0
    for platform in platforms[: count.value]:
        assert loader.clGetPlatformInfo(pointer(platform), 0x0902, len(name), name, None) == 0
        if name.value.decode() == wanted:
            break
    else:
        pytest.skip(f"the system's loader does not list {wanted}")
    own = (pointer * 1)()
    assert loader.clGetDeviceIDs(pointer(platform), ct.c_uint64(0xFFFFFFFF), 1, own, None) == 0
    context = loader.clCreateContext(None, 1, own, None, None, ct.byref(error))
    queue = loader.clCreateCommandQueue(context, own[0], 0, ct.byref(error))
    assert context and queue and error.value == 0
    pipeline = Pipeline(Device.from_context(context, queue), W, H, PLAIN)
    for frame in frames():
        pipeline.submit(frame)
    assert bits(pipeline.extrapolate()) == expected_bits(device)
    del pipeline
    assert loader.clReleaseCommandQueue(pointer(queue)) == loader.clReleaseContext(pointer(context)) == 0


def test_a_queue_with_profiling_gives_timings(device, context):
    assert not any(made.profiles for made in (Device.from_context(context), open_device(device.info.index)))
    own = Device.from_context(context, None, profiling=True)
    assert own.profiles and own.queue.context == context
    pipeline = Pipeline(own, W, H, PLAIN)
    pipeline.submit(next(frames()))
    pipeline.extrapolate()
    assert pipeline.take_timings()["warp"] > 0


def test_a_context_of_several_devices(device):
    """Kernels are built for the queue's device alone."""
    try:
        both = device.cl_device.create_sub_devices([cl.device_partition_property.EQUALLY, 1])[:2]
        context = cl.Context(both)
    except cl.Error as error:
        pytest.skip(f"no context of two sub-devices here: {error}")
    if len(both) < 2 or len(context.devices) < 2:
        pytest.skip("one core, or sub-devices that count as one")
    with pytest.raises(GffeError, match=r"the context has 2 devices \(expected a queue of one\)"):
        Device.from_context(context)
    own = Device.from_context(context, cl.CommandQueue(context, both[1]))
    pipeline = Pipeline(own, W, H, PLAIN)
    for frame in frames():
        pipeline.submit(frame)
    assert bits(pipeline.extrapolate()) == expected_bits(device)


def test_programs_are_shared_and_released_with_the_last_device(context):
    queue = cl.CommandQueue(context)
    before = references(context, cl.context_info)
    own, other = (Device.from_context(context.int_ptr, queue.int_ptr) for _ in range(2))
    assert own.opened is other.opened
    pipeline = Pipeline(own, W, H, PLAIN)
    pipeline.submit(next(frames()))
    made = pipeline.extrapolate()
    made.numpy("color")
    assert references(context, cl.context_info) > before
    del pipeline, made, own, other
    assert references(context, cl.context_info) == before


def test_what_is_no_context_or_queue(device, context):
    other = cl.Context([device.cl_device])

    def refused(text, *arguments):
        with pytest.raises(GffeError, match=text) as told:
            Device.from_context(*arguments)
        assert "\n" not in str(told.value)

    refused(r"context must be a pyopencl.Context or the integer handle of one, got 0", 0, None)
    refused(r"context must be .*, got nothing", None, None)
    refused(r"queue must be a pyopencl.CommandQueue or .*, got 7", context, 7)
    refused(r"queue must be .*, got a Context", context, context)
    refused(r"the queue belongs to another OpenCL context", context, cl.CommandQueue(other))
    out_of_order = cl.CommandQueue(context, properties=OUT_OF_ORDER)
    refused(r"works out of order \(expected one that works in order, or queue=None and events\)", context, out_of_order)


# ---- buffers by handle -------------------------------------------------------------------------------------


def test_buffers_are_retained_as_long_as_they_are_in_use(engine, context):
    pipeline, first = Pipeline(engine, W, H, PLAIN), None
    for k, frame in enumerate(frames(4)):
        buffers = buffers_of(frame, context)
        pipeline.submit(by_handle(frame, buffers))
        engine.queue.finish()  # commands retain them, too
        assert all(references(b, cl.mem_info) == 2 for b in buffers)
        first = first or buffers
        if k < 2:  # in use until two more frames have been submitted
            assert [references(b, cl.mem_info) for b in first[:2]] == [2, 2]
    assert [references(b, cl.mem_info) for b in first] == [1, 1, 1]
    last = buffers
    del pipeline
    assert [references(b, cl.mem_info) for b in last] == [1, 1, 1]


def test_overlays_by_handle(device, engine, context):
    ui = np.zeros((H, W, 4), np.float16)
    ui[5:9, 5:30] = 0.5, 0.25, 0.125, 1
    buffer = cl.Buffer(context, cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR, hostbuf=ui)
    pipeline, frame = Pipeline(engine, W, H, PLAIN), next(frames())
    pipeline.submit(replace(frame, overlays=Overlays(ui=buffer.int_ptr)))
    assert pipeline.extrapolate().numpy("color")[6, 6].tolist() == [0.5, 0.25, 0.125]


def test_handles_that_cannot_be_used(device, engine, context):
    frame = next(frames())
    good = buffers_of(frame, context)
    flags, shape = cl.mem_flags.READ_ONLY, (W, H)
    image = cl.create_image(context, flags, cl.ImageFormat(cl.channel_order.RGBA, cl.channel_type.HALF_FLOAT), shape)
    small, foreign = cl.Buffer(context, flags, 16), buffers_of(frame, device.context)
    pipeline = Pipeline(engine, W, H, PLAIN)

    def refused(text, **changes):
        with pytest.raises(GffeError, match=text) as told:
            pipeline.submit(replace(by_handle(frame, good), **changes))
        assert "\n" not in str(told.value)

    refused(r"color: the handle is of an image \(expected a buffer", color=image.int_ptr)
    refused(r"depth buffer must hold 12288 bytes \(64×48\), got 16", depth=small.int_ptr)
    refused(r"color: the device buffer belongs to another OpenCL context", color=foreign[0].int_ptr)
    for wrong in (0, -1, 7, True, 2**64, None):
        refused(r"must be all NumPy arrays or all device buffers, got color as", color=wrong)
    pipeline.submit(by_handle(frame, good))


# ---- events ------------------------------------------------------------------------------------------------


def status(event):
    return event.command_execution_status


def test_work_begins_when_events_are_complete_and_tells_when_it_is_done(device, engine, context):
    """Of another queue of the engine, by handle too; the host does not wait."""
    other = cl.CommandQueue(context)
    pipeline, kept = Pipeline(engine, W, H, NO_WAIT), []
    written, read = cl.UserEvent(context), cl.UserEvent(context)
    for k, frame in enumerate(frames()):
        empty = [cl.Buffer(context, cl.mem_flags.READ_WRITE, b.size) for b in buffers_of(frame, context)]
        waits = [written] if k == 0 else []
        copies = [
            cl.enqueue_copy(other, to, of, wait_for=waits)
            for to, of in zip(empty, buffers_of(frame, context), strict=True)
        ]
        other.flush()
        kept.append(empty)
        done = pipeline.submit(by_handle(frame, empty), wait_for=[copies[0], *(e.int_ptr for e in copies[1:])])
    made = pipeline.extrapolate(wait_for=(read,))
    time.sleep(0.05)
    states = cl.command_execution_status
    assert status(done) > states.COMPLETE and status(made.event) > states.COMPLETE
    written.set_status(states.COMPLETE)
    done.wait()
    time.sleep(0.05)
    assert status(done) == states.COMPLETE and status(made.event) > states.COMPLETE
    out = np.empty((H, W, 4), np.float16)
    copied = cl.enqueue_copy(other, out, made.color, wait_for=[made.event], is_blocking=False)
    other.flush()
    read.set_status(states.COMPLETE)
    copied.wait()
    assert out[..., :3].tobytes() == expected_bits(device)[0]
    pipeline.present(wait_for=[copied]).event.wait()
    assert bits(made) == expected_bits(device)


def test_the_event_comes_after_the_network(engine, tmp_path):
    """It is that of the kernels after it."""
    model = scn_models.constant_model(tmp_path / "scn.onnx", delta=0.2)
    pipeline = Pipeline(engine, W, H, replace(PLAIN, shading_correction=True, scn_model=str(model)))
    for k, frame in enumerate(frames(4)):
        pipeline.submit(replace(frame, color=frame.color * np.float16(0.7**k)))  # still frames need no network
    made = pipeline.extrapolate()
    made.event.wait()
    out = np.empty((H, W, 4), np.float16)
    cl.enqueue_copy(cl.CommandQueue(engine.context), out, made.color)
    assert out[..., :3].tobytes() == made.numpy("color").tobytes()
    assert made.numpy("color").tobytes() != made.numpy("gae").tobytes()
    assert set(pipeline.stages["correction"].take_network_milliseconds()) == {"network"}


def test_events_that_cannot_be_waited_for(device, engine, context):
    pipeline = Pipeline(engine, W, H, PLAIN)
    first, second, _ = frames()
    pipeline.submit(first)
    failed = cl.UserEvent(context)
    failed.set_status(-5)
    cases = (
        (3, r"must be a list of OpenCL events, got 3"),
        ("ab", r"wait_for\[0\] must be a pyopencl.Event or the integer handle of one"),
        ([None], r"wait_for\[0\] must be a pyopencl.Event or the integer handle of one, got nothing"),
        ([cl.UserEvent(device.context)], r"wait_for\[0\] belongs to another OpenCL context"),
        ([failed], r"wait_for\[0\] has failed \(OpenCL error -5\)"),
    )
    for events, text in cases:
        for call in (lambda **given: pipeline.submit(second, **given), pipeline.extrapolate, pipeline.present):
            with pytest.raises(GffeError, match=text) as told:
                call(wait_for=events)
            assert "\n" not in str(told.value)
    pipeline.submit(second)  # it was not taken before
    pipeline.extrapolate().event.wait()


# ---- arrays in place ---------------------------------------------------------------------------------------


def aligned(device, array):
    made = device.empty(array.shape, array.dtype)
    made[...] = array
    assert made.ctypes.data % device.alignment == 0 and made.flags.c_contiguous
    return made


def in_place(device, frame):
    """The frame with arrays that lie as device buffers do."""
    host = host_arrays(frame, H, W).in_device_layout()
    arrays = {name: aligned(device, getattr(host, name)) for name in NAMES[:3]}
    return replace(frame, **arrays)


@pytest.mark.parametrize("on_cpu", [True, False], ids=["in host memory", "of its own memory"])
def test_arrays_in_place_are_not_copied(device, on_cpu, monkeypatch):
    monkeypatch.setitem(device.__dict__, "works_in_host_memory", on_cpu and device.info.kind == "cpu")
    pipeline, copying = (Pipeline(device, W, H, PLAIN) for _ in range(2))
    kept = [in_place(device, frame) for frame in frames()]
    for frame in kept:
        pipeline.submit(frame, zero_copy=True)
        copying.submit(frame)
    assert bits(pipeline.extrapolate()) == bits(copying.extrapolate()) == expected_bits(device)
    on_cpu = device.works_in_host_memory
    assert pipeline.copied_bytes == (0 if on_cpu else copying.copied_bytes)
    assert copying.copied_bytes == len(kept) * W * H * (20 if on_cpu else 40)


def test_kernels_read_arrays_in_place_when_they_run(device):
    """Not before: what changes in them meanwhile is seen. They live as long as they are in use."""
    if not device.works_in_host_memory:
        pytest.skip("not a CPU")
    pipeline, go = Pipeline(device, W, H, NO_WAIT), cl.UserEvent(device.context)
    first, second, _ = (in_place(device, frame) for frame in frames())
    pipeline.submit(first, zero_copy=True)
    pipeline.submit(second, zero_copy=True, wait_for=[go])
    made = pipeline.extrapolate()
    second.depth[...] = 7
    second.color[...] = 0.25
    del first, second
    go.set_status(cl.command_execution_status.COMPLETE)
    depth = made.numpy("depth")
    assert (depth[made.numpy("filled_by") == 0] == 7).all()


def test_arrays_in_place_live_until_the_device_has_done_with_them(device):
    if not device.works_in_host_memory:
        pytest.skip("not a CPU")
    pipeline, go = Pipeline(device, W, H, NO_WAIT), cl.UserEvent(device.context)
    memory = []
    for frame in frames(4):
        frame = in_place(device, frame)
        memory.append(weakref.ref(frame.depth.base))
        done = pipeline.submit(frame, zero_copy=True, wait_for=[go])
        pipeline.extrapolate()
    del frame
    assert all(array() is not None for array in memory)
    go.set_status(cl.command_execution_status.COMPLETE)
    done.wait()
    pipeline.submit(replace(next(frames(1)), time=1.0), zero_copy=True)
    assert memory[0]() is None and memory[1]() is None
    del pipeline
    assert all(array() is None for array in memory)


@pytest.mark.parametrize(
    ("name", "changed", "least", "most"),  # bytes per pixel: what the host has made anew may be aligned by chance
    [
        ("color", lambda a: a[..., :3].astype(np.float32), 8, 8),  # converted by a kernel
        ("color", lambda a: a.astype(np.float64)[..., :3], 8 + 12, 8 + 12),  # ... and by the host
        (
            "color",
            lambda a: np.frombuffer(b"--" + a.tobytes(), a.dtype, offset=2).reshape(a.shape),
            8,
            8,
        ),  # not aligned
        ("depth", lambda a: np.frombuffer(b"----" + a.tobytes(), a.dtype, offset=4).reshape(a.shape), 12, 12),
        ("depth", lambda a: a.astype(np.float64), 4, 4 + 12),
        ("motion", lambda a: np.asfortranarray(a), 8, 8 + 12),
    ],
)
def test_arrays_that_must_be_copied_are_counted(device, name, changed, least, most):
    if not device.works_in_host_memory:
        pytest.skip("not a CPU")
    pipeline = Pipeline(device, W, H, PLAIN)
    for frame in frames():
        frame = in_place(device, frame)
        pipeline.submit(replace(frame, **{name: changed(getattr(frame, name))}), zero_copy=True)
    assert bits(pipeline.extrapolate()) == expected_bits(device)
    assert 3 * W * H * least <= pipeline.copied_bytes <= 3 * W * H * most


def test_bad_pixels_are_counted_in_what_is_copied(device):
    if not device.works_in_host_memory:
        pytest.skip("not a CPU")
    pipeline, frame = Pipeline(device, W, H, PLAIN), in_place(device, next(frames()))
    frame.depth[3, 4] = np.nan
    color = frame.color.astype(np.float32)
    color[5, 6] = np.nan
    pipeline.submit(frame, zero_copy=True)
    assert not pipeline.bad_pixels
    pipeline.submit(replace(frame, color=color), zero_copy=True)
    assert (pipeline.bad_pixels.color, pipeline.bad_pixels.depth) == (1, 0)
    pipeline.submit(replace(frame, color=color))
    assert (pipeline.bad_pixels.color, pipeline.bad_pixels.depth) == (2, 1)


def test_made_frames_can_be_read_where_they_are(device):
    pipeline = Pipeline(device, W, H, PLAIN)
    for frame in frames():
        pipeline.submit(frame)
        made = pipeline.extrapolate()
        for name in (*NAMES, "gae", "dynamic"):
            with made.mapped(name) as array:
                assert array.shape == made.numpy(name).shape and not array.flags.writeable
                assert array.tobytes() == made.numpy(name).tobytes()
    with pipeline.present().mapped("color") as array:
        assert array.tobytes() == frame.color.tobytes()
    with pytest.raises(GffeError, match=r"frame: name must be one of color, depth"), made.mapped("blue"):
        pass
    with pytest.raises(RuntimeError, match="stop"), made.mapped("color"):
        raise RuntimeError("stop")
    assert bits(made) == expected_bits(device)


@pytest.mark.parametrize("library", ["numpy", "torch"])
def test_made_frames_are_tensors_of_other_libraries(device, library):
    """In place on CPUs: the next frame changes them, and they outlive the pipeline."""
    module = pytest.importorskip(library)
    pipeline, given = Pipeline(device, W, H, PLAIN), list(frames())
    pipeline.submit(given[0])
    made = pipeline.extrapolate()
    tensors = {name: module.from_dlpack(made.dlpack(name)) for name in (*NAMES, "gae", "dynamic")}
    before = {name: np.asarray(tensor).copy() for name, tensor in tensors.items()}
    for name, array in before.items():
        assert array.tobytes() == made.numpy(name).tobytes() and array.shape == made.numpy(name).shape
    pipeline.submit(given[1])
    after = pipeline.extrapolate().numpy("color")
    assert after.tobytes() != before["color"].tobytes()
    del pipeline, made
    shown = after if device.works_in_host_memory else before["color"]
    assert np.array_equal(np.asarray(tensors["color"]), shown)
    frame = RenderedFrame(tensors["color"], tensors["depth"], tensors["motion"], given[1].camera, time=0.0)
    assert np.array_equal(host_arrays(frame, H, W).color, shown)


def test_aligned_arrays(device):
    for shape, dtype in (((3, 5), np.float32), (7, "u1"), ((), np.float64)):
        array = device.empty(shape, dtype)
        assert array.ctypes.data % device.alignment == 0 and array.flags.writeable
        assert array.shape == np.broadcast_shapes(shape) and array.dtype == dtype
    for shape, dtype in (("ab", np.float32), ((-1,), np.float32), ((2,), object), ((2,), "none")):
        with pytest.raises(GffeError, match=r"empty: no array of shape"):
            device.empty(shape, dtype)
