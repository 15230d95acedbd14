"""Source of a run: a sequence on disk, or a built-in scene that is rendered meanwhile."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

from gffe_cl.captures.scenes import Scene, SceneFrames, SceneRenderer
from gffe_cl.captures.scenes.sequences import require_frames, smaller_renderer
from gffe_cl.captures.sequence import (
    FrameEntry,
    Sequence,
    SequenceWriter,
    named_channels,
    refuse_same_folder,
    require_clean,
)
from gffe_cl.captures.sequence.description import rendered_entry
from gffe_cl.captures.sequence.read_ahead import usable_cores
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.jitter import Jitter, without_jitter
from gffe_cl.engine.frame.rendered_frame import RenderedFrame, display_camera_of, host_arrays
from gffe_cl.engine.frame.window import WindowChooser
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.stages.presentation import present

JITTER_LENGTH = 16  # frames until built-in scenes repeat their jitter


class Source(Protocol):
    """Source of rendered frames in order of time.

    `width`, `height`: of the display, pixels; `render_size`: of the rendered frames; `count`: how many there are;
    `attributes`: of EXR headers, which new frames get.
    """

    width: int
    height: int
    render_size: tuple[int, int]
    fps: float
    exposure: float
    count: int
    attributes: dict[str, Any]

    def frames(self, alphas: list[float], strict: bool) -> Iterator[tuple[FrameEntry, RenderedFrame]]:
        """Yield each rendered frame; `alphas` are the times that will be extrapolated after it, in intervals. With
        `strict` bad pixels raise GffeError."""
        ...

    def store(self, writer: SequenceWriter, entry: FrameEntry, frame: RenderedFrame) -> None:
        """Write a rendered frame to an output."""

    def cameras_at(self, times: list[float]) -> list[Camera] | None:
        """Return the display cameras of the new frames of one interval, at `times` (seconds); None unless each of them
        is known: predicted and known cameras do not mix within an interval."""
        ...

    def number_of(self, entry: FrameEntry) -> str:
        """Return a text that identifies a rendered frame in names of files: the number in its own file's name, or its
        index."""
        ...

    def refuse(self, output: Path) -> None:
        """Raise GffeError if `output` must not be written to."""

    def warnings(self) -> list[str]:
        """Return legal but suspicious properties of the input so far, as sentences."""
        ...


class Recorded:
    """Source from a sequence on disk. A frame with overscan (its render camera is wider than its display camera) counts
    as rendered through a window. With `window` "off" only its display part is used, resampled on `device`. `upscale` is
    the factor from rendered to displayed size. Without a display camera, a principal point within a pixel of the center
    is then taken for jitter.

    Raises GffeError for other windows than that, and for a sequence without rendered frames.
    """

    def __init__(self, sequence: Sequence, device: Device | None, window: str | None = None, upscale: float = 0.0):
        if window not in (None, "off"):
            raise GffeError(
                f"--window {window}: only built-in scenes are rendered through a chosen window, {sequence.path} is a"
                " recorded sequence (expected off, or no --window)"
            )
        self.sequence, self._device = sequence, device
        self.width, self.height, self.fps = sequence.width, sequence.height, sequence.fps
        self.exposure, self.count = sequence.exposure, len(sequence.rendered)
        self.attributes = sequence.attributes
        stored = _render_size(sequence)
        size = (self.width, self.height)
        whole = stored == size and all(e.display_camera == e.render_camera for e in sequence.rendered)
        self._cut = window == "off" and not whole
        self._upscale = upscale
        if upscale:
            self._enlarge(stored, upscale)
        self.render_size = size if self._cut else stored
        self._numbers = dict(zip((e.file for e in sequence.rendered), _numbers(sequence.rendered), strict=True))
        self._missed = ""  # the first truth that a new frame missed by little

    def _enlarge(self, stored: tuple[int, int], upscale: float) -> None:
        """Enlarge the display by `upscale` if it has the size of the rendered frames. Otherwise raise GffeError unless
        it is so many times larger already."""
        sequence, recorded = self.sequence, (self.sequence.width, self.sequence.height)
        if self._cut:
            raise GffeError(f"--upscale {upscale:g} and --window off exclude each other for {sequence.path}")
        if stored == recorded:
            self.width, self.height = (round(n * upscale) for n in recorded)
        elif any(abs(n / upscale - r) > 1 for n, r in zip(recorded, stored, strict=True)):
            raise GffeError(
                f"{sequence.path}: frames of {stored[0]}×{stored[1]} for a display of {recorded[0]}×{recorded[1]}"
                f" (expected --upscale {recorded[0] / stored[0]:.3g}, got {upscale:g})"
            )

    def _shown(self, camera: Camera) -> Camera:
        """Return a display camera of the sequence, in pixels of displayed frames."""
        return camera.scaled(self.width / self.sequence.width, self.height / self.sequence.height)

    def _upscaled(self, frame: RenderedFrame) -> RenderedFrame:
        """Return the frame with a display camera of the displayed size."""
        size = self.sequence.width, self.sequence.height
        told = frame.shown_camera
        if told.intrinsics == display_camera_of(replace(frame, display_camera=None), self.render_size, size).intrinsics:
            told = without_jitter(told, size)
        return replace(frame, display_camera=self._shown(told))

    def frames(self, alphas, strict):
        def read(entry: FrameEntry):
            frame = self.sequence.read(entry)
            if self._upscale:
                frame = self._upscaled(frame)
            if strict:
                require_clean(entry.file, host_arrays(frame).bad)
            return frame

        return self._cut_frames(
            self.sequence.prefetch(self.sequence.rendered, read=read, ahead=2 + usable_cores() // 4)
        )

    def _cut_frames(self, whole):
        before = None
        for entry, frame in whole:
            if not self._cut:
                yield entry, frame
                continue
            shown = present(frame, before, size=self.render_size, device=self._device)
            before = frame
            cut = replace(entry, render_size=None, render_camera=shown.camera, display_camera=None)
            yield cut, shown

    def store(self, writer, entry, frame):
        own = None if self._cut else self.sequence.exr_file(entry)
        if own is None:
            writer.add(entry, named_channels(frame.color, frame.depth, frame.motion, frame.overlays))
        else:
            writer.link(entry, own)

    def cameras_at(self, times):
        found = [self.sequence.camera_at(time) for time in times]
        cameras = [camera for camera in found if camera is not None]
        if len(cameras) == len(times):
            return [self._shown(camera) for camera in cameras] if self._upscale else cameras
        for time in times:
            self._missed = self._missed or self.sequence.near_miss("ground_truth", time) or ""
        return None

    def warnings(self):
        missed = [f"cameras are predicted: {self._missed} (times rounded?)"] if self._missed else []
        return [*self.sequence.warnings(), *missed]

    def number_of(self, entry):
        return self._numbers[entry.file]

    def refuse(self, output):
        refuse_same_folder(output, self.sequence.path)


class Live:
    """Source of `count` frames of a built-in scene, rendered through `window` ("adaptive", "fixed:FACTOR" or "off").

    With `upscale` the frames are so many times smaller than the display, and jittered.
    """

    def __init__(
        self,
        scene: Scene,
        device: Device,
        width: int,
        height: int,
        count: int,
        fps: float,
        window="off",
        upscale: float = 0.0,
    ):
        require_frames(count, fps)
        self.scene, self.width, self.height, self.count, self.fps = scene, width, height, count, fps
        self.exposure, self._window = scene.exposure, window
        self.attributes: dict[str, Any] = {}
        WindowChooser(window, (width, height), [])
        self._renderer, self._jitter = jittered_renderer(device, scene, (width, height), upscale)
        self.render_size = self._renderer.width, self._renderer.height

    def frames(self, alphas, strict):
        size = self.width, self.height
        made = SceneFrames(self._renderer, WindowChooser(self._window, size, alphas), size, self._jitter)
        for k, frame in enumerate(made.sequence(self.count, self.fps)):
            entry = rendered_entry(k, frame, size)
            if strict:
                require_clean(entry.file, host_arrays(frame).bad)
            yield entry, frame

    def store(self, writer, entry, frame):
        writer.add(entry, named_channels(frame.color, frame.depth, frame.motion, frame.overlays))

    def cameras_at(self, times):
        return [self.scene.camera(time, self.width, self.height) for time in times]

    def number_of(self, entry):
        return Path(entry.file).stem.removeprefix("frame_")

    def refuse(self, output):
        return

    def warnings(self):
        return []


def jittered_renderer(
    device: Device, scene: Scene, size: tuple[int, int], upscale: float, samples: int | None = None
) -> tuple[SceneRenderer, Jitter]:
    """Return a renderer of `scene` for upscaling to a display of `size`: small frames with one sample per pixel, with
    textures as fine as the display, and jitter. With `upscale` 0 frames have the display's size and no jitter."""
    if not upscale:
        return SceneRenderer(device, scene, *size, samples or 8), Jitter()
    return smaller_renderer(device, scene, size, upscale, samples or 1), Jitter(JITTER_LENGTH)


def _render_size(sequence: Sequence) -> tuple[int, int]:
    """Return the size of the rendered frames. Raises GffeError if there are none."""
    if not sequence.rendered:
        raise GffeError(f"{sequence.path}: no rendered frame to extrapolate from")
    return sequence.size_of(sequence.rendered[0])


def _numbers(entries: list[FrameEntry]) -> list[str]:
    """Return the numbers in the frames' names (`frame_000012.exr` → `000012`), or indices unless all numbers differ."""
    numbers = [Path(entry.file).stem.rpartition("_")[2] for entry in entries]
    own = all(n.isdigit() and n.isascii() for n in numbers) and len(set(numbers)) == len(numbers)
    return numbers if own else [f"{index:06d}" for index in range(len(entries))]
