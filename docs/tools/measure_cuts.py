"""Measure the detection of cuts and teleports, which fast motion and changing light must not trigger.

    python docs/tools/measure_cuts.py             prints the tables of docs/cuts.md
    python docs/tools/measure_cuts.py --write     puts them there

Frames of the built-in scenes, of seeds that the detection was not made with. Every one is submitted to a pipeline as a
program would, with nothing told.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from pages import table, write_tables

from gffe_cl.captures.scenes import SCENES, SceneRenderer, load_scene
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.opencl.device import Device, open_device
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.scene_cuts import COUNTED, LEAST_OVERLAP

SIZE, SEEDS, SAMPLES = (240, 136), (11, 12, 13), 2
SECTION = 12  # frames of one kind of motion
STEP = 1 / 30
SHOT_TIMES = (0.5, 3.0, 5.5)  # s
JOINS, TELEPORTS = 180, 60
CHEAP = Options(levels=0, hole_filling="none", soft_silhouettes=False, hidden_parts=False, shading_correction=False)

# Kinds of motion: seconds between frames, and degrees that the camera turns and rolls beside its path.
MOTIONS = {
    "along its path, 30 fps": (1 / 30, 0, 0),
    "along its path, 10 fps": (1 / 10, 0, 0),
    "along its path, 4 fps": (1 / 4, 0, 0),
    "along its path, 2 fps": (1 / 2, 0, 0),
    "whip pan, 15° a frame": (1 / 30, 15, 0),
    "whip pan, 35° a frame": (1 / 15, 35, 0),
    "whip pan, 55° a frame": (1 / 30, 55, 0),
    "roll, 25° a frame": (1 / 30, 4, 25),
}


@dataclass
class Tally:
    """Number of frames of one kind, how many were taken for cuts, and the counts of each."""

    frames: int = 0
    cuts: int = 0
    depth: list[float] = field(default_factory=list)
    contrast: list[float] = field(default_factory=list)

    def add(self, is_cut: bool, counts: dict[str, int]) -> None:
        self.frames += 1
        self.cuts += is_cut
        if counts["compared"] and counts["inside"] >= LEAST_OVERLAP * counts["valid"]:
            self.depth.append(counts["depth_right"] / counts["compared"])
            self.contrast.append(counts["contrast_right"] / max(counts["with_contrast"], 1))


class Judge:
    """A pipeline that frames are submitted to."""

    def __init__(self, device: Device):
        self.pipeline = Pipeline(device, *SIZE, CHEAP)
        self._time = 0.0

    def take(self, frame: RenderedFrame, reset: bool = False) -> tuple[bool, dict[str, int]]:
        """Return whether a frame is found to be a cut, and the counts. Times are made anew."""
        self._time += STEP
        self.pipeline.submit(replace(frame, time=self._time, reset=reset))
        counts = self.pipeline.stages["scene_cuts"].read("counts").sum(0)
        return self.pipeline.is_cut, dict(zip(COUNTED, counts.tolist(), strict=True))


class Shots:
    """Frames of one scene and seed, with cameras of one's own."""

    def __init__(self, device: Device, name: str, seed: int):
        self.scene = load_scene(name, seed)
        self._renderer = SceneRenderer(device, self.scene, *SIZE, SAMPLES)

    def camera(self, time: float, yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0) -> Camera:
        return turned(self.scene.camera(time, *SIZE), yaw, pitch, roll)

    def frame(self, time: float, camera: Camera, before: float, camera_before: Camera) -> RenderedFrame:
        image = self._renderer.render(time, camera, before, camera_before).numpy()
        return RenderedFrame(image.color, image.depth, image.motion, camera, time)

    def shot(self, time: float, count: int) -> list[RenderedFrame]:
        """Return frames along the path; the first one's vectors refer to a frame that nobody sees."""
        times = [time + k * STEP for k in range(-1, count)]
        cameras = [self.camera(t) for t in times]
        return [self.frame(times[k], cameras[k], times[k - 1], cameras[k - 1]) for k in range(1, count + 1)]


def turned(camera: Camera, *degrees: float) -> Camera:
    """Return the camera after a turn to the side, upwards, and around the direction of view."""
    (a, b, c), matrix = np.radians(degrees), np.eye(4)
    yaw = [[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]]
    pitch = [[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]]
    roll = [[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]]
    matrix[:3, :3] = np.array(roll) @ pitch @ yaw
    return replace(camera, world_to_view=matrix @ camera.world_to_view)


