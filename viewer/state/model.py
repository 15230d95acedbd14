"""State and decisions of the viewer, between the interface and the engine; no ImGui here."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.inspection.explain.pixel_explain_types import Inspection
from gffe_cl.engine.options import Options
from ..engine.figures import Measurements, Timings
from ..engine.jobs import Derived, Jobs
from ..engine.messages import Failure, Key, Recipe, Setup
from ..engine.sources.opening import ScenePlan
from ..engine.sources.source import FrameSource
from ..engine.store import CACHE_MIB, Want
from ..picture.current_frame import Picture, Screen, Showing
from ..picture.looks import Histogram
from ..picture.shown_numbers import largest, sides_of, statistics
from .captions import Captions, Message
from .choices import Choices
from .comparing import BUILD_LETTERS, Sides
from .document import Doctor, Document
from .navigation import Pointing, Walk
from .playback import Playback
from .saving import Saving, Subject
from .settings import Settings
from .studies import Here, Studies
from .survey import Survey

_SCENES = ScenePlan(480, 270, 0)
_OPTIONS = Options()


class Model:
    """State of the viewer: the open `document`, the `choices` of the user, and what follows from both.

    `update` is called once per frame of the interface; everything else is called by panels and actions in between.
    """

    def __init__(
        self,
        settings: Settings,
        *,
        device: str | None = None,
        n: int = 1,
        window: str | None = None,
        plan: ScenePlan = _SCENES,
        options: Options = _OPTIONS,
        save_settings: bool = True,
        check: bool = False,
        cache_mib: int = CACHE_MIB,
        start: bool = True,
    ):
        self.playback, self.settings, self._save_settings = Playback(n=n), settings, save_settings
        self.document = document = Document(self.playback, device, plan, check, cache_mib)
        self.engine, self.store, self.contents = document.engine, document.store, document.contents
        if start:  # else there is no device, and nothing can be opened
            self.engine.start()
        self._background = beside = Jobs("beside")  # of all that follows from what is shown
        self.choices = choices = Choices(settings, options, self.playback, window, self.contents, beside)
        self.view, self.framing, self.looks = choices.view, choices.framing, choices.looks
        self.parameters, self.kept, self.comparison = choices.parameters, choices.kept, choices.comparison
        self.messages: list[Message] = []
        self.screen = Screen(self.contents)
        self.histogram = Histogram(self.view, self.contents, self.looks, beside)
        self.showing = Showing(self.store, self.contents, self._fail, beside)
        self.measured = Measurements(beside)
        self.survey = Survey(self.store, self.measured, self.playback)
        self.studies = Studies(self.store, beside)
        self.pointing = Pointing(self.store, self.contents)
        self.walk = Walk(self.view, self.contents, self.playback, self.pointing)
        self.sides = Sides(self.engine, self.parameters, self.kept, self.comparison, self.say)
        self.captions = Captions(self.contents, self.view, self.looks, self.comparison, self.playback)
        subject = Subject(self.contents, self.playback, self.view, self.comparison.shown, lambda: self.settled)
        self.saving = Saving(subject, self.say)
        self._inspection_fault, self._statistics = "", Derived(beside)
        self.timings = Timings()
        self.recipe = self.engine.recipe(self.setup)
        self._stopped: Picture | None = None  # by the user, while it was made
        self._closed = False

    # ---- opening -----------------------------------------------------------------------------------------

    @property
    def source(self) -> Any:
        """Return the open FrameSource, or None."""
        return self.contents.source

    def open(self, target: str) -> None:
        """Open a folder with a sequence, or the built-in scene of that name, in the background; `update` notices when
        it is open."""
        self.document.open(target, self.parameters.window)

    def reload(self) -> None:
        """Open the present source again, and stay at the same slot."""
        self.document.keep_place = True
        self.open(self.document.target)

    def opened(self, source: FrameSource) -> None:
        document, keep_place = self.document, self.document.keep_place
        document.take(source)
        self.parameters.open(source)
        for part in (self.showing, self.measured, self.survey, self.studies, self.walk):
            part.forget()
        self.saving.cancel()
        self.playback.open(source.count, source.fps, document.times(source.count), keep=keep_place)
        self.pointing.open(self.contents.size)
        if not keep_place:
            self.looks.forget()
            self.timings = Timings()
        self.comparison.drop_missing()
        self.framing.due = not keep_place
        document.keep_place = False
        if source.target and not source.live:
            self.settings.add_recent(Path(source.target).expanduser())

    # ---- one frame of the interface after the other ----------------------------------------------------------

    def update(self, now: float, canvas) -> None:
        """Take what is there, and say what is wanted. `now`: seconds of the playback clock; `canvas`: None without a
        window."""
        self.screen.canvas = canvas
        if (opened := self.engine.source) is not None and opened is not self.source:
            self.opened(opened)
        if self.source is not None:
            self._follow_source()
        self._upload()
        self.recipe = self.engine.recipe(self.setup)
        while (failure := self.engine.poll()) is not None:
            self._failed(failure)
        if self.source is None:
            return
        self.contents.cuts = self.engine.cuts.get(self.recipe, frozenset())
        result = self.contents.result
        is_ready = result is not None and result.setup == self.setup and not self.showing.is_preview
        ready = result.slot if result is not None and is_ready else None
        due = self._due(self.playback.tick(now, ready).request)
        self._take_values()
        if self.showing.update(due, self._passes and not self.stopped, self.screen.ready or result is None):
            self._shown()
        if fault := self.comparison.update(canvas):
            self.say(fault, error=True)
        self.store.leave(sum(nbytes for name, nbytes in self.held.items() if name != "frames"))
        self.store.want(self._wants(now))
        self.saving.advance(canvas)

    def _follow_source(self) -> None:
        """Take over another render rate that was chosen, and more frames of the source."""
        document = self.document
        if self.source.live and self.parameters.render_rate != document.plan.fps:
            document.plan = document.plan._replace(fps=self.parameters.render_rate)
            self.reload()
        if (count := self.source.count) != self.playback.count:
            self.playback.extend(count, document.times(count))

    @property
    def _passes(self) -> bool:
        """Whether the picture changes by playing or dragging: then each one that is begun is shown, of dragging at
        least provisionally."""
        return self.playback.playing or (self.playback.scrubbing and not self.showing.is_preview)

    @property
    def _layers(self) -> frozenset[str]:
        """Names of layers of A that are read back now."""
        return self.choices.layers() | (self.saving.work.layers if self.saving.work is not None else frozenset())

    def _due(self, slot: int) -> Picture:
        """Return the picture of a slot, as it is looked at now."""
        layers = self._layers

        def want(recipe: Recipe, layers: frozenset[str], slot: int = slot) -> Want:
            return Want(Key(recipe, slot), layers, preview=True)

        setup, other = self.choices.second, self.comparison.slot_of_b(slot, self.n, self.playback.count)
        if setup is None or other is None:
            self.comparison.same_settings = False
            return Picture(want(self.recipe, layers))
        second = self.engine.recipe(setup)
        self.comparison.same_settings = second == self.recipe
        of_b = want(second, self.choices.layers_of_second(), other)
        return Picture(want(self.recipe, layers), of_b, self.choices.follows)

    def _wants(self, now: float) -> list[Want]:
        """Return everything that is wanted of the engine, the most urgent first."""
        showing, awaited = self.showing, self.showing.awaited
        if self.stopped:
            return []
        wants = list(showing.wants)
        if awaited is not None and self.inspects and not self.showing.failed:
            wants += self.pointing.wants(awaited.a.key)
        wants += showing.following
        result, beside = self.contents.result, not (self.choices.overview or self.saving.work)
        kept = self.kept.b
        idle = not (self.saving.work or self.playback.playing) and not showing.is_waiting
        a, b = self.recipe, None if kept is None else self.engine.recipe(kept.setup(self.n))
        slots, contents = range(self.playback.first, self.playback.last + 1), self.contents
        shown, exposure = (self.view.a, self.pointing.picked, slots), self.source.exposure
        info = exposure, self.engine.recipe, contents.frame_info
        other = self.comparison.slot_of_b(self.slot, self.n, self.playback.count) if self.comparison.neighbor else None
        sides = (self.slot, a, b) if other is None else (other, a, a)
        here = Here(self.slot, *sides, tuple(contents.layers), *shown, *info)
        wants += self.studies.update(here, idle and result is not None)
        if awaited is not None and result is not None:
            others = set() if awaited.b is None else {awaited.b.key.recipe}
            may_run = beside and showing.shows_due
            wants += self.document.ahead.wants(now, awaited.a, others, result.nbytes, may_run)
        if self.document.scan is not None:
            self.document.scan.update(idle and result is not None)
        self.survey.resets = sorted({0, *self.contents.resets})
        wants += self.survey.update(a, b if self.comparison.by_settings else None, self.source.exposure, idle)
        return wants

    def _take_values(self) -> None:
        """Take values of pixels, and figures, that became known."""
        fault = self.pointing.update()
        if fault and not self.showing.failed and fault != self._inspection_fault:
            self.say(fault, error=True)
        self._inspection_fault = fault
        self.measured.update()
        for fault in dict.fromkeys(self.measured.faults):
            self.say(fault, error=True)
        self.measured.faults.clear()

    def _shown(self) -> None:
        """Note what follows from another picture that is shown."""
        result, second = self.contents.result, self.contents.second
        assert result is not None
        self.document.failure = None
        if self.choices.measuring and not result.key.provisional:
            for made in filter(None, (result, second if self.comparison.by_settings else None)):
                self.measured.measure(made, self.source.exposure)
        self._upload()
        if not self.showing.is_preview:
            self.timings.add(result)

    def _upload(self) -> None:
        self.screen.update({self.view.a, self.view.b or self.view.a})

    def _fail(self, failure: Failure, of_b: bool) -> None:
        """Take notice that A or B of the awaited picture cannot be made."""
        if of_b:
            self.say(f"B: {failure.error}", error=True)
            return
        self.document.failure = failure.error
        if failure.during == "network":  # goes on without it, until it is switched on again
            self.say(f"shading correction is off: {failure.error}", error=True)
            self.parameters.network_fault = failure.error
            self.document.failure = None
        else:
            self.say(failure.error, error=True)
            self.playback.pause()
        self.saving.cancel()

    def _failed(self, failure: Failure) -> None:
        """Take notice of a failure of anything but a picture."""
        self.document.fail(failure.error, failure.during == "source")
        self.say(failure.error, error=True)
        if failure.during == "source":
            self.playback.pause()
            self.saving.cancel()

    def go_to(self, find: Callable[[], int | None]) -> None:
        """Go to the slot that `find`, a method of the survey, gives, and show a message about it."""
        slot, text = self.survey.search(find)
        if slot is not None:
            self.playback.seek(slot)
        self.say(text)

    def go_to_fault(self, step: int) -> None:
        """Go to the next (1) or previous (-1) frame that is marked on the timeline, and say why."""
        faults, k, scan = self.document.faults, self.playback.slot // (self.n + 1), self.document.scan
        so_far = f" of the {scan.done} frames looked at so far" if scan is not None and scan.busy else ""
        if not faults:
            self.say(f"no frame is marked{so_far}")
            return
        beyond = [frame for frame in faults if (frame - k) * step > 0]
        frame = min(beyond or faults, key=lambda one: one * step)
        self.playback.seek(frame * (self.n + 1))
        place = f"{list(faults).index(frame) + 1} of {len(faults)} marked frames{so_far}"
        self.say(
            f"rendered frame {frame} ({place}): " + "; ".join(f"{of}: {text}" for of, text in faults[frame].items())
        )

    def go_to_largest(self) -> None:
        """Look at the pixel with the largest difference or error that is shown, and show a message about it."""
        found = largest(self.comparison.shown(), self.contents, self.comparison.flip_map)
        if found is None:
            self.say("A and B are equal here")
            return
        self.walk.go_to_pixel(found[0])
        self.say(f"largest: {found[1]:.4g} at ({found[0][0]}, {found[0][1]})")

    def statistics(self) -> list[tuple[str, list[float], float]]:
        """Return the statistics of the shown layers in the marked rectangle, as far as they are known."""
        view, rectangle = self.comparison.shown(), self.pointing.rectangle
        key = self.contents.changes, view.a, view.b, view.compare, view.a_display.plane, rectangle
        made = self._statistics.get(key, statistics, sides_of(view, self.contents), rectangle)
        return made if made and self._statistics.ready else []

    @property
    def inspects(self) -> bool:
        """Whether pixel values are wanted: cached frames are not computed for that during playback."""
        return not (self.showing.from_cache and self.playback.playing)

    # ---- what is shown --------------------------------------------------------------------------------------------

    @property
    def n(self) -> int:
        """Generated frames after each rendered one."""
        return self.playback.n

    @property
    def slot(self) -> int:
        result = self.contents.result
        return result.slot if result is not None else self.playback.slot

    @property
    def setup(self) -> Setup:
        return self.parameters.setup

    def stop_computing(self) -> None:
        """Give up the picture that is being made, and playing, until another one is due; a second call goes on with
        it."""
        if self.stopped:
            self._stopped = None
            return
        self.playback.pause()
        self._stopped = self.showing.skip()

    @property
    def stopped(self) -> bool:
        """Whether the user has given up the picture that is awaited."""
        return self._stopped is not None and self._stopped == self.showing.awaited

    @property
    def held(self) -> dict[str, int]:
        """Bytes that are held, by where."""
        canvas = self.screen.canvas
        textures = getattr(canvas, "nbytes", 0)
        return {"frames": self.store.nbytes, "pipelines": self.engine.nbytes, "textures": textures}

    @property
    def waiting_text(self) -> str:
        """Return what the picture waits for, in words."""
        if self.stopped:
            return "stopped: Ctrl+. goes on"
        (done, total), kind = self.engine.progress, "provisional picture: " if self.showing.is_preview else ""
        return f"{kind}rendered frame {done + 1} of {total} …" if done + 1 < total else f"{kind}computing …"

    @property
    def busy(self) -> bool:
        """Whether the engine works on anything that the picture waits for, or that was asked for."""
        waits = self.showing.is_waiting and not self.stopped
        return self.engine.busy or waits

    @property
    def at_work(self) -> bool:
        """Whether something changes by itself, is made or measured; frames that are looked at in idle time apart."""
        beside = self.works_beside or self._background.busy or not self.comparison.ready
        return self.moves or self.busy or beside or self.document.ahead.waits

    @property
    def moves(self) -> bool:
        """Whether each frame of the interface goes on with something."""
        return self.playback.playing or self.saving.work is not None

    @property
    def works_beside(self) -> bool:
        """Whether frames are being measured or saved, or the doctor examines the sequence."""
        doctor = self.document.doctor
        examines = doctor is not None and not doctor.done
        return self.survey.busy or self.studies.busy or self.saving.work is not None or examines

    @property
    def settled(self) -> bool:
        """Whether the displayed frame is the requested one."""
        result = self.contents.result
        if result is None:
            return False
        return (
            self.showing.shows_due
            and self._layers == result.layers
            and not self.engine.busy
            and (not self.pointing.story_is_due or not self.inspects)
            and self.comparison.ready
            and self.screen.ready
        )

    @property
    def current(self) -> bool:
        """Whether a still picture shows the playhead's slot, made with the present settings, kernels and frames."""
        if self.showing.is_preview:
            return False
        if self.contents.result is None or self.playback.playing:
            return True
        return self.showing.shows_slot_due

    @property
    def values(self) -> tuple[Inspection | None, bool]:
        """Return the values of the picked pixel, else of the one under the pointer; and whether they are still those of
        another picture."""
        found, stale = self.pointing.values
        return found, stale or not self.current

    @property
    def states(self) -> list[str]:
        """Return what keeps the picture from being that of the files on disk, as long as it does."""
        return self.document.states(self.recipe.kernels[:BUILD_LETTERS])

    def set(self, name: str, value: Any) -> None:
        """Set a parameter. Invalid values give a message."""
        try:
            self.parameters.set(name, value)
        except GffeError as error:
            self.say(str(error), error=True)

    # ---- display ---------------------------------------------------------------------------------------------

    def show_layer(self, name: str) -> None:
        self.view.a = name

    # ---- telling -------------------------------------------------------------------------------------------

    def say(self, text: str, error: bool = False) -> None:
        self.messages = [*self.messages[-20:], Message(text, "error" if error else "note")]

    def lately(self, now: float, seconds: dict[str, float]) -> list[Message]:
        """Return the messages that were shown first at most `seconds` ago, which are given by their kind."""
        found = []
        for message in self.messages:
            message.since = now if message.since is None else message.since
            if now - message.since < seconds.get(message.kind, 0.0):
                found.append(message)
        return found

    def dismiss_messages(self) -> None:
        """Take all messages away that stand over the picture."""
        for message in self.messages:
            message.dismissed = True

    def examine(self) -> None:
        """Have the doctor look at the sequence."""
        self.document.doctor = Doctor(self.source.sequence)

    def remember(self, window_size: tuple[int, int]) -> None:
        """Write the settings."""
        warning = self.choices.remember(window_size) if self._save_settings else None
        if warning:
            print(warning, file=sys.stderr)

    def close(self) -> None:
        """Stop everything. A second call does nothing."""
        if self._closed:
            return
        self._closed = True
        self.saving.close()
        self.document.close()
        self._background.close()
        self.engine.close()

    @property
    def left_working(self) -> bool:
        """Whether the device is at work although `close` was called."""
        return self._closed and self.engine.alive
