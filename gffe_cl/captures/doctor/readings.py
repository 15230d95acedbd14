"""Hypotheses of the doctor: how motion vectors, depth and cameras may be meant, in the words of `FrameFormat`.

Depth is in terms of w = 1 / depth, which is linear in the unknown parameters: w = Σ c · φ(stored). Of logarithmic depth
ln(depth + added) is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from gffe_cl.captures.doctor.findings import CameraKey, Finding, FormatChange, MotionToNext, OtherFrame, short
from gffe_cl.captures.doctor.samples import NEXT, PREVIOUS, Look
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.conventions import DIRECTIONS
from gffe_cl.engine.frame.frame_format import FrameFormat

VIEW_AXES = {"gffe": (1, 1, 1), "opengl": (1, -1, -1), "direct3d": (1, -1, 1)}  # x right, y down, z forward: 1
_INFINITE = 5e-4  # near / far: below that far is indistinguishable from infinity
_SIGNED = 0.01  # device depths below minus this reach from −1 to 1
_MOST_POWER = 60.0  # of e
_LITTLE_MORE = 1.5
_DRAWS = 48  # lines through two samples, of which the best one is kept


@dataclass(frozen=True)
class Motion:
    """One way to read motion vectors; the fields are those of `FrameFormat`. `to_next`: they lead to the next frame;
    `other_jitter`: `motion_jittered` has the other value than the frames were read with."""

    direction: str = "to_previous"
    y: str = "down"
    unit: str = "pixels"
    scale: float = 1.0
    camera: str = "included"
    to_next: bool = False
    other_jitter: bool = False

    @property
    def step(self) -> int:
        return NEXT if self.to_next else PREVIOUS

    def pixels(self, look: Look) -> np.ndarray | None:
        """Return the vectors (N, 2), in pixels, of the samples of `look`; None where there are none, or no frame that
        they lead to."""
        stored = look.stored_motion
        if stored is None or self.step not in look.neighbors:
            return None
        sides = {"pixels": (1.0, 1.0), "uv": look.size, "ndc": np.divide(look.size, 2)}[self.unit]
        sign = DIRECTIONS[self.direction] * self.scale
        factors = np.multiply(sides, sign) * (1, -1 if self.y == "up" else 1)
        return stored * factors + look.shift * (look.unjittered != self.other_jitter)

    def findings(self) -> list[Finding]:
        made: list[Finding] = []
        for name in ("direction", "y", "unit"):
            if getattr(self, name) != getattr(GIVEN.motion, name):
                made.append(FormatChange(f"motion_{name}", {f"motion_{name}": getattr(self, name)}))
        if self.other_jitter:
            made.append(FormatChange("motion_jittered", {"motion_jittered": True}))
        if self.scale != 1:
            made.append(FormatChange("motion_scale", {"motion_scale": (self.scale, self.scale)}))
        if self.camera != "included":
            invalid = {"motion_invalid": 0.0} if self.camera == "movers_only" else {}
            made.append(FormatChange("camera_motion", {"camera_motion": self.camera} | invalid))
        return made + ([MotionToNext()] if self.to_next else [])


def motions(jittered: bool) -> list[Motion]:
    """Return all hypotheses about motion vectors that cameras can judge, the usual one first. `jittered`: whether
    frames have a `geometry_jitter`."""
    kinds = [("pixels", 1.0), ("pixels", 0.5), ("pixels", 2.0), ("uv", 1.0), ("ndc", 1.0)]
    found = []
    for to_next, (unit, scale), y, direction in product((False, True), kinds, ("down", "up"), DIRECTIONS):
        found.append(Motion(direction, y, unit, scale, to_next=to_next))
    return found + [replace(one, other_jitter=True) for one in found if jittered and not one.to_next]


@dataclass(frozen=True)
class Law:
    """Law of a depth buffer: `name` in `FrameFormat.depth`, and how many functions φ it has. `added` to depth before
    the logarithm, of which φ is linear; None: w is."""

    name: str
    terms: int
    added: float | None = None

    def basis(self, stored: np.ndarray, ray: np.ndarray) -> np.ndarray:
        """Return the basis (N, terms) of stored depths (N,) and rays (N, 3)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            if self.name == "linear":
                return (1 / stored)[..., None]
            if self.name == "distance":
                return (np.linalg.norm(ray, axis=-1) / stored)[..., None]
            return np.stack([np.ones_like(stored), stored], -1)

    def inverse(self, linear: np.ndarray) -> np.ndarray:
        """Return w (…) of a basis times the coefficients (…)."""
        if self.added is None:
            return linear
        with np.errstate(divide="ignore"):
            return 1 / (np.exp(np.clip(linear, -_MOST_POWER, _MOST_POWER)) - self.added)

    def linear(self, w: np.ndarray) -> np.ndarray:
        """Return what `inverse` gives `w` for; NaN where nothing does."""
        if self.added is None:
            return w
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(w > 0, np.log(1 / w + self.added), np.nan)

    def slope(self, w: np.ndarray) -> np.ndarray:
        """Return the derivative of `inverse` where it gives `w`."""
        return np.ones_like(w) if self.added is None else -w * (1 + self.added * w)