# ---- no cuts ---------------------------------------------------------------------------------------------


def fast_frames(shots: Shots) -> Iterator[tuple[str, RenderedFrame]]:
    """Yield a clip without a cut: one kind of motion after the other; pans go to and fro."""
    time, yaw, roll, before = 0.4, 0.0, 0.0, None
    for kind, (step, turn, roll_by) in MOTIONS.items():
        for k in range(SECTION):
            time += step
            yaw += turn if k % 4 < 2 else -turn
            roll += roll_by if k % 4 < 2 else -roll_by
            camera = shots.camera(time, yaw, 0.0, roll)
            frame = shots.frame(time, camera, *(before or (time, camera)))
            yield kind, frame
            before = (time, camera)


def lit(frame: RenderedFrame, k: int, rng: np.random.Generator) -> RenderedFrame:
    """Return a frame under a strobe of changing colors, with a flash over a part of the image every other frame."""
    light = np.ones((*frame.depth.shape, 3)) * (20.0 if k % 2 else 0.05) * rng.uniform(0.3, 3.0, 3)
    y, x = np.mgrid[: frame.depth.shape[0], : frame.depth.shape[1]]
    away = np.hypot(x - rng.uniform(0, SIZE[0]), y - rng.uniform(0, SIZE[1])) / rng.uniform(20, 120)
    light *= 1 + 300 * np.exp(-(away**2))[..., None] * rng.uniform(0.2, 1.0, 3) * (rng.random() < 0.5)
    return replace(frame, color=np.minimum(frame.color * light, 6e4).astype(np.float16))


def without_cuts(device: Device, seeds: tuple[int, ...]) -> dict[str, tuple[Tally, Tally]]:
    """Return two tallies by kind of motion: as rendered, and under changing light."""
    found = defaultdict(lambda: (Tally(), Tally()))
    for name in SCENES:
        for seed in seeds:
            rng, judges = np.random.default_rng(seed), (Judge(device), Judge(device))
            for k, (kind, frame) in enumerate(fast_frames(Shots(device, name, seed))):
                for judge, tally, shown in zip(judges, found[kind], (frame, lit(frame, k, rng)), strict=True):
                    told = judge.take(shown, reset=k == 0)
                    if k:
                        tally.add(*told)
    return found


# ---- cuts --------------------------------------------------------------------------------------------------


def matched(frame: RenderedFrame, other: RenderedFrame) -> RenderedFrame:
    """Return a frame with the mean and the spread of the colors of another one."""
    a, b = (np.log(f.color.astype(np.float64) + 1e-3) for f in (frame, other))
    axes = (0, 1)
    changed = (a - a.mean(axes)) / (a.std(axes) + 1e-6) * b.std(axes) + b.mean(axes)
    return replace(frame, color=np.clip(np.exp(changed) - 1e-3, 0, 6e4).astype(np.float16))


def joined(device: Device, seeds: tuple[int, ...], rng: np.random.Generator) -> dict[str, Tally]:
    """Return tallies of joins of two shots, with the second one's own vectors and with none; every third in similar
    colors."""
    shots = {
        (name, seed, time): Shots(device, name, seed).shot(time, 3)
        for name in SCENES
        for seed in seeds
        for time in SHOT_TIMES
    }
    keys, judge = list(shots), Judge(device)
    found: dict[str, Tally] = defaultdict(Tally)
    for k in range(JOINS):
        name, _, time = first = keys[rng.integers(len(keys))]
        others = {
            "to another scene": [key for key in keys if key[0] != name],
            "to the scene of another seed, same time": [
                key for key in keys if key[::2] == (name, time) and key != first
            ],
            "to another scene, similar colors": [key for key in keys if key[0] != name],
        }
        kind = list(others)[k % 3]
        second = others[kind][rng.integers(len(others[kind]))]
        new = shots[second][1]
        if "similar" in kind:
            new = matched(new, shots[first][-1])
        if vectors := k // 3 % 2:
            new = replace(new, motion=np.zeros_like(new.motion))
        for n, frame in enumerate(shots[first]):
            judge.take(frame, reset=n == 0)
        found[f"{kind}, vectors {'zero' if vectors else 'of the new shot'}"].add(*judge.take(new))
    return found


