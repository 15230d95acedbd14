"""The engine thread: owns the device, the source of frames and the pipeline, and computes slots for the interface.

Slot s shows rendered frame k = s // (n + 1) if j = s % (n + 1) is 0, else the frame extrapolated from it at
α = j / (n + 1). The interface posts requests and polls for answers; neither ever waits.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pyopencl as cl

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.inference.network import NetworkError
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.timing.bench import Copier
from .cache import FrameCache, FrameKey
from .mailbox import Exchange
from .messages import Closing, EngineError, Interrupted, Metrics, Recipe, Request, Result, Setup
from .metric_worker import Scorer
from .reloading import Kernels
from .slot_renderer import SlotMaker, weights_of
from .sources.attached import AttachedSource, RemoteSlots
from .sources.opening import open_viewer_device

_CLOSE_SECONDS = 2.0


class Engine(Exchange):
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
    device_name : str
        Empty until it is open.
    builds : int
        How often other kernels were taken into use.
    build_error : str or None
        Why the kernels on disk do not build, with file and line, in one line; the last good ones go on.
    build_log : str
        All that the compiler said of that, in its lines.
    cuts : dict
        Rendered frames that were found to be cuts so far, by recipe, whoever made their slots.
    traffic : dict
        Bytes per display pixel, by stage and kernel, that a slot had to move, once counted.
    """

    def __init__(
        self,
        open_the_device: Callable[[], Device] = open_viewer_device,
        notify: Callable[[], None] = lambda: None,
        cache: FrameCache | None = None,
    ):
        super().__init__()
        self.cache = FrameCache(0) if cache is None else cache
        self._open_the_device, self._notify = open_the_device, notify
        self.device_name, self.activity = "", "opening the device"
        self.builds, self.build_error, self.build_log = 0, None, ""
        self.traffic: dict[str, dict[str, float]] = {}
        self.cuts: dict[Recipe, frozenset[int]] = {}
        self._thread = threading.Thread(target=self._run, name="gffe-viewer-engine", daemon=True)
        self._device: Device | None = None
        self._problem = ""  # of opening the device
        self._kernels: Kernels | None = None
        self._makers: dict[str, SlotMaker | RemoteSlots] = {}  # by role
        self._opened = 0  # sources
        self._scorer = Scorer(notify, lambda error: self._fail(error, "metrics", None))
        self._last: Request | None = None  # of role "a", computed last

    def start(self) -> None:
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether the thread runs; when it has ended, the device is idle."""
        return self._thread.is_alive()

    def close(self) -> None:
        """End the thread. Waits two seconds at most, even if a kernel takes longer."""
        with self._news:
            self._closing = True
            self._news.notify()
        self._scorer.close()
        if self._thread.is_alive():
            self._thread.join(_CLOSE_SECONDS)

    def recipe(self, setup: Setup) -> Recipe:
        """Return everything that slots made with `setup` depend on now. May be called from any thread."""
        flight = self.source.flight if self.source is not None else 0
        kernels = setup.kernels or (self._kernels.identity if self._kernels is not None else "")
        return Recipe(self._opened, flight, replace(setup, kernels=""), kernels, weights_of(setup.options))

    def poll_metrics(self) -> Metrics | None:
        """Return the next new metrics. Those of a slot arrive one by one, together with the earlier ones."""
        return self._scorer.take()

    # ---- on the thread -----------------------------------------------------------------------------------

    def _run(self) -> None:
        kind, content = "device", None
        while kind:
            try:
                getattr(self, f"_do_{kind}")(content)
            except Closing:
                break
            except Interrupted:
                pass  # another source is to be opened
            except Exception as error:
                self._fail(error, kind, content)
            self.activity = ""
            watch_at = self._kernels.look_again_at if self._kernels else math.inf
            kind, content = self._next(kind, watch_at)
        self._makers, self._last = {}, None
        if self.source:
            self.source.close()
        if self._kernels:
            self._kernels.release()
        if self._device:
            self._device.queue.finish()

    def _fail(self, error: Exception, kind: str, content: Any) -> None:
        message = str(error) if isinstance(error, GffeError) else f"{type(error).__name__}: {error}"
        if isinstance(error, cl.Error):
            message = f"the device failed ({error}): cached frames stay; if it does not recover, restart the viewer"
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
        self._makers, self._last = {}, None
        self._scorer.clear()
        self.cache.clear()
        self.cuts = {}
        self._opened += 1
        self._give_up(source)
        self._notify()

    def _do_watch(self, _) -> None:
        if self._kernels is not None and self._kernels.have_changed():
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
        assert self._kernels is not None
        changed = self._kernels.reload()
        self.build_log, self.build_error = self._kernels.log, self._kernels.error
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

    def _holding(self, request: Request) -> SlotMaker | RemoteSlots:
        """Return the maker of role "a" whose buffers hold all layers of that slot, which it makes first if need be."""
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
        if inspection is not None and maker.last is not None:
            with self._news:
                self._inspection = replace(inspection, recipe=self.recipe(maker.last.setup))
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
        """Make a slot in advance. A new request interrupts it; then it is made later."""
        key = FrameKey(self.recipe(request.setup), request.slot)
        if self.cache.get(key, request.layers, request.metrics):
            return
        try:
            self._made(request)
        except Interrupted:
            with self._news:
                self._plan.appendleft(request)
        except GffeError:
            self._hopeless.add(request)  # the display of that slot shows the reason
        self._notify()

    def _do_survey(self, request: Request) -> None:
        recipe, result = self.recipe(request.setup), None
        try:
            result = self._noted(recipe, self._maker("ahead").make(request))
        except Interrupted:
            with self._news:
                self._surveys.appendleft(request)
                self._surveying = None
            return
        except GffeError:
            pass  # reported by no result
        with self._news:
            self._surveying = None
            self._surveyed.append((request, recipe, result))
        self._notify()

    def _made(self, request: Request) -> Result:
        """Return the computed slot. It is stored in the cache if the request wants that and its dependencies did not
        change meanwhile."""
        before = self.recipe(request.setup)
        result = self._noted(before, self._maker(request.role).make(request))
        if self.cache.most and request.keep and before == self.recipe(request.setup):
            self.cache.put(FrameKey(before, request.slot), result)
        return result

    def _noted(self, recipe: Recipe, result: Result) -> Result:
        """Note the cuts that were found on the way to a slot, and return the slot with its recipe."""
        known = self.cuts.get(recipe, frozenset())
        if not result.cuts <= known:
            self.cuts[recipe] = known | result.cuts
        return replace(result, recipe=recipe)

    def _maker(self, role: str) -> SlotMaker | RemoteSlots:
        assert self.source is not None
        if role not in self._makers and isinstance(self.source, AttachedSource):
            self._makers[role] = RemoteSlots(self.source, self._check_while_waiting)
        elif role not in self._makers:
            assert self._device is not None and self._kernels is not None
            source = self.source if role == "a" else self.source.sibling()
            check = self._check_beside if role == "ahead" else self._check
            self._makers[role] = SlotMaker(self._device, source, self._kernels, self._scorer, check)
        return self._makers[role]

    def _check(self) -> None:
        if self._closing:
            raise Closing

    def _check_while_waiting(self) -> None:
        """Raise Interrupted if another source is to be opened, Closing if the engine closes: an attached program may be
        stopped for long."""
        self._check()
        if "source" in self._posted:
            raise Interrupted

    def _check_beside(self) -> None:
        self._check()
        if self._posted or (self._plan and not self._beside):
            raise Interrupted
