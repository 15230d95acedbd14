"""Writer of a sequence: all of it, or nothing new after an error; after Ctrl-C the frames that were finished."""

from __future__ import annotations

import contextlib
import os
import shutil
import time
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gffe_cl.captures.sequence import exr
from gffe_cl.captures.sequence.description import (
    FILE_NAME,
    KINDS,
    Description,
    FrameEntry,
    check_file_name,
    checked_entry,
    describe,
    parse_description,
    require_one_size,
)
from gffe_cl.captures.sequence.exr import GEOMETRY, OVERLAY_CHANNELS, RENDERED
from gffe_cl.captures.sequence.output_folder import GENERATOR, OutputFolder
from gffe_cl.captures.sequence.reader import usable_cores
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import (
    require_array,
    require_bool,
    require_exposure,
    require_kind,
    require_list,
    require_path,
    require_positive,
    require_size,
    require_whole,
)
from gffe_cl.engine.frame.frame_format import DEPTH_TYPES, MOTION_TYPES, TYPES, FrameFormat, require_render_size
from gffe_cl.engine.frame.rendered_frame import Overlays, RenderedFrame, type_of

_WAITING = 2  # frames, besides those that are being compressed
_MOST_THREADS = 1024
_MOST_BYTES = 2 << 30  # of frames under way
_NOTED_EVERY = 10.0  # seconds, the list of finished frames of a run that may be continued


