"""Reader of folders of EXR, PNG or NPY images, recognized by their first bytes, that a short `sequence.json` of
`"format": "gffe-folder"` describes.

{"files": {"color": "color/%04d.exr", …}, "frame_format": {fields of FrameFormat}, "cameras": {…}}: docs/formats.md.
"""

from __future__ import annotations

import io
import math
import re
import struct
from collections.abc import Iterator
from collections.abc import Sequence as Ordered
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from gffe_cl.captures.formats import folder_version_1
from gffe_cl.captures.formats.capture import (
    MOST_FRAMES,
    Keys,
    Place,
    Size,
    described,
    layers_of,
    mark_gaps,
    read_json,
    with_ending,
)
from gffe_cl.captures.formats.flow import inverted_flow
from gffe_cl.captures.sequence.description import FILE_NAME, Description, FrameEntry, check_file_name
from gffe_cl.captures.sequence.engine_form import color_of, described_frame
from gffe_cl.captures.sequence.exr import (
    ExrHeader,
    Pixels,
    decoded,
    place_of,
    placed,
    read_header,
    require_shown,
)
from gffe_cl.captures.sequence.reader import Sequence
from gffe_cl.engine.core.errors import GffeError, require_packages, within
from gffe_cl.engine.core.files import open_regular, require_moderate
from gffe_cl.engine.core.validation import (
    MOST_SIDE,
    require_bool,
    require_exposure,
    require_kind,
    require_number,
    require_positive,
    require_vector,
    require_whole,
    shown,
)
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.conventions import (
    LAYOUTS,
    decides_depth_range,
    matrices,
    planes_of,
    refuse_oblique,
    rigid,
    square,
)
from gffe_cl.engine.frame.frame_format import SCALED_DEPTHS, FrameFormat
from gffe_cl.engine.frame.rendered_frame import RenderedFrame

_MOST_HEADER = 1 << 16
_EXR_MAGIC, _NPY_MAGIC, _PNG_MAGIC = b"\x76\x2f\x31\x01", b"\x93NUMPY", b"\x89PNG\r\n\x1a\n"
_PNG_HEADER, _PNG_CHANNELS = 26, {0: "Y", 2: "RGB", 3: "RGBA", 4: "YA", 6: "RGBA"}
_RGBA = {"R": 0, "G": 1, "B": 2, "A": 3}


def read_planes(path: Path, names: Ordered[str], label: str, size: Size, outside: float = 0.0) -> np.ndarray:
    """Return the channels `names` of the image at `path` as (H, W, C), in the type stored.

    Channels of PNG are R, G, B, A (gray is any of the first three), of NPY 0, 1, …, or R, G, B, A for the first four.
    In EXR files pixels lie in the display window where the data window says; `outside` of it they are that value.
    Raises a GffeError that begins with `label` for a missing file or channel, another size than `size`, and damage.
    """
    return _read(path, names, label, size, outside, decode=True)


def check_planes(path: Path, names: Ordered[str], label: str, size: Size) -> None:
    """Check an image as `read_planes` does, by headers only: no pixel is decoded."""
    _read(path, names, label, size, 0.0, decode=False)


def _read(path, names, label, size, outside, decode) -> Any:
    try:
        with open_regular(path) as file:
            start = file.read(8)
        if start.startswith(_EXR_MAGIC):
            return _exr(path, names, label, size, outside, decode)
        if start == _PNG_MAGIC:
            return _png(path, names, label, size, decode)
        if start.startswith(_NPY_MAGIC):
            return _npy(path, names, label, size, decode)
    except FileNotFoundError:
        raise GffeError(f"{label}: no such file in {path.parent}") from None
    except OSError as error:
        raise GffeError(f"{label}: cannot be read ({error.strerror or error})") from None
    raise GffeError(f"{label}: not an EXR, PNG or NPY file")


