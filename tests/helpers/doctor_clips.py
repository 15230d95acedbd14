"""A short sequence for tests of the doctor, exact in everything, without a device."""

from functools import cache

import numpy as np
from fault_injection import Kept
from synthetic import Rect, Rects, camera

from gffe_cl.captures.sequence import SequenceWriter, named_channels

W, H, COUNT = 120, 68, 9


def made_world():
    rects = [
        Rect((0, 0, 24), (40, 30), frequency=0.35),
        Rect((1.2, 0.3, 4), (0.7, 0.9), (1.5, 0, 0), 1.1, (0.7, 0.5, 0.2)),
    ]
    rng = np.random.default_rng(3)
    for k in range(7):
        place = (rng.uniform(-5, 5), rng.uniform(-2.5, 2.5), rng.uniform(5, 14))
        tint = tuple(rng.uniform(0.2, 0.8, 3))
        rects.append(Rect(place, tuple(rng.uniform(0.5, 1.8, 2)), frequency=0.4 + 0.1 * k, tint=tint))
    return Rects(rects)


def frames_of(view_at, count=COUNT):
    """Return frames of rectangles, one of which moves, seen by the cameras `view_at(k)`."""
    world, frames, before = made_world(), [], None
    for k in range(count):
        frames.append(world.frame(view_at(k), k / 30, W, H, before, reset=k == 0, samples=2))
        before = view_at(k), k / 30
    return frames


@cache
def clip(moves=True, turns=True):
    """Return frames that are exact in everything."""
    return Kept(frames_of(lambda k: view_at(k, moves, turns)))


def view_at(k, moves=True, turns=True):
    at = (0.09 * k + 0.01 * k * k, 0.03 * k, 0.06 * k) if moves else (0, 0, 0)
    angles = dict(yaw=0.012 * k + 0.002 * k * k, pitch=-0.008 * k, roll=0.006 * k) if turns else {}
    return camera(W, H, at, **angles)


def written(folder, kept):
    with SequenceWriter(folder, kept.width, kept.height, 30.0, kept.exposure) as writer:
        for entry in kept.rendered:
            frame = kept.read(entry)
            writer.add(entry, named_channels(frame.color, frame.depth, frame.motion))
    return folder
