"""Loops of frames for benchmarks: two frames of a built-in scene go back and forth; frames of a sequence go forward,
and start again with a reset that is not counted."""

from __future__ import annotations

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


def is_sequence(subject: str | None) -> bool:
    """Return whether `loop_of` takes this for the folder of a sequence."""
    return subject is not None and not is_scene(subject)


def loop_of(
    device: Device, subject: str | None, size: tuple[int, int] | None, number: int | None = None, scale: float = 0.0
) -> FrameLoop:
    """Return the loop of the scene of that name (None: `SCENE`) at `size`, else of the sequence in that folder,
    whose size is None. With `scale` rendered frames are so many times smaller than `size`, and the display is so many
    times larger than a sequence. Raises GffeError."""
    if scale:
        smaller = None if size is None else (max(1, round(size[0] / scale)), max(1, round(size[1] / scale)))
        loop = loop_of(device, subject, smaller, number)
        return loop.shown_larger(*(size or (round(n * scale) for n in (loop.width, loop.height))))
    if is_sequence(subject):
        if size is not None:
            raise GffeError(f"--sizes are those of built-in scenes, {subject} is none (expected a sequence's own size)")
        return sequence_loop(Recorded(open_capture(str(subject)), device, "off"), number)
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


def sequence_loop(source: Recorded, number: int | None = None) -> FrameLoop:
    """Return up to 6 rendered frames of a sequence around `number` (default: the middle one), forward, none of them a
    reset except perhaps the first, as host arrays. The cameras are those of the truth where there is some."""
    first, last = _loop(source, number)
    interval = (source.time(last - 1) - source.time(first)) / (last - 1 - first)
    frames = tuple(source.rendered(k) for k in range(first, last))
    known = [source.cameras_at([source.time(k) + interval / 2]) for k in range(first, last)]
    cameras = tuple(found[0] if found else None for found in known)
    size = source.width, source.height
    return FrameLoop(source.name, *size, source.exposure, interval, frames, cameras, forward=True)


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