def _exr(path, names, label, size, outside, decode):
    header = read_header(path, label)
    places = _places(header, names, label)
    require_shown(header, {part for part, _ in places}, size, label)
    if not decode:
        return None
    found = decoded(path, header, places, label)
    parts = [header.parts[part] for part, _ in places]
    return np.stack([placed(array, part, outside) for array, part in zip(found, parts, strict=True)], -1)


def _places(header: ExrHeader, names, label) -> list[Place]:
    """Return the places of channels, given by their whole name, or by `part.name`; in files with a single channel that
    one."""
    layers, places = layers_of(header), []
    for name in names:
        layer, _, component = name.rpartition(".")
        place = (layers.get(layer, {}).get(component) if layer else None) or place_of(header, name, label)
        if place is None and len(header.channels) == 1:
            place = (0, header.channels[0])
        if place is None:
            raise _no_channel(name, header.channels, label)
        places.append(place)
    return places


def _png(path, names, label, size, decode):
    with open_regular(path) as file:
        data = file.read(_PNG_HEADER)
        width, height, bits, held = _png_header(data, label)
        _require_size((width, height), size, label)
        order = []
        for name in names:
            gray = held[0] == "Y" and name in ("R", "G", "B")
            if not gray and name not in held:
                raise _no_channel(name, held, label)
            order.append(0 if gray else held.index(name))
        require_moderate(width * height * len(held) * 2, math.prod(size), label)
        if not decode:
            return None
        data += file.read()
    by_opencv = bits == 16 and held != "Y"  # Pillow keeps 8 of 16 bits in color
    if by_opencv:
        require_packages(f"{label}: a PNG of 16 bits", "opencv", "cv2")
    try:
        return (_by_opencv if by_opencv else _by_pillow)(data, held, bits)[..., order]
    except Exception as error:  # whatever the decoder meets in a damaged file
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise GffeError(f"{label}: damaged, the pixels cannot be decoded ({reason})") from None


def _png_header(data: bytes, label: str) -> tuple[int, int, int, str]:
    """Return width, height, bits and channels from the first bytes of a PNG (https://www.w3.org/TR/png-3/)."""
    if len(data) == _PNG_HEADER and data[12:16] == b"IHDR":
        width, height, bits, kind = struct.unpack(">IIBB", data[16:])
        if kind in _PNG_CHANNELS and bits in (1, 2, 4, 8, 16) and width and height:
            return width, height, bits, _PNG_CHANNELS[kind]
    raise GffeError(f"{label}: damaged PNG header")


def _by_pillow(data: bytes, held: str, bits: int) -> np.ndarray:
    with Image.open(io.BytesIO(data), formats=["PNG"]) as image:
        if bits == 16:
            return np.asarray(image).astype(np.uint16)[..., None]
        return np.atleast_3d(np.asarray(image.convert(held.replace("Y", "L"))))


def _by_opencv(data: bytes, held: str, bits: int) -> np.ndarray:
    import cv2

    found = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if found is None or found.dtype != np.uint16:
        raise ValueError("not decoded")
    return found[..., {"YA": [0, -1], "RGB": [2, 1, 0], "RGBA": [2, 1, 0, 3]}[held]]


def _npy(path, names, label, size, decode):
    """Return channels of the array in an NPY file, which is mapped: no more is read than they need."""
    with open_regular(path) as file:
        start = file.read(12)
    length = int.from_bytes(start[8 : 10 if start[6:7] == b"\1" else 12], "little")
    if length > _MOST_HEADER:  # NumPy would make room for it
        raise GffeError(f"{label}: damaged NPY file (a header of {length} bytes)")
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except OSError:
        raise
    except Exception as error:  # NumPy parses its header as Python
        raise GffeError(f"{label}: damaged NPY file ({' '.join(str(error).split())[:200]})") from None
    if array.ndim not in (2, 3) or array.dtype.kind not in "fiub" or array.dtype.itemsize > 8:
        kind = f"an array of {array.dtype} and shape {array.shape}"
        raise GffeError(f"{label}: {kind} (expected numbers, (H, W) or (H, W, C))")
    _require_size((array.shape[1], array.shape[0]), size, label)
    channels = array.shape[2] if array.ndim == 3 else 1
    order = [_index(name, channels, label) for name in names]
    require_moderate(array.nbytes, math.prod(size), label)
    if not decode:
        return None
    found = np.asarray(array).reshape(size[1], size[0], channels)[..., order]
    return found.astype(found.dtype.newbyteorder("="), copy=False)


