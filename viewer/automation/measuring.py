"""Playback speed of the viewer (`gffe view --measure`): a first pass, then playback from the cache."""

from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np

from gffe_cl.engine.core.errors import GffeError
from ..state.model import Model
from ..window.app import App
from .screenshot import PATIENCE, Look

_SIZE = (1280, 720)  # of the window
_FASTEST = 4.0  # times real time
_COMES_TO_REST, _LEAST_REST = 4.0, 3.0  # seconds until a window is at rest, and for which that is measured
_PLAIN = Look()


def measure(
    model: Model, seconds: float, size: tuple[int, int] | None = None, look: Look = _PLAIN
) -> dict[str, dict[str, float]]:
    """Play every frame as `look`, computed, for the given seconds or until the end. Then play the same frames from the
    cache, in real time, repeatedly for the given seconds.

    Returns "first_picture": "seconds" from the start of this process until a rendered frame was on the screen, and
    "computed_seconds" until the first computed one was (nothing where the system does not tell when a process
    started); "first_pass" and "cached": means of frames shown, of those generated and of the interface's per second;
    milliseconds per frame shown of uploading and of processor time (of this process, all threads); first_pass also
    those of computing (kernels) and reading back, cached also frames per second that were due and how many frames were
    dropped. "cached" is empty where there is no cache. "idle": percent of a processor core of a window in which nothing
    changes, and frames of the interface per second.
    Raises GffeError when nothing can be played.
    """
    stopwatch = _Stopwatch(seconds, look)
    app = App(model, on_frame=stopwatch)
    app.picture_frames.on_picture = stopwatch.count
    app.run(size or _SIZE, test=lambda app: None)
    if stopwatch.problem:
        raise GffeError(stopwatch.problem)
    assert stopwatch.first is not None  # it ran to its end
    cached = stopwatch.cached.figures() if stopwatch.cached else {}
    passes = {"first_pass": stopwatch.first.figures(), "cached": cached}
    return {"first_picture": stopwatch.pictures} | passes | {"idle": stopwatch.idle}


class _Stopwatch:
    """Stopwatch, called once per frame of the interface: starts the passes one after the other, and closes the
    window."""

    def __init__(self, seconds: float, look: Look):
        self.seconds, self.problem = seconds, None
        self._look: Look | None = look  # until it is shown
        self.pictures: dict[str, float] = {}
        self._drawn: set[str] = set()  # of `pictures`: in the frame of the interface before this one
        self.first: _Pass | None = None
        self.cached: _Pass | None = None
        self.idle: dict[str, float] = {}
        # Its start, and from then on processor time and frames of the interface.
        self._rest: tuple[float, float | None, int] | None = None
        self._until = time.perf_counter() + PATIENCE

    def __call__(self, app: App) -> None:
        model, now = app.model, time.perf_counter()
        self._look_for_pictures(model)
        playback = model.playback
        self.problem = model.failure or model.parameters.network_fault
        if self.problem is None and self.first is None and now > self._until:
            self.problem = f"nothing was shown after {PATIENCE:.0f} s"
        if self.problem:
            app.close()
        elif self._rest is not None:
            self._count_rest(app, now)
        elif self._look is not None:
            if model.contents.result is not None:
                self._show(model)
        elif self.first is None:
            if model.settled:
                playback.mode, playback.speed, playback.loop = "every frame", _FASTEST, False
                playback.seek(0)
                playback.play()
                self.first = _Pass(now, model)
        elif self.cached is None:
            self.first.count(now, model)
            if now - self.first.start > self.seconds or not playback.playing:
                self._play_again(app, now)
        else:
            self.cached.count(now, model)
            if now - self.cached.start > self.seconds:
                playback.pause()
                self._begin_rest(app, now)

    def _begin_rest(self, app: App, now: float) -> None:
        app.may_idle = True
        self._rest = now + _COMES_TO_REST, None, 0

    def _count_rest(self, app: App, now: float) -> None:
        """Measure the window at rest, then close it."""
        assert self._rest is not None
        start, processor, frames = self._rest
        if now < start or app.at_work or not app.model.source.is_checked:
            self._rest = max(start, now), None, 0
        elif processor is None:  # only now, or the end of the last work would be counted
            self._rest = now, time.process_time(), 0
        elif now - start < max(self.seconds, _LEAST_REST):
            self._rest = start, processor, frames + 1
        else:
            share = (time.process_time() - processor) / (now - start)
            self.idle = {"percent_of_a_core": 100 * share, "interface_frames_per_second": (frames + 1) / (now - start)}
            app.close()

    def count(self, app: App) -> None:
        """Count a picture that was drawn without a frame of the interface. Call once per such picture."""
        played = self.cached or self.first
        if played is not None:
            played.count(time.perf_counter(), app.model, interface=False)

    def _look_for_pictures(self, model: Model) -> None:
        for name in self._drawn - self.pictures.keys():
            seconds = _age_of_process()
            self.pictures |= {} if seconds is None else {name: seconds}
        if model.preview is not None or model.contents.result is not None:
            self._drawn.add("seconds")
        if model.contents.result is not None:
            self._drawn.add("computed_seconds")

    def _show(self, model: Model) -> None:
        look, self._look = self._look, None
        assert look is not None
        try:
            look.take(model)
        except GffeError as error:
            self.problem = str(error)

    def _play_again(self, app: App, now: float) -> None:
        model, playback = app.model, app.model.playback
        playback.pause()
        if not model.store.most:
            self._begin_rest(app, now)
            return
        playback.set_out(model.slot)
        if model.busy:
            return
        playback.mode, playback.speed, playback.loop = "real time", 1.0, True
        playback.seek(0)
        playback.play()
        self.cached = _Pass(now, model, real_time=True)


