"""Saving: pictures and layers, in the background; files are written whole or not at all."""

from __future__ import annotations

import contextlib
import os
import re
import tempfile
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, wait
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gffe_cl.captures.offline.run import _dump_channels
from gffe_cl.captures.sequence.exr import write_channels
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.files import replacing
from gffe_cl.engine.inspection.layers import LayerSpec
from ..engine.jobs import Jobs
from ..picture.canvas import read
from ..picture.current_frame import Contents
from ..picture.view import View
from .playback import Playback

_LONGEST_STEM = 120  # characters; file names end at 255 bytes


def unused_name(folder: Path, stem: str, suffix: str) -> Path:
    """Return a path in `folder` that nothing has yet: `stem`, else `stem_2`, `stem_3` …, then `suffix` (".png").
    Characters that file names should not have become "_"."""
    stem = re.sub(r"[^\w.@+=-]+", "_", stem).lstrip(".")[:_LONGEST_STEM] or "image"
    number, path = 1, Path(folder) / f"{stem}{suffix}"
    while os.path.lexists(path):
        number += 1
        path = Path(folder) / f"{stem}_{number}{suffix}"
    return path


def save_png(path: Path, rgba: np.ndarray) -> None:
    """Write (H, W, 3 or 4) uint8 display values. Raises GffeError, leaving nothing new."""
    from PIL import Image

    with _faults(path, "the image"), replacing(path) as part:
        Image.fromarray(np.ascontiguousarray(rgba)).save(part, "PNG")


def save_layers_exr(
    folder: Path,
    images: Mapping[str, np.ndarray],
    specs: Mapping[str, LayerSpec],
    cancelled: Callable[[], bool] = lambda: False,
    on_layer: Callable[[], None] = lambda: None,
) -> list[Path]:
    """Write each layer to the new `folder`/<layer>.exr, its channels named after its components ("Y" for a single one,
    "1.x" … for planes), float16 or float32. Returns the paths, none if `cancelled`, called before each layer, returned
    true. `on_layer` is called after each. Then, and when GffeError is raised, there is no such folder.
    """
    with (
        _faults(folder, "the layers"),
        tempfile.TemporaryDirectory(prefix=".layers.", dir=folder.parent, ignore_cleanup_errors=True) as staging,
    ):
        whole = Path(staging) / "whole"
        whole.mkdir()
        for name, image in images.items():
            if cancelled():
                return []
            write_channels(whole / f"{name}.exr", _channels(specs[name], np.asarray(image)))
            on_layer()
        whole.rename(folder)
    return [folder / f"{name}.exr" for name in images]


def _channels(spec: LayerSpec, image: np.ndarray) -> dict[str, np.ndarray]:
    """Return the channels of an image (planes?, H, W, components?) by name, each a contiguous (H, W)."""
    if len(spec.components) == 1 and image.ndim == 2 + (spec.planes > 1):
        image = image[..., None]
    return {name: np.ascontiguousarray(plane) for name, plane in _dump_channels(spec, image).items()}


@contextlib.contextmanager
def _faults(path: Path, what: str) -> Iterator[None]:
    """Raise GffeError in place of OSError, in one line that names `path`."""
    try:
        yield
    except OSError as error:
        raise GffeError(f"{path}: cannot write {what}: {error.strerror or error}") from None


_PATIENCE = 5.0  # seconds for writing to end after it was cancelled


@dataclass
class Subject:
    """Saved content: the contents, as `view`, with comparison and display settings from `shown`; `settled`: whether
    the displayed frame is the requested one. `folder`: where it is saved; None: in the working folder."""

    contents: Contents
    playback: Playback
    view: View
    shown: Callable[[], View]
    settled: Callable[[], bool]
    folder: Path | None = None

    @property
    def slot(self) -> int:
        result = self.contents.result
        return result.slot if result is not None else self.playback.slot

    def unused(self, stem: str, suffix: str) -> Path:
        """Return a new path in the folder."""
        return unused_name(self.folder or Path.cwd(), f"{self.contents.source.name}_{stem}", suffix)

    def picture(self, canvas) -> np.ndarray:
        """Return (H, W, 4) uint8 of the view, unzoomed."""
        width, height = self.contents.size
        view = replace(self.shown(), zoom=1.0, center=(width / 2, height / 2), grid=False)
        return read(canvas.draw(view, (width, height), "export"))


