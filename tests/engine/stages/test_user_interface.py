"""A user interface in the color is found and kept in place; what merely looks alike is not."""

from dataclasses import replace

import numpy as np
import pytest
import user_interface_twin as twin
from device_arrays import copy_to, of_arrays
from synthetic import Rect, Rects, camera, psnr

from gffe_cl import GffeError, Options, Overlays, Pipeline
from gffe_cl.captures.offline.run import shows_interface
from gffe_cl.captures.offline.source import Source
from gffe_cl.captures.sequence.encoding import user_interface, with_ui
from gffe_cl.engine.export.recording import record
from gffe_cl.engine.stages.base import Board
from gffe_cl.engine.stages.buffers import DeviceFrame, Sizes
from gffe_cl.engine.stages.measures import UserInterface

W, H = 160, 90
FINDS = Options.preset("performance", ui_detection=True)
SCENE = Rects([Rect((0, 0, 14), frequency=0.35), Rect((-1.5, 0.3, 6), (1, 1), frequency=0.5, tint=(0.6, 0.3, 0.1))])
UI = user_interface(W, H)
OPAQUE = UI[..., 3] == 1


def seen_from(k):
    return camera(W, H, (0.3 * k, 0.02 * k, 0), yaw=0.012 * k)


def frames(count=5, change=lambda color: with_ui(color, UI)):
    for k in range(count):
        before = (seen_from(k - 1), (k - 1) / 30) if k else (seen_from(0), 0.0)
        frame = SCENE.frame(seen_from(k), k / 30, W, H, before, reset=k == 0)
        yield replace(frame, color=change(np.asarray(frame.color)))


def mask_of(pipeline):
    return pipeline.stages["user_interface"].read("mask") > 0


@pytest.mark.parametrize("size", [(45, 31), (3, 2)])
def test_kernels_equal_their_twin(device, size):
    """Bit for bit: colors that stay and that do not, vectors out of the image and no numbers, sky, holes."""
    rng = np.random.default_rng(3)
    width, height = size
    shape = height, width
    stage = UserInterface(Board(device, Sizes(size, size), FINDS))
    buffers = [DeviceFrame.allocate(device, size, camera(*size), camera(*size), 0.0) for _ in range(2)]
    evidence = np.zeros(shape, np.uint8)
    color = rng.uniform(-0.1, 1.5, (*shape, 4)).astype(np.float16)
    for k in range(4):
        color_prev, color = color, color.copy()
        changed = rng.random(shape) < 0.2
        color[changed] = rng.uniform(0, 1.5, (*shape, 4))[changed]
        color[0, 0] = np.nan
        depth, depth_prev = rng.choice([2, 2.1, 5, np.inf, np.nan], (2, *shape), p=[0.5, 0.3, 0.1, 0.05, 0.05])
        motion = rng.choice([0.2, 0.6, 4], shape)[..., None] * rng.choice([1, 1, 1, -1, np.nan, 1e9], (*shape, 1))
        motion = (motion * (1, 0.3)).astype(np.float32)
        depth, depth_prev = depth.astype(np.float32), depth_prev.astype(np.float32)
        given = (rng.random(shape) < 0.05).astype(np.uint8) if k == 2 else None
        for frame, arrays in zip(buffers, ((color, depth), (color_prev, depth_prev)), strict=True):
            copy_to(device, frame, of_arrays(*arrays, motion))
        layers = stage.found({} if given is None else {"fixed_mask": given}, *buffers, 1.7)
        evidence = twin.count_evidence(evidence, color, color_prev, depth, depth_prev, motion, 1.7)
        np.testing.assert_array_equal(stage.read("evidence"), evidence)
        expected = twin.user_interface_mask(evidence) | (False if given is None else given > 0)
        np.testing.assert_array_equal(stage.read("mask"), expected)
        assert layers["fixed_mask"] is stage.buffer["mask"]
    assert size == (3, 2) or (0.02 < (evidence == 2).mean() < 0.9 and 0.02 < stage.read("mask").mean() < 0.9)
    stage.found({}, buffers[0], None, 1.0)
    assert not stage.read("evidence").any() and not stage.read("mask").any()


