"""`gffe export`: the pipeline in C gives the same bits as Python's, on the same device from the same buffers."""

from dataclasses import replace

import numpy as np
import pyopencl as cl
import pytest

from exported import Engine, compile_library, load, require_compiler
from gffe_cl.buffers import EXTRAPOLATED, RENDERED, Owner, spread
from gffe_cl.export.writing import export
from gffe_cl.frame import RenderedFrame, pack_frame
from gffe_cl.options import Options
from gffe_cl.pipeline import Pipeline
from gffe_cl.scenes import load_scene
from gffe_cl.scenes.renderer import SceneRenderer
from gffe_cl.scenes.sequences import SceneFrames
from gffe_cl.window import WindowChooser

W, H = 83, 61
DEFAULT = Options(shading_correction=False)
VARIED = replace(
    DEFAULT, levels=1, crack_closing=False, soft_silhouettes=False, acceleration=False, history=4, order=3,
    hole_filling="none", cut_detection=False, static_threshold=1.5, camera_order=1,
)  # fmt: skip
DEEP = replace(DEFAULT, levels=4, hole_filling="downsample", shading_inputs=True, hidden_parts=False, blocks=False)
_libraries: dict = {}


@pytest.fixture
def library(device, tmp_path_factory):
    """The compiled library of options, made once per run."""
    require_compiler("cc")

    def made(options):
        if options not in _libraries:
            folder = tmp_path_factory.mktemp("export")
            export(folder, device, options)
            _libraries[options] = load(compile_library(folder, folder / "libgffe.so"))
        return _libraries[options]

    return made


def on_device(device, frame: RenderedFrame, size):
    """The frame with device buffers, which both pipelines take."""
    packed = pack_frame(frame, size[1], size[0])
    flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
    buffers = [cl.Buffer(device.context, flags, hostbuf=a) for a in (packed.color, packed.depth, packed.motion)]
    return replace(frame, color=buffers[0], depth=buffers[1], motion=buffers[2])


def moving(device, count, size=(W, H), render_size=None, window="off", start=0.0):
    """Rendered frames of a built-in scene, on the device."""
    scene = load_scene("plaza", 1)
    windows = WindowChooser(window, size, [0.5])
    render_size = render_size or size
    renderer = SceneRenderer(device, scene, *render_size)
    frames = SceneFrames(renderer, windows, size)
    return [on_device(device, frame, render_size) for frame in frames.sequence(count, 15.0, start)]


def named_buffers(pipeline):
    """What the pipeline's buffers hold, as they are stored, where they hold anything; by name."""
    found = {}
    for owner, spec in pipeline.named_buffers():
        stored, flat = spec.host_array(spec.size(owner.sizes))
        cl.enqueue_copy(pipeline.device.queue, flat, owner.buffer[spec.name])
        found[f"{owner.name}.{spec.name}"] = (flat.view(np.uint8).reshape(-1), known_texels(owner, spec))
    return found


def known_texels(owner: Owner, spec):
    """Where a buffer holds anything; None: everywhere."""
    if not spec.known_where:
        return None
    telling = owner.spec(spec.known_where[0])
    width, height = spec.size(owner.sizes)
    return spread(owner.read(telling.name), telling.grid, spec.grid, 0, 0, width, height) == spec.known_where[1]


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
    for name in ("color", "depth", "motion", "dynamic", "disoccluded", "filled_by", "gae"):
        if getattr(made, name) is None:
            continue
        buffer = getattr(ours, name)
        expected = np.empty(buffer.size, np.uint8)
        cl.enqueue_copy(engine.device.queue, expected, buffer)
        assert np.array_equal(engine.read(getattr(made, name), buffer.size), expected), name
    assert made.camera.camera() == ours.camera and made.time == ours.time


def run_both(device, library, options, frames, size=(W, H), alphas=(0.5,), cameras=None, **more):
    """Both pipelines over frames; all buffers and outputs are compared after each extrapolated one."""
    render_size = more.pop("render_size", size)
    engine = Engine(library(options), device, *size, render_width=render_size[0], render_height=render_size[1], **more)
    int64 = None if more.get("int64_atomics", -1) < 0 else bool(more["int64_atomics"])
    pipeline = Pipeline(device, *size, options, render_size=render_size, int64_atomics=int64)
    compared, cuts = set(), []
    for frame in frames:
        pipeline.submit(frame)
        buffers = (frame.color, frame.depth, frame.motion)
        engine.submit(buffers, frame.camera, frame.time, frame.display_camera, frame.reset)
        assert engine.is_cut == pipeline.is_cut
        cuts.append(pipeline.is_cut)
        assert_same_frame(engine, engine.present(), pipeline.present())
        for alpha in alphas:
            time = frame.time + alpha * pipeline.interval
            camera = cameras and cameras(time)
            assert_same_frame(engine, engine.extrapolate(time, camera), pipeline.extrapolate(camera, time))
            compared |= assert_same_buffers(engine, pipeline)
    engine.destroy()
    return compared, cuts


def test_ten_frames_of_a_scene_have_the_same_bits(device, library):
    compared, _ = run_both(device, library, DEFAULT, moving(device, 10))
    assert {"history.dynamic_mask", "background.color_1", "frame.filled_by", "silhouettes.coverage"} <= compared
    assert len(compared) > 25
