"""Reader of a sequence: everything about its files is checked on opening, pixels are read on demand, the next frames on
threads. Input that is legal but suspicious has warnings.
"""

from __future__ import annotations

import json
import os
from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

from gffe_cl.captures.sequence import exr
from gffe_cl.captures.sequence.description import (
    FILE_NAME,
    KINDS,
    Description,
    FrameEntry,
    frame_label,
    parse_description,
    read_text,
    require_one_size,
    without_collections,
)
from gffe_cl.captures.sequence.engine_form import color_of, described_frame
from gffe_cl.captures.sequence.exr import (
    COLOR,
    MOTION,
    RENDERED,
    OwnPixels,
    Pixels,
    read_header,
    require_whole_overlays,
)
from gffe_cl.captures.sequence.output_folder import why_unfinished
from gffe_cl.engine.core.errors import GffeError, printable, within
from gffe_cl.engine.core.validation import (
    require_choice,
    require_kind,
    require_list,
    require_number,
    require_path,
    require_whole,
)
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.frame_format import FrameFormat, jitter_in_color, require_render_size
from gffe_cl.engine.frame.rendered_frame import BadPixels, RenderedFrame, require_one_pose

_EVEN = 0.02  # of the usual interval: by which an even one may differ
_SLOW_INTERVAL = 5.0  # seconds between rendered frames that look like milliseconds


def require_clean(file: str, bad: BadPixels) -> None:
    """Raise GffeError if a frame holds bad pixels (strict mode)."""
    if bad:
        raise GffeError(f"{file}: {bad} (strict)")


def uneven_intervals(frames: list[FrameEntry]) -> tuple[dict[int, float], float]:
    """Return the intervals to the frame before, seconds, that are not the usual one, by the frame's number, and the
    usual one; `frames` are the rendered ones, by time. Resets have none before them."""
    steps = {k: here.time - frames[k - 1].time for k, here in enumerate(frames) if k and not here.reset}
    usual = float(np.median(list(steps.values()))) if steps else 0.0
    return {k: step for k, step in steps.items() if abs(step - usual) > _EVEN * usual}, usual


def time_warnings(frames: list[FrameEntry], fps: float) -> list[str]:
    """Return sentences about frame times that look wrong; `frames` are the rendered ones, by time."""
    steps = np.diff([entry.time for entry in frames])
    steps = [step for step, entry in zip(steps, frames[1:], strict=True) if not entry.reset]
    if not steps:
        return []
    step = float(np.median(steps))
    if step > _SLOW_INTERVAL:
        return [f"frame interval {step:.3g} s: milliseconds? (times are in seconds)"]
    if not 0.5 <= step * fps <= 2:
        return [f"fps is {fps:g}, but rendered frames are {step:.3g} s apart ({1 / step:.3g} per second)"]
    return []


_MOST_AHEAD = 1024
_TOLERANCE = 1 / 50  # of the interval of rendered frames
_NEAR = 3  # tolerances: a frame that is missed by less was probably meant


