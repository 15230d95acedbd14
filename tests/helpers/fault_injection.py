"""Fault injection: good sequences are given the faults of real captures, to measure and test the doctor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gffe_cl.captures.sequence import FrameEntry
from gffe_cl.captures.sequence.description import check_times
from gffe_cl.captures.sequence.encoding import Encoding
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.rendered_frame import RenderedFrame

NEAR = 0.1  # world units, of device depths
_FOCAL_ERROR = 1.08
_GRAIN = 0.03  # of linear colors
_UNWRITTEN, _FEW = 65504.0, 0.002  # pixels, and the share of vectors that have this value
_FAR = 1e9  # stands for infinity where directions are reprojected
_JITTER = 8  # positions of the Halton sequence
_CAPTURE = Encoding.parse("engine")


class Kept:
    """Clip of rendered frames in memory, with the parts of a `Sequence` that the doctor needs."""

    def __init__(self, frames: list[RenderedFrame], exposure: float = 1.0, fps: float = 30.0):
        self.images, self.exposure, self.fps = frames, exposure, fps
        self.format = None
        self.height, self.width = np.shape(frames[0].depth)
        self.frames = [
            FrameEntry(f"frame_{k:06d}.exr", f.time, "rendered", f.reset, (self.width, self.height), f.camera, f.camera)
            for k, f in enumerate(frames)
        ]
        check_times(self.frames)

    @property
    def rendered(self) -> list[FrameEntry]:
        return self.frames

    def read(self, entry: FrameEntry) -> RenderedFrame:
        return self.images[int(entry.file[6:12])]


def static_motion(frame: RenderedFrame, other: Camera) -> np.ndarray:
    """Return the motion (H, W, 2) float64, pixels: where everything would be seen by `other` if nothing moved, minus
    where it is."""
    height, width = frame.depth.shape
    y, x = np.mgrid[:height, :width] + 0.5
    px = np.stack([x, y], -1)
    depth = np.asarray(frame.depth, np.float64)
    with np.errstate(all="ignore"):
        depth = np.where((depth > 0) & (depth < _FAR), depth, _FAR)
        return other.project(frame.camera.unproject(px, depth))[0] - px


def _each(change: Callable[[RenderedFrame], dict]) -> Callable:
    return lambda frames: [replace(frame, **change(frame)) for frame in frames]


def _motion(change: Callable[[np.ndarray, tuple[int, int]], np.ndarray]) -> Callable:
    def changed(frame):
        if frame.motion is None:
            return {}
        height, width = frame.depth.shape
        return {"motion": np.asarray(change(frame.motion, (width, height)), np.float32)}

    return _each(changed)


def _scaled_motion(factor) -> Callable:
    return _motion(lambda v, size: v * np.asarray(factor, np.float64))


def _depth(change: Callable[[np.ndarray], np.ndarray]) -> Callable:
    def changed(frame):
        with np.errstate(all="ignore"):
            return {"depth": np.asarray(change(frame.depth.astype(np.float64)), np.float32)}

    return _each(changed)


def _camera(change: Callable[[np.ndarray], np.ndarray], focal: float = 1.0) -> Callable:
    def changed(frame):
        c = frame.camera
        made = Camera(change(c.world_to_view.copy()), c.fx * focal, c.fy * focal, c.cx, c.cy)
        return {"camera": made, "display_camera": None}

    return _each(changed)


def _rotation_transposed(m):
    m[:3, :3] = m[:3, :3].T.copy()
    return m


def _with_motion(frames, motions):
    pairs = zip(frames, motions, strict=True)
    return [replace(f, motion=None if m is None else np.asarray(m, np.float32)) for f, m in pairs]


def _to_next(frames):
    """Return the frames with vectors to the next frame: exact for static points, the previous motion for movers."""
    motions = []
    for k, frame in enumerate(frames):
        if k + 1 == len(frames):
            motions.append(np.zeros_like(frames[1].motion))
            continue
        made = static_motion(frame, frames[k + 1].camera)
        if k and frame.motion is not None:
            before = static_motion(frame, frames[k - 1].camera)
            own = frame.motion - before
            made = np.where((np.linalg.norm(own, axis=-1) > 0.25)[..., None], made - own, made)
        motions.append(made)
    return _with_motion(frames, motions)


def _without_camera(frames):
    motions = [frames[0].motion]
    motions += [f.motion - static_motion(f, before.camera) for before, f in zip(frames, frames[1:], strict=False)]
    return _with_motion(frames, motions)


def _jittered(frames):
    offsets = jitter(len(frames))
    motions = [frames[0].motion]
    motions += [f.motion + (a - b) for f, a, b in zip(frames[1:], offsets, offsets[1:], strict=False)]
    return _with_motion(frames, motions)


def jitter(count: int) -> np.ndarray:
    """Return offsets (count, 2) in pixels within half a pixel: the Halton sequence of bases 2 and 3."""

    def radical(index, base):
        value, share = 0.0, 1.0 / base
        while index:
            value += share * (index % base)
            index, share = index // base, share / base
        return value

    return np.array([[radical(k % _JITTER + 1, base) - 0.5 for base in (2, 3)] for k in range(count)])


def _sky_still(frame):
    if frame.motion is None:
        return {}
    return {"motion": np.where(np.isinf(frame.depth)[..., None], 0, frame.motion).astype(np.float32)}


def _few_unwritten(frames):
    rng = np.random.default_rng(2)

    def change(v, size):
        return np.where((rng.random(v.shape[:2]) < _FEW)[..., None], _UNWRITTEN, v)

    return _motion(change)(frames)


def _one_dropped(frames):
    return [frame for k, frame in enumerate(frames) if k != len(frames) // 2]


def _letterboxed(frame):
    color, bar = frame.color.copy(), len(frame.color) // 8
    color[:bar] = color[-bar:] = 0
    return {"color": color}


def _grainy(frames):
    rng = np.random.default_rng(1)
    return _each(lambda frame: {"color": _noisy(frame.color, rng)})(frames)


def _noisy(color, rng):
    return np.maximum(color + rng.normal(0, _GRAIN, color.shape), 0).astype(np.float16)


def _fading_in(frames):
    return [replace(frame, color=frame.color * np.float16(k / len(frames))) for k, frame in enumerate(frames)]


def _times_kept(frames, order):
    none = np.zeros_like(frames[1].motion)
    moved = []
    for place, k in enumerate(order):
        motion = none if frames[k].motion is None else frames[k].motion
        moved.append(replace(frames[k], time=frames[place].time, reset=place == 0, motion=motion))
    return moved


def _two_swapped(frames):
    order, at = list(range(len(frames))), len(frames) // 2
    order[at], order[at - 1] = order[at - 1], order[at]
    return _times_kept(frames, order)


def _bottom_up(*buffers: str) -> Callable:
    def changed(frame):
        stored = {name: getattr(frame, name) for name in buffers}
        return {name: image[::-1].copy() for name, image in stored.items() if image is not None}

    return _each(changed)


BREAKS: dict[str, tuple[str, Callable]] = {
    "motion jitter not removed": ("motion", _jittered),
    "motion without the camera": ("motion", _without_camera),
    "motion to the next frame": ("motion", _to_next),
    "motion negated": ("motion", _scaled_motion((-1, -1))),
    "depth in centimeters": ("depth", _depth(lambda z: z * 100)),
    "camera transposed": ("camera", _camera(_rotation_transposed)),
    "camera field of view": ("camera", _camera(lambda m: m, _FOCAL_ERROR)),
    "two frames swapped": ("order", _two_swapped),
    "color rows": ("color", _bottom_up("color")),
}
HARMLESS: dict[str, Callable] = {
    "as it is": lambda frames: frames,
    "vectors to 1/16 px": _motion(lambda v, size: np.round(v * 16) / 16),
    "vectors to 1 px": _motion(lambda v, size: np.round(v)),
    "sky without motion": _each(_sky_still),
    "few vectors unwritten": _few_unwritten,
    "letterboxed": _each(_letterboxed),
    "film grain": _grainy,
    "exposure fades in": _fading_in,
    "as in an engine's capture": _each(lambda frame: vars(_CAPTURE.frame(frame))),
}

GAPS: dict[str, Callable] = {"frame dropped": _one_dropped}


def broken(clip: Kept, names: list[str]) -> Kept:
    """Return `clip` with the faults `names` (of BREAKS, HARMLESS or GAPS), one after the other. Raises GffeError for an
    unknown one."""
    frames, known = clip.images, {name: change for name, (_, change) in BREAKS.items()} | HARMLESS | GAPS
    for name in names:
        if name not in known:
            raise GffeError(f"unknown fault '{name}': expected one of {', '.join(known)}")
        frames = known[name](frames)
    return Kept(frames, clip.exposure, clip.fps)