LINEAR, DISTANCE, DEVICE = Law("linear", 1), Law("distance", 1), Law("device", 2)
LAWS = (LINEAR, DISTANCE, DEVICE, Law("logarithmic", 2, 0.0), Law("logarithmic", 2, 1.0))


@dataclass(frozen=True)
class Depth:
    """Law with its parameters: 1 / depth = basis · coefficients."""

    law: Law = LINEAR
    coefficients: tuple[float, ...] = (1.0,)

    def inverse(self, stored: np.ndarray, ray: np.ndarray) -> np.ndarray:
        """Return 1 / planar depth (N,) float64 in units of the camera's translation; 0 for no surface."""
        with np.errstate(invalid="ignore"):
            w = self.law.inverse(self.law.basis(stored, ray) @ np.array(self.coefficients))
        return np.where(np.isinf(stored), 0.0, w)

    def is_possible(self, stored: np.ndarray) -> bool:
        """Return whether a buffer by this law can hold such values: from −1 or 0 to 1, or logarithms of 1 + z; and
        whether a format can have its parameters."""
        if self.law.terms == 1:
            return True
        try:
            FrameFormat(**self.findings(stored)[0].fields)
        except GffeError:
            return False
        if np.nanmin(stored) > -1 - _SIGNED and np.nanmax(stored) < 1 + _SIGNED:
            return True
        return bool(self.law.added) and abs(self.coefficients[0]) < _SIGNED * abs(self.coefficients[1])

    def findings(self, stored: np.ndarray) -> list[Finding]:
        """Return the changes of fields, with their parameters rounded. `stored`: some of the depths."""
        if self == GIVEN.depth:
            return []
        made: list[Finding] = []
        if self.law.terms == 1:
            if self.law is DISTANCE:
                made.append(FormatChange("depth", {"depth": "distance"}, ", along the rays"))
            scale = short(1 / self.coefficients[0])
            if scale != 1:
                made.append(FormatChange("depth_scale", {"depth_scale": scale}, ": its unit is not the cameras'"))
            return made
        least, most = float(np.nanmin(stored)), float(np.nanmax(stored))
        ends = (-1.0 if least < -_SIGNED else 0.0, 1.0)
        if self.law.added is not None and not (least > -_SIGNED and most < 1 + _SIGNED):
            ends = (float(np.floor(least)), float(np.ceil(most)))
        return [FormatChange("depth", self._planes(ends))]

    def _planes(self, ends: tuple[float, float]) -> dict[str, Any]:
        first, slope = self.coefficients
        with np.errstate(divide="ignore", over="ignore"):
            planes = (1 / self.law.inverse(first + slope * np.array(ends))).tolist()
        if self.law is DEVICE:
            farthest = int(first + slope * ends[0] > first + slope * ends[1])
            near = planes[1 - farthest]
            if not 0 < planes[farthest] < near / _INFINITE:
                planes[farthest] = np.inf
        elif self.law.added and abs(planes[0]) < 0.01 * abs(planes[1]):
            planes[0] = 0.0
        elif self.law.added and abs(planes[1]) < 0.01 * abs(planes[0]):
            planes[1] = 0.0
        (near, low), (far, high) = sorted(zip(map(short, planes), ends, strict=True))
        return {"depth": self.law.name, "near_z": near, "far_z": far, "depth_range": (low, high)}


