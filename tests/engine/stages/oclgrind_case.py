"""Runs every kernel once at 40×24; meant to be started under Oclgrind (see test_oclgrind.py)."""

import json
import os
import sys
import tempfile
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from shutil import copytree

import numpy as np
import pyopencl as cl
from device_arrays import of_arrays
from network_stages import made_stages
from recorded_bits import CASES, PATH, digests_of
from scn_models import integer_model
from synthetic import Rect, Rects, camera
from twin_cases import frames, run

from gffe_cl.engine.frame.frame_format import COLOR_TYPES, DEPTH_TYPES, MOTION_TYPES, TYPES, FrameFormat, conversion
from gffe_cl.engine.frame.rendered_frame import BadPixels, Overlays
from gffe_cl.engine.inference.network import OPENCL, load_network
from gffe_cl.engine.opencl.device import open_device
from gffe_cl.engine.opencl.program import kernel_folder
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.base import Board, Step
from gffe_cl.engine.stages.buffers import DeviceFrame, Sizes
from gffe_cl.engine.stages.upload import Upload

WIDTH, HEIGHT = 40, 24


def without_looks(folder):
    """Use kernels that change keys without a look at them: Oclgrind takes a read beside an atomic for a race."""
    copytree(kernel_folder(), folder, dirs_exist_ok=True)
    header = Path(folder, "nearest.h")
    text = header.read_text()
    assert "#define LOOKS 1" in text
    header.write_text(text.replace("#define LOOKS 1", "#define LOOKS 0"))
    os.environ["GFFE_KERNELS"] = str(folder)


def stages(device, int64):
    """All kernels of the pipeline, in the path with 64-bit atomics or, where they differ, the one without."""
    most = Options(history=3, order=2, shading_inputs=True, upscale=1, scn_provider="cpu")  # kernels: `convolutions`
    for options in (*(most,) * int64, Options(scn_provider="cpu"), Options.preset("performance")):
        case = run(device, WIDTH, HEIGHT, options, int64, target=(WIDTH - 3, HEIGHT + 5))
        case.made.numpy("color")
        case.pipeline.present().numpy("motion")
        case.pipeline.submit(replace(case.now, time=case.now.time + 1, overlays=overlays()))
        case.pipeline.extrapolate().numpy("color")


def sizes(device):
    """A sample of small images, with holes within a few pixels of the border and of each other."""
    run(device, 1, 1, Options(), None, (2, 3)).made.numpy("color")
    view, past = camera(24, 10), None
    scene = Rects([Rect((0, 0, 10)), Rect((-2, 0, 6), (1, 9), velocity=(36, 0, 0))])  # over all rows
    pipeline = Pipeline(device, 24, 10, Options(shading_correction=False))
    for k in range(4):
        pipeline.submit(scene.frame(view, k / 30, 24, 10, past, reset=k == 0))
        past = view, k / 30
    assert (pipeline.extrapolate(view, 3.5 / 30).numpy("filled_by") == 1).any()


def recorded(device):
    """Oclgrind gives the bits of all other runtimes."""
    assert digests_of(device, CASES["13x9"]) == json.loads(PATH.read_text())["13x9"]


def overlays():
    """All there are; the effects move out of the image."""
    rgba, motion = np.full((HEIGHT, WIDTH, 4), 0.5, np.float16), np.full((HEIGHT, WIDTH, 2), -9, np.float32)
    mask, ui = np.eye(HEIGHT, WIDTH), np.full((HEIGHT + 5, WIDTH - 3, 4), 0.5, np.float16)
    return Overlays(mask, rgba, motion, ui)


def shading(device):
    """What surrounds the shading correction network, on images of odd sizes, with output made up."""
    for size in ((37, 21), (1, 1)):
        board, correction, step = made_stages(device, size, 0.5)
        shape = correction.spec("judgement").shape(correction.sizes)
        judgement = np.random.default_rng(0).normal(0, 1, shape).astype(np.float32)
        for name in ("shading", "network_input", "shading_flow"):
            board.stages[name].extrapolated(step)
        correction.upload("judgement", judgement)
        board.stages["shading_trend"].upload("changed", np.ones(1, np.int32))
        correction.judge(step, within_mask=True)
        for within_mask in (True, False):
            correction.with_refined = within_mask
            correction.compose(step, within_mask)
        correction.skip()


