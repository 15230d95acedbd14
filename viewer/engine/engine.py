"""The engine thread: owns the device, the source of frames and the pipelines, and makes what the store is asked for.

Slot s shows rendered frame k = s // (n + 1) if j = s % (n + 1) is 0, else the frame extrapolated from it at
α = j / (n + 1). The interface never waits for this thread, nor this thread for the interface.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import pyopencl as cl

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.inference.network import NetworkError
from gffe_cl.engine.opencl.device import Device
from .messages import Closing, Failure, Frame, Interrupted, Recipe, Setup
from .reloading import WATCH_SECONDS, Kernels
from .slot_maker import SlotMaker, weights_of
from .sources.opening import open_viewer_device
from .sources.source import FrameSource
from .sources.stored import StoredSlots, version_of
from .store import Store, Want

_CLOSE_SECONDS = 2.0
_LONG = 32  # rendered frames to submit: for more of them a provisional slot is made first
_ACTIVITIES = {"source": "opening", "kernels": "building kernels"}


class Engine:
    """The viewer's computing thread.

    Parameters
    ----------
    open_the_device : callable
        Opens the device, on the thread.
    store : Store or None
        Where slots are wanted and put; None: a new one that keeps nothing.

    Attributes
    ----------
    source : FrameSource or None
        What was opened last.
    device_name : str
        Empty until it is open.
    activity : str
        What is being done besides making slots; empty if nothing, or something short.
    builds : int
        How often other kernels were taken into use.
    build_error : str or None
        Why the kernels on disk do not build, with file and line, in one line; the last good ones go on.
    build_log : str
        All that the compiler said of that, in its lines.
    cuts : dict
        Rendered frames that were found to be cuts so far, by recipe, whoever made their slots.
    wake : callable
        Called on the thread when something was made, or files that are watched have changed.
    """

    def __init__(self, open_the_device: Callable[[], Device] = open_viewer_device, store: Store | None = None):
        self.store = Store(0) if store is None else store
        self._open_the_device = open_the_device
        self.source: FrameSource | None = None
        self.device_name, self.activity = "", "opening the device"
        self.builds, self.build_error, self.build_log = 0, None, ""
        self.cuts: dict[Recipe, frozenset[int]] = {}
        self.wake: Callable[[], object] = lambda: None
        self._news = self.store.news
        self._orders: dict[str, Callable[[], None]] = {}
        self._failures: deque[Failure] = deque(maxlen=16)
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="gffe-viewer-engine", daemon=True)
        self._device: Device | None = None
        self._problem = ""  # of opening the device
        self._kernels: Kernels | None = None
        self._makers: list[SlotMaker] = []  # the first of them has `source`, all others a sibling of it
        self._maker_at_work: SlotMaker | None = None
        self._wanted: Want | None = None  # what is being made, or was last
        self._stored: StoredSlots | None = None  # the pictures of a setup that are not computed
        self._opened = 0  # sources

    # ---- for the interface ---------------------------------------------------------------------------------

    def start(self) -> None:
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether the thread runs; when it has ended, the device is idle."""
        return self._thread.is_alive()

    @property
    def busy(self) -> bool:
        """Whether anything but a slot is under way or waits."""
        with self._news:
            return bool(self.activity or self._orders)

    def close(self) -> None:
        """End the thread. Waits two seconds at most, even if a kernel takes longer."""
        with self._news:
            self._closing = True
            self._news.notify_all()
        if self._thread.is_alive():
            self._thread.join(_CLOSE_SECONDS)

    def recipe(self, setup: Setup) -> Recipe:
        """Return everything that slots made with `setup` depend on now. May be called from any thread."""
        kernels = setup.kernels or (self._kernels.identity if self._kernels is not None else "")
        version = version_of(setup.place) if setup.place else weights_of(setup.options)
        return Recipe(self._opened, replace(setup, kernels=""), kernels, version)

    def open_source(self, make: Callable[[Device], FrameSource]) -> None:
        """Open a source with `make` on the thread. Then it is `source`, and nothing of the one before is made any more.
        If it fails, the old source stays."""
        self._post("source", partial(self._do_source, make))

    def take_kernels(self, folder: Path) -> str:
        """Return what `Setup.kernels` calls those in another folder. Raises GffeError if it has none."""
        if self._kernels is None:
            raise GffeError(f"{folder}: kernels are built when the device is open")
        return self._kernels.take(folder)

    def reload_kernels(self) -> None:
        """Rebuild the kernels if their text changed."""
        self._post("kernels", self._do_kernels)

    @property
    def nbytes(self) -> int:
        """Bytes that pipelines and sources hold, mostly on the device."""
        return sum(maker.nbytes + maker.source.nbytes for maker in tuple(self._makers))

    @property
    def progress(self) -> tuple[int, int]:
        """Rendered frames that are submitted for the slot under way, and all that are needed."""
        return (0, 0) if self._maker_at_work is None else self._maker_at_work.progress

    def poll(self) -> Failure | None:
        """Return the oldest failure of anything but slots, once."""
        with self._news:
            return self._failures.popleft() if self._failures else None

    def _post(self, kind: str, do: Callable[[], None]) -> None:
        with self._news:
            self._orders[kind] = do
            self._news.notify_all()

    # ---- on the thread -----------------------------------------------------------------------------------

    def _run(self) -> None:
        kind, do = "device", self._do_device
        while kind:
            try:
                do()
            except Closing:
                break
            except Interrupted:
                pass  # something else comes first
            except Exception as error:
                self._fail(error, kind)
            self.activity = ""
            if kind != "watch":
                self.wake()
            kind, do = self._next()
        self._makers = []
        if self.source:
            self.source.close()
        if self._kernels:
            self._kernels.release()
        if self._device:
            self._device.queue.finish()

    def _fail(self, error: Exception, kind: str) -> None:
        """Note why something could not be made. Of a picture that is what is shown in its place."""
        want = self._wanted
        if kind == "slot" and want is not None and self.source is not None:
            if self._maker_at_work is not None and not want.key.recipe.setup.place:
                self._maker_at_work.drop()
            self.store.put(want, _failure(error, "inspection" if want.pixel else kind))
            self.source.look_closer()
            return
        failure = _failure(error, kind)
        if kind == "device":
            self._problem, self.device_name = failure.error, "no device"
        with self._news:
            self._failures.append(failure)

    def _next(self) -> tuple[str, Callable[[], None]]:
        """Return what is to be done next, and its kind, which is empty to end: look for changed files from time to
        time, orders, then the most urgent want."""
        watch_at = self._kernels.look_again_at if self._kernels else math.inf
        with self._news:
            while not self._closing:
                if time.monotonic() >= watch_at:
                    return "watch", self._do_watch
                for kind in self._orders:
                    self.activity = _ACTIVITIES[kind]
                    return kind, self._orders.pop(kind)
                if (want := self.store.next()) is not None:
                    self._wanted = want
                    return "slot", partial(self._do_want, want)
                self._news.wait(WATCH_SECONDS)
        return "", self._do_watch

    def _do_device(self) -> None:
        self._device = self._open_the_device()
        self.device_name = self._device.info.name
        self.activity = "building kernels"
        self._kernels = Kernels(self._device)
        self._do_kernels()

    def _need_device(self) -> Device:
        if self._device is None:
            raise GffeError(self._problem)
        return self._device

    def _do_source(self, make: Callable[[Device], FrameSource]) -> None:
        source = make(self._need_device())
        if self.source:
            self.source.close()
        self._maker_at_work = None
        for maker in self._makers:
            maker.drop()
        self._makers, self._stored, self.cuts = [], None, {}
        with self._news:
            self._opened += 1
            self.source = source
            self.store.open(self._opened)

    def _do_watch(self) -> None:
        if self._kernels is not None and self._kernels.have_changed():
            self._do_kernels()
            self.wake()
        if self.source is None:
            return
        before = self.source.count
        if self.source.grow():
            self.wake()
            for maker in self._makers[1:]:  # their sources are not the one that has grown
                maker.drop()
            del self._makers[1:]
            self.store.forget(lambda key: key.slot >= (before - 1) * (key.recipe.setup.n + 1))

    def _do_kernels(self) -> None:
        self._need_device()
        self.activity = "building kernels"
        assert self._kernels is not None
        self.builds += self._kernels.reload()
        self.build_log, self.build_error = self._kernels.log, self._kernels.error

    def _do_want(self, want: Want) -> None:
        """Make what is wanted."""
        source = self.source
        assert source is not None  # or nothing would be wanted of it
        self.store.put(want, self._inspected(want) if want.pixel else self._made(want))
        source.look_closer()

    def _made(self, want: Want) -> Frame:
        if want.key.recipe.setup.place:
            return self._read(want)
        for other in self.store.unseen():
            if (maker := self._maker(other, want)).steps_to(other.key) > _LONG:
                self.store.put(other.provisional, maker.make(other.provisional.key, other.layers))
        frame = self._maker(want, want).make(want.key, want.layers)
        known = self.cuts.get(want.key.recipe, frozenset())
        if not frame.cuts <= known:
            self.cuts[want.key.recipe] = known | frame.cuts
        return frame

    def _read(self, want: Want) -> Frame:
        assert self.source is not None
        stored, place, version = self._stored, want.key.recipe.setup.place, want.key.recipe.weights
        if stored is None or (stored.place, stored.version) != (place, version):
            self._stored = stored = StoredSlots(place, version)
        beside = self.store.beside(want)
        return stored.make(want.key, want.layers, self.source, {} if beside is None else beside.specs)

    def _inspected(self, want: Want):
        assert want.pixel is not None
        inspection = self._holding(want).inspect(*want.pixel)
        return Failure("outside of the display", "inspection") if inspection is None else inspection

    def _holding(self, want: Want) -> SlotMaker:
        """Return a maker whose buffers hold all layers of that slot, which it makes first if need be."""
        maker = next((maker for maker in self._makers if maker.holds(want.key)), None)
        if maker is None:
            maker = self._maker(want, want)
            maker.make(want.key, want.layers, to_inspect=True)
        return maker

    def _maker(self, want: Want, at_work: Want) -> SlotMaker:
        """Return the maker that is nearest to a slot, of those that hold no slot that is more urgent. It works for as
        long as `at_work` comes first."""
        source = self.source
        assert source is not None
        above = self.store.above(want) - {want.key}
        free = [maker for maker in self._makers if maker.key not in above]
        if not free and len(self._makers) > 1 and 0 < self.store.most < self.nbytes:
            free = self._makers[1:]  # what its last slot was is made again, if need be
        if not free:
            assert self._device is not None and self._kernels is not None
            own = source.sibling() if self._makers else source
            free = [SlotMaker(self._device, own, self._kernels, self._check)]
            self._makers += free
        maker = min(free, key=lambda maker: (maker.steps_to(want.key), maker.used_at))
        maker.check, self._maker_at_work = partial(self._check, at_work), maker
        return maker

    def _check(self, want: Want | None = None) -> None:
        """Raise Closing, or Interrupted if something else than this want comes first now."""
        if self._closing:
            raise Closing
        if want is not None and (self._orders or self.store.next() != want):
            raise Interrupted


def _failure(error: Exception, during: str) -> Failure:
    message = str(error) if isinstance(error, GffeError) else f"{type(error).__name__}: {error}"
    if isinstance(error, cl.Error):
        message = f"the device failed ({error}): cached frames stay; if it does not recover, restart the viewer"
    return Failure(message, "network" if isinstance(error, NetworkError) else during)
