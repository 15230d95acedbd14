"""Hypotheses about depths, whose parameters (near, far, units) are fitted to motion vectors.

Everything is in terms of w = 1 / depth, which is linear in the unknown parameters: w = Σ c · φ(stored). Of logarithmic
depth ln(depth + added) is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gffe_cl.engine.frame.camera import Camera

_DRAWS = 48
_INFINITE = 5e-4  # near / far: below that far is indistinguishable from infinity
_SIGNED = 0.01  # device depths below minus this reach from −1 to 1


def rays(camera: Camera, px: np.ndarray) -> np.ndarray:
    """Return view positions (N, 3) float64 at depth 1 of pixels (N, 2)."""
    x, y = (px[:, 0] - camera.cx) / camera.fx, (px[:, 1] - camera.cy) / camera.fy
    return np.stack([x, y, np.ones_like(x)], -1)


@dataclass(frozen=True)
class DepthModel:
    """Model of a depth buffer: its `name`, how many functions φ it has, and what it costs as a hypothesis. `added` to
    depth before the logarithm, of which φ is linear; None: w is."""

    name: str
    terms: int
    cost: float
    added: float | None = None

    @property
    def is_of_device(self) -> bool:
        """Whether the stored numbers were taken for device depth and made linear."""
        return self.name == _LINEARIZED

    def basis(self, stored: np.ndarray, ray: np.ndarray) -> np.ndarray:
        """Return the basis (N, terms) of stored depths (N,) and rays (N, 3)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            if self.name == "planar":
                return (1 / stored)[..., None]
            if self.name == "along rays":
                return (np.linalg.norm(ray, axis=-1) / stored)[..., None]
            if self.name in _BITS:
                return (1 / _decoded(stored, *_BITS[self.name]))[..., None]
            if self.name in (RANGE_NAME, _LINEARIZED):
                return np.stack([np.ones_like(stored), 1 / stored], -1)
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


RANGE_NAME, _LINEARIZED = "range", "logarithmic as device"
_MOST_POWER = 60.0  # of e
_BITS = {"bits of 32-bit floats": (np.uint32, np.float32), "bits of 16-bit floats": (np.uint16, np.float16)}
PLANAR, ALONG_RAYS = DepthModel("planar", 1, 1.0), DepthModel("along rays", 1, 1.0)
DEVICE = DepthModel("device", 2, 1.5)
# A depth buffer that was made linear with 0 … 1 taken for −1 … 1, or the other way.
RANGE = DepthModel(RANGE_NAME, 2, 1.5)
MODELS = (PLANAR, ALONG_RAYS, DEVICE, RANGE)
# Logarithms of z and of 1 + z: as stored, and as they become if they are made linear like device depth.
LOGARITHMIC = tuple(DepthModel(name, 2, 2.0, added) for name in ("logarithmic", _LINEARIZED) for added in (0.0, 1.0))
FLOAT_BITS = tuple(DepthModel(name, 1, 1.5) for name in _BITS)
RARE = (*LOGARITHMIC, *FLOAT_BITS)  # laws that are tried only with what one of MODELS fits best


def _decoded(stored: np.ndarray, integer: type, number: type) -> np.ndarray:
    """Return the numbers (…) float64 whose bits were read as integers, or as parts of the largest integer."""
    most = np.iinfo(integer).max
    scale = most if np.nanmax(np.abs(stored), initial=0) <= 1 else 1
    whole = np.clip(np.nan_to_num(np.round(stored * scale)), 0, most).astype(integer)
    return whole.view(number).astype(np.float64)


_RANGES = 2.0, 0.5
_NEAR_RANGE = 0.05  # of the logarithm of the range's factor


def misread_range(factor: float) -> float | None:
    """Return 2 if 0 … 1 was taken for −1 … 1, 0.5 for the reverse, None if `factor`, of 1 / depth, fits neither."""
    return next((r for r in _RANGES if factor > 0 and abs(np.log(factor / r)) < _NEAR_RANGE), None)


@dataclass(frozen=True)
class DepthReading:
    """Depth model with its parameters: 1 / depth = basis · coefficients."""

    model: DepthModel = PLANAR
    coefficients: tuple[float, ...] = (1.0,)

    @property
    def is_possible(self) -> bool:
        """Whether the parameters have a meaning, perhaps with all axes reversed."""
        return self.model is not RANGE or misread_range(abs(self.coefficients[1])) is not None

    @property
    def has_meaning(self) -> bool:
        """Whether the parameters have a meaning under the axes they were found with."""
        return self.model is not RANGE or misread_range(self.coefficients[1]) is not None

    def inverse(self, stored: np.ndarray, ray: np.ndarray) -> np.ndarray:
        """Return 1 / planar depth (N,) float64 in units of the camera's translation; 0 for no surface."""
        with np.errstate(invalid="ignore"):
            w = self.model.inverse(self.model.basis(stored, ray) @ np.array(self.coefficients))
        return np.where(np.isinf(stored), 0.0, w)


