"""Frame block: the struct of sizes, cameras, times and options that kernels receive in addition to buffers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.vectors import length, view_to_view
from gffe_cl.engine.opencl.program import expand, parse_struct
from gffe_cl.engine.options import MAX_LEVELS, MAX_ORDER, Options
from gffe_cl.engine.stages.buffers import DeviceFrame, Sizes
from gffe_cl.engine.stages.mu_law import color_law

_SOURCE = expand("frame.h")
FRAME = parse_struct(_SOURCE, "Frame")
_GRIDS = ("source", "target", "network", "cells")
# Where each member is, in words of 4 bytes.
_WORDS = {
    name: slice(member[1] // 4, (member[1] + member[0].itemsize) // 4) for name, member in (FRAME.fields or {}).items()
}


class BlockWriter:
    """Writer of frame blocks for images of `sizes`; `facts`: the members that do not change from frame to frame."""

    def __init__(self, sizes: Sizes, facts: Mapping[str, Any]):
        fixed = np.zeros(1, FRAME)
        for grid in _GRIDS:
            fixed[f"{grid}_width"], fixed[f"{grid}_height"] = sizes.of(grid)
        for name, value in facts.items():
            fixed[name] = value
        self._fixed, self._facts = fixed.view(np.uint32), facts

    def write(
        self,
        frame: DeviceFrame,
        previous: DeviceFrame | None,
        times: Sequence[float],
        exposure: float,
        camera: Camera | None,
        time: float,
        alpha: float,
        overlays: int,
    ) -> np.ndarray:
        """Return the `Frame` of frame.h, as bytes, of a rendered frame or, with a `camera`, of a new one. Parameters
        are those of `Step`."""
        before, facts = previous or frame, self._facts
        order = min(facts.get("order", 0), len(times) - 1)
        values: dict[str, Any] = {
            "to_previous": _reprojection(frame.camera, before.camera),
            "from_previous": _reprojection(before.camera, frame.camera),
            "to_render": _mapping(frame.display_camera, frame.camera),
            "to_display": _mapping(frame.camera, frame.display_camera),
            "to_previous_display": _mapping(before.camera, before.display_camera),
            "pixel_size": pixel_size(frame.display_camera, frame.camera),
            "camera_step": distance(frame.camera, before.camera),
            "interval_ratio": (times[0] - times[1]) / (times[1] - times[2]) if len(times) > 2 else 1.0,
            "exposure": exposure,
            "alpha": alpha,
            "color_law": color_law(exposure),
            "code_offset": facts.get("code_offset", 0.0) / math.sqrt(exposure),
        }
        if camera is not None:
            values |= {
                "to_target": _reprojection(frame.camera, camera),
                "to_source": _reprojection(camera, frame.camera),
                "target_to_previous": _reprojection(camera, before.camera),
                "zoom": (camera.fx / frame.camera.fx, camera.fy / frame.camera.fy),
                "polynomial": padded(polynomial_weights(times[: order + 1], time, MAX_ORDER)),
            }
        block = self._fixed.copy()
        floats, integers = block.view(np.float32), block.view(np.int32)
        for name, value in values.items():
            floats[_WORDS[name]] = value
        integers[_WORDS["has_previous"]] = previous is not None
        integers[_WORDS["has_overlays"]] = overlays
        integers[_WORDS["order"]] = order
        return block.view(np.uint8)


def block_facts(options: Options, sizes: Sizes) -> dict[str, Any]:
    """Return the members of the frame block that are options, and the starts of the background's levels."""
    facts = {name: getattr(options, name) for name in FRAME.names or () if hasattr(options, name)}
    if levels := facts.get("levels", 0):
        starts = sizes.level_starts(levels)
        facts["level_starts"] = [*starts[1:levels], *[starts[levels]] * MAX_LEVELS][:MAX_LEVELS]
    return facts


def reprojection(source: Camera, target: Camera) -> np.ndarray:
    """Return (6, 4) float32, the `Reprojection` of common.h, composed in float64: source view space → target view
    space."""
    return np.array(_reprojection(source, target), np.float32).reshape(6, 4)


def _reprojection(source: Camera, target: Camera) -> list[float]:
    row0, row1, row2 = view_to_view(source.rows, source.inverse, target.rows)
    inverse = (1 / source.fx, 1 / source.fy, source.cx, source.cy)
    return [*row0, *row1, *row2, *source.intrinsics, *inverse, *target.intrinsics]


def mapping(a: Camera, b: Camera) -> np.ndarray:
    """Return (4,) float32: scale x, scale y, offset x, offset y from pixels of `a` to pixels of `b`; both have one
    pose."""
    return np.array(_mapping(a, b), np.float32)


def _mapping(a: Camera, b: Camera) -> tuple[float, float, float, float]:
    scale_x, scale_y = b.fx / a.fx, b.fy / a.fy
    return scale_x, scale_y, b.cx - scale_x * a.cx, b.cy - scale_y * a.cy


def pixel_size(display: Camera, render: Camera) -> np.ndarray:
    """Return (2,) float32: width and height of a pixel of `render`, in pixels of `display`; both have one pose."""
    return 1 / mapping(display, render)[:2]


def distance(a: Camera, b: Camera) -> float:
    """Return the distance between the positions of two cameras, world units."""
    return length([x - y for x, y in zip(a.inverse[1], b.inverse[1], strict=True)])


def polynomial_weights(times: Sequence[float], time: float, max_order: int) -> np.ndarray:
    """Return the Lagrange weights of P_i − P_0 at `time`, for every order that `times` (newest first) allow.

    Returns
    -------
    (max_order, max_order) float32
        [o − 1, i − 1]: the weight of (P_i − P_0), i ≤ o, in the polynomial of order o. Order 1 gives −α.
    """
    weights = np.zeros((max_order, max_order), np.float32)
    for order in range(1, min(max_order, len(times) - 1) + 1):
        nodes = [node - times[0] for node in times[: order + 1]]
        for i in range(1, order + 1):
            others = nodes[:i] + nodes[i + 1 :]
            weights[order - 1, i - 1] = math.prod((time - times[0] - other) / (nodes[i] - other) for other in others)
    return weights


def padded(weights: np.ndarray) -> np.ndarray:
    """Return the weights in rows of 8, float8 in the kernel, one after another."""
    rows = np.zeros((len(weights), 8), np.float32)
    rows[:, : weights.shape[1]] = weights
    return rows.ravel()