class Sequence:
    """An opened sequence. It is made by `open_sequence`, or from a capture in another form by `open_capture`.

    Attributes
    ----------
    path : Path
        The folder.
    width, height : int
        Display size in pixels.
    fps, exposure : float
    format : FrameFormat or None
        Description of depth and motion of the rendered frames as they are stored; None: in our conventions.
    frames : list[FrameEntry]
        All frames by time; `rendered`, `ground_truth` and `extrapolated` are those of one kind.
    known_cameras : list[FrameEntry]
        Times without a picture whose camera is known, of kind "camera_only".
    unfinished : bool
        Whether its writer was interrupted: the frames are those that were finished.

    Raises
    ------
    GffeError
        If rendered frames have several sizes, or another one than `format` describes. Methods raise it for arguments of
        other types, for files that were damaged since opening, and for frames of another kind than expected.
    """

    def __init__(self, path: Path, description: Description, pixels: Pixels):
        require_one_size(description.frames, (description.width, description.height), str(path))
        self.path, self._pixels = path, pixels
        self.width, self.height = description.width, description.height
        self.fps, self.exposure, self.format = description.fps, description.exposure, description.format
        self.frames, self.unfinished = description.frames, description.unfinished
        self.known_cameras = list(description.known_cameras)
        self._of_kind: dict[str, list[FrameEntry]] = {kind: [] for kind in (*KINDS, "camera_only")}
        for entry in self.frames + self.known_cameras:
            self._of_kind[entry.kind].append(entry)
        self._times = {kind: [entry.time for entry in entries] for kind, entries in self._of_kind.items()}
        self._previous = dict(zip([e.file for e in self.rendered[1:]], self.rendered, strict=False))
        for entry in self.rendered:
            with within(str(path)):
                self._geometry_of(entry)

    def __iter__(self) -> Iterator[RenderedFrame]:
        """Return an iterator over the rendered frames in order. The next ones are read meanwhile on threads.

        for frame in gffe.open_sequence(folder):
            pipeline.submit(frame)
        """
        return (frame for _, frame in self.prefetch(self.rendered))

    def __repr__(self):
        return f"<Sequence {self.path}: {len(self.frames)} frames, {self.width}×{self.height}>"

    @property
    def rendered(self) -> list[FrameEntry]:
        """Entries of the rendered frames, by time."""
        return [*self._of_kind["rendered"]]

    @property
    def ground_truth(self) -> list[FrameEntry]:
        """Entries of the ground-truth frames, by time."""
        return [*self._of_kind["ground_truth"]]

    @property
    def extrapolated(self) -> list[FrameEntry]:
        """Entries of the extrapolated frames, by time."""
        return [*self._of_kind["extrapolated"]]

    def at(self, kind: str, time: float) -> FrameEntry | None:
        """Return the frame of `kind` at `time` (seconds), within 1/50 of the interval of rendered frames there. The
        result is None if there is no such frame. All matching of frames uses this method."""
        kind, time = _moment(kind, time)
        entries, times, slack = self._of_kind[kind], self._times[kind], self._tolerance(time)
        found = entries[bisect_left(times, time - slack) : bisect_right(times, time + slack)]
        return min(found, key=lambda entry: abs(entry.time - time), default=None)

    def _tolerance(self, time: float) -> float:
        """Return the seconds around `time` that count as the same time: 1/50 of the interval between the rendered
        frames around it; after the last one, or before a reset, of the interval before that frame; else of 1/fps."""
        rendered, times = self._of_kind["rendered"], self._times["rendered"]
        k = max(bisect_right(times, time) - 1, 0)
        interval = 1 / self.fps
        if k + 1 < len(rendered) and not rendered[k + 1].reset:
            interval = times[k + 1] - times[k]
        elif 0 < k < len(rendered) and not rendered[k].reset:
            interval = times[k] - times[k - 1]
        return _TOLERANCE * interval

    def camera_at(self, time: float) -> Camera | None:
        """Return the display camera at `time` (seconds), matched as in `at`, from ground truth or a known camera; None
        without one."""
        known = self.at("ground_truth", time), self.at("camera_only", time)
        cameras = [entry.display_camera or entry.render_camera for entry in known if entry is not None]
        return next(filter(None, cameras), None)

    def nearest(self, kind: str, time: float) -> FrameEntry | None:
        """Return the frame of `kind` that is nearest in time, however far: for messages about a miss of `at`. None
        without any."""
        kind, time = _moment(kind, time)
        k = bisect_left(self._times[kind], time)
        return min(self._of_kind[kind][max(k - 1, 0) : k + 1], key=lambda entry: abs(entry.time - time), default=None)

    def near_miss(self, kind: str, time: float) -> str | None:
        """Return a sentence if `at` finds nothing, but a frame is so near that it was probably meant: rounded times.
        Else None."""
        near = self.nearest(kind, time)
        if near is None or self.at(kind, time) or abs(near.time - time) > _NEAR * self._tolerance(time):
            return None
        apart = 1e3 * abs(near.time - time)
        return f"{near.file} at {near.time:.6g} s is {apart:.3g} ms from {time:.6g} s, more than 1/50 of an interval"

    @property
    def notes(self) -> list[str]:
        """Remarks of the reader of the capture's form on opening it."""
        text = json.dumps(self.format.to_json()) if self.format else ""
        converted = [f"depth and motion are converted from the frame_format {text}"] if text else []
        return [printable(text) for text in converted + self._pixels.notes]

    def rendered_before(self, time: float) -> int | None:
        """Return the index in `rendered` of the last frame before `time`, None without one. A frame that is `at` it is
        not before it."""
        time = require_number(time, "sequence: time")
        k = bisect_right(self._times["rendered"], time - self._tolerance(time)) - 1
        return k if k >= 0 else None

    def size_of(self, entry: FrameEntry) -> tuple[int, int]:
        """Return (width, height) of the images of `entry`, in pixels."""
        return _entry(entry).render_size or (self.width, self.height)

    def _geometry_of(self, entry: FrameEntry) -> tuple[int, int]:
        """Return width and height of depth and motion of a rendered frame, pixels."""
        return require_render_size(self.format, self.size_of(entry), entry.geometry_size)

    def warnings(self) -> list[str]:
        """Return sentences about legal but suspicious input: an unfinished sequence, frame times, and what is displayed
        but was not rendered. `gffe_cl.check` and `gffe check` look at pixels."""
        outside = [entry.file for entry in self.rendered if not self._covers_display(entry)]
        cut = [f"{outside[0]}: the display reaches beyond the rendered area (display_camera)"] if outside else []
        few = [f"{self.path}: unfinished: its writer was interrupted after {len(self.frames)} frames"]
        times = time_warnings(self.rendered, self.fps)
        said = (few if self.unfinished else []) + list(self._pixels.notes) + times + cut
        return [printable(text) for text in said]

    def _covers_display(self, entry: FrameEntry) -> bool:
        """Return whether everything displayed was rendered, to half a pixel of the display; and of the frame, for
        jitter."""
        width, height = self.size_of(entry)
        display, render = entry.display_camera, entry.render_camera
        if render is None or display is None:
            return True
        corners = np.array([(0.5, 0.5), (self.width - 0.5, self.height - 0.5)])
        scale = np.array([render.fx / display.fx, render.fy / display.fy])
        at = (corners - (display.cx, display.cy)) * scale + (render.cx, render.cy)
        return bool((at >= -0.5).all() and (at <= (width + 0.5, height + 0.5)).all())

    def read(self, entry: FrameEntry) -> RenderedFrame:
        """Return the rendered frame `entry`: color (H, W, 3) float16 or float32 as stored, depth (H, W) float32, motion
        (H, W, 2) float32 or None, in our conventions and of the size of color; and its overlays. Raises GffeError if
        the file has been damaged since opening."""
        frame, previous = self.read_stored(entry), self._previous.get(entry.file)
        before = None if entry.reset or previous is None else previous
        size, geometry = self.size_of(entry), self._geometry_of(entry)
        if self.format or geometry != size:
            jitter = (0.0, 0.0)
            if before:
                jitter = jitter_in_color(before.geometry_jitter, size, self._geometry_of(before))
            frame = described_frame(frame, self.format or FrameFormat(), before and before.render_camera, jitter)
        return frame

    def read_stored(self, entry: FrameEntry) -> RenderedFrame:
        """Return the rendered frame `entry` as it is stored, with depth and motion as `format` describes them and of
        their own size, for a `Pipeline` with that. Raises GffeError as `read` does."""
        if _entry(entry).kind != "rendered":
            raise GffeError(f"{entry.file}: kind is {entry.kind} (expected a rendered frame)")
        size = self.size_of(entry)
        color, depth, motion, overlays = self._pixels.read(entry, size)
        width, height = self._geometry_of(entry)
        depth, motion = (a if a is None or (width, height) == size else a[:height, :width] for a in (depth, motion))
        camera = entry.render_camera
        assert camera is not None  # every rendered frame of an opened sequence has one
        shown_as_rendered = size == (self.width, self.height) and entry.display_camera == camera
        return RenderedFrame(
            color,
            depth,
            motion,
            camera,
            entry.time,
            display_camera=None if shown_as_rendered else entry.display_camera,
            reset=entry.reset,
            overlays=overlays,
            geometry_jitter=entry.geometry_jitter,
            geometry_size=entry.geometry_size,
        )

    def read_channels(self, entry: FrameEntry, names: Iterable[str]) -> dict[str, np.ndarray]:
        """Return channels of any frame by name, (H, W) each, in the type stored (float16, float32 or uint32)."""
        size = self.size_of(entry)
        return self._pixels.channels(entry, require_list(names, str, "sequence: names", "a list of texts"), size)

    def read_color(self, entry: FrameEntry) -> np.ndarray:
        """Return linear RGB of any frame: (H, W, 3), float16 or float32 as stored."""
        color = self._pixels.color(entry, self.size_of(entry))
        return color_of(color, self.format) if self.format and entry.kind == "rendered" else color

    def exr_file(self, entry: FrameEntry) -> Path | None:
        """Return the EXR file that holds the frame in our own form; None in captures of another one."""
        return self._pixels.exr_file(_entry(entry))

    def prefetch(self, entries: Iterable[FrameEntry], read: Callable | None = None, ahead: int = 2) -> Iterator[tuple]:
        """Yield (entry, read(entry)) in order, reading the next `ahead` frames on threads.

        `read` defaults to `self.read`. Errors are raised when their frame's turn comes; leaving the loop
        stops the threads.
        """
        entries = require_list(entries, FrameEntry, "sequence: entries", "a list of FrameEntry")
        reading = self.read if read is None else require_kind(read, Callable, "sequence: read", "a function or None")
        return read_ahead(entries, reading, require_whole(ahead, "sequence: ahead", 0, _MOST_AHEAD))


