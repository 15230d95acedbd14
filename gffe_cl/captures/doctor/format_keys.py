"""Corrections of a capture's own description: keys of a `gffe-folder`."""

from __future__ import annotations

import json
from collections.abc import Callable

import numpy as np

from gffe_cl.captures.doctor.findings import (
    BOTTOM_UP,
    DISPLAY_VALUES,
    LOGARITHMIC,
    NEVER_WRITTEN,
    RANGE_MISREAD,
    Finding,
)
from gffe_cl.captures.formats.buffers import TO_NEXT, Buffer, DepthBuffer
from gffe_cl.captures.formats.cameras import CONVENTIONS
from gffe_cl.captures.formats.folder import FolderSettings
from gffe_cl.engine.frame.conventions import DIRECTIONS

_TO_PREVIOUS, _FROM_PREVIOUS = DIRECTIONS
_AXES = {"OpenGL axes": (1, -1, -1), "y up": (1, -1, 1), "z backward": (1, 1, -1)}
_UNIT_OF = {  # motion's unit as described, and the finding → its actual unit
    ("pixels", "in UV"): "uv",
    ("pixels", "in NDC"): "ndc",
    ("uv", "twice too long"): "ndc",
    ("ndc", "half as long as they are"): "uv",
}
_FACTORS = {"twice too long": 0.5, "half as long as they are": 2.0}


def tell_keys(findings: list[Finding], settings: FolderSettings | None) -> None:
    """Add the JSON key to change, and its new value, to each of `findings` that has one. `settings`: the present
    JSON, None for captures without."""
    if settings is None:
        return
    found = {(finding.about, finding.name) for finding in findings}
    for finding in findings:
        changes = _changes(finding, found, settings)
        if changes:
            keys = ", ".join(f'"{key}": {json.dumps(value)}' for key, value in changes.items())
            finding.change = f"{finding.about if finding.about != 'frames' else 'frame'}: {keys}"


def _changes(finding: Finding, found: set, settings: FolderSettings) -> dict:
    if finding.name == BOTTOM_UP:
        bottom_up = getattr(settings, finding.about).buffer.bottom_up
        return {"origin": "top-left" if bottom_up else "bottom-left"}
    by_name: dict[str, Callable] = {"motion": _motion, "depth": _depth, "camera": _camera}
    if finding.about in by_name:
        return by_name[finding.about](finding, found, settings)
    if finding.name == DISPLAY_VALUES and settings.color.encoding == "linear":
        return {"encoding": "srgb"}
    return {"reset": True} if finding.name in ("cut", "gap") else {}


def _motion(finding: Finding, found: set, settings: FolderSettings) -> dict:
    name, motion = finding.name, settings.motion
    negated, to_next = ("motion", "negated") in found, ("motion", "to the next frame") in found
    if name in ("negated", "to the next frame") and not motion.to_next:
        from_previous = (motion.direction == _FROM_PREVIOUS) != negated
        if to_next:
            return {} if from_previous else {"direction": TO_NEXT}
        return {"direction": _FROM_PREVIOUS if from_previous else _TO_PREVIOUS}
    if name == "y flipped":
        return {"y": "down" if motion.y_up else "up"}
    if name == "x flipped":
        return _scaled(motion.buffer, (-1, 1))
    if name == "x and y swapped" and motion.buffer.packing == "none":
        return {"channels": list(motion.buffer.channels[::-1])}
    if (motion.unit, name) in _UNIT_OF:
        return {"unit": _UNIT_OF[motion.unit, name]}
    if name in _FACTORS:
        return _scaled(motion.buffer, (_FACTORS[name],) * 2)
    if name == "jitter not removed":
        return {"jitter": "included" if motion.jitter_removed else "removed"}
    if name == NEVER_WRITTEN and finding.figures["value"] and not motion.jitter_removed:
        stored = [
            px / factor / scale + offset
            for px, factor, scale, offset in zip(
                finding.figures["value"], motion.factors(settings.size), motion.buffer.scale, motion.buffer.offset,
                strict=True,
            )
        ]  # fmt: skip
        return {"unknown": [float(f"{value:.7g}") + 0.0 for value in stored]}
    return {}


def _depth(finding: Finding, found: set, settings: FolderSettings) -> dict:
    depth, figures = settings.depth, finding.figures
    if finding.name == RANGE_MISREAD and depth.encoding == "device":
        if depth.near is None:
            return {"opengl_buffer": figures["factor"] == 2}
        return _scaled(depth.buffer, (0.5,), (-1.0,)) if figures["factor"] == 0.5 else {}
    if finding.name == LOGARITHMIC:
        return _logarithmic(depth, figures)
    if depth.encoding != "linear":
        return {}
    if finding.name in ("device", "reversed"):
        far = "infinite" if np.isinf(figures["far"]) else _short(figures["far"])
        return {"encoding": "device", "near": _short(figures["near"]), "far": far, "reversed": figures["reversed"]}
    if finding.name == "along rays":
        return {"encoding": "distance"}
    return _scaled(depth.buffer, (_short(figures["unit"]),)) if finding.name in ("units", "negative") else {}


def _logarithmic(depth: DepthBuffer, figures: dict) -> dict:
    """Return the keys of logarithmic depth; nothing where the planes do not follow from the present ones."""
    ends = np.array([0.0, 1.0])  # of what the finding's coefficients are for
    if depth.encoding == "device" and depth.near is not None:
        ends = 1 / np.array([depth.far, depth.near] if depth.reversed else [depth.near, depth.far])
    elif depth.encoding != "linear" or not figures["unit"]:
        return {}
    first, slope = figures["coefficients"]
    near, far = np.exp(first + slope * ends) - figures["added"]
    near, far, is_reversed = (far, near, True) if near > far else (near, far, False)
    planes = {"far": _short(far), "reversed": is_reversed}
    return {"encoding": LOGARITHMIC} | ({} if figures["added"] else {"near": _short(near)}) | planes


def _camera(finding: Finding, found: set, settings: FolderSettings) -> dict:
    rules = settings.cameras
    if finding.name == "inverted":
        return {"matrix": "world_to_view" if rules.view_to_world else "view_to_world"}
    if finding.name in _AXES and not settings.has_projections:  # a projection defines its axes
        axes = tuple(np.multiply(CONVENTIONS[rules.convention][1], _AXES[finding.name]).tolist())
        named = next((name for name, (_, other) in CONVENTIONS.items() if tuple(other) == axes), None)
        return {"convention": named} if named else {}
    if finding.name == "jitter not removed" and rules.jitter_in_projection:
        return {"jitter": {"in_projection": False}}
    return {}


def _scaled(buffer: Buffer, factors: tuple, offset: tuple = ()) -> dict:
    scale = [_short(a * b) for a, b in zip(buffer.scale, factors, strict=True)]
    added = {"offset": [a + b for a, b in zip(buffer.offset, offset, strict=True)]} if offset else {}
    return {**added, "scale": scale}


def _short(value: float) -> float:
    return float(f"{value:.4g}")
