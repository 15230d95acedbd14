"""Built-in scenes: exact test data for frame extrapolation, rendered on the same OpenCL device.

    from gffe_cl.captures.scenes import SCENES, SceneRenderer, load_scene

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

from gffe_cl.captures.scenes.renderer import EncodedFrames, SceneArrays, SceneFrames, SceneImage, SceneRenderer
from gffe_cl.captures.scenes.scene_types import Scene
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import require_seed

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

# Each holds one thing that is hard, and little else; beside the eight above, which tables and studies are made of.
SITUATIONS = {
    "bars": "Movers behind bars: three people and an animal pass behind a fence",
    "railings": "People behind a fence and before it, and moving shadows that cross them; the camera strafes",
    "balls": "Balls that fly on parabolas, bounce and roll",
    "rotors": "Arcs: a pinwheel, a wheel with spokes, a rotor, a cart on wheels",
    "handheld": "A camera that speeds up, turns and stops, in a still room",
    "cab": "Dashboard and pillars of a cab that shakes: they are fixed to the camera",
    "wipers": "Wipers and a hand that move in a shaking cab: relative to the camera",
    "shadows": "Shadows of things out of view, across steps, columns and walls",
    "fan": "A fan before a lamp: shadows of blades turn over walls and floor",
}

__all__ = [
    "SCENES",
    "SITUATIONS",
    "EncodedFrames",
    "Scene",
    "SceneArrays",
    "SceneFrames",
    "SceneImage",
    "SceneRenderer",
    "is_scene",
    "is_scene_name",
    "load_scene",
    "scene_names",
]


def is_scene(target: str) -> bool:
    """Return whether `target` names a built-in scene, not a sequence: a folder of that name takes precedence."""
    return is_scene_name(target) and not Path(target).exists()


def is_scene_name(name: str) -> bool:
    """Return whether `load_scene` accepts the name."""
    return name in SCENES or name in SITUATIONS


def scene_names() -> str:
    """Return the names of all scenes, for messages."""
    return f"{', '.join(SCENES)}; {', '.join(SITUATIONS)}"


def load_scene(name: str, seed: int = 0) -> Scene:
    """Return the scene `name` of `SCENES` or `SITUATIONS`, built for `seed`, 0 to 2³² − 1. Raises GffeError for an
    unknown name and for other seeds."""
    if not is_scene_name(name):
        raise GffeError(f"unknown scene '{name}': expected one of {scene_names()}")
    seed = require_seed(seed, f"scene '{name}': seed")
    rng = np.random.default_rng([*name.encode(), seed])
    if name in SITUATIONS:
        return importlib.import_module("gffe_cl.captures.scenes.situations").build(name, seed, rng)
    return importlib.import_module(f"gffe_cl.captures.scenes.places.{name}").build(seed, rng)