class _Pass:
    """Displayed frames from `start` on."""

    def __init__(self, start: float, model: Model, real_time: bool = False):
        self.start = self._end = start
        self._processor = self._processor_end = time.process_time()
        self._real_time, self._last = real_time, model.contents.result
        self._interface = self._dropped = 0
        self._due_rate = model.playback.target_rate
        self._rows: list[tuple[bool, float, float, float]] = []

    def count(self, now: float, model: Model, interface: bool = True) -> None:
        self._interface += interface
        self._end, self._dropped = now, model.playback.dropped
        self._processor_end = time.process_time()
        result = model.contents.result
        if result is not None and result is not self._last:
            self._last = result
            kernels = sum(result.milliseconds.values())
            self._rows.append((result.moment.alpha > 0, kernels, result.readback_ms, model.screen.upload_ms))

    def figures(self) -> dict[str, float]:
        elapsed = max(self._end - self.start, 1e-9)
        generated = sum(row[0] for row in self._rows)
        kernels, readback, upload = np.array([row[1:] for row in self._rows] or [(np.nan,) * 3]).mean(0).tolist()
        figures = {
            "frames_per_second": len(self._rows) / elapsed,
            "generated_frames_per_second": generated / elapsed,
            "interface_frames_per_second": self._interface / elapsed,
            "upload_ms_per_frame": upload,
            "processor_ms_per_frame": (self._processor_end - self._processor) * 1e3 / max(len(self._rows), 1),
        }
        if self._real_time:
            return figures | {"due_per_second": self._due_rate, "dropped": self._dropped}
        return figures | {"kernels_ms_per_frame": kernels, "reading_back_ms_per_frame": readback}


def _age_of_process() -> float | None:
    """Return the seconds since this process was started, to about 0.01, from Linux; None elsewhere."""
    try:
        started = int(Path("/proc/self/stat").read_text().rpartition(")")[2].split()[19]) / os.sysconf("SC_CLK_TCK")
        return float(Path("/proc/uptime").read_text().split()[0]) - started
    except (OSError, ValueError, IndexError, AttributeError):
        return None