def _index(name: str, channels: int, label) -> int:
    index = int(name) if name.isdigit() and name.isascii() and len(name) < 6 else _RGBA.get(name, channels)
    if channels == 1 and name in _RGBA:
        index = 0
    if index >= channels:
        raise _no_channel(name, list(map(str, range(min(channels, 12)))), label)
    return index


def _no_channel(name: str, held: Ordered[str], label: str) -> GffeError:
    listed = ", ".join(held[:12]) + (", …" if len(held) > 12 else "")
    return GffeError(f"{label}: no channel '{name}' (the file holds {listed})")


def _require_size(given: Size, size: Size, label: str) -> None:
    if tuple(given) != tuple(size):
        raise GffeError(f"{label}: {given[0]}×{given[1]} pixels, expected {size[0]}×{size[1]}")


# Constructors of a camera from view and projection, and the view's axes if there is no projection.
CONVENTIONS = {
    "gffe": (Camera.from_vulkan, (1, 1, 1)),
    "opengl": (Camera.from_opengl, (1, -1, -1)),
    "direct3d": (Camera.from_direct3d, (1, -1, 1)),
    "vulkan": (Camera.from_vulkan, (1, 1, 1)),
    "unity": (Camera.from_unity, (1, -1, -1)),
    "unreal": (Camera.from_unreal, (1, -1, 1)),
}
UNITS = {
    "pixels": lambda size: (1.0, 1.0),
    "uv": lambda size: size,
    "ndc": lambda size: (size[0] / 2, size[1] / 2),
}


@dataclass(frozen=True)
class CameraRules:
    """Conventions of all frames' matrices."""

    convention: str
    layout: str
    view_to_world: bool
    scale: float
    jitter_unit: str
    jitter_up: bool
    jitter_in_projection: bool
    opengl_buffer: bool | None  # None: as the convention has it


@dataclass(frozen=True)
class FoundCamera:
    """Camera of a frame; its projection matrix for column vectors, if it was given, and the factor from its unit to our
    world units; its jitter (x, y) in pixels, y down; `label` for errors."""

    camera: Camera
    projection: np.ndarray | None
    scale: float
    jitter: tuple[float, float]
    label: str

    def planes(self, rules: CameraRules) -> tuple[float, float]:
        """Return planar depth, world units, where a depth buffer of the projection holds 0 and 1. Raises GffeError for
        an oblique near plane."""
        self.refuse_oblique()
        assert self.projection is not None
        opengl = rules.convention == "opengl" if rules.opengl_buffer is None else rules.opengl_buffer
        first, second = planes_of(self.projection, opengl)
        first, second = (float(f"{end * self.scale:.10g}") for end in (first, second))
        return first, second

    def refuse_oblique(self) -> None:
        assert self.projection is not None
        with within(self.label):
            refuse_oblique(self.projection)

    def range_note(self, rules: CameraRules) -> str | None:
        """Return a sentence where neither the description nor the projection determines the range of a depth buffer of
        OpenGL, else None."""
        if rules.convention != "opengl" or rules.opengl_buffer is not None or self.projection is None:
            return None
        if decides_depth_range(self.projection):
            return None
        return (
            "depth: the matrix does not tell whether 0 … 1 in the buffer is −1 … 1 in device coordinates: it is taken"
            ' for that, as without glClipControl (expected "opengl_buffer": true or false in cameras)'
        )


