"""Content of `sequence.json`: frames and cameras, validated when read, and lookup of frames by time. No other file is
touched here.
"""

from __future__ import annotations

import gc
import json
import math
import os
import re
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

import numpy as np

from gffe_cl.engine.core.errors import GffeError, within
from gffe_cl.engine.core.files import open_regular
from gffe_cl.engine.core.validation import (
    MOST_SIDE,
    require_bool,
    require_choice,
    require_exposure,
    require_kind,
    require_number,
    require_positive,
    require_size,
    require_whole,
    shown,
)
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.frame_format import FrameFormat, require_jitter
from gffe_cl.engine.frame.rendered_frame import RenderedFrame

FILE_NAME = "sequence.json"
FORMAT, VERSIONS = "gffe-sequence", (1, 2)  # the second one describes an engine's buffers
KINDS = ("rendered", "ground_truth", "extrapolated")
_OPTIONAL = (
    "reset",
    "render_size",
    "geometry_jitter",
    "geometry_size",
    "source",
    "alpha",
    "render_camera",
    "display_camera",
)
_CAMERA = ("world_to_view", "fx", "fy", "cx", "cy")
_MAX_BYTES = 1 << 30
_PLAIN_NAME = re.compile(r"[\w+=@-][\w+=@. -]*", re.ASCII)


@dataclass
class FrameEntry:
    """One frame of a sequence.

    Parameters
    ----------
    file : str
        EXR file, relative to the sequence's folder.
    time : float
        Time of the frame, seconds.
    kind : "rendered", "ground_truth" or "extrapolated"
    reset : bool
        Whether frames before this rendered one must not be used; always true for the first one.
    render_size : (width, height) or None
        Size of the stored images in pixels; None means the display size.
    render_camera : Camera or None
        Render camera, in render pixels. None for frames that are not rendered.
    display_camera : Camera or None
        Display camera, in display pixels. For rendered frames None means the frustum of the render camera; in an opened
        sequence it is always set for them, and None elsewhere if neither JSON nor EXR header has one.
    source : str or None
        The rendered frame that an extrapolated one was made from.
    alpha : float or None
        (time − source time) / (source time − time of the rendered frame before it).
    geometry_jitter : (float, float)
        Jitter of depth and motion of a rendered frame that its color does not have, pixels of these.
    geometry_size : (width, height) or None
        Size of depth and motion of a rendered frame where they are smaller than color: they are stored from the top
        left corner of their channels on. None: that of the `FrameFormat`, else color's.
    """

    file: str
    time: float
    kind: str = "rendered"
    reset: bool = False
    render_size: tuple[int, int] | None = None
    render_camera: Camera | None = None
    display_camera: Camera | None = None
    source: str | None = None
    alpha: float | None = None
    geometry_jitter: tuple[float, float] = (0.0, 0.0)
    geometry_size: tuple[int, int] | None = None


@dataclass
class Description:
    """Contents of `sequence.json`; sizes in pixels, times in seconds. `unfinished`: the run that wrote it was
    interrupted, the frames are those that were finished then. `format`: of depth and motion of the rendered frames,
    None: they have our conventions. `settings`: digest of everything that the frames were made from."""

    width: int
    height: int
    fps: float
    exposure: float
    frames: list[FrameEntry]
    unfinished: bool = False
    known_cameras: tuple[FrameEntry, ...] = ()  # of other forms: kind "camera_only", no file
    format: FrameFormat | None = None
    settings: str | None = None


