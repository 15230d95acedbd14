"""Saving: pictures, layers, videos and figures, in the background."""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, wait
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gffe_cl.engine.core.errors import GffeError
from ..engine.background import Background
from ..picture.canvas import read
from ..picture.current_frame import Contents
from ..picture.files import export_video, save_json, save_layers_exr, save_png, unused_name
from ..picture.legend_strip import Entry, with_legends
from ..picture.view import View
from .playback import Playback

_WAITING = 2  # frames between the interface and the encoder
_PATIENCE = 5.0  # seconds for writing to end after it was cancelled


@dataclass
class Subject:
    """Saved content: the contents, as `view`, with comparison and display settings from `shown`; `settled`: whether
    the displayed frame is the requested one. `folder`: where it is saved; None: in the working folder."""

    contents: Contents
    playback: Playback
    view: View
    shown: Callable[[], View]
    legends: Callable[[], list[Entry]]
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


class Work:
    """A save in progress: `done` of `total`; `layers` are read back for it; `advance` is called once per frame of
    the interface until `finished`. Then `outcome` is a message, if any, and `failed` an error. Files are written on
    a thread."""

    def __init__(self, subject: Subject, path: Path, total: int):
        self.subject, self.path, self.done, self.total = subject, path, 0, total
        self.finished = self.failed = False
        self.outcome: str | None = None
        self._background = Background("saving")
        self._writing: Future | None = None

    @property
    def label(self) -> str:
        return f"→ {self.path.name}"

    @property
    def layers(self) -> set[str]:
        return set()

    def advance(self, canvas) -> None:
        if self._writing is not None and self._writing.done():
            error = self._writing.exception()
            self.failed = error is not None
            self.outcome = self._writing.result() if error is None else str(error) or repr(error)
            self.finished = True
            self._background.close()
        else:
            self._proceed(canvas)

    def cancel(self) -> None:
        """Stop if possible; `finished` then becomes true."""

    def close(self) -> None:
        """Cancel as the viewer ends: nothing half done is left, unless it takes more than five seconds to stop."""
        self.cancel()
        if self._writing is not None:
            wait([self._writing], _PATIENCE)

    def _proceed(self, canvas) -> None:
        raise NotImplementedError

    def _count(self) -> None:
        """Count another one that is written."""
        self.done += 1

    def _start(self, write: Callable[[], str]) -> None:
        """Run `write`, which returns a message, on the thread."""
        self._writing = self._background.run(write)


class PictureWork(Work):
    """Saving of the view as it is compared and displayed, one display pixel to a pixel, as PNG, with legends under
    it."""

    def __init__(self, subject: Subject):
        super().__init__(subject, subject.unused(f"{subject.slot:05d}_{subject.view.a}", ".png"), 1)

    def _proceed(self, canvas):
        if self._writing is None:
            pixels, legends, self.done = self.subject.picture(canvas), self.subject.legends(), 1
            self._start(lambda: self._write(with_legends(pixels, legends)))

    def _write(self, pixels: np.ndarray) -> str:
        save_png(self.path, pixels)
        return f"saved {self.path}"


class LayersWork(Work):
    """Saving of all layers of the present slot as EXR files in a new folder."""

    def __init__(self, subject: Subject):
        super().__init__(subject, subject.unused(f"{subject.slot:05d}_layers", ""), 1)
        subject.playback.pause()
        self._cancelled = False

    @property
    def layers(self):
        return {spec.name for spec in self.subject.contents.showable()}

    def cancel(self):
        self._cancelled = True

    def _proceed(self, canvas):
        if self._writing is not None:
            return
        if self._cancelled:
            self.finished = True
        elif self.subject.settled() and self.layers <= self.subject.contents.asked:
            result = self.subject.contents.result
            assert result is not None  # it is settled
            self.total = len(result.images)
            self._start(lambda: self._write(result))

    def _write(self, result) -> str:
        saved = save_layers_exr(self.path, result.images, result.specs, lambda: self._cancelled, self._count)
        return f"saved {len(saved)} layers in {self.path}" if saved else "saving the layers was cancelled"


class FiguresWork(Work):
    """Writing of figures, plain JSON, as a baseline."""

    def __init__(self, subject: Subject, document: dict[str, Any]):
        super().__init__(subject, subject.unused("baseline", ".json"), 1)
        self._start(lambda: self._write(document))

    def _write(self, document: dict[str, Any]) -> str:
        save_json(self.path, document)
        return f"saved the figures of {len(document['frames'])} frames in {self.path}"

    def _proceed(self, canvas):
        """Do nothing: all is done on the thread."""


class VideoWork(Work):
    """Saving of every slot between the in and the out point as MP4; then back to the slot from which it was started."""

    def __init__(self, subject: Subject):
        playback = subject.playback
        playback.pause()
        self._slots = list(range(playback.first, playback.last + 1))
        self._back = playback.slot
        self._frames: queue.Queue = queue.Queue(_WAITING)
        self._cancelled = threading.Event()
        super().__init__(subject, subject.unused(subject.view.a, ".mp4"), len(self._slots))
        rate = playback.fps * (playback.n + 1)
        self._start(lambda: self._write(rate))

    def _write(self, rate: float) -> str:
        written = export_video(self.path, self._given(), rate, self._cancelled.is_set)
        return f"saved {self.path}" if written else "the video was cancelled"

    def _proceed(self, canvas):
        if self._frames.full() or self._cancelled.is_set():
            return
        if self.done == self.total:
            self._put(None)
            return
        slot, playback = self._slots[self.done], self.subject.playback
        if playback.slot != slot:
            playback.seek(slot)
        elif self.subject.settled() and self.subject.slot == slot:
            self._put(np.ascontiguousarray(self.subject.picture(canvas)[..., :3]))
            self.done += 1
            if self.done == self.total:
                playback.seek(self._back)

    def _given(self) -> Iterator[np.ndarray]:
        while (frame := self._frames.get()) is not None:
            yield frame

    def _put(self, frame) -> None:
        with contextlib.suppress(queue.Full):  # then the encoder is not waiting
            self._frames.put_nowait(frame)

    def cancel(self):
        self._cancelled.set()
        self._put(None)


class Saving:
    """Saves `subject`, one `work` at a time, which is None when there is none. `say` is given its outcome; `saved`: the
    file or folder that was written last."""

    def __init__(self, subject: Subject, say: Callable[[str, bool], None]):
        self.subject, self._say = subject, say
        self.work: Work | None = None
        self.saved: Path | None = None

    def choose_folder(self, place: str) -> None:
        """Save into another folder from now on."""
        folder = Path(place).expanduser().absolute()
        if folder.is_dir():
            self.subject.folder = folder
        self._say(f"saves into {folder}" if folder.is_dir() else f"{folder}: no such folder", not folder.is_dir())

    def start(self, work: Callable[[Subject], Work]) -> None:
        """Start saving in the background, or say why there is nothing to save."""
        try:
            self.work = work(self.subject)
        except GffeError as error:
            self._say(str(error), True)

    def advance(self, canvas) -> None:
        """Go on with it. Call once per frame of the interface."""
        if self.work is None:
            return
        self.work.advance(canvas)
        if self.work.finished:
            self.saved = self.work.path if self.work.path.exists() else self.saved
            if self.work.outcome:
                self._say(self.work.outcome, self.work.failed)
            self.work = None

    def cancel(self) -> None:
        if self.work is not None:
            self.work.cancel()

    def close(self) -> None:
        if self.work is not None:
            self.work.close()