def parse_rules(keys: Keys) -> CameraRules:
    jitter = Keys(keys.take("jitter", {}), f"{keys.label}, jitter")
    made = CameraRules(
        keys.choice("convention", tuple(CONVENTIONS), "gffe"),
        keys.choice("layout", LAYOUTS, "auto"),
        keys.choice("matrix", ("world_to_view", "view_to_world"), "world_to_view") == "view_to_world",
        keys.number("scale", 1.0) or 0.0,
        jitter.choice("unit", tuple(UNITS), "pixels"),
        jitter.choice("y", ("down", "up"), "down") == "up",
        jitter.flag("in_projection", True),
        None if (opengl := keys.take("opengl_buffer")) is None else require_bool(opengl, "cameras, opengl_buffer"),
    )
    jitter.done()
    if not made.scale > 0:
        raise GffeError(f"{keys.label}, scale must be greater than 0, got {made.scale:g}")
    return made


def parse_camera(document: Any, rules: CameraRules, size: Size, label: str) -> FoundCamera:
    """Return the camera in the object `document` on an image of `size`. Raises a GffeError that begins with `label`."""
    keys = Keys(document, f"{label}, camera")
    view, projection = keys.take("view"), keys.take("projection")
    jitter = require_vector(keys.take("jitter", (0.0, 0.0)), f"{keys.label}, jitter", 2).tolist()
    focal = {name: keys.number(name) for name in ("fx", "fy", "cx", "cy", "fov_x", "fov_y")}
    keys.done()
    with within(label):
        view = square(view, "view")
        if projection is None:
            made, p = _from_focal(view, focal, rules, size), None
        else:
            projection = square(projection, "projection")
            view, p = matrices(_inverted(view) if rules.view_to_world else view, projection, rules.layout)
            made = CONVENTIONS[rules.convention][0](view, p, size, "row-major")
    factor = UNITS[rules.jitter_unit](size)
    moved = (jitter[0] * factor[0], jitter[1] * factor[1] * (-1 if rules.jitter_up else 1))
    if not rules.jitter_in_projection:
        made = replace(made, cx=made.cx + moved[0], cy=made.cy + moved[1])
    if rules.scale != 1:
        matrix = made.world_to_view.copy()
        matrix[:3, 3] *= rules.scale
        made = replace(made, world_to_view=matrix)
    return FoundCamera(made, p, rules.scale, moved, label)


def _inverted(view: np.ndarray) -> np.ndarray:
    try:
        return np.linalg.inv(view)
    except np.linalg.LinAlgError:
        raise GffeError("camera: view is singular (expected a rotation and a translation)") from None


def _from_focal(view: np.ndarray, focal: dict[str, float | None], rules: CameraRules, size: Size) -> Camera:
    layout = rules.layout
    if layout == "auto":
        layout = "row-major" if np.abs(view[3] - (0, 0, 0, 1)).max() < 1e-6 else "column-major"
    view = view if layout == "row-major" else view.T
    if np.abs(view[3] - (0, 0, 0, 1)).max() > 1e-6:
        raise GffeError(f"camera: view does not fit layout '{layout}' (expected a last row 0 0 0 1 for column vectors)")
    if rules.view_to_world:
        view = _inverted(view)
    fx, fy = focal["fx"], focal["fy"]
    for axis, angle in enumerate((focal["fov_x"], focal["fov_y"])):
        if angle is not None:
            if not 0 < angle < 180:
                raise GffeError(f"camera: fields of view are between 0 and 180 degrees, got {angle:g}")
            length = size[axis] / 2 / np.tan(np.radians(angle) / 2)
            fx, fy = (length, fy) if axis == 0 else (fx, length)
    fx, fy = fx or fy, fy or fx
    if fx is None or fy is None:
        raise GffeError("camera: no projection (expected a matrix, fx and fy, or fov_x or fov_y in degrees)")
    cx = size[0] / 2 if focal["cx"] is None else focal["cx"]
    cy = size[1] / 2 if focal["cy"] is None else focal["cy"]
    axes = np.diag([*CONVENTIONS[rules.convention][1], 1.0])
    return Camera(axes @ rigid(view, "view"), fx, fy, cx, cy)