AS_GIVEN = DepthReading()


def is_from_0_to_1(stored: np.ndarray) -> bool:
    """Return whether `stored` depths (N,) can be those of a depth buffer."""
    return bool(np.nanmin(stored) > -_SIGNED and np.nanmax(stored) < 1 + _SIGNED)


@dataclass(frozen=True)
class Planes:
    """Clipping planes of device depth: `near` and `far` (may be infinite) in world units; `reverse`: far is at the
    `low` end, which is 0 or −1, the other one being 1."""

    near: float
    far: float
    reverse: bool
    low: float

    @classmethod
    def of(cls, depth: DepthReading, stored: np.ndarray) -> Planes:
        """Return the planes of a reading by the model DEVICE; `stored`: some of the depths."""
        low = -1.0 if np.nanmin(stored) < -_SIGNED else 0.0
        first, last = (depth.coefficients[0] + depth.coefficients[1] * end for end in (low, 1.0))
        nearest, farthest = max(first, last), min(first, last)
        far = np.inf if farthest < _INFINITE * nearest else 1 / farthest
        return cls(1 / nearest, far, bool(last > first), low)

    @property
    def far_end(self) -> float:
        """The stored value at the far plane: nothing is there."""
        return self.low if self.reverse else 1.0

    def reading(self) -> DepthReading:
        first, last = (1 / self.far, 1 / self.near) if self.reverse else (1 / self.near, 1 / self.far)
        slope = (last - first) / (1 - self.low)
        return DepthReading(DEVICE, (last - slope, slope))


def fit_depth(model: DepthModel, basis: np.ndarray, a: np.ndarray, b: np.ndarray, frame=None) -> DepthReading | None:
    """Return the parameters that fit a · w = b (`a`, `b`: (N, 2), in pixels), w = `basis` · c, for most samples;
    None if the camera does not move. With `frame` (N,) int the model is a · w = b + a constant per frame."""
    power = (a * a).sum(-1)
    ok = np.isfinite(basis).all(-1) & np.isfinite(b).all(-1) & (power > 0) & np.isfinite(power)
    if ok.sum() < 16:
        return None
    basis, a, b, power = basis[ok], a[ok], b[ok], power[ok]
    frame = None if frame is None else frame[ok]
    w = (a * b).sum(-1) / power
    start = _median_start(basis[:, 0], w, power) if model.terms == 1 else _drawn_start(model, basis, w, a, b)
    return None if start is None else DepthReading(model, tuple(_polished(model, start, basis, a, b, frame).tolist()))


def _median_start(basis, w, power) -> np.ndarray | None:
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = w / basis
    weight = np.sqrt(power) * np.abs(basis)
    order = np.argsort(ratio)
    total = np.cumsum(weight[order])
    if not total[-1] > 0:
        return None
    return ratio[order][np.searchsorted(total, total[-1] / 2)][None]


def _drawn_start(model, basis, w, a, b) -> np.ndarray | None:
    """Return, of the lines through two samples, the one with the smallest logarithms of residuals."""
    w = model.linear(w)
    one, two = np.random.default_rng(7).integers(len(w), size=(2, _DRAWS))
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = (w[two] - w[one]) / (basis[two, 1] - basis[one, 1])
        lines = np.stack([w[one] - slope * basis[one, 1], slope], -1)
    lines = lines[np.isfinite(lines).all(-1)]
    if not len(lines):
        return None
    some = slice(None, None, max(1, len(w) // 200))
    trial = model.inverse(basis[some] @ lines.T)  # (samples, lines)
    off = ((a[some][:, None] * trial[..., None] - b[some][:, None]) ** 2).sum(-1)
    return lines[np.log(off + 1e-4).mean(0).argmin()]


def _polished(model, start, basis, a, b, frame=None) -> np.ndarray:
    """Return the parameters after iteratively reweighted least squares, with a scale that follows the residuals."""
    found, constant = start, 0.0
    for _ in range(6 if frame is None else 12):
        w = model.inverse(basis @ found)
        off = ((a * w[:, None] - b - constant) ** 2).sum(-1)
        at = int(0.4 * len(off))
        weight = 1 / (1 + off / max(float(np.partition(off, at)[at]), 1e-8)) ** 2
        tangent = basis * model.slope(w)[:, None]
        left, right = tangent[:, None, :] * a[:, :, None], b - a * (w - tangent @ found)[:, None]
        if frame is not None:
            left, right = left - _frame_means(left, weight, frame), right - _frame_means(right, weight, frame)
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
        if frame is not None:
            constant = _frame_means(a * model.inverse(basis @ found)[:, None] - b, weight, frame)
    return found


def _frame_means(values: np.ndarray, weight: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """Return weighted means of `values` (N, …) over each frame, at each sample."""
    flat = values.reshape(len(values), -1)
    total = np.bincount(frame, weight) + 1e-300
    means = np.stack([np.bincount(frame, weight * column) / total for column in flat.T], -1)
    return means[frame].reshape(values.shape)
