"""Reader of captures of Unreal's Movie Render Queue: multilayer EXR, the camera in the header, centimeters.

World depth is in centimeters and motion around ½, but documentation, decoders and versions disagree on the factor, and
depth is planar or along the rays. Reprojecting static surfaces decides.
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gffe_cl.captures.formats.capture import (
    MOST_FRAMES,
    Place,
    described,
    layers_of,
    missing_numbers,
    number_of,
    through_window,
    visible_files,
)
from gffe_cl.captures.sequence.description import FrameEntry
from gffe_cl.captures.sequence.engine_form import static_motion
from gffe_cl.captures.sequence.exr import ExrHeader, ExrPart, Pixels, decoded, placed, read_header, require_parts
from gffe_cl.captures.sequence.reader import Sequence
from gffe_cl.engine.core.errors import GffeError, within
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.conventions import depth_from_distance, motion_from_unreal

SKY = 1e7  # centimeters: 100 km
_HALF_MAX = 65504.0  # depth stored as half ends there
_CAMERA, _LAYER_DATA = "unreal/camera/", "unreal/layerData/"  # of Movie Render Queue, and of its newer graph
_FPS = 30.0
_TRIED, _MOVED = 6, 0.5  # frames at most; least motion of the picture, pixels
_GRID = 4  # every so many pixels


class _Meaning(NamedTuple):
    """Meaning of the numbers: motion's factor, and whether depth is along the rays."""

    scale: float
    along_rays: bool


_USUAL = _Meaning(2.0, False)


def is_unreal(folder: Path) -> bool:
    files = visible_files(folder, ".exr")
    if not files:
        return False
    try:
        header = read_header(files[0], files[0].name)
    except GffeError:
        return False
    return any(name.startswith("unreal/") for part in header.parts for name in part.attributes)


def open_unreal(folder: Path) -> Sequence:
    """Open the frames in `folder` and return them as a sequence. The headers of all files are checked, and a few frames
    are read to determine the meaning of motion and depth. Raises GffeError."""
    numbered, entries, pixels = _numbered(folder), [], UnrealPixels(folder)
    size = fps = before = None
    for number, file in numbered:
        header = read_header(folder / file, file)
        places = _places(header, file)
        require_parts(header, {part for part, _ in places}, None, file)
        part = header.parts[places[0][0]]
        if size is None:
            size, fps = part.shown_size, _frame_rate(part)
        time = (number - numbered[0][0]) / (fps or _FPS)
        entry = FrameEntry(file, time, reset=before is None or number != before + 1)
        entry.render_camera = entry.display_camera = _camera(part.attributes, size, file)
        through_window(entry, part, size, file)
        entries.append(entry)
        before = number
    assert size is not None  # of the first frame
    if fps is None:
        pixels.notes.append(f"{folder}: no frame rate in the headers, {_FPS:g} frames per second are assumed")
    if missing := missing_numbers((a, b) for (a, _), (b, _) in zip(numbered, numbered[1:], strict=False)):
        pixels.notes.append(f"{folder}: {missing}")
    description = described(str(folder), size, entries, fps or _FPS)
    pixels.settle(description.frames, size)
    return Sequence(folder, description, pixels)


class UnrealPixels(Pixels):
    """Pixels of the frames in `folder`."""

    def __init__(self, folder: Path):
        super().__init__()
        self._folder, self._meaning = folder, _USUAL

    def rendered(self, entry, size):
        color, depth, motion, _ = self._raw(entry, size)
        assert entry.render_camera is not None  # read from the header
        depth = self._depth(depth, entry.render_camera, self._meaning.along_rays)
        return color, depth, motion_from_unreal(motion, size, self._meaning.scale)

    def color(self, entry, size):
        color, _, _, header = self._raw(entry, size)
        part = header.parts[_places(header, entry.file)[0][0]]
        return np.stack([placed(one, part, 0.0) for one in np.moveaxis(color, -1, 0)], -1)

    def settle(self, entries: list[FrameEntry], size: tuple[int, int]) -> None:
        """Determine the meaning of the numbers from the first frames in which the camera moves."""
        for before, entry in list(zip(entries, entries[1:], strict=False))[:_TRIED]:
            if entry.reset:
                continue
            assert entry.render_camera is not None and before.render_camera is not None  # read from the headers
            _, raw_depth, raw_motion, _ = self._raw(entry, entry.render_size or size)
            residuals, moved = {}, 0.0
            for along_rays in (False, True):
                depth = self._depth(raw_depth, entry.render_camera, along_rays)
                still = static_motion(depth, entry.render_camera, before.render_camera)[0][::_GRID, ::_GRID]
                moved = max(moved, _median_length(still))
                for scale in (2.0, 1.0):
                    given = motion_from_unreal(raw_motion, entry.render_size or size, scale)[::_GRID, ::_GRID]
                    residuals[_Meaning(scale, along_rays)] = _median_length(given - still)
            if moved >= _MOVED:
                self._meaning = min(residuals, key=residuals.__getitem__)
                if self._meaning != _USUAL:
                    self.notes.append(_said(entry.file, self._meaning, residuals))
                return
        self.notes.append("the camera moves too little to determine the scale of the motion vectors: 2 is assumed")

    def _depth(self, depth: np.ndarray, camera: Camera, along_rays: bool) -> np.ndarray:
        nothing = ~(depth < (SKY if depth.dtype != np.float16 else _HALF_MAX))
        depth = np.where(nothing & ~np.isnan(depth), np.inf, depth).astype(np.float32)
        return depth_from_distance(depth, camera) if along_rays else depth

    def _raw(self, entry: FrameEntry, size):
        """Return color (H, W, 3), depth (H, W) and motion (H, W, 2) as stored, and the header."""
        path = self._folder / entry.file
        header = read_header(path, entry.file)
        places = _places(header, entry.file)
        require_parts(header, {part for part, _ in places}, size, entry.file)
        arrays = decoded(path, header, places, entry.file)
        return np.stack(arrays[:3], -1), arrays[3], np.stack(arrays[4:], -1), header


