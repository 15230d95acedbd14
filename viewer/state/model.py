"""State and decisions of the viewer, between the interface and the engine; no ImGui here."""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.options import Options
from ..engine import names
from ..engine.attached.program import FRAMES, RunningProgram
from ..engine.buffers import moved
from ..engine.doctor_worker import Doctor
from ..engine.engine import Engine, open_viewer_device
from ..engine.explain.pixel_explain_types import Link
from ..engine.figures import Figures, Measurements
from ..engine.messages import Failure, Frame, Key, Recipe, Setup
from ..engine.sources.attached import AttachedSource, FrozenSource, resolved
from ..engine.sources.opening import ScenePlan, make_source
from ..engine.sources.preview import Preview, Previewer, preview_of
from ..engine.sources.source import FrameSource
from ..engine.store import CACHE_MIB, Store, Want
from ..picture.current_frame import Contents
from ..picture.disocclusions import Disocclusions
from ..picture.display_settings import Looks
from ..picture.displays import Display
from ..picture.histogram import Histogram
from ..picture.invalid import InvalidPixels
from ..picture.legend_strip import Entry
from ..picture.legends import Legend
from ..picture.regions import Regions
from ..picture.selection import Selection
from ..picture.view import View
from ..picture.worst_pixels import WorstPixels
from .captions import Message, entries_of, frame_text, layer_text, slot_text
from .comparing import Comparison
from .navigation import Flight, Flyer, Walk
from .parameters import Parameters
from .playback import Playback
from .presets import Kept, KeptSettings, command_line, told
from .saving import RecordingWork, Subject, Work
from .settings import Settings
from .studies import Here, Studies
from .survey import Side, Survey
from .timings import Timings
from .undo import Undo
from .viewport import Framing, Pointing, Screen
from .wanting import Ahead, Needed, Picture, Showing

_SCENES = ScenePlan(480, 270, 0)
_OPTIONS = Options()
_LOOK_FOR_PROGRAM = 2.0  # seconds between looks for a program that has ended
BUILD_LETTERS = 6  # of the identity of a build


