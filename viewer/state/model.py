"""What the viewer knows and decides, between the interface and the engine; no ImGui here."""

from __future__ import annotations

import itertools
import sys
import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gffe_cl.errors import GffeError
from gffe_cl.options import Options
from gffe_cl.viewer.engine import names
from gffe_cl.viewer.engine.engine import Engine, open_viewer_device
from gffe_cl.viewer.engine.messages import EngineError, Metrics, Request, Result, Setup
from gffe_cl.viewer.engine.opening import ScenePlan, make_source
from gffe_cl.viewer.engine.sources import FrameSource
from gffe_cl.viewer.picture import flip_map
from gffe_cl.viewer.picture.displays import Display
from gffe_cl.viewer.picture.view import View
from gffe_cl.viewer.state.comparing import Comparison
from gffe_cl.viewer.state.contents import Contents
from gffe_cl.viewer.state.flying import Flight, Flyer
from gffe_cl.viewer.state.framing import Framing
from gffe_cl.viewer.state.looks import Looks
from gffe_cl.viewer.state.parameters import Parameters
from gffe_cl.viewer.state.playback import Playback
from gffe_cl.viewer.state.pointing import Pointing
from gffe_cl.viewer.state.saving import Subject, Work, save_picture
from gffe_cl.viewer.state.settings import Settings
from gffe_cl.viewer.state.timings import Timings

_SCENES = ScenePlan(480, 270, 0)
_OPTIONS = Options()


@dataclass
class Message:
    """Something to tell; `time`: of `time.perf_counter`."""

    text: str
    error: bool
    time: float


