"""How well disocclusions are filled on the built-in scenes (`gffe study --disocclusions`).

A pixel that no fragment of the rendered frame reaches is *out of screen* if what it shows lies outside the
rendered image, else a *static* disocclusion if treating everything as static leaves it empty too, else a
*dynamic* one (paper: 'Disocclusions'). It was *seen before* if its surface is static and shows in an earlier
rendered frame from which backgrounds are collected.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from gffe_cl.buffers import BY_HOLE_FILLING
from gffe_cl.camera import Camera
from gffe_cl.evaluation.methods import submitted_frames
from gffe_cl.metrics import display_values
from gffe_cl.opencl.device import Device
from gffe_cl.options import Options
from gffe_cl.pipeline import Pipeline
from gffe_cl.scenes import SceneRenderer, load_scene

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
_SAME_SURFACE = 0.01  # relative depth
_SKY = 1e7  # world units


@dataclass
class DisocclusionStudy:
    """Pooled over the frames of one scene and seed, or over several of them.

    `pixels`: how many pixels of each category, and "all" of the image; `squared_error`: summed squared error
    of display values (mean over RGB), by method and category; `unfilled`: holes that the background left, by
    method, out of screen apart.
    """

    pixels: dict[str, int]
    squared_error: dict[str, dict[str, float]]
    unfilled: dict[str, int]

    def psnr(self, method: str, category: str) -> float:
        """dB over the pixels of a category; NaN if there are none."""
        if not self.pixels[category]:
            return float("nan")
        return -10 * float(np.log10(self.squared_error[method][category] / self.pixels[category] + 1e-12))

    @classmethod
    def pooled(cls, studies: list[DisocclusionStudy]) -> DisocclusionStudy:
        """The sum of several."""
        return cls(
            {c: sum(s.pixels[c] for s in studies) for c in (*CATEGORIES, "all")},
            {m: {c: sum(s.squared_error[m][c] for s in studies) for c in CATEGORIES} for m in METHODS},
            {m: sum(s.unfilled[m] for s in studies) for m in METHODS},
        )


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
    renderer = SceneRenderer(device, scene, width, height)
    pipelines = {
        method: Pipeline(device, width, height, replace(options, shading_correction=False), fps=fps)
        for method, options in METHODS.items()
    }
    all_static = Pipeline(device, width, height, Options(motion=False, levels=0, shading_correction=False), fps=fps)
    pixels = dict.fromkeys((*CATEGORIES, "all"), 0)
    errors: dict = {method: defaultdict(float) for method in METHODS}
    unfilled = dict.fromkeys(METHODS, 0)
    seen = []  # (camera, depth) of the rendered frames so far
    everyone = (*pipelines.values(), all_static)
    for frame, image, time in submitted_frames(renderer, everyone, frames, fps, alpha, on_frame):
        if time is not None:
            camera = scene.camera(time, width, height)
            future = renderer.render(time, camera).numpy()
            truth = display_values(future.color, scene.exposure)
            made = {method: pipeline.extrapolate(camera, time) for method, pipeline in pipelines.items()}
            holes = made["far-side, L = 0"].numpy("disoccluded") > 0
            static_holes = all_static.extrapolate(camera, time).numpy("disoccluded") > 0
            masks = _categories(holes, static_holes, camera, future, moving, frame.camera, seen)
            for category, mask in masks.items():
                pixels[category] += int(mask.sum())
            pixels["all"] += holes.size
            for method, extrapolated in made.items():
                shown = display_values(extrapolated.numpy("color"), scene.exposure)
                squared = np.square(shown - truth).mean(-1)
                for category, mask in masks.items():
                    errors[method][category] += float(squared[mask].sum())
                left = extrapolated.numpy("filled_by") == BY_HOLE_FILLING
                unfilled[method] += int((left & ~masks["out of screen"]).sum())
        if not frame.reset:
            seen.append((frame.camera, image.depth))
    return DisocclusionStudy(pixels, {m: {c: e[c] for c in CATEGORIES} for m, e in errors.items()}, unfilled)


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
