"""Cameras of a `gffe-folder`: matrices of an API's or engine's convention, or a view with focal lengths."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gffe_cl.captures.formats.capture import Keys, Size
from gffe_cl.engine.core.errors import GffeError, within
from gffe_cl.engine.core.validation import require_bool, require_vector
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.conventions import (
    LAYOUTS,
    decides_depth_range,
    matrices,
    planes_of,
    refuse_oblique,
    rigid,
    square,
)

# Constructors of a camera from view and projection, and the view's axes if there is no projection.
CONVENTIONS = {
    "gffe": (Camera.from_vulkan, (1, 1, 1)),
    "opengl": (Camera.from_opengl, (1, -1, -1)),
    "direct3d": (Camera.from_direct3d, (1, -1, 1)),
    "vulkan": (Camera.from_vulkan, (1, 1, 1)),
    "unity": (Camera.from_unity, (1, -1, -1)),
    "unreal": (Camera.from_unreal, (1, -1, 1)),
}
UNITS = {
    "pixels": lambda size: (1.0, 1.0),
    "uv": lambda size: size,
    "ndc": lambda size: (size[0] / 2, size[1] / 2),
}


@dataclass(frozen=True)
class CameraRules:
    """Conventions of all frames' matrices."""

    convention: str
    layout: str
    view_to_world: bool
    scale: float
    jitter_unit: str
    jitter_up: bool
    jitter_in_projection: bool
    opengl_buffer: bool | None  # None: as the convention has it


@dataclass(frozen=True)
class FoundCamera:
    """Camera of a frame; its projection matrix for column vectors, if it was given, and the factor from its unit to our
    world units; its jitter (x, y) in pixels, y down; `label` for errors."""

    camera: Camera
    projection: np.ndarray | None
    scale: float
    jitter: tuple[float, float]
    label: str

    def planes(self, rules: CameraRules) -> tuple[float, float]:
        """Return planar depth, world units, where a depth buffer of the projection holds 0 and 1. Raises GffeError for
        an oblique near plane."""
        self.refuse_oblique()
        assert self.projection is not None
        opengl = rules.convention == "opengl" if rules.opengl_buffer is None else rules.opengl_buffer
        first, second = planes_of(self.projection, opengl)
        first, second = (float(f"{end * self.scale:.10g}") for end in (first, second))
        return first, second

    def refuse_oblique(self) -> None:
        assert self.projection is not None
        with within(self.label):
            refuse_oblique(self.projection)

    def range_note(self, rules: CameraRules) -> str | None:
        """Return a sentence where neither the description nor the projection determines the range of a depth buffer of
        OpenGL, else None."""
        if rules.convention != "opengl" or rules.opengl_buffer is not None or self.projection is None:
            return None
        if decides_depth_range(self.projection):
            return None
        return (
            "depth: the matrix does not tell whether 0 … 1 in the buffer is −1 … 1 in device coordinates: it is taken"
            ' for that, as without glClipControl (expected "opengl_buffer": true or false in cameras)'
        )


def parse_rules(keys: Keys) -> CameraRules:
    jitter = Keys(keys.take("jitter", {}), f"{keys.label}, jitter")
    made = CameraRules(
        keys.choice("convention", tuple(CONVENTIONS), "gffe"),
        keys.choice("layout", LAYOUTS, "auto"),
        keys.choice("matrix", ("world_to_view", "view_to_world"), "world_to_view") == "view_to_world",
        keys.number("scale", 1.0) or 0.0,
        jitter.choice("unit", tuple(UNITS), "pixels"),
        jitter.choice("y", ("down", "up"), "down") == "up",
        jitter.flag("in_projection", True),
        None if (opengl := keys.take("opengl_buffer")) is None else require_bool(opengl, "cameras, opengl_buffer"),
    )
    jitter.done()
    if not made.scale > 0:
        raise GffeError(f"{keys.label}, scale must be greater than 0, got {made.scale:g}")
    return made


def parse_camera(document: Any, rules: CameraRules, size: Size, label: str) -> FoundCamera:
    """Return the camera in the object `document` on an image of `size`. Raises a GffeError that begins with `label`."""
    keys = Keys(document, f"{label}, camera")
    view, projection = keys.take("view"), keys.take("projection")
    jitter = require_vector(keys.take("jitter", (0.0, 0.0)), f"{keys.label}, jitter", 2).tolist()
    focal = {name: keys.number(name) for name in ("fx", "fy", "cx", "cy", "fov_x", "fov_y")}
    keys.done()
    with within(label):
        view = square(view, "view")
        if projection is None:
            made, p = _from_focal(view, focal, rules, size), None
        else:
            projection = square(projection, "projection")
            view, p = matrices(_inverted(view) if rules.view_to_world else view, projection, rules.layout)
            made = CONVENTIONS[rules.convention][0](view, p, size, "row-major")
    factor = UNITS[rules.jitter_unit](size)
    moved = (jitter[0] * factor[0], jitter[1] * factor[1] * (-1 if rules.jitter_up else 1))
    if not rules.jitter_in_projection:
        made = replace(made, cx=made.cx + moved[0], cy=made.cy + moved[1])
    if rules.scale != 1:
        matrix = made.world_to_view.copy()
        matrix[:3, 3] *= rules.scale
        made = replace(made, world_to_view=matrix)
    return FoundCamera(made, p, rules.scale, moved, label)


def _inverted(view: np.ndarray) -> np.ndarray:
    try:
        return np.linalg.inv(view)
    except np.linalg.LinAlgError:
        raise GffeError("camera: view is singular (expected a rotation and a translation)") from None


def _from_focal(view: np.ndarray, focal: dict[str, float | None], rules: CameraRules, size: Size) -> Camera:
    layout = rules.layout
    if layout == "auto":
        layout = "row-major" if np.abs(view[3] - (0, 0, 0, 1)).max() < 1e-6 else "column-major"
    view = view if layout == "row-major" else view.T
    if np.abs(view[3] - (0, 0, 0, 1)).max() > 1e-6:
        raise GffeError(f"camera: view does not fit layout '{layout}' (expected a last row 0 0 0 1 for column vectors)")
    if rules.view_to_world:
        view = _inverted(view)
    fx, fy = focal["fx"], focal["fy"]
    for axis, angle in enumerate((focal["fov_x"], focal["fov_y"])):
        if angle is not None:
            if not 0 < angle < 180:
                raise GffeError(f"camera: fields of view are between 0 and 180 degrees, got {angle:g}")
            length = size[axis] / 2 / np.tan(np.radians(angle) / 2)
            fx, fy = (length, fy) if axis == 0 else (fx, length)
    fx, fy = fx or fy, fy or fx
    if fx is None or fy is None:
        raise GffeError("camera: no projection (expected a matrix, fx and fy, or fov_x or fov_y in degrees)")
    cx = size[0] / 2 if focal["cx"] is None else focal["cx"]
    cy = size[1] / 2 if focal["cy"] is None else focal["cy"]
    axes = np.diag([*CONVENTIONS[rules.convention][1], 1.0])
    return Camera(axes @ rigid(view, "view"), fx, fy, cx, cy)
