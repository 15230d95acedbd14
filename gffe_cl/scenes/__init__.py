"""Built-in scenes: exact test data for frame extrapolation, rendered on the same OpenCL device.

    from gffe_cl.scenes import SCENES, SceneRenderer, load_scene

    scene = load_scene("corridor", seed=3)
    renderer = SceneRenderer(device, scene, 960, 540)
    now, before = scene.camera(1.0, 960, 540), scene.camera(0.967, 960, 540)
    image = renderer.render(1.0, now, 0.967, before)

A seed varies layout, textures, palette, lights, speeds and the camera's path; the picture depends on
nothing else.
"""

from __future__ import annotations

import importlib
from pathlib import Path

import numpy as np

from gffe_cl.errors import GffeError
from gffe_cl.scenes.renderer import SceneArrays, SceneImage, SceneRenderer
from gffe_cl.scenes.sequences import SceneFrames
from gffe_cl.scenes.vocabulary import Scene
from gffe_cl.values import require_seed

SCENES = {
    "corridor": "Indoor passage: walkers, mirror ball, railings, a sweeping lamp; the camera dollies",
    "plaza": "Town square under a sky: fence in front, walkers, statue and fountain; the camera strafes",
    "room": "Furnished living room: mirror, glass panel, toys and a fan; the camera orbits",
    "forest": "Trunks, foliage, sun shadows and animals; the camera turns quickly",
    "gallery": "Hall of polished floors: mirrors, turning sculptures, lamps that travel and swing; the camera glides",
    "street": "Wet street at night: headlights, lanterns in the wind, neon; the camera walks",
    "factory": "Hall with strip curtains, glass, a conveyor, fans, a crane and a beacon; the camera trucks",
    "courtyard": "Sunlit court: arcades, laundry, a tree, birds above, a fountain; the camera turns as with a mouse",
}

__all__ = [
    "SCENES",
    "Scene",
    "SceneArrays",
    "SceneFrames",
    "SceneImage",
    "SceneRenderer",
    "is_scene",
    "load_scene",
]


def is_scene(target: str) -> bool:
    """Whether this names a built-in scene, not a sequence: a folder of that name comes first."""
    return target in SCENES and not Path(target).exists()


def load_scene(name: str, seed: int = 0) -> Scene:
    """Build the scene `name` of `SCENES` for `seed`, 0 to 2³² − 1. Raises GffeError for an unknown name and for other
    seeds."""
    if name not in SCENES:
        raise GffeError(f"unknown scene '{name}': expected one of {', '.join(SCENES)}")
    seed = require_seed(seed, f"scene '{name}': seed")
    module = importlib.import_module(f"gffe_cl.scenes.{name}")
    return module.build(seed, np.random.default_rng([*name.encode(), seed]))
