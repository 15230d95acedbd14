"""Mailbox between the interface and the engine's thread: orders on one side, answers on the other."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any

from gffe_cl.engine.opencl.device import Device
from .messages import EngineError, Inspection, Recipe, Request, Result
from .reloading import WATCH_SECONDS
from .sources.source import FrameSource

_KINDS = {  # of posted messages, and the activity meanwhile
    "source": "opening",
    "kernels": "building kernels",
    "slot": "computing",
    "slot_b": "computing B",
    "inspection": "",
    "bandwidth": "measuring bandwidth",
    "traffic": "counting bytes that must move",
}


class Exchange:
    """The side of the engine that the interface sees; neither ever waits for the other.

    Attributes
    ----------
    source : FrameSource or None
        What was opened last.
    bandwidth : float or None
        GB/s of copying, once measured.
    activity : str
        What is being done; empty if nothing, or something short.
    """

    def __init__(self):
        self.source: FrameSource | None = None
        self.bandwidth: float | None = None
        self.activity = ""
        self._news = threading.Condition()
        self._posted: dict[str, Any] = {}
        self._closing = self._beside = False
        self._results: dict[str, Result] = {}  # not polled yet, by role
        self._errors: deque[EngineError] = deque(maxlen=16)
        self._inspection: Inspection | None = None
        self._plan: deque[Request] = deque()  # to be made when there is nothing else to do
        self._surveys: deque[Request] = deque()  # the same, after that
        self._surveying: Request | None = None  # under way
        self._surveyed: deque[tuple[Request, Recipe, Result | None]] = deque()  # not polled yet
        self._hopeless: set[Request] = set()  # of those asked for ahead: cannot be made

    @property
    def busy(self) -> bool:
        """Whether anything but an inspection is under way or waits."""
        with self._news:
            return bool(self.activity or self._posted.keys() - {"inspection"})

    def open_source(self, make: Callable[[Device], FrameSource], serial: int = 0) -> None:
        """Open a source with `make` on the thread. Then it is `source`, and earlier requests are dropped. If it
        fails, the old source stays."""
        self._post("source", (make, serial))

    def submit(self, request: Request, source: FrameSource | None = None) -> None:
        """Request a slot. It replaces a waiting request of its role. Ignored for a `source` that is not open any
        more. Cached slots are computed again: look into the cache first."""
        with self._news:
            if source in (None, self.source):
                self._posted["slot" if request.role == "a" else f"slot_{request.role}"] = request
                self._news.notify()

    def withdraw(self, role: str = "a") -> None:
        """Withdraw the last request, if it was not taken up yet."""
        with self._news:
            self._posted.pop("slot" if role == "a" else f"slot_{role}", None)

    def prefetch(self, requests: Iterable[Request], source: FrameSource | None = None) -> None:
        """Plan slots to make for the cache, in this order, when the thread is idle. It replaces the earlier plan.
        Their role is "ahead". Failures are ignored."""
        with self._news:
            if source in (None, self.source):
                self._plan = deque(request for request in requests if request not in self._hopeless)
                self._news.notify()

    def survey(self, requests: Iterable[Request], source: FrameSource | None = None) -> None:
        """Have slots made for `poll_survey` when nothing else is planned either. These replace the earlier ones."""
        with self._news:
            if source in (None, self.source):
                self._surveys = deque(request for request in requests if request != self._surveying)
                self._news.notify()

    def poll_survey(self) -> tuple[Request, Recipe, Result | None] | None:
        """Return the next slot of a survey and its dependencies; no result if it cannot be made."""
        with self._news:
            return self._surveyed.popleft() if self._surveyed else None

    def inspect(self, x: int, y: int, layers: frozenset[str] | None = None, request: Request | None = None) -> None:
        """Request the values at display pixel (x, y) of the slot of `request`, or of the last computed one.
        `layers`: None for all."""
        self._post("inspection", (x, y, layers, request))

    def reload_kernels(self) -> None:
        """Rebuild the kernels if their text changed, and compute the last slot with them."""
        self._post("kernels", None)

    def measure_bandwidth(self) -> None:
        """Measure `bandwidth`, once; takes a second, and 512 MiB on the device."""
        if self.bandwidth is None:
            self._post("bandwidth", None)

    def count_traffic(self, request: Request) -> None:
        """Count `traffic` for the slot of a request; reads some layers back."""
        self._post("traffic", request)

    def poll(self, role: str = "a") -> Result | EngineError | None:
        """Return the oldest error, else the newest result of a role; each once. Errors are returned with role "a"."""
        with self._news:
            if self._errors and role == "a":
                return self._errors.popleft()
            return self._results.pop(role, None)

    def poll_inspection(self) -> Inspection | None:
        with self._news:
            inspection, self._inspection = self._inspection, None
        return inspection

    def _post(self, kind: str, content: Any) -> None:
        with self._news:
            self._posted[kind] = content
            self._news.notify()

    # ---- on the engine's thread ----------------------------------------------------------------------------

    def _next(self, last: str, watch_at: float) -> tuple[str, Any]:
        """Return the next order, kinds taking turns; "watch" from `watch_at` on (of time.monotonic); an empty kind to
        end."""
        kinds = list(_KINDS)
        turns = kinds[kinds.index(last) + 1 :] + kinds if last in kinds else kinds
        with self._news:
            while not self._closing:
                if time.monotonic() >= watch_at:
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

    def _give_up(self, source: FrameSource) -> None:
        """Make `source` the current one. Results for others are dropped."""
        self._hopeless = set()
        with self._news:
            for kind in ("slot", "slot_b", "inspection"):
                self._posted.pop(kind, None)
            self._plan.clear()
            self._surveys.clear()
            self._surveyed.clear()
            self._results, self._inspection = {}, None
            self.source = source
