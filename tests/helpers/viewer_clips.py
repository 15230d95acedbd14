"""Clips for tests of the viewer: sources in memory, engines on them, and what a plain pipeline gives."""

import functools
import threading
import time
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from synthetic import Rect, Rects, camera
from viewer_session import PATIENCE, wait_for

from gffe_cl import (
    Options,
    Pipeline,
)
from gffe_cl.viewer.engine.engine import Engine
from gffe_cl.viewer.engine.sources.source import FrameSource
from gffe_cl.viewer.engine.store import Key, Want

W, H, COUNT, FPS = 96, 64, 14, 30.0
ALL = Options(shading_inputs=True)


@dataclass
class Falling(Rect):
    """A rectangle that accelerates."""

    def at(self, time):
        return super().at(time) + np.array((6.0, 9.0, 0.0)) * time**2


WALL = Rect((0, 0, 14), (9, 20), frequency=0.12)
SCENE = Rects(
    [
        WALL,
        Rect((-2.2, 0.3, 6), (0.6, 1), frequency=0.5, tint=(0.6, 0.3, 0.1)),
        Falling((0.2, -0.8, 4), (0.5, 0.4), velocity=(2, 0.5, -1), frequency=0.8, tint=(0.2, 0.5, 0.3)),
    ]
)
BARRED = [Rect((x, 0, 4), (0.06, 3), frequency=0.2) for x in np.arange(-1.5, 1.6, 0.5)]
SCENES = {
    "": SCENE,
    "barred": Rects([WALL, Rect((-0.8, 0, 8), (1.2, 0.8), velocity=(5, 0, 0), frequency=0.1), *BARRED]),
    "entering": Rects([WALL, Rect((-4.4, 1.8, 6), (1.0, 1.2), velocity=(18, 0, 0), frequency=0.1)]),
}
MOVER = 2


def pose(at):
    """Return the display camera `at` rendered frames from the start."""
    return camera(W, H, (0.1 * at, 0.01 * at, 0.02 * at), yaw=0.015 * at)


@functools.cache
def frames(scene=""):
    made = []
    for k in range(COUNT):
        before = (pose(k - 1), (k - 1) / FPS) if k else None
        made.append(SCENES[scene].frame(pose(k), k / FPS, W, H, before, reset=k == 0))
    return made


class Clip(FrameSource):
    """Frames in memory; `asked` says which were, `gate` holds them up."""

    name, width, height, render_size, fps, exposure, count = "clip", W, H, (W, H), FPS, 1.0, COUNT
    has_truth = True

    def __init__(self, delay=0.0, reset=0, back=0.0):
        self.delay, self.asked, self.gate = delay, [], threading.Event()
        self.reset, self.back = reset, back
        self.gate.set()

    def configure(self, window, n, scale=0.0):
        return False

    def rendered(self, k):
        self.asked.append(k)
        assert self.gate.wait(PATIENCE)
        time.sleep(self.delay)
        return replace(frames()[k], reset=k in (0, self.reset))

    def reset_before(self, k):
        return self.reset if k >= self.reset else 0

    def camera(self, k, alpha):
        return pose(k + alpha).moved((0, 0, -self.back))

    def truth(self, k, alpha):
        return SCENE.color(pose(k + alpha), self.time(k, alpha), W, H).astype(np.float32)

    def time(self, k, alpha=0.0):
        return k / FPS + alpha * (k / FPS - (k - 1) / FPS if k else 1 / FPS)


class SceneClip(Clip):
    """Frames of another scene."""

    def __init__(self, scene):
        super().__init__()
        self.scene = scene

    def rendered(self, k):
        return frames(self.scene)[k]


class FadingClip(Clip):
    """Frames under a light that fades, so that there is something to correct."""

    def rendered(self, k):
        frame = super().rendered(k)
        return replace(frame, color=frame.color * np.float16(0.85**k))


@contextmanager
def running(device, source=None):
    engine = Engine(device if callable(device) else lambda: device)
    engine.start()
    try:
        if source is not None:
            engine.open_source(source if callable(source) else lambda _: source)
            wait_for(lambda: engine.source is not None)
        yield engine
    finally:
        engine.close()


def want(engine, slot, setup, layers=(), **more):
    return Want(Key(engine.recipe(setup), slot), frozenset(layers), keep=False, **more)


def ask(engine, slot, setup, layers=()):
    """Return a slot as the engine makes it anew: a Frame or a Failure; `layers`: "all" for every one."""
    if layers == "all":
        layers = ask(engine, slot, setup).specs
    wanted = want(engine, slot, setup, layers)
    engine.store.want([])
    engine.store.want([wanted])
    return wait_for(lambda: engine.store.get(wanted))


def inspect(engine, x, y, slot, setup):
    """Return the values at a pixel of a slot."""
    wanted = want(engine, slot, setup, pixel=(int(x), int(y)))
    engine.store.want([wanted])
    return wait_for(lambda: engine.store.get(wanted))


def slots(setup, *pairs):
    """Return the numbers of the slots (k, j)."""
    return [k * (setup.n + 1) + j for k, j in pairs]


def plain_run(device, source_frames, setup, wanted, camera_at=pose, size=(W, H), exposure=1.0, begin=None, **given):
    """Return {slot → layers} of a pipeline that plays all frames in order. `wanted`: slots (k, j); `begin` gets it."""
    pipeline = Pipeline(device, *size, setup.options, fps=FPS, **given)
    if begin:
        begin(pipeline)
    pipeline.exposure = exposure
    pipeline.keep(["correction.refined", "shading.warped_previous", "shading.input_mask"])
    kept = {}
    for k, frame in enumerate(source_frames):
        pipeline.submit(frame)
        shown = pipeline.present()
        for j in range(setup.n + 1):
            time = frame.time + j / (setup.n + 1) * pipeline.interval
            made = pipeline.extrapolate(camera_at(k + j / (setup.n + 1)), time) if j else shown
            if (k, j) in wanted:
                layers = {
                    f"{stage.name}.{spec.name}": stage.read(spec.name)
                    for stage, spec in pipeline.named_buffers()
                    if spec.grid != "once" and (j or not spec.transient)
                }
                kept[k, j] = layers | {"final": made.numpy("color")}
        if len(kept) == len(wanted):
            return kept


def assert_same(images, expected, names=None):
    for name in names or expected:
        mine = images[name][..., :3] if name == "final" else images[name]
        assert mine.dtype == expected[name].dtype and mine.shape == expected[name].shape, name
        assert mine.tobytes() == expected[name].tobytes(), name


# ---- what is shown ---------------------------------------------------------------------------------------
