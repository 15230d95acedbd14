"""Shared parts of readers of foreign captures: objects in JSON, frames in order, numbers in file names, layers of EXR
files."""

from __future__ import annotations

import json
import os
import re
from collections import defaultdict
from collections.abc import Iterable
from collections.abc import Sequence as Ordered
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gffe_cl.captures.sequence.description import Description, FrameEntry, check_times, read_text
from gffe_cl.captures.sequence.exr import ExrHeader, ExrPart
from gffe_cl.engine.core.errors import GffeError, within
from gffe_cl.engine.core.validation import require_bool, require_choice, require_number, require_positive, shown
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.conventions import rigid, square

MOST_JSON = 64 << 20
MOST_FRAMES = 1 << 17
Size = tuple[int, int]
Place = tuple[int, str]  # part, channel in it

# The last number of a name is the frame's. A minus is its sign unless it stands after a letter or digit: Shot-0001.
_NUMBER = re.compile(r"(?:(?<![^\W_])-)?\d+")
_MOST_DIGITS, _MOST_NAMED = 18, 6
_LATE = 1.5  # intervals: frames that are farther apart have one missing between them


class Keys:
    """Keys of the object `document`; `label` names it in errors. Keys that were not taken before `done` are unknown
    ones."""

    def __init__(self, document: Any, label: str):
        if document is None:
            raise GffeError(f"{label} is missing (expected an object)")
        if not isinstance(document, dict):
            raise GffeError(f"{label} must be an object, got {shown(document)}")
        self._left, self.label, self._known = dict(document), label, []

    def take(self, key: str, default: Any = None) -> Any:
        self._known.append(key)
        value = self._left.pop(key, None)
        return default if value is None else value

    def number(self, key: str, default: float | None = None) -> float | None:
        value = self.take(key, default)
        return None if value is None else require_number(value, f"{self.label}, {key}")

    def flag(self, key: str, default: bool = False) -> bool:
        return require_bool(self.take(key, default), f"{self.label}, {key}")

    def choice(self, key: str, choices: Iterable[str], default: str) -> str:
        return require_choice(self.take(key, default), choices, f"{self.label}, {key}")

    def done(self) -> None:
        """Raise GffeError if there are keys that were not taken."""
        for key in self._left:
            raise GffeError(f"{self.label}: unknown key {shown(key)} (expected some of {', '.join(self._known)})")


def read_json(path: Path) -> dict:
    """Return the object in the JSON file at `path`. Raises GffeError if it is missing or invalid."""
    text = read_text(path, MOST_JSON)
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise GffeError(f"{path.name}: not valid JSON ({' '.join(str(error).split())})") from None
    if not isinstance(document, dict):
        raise GffeError(f"{path.name}: expected a JSON object, got {shown(document)}")
    return document


def described(
    name: str,
    size: tuple[int, int],
    frames: Iterable[FrameEntry],
    fps: float | None = None,
    exposure: float = 1.0,
    known_cameras: Iterable[FrameEntry] = (),
) -> Description:
    """Return the description of `frames`, in order of time. The first rendered frame is a reset. If `fps` is None it
    follows from the times. Raises GffeError, beginning with `name`, if there are no frames or times do not increase."""
    ordered = sorted(frames, key=lambda entry: entry.time)
    if not ordered:
        raise GffeError(f"{name}: no frames (expected at least one)")
    check_times(ordered, name)
    files = [entry.file for entry in ordered]
    if len(set(files)) < len(files):
        twice = next(file for file in files if files.count(file) > 1)
        raise GffeError(f"{name}: {twice} is listed twice (expected a file for each frame)")
    rendered = [entry for entry in ordered if entry.kind == "rendered"]
    if rendered:
        rendered[0].reset = True
    cameras = tuple(sorted(known_cameras, key=lambda entry: entry.time))
    return Description(*size, fps or _fps(rendered or ordered), exposure, ordered, False, cameras)


def camera_of(document: dict, matrix: str, size: tuple[int, int], label: str) -> Camera:
    """Return the camera in a JSON object: `matrix`, 4×4 world → x right, y down, z forward, perhaps scaled, and fx, fy,
    cx, cy in pixels; fy defaults to fx, cx and cy to the middle of the image. Raises a GffeError that begins with
    `label`."""
    if document.get(matrix) is None or document.get("fx") is None:
        raise GffeError(f"{label}: no {matrix if document.get(matrix) is None else 'fx'} (expected a camera)")
    with within(label):
        view = square(document[matrix], matrix)
        if np.abs(view[3] - (0, 0, 0, 1)).max() > 1e-6:
            raise GffeError(f"camera: the last row of {matrix} must be 0 0 0 1 (column vectors)")
        fx = require_positive(document["fx"], "camera: fx")
        fy = require_positive(document.get("fy", fx), "camera: fy")
        cx = require_number(document.get("cx", size[0] / 2), "camera: cx")
        cy = require_number(document.get("cy", size[1] / 2), "camera: cy")
        return Camera(rigid(view, matrix), fx, fy, cx, cy)


