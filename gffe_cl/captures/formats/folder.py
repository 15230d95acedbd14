"""Reader of folders of EXR, PNG or NPY images that a short `sequence.json` of `"format": "gffe-folder"` describes.

The schema is in docs/formats.md.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gffe_cl.captures.formats.buffers import (
    Buffer,
    ColorBuffer,
    DepthBuffer,
    MotionBuffer,
    parse_buffer,
    parse_color,
    parse_depth,
    parse_motion,
)
from gffe_cl.captures.formats.cameras import CameraRules, FoundCamera, parse_camera, parse_rules
from gffe_cl.captures.formats.capture import MOST_FRAMES, described, read_json
from gffe_cl.captures.formats.flow import inverted_flow
from gffe_cl.captures.formats.images import Size
from gffe_cl.captures.formats.json_schema import Keys
from gffe_cl.captures.formats.numbering import mark_gaps
from gffe_cl.captures.sequence.description import FILE_NAME, Description, FrameEntry
from gffe_cl.captures.sequence.pixel_source import ForeignPixels
from gffe_cl.captures.sequence.reader import Sequence
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.files import open_regular
from gffe_cl.engine.core.validation import (
    MOST_SIDE,
    require_exposure,
    require_number,
    require_positive,
    require_whole,
)
from gffe_cl.engine.frame.conventions import refuse_oblique

FORMAT, VERSION = "gffe-folder", 1
_NUMBERS = -(10**9), 10**9  # of frames
_FIRST_BYTES = 1 << 16


@dataclass(frozen=True, eq=False)
class _Frame:
    """One frame, with the number in the names of its files."""

    number: int
    entry: FrameEntry
    camera: Any  # a FoundCamera; None where none is needed
    before: _Frame | None  # the rendered one before it, unless it is a reset


@dataclass
class FolderSettings:
    """Contents of the JSON; `cameras`: conventions of the matrices."""

    size: Size
    color: ColorBuffer
    truth: ColorBuffer
    depth: DepthBuffer
    motion: MotionBuffer
    cameras: CameraRules
    frames: dict[str, _Frame]  # by the entry's name
    gaps: str | None = None  # a sentence about numbers that are missing

    @property
    def has_projections(self) -> bool:
        return any(frame.camera and frame.camera.projection is not None for frame in self.frames.values())


def is_folder(path: Path) -> bool:
    """Return whether the `sequence.json` at `path` names this format, near its beginning. Raises OSError if it cannot
    be read."""
    with open_regular(path) as file:
        start = file.read(_FIRST_BYTES)
    found = re.search(rb'"format"\s*:\s*"([^"]*)"', start)
    return bool(found) and found[1] == FORMAT.encode()


def open_folder(folder: Path, *, cameras: str = "needed") -> Sequence:
    """Open the capture in `folder` and return it: the JSON and the headers of all images are checked. With `cameras`
    "optional" none need be described. Raises GffeError."""
    made, description = _parse(folder, read_json(folder / FILE_NAME), cameras == "needed")
    for frame in made.frames.values():
        if frame.entry.kind == "ground_truth":
            made.truth.buffer.check(folder, frame.number, made.size)
            continue
        made.color.buffer.check(folder, frame.number, made.size)
        made.depth.buffer.check(folder, frame.number, made.size)
        if frame.before:
            made.motion.buffer.check(folder, (frame.before if made.motion.to_next else frame).number, made.size)
    return Sequence(folder, description, FolderPixels(folder, made))


class FolderPixels(ForeignPixels):
    """Pixels of the capture in `folder`."""

    def __init__(self, folder: Path, made: FolderSettings):
        super().__init__()
        self._folder, self.settings = folder, made
        self.notes += [f"{folder}: {made.gaps}"] if made.gaps else []
        ranges = (made.depth.range_note(one.camera) for one in made.frames.values() if one.camera)
        self.notes += [note for note in ranges if note][:1]

    def rendered(self, entry, size):
        frame = self.settings.frames[entry.file]
        with np.errstate(all="ignore"):  # bad pixels are survived
            depth, motion = self._depth(frame), None
            if frame.before:
                motion = self._motion(frame, depth)
        return self.color(entry, size), depth, motion

    def color(self, entry, size):
        frame = self.settings.frames[entry.file]
        buffer = self.settings.truth if entry.kind == "ground_truth" else self.settings.color
        with np.errstate(all="ignore"):
            return buffer.read(self._folder, frame.number, size)

    def _depth(self, frame: _Frame) -> np.ndarray:
        return self.settings.depth.read(self._folder, frame.number, self.settings.size, frame.camera)

    def _motion(self, frame: _Frame, depth: np.ndarray) -> np.ndarray:
        said, before = self.settings.motion, frame.before
        assert before is not None  # only resets have none
        if said.to_next:
            flow = said.read(self._folder, before.number, self.settings.size)
            motion = inverted_flow(flow, self._depth(before), before.camera.camera, depth, frame.camera.camera)
        else:
            motion = said.read(self._folder, frame.number, self.settings.size)
        if said.jitter_removed:
            motion += np.float32(np.subtract(before.camera.jitter, frame.camera.jitter))
        return motion


def _parse(folder: Path, document: dict, cameras_needed: bool) -> tuple[FolderSettings, Description]:
    keys = Keys(document, FILE_NAME)
    keys.take("format")
    if keys.take("version", VERSION) != VERSION:
        raise GffeError(f"{FILE_NAME}: unknown version (expected {VERSION})")
    size = (
        require_whole(keys.take("width"), f"{FILE_NAME}: width", 1, MOST_SIDE),
        require_whole(keys.take("height"), f"{FILE_NAME}: height", 1, MOST_SIDE),
    )
    fps = keys.take("fps")
    fps = None if fps is None else require_positive(fps, f"{FILE_NAME}: fps")
    exposure = require_exposure(keys.take("exposure", 1.0), f"{FILE_NAME}: exposure")
    cameras = Keys(keys.take("camera", {}), "camera")
    rules, files, listed = parse_rules(cameras), _camera_files(cameras), cameras.take("list")
    cameras.done()
    color = keys.take("color")
    made = FolderSettings(
        size,
        parse_color(color),
        parse_color(keys.take("ground_truth", color), "ground_truth"),
        parse_depth(keys.take("depth"), rules.convention),
        parse_motion(keys.take("motion")),
        rules,
        {},
    )
    frames = list(_frames(keys.take("frames"), fps))
    keys.done()
    if listed is not None and (not isinstance(listed, list) or len(listed) != len(frames)):
        raise GffeError(f"camera, list must have a camera for each of the {len(frames)} frames")
    previous = None
    made.gaps = mark_gaps([(number, entry) for number, entry, _ in frames])
    for index, (number, entry, camera) in enumerate(frames):
        label = f"{FILE_NAME}, frame {number}, camera"
        if camera is None and listed is not None:
            camera = listed[index]
        if camera is None and files is not None:
            label = files.file(number)
            camera = read_json(files.path(folder, number))
        found = None
        if camera is not None or cameras_needed:
            found = parse_camera(camera, rules, size, label)
            entry.display_camera = found.camera
        _require_camera(made, found, label)
        frame = _Frame(number, entry, found, None)
        if entry.kind == "rendered":
            entry.render_camera = entry.display_camera
            entry.reset = entry.reset or previous is None
            frame = _Frame(number, entry, found, None if entry.reset else previous)
            previous = frame
        made.frames[entry.file] = frame
    return made, described(FILE_NAME, size, [entry for _, entry, _ in frames], fps, exposure)


def _require_camera(made: FolderSettings, found: FoundCamera | None, label: str) -> None:
    """Raise GffeError if the camera lacks data that the buffers need."""
    if made.depth.encoding == "device" and made.depth.near is None and (found is None or found.projection is None):
        raise GffeError(f"{label}: device depth needs a projection matrix, or near and far in depth")
    if made.depth.encoding == "device" and found is not None and found.projection is not None:
        try:
            refuse_oblique(found.projection)
        except GffeError as error:
            raise GffeError(f"{label}: {str(error).removeprefix('camera: ')}") from None
    if found is None:
        for needs, what in (
            (made.depth.encoding == "distance", "distances along the rays"),
            (made.motion.to_next, "motion to the next frame"),
            (made.motion.jitter_removed, "motion without jitter"),
        ):
            if needs:
                raise GffeError(f"{label}: {what} cannot be converted without a camera")


def _camera_files(keys: Keys) -> Buffer | None:
    pattern = keys.text("file")
    return None if pattern is None else parse_buffer(Keys({"file": pattern}, "camera"), ("R",))


def _frames(given: Any, fps: float | None) -> Iterator[tuple[int, FrameEntry, Any]]:
    """Yield number, entry without camera, and the camera's JSON of each frame, in order of time."""
    if isinstance(given, dict):
        keys = Keys(given, f"{FILE_NAME}, frames")
        first, step, count = (
            keys.take(name, default) for name, default in (("first", 0), ("step", 1), ("count", None))
        )
        keys.done()
        if fps is None:
            raise GffeError(f"{FILE_NAME}: frames without times need fps")
        require_whole(count, f"{FILE_NAME}, frames, count", 1, MOST_FRAMES)
        first = require_whole(first, f"{FILE_NAME}, frames, first", *_NUMBERS)
        step = require_whole(step, f"{FILE_NAME}, frames, step", 1, _NUMBERS[1])
        given = [{"number": first + k * step, "time": k / fps} for k in range(count)]
    if not isinstance(given, list) or not 0 < len(given) <= MOST_FRAMES:
        raise GffeError(
            f'{FILE_NAME}: frames must be {{"first": …, "count": …}} or a list of 1 to {MOST_FRAMES} frames'
        )
    found = [_frame(one, index) for index, one in enumerate(given)]
    return iter(sorted(found, key=lambda one: one[1].time))


def _frame(given: Any, index: int) -> tuple[int, FrameEntry, Any]:
    keys = Keys(given, f"{FILE_NAME}, frames[{index}]")
    number = require_whole(keys.take("number"), f"{keys.label}, number", *_NUMBERS)
    kind = keys.choice("kind", ("rendered", "ground_truth"), "rendered")
    time = require_number(keys.take("time"), f"{keys.label}, time")
    entry = FrameEntry(f"{'frame' if kind == 'rendered' else 'truth'}_{number:06d}.exr", time, kind, keys.flag("reset"))
    camera = keys.take("camera")
    keys.done()
    return number, entry, camera
