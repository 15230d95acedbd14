"""Import of captures of any form into sequences of our own (`gffe import`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from gffe_cl.captures.formats.flow import composed
from gffe_cl.captures.sequence import FrameEntry, Sequence, SequenceWriter, named_channels, refuse_same_folder
from gffe_cl.captures.sequence.encoding import EXACT, Encoding
from gffe_cl.captures.sequence.exr import DEFAULT_COMPRESSION
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.rendered_frame import RenderedFrame

_MOST_EVERY = 16


@dataclass
class ImportReport:
    """Number of frames written, by kind, and warnings."""

    rendered: int = 0
    ground_truth: int = 0
    warnings: list[str] = field(default_factory=list)


def import_capture(
    sequence: Sequence,
    output: Path,
    every: int = 1,
    *,
    encoding: Encoding = EXACT,
    compression: str = DEFAULT_COMPRESSION,
    on_frame: Callable[[], None] = lambda: None,
) -> ImportReport:
    """Write the rendered frames and the truth of `sequence` into the folder `output`, in our own form, and return the
    counts. Depth and motion that the sequence stores in an engine's format keep it, with its description, where nothing
    is to be changed: with `every` 1 and an exact `encoding`.

    Of the rendered frames after a reset every `every`-th one stays rendered, the others become ground truth; motion
    then reaches over the frames in between, m₂(x) = m(x) + m′(x + m(x)), and `fps` is that of the frames that stay.
    Frames that stay are stored by `encoding`. `compression` is that of the EXRs (see `SequenceWriter`). `on_frame` is
    called after every frame.

    Raises GffeError for structural faults; then `output` is as it was before.
    """
    if not 1 <= every <= _MOST_EVERY:
        raise GffeError(f"--every must be 1 to {_MOST_EVERY}, got {every}")
    if encoding.is_rendered:
        raise GffeError("--encode: taa and jittered need a renderer (expected `gffe render --encode`)")
    refuse_same_folder(output, sequence.path)
    if every > 1 or encoding.is_on_display:
        _require_unwindowed(sequence)
    if not sequence.rendered and not sequence.ground_truth:
        raise GffeError(f"{sequence.path}: neither rendered frames nor ground truth to import")
    report, names = ImportReport(), {entry.file for entry in sequence.frames}
    fps, size = sequence.fps / every, (sequence.width, sequence.height)
    writing = SequenceWriter(
        output,
        *size,
        fps,
        sequence.exposure,
        generator="gffe-cl import",
        compression=compression,
        format=sequence.format if every == 1 and encoding == EXACT else encoding.format,
    )
    with writing as writer:
        for entry, frame, stays in _thinned(sequence, every, encoding):
            if stays:
                writer.add_frame(entry, frame)
            else:
                truth = encoding.truth(frame.color, sequence.exposure)
                _add_truth(writer, replace(entry, file=_truth_name(entry.file, names)), truth)
            report.rendered += stays
            report.ground_truth += not stays
            on_frame()
        for entry, color in sequence.prefetch(sequence.ground_truth, sequence.read_color):
            _add_truth(writer, entry, encoding.truth(color, sequence.exposure))
            report.ground_truth += 1
            on_frame()
    report.warnings = sequence.warnings()
    if sequence.known_cameras:
        report.warnings.append(f"{len(sequence.known_cameras)} cameras without a picture are left out")
    return report


def _thinned(sequence: Sequence, every: int, encoding: Encoding) -> Iterator[tuple[FrameEntry, RenderedFrame, bool]]:
    """Yield each rendered frame, and whether it stays; then it is stored, with motion to the one before that stays."""
    since: list[RenderedFrame] = []  # the last one that stays, and those after it
    reading = sequence.read_stored if every == 1 and encoding == EXACT else sequence.read
    for entry, frame in sequence.prefetch(sequence.rendered, reading):
        if entry.reset:
            since = []
        stays = len(since) in (0, every)
        if not stays:
            since.append(frame)
            yield entry, frame, False
            continue
        stored = replace(frame, motion=_over(frame, since)) if since else frame
        since = [frame]
        yield entry, encoding.frame(stored, sequence.exposure), True


def _over(frame: RenderedFrame, since: list[RenderedFrame]) -> np.ndarray | None:
    """Return the motion of `frame` to the first of the frames `since`, each of which has it to the one before; None
    without motion."""
    motion = frame.motion
    for steps, k in enumerate(range(len(since) - 1, 0, -1), 1):
        between, before = since[k], since[k - 1]
        motion = composed(
            motion, frame.depth, frame.camera, between.motion, between.depth, between.camera, before.camera, steps
        )
    return motion


def _add_truth(writer: SequenceWriter, entry: FrameEntry, color: np.ndarray) -> None:
    camera = entry.display_camera
    writer.add(FrameEntry(entry.file, entry.time, "ground_truth", display_camera=camera), named_channels(color))


def _truth_name(file: str, taken: set[str]) -> str:
    """Return a name for a rendered frame that becomes truth."""
    path = Path(file)
    name = path.with_name("truth_" + path.name.removeprefix("frame_")).as_posix()
    while name in taken:
        name = path.with_name("truth_" + Path(name).name).as_posix()
    taken.add(name)
    return name


def _require_unwindowed(sequence: Sequence) -> None:
    for entry in sequence.rendered:
        if sequence.size_of(entry) != (sequence.width, sequence.height) or entry.display_camera != entry.render_camera:
            raise GffeError(f"{entry.file}: rendered through a window (expected none, or neither --every nor hud)")
