"""Jittered frames of fewer pixels than are shown, and pipelines that upscale them."""

from dataclasses import replace

import numpy as np
from synthetic import Rect, Rects, camera

from gffe_cl.engine.frame.window import Jitter
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline

W, H = 96, 64
JITTER = Jitter(16)
WALL = Rect((0, 0, 12), (9, 6), frequency=0.7)
STILL = Rects([WALL, Rect((0.9, 0.2, 6), (0.7, 1.5), frequency=1, tint=(0.7, 0.2, 0.1))])
MOVING = Rects([WALL, Rect((-1, 0.2, 6), (0.7, 1.5), velocity=(6, 0, 0), frequency=1, tint=(0.7, 0.2, 0.1))])


def pipeline_for(device, size=(W, H), scale=2.0, render_size=None, upscale=2.0, **options):
    small = render_size or tuple(round(n / scale) for n in size)
    return Pipeline(device, *size, Options(upscale=upscale, **options), render_size=small)


def path(k, still=True):
    """Return the display camera of frame `k`."""
    return camera(W, H) if still else camera(W, H, (0.04 * k, 0.01 * k, 0.05 * k), 0.004 * k)


def frames(scene, count, size=(W, H), scale=2.0, still=True, jitter=JITTER, first=0):
    """Jittered frames of a sample per pixel."""
    small, before = tuple(round(n / scale) for n in size), None
    for k in range(first, first + count):
        shown = path(k, still)
        render = jitter.camera(shown.scaled(small[0] / size[0], small[1] / size[1]), k)
        frame = scene.frame(render, k / 30, *small, before, reset=before is None)
        before = (render, k / 30)
        yield replace(frame, display_camera=shown)


def color_of(pipeline):
    return pipeline.present().numpy("color").astype(np.float32)
