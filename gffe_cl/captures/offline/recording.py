"""Recording of the rendered frames of a running pipeline, as a sequence on disk that grows."""

from __future__ import annotations

import os
import re
import threading
import warnings
import weakref
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyopencl as cl

from gffe_cl.captures.sequence import exr
from gffe_cl.captures.sequence.description import (
    FILE_NAME,
    Description,
    FrameEntry,
    describe,
    read_text,
    rendered_entry,
)
from gffe_cl.captures.sequence.exr import GEOMETRY
from gffe_cl.captures.sequence.reader import usable_cores
from gffe_cl.captures.sequence.writer import named_channels
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.files import write_text
from gffe_cl.engine.core.validation import require_array, require_kind, require_path, require_whole
from gffe_cl.engine.frame.frame_format import TYPES, FrameFormat, require_render_size
from gffe_cl.engine.frame.rendered_frame import (
    HALF_MAX,
    OVERLAYS,
    Overlays,
    RenderedFrame,
    described_arrays,
    host_arrays,
    type_of,
)
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.buffers import BufferSpec, Sizes, given_buffer
from gffe_cl.engine.stages.intake import described_specs
from gffe_cl.engine.stages.presentation import Composition

_GENERATOR = "gffe-cl record"
_OWN = re.compile(r"\.?(frame_\d{6}|sequence)(\.part)?\.(exr|json)(\.part)?")
_WAITING = 8  # frames under way
_MOST = 100_000


def record(pipeline: Pipeline, folder: str | os.PathLike[str], most: int = 240) -> Recording:
    """Write the rendered frames that `pipeline` takes from now on into `folder`, as a sequence that `gffe view FOLDER`
    follows while it grows.

    Frames are written as the program gives them, NumPy arrays or device buffers, with overlays and the pipeline's
    `FrameFormat`. The layers that the viewer shows are then those of the program, to the bit, from the first reset on,
    if it has the same options and the exposure has not changed. Cuts that the pipeline finds become resets.

    `submit` copies arrays, or enqueues the reading of device buffers; other threads write. Where they are slower than
    the program, frames are dropped, and the next one becomes a reset. While the recording is off, nothing is copied.
    It ends after `most` frames, with the program, where a frame cannot be written (a full disk), and where the
    pipeline gets another `format`; the last two give a warning.

    Parameters
    ----------
    pipeline : Pipeline
    folder : path-like
        Created, with its parents. An earlier recording in it is replaced.
    most : int
        Number of frames, 1 to 100,000.

    Returns
    -------
    Recording
        A context manager, switched on.

    Raises
    ------
    GffeError
        For arguments of other types, a pipeline that is recorded already, and a folder that holds anything else than an
        earlier recording, or cannot be written to.

    Notes
    -----
    A user interface (`Overlays.ui`) is not recorded where rendered frames have another size than the display: sequences
    store it in pixels of the frame. A frame whose time is not later than the one before, as after a reset, is moved to
    1/fps after that.
    """
    require_kind(pipeline, Pipeline, "record: pipeline", "a Pipeline")
    if pipeline.watcher is not None:
        raise GffeError("record: this pipeline is recorded already (expected close() before)")
    return Recording(pipeline, require_path(folder, "record: folder"), require_whole(most, "record: most", 1, _MOST))


@dataclass
class _Waiting:
    """Frame on its way to disk. `is_decided`: whether it is known if the pipeline found it to be a cut."""

    entry: FrameEntry
    is_decided: bool = False
    is_written: bool = False