def _entry(entry: FrameEntry) -> FrameEntry:
    return require_kind(entry, FrameEntry, "sequence: entry")


def _moment(kind: str, time: float) -> tuple[str, float]:
    return require_choice(kind, (*KINDS, "camera_only"), "sequence: kind"), require_number(time, "sequence: time")


@without_collections()
def open_sequence(path: str | os.PathLike[str]) -> Sequence:
    """Open the sequence in the folder `path` (or whose `sequence.json` is `path`), and return it.

    JSON, cameras and the headers of all files are checked here, so that no later work meets a missing channel or file,
    a wrong size, or a truncated file. Raises GffeError.
    """
    path = require_path(path, "open_sequence: path")
    try:
        if unfinished := why_unfinished(path):
            raise GffeError(f"{path}: {unfinished}")
        if not path.exists():
            raise GffeError(f"{path}: no such folder (expected a sequence: a folder with {FILE_NAME})")
        json_path = path / FILE_NAME if path.is_dir() else path
        if json_path.suffix.lower() != ".json":
            raise GffeError(f"{path}: not a folder (expected a folder with {FILE_NAME}, or that file)")
        folder = json_path.parent
    except OSError as error:
        raise GffeError(f"{path}: cannot be read ({error.strerror or error})") from None
    description = parse_description(read_text(json_path), json_path.name)

    # On one thread: the system calls are so short that threads only wait for each other.
    pixels = OwnPixels(folder)
    for index, entry in enumerate(description.frames):
        header = read_header(os.path.join(folder, entry.file), entry.file)
        places = _places(entry, header)
        _complete_cameras(entry, header, description, index, json_path.name)
        size = entry.render_size or (description.width, description.height)
        exr.require_parts(header, {part for part, _ in places}, size, entry.file)
        if entry.kind == "rendered":
            require_whole_overlays(header, entry.file, size == (description.width, description.height))
    return Sequence(folder, description, pixels)


