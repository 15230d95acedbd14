"""Shared parts of readers of foreign captures: JSON, frames in order, windows."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from gffe_cl.captures.sequence.description import Description, FrameEntry, check_times, read_text
from gffe_cl.captures.sequence.exr_layout import ExrPart
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import require_number, require_positive, shown
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.conventions import rigid, square

MOST_JSON = 64 << 20
MOST_FRAMES = 1 << 17


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
    try:
        view = square(document[matrix], matrix)
        if np.abs(view[3] - (0, 0, 0, 1)).max() > 1e-6:
            raise GffeError(f"the last row of {matrix} must be 0 0 0 1 (column vectors)")
        fx = require_positive(document["fx"], "fx")
        fy = require_positive(document.get("fy", fx), "fy")
        cx = require_number(document.get("cx", size[0] / 2), "cx")
        cy = require_number(document.get("cy", size[1] / 2), "cy")
        return Camera(rigid(view, matrix), fx, fy, cx, cy)
    except GffeError as error:
        raise GffeError(f"{label}: {str(error).removeprefix('camera: ')}") from None


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


def shown_part(image: np.ndarray, part: ExrPart, label: str) -> np.ndarray:
    """Return the part of an image (H, W, …), stored in the data window of `part`, in its display window. Raises
    GffeError if some of that was not stored."""
    (width, height), (left, top) = part.shown_size, (-n for n in part.offset)
    if left < 0 or top < 0 or left + width > part.size[0] or top + height > part.size[1]:
        raise GffeError(f"{label}: the data window is smaller than the display window (expected all that is shown)")
    return image[top : top + height, left : left + width]


def _fps(frames: list[FrameEntry]) -> float:
    steps = np.diff([entry.time for entry in frames])
    return round(float(1 / np.median(steps)), 6) if len(steps) else 30.0
