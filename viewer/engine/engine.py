"""The engine thread: owns the device, the source of frames and the pipeline, and computes slots for the interface.

Slot s shows rendered frame k = s // (n + 1) if j = s % (n + 1) is 0, else the frame extrapolated from it at
α = j / (n + 1). The interface posts requests and polls for answers; neither ever waits.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
import pyopencl as cl

from gffe_cl.errors import GffeError
from gffe_cl.evaluation.bench import Copier
from gffe_cl.frame import HALF_MAX
from gffe_cl.inference import NetworkError
from gffe_cl.opencl.device import Device, open_device
from gffe_cl.run import alphas_for
from gffe_cl.viewer.engine import names
from gffe_cl.viewer.engine.buffers import device_layers, pixel_values, read_layers
from gffe_cl.viewer.engine.layers import layers_of
from gffe_cl.viewer.engine.messages import Closing, EngineError, Inspection, Metrics, Request, Result
from gffe_cl.viewer.engine.reloading import WATCH_SECONDS, Kernels
from gffe_cl.viewer.engine.scoring import Scorer
from gffe_cl.viewer.engine.seeking import Seeker
from gffe_cl.viewer.engine.sources import FrameSource
from gffe_cl.viewer.engine.story import pixel_story

_CLOSE_SECONDS = 2.0
_KINDS = {  # of what is posted, and the activity meanwhile
    "source": "opening",
    "kernels": "building kernels",
    "slot": "computing",
    "inspection": "",
    "bandwidth": "measuring bandwidth",
}


def open_viewer_device(wanted: str | None = None) -> Device:
    """The device that `open_device` opens; of a CPU all compute units but one, which is left to the interface."""
    device = open_device(wanted)
    cl_device = device.cl_device
    if device.info.kind != "cpu" or cl_device.max_compute_units < 2:
        return device
    counts = [cl.device_partition_property.BY_COUNTS, cl_device.max_compute_units - 1]
    with suppress(cl.Error):
        return Device(cl_device.create_sub_devices(counts)[0], device.info)
    return device


class Engine:
    """The viewer's computing thread.

    Parameters
    ----------
    open_the_device : callable
        Opens the device, on the thread.
    notify : callable
        Called on the engine's threads whenever there is something to poll.

    Attributes
    ----------
    source : FrameSource or None
        What was opened last.
    device_name : str
        Empty until it is open.
    builds : int
        How often other kernels were taken into use.
    build_error : str or None
        Why the kernels on disk do not build, with file and line; the last good ones go on.
    bandwidth : float or None
        GB/s of copying, once measured.
    activity : str
        What is being done; empty if nothing, or something short.
    """

    def __init__(
        self, open_the_device: Callable[[], Device] = open_viewer_device, notify: Callable[[], None] = lambda: None
    ):
        self._open_the_device, self._notify = open_the_device, notify
        self.source: FrameSource | None = None
        self.device_name, self.activity = "", "opening the device"
        self.builds, self.build_error = 0, None
        self.bandwidth: float | None = None
        self._thread = threading.Thread(target=self._run, name="gffe-viewer-engine", daemon=True)
        self._news = threading.Condition()
        self._posted: dict[str, Any] = {}
        self._closing = False
        self._result: Result | None = None
        self._errors: deque[EngineError] = deque(maxlen=16)
        self._inspection: Inspection | None = None
        self._device: Device | None = None
        self._problem = ""  # of opening the device
        self._kernels: Kernels | None = None
        self._seeker: Seeker | None = None
        self._scorer = Scorer(notify, lambda error: self._fail(error, "metrics", None))
        self._last: Request | None = None  # computed last

    @property
    def busy(self) -> bool:
        """Whether anything but an inspection is under way or waits."""
        with self._news:
            return bool(self.activity or self._posted.keys() - {"inspection"})

    def start(self) -> None:
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether the thread runs; when it has ended, the device is idle."""
        return self._thread.is_alive()

    def close(self) -> None:
        """Ends the thread; returns within two seconds even if a kernel takes longer."""
        with self._news:
            self._closing = True
            self._news.notify()
        self._scorer.close()
        if self._thread.is_alive():
            self._thread.join(_CLOSE_SECONDS)

    # ---- posting and polling -----------------------------------------------------------------------------

    def open_source(self, make: Callable[[Device], FrameSource], serial: int = 0) -> None:
        """Have `make` open a source on the thread; `source` is it then, and what was asked before is given up. If it
        fails the old one stays."""
        self._post("source", (make, serial))

    def submit(self, request: Request, source: FrameSource | None = None) -> None:
        """Ask for a slot; replaces a request that was not taken up yet. Ignored if it was meant for a `source` that is
        not the one any more."""
        with self._news:
            if source in (None, self.source):
                self._posted["slot"] = request
                self._news.notify()

    def inspect(self, x: int, y: int, layers: frozenset[str] | None = None) -> None:
        """Ask what the slot last computed holds at display pixel (x, y); `layers`: None for all."""
        self._post("inspection", (x, y, layers))

    def reload_kernels(self) -> None:
        """Build the kernels anew if their text changed, and the last slot with them."""
        self._post("kernels", None)

    def measure_bandwidth(self) -> None:
        """Measure `bandwidth`, once; takes a second, and 512 MiB on the device."""
        if self.bandwidth is None:
            self._post("bandwidth", None)

    def poll(self) -> Result | EngineError | None:
        """What went wrong, oldest first, else the newest result; each once."""
        with self._news:
            if self._errors:
                return self._errors.popleft()
            result, self._result = self._result, None
        return result

    def poll_inspection(self) -> Inspection | None:
        with self._news:
            inspection, self._inspection = self._inspection, None
        return inspection

    def poll_metrics(self) -> Metrics | None:
        """The next metrics that became known: those of a slot come one by one, with what was known before."""
        return self._scorer.take()

    def _post(self, kind: str, content: Any) -> None:
        with self._news:
            self._posted[kind] = content
            self._news.notify()

    # ---- on the thread -----------------------------------------------------------------------------------

    def _run(self) -> None:
        kind, content = "device", None
        while kind:
            try:
                getattr(self, f"_do_{kind}")(content)
            except Closing:
                break
            except Exception as error:
                self._fail(error, kind, content)
            self.activity = ""
            kind, content = self._next(kind)
        self._seeker = self._last = None
        if self.source:
            self.source.close()
        if self._kernels:
            self._kernels.release()
        if self._device:
            self._device.queue.finish()

    def _next(self, last: str) -> tuple[str, Any]:
        """What to do next, kinds taking turns; an empty kind to end."""
        kinds = list(_KINDS)
        turns = kinds[kinds.index(last) + 1 :] + kinds if last in kinds else kinds
        with self._news:
            while not self._closing:
                if self._kernels and time.monotonic() >= self._kernels.look_again_at:
                    return "watch", None
                for kind in turns:
                    if kind in self._posted:
                        self.activity = _KINDS[kind]
                        return kind, self._posted.pop(kind)
                self._news.wait(WATCH_SECONDS)
        return "", None

    def _fail(self, error: Exception, kind: str, content: Any) -> None:
        message = str(error) if isinstance(error, GffeError) else f"{type(error).__name__}: {error}"
        serial = {"slot": lambda: content.serial, "source": lambda: content[1]}.get(kind, lambda: 0)()
        if kind == "device":
            self._problem, self.device_name = message, "no device"
        during = "network" if isinstance(error, NetworkError) else kind
        self._errors.append(EngineError(message, serial, during))
        self._notify()

    def _do_device(self, _) -> None:
        self._device = self._open_the_device()
        self.device_name = self._device.info.name
        self.activity = "building kernels"
        self._kernels = Kernels(self._device)
        self._do_kernels(None)

    def _need_device(self) -> Device:
        if self._device is None:
            raise GffeError(self._problem)
        return self._device

    def _do_source(self, content) -> None:
        source = content[0](self._need_device())
        if self.source:
            self.source.close()
        self._seeker, self._last = Seeker(self._device, source, lambda: self._closing), None
        self._scorer.clear()
        with self._news:
            self._posted.pop("slot", None)
            self._posted.pop("inspection", None)
            self._result = self._inspection = None
            self.source = source
        self._notify()

    def _do_watch(self, _) -> None:
        if self._kernels.have_changed():
            self._do_kernels(None)

    def _do_kernels(self, _) -> None:
        self._need_device()
        self.activity = "building kernels"
        changed = self._kernels.reload()
        self.build_error = self._kernels.error
        self.builds += changed
        if changed and self._seeker:
            self._seeker.drop()
            self._scorer.clear()
            with self._news:
                if self._last:
                    self._posted.setdefault("slot", self._last)
        self._notify()

    def _do_bandwidth(self, _) -> None:
        if self.bandwidth is None:
            self.bandwidth = Copier(self._need_device()).bandwidth()
            self._notify()

    def _do_inspection(self, content) -> None:
        x, y, layers = content
        seeker = self._seeker
        if not (seeker and seeker.shot and 0 <= x < self.source.width and 0 <= y < self.source.height):
            return
        pipeline, shot = seeker.pipeline, seeker.shot
        values = pixel_values(pipeline, shot, x, y)
        story = pixel_story(pipeline, shot, x, y, values)
        if seeker.truth is not None:
            values[names.TRUTH] = _rgba(seeker.truth[y : y + 1, x : x + 1])[0, 0]
        if layers is not None:
            values = {name: value for name, value in values.items() if name in layers}
        inspection = Inspection((x, y), self._last.slot, story.source, values, story)
        with self._news:
            self._inspection = inspection
        self._notify()

    def _do_slot(self, request: Request) -> None:
        start = time.perf_counter()
        self._need_device()
        if self._seeker is None:
            raise GffeError("nothing is open: expected a sequence or a built-in scene")
        seeker, alphas = self._seeker, (0.0, *alphas_for(request.setup.n))
        k, j = divmod(request.slot, len(alphas))
        if not 0 <= k < self.source.count:
            raise GffeError(f"slot {request.slot}: expected 0 to {self.source.count * len(alphas) - 1}")
        self._last = request
        try:
            result = self._computed(seeker, request, k, alphas[j], start)
        except Exception:
            seeker.drop()
            raise
        with self._news:
            self._result = result
        self._notify()

    def _computed(self, seeker: Seeker, request: Request, k: int, alpha: float, start: float) -> Result:
        seeker.prepare(request.setup)
        notes = seeker.go_to(k, alpha)
        seeker.pipeline.keep(request.layers)
        shot = seeker.shoot(k, alpha)
        pipeline = seeker.pipeline
        specs = layers_of(pipeline)
        if not self.source.has_truth:
            del specs[names.TRUTH], specs[names.FOCUS_TRUTH]
        milliseconds = pipeline.take_timings()
        measure = request.metrics and alpha > 0 and self.source.has_truth
        wanted = (request.layers | ({names.FINAL} if measure else set())) & specs.keys()
        truth = None
        if alpha and self.source.has_truth and (measure or wanted & {names.TRUTH, names.FOCUS_TRUTH}):
            seeker.truth = truth = self._truth(k, alpha, notes)
        if truth is not None and names.FOCUS_TRUTH in wanted:
            seeker.find_focus(_rgba(truth))
        reading = time.perf_counter()
        images = read_layers(pipeline, device_layers(pipeline, shot), wanted)
        readback_ms = (time.perf_counter() - reading) * 1e3
        known = Metrics(request.slot, request.setup)
        if truth is not None and names.TRUTH in wanted:
            images[names.TRUTH] = _rgba(truth)
        if truth is not None and measure:
            known = self._scorer.score(known, shot.moment, images[names.FINAL], truth, self.source.exposure)
        return Result(
            request,
            shot.moment,
            images={name: image for name, image in images.items() if name in request.layers},
            specs=specs,
            milliseconds=milliseconds,
            wall_ms=(time.perf_counter() - start) * 1e3,
            readback_ms=readback_ms,
            warnings=(*self.source.warnings(), *notes),
            bad_pixels=seeker.bad_pixels,
            metrics=known.values,
            cuts=frozenset(seeker.cuts),
        )

    def _truth(self, k: int, alpha: float, notes: list[str]) -> np.ndarray | None:
        """A fault of the truth is a warning: the slot itself can be shown."""
        try:
            return self.source.truth(k, alpha)
        except GffeError as error:
            notes.append(str(error))
            return None


def _rgba(color: np.ndarray) -> np.ndarray:
    """(H, W, 4) float16 of (H, W, 3)."""
    out = np.zeros((*color.shape[:2], 4), np.float16)
    out[..., :3] = color if color.dtype == np.float16 else np.clip(color, -HALF_MAX, HALF_MAX)
    return out
