"""How well disocclusions are filled on the built-in scenes (`gffe study --disocclusions`).

A pixel that no fragment of the rendered frame reaches is *out of screen* if what it shows lies outside the
rendered image, else a *static* disocclusion if treating everything as static leaves it empty too, else a
*dynamic* one (paper: 'Disocclusions'). It was *seen before* if its surface is static and shows in an earlier
rendered frame from which backgrounds are collected.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from gffe_cl.buffers import BY_HOLE_FILLING
from gffe_cl.camera import Camera
from gffe_cl.evaluation.methods import submitted_frames
from gffe_cl.metrics import METRICS, RegionErrors, display_values
from gffe_cl.opencl.device import Device
from gffe_cl.options import Options
from gffe_cl.pipeline import Pipeline
from gffe_cl.scenes import SceneFrames, SceneRenderer, load_scene

METHODS: dict[str, Options] = {
    "downsample, L = 0": Options(levels=0, hole_filling="downsample"),
    "downsample, L = 1": Options(levels=1, hole_filling="downsample"),
    "downsample, L = 2": Options(levels=2, hole_filling="downsample"),
    "downsample, L = 3": Options(levels=3, hole_filling="downsample"),
    "push-pull, L = 0": Options(levels=0, hole_filling="push-pull"),
    "push-pull, L = 2": Options(levels=2, hole_filling="push-pull"),
    "far-side, L = 0": Options(levels=0),
    "far-side, L = 1": Options(levels=1),
    "far-side, L = 2": Options(levels=2),
    "far-side, L = 3": Options(levels=3),
}
CATEGORIES = ("static", "dynamic", "out of screen", "seen before")
_METRIC = METRICS["psnr"]
_SAME_SURFACE = 0.01  # relative depth
_SKY = 1e7  # world units


@dataclass
class DisocclusionStudy:
    """Pooled over the frames of one scene and seed, or over several of them.

    `errors`: by method, over the pixels of each category, and "whole"; `unfilled`: holes that the background left, by
    method, out of screen apart.
    """

    errors: dict[str, RegionErrors]
    unfilled: dict[str, int]

    def psnr(self, method: str, category: str) -> float:
        """dB over the pixels of a category; NaN if there are none."""
        return self.errors[method].figure(_METRIC.name, category)

    @property
    def pixels(self) -> dict[str, int]:
        """How many there are of each category, and "all" of the image."""
        counts = next(iter(self.errors.values())).pixels
        return {"all" if name == "whole" else name: count for name, count in counts.items()}

    @classmethod
    def pooled(cls, studies: list[DisocclusionStudy]) -> DisocclusionStudy:
        """The sum of several."""
        errors = {m: RegionErrors.pooled(study.errors[m] for study in studies) for m in METHODS}
        return cls(errors, {m: sum(study.unfilled[m] for study in studies) for m in METHODS})

    def to_json(self) -> dict:
        """`squared_error`: summed squared error of display values (mean over RGB), by method and category."""
        sums = {m: {c: errors.sums[_METRIC.name][c] for c in CATEGORIES} for m, errors in self.errors.items()}
        return {"pixels": self.pixels, "squared_error": sums, "unfilled": self.unfilled}


def study_disocclusions(
    device: Device,
    name: str,
    seed: int,
    width: int,
    height: int,
    frames: int,
    fps: float = 30.0,
    alpha: float = 0.5,
    on_frame: Callable[[], None] = lambda: None,
) -> DisocclusionStudy:
    """Extrapolate `frames` rendered frames of a built-in scene by every method and measure the disocclusions."""
    scene = load_scene(name, seed)
    moving = np.array([group.motion.moves for group in scene.groups] + [False])  # [-1] is the sky
    scene_frames = SceneFrames(SceneRenderer(device, scene, width, height))
    pipelines = {
        method: Pipeline(device, width, height, replace(options, shading_correction=False), fps=fps)
        for method, options in METHODS.items()
    }
    all_static = Pipeline(device, width, height, Options(motion=False, levels=0, shading_correction=False), fps=fps)
    errors = {method: RegionErrors() for method in METHODS}
    unfilled = dict.fromkeys(METHODS, 0)
    seen = []  # (camera, depth) of the rendered frames so far
    everyone = (*pipelines.values(), all_static)
    for _, frame, time in submitted_frames(scene_frames, everyone, frames, fps, alpha, on_frame):
        if time is not None:
            camera = scene_frames.display_camera(time)
            future = scene_frames.truth(time).numpy()
            truth = display_values(future.color, scene.exposure)
            made = {method: pipeline.extrapolate(camera, time) for method, pipeline in pipelines.items()}
            holes = made["far-side, L = 0"].numpy("disoccluded") > 0
            static_holes = all_static.extrapolate(camera, time).numpy("disoccluded") > 0
            masks = _categories(holes, static_holes, camera, future, moving, frame.camera, seen)
            regions = masks | {"whole": np.ones(holes.shape, bool)}
            for method, extrapolated in made.items():
                shown = display_values(extrapolated.numpy("color"), scene.exposure)
                errors[method].add(shown, truth, regions, [_METRIC])
                left = extrapolated.numpy("filled_by") == BY_HOLE_FILLING
                unfilled[method] += int((left & ~masks["out of screen"]).sum())
        if not frame.reset:
            seen.append((frame.camera, frame.depth))
    return DisocclusionStudy(errors, unfilled)


def shows(camera: Camera, width: int, height: int, world_pos: np.ndarray) -> np.ndarray:
    """(N,) bool: whether world positions (N, 3) lie before `camera` and within its image, hidden or not."""
    px, depth = camera.project(world_pos)
    with np.errstate(invalid="ignore"):
        return (depth > 0) & (px >= 0).all(-1) & (px < (width, height)).all(-1)


def world_positions(camera: Camera, depth: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """(N, 3) of the pixels of `mask`; sky is put very far away."""
    y, x = np.nonzero(mask)
    z = depth[mask].astype(np.float64)
    return camera.unproject(np.stack([x + 0.5, y + 0.5], -1), np.where(np.isinf(z), _SKY, z))


def _categories(holes, static_holes, camera, future, moving, source_camera, seen) -> dict[str, np.ndarray]:
    height, width = holes.shape
    y, x = np.nonzero(holes)
    sky = np.isinf(future.depth[holes])
    still = ~moving[future.object_id[holes]]
    world = world_positions(camera, future.depth, holes)

    def seen_in(other, other_depth):
        at, z = other.project(world)
        inside = shows(other, width, height, world)
        cell = np.where(inside[:, None], at, 0).astype(int)
        d = other_depth[cell[:, 1], cell[:, 0]]
        same = np.where(sky, np.isinf(d), np.abs(d - z) <= _SAME_SURFACE * z)
        return inside & same

    outside = ~shows(source_camera, width, height, world)
    before = np.zeros(len(x), bool)
    for other, other_depth in seen:
        before |= seen_in(other, other_depth)
    parts = {
        "static": ~outside & static_holes[holes],
        "dynamic": ~outside & ~static_holes[holes],
        "out of screen": outside,
        "seen before": ~outside & before & still,
    }
    masks = {}
    for category, part in parts.items():
        masks[category] = np.zeros_like(holes)
        masks[category][y[part], x[part]] = True
    return masks
