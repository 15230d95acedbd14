"""Rendering built-in scenes to sequences on disk (`gffe render`)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from gffe_cl.errors import GffeError
from gffe_cl.opencl.device import Device
from gffe_cl.scenes import Scene, SceneRenderer, sequence_frames
from gffe_cl.sequence import FrameEntry, SequenceWriter, named_channels
from gffe_cl.window import WindowChooser


def render_sequence(
    scene: Scene,
    output: Path,
    device: Device,
    width: int,
    height: int,
    frames: int,
    fps: float,
    *,
    ground_truth: bool = False,
    per_frame: int = 1,
    samples: int = 8,
    window: str = "off",
    on_frame: Callable[[], None] = lambda: None,
) -> int:
    """Render `frames` frames of `scene` at `fps` into the folder `output`; returns how many were written.

    With `ground_truth`, also `per_frame` frames after each, with their own depth and motion (to the
    rendered frame before), for measuring. `window` is "off", "fixed:FACTOR" or "adaptive": covering the frames in
    between. `on_frame` is called after every frame.
    """
    if frames < 1:
        raise GffeError(f"--frames must be at least 1, got {frames}")
    if not 0 < fps < float("inf"):
        raise GffeError(f"--fps must be positive, got {fps:g}")
    windows = WindowChooser(window, (width, height), [j / (per_frame + 1) for j in range(1, per_frame + 1)])
    renderer = SceneRenderer(device, scene, width, height, samples)
    count = 0
    with SequenceWriter(output, width, height, fps, scene.exposure, generator="gffe-cl render") as writer:
        plan = sequence_frames(scene, width, height, frames, fps, ground_truth, per_frame, windows=windows)
        for frame in plan:
            image = renderer.render(frame.time, frame.camera, frame.previous_time, frame.previous_camera).numpy()
            rendered = frame.kind == "rendered"
            name = (
                f"frame_{frame.source:06d}" if rendered else f"truth_{frame.source:06d}_{round(frame.alpha * 1000):04d}"
            )
            if rendered:
                windows.observe(image.depth)
            entry = FrameEntry(
                file=f"{name}.exr",
                time=frame.time,
                kind=frame.kind,
                reset=rendered and frame.reset,
                render_camera=frame.camera if rendered else None,
                display_camera=frame.display_camera,
            )
            writer.add(entry, named_channels(image.color, image.depth, image.motion))
            count += 1
            on_frame()
    return count
