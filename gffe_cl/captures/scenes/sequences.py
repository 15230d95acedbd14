"""Frames and sequences of built-in scenes, and `gffe render`, which writes them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from gffe_cl.captures.scenes.renderer import SceneImage, SceneRenderer
from gffe_cl.captures.scenes.scene_types import Scene
from gffe_cl.captures.sequence import FrameEntry, SequenceWriter, named_channels
from gffe_cl.captures.sequence.description import rendered_entry
from gffe_cl.captures.sequence.encoding import EXACT, HALF, JITTERED, TAA, Encoding, TemporalAntialiasing
from gffe_cl.captures.sequence.exr import DEFAULT_COMPRESSION
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.frame.window import Jitter, WindowChooser
from gffe_cl.engine.opencl.device import Device

JITTER_LENGTH = 16  # frames until built-in scenes repeat their jitter


def require_frames(count: int, fps: float) -> None:
    """Raise GffeError unless a scene can be asked for `count` rendered frames at `fps`."""
    if count < 1 or not (0 < fps < float("inf") and 1.0 / fps < float("inf")):
        raise GffeError(f"a built-in scene needs at least 1 frame and positive fps, got {count} and {fps:g}")


class SceneFrames:
    """Frames of a scene by `renderer`: rendered frames, and the truth at any time.

    Parameters
    ----------
    windows : WindowChooser or None
        Chooses the window of each rendered frame. None: no windows.
    size : (width, height) or None
        Size of the display, pixels; that of the renderer's image if None.
    jitter : Jitter or None
        Jitter of rendered frames. None: none.
    truths : SceneRenderer or None
        Renders truth; its image has the display's size. None: `renderer`, where that has it.
    """

    def __init__(
        self,
        renderer: SceneRenderer,
        windows: WindowChooser | None = None,
        size: tuple[int, int] | None = None,
        jitter: Jitter | None = None,
        truths: SceneRenderer | None = None,
    ):
        self.renderer, self.scene = renderer, renderer.scene
        self.render_size = (renderer.width, renderer.height)
        self.size = size or self.render_size
        self.windows = windows or WindowChooser("off", self.size, [])
        self.jitter = jitter or Jitter()
        self._truths = truths or renderer

    @classmethod
    def smaller(
        cls,
        device: Device,
        scene: Scene,
        size: tuple[int, int],
        scale: float,
        samples: int = 1,
        jitter: Jitter | None = None,
        windows: WindowChooser | None = None,
        truths: SceneRenderer | None = None,
    ) -> SceneFrames:
        """Return frames of `scene` for a display of `size`: `scale` times smaller each way, with `samples` per pixel,
        textures as fine as the display, and jitter (None: that of built-in scenes)."""
        width, height = (max(round(n / scale), 1) for n in size)
        renderer = SceneRenderer(device, scene, width, height, samples, 1 / scale)
        return cls(renderer, windows, size, jitter or Jitter(JITTER_LENGTH), truths)

    def display_camera(self, time: float) -> Camera:
        """Return the scene's camera at `time` (seconds), in display pixels."""
        return self.scene.camera(time, *self.size)

    def render_camera(self, shown: Camera, before: RenderedFrame | None, number: int = 0) -> Camera:
        """Return the camera to render frame `number` with, after the rendered frame `before` (None: after a reset), so
        that `shown` is seen."""
        window = self.windows.choose(shown, before and before.shown_camera)
        return self.jitter.camera(window.camera(shown, self.size, self.render_size), number)

    def image(self, time: float, camera: Camera, before: RenderedFrame | None = None, number: int = 0) -> SceneImage:
        """Return the image at `time` seen by `camera`, on the device until the next one is rendered. Motion refers to
        `before`; None: to the frame itself. `number`: for jitter."""
        phase = number % self.jitter.length
        other = before and before.time, before and before.camera
        return self.renderer.render(time, camera, *other, phase=phase)

    def rendered(self, time: float, before: RenderedFrame | None = None, number: int = 0) -> RenderedFrame:
        """Return the rendered frame at `time` after `before`, of host arrays; a reset without one. `number`: for
        jitter."""
        shown = self.display_camera(time)
        camera = self.render_camera(shown, before, number)
        image = self.image(time, camera, before, number).numpy()
        self.windows.observe(image.depth)
        return RenderedFrame(image.color, image.depth, image.motion, camera, time, shown, reset=before is None)

    def truth(self, time: float, before: RenderedFrame | None = None) -> SceneImage:
        """Return the displayed image at `time`, between rendered frames or at one; motion leads into the rendered frame
        `before`."""
        assert self.size == (self._truths.width, self._truths.height)
        return self._truths.render(time, self.display_camera(time), before and before.time, before and before.camera)

    def sequence(self, count: int, fps: float | None = None, start: float = 0.0) -> Iterator[RenderedFrame]:
        """Yield `count` rendered frames in order of time from `start` (seconds) on, 1 / `fps` (default: the scene's)
        apart; the first is a reset."""
        fps = fps or self.scene.fps
        require_frames(count, fps)
        step = 1.0 / fps
        before = None
        for k in range(count):
            before = self.rendered(start + k * step, before, k)
            yield before


