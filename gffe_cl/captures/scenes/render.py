"""Rendering of built-in scenes to sequences on disk (`gffe render`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from gffe_cl.captures.scenes import EncodedFrames, Scene, SceneFrames, SceneRenderer
from gffe_cl.captures.sequence import FrameEntry, SequenceWriter, named_channels
from gffe_cl.captures.sequence.description import rendered_entry
from gffe_cl.captures.sequence.encoding import EXACT, Encoding
from gffe_cl.captures.sequence.exr import DEFAULT_COMPRESSION
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.frame.window import Jitter, WindowChooser
from gffe_cl.engine.opencl.device import Device

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
    encoding: Encoding = EXACT,
    compression: str = DEFAULT_COMPRESSION,
    on_frame: Callable[[], None] = lambda: None,
) -> int:
    """Render `frames` frames of `scene` at `fps` into the folder `output`, and return how many were written.

    With `ground_truth`, also `per_frame` frames after each, with their own depth and motion (to the rendered frame
    before), for measuring. `window` is "off", "fixed:FACTOR" or "adaptive": covering the frames in between. `width` and
    `height` are the display's; rendered frames are `scale` times smaller each way, with textures as fine as the
    display. `samples` per pixel: 8 if None, 1 of jittered frames. Rendered frames are stored by `encoding`; truth is
    exact but for its camera and a user interface. `compression` is that of the EXRs (see `SequenceWriter`).
    `on_frame` is called after every frame. Raises GffeError.
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
    WindowChooser(window, (width, height), alphas)
    jitter = jitter or Jitter()
    if encoding.is_on_display and not (window == "off" and jitter.length == 1 and scale == 1):
        raise GffeError("--encode: taa, jittered, half and hud exclude --window, --jitter and --scale")
    samples = samples or (1 if jitter.length > 1 else 8)
    job = _Job(scene, (width, height), fps, tuple(alphas), ground_truth, samples, window, jitter, scale, encoding)
    writing = SequenceWriter(
        output, width, height, fps, scene.exposure, generator="gffe-cl render", compression=compression,
        format=encoding.format,
    )  # fmt: skip
    with writing as writer:
        for entry, channels in _rendered(job, frames, device):
            writer.add(entry, channels)
            on_frame()
    return frames * (1 + len(alphas) * ground_truth)


@dataclass(frozen=True)
class _Job:
    scene: Scene
    size: tuple[int, int]  # of the display
    fps: float
    alphas: tuple[float, ...]
    ground_truth: bool
    samples: int
    window: str
    jitter: Jitter
    scale: float
    encoding: Encoding

    def frames(self, device: Device) -> SceneFrames:
        is_apart = self.ground_truth and (self.scale > 1 or self.jitter.length > 1)
        truths = SceneRenderer(device, self.scene, *self.size, 8) if is_apart else None
        windows = WindowChooser(self.window, self.size, self.alphas)
        return SceneFrames.for_upscaling(
            device, self.scene, self.size, self.scale, self.samples, self.jitter, windows, truths
        )


def _rendered(job: _Job, count: int, device: Device) -> Iterator[tuple[FrameEntry, dict]]:
    made, before = EncodedFrames(job.frames(device), job.encoding), None
    for k, frame in enumerate(made.frames.sequence(count, job.fps)):
        yield from _written(job, made, k, frame, before)
        before = frame


def _written(
    job: _Job, made: EncodedFrames, k: int, frame: RenderedFrame, before: RenderedFrame | None
) -> Iterator[tuple[FrameEntry, dict]]:
    """Yield the written frames for frame `k`, rendered after `before`: the frame and the truth after it."""
    stored = made.encoded(frame, before, k)
    yield rendered_entry(k, stored, job.size), named_channels(stored.color, stored.depth, stored.motion)
    for alpha in job.alphas if job.ground_truth else ():
        time = (k + alpha) * (1.0 / job.fps)
        image = made.frames.truth(time, frame).numpy()
        color = job.encoding.truth(image.color, job.scene.exposure)
        file = f"truth_{k:06d}_{round(alpha * 1000):04d}.exr"
        (camera,) = job.encoding.cameras(time, made.frames.display_camera(time))
        entry = FrameEntry(file, time, "ground_truth", display_camera=camera)
        yield entry, named_channels(color, image.depth, image.motion)
