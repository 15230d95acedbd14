"""Scenes of the corpus beside the built-in ones: fast games, lattices and thickets, and effects that games draw over
finished frames. `corpus.py` renders them."""
# ruff: noqa: F403, F405 (the vocabulary of scenes)

from __future__ import annotations

import numpy as np

from gffe_cl.captures.scenes.props import *
from gffe_cl.captures.scenes.situations import scene, sunlight, yard
from gffe_cl.engine.frame.camera import Camera

ROWS = 136  # of the corpus' images: pitches of lattices are in pixels of these


# ---- fast games ---------------------------------------------------------------------------------------------------


def racing(seed: int, rng: np.random.Generator) -> Scene:
    """Return a race on a winding road, seen from behind the own car: 25 m/s, others overtake and fall back."""
    ground = Material(vary(rng, (0.2, 0.26, 0.1)), (0.3, 0.26, 0.18), "cobbles", scale=0.7, contrast=0.5, seed=seed)
    tar = Material((0.15, 0.15, 0.16), (0.1, 0.1, 0.1), "cobbles", scale=0.3, contrast=0.4, roughness=0.9, seed=seed)
    bend = rng.uniform(12, 22)
    loop = [(0, 0), (bend, -50), (-bend, -100), (bend, -150), (120, -160), (130, 0), (60, 60)]
    road = Path(loop, 25.0, rng.uniform(0.0, 0.15))
    groups = [Group([Box((40, -0.2, -60), (400, 0.2, 400), ground)], name="ground")]
    for k in range(int(road.length // 4)):
        at = _facing(road, 4.0 * k)
        stripe = Material((0.6, 0.1, 0.08) if k % 2 else (0.6, 0.6, 0.58), contrast=0.1)
        slabs = [Box((0, -0.08, 0), (8, 0.06, 4.6), tar), Box((0, -0.04, 0), (0.15, 0.02, 1.8), stripe)]
        rails = [Box((s * 4.6, 0.3, 0), (0.12, 0.6, 4.3), stripe) for s in (-1, 1)]
        groups.append(Group(slabs + rails, at, name="road"))
        if k % 2:
            x, _, z = (at @ Place((-1) ** (k // 2) * rng.uniform(7, 14)))(0.0)[:3, 3]
            groups += conifer(x, z, rng, rng.uniform(4, 8), bark_material(rng), leaf_material(rng))
    sway = Slide((0.5, 0, 0), rng.uniform(1.4, 2.0), rng.random())
    groups += car(road @ sway @ Swing("y", 6, rng.uniform(1.4, 2.0), rng.random()), rng)
    for k in range(4):
        other = Path(loop, rng.uniform(21, 30), road.start + (6 + 7 * k) / road.length)
        groups += car(other @ Place(rng.choice((-2.4, 2.4))), rng)

    def eye(time):
        return road.position(road.distance(time) - 6.5) + (0, 2.3, 0)

    def target(time):
        return road.position(road.distance(time) + 6.0) + (0, 0.6, 0)

    return scene("racing", seed, groups, *sunlight(rng), (eye, target))


def _facing(road: Path, distance: float) -> Place:
    """Return the place at `distance` along a path, z ahead."""
    at, ahead = road.position(distance), road.position(distance + 0.5) - road.position(distance - 0.5)
    return Place(*at, yaw=float(np.degrees(np.arctan2(ahead[0], ahead[2]))))


def first_person(seed: int, rng: np.random.Generator) -> Scene:
    """Return a yard with pillars and people in first person: the player strafes and turns quickly; a tool in the hands
    bobs with the steps, lags behind turns and kicks."""
    groups = yard(rng, seed)
    stone = Material(vary(rng, (0.5, 0.46, 0.4)), (0.3, 0.28, 0.25), "bricks", scale=0.3, contrast=0.3, seed=seed)
    for x, z in ((-2.6, -1.6), (2.4, -2.2), (0.3, -3.6), (-5.5, -0.5), (5.2, -0.8)):
        groups.append(Group([Box((x, 1.1, z), (0.6, 2.2, 0.6), stone)], name="pillar"))
    for k in range(3):
        z = -1.4 - 0.9 * k
        loop = [(-3, z), (0, z + 0.3), (3, z), (3.2, z - 0.4), (0, z - 0.5), (-3.2, z - 0.4)]
        groups += walker(Path(loop[:: pick(rng, -1, 1)], rng.uniform(1.8, 3.2), rng.random()), rng)
    phase, turn = rng.random(3), rng.uniform(0.9, 1.3)
    eye = wave((0, 1.6, 3.2), (1.3, 0.05, 0.5), (rng.uniform(1.3, 1.8), 0.42, 2.1), phase)
    look = wave((0, 1.3, -3.5), (3.4, 0.4, 0.0), (turn, 0.8, 1.0), rng.random(3))
    held = Held(eye, look)
    bob = Slide((0.018, 0.0, 0.0), 0.84, phase[1]) @ Slide((0.0, 0.012, 0.0), 0.42, phase[1])
    lag = Swing("y", 5, turn, rng.random()) @ Swing("x", 2, 0.8, rng.random())
    hand = held @ Place(0.24, -0.2, -0.5) @ bob @ lag @ Bounce(0.02, rng.uniform(0.3, 0.5))
    metal = Material((0.2, 0.21, 0.22), (0.1, 0.1, 0.1), "stripes", scale=0.04, contrast=0.4, roughness=0.5, seed=seed)
    skin = Material(vary(rng, (0.5, 0.32, 0.22)), scale=0.2, contrast=0.1)
    tool = [Box((0, 0, -0.1), (0.07, 0.1, 0.42), metal), Capsule((0, 0.02, -0.3), (0, 0.02, -0.55), 0.02, IRON)]
    tool += [Box((0, 0.07, -0.1), (0.02, 0.03, 0.3), STEEL), Capsule((0, -0.05, 0.05), (0.1, -0.2, 0.3), 0.05, skin)]
    groups.append(Group(tool, hand, name="tool"))
    drum = hand @ Place(0, 0.02, -0.34) @ Spin("z", rng.uniform(300, 700))
    rings = [Capsule((0.04 * np.cos(a), 0.04 * np.sin(a), 0), (0.04 * np.cos(a), 0.04 * np.sin(a), -0.14), 0.01, STEEL)
             for a in 2 * np.pi * np.arange(6) / 6]  # fmt: skip
    groups.append(Group(rings, drum, name="drum"))
    return scene("first_person", seed, groups, *sunlight(rng), (eye, look))


def posts(seed: int, rng: np.random.Generator) -> Scene:
    """Return a yard in first person, past posts; a car behind these enters in a curve, and drives by."""
    groups = yard(rng, seed)
    iron = Material(vary(rng, (0.16, 0.17, 0.18)), specular=0.2, roughness=0.3)
    for x in np.arange(-4.5, 4.6, rng.uniform(1.4, 1.9)):
        groups.append(Group([Cylinder((x, 0, 0), (x, 4, 0), rng.uniform(0.05, 0.1), iron)], name="post"))
    side = pick(rng, -1, 1)
    curve = [(side * x, z) for x, z in ((-14, -5), (-6, -3.6), (0, -2.4), (6, -2.2), (14, -4), (20, -12), (0, -40))]
    groups += car(Path(curve, rng.uniform(7, 10), rng.uniform(0.08, 0.12)), rng)
    eye = wave((0, 1.6, 3.2), (1.2, 0.03, 0.4), (rng.uniform(1.6, 2.4), 0.42, 2.1), rng.random(3))
    look = wave((0, 1.2, -3.0), (1.2, 0.1, 0.0), (rng.uniform(1.6, 2.4), 0.8, 1.0), rng.random(3))
    return scene("posts", seed, groups, *sunlight(rng), (eye, look))


def platform(seed: int, rng: np.random.Generator) -> Scene:
    """Return a platform game from the side: layers at many depths pass at 7 m/s, a runner hops, coins spin, platforms
    travel."""
    earth = Material(vary(rng, (0.36, 0.22, 0.12)), (0.2, 0.3, 0.1), "bricks", scale=0.5, contrast=0.4, seed=seed)
    grass, gold = Material(vary(rng, (0.15, 0.35, 0.1)), contrast=0.4), Material((0.7, 0.5, 0.1), roughness=0.3)
    groups = []
    for k in range(16):
        x, y = 3.2 * k - 6.0, rng.uniform(-0.5, 0.7)
        block = [Box((x, y - 1.5, 0), (2.5, 3.0, 1.6), earth), Box((x, y + 0.05, 0), (2.6, 0.14, 1.7), grass)]
        groups.append(Group(block, name="block"))
        slab = [Box((0, 0, 0), (1.4, 0.25, 1.2), earth), Box((0, 0.14, 0), (1.5, 0.08, 1.3), grass)]
        motion = Place(x + 1.5, y + 2.0, 0) @ Slide(
            pick(rng, (1.0, 0, 0), (0, 0.7, 0)), rng.uniform(1, 2), rng.random()
        )
        groups.append(Group(slab, motion, name="platform"))
        spin = Place(x + rng.uniform(-0.8, 0.8), y + 1.2, 0) @ Spin("y", rng.uniform(200, 400), 360 * rng.random())
        groups.append(Group([Cylinder((0, 0, -0.03), (0, 0, 0.03), 0.25, gold)], spin, name="coin"))
        groups += conifer(x + rng.uniform(-1, 1), -5.0, rng, rng.uniform(3, 5), bark_material(rng), leaf_material(rng))
        rock = Material(vary(rng, (0.3, 0.32, 0.36)), scale=2.0, contrast=0.4)
        groups.append(Group([Ellipsoid((4 * k - 10, -3, -18), (4, rng.uniform(5, 9), 3), rock)], name="hill"))
    speed, paint = rng.uniform(6, 8), Material(vary(rng, (0.6, 0.1, 0.1)), (0.7, 0.7, 0.6), "stripes", scale=0.2)
    run = Place(0, 1.2, 0) @ Carry((100 * speed, 0, 0), 100.0)
    hop = run @ Bounce(rng.uniform(1.0, 1.8), rng.uniform(0.6, 0.9), rng.random())
    groups.append(Group([Sphere((0, 0, 0), 0.4, paint)], hop @ Spin("z", -500), name="runner"))
    for s in (-1, 1):
        leg = hop @ Place(0, -0.2, 0.2 * s) @ Swing("z", 50, 0.35, 0.5 * (s > 0))
        groups.append(Group([Capsule((0, 0, 0), (0, -0.55, 0), 0.1, IRON)], leg, name="leg"))
    sway = rng.random()

    def eye(time):
        return np.array((speed * time, 2.0 + 0.3 * np.sin(5 * time + 6 * sway), 9.0))

    def target(time):
        return np.array((speed * time + 0.6, 1.4 + 0.3 * np.sin(5 * time + 6 * sway), 0.0))

    return scene("platform", seed, groups, *sunlight(rng), (eye, target))


def strategy(seed: int, rng: np.random.Generator) -> Scene:
    """Return a field from above with many small units that march, and a camera that scrolls and comes closer."""
    ground = Material(vary(rng, (0.24, 0.27, 0.12)), (0.32, 0.27, 0.18), "cobbles", scale=0.6, contrast=0.5, seed=seed)
    groups = [Group([Box((0, -0.1, 0), (120, 0.2, 120), ground)], name="ground")]
    roof = Material(vary(rng, (0.45, 0.2, 0.12)), (0.3, 0.14, 0.1), "tiles", scale=0.4, contrast=0.4, seed=seed)
    for k in range(9):
        x, z = 7.0 * (k % 3 - 1) + rng.uniform(-1, 1), -6.0 * (k // 3) + rng.uniform(-1, 1)
        house = [Box((0, 0.8, 0), (2.4, 1.6, 2.0), CERAMIC), Box((0, 1.8, 0), (2.7, 0.4, 2.3), roof)]
        groups.append(Group(house, Place(x, 0, z, yaw=rng.uniform(0, 90)), name="house"))
        groups += broad_tree(x + 3, z + rng.uniform(-2, 2), rng, 2.5, bark_material(rng), leaf_material(rng), 6)
    for k in range(14):
        x, z, r = rng.uniform(-8, 8), rng.uniform(-12, 4), rng.uniform(1.2, 3.0)
        ring = [(x + r * np.cos(a), z + r * np.sin(a)) for a in 2 * np.pi * np.arange(6) / 6]
        path = Path(ring[:: pick(rng, -1, 1)], rng.uniform(1.5, 3.5), rng.random())
        if k % 4 == 0:
            groups += car(path, rng)
        elif k % 4 == 1:
            groups += animal(path, rng, 1.0)
        else:
            groups += walker(path, rng)
    scroll = wave((0, 9.0, 7.0), (4.0, 1.2, 2.5), (rng.uniform(2.0, 2.8), 2.3, 3.1), rng.random(3))

    def target(time):
        x, _, z = scroll(time)
        return np.array((x, 0.0, z - 7.5))

    return scene("strategy", seed, groups, *sunlight(rng), (scroll, target))


# ---- lattices -----------------------------------------------------------------------------------------------------


def lattice(seed: int, rng: np.random.Generator) -> Scene:
    """Return a chain-link fence (even seeds) or a net before a facade, wires 3, 6 or 1.5 px apart (seed modulo 3); the
    camera strafes or turns."""
    groups = yard(rng, seed)
    away = rng.uniform(2.6, 4.0)  # meters from the camera
    pitch = (3.0, 6.0, 1.5)[seed % 3] * rng.uniform(0.9, 1.1) * away / ROWS
    wire = pick(rng, STEEL, IRON, Material((0.08, 0.2, 0.12), roughness=0.5), Material((0.6, 0.6, 0.57), roughness=0.6))
    radius, z = min(0.25 * pitch, 0.5 * rng.uniform(0.7, 1.3) * away / ROWS), 3.0 - away
    ends = (-4.8, z + rng.uniform(-0.5, 0.5)), (4.8, z)
    groups += _mesh(*ends, rng.uniform(1.5, 2.3), pitch, seed % 2 == 0, wire, radius)
    return scene("lattice", seed, groups, *sunlight(rng), _pan(rng, seed // 3 % 2 == 0, 1.5))


def _mesh(start, end, height, pitch, slanted, wire: Material, radius) -> list[Group]:
    """Return wires between two ground points (x, z), `pitch` meters apart in both directions, slanted as in a
    chain-link fence or upright and level as in a net, in panels with posts."""
    start, end, groups = np.asarray(start, float), np.asarray(end, float), []
    length = np.linalg.norm(end - start)
    pieces = max(round(length / 1.2), 1)
    wide = length / pieces
    for piece in range(pieces):
        a, b = (start + (end - start) * (piece + k) / pieces for k in (0, 1))

        def at(s, y, a=a, b=b):
            p = a + (b - a) * (s / wide)
            return p[0], y, p[1]

        wires = []
        if slanted:
            step, first = pitch * 2**0.5, piece * wide  # wires go on from panel to panel
            for k in range(int((first - height) // step), int((first + wide + height) // step) + 1):
                foot = k * step - first  # of one wire that rises to the right, and one to the left
                low, high = max(0.0, -foot), min(height, wide - foot)
                wires += [((foot + low, low), (foot + high, high))] * bool(low < high)
                low, high = max(0.0, foot - wide), min(height, foot)
                wires += [((foot - low, low), (foot - high, high))] * bool(low < high)
        else:
            wires += [((0.0, y), (wide, y)) for y in np.arange(pitch / 2, height, pitch)]
            wires += [((s, 0.0), (s, height)) for s in np.arange(pitch / 2, wide, pitch)]
        prims = [Capsule(at(*p), at(*q), radius, wire) for p, q in wires]
        prims += [
            Cylinder(at(0, 0), at(0, height), 0.025, STEEL),
            Capsule(at(0, height), at(wide, height), 0.012, STEEL),
        ]
        groups.append(Group(prims, name="mesh", casts_shadow=False))
    return groups


def thicket(seed: int, rng: np.random.Generator) -> Scene:
    """Return grass, twigs and far railings before a facade: thin things in depth, but no lattice. The camera strafes
    (even seeds) or turns."""
    groups = yard(rng, seed)
    for x in np.arange(-4.5, 4.5, 0.75):
        for z in (0.6, -0.2, -1.0):
            blades, green = [], Material(vary(rng, (0.16, 0.26, 0.07), 0.4), roughness=0.9)
            for _ in range(45):
                foot = np.array((x + rng.uniform(0, 0.75), 0.0, z + rng.uniform(-0.4, 0.4)))
                tip = foot + (rng.uniform(-0.15, 0.15), rng.uniform(0.25, 0.95), rng.uniform(-0.15, 0.15))
                blades.append(Cone(tuple(foot), tuple(tip), rng.uniform(0.005, 0.012), 0.002, green))
            groups.append(Group(blades, name="grass", casts_shadow=False))
    for z, height in ((-3.4, rng.uniform(1.5, 2.0)), (-4.4, rng.uniform(2.0, 2.5))):
        groups += railing((-6, z), (6, z), height, rng.uniform(0.08, 0.14), pick(rng, IRON, STEEL))
    for x in (-2.5, 2.2):
        twigs, bark = [], bark_material(rng)
        for _ in range(60):
            foot = np.array((x + rng.uniform(-0.5, 0.5), rng.uniform(0.6, 2.2), -2.0 + rng.uniform(-0.5, 0.5)))
            twigs.append(Capsule(tuple(foot), tuple(foot + rng.uniform(-0.5, 0.5, 3)), 0.006, bark))
        groups.append(Group(twigs, name="twigs", casts_shadow=False))
    return scene("thicket", seed, groups, *sunlight(rng), _pan(rng, seed % 2 == 0, 1.3))


def _pan(rng: np.random.Generator, strafes: bool, height: float):
    """Return the paths of eye and target of a camera that strafes, or turns."""
    eye = wave(
        (0, height, 3.0), (0.6 if strafes else 0.1, 0.04, 0.15), (rng.uniform(2.2, 3.5), 1.9, 2.7), rng.random(3)
    )
    across = 0.3 if strafes else 1.4
    return eye, wave((0, 1.2, -3.0), (across, 0.06, 0.0), (rng.uniform(2.0, 3.0), 1.7, 1.0), rng.random(3))


GENERATORS = {f.__name__: f for f in (racing, first_person, posts, platform, strategy, lattice, thicket)}


# ---- effects ------------------------------------------------------------------------------------------------------


def draw_effect(
    kind: str, color: np.ndarray, depth: np.ndarray, camera: Camera, before: Camera, time: float, exposure: float
) -> np.ndarray:
    """Return linear `color` (H, W, 3) with an effect drawn over it as games do: soft sprites hidden by `depth` (H, W),
    that have neither depth nor motion of their own.

    `kind` is "sparks" (bright, additive, on parabolas), "smoke" (rises and grows), "trail" (a blade's sweep) or "rain"
    (streaks). Sprites are placed in the world ahead of the camera `before`, that of the sequence's first frame.
    """
    rng, shown = np.random.default_rng([*kind.encode()]), color.astype(np.float32)
    right, down, ahead = before.world_to_view[:3, :3]
    origin = -before.world_to_view[:3, :3].T @ before.world_to_view[:3, 3]
    near = float(np.quantile(depth[np.isfinite(depth)], 0.3))
    middle, size = origin + near * ahead, near / 6
    for k in range({"sparks": 60, "smoke": 24, "trail": 40, "rain": 150}[kind]):
        a, b, c, age0 = rng.uniform(-1, 1, 4)
        radius, opacity, tone = 0.05, 0.9, (3.0, 1.8, 0.6)
        if kind == "sparks":
            age = (time * 1.4 + age0) % 1.0
            at = middle + size * (
                age * (2.5 * a * right + 2.5 * c * ahead) + (2.2 * age * (age - 0.8) - b * age) * down
            )
        elif kind == "smoke":
            age = (time * 0.5 + age0) % 1.0
            at = middle + size * ((0.5 * a + 0.6 * age) * right + (1 - 2.4 * age + 0.3 * b) * down)
            radius, opacity, tone = 0.25 + 0.6 * age, 0.35 * (1 - age), (0.35, 0.35, 0.36)
        elif kind == "trail":
            turn = 5.0 * time - 0.03 * k
            at = middle + 1.6 * size * (np.cos(turn) * right + np.sin(turn) * down)
            radius, opacity, tone = 0.16, 0.5 * (1 - k / 40), (0.9, 1.1, 1.5)
        else:
            fall = (2.2 * time + age0) % 1.0
            at = origin + near * (0.35 + 0.3 * c) * ahead + size * 3 * a * right + size * (8 * fall - 4) * down
            radius, opacity, tone = 0.02, 0.35, (0.7, 0.75, 0.85)
        long = 8.0 if kind == "rain" else 1.0
        _draw_sprite(
            shown, depth, camera, at, radius * size, long, opacity, np.array(tone) / exposure, kind == "sparks"
        )
    return shown.astype(np.float16)


def _draw_sprite(shown, depth, camera: Camera, at, radius, long, opacity, tone, additive) -> None:
    """Draw a soft disk at a world position, `long` times as high as wide."""
    (px,), (z,) = camera.project(at[None])
    if not z > 0.1:
        return
    height, width = depth.shape
    spread = max(camera.fx * radius / z, 0.4)
    x0, x1 = (int(np.clip(px[0] + s * 3 * spread, 0, width)) for s in (-1, 1))
    y0, y1 = (int(np.clip(px[1] + s * 3 * spread * long, 0, height)) for s in (-1, 1))
    y, x = np.mgrid[y0:y1, x0:x1] + 0.5
    away = ((x - px[0]) / spread) ** 2 + ((y - px[1]) / (spread * long)) ** 2
    share = (opacity * np.exp(-away) * (depth[y0:y1, x0:x1] > z))[..., None].astype(np.float32)
    part = shown[y0:y1, x0:x1]
    part *= 1 if additive else 1 - share
    part += share * tone.astype(np.float32)