FORMAT, VERSION = "gffe-folder", 2
_NUMBERS = -(10**9), 10**9  # of frames
_MOST_OFFSET = 16  # frames
_FIRST_BYTES = 1 << 16
_NUMBER = re.compile(r"%(0\d{1,2})?d")
_CHANNELS = {"color": "RGB", "depth": "R", "motion": "RG", "ground_truth": "RGB"}


@dataclass(frozen=True)
class Buffer:
    """Files of a buffer, and which of their numbers are values. `frame_offset`: how many rendered frames after a frame
    its file is."""

    pattern: str  # path of the files, with %d or %04d for the frame's number
    channels: tuple[str, ...]
    is_color: bool
    frame_offset: int = 0
    raw: bool = False  # integers are themselves, and not 0 … 1
    valid: str | None = None  # a channel that is 0 where nothing was written
    unknown: float | None = None  # what stands in place of values that were never written
    unknown_from: float | None = None  # values of that magnitude or more are none
    sky: float | None = None
    sky_from: float | None = None
    to_next: bool = False  # vectors lead to the next frame
    without_jitter: bool = False  # vectors, of cameras that jitter

    def file(self, number: int) -> str:
        return _NUMBER.sub(lambda found: found[0] % number, self.pattern)

    def path(self, folder: Path, number: int) -> Path:
        """Return the path of the file, whose ending may be in capital letters."""
        return with_ending(folder / self.file(number))

    def check(self, folder: Path, number: int, size: Size) -> None:
        """Check the file by its headers. Raises GffeError if it cannot be read."""
        check_planes(self.path(folder, number), self._planes, self.file(number), size)

    @property
    def _planes(self) -> tuple[str, ...]:
        return self.channels if self.valid is None else (*self.channels, self.valid)

    def read(self, folder: Path, number: int, size: Size) -> np.ndarray:
        """Return (H, W, components) as stored: floats, of color also uint8 and uint16. Other integers are from 0 to 1.
        NaN where nothing was written."""
        outside = 0.0 if self.is_color else math.nan
        values = read_planes(self.path(folder, number), self._planes, self.file(number), size, outside)
        kind = values.dtype
        unwritten: np.ndarray | None = None
        if self.valid is not None:
            unwritten, values = np.asarray(values[..., -1] == 0), values[..., :-1]
        if kind.kind != "f" and not (self.is_color and kind in (np.uint8, np.uint16) and not self.raw):
            most = 1.0 if self.raw or kind.kind == "b" else float(np.iinfo(kind).max)
            values = values / most
        if self.unknown is not None:
            found = np.asarray((np.abs(values.astype(np.float64) - self.unknown) <= 1e-6 * abs(self.unknown)).all(-1))
            unwritten = found if unwritten is None else unwritten | found
        if self.unknown_from is not None:
            found = np.asarray((np.abs(values) >= self.unknown_from).any(-1))
            unwritten = found if unwritten is None else unwritten | found
        return values if unwritten is None else np.where(unwritten[..., None], values.dtype.type(np.nan), values)