class SavingWork:
    """A save in progress: `done` of `total`; `layers` are read back for it."""

    def __init__(self, subject: Subject, stem: str, suffix: str):
        self.subject, self.path = subject, subject.unused(f"{subject.slot:05d}_{stem}", suffix)
        self.done, self.total, self.cancelled = 0, 1, False

    @property
    def layers(self) -> set[str]:
        return set()

    def job(self, canvas) -> Callable[[], str] | None:
        """Return what writes the files and returns a message, once everything is there for it. It runs on a thread."""
        raise NotImplementedError


class PictureWork(SavingWork):
    """Saving of the view as it is compared and displayed, one display pixel to a pixel, as PNG."""

    def __init__(self, subject: Subject):
        super().__init__(subject, subject.view.a, ".png")

    def job(self, canvas) -> Callable[[], str]:
        pixels, self.done = self.subject.picture(canvas), 1

        def write() -> str:
            save_png(self.path, pixels)
            return f"saved {self.path}"

        return write


class LayersWork(SavingWork):
    """Saving of all layers of the present slot as EXR files in a new folder."""

    def __init__(self, subject: Subject):
        super().__init__(subject, "layers", "")
        subject.playback.pause()

    @property
    def layers(self) -> set[str]:
        return {spec.name for spec in self.subject.contents.showable()}

    def job(self, canvas) -> Callable[[], str] | None:
        if not (self.subject.settled() and self.layers <= self.subject.contents.asked):
            return None
        result = self.subject.contents.result
        assert result is not None  # it is settled
        self.total = len(result.images)

        def write() -> str:
            saved = save_layers_exr(self.path, result.images, result.specs, lambda: self.cancelled, self._count)
            return f"saved {len(saved)} layers in {self.path}" if saved else "saving the layers was cancelled"

        return write

    def _count(self) -> None:
        self.done += 1


class Saving:
    """Saves `subject`, one `work` at a time, which is None when there is none. `say` is given its outcome; `saved`: the
    file or folder that was written last."""

    def __init__(self, subject: Subject, say: Callable[[str, bool], None]):
        self.subject, self._say = subject, say
        self.work: SavingWork | None = None
        self.saved: Path | None = None
        self._background = Jobs("saving")
        self._writing: Future[str] | None = None

    def choose_folder(self, place: str) -> None:
        """Save into another folder from now on."""
        folder = Path(place).expanduser().absolute()
        if folder.is_dir():
            self.subject.folder = folder
        self._say(f"saves into {folder}" if folder.is_dir() else f"{folder}: no such folder", not folder.is_dir())

    def start(self, work: Callable[[Subject], SavingWork]) -> None:
        """Start saving in the background."""
        self.work, self._writing = work(self.subject), None

    def advance(self, canvas) -> None:
        """Go on with it. Call once per frame of the interface."""
        work = self.work
        if work is None:
            return
        if self._writing is None:
            job = None if work.cancelled else work.job(canvas)
            self._writing = None if job is None else self._background.run(job)
            self.work = None if work.cancelled else work
        elif self._writing.done():
            error = self._writing.exception()
            self.saved = work.path if work.path.exists() else self.saved
            self._say(self._writing.result() if error is None else str(error) or repr(error), error is not None)
            self.work = None

    def cancel(self) -> None:
        """Stop if possible; `work` then becomes None."""
        if self.work is not None:
            self.work.cancelled = True

    def close(self) -> None:
        """Cancel as the viewer ends: nothing half done is left, unless it takes more than five seconds to stop."""
        self.cancel()
        if self._writing is not None:
            wait([self._writing], _PATIENCE)
        self._background.close()


def require_file(path: Path, what: str, endings: tuple[str, ...]) -> None:
    """Raise GffeError if `what`, a film or a picture, cannot be written to `path`."""
    if path.suffix.lower() not in endings:
        raise GffeError(f"{path}: a {what}'s name must end in {' or '.join(endings)}")
    if not path.absolute().parent.is_dir():
        raise GffeError(f"{path}: cannot write: no such folder")
