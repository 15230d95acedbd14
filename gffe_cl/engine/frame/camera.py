"""Cameras: poses and pinholes.

Conventions: `world_to_view` is a rigid 4×4 matrix for column vectors; the view axes are x right, y down,
z forward; the projection is an off-center pinhole in pixels, the center of pixel (i, j) being
(i + 0.5, j + 0.5). All arithmetic here is float64; kernels only ever see view → view transforms.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from gffe_cl.engine.core import validation
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame import conventions, vectors

HELD_ALPHA = 2.0  # intervals: `Pacer` holds the picture from there on, unless it is told otherwise
FAR_ALPHA = 16.0  # beyond, new frames are no longer closer to the truth than the last rendered one in every scene
MOST_ALPHA = 1e6  # beyond, none is made


def interval_of(times: Sequence[float], fps: float) -> float:
    """Return the seconds between the last two rendered frames since a reset, from their `times`, newest first; 1/fps
    where there are no two."""
    return times[0] - times[1] if len(times) > 1 else 1.0 / fps


RIGIDITY_TOLERANCE = 1e-3
MOST_FOCAL = 1e9
MOST_DISTANCE = 1e15
_FIELDS = ("world_to_view", "fx", "fy", "cx", "cy")
_VIEW_AXES = {"opengl": (1.0, -1.0, -1.0), "direct3d": (1.0, -1.0, 1.0), "vulkan": (1.0, 1.0, 1.0)}


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera.

    Parameters
    ----------
    world_to_view : (4, 4) float64
        Rigid transform from world to view space; mirrored for left-handed worlds; x right, y down, z forward.
    fx, fy : float
        Focal lengths in pixels, > 0.
    cx, cy : float
        Principal point in pixels from the top left corner; jitter is part of it.

    Raises
    ------
    GffeError
        If the matrix is not 4×4, not finite or not rigid, or the projection is singular.
    """

    world_to_view: np.ndarray
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self):
        intrinsics = [validation.require_number(getattr(self, name), f"camera: {name}") for name in _FIELDS[1:]]
        matrix = _matrix(self.world_to_view)
        matrix.setflags(write=False)
        self.__dict__.update(zip(_FIELDS, (matrix, *intrinsics), strict=True))
        _check(self.rows, *self.intrinsics)
        _ = self.inverse  # already here, and not while frames are made

    def __eq__(self, other):
        return (
            isinstance(other, Camera)
            and np.array_equal(self.world_to_view, other.world_to_view)
            and self.intrinsics == other.intrinsics
        )

    __hash__ = None  # pyright: ignore[reportAssignmentType]  # how Python says that it has none

    @classmethod
    @validation.QUIETLY
    def look_at(
        cls, position: ArrayLike, target: ArrayLike, up: ArrayLike, fx: float, fy: float, cx: float, cy: float
    ) -> Camera:
        """Return the camera at `position` that looks at `target` (world units). `up` is a world direction; `fx`, `fy`,
        `cx`, `cy` are in pixels. Raises GffeError if no such camera exists."""
        position = validation.require_vector(position, "camera: position")
        return cls.from_pose(
            position, validation.require_vector(target, "camera: target") - position, up, fx, fy, cx, cy
        )

    @classmethod
    @validation.QUIETLY
    def from_pose(
        cls, position: ArrayLike, direction: ArrayLike, up: ArrayLike, fx: float, fy: float, cx: float, cy: float
    ) -> Camera:
        """Return the camera of the paper's pose vectors (v_pos, v_dir, v_up), re-orthonormalized. Raises GffeError
        unless each is three finite numbers, and if `up` is parallel to `direction`."""
        place = validation.require_vector(position, "camera: position").tolist()
        forward = _normalized(validation.require_vector(direction, "camera: direction"), "direction")
        right = vectors.cross(forward, validation.require_vector(up, "camera: up").tolist())
        right = _normalized(right, "up (parallel to the direction)")
        down = vectors.cross(forward, right)
        matrix = np.eye(4)
        matrix[:3, :3] = (right, down, forward)
        matrix[:3, 3] = [-x for x in vectors.times((right, down, forward), place)]
        return cls(matrix, fx, fy, cx, cy)

    @classmethod
    def from_opengl(
        cls, view: ArrayLike, projection: ArrayLike, size: tuple[float, float], layout: str = "auto"
    ) -> Camera:
        """Return the camera of OpenGL's matrices. Off-center projections, jitter, reversed and infinitely far planes
        are supported.

        Parameters
        ----------
        view : (4, 4), or 16 numbers
            World → view space, as given to the shaders.
        projection : (4, 4), or 16 numbers
            View → clip space. Which way the view axes point follows from it; normalized device coordinates go up.
        size : (width, height) of the image, pixels
        layout : "auto", "row-major" or "column-major"
            "row-major": `view[0]` is the first row of the matrix that column vectors are multiplied with, and the
            translation is in the last column. "column-major": `view[0]` is its first column, as OpenGL and glm keep it
            in memory; the same thing is a matrix for row vectors (v·M) written in rows, as of DirectXMath and Unreal.
            "auto" recognizes them by the row or column 0 0 0 1 of the view and 0 0 ±1 0 of the projection.

        Raises
        ------
        GffeError
            If that is no rigid view and pinhole, or fits another layout.

        Notes
        -----
        With P for column vectors: fx = abs(P₀₀) W/2, fy = abs(P₁₁) H/2, cx = (1 + P₀₂/P₃₂) W/2,
        cy = (1 − P₁₂/P₃₂) H/2; x, y, z of the view are turned to right, down, forward by the signs of P₀₀, P₁₁, P₃₂.
        """
        return cls(*conventions.pinhole(view, projection, size, layout, ndc_up=True))

    @classmethod
    def from_direct3d(
        cls, view: ArrayLike, projection: ArrayLike, size: tuple[float, float], layout: str = "auto"
    ) -> Camera:
        """Return the camera of Direct3D's matrices, left- or right-handed. Parameters and formula are those of
        `from_opengl`.

        DirectXMath's row-vector matrices are "column-major". Use it, too, for Vulkan with a viewport of negative
        height.
        """
        return cls(*conventions.pinhole(view, projection, size, layout, ndc_up=True))

    @classmethod
    def from_vulkan(
        cls, view: ArrayLike, projection: ArrayLike, size: tuple[float, float], layout: str = "auto"
    ) -> Camera:
        """Return the camera of Vulkan's matrices, whose normalized device coordinates go down. Parameters are those of
        `from_opengl`.

        cy = (1 + P₁₂/P₃₂) H/2; the other formulas are those of `from_opengl`. OpenGL-like views with
        ``projection[1][1] *= -1`` are right, too.
        """
        return cls(*conventions.pinhole(view, projection, size, layout, ndc_up=False))

    @classmethod
    def from_unity(
        cls, view: ArrayLike, projection: ArrayLike, size: tuple[float, float], layout: str = "auto"
    ) -> Camera:
        """Return the camera of Unity's `camera.worldToCameraMatrix` and `camera.projectionMatrix`. Parameters are those
        of `from_opengl`.

        `GL.GetGPUProjectionMatrix(…)` is accepted, too; if it is upside down, for textures, that is detected. Matrices
        that begin with `m.GetRow(0)` are "row-major", the memory of a `Matrix4x4` is "column-major". `projectionMatrix`
        holds the jitter, `nonJitteredProjectionMatrix` does not. Unity's world is left-handed, so `world_to_view` is
        mirrored.
        """
        return cls(*conventions.pinhole(view, projection, size, layout, ndc_up=True, view_up=True))

    @classmethod
    def from_unreal(
        cls, view: ArrayLike, projection: ArrayLike, size: tuple[float, float], layout: str = "auto"
    ) -> Camera:
        """Return the camera of Unreal's `FViewMatrices`: view and projection, jittered or not. Parameters are those of
        `from_opengl`.

        An `FMatrix` is for row vectors, so matrices that begin with `M[0]` are "column-major". World units stay
        centimeters: take depth in centimeters, too. Unreal's world is left-handed, so `world_to_view` is mirrored.
        """
        return cls(*conventions.pinhole(view, projection, size, layout, ndc_up=True, view_up=True))

    @classmethod
    @validation.QUIETLY
    def from_unreal_pose(
        cls, location: ArrayLike, rotation: ArrayLike, fov: float, size: tuple[float, float]
    ) -> Camera:
        """Return the camera of an Unreal `FVector` location (3,), an `FRotator` (pitch, yaw, roll) and the horizontal
        field of view, degrees, on an image of `size` = (width, height) pixels: fx = fy = W/2 / tan(fov/2). World units
        are those of the location.

        Raises GffeError for fields of view that are not between 0° and 180°.
        """
        if not 0 < validation.require_number(fov, "camera: fov") < 180:
            raise GffeError(f"camera: fov must be between 0 and 180 degrees, got {fov}")
        width, height = validation.require_size(size)
        focal = width / 2 / np.tan(np.radians(fov) / 2)
        location = validation.require_vector(location, "camera: location")
        angles = validation.require_vector(rotation, "camera: rotation (pitch, yaw, roll)")
        return cls(conventions.unreal_view(location, *angles), focal, focal, width / 2, height / 2)

    @property
    def intrinsics(self) -> tuple[float, float, float, float]:
        """Focal lengths fx, fy and principal point cx, cy in pixels."""
        return (self.fx, self.fy, self.cx, self.cy)

    @cached_property
    def rows(self) -> list[list[float]]:
        """The rows of `world_to_view`."""
        return self.world_to_view.tolist()

    @cached_property
    def inverse(self) -> tuple[list[list[float]], list[float]]:
        """Rotation (3, 3) and translation (3,) from view space to world space."""
        return vectors.view_inverse(self.rows)

    @property
    def position(self) -> np.ndarray:
        """The camera's position in the world, (3,) float64."""
        return np.array(self.inverse[1])

    @property
    def direction(self) -> np.ndarray:
        """The world direction in which the camera looks, (3,) float64."""
        return self.world_to_view[2, :3].copy()

    @property
    def up(self) -> np.ndarray:
        """The world direction of the top of the image, (3,) float64."""
        return -self.world_to_view[1, :3]

    @property
    def view_to_world(self) -> np.ndarray:
        """The inverse of `world_to_view`, (4, 4) float64."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = vectors.view_inverse(self.world_to_view.tolist())
        return matrix

    @validation.QUIETLY
    def project(self, world_pos: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Return pixel positions (..., 2) and view depths (...) of world positions (..., 3). Raises GffeError for
        another shape."""
        world_pos = validation.as_float64(validation.require_array(world_pos, "camera: world_pos", ..., 3))
        view_pos = world_pos @ self.world_to_view[:3, :3].T + self.world_to_view[:3, 3]
        depth = view_pos[..., 2]
        x = self.fx * view_pos[..., 0] / depth + self.cx
        y = self.fy * view_pos[..., 1] / depth + self.cy
        return np.stack([x, y], -1), depth

    @validation.QUIETLY
    def unproject(self, px: ArrayLike, depth: ArrayLike) -> np.ndarray:
        """Return the world positions (..., 3) of pixel positions (..., 2) and view depths (...). Raises GffeError for
        other shapes."""
        px = validation.require_array(px, "camera: px", ..., 2)
        depth = validation.as_float64(validation.require_array(depth, "camera: depth", *px.shape[:-1]))
        px = validation.as_float64(px)
        view_pos = np.stack(
            [(px[..., 0] - self.cx) / self.fx * depth, (px[..., 1] - self.cy) / self.fy * depth, depth], -1
        )
        matrix = self.view_to_world
        return view_pos @ matrix[:3, :3].T + matrix[:3, 3]

    def view_matrix(self, api: str) -> np.ndarray:
        """Return the matrix (4, 4) float64, for column vectors, from world space to the view space that
        `projection_matrix` of the same `api` takes.

        "opengl": x right, y up, z backward; "direct3d": x right, y up, z forward; "vulkan": x right, y down, z forward.
        For row vectors (v·M) transpose it. Raises GffeError for an unknown API.
        """
        validation.require_choice(api, _VIEW_AXES, "camera: api")
        return np.diag([*_VIEW_AXES[api], 1.0]) @ self.world_to_view

    def projection_matrix(
        self, api: str, width: float, height: float, near: float, far: float = np.inf, reverse_depth: bool = False
    ) -> np.ndarray:
        """Return the matrix (4, 4) float64, for column vectors, from the view space of `view_matrix(api)` to clip
        space.

        It is off-center (jitter and windows included), for an image of `width` × `height` pixels. Depth from `near` to
        `far` (world units, `far` may be infinite) becomes, after division by w, −1 … 1 for "opengl" and 0 … 1 for
        "direct3d" and "vulkan"; with `reverse_depth` 1 … 0 for all (OpenGL: glClipControl(…, GL_ZERO_TO_ONE)).

        Raises GffeError for an unknown API, an empty image, or planes not within 0 < near < far.
        """
        validation.require_choice(api, _VIEW_AXES, "camera: api")
        near = validation.require_number(near, "camera: near")
        far = validation.require_number(far, "camera: far", infinite=True)
        if not 0 < near < far:
            raise GffeError(f"camera: expected 0 < near < far, got {near:g} and {far:g}")
        width, height = validation.require_size((width, height), "camera: image")
        reverse_depth = validation.require_bool(reverse_depth, "camera: reverse_depth")
        ends = (1.0, 0.0) if reverse_depth else (-1.0, 1.0) if api == "opengl" else (0.0, 1.0)
        scale = (ends[1] - ends[0] * near / far) / (1 - near / far)  # clip z = scale · z + offset
        offset = (ends[0] - scale) * near
        matrix = np.array(
            [
                [2 * self.fx / width, 0, 2 * self.cx / width - 1, 0],
                [0, 2 * self.fy / height, 2 * self.cy / height - 1, 0],
                [0, 0, scale, offset],
                [0, 0, 1, 0],
            ]
        )
        if api != "vulkan":
            matrix[1] *= -1  # normalized device coordinates go up
        return matrix @ np.diag([*_VIEW_AXES[api], 1.0])

    def to_view_of(self, other: Camera) -> np.ndarray:
        """Return the matrix (4, 4) float64 from the view space of this camera to that of `other`. For equal poses it is
        exactly the identity."""
        validation.require_kind(other, Camera, "camera: other")
        rows = vectors.view_to_view(self.rows, self.inverse, other.rows)
        return np.array([*rows, [0.0, 0.0, 0.0, 1.0]])

    def scaled(self, scale_x: float, scale_y: float) -> Camera:
        """Return the camera of the same frustum on an image whose sides are `scale_x`, `scale_y` times as many pixels.
        Raises GffeError for factors that are not positive."""
        scale_x, scale_y = (
            validation.require_positive(s, f"camera: scale_{a}") for s, a in ((scale_x, "x"), (scale_y, "y"))
        )
        return replace(self, fx=self.fx * scale_x, fy=self.fy * scale_y, cx=self.cx * scale_x, cy=self.cy * scale_y)

    def moved(self, offset: ArrayLike) -> Camera:
        """Return the same camera after the whole world has moved by `offset` (3,) world units."""
        matrix = self.world_to_view.copy()
        matrix[:3, 3] -= matrix[:3, :3] @ validation.require_vector(offset, "camera: offset")
        return replace(self, world_to_view=matrix)


