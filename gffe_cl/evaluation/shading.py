"""What the shading correction network is worth on the built-in scenes (`gffe study --shading`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from gffe_cl.evaluation.methods import submitted_frames
from gffe_cl.metrics import FOCUS, RegionErrors, display_values, focus_mask, measurable, shading_regions
from gffe_cl.opencl.device import Device
from gffe_cl.options import Options
from gffe_cl.pipeline import Pipeline
from gffe_cl.scenes import SceneFrames, SceneRenderer, load_scene

# Without and with shading correction; and with it, but without its focus mask.
METHODS = ("GAE", "final", "no focus mask")
REGIONS = (FOCUS, "disoccluded", "whole")
_CROP = 3  # a picture shows a third of the frame each way
_CROPS = 2  # of each scene and seed


@dataclass
class ShadingStudy:
    """Of one scene and seed: `errors` by method, pooled over frames; `corrected`: share of the pixels that the
    network's focus mask covers; `crops`: where the most was wrong, captions and display values."""

    scene: str
    seed: int
    errors: dict[str, RegionErrors]
    corrected: float
    crops: list[list[tuple[str, np.ndarray]]] = field(default_factory=list)

    def figures(self) -> dict:
        """For JSON: by method and region `share` and every metric."""
        by_method = {method: errors.figures() for method, errors in self.errors.items()}
        return {"scene": self.scene, "seed": self.seed, "corrected": self.corrected, "methods": by_method}


def study_shading(
    device: Device,
    name: str,
    seed: int,
    width: int,
    height: int,
    frames: int,
    fps: float = 30.0,
    alpha: float = 0.5,
    on_frame: Callable[[], None] = lambda: None,
    options: Options | None = None,
) -> ShadingStudy:
    """Extrapolate `frames` rendered frames of a built-in scene and measure at t + α. `options` choose the network."""
    scene = load_scene(name, seed)
    scene_frames = SceneFrames(SceneRenderer(device, scene, width, height))
    pipeline = Pipeline(device, width, height, options or Options(shading_correction=True), fps=fps)
    pipeline.exposure = scene.exposure
    pipeline.keep(["correction.refined"])
    errors = {method: RegionErrors() for method in METHODS}
    corrected, crops = [], []
    metrics = measurable()
    for k, _, time in submitted_frames(scene_frames, [pipeline], frames, fps, alpha, on_frame):
        if time is None:
            continue
        truth = scene_frames.truth(time).read("color")
        made = pipeline.extrapolate(scene_frames.display_camera(time), time)
        predicted = pipeline.stages["correction"].read("focus_mask").astype(np.float32)
        refined = pipeline.stages["correction"].read("refined")[..., :3]
        focus = focus_mask(made.numpy("gae"), truth, made.numpy("dynamic"), scene.exposure)
        regions = shading_regions(focus, made.numpy("disoccluded") != 0)
        shown = display_values(truth, scene.exposure)
        pictures = {}
        for method, color in zip(METHODS, (made.numpy("gae"), made.numpy("color"), refined), strict=True):
            pictures[method] = display_values(color, scene.exposure)
            errors[method].add(pictures[method], shown, regions, metrics)
        corrected.append(float((predicted > 0).mean()))
        pictures |= {
            "ground truth": shown,
            "focus mask": predicted,
            "true focus mask": regions[FOCUS].astype(np.float32),
        }
        crops += _crops(pictures, regions[FOCUS], k)
    return ShadingStudy(name, seed, errors, float(np.mean(corrected)), _chosen(crops))


def _crops(pictures: dict[str, np.ndarray], focus: np.ndarray, frame: int) -> list[tuple]:
    """The parts of a frame that hold the most focus pixels, apart from each other: (pixels, x, y, size, pictures)."""
    height, width = focus.shape
    h, w = -(-height // _CROP), -(-width // _CROP)
    sums = np.pad(focus, ((1, 0), (1, 0))).astype(np.int64).cumsum(0).cumsum(1)
    inside = sums[h:, w:] - sums[:-h, w:] - sums[h:, :-w] + sums[:-h, :-w]
    found = []
    for _ in range(_CROPS):
        y, x = np.unravel_index(np.argmax(inside), inside.shape)
        images = [(f"{name}, frame {frame}", p[y : y + h, x : x + w].copy()) for name, p in pictures.items()]
        found.append((int(inside[y, x]), int(x), int(y), (w, h), images))
        inside[max(y - h + 1, 0) : y + h, max(x - w + 1, 0) : x + w] = -1
    return found


def _chosen(crops: list[tuple]) -> list[list[tuple[str, np.ndarray]]]:
    """The best, whatever their frames, that do not overlap."""
    chosen: list[tuple] = []
    for crop in sorted(crops, key=lambda c: -c[0]):
        _, x, y, (w, h), _ = crop
        if crop[0] > 0 and all(abs(x - c[1]) >= w or abs(y - c[2]) >= h for c in chosen):
            chosen.append(crop)
    return [crop[-1] for crop in chosen[:_CROPS]]
