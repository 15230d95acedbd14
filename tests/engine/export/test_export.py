"""`gffe export`: the pipeline in C gives the same bits as Python's, on the same device from the same buffers."""

import ctypes as ct
import os
import subprocess
import sys
from dataclasses import replace
from functools import partial

import numpy as np
import pyopencl as cl
import pytest
import scn_models
from exported import (
    DECLARED,
    INVALID,
    OK,
    SCALARS,
    STRUCTURES,
    CFrame,
    Engine,
    Failed,
    c_camera,
    c_format,
    camera_of,
    compile_library,
    load,
    require_compiler,
)
from refused_values import TABLE, Calls, refusal

from gffe_cl.captures.scenes import load_scene
from gffe_cl.captures.scenes.renderer import SceneFrames, SceneRenderer
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.export.writing import export
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.frame_format import COLOR_TYPES, DEPTH_TYPES, MOTION_TYPES, TYPES, FrameFormat
from gffe_cl.engine.frame.rendered_frame import Overlays, RenderedFrame, host_arrays
from gffe_cl.engine.frame.window import Jitter, WindowChooser
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.buffers import Owner, grid_of, spread

W, H = 83, 61
RGBA, HALF = cl.channel_order.RGBA, cl.channel_type.HALF_FLOAT
DEFAULT = Options(shading_correction=False)
VARIED = replace(
    DEFAULT,
    levels=2,
    crack_closing=False,
    soft_silhouettes=False,
    acceleration=False,
    history=4,
    order=3,
    hole_filling="none",
    cut_detection=False,
    static_threshold=1.5,
    camera_order=1,
)
DEEP = replace(
    DEFAULT, levels=4, hole_filling="downsample", expected_error=True, detail=True, hidden_parts=False, blocks=False
)
UPSCALED = replace(DEFAULT, upscale=2.0)
_libraries: dict = {}


@pytest.fixture
def library(device, request, tmp_path_factory):
    """The compiled library of options, made once per run."""
    require_compiler("cc")
    slowly = request.node.get_closest_marker("slow") and "pocl" not in device.info.version.lower()
    if slowly and not os.environ.get("GFFE_DEVICE"):
        pytest.skip("builds its kernels anew with every pipeline: GFFE_DEVICE asks for it")

    def made(options):
        if options not in _libraries:
            folder = tmp_path_factory.mktemp("export")
            export(folder, device, options)
            _libraries[options] = load(compile_library(folder, folder / "libgffe.so"))
            _libraries[options]._folder = folder
        return _libraries[options]

    return made


def on_device(device, frame: RenderedFrame, size):
    """The frame with device buffers, which both pipelines take."""
    host = host_arrays(frame, size[1], size[0]).in_device_layout()
    flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
    buffers = [cl.Buffer(device.context, flags, hostbuf=a) for a in (host.color, host.depth, host.motion)]
    return replace(frame, color=buffers[0], depth=buffers[1], motion=buffers[2])


def moving(device, count, size=(W, H), render_size=None, window="off", start=0.0, scene="plaza"):
    """Rendered frames of a built-in scene, on the device."""
    scene = load_scene(scene, 1)
    windows = WindowChooser(window, size, [0.5])
    render_size = render_size or size
    renderer = SceneRenderer(device, scene, *render_size)
    frames = SceneFrames(renderer, windows, size)
    return [on_device(device, frame, render_size) for frame in frames.sequence(count, 15.0, start)]


def named_buffers(pipeline):
    """What the pipeline's buffers hold, as they are stored, where they hold anything; by name."""
    found = {}
    for owner, spec in pipeline.named_buffers():
        if owner.name == "correction" and spec.name == "refined":  # made for lookers only
            continue
        if owner.name == "backward_blocks" and not pipeline.options.blocks:  # never written: what was lent lies there
            continue
        _, flat = spec.host_array(spec.size(owner.sizes))
        cl.enqueue_copy(pipeline.device.queue, flat, owner.buffer[spec.name])
        found[f"{owner.name}.{spec.name}"] = (flat.view(np.uint8).reshape(-1), known_texels(owner, spec))
    return found


