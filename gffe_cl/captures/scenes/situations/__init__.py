"""Situations: small built-in scenes, each with one difficulty for frame extrapolation and little else."""

from __future__ import annotations

import numpy as np

from gffe_cl.captures.scenes.scene_types import Scene
from gffe_cl.captures.scenes.situations import cameras, movers, shading

BUILDERS = {
    "bars": movers.bars,
    "railings": movers.railings,
    "entering": movers.entering,
    "ropes": movers.ropes,
    "balls": movers.balls,
    "rotors": movers.rotors,
    "handheld": cameras.handheld,
    "cab": cameras.cab,
    "wipers": cameras.wipers,
    "lamps": shading.lamps,
    "shadows": shading.shadows,
    "fan": shading.fan,
    "screen": shading.screen,
    "marbles": shading.marbles,
    "quantized": cameras.quantized,
}


def build(name: str, seed: int, rng: np.random.Generator) -> Scene:
    """Return the situation `name`, one of `SITUATIONS` of `gffe_cl.captures.scenes`."""
    return BUILDERS[name](seed, rng)
