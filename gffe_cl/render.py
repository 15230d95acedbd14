"""Rendering built-in scenes to sequences on disk (`gffe render`)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from gffe_cl.errors import GffeError
from gffe_cl.jitter import Jitter
from gffe_cl.opencl.device import Device
from gffe_cl.scenes import Scene, SceneFrames, SceneRenderer
from gffe_cl.sequence import FrameEntry, SequenceWriter, named_channels
from gffe_cl.sequence.exr import DEFAULT_COMPRESSION
from gffe_cl.source import rendered_entry
from gffe_cl.window import WindowChooser

_MOST_SCALE = 4


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
    samples: int | None = None,
    window: str = "off",
    jitter: Jitter | None = None,
    scale: float = 1.0,
    compression: str = DEFAULT_COMPRESSION,
    on_frame: Callable[[], None] = lambda: None,
) -> int:
    """Render `frames` frames of `scene` at `fps` into the folder `output`; returns how many were written.

    With `ground_truth`, also `per_frame` frames after each, with their own depth and motion (to the rendered frame
    before), for measuring. `window` is "off", "fixed:FACTOR" or "adaptive": covering the frames in between. `width` and
    `height` are the display's; rendered frames are `scale` times smaller each way, with textures as fine as the
    display. `samples` per pixel: 8 if None, 1 of jittered frames. `compression` is that of the EXRs (see
    `SequenceWriter`). `on_frame` is called after every frame.
    """
    if frames < 1:
        raise GffeError(f"--frames must be at least 1, got {frames}")
    if not 0 < fps < float("inf"):
        raise GffeError(f"--fps must be positive, got {fps:g}")
    if per_frame < 0:
        raise GffeError(f"-n must be at least 0 frames in between, got {per_frame}")
    alphas = [j / (per_frame + 1) for j in range(1, per_frame + 1)]
    if not 1 <= scale <= _MOST_SCALE:
        raise GffeError(f"--scale must be 1 to {_MOST_SCALE}, got {scale:g}")
    jitter, size = jitter or Jitter(), (width, height)
    small = tuple(max(round(n / scale), 1) for n in size)
    renderer = SceneRenderer(device, scene, *small, samples or (1 if jitter.length > 1 else 8), 1 / scale)
    truths = SceneRenderer(device, scene, *size, 8) if ground_truth and (scale > 1 or jitter.length > 1) else None
    made = SceneFrames(renderer, WindowChooser(window, size, alphas), size, jitter, truths)
    writing = SequenceWriter(
        output, width, height, fps, scene.exposure, generator="gffe-cl render", compression=compression
    )
    with writing as writer:
        for k, frame in enumerate(made.sequence(frames, fps)):
            writer.add(rendered_entry(k, frame, size), named_channels(frame.color, frame.depth, frame.motion))
            on_frame()
            for alpha in alphas if ground_truth else ():
                time = (k + alpha) * (1.0 / fps)
                image = made.truth(time, frame).numpy()
                file = f"truth_{k:06d}_{round(alpha * 1000):04d}.exr"
                entry = FrameEntry(file, time, "ground_truth", display_camera=made.display_camera(time))
                writer.add(entry, named_channels(image.color, image.depth, image.motion))
                on_frame()
    return frames * (1 + len(alphas) * ground_truth)
