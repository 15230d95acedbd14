"""What the viewer knows and decides, between the interface and the engine; no ImGui here."""

from __future__ import annotations

import itertools
import sys
import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from gffe_cl import inference
from gffe_cl.errors import GffeError
from gffe_cl.options import Options
from gffe_cl.viewer.engine.engine import Engine, open_viewer_device
from gffe_cl.viewer.engine.layers import Display, FrameInfo, LayerSpec, area_of
from gffe_cl.viewer.engine.messages import EngineError, Metrics, Request, Result, Setup
from gffe_cl.viewer.engine.opening import ScenePlan, make_source
from gffe_cl.viewer.picture import flip_map
from gffe_cl.viewer.picture.canvas import View
from gffe_cl.viewer.state import remembering
from gffe_cl.viewer.state.comparing import Comparison
from gffe_cl.viewer.state.flying import Flyer
from gffe_cl.viewer.state.looks import Looks
from gffe_cl.viewer.state.playback import Playback
from gffe_cl.viewer.state.pointing import Pointing
from gffe_cl.viewer.state.saving import Work
from gffe_cl.viewer.state.settings import Settings
from gffe_cl.viewer.state.timings import Timings

_FIT = 0.98  # of the window that a fitted picture takes
_SCENES = ScenePlan(480, 270, 0)
_OPTIONS = Options()


@dataclass
class Message:
    """Something to tell; `sticky` ones stay until the next `open`."""

    text: str
    error: bool
    time: float
    sticky: bool = False