def teleported(device: Device, seeds: tuple[int, ...], rng: np.random.Generator) -> dict[str, Tally]:
    """Return tallies of teleports within a scene, to a place far away or to where nothing of the last frame is seen."""
    judge, found = Judge(device), defaultdict(Tally)
    names = list(SCENES)
    for k in range(TELEPORTS):
        vectors = ("true", "zero", "of the new shot")[k % 3]
        shots = Shots(device, names[k // 3 % len(names)], seeds[k % len(seeds)])
        time = rng.uniform(0.3, 2.0)
        old = shots.shot(time, 3)
        last, now = old[-1], old[-1].time + STEP
        while True:  # until it is a teleport
            angles = rng.uniform(-180, 180), rng.uniform(-15, 15)
            place, before = shots.camera(now + rng.uniform(2, 8), *angles), shots.camera(now + 2, *angles)
            new = shots.frame(now, place, last.time, last.camera)
            if is_teleport(new, last):
                break
        if vectors == "of the new shot":
            before = replace(before, world_to_view=place.world_to_view)
            new = replace(new, motion=shots.frame(now, place, last.time, turned(before, 1.0, 0.0, 0.0)).motion)
        if vectors == "zero":
            new = replace(new, motion=np.zeros_like(new.motion))
        for n, frame in enumerate(old):
            judge.take(frame, reset=n == 0)
        found[f"teleport, vectors {vectors}"].add(*judge.take(new))
    return found


def is_teleport(new: RenderedFrame, last: RenderedFrame) -> bool:
    """Return whether by the true vectors less than 5% of the view was seen before, or the camera moved by one and a
    half times the median depth."""
    height, width = new.depth.shape
    y, x = np.mgrid[:height, :width] + 0.5
    px = np.nan_to_num(np.stack([x, y], -1) + new.motion, nan=-1.0)
    inside = ((px >= 0) & (px < (width, height))).all(-1)
    there = px[inside].astype(int)
    before = last.depth[there[:, 1], there[:, 0]]
    world = new.camera.unproject(np.stack([x, y], -1)[inside], np.minimum(new.depth[inside], 1e6))
    expected = last.camera.project(world)[1]
    seen = (np.abs(np.minimum(before, 1e6) / expected - 1) < 0.05).sum() / new.depth.size
    step = np.linalg.norm(new.camera.position - last.camera.position)
    return bool(seen < 0.05 or step > 1.5 * np.median(new.depth))


# ---- tables ------------------------------------------------------------------------------------------------


def no_cuts_table(found: dict[str, tuple[Tally, Tally]]) -> str:
    heads = (
        *("motion", "frames", "taken for cuts", "least share of right depths"),
        *("under changing light: taken for cuts", "least share of right contrasts"),
    )
    rows = []
    for kind, (plain, light) in found.items():
        figures = str(plain.frames), str(plain.cuts), f"{min(plain.depth):.2f}"
        rows.append((kind, *figures, f"{light.cuts} of {light.frames}", f"{min(light.contrast):.2f}"))
    plain, light = ([tallies[k] for tallies in found.values()] for k in (0, 1))
    totals = [sum(getattr(t, what) for t in part) for part in (plain, light) for what in ("frames", "cuts")]
    rows.append(("all", str(totals[0]), str(totals[1]), "", f"{totals[3]} of {totals[2]}", ""))
    return table(heads, rows)


def cuts_table(found: dict[str, Tally]) -> str:
    rows = []
    for kind, tally in sorted(found.items()):
        most = np.argmax(tally.depth) if tally.depth else None
        figures = ("no overlap", "") if most is None else (f"{tally.depth[most]:.2f}", f"{tally.contrast[most]:.2f}")
        rows.append((kind, str(tally.frames), str(tally.cuts), *figures))
    totals = (str(sum(getattr(t, what) for t in found.values())) for what in ("frames", "cuts"))
    rows.append(("all", *totals, "", ""))
    return table(("cut", "how many", "found", "greatest share of right depths", "right contrasts there"), rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="put the tables into docs/cuts.md")
    parser.add_argument("--tables", nargs="+", choices=("cuts", "no-cuts"), default=("cuts", "no-cuts"))
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS)
    parser.add_argument("--device")
    given = parser.parse_args()
    device, seeds, rng = open_device(given.device), tuple(given.seeds), np.random.default_rng(1)
    made = {
        "cuts": lambda: cuts_table(joined(device, seeds, rng) | teleported(device, seeds, rng)),
        "no-cuts": lambda: no_cuts_table(without_cuts(device, seeds)),
    }
    for name in given.tables:
        found = made[name]()
        print(f"\n{found}", flush=True)
        if given.write:
            write_tables("cuts.md", {name: found})


if __name__ == "__main__":
    main()
