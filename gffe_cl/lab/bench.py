"""Loops of frames for benchmarks: two frames of a built-in scene go back and forth; frames of a sequence go forward,
and start again with a reset that is not counted."""

from __future__ import annotations

import numpy as np

from gffe_cl.captures.formats import open_capture
from gffe_cl.captures.offline.source import Recorded
from gffe_cl.captures.scenes import SceneRenderer, is_scene, load_scene
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.timing.footage import FrameLoop

SCENE, SCENE_FRAME = "plaza", 31  # by default: the later one of a scene's two frames, at SCENE_FPS
SCENE_FPS = 30.0
_LOOP = 6  # frames of a sequence
_SURFACE = 0.05  # neighbors whose inverse depths differ by less are taken for one surface,
_STRAIN = 1.0  # if their motion differs by less than that, pixels
_BAND = 128  # rows enlarged at a time


def is_sequence(subject: str | None) -> bool:
    """Return whether `loop_of` takes this for the folder of a sequence."""
    return subject is not None and not is_scene(subject)


def loop_of(
    device: Device, subject: str | None, size: tuple[int, int] | None, number: int | None = None, scale: float = 0.0
) -> FrameLoop:
    """Return the loop of the built-in scene of that name (None: `SCENE`), else of the sequence in that folder; `size`
    None: the sequence's own. With `scale` rendered frames are so many times smaller than `size`; None: the display is
    larger than the sequence."""
    if scale:
        smaller = None if size is None else (max(1, round(size[0] / scale)), max(1, round(size[1] / scale)))
        loop = loop_of(device, subject, smaller, number)
        return loop.shown_larger(*(size or (round(n * scale) for n in (loop.width, loop.height))))
    if is_sequence(subject):
        return sequence_loop(Recorded(open_capture(str(subject)), device, "off"), size, number)
    assert size is not None  # of scenes it is always given
    return scene_loop(device, subject or SCENE, *size, number=number)


def scene_loop(device: Device, name: str, width: int, height: int, number: int | None = None) -> FrameLoop:
    """Return the frames `number` − 1 and `number` (default: `SCENE_FRAME`) of a built-in scene, back and forth,
    rendered on `device`, as host arrays."""
    number = SCENE_FRAME if number is None else number
    if number < 1:
        raise GffeError(f"--frame must be at least 1, a frame with one before it, got {number}")
    scene = load_scene(name)
    renderer = SceneRenderer(device, scene, width, height, samples=1)
    times = [k / SCENE_FPS for k in (number - 1, number)]
    seen = [scene.camera(t, width, height) for t in times]
    frames = []
    for k in range(2):
        image = renderer.render(times[k], seen[k], times[1 - k], seen[1 - k])
        arrays = (image.read(buffer) for buffer in ("color", "depth", "motion"))
        frames.append(RenderedFrame(*arrays, camera=seen[k], time=times[k]))
    between = scene.camera(sum(times) / 2, width, height)
    return FrameLoop(name, width, height, scene.exposure, 1 / SCENE_FPS, tuple(frames), (between,) * 2, forward=False)


def sequence_loop(source: Recorded, size: tuple[int, int] | None = None, number: int | None = None) -> FrameLoop:
    """Return up to 6 rendered frames of a sequence around `number` (default: the middle one), forward, none of them a
    reset except perhaps the first, as host arrays; enlarged to `size` (width, height) by `enlarged`. The cameras are
    those of the truth where there is some."""
    first, last = _loop(source, number)
    width, height = size or (source.width, source.height)
    interval = (source.time(last - 1) - source.time(first)) / (last - 1 - first)
    frames = tuple(enlarged(source.rendered(k), width, height) for k in range(first, last))
    known = [source.cameras_at([source.time(k) + interval / 2]) for k in range(first, last)]
    factors = width / source.width, height / source.height
    cameras = tuple(found[0].scaled(*factors) if found else None for found in known)
    return FrameLoop(source.name, width, height, source.exposure, interval, frames, cameras, forward=True)


def _loop(source: Recorded, number: int | None) -> tuple[int, int]:
    """Return the number of the first rendered frame of the loop and of the one after its last."""
    count, resets, path = source.count, source.resets, source.sequence.path
    if number is None:
        followers = [k for k in range(count) if k not in resets]
        if not followers:
            raise GffeError(f"{path}: no rendered frame follows another one (expected at least 2 in a row)")
        number = min(followers, key=lambda k: abs(k - count // 2))
    if not 0 <= number < count or number in resets:
        raise GffeError(
            f"--frame {number}: expected a rendered frame of {path} with one before it, 1 to {count - 1}, and no reset"
        )
    start, end = source.reset_before(number), min((k for k in resets if k > number), default=count)
    first = max(start, min(number - _LOOP // 2, end - _LOOP))
    return first, min(end, first + _LOOP)


def enlarged(frame: RenderedFrame, width: int, height: int) -> RenderedFrame:
    """Return `frame` (host arrays) with `width` × `height` pixels; motion in its new pixels.

    Interpolation is bilinear in color, inverse depth and motion where the four neighbors lie on one surface, so that
    planes stay planes. Elsewhere the nearest pixel is used, so that edges stay edges.
    """
    old_height, old_width = np.shape(frame.depth)
    if (old_width, old_height) == (width, height):
        return frame
    factors = np.array([width / old_width, height / old_height], np.float32)
    motion = np.zeros((old_height, old_width, 2), np.float32) if frame.motion is None else frame.motion
    with np.errstate(all="ignore"):
        stack = np.concatenate([frame.color[..., :3], 1 / frame.depth[..., None], motion], -1, dtype=np.float32)
    columns = _taps(width, old_width)
    bands = [
        _enlarged_rows(stack, [part[y : y + _BAND] for part in _taps(height, old_height)], columns)
        for y in range(0, height, _BAND)
    ]
    stack = np.concatenate(bands)
    with np.errstate(all="ignore"):
        depth = 1 / stack[..., 3]
    camera = frame.camera.scaled(*factors.tolist())
    return RenderedFrame(stack[..., :3], depth, stack[..., 4:] * factors, camera, frame.time, reset=frame.reset)


def _taps(count: int, old: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return, for `count` new pixels along a side of `old`, the neighbors before and after, and the latter's weight."""
    place = np.clip((np.arange(count) + 0.5) * old / count - 0.5, 0, old - 1)
    low = place.astype(int)
    return low, np.minimum(low + 1, old - 1), (place - low).astype(np.float32)


def _enlarged_rows(stack: np.ndarray, rows, columns) -> np.ndarray:
    """Return rows of the enlarged `stack` (H, W, 6): color, inverse depth, motion."""
    top, bottom, down = rows
    left, right, across = columns
    taps = [stack[y][:, x] for y in (top, bottom) for x in (left, right)]
    weights = [v[:, None] * h[None, :] for v in (1 - down, down) for h in (1 - across, across)]
    depths = np.stack([tap[..., 3] for tap in taps])
    motions = np.stack([tap[..., 4:] for tap in taps])
    with np.errstate(all="ignore"):
        strain = np.ptp(motions, 0).max(-1)
        one_surface = (np.ptp(depths, 0) <= _SURFACE * depths.max(0)) & (strain <= _STRAIN)
        mixed = sum(weight[..., None] * tap for weight, tap in zip(weights, taps, strict=True))
    nearest = stack[np.where(down < 0.5, top, bottom)][:, np.where(across < 0.5, left, right)]
    return np.where(one_surface[..., None], mixed, nearest)
