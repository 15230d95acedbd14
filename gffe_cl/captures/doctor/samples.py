"""Samples for the doctor: pixels of a few frames on a grid, with the images of the frames beside them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from gffe_cl.captures.sequence import FrameEntry
from gffe_cl.captures.sequence.reader import read_ahead
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import QUIETLY
from gffe_cl.engine.frame.camera import Camera
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
