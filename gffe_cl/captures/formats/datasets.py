"""Readers of public data sets: MPI Sintel, Spring, TartanAir.

Their colors are display values (sRGB, 8 bits). Sintel and TartanAir have flow to the next frame, which is inverted with
a depth test; Spring has flow to the previous one.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gffe_cl.captures.formats.capture import MOST_FRAMES, described
from gffe_cl.captures.formats.hdf5 import read_hdf5
from gffe_cl.captures.formats.images import Size, check_planes, read_planes
from gffe_cl.captures.formats.motion_conversion import inverted_flow, static_motion
from gffe_cl.captures.formats.numbering import lines_of, missing_numbers, numbered_files, visible_files
from gffe_cl.captures.formats.png import read_png_colors, read_png_header
from gffe_cl.captures.sequence.description import FrameEntry, read_text
from gffe_cl.captures.sequence.pixel_source import ForeignPixels
from gffe_cl.captures.sequence.reader import Sequence
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.files import following_links, open_regular, require_readable
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.conventions import rigid

_TAG = struct.pack("<f", 202021.25)  # of Sintel's files
_MOST_TEXT = 64 << 20
_SPRING_BASELINE = 0.065  # meters
_NED = np.array([[0, 1, 0, 0], [0, 0, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])  # x forward, y right, z down → ours
_TARTANAIR_FOCAL = 320.0
_SKY = 1e4  # meters: farther pixels are sky


class _Frame(NamedTuple):
    """One frame. `flow` leads to the next number, or with `backward` from it to the previous one; None if it or that
    frame is missing."""

    number: int
    color: Path
    depth: Callable[[], np.ndarray]
    flow: Callable[[], np.ndarray] | None
    camera: Camera
    files: tuple[Path, ...]  # all that are read of it but the colors
    backward: bool = False


class DatasetPixels(ForeignPixels):
    """Pixels of `frames`, by the names of their entries; colors in the display's encoding."""

    def __init__(self, frames: dict[str, _Frame]):
        super().__init__()
        self._frames = frames
        self._before = dict(zip(list(frames)[1:], frames.values(), strict=False))

    def rendered(self, entry, size):
        frame, before = self._frames[entry.file], self._before.get(entry.file)
        depth, motion = frame.depth(), None
        if not entry.reset and frame.backward:
            assert frame.flow is not None  # only resets lack it
            motion = frame.flow().astype(np.float32)
        elif not entry.reset:
            assert before is not None and before.flow is not None  # else it were a reset
            motion = inverted_flow(before.flow(), before.depth(), before.camera, depth, frame.camera)
        return self.color(entry, size), depth, motion

    def color(self, entry, size):
        path = self._frames[entry.file].color
        shown = read_planes(path, "RGB", path.name, size) / np.float32(255)
        return np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4).astype(np.float32)


def _opened(folder: Path, frames: list[_Frame], size: Size, fps: float, notes: tuple[str, ...] = ()) -> Sequence:
    """Return the sequence of `frames`. Raises GffeError for files that are missing."""
    if not 0 < len(frames) <= MOST_FRAMES:
        raise GffeError(f"{folder}: {len(frames)} frames (expected 1 to {MOST_FRAMES})")
    entries = {}
    for k, frame in enumerate(frames):
        for path in frame.files:
            require_readable(path, path.name)
        check_planes(frame.color, "RGB", frame.color.name, size)
        before = frames[k - 1] if k else None
        cut = before is None or (frame.flow if frame.backward else before.flow) is None
        entry = FrameEntry(f"frame_{frame.number:06d}.exr", (frame.number - frames[0].number) / fps, reset=cut)
        entry.render_camera = entry.display_camera = frame.camera
        entries[entry.file] = entry
    pixels = DatasetPixels(dict(zip(entries, frames, strict=True)))
    pixels.notes += notes
    told = read_png_colors(frames[0].color)
    if told.profile or told.contradicts("srgb", 2.2):
        pixels.notes.append(f"{frames[0].color.name}: the header says {told.words}; colors are read as sRGB")
    pixels.attributes = {"chromaticities": told.chromaticities} if told.chromaticities else {}
    if missing := missing_numbers((a.number, b.number) for a, b in zip(frames, frames[1:], strict=False)):
        pixels.notes.append(f"{folder}: {missing}")
    return Sequence(folder, described(str(folder), size, entries.values(), fps), pixels)