def known_texels(owner: Owner, spec):
    """Where a buffer holds anything; None: everywhere."""
    if not spec.known_where:
        return None
    telling = owner.spec(spec.known_where[0])
    width, height = spec.size(owner.sizes)
    return spread(owner.read(telling.name), telling.grid, spec.grid, 0, 0, width, height) >= spec.known_where[1]


def assert_same_buffers(engine: Engine, pipeline: Pipeline):
    compared = named_buffers(pipeline)
    for name, (ours, known) in compared.items():
        theirs = engine.bytes_of(name).reshape(-1)
        if known is not None:
            texels = np.repeat(known.reshape(-1), ours.size // known.size) if ours.size == theirs.size else None
            ours, theirs = ours[texels], theirs[texels]
        assert np.array_equal(ours, theirs), f"{name}: {np.count_nonzero(ours != theirs)} of {ours.size} bytes differ"
    return set(compared)


def assert_same_frame(engine: Engine, made, ours):
    for name in ("color", "depth", "motion", "dynamic", "disoccluded", "filled_by", "gae", "expected_error"):
        if getattr(made, name) is None:
            continue
        buffer = getattr(ours, name)
        expected = np.empty(buffer.size, np.uint8)
        cl.enqueue_copy(engine.device.queue, expected, buffer)
        assert np.array_equal(engine.read(getattr(made, name), buffer.size), expected), name
    assert camera_of(made.camera) == ours.camera and made.time == ours.time


def run_both(device, library, options, frames, size=(W, H), alphas=(0.5,), cameras=None, formats=None, **more):
    """Both pipelines over frames; all buffers and outputs are compared after each extrapolated one."""
    render_size, exposure = more.pop("render_size", size), more.pop("exposure", 1.0)
    engine = Engine(library(options), device, *size, render_width=render_size[0], render_height=render_size[1], **more)
    int64 = None if more.get("int64_atomics", -1) < 0 else bool(more["int64_atomics"])
    pipeline = Pipeline(device, *size, options, render_size=render_size, int64_atomics=int64)
    compared, cuts = set(), []
    for frame, described in zip(frames, formats or [None] * len(frames), strict=True):
        pipeline.format, pipeline.exposure = described, exposure
        engine.set_exposure(exposure)
        if formats:
            engine.set_format(described, frame.geometry_jitter)
        pipeline.submit(frame)
        if frame.overlays:
            engine.set_overlays(frame.overlays)
        buffers = (frame.color, frame.depth, frame.motion)
        engine.submit(buffers, frame.camera, frame.time, frame.display_camera, frame.reset)
        pipeline.exposure = exposure / 2  # of the next frame
        engine.set_exposure(exposure / 2)
        assert engine.is_cut == pipeline.is_cut
        cuts.append(pipeline.is_cut)
        assert_same_frame(engine, engine.present(), pipeline.present())
        for alpha in alphas:
            time = frame.time + alpha * pipeline.interval
            camera = cameras(time) if cameras else pipeline.predict_camera(alpha)
            assert_same_frame(engine, engine.extrapolate(time, camera), pipeline.extrapolate(camera, time))
            compared |= assert_same_buffers(engine, pipeline)
    engine.destroy()
    return compared, cuts


def test_ten_frames_of_a_scene_have_the_same_bits(device, library):
    compared, _ = run_both(device, library, DEFAULT, moving(device, 10))
    assert {"history.dynamic_mask", "background.color_0", "frame.filled_by", "silhouettes.coverage"} <= compared
    assert len(compared) > 25


def test_a_camera_that_rests_has_the_same_bits(device, library):
    """Blocks at rest are skipped and copied: two new frames after each, seen by the resting camera and by another."""
    scene = load_scene("plaza", 1)
    seen = scene.camera(1.0, W, H)
    renderer = SceneRenderer(device, scene, W, H)
    frames = []
    for k in range(6):
        image = renderer.render(1 + k / 15, seen, 1 + max(k - 1, 0) / 15, seen)
        arrays = (image.read(name) for name in ("color", "depth", "motion"))
        frames.append(on_device(device, RenderedFrame(*arrays, camera=seen, time=k / 15, reset=k == 0), (W, H)))
    pushed = replace(seen, cx=seen.cx + 0.4)
    cameras = iter([seen, pushed, seen] * len(frames))
    compared, _ = run_both(device, library, DEFAULT, frames, alphas=(0.2, 0.5, 0.8), cameras=lambda _: next(cameras))
    assert {"backward_blocks.block_class", "color_code.codes", "history.dynamic_mask"} <= compared


def in_format(device, frame, format, rng):
    """The frame in the types of a description, with values of every kind that these have."""

    def buffer(values, type_name):
        dtype, most = TYPES[type_name]
        with np.errstate(over="ignore"):
            array = values.astype(dtype) if most == 1 else np.round(values * most).astype(dtype)
        return cl.Buffer(device.context, cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR, hostbuf=array)

    width, height = format.geometry_size or (W, H)
    color = rng.uniform(0, 1, (H, W, format.color_channels))
    depth = rng.uniform(0.1, 1, (height, width))
    motion = rng.uniform(0, 0.1, (height, width, format.motion_channels))
    motion[:9] = 0.25 if format.motion_invalid is None else format.motion_invalid
    missing = frame.reset and format.motion_y == "up"
    return replace(
        frame,
        color=buffer(color, format.color_type),
        depth=buffer(depth, format.depth_type),
        motion=None if missing else buffer(motion, format.motion_type),
        geometry_jitter=tuple(rng.uniform(-0.5, 0.5, 2)),
    )


FORMATS = (
    FrameFormat(),
    FrameFormat.fsr3(renderSize=(W, H), cameraNear=0.3, flags=1 << 2 | 1 << 3 | 1 << 4, motionVectorScale=(W, -H)),
    FrameFormat.streamline(
        mvecScale=(1, 1), cameraNear=0.2, cameraFar=40, depthInverted=False, cameraMotionIncluded=False
    ),
    FrameFormat.openxr(nearZ=np.inf, farZ=0.2, minDepth=0.1, maxDepth=0.9, motionVectorOffset=(0.01, -0.02, 0, 0)),
    FrameFormat(
        near_z=1, far_z=90, motion_unit="uv", motion_y="up", camera_motion="excluded", motion_jittered=True, rows="up"
    ),
    FrameFormat(
        motion_unit="ndc", motion_direction="from_previous", motion_invalid=0.3, geometry_size=(W // 2, -(-H // 3))
    ),
    FrameFormat(
        geometry_size=(W - 5, H // 2),
        motion_jittered=True,
        motion_dilated=True,
        color_encoding="srgb",
        depth="distance",
        depth_scale=12,
        rows="up",
    ),
    FrameFormat(motion_unit="uv", motion_dilated=True, depth="logarithmic", near_z=30, far_z=0.4),
    FrameFormat(depth="logarithmic", near_z=0, far_z=90, depth_range=(0.2, 0.9)),
    FrameFormat(motion_unit="color_pixels", motion_dilated=True, geometry_size=(W // 2, H // 2)),
)


def test_engines_own_formats_have_the_same_bits(device, library):
    """Every type, from frame to frame another description, or none; a reset without motion."""
    rng, frames, formats = np.random.default_rng(2), moving(device, 12), [*FORMATS, None, FORMATS[4]]
    types = zip(3 * COLOR_TYPES, 3 * (*DEPTH_TYPES, "float32"), 3 * MOTION_TYPES, strict=True)
    names = [dict(zip(("color_type", "depth_type", "motion_type"), t, strict=True)) for t in types]
    formats = [
        f and replace(f, **(n if k else {}), motion_channels=2 + k % 3 if k else 2)
        for k, (f, n) in enumerate(zip(formats, names, strict=False))
    ]
    frames = [f if g is None else in_format(device, f, g, rng) for f, g in zip(frames, formats, strict=True)]
    frames[-1] = replace(frames[-1], reset=True, motion=None)
    run_both(device, library, DEFAULT, frames, formats=formats)


def test_buffers_must_fit_their_format(device, library):
    engine = Engine(library(DEFAULT), device, W, H)
    assert bytes(engine.library.gffe_default_format()) == bytes(c_format(FrameFormat()))
    engine.set_format(FrameFormat(color_type="float32"))
    frame = moving(device, 1)[0]
    with pytest.raises(Failed, match=f"color buffer must hold {16 * W * H} bytes"):
        submit(engine, frame)
    engine.destroy()


@pytest.mark.slow
def test_every_object_of_opencl_is_released(device, library):
    """Each holds the context."""
    context = cl.Context([device.cl_device])
    queue = cl.CommandQueue(context)

    def references():
        found = context.get_info(cl.context_info.REFERENCE_COUNT)
        return found, *(buffer.get_info(cl.mem_info.REFERENCE_COUNT) for buffer in buffers)

    buffers = [cl.Buffer(context, cl.mem_flags.READ_WRITE, n * W * H) for n in (8, 4, 8)]
    for buffer in buffers:
        cl.enqueue_fill_buffer(queue, buffer, np.uint8(60), 0, buffer.size)
    queue.finish()
    before = references()
    engine = Engine(library(DEFAULT), device, W, H, context=context.int_ptr, queue=queue.int_ptr)
    camera = Camera(np.eye(4), 60, 60, 40, 30)
    for k in range(4):
        if k % 2:
            engine.set_overlays(Overlays(effects=buffers[0], effects_motion=buffers[2], ui=buffers[0]))
        engine.set_format(FrameFormat(motion_unit="uv", color_type="unorm8") if k > 1 else None)
        engine.submit([*buffers[:2], buffers[2] if k else None], camera, k, camera.scaled(1.1, 1.1), reset=k == 0)
        engine.extrapolate(k + 0.5, camera)
        engine.present()
    assert references() > before
    engine.destroy()
    assert references() == before


@pytest.mark.long
@pytest.mark.slow
def test_other_modules_other_sizes_windows_and_known_cameras(device, library):
    """Rendered images smaller than the display and wider than what is shown; several new frames after each; uneven
    intervals; a reset in the middle."""
    size, render_size = (W, H), (67, 52)
    frames = moving(device, 4, size, render_size, "fixed:1.25") + moving(device, 3, size, render_size, start=3.0)
    assert frames[4].reset and frames[1].camera.intrinsics != frames[1].display_camera.intrinsics
    scene = load_scene("plaza", 1)
    compared, _ = run_both(
        device,
        library,
        VARIED,
        frames,
        size,
        (0.25, 1.3),
        lambda time: scene.camera(time, *size),
        render_size=render_size,
        int64_atomics=0,
    )
    assert {"presentation.motion", "history.history"} <= compared


@pytest.mark.long
@pytest.mark.slow
def test_the_dilated_warp(device, library):
    """On frames through a window."""
    frames = moving(device, 4, render_size=(97, 70), window="fixed:1.15")
    compared, _ = run_both(device, library, Options.preset("performance"), frames, render_size=(97, 70))
    assert {"frame.color", "presentation.motion"} <= compared


@pytest.mark.long
@pytest.mark.slow
def test_cuts_that_nobody_tells_of(device, library):
    frames = moving(device, 4) + [replace(f, reset=False) for f in moving(device, 3, start=9.0, scene="room")]
    times = [0.1 * k + 0.01 * (k % 2) for k in range(len(frames))]
    frames = [replace(frame, time=time) for frame, time in zip(frames, times, strict=True)]
    compared, cuts = run_both(device, library, DEEP, frames, cameras=None)
    assert cuts == [False] * 4 + [True, False, False]
    assert {"shading.warped_previous", "background.color_3", "holes.downsampled_color"} <= compared


@pytest.mark.long
@pytest.mark.slow
def test_upscaled_frames_have_the_same_bits(device, library, tmp_path):
    """With jitter that nobody tells, and through a window; after the network."""
    size, render_size = (W, H), (47, 33)
    frames = moving(device, 3, size, render_size)
    frames = [replace(frame, camera=Jitter(8).camera(frame.camera, k)) for k, frame in enumerate(frames)]
    frames += moving(device, 2, size, render_size, "fixed:1.25", start=5.0)
    options = corrected(UPSCALED, tmp_path)
    compared, _ = run_both(device, library, options, frames, size, (0.5, 0.75), render_size=render_size, exposure=2.5)
    assert {"upscaling.history", "upscaling.color", "presentation.motion"} <= compared


@pytest.mark.slow
def test_overlays_lie_over_the_picture(device, library):
    """Of several kinds, of device buffers, in a window; some frames bring none."""
    size, render_size, rng = (W, H), (67, 52), np.random.default_rng(6)

    def layers(*names):
        mask = np.zeros((52, 67), np.uint8)
        mask[30:, 20:50] = 1
        layer = {"effects": (52, 67), "ui": (H, W)}
        arrays = {name: rng.uniform(0, 1, (*shape, 4)).astype(np.float16) for name, shape in layer.items()}
        arrays |= {"fixed_mask": mask, "effects_motion": rng.uniform(-9, 9, (52, 67, 2)).astype(np.float32)}
        flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
        return Overlays(**{name: cl.Buffer(device.context, flags, hostbuf=arrays[name]) for name in names})

    brought = [None, layers("fixed_mask", "effects", "effects_motion", "ui"), layers("ui"), layers("fixed_mask"), None]
    frames = moving(device, len(brought), size, render_size, "fixed:1.25")
    frames = [replace(frame, overlays=overlays) for frame, overlays in zip(frames, brought, strict=True)]
    compared, _ = run_both(device, library, DEFAULT, frames, size, (0.25, 0.75), render_size=render_size)
    assert "composition.color" in compared


@pytest.mark.long
@pytest.mark.slow
def test_one_pixel_per_work_item_as_on_gpus_gives_the_same_frames(device, library):
    run_both(device, library, DEFAULT, moving(device, 3), lanes=1, int64_atomics=0)


@pytest.mark.slow
def test_the_network_is_part_of_it(device, library, tmp_path):
    """As OpenCL kernels, with sums in integers and in floats; without onnxruntime."""
    options = corrected(DEFAULT, tmp_path)
    frames = moving(device, 4)
    for float_sums in (0, 1):
        compared, _ = run_both(device, library, options, frames[: 4 - float_sums], float_sums=float_sums)
        assert {"correction.judgement", "correction.color"} <= compared


def test_a_network_in_floats_is_not_exported(device, tmp_path):
    options = replace(DEFAULT, shading_correction=True, scn_model=str(scn_models.look_model(tmp_path / "scn.onnx")))
    with pytest.raises(GffeError, match=r"scn.onnx: OpenCL kernels cannot run it: .*gffe train --integers") as failure:
        export(tmp_path / "c", device, options)
    assert "\n" not in str(failure.value) and not (tmp_path / "c").exists()


def test_work_begins_after_events_and_ends_in_one(device, library):
    """On a queue without profiling; the host does not wait; the bits are the same."""
    options, frames = replace(DEFAULT, cut_detection=False), moving(device, 3)
    context, queue = device.context, cl.CommandQueue(device.context)
    engine = Engine(library(options), device, W, H, queue=queue.int_ptr)
    pipeline = Pipeline(device, W, H, options)
    states = cl.command_execution_status
    for frame in frames:
        pipeline.submit(frame)
        written, read = cl.UserEvent(context), cl.UserEvent(context)
        both, buffers = [written, cl.enqueue_marker(device.queue)], (frame.color, frame.depth, frame.motion)
        taken = engine.submit(buffers, frame.camera, frame.time, frame.display_camera, frame.reset, wait_for=both)
        shown, presented = engine.present(wait_for=[])
        time = frame.time + 0.5 * pipeline.interval
        made, done = engine.extrapolate(time, frame.camera, wait_for=[read])
        assert all(event.command_execution_status > states.COMPLETE for event in (taken, presented, done))
        written.set_status(states.COMPLETE)
        cl.wait_for_events([taken, presented])
        assert done.command_execution_status > states.COMPLETE
        read.set_status(states.COMPLETE)
        done.wait()
        assert_same_frame(engine, shown, pipeline.present())
        assert_same_frame(engine, made, pipeline.extrapolate(frame.camera, time))

    foreign, failed = cl.UserEvent(cl.Context([device.cl_device])), cl.UserEvent(context)
    failed.set_status(-5)
    for events, text in (
        ([foreign], "event 0 is of another context"),
        ([taken, None], "event 1 is NULL"),
        ([taken, failed], r"event 1 has failed \(OpenCL error -5\)"),
    ):
        for call in (
            engine.present,
            partial(engine.extrapolate, time, frame.camera),
            partial(engine.submit, buffers, frame.camera, frame.time + 1),
        ):
            with pytest.raises(Failed, match=text) as failure:
                call(wait_for=events)
            assert failure.value.status == INVALID
    assert_same_frame(engine, engine.present(wait_for=[])[0], pipeline.present())  # nothing has happened
    made = CFrame()
    for count, given in ((1, None), (0, ct.byref(ct.c_void_p(taken.int_ptr)))):
        assert engine.library.gffe_present_after(engine.handle, ct.byref(made), count, given, None) == INVALID
    assert engine.library.gffe_present_after(engine.handle, ct.byref(made), 0, None, None) == 0
    engine.destroy()


def corrected(options, tmp_path):
    """The options, with a network that OpenCL kernels run."""
    model = str(scn_models.integer_model(tmp_path / "scn.onnx"))
    return replace(options, shading_correction=True, scn_model=model, scn_provider="opencl")


def submit(engine, frame, **changes):
    """Submit a frame with other fields, which a RenderedFrame would not take."""
    names = ("color", "depth", "motion", "camera", "time", "display_camera", "reset")
    color, depth, motion, *others = ({name: getattr(frame, name) for name in names} | changes).values()
    engine.submit((color, depth, motion), *others)


# ---- faults ------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_faults_say_what_and_what_was_expected(device, library):
    host, frames = library(DEFAULT), moving(device, 2)
    first, second = frames
    engine = Engine(host, device, W, H)
    small = cl.Buffer(device.context, cl.mem_flags.READ_WRITE, 16)
    moved = first.camera.moved((1, 0, 0))

    def refused(text, call, *arguments, **changes):
        with pytest.raises(Failed, match=text) as failure:
            call(*arguments, **changes)
        assert failure.value.status == INVALID

    refused("submit a rendered frame first", engine.extrapolate, 1.0, first.camera)
    refused("submit a rendered frame first", engine.present)
    refused(r"depth buffer must hold 20252 bytes \(83x61\), got 16", submit, engine, first, depth=small)
    refused("there is no color buffer", submit, engine, first, color=None)
    refused("must have the pose of the render camera", submit, engine, first, display_camera=moved)
    refused("motion is missing", submit, engine, first, motion=None, reset=False)
    refused("effects_motion without effects", engine.set_overlays, Overlays(effects_motion=small))
    refused("ui buffer must hold 40504", engine.set_overlays, Overlays(ui=small))
    submit(engine, first, motion=None)  # a reset may lack it
    refused("after the previous rendered frame's", submit, engine, second, time=first.time)
    refused("extrapolate: camera: there is none", engine.extrapolate, first.time, None)
    refused("there is no buffer 'history.none'", engine.get, "history.none")
    refused("there is no buffer 'presentation.color'", engine.get, "presentation.color")  # nothing was resampled yet
    submit(engine, second)
    if device.cl_device.image_support:
        image = cl.create_image(device.context, cl.mem_flags.READ_WRITE, cl.ImageFormat(RGBA, HALF), (2 * W, 2 * H))
        refused("frame: color is an image", submit, engine, first, color=image, reset=True)
    engine.destroy()
    host.gffe_destroy(None)
    refused("lanes must be 0, 1 or 8, got 3", Engine, host, device, W, H, lanes=3)
    refused("needs a context and a queue", Engine, host, device, W, H, context=0)
    other = cl.Context([device.cl_device])
    refused("the queue is of another context", Engine, host, device, W, H, context=other.int_ptr)


MAY_BE_NULL = {  # where NULL means something
    ("gffe_destroy", "g"), ("gffe_set_format", "format"), ("gffe_set_overlays", "overlays"),
    *((name, given) for name in ("gffe_submit", "gffe_submit_after") for given in ("motion", "display_camera")),
    *((f"gffe_{name}_after", "done") for name in ("submit", "extrapolate", "present")),
}  # fmt: skip


@pytest.mark.slow
def test_null_for_each_pointer_is_an_invalid_argument(device, library):
    """Of a gffe that is there, and of one that could not be made; nothing crashes."""
    host, frame = library(DEFAULT), moving(device, 1)[0]
    engine, failed = Engine(host, device, W, H), ct.c_void_p()
    context, queue = device.context.int_ptr, device.queue.int_ptr
    assert host.gffe_create(context, queue, None, ct.byref(failed)) == INVALID and failed
    submit(engine, replace(frame, time=-1.0))
    marker = cl.enqueue_marker(device.queue)
    event, done = ct.c_void_p(marker.int_ptr), ct.c_void_p()
    made = {f"{name} *": ct.byref(kind()) for name, kind in STRUCTURES.items()}
    good = made | {
        **{"gffe *": engine.handle, "gffe **": ct.byref(ct.c_void_p()), "gffe_options *": ct.byref(engine.options)},
        **{"gffe_camera *": ct.byref(c_camera(frame.camera)), "gffe_format *": ct.byref(c_format(FrameFormat()))},
        **{"cl_context": context, "cl_command_queue": queue, "cl_mem": frame.color.int_ptr},
        **{"cl_event *": ct.byref(event), "char *": b"history.dynamic_mask"},
        **{"double": 1.0, "int": 1, "cl_uint": 1},
    }
    taken, count = set(), 0
    for kind, name, parameters in DECLARED:
        function = getattr(host, name)
        for wrong, (about, own) in enumerate(parameters):
            for value in (None, failed) if about == "gffe *" else () if about in SCALARS else (None,):
                if name == "gffe_destroy" and value is failed:
                    continue
                given = [ct.byref(done) if name == "done" else good[about] for about, name in parameters]
                given[wrong] = value
                status, count = function(*given), count + 1
                if kind == "gffe_status" and status != INVALID:
                    assert status == OK, (name, own)
                    taken.add((name, own))
    assert count > 40 and taken == MAY_BE_NULL - {("gffe_destroy", "g")}
    host.gffe_destroy(failed)
    engine.destroy()


@pytest.fixture
def calls(device, library):
    frame = moving(device, 1)[0]
    made = Calls(Engine(library(DEFAULT), device, W, H), Pipeline(device, W, H, DEFAULT), frame)
    yield made
    made.engine.destroy()


@pytest.mark.filterwarnings("ignore:extrapolate. time")  # far ahead
def test_values_that_python_refuses_are_refused(calls):
    """And no others. Each refusal is one line; those of a pipeline name the field."""
    for row in TABLE:
        for value in row.bad:
            assert refusal(calls.python, row, value), (str(row), value)
            message = refusal(calls.c, row, value)
            assert message and "\n" not in message and len(message) < 200, (str(row), value, message)
            named = row.name.partition("[")[0].removesuffix("_width").removesuffix("_height") or row.name
            assert named in message or row.call == "camera", message
        for value in row.good:
            for call in (calls.python, calls.c):
                assert not refusal(call, row, value), (str(row), value, call)


def test_a_grid_that_does_not_exist_is_refused():
    with pytest.raises(GffeError, match=r"there is no grid 'diamonds' \(expected "):
        grid_of("diamonds")


@pytest.mark.slow
def test_every_process_exports_the_same(device, library, tmp_path):
    """Whatever the seed of Python's hashes, by which sets are ordered: another one, and that of this process."""
    here = library(DEFAULT)._folder
    command = [sys.executable, "-m", "gffe_cl", "export", str(tmp_path), "--device", device.info.index, "--no-scn"]
    subprocess.run(command, env=os.environ | {"PYTHONHASHSEED": "1"}, check=True, capture_output=True)
    for path in (path for path in tmp_path.rglob("*") if path.is_file()):
        assert path.read_bytes() == (here / path.relative_to(tmp_path)).read_bytes(), path


@pytest.mark.slow
def test_an_earlier_export_is_replaced(device, tmp_path):
    export(tmp_path, device, DEFAULT)
    assert (tmp_path / "kernels" / "holes.cl").is_file()
    (tmp_path / "mine.txt").write_text("mine")
    names = export(tmp_path, device, replace(DEFAULT, hole_filling="none"))
    assert not (tmp_path / "kernels" / "holes.cl").exists() and (tmp_path / "mine.txt").is_file()
    found = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file()}
    assert found == {*names, "mine.txt"}


@pytest.mark.slow
def test_a_folder_that_holds_something_else_is_left_alone(device, gffe, tmp_path):
    (tmp_path / "mine.c").write_text("int mine;\n")
    code, _, error = gffe("export", tmp_path, "--device", device.info.index)
    assert code == 2 and "is not empty, and not written by `gffe export`" in error
    assert [path.name for path in tmp_path.iterdir()] == ["mine.c"]
