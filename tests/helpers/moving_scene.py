"""A mover before a wall, and a camera on its way, for tests of what the pipeline promises."""

import numpy as np
from synthetic import Rect, Rects, camera

W, H = 96, 64
WALL = Rect((0, 0, 10), frequency=0.35)
MOVING = Rects(
    [
        Rect((0, 0, 14), frequency=0.3),
        Rect((-0.5, 0.3, 6), (1, 1), velocity=(6, 1, 0), frequency=1.3, tint=(0.6, 0.3, 0.1)),
    ]
)


def half(image):
    """Return the values rounded to half."""
    return image.astype(np.float16)


def dolly(k, offset=(0, 0, 0)):
    """Return the camera of frame `k`, in a world shifted by `offset`."""
    position = np.array([0.06 * k, 0.01 * k, 0.1 * k]) + offset
    return camera(W, H, tuple(position), 0.01 * k, 0.003 * k, 0.004 * k)


def submit(pipeline, scene, cameras, times, width=W, height=H, reset_first=True, samples=1):
    """Submit a frame of `scene` per camera and time; returns the last one."""
    previous = None
    for k, (cam, time) in enumerate(zip(cameras, times, strict=True)):
        frame = scene.frame(cam, time, width, height, previous, reset=reset_first and k == 0, samples=samples)
        pipeline.submit(frame)
        previous = (cam, time)
    return frame