def parse_buffer(given: Any, name: str) -> Buffer:
    """Return the buffer that a name with %d, or an object of keys, describes. Raises GffeError."""
    keys, is_color = Keys({"file": given} if isinstance(given, str) else given, name), name in ("color", "ground_truth")
    pattern = keys.take("file")
    if not isinstance(pattern, str) or len(_NUMBER.findall(pattern)) != 1 or "%" in _NUMBER.sub("", pattern):
        raise GffeError(f"{name}, file must be a name with %d or %04d for the frame's number, got {shown(pattern)}")
    pattern = check_file_name(pattern, name)
    default = _CHANNELS[name]
    channels = keys.take("channels", list(default))
    texts = isinstance(channels, list) and all(isinstance(one, str) for one in channels)
    if not texts or len(channels) != len(default):
        raise GffeError(f"{name}, channels must be {len(default)} names, got {shown(channels)}")
    offset = require_whole(keys.take("frame_offset", 0), f"{name}, frame_offset", -_MOST_OFFSET, _MOST_OFFSET)
    more: dict[str, Any] = {"raw": keys.choice("values", ("normalized", "raw"), "normalized") == "raw"}
    if not is_color:
        valid = keys.take("valid")
        more["valid"] = valid and require_kind(valid, str, f"{name}, valid", "a channel's name")
        more |= {key: keys.number(key) for key in ("unknown", "unknown_from")}
    if name == "depth":
        more |= {key: keys.number(key) for key in ("sky", "sky_from")}
    if name == "motion":
        more |= {key: keys.flag(key) for key in ("to_next", "without_jitter")}
    keys.done()
    return Buffer(pattern, tuple(channels), is_color, offset, **more)


@dataclass(eq=False)
class _Frame:
    """One frame, with the number in the names of its files, by buffer."""

    number: int
    entry: FrameEntry
    camera: FoundCamera
    before: _Frame | None = None  # the rendered one before it, unless it is a reset
    numbers: dict[str, int] | None = None


@dataclass
class _Capture:
    """Contents of the JSON. `depth_planes`: whether those of depth follow from the cameras' projections."""

    size: Size
    files: dict[str, Buffer]
    format: FrameFormat
    depth_planes: bool
    rules: CameraRules
    frames: dict[str, _Frame]  # by the entry's name

    def format_of(self, frame: _Frame) -> FrameFormat:
        """Return the format of a frame, with the planes of its own projection."""
        if not self.depth_planes:
            return self.format
        near, far = frame.camera.planes(self.rules)
        return replace(self.format, near_z=near, far_z=far, depth_range=(0.0, 1.0))


def is_folder(path: Path) -> bool:
    """Return whether the `sequence.json` at `path` names this format, near its beginning. Raises OSError if it cannot
    be read."""
    with open_regular(path) as file:
        start = file.read(_FIRST_BYTES)
    found = re.search(rb'"format"\s*:\s*"([^"]*)"', start)
    return bool(found) and found[1] == FORMAT.encode()


def open_folder(folder: Path) -> Sequence:
    """Open the capture in `folder` and return it: the JSON and the headers of all images are checked. Raises
    GffeError."""
    document, notes = read_json(folder / FILE_NAME), []
    if document.get("version", 1) == 1:
        document = folder_version_1.translated(document)
        notes.append(f"{folder}: version 1 of the description (docs/formats.md has the present one)")
    made, description, gaps = _parse(folder, document)
    pixels = FolderPixels(folder, made)
    for frame in made.frames.values():
        is_truth = frame.entry.kind == "ground_truth"
        for name in ("ground_truth",) if is_truth else ("color", "depth", *(("motion",) if frame.before else ())):
            made.files[name].check(folder, pixels.number(frame, name), pixels.size_of(name))
    formats = {made.format_of(frame) for frame in made.frames.values() if frame.entry.kind == "rendered"}
    pixels.converts = made.files["motion"].to_next or len(formats) > 1
    if not pixels.converts and formats != {FrameFormat()}:
        description.format = next(iter(formats), None)
    pixels.notes += notes + ([f"{folder}: {gaps}"] if gaps else [])
    ranges = (one.camera.range_note(made.rules) for one in made.frames.values() if made.depth_planes)
    pixels.notes += [note for note in ranges if note][:1]
    return Sequence(folder, description, pixels)


