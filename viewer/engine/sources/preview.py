"""The first rendered frame of a sequence, shown while the device is opened and kernels are built."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gffe_cl.captures.formats import open_capture
from gffe_cl.captures.scenes import is_scene
from gffe_cl.captures.sequence import Sequence
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.rendered_frame import HALF_MAX
from ..background import Background

_IMAGES = (".exr", ".png", ".npy", ".npz", ".flo", ".flo5")


@dataclass(frozen=True)
class Preview:
    """Preview of `target` without a device: `color` (H, W, 4) float16 is the picture of slot 0."""

    target: str
    color: np.ndarray
    exposure: float


def place_of(target: str) -> Path:
    """Return the folder or JSON file to open: for an image its folder."""
    path = Path(target).expanduser()
    return path.parent if path.suffix.lower() in _IMAGES and path.is_file() else path


class Previewer:
    """Opens `target` and reads its first rendered frame, on a thread of its own."""

    def __init__(self, target: str):
        self.target = target
        background = Background("preview")
        self._opened: Future = background.run(open_capture, place_of(target))
        self._read: Future | None = background.run(self._first)

    def sequence(self) -> Sequence:
        """Wait until the sequence is opened, and return it. Raises GffeError if it cannot be opened."""
        try:
            return self._opened.result()
        except GffeError:
            raise
        except Exception as error:
            raise GffeError(f"{self.target}: {type(error).__name__}: {error}") from None

    def take(self) -> Preview | None:
        """Return the preview once it is ready, one time only. There is none if slot 0 needs a device."""
        if self._read is None or not self._read.done():
            return None
        read, self._read = self._read, None
        return None if read.exception() else read.result()  # opening and reading it again report errors

    def _first(self) -> Preview | None:
        sequence = self.sequence()
        if not sequence.rendered:
            return None
        entry = sequence.rendered[0]
        whole = entry.render_camera == entry.display_camera
        if not whole or sequence.size_of(entry) != (sequence.width, sequence.height):
            return None
        color = sequence.read_color(entry)
        rgba = np.zeros((*color.shape[:2], 4), np.float16)
        rgba[..., :3] = np.clip(np.nan_to_num(color), -HALF_MAX, HALF_MAX)
        return Preview(self.target, rgba, sequence.exposure)


def preview_of(target: str) -> Previewer | None:
    """Return the previewer of `target`; None for built-in scenes, which a device renders."""
    return None if is_scene(target) else Previewer(target)
