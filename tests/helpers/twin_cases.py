"""Small frames that hold everything (moving parts, sky, bad pixels), and pipelines that have seen them, for the tests
of the stages. Each stage is compared with its NumPy twin on the device's own input, so that one rounding is not counted
twice and a wrong kernel fails the tests of its own name."""

import functools
from typing import NamedTuple

import numpy as np
import twins
from synthetic import Rect, Rects, camera

from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.frame_block import reprojection

SHARPNESS = 1.3  # of new frames, whatever was measured
SCENE = Rects(
    [
        Rect((0, 0, 12), (9, 4), frequency=0.3),
        Rect((-1, 0.5, 6), (0.8, 1.5), velocity=(9, 0, 0), frequency=1, tint=(0.7, 0.2, 0.1)),
        Rect((1.5, -0.3, 5), (0.5, 0.5), velocity=(-3, 2, -12), frequency=2, tint=(4, 5, 90)),
        Rect((-1.2, -1.2, 8), (0.6, 0.6), velocity=(-26, 0, 0), frequency=1, tint=(0.2, 0.6, 0.1)),
        Rect((0.2, 0, 4), (0.05, 3), frequency=2, tint=(0.1, 0.1, 0.1)),
        Rect((7.5, 3, 9), (2.5, 1.8), velocity=(-30, -8, 0), frequency=1, tint=(0.3, 0.3, 0.9)),  # enters
    ]
)
_DEFAULT = Options(shading_inputs=True, blocks=False)  # blocks: test_backward_blocks.py
_SAME, _LARGER, _SMALLER = ((61, 37), (61, 37)), ((48, 33), (64, 48)), ((64, 48), (40, 31))
# By name: options, and sizes of the rendered and of the new frame.
CASES = {
    "default": (_DEFAULT, *_SAME),
    "default-larger": (_DEFAULT, *_LARGER),
    "default-smaller": (_DEFAULT, *_SMALLER),
    "cubic-larger": (Options(history=4, order=3, levels=3, blocks=False), *_LARGER),
    "downsample-smaller": (Options(hole_filling="downsample", blocks=False, acceleration=False), *_SMALLER),
    "literal": (
        Options(
            crack_closing=False,
            static_threshold=0.7,
            levels=0,
            hole_filling="downsample",
            resampling="linear",
            sharpness=False,
        ),
        *_SAME,
    ),
    "linear-smaller": (Options(resampling="linear", levels=3, blocks=False), *_SMALLER),
}


def time_of(k):
    """Return the time of rendered frame `k`, seconds: the first two intervals are uneven."""
    return (k - 0.3 * (k == 1)) / 30


def frames(width, height, count=4, spoil=True, scene=SCENE):
    """Yield rendered frames of a camera that moves and turns; with `spoil` some pixels are bad, and vectors noisy."""
    rng = np.random.default_rng(5)
    cameras = [
        camera(width, height, (0.1 * k, 0.02 * k, 0.15 * k), 0.02 * k, 0.004 * k * k, 0.01 * k) for k in range(count)
    ]
    previous = None
    for k in range(count):
        frame = scene.frame(cameras[k], time_of(k), width, height, previous, reset=k == 0)
        previous = (cameras[k], time_of(k))
        if spoil and k:
            for array, values in (
                (frame.depth, (np.nan, 0, -3, np.inf, 1e30)),
                (frame.motion, (np.nan, np.inf, 1e9, -1e6, 300)),
                (frame.color, (np.nan, np.inf, -np.inf, 60000, -5)),
            ):
                for value in values:
                    y, x = rng.integers(height), rng.integers(width)
                    array[y, x] = value
            frame.motion += rng.uniform(-0.01, 0.01, frame.motion.shape).astype(np.float32)
        yield frame


class State(NamedTuple):
    """Buffers from which the stages of the next frame start."""

    dynamic: np.ndarray
    history: np.ndarray | None
    steps: np.ndarray  # of quantized motion
    levels: list[dict]
    movers: tuple | None