class FolderPixels(Pixels):
    """Pixels of the capture in `folder`, as they are stored or, if it `converts`, in our conventions."""

    def __init__(self, folder: Path, made: _Capture):
        super().__init__()
        self._folder, self._made, self.converts = folder, made, False

    def size_of(self, name: str) -> Size:
        """Return the size of a buffer's images."""
        return self._made.format.geometry_size or self._made.size if name in ("depth", "motion") else self._made.size

    def number(self, frame: _Frame, name: str) -> int:
        """Return the number of the file that holds a buffer of a frame: vectors to the next frame are in the one
        before."""
        if name == "motion" and frame.before and self._made.files[name].to_next:
            frame = frame.before
        return (frame.numbers or {}).get(name, frame.number)

    def rendered(self, entry, size):
        frame = self._made.frames[entry.file]
        with np.errstate(all="ignore"):  # bad pixels are survived
            if self.converts:
                return self._converted(frame)
            motion = self._read(frame, "motion") if frame.before else None
            return self._read(frame, "color"), self._depth(frame), motion

    def color(self, entry, size):
        frame, is_truth = self._made.frames[entry.file], entry.kind == "ground_truth"
        stored = self._read(frame, "ground_truth" if is_truth else "color")
        return color_of(stored, self._made.format) if is_truth or self.converts else stored

    def _read(self, frame: _Frame, name: str) -> np.ndarray:
        return self._made.files[name].read(self._folder, self.number(frame, name), self.size_of(name))

    def _depth(self, frame: _Frame) -> np.ndarray:
        """Return stored depth (H, W), with sky as the format has it."""
        buffer, format = self._made.files["depth"], self._made.format_of(frame)
        depth = self._read(frame, "depth")[..., 0]
        found = np.zeros(depth.shape, bool)
        if buffer.sky is not None:
            found |= depth == buffer.sky
        if buffer.sky_from is not None:
            found |= depth >= buffer.sky_from
        (_, far_value) = max(zip((format.near_z, format.far_z), format.depth_range, strict=True))
        (_, near_value) = min(zip((format.near_z, format.far_z), format.depth_range, strict=True))
        sky = math.copysign(math.inf, far_value - near_value) if format.depth in SCALED_DEPTHS else far_value
        return np.where(found, sky, depth) if found.any() else depth

    def _converted(self, frame: _Frame) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        made = self._in_our_form(frame, None)
        if frame.before is None:
            return made.color, made.depth, None
        vectors = self._read(frame, "motion")
        if not self._made.files["motion"].to_next:
            made = self._in_our_form(frame, vectors)
            return made.color, made.depth, made.motion
        before = self._in_our_form(frame.before, vectors)
        assert before.motion is not None  # as its vectors are given
        return (
            made.color,
            made.depth,
            inverted_flow(before.motion, before.depth, before.camera, made.depth, made.camera),
        )

    def _in_our_form(self, frame: _Frame, motion: np.ndarray | None) -> RenderedFrame:
        entry, before = frame.entry, frame.before
        stored = RenderedFrame(
            self._read(frame, "color"),
            self._depth(frame),
            motion,
            frame.camera.camera,
            entry.time,
            reset=entry.reset,
            geometry_jitter=entry.geometry_jitter,
        )
        jitter = before.entry.geometry_jitter if before else (0.0, 0.0)
        return described_frame(stored, self._made.format_of(frame), before and before.entry.render_camera, jitter)


