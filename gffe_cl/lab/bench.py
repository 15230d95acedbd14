"""Loops of frames for benchmarks: two frames of a built-in scene go back and forth."""

from __future__ import annotations

from gffe_cl.captures.scenes import SceneRenderer, load_scene
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.timing.footage import FrameLoop

SCENE, SCENE_FRAME = "plaza", 31  # by default: the later one of a scene's two frames, at SCENE_FPS
SCENE_FPS = 30.0


def loop_of(
    device: Device, name: str | None, size: tuple[int, int], number: int | None = None, scale: float = 0.0
) -> FrameLoop:
    """Return the loop of the scene of that name (None: `SCENE`) at `size`. With `scale` rendered frames are so much
    smaller. Raises GffeError."""
    if not scale:
        return scene_loop(device, name or SCENE, *size, number=number)
    width, height = (max(1, round(n / scale)) for n in size)
    return scene_loop(device, name or SCENE, width, height, number).shown_larger(*size)


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
    return FrameLoop(name, width, height, scene.exposure, 1 / SCENE_FPS, tuple(frames), (between,) * 2)
