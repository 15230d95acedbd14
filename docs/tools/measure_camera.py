"""Measure errors of predicted cameras, and their cost, by `--camera-order`.

    python docs/tools/measure_camera.py                  prints the table of docs/deviations.md
    python docs/tools/measure_camera.py --write          puts it there

A path is that of a built-in scene, steady or shaken in one of three ways. What shakes is a mass on a damped spring,
pushed at random. Errors are distances in pixels of what the predicted and the true camera
show at the image's corners, `DISTANCE` before the camera, at t + ½ and t + 1. PSNR is of all new frames
against the truth, pooled.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from pages import table, write_tables
from scipy.signal import lfilter

from gffe_cl.captures.scenes import SCENES, SceneFrames, SceneRenderer, load_scene
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.camera_prediction import POSES, predict_camera_at, rotation_matrix
from gffe_cl.engine.opencl.device import Device, open_device
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.lab.compare import NO_HISTORY
from gffe_cl.lab.metrics import to_display

ALPHAS = (0.5, 1.0)
ORDERS = (1, 2, None)
HEADS = (
    *("path", "α", "px off: order 1", "order 2", "auto"),
    *("PSNR, dB: camera known", "order 1", "order 2", "auto"),
)
DISTANCE = 3.0  # world units
RATE = 960  # steps per second of the shake
# Springs of the shake: hertz, damping, and root mean square in radians of each turn and in world units of each move.
SHAKES: dict[str, list[tuple[float, float, float, float]]] = {
    "steady": [],
    "hand-held": [(1.3, 0.4, 0.004, 0.008), (7.0, 0.15, 0.0012, 0.0)],
    "walking": [(1.9, 0.08, 0.006, 0.02), (3.8, 0.1, 0.002, 0.008)],
    "tram's cab": [(1.1, 0.15, 0.002, 0.01), (10.5, 0.3, 0.0006, 0.001)],
}


class ShakenFrames(SceneFrames):
    """Frames of a scene whose camera shakes."""

    def __init__(self, renderer: SceneRenderer, shake: Callable[[float], Camera]):
        super().__init__(renderer)
        self.display_camera = shake


def shaken(path: Callable[[float], Camera], springs, seconds: float, seed: int) -> Callable[[float], Camera]:
    """Return a camera on `path` (by seconds) on which `springs` act."""
    rng, count = np.random.default_rng(seed), int((seconds + 4) * RATE)
    moved = np.zeros((count, 6))
    for hertz, damping, turn, move in springs:
        angular = 2 * np.pi * hertz / RATE
        feedback = [1 + 2 * damping * angular, -2 - 2 * damping * angular + angular**2, 1.0]
        swing = lfilter([1.0], feedback, rng.normal(size=(count, 6)), axis=0)[2 * RATE :]
        moved[: len(swing)] += swing / swing.std(axis=0) * ([turn] * 3 + [move] * 3)

    def at(time: float) -> Camera:
        camera = path(time)
        k, rest = divmod(time * RATE, 1)
        offset = moved[int(k)] * (1 - rest) + moved[int(k) + 1] * rest
        matrix = camera.world_to_view.copy()
        matrix[:3] = rotation_matrix(offset[:3].tolist()) @ matrix[:3]
        matrix[:3, 3] += offset[3:]
        return replace(camera, world_to_view=matrix)

    return at


def corner_error(predicted: Camera, true: Camera, size: tuple[int, int]) -> float:
    """Return the distance in pixels, mean of the four corners."""
    corners = np.array([(x, y) for x in (0.0, size[0]) for y in (0.0, size[1])])
    seen = predicted.project(true.unproject(corners, np.full(4, DISTANCE)))[0]
    return float(np.linalg.norm(seen - corners, axis=1).mean())


def pose_errors(camera: Callable[[float], Camera], times: list[float], size) -> dict:
    """Return corner errors by order and α; `times` are those of rendered frames."""
    found = defaultdict(list)
    path = [camera(time) for time in times]
    for k in range(NO_HISTORY, len(times) - 1):
        known = slice(max(k + 1 - POSES, 0), k + 1)
        for alpha in ALPHAS:
            time = times[k] + alpha * (times[k + 1] - times[k])
            for order in ORDERS:
                made = predict_camera_at(time, path[known][::-1], times[known][::-1], order)
                found[order, alpha].append(corner_error(made, camera(time), size))
    return found


def rendered_errors(device: Device, frames: SceneFrames, times: list[float], size, exposure: float) -> dict:
    """Return squared errors of display values by order ("known": of the true camera) and α, means of frames."""
    pipeline = Pipeline(device, *size, Options(shading_correction=False), fps=1 / (times[1] - times[0]))
    pipeline.exposure, found, before, path = exposure, defaultdict(list), None, []
    for k, time in enumerate(times[:-1]):
        before = frames.rendered(time, before)
        pipeline.submit(before)
        path.append(before.shown_camera)
        known = slice(max(k + 1 - POSES, 0), k + 1)
        for alpha in ALPHAS if k >= NO_HISTORY else ():
            then = time + alpha * (times[k + 1] - time)
            truth = to_display(frames.truth(then).read("color"), exposure)
            for order in ("known", *ORDERS):
                if order == "known":
                    camera = frames.display_camera(then)
                else:
                    camera = predict_camera_at(then, path[known][::-1], times[known][::-1], order)
                shown = to_display(pipeline.extrapolate(camera, then).numpy("color"), exposure)
                found[order, alpha].append(float(np.square(shown - truth).mean(dtype=np.float64)))
    return found


def scene_paths(setting, device: Device) -> Iterator[tuple[str, dict, dict]]:
    """Yield each way to shake: its name, pose errors and squared errors of all scenes."""
    times = [k / setting.fps for k in range(setting.frames)]
    for name, springs in SHAKES.items():
        poses, squared = defaultdict(list), defaultdict(list)
        for number, scene_name in enumerate(setting.scenes):
            print(f"\r{name}, {scene_name}".ljust(40), end="", file=sys.stderr, flush=True)
            scene = load_scene(scene_name, setting.seed)

            def path(time, scene=scene):
                return scene.camera(time, *setting.size)

            camera = shaken(path, springs, times[-1], setting.seed + number)
            for key, errors in pose_errors(camera, times, setting.size).items():
                poses[key] += errors
            frames = ShakenFrames(SceneRenderer(device, scene, *setting.size, 4), camera)
            for key, errors in rendered_errors(device, frames, times, setting.size, scene.exposure).items():
                squared[key] += errors
        yield name, poses, squared


def rows(name: str, poses: dict, squared: dict) -> Iterator[tuple[str, ...]]:
    for alpha in ALPHAS:
        figures = []
        for order in ORDERS:
            middle, most = np.percentile(poses[order, alpha], (50, 95))
            figures.append(f"{middle:.2f} / {most:.2f}")
        for order in ("known", *ORDERS):
            figures.append(f"{-10 * np.log10(np.mean(squared[order, alpha])):.2f}")
        yield name, f"{alpha:g}", *figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="into docs/deviations.md")
    parser.add_argument("--scenes", nargs="*", choices=SCENES, default=list(SCENES))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--fps", type=float, default=30.0)
    parser.add_argument("--size", type=int, nargs=2, default=(480, 270))
    parser.add_argument("--device")
    setting = parser.parse_args()
    device = open_device(setting.device)
    made = table(HEADS, [line for found in scene_paths(setting, device) for line in rows(*found)])
    print(f"\n{made}")
    if setting.write:
        write_tables("deviations.md", {"camera": made})


if __name__ == "__main__":
    main()
