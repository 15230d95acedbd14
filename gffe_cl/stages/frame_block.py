"""Frame block: the struct of sizes, cameras, times and options that kernels receive in addition to buffers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gffe_cl.frame.camera import Camera
from gffe_cl.frame.vectors import length
from gffe_cl.opencl.program import expand, parse_constants, parse_struct
from gffe_cl.stages.buffers import DeviceFrame, Sizes, level_starts
from gffe_cl.stages.mu_law import color_law

_SOURCE = expand("frame.h")
FRAME = parse_struct(_SOURCE, "Frame")
MAX_ORDER, MAX_LEVELS = (parse_constants(_SOURCE)[name] for name in ("MAX_ORDER", "MAX_LEVELS"))
_GRIDS = ("source", "target", "network", "cells")


def frame_block(
    sizes: Sizes,
    facts: Mapping[str, Any],
    frame: DeviceFrame,
    previous: DeviceFrame | None,
    times: Sequence[float],
    exposure: float,
    camera: Camera | None,
    time: float,
    alpha: float,
    overlays: int,
) -> np.ndarray:
    """The `Frame` of frame.h, as bytes, of a rendered frame or, with a `camera`, of a new one.

    Parameters
    ----------
    facts : mapping
        The members that do not change from frame to frame, by name.
    frame, previous, times, exposure, camera, time, alpha, overlays
        As in `Step`.
    """
    before = previous or frame
    intervals = -np.diff(times[:3])
    values = dict(facts)
    for grid in _GRIDS:
        values[f"{grid}_width"], values[f"{grid}_height"] = sizes.of(grid)
    values |= {
        "to_previous": reprojection(frame.camera, before.camera),
        "from_previous": reprojection(before.camera, frame.camera),
        "to_render": mapping(frame.display_camera, frame.camera),
        "to_display": mapping(frame.camera, frame.display_camera),
        "to_previous_display": mapping(before.camera, before.display_camera),
        "pixel_size": pixel_size(frame.display_camera, frame.camera),
        "camera_step": length((frame.camera.position - before.camera.position).tolist()),
        "has_previous": previous is not None,
        "interval_ratio": intervals[0] / intervals[1] if len(intervals) > 1 else 1.0,
        "exposure": exposure,
        "alpha": alpha,
        "has_overlays": overlays,
        "color_law": color_law(exposure),
        "code_offset": facts.get("code_offset", 0.0) / math.sqrt(exposure),
        "order": min(facts.get("order", 0), len(times) - 1),
    }
    if camera is not None:
        values |= {
            "to_target": reprojection(frame.camera, camera),
            "to_source": reprojection(camera, frame.camera),
            "target_to_previous": reprojection(camera, before.camera),
            "zoom": zoom(frame.camera, camera),
            "polynomial": padded(polynomial_weights(times, time, MAX_ORDER)),
        }
    block = np.zeros(1, FRAME)
    for name, value in values.items():
        block[name] = value.ravel().view(FRAME[name]) if FRAME[name].names else value
    return block.view(np.uint8)


def block_facts(options: Any, sizes: Sizes) -> dict[str, Any]:
    """The members of the frame block that are options, and where the background's levels start."""
    facts = {name: getattr(options, name) for name in FRAME.names or () if hasattr(options, name)}
    if levels := facts.get("levels", 0):
        starts = level_starts(sizes.source, levels)
        facts["level_starts"] = [*starts[1:levels], *[starts[levels]] * MAX_LEVELS][:MAX_LEVELS]
    return facts


def reprojection(source: Camera, target: Camera) -> np.ndarray:
    """(24,) float32, the `Reprojection` of common.h, composed in float64: source view space → target view space."""
    matrix = source.to_view_of(target)
    packed = np.zeros((6, 4), np.float32)
    packed[:3] = matrix[:3]
    packed[3] = source.intrinsics
    packed[4] = (1 / source.fx, 1 / source.fy, source.cx, source.cy)
    packed[5] = target.intrinsics
    return packed


def zoom(source: Camera, target: Camera) -> np.ndarray:
    """Return (2,) float32: target pixels per source pixel for a surface at equal depth in both cameras."""
    return np.array([target.fx / source.fx, target.fy / source.fy], np.float32)


def mapping(a: Camera, b: Camera) -> np.ndarray:
    """(4,) float32: scale x, scale y, offset x, offset y from pixels of `a` to pixels of `b`; both have one pose."""
    scale = np.array([b.fx / a.fx, b.fy / a.fy])
    return np.concatenate([scale, (b.cx, b.cy) - scale * (a.cx, a.cy)]).astype(np.float32)


def pixel_size(display: Camera, render: Camera) -> np.ndarray:
    """(2,) float32: width and height of a pixel of `render`, in pixels of `display`; both have one pose."""
    return 1 / mapping(display, render)[:2]


def polynomial_weights(times: Sequence[float], time: float, max_order: int) -> np.ndarray:
    """Lagrange weights of P_i − P_0 at `time`, for every order that `times` (newest first) allow.

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
    """Rows of 8: float8 in the kernel."""
    return np.pad(weights, ((0, 0), (0, 8 - weights.shape[1])))