class Model:
    """State of the viewer.

    `update` is called once per frame of the interface; everything else is called by panels and actions in between.
    """

    def __init__(
        self, settings: Settings, *, device: str | None = None, n: int = 1, window: str | None = None,
        plan: ScenePlan = _SCENES, options: Options = _OPTIONS, save_settings: bool = True,
    ):  # fmt: skip
        self.settings, self._save_settings, self.plan = settings, save_settings, plan
        self.engine = Engine(partial(open_viewer_device, device))
        self.engine.start()
        self.playback = Playback(n=n)
        self.options = replace(options, shading_inputs=True)
        self.defaults = replace(self.options, shading_correction=None)
        self.network_fault: str | None = None  # why shading correction was switched off
        self.window = window
        self.info = None
        self.layers: list[LayerSpec] = []
        self.view = View("final", Display())
        self.looks = Looks(self)
        self.comparison = Comparison(self)
        self.overview = False
        self.arrows = False
        self.measuring = False
        self.fit_pending = True
        self._fitted: tuple | None = None
        self.flyer: Flyer | None = None
        self.result: Result | None = None
        self.pointing = Pointing(self)
        self.metrics: dict[int, Metrics] = {}
        self.messages: list[Message] = []
        self.warnings: list[str] = []
        self.failure: str | None = None
        self.notice = ""
        self.export: Work | None = None
        self.upload_ms = 0.0
        self.timings = Timings()
        self._builds = 0  # of the engine when last looked at
        self._serial = itertools.count(1)
        self._asked: Request | None = None  # the latest request, and it without its serial number
        self._wanted: Request | None = None
        self._target = ""
        self._keep_place = False
        self.taken = 0  # times that other images came
        self._closed = False
        remembering.restore(self)

    # ---- opening -----------------------------------------------------------------------------------------

    def open(self, target: str) -> None:
        """A folder with a sequence, or the name of a built-in scene; `update` hears when it is open."""
        self.messages = [message for message in self.messages if not message.sticky]
        self.failure = None
        self.notice = f"opening {target} …"
        self.engine.open_source(partial(make_source, target, self.window, self.plan), next(self._serial))

    def reload(self) -> None:
        """Read the same thing again, and stay where we are."""
        self._keep_place = True
        self.open(self._target)

    def _opened(self, source, canvas) -> None:
        self.info, self.notice, self.result, self._asked = source, "", None, None
        self._target = source.target
        self._show({}, canvas)
        if self.export is not None:
            self.export.cancel()
        times = None if source.live else [source.time(k) for k in range(source.count)]
        self.playback.open(source.count, source.fps, times, keep=self._keep_place)
        self.metrics.clear()
        self.pointing.forget()
        self.flyer = None
        if not self._keep_place:
            self.looks.forget()
            self.timings = Timings()
        self._drop_missing()
        self.fit_pending = not self._keep_place
        self._keep_place = False
        if source.live:
            self.window = self.window or "off"
        else:
            self.settings.add_recent(Path(self._target).expanduser())
            self.window = "off" if self.window == "off" else None

    def _drop_missing(self) -> None:
        """Ground truth is not shown where there is none."""
        if self.why_not("truth"):
            self.view.a = "final" if self.why_not(self.view.a) else self.view.a
            if self.view.b and self.why_not(self.view.b):
                self.view.b, self.view.compare = None, "off"

    # ---- one frame of the interface ------------------------------------------------------------------------

    def update(self, now: float, canvas) -> None:
        """Take what the engine has finished into textures, and ask for what is wanted next."""
        if self.engine.source is not self.info:
            self._opened(self.engine.source, canvas)
        if self.engine.builds != self._builds:
            self._builds = self.engine.builds
            self.metrics.clear()
        while (answer := self.engine.poll()) is not None:
            if isinstance(answer, EngineError):
                self._failed(answer)
            elif self.info is not None:
                self._take(answer, canvas)
        while (metrics := self.engine.poll_metrics()) is not None:
            if metrics.setup == self.setup:
                self.metrics[metrics.slot] = metrics
        inspection = self.engine.poll_inspection()
        if inspection is not None and inspection.slot == self.slot:
            self.pointing.take(inspection)
        if self.info is None:
            return
        self.comparison.update(canvas)
        ready = None
        if self.result is not None and self.result.request.setup == self.setup:
            ready = self.result.request.slot
        self._ask(self.playback.tick(now, ready).request)
        if self.export is not None:
            self.export.advance(self, canvas)
            if self.export.finished:
                self.export = None

    def _failed(self, error: EngineError) -> None:
        self.failure = error.message
        if error.during == "network":
            self._without_network(error.message)
            return
        self.say(error.message, error=True)
        self.notice = error.message if self.info is None else ""
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
        self.network_fault = why
        self.metrics.clear()
        if self.export is not None:
            self.export.cancel()

    def _take(self, result: Result, canvas) -> None:
        self.result = result
        self.failure = None
        self.layers = list(result.specs.values())
        self.warnings = list(result.warnings)
        if result.psnr is not None:
            self.metrics[result.request.slot] = Metrics(
                result.request.slot, result.request.setup, result.psnr, result.ssim, result.flip
            )
        if canvas is not None:
            canvas.frame = self.frame_info(result)
        self._show(result.images, canvas)
        self.looks.meet(result.images)
        self.timings.add(result)
        self.pointing.ask_again()

    def _show(self, images: dict[str, np.ndarray], canvas) -> None:
        """Have these images and no others, which would be of another time, on the canvas."""
        self.taken += 1
        if canvas is None:
            return
        start = time.perf_counter()
        canvas.forget(canvas.layers.keys() - images.keys() - {flip_map.NAME})
        for name, image in images.items():
            canvas.upload(name, image, self.spec_of(name))
        self.upload_ms = (time.perf_counter() - start) * 1e3

    def _ask(self, slot: int) -> None:
        """Submit a request if it is another one than before."""
        if self.flying:
            k, j = divmod(slot, self.n + 1)
            self.info.fly(k, j / (self.n + 1), self.flyer.pose)
        request = Request(slot, self.setup, frozenset(self._needed()), 0, self.measuring)
        steered = self.flying and self.flyer.moved
        if request == self._wanted and self._asked is not None and not steered:
            return
        if self.flying:
            self.flyer.moved = False
        self._wanted = request
        self._asked = replace(request, serial=next(self._serial))
        self.engine.submit(self._asked, self.info)

    # ---- what is asked for -----------------------------------------------------------------------------------

    @property
    def n(self) -> int:
        return self.playback.n

    @property
    def slot(self) -> int:
        return self.result.request.slot if self.result is not None else self.playback.slot

    @property
    def setup(self) -> Setup:
        return Setup(replace(self.options, shading_correction=self.corrects_shading), self.window, self.n)

    @property
    def corrects_shading(self) -> bool:
        return self.options.corrects_shading and self.network_fault is None

    @property
    def pixels(self) -> int:
        return self.info.width * self.info.height

    @property
    def settled(self) -> bool:
        """Whether what is shown is what was asked for."""
        return (
            self.result is not None
            and self._asked is not None
            and self.result.request == self._asked
            and not self.engine.busy
            and not self.pointing.story_due
            and self.comparison.ready
        )

    @property
    def asked_layers(self) -> frozenset[str]:
        """Layers that the present images were asked for."""
        return self.result.request.layers if self.result is not None else frozenset()

    def _needed(self) -> set[str]:
        """Layers to read back."""
        if self.overview:
            return {spec.name for spec in self.layers} or {"final"}
        names = {self.view.a}
        if self.view.compare != "off" and self.view.b:
            names.add(self.view.b)
        if self.view.overlay != "none":
            names |= {"rendered.color", "rendered.depth", "rendered.motion"}
        specs = [self.spec_of(name) for name in names]
        if any(spec is not None and spec.view == "world" for spec in specs):
            names.add("rendered.depth")
        if self.export is not None:
            names |= self.export.layers(self)
        return names

    def set_options(self, options: Options) -> None:
        try:
            self.options = replace(options, shading_inputs=True)
        except GffeError as error:
            self.say(str(error), error=True)
        self.metrics.clear()

    def correct_shading(self, on: bool) -> None:
        """Switch the shading correction network; what was wrong with it is forgotten."""
        self.network_fault = None
        self.set_options(replace(self.options, shading_correction=None if on else False))

    def use_defaults(self) -> None:
        self.network_fault = None
        self.set_options(self.defaults)
        self.set_n(1)

    def set_window(self, window: str | None) -> None:
        self.window = window
        self.metrics.clear()

    def set_n(self, n: int) -> None:
        self.playback.n = n
        self.metrics.clear()

    def set_measuring(self, on: bool) -> None:
        self.measuring = on

    def time_of(self, slot: int) -> float:
        return self.playback.time_of(slot)

    # ---- layers and how they look ----------------------------------------------------------------------------

    def spec_of(self, name: str | None) -> LayerSpec | None:
        return next((spec for spec in self.layers if spec.name == name), None)

    def image_of(self, name: str) -> np.ndarray | None:
        return None if self.result is None else self.result.images.get(name)

    def find_layer(self, text: str) -> str | None:
        """Full name of a layer given by it or by the buffer's name alone."""
        names = [spec.name for spec in self.layers]
        if text in names:
            return text
        return next((name for name in names if name.partition(".")[2] == text), None)

    def why_not(self, name: str) -> str | None:
        """Why a layer cannot be shown in this sequence."""
        if name in ("truth", "focus_truth") and self.info is not None and not self.info.has_truth:
            return "this sequence has no ground truth"
        return None

    def why_no_correction(self) -> str | None:
        """Why the shading correction network cannot be switched on."""
        return None if self.options.scn_model else inference.scn_missing()

    def show_layer(self, name: str) -> None:
        self.view.a = name

    def next_layer(self, step: int) -> None:
        names = [spec.name for spec in self.layers if self.why_not(spec.name) is None]
        if names:
            index = names.index(self.view.a) if self.view.a in names else 0
            self.show_layer(names[(index + step) % len(names)])

    def set_overview(self, on: bool) -> None:
        self.overview = on

    def overview_tiles(self) -> list[tuple[str, Display]]:
        names = [spec.name for spec in self.layers if self.image_of(spec.name) is not None]
        return [(name, self.looks.of(name)) for name in names]

    # ---- looking closer ------------------------------------------------------------------------------------

    def fit(self, size: tuple[int, int]) -> None:
        """Zoom so that the whole picture is seen in a canvas of `size` (screen pixels)."""
        self.view.zoom = max(min(size[0] / self.info.width, size[1] / self.info.height) * _FIT, 0.01)
        self.view.centre = (self.info.width / 2, self.info.height / 2)
        self.fit_pending = False
        self._fitted = self.view.zoom, self.view.centre

    @property
    def is_fitted(self) -> bool:
        """Whether nobody has zoomed or panned since `fit`."""
        return self._fitted == (self.view.zoom, self.view.centre)

    def zoom(self, factor: float) -> None:
        self.view.zoom = min(max(self.view.zoom * factor, 0.05), 128.0)

    def frame_info(self, result: Result) -> FrameInfo:
        """What the layers of `result` refer to, for displaying them."""
        size, render_size = (self.info.width, self.info.height), self.info.render_size
        area = area_of(result.source_camera, render_size, result.display_camera, size)
        return FrameInfo(
            size,
            render_size,
            size,
            self.info.exposure,
            result.source_camera,
            result.previous_camera,
            source_area=area,
        )

    # ---- the camera ----------------------------------------------------------------------------------------

    @property
    def flying(self) -> bool:
        return self.flyer is not None and self.flyer.active

    def toggle_flying(self) -> None:
        if self.flying:
            self.flyer.active = False
        elif self.result is not None:
            self.flyer = Flyer(self.result.camera)
            self.playback.play()

    def stop_flying(self) -> None:
        self.flyer = None
        self.info.forget_flight()
        self._asked = None

    def fly(self, flight) -> None:
        if self.flyer is not None and flight is not None:
            self.flyer.steer(flight, time.perf_counter())

    # ---- telling -------------------------------------------------------------------------------------------

    def say(self, text: str, error: bool = False) -> None:
        self.messages = [*self.messages[-20:], Message(text, error, time.perf_counter())]

    def remember(self, window_size: tuple[int, int]) -> None:
        """Write the settings."""
        if not self._save_settings:
            return
        self.settings.window_size = window_size
        remembering.collect(self)
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