def convolutions(device):
    """A network of few channels, whose images are smaller than a work-group, in both forms."""
    for float_sums in (False, True):
        device.__dict__["float_sums"] = float_sums
        board, correction, step = made_stages(device, (1, 1))
        with tempfile.TemporaryDirectory() as folder:
            correction.use(load_network(integer_model(Path(folder, "m.onnx"), (16, 20)), OPENCL))
        board.stages["shading_trend"].upload("changed", np.ones(1, np.int32))
        for name in ("shading", "network_input", "shading_flow", "convolutions"):
            board.stages[name].extrapolated(step)
        assert np.isfinite(correction.read("judgement")).all()


def upload(device):
    """Frames from the host, in each form that kernels take, in images with rows that end within a strip."""
    for lanes, size in product((1, 8), ((37, 3), (250, 2))):
        device.__dict__["lanes"] = lanes
        board, view = Board(device, Sizes(size, size)), camera(*size)
        frame = DeviceFrame.allocate(device, size, view, view, 0.0)
        for in_place, dtype, channels in product((True, False), (np.float16, np.float32), (3, 4)):
            stage = Upload(board)
            stage._in_place = in_place
            color = np.full((*size[::-1], channels), np.nan, dtype)
            depth, motion = np.zeros(size[::-1], np.float32), np.ones((*size[::-1], 2), np.float32)
            stage.take(of_arrays(color, depth, motion), frame)
            assert stage.take_bad_pixels() == BadPixels(color=depth.size, depth=depth.size)
        described(Upload(board), frame, size)


def described(stage, frame, size):
    """Buffers of all types that a description allows, no larger than they must be, and motion from cameras."""
    format = FrameFormat(depth="device", near_z=1, far_z=2, motion_invalid=0.0, camera_motion="movers_only")
    small = -(-size[0] // 2), size[1] // 2
    for number, (depth_type, motion_type) in enumerate(product(DEPTH_TYPES, (*MOTION_TYPES, None))):
        geometry = small if number % 4 == 1 else size
        types = {"color": COLOR_TYPES[number % 4], "depth": depth_type, "motion": motion_type}
        channels = {"color": 3 + number % 2, "motion": 2 + number % 3}
        given = {}
        for name, type_name in types.items():
            if type_name:
                texel = TYPES[type_name][0], channels.get(name, 1)
                zeros = np.zeros((*(size if name == "color" else geometry)[::-1], texel[1]), texel[0])
                flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
                given[name] = cl.Buffer(stage.device.context, flags, hostbuf=zeros)
        step = Step(frame, frame, [0.1, 0.0], given=conversion(format, size, types, channels, geometry=geometry))
        stage.convert(given, frame, step, is_dilated=number % 3 == 1)
        assert not stage.take_bad_pixels()


def dilate_splat(device):
    """In all forms, on images of odd sizes."""
    from gffe_cl.lab.table.footage import Footage, Moment, Shot
    from gffe_cl.lab.table.methods import DilateSplat

    for lanes, int64, size in product((1, 8), (True, False), ((37, 11), (3, 2))):
        device.__dict__["lanes"] = lanes
        *_, frame = frames(*size)
        runner = DilateSplat(Footage("odd", *size, 30.0, 1.0), device, int64)
        runner.submit(Shot(frame, frame.color, ()))
        runner.color_of(runner.extrapolated(Moment(0.5, 0.5, None, frame.color)))


def scene(device):
    from gffe_cl.captures.scenes import SCENES, SceneRenderer, load_scene

    for name in SCENES:
        built = load_scene(name)
        renderer = SceneRenderer(device, built, 32, 18, samples=2)
        camera = built.camera(0.1, 32, 18)
        renderer.render(0.1, camera, 0.0, built.camera(0.0, 32, 18)).numpy()


if __name__ == "__main__":
    opened = open_device()
    assert opened.info.platform == "Oclgrind", opened
    case = sys.argv[1]
    with tempfile.TemporaryDirectory() as folder:
        without_looks(folder)
        cases = {"upload": (upload,), "dilate-splat": (dilate_splat,), "scene": (scene,)}
        # One process builds what these share once.
        cases |= {"int64": (partial(stages, int64=True), sizes, recorded, shading, convolutions)}
        cases |= {"int32": (partial(stages, int64=False),)}
        for part in cases[case]:
            part(opened)
    print("finished", case)