@contextmanager
def without_collections() -> Iterator[None]:
    """Disable Python's cyclic garbage collector during the block. With many objects it takes several times as long as
    the work, and finds none."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


@without_collections()
def parse_description(text: str, name: str = FILE_NAME) -> Description:
    """Check everything in the JSON `text` and return its content. Raises a GffeError that names the file `name` and the
    frame."""
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise GffeError(f"{name}: not valid JSON ({' '.join(str(error).split())})") from None
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise GffeError(f'{name}: not a sequence (expected "format": "{FORMAT}")')
    version = document.get("version")
    if version not in VERSIONS or isinstance(version, bool):
        raise GffeError(f"{name}: unknown version {shown(version)} (expected {' or '.join(map(str, VERSIONS))})")
    description = Description(
        require_whole(document.get("width"), f"{name}: width", 1, MOST_SIDE),
        require_whole(document.get("height"), f"{name}: height", 1, MOST_SIDE),
        require_positive(document.get("fps"), f"{name}: fps"),
        require_exposure(document.get("exposure", 1.0), f"{name}: exposure"),
        [],
        require_bool(document.get("unfinished", False), f"{name}: unfinished"),
    )
    if isinstance(document.get("settings"), str):
        description.settings = document["settings"]
    if document.get("frame_format") is not None:
        description.format = _parse_format(document["frame_format"], version, name)
    frames = document.get("frames")
    if not isinstance(frames, list) or not frames:
        raise GffeError(f"{name}: frames must be a list of at least one frame")
    description.frames = [_parse_frame(frame, index, name) for index, frame in enumerate(frames)]
    check_times(description.frames, name)
    for entry in description.frames:
        if entry.kind == "rendered":
            entry.reset = True
            break
    return description


def checked_entry(entry: FrameEntry, label: str = "") -> FrameEntry:
    """Return a copy of `entry` with Python numbers. Raises GffeError for invalid values, which begins with `label`, or
    else with its file."""
    require_kind(entry, FrameEntry, "entry")
    check_file_name(entry.file, "entry")
    label = f"{label or entry.file}: "
    for name in ("render_camera", "display_camera"):
        if (camera := getattr(entry, name)) is not None:
            require_kind(camera, Camera, f"{label}{name}", "a Camera or None")
    if entry.source is not None:
        check_file_name(entry.source, f"{label}source")
    size, geometry, alpha = entry.render_size, entry.geometry_size, entry.alpha
    return replace(
        entry,
        time=require_number(entry.time, f"{label}time"),
        kind=require_choice(entry.kind, KINDS, f"{label}kind"),
        reset=require_bool(entry.reset, f"{label}reset"),
        render_size=None if size is None else require_size(size, f"{label}render_size", whole=True),
        alpha=None if alpha is None else require_positive(alpha, f"{label}alpha"),
        geometry_jitter=require_jitter(entry.geometry_jitter, label[:-2]),
        geometry_size=None if geometry is None else require_size(geometry, f"{label}geometry_size", whole=True),
    )


def frame_label(index: int, file: str, name: str = FILE_NAME) -> str:
    return f"{name}, frame {index} ({file})"


def check_times(frames: list[FrameEntry], name: str = FILE_NAME) -> None:
    """Raise GffeError unless times increase. Extrapolated frames may coincide with others: with α ≥ 1 they reach the
    time of the next rendered frame."""
    last = {"any": -math.inf, "given": -math.inf}
    for index, entry in enumerate(frames):
        given = entry.kind != "extrapolated"
        late = entry.time < last["any"] or (given and entry.time == last["given"])
        if late:
            raise GffeError(
                f"{frame_label(index, entry.file, name)}: times must increase, got {entry.time:g} s"
                f" after {last['any']:g} s"
            )
        last["any"] = entry.time
        if given:
            last["given"] = entry.time


def require_one_size(frames: Iterable[FrameEntry], size: tuple[int, int], label: str) -> None:
    """Raise GffeError, beginning with `label`, unless the rendered ones of `frames` have one size. `size`: of the
    display, which those without a size have."""
    first: dict[tuple[int, int], FrameEntry] = {}
    for entry in frames:
        if entry.kind == "rendered":
            width, height = entry.render_size or size
            first.setdefault((width, height), entry)
    if len(first) > 1:
        sizes = [f"{entry.file} is {width}×{height}" for (width, height), entry in first.items()]
        raise GffeError(f"{label}: rendered frames must have one size ({', '.join(sizes[:2])})")


def check_file_name(file, label: str) -> str:
    """Return `file` as Python's name of it on disk. Raises GffeError unless it is a relative path inside the sequence's
    folder."""
    if isinstance(file, str) and _PLAIN_NAME.fullmatch(file) and file != FILE_NAME:
        return file
    name = _on_disk(file) if isinstance(file, str) and file.strip() and "\0" not in file else None
    if name is None or name in (".", FILE_NAME):
        raise GffeError(f"{label}: file must be the name of an EXR file, got {shown(file)}")
    if _leaves(name):
        raise GffeError(
            f"{label}: file must stay inside the folder, got {shown(file)} (expected a link of the file system)"
        )
    return name


def _leaves(file: str) -> bool:
    paths = (PurePosixPath(file), PureWindowsPath(file))
    return any(path.anchor or ".." in path.parts for path in paths)


def _on_disk(name: str) -> str | None:
    """Return Python's name of the file whose name is that UTF-8 text, in any locale; None where no file can be called
    so: half a surrogate pair has no bytes."""
    try:
        return os.fsdecode(name.encode("utf-8", sys.getfilesystemencodeerrors()))
    except UnicodeError:
        return None


def read_text(path: Path, most: int = _MAX_BYTES) -> str:
    """Return the text of a `sequence.json` in UTF-8, also after a byte order mark. Raises GffeError if it cannot be
    read or has more than `most` bytes."""
    try:
        with open_regular(path) as file:
            size = os.fstat(file.fileno()).st_size
            if size > most:
                raise GffeError(f"{path}: {size} bytes (expected a {path.name} of at most {most})")
            return file.read().decode("utf-8-sig")
    except FileNotFoundError:
        raise GffeError(f"{path.parent}: no {path.name} in this folder") from None
    except OSError as error:
        raise GffeError(f"{path}: cannot be read ({error.strerror or error})") from None
    except UnicodeDecodeError:
        raise GffeError(f"{path}: not valid JSON (not UTF-8 text)") from None


def describe(description: Description, generator: str) -> str:
    """Return the JSON text of a sequence: the inverse of `parse_description`."""
    is_described = description.format is not None or any(
        any(entry.geometry_jitter) or entry.geometry_size for entry in description.frames
    )
    document = {
        "format": FORMAT,
        "version": VERSIONS[is_described],
        "generator": generator,
        "width": description.width,
        "height": description.height,
        "fps": description.fps,
        "exposure": description.exposure,
    }
    if description.unfinished:
        document["unfinished"] = True
    if description.settings is not None:
        document["settings"] = description.settings
    if description.format is not None:
        document["frame_format"] = description.format.to_json()
    size = (description.width, description.height)
    frames = [_frame_document(entry, size) for entry in description.frames]
    return json.dumps({**document, "frames": frames}, indent=1) + "\n"


def _frame_document(entry: FrameEntry, size) -> dict:
    render_size = entry.render_size or size
    document = {"file": entry.file, "time": float(entry.time), "kind": entry.kind}
    if entry.kind == "rendered":
        document["reset"] = bool(entry.reset)
    if tuple(render_size) != tuple(size) or entry.kind == "rendered":
        document["render_size"] = [int(n) for n in render_size]
    if any(entry.geometry_jitter):
        document["geometry_jitter"] = list(entry.geometry_jitter)
    if entry.geometry_size is not None:
        document["geometry_size"] = list(entry.geometry_size)
    if entry.source is not None:
        document["source"] = entry.source
    if entry.alpha is not None:
        document["alpha"] = float(entry.alpha)
    if entry.render_camera is not None:
        document["render_camera"] = _camera_document(entry.render_camera)
    same = tuple(render_size) == tuple(size) and entry.display_camera == entry.render_camera
    if entry.display_camera is not None and not same:
        document["display_camera"] = _camera_document(entry.display_camera)
    return document


def _camera_document(camera: Camera) -> dict:
    fx, fy, cx, cy = camera.intrinsics
    return {"world_to_view": camera.world_to_view.tolist(), "fx": fx, "fy": fy, "cx": cx, "cy": cy}


def _parse_frame(frame, index, name) -> FrameEntry:
    if not isinstance(frame, dict):
        raise GffeError(f"{name}, frame {index}: must be an object, got {shown(frame)}")
    file = check_file_name(frame.get("file"), f"{name}, frame {index}")
    label = frame_label(index, file, name)
    given: dict[str, Any] = {key: frame[key] for key in _OPTIONAL if frame.get(key) is not None}
    for key in given.keys() & {"render_camera", "display_camera"}:
        given[key] = _parse_camera(given[key], f"{label}: {key}")
    if "source" in given:
        given["source"] = check_file_name(given["source"], f"{label}, source")
    given |= {"time": frame.get("time"), "kind": frame.get("kind")}
    return checked_entry(FrameEntry(file, **given), label)


def _parse_format(given, version: int, name: str) -> FrameFormat:
    if version < 2:
        raise GffeError(f"{name}: frame_format needs version 2, got {version}")
    with within(name):
        return FrameFormat.from_json(given)


def _parse_camera(document, label) -> Camera:
    if not isinstance(document, dict) or any(name not in document for name in _CAMERA):
        raise GffeError(f"{label} must have {', '.join(_CAMERA)}")
    with within(label):
        return Camera(**{name: document[name] for name in _CAMERA})


def rendered_entry(number: int, frame: RenderedFrame, size: tuple[int, int]) -> FrameEntry:
    """Return the entry of a rendered frame in a sequence on disk, for a display of `size`."""
    height, width = np.shape(frame.color)[:2]
    render_size = (width, height) if (width, height) != size else None
    cameras = {"render_camera": frame.camera, "display_camera": frame.display_camera}
    own = {"reset": frame.reset, "render_size": render_size}
    geometry = {"geometry_jitter": frame.geometry_jitter, "geometry_size": frame.geometry_size}
    return FrameEntry(f"frame_{number:06d}.exr", frame.time, **own, **geometry, **cameras)
