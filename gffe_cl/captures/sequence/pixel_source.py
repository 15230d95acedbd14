"""Sources of a sequence's pixels: EXR files of our own form, or a foreign capture's."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import chain
from pathlib import Path
from typing import Protocol

import numpy as np

from gffe_cl.captures.sequence import exr
from gffe_cl.captures.sequence.description import FrameEntry
from gffe_cl.captures.sequence.exr_layout import ExrHeader, read_header
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.rendered_frame import Overlays, color_of_planes

COLOR = ("R", "G", "B")
MOTION = ("motion.x", "motion.y")
GEOMETRY = ("Z", *MOTION)
RENDERED = (*COLOR, *GEOMETRY)
RGBA = ("R", "G", "B", "A")
# Optional channels of a rendered frame, by the fields of `Overlays`: all channels of one, or none.
OVERLAY_CHANNELS = {
    "fixed_mask": ("mask.fixed",),
    "effects": tuple(f"effects.{name}" for name in RGBA),
    "effects_motion": ("effects.motion.x", "effects.motion.y"),
    "ui": tuple(f"ui.{name}" for name in RGBA),
}


class Pixels(Protocol):
    """Pixels of frames, by their entries. `size` is (width, height) of the image. All methods raise GffeError that
    names the file if it is missing or damaged. `notes`: warnings."""

    notes: list[str]

    def read(
        self, entry: FrameEntry, size: tuple[int, int]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, Overlays | None]:
        """Return color (H, W, 3) float16 or float32, depth (H, W) float32 and motion (H, W, 2) float32 or None of a
        rendered frame, in the project's conventions; and its overlays, if it has any."""
        ...

    def color(self, entry: FrameEntry, size: tuple[int, int]) -> np.ndarray:
        """Return linear RGB (H, W, 3), float16 or float32, of any frame."""
        ...

    def channels(self, entry: FrameEntry, names: Iterable[str], size: tuple[int, int]) -> dict[str, np.ndarray]:
        """Return channels of our own form by name, (H, W) each."""
        ...

    def exr_file(self, entry: FrameEntry) -> Path | None:
        """Return the frame's EXR file in the project's own format, None if there is none. Other sequences can link
        it."""


class OwnPixels:
    """Pixels of our own form: one EXR file per frame, in `folder`."""

    def __init__(self, folder: Path):
        self._folder = folder
        self.notes = []

    def read(self, entry, size):
        path = self._folder / entry.place
        header = read_header(path, entry.file)
        names = RENDERED if has_motion(header) or not entry.reset else RENDERED[:4]
        over = {field: those for field, those in OVERLAY_CHANNELS.items() if header.find(those[0])}
        channels = exr.read_channels(path, (*names, *chain(*over.values())), entry.file, size)
        depth = channels["Z"].astype(np.float32, copy=False)
        motion = None
        if len(names) == len(RENDERED):
            motion = np.stack([channels[name] for name in MOTION], -1).astype(np.float32, copy=False)
        layers = {field: np.stack([channels[name] for name in those], -1) for field, those in over.items()}
        if "fixed_mask" in layers:
            layers["fixed_mask"] = layers["fixed_mask"][..., 0] > 0
        return stack_color(channels), depth, motion, Overlays(**layers) if layers else None

    def color(self, entry, size):
        channels = self.channels(entry, COLOR, size)
        if entry.kind != "rendered":  # the camera of a rendered frame says where its data window is
            header = read_header(self._folder / entry.place, entry.file)
            part = header.parts[exr.require_channels(header, COLOR, entry.file)[0][0]]
            if part.shown_size == tuple(size):
                channels = {name: exr.placed(channel, part, 0.0) for name, channel in channels.items()}
        return stack_color(channels)

    def channels(self, entry, names, size):
        return exr.read_channels(self._folder / entry.place, tuple(names), entry.file, size)

    def exr_file(self, entry):
        return self._folder / entry.place


class ForeignPixels:
    """Pixels of other formats, from their functions `rendered` and `color`."""

    def __init__(self):
        self.notes: list[str] = []

    def read(self, entry, size):
        return *self.rendered(entry, size), None

    def rendered(self, entry, size) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Return color, depth and motion as `read` does."""
        raise NotImplementedError

    def color(self, entry, size) -> np.ndarray:
        """Return linear RGB (H, W, 3), float16 or float32, as `Pixels.color` does."""
        raise NotImplementedError

    def channels(self, entry, names, size):
        names = tuple(names)
        if set(names) <= set(COLOR):
            found = dict(zip(COLOR, np.moveaxis(self.color(entry, size), -1, 0), strict=True))
        else:
            color, depth, motion = self.rendered(entry, size)
            found = {**dict(zip(COLOR, np.moveaxis(color, -1, 0), strict=True)), "Z": depth}
            if motion is not None:
                found |= dict(zip(MOTION, np.moveaxis(motion, -1, 0), strict=True))
        for name in names:
            if name not in found:
                raise GffeError(f"{entry.file}: no channel '{name}' (the capture gives {', '.join(found)})")
        return {name: found[name] for name in names}

    def exr_file(self, entry):
        return None


def has_motion(header: ExrHeader) -> bool:
    return all(header.find(name) for name in MOTION)


def require_whole_overlays(header: ExrHeader, file: str, shown: bool) -> None:
    """Raise GffeError if only some channels of an overlay are there, or a user interface that cannot be in display
    pixels, unless the image is `shown` unchanged."""
    for field, names in OVERLAY_CHANNELS.items():
        missing = [name for name in names if not header.find(name)]
        if missing and len(missing) < len(names):
            raise GffeError(f"{file}: no channel '{missing[0]}' (expected all of {', '.join(names)}, or none)")
        if field == "ui" and not missing and not shown:
            raise GffeError(f"{file}: channels ui.* are in display pixels (expected render_size as the display's size)")
        if field == "effects_motion" and not missing and not header.find(OVERLAY_CHANNELS["effects"][0]):
            raise GffeError(
                f"{file}: effects.motion without effects (expected {', '.join(OVERLAY_CHANNELS['effects'])})"
            )


def stack_color(channels: dict[str, np.ndarray]) -> np.ndarray:
    """Return color (H, W, 3), float16 or float32, from the channels R, G, B."""
    if all(channels[name].dtype == np.float16 for name in COLOR):
        return color_of_planes(channels[name] for name in COLOR)
    color = np.stack([channels[name] for name in COLOR], -1)
    return color if color.dtype in (np.float16, np.float32) else color.astype(np.float32)