class EncodedFrames:
    """Rendered frames of `frames`, stored by `encoding`. Jittered samples, where it needs them, are rendered beside."""

    def __init__(self, frames: SceneFrames, encoding: Encoding):
        self.frames, self.encoding = frames, encoding
        self._antialiasing = TemporalAntialiasing(frames.scene.exposure)
        device, jitter = frames.renderer.device, Jitter(JITTER_LENGTH)
        if encoding.parts & {TAA, JITTERED}:
            full = SceneRenderer(device, frames.scene, *frames.size, samples=1)
            self._samples = _JitteredSamples(SceneFrames(full, jitter=jitter))
        if HALF in encoding.parts:
            self._small = _JitteredSamples(SceneFrames.smaller(device, frames.scene, frames.size, 2.0))

    def encoded(self, frame: RenderedFrame, number: int) -> RenderedFrame:
        """Return `frame`, number `number`, after being stored. Where encodings are `is_rendered`, frames must come in
        order."""
        if self.encoding.is_rendered:
            frame = self._rendered(frame, number)
        return self.encoding.frame(frame, self.frames.scene.exposure)

    def sequence(self, count: int, fps: float | None = None, start: float = 0.0) -> Iterator[RenderedFrame]:
        """Yield stored frames as `SceneFrames.sequence` yields exact ones."""
        for k, frame in enumerate(self.frames.sequence(count, fps, start)):
            yield self.encoded(frame, k)

    def _rendered(self, frame: RenderedFrame, number: int) -> RenderedFrame:
        """Return `frame` antialiased over time, or its geometry jittered, perhaps smaller, or both."""
        parts, sample = self.encoding.parts, None
        if parts & {TAA, JITTERED}:
            sample = self._samples.of(frame, number)
            if TAA in parts:
                frame = replace(frame, color=self._antialiasing.resolve(sample, frame.color))
        if HALF in parts:
            sample = self._small.of(frame, number)
            frame = replace(frame, geometry_size=(sample.depth.shape[1], sample.depth.shape[0]))
        if sample is None or not parts & {JITTERED, HALF}:
            return frame
        return replace(frame, depth=sample.depth, motion=sample.motion, geometry_jitter=sample.geometry_jitter)


class _JitteredSamples:
    """Jittered samples of a scene, one per pixel, in order of `frames`; their motion is without jitter."""

    def __init__(self, frames: SceneFrames):
        self._frames = frames
        self._last: RenderedFrame | None = None

    def of(self, frame: RenderedFrame, number: int) -> RenderedFrame:
        """Return the samples of `frame`, number `number`, with their `geometry_jitter`."""
        sample = self._frames.rendered(frame.time, None if frame.reset else self._last, number)
        self._last = sample
        x, y = self._frames.jitter.offset(number)
        x_before, y_before = (x, y) if frame.reset else self._frames.jitter.offset(number - 1)
        motion = sample.motion - np.array((x - x_before, y - y_before), np.float32)
        return replace(sample, motion=motion, geometry_jitter=(-x, -y))


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
    exact but for a user interface. `compression` is that of the EXRs (see `SequenceWriter`).
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
    windows = WindowChooser(window, (width, height), alphas)
    jitter = jitter or Jitter()
    if encoding.is_on_display and not (window == "off" and jitter.length == 1 and scale == 1):
        raise GffeError("--encode: taa, jittered, half and hud exclude --window, --jitter and --scale")
    samples = samples or (1 if jitter.length > 1 else 8)
    is_apart = ground_truth and (scale > 1 or jitter.length > 1)
    truths = SceneRenderer(device, scene, width, height, 8) if is_apart else None
    exact = SceneFrames.smaller(device, scene, (width, height), scale, samples, jitter, windows, truths)
    made = EncodedFrames(exact, encoding)
    writing = SequenceWriter(
        output,
        width,
        height,
        fps,
        scene.exposure,
        generator="gffe-cl render",
        compression=compression,
        format=encoding.format,
    )
    with writing as writer:
        for k, frame in enumerate(exact.sequence(frames, fps)):
            stored = made.encoded(frame, k)
            channels = named_channels(stored.color, stored.depth, stored.motion)
            writer.add(rendered_entry(k, stored, (width, height)), channels)
            on_frame()
            for alpha in alphas if ground_truth else ():
                time = (k + alpha) * (1.0 / fps)
                image = exact.truth(time, frame).numpy()
                color = encoding.truth(image.color, scene.exposure)
                file = f"truth_{k:06d}_{round(alpha * 1000):04d}.exr"
                entry = FrameEntry(file, time, "ground_truth", display_camera=exact.display_camera(time))
                writer.add(entry, named_channels(color, image.depth, image.motion))
                on_frame()
    return frames * (1 + len(alphas) * ground_truth)
