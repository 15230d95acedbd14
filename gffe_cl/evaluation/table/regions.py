"""Where errors are counted: every pixel of a new frame belongs to one region.

Disocclusions are the paper's three ('Disocclusions'): what a new frame shows and the rendered frame does not lies *out
of screen*, or behind something that stands still (*static*) or moves (*dynamic*). On built-in scenes that is exact,
from the renderer. On sequences without G-buffers of the new frame it is what the pipeline itself found: no better than
its masks, but the same for all methods.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gffe_cl.evaluation.metrics import focus_mask
from gffe_cl.evaluation.table.datasets import Footage, Guide, Shot
from gffe_cl.evaluation.table.image_space import pixel_centers
from gffe_cl.frame.camera import Camera
from gffe_cl.opencl.device import Device
from gffe_cl.pipeline.options import Options
from gffe_cl.pipeline.pipeline import Pipeline

# By label; where several would hold, the first does.
REGIONS = {
    "out of screen": "it shows something outside of the rendered frame",
    "static disocclusion": "hidden in the rendered frame behind something that stands still",
    "dynamic disocclusion": "hidden in the rendered frame behind something that moves",
    "silhouettes": "beside a step in depth",
    "dynamic": "surfaces that move by themselves",
    "focus": "shading is wrong although geometry is not (the paper's focus pixels)",
    "rest": "everything else",
}
_LABEL = {name: number for number, name in enumerate(REGIONS)}
_SAME_SURFACE = 0.02  # of the depth
_MUCH = 0.25  # of a pixel: a surface shows there if it has so much of it, in some pixel
_STEP = 0.1  # of the depth, from which two neighbors are two surfaces
_SKY = 1e7  # world units


def masks(labels: np.ndarray) -> dict[str, np.ndarray]:
    """(H, W) bool by name of the region, and "whole"."""
    found = {name: labels == number for name, number in _LABEL.items()}
    return found | {"whole": np.ones(labels.shape, bool)}


def find_labels(footage: Footage, device: Device) -> Iterator[np.ndarray]:
    """Of every moment in order: (H, W) uint8, indices into `REGIONS`."""
    size = (footage.width, footage.height)
    gae = Pipeline(device, *size, Options(shading_correction=False, overlays=False), fps=footage.fps)
    still = Options(motion=False, levels=0, shading_correction=False, overlays=False)
    static = None if footage.exact else Pipeline(device, *size, still, fps=footage.fps)
    for shot in footage.shots():
        for pipeline in filter(None, (gae, static)):
            pipeline.submit(shot.frame)
        for moment in shot.moments:
            made = gae.extrapolate(moment.camera, moment.time)
            found = {name: made.numpy(name) for name in ("color", "depth", "dynamic", "disoccluded")}
            if moment.guide:
                parts = exact_parts(shot, moment.guide)
            else:
                assert static is not None
                seen = static.extrapolate(moment.camera, moment.time).numpy("disoccluded")
                parts = _found_parts(shot, found, seen != 0, made.camera)
            moving = parts["dynamic"]
            parts["focus"] = focus_mask(found["color"], moment.truth, moving, footage.exposure)
            yield labels_of(parts)


def labels_of(parts: dict[str, np.ndarray]) -> np.ndarray:
    """(H, W) uint8 of masks by name; the first of `REGIONS` wins."""
    labels = np.full(parts["dynamic"].shape, _LABEL["rest"], np.uint8)
    for name in reversed(REGIONS):
        if name in parts:
            labels[parts[name]] = _LABEL[name]
    return labels


def exact_parts(shot: Shot, guide: Guide) -> dict[str, np.ndarray]:
    """Return masks from the renderer, all except "focus" and "rest". `shot` is without a window."""
    height, width = guide.depth.shape
    with np.errstate(invalid="ignore"):
        place = pixel_centers(height, width) + guide.motion
        inside = (place >= 0).all(-1) & (place < (width, height)).all(-1) & ~np.isnan(guide.source_depth)
    place = np.where(inside[..., None], place, 0.5)
    visible = np.zeros_like(inside)
    low = np.floor(place - 0.5)
    part = place - 0.5 - low
    for tap in range(4):
        dx, dy = tap & 1, tap >> 1
        weight = np.where(dx, part[..., 0], 1 - part[..., 0]) * np.where(dy, part[..., 1], 1 - part[..., 1])
        x = np.clip(low[..., 0].astype(int) + dx, 0, width - 1)
        y = np.clip(low[..., 1].astype(int) + dy, 0, height - 1)
        visible |= (weight >= _MUCH) & same_surface(shot.frame.depth[y, x], guide.source_depth)
    hidden = inside & ~visible
    nearest = place.astype(int)
    assert shot.moving is not None  # where there are guides
    behind_mover = shot.moving[nearest[..., 1], nearest[..., 0]]
    return {
        "out of screen": ~inside,
        "static disocclusion": hidden & ~behind_mover,
        "dynamic disocclusion": hidden & behind_mover,
        "silhouettes": steps(guide.depth),
        "dynamic": guide.moving,
    }


def same_surface(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Whether depths are one surface's, to 2%; both infinite, or neither."""
    with np.errstate(invalid="ignore"):
        return np.where(np.isinf(b), np.isinf(a), np.abs(a - b) <= _SAME_SURFACE * np.abs(b))


def _found_parts(shot: Shot, found: dict, static_holes: np.ndarray, camera: Camera) -> dict[str, np.ndarray]:
    """Return the same masks by the pipeline's own buffers. `static_holes`: disocclusions if everything counts as
    static."""
    holes = found["disoccluded"] != 0
    height, width = holes.shape
    outside = np.zeros_like(holes)
    outside[holes] = ~shows(shot.frame.camera, width, height, world_positions(camera, found["depth"], holes))
    return {
        "out of screen": outside,
        "static disocclusion": holes & static_holes,
        "dynamic disocclusion": holes,
        "silhouettes": steps(found["depth"]),
        "dynamic": found["dynamic"] != 0,
    }


def steps(depth: np.ndarray) -> np.ndarray:
    """(H, W) bool: pixels with a neighbor, of four, at another depth."""
    found = np.zeros(depth.shape, bool)
    for axis in (0, 1):
        a, b = (np.take(depth, range(k, depth.shape[axis] - 1 + k), axis) for k in (0, 1))
        with np.errstate(invalid="ignore"):
            step = np.where(np.isfinite(a) & np.isfinite(b), np.abs(a - b) > _STEP * np.minimum(a, b), a != b)
        step &= ~(np.isinf(a) & np.isinf(b))
        first = [slice(None)] * 2
        second = [slice(None)] * 2
        first[axis], second[axis] = slice(None, -1), slice(1, None)
        found[tuple(first)] |= step
        found[tuple(second)] |= step
    return found


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