def test_it_is_found_and_stays(device):
    """New frames are nearer to the truth, which has the interface where it is; nothing is found before two pairs."""
    errors = {}
    for options in (FINDS, replace(FINDS, ui_detection=False)):
        pipeline, found = Pipeline(device, W, H, options, fps=30), []
        for frame in frames():
            pipeline.submit(frame)
            found.append(mask_of(pipeline) if options.ui_detection else None)
        made = pipeline.extrapolate(seen_from(4.5), 4.5 / 30).numpy("color")
        truth = with_ui(np.asarray(SCENE.frame(seen_from(4.5), 4.5 / 30, W, H).color), UI)
        errors[options.ui_detection] = psnr(made, truth, OPAQUE)
        if options.ui_detection:
            assert not found[1].any() and found[2].any()
            held = found[-1] & OPAQUE
            assert held.sum() > 0.5 * OPAQUE.sum() and np.array_equal(made[held], frame.color[held])
            beside = ~(twin.window_sums(UI[..., 3] > 0, 1) > 0)
            assert not (found[-1] & beside).any()
    assert errors[True] > errors[False] + 5, errors


def test_nothing_is_found_without_one(device):
    """Neither in a moving picture, nor in one that stands still, nor in a flat one; the frames are the same ones."""
    flat = np.full((H, W, 3), 0.3, np.float16)
    for change in (lambda color: color, lambda color: flat):
        pipelines = [Pipeline(device, W, H, options, fps=30) for options in (FINDS, replace(FINDS, ui_detection=False))]
        for frame in frames(change=change):
            for pipeline in pipelines:
                pipeline.submit(frame)
        made, usual = (pipeline.extrapolate(seen_from(4.5), 4.5 / 30).numpy("color") for pipeline in pipelines)
        assert not mask_of(pipelines[0]).any() and np.array_equal(made, usual)
    pipeline = pipelines[0]
    still = next(iter(frames(1)))
    for k in range(4):
        pipeline.submit(replace(still, time=1 + k / 30, reset=k == 0, motion=np.zeros((H, W, 2), np.float32)))
    assert not mask_of(pipeline).any()


def test_it_ends_with_a_reset_and_adds_to_a_given_mask(device):
    given = np.zeros((H, W), bool)
    given[40:50, 90:110] = True
    pipeline = Pipeline(device, W, H, FINDS, fps=30)
    for frame in frames(4):
        pipeline.submit(replace(frame, overlays=Overlays(fixed_mask=given)))
    found = mask_of(pipeline)
    assert (found | ~given).all() and (found & OPAQUE).sum() > 0.4 * OPAQUE.sum()
    pipeline.submit(replace(frame, time=1.0, reset=True))
    assert not mask_of(pipeline).any()


def test_export_refuses_it(device):
    with pytest.raises(GffeError, match="user interface detection is not exported"):
        record(device, FINDS, False)


class Shown(Source):
    exposure, render_size, count = 1.0, (W, H), 3

    def __init__(self, change, mask=None):
        overlays = None if mask is None else Overlays(fixed_mask=mask)
        self._frames = [replace(frame, overlays=overlays) for frame in frames(3, change)]

    def rendered(self, k):
        return self._frames[k]


def test_whether_a_clip_shows_it(device):
    """Not if its color has none, nor where most of it is masked."""
    assert shows_interface(Shown(lambda color: with_ui(color, UI)), device)
    assert not shows_interface(Shown(lambda color: color), device)
    masked = Shown(lambda color: with_ui(color, UI), twin.window_sums(UI[..., 3] > 0, 2) > 0)
    assert not shows_interface(masked, device)