class Model:
    """State of the viewer.

    `update` is called once per frame of the interface; everything else is called by panels and actions in between.
    """

    def __init__(
        self, settings: Settings, *, device: str | None = None, n: int = 1, window: str | None = None,
        plan: ScenePlan = _SCENES, options: Options = _OPTIONS, save_settings: bool = True,
        check: bool = False, cache_mib: int = CACHE_MIB, start: bool = True,
    ):  # fmt: skip
        self.settings, self._save_settings, self.plan, self._check = settings, save_settings, plan, check
        self.store = Store(cache_mib << 20)
        self.engine = Engine(partial(open_viewer_device, device), self.store)
        if start:  # else there is no device, and nothing can be opened
            self.engine.start()
        self.contents = Contents()
        self.playback = Playback(n=n)
        self.ahead = Ahead(self.store, self.playback)
        self.parameters = Parameters(options, self.playback, window)
        self.undo = Undo(self.parameters, self.playback)
        self.view = View(names.FINAL, Display())
        self.framing = Framing(self.view)
        self.looks = Looks(self.contents, settings.displays)
        self.screen = Screen(self.contents, self.looks)
        self.kept = KeptSettings()
        self.comparison = Comparison(self.view, self.contents, self.looks, self.kept)
        self.regions = Regions(self.view, self.contents)
        self.disocclusions = Disocclusions(self.view, self.contents)
        self.histogram = Histogram(self.view, self.contents, self.looks)
        self.invalid = InvalidPixels(self.view, self.contents)
        self.showing = Showing(self.store, self._show, self._fail)
        self.measured = Measurements()
        self.survey = Survey(self.store, self.measured, self.playback)
        self.studies = Studies(self.store, self.measured.background)
        self.pointing = Pointing(self.store)
        self.walk = Walk(self.view, self.contents, self.playback, self.pointing)
        self.selection = Selection(self.contents)
        self.worst = WorstPixels(self.view, self.contents)
        self.needed = Needed(self.view, self.contents, self.regions, self.disocclusions, self.selection, self.worst)
        self.flyer: Flyer | None = None
        self.export: Work | None = None
        self.overview = False
        self.arrows = False
        self.measuring = False
        self.messages: list[Message] = []
        self.doctor: Doctor | None = None  # of the open source, once requested
        self.preview: Preview | None = None  # shown until the opened source has a result
        self.previewer: Previewer | None = None
        self.failure: str | None = None  # why the requested picture is not there
        self._inspection_fault = ""
        self.reload_fault = ""  # why the open source could not be read again
        self.notice = ""
        self.timings = Timings()
        self.program: RunningProgram | None = None  # that was attached to
        self.recipe = self.engine.recipe(self.setup)
        self._target = ""
        self._stopped: Picture | None = None  # by the user, while it was made
        self._awaits_program, self._looked_for_program = False, 0.0  # which was followed when it ended
        self._flights = itertools.count(1)
        self.keep_place = False
        self._closed = False
        self.playback.restore(settings.playback)
        self.parameters.restore(settings.options)
        self.comparison.restore(settings.compare)
        self.kept.restore(settings.kept)

    # ---- opening -----------------------------------------------------------------------------------------

    @property
    def source(self) -> Any:
        """Return the open FrameSource, or None."""
        return self.contents.source

    def open(self, target: str) -> None:
        """Open a folder with a sequence, or the built-in scene of that name, in the background; `update` notices when
        it is open."""
        self.failure = None
        self.notice = f"opening {target} …"
        self.previewer = preview_of(target) if self.source is None else None
        make = partial(
            make_source, target, self.parameters.window, self.plan, check=self._check, previewer=self.previewer
        )
        self.engine.open_source(make)

    def attach_to(self, name: str) -> None:
        """Follow the program attached as `name`, if there is one; else tell why not."""
        before = self.program
        try:
            self.attach(name.strip())
        except GffeError as error:
            self.say(str(error), error=True)
            return
        if before is not None:
            before.close()

    def _attach_again(self, now: float) -> None:
        """Follow a program that was followed when it ended, once it runs again."""
        ended = self.program is not None and self.program.ended
        if self._awaits_program and ended and now - self._looked_for_program > _LOOK_FOR_PROGRAM:
            self._looked_for_program = now
            assert self.program is not None  # it has ended
            with suppress(GffeError):
                self.attach(self.program.name, self.program.frames)
                self._awaits_program = False
                self.say(f"attached again to '{self.program.name}'")

    def attach(self, name: str, frames: int = FRAMES) -> None:
        """Follow the running program attached as `name`, which keeps its last `frames` rendered frames. Raises
        GffeError if there is none."""
        self.program = RunningProgram(name, frames)
        self.follow()

    def follow(self) -> None:
        """Show the program live, with its pipeline's options."""
        program = self.program
        assert program is not None  # as `attach` was called
        self.notice = f"attaching to {program.name} …"
        self.engine.open_source(lambda device: AttachedSource(program))

    def freeze(self) -> None:
        """Show the program's last rendered frames as they are now."""
        program = self.program
        assert program is not None
        self.engine.open_source(lambda device: FrozenSource(program, device))

    @property
    def follows(self) -> bool:
        """Whether a running program is displayed live."""
        return self.source is not None and self.source.follows

    @property
    def frozen(self) -> bool:
        """Whether a program's last frames are displayed."""
        return isinstance(self.source, FrozenSource)

    def reload(self) -> None:
        """Open the present source again, and stay at the same slot."""
        self.keep_place = True
        self.open(self._target)

    def opened(self, source: FrameSource) -> None:
        self.contents.open(source)
        self.parameters.open(source)
        self.undo.forget()
        self.notice, self.reload_fault, self._target = "", "", source.target
        for part in (
            self.showing, self.ahead, self.measured, self.survey, self.studies, self.walk, self.selection,
            self.disocclusions,
        ):  # fmt: skip
            part.forget()
        if self.export is not None:
            self.export.cancel()
        self.playback.open(source.count, source.fps, self.times(source.count), keep=self.keep_place)
        self.pointing.open(self.contents.size)
        self.doctor = None
        if self.keep_place and self.flying:
            self.playback.play()  # at another render rate, from where the camera is
        else:
            self.flyer = None
        if not self.keep_place:
            self.looks.forget()
            self.timings = Timings()
        self.comparison.drop_missing()
        self.framing.due = not self.keep_place
        self.keep_place = False
        if self.frozen:
            self.playback.n = source.generated
            self.playback.end()
        if source.target and not source.live:
            self.settings.add_recent(Path(self._target).expanduser())

    def times(self, count: int) -> list[float] | None:
        """Return the times of `count` rendered frames in seconds; None in a built-in scene, and while a running program
        is followed."""
        return None if self.source.live or self.follows else [self.source.time(k) for k in range(count)]

    # ---- one frame of the interface after the other ----------------------------------------------------------

    def update(self, now: float, canvas) -> None:
        """Take what is there, and say what is wanted. `now`: seconds of the playback clock; `canvas`: None without a
        window."""
        self.screen.canvas = canvas
        if self.previewer is not None and (preview := self.previewer.take()) is not None:
            self.preview = preview
            self.screen.preview(preview)
        self.undo.update(now)
        self._attach_again(now)
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
        ready = result.slot if result is not None and result.setup == self.setup else None
        if ready == self.playback.shown_for(self.playback.slot):
            ready = self.playback.slot
        due = self._due(self.playback.shown_for(self.playback.tick(now, ready).request))
        self._take_values()
        self.showing.update(due, self._passes, self.screen.ready or result is None)
        if self.follows and self.showing.shows_due:
            self.source.flight += 1  # another frame is awaited from now on
        self._derive(canvas)
        self.store.leave(sum(nbytes for name, nbytes in self.held.items() if name != "frames"))
        self.store.want(self._wants(now))
        if self.export is not None:
            self.advance_export(canvas)

    def _follow_source(self) -> None:
        """Take over another render rate that was chosen, more frames of the source, and options that a running program
        has changed."""
        if self.source.live and self.parameters.render_rate != self.plan.fps:
            self.plan = self.plan._replace(fps=self.parameters.render_rate)
            self.reload()
        if (count := self.source.count) != self.playback.count:
            self.playback.extend(count, self.times(count))
        result = self.contents.result
        current = self.follows and result is not None and result.setup == self.setup
        if current and self.setup.options != resolved(self.source.options):  # the program itself has changed them
            self.parameters.take(self.source.options, None)

    @property
    def _passes(self) -> bool:
        """Whether the picture changes by itself, or by dragging: then each one that is begun is shown."""
        return self.playback.playing or self.playback.scrubbing or self.flying or self.follows

    @property
    def _kept_b(self) -> Kept | None:
        """B's settings while anything of them is shown."""
        return None if self.overview or self.follows else self.comparison.second

    @property
    def _layers(self) -> frozenset[str]:
        """Names of layers of A that are read back now."""
        layers = self.needed.all() if self.overview else self.needed.of_first(self.measuring)
        return layers | (self.export.layers if self.export is not None else frozenset())

    def _due(self, slot: int) -> Picture:
        """Return the picture of a slot, as it is looked at now."""
        flyer = self.flyer if self.flying else None
        layers = self._layers
        slot = 0 if self.follows else slot
        if flyer is not None and (flyer.moved or flyer.slot != slot):
            flyer.moved, flyer.slot, flyer.flight = False, slot, next(self._flights)

        def want(recipe: Recipe, layers: frozenset[str]) -> Want:
            if flyer is not None:
                return Want(Key(replace(recipe, flight=flyer.flight), slot), layers, keep=False, pose=flyer.pose)
            return Want(Key(recipe, slot), layers, keep=not self.follows)

        kept = self._kept_b
        if kept is None:
            self.comparison.same_settings = False
            return Picture(want(self.recipe, layers))
        second = self.engine.recipe(kept.setup(self.n))
        self.comparison.same_settings = second == self.recipe
        return Picture(want(self.recipe, layers), want(second, self.needed.of_second(self.measuring)))

    def _wants(self, now: float) -> list[Want]:
        """Return everything that is wanted of the engine, the most urgent first."""
        showing, awaited = self.showing, self.showing.awaited
        if self.stopped:
            return []
        wants = list(showing.wants)
        if awaited is not None and self.inspects and not self.showing.failed:
            wants += self.pointing.wants(awaited.a.key, self.follows)
        wants += showing.following
        result, beside = self.contents.result, not (self.flying or self.overview or self.export or self.follows)
        kept = self.kept.b
        idle = not (self.flying or self.export or self.playback.playing or self.follows) and not showing.is_waiting
        a = Side(self.setup, self.recipe)
        b = None if kept is None else Side(kept.setup(self.n), self.engine.recipe(kept.setup(self.n)))
        here = Here(
            self.slot, a, b, tuple(self.contents.layers), self.view.a, self.pointing.picked,
            range(self.playback.first, self.playback.last + 1), self.source.exposure, self.engine.recipe,
            self.contents.frame_info,
        )  # fmt: skip
        wants += self.studies.update(here, idle and result is not None)
        if awaited is not None and result is not None:
            others = set() if awaited.b is None else {awaited.b.key.recipe}
            may_run = beside and showing.shows_due
            wants += self.ahead.wants(now, awaited.a, others, result.nbytes, may_run)
        self.survey.resets = sorted({0, *self.contents.resets})
        wants += self.survey.update(a, b if self.comparison.by_settings else None, self.source.exposure, idle)
        return wants

    def _take_values(self) -> None:
        """Take values of pixels, and figures, that became known."""
        fault = self.pointing.update()
        if fault and not self.showing.failed and fault != self._inspection_fault:
            self.say(fault, error=True)
            self._failed_attached()
        self._inspection_fault = fault
        self.measured.update()
        for fault in dict.fromkeys(self.measured.faults):
            self.say(fault, error=True)
        self.measured.faults.clear()

    def _derive(self, canvas) -> None:
        """Find what follows from the images that are shown."""
        self.disocclusions.update(canvas)
        self.invalid.update(canvas, self.playback.playing)
        faults = self.comparison.update(canvas), self.regions.update(canvas), self.selection.update()
        for fault in filter(None, faults):
            self.say(fault, error=True)
        found, reason = self.worst.update()
        if found is not None:
            self.walk.go_to_pixel(found.pixel)
            x, y = found.pixel
            self.say(f"error {found.error:.4g} at ({x}, {y}): number {found.rank} of the slot")
        elif reason:
            self.say(reason)

    def _show(self, result: Frame, second: Frame | None) -> None:
        """Set the displayed frames of A and B."""
        self.contents.take(result, second)
        self.failure = None
        self.previewer = self.preview = None
        if self.measuring:
            for made in filter(None, (result, second)):
                self.measured.measure(made, self.source.exposure)
        self._upload()
        self.timings.add(result)

    def _upload(self) -> None:
        if self.preview is None:
            self.screen.update({self.view.a, self.view.b or self.view.a})

    def _fail(self, failure: Failure, of_b: bool) -> None:
        """Take notice that A or B of the awaited picture cannot be made."""
        if of_b:
            self.say(f"B: {failure.error}", error=True)
            return
        self.failure = failure.error
        if failure.during == "network":  # goes on without it, until it is switched on again
            self.say(f"shading correction is off: {failure.error}", error=True)
            self.parameters.network_fault = failure.error
            self.failure = None
        else:
            self.say(failure.error, error=True)
            self._failed_attached()
            self.playback.pause()
        self.previewer = self.preview = None
        if self.export is not None:
            self.export.cancel()

    def _failed(self, failure: Failure) -> None:
        """Take notice of a failure of anything but a picture."""
        self.failure = failure.error
        self.say(failure.error, error=True)
        self.notice = failure.error if self.source is None else ""
        if failure.during == "source":
            self.reload_fault = failure.error if self.keep_place else self.reload_fault
            self.playback.pause()
            if self.export is not None:
                self.export.cancel()
        self.keep_place = False
        self.previewer = self.preview = None

    def _failed_attached(self) -> None:
        """Go on with the options of a running program that has refused others, and with its last frames if it has
        ended."""
        if self.follows and (program := self.program) is not None:
            if program.ended:
                self._awaits_program = True
                self.freeze()
            self.parameters.take(program.options, None)
            self.source.flight += 1

    def go_to(self, find: Callable[[], int | None]) -> None:
        """Go to the slot that `find`, a method of the survey, gives, and show a message about it."""
        slot, text = self.survey.search(find)
        if slot is not None:
            self.playback.seek(slot)
        self.say(text)

    def go_to_input(self, k: int, px: tuple[int, int]) -> None:
        """Look at pixel `px` of the rendered image of frame `k` of a sequence."""
        entry = self.source.sequence.rendered[k]
        x, y = moved((px[0] + 0.5, px[1] + 0.5), entry.render_camera, entry.display_camera)
        self.walk.follow(Link("", frame=k, pixel=(math.floor(x), math.floor(y))))

    def go_to_invalid(self) -> None:
        """Look at the next invalid pixel of the picture, after the picked one."""
        pixel = self.invalid.next(self.pointing.picked)
        if pixel is not None:
            self.walk.go_to_pixel(pixel)

    @property
    def inspects(self) -> bool:
        """Whether pixel values are wanted: cached frames are not computed for that during playback."""
        return not (self.from_cache and self.playback.playing)

    @property
    def from_cache(self) -> bool:
        """Whether the displayed frame came from the cache."""
        return self.showing.from_cache

    # ---- what is shown --------------------------------------------------------------------------------------------

    @property
    def metrics(self) -> dict[int, Figures]:
        """Return the figures of the present recipe, by slot."""
        return self.measured.of(self.recipe)

    def metrics_of_second(self) -> dict[int, Figures]:
        """Return the figures of B's settings, by slot; empty without B."""
        kept = self.kept.b
        return {} if kept is None else self.measured.of(self.engine.recipe(kept.setup(self.n)))

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

    @property
    def warnings(self) -> list[str]:
        """Warnings about the open source and the displayed frame."""
        result = self.contents.result
        return [*self.source.suspicions, *(result.warnings if result is not None else ())] if self.source else []

    def stop_computing(self) -> None:
        """Give up the picture that is being made, until another one is due; a second call goes on with it."""
        self._stopped = None if self.stopped else self.showing.awaited

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
        done, total = self.engine.progress
        return f"rendered frame {done + 1} of {total} …" if done + 1 < total else "computing …"

    @property
    def busy(self) -> bool:
        """Whether the engine works on anything that the picture waits for, or that was asked for."""
        return self.engine.busy or (self.showing.is_waiting and not self.stopped)

    @property
    def settled(self) -> bool:
        """Whether the displayed frame is the requested one."""
        result = self.contents.result
        if result is None:
            return False
        if self.follows:  # there is always another frame to come
            return (
                self.showing.shows_like_due
                and self.screen.ready
                and not (self.pointing.picked and self.pointing.story is None)
            )
        return (
            self.showing.shows_due
            and self._layers == result.layers
            and not self.engine.busy
            and (self.pointing.tells(result.key) or not self.inspects)
            and self.comparison.ready
            and self.regions.ready
            and self.selection.ready
            and not self.worst.due
            and self.screen.ready
        )

    @property
    def current(self) -> bool:
        """Whether a still picture shows the playhead's slot, made with the present settings, kernels and frames."""
        if self.contents.result is None or self.follows or self.flying or self.playback.playing:
            return True
        return self.showing.shows_slot_due

    @property
    def shows_values(self) -> bool:
        """Whether the values under the pointer belong to the displayed picture."""
        result = self.contents.result
        return result is not None and (self.follows or self.pointing.shows(result.key))

    @property
    def story_is_due(self) -> bool:
        """Whether the story of the picked pixel is still that of another picture."""
        result = self.contents.result
        return result is None or not (self.follows or self.pointing.tells(result.key))

    @property
    def builds(self) -> tuple[str, str]:
        """Return which kernels the displayed frames of A and B were made with, where these differ; else empty texts."""
        shown = self.contents.result, self.contents.second
        a, b = (frame.key.recipe.kernels if frame else "" for frame in shown)
        if not self.comparison.by_settings or a == b or not b:
            return "", ""
        return f"kernels {a[:BUILD_LETTERS]}   ", f"kernels {b[:BUILD_LETTERS]}   "

    @property
    def states(self) -> list[str]:
        """Return what keeps the picture from being that of the files on disk, as long as it does."""
        found, built = [], self.recipe.kernels[:BUILD_LETTERS]
        if self.engine.build_error:
            found.append(f"kernels on disk do not build: build {built} is shown")
        if self.reload_fault:
            found.append(f"as it was before it could not be read again: {self.reload_fault}")
        if self.source is not None and self.source.changed_on_disk:
            found.append("files on disk have changed: Ctrl+R reads them again")
        return found

    def keep_as_b(self) -> None:
        """Keep the present settings as B."""
        kept = self.kept.keep(self.setup, self.recipe.kernels)
        self.comparison.with_settings(kept.name)
        self.say(f"kept as B: {kept.name}. W wipes between A and B, D shows their difference")

    def take_b_from(self, place: str) -> None:
        """Compare with what is stored at `place`: kernels, with the present settings, or the pictures of a sequence."""
        folder = Path(place).expanduser().absolute()
        try:
            if next(folder.glob("*.cl"), None) is not None:
                kernels = self.engine.take_kernels(folder)
                kept = self.kept.keep(self.setup, kernels, f"{told(self.setup)}, kernels of {folder.name}")
            else:
                kept = self.kept.keep_stored(str(folder), self.setup.options)
        except (GffeError, OSError) as error:
            self.say(str(error), error=True)
            return
        self.comparison.with_settings(kept.name)
        if self.view.compare == "off":
            self.comparison.set("split")

    def take_second(self) -> None:
        """Go on with B's settings as A."""
        kept = self.kept.b
        assert kept is not None  # there is a B
        self.parameters.take(kept.options, kept.window)
        self.say(f"A has B's settings now: {kept.name}" + (", with the newest kernels" if kept.kernels else ""))

    def command_line(self, setup: Setup) -> str:
        """Return the shell command that makes the frames of `setup`."""
        return command_line(setup, self.source, self.plan.seed)

    def set(self, name: str, value: Any) -> None:
        """Set a parameter. Invalid values give a message."""
        try:
            self.parameters.set(name, value)
        except GffeError as error:
            self.say(str(error), error=True)

    # ---- display ---------------------------------------------------------------------------------------------

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
        """Return all layers that generated frames have, with their displays: tiles keep their places."""
        image = self.contents.image
        shown = [spec.name for spec in self.contents.layers if spec.of_generated or image(spec.name) is not None]
        return [(name, self.looks.of(name)) for name in shown]

    # ---- the camera ----------------------------------------------------------------------------------------

    @property
    def flying(self) -> bool:
        return self.flyer is not None and self.flyer.active

    def toggle_flying(self) -> None:
        if self.flyer is not None and self.flyer.active:
            self.flyer.active = False
        elif self.contents.result is not None:
            self.flyer = Flyer(self.contents.result.moment.camera)
            self.playback.play()

    def stop_flying(self) -> None:
        self.flyer = None
        self.store.want(())
        self.source.forget_flight()

    def fly(self, flight: Flight | None, now: float) -> None:
        """Steer the camera; `now`: of the clock that playback goes by, seconds."""
        if self.flyer is not None and flight is not None:
            self.flyer.steer(flight, now)

    # ---- saving --------------------------------------------------------------------------------------------

    @property
    def _subject(self) -> Subject:
        def legends() -> list[Entry]:
            return [*self._headings(), *self.legends()] if self.settings.legends else []

        return Subject(self.contents, self.playback, self.view, self.comparison.shown, legends, lambda: self.settled)

    def legends(self) -> list[Entry]:
        """Return the legends of the picture."""
        return entries_of(self.view, self.contents, self.looks, self.comparison)

    @property
    def frame_text(self) -> str:
        """The name of the displayed frame."""
        result = self.contents.result
        if result is None:
            return slot_text(self.slot, self.n)
        return frame_text(result.moment) if self.follows else slot_text(self.slot, result.setup.n)

    def _headings(self) -> list[Entry]:
        """Return what a saved picture shows: the frame, and the layers and settings of A and B."""
        view, settings = self.view, told(self.setup)
        shown = [("A", view.a, settings)]
        if view.compare != "off" and view.b:
            kept = self.kept.b if self.comparison.by_settings else None
            shown.append(("B", view.b, settings if kept is None else kept.name))
        texts = [f"{self.source.name}   {self.frame_text}"]
        for side, name, of in shown:
            spec = self.contents.spec(name)
            text = names.plain(name) if spec is None else layer_text(spec, self.looks.of(name))
            text = text if name == names.TRUTH else f"{text}   {of}"
            texts.append(f"{side}  {text}" if len(shown) > 1 else text)
        if view.mark_invalid and (found := self.invalid.text()):
            texts.append(f"{found}, checkered")
        return [Entry(text, Legend("none")) for text in texts]

    def save(self, work: Callable[[Subject], Work]) -> None:
        """Start saving in the background."""
        self.export = work(self._subject)

    def save_recording(self) -> None:
        """Start writing the program's last rendered frames: those that are frozen, else those up to now."""
        program = self.program
        assert program is not None
        try:
            sequence = self.source.sequence if self.frozen else program.recording()
        except GffeError as error:
            self.say(str(error), error=True)
            return
        self.export = RecordingWork(self._subject, sequence)

    def advance_export(self, canvas) -> None:
        export = self.export
        assert export is not None  # asked for only while there is one
        export.advance(canvas)
        if export.finished:
            if export.outcome:
                self.say(export.outcome, export.failed)
            self.export = None

    # ---- telling -------------------------------------------------------------------------------------------

    def examine(self) -> None:
        """Have the doctor look at the sequence."""
        self.doctor = Doctor(self.source.sequence)

    @property
    def marks(self) -> dict[int, str]:
        """Rendered frames with findings of the doctor."""
        return self.doctor.marks if self.doctor is not None else {}

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

    def remember(self, window_size: tuple[int, int]) -> None:
        """Write the settings."""
        if not self._save_settings:
            return
        self.settings.window_size = window_size
        if self.program is None:  # else they are the program's
            self.settings.playback = self.playback.preferences()
            self.settings.options = self.parameters.preferences()
        self.settings.compare = self.comparison.preferences()
        self.settings.kept = self.kept.preferences()
        warning = self.settings.save()
        if warning:
            print(warning, file=sys.stderr)

    def close(self) -> None:
        """Stop everything. A second call does nothing."""
        if self._closed:
            return
        self._closed = True
        if self.export is not None:
            self.export.close()
        for part in (
            self.comparison, self.regions, self.invalid, self.histogram, self.worst, self.selection, self.measured,
            self.engine,
        ):  # fmt: skip
            part.close()
        if self.program is not None:
            self.program.close()

    @property
    def left_working(self) -> bool:
        """Whether the device is at work although `close` was called."""
        return self._closed and self.engine.alive