def predict_camera(previous: Camera, current: Camera, alpha: float) -> Camera:
    """Return the predicted camera at t + α: C̄ = C_t + α (C_t − C_{t−1}).

    Each pose vector (position, direction, up) is predicted by itself and the pose is re-orthonormalized. fx and fy are
    predicted in the same way; cx and cy stay. Paper: 'Adaptive rendering window'. `alpha` is in intervals between
    rendered frames and may exceed 1. Give cameras without jitter: its next value is known to the renderer only. Raises
    GffeError unless `alpha` is a number up to a million, either way.
    """
    validation.require_kind(previous, Camera, "camera: previous")
    validation.require_kind(current, Camera, "camera: current")
    alpha = validation.require_within(alpha, "camera: alpha", -MOST_ALPHA, MOST_ALPHA)

    def ahead(a, b):
        return b + alpha * (b - a)

    direction = ahead(previous.direction, current.direction)
    ups = (ahead(previous.up, current.up), current.up, -current.direction)  # the last two cannot both be parallel to it
    least = 1e-6 * vectors.length(direction.tolist())
    fitting = (up for up in ups if vectors.length(vectors.cross(direction.tolist(), up.tolist())) > least)
    up = next(fitting, current.up)  # without a direction none fits: no camera
    predicted = Camera.from_pose(
        ahead(previous.position, current.position),
        direction,
        up,
        max(ahead(previous.fx, current.fx), current.fx * 0.1),
        max(ahead(previous.fy, current.fy), current.fy * 0.1),
        current.cx,
        current.cy,
    )
    if np.array_equal(previous.world_to_view, current.world_to_view):
        return replace(predicted, world_to_view=current.world_to_view)
    if vectors.determinant(current.world_to_view[:3, :3].tolist()) < 0:  # left-handed world
        matrix = predicted.world_to_view.copy()
        matrix[0] *= -1
        predicted = replace(predicted, world_to_view=matrix)
    return predicted