def _parse(folder: Path, document: dict) -> tuple[_Capture, Description, str | None]:
    """Return the capture, its description, and a sentence about numbers that are missing."""
    keys = Keys(document, FILE_NAME)
    keys.take("format")
    if keys.take("version") != VERSION:
        raise GffeError(f"{FILE_NAME}: unknown version (expected {VERSION})")
    width, height = (require_whole(keys.take(n), f"{FILE_NAME}: {n}", 1, MOST_SIDE) for n in ("width", "height"))
    size, fps = (width, height), keys.take("fps")
    fps = None if fps is None else require_positive(fps, f"{FILE_NAME}: fps")
    exposure = require_exposure(keys.take("exposure", 1.0), f"{FILE_NAME}: exposure")
    cameras = Keys(keys.take("cameras", {}), "cameras")
    rules, camera_files, listed = parse_rules(cameras), cameras.take("file"), cameras.take("list")
    cameras.done()
    named = Keys(keys.take("files"), "files")
    given = {name: named.take(name) for name in _CHANNELS}
    named.done()
    given["ground_truth"] = given["ground_truth"] or given["color"]
    files = {name: parse_buffer(value, name) for name, value in given.items()}
    format, depth_planes = _format(keys.take("frame_format", {}), files["motion"])
    made = _Capture(size, files, format, depth_planes, rules, {})
    frames = list(_frames(keys.take("frames"), fps))
    keys.done()
    if listed is not None and (not isinstance(listed, list) or len(listed) != len(frames)):
        raise GffeError(f"cameras, list must have a camera for each of the {len(frames)} frames")
    patterns = None if camera_files is None else parse_buffer({"file": camera_files, "channels": ["R"]}, "depth")
    gaps = mark_gaps([(number, entry) for number, entry, _ in frames])
    for index, (number, entry, camera) in enumerate(frames):
        label = f"{FILE_NAME}, frame {number}"
        if camera is None and listed is not None:
            camera = listed[index]
        if camera is None and patterns is not None:
            label, camera = patterns.file(number), read_json(patterns.path(folder, number))
        found = parse_camera(camera, rules, size, label)
        _require_camera(made, found, label)
        entry.display_camera = found.camera
        made.frames[entry.file] = _Frame(number, entry, found)
    _link(made)
    entries = [frame.entry for frame in made.frames.values()]
    return made, described(FILE_NAME, size, entries, fps, exposure), gaps


def _format(given: Any, motion: Buffer) -> tuple[FrameFormat, bool]:
    """Return the format of stored arrays, and whether the planes of depth follow from the cameras."""
    given = require_kind(given, dict, "frame_format", "an object")
    depth_planes = given.get("depth") == "device" and not {"near_z", "far_z"} & given.keys()
    format = FrameFormat.from_json(given | ({"near_z": 1.0, "far_z": 2.0} if depth_planes else {}))
    if motion.without_jitter:
        format = replace(format, motion_jittered=True)
    return format, depth_planes


def _link(made: _Capture) -> None:
    """Set the frame before each rendered one, its files, and jitter. Frames at the ends, some of whose buffers were not
    recorded, are left out."""
    rendered = [frame for frame in made.frames.values() if frame.entry.kind == "rendered"]
    offsets = {name: buffer.frame_offset for name, buffer in made.files.items() if buffer.frame_offset}
    previous, jitters = None, made.files["motion"].without_jitter
    for k, frame in enumerate(rendered):
        entry, at = frame.entry, {name: k + offset for name, offset in offsets.items()}
        if any(not 0 <= index < len(rendered) for index in at.values()):
            del made.frames[entry.file]
            continue
        frame.numbers = {name: rendered[index].number for name, index in at.items()}
        entry.render_camera = entry.display_camera
        entry.reset = entry.reset or previous is None
        if jitters:
            entry.geometry_jitter = (-frame.camera.jitter[0], -frame.camera.jitter[1])
        frame.before = None if entry.reset else previous
        previous = frame


def _require_camera(made: _Capture, found: FoundCamera, label: str) -> None:
    """Raise GffeError if the camera lacks data that the buffers need."""
    if made.depth_planes:
        if found.projection is None:
            raise GffeError(f"{label}: device depth needs a projection matrix, or near_z and far_z in frame_format")
        found.planes(made.rules)
    elif made.format.depth == "device" and found.projection is not None:
        found.refuse_oblique()


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