def _places(entry, header) -> list[tuple[int, str]]:
    """Return the places of R, G, B and, of rendered frames, of depth and motion."""
    if entry.kind != "rendered":
        return exr.require_channels(header, COLOR, entry.file)
    # Half a motion vector is a fault even where none is allowed.
    has_motion = not entry.reset or any(header.find(name) for name in MOTION)
    return exr.require_channels(header, RENDERED if has_motion else RENDERED[:4], entry.file)


def _complete_cameras(entry, header, description, index, json_name):
    """Set the display camera that the JSON leaves out: from the windows of the EXR header, else the render camera's
    frustum."""
    if entry.kind != "rendered":
        return
    size = (description.width, description.height)
    with within(frame_label(index, entry.file, json_name)):
        if entry.render_camera is None:
            raise GffeError("no render_camera (expected one of every rendered frame)")
        _complete_overscan(entry, header.parts[header.find("R")[0]], size)
        if entry.display_camera is None:
            entry.display_camera = _same_frustum(entry, size)
        if entry.display_camera is not entry.render_camera:
            require_one_pose(entry.render_camera, entry.display_camera)


def _complete_overscan(entry, part, size):
    """Set render size and display camera that the JSON leaves out, where the stored image is more or less than the
    display window of its EXR header."""
    shown, (left, top) = part.shown_size, part.offset
    if shown == part.size and not (left or top):
        return
    entry.render_size = entry.render_size or part.size
    if entry.display_camera is None and tuple(entry.render_size) == part.size:
        camera = entry.render_camera
        whole = replace(camera, cx=camera.cx + left, cy=camera.cy + top)
        entry.display_camera = whole.scaled(size[0] / shown[0], size[1] / shown[1])


def _same_frustum(entry, size):
    render_size = entry.render_size or size
    if tuple(render_size) == size:
        return entry.render_camera
    return entry.render_camera.scaled(size[0] / render_size[0], size[1] / render_size[1])


def usable_cores() -> int:
    """Return how many processor cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def read_ahead(items: Iterable, function: Callable, ahead: int = 2) -> Iterator[tuple]:
    """Yield (item, function(item)) in order, `function` running on threads for the next `ahead`, from now on.

    An exception of `function` is raised when its item's turn comes. Leaving the loop (break, exception, Ctrl-C) drops
    items that were not started and waits for the others.
    """
    ahead = max(1, ahead)
    items = iter(items)
    pool = ThreadPoolExecutor(ahead, thread_name_prefix="gffe-read")
    pending = deque((item, pool.submit(function, item)) for item in islice(items, ahead))
    return _in_order(items, function, pool, pending)


def _in_order(items: Iterator, function: Callable, pool: ThreadPoolExecutor, pending: deque) -> Iterator[tuple]:
    try:
        while pending:
            item, future = pending.popleft()
            result = future.result()
            for following in islice(items, 1):
                pending.append((following, pool.submit(function, following)))
            yield item, result
            del result, future
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
