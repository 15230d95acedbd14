"""The first rendered frame of a sequence, shown while the device is opened and kernels are built."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gffe_cl.captures.formats import open_capture
from gffe_cl.captures.scenes import is_scene
from gffe_cl.captures.sequence import Sequence
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.rendered_frame import HALF_MAX

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
        self._made: Preview | None = None
        self._sequence: Sequence | None = None
        self._problem: GffeError | None = None
        self._opened = threading.Event()
        threading.Thread(target=self._run, name="gffe-viewer-preview", daemon=True).start()

    def sequence(self) -> Sequence:
        """Wait until the sequence is opened, and return it. Raises GffeError if it cannot be opened."""
        self._opened.wait()
        if self._problem is not None:
            raise self._problem
        assert self._sequence is not None  # it was opened without a problem
        return self._sequence

    def take(self) -> Preview | None:
        """Return the preview once it is ready, one time only. There is none if slot 0 needs a device."""
        made, self._made = self._made, None
        return made

    def _run(self) -> None:
        try:
            self._sequence = open_capture(place_of(self.target))
        except GffeError as error:
            self._problem = error
        except Exception as error:  # opening it reports the error
            self._problem = GffeError(f"{self.target}: {type(error).__name__}: {error}")
        finally:
            self._opened.set()
        if self._sequence is not None and self._sequence.rendered:
            self._read(self._sequence)

    def _read(self, sequence: Sequence) -> None:
        entry = sequence.rendered[0]
        whole = entry.render_camera == entry.display_camera
        if not whole or sequence.size_of(entry) != (sequence.width, sequence.height):
            return
        try:
            color = sequence.read_color(entry)
        except GffeError:
            return  # the next read reports the error
        rgba = np.zeros((*color.shape[:2], 4), np.float16)
        rgba[..., :3] = np.clip(np.nan_to_num(color), -HALF_MAX, HALF_MAX)
        self._made = Preview(self.target, rgba, sequence.exposure)


def preview_of(target: str) -> Previewer | None:
    """Return the previewer of `target`; None for built-in scenes, which a device renders."""
    return None if is_scene(target) else Previewer(target)
