"""Samples for the doctor, pixels of a few frames on a grid with the images of the frames beside them; and hypotheses of
how motion vectors, depth and cameras may be meant, in the words of `FrameFormat`.

Depth is in terms of w = 1 / depth, which is linear in the unknown parameters: w = Σ c · φ(stored). Of logarithmic depth
ln(depth + added) is.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any, Protocol

import numpy as np

from gffe_cl.captures.doctor.findings import CameraKey, Finding, FormatChange, MotionToNext, OtherFrame, short
from gffe_cl.captures.sequence import FrameEntry
from gffe_cl.captures.sequence.reader import read_ahead
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import QUIETLY
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.conventions import DIRECTIONS
from gffe_cl.engine.frame.frame_format import FrameFormat, jitter_in_color
from gffe_cl.engine.frame.rendered_frame import BadPixels, RenderedFrame, wrong_geometry

PREVIOUS, NEXT = -1, 1
_TEXTURED = 0.02  # least difference of encoded color between neighbors for a distinguishable place
_SMALLEST = 8  # pixels: least size of an image
_FAR = 1e9  # depths beyond this are nothing, as +inf
_FIELDS = {"color": ("color", "contrast", "image"), "depth": ("depth", "deep")}


class Clip(Protocol):
    """Examined frames: a `Sequence`, or any object with its rendered frames, and the format that they were converted
    from, if any."""

    format: FrameFormat | None

    @property
    def rendered(self) -> list[FrameEntry]: ...

    def read(self, entry: FrameEntry) -> RenderedFrame: ...


@dataclass
class Look:
    """Samples of one rendered frame.

    Attributes
    ----------
    index : int
        Number among the rendered frames.
    size : (width, height), pixels
    px : (N, 2) float64, centers of the sampled pixels
    depth : (N,) float64, as stored
    motion : (N, 2) float64 as stored, or None
    color : (N, 3) float32, encoded by `encoded`
    contrast : (N,) float32, how far the encoded color is from that of the pixels around
    image, deep : (H, W, 3) float, linear color of the whole frame as stored, and (H, W) its depth; None where they
        are not needed
    jitter, shift : (2,) float64, of geometry, pixels, and its difference from that of the frame before
    unjittered : whether the conversion from a format added `shift` to motion
    neighbors : {PREVIOUS, NEXT → Look}, as far as there are any without a reset in between
    """

    index: int
    file: str
    size: tuple[int, int]
    px: np.ndarray
    depth: np.ndarray
    motion: np.ndarray | None
    color: np.ndarray
    contrast: np.ndarray
    image: np.ndarray | None
    deep: np.ndarray | None
    camera: Camera
    reset: bool
    bad: BadPixels
    first_bad: dict[str, tuple[int, int]] = field(default_factory=dict)
    exposure: float = 1.0
    jitter: np.ndarray = field(default_factory=lambda: np.zeros(2))
    shift: np.ndarray = field(default_factory=lambda: np.zeros(2))
    unjittered: bool = False
    neighbors: dict[int, Look] = field(default_factory=dict, repr=False)

    @property
    def stored_motion(self) -> np.ndarray | None:
        """Motion (N, 2) before the conversion from a format added the difference of jitter."""
        return self.motion - self.shift if self.unjittered and self.motion is not None else self.motion

    @property
    def solid(self) -> np.ndarray:
        """Mask (N,) bool of samples whose pixel shows a surface, for any meaning of its depth."""
        return np.isfinite(self.depth) & (np.abs(self.depth) < _FAR)

    @property
    def textured(self) -> np.ndarray:
        """Mask (N,) bool of samples whose color distinguishes their place from others nearby."""
        return self.contrast > _TEXTURED


def encoded(color: np.ndarray, exposure: float) -> np.ndarray:
    """Return linear color in perceptual steps: (…, 3) float32, logarithmic above mid-gray."""
    values = np.nan_to_num(np.asarray(color, np.float32) * np.float32(exposure), posinf=0.0, neginf=0.0)
    return np.log1p(16 * np.maximum(values, 0)) / np.float32(np.log(17))


def take_looks(
    clip: Clip, indices: Iterable[int], samples: int, images: set[int], exposure: float = 1.0
) -> dict[int, Look]:
    """Return {index: Look} of rendered frames; whole images are kept of those in `images`."""
    entries = clip.rendered

    @QUIETLY  # on threads of its own
    def look(index: int) -> Look:
        made = _look(clip.read(entries[index]), index, entries[index], samples, index in images, exposure)
        made.jitter = _jitter(entries[index], made.size, clip.format)
        if index and not made.reset:
            made.shift = made.jitter - _jitter(entries[index - 1], made.size, clip.format)
            made.unjittered = clip.format is not None and clip.format.motion_jittered
        return made

    looks = dict(read_ahead(sorted(set(indices)), look, 2))
    if not looks:
        raise GffeError("nothing to check: no rendered frame")
    return relinked(looks)


def _jitter(entry: FrameEntry, size: tuple[int, int], format: FrameFormat | None) -> np.ndarray:
    geometry = entry.geometry_size or (format and format.geometry_size) or size
    return np.array(jitter_in_color(entry.geometry_jitter, size, geometry))


def relinked(looks: dict[int, Look]) -> dict[int, Look]:
    """Make looks without neighbors each other's neighbors, by their numbers, and return them."""
    for index, one in looks.items():
        before = looks.get(index - 1)
        if before and not one.reset and before.size == one.size and min(one.size) >= _SMALLEST:
            one.neighbors[PREVIOUS], before.neighbors[NEXT] = before, one
    return looks


