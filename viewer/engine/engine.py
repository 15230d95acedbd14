"""The engine thread: owns the device, the source of frames and the pipeline, and computes slots for the interface.

Slot s shows rendered frame k = s // (n + 1) if j = s % (n + 1) is 0, else the frame extrapolated from it at
α = j / (n + 1). The interface posts requests and polls for answers; neither ever waits.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

from gffe_cl.errors import GffeError
from gffe_cl.evaluation.bench import Copier
from gffe_cl.inference import NetworkError
from gffe_cl.opencl.device import Device
from gffe_cl.viewer.engine.cache import FrameCache, FrameKey
from gffe_cl.viewer.engine.making import SlotMaker, weights_of
from gffe_cl.viewer.engine.messages import (
    Closing,
    EngineError,
    Inspection,
    Interrupted,
    Metrics,
    Recipe,
    Request,
    Result,
    Setup,
)
from gffe_cl.viewer.engine.opening import open_viewer_device
from gffe_cl.viewer.engine.reloading import WATCH_SECONDS, Kernels
from gffe_cl.viewer.engine.scoring import Scorer
from gffe_cl.viewer.engine.sources import FrameSource

_CLOSE_SECONDS = 2.0
_KINDS = {  # of what is posted, and the activity meanwhile
    "source": "opening",
    "kernels": "building kernels",
    "slot": "computing",
    "slot_b": "computing B",
    "inspection": "",
    "bandwidth": "measuring bandwidth",
    "traffic": "counting what must move",
}


class Engine:
    """The viewer's computing thread.

    Parameters
    ----------
    open_the_device : callable
        Opens the device, on the thread.
    notify : callable
        Called on the engine's threads whenever there is something to poll.
    cache : FrameCache or None
        Where computed slots are kept; None: nowhere.

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
    traffic : dict
        Bytes per display pixel, by stage and kernel, that a slot had to move, once counted.
    activity : str
        What is being done; empty if nothing, or something short.
    """

    def __init__(
        self,
        open_the_device: Callable[[], Device] = open_viewer_device,
        notify: Callable[[], None] = lambda: None,
        cache: FrameCache | None = None,
    ):
        self.cache = FrameCache(0) if cache is None else cache
        self._open_the_device, self._notify = open_the_device, notify
        self.source: FrameSource | None = None
        self.device_name, self.activity = "", "opening the device"
        self.builds, self.build_error = 0, None
        self.bandwidth: float | None = None
        self.traffic: dict[str, dict[str, float]] = {}
        self._thread = threading.Thread(target=self._run, name="gffe-viewer-engine", daemon=True)
        self._news = threading.Condition()
        self._posted: dict[str, Any] = {}
        self._closing = self._beside = False
        self._results: dict[str, Result] = {}  # not polled yet, by role
        self._errors: deque[EngineError] = deque(maxlen=16)
        self._inspection: Inspection | None = None
        self._device: Device | None = None
        self._problem = ""  # of opening the device
        self._kernels: Kernels | None = None
        self._makers: dict[str, SlotMaker] = {}  # by role
        self._plan: deque[Request] = deque()  # to be made when there is nothing else to do
        self._surveys: deque[Request] = deque()  # the same, after that
        self._surveying: Request | None = None  # under way
        self._surveyed: deque[tuple[Request, Recipe, Result | None]] = deque()  # not polled yet
        self._hopeless: set[Request] = set()  # of those asked for ahead: cannot be made
        self._opened = 0  # sources
        self._scorer = Scorer(notify, lambda error: self._fail(error, "metrics", None))
        self._last: Request | None = None  # of role "a", computed last

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
        """Ask for a slot; replaces a request of its role that was not taken up yet. Ignored if it was meant for a
        `source` that is not the one any more. What is in the cache is made anew: look there first."""
        with self._news:
            if source in (None, self.source):
                self._posted["slot" if request.role == "a" else f"slot_{request.role}"] = request
                self._news.notify()

    def withdraw(self, role: str = "a") -> None:
        """What was submitted last is not wanted any more, if it was not taken up yet."""
        with self._news:
            self._posted.pop("slot" if role == "a" else f"slot_{role}", None)

    def prefetch(self, requests: Iterable[Request], source: FrameSource | None = None) -> None:
        """Have slots made for the cache, in this order, whenever there is nothing else to do; replaces what was planned
        before. Their role is to be "ahead". What fails there is left out without a word."""
        with self._news:
            if source in (None, self.source):
                self._plan = deque(request for request in requests if request not in self._hopeless)
                self._news.notify()

    def survey(self, requests: Iterable[Request], source: FrameSource | None = None) -> None:
        """Have slots made for `poll_survey` when nothing else is planned either; replaces those before."""
        with self._news:
            if source in (None, self.source):
                self._surveys = deque(request for request in requests if request != self._surveying)
                self._news.notify()

    def poll_survey(self) -> tuple[Request, Recipe, Result | None] | None:
        """The next slot made for a survey, and what it depends on; no result if it cannot be made."""
        with self._news:
            return self._surveyed.popleft() if self._surveyed else None

    def recipe(self, setup: Setup) -> Recipe:
        """What slots made with `setup` depend on now. May be called from any thread."""
        flight = self.source.flight if self.source is not None else 0
        kernels = setup.kernels or (self._kernels.identity if self._kernels is not None else "")
        return Recipe(self._opened, flight, replace(setup, kernels=""), kernels, weights_of(setup.options))

    @property
    def prefetching(self) -> bool:
        """Whether something is planned or made beside."""
        with self._news:
            return bool(self._plan) or self._beside

    def inspect(self, x: int, y: int, layers: frozenset[str] | None = None, request: Request | None = None) -> None:
        """Ask what the slot of `request`, or else the one last computed, holds at display pixel (x, y); `layers`: None
        for all."""
        self._post("inspection", (x, y, layers, request))

    def reload_kernels(self) -> None:
        """Build the kernels anew if their text changed, and the last slot with them."""
        self._post("kernels", None)

    def measure_bandwidth(self) -> None:
        """Measure `bandwidth`, once; takes a second, and 512 MiB on the device."""
        if self.bandwidth is None:
            self._post("bandwidth", None)

    def count_traffic(self, request: Request) -> None:
        """Count `traffic` for the slot of a request; reads some layers back."""
        self._post("traffic", request)

    def poll(self, role: str = "a") -> Result | EngineError | None:
        """What went wrong, oldest first, else the newest result of a role; each once. Errors are told with "a"."""
        with self._news:
            if self._errors and role == "a":
                return self._errors.popleft()
            return self._results.pop(role, None)

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
        self._makers, self._last = {}, None
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
                self._beside = bool(self._plan)
                if self._beside:
                    return "ahead", self._plan.popleft()
                if self._surveys:
                    self._surveying = self._surveys.popleft()
                    return "survey", self._surveying
                self._news.wait(WATCH_SECONDS)
        return "", None

    def _fail(self, error: Exception, kind: str, content: Any) -> None:
        message = str(error) if isinstance(error, GffeError) else f"{type(error).__name__}: {error}"
        serial = content.serial if isinstance(content, Request) else content[1] if kind == "source" else 0
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
        self._makers, self._last, self._hopeless = {}, None, set()
        self._scorer.clear()
        self.cache.clear()
        with self._news:
            for kind in ("slot", "slot_b", "inspection"):
                self._posted.pop(kind, None)
            self._plan.clear()
            self._surveys.clear()
            self._surveyed.clear()
            self._results, self._inspection = {}, None
            self._opened += 1
            self.source = source
        self._notify()

    def _do_watch(self, _) -> None:
        if self._kernels.have_changed():
            self._do_kernels(None)
        if self.source is None:
            return
        before = self.source.count
        if self.source.grow():
            for role in self._makers.keys() - {"a"}:  # their sources are not the one that has grown
                del self._makers[role]
            self.cache.forget(lambda key: key.slot >= (before - 1) * (key.recipe.setup.n + 1))
            self._notify()

    def _do_kernels(self, _) -> None:
        self._need_device()
        self.activity = "building kernels"
        changed = self._kernels.reload()
        self.build_error = self._kernels.error
        self.builds += changed
        if changed and self._makers:
            for maker in self._makers.values():
                maker.drop()
            self._hopeless = set()
            self._scorer.clear()
            with self._news:
                if self._last:
                    self._posted.setdefault("slot", self._last)
        self._notify()

    def _do_bandwidth(self, _) -> None:
        if self.bandwidth is None:
            self.bandwidth = Copier(self._need_device()).bandwidth()
            self._notify()

    def _do_traffic(self, request: Request) -> None:
        if self.source is not None:
            self.traffic = self._holding(request).must_move()
            self._notify()

    def _holding(self, request: Request) -> SlotMaker:
        """A maker whose buffers hold that slot, all layers of it."""
        maker = self._maker("a")
        if not maker.holds(request):
            maker.make(request, to_inspect=True)
            self._last = request
        return maker

    def _do_inspection(self, content) -> None:
        x, y, layers, request = content
        if self._last is None and request is None:
            return
        maker = self._maker("a") if request is None else self._holding(request)
        inspection = maker.inspect(x, y, layers)
        if inspection is not None:
            with self._news:
                self._inspection = inspection
            self._notify()

    def _do_slot(self, request: Request) -> None:
        self._need_device()
        if self.source is None:
            raise GffeError("nothing is open: expected a sequence or a built-in scene")
        if request.role == "a":
            self._last = request
        result = self._made(request)
        with self._news:
            self._results[request.role] = result
        self._notify()
        self.source.look_closer()

    _do_slot_b = _do_slot

    def _do_ahead(self, request: Request) -> None:
        """Make a slot beside; if something else is asked for meanwhile, it is given up and made later."""
        key = FrameKey(self.recipe(request.setup), request.slot)
        if self.cache.get(key, request.layers, request.metrics):
            return
        try:
            self._made(request)
        except Interrupted:
            with self._news:
                self._plan.appendleft(request)
        except GffeError:
            self._hopeless.add(request)  # who looks at that slot is told why
        self._notify()

    def _do_survey(self, request: Request) -> None:
        recipe, result = self.recipe(request.setup), None
        try:
            result = self._maker("ahead").make(request)
        except Interrupted:
            with self._news:
                self._surveys.appendleft(request)
                self._surveying = None
            return
        except GffeError:
            pass  # told by no result
        with self._news:
            self._surveying = None
            self._surveyed.append((request, recipe, result))
        self._notify()

    def _made(self, request: Request) -> Result:
        """The slot, which is kept in the cache from now on, if it is all of one recipe."""
        before = self.recipe(request.setup)
        result = self._maker(request.role).make(request)
        if self.cache.most and request.keep and before == self.recipe(request.setup):
            self.cache.put(FrameKey(before, request.slot), result)
        return result

    def _maker(self, role: str) -> SlotMaker:
        if role not in self._makers:
            source = self.source if role == "a" else self.source.sibling()
            check = self._check_beside if role == "ahead" else self._check
            self._makers[role] = SlotMaker(self._device, source, self._kernels, self._scorer, check)
        return self._makers[role]

    def _check(self) -> None:
        if self._closing:
            raise Closing

    def _check_beside(self) -> None:
        self._check()
        if self._posted or (self._plan and not self._beside):
            raise Interrupted
