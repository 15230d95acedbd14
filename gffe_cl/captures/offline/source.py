"""Sources of rendered frames: a sequence on disk, or a built-in scene that is rendered meanwhile; and the raw form of
their frames that the exported example reads (`c/main.c` describes it)."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

from gffe_cl.captures.scenes import Scene, SceneFrames, SceneRenderer
from gffe_cl.captures.scenes.renderer import require_frames
from gffe_cl.captures.sequence import (
    FrameEntry,
    Sequence,
    SequenceWriter,
    refuse_same_folder,
    require_clean,
)
from gffe_cl.captures.sequence.description import rendered_entry
from gffe_cl.captures.sequence.reader import read_ahead, usable_cores
from gffe_cl.engine.core.errors import GffeError, printable
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.frame_format import FrameFormat
from gffe_cl.engine.frame.rendered_frame import RenderedFrame, display_camera_of, host_arrays
from gffe_cl.engine.frame.window import WindowChooser, without_jitter
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.stages.presentation import present


class Source(Protocol):
    """Source of rendered frames by number, and of what is known about the times between them.

    `width`, `height`: of the display, pixels; `render_size`: of the rendered frames; `count`: how many there are;
    `resets`: numbers of those that are known to be one, in order;
    `format`: the description of stored frames, None where `store` writes them in our conventions.
    """

    name: str
    width: int
    height: int
    render_size: tuple[int, int]
    fps: float
    exposure: float
    count: int
    resets: tuple[int, ...] = (0,)
    format: FrameFormat | None = None

    def rendered(self, k: int) -> RenderedFrame:
        """Return frame `k`. A frame of a built-in scene follows frame `k` − 1 if that was the last one asked for;
        otherwise it is a reset. Raises GffeError."""
        ...

    def frames(self, alphas: list[float], strict: bool) -> Iterator[tuple[FrameEntry, RenderedFrame]]:
        """Yield each rendered frame; `alphas` are the times that will be extrapolated after it, in intervals. With
        `strict` bad pixels raise GffeError."""
        for k in range(self.count):
            frame = self.rendered(k)
            entry = rendered_entry(k, frame, (self.width, self.height))
            if strict:
                require_clean(entry.file, host_arrays(frame).bad)
            yield entry, frame

    def reset_before(self, k: int) -> int:
        """Return the number of the last reset frame up to `k`."""
        return self.resets[bisect_right(self.resets, k) - 1]

    def _time_of(self, k: int) -> float:
        """Return the time of frame `k` (seconds): by default they are 1 / `fps` apart."""
        return k * (1.0 / self.fps)

    def interval(self, k: int) -> float:
        """Return the seconds from the frame before to frame `k`; of a reset 1 / fps."""
        return 1.0 / self.fps if self.reset_before(k) == k else self._time_of(k) - self._time_of(k - 1)

    def time(self, k: int, alpha: float = 0.0) -> float:
        """Return the time `alpha` intervals after frame `k` (seconds)."""
        return self._time_of(k) + alpha * self.interval(k)

    def cameras_at(self, times: list[float]) -> list[Camera] | None:
        """Return the display cameras of the new frames of one interval, at `times` (seconds). None unless each of them
        is known: predicted and known cameras do not mix within an interval."""

    def store(self, writer: SequenceWriter, entry: FrameEntry, frame: RenderedFrame) -> None:
        """Write a rendered frame to an output whose writer has the `format`."""
        writer.add_frame(entry, frame)

    def number_of(self, entry: FrameEntry) -> str:
        """Return a text that identifies a rendered frame in names of files: the number in its own file's name, or its
        index."""
        return Path(entry.file).stem.removeprefix("frame_")

    def refuse(self, output: Path) -> None:
        """Raise GffeError if `output` must not be written to."""

    def identity(self) -> list:
        """Return values for JSON that tell the frames from all others."""
        ...

    def warnings(self) -> list[str]:
        """Return legal but suspicious properties of the input so far, as sentences."""
        return []


class Recorded(Source):
    """Source from a sequence on disk. A frame with overscan (its render camera is wider than its display camera) counts
    as rendered through a window. With `window` "off" only its display part is used, resampled on `device`. `scale` is
    the factor from rendered to displayed size. Without a display camera, a principal point within a pixel of the center
    is then taken for jitter. `windowed`: whether a window, or another size than the display's, makes such parts differ.

    Raises GffeError for other windows than that, and for a sequence without rendered frames.
    """

    _cut = False  # whether only display parts are used

    def __init__(self, sequence: Sequence, device: Device | None, window: str | None = None, scale: float = 0.0):
        self.name, self._device, self._scale = printable(sequence.path.resolve().name), device, scale
        self.width, self.height, self.fps = sequence.width, sequence.height, sequence.fps
        self.exposure = sequence.exposure
        self._window = window
        self._take(sequence)
        if scale:
            self._enlarge(self.render_size, scale)

    def _take(self, sequence: Sequence) -> None:
        """Take the frames of `sequence`, which may be longer than before."""
        self.sequence, self.entries = sequence, sequence.rendered
        if not self.entries:
            raise GffeError(f"{sequence.path}: no rendered frame to extrapolate from")
        self.count, self._stored = len(self.entries), sequence.size_of(self.entries[0])
        self.resets = tuple(k for k, entry in enumerate(self.entries) if entry.reset or k == 0)
        whole = all(entry.display_camera == entry.render_camera for entry in self.entries)
        self.windowed = not whole or self._stored != (sequence.width, sequence.height)
        self._numbers = dict(zip((e.file for e in self.entries), _numbers(self.entries), strict=True))
        self._missed = ""  # the first truth that a new frame missed by little
        self.choose(self._window)

    def choose(self, window: str | None) -> bool:
        """Use another window from now on, and return whether the frames change by that."""
        if window not in (None, "off"):
            raise GffeError(
                f"--window {window}: only built-in scenes are rendered through a chosen window, {self.sequence.path} is"
                " a recorded sequence (expected off, or no --window)"
            )
        before, self._window, self._cut = self._cut, window, window == "off" and self.windowed
        self.render_size = (self.width, self.height) if self._cut else self._stored
        is_own = self.sequence.exr_file(self.entries[0]) is not None  # frames are linked, else written as converted
        self.format = self.sequence.format if is_own and not self._cut and not self._scale else None
        return self._cut != before

    def _enlarge(self, stored: tuple[int, int], scale: float) -> None:
        """Enlarge the display by `scale` if it has the size of the rendered frames. Otherwise raise GffeError unless
        it is so many times larger already."""
        sequence, recorded = self.sequence, (self.sequence.width, self.sequence.height)
        if self._cut:
            raise GffeError(f"--upscale {scale:g} and --window off exclude each other for {sequence.path}")
        if stored == recorded:
            self.width, self.height = (round(n * scale) for n in recorded)
        elif any(abs(n / scale - r) > 1 for n, r in zip(recorded, stored, strict=True)):
            raise GffeError(
                f"{sequence.path}: frames of {stored[0]}×{stored[1]} for a display of {recorded[0]}×{recorded[1]}"
                f" (expected --upscale {recorded[0] / stored[0]:.3g}, got {scale:g})"
            )

    def _shown(self, camera: Camera) -> Camera:
        """Return a display camera of the sequence, in pixels of displayed frames."""
        return camera.scaled(self.width / self.sequence.width, self.height / self.sequence.height)

    def _as_shown(self, frame: RenderedFrame) -> RenderedFrame:
        """Return the frame with a display camera of the displayed size."""
        size = self.sequence.width, self.sequence.height
        told = frame.shown_camera
        if told.intrinsics == display_camera_of(replace(frame, display_camera=None), self.render_size, size).intrinsics:
            told = without_jitter(told, size)
        return replace(frame, display_camera=self._shown(told))

    def _read(self, k: int) -> RenderedFrame:
        """Return frame `k` as it was rendered."""
        frame = self.sequence.read(self.entries[k])
        return self._as_shown(frame) if self._scale else frame

    def _display_part(self, k: int, frame: RenderedFrame) -> RenderedFrame:
        """Return the display part of frame `k`; its bad pixels are those of the whole frame."""
        last = self.entries[max(k - 1, 0)]
        before = replace(frame, camera=last.render_camera, display_camera=last.display_camera)
        return present(frame, before if k else None, size=self.render_size, device=self._device)

    def rendered(self, k):
        return self._display_part(k, self._read(k)) if self._cut else self._read(k)

    def frames(self, alphas, strict):
        def read(k: int) -> RenderedFrame:
            frame = self._read(k)
            if strict:
                require_clean(self.entries[k].file, host_arrays(frame).bad)
            return frame

        return self._in_order(read_ahead(range(self.count), read, 2 + usable_cores() // 4))

    def _in_order(self, read):
        for k, frame in read:
            entry = self.entries[k]
            if self._cut:
                frame = self._display_part(k, frame)
                entry = replace(entry, render_size=None, render_camera=frame.camera, display_camera=None)
            yield entry, frame

    def _time_of(self, k):
        return self.entries[k].time

    def store(self, writer, entry, frame):
        own = None if self._cut else self.sequence.exr_file(entry)
        if own is None:
            super().store(writer, entry, frame)
        else:
            writer.link(entry, own)

    def cameras_at(self, times):
        found = [self.sequence.camera_at(time) for time in times]
        cameras = [camera for camera in found if camera is not None]
        if len(cameras) == len(times):
            return [self._shown(camera) for camera in cameras] if self._scale else cameras
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

    def identity(self):
        folder = self.sequence.path
        files = [(str(path.relative_to(folder)), path.stat()) for path in sorted(folder.rglob("*")) if path.is_file()]
        return [self._window, self._scale, [(name, stat.st_size, stat.st_mtime_ns) for name, stat in files]]


class Live(Source):
    """Source of `count` frames of a built-in scene, rendered through `window` ("adaptive", "fixed:FACTOR" or "off").

    With `scale` the frames are so many times smaller than the display, and jittered.
    """

    def __init__(
        self,
        scene: Scene,
        device: Device,
        width: int,
        height: int,
        count: int,
        fps: float,
        window: str = "off",
        scale: float = 0.0,
    ):
        require_frames(count, fps)
        self.scene, self.name, self.exposure, self._device = scene, scene.name, scene.exposure, device
        self.width, self.height, self.count, self.fps = width, height, count, fps
        self._way: Any = None  # the arguments of `choose` that frames depend on, a tuple
        self.choose(window, [], scale)

    def choose(self, window: str, alphas: list[float], scale: float = 0.0) -> bool:
        """Render through `window`, for new frames at `alphas`, and at `scale` from now on. Return whether the frames
        change by that."""
        way = (window, scale, *(alphas if window == "adaptive" else ()))
        if way == self._way:
            return False
        WindowChooser(window, (self.width, self.height), alphas)
        if self._way is None or scale != self._way[1]:
            self._frames = self._frames_for(scale)
            self.render_size = self._frames.render_size
        self._way, self._alphas = way, alphas
        self.restart()
        return True

    def _frames_for(self, scale: float) -> SceneFrames:
        size = self.width, self.height
        if scale:
            return SceneFrames.smaller(self._device, self.scene, size, scale)
        return SceneFrames(SceneRenderer(self._device, self.scene, *size))

    def restart(self) -> None:
        """Make the next frame a reset."""
        self._frames.windows = WindowChooser(self._way[0], (self.width, self.height), self._alphas)
        self._last = -1, None

    def rendered(self, k):
        number, before = self._last
        frame = self._frames.rendered(self.time(k), before if number == k - 1 else None, k)
        self._last = k, frame
        return frame

    def frames(self, alphas, strict):
        self.choose(self._way[0], alphas, self._way[1])
        self.restart()
        return super().frames(alphas, strict)

    def cameras_at(self, times):
        return [self.scene.camera(time, self.width, self.height) for time in times]

    def identity(self):
        return [self.name, self.scene.seed, self.width, self.height, self.count, self.fps, self._way]


def _numbers(entries: list[FrameEntry]) -> list[str]:
    """Return the numbers in the frames' names (`frame_000012.exr` → `000012`), or indices unless all numbers differ."""
    numbers = [Path(entry.file).stem.rpartition("_")[2] for entry in entries]
    own = all(n.isdigit() and n.isascii() for n in numbers) and len(set(numbers)) == len(numbers)
    return numbers if own else [f"{index:06d}" for index in range(len(entries))]