def _median_length(vectors: np.ndarray) -> float:
    lengths = np.linalg.norm(vectors, axis=-1)
    lengths = lengths[np.isfinite(lengths)]
    return float(np.median(lengths)) if lengths.size else np.inf


def _said(file: str, meaning: _Meaning, residuals: dict) -> str:
    words = f"motion vectors have a scale of {meaning.scale:g}" + (
        ", depth is along the rays" if meaning.along_rays else ""
    )
    return f"{file}: {words} (static pixels: {residuals[meaning]:.2g} px off, as usual {residuals[_USUAL]:.2g} px)"


def _numbered(folder: Path) -> list[tuple[int, str]]:
    """Return the frames' numbers and files, in order. Raises GffeError if they are of several shots."""
    found: dict[int, str] = {}
    shots = set()
    for path in visible_files(folder, ".exr"):
        number = number_of(path.stem) if path.stem[-1:].isdigit() else None
        if number is None:
            raise GffeError(f"{path.name}: no frame number in the name (expected Name.0000.exr)")
        shots.add(path.stem.rstrip("0123456789").removesuffix("-" if number < 0 else ""))
        if number in found and len(shots) == 1:
            raise GffeError(f"{path.name}: frame {number} like {found[number]} (expected one file for a frame)")
        found[number] = path.name
    if len(shots) > 1:
        raise GffeError(f"{folder}: several shots, {', '.join(sorted(shots)[:3])} (expected one in a folder)")
    if len(found) > MOST_FRAMES:
        raise GffeError(f"{folder}: {len(found)} frames (expected at most {MOST_FRAMES})")
    return sorted(found.items())


def _places(header: ExrHeader, file: str) -> list[Place]:
    """Return the channels of R, G, B, depth, motion x and y. Raises GffeError that names missing ones."""
    layers = layers_of(header)
    wanted = {
        "the final image": (_picture, "RGB"),
        "WorldDepth": (lambda name: "worlddepth" in name or "scenedepth" in name, "R"),
        "MotionVectors": (lambda name: "motionvector" in name, "RG"),
    }
    places = []
    for what, (fits, components) in wanted.items():
        for layer, held in layers.items():
            if fits(layer.lower()) and all(c in held for c in components):
                places += [held[c] for c in components]
                break
        else:
            held = ", ".join(list(layers)[:12])
            raise GffeError(f"{file}: no layer of {what} (expected it among the render passes; the file holds {held})")
    return places


def _picture(name: str) -> bool:
    return name == "" or (name.startswith("finalimage") and ("beauty" in name or "movierenderqueue" not in name))


def _camera(attributes: dict[str, Any], size: tuple[int, int], file: str) -> Camera:
    location = [_number(attributes, f"curPos/{axis}", file) for axis in "xyz"]
    rotation = [_number(attributes, f"curRot/{angle}", file) for angle in ("pitch", "yaw", "roll")]
    fov = _number(attributes, "fov", file)
    with within(file):
        return Camera.from_unreal_pose(location, rotation, fov, size)


def _number(attributes: dict[str, Any], name: str, file: str) -> float:
    """Return the camera's number `name` from any layer: all layers of a file have the same."""
    for key, given in attributes.items():
        if key.startswith((_CAMERA, _LAYER_DATA)) and key.endswith(f"/{name}"):
            try:
                value = float(given)
            except (TypeError, ValueError):
                value = np.nan
            if not np.isfinite(value):
                raise GffeError(f"{file}: {key} must be a finite number, got '{str(given)[:40]}'")
            return value
    raise GffeError(f"{file}: no {_CAMERA}…{name} in the header (expected the metadata of Movie Render Queue)")


def _frame_rate(part: ExrPart) -> float | None:
    """Return the frame rate of the standard attribute, or of Unreal's; None without either."""
    for name in ("framesPerSecond", "unreal/frameRate", "unreal/framerate"):
        above, _, below = str(part.attributes.get(name, "")).partition("/")
        with contextlib.suppress(ValueError, ZeroDivisionError):
            if 0 < (rate := float(above) / float(below or 1)) < 1e6:
                return rate
    return None
