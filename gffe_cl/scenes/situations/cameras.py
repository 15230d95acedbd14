"""Situations of how frames are made: a camera that speeds up, turns and stops; motion vectors that are rounded."""

from __future__ import annotations

import numpy as np

from gffe_cl.scenes.parts.figures import walker
from gffe_cl.scenes.parts.motions import Path
from gffe_cl.scenes.scene_types import Scene, wave
from gffe_cl.scenes.situations.places import hall, lamplight, scene, sunlight, yard


def handheld(seed: int, rng: np.random.Generator) -> Scene:
    """A still room, seen by a camera that is swung to and fro."""
    period, phase = rng.uniform(1.5, 1.9), rng.random(3)
    eye = wave((0, 1.55, 1.8), (0.45, 0.05, 0.4), (1.3 * period, 0.6 * period, 1.7 * period), phase)
    target = wave((0, 1.4, -3.0), (1.6, 0.25, 0), (period, 0.8 * period, 1), rng.random(3))
    cameras = eye, target
    return scene("handheld", "A camera that accelerates", seed, hall(rng, seed), *lamplight(rng), cameras)


def quantised(seed: int, rng: np.random.Generator) -> Scene:
    """People in a yard; motion vectors are rounded to whole pixels."""
    groups = yard(rng, seed)
    for k in range(3):
        z = -1.5 - 1.0 * k
        loop = [(-2.4, z), (0, z + 0.3), (2.4, z), (2.6, z - 0.5), (0, z - 0.4), (-2.6, z - 0.5)]
        groups += walker(Path(loop, rng.uniform(1.1, 1.6), rng.random()), rng)
    eye = wave((0, 1.6, 2.2), (1.6, 0.1, 0.5), (6.0, 5.0, 7.0), rng.random(3))
    target = wave((0, 1.4, -3.0), (0.6, 0.1, 0), (7.0, 6.0, 1), rng.random(3))
    cameras = eye, target
    return scene("quantised", "Rounded motion vectors", seed, groups, *sunlight(rng), cameras, motion_step=1.0)