class Case(NamedTuple):
    """A pipeline that has made a frame, what it was given, and what each of its stages left."""

    pipeline: Pipeline
    now: object  # the rendered frames, as they were submitted
    past: object
    before: State  # after the frame `past`
    to: object  # camera of the new frame
    made: object

    @property
    def options(self):
        return self.pipeline.options

    @property
    def to_previous(self):
        return reprojection(self.now.camera, self.past.camera)

    @property
    def from_previous(self):
        return reprojection(self.past.camera, self.now.camera)

    @property
    def to_target(self):
        return reprojection(self.now.camera, self.to)

    @property
    def to_source(self):
        return reprojection(self.to, self.now.camera)

    @property
    def zoom(self):
        return np.array([self.to.fx / self.now.camera.fx, self.to.fy / self.now.camera.fy], np.float32)

    @property
    def sharpness(self):
        """The sharpness with which the rendered frame is resampled."""
        return np.float32(SHARPNESS if self.options.sharpness else 0)

    def read(self, stage, name):
        """Return a buffer of a stage."""
        return self.pipeline.stages[stage].read(name)

    def after(self, stage):
        """Return the new frame as `stage` left it, by the names of its buffers; `stage` None: as it is in the end."""
        frame = {spec.name: self.pipeline.board.frame.read(spec.name) for spec in self.pipeline.board.frame.buffers}
        if stage is None:
            return frame
        names = list(self.pipeline.stages)
        for owner, spec in self.pipeline.named_buffers():
            if owner not in self.pipeline.stages.values() and owner.name in names[: names.index(stage) + 1]:
                frame[spec.name] = owner.read(spec.name)  # in the order of the stages
        if stage not in names[names.index("holes") :]:  # labels of holes are there before they are filled
            holes = frame["filled_by"] == twins.COMMON.BY_HOLE_FILLING
            frame["filled_by"] = np.where(holes, np.uint8(twins.COMMON.BY_NOTHING), frame["filled_by"])
        return frame


def run(device, width, height, options, int64=None, target=None, spoil=True):
    """Submit four frames and make one, with the output of every stage kept. Return a `Case`."""
    pipeline = Pipeline(device, *(target or (width, height)), options, render_size=(width, height), int64_atomics=int64)
    pipeline.keep()
    *first, past, now = frames(width, height, spoil=spoil)
    for frame in (*first, past):
        pipeline.submit(frame)
    before = State(
        pipeline.stages["history"].read("dynamic_mask"),
        read_history(pipeline),
        pipeline.stages["history"].read("motion_steps").ravel(),
        read_levels(pipeline, past),
        read_movers(pipeline),
    )
    pipeline.submit(now)
    if options.sharpness:
        pipeline.stages["sharpness"].upload("sharpness", np.array([SHARPNESS], np.float32))
    to = camera(*(target or (width, height)), (0.35, 0.07, 0.6), 0.075, 0.045, 0.035)
    return Case(pipeline, now, past, before, to, pipeline.extrapolate(to, now.time + 0.02))


@functools.cache
def named_case(device, name):
    """Return the case `name` of CASES, made once per device."""
    options, size, target = CASES[name]
    return run(device, *size, options, target=target)


def read_history(pipeline):
    """Return the positions that are stored, in planes; None for a history of two, which stores none."""
    stage = pipeline.stages["history"]
    return stage.read("history") if stage.positions > 2 else None


def read_movers(pipeline):
    """Return velocity, acceleration, its continuation and velocity in view space per cell; None where that is off."""
    stage = pipeline.stages.get("acceleration")
    return stage and tuple(stage.read(name) for name in ("velocity", "acceleration", "bend", "view_velocity"))


def read_levels(pipeline, frame):
    """Return the background's levels; texels that are shown are pixels of `frame`, the last one that was submitted."""
    if "background" not in pipeline.stages:
        return []
    found = [
        {name: pipeline.stages["background"].read(f"{name}_{level}") for name in ("color", "depth", "px", "state")}
        for level in range(pipeline.options.levels)
    ]
    shown = found[0]["state"] == twins.SHOWN
    of_frame = twins.collect_shown(frame.color, frame.depth, np.zeros_like(shown))
    for name in ("color", "depth", "px"):
        found[0][name][shown] = of_frame[name][shown]
    return [found[0] | {"shown": of_frame}, *found[1:]]


def assert_close(got, expected):
    """Values are equal, but for those (1 in 1000) where a rounding of the device's division differs by 1e-5."""
    same = (got == expected) | (np.isnan(got) & np.isnan(expected))
    assert (~same).sum() <= same.size // 1000, f"{(~same).sum()} of {same.size} values differ"
    both = np.isfinite(got) & np.isfinite(expected)
    np.testing.assert_allclose(got[both].astype(np.float64), expected[both].astype(np.float64), rtol=1e-5, atol=1e-5)
    assert np.array_equal(np.isfinite(got), np.isfinite(expected))