def _matrix(given) -> np.ndarray:
    """Return a copy of `given` as (4, 4) float64. Raises GffeError unless it is a matrix of numbers."""
    array = validation.require_array(given, "camera: world_to_view", 4, 4)
    if not _all_numbers(given):
        raise GffeError("camera: world_to_view must be real numbers, got truth values")
    return array.astype(np.float64)


def _all_numbers(given) -> bool:
    """Return whether rows given as lists hold no truth values, which arrays take for numbers."""
    if isinstance(given, np.ndarray):
        return True
    return bool not in {type(value) for row in given if isinstance(row, list | tuple) for value in row}


def _check(rows: list[list[float]], fx: float, fy: float, cx: float, cy: float) -> None:
    """Raise GffeError if a camera is invalid; `rows`: of the matrix (4, 4)."""
    if not all(map(math.isfinite, (*rows[0], *rows[1], *rows[2], *rows[3], fx, fy, cx, cy))):
        raise GffeError("camera: not finite (world_to_view, fx, fy, cx and cy must be finite numbers)")
    axes = rows[:3]
    if not all(abs(vectors.dot(a, b) - (a is b)) <= RIGIDITY_TOLERANCE for a in axes for b in axes):
        raise GffeError("camera: world_to_view is singular or not rigid (expected a rotation and a translation)")
    if any(abs(x - expected) > 1e-9 for x, expected in zip(rows[3], (0, 0, 0, 1), strict=True)):
        raise GffeError("camera: the last row of world_to_view must be 0 0 0 1 (column vectors)")
    if min(fx, fy) <= 0:
        raise GffeError(f"camera: singular projection, fx and fy must be positive, got {fx:g} and {fy:g}")
    if max(fx, fy) > MOST_FOCAL or min(fx, fy) < 1 / MOST_FOCAL:
        raise GffeError(f"camera: fx and fy must be within 1e-9 and 1e9 pixels, got {fx:g} and {fy:g}")
    if max(abs(cx), abs(cy)) > MOST_FOCAL or max(abs(row[3]) for row in axes) > MOST_DISTANCE:
        raise GffeError("camera: cx, cy must be within 1e9 pixels and the position within 1e15 world units")


def _normalized(vector, name) -> list[float]:
    components = np.asarray(vector, np.float64).tolist()
    length = vectors.length(components)
    if not math.isfinite(length) or length < 1e-12:
        raise GffeError(f"camera: {name} has no length")
    return [x / length for x in components]