class SequenceWriter:
    """Context manager that writes a sequence into the folder `path`.

    Parameters
    ----------
    path : path-like
        The folder. It is created; an earlier output of gffe-cl in it is replaced, anything else stays.
    width, height : int
        Display size in pixels.
    fps, exposure : float
        Exposure from 1e-6 to 1e6.
    threads : int or None
        EXRs are compressed on so many threads, by default one for each processor core; `add` waits while many more
        frames than that are under way.
    generator : str
        Name of the writing program; only an earlier output of the same generator is replaced.
    format : FrameFormat or None
        Description of depth and motion of the rendered frames, if these are stored as an engine has them.
    compression : str
        Compression of the EXRs: none, rle, zips, zip, piz, htj2k256, dwaa or dwab. All but the last two keep every bit.
    settings : str or None
        Digest of everything that the frames depend on. A stopped run of the same settings is continued: `finished` has
        the entries of its extrapolated frames by their files, and `take_up` keeps one.

    Notes
    -----
    Frames are written beside `path`, into the folder `path`.part, which takes the place of `path` when the context
    ends: until then an earlier output stays unchanged. If the context ends by KeyboardInterrupt, `path`.part stays: its
    `sequence.json` lists the finished frames and is marked as unfinished, and a note of the exception names it. The
    next run into `path` replaces it, or continues it (`settings`). After any other exception everything is as before.
    Errors of the threads are raised by the next `add` or `link`, or at the end of the context. All of them are
    GffeError; so are a full disk and a folder that cannot be written to. Of two runs into one folder at a time, one
    fails or the last one stays.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        width: int,
        height: int,
        fps: float,
        exposure: float = 1.0,
        threads: int | None = None,
        generator: str = GENERATOR,
        compression: str = exr.DEFAULT_COMPRESSION,
        format: FrameFormat | None = None,
        settings: str | None = None,
    ):
        self.path = require_path(path, "writer: path")
        size = require_size((width, height), "writer: width and height", whole=True)
        fps, exposure = require_positive(fps, "writer: fps"), require_exposure(exposure, "writer: exposure")
        if format is not None:
            require_kind(format, FrameFormat, "writer: format", "a FrameFormat or None")
        self._description = Description(*size, fps, exposure, [], format=format, settings=settings)
        self.finished: dict[str, FrameEntry] = {}
        self._noted = time.monotonic()
        self._generator = require_kind(generator, str, "writer: generator", "a text")
        self._folder = OutputFolder(self.path, generator)
        self._pending: deque = deque()
        self._times: set[float] = set()
        self._bytes = 0  # of the channels under way
        self._compression = exr.require_compression(compression)
        self._threads = (
            usable_cores() if threads is None else require_whole(threads, "writer: threads", 1, _MOST_THREADS)
        )
        self._pool: ThreadPoolExecutor | None = None
        self._kept: str | None = None
        self._size, self._first = size, None  # of the display; the first rendered frame

    def __enter__(self) -> SequenceWriter:
        if kept := self._folder.open(self._description.settings):
            with contextlib.suppress(GffeError):  # none was finished
                frames = [entry for entry in parse_description(kept).frames if entry.kind == "extrapolated"]
                self.finished = {entry.file: entry for entry in frames if self._folder.has(entry.file)}
        self._pool = ThreadPoolExecutor(self._threads, thread_name_prefix="gffe-write")
        return self

    def add(self, entry: FrameEntry, channels: dict[str, np.ndarray], *, owned: bool = False) -> None:
        """Write the frame `entry` from `channels`: channel name → (H, W) array, copied before the call returns. With
        `owned` the writer takes over the dict and its arrays, copies them later, and empties the dict.

        R, G, B, `Z` and `motion.*` are floats, as of frames for a pipeline. Half stays half, masks of bool and uint8
        become half, `Z` and `motion.*` become float32. (H, W) is the entry's render size, else the display size; of
        these two in rendered frames, the entry's geometry size, else that of the `format`. Raises GffeError for another
        shape or type, and entries that could not be read again.
        """
        entry, owned = checked_entry(entry), require_bool(owned, "writer: owned")
        require_kind(channels, dict, "writer: channels", "a dict of arrays by their names")
        if not require_list(channels, str, "writer: names of channels", "texts"):
            raise GffeError(f"{entry.file}: no channels (expected at least R, G and B)")
        if entry.kind == "rendered" and entry.render_camera is None:
            raise GffeError(f"{entry.file}: no render_camera (rendered frames need one)")
        width, height = self._size_of(entry)
        geometry = (width, height)
        if entry.kind == "rendered":
            self._first = self._first or entry
            require_one_size((self._first, entry), self._size, str(self.path))
            geometry = require_render_size(self._description.format, geometry, entry.geometry_size)
        padded: dict[str, np.ndarray] = {}
        for name, array in channels.items():
            side, rows = geometry if name in GEOMETRY else (width, height)
            kinds = "f" if name in RENDERED else "biuf"
            array = require_array(array, f"{entry.file}: channel '{name}'", rows, side, kinds=kinds)
            if (side, rows) != (width, height):
                padded[name] = np.pad(array, ((0, height - rows), (0, width - side)))
        if owned:
            channels.update(padded)
        else:
            channels = channels | padded
        given = channels if owned else {name: exr.stored_type(name, array) for name, array in channels.items()}
        windows, nbytes = self._windows(entry), sum(np.asarray(array).nbytes for array in given.values())

        def write(path: Path) -> None:
            stored = {name: exr.stored_type(name, given.pop(name), copy=False) for name in list(given)}
            exr.write_channels(path, stored, windows, self._compression)

        self._submit(entry, write, nbytes)

    def add_frame(self, entry: FrameEntry, frame: RenderedFrame) -> None:
        """Write the rendered frame `frame`, of arrays, with its overlays. Size and jitter of its geometry replace those
        of `entry`; integer colors are from 0 to 1, and so are depth and motion as the `format` describes them. Raises
        GffeError as `add` does."""
        require_kind(entry, FrameEntry, "entry")
        require_kind(frame, RenderedFrame, "frame")
        entry = replace(entry, geometry_size=frame.geometry_size, geometry_jitter=frame.geometry_jitter)
        color, depth, motion = _as_floats(frame.color, ("unorm8", "unorm16")), frame.depth, frame.motion
        if self._description.format:
            depth = _as_floats(depth, DEPTH_TYPES)
            motion = None if motion is None else _as_floats(motion, MOTION_TYPES)
        self.add(entry, named_channels(color, depth, motion, frame.overlays))

    def link(self, entry: FrameEntry, source_path: str | os.PathLike[str]) -> None:
        """Add the existing EXR file `source_path` as the frame `entry`: a hard link, or else a copy."""
        source = Path(os.path.realpath(require_path(source_path, "writer: source_path")))
        self._submit(checked_entry(entry), lambda path: _link_or_copy(source, path))

    def take_up(self, entry: FrameEntry) -> None:
        """Keep a frame of `finished`. Raises GffeError for any other."""
        if require_kind(entry, FrameEntry, "entry") not in self.finished.values():
            raise GffeError(f"{entry.file}: is not finished (expected a frame of `finished`)")
        self._folder.claim(entry.file)
        self._description.frames.append(entry)

    def folder(self, name: str) -> Path:
        """Return the folder for other files of this run, which come to `path`/name together with the frames."""
        return self._folder.folder(check_file_name(name, str(self.path)))

    def __exit__(self, kind, error, trace) -> None:
        interrupted = isinstance(error, KeyboardInterrupt)
        failed = error is not None and not interrupted
        try:
            _undisturbed(lambda: self._end(failed, interrupted))
        except KeyboardInterrupt as late:
            error = late
            raise
        finally:
            if isinstance(error, KeyboardInterrupt) and self._kept:
                error.add_note(self._kept)
            self._end_threads()

    def _end(self, failed: bool, interrupted: bool) -> None:
        is_whole = False
        try:
            if not failed:
                self._finish(interrupted)
                is_whole = True
        finally:
            if not is_whole:
                self._stop()
                self._folder.discard()

    def _finish(self, interrupted: bool) -> None:
        while self._pending:
            try:
                self._pending[0][0].result()
            except (GffeError, OSError):
                if not interrupted:
                    raise
            self._pending.popleft()
        if not self._description.frames:
            self._folder.discard()
            if not interrupted:
                raise GffeError(f"{self.path}: no frame was written (expected at least one)")
            return
        document = self._document(interrupted)
        parse_description(document)  # do not write files that would not open again
        folder = self._folder.keep(document, interrupted)
        count = len(self._description.frames)
        self._kept = f"{count} finished frames are in {folder}" if interrupted else f"{folder} is complete"

    def _document(self, unfinished: bool) -> str:
        """Return the text of `sequence.json` with the frames that are written."""
        written = list(self._description.frames)  # threads add to it
        frames = sorted(written, key=lambda entry: (entry.time, KINDS.index(entry.kind), entry.file))
        return describe(replace(self._description, frames=frames, unfinished=unfinished), self._generator)

    def _end_threads(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)

    def _stop(self) -> None:
        self._end_threads()
        self._pending.clear()

    def _submit(self, entry: FrameEntry, write: Callable[[Path], None], nbytes: int = 0) -> None:
        if self._pool is None:
            raise GffeError(f"{self.path}: not open (use `with SequenceWriter(…) as writer:`)")
        while self._pending and (self._pending[0][0].done() or self._is_busy(nbytes)):
            future, held = self._pending.popleft()
            self._bytes -= held
            future.result()
        if self._description.settings is not None and time.monotonic() - self._noted > _NOTED_EVERY:
            with contextlib.suppress(OSError):  # a full disk fails elsewhere
                self._folder.note(self._document(unfinished=True))
            self._noted = time.monotonic()
        if entry.kind != "extrapolated" and entry.time in self._times:
            raise GffeError(f"{entry.file}: time {entry.time:g} s (expected one of its own)")
        path = self._folder.claim(entry.file)
        if entry.kind != "extrapolated":
            self._times.add(entry.time)

        def job():
            try:
                write(path)
            except OSError as error:
                raise GffeError(f"{path}: cannot be written ({error.strerror or error})") from None
            self._description.frames.append(entry)

        self._pending.append((self._pool.submit(job), nbytes))
        self._bytes += nbytes

    def _is_busy(self, nbytes: int) -> bool:
        return len(self._pending) >= self._threads + _WAITING or self._bytes + nbytes > _MOST_BYTES

    def _size_of(self, entry) -> tuple[int, int]:
        return entry.render_size or (self._description.width, self._description.height)

    def _windows(self, entry) -> dict:
        """Return the attributes of windows. The display window is the display where the stored image is a crop or an
        overscan of it in whole pixels; else both windows are the stored image."""
        render, display = entry.render_camera, entry.display_camera
        if render is None or display is None:
            return {}
        offset = (display.cx - render.cx, display.cy - render.cy)
        left, top = (round(n) for n in offset)
        same_scale = np.allclose((render.fx, render.fy), (display.fx, display.fy), rtol=1e-9)
        same_pose = np.array_equal(render.world_to_view, display.world_to_view)
        if not (same_scale and same_pose and np.abs(np.subtract(offset, (left, top))).max() < 1e-6):
            return {}
        size = (self._description.width, self._description.height)
        return {"dataWindow": _box(left, top, *self._size_of(entry)), "displayWindow": _box(0, 0, *size)}


def write_parts(
    path: Path,
    generator: str,
    parts: Iterable[dict[str, bytes]],
    settings: str | None = None,
    source: Path | None = None,
) -> int:
    """Write the sequence `path` from the files of its `parts`, consecutive sequences in memory, and return the number
    of frames. Frames without a file are linked from the folder `source`. `generator`, `settings` and errors: as of
    `SequenceWriter`."""
    writer, count = None, 0
    with contextlib.ExitStack() as stack:
        for files in parts:
            part = parse_description(files[FILE_NAME].decode())
            if writer is None:
                size, rate = (part.width, part.height), (part.fps, part.exposure)
                made = SequenceWriter(path, *size, *rate, generator=generator, format=part.format, settings=settings)
                writer = stack.enter_context(made)
            else:
                part.frames[0].reset = False  # the first frame of a description is read as one
            for entry in part.frames:
                if entry.file in files:
                    writer._submit(entry, partial(_write, files[entry.file]))
                elif source:
                    writer.link(entry, source / entry.file)
            count += len(part.frames)
    return count


def _write(content: bytes, path: Path) -> None:
    path.write_bytes(content)


def named_channels(
    color: ArrayLike,
    depth: ArrayLike | None = None,
    motion: ArrayLike | None = None,
    overlays: Overlays | None = None,
) -> dict[str, np.ndarray]:
    """Return the channels for `SequenceWriter.add` from color (H, W, 3 or 4), depth (H, W), motion (H, W, 2), these two
    perhaps smaller than color, and overlays. Color, depth and motion are floats. Raises GffeError for other shapes and
    types."""
    color = require_array(color, "color", None, None, (3, 4), kinds="f")
    channels = dict(zip("RGB", np.moveaxis(color[..., :3], -1, 0), strict=True))
    if depth is not None:
        channels["Z"] = require_array(depth, "depth", None, None, kinds="f")
    if motion is not None:
        channels["motion.x"], channels["motion.y"] = np.moveaxis(
            require_array(motion, "motion", *np.shape(color[..., 0] if depth is None else depth), 2, kinds="f"), -1, 0
        )
    if overlays is not None:
        require_kind(overlays, Overlays, "overlays", "Overlays or None")
    for field, names in OVERLAY_CHANNELS.items():
        array = getattr(overlays, field, None)
        if array is not None:
            shape = (None, None, len(names)) if len(names) > 1 else (None, None)
            planes = np.moveaxis(np.atleast_3d(require_array(array, f"overlays: {field}", *shape, kinds="biuf")), -1, 0)
            halves = planes.astype(np.float16) if field != "effects_motion" else planes.astype(np.float32)
            channels |= dict(zip(names, halves, strict=True))
    return channels


def _as_floats(array: Any, types: tuple[str, ...]) -> Any:
    """Return an array of integers of one of the `types` as float32, 0 to 1 or −1 to 1, and others unchanged."""
    array = np.asarray(array)
    name = type_of(array)
    if name not in types or array.dtype.kind == "f":
        return array
    values = array & 0xFFFFFF if name == "unorm24" else array
    return (values / np.float64(TYPES[name][1])).astype(np.float32)


def _undisturbed(work: Callable[[], None]) -> None:
    """Do `work` on a thread, where Ctrl-C does not reach it; KeyboardInterrupt comes through when it is done."""
    interrupt = None
    with ThreadPoolExecutor(1, thread_name_prefix="gffe-end") as pool:
        future = pool.submit(work)
        while not future.done():
            try:
                wait([future])
            except KeyboardInterrupt as error:
                interrupt = error
    future.result()
    if interrupt:
        raise interrupt


def _box(left, top, width, height):
    return (np.array([left, top], np.int32), np.array([left + width - 1, top + height - 1], np.int32))


def _link_or_copy(source: Path, path: Path) -> None:
    part_path = exr.partial_name(path)
    try:
        part_path.unlink(missing_ok=True)
        try:
            os.link(source, part_path)
        except OSError:
            shutil.copyfile(source, part_path)
        os.replace(part_path, path)
    finally:  # renaming one link over another of the same file leaves both
        with contextlib.suppress(OSError):
            part_path.unlink()
