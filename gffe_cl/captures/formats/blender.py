"""Captures from Blender (Cycles): multilayer EXR files, and `cameras.json` as docs/blender/export_gffe.py writes it."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gffe_cl.captures.formats.capture import (
    MOST_FRAMES,
    Place,
    camera_of,
    described,
    holding,
    layers_of,
    mark_gaps,
    owner,
    read_json,
    through_window,
)
from gffe_cl.captures.sequence.description import Description, FrameEntry, check_file_name
from gffe_cl.captures.sequence.exr import (
    COLOR,
    ExrHeader,
    Pixels,
    decoded,
    placed,
    read_header,
    require_parts,
    require_shown,
    stack_color,
)
from gffe_cl.captures.sequence.reader import Sequence
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import (
    MOST_SIDE,
    require_exposure,
    require_number,
    require_positive,
    require_whole,
    shown,
)

FILE_NAME = "cameras.json"
KINDS = ("rendered", "ground_truth", "camera_only")
SKY = 1e9  # depth from there on is nothing: Blender writes 1e10
_DATA_LAYER = "data"  # of one sample per pixel: exact depth and vectors, but jagged colors
_COMPOSITED = "composite"


class _Passes(NamedTuple):
    """Positions of the channels in a file; None for missing ones."""

    color: list[Place]
    depth: list[Place] | None
    vector: list[Place] | None


def is_blender(folder: Path) -> bool:
    return (folder / FILE_NAME).exists()


def open_blender(folder: Path) -> Sequence:
    """Open the capture in `folder` and return it: JSON and the headers of all files are checked. Raises GffeError."""
    description, gaps = _parse(read_json(folder / FILE_NAME))
    size = (description.width, description.height)
    pixels = BlenderPixels(folder)
    for entry in description.frames:
        header = read_header(folder / entry.file, entry.file)
        passes = _passes(header, entry)
        parts = {part for places in filter(None, passes) for part, _ in places}
        require_parts(header, parts, None, entry.file)
        windows = {header.parts[part].data_window for part in parts}
        if len(windows) > 1:
            raise GffeError(f"{entry.file}: passes have several data windows (expected one)")
        through_window(entry, header.parts[passes.color[0][0]], size, entry.file)
        if entry.kind != "rendered":
            entry.render_size = None
    pixels.notes += [f"{folder}: {gaps}"] if gaps else []
    return Sequence(folder, description, pixels)


class BlenderPixels(Pixels):
    """Pixels of the capture in `folder`."""

    def __init__(self, folder: Path):
        super().__init__()
        self._folder = folder

    def rendered(self, entry, size):
        (*color, depth), vector = self._read(entry, size)
        depth = depth.astype(np.float32)
        depth[depth >= SKY] = np.inf
        motion = np.stack([vector[0], -vector[1]], -1).astype(np.float32) if vector else None
        return stack_color(dict(zip(COLOR, color, strict=True))), depth, motion

    def color(self, entry, size):
        if entry.kind == "rendered":
            return self.rendered(entry, size)[0]
        path = self._folder / entry.file
        header = read_header(path, entry.file)
        places = _passes(header, entry).color
        part = header.parts[places[0][0]]
        require_shown(header, {places[0][0]}, size, entry.file)
        return np.stack([placed(one, part, 0.0) for one in decoded(path, header, places, entry.file)], -1)

    def _read(self, entry: FrameEntry, size):
        """Return R, G, B and depth, and X and Y if there are vectors."""
        path = self._folder / entry.file
        header = read_header(path, entry.file)
        passes = _passes(header, entry)
        places = [*passes.color, *(passes.depth or []), *(passes.vector or [])]
        require_parts(header, {part for part, _ in places}, size, entry.file)
        arrays = decoded(path, header, places, entry.file)
        return arrays[:4], arrays[4:]


def _parse(document: dict) -> tuple[Description, str | None]:
    """Return the description, and a sentence about frames that are missing."""
    size = (
        require_whole(document.get("width"), f"{FILE_NAME}: width", 1, MOST_SIDE),
        require_whole(document.get("height"), f"{FILE_NAME}: height", 1, MOST_SIDE),
    )
    given = document.get("frames")
    if not isinstance(given, list) or not 0 < len(given) <= MOST_FRAMES:
        raise GffeError(f"{FILE_NAME}: frames must be a list of 1 to {MOST_FRAMES} frames")
    frames, cameras, numbered = [], [], []
    for index, one in enumerate(given):
        entry = _frame(one, index, size)
        (cameras if entry.kind == "camera_only" else frames).append(entry)
        if isinstance(one.get("frame"), int):
            numbered.append((one["frame"], entry))
    numbered.sort(key=lambda one: one[1].time)
    gaps = mark_gaps(numbered) if len(numbered) == len(given) else None
    fps = document.get("fps")
    description = described(
        FILE_NAME,
        size,
        frames,
        None if fps is None else require_positive(fps, f"{FILE_NAME}: fps"),
        require_exposure(document.get("exposure", 1.0), f"{FILE_NAME}: exposure"),
        cameras,
    )
    return description, gaps


def _frame(one, index: int, size) -> FrameEntry:
    label = f"{FILE_NAME}, frame {index}"
    if not isinstance(one, dict):
        raise GffeError(f"{label}: must be an object, got {shown(one)}")
    kind = one.get("kind")
    file: Any = one.get("file")
    if kind not in KINDS:
        raise GffeError(f"{label}: kind must be one of {', '.join(KINDS)}, got {shown(kind)}")
    if kind == "camera_only":
        file = ""
    elif file is None and isinstance(one.get("frame"), int):
        file = f"frame_{one['frame']:04d}.exr"
    if kind != "camera_only":
        file = check_file_name(file, label)
        label = f"{label} ({file})"
    time = require_number(one.get("time"), f"{label}: time")
    camera = camera_of(one, "world_to_camera", size, label)
    entry = FrameEntry(str(file), time, kind, reset=one.get("reset") is True, display_camera=camera)
    if kind == "rendered":
        entry.render_camera = camera
    return entry


def _passes(header: ExrHeader, entry: FrameEntry) -> _Passes:
    """Return the passes to use, in whichever view layers they are. Raises GffeError if one is missing that the frame
    needs."""
    layers = layers_of(header)
    depths = {layer: [c] for c in ("V", "Z") for layer in holding(layers, "Depth", c)}
    vectors = {layer: ["X", "Y"] for layer in holding(layers, "Vector", "XY")}
    if not depths and "Z" in layers.get("", {}):
        depths[""] = ["Z"]
    depth, vector = _exact(depths), _exact(vectors)
    colors = holding(layers, "Combined", "RGB") or [name for name in ("",) if set("RGB") <= set(layers.get(name, ()))]
    if not colors and entry.kind != "rendered":
        colors = [name for name, places in layers.items() if set("RGB") <= set(places)][:1]
    if not colors:
        raise _missing(entry, header, "Combined.R, Combined.G, Combined.B")
    data = owner(depth) if depth is not None else None
    color = min(colors, key=lambda layer: _unlike_picture(owner(layer), data if len(colors) > 1 else None))
    if entry.kind == "rendered":
        if depth is None:
            raise _missing(entry, header, "Depth.Z")
        if vector is None and not entry.reset:
            raise _missing(entry, header, "Vector.X, Vector.Y")
    return _Passes(
        [layers[color][c] for c in "RGB"],
        None if depth is None else [layers[depth][c] for c in depths[depth]],
        None if vector is None else [layers[vector][c] for c in vectors[vector]],
    )


def _exact(found: dict[str, list[str]]) -> str | None:
    """Return, of several layers with a pass, the one named Data, whose passes are no means over samples; else the last
    one."""
    named = [layer for layer in found if owner(layer).lower() == _DATA_LAYER]
    return (named or list(found) or [None])[-1]


def _unlike_picture(name: str, data: str | None) -> tuple[bool, bool]:
    """Return the sort key of view layers: data layers and the compositor's output come last."""
    return name.lower() == _COMPOSITED, name == data or name.lower() == _DATA_LAYER


def _missing(entry: FrameEntry, header: ExrHeader, names: str) -> GffeError:
    held = ", ".join(header.channels[:12]) + (", …" if len(header.channels) > 12 else "")
    needed = "Combined, Depth and Vector passes" if entry.kind == "rendered" else "color"
    needed = f"{entry.kind} frames need {needed}"
    return GffeError(f"{entry.file}: no channel {names} in any layer ({needed}; the file holds {held})")
