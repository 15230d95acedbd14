"""Make sequences with effects that have no depth, as engines draw them, to measure what becomes of them.

    python docs/tools/make_effects.py OUT                     fire0, trail0, door0, walk0 and the same with seed 1
    python docs/tools/make_effects.py OUT fire2 door1         these; the number is the seed
    gffe run OUT/fire1 OUT/with; gffe run OUT/fire1 OUT/without --no-image-flow; gffe compare OUT/with OUT/fire1

Constants of the image flow were chosen on seeds 0 and on trail2; seeds 1 are for the proof. An effect is a plane that
moves, with a color and an opacity for each of its points, laid over the color alone: depth and motion are those of what
stands behind.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np

import gffe_cl as gffe
from gffe_cl.captures.scenes import SceneFrames, SceneRenderer
from gffe_cl.captures.scenes.parts.figures import walker
from gffe_cl.captures.scenes.parts.furniture import IRON, STEEL
from gffe_cl.captures.scenes.parts.motions import Motion, Place, Swing
from gffe_cl.captures.scenes.parts.motions import Path as Way
from gffe_cl.captures.scenes.scene_types import Box, Capsule, Cylinder, Group, Light, Material, Scene, pick, wave
from gffe_cl.captures.scenes.situations.places import scene, still_camera, sunlight, yard
from gffe_cl.captures.sequence.description import rendered_entry

WIDTH, HEIGHT, FRAMES, FPS = 480, 270, 9, 30.0
Shade = Callable[..., tuple[np.ndarray, np.ndarray]]  # u, v, time, rays → color times opacity, opacity
Effect = tuple[Motion, Shade]


def noise(x, y, t, seed):
    """Return smooth noise of three coordinates, −1 to 1."""

    def corner(*at):
        n = np.sin(sum(c * k for c, k in zip(at, (127.1, 311.7, 74.7), strict=True)) + seed * 17.3) * 43758.5453
        return n - np.floor(n)

    low = [np.floor(c) for c in (x, y, t)]
    parts = [(c - f) ** 2 * (3 - 2 * (c - f)) for c, f in zip((x, y, t), low, strict=True)]
    total = 0
    for k in np.ndindex(2, 2, 2):
        x, y, t = (p if b else 1 - p for b, p in zip(k, parts, strict=True))
        total = total + x * y * t * corner(*(f + b for f, b in zip(low, k, strict=True)))
    return 2 * total - 1


def turbulence(x, y, t, seed):
    return sum(noise(2**k * x, 2**k * y, 1.7**k * t, seed + k) / 2**k for k in range(3))


def laid_over(color, depth, camera, time, effects: list[Effect]):
    """Return color (H, W, 3) float16 with the effects in front of `depth`, of 2×2 samples per pixel."""
    result = np.zeros(color.shape)
    for dx, dy in ((0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)):
        x, y = np.meshgrid(np.arange(WIDTH) + dx, np.arange(HEIGHT) + dy)
        rays = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], -1)
        shown = color.astype(np.float64)
        for pose, shade in effects:
            to_plane = np.linalg.inv(pose(time)) @ camera.view_to_world
            origin, local = to_plane[:3, 3], rays @ to_plane[:3, :3].T
            z = -origin[2] / np.where(local[..., 2] == 0, 1e-9, local[..., 2])
            hit = (z > 0.05) & (z < depth)
            u, v = (np.where(hit, origin[k] + z * local[..., k], 1e3) for k in (0, 1))
            light, opacity = shade(u, v, time, local)
            shown = np.where(hit[..., None], shown * (1 - opacity[..., None]) + light, shown)
        result += shown / 4
    return result.astype(np.float16)


def flame(width: float, height: float, speed: float, seed: int) -> Shade:
    """Return fire that rises at `speed` m/s, with smoke and sparks."""

    def shade(u, v, t, rays):
        rise = np.clip(v / height, 0, 1)
        aside = np.abs(u / width + 0.25 * turbulence(2.2 * u, 2.2 * v - 1.2 * speed * t, 0.8 * t, seed + 5) * rise)
        licks = turbulence(1.75 * u / width, (2.3 * v - 1.6 * speed * t) / height, 1.3 * t, seed)
        near = (np.abs(u) < 1.3 * width) & (v > -0.05)
        heat = np.clip(1.5 * (1 - v / height) - 1.9 * aside**1.5 * (1 + rise) + 0.75 * licks, 0, 1.6) * near
        puffs = 0.3 * turbulence(1.6 * u, 1.3 * v - 0.7 * speed * t, 0.5 * t, seed + 9) * v / height
        fade = np.clip(2 * v / height - 0.6, 0, 1) * np.clip(2.2 - v / height, 0, 1)
        smoke = np.clip(0.35 * (1 - 0.8 * aside) + puffs, 0, 0.5) * fade * near
        light = np.stack([2.2 * heat, 1.1 * heat**2, 0.35 * heat**3], -1) + 0.1 * smoke[..., None]
        rng = np.random.default_rng(seed)
        for life, phase, side in rng.uniform((0.5, 0, -0.6), (1.0, 1, 0.6), (14, 3)):
            age = (t / life + phase) % 1.0
            x, y = side * width * (1 + age) + 0.08 * np.sin(9 * t + 50 * phase), height * (0.3 + 1.6 * age)
            spark = np.exp(-((u - x) ** 2 + (v - y) ** 2) / (2 * 0.013**2)) * (1 - age)
            light += spark[..., None] * (3.0, 1.6, 0.5)
        return light, np.clip(0.55 * heat + smoke, 0, 1)

    return shade


def fire(seed: int, rng: np.random.Generator) -> tuple[Scene, list[Effect]]:
    """Return two fires before a wall, and a person who passes behind them."""
    groups, effects = yard(rng, seed), []
    for k, (x, z) in enumerate(((-1.1, -2.4), (1.3, -3.2))):
        x += rng.uniform(-0.4, 0.4)
        coal = Material((0.05, 0.045, 0.04), roughness=1.0)
        groups.append(Group([Cylinder((x, 0, z), (x, 0.35, z), 0.36, coal)], name="brazier"))
        made = flame(rng.uniform(0.3, 0.42), rng.uniform(0.9, 1.3), rng.uniform(1.6, 2.4), 10 * seed + k)
        effects.append((Place(x, 0.32, z), made))
    groups += walker(Way([(-2.4, -3.9), (0, -4.1), (2.4, -3.9), (0, -3.6)], rng.uniform(1.1, 1.6), rng.random()), rng)
    eye = wave((0, 1.5, 2.2), (0.5, 0.05, 0.1), (rng.uniform(3, 4), 5.0, 6.0), rng.random(3))
    return scene("fire", "Fire", seed, groups, *sunlight(rng, 0.8), (eye, still_camera(rng)[1])), effects


def streak(swing: Swing, tint, seed: int) -> Shade:
    """Return light where a blade on the y axis of `swing` passed within the last 0.16 s."""

    def angle(t):
        return swing.rest + swing.amplitude * np.sin(2 * np.pi * (t / swing.period + swing.phase))

    def shade(u, v, t, rays):
        radius, here, steps = np.hypot(u, v), np.degrees(np.arctan2(-u, v)), 16
        light = np.zeros_like(u)
        for k in range(steps):
            a, b = angle(t - 0.16 * k / steps), angle(t - 0.16 * (k + 1) / steps)
            swept = (here >= min(a, b)) & (here <= max(a, b))
            age = (k + (here - a) / (b - a if b != a else 1)) / steps
            light = np.maximum(light, np.where(swept, 1 - age, 0))
        light = light**1.3 * (0.6 + 0.4 * noise(22 * radius, 0 * u, 0 * u, seed))
        light *= np.clip((radius - 0.5) / 0.25, 0, 1) * np.clip((1.42 - radius) / 0.06, 0, 1)
        return 1.5 * light[..., None] * tint, 0.35 * light

    return shade


def trail(seed: int, rng: np.random.Generator) -> tuple[Scene, list[Effect]]:
    """Return two people who swing blades, each with a trail of light behind it."""
    groups, effects = yard(rng, seed), []
    for k, x in enumerate((-0.9, 1.0)):
        z = -1.5 - 0.8 * k + rng.uniform(-0.2, 0.2)
        steps = [(x - 0.25, z - 0.5), (x + 0.25, z - 0.5), (x + 0.25, z - 0.7), (x - 0.25, z - 0.7)]
        groups += walker(Way(steps, 0.25, rng.random()), rng)
        swing = Swing("z", rng.uniform(70, 95), rng.uniform(0.8, 1.2), rng.random(), pick(rng, 0, 30, -30))
        at = Place(x, 1.35, z, yaw=rng.uniform(-25, 25), pitch=rng.uniform(-20, 20))
        arm = Capsule((0, 0, 0), (0, 0.46, 0), 0.045, Material((0.4, 0.25, 0.18)))
        blade = [Box((0, 0.95, 0), (0.07, 0.9, 0.02), STEEL), Box((0, 0.48, 0), (0.22, 0.05, 0.05), IRON), arm]
        groups.append(Group(blade, at @ swing, name="blade"))
        tint = pick(rng, (0.35, 0.6, 1.1), (1.0, 0.5, 0.25), (0.5, 1.0, 0.6))
        effects.append((at @ Place(0, 0, 0.03), streak(swing, tint, 10 * seed + k)))
    return scene("trail", "Swings with a trail", seed, groups, *sunlight(rng), still_camera(rng)), effects


def pane(hinge: Motion, seed: int) -> Shade:
    """Return glass with letters, which mirrors a row of houses behind the camera."""

    def shade(u, v, t, rays):
        pose = hinge(t)
        normal, world = pose[:3, 2], rays @ pose[:3, :3].T
        at = np.stack([u, v, 0 * u], -1) @ pose[:3, :3].T + pose[:3, 3]
        mirrored = world - 2 * (world @ normal)[..., None] * normal
        far = (8 - at[..., 2]) / np.where(np.abs(mirrored[..., 2]) > 1e-3, mirrored[..., 2], 1e-3)
        x, y = (at[..., k] + far * mirrored[..., k] for k in (0, 1))
        houses = np.where((x % 1.9 < 0.9) & ((y + 0.3) % 1.7 < 1.0), 0.9, 0.25)
        houses *= 0.85 + 0.15 * noise(3 * x, 3 * y, 0 * x, seed)
        facing = np.abs(world @ normal) / np.linalg.norm(world, axis=-1)
        share = 0.12 + 0.35 * (1 - facing) ** 2
        light = (share * np.where((far > 0) & (y < 5), houses, 1.6))[..., None] * (0.9, 1.0, 1.05)
        written = (np.abs(v - 1.44) < 0.09) & (u > 0.25) & (u < 1.0)
        written &= noise(np.floor(u / 0.025), np.floor(v / 0.03), 0 * u, seed + 3) > 0.05
        light, share = np.where(written[..., None], (0.75, 0.72, 0.6), light), np.where(written, 0.9, share)
        inside = (u > 0.04) & (u < 1.2) & (v > 0.08) & (v < 2.3)
        return light * inside[..., None], share * inside

    return shade


def door(seed: int, rng: np.random.Generator) -> tuple[Scene, list[Effect]]:
    """Return a glass door that swings beside a pane that stands, and people behind them; the camera strafes."""
    groups, x, z, wood = yard(rng, seed), rng.uniform(-0.8, -0.4), -1.4, Material((0.3, 0.2, 0.12), contrast=0.4)
    frame = [Box((x + 1.25, 2.44, z), (2.7, 0.1, 0.12), wood)]
    frame += [Box((x + side, 1.2, z), (0.09, 2.4, 0.12), wood) for side in (-0.04, 2.54)]
    groups.append(Group(frame, name="frame"))
    swing = Swing("y", rng.uniform(18, 35), rng.uniform(1.8, 2.6), rng.random(), rng.uniform(-30, -10))
    hinge = Place(x, 0, z) @ swing
    leaf = [Box((side, 1.2, 0), (0.06, 2.36, 0.05), IRON) for side in (0.03, 1.2)]
    leaf += [Box((0.6, y, 0), (1.2, 0.08, 0.05), IRON) for y in (0.05, 2.34)]
    groups.append(Group(leaf, hinge, name="leaf"))
    stands = Place(x + 1.25, 0, z)
    effects = [(hinge, pane(hinge, 10 * seed + 1)), (stands, pane(stands, 10 * seed))]
    groups += _passers(rng, (-2.4, -3.4))
    eye = wave((0, 1.55, 2.0), (0.9, 0.05, 0.1), (rng.uniform(2.2, 3.2), 5.0, 6.0), rng.random(3))
    return scene("door", "Glass door", seed, groups, *sunlight(rng), (eye, still_camera(rng)[1])), effects


def walk(seed: int, rng: np.random.Generator) -> tuple[Scene, list[Effect]]:
    """Return people in a low sun, with long shadows: these have no depth of their own, either."""
    groups = yard(rng, seed) + _passers(rng, (-0.9, -2.2))
    _, air = sunlight(rng)
    sun = Light("sun", (-0.9, 0.62, -0.25 + 0.9 * (seed % 2)), (2.4, 2.2, 1.9), size=0.01)
    cameras = still_camera(rng, (0, 2.1, 2.0), (0, 0.7, -2.5))
    return scene("walk", "Walkers and their shadows", seed, groups, [sun], air, cameras), []


def _passers(rng: np.random.Generator, depths) -> list[Group]:
    groups = []
    for z in depths:
        loop = [(-2.4, z), (0, z - 0.2), (2.4, z), (2.8, z - 0.4), (0, z - 0.55), (-2.8, z - 0.4)]
        groups += walker(Way(loop[:: pick(rng, -1, 1)], rng.uniform(1.2, 1.8), rng.random()), rng)
    return groups


KINDS = {"fire": fire, "trail": trail, "door": door, "walk": walk}


def make(out: Path, name: str, device: gffe.Device) -> None:
    """Render a kind and seed such as "fire0" into the folder `out`/`name`, with the frames in between."""
    kind = name.rstrip("0123456789")
    seed = int(name[len(kind) :])
    described, effects = KINDS[kind](seed, np.random.default_rng([*kind.encode(), seed]))
    frames, before = SceneFrames(SceneRenderer(device, described, WIDTH, HEIGHT)), None
    with gffe.SequenceWriter(out / name, WIDTH, HEIGHT, FPS) as writer:
        for k in range(FRAMES):
            frame = frames.rendered(k / FPS, before, k)
            color = laid_over(frame.color, frame.depth, frame.camera, frame.time, effects)
            entry = rendered_entry(k, frame, (WIDTH, HEIGHT))
            writer.add(entry, gffe.named_channels(color, frame.depth, frame.motion))
            time = (k + 0.5) / FPS
            truth, camera = frames.truth(time, frame).numpy(), frames.display_camera(time)
            color = laid_over(truth.color, truth.depth, camera, time, effects)
            entry = gffe.FrameEntry(f"truth_{k:06d}_0500.exr", time, "ground_truth", display_camera=camera)
            writer.add(entry, gffe.named_channels(color, truth.depth, truth.motion))
            before = frame


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, metavar="OUT", help="folder of the sequences")
    parser.add_argument("names", nargs="*", metavar="NAME", help="kind and seed (default: all kinds, seeds 0 and 1)")
    given = parser.parse_args()
    device = gffe.open_device()
    for name in given.names or [f"{kind}{seed}" for seed in (0, 1) for kind in KINDS]:
        make(given.out, name, device)
        print(name, flush=True)


if __name__ == "__main__":
    main()
