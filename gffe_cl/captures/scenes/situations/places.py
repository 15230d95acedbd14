"""Places of situations: a yard in the sun and a hall under lamps, both still. The camera stands at positive z, and the
back wall at `BACK`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gffe_cl.captures.scenes.parts.furniture import IRON, STEEL, bench
from gffe_cl.captures.scenes.parts.motions import Place
from gffe_cl.captures.scenes.parts.room_furniture import bookcase
from gffe_cl.captures.scenes.scene_types import (
    Air,
    Box,
    Cone,
    Cylinder,
    Group,
    Light,
    Material,
    Scene,
    pick,
    tint,
    vary,
    wave,
)

BACK, HALF_WIDTH, HEIGHT = -5.5, 4.5, 3.4  # meters; width and height of the hall


def yard(rng: np.random.Generator, seed: int) -> list[Group]:
    """Return paving before a brick wall with windows, a bench and barrels."""
    paving = Material(
        vary(rng, (0.4, 0.36, 0.31)), (0.16, 0.14, 0.12), pick(rng, "cobbles", "tiles"), scale=0.4, contrast=0.35,
        roughness=0.85, seed=seed,
    )  # fmt: skip
    brick = Material(
        vary(rng, pick(rng, (0.42, 0.2, 0.13), (0.45, 0.36, 0.26), (0.36, 0.35, 0.34))), (0.5, 0.47, 0.42), "bricks",
        scale=0.16, contrast=0.35, roughness=0.9, seed=seed,
    )  # fmt: skip
    frame, pane = Material((0.6, 0.58, 0.54), roughness=0.6), Material((0.05, 0.07, 0.09), contrast=0.1)
    groups = [
        Group([Box((0, -0.1, -10), (60, 0.2, 60), paving)], name="paving"),
        Group([Box((0, 2.2, BACK - 0.1), (24, 4.4, 0.2), brick)], name="wall"),
        Group([Box((0, 4.45, BACK - 0.05), (24, 0.14, 0.4), frame)], name="coping"),
    ]
    for x in np.arange(-7.0, 8.0, 2.8) + rng.uniform(-0.5, 0.5):
        window = [Box((x, 2.2, BACK), (1.1, 1.5, 0.1), frame), Box((x, 2.2, BACK + 0.01), (0.96, 1.36, 0.1), pane)]
        window += [Box((x, 2.2, BACK + 0.03), (0.05, 1.4, 0.1), frame), Box((x, 1.42, BACK), (1.3, 0.08, 0.3), frame)]
        groups.append(Group(window, name="window"))
    groups += bench(Place(-2.3 + rng.uniform(-0.5, 0.5), 0, BACK + 0.7))
    for k in range(3):
        paint = Material(vary(rng, pick(rng, (0.1, 0.25, 0.3), (0.45, 0.1, 0.06), (0.4, 0.3, 0.1))), roughness=0.5)
        x, z = 1.6 + 0.75 * k, BACK + 0.75 + 0.3 * (k % 2)
        barrel = [Cylinder((x, 0, z), (x, 0.85, z), 0.29, paint)]
        barrel += [Cylinder((x, y, z), (x, y + 0.04, z), 0.305, STEEL) for y in (0.05, 0.4, 0.78)]
        groups.append(Group(barrel, name="barrel"))
    return groups


def sunlight(rng: np.random.Generator, strength: float = 1.5) -> tuple[list[Light], Air]:
    """Return a sun from the upper left behind the camera, and its sky."""
    sun = Light("sun", (-0.55 + rng.uniform(-0.2, 0.2), 0.9, 0.75), tint((1.0, 0.92, 0.8), strength), size=0.01)
    air = Air(
        zenith=(0.1, 0.23, 0.52),
        horizon=(0.48, 0.54, 0.63),
        clouds=rng.uniform(0.2, 0.6),
        ambient_up=(0.2, 0.23, 0.29),
        ambient_down=(0.13, 0.12, 0.1),
    )
    return [sun], air


def hall(rng: np.random.Generator, seed: int) -> list[Group]:
    """Return a room with planks, papered walls, pictures, a bookcase, a bench, a vase on a stand; nothing reflects."""
    oak = vary(rng, pick(rng, (0.42, 0.27, 0.14), (0.5, 0.38, 0.24), (0.3, 0.18, 0.1)))
    floor = Material(oak, tint(oak, 0.5), "planks", scale=0.14, contrast=0.5, roughness=0.7, seed=seed)
    color = vary(rng, pick(rng, (0.58, 0.53, 0.42), (0.42, 0.5, 0.5), (0.55, 0.42, 0.38), (0.46, 0.5, 0.38)))
    paper = Material(color, tint(color, 0.65), pick(rng, "wallpaper", "stripes"), scale=0.36, contrast=0.12, seed=seed)
    plaster = Material((0.66, 0.64, 0.6), scale=0.8, contrast=0.08, roughness=1.0)
    white = Material((0.6, 0.58, 0.54), roughness=0.6, contrast=0.05)
    w, h, near = HALF_WIDTH, HEIGHT, 4.5
    middle, length = (BACK + near) / 2, near - BACK
    groups = [
        Group([Box((0, -0.1, middle), (2 * w + 0.4, 0.2, length + 0.4), floor)], name="floor"),
        Group([Box((0, h + 0.1, middle), (2 * w + 0.4, 0.2, length + 0.4), plaster)], name="ceiling"),
        Group([Box((0, h / 2, BACK - 0.1), (2 * w, h, 0.2), paper)], name="wall"),
        Group([Box((0, h / 2, near + 0.1), (2 * w, h, 0.2), paper)], name="wall"),
        Group([Box((0, 0.07, BACK + 0.01), (2 * w, 0.14, 0.04), white)], name="skirting"),
    ]
    groups += [Group([Box((s * (w + 0.1), h / 2, middle), (0.2, h, length), paper)], name="wall") for s in (-1, 1)]
    for x in (-2.6, -0.2, 2.3):
        art = Material(
            vary(rng, (0.6, 0.5, 0.35), 0.6), vary(rng, (0.2, 0.28, 0.42), 0.7), "picture", scale=0.3, contrast=0.3,
            seed=int(rng.integers(1 << 16)),
        )  # fmt: skip
        size = rng.uniform(0.8, 1.3), rng.uniform(0.6, 0.9)
        hung = [Box((x, 1.9, BACK), (size[0] + 0.1, size[1] + 0.1, 0.06), IRON)]
        groups.append(Group([*hung, Box((x, 1.9, BACK + 0.02), (*size, 0.06), art)], name="picture"))
    groups += bookcase(rng, Material(tint(oak, 0.6), scale=0.2, contrast=0.3), -HALF_WIDTH)
    groups += bench(Place(0.5 + rng.uniform(-0.6, 0.6), 0, BACK + 0.6))
    glaze = Material(vary(rng, pick(rng, (0.1, 0.25, 0.45), (0.5, 0.2, 0.1), (0.12, 0.35, 0.25))), roughness=0.3)
    x, z = 3.0, BACK + 1.4
    stand = [Box((x, 0.45, z), (0.5, 0.9, 0.5), white), Cone((x, 0.9, z), (x, 1.25, z), 0.1, 0.22, glaze)]
    groups.append(Group([*stand, Cone((x, 1.25, z), (x, 1.5, z), 0.22, 0.09, glaze)], name="vase"))
    return groups


def lamplight(rng: np.random.Generator, strength: float = 1.0) -> tuple[list[Light], Air]:
    """Return the soft light of a room; at strength 1 it is bright enough to see by. Nothing of it moves."""
    warm = vary(rng, (1.0, 0.85, 0.66), 0.08)
    lights = [
        Light("lamp", (-1.5, HEIGHT - 0.3, 1.5), tint(warm, 9.0 * strength), size=0.25),
        Light("fill", (0, 0.6, -1.0), tint(warm, 1.4 * strength), size=2.0),
    ]
    air = Air(
        ambient_up=tint((0.3, 0.3, 0.31), strength),
        ambient_down=tint((0.26, 0.23, 0.2), strength),
        haze_color=(0.4, 0.4, 0.4),
    )
    return lights, air


def still_camera(rng: np.random.Generator, eye=(0.0, 1.55, 2.0), target=(0.0, 1.3, -3.0)) -> tuple[Callable, Callable]:
    """Return paths of eye and target of a nearly still camera, so that visible motion is the objects' own."""
    phase = rng.random(3)
    eye_path = wave(eye, (0.25, 0.04, 0.1), (9.0, 7.0, 11.0), phase)
    return eye_path, wave(target, (0.15, 0.03, 0.0), (8.0, 9.0, 1.0), phase)


def scene(name: str, description: str, seed: int, groups, lights, air, cameras, **more) -> Scene:
    """Return a `Scene` seen through `cameras`: paths of eye and target."""
    return Scene(name, description, seed, groups, lights, air, *cameras, focal=1.0, **more)