def turned(looks: dict[int, Look]) -> dict[int, Look]:
    """Return `looks` at images that are turned upside down, with the same samples."""
    return relinked({k: _upside_down(look) for k, look in looks.items()})


def _upside_down(look: Look) -> Look:
    px = look.px * (1, -1) + (0, look.size[1])
    image, deep = (None if array is None else array[::-1] for array in (look.image, look.deep))
    return replace(look, neighbors={}, px=px, image=image, deep=deep)


def of_other_frames(looks: dict[int, Look], buffer: str, by: int) -> dict[int, Look]:
    """Return `looks` with the `buffer` ("color", "depth", "motion" or "camera") of the look `by` after each; those that
    have none are left out."""
    made = {}
    for k, look in looks.items():
        other = look.neighbors.get(by)
        if other is not None and len(other.px) == len(look.px):
            made[k] = replace(look, neighbors={}, **{n: getattr(other, n) for n in _FIELDS.get(buffer, (buffer,))})
            if buffer == "motion" and other.stored_motion is not None:
                made[k].motion = other.stored_motion + look.shift * look.unjittered
    return relinked(made)


def grid(size: tuple[int, int], samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (x, y) indices of about `samples` pixels, evenly spread with an offset that changes from row to row."""
    width, height = size
    step = max(1.0, np.sqrt(width * height / samples))
    rows = np.arange(step / 2, height, step)
    columns = np.arange(0, width, step)
    x = columns[None] + ((np.arange(len(rows)) * 0.618) % 1 * step)[:, None]
    y = np.broadcast_to(rows[:, None], x.shape)
    inside = x < width
    return x[inside].astype(int), y[inside].astype(int)


def _look(frame: RenderedFrame, index: int, entry: FrameEntry, samples: int, whole: bool, exposure: float) -> Look:
    depth, color = np.asarray(frame.depth), np.asarray(frame.color)[..., :3]
    height, width = depth.shape
    motion = None if frame.motion is None else np.asarray(frame.motion)
    x, y = grid((width, height), samples)
    around = [
        encoded(color[np.clip(y + dy, 0, height - 1), np.clip(x + dx, 0, width - 1)], exposure)
        for dx, dy in ((0, 0), (2, 0), (-2, 0), (0, 2), (0, -2))
    ]
    bad, first = _bad_pixels(frame)
    return Look(
        index=index,
        file=entry.file,
        size=(width, height),
        px=np.stack([x, y], -1) + 0.5,
        depth=depth[y, x].astype(np.float64),
        motion=None if motion is None else motion[y, x].astype(np.float64),
        color=around[0],
        contrast=np.abs(np.stack(around[1:]) - around[0]).mean((0, 2)),
        image=color if whole else None,
        deep=depth if whole else None,
        camera=frame.camera,
        reset=entry.reset,
        bad=bad,
        first_bad=first,
        exposure=exposure,
    )


def _bad_pixels(frame: RenderedFrame) -> tuple[BadPixels, dict[str, tuple[int, int]]]:
    """Return counts of invalid values, and the position of the first one of each kind."""
    motion = None if frame.motion is None else np.asarray(frame.motion)
    kinds: dict[str, Any] = wrong_geometry(np.asarray(frame.depth), motion)
    finite = np.isfinite(frame.color)
    kinds["color"] = np.zeros(1, bool) if finite.all() else ~finite.all(-1)  # all of them at once is quicker
    first = {}
    for name, wrong in kinds.items():
        if wrong.any():
            y, x = np.unravel_index(int(wrong.argmax()), wrong.shape)
            first[name] = (int(x), int(y))
    return BadPixels(**{name: int(wrong.sum()) for name, wrong in kinds.items()}), first


def sampled(look: Look, px: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the encoded color (…, 3) of a look's image at pixel positions (…, 2), bilinear, and whether each is
    inside."""
    image = look.image
    assert image is not None  # kept of the looks that are asked for
    height, width = image.shape[:2]
    x, y = px[..., 0] - 0.5, px[..., 1] - 0.5
    with np.errstate(invalid="ignore"):
        inside = (x >= 0) & (y >= 0) & (x <= width - 1) & (y <= height - 1)
    x, y = np.where(inside, x, 0), np.where(inside, y, 0)
    x0, y0 = np.minimum(x.astype(np.intp), width - 2), np.minimum(y.astype(np.intp), height - 2)
    fx, fy = (x - x0)[..., None].astype(np.float32), (y - y0)[..., None].astype(np.float32)

    def tap(down: int, right: int) -> np.ndarray:
        return image[y0 + down, x0 + right].astype(np.float32)

    top = tap(0, 0) * (1 - fx) + tap(0, 1) * fx
    bottom = tap(1, 0) * (1 - fx) + tap(1, 1) * fx
    return encoded(top * (1 - fy) + bottom * fy, look.exposure), inside


VIEW_AXES = {"gffe": (1, 1, 1), "opengl": (1, -1, -1), "direct3d": (1, -1, 1)}  # x right, y down, z forward: 1
_INFINITE = 5e-4  # near / far: below that far is indistinguishable from infinity
_SIGNED = 0.01  # device depths below minus this reach from −1 to 1
_MOST_POWER = 60.0  # of e
_FARTHEST = 1e9  # finite far planes
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
        fields = self.findings(stored)[0].fields
        if _FARTHEST < fields["far_z"] < np.inf:
            return False
        try:
            FrameFormat(**fields)
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