def _images(folder: Path, pattern: str) -> dict[int, Path]:
    """Return PNG files by their numbers, in order. Raises GffeError if there are none."""
    found = numbered_files(folder, pattern)
    if not found:
        raise GffeError(f"{folder}: no {pattern} (expected a frame at least)")
    return found


def _digits(path: Path, before: str, after: str) -> str:
    """Return the number in the name of an image as it is written there, for messages about files that are missing."""
    return path.name[len(before) : len(path.name) - len(after)]


def _size(path: Path) -> Size:
    header = read_png_header(path, path.name)
    return header.width, header.height


def _within(depth: np.ndarray, sky: float = _SKY) -> np.ndarray:
    return np.where(depth >= sky, np.inf, depth).astype(np.float32)


# MPI Sintel


def is_sintel(folder: Path) -> bool:
    return _sintel_folders(folder) is not None


def open_sintel(folder: Path) -> Sequence:
    """Open and return the scene whose colors are in `folder`, .../final/SCENE or .../clean/SCENE. Raises GffeError."""
    parts = _sintel_folders(folder)
    assert parts is not None  # `is_sintel` was asked
    images = _images(folder, "frame_*.png")
    flows, depths, cameras = (
        numbered_files(place, f"frame_*{end}") for place, end in zip(parts, (".flo", ".dpt", ".cam"), strict=True)
    )
    size, frames = _size(next(iter(images.values()))), []
    for number, path in images.items():
        name = f"frame_{_digits(path, 'frame_', '.png')}"
        depth = depths.get(number, parts[1] / f"{name}.dpt")
        _sintel_header(depth, 1, size)
        flow = flows.get(number) if number + 1 in images else None
        if flow is not None:
            _sintel_header(flow, 2, size)
        camera = _sintel_camera(cameras.get(number, parts[2] / f"{name}.cam"))
        read_flow = None if flow is None else (lambda flow=flow: _sintel_array(flow, 2, size))
        read_depth = lambda depth=depth: _within(_sintel_array(depth, 1, size)[..., 0])  # noqa: E731
        files = (depth,) if flow is None else (depth, flow)
        frames.append(_Frame(number, path, read_depth, read_flow, camera, files))
    return _opened(folder, frames, size, 24.0)


def _sintel_folders(folder: Path) -> tuple[Path, Path, Path] | None:
    """Return the folders of flow, depth and cameras of the scene, None if it is no folder of Sintel."""
    folder = folder.absolute()
    root = folder.parent.parent
    flow, depth, cameras = (root / name / folder.name for name in ("flow", "depth", "camdata_left"))
    return (flow, depth, cameras) if flow.is_dir() and depth.is_dir() and cameras.is_dir() else None


def _sintel_header(path: Path, channels: int, size: Size) -> None:
    """Raise GffeError unless the file at `path` holds an image of `size`, whole."""
    try:
        with open_regular(path) as file:
            start, length = file.read(12), path.stat().st_size
    except OSError as error:
        raise GffeError(f"{path.name}: cannot be read ({error.strerror or error})") from None
    if len(start) < 12 or not start.startswith(_TAG):
        raise GffeError(f"{path.name}: not a file of MPI Sintel")
    given = struct.unpack("<ii", start[4:])
    if given != tuple(size):
        raise GffeError(f"{path.name}: {given[0]}×{given[1]} pixels, expected {size[0]}×{size[1]}")
    expected = 12 + 4 * channels * size[0] * size[1]
    if length < expected:
        raise GffeError(f"{path.name}: truncated, {length} of {expected} bytes")