@dataclass(frozen=True)
class Cameras:
    """One way to read camera matrices: `VIEW_AXES[convention]` · layout(stored); `focal_scale` multiplies focal
    lengths; `jitter` "geometry_jitter" is part of the principal point by mistake. These are the keys of the cameras of
    a found format."""

    convention: str = "gffe"
    matrix: str = "world_to_view"
    rotation: str = "as stored"
    translation: str = "as stored"
    focal_scale: float = 1.0
    jitter: str = "as stored"

    def read(self, camera: Camera, jitter: np.ndarray) -> Camera:
        """Return the camera with this hypothesis applied. `jitter`: of its frame's geometry, pixels."""
        m = camera.world_to_view
        if self.matrix == "view_to_world":
            m = np.linalg.inv(m)
        if self.rotation == "transposed":
            m = m.copy()
            m[:3, :3] = m[:3, :3].T.copy()
        if self.translation == "position":
            m = m.copy()
            m[:3, 3] = -m[:3, :3] @ m[:3, 3]
        if self.convention != "gffe":
            m = np.diag([*VIEW_AXES[self.convention], 1.0]) @ m
        scale, (x, y) = self.focal_scale, jitter * (self.jitter != "as stored")
        made = replace(camera, world_to_view=m, fx=camera.fx * scale, fy=camera.fy * scale)
        return replace(made, cx=camera.cx - float(x), cy=camera.cy - float(y))

    def keys(self) -> dict[str, Any]:
        """Return the keys that differ from frames in our conventions."""
        return {name: value for name, value in vars(self).items() if value != getattr(GIVEN.cameras, name)}

    def findings(self) -> list[Finding]:
        return [CameraKey(key, value) for key, value in self.keys().items()]


def cameras(look: Look) -> list[Cameras]:
    """Return all hypotheses about cameras, the usual one first; `look`: any of them, for mistaken fields of view."""
    layouts = [{}, {"matrix": "view_to_world"}, {"rotation": "transposed"}, {"translation": "position"}]
    found = [Cameras(convention, **layout) for layout in layouts for convention in VIEW_AXES]
    found += [Cameras(jitter="geometry_jitter")] if look.jitter.any() else []
    return found + [Cameras(focal_scale=scale) for scale in _mistaken_fields_of_view(look)]


def _mistaken_fields_of_view(look: Look) -> list[float]:
    """Return the factors that undo usual mistakes: the vertical angle taken for the horizontal one or the other way,
    and an angle in radians taken for degrees."""
    (width, height), camera = look.size, look.camera
    found = [width / height, height / width]
    for side, focal in ((width, camera.fx), (height, camera.fy)):
        angle = np.degrees(2 * np.arctan(side / 2 / focal))
        if 0 < angle < np.pi:
            found.append(float(side / 2 / focal / np.tan(angle / 2)))
    return found


@dataclass(frozen=True)
class Reading:
    """A hypothesis about all buffers. `rows` as of `FrameFormat`; `offset`: the buffer that is of another frame, and
    how many frames after its own that is."""

    motion: Motion = Motion()
    depth: Depth = Depth()
    cameras: Cameras = Cameras()
    rows: str = "down"
    offset: tuple[str, int] = ("", 0)

    def findings(self, stored: np.ndarray) -> list[Finding]:
        """Return a finding for each difference from the frames as given. `stored`: some of the depths."""
        made: list[Finding] = []
        if self.offset[1]:
            made.append(OtherFrame(*self.offset))
        if self.rows == "up":
            made.append(FormatChange("rows", {"rows": "up"}))
        return made + self.motion.findings() + self.cameras.findings() + self.depth.findings(stored)

    @property
    def changes(self) -> float:
        """Number of differences from the frames as given. Vectors from the previous frame with y up, as engines write
        them, count little more than one, and so do vectors to the next frame."""
        m, given = self.motion, GIVEN.motion
        turns = [0, 1, _LITTLE_MORE][(m.direction != given.direction) + (m.y != given.y)]
        parts = [turns, m.unit != "pixels", m.scale != 1, m.camera != "included", _LITTLE_MORE * m.to_next]
        parts += [m.other_jitter, self.rows != "down", self.offset[1] != 0]
        depth = 0 if self.depth == GIVEN.depth else 2 if self.depth.law.added is not None else 1
        return sum(parts) + len(self.cameras.keys()) + depth


