"""Footage of benchmarks: two frames of a built-in scene go back and forth; frames of a sequence go forward, and start
again with a reset that is not counted."""

from __future__ import annotations

import numpy as np

from gffe_cl.captures.formats import open_capture
from gffe_cl.captures.scenes import SceneRenderer, is_scene, load_scene
from gffe_cl.captures.sequence import Sequence
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.stages.presentation import present
from gffe_cl.engine.timing.footage import Footage

SCENE, SCENE_FRAME = "plaza", 31  # by default: the later one of a scene's two frames, at SCENE_FPS
SCENE_FPS = 30.0
_LOOP = 6  # frames of a sequence
_SURFACE = 0.05  # neighbors whose inverse depths differ by less are taken for one surface,
_STRAIN = 1.0  # if their motion differs by less than that, pixels
_BAND = 128  # rows enlarged at a time


def is_sequence(subject: str | None) -> bool:
    """Return whether `footage_of` takes this for the folder of a sequence."""
    return subject is not None and not is_scene(subject)


def footage_of(
    device: Device, subject: str | None, size: tuple[int, int] | None, number: int | None = None, upscale: float = 0.0
) -> Footage:
    """Return the footage of the built-in scene of that name (None: `SCENE`), else of the sequence in that folder;
    `size` None: the sequence's own. With `upscale` rendered frames are so many times smaller than `size`; None: the
    display is larger than the sequence."""
    if upscale:
        smaller = None if size is None else (max(1, round(size[0] / upscale)), max(1, round(size[1] / upscale)))
        footage = footage_of(device, subject, smaller, number)
        return footage.shown_larger(*(size or (round(n * upscale) for n in (footage.width, footage.height))))
    if is_sequence(subject):
        return sequence_footage(device, open_capture(str(subject)), size, number)
    assert size is not None  # of scenes it is always given
    return scene_footage(device, subject or SCENE, *size, number=number)


def scene_footage(device: Device, name: str, width: int, height: int, number: int | None = None) -> Footage:
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
    return Footage(name, width, height, scene.exposure, 1 / SCENE_FPS, tuple(frames), (between,) * 2, forward=False)


def sequence_footage(
    device: Device, sequence: Sequence, size: tuple[int, int] | None = None, number: int | None = None
) -> Footage:
    """Return up to 6 rendered frames of a sequence around `number` (default: the middle one), forward, none of them a
    reset except perhaps the first, as host arrays; enlarged to `size` (width, height) by `enlarged`.

    Frames that were rendered through a window are cut to the displayed part. The cameras are those of the truth where
    there is some.
    """
    entries = sequence.rendered
    first, last = _loop(sequence, number)
    width, height = size or (sequence.width, sequence.height)
    factors = width / sequence.width, height / sequence.height
    frames, cameras, before = [], [], None
    interval = (entries[last - 1].time - entries[first].time) / (last - 1 - first)
    for entry in entries[first:last]:
        read = frame = sequence.read(entry)
        if frame.display_camera is not None:
            frame = present(frame, before, size=(sequence.width, sequence.height), device=device)
        before = read
        camera = sequence.camera_at(entry.time + interval / 2)
        frames.append(enlarged(frame, width, height))
        cameras.append(camera and camera.scaled(*factors))
    name = sequence.path.resolve().name
    return Footage(name, width, height, sequence.exposure, interval, tuple(frames), tuple(cameras), forward=True)


def _loop(sequence: Sequence, number: int | None) -> tuple[int, int]:
    """Return the number of the first rendered frame of the loop and of the one after its last."""
    entries = sequence.rendered
    resets = [k for k, entry in enumerate(entries) if entry.reset or k == 0]
    if number is None:
        followers = [k for k in range(len(entries)) if k not in resets]
        if not followers:
            raise GffeError(f"{sequence.path}: no rendered frame follows another one (expected at least 2 in a row)")
        number = min(followers, key=lambda k: abs(k - len(entries) // 2))
    if not 0 <= number < len(entries) or number in resets:
        raise GffeError(
            f"--frame {number}: expected a rendered frame of {sequence.path} with one before it, 1 to"
            f" {len(entries) - 1}, and no reset"
        )
    start = max(k for k in resets if k < number)
    end = min((k for k in resets if k > number), default=len(entries))
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