def _sintel_array(path: Path, channels: int, size: Size) -> np.ndarray:
    _sintel_header(path, channels, size)
    array = np.fromfile(path, "<f4", channels * size[0] * size[1], offset=12)
    return array.reshape(size[1], size[0], channels)


def _sintel_camera(path: Path) -> Camera:
    """Return the camera of a file of tag, 3×3 intrinsics and 3×4 world → camera (x right, y down, z forward),
    float64."""
    try:
        with open_regular(path) as file:
            data = file.read(4 + 8 * 21)
    except OSError as error:
        raise GffeError(f"{path.name}: cannot be read ({error.strerror or error})") from None
    if len(data) < 172 or not data.startswith(_TAG):
        raise GffeError(f"{path.name}: not a camera of MPI Sintel")
    numbers = np.frombuffer(data, "<f8", 21, 4)
    return _camera(np.vstack([numbers[9:].reshape(3, 4), (0, 0, 0, 1)]), *numbers[[0, 4, 2, 5]], label=path.name)


def _camera(matrix, fx, fy, cx, cy, label) -> Camera:
    if not np.isfinite(matrix).all():
        raise GffeError(f"{label}: the camera's matrix must be finite")
    try:
        return Camera(rigid(matrix, "world to camera"), float(fx), float(fy), float(cx), float(cy))
    except GffeError as error:
        raise GffeError(f"{label}: {error}") from None


# TartanAir


def is_tartanair(folder: Path) -> bool:
    return (folder / "pose_left.txt").exists() and (folder / "image_left").is_dir()


def open_tartanair(folder: Path) -> Sequence:
    """Open and return the trajectory in `folder`, left camera. Raises GffeError."""
    images = _images(folder / "image_left", "*_left.png")
    depths = numbered_files(folder / "depth_left", "*_left_depth.npy")
    flows = _flows(folder / "flow")
    numbers, file = list(images), folder / "pose_left.txt"
    poses = lines_of(_table(file, 7, len(images)), numbers, 0, file.name)
    size, frames = _size(images[numbers[0]]), []
    for number, after, pose in zip(numbers, [*numbers[1:], None], poses, strict=True):
        path = images[number]
        missing = folder / "depth_left" / f"{_digits(path, '', '_left.png')}_left_depth.npy"
        depth, flow = depths.get(number, missing), flows.get(f"{number} {after}")
        check_planes(depth, "0", depth.name, size)
        if flow is not None:
            check_planes(flow, "01", flow.name, size)
        camera = _camera(_from_ned(pose), _TARTANAIR_FOCAL, _TARTANAIR_FOCAL, size[0] / 2, size[1] / 2, "pose_left.txt")
        read_flow = None if flow is None else (lambda flow=flow: read_planes(flow, "01", flow.name, size))
        read_depth = lambda depth=depth: _within(read_planes(depth, "0", depth.name, size)[..., 0])  # noqa: E731
        files = (depth,) if flow is None else (depth, flow)
        frames.append(_Frame(number, path, read_depth, read_flow, camera, files))
    note = "TartanAir's flow is the camera's: moving objects have wrong motion; 30 frames per second are assumed"
    return _opened(folder, frames, size, 30.0, notes=(note,))


def _flows(folder: Path) -> dict[str, Path]:
    """Return the files of flow by the two numbers, "3 4", from which one and to which other it leads."""
    pattern = re.compile(r"(-?\d{1,18})_(-?\d{1,18})_flow\.npy", re.IGNORECASE)
    matches = ((pattern.fullmatch(path.name), path) for path in visible_files(folder, ".npy"))
    return {f"{int(match[1])} {int(match[2])}": path for match, path in matches if match}


def _from_ned(pose: np.ndarray) -> np.ndarray:
    """Return the matrix (4, 4) world → right, down, forward, of tx ty tz qx qy qz qw: camera → world, x forward, y
    right, z down."""
    x, y, z, w = pose[3:] / max(np.linalg.norm(pose[3:]), 1e-12)
    made = np.eye(4)
    made[:3, :3] = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    made[:3, 3] = pose[:3]
    return _NED @ np.linalg.inv(made)