def through_window(entry: FrameEntry, part: ExrPart, size: tuple[int, int], label: str) -> None:
    """Set the render size and camera of a rendered frame whose stored image (data window) differs from the displayed
    one (display window); its display camera is in displayed pixels. Raises GffeError unless the displayed image has
    `size`."""
    (width, height), (left, top) = part.shown_size, part.offset
    if (width, height) != tuple(size):
        raise GffeError(f"{label}: {width}×{height} pixels, expected {size[0]}×{size[1]}")
    if part.size == tuple(size) and not (left or top):
        return
    entry.render_size = part.size
    if entry.kind == "rendered":
        camera = entry.display_camera
        assert camera is not None  # the caller has set it
        entry.render_camera = replace(camera, cx=camera.cx - left, cy=camera.cy - top)


def _fps(frames: list[FrameEntry]) -> float:
    steps = np.diff([entry.time for entry in frames])
    return round(float(1 / np.median(steps)), 6) if len(steps) else 30.0


# ---- numbers in file names -----------------------------------------------------------------------------


def visible_files(folder: Path, ending: str = "") -> list[Path]:
    """Return the files in `folder` with this `ending`, whatever the case of its letters, that are not hidden."""
    try:
        found = sorted(folder.iterdir())
    except FileNotFoundError:
        return []
    return [path for path in found if not path.name.startswith(".") and path.name.lower().endswith(ending)]


def with_ending(path: Path) -> Path:
    """Return `path`, or where there is no such file, the one whose ending is in capital letters, or in small ones."""
    if os.path.lexists(path):
        return path
    endings = path.suffix.upper(), path.suffix.lower()
    return next((other for ending in endings if os.path.lexists(other := path.with_suffix(ending))), path)


def number_of(text: str) -> int | None:
    """Return the last number in `text`, which may be negative; None if there is none."""
    found = _NUMBER.findall(text)
    return int(found[-1][:_MOST_DIGITS]) if found else None


def missing_numbers(pairs: Iterable[tuple[int, int]], step: int = 1) -> str | None:
    """Return a sentence about the numbers that are missing between `pairs` of successive ones; None if there are
    none."""
    ranges = []
    for before, number in pairs:
        first, last = before + step, number - step
        if first <= last:
            ranges.append(f"{first}" if last == first else f"{first} to {last}")
    if not ranges:
        return None
    named = ", ".join(ranges[:_MOST_NAMED]) + (", …" if len(ranges) > _MOST_NAMED else "")
    words = f"frame {named} is" if len(ranges) == 1 and " " not in named else f"frames {named} are"
    return f"{words} missing: the next frame is a reset"


def mark_gaps(frames: list[tuple[int, FrameEntry]]) -> str | None:
    """Make resets of the rendered `frames`, given with their numbers in order of time, that follow a gap: both their
    number and their time are more than the usual step after the frame before. Return a sentence about the gaps, None if
    there are none."""
    rendered = [one for one in frames if one[1].kind == "rendered"]
    pairs = list(zip(rendered, rendered[1:], strict=False))
    steps = [after[0] - before[0] for before, after in pairs]
    if len(steps) < 2 or min(steps) <= 0:
        return None
    usual = max(set(steps), key=lambda step: (steps.count(step), -step))
    interval = np.median([b[1].time - a[1].time for a, b in pairs if b[0] - a[0] == usual])
    gaps = []
    for before, (number, entry) in pairs:
        late = entry.time - before[1].time > _LATE * interval
        if number - before[0] > usual and late and not entry.reset:
            entry.reset = True
            gaps.append((before[0], number))
    return missing_numbers(gaps, usual)


# ---- layers of EXR files -------------------------------------------------------------------------------


def layers_of(header: ExrHeader) -> dict[str, dict[str, Place]]:
    """Return a map of layer (all but the last word, "" for plain channels) → component → place, in the order of the
    file."""
    found: dict[str, dict[str, Place]] = defaultdict(dict)
    for index, part in enumerate(header.parts):
        for channel in part.channels:
            whole = len(header.parts) == 1 or not part.name or channel.startswith(f"{part.name}.")
            layer, _, component = (channel if whole else f"{part.name}.{channel}").rpartition(".")
            found[layer].setdefault(component, (index, channel))
    return dict(found)


def holding(layers: dict[str, dict[str, Place]], name: str, components: Ordered[str]) -> list[str]:
    """Return the layers whose last word is `name` and that have all `components`."""
    return [
        layer
        for layer, places in layers.items()
        if layer.rpartition(".")[2].lower() == name.lower() and all(c in places for c in components)
    ]


def owner(layer: str) -> str:
    """Return the view layer of a pass: `ViewLayer` of `ViewLayer.Combined`."""
    return layer.rpartition(".")[0]