class Recording:
    """Recording of a pipeline, returned by `record`; a context manager that closes it.

    Attributes
    ----------
    folder : Path
    written : int
        Number of frames in the folder.
    dropped : int
        Number of frames that were lost because writing took too long.
    """

    def __init__(self, pipeline: Pipeline, folder: Path, most: int):
        _take_folder(folder)
        self.folder, self.written, self.dropped = folder, 0, 0
        self._pipeline, self._format, self._left = weakref.ref(pipeline), pipeline.format, most
        self._about = Description(*pipeline.sizes.target, pipeline.fps, pipeline.exposure, [])
        self._waiting: deque[_Waiting] = deque()  # in their order
        self._is_torn = True  # whether the next frame does not continue the last
        self._taken, self._time, self._shift = 0, 0.0, 0.0
        self._fault, self._listing = "", threading.Lock()
        self._pool = ThreadPoolExecutor(max(usable_cores() // 2, 1), thread_name_prefix="gffe-record")
        self._end = weakref.finalize(pipeline, self._finish)  # at the end of the program, too
        self.start()

    @property
    def on(self) -> bool:
        """Whether frames are recorded now."""
        pipeline = self._pipeline()
        return pipeline is not None and pipeline.watcher == self._take

    def start(self) -> None:
        """Record from the next frame on, which becomes a reset. Without effect when the recording has ended."""
        pipeline = self._pipeline()
        if pipeline is not None and not self.on and self._left:
            self._is_torn, pipeline.watcher = True, self._take

    def stop(self) -> None:
        """Record no more frames until `start`. Frames under way are still written."""
        pipeline = self._pipeline()
        if pipeline is not None and self.on:
            self._note_cut(pipeline.is_cut)
            pipeline.watcher = None
        self._note_cut(False)
        self._list()

    def close(self) -> None:
        """End the recording, and wait until all frames are written. A second call does nothing."""
        self.stop()
        self._end()
        self._pool.shutdown()

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def _finish(self) -> None:
        self._left = 0
        self._note_cut(False)
        self._list()
        self._pool.shutdown(wait=False)

    # ---- on the program's thread, which must not wait --------------------------------------------------------

    def _take(self, pipeline: Pipeline, frame: RenderedFrame, was_cut: bool) -> None:
        """Take a frame that was submitted. `was_cut`: whether the pipeline found the one before to be a cut."""
        self._note_cut(was_cut)
        if not self._left:
            self._leave(pipeline)
        elif len(self._waiting) >= _WAITING:
            self.dropped, self._is_torn = self.dropped + 1, True
        else:
            try:
                copy, events = _copied(pipeline, frame)
                format = _stored_format(pipeline.format, copy)
            except (GffeError, cl.Error, MemoryError) as error:
                self._leave(pipeline, str(error))
                return
            self._about.format = self._about.format if self._taken else format
            if format != self._about.format:
                self._leave(pipeline, "the pipeline has another format")
            else:
                self._begin(self._entry(pipeline, frame, copy), copy, events)

    def _entry(self, pipeline: Pipeline, frame: RenderedFrame, copy: RenderedFrame) -> FrameEntry:
        if self._taken and frame.time + self._shift <= self._time:
            self._shift = self._time + 1 / pipeline.fps - frame.time
        self._time = frame.time + self._shift
        entry = rendered_entry(self._taken, copy, pipeline.sizes.target)
        return replace(entry, time=self._time, reset=frame.reset or self._is_torn)

    def _begin(self, entry: FrameEntry, copy: RenderedFrame, events: list[cl.Event]) -> None:
        self._taken, self._left, self._is_torn = self._taken + 1, self._left - 1, False
        self._waiting.append(_Waiting(entry))
        self._pool.submit(self._write, self._waiting[-1], copy, events)

    def _note_cut(self, is_cut: bool) -> None:
        """Note whether the last frame was a cut, if that is not known yet."""
        if self._waiting and not self._waiting[-1].is_decided:
            self._waiting[-1].entry.reset |= is_cut
            self._waiting[-1].is_decided = True

    def _leave(self, pipeline: Pipeline, fault: str = "") -> None:
        """Take no more frames."""
        pipeline.watcher, self._left = None, 0
        self._pool.submit(self._fail, fault) if fault else self._pool.submit(self._list)

    # ---- on other threads ------------------------------------------------------------------------------

    def _write(self, one: _Waiting, frame: RenderedFrame, events: list[cl.Event]) -> None:
        try:
            if events:
                cl.wait_for_events(events)
            exr.write_channels(self.folder / one.entry.file, _channels(frame), compression="zips")
        except (OSError, GffeError, cl.Error, MemoryError) as error:
            self._fail(str(getattr(error, "strerror", None) or error))
            return
        one.is_written = True
        self._list()

    def _list(self) -> None:
        """Write `sequence.json` with all frames that are finished, in their order."""
        with self._listing:
            before = self.written
            while self._waiting and self._waiting[0].is_decided and self._waiting[0].is_written:
                self._about.frames.append(self._waiting.popleft().entry)
                self.written += 1
            try:
                if self.written > before:
                    write_text(self.folder / FILE_NAME, describe(self._about, _GENERATOR))
            except OSError as error:
                self._fail(error.strerror or str(error))

    def _fail(self, fault: str) -> None:
        """End the recording, with a warning for the first fault."""
        self._left, told, self._fault = 0, self._fault, fault
        if not told:
            warnings.warn(f"{self.folder}: the recording ends after {self.written} frames ({fault})", stacklevel=1)


def _take_folder(folder: Path) -> None:
    """Make the folder, or remove an earlier recording from it. Raises GffeError if it holds anything else."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        found = [path.name for path in folder.iterdir()]
        is_ours = not found or (all(map(_OWN.fullmatch, found)) and f'"generator": "{_GENERATOR}"' in _text_in(folder))
        if not is_ours:
            raise GffeError(f"{folder}: holds other files (expected an empty folder, or an earlier recording)")
        for name in sorted(found, key=lambda name: name != FILE_NAME):  # that first: it names the others
            (folder / name).unlink()
        if not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError("expected a folder with permission")
    except OSError as error:
        raise GffeError(f"{folder}: cannot be written to ({error.strerror or error})") from None


def _text_in(folder: Path) -> str:
    """Return the text of the folder's `sequence.json`; empty if that cannot be read."""
    try:
        return read_text(folder / FILE_NAME)
    except GffeError:
        return ""


def _copied(pipeline: Pipeline, frame: RenderedFrame) -> tuple[RenderedFrame, list[cl.Event]]:
    """Return a frame that was submitted with copies of its arrays. Those of device buffers are valid after the
    events."""
    device, sizes, events = pipeline.device, pipeline.sizes, []
    geometry = require_render_size(pipeline.format, sizes.source, frame.geometry_size)
    small = replace(sizes, source=geometry)

    def read(value: Any, spec: BufferSpec, sizes: Sizes) -> np.ndarray | None:
        """Return the content of a device buffer; None for arrays."""
        buffer: Any = None if value is None else given_buffer(value, spec, sizes, device)
        if buffer is None:
            return None
        array, flat = spec.host_array(spec.size(sizes))
        events.append(cl.enqueue_copy(device.queue, flat, buffer, is_blocking=False))
        return array if spec.components else array[..., 0]

    planes: dict[str, Any] = {
        spec.name: read(getattr(frame, spec.name), spec, sizes if spec.name == "color" else small)
        for spec in described_specs(pipeline.format or FrameFormat())
    }
    if planes["color"] is None:
        plain = pipeline.format is None and geometry == sizes.source
        arrays = host_arrays(frame, *sizes.source[::-1]) if plain else described_arrays(frame, sizes.source, geometry)
        planes = {name: None if (a := getattr(arrays, name)) is None else np.array(a) for name in planes}
    layers: dict[str, Any] = {}
    for spec in (spec for spec in Composition.buffers if spec.name in OVERLAYS):
        given = getattr(frame.overlays, spec.name, None)
        if given is None or (spec.name == "ui" and sizes.source != sizes.target):
            continue
        layers[spec.name] = read(given, spec, sizes)
        if layers[spec.name] is None:
            array = require_array(given, f"frame: {spec.name}", *spec.shape(sizes), kinds="biuf")
            layers[spec.name] = array > 0 if spec.name == "fixed_mask" else np.array(array, spec.dtype)
    return replace(frame, **planes, overlays=Overlays(**layers) if layers else None), events


def _stored_format(format: FrameFormat | None, frame: RenderedFrame) -> FrameFormat | None:
    """Return the description of a frame as `_channels` stores it: integers as the same numbers in float32."""
    if format is None:
        return None
    depth_type, motion_type = type_of(frame.depth), format.motion_type
    if frame.motion is not None:
        motion_type = type_of(frame.motion) or motion_type
    depth_most, (kind, motion_most) = TYPES[depth_type or "float32"][1], TYPES[motion_type]
    invalid = format.motion_invalid
    if invalid is not None and abs(invalid * motion_most) <= HALF_MAX:
        invalid = float(kind(np.round(invalid * motion_most)) if motion_most > 1 else kind(invalid))
    (near, far), scale = format.depth_range, format.motion_scale
    return replace(
        format,
        color_type="float32",
        depth_type="float32",
        motion_type="float32",
        motion_channels=2,
        depth_range=(near * depth_most, far * depth_most),
        motion_invalid=invalid,
        motion_scale=(scale[0] / motion_most, scale[1] / motion_most),
    )


def _channels(frame: RenderedFrame) -> dict[str, np.ndarray]:
    """Return the channels of a copied frame for its EXR file."""
    color, depth, motion = frame.color, frame.depth, frame.motion
    if color.dtype.kind == "u":  # as kernels/upload.cl scales it
        color = color.astype(np.float32) * np.float32(1 / TYPES[type_of(color) or ""][1])
    depth = (depth & 0xFFFFFF if depth.dtype == np.uint32 else depth).astype(np.float32)
    motion = None if motion is None else motion[..., :2].astype(np.float32)
    channels = named_channels(color, depth, motion, frame.overlays)
    rows, columns = np.shape(color)[:2]
    for name in channels.keys() & set(GEOMETRY):
        height, width = channels[name].shape
        channels[name] = np.pad(channels[name], ((0, rows - height), (0, columns - width)))
    return {name: exr.stored_type(name, array, copy=False) for name, array in channels.items()}