def _table(path: Path, columns: int, rows: int) -> np.ndarray:
    """Return a text file of finite numbers as (lines, columns) float64. Raises GffeError for fewer lines than `rows`,
    those of the frames."""
    try:
        table = np.array(
            [line.split() for line in read_text(path, _MOST_TEXT).splitlines() if line.strip()], np.float64
        )
    except ValueError:
        table = np.zeros((0, 0))
    if table.ndim != 2 or table.shape[1] != columns or len(table) < rows or not np.isfinite(table).all():
        raise GffeError(f"{path.name}: expected {columns} finite numbers for each of {rows} frames")
    return table


# Spring


def is_spring(folder: Path) -> bool:
    return (folder / "frame_left").is_dir() and (folder / "cam_data" / "extrinsics.txt").exists()


def open_spring(folder: Path) -> Sequence:
    """Open and return the scene in `folder`, left camera, at the size of the colors. Raises GffeError, also without
    h5py."""
    images = _images(folder / "frame_left", "frame_left_*.png")
    disparities = numbered_files(folder / "disp1_left", "disp1_left_*.dsp5")
    flows = numbered_files(folder / "flow_BW_left", "flow_BW_left_*.flo5")
    numbers, size, frames, links = list(images), _size(next(iter(images.values()))), [], following_links()
    tables = [
        lines_of(_table(folder / "cam_data" / name, columns, len(images)), numbers, 1, name)
        for name, columns in (("intrinsics.txt", 4), ("extrinsics.txt", 16))
    ]
    for number, (fx, fy, cx, cy), matrix in zip(numbers, *tables, strict=True):
        path = images[number]
        missing = folder / "disp1_left" / f"disp1_left_{_digits(path, 'frame_left_', '.png')}.dsp5"
        disparity = disparities.get(number, missing)
        flow = flows.get(number) if number - 1 in images else None
        camera = _camera(matrix.reshape(4, 4), fx, fy, cx, cy, "extrinsics.txt")
        read_flow = None if flow is None else (lambda flow=flow: read_hdf5(flow, "flow", size, 2, links))
        read_depth = lambda file=disparity, fx=fx: _from_disparity(file, fx, size, links)  # noqa: E731
        files = (disparity,) if flow is None else (disparity, flow)
        frames.append(_Frame(number, path, read_depth, read_flow, camera, files, backward=True))
    read_hdf5(frames[0].files[0], "disparity", size, 1, links)
    return _settled(folder, frames, size)


def _settled(folder: Path, frames: list[_Frame], size: Size) -> Sequence:
    """Return the sequence with extrinsics as world → camera or inverted, by the motion of static surfaces."""
    for before, frame in zip(frames, frames[1:], strict=False):
        if frame.flow is None:
            continue
        depth, flow, off = frame.depth(), frame.flow(), []
        for turn in (lambda camera: camera, _inverse):
            still, _ = static_motion(depth, turn(frame.camera), turn(before.camera))
            off.append(np.nanmedian(np.linalg.norm(flow - still, axis=-1)))
        if off[1] < off[0]:
            frames = [one._replace(camera=_inverse(one.camera)) for one in frames]
        break
    return _opened(folder, frames, size, 24.0)


def _inverse(camera: Camera) -> Camera:
    return Camera(camera.view_to_world, *camera.intrinsics)


def _from_disparity(path: Path, fx: float, size: Size, follow_links: bool) -> np.ndarray:
    """Return depth in meters from disparity d: fx · 0.065 / d."""
    disparity = np.abs(read_hdf5(path, "disparity", size, 1, follow_links)[..., 0]).astype(np.float64)
    with np.errstate(divide="ignore"):
        return _within(fx * _SPRING_BASELINE / disparity)