class Model:
    """State of the viewer.

    `update` is called once per frame of the interface; everything else is called by panels and actions in between.
    """

    def __init__(
        self, settings: Settings, *, device: str | None = None, n: int = 1, window: str | None = None,
        plan: ScenePlan = _SCENES, options: Options = _OPTIONS, save_settings: bool = True,
        check: bool = False,
    ):  # fmt: skip
        self.settings, self._save_settings, self.plan, self._check = settings, save_settings, plan, check
        self.engine = Engine(partial(open_viewer_device, device))
        self.engine.start()
        self.contents = Contents()
        self.playback = Playback(n=n)
        self.parameters = Parameters(options, self.playback, window)
        self.view = View(names.FINAL, Display())
        self.framing = Framing(self.view)
        self.looks = Looks(self.contents, settings.displays)
        self.comparison = Comparison(self.view, self.contents, self.looks)
        self.pointing = Pointing(self.engine.inspect)
        self.flyer: Flyer | None = None
        self.export: Work | None = None
        self.overview = False
        self.arrows = False
        self.measuring = False
        self.metrics: dict[int, Metrics] = {}
        self.messages: list[Message] = []
        self.warnings: list[str] = []
        self.failure: str | None = None
        self.notice = ""
        self.timings = Timings()
        self.upload_ms = 0.0
        self._measured: tuple[Setup, int] | None = None  # what the metrics are of: setup, builds of the kernels
        self._serial = itertools.count(1)
        self._asked: Request | None = None  # the latest request, and it without its serial number
        self._wanted: Request | None = None
        self._target = ""
        self._keep_place = False
        self._closed = False
        self.playback.restore(settings.playback)
        self.parameters.restore(settings.options)
        self.comparison.restore(settings.compare)

    # ---- opening -----------------------------------------------------------------------------------------

    @property
    def source(self) -> FrameSource | None:
        """What is open."""
        return self.contents.source

    def open(self, target: str) -> None:
        """A folder with a sequence, or the name of a built-in scene; `update` hears when it is open."""
        self.failure = None
        self.notice = f"opening {target} …"
        make = partial(make_source, target, self.parameters.window, self.plan, check=self._check)
        self.engine.open_source(make, next(self._serial))

    def reload(self) -> None:
        """Read the same thing again, and stay where we are."""
        self._keep_place = True
        self.open(self._target)

    def _opened(self, source: FrameSource, canvas) -> None:
        self.contents.open(source)
        self.parameters.open(source)
        self.notice, self._asked, self._target = "", None, source.target
        self._show({}, canvas)
        if self.export is not None:
            self.export.cancel()
        times = None if source.live else [source.time(k) for k in range(source.count)]
        self.playback.open(source.count, source.fps, times, keep=self._keep_place)
        self.pointing.open(self.contents.size)
        self.metrics.clear()
        self.flyer = None
        if not self._keep_place:
            self.looks.forget()
            self.timings = Timings()
        self.comparison.drop_missing()
        self.framing.due = not self._keep_place
        self._keep_place = False
        if not source.live:
            self.settings.add_recent(Path(self._target).expanduser())

    # ---- one frame of the interface ------------------------------------------------------------------------

    def update(self, now: float, canvas) -> None:
        """Take what the engine has finished into textures, and ask for what is wanted next."""
        if self.engine.source is not self.source:
            self._opened(self.engine.source, canvas)
        if (self.setup, self.engine.builds) != self._measured:
            self._measured = self.setup, self.engine.builds
            self.metrics.clear()
        while (answer := self.engine.poll()) is not None:
            if isinstance(answer, EngineError):
                self._failed(answer)
            elif self.source is not None:
                self._take(answer, canvas)
        while (metrics := self.engine.poll_metrics()) is not None:
            if metrics.setup == self.setup:
                self.metrics[metrics.slot] = metrics
        inspection = self.engine.poll_inspection()
        if inspection is not None and inspection.slot == self.slot:
            self.pointing.take(inspection)
        if self.source is None:
            return
        fault = self.comparison.update(canvas)
        if fault:
            self.say(fault, error=True)
        result, ready = self.contents.result, None
        if result is not None and result.request.setup == self.setup:
            ready = result.request.slot
        self._ask(self.playback.tick(now, ready).request)
        if self.export is not None:
            self._advance_export(canvas)

    def _failed(self, error: EngineError) -> None:
        self.failure = error.message
        if error.during == "network":
            self._without_network(error.message)
            return
        self.say(error.message, error=True)
        self.notice = error.message if self.source is None else ""
        self._keep_place = False
        self.pointing.story_due &= error.during != "inspection"
        if error.during == "source":
            self._asked = None  # what was asked of the old one was thrown away
        if error.during in ("source", "slot"):
            self.playback.pause()
            if self.export is not None:
                self.export.cancel()

    def _without_network(self, why: str) -> None:
        """Go on without shading correction, until it is switched on again."""
        self.say(f"shading correction is off: {why}", error=True)
        self.parameters.network_fault = why
        if self.export is not None:
            self.export.cancel()

    def _take(self, result: Result, canvas) -> None:
        self.contents.take(result)
        self.failure = None
        self.warnings = list(result.warnings)
        if result.metrics:
            request = result.request
            self.metrics[request.slot] = Metrics(request.slot, request.setup, result.metrics)
        if canvas is not None:
            canvas.frame = self.contents.frame_info()
        self._show(result.images, canvas)
        self.looks.meet(result.images)
        self.timings.add(result)
        self.pointing.ask_again()

    def _show(self, images: dict[str, np.ndarray], canvas) -> None:
        """Have these images and no others, which would be of another time, on the canvas."""
        if canvas is None:
            return
        start = time.perf_counter()
        canvas.forget(canvas.layers.keys() - images.keys() - {flip_map.NAME})
        for name, image in images.items():
            canvas.upload(name, image, self.contents.spec(name))
        self.upload_ms = (time.perf_counter() - start) * 1e3

    def _ask(self, slot: int) -> None:
        """Submit a request if it is another one than before."""
        if self.flying:
            k, j = divmod(slot, self.n + 1)
            self.source.fly(k, j / (self.n + 1), self.flyer.pose)
        request = Request(slot, self.setup, frozenset(self._needed()), 0, self.measuring)
        steered = self.flying and self.flyer.moved
        if request == self._wanted and self._asked is not None and not steered:
            return
        if self.flying:
            self.flyer.moved = False
        self._wanted = request
        self._asked = replace(request, serial=next(self._serial))
        self.engine.submit(self._asked, self.source)

    # ---- what is asked for -----------------------------------------------------------------------------------

    @property
    def n(self) -> int:
        """Generated frames after each rendered one."""
        return self.playback.n

    @property
    def slot(self) -> int:
        result = self.contents.result
        return result.request.slot if result is not None else self.playback.slot

    @property
    def setup(self) -> Setup:
        return self.parameters.setup

    @property
    def settled(self) -> bool:
        """Whether what is shown is what was asked for."""
        return (
            self.contents.result is not None
            and self._asked is not None
            and self.contents.result.request == self._asked
            and not self.engine.busy
            and not self.pointing.story_due
            and self.comparison.ready
        )

    def _needed(self) -> set[str]:
        """Layers to read back."""
        if self.overview:
            return {spec.name for spec in self.contents.layers} or {names.FINAL}
        wanted = {self.view.a}
        if self.view.compare != "off" and self.view.b:
            wanted.add(self.view.b)
        if self.view.overlay != "none":
            wanted |= {names.RENDERED_COLOR, names.RENDERED_DEPTH, names.RENDERED_MOTION}
        specs = [self.contents.spec(name) for name in wanted]
        if any(spec is not None and spec.view == "world" for spec in specs):
            wanted.add(names.RENDERED_DEPTH)
        if self.export is not None:
            wanted |= self.export.layers
        return wanted

    def set(self, name: str, value: Any) -> None:
        """A parameter; what makes no sense is said."""
        try:
            self.parameters.set(name, value)
        except GffeError as error:
            self.say(str(error), error=True)

    # ---- what is shown ---------------------------------------------------------------------------------------

    def show_layer(self, name: str) -> None:
        self.view.a = name

    def next_layer(self, step: int) -> None:
        found = [spec.name for spec in self.contents.showable()]
        if found:
            index = found.index(self.view.a) if self.view.a in found else 0
            self.show_layer(found[(index + step) % len(found)])

    def set_overview(self, on: bool) -> None:
        self.overview = on

    def set_measuring(self, on: bool) -> None:
        self.measuring = on

    def overview_tiles(self) -> list[tuple[str, Display]]:
        shown = [spec.name for spec in self.contents.layers if self.contents.image(spec.name) is not None]
        return [(name, self.looks.of(name)) for name in shown]

    # ---- the camera ----------------------------------------------------------------------------------------

    @property
    def flying(self) -> bool:
        return self.flyer is not None and self.flyer.active

    def toggle_flying(self) -> None:
        if self.flying:
            self.flyer.active = False
        elif self.contents.result is not None:
            self.flyer = Flyer(self.contents.result.moment.camera)
            self.playback.play()

    def stop_flying(self) -> None:
        self.flyer = None
        self.source.forget_flight()
        self._asked = None

    def fly(self, flight: Flight | None) -> None:
        if self.flyer is not None and flight is not None:
            self.flyer.steer(flight, time.perf_counter())

    # ---- saving --------------------------------------------------------------------------------------------

    @property
    def _subject(self) -> Subject:
        return Subject(self.contents, self.playback, self.view, self.comparison.shown, lambda: self.settled)

    def save_picture(self, canvas) -> None:
        try:
            self.say(f"saved {save_picture(self._subject, canvas)}")
        except GffeError as error:
            self.say(str(error), error=True)

    def save(self, work: type[Work]) -> None:
        """Start saving beside the interface."""
        self.export = work(self._subject)

    def _advance_export(self, canvas) -> None:
        self.export.advance(canvas)
        if self.export.finished:
            if self.export.outcome:
                self.say(self.export.outcome, self.export.failed)
            self.export = None

    # ---- telling -------------------------------------------------------------------------------------------

    def say(self, text: str, error: bool = False) -> None:
        self.messages = [*self.messages[-20:], Message(text, error, time.perf_counter())]

    def remember(self, window_size: tuple[int, int]) -> None:
        """Write the settings."""
        if not self._save_settings:
            return
        self.settings.window_size = window_size
        self.settings.playback = self.playback.preferences()
        self.settings.options = self.parameters.preferences()
        self.settings.compare = self.comparison.preferences()
        warning = self.settings.save()
        if warning:
            print(warning, file=sys.stderr)

    def close(self) -> None:
        """Stop everything; again it does nothing."""
        if self._closed:
            return
        self._closed = True
        if self.export is not None:
            self.export.close()
        self.comparison.close()
        self.engine.close()

    @property
    def left_working(self) -> bool:
        """Whether the device is at work although `close` was called."""
        return self._closed and self.engine.alive
