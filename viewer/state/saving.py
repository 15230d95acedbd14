"""Saving what is seen into the working folder: the picture at once; layers and videos beside the running interface."""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from gffe_cl.errors import GffeError
from gffe_cl.viewer.picture.canvas import read
from gffe_cl.viewer.picture.files import export_video, save_layers_exr, save_png, unused_name

_WAITING = 2  # frames between the interface and the encoder
_PATIENCE = 5.0  # seconds for writing to end after it was cancelled


def save_picture(model, canvas) -> None:
    """The view as it is compared and displayed, one display pixel to a pixel, as PNG."""
    path = unused_name(Path.cwd(), f"{model.info.name}_{model.slot:05d}_{model.view.a}", ".png")
    try:
        save_png(path, _picture(model, canvas))
    except GffeError as error:
        model.say(str(error), error=True)
    else:
        model.say(f"saved {path}")


def _picture(model, canvas) -> np.ndarray:
    """(H, W, 4) uint8 of the view, unzoomed."""
    width, height = model.info.width, model.info.height
    view = replace(model.comparison.shown(), zoom=1.0, centre=(width / 2, height / 2), grid=False)
    return read(canvas.draw(view, (width, height), "export"))


class Work:
    """Something that is being saved: `done` of `total`; `layers` are read back for it; `advance` is called once per
    frame of the interface until `finished`. The writing is done on a thread."""

    def __init__(self, path: Path, total: int):
        self.path, self.done, self.total, self.finished = path, 0, total, False
        self._outcome: str | None = None
        self._error = False
        self._thread: threading.Thread | None = None

    @property
    def label(self) -> str:
        return f"→ {self.path.name}"

    def layers(self, model) -> set[str]:
        return set()

    def advance(self, model, canvas) -> None:
        if self._outcome is not None:
            model.say(self._outcome, self._error)
            self.finished = True
        else:
            self._proceed(model, canvas)

    def cancel(self) -> None:
        """Stop, if it can be stopped; `finished` says when it has."""

    def close(self) -> None:
        """The viewer ends: nothing half done is left, unless it takes more than seconds to stop."""
        self.cancel()
        if self._thread is not None:
            self._thread.join(_PATIENCE)

    def _proceed(self, model, canvas) -> None:
        raise NotImplementedError

    def _start(self, write: Callable[[], str]) -> None:
        """Run `write`, which returns what to tell, on the thread."""

        def run() -> None:
            try:
                self._outcome = write()
            except Exception as error:
                self._error, self._outcome = True, str(error) or repr(error)

        self._thread = threading.Thread(target=run, name="gffe-viewer-saving", daemon=True)
        self._thread.start()


class LayersWork(Work):
    """All layers of the present slot as EXR files in a new folder."""

    def __init__(self, model):
        super().__init__(unused_name(Path.cwd(), f"{model.info.name}_{model.slot:05d}_layers", ""), 1)
        model.playback.pause()
        self._cancelled = False

    def layers(self, model):
        return {spec.name for spec in model.layers if model.why_not(spec.name) is None}

    def cancel(self):
        self._cancelled = True

    def _proceed(self, model, canvas):
        if self._thread is not None:
            return
        if self._cancelled:
            self.finished = True
        elif model.settled and self.layers(model) <= model.result.request.layers:
            result, self.done = model.result, 1
            self._start(lambda: self._write(result))

    def _write(self, result) -> str:
        saved = save_layers_exr(self.path, result.images, result.specs, lambda: self._cancelled)
        return f"saved {len(saved)} layers in {self.path}" if saved else "saving the layers was cancelled"


class VideoWork(Work):
    """Every slot between the in and the out point as MP4; then back to the slot from which it was started."""

    def __init__(self, model):
        playback = model.playback
        playback.pause()
        self._slots = list(range(playback.first, playback.last + 1))
        self._back = playback.slot
        self._frames: queue.Queue = queue.Queue(_WAITING)
        self._cancelled = threading.Event()
        super().__init__(unused_name(Path.cwd(), f"{model.info.name}_{model.view.a}", ".mp4"), len(self._slots))
        rate = playback.fps * (playback.n + 1)
        self._start(lambda: self._write(rate))

    def _write(self, rate: float) -> str:
        written = export_video(self.path, self._given(), rate, self.total, cancelled=self._cancelled.is_set)
        return f"saved {self.path}" if written else "the video was cancelled"

    def _proceed(self, model, canvas):
        if self._frames.full() or self._cancelled.is_set():
            return
        if self.done == self.total:
            self._put(None)
            return
        slot = self._slots[self.done]
        if model.playback.slot != slot:
            model.playback.seek(slot)
        elif model.settled and model.slot == slot:
            self._put(np.ascontiguousarray(_picture(model, canvas)[..., :3]))
            self.done += 1
            if self.done == self.total:
                model.playback.seek(self._back)

    def _given(self) -> Iterator[np.ndarray]:
        while (frame := self._frames.get()) is not None:
            yield frame

    def _put(self, frame) -> None:
        with contextlib.suppress(queue.Full):  # then the encoder is not waiting
            self._frames.put_nowait(frame)

    def cancel(self):
        self._cancelled.set()
        self._put(None)
