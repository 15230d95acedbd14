"""Regions of the frames of a footage: exact on built-in scenes, elsewhere as the pipeline finds them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.lab.metrics import focus_mask
from gffe_cl.lab.metrics.regions import labels_of, same_surface, shows, steps, world_positions
from gffe_cl.lab.table.datasets import Footage, Guide, Shot
from gffe_cl.lab.table.image_space import pixel_centers

_MUCH = 0.25  # of a pixel: a surface shows there if it has so much of it, in some pixel


def find_labels(footage: Footage, device: Device) -> Iterator[np.ndarray]:
    """Yield the labels of every moment in order: (H, W) uint8, indices into `REGIONS`."""
    size, more = (footage.width, footage.height), {"fps": footage.fps, "format": footage.encoding.format}
    gae = Pipeline(device, *size, Options(shading_correction=False, overlays=False), **more)
    still = Options(motion=False, levels=0, shading_correction=False, overlays=False)
    static = None if footage.exact else Pipeline(device, *size, still, **more)
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


def _found_parts(shot: Shot, found: dict, static_holes: np.ndarray, camera: Camera) -> dict[str, np.ndarray]:
    """Return the masks of `exact_parts` by the pipeline's own buffers. `static_holes`: disocclusions if everything
    counts as static."""
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