GIVEN = Reading()


def rays(camera: Camera, px: np.ndarray) -> np.ndarray:
    """Return view positions (N, 3) float64 at depth 1 of pixels (N, 2)."""
    x, y = (px[:, 0] - camera.cx) / camera.fx, (px[:, 1] - camera.cy) / camera.fy
    return np.stack([x, y, np.ones_like(x)], -1)


def fit_depth(law: Law, basis: np.ndarray, a: np.ndarray, b: np.ndarray) -> Depth | None:
    """Return the parameters that fit a · w = b (`a`, `b`: (N, 2), in pixels), w = `basis` · c, for most samples; None
    if the camera does not move."""
    power = (a * a).sum(-1)
    ok = np.isfinite(basis).all(-1) & np.isfinite(b).all(-1) & (power > 0) & np.isfinite(power)
    if ok.sum() < 16:
        return None
    basis, a, b, power = basis[ok], a[ok], b[ok], power[ok]
    w = (a * b).sum(-1) / power
    start = _median_start(basis[:, 0], w, power) if law.terms == 1 else _drawn_start(law, basis, w, a, b)
    return None if start is None else Depth(law, tuple(_polished(law, start, basis, a, b).tolist()))


def _median_start(basis: np.ndarray, w: np.ndarray, power: np.ndarray) -> np.ndarray | None:
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = w / basis
    weight = np.sqrt(power) * np.abs(basis)
    order = np.argsort(ratio)
    total = np.cumsum(weight[order])
    if not total[-1] > 0:
        return None
    return ratio[order][np.searchsorted(total, total[-1] / 2)][None]


def _drawn_start(law: Law, basis: np.ndarray, w: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray | None:
    """Return, of the lines through two samples, the one with the smallest logarithms of residuals."""
    w = law.linear(w)
    one, two = np.random.default_rng(7).integers(len(w), size=(2, _DRAWS))
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = (w[two] - w[one]) / (basis[two, 1] - basis[one, 1])
        lines = np.stack([w[one] - slope * basis[one, 1], slope], -1)
    lines = lines[np.isfinite(lines).all(-1)]
    if not len(lines):
        return None
    some = slice(None, None, max(1, len(w) // 200))
    trial = law.inverse(basis[some] @ lines.T)  # (samples, lines)
    off = ((a[some][:, None] * trial[..., None] - b[some][:, None]) ** 2).sum(-1)
    return lines[np.log(off + 1e-4).mean(0).argmin()]


def _polished(law: Law, start: np.ndarray, basis: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the parameters after iteratively reweighted least squares, with a scale that follows the residuals."""
    found = start
    for _ in range(6):
        w = law.inverse(basis @ found)
        off = ((a * w[:, None] - b) ** 2).sum(-1)
        at = int(0.4 * len(off))
        weight = 1 / (1 + off / max(float(np.partition(off, at)[at]), 1e-8)) ** 2
        tangent = basis * law.slope(w)[:, None]
        left, right = tangent[:, None, :] * a[:, :, None], b - a * (w - tangent @ found)[:, None]
        normal = np.einsum("n,nij,nik->jk", weight, left, left)
        size = np.sqrt(np.diag(normal)) + 1e-300
        try:
            solved = np.linalg.solve(
                normal / np.outer(size, size), np.einsum("n,nij,ni->j", weight, left, right) / size
            )
        except np.linalg.LinAlgError:
            break
        if not np.isfinite(solved).all():
            break
        found = solved / size
    return found
