"""Loop over frames of the interface: take finished results from the engine, and request what is due."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..engine.messages import EngineError, Request, Result
from ..engine.sources.attached import resolved

if TYPE_CHECKING:
    from .model import Model


class Loop:
    """Moves a model on. Panels and actions change the model in between."""

    def __init__(self, model: Model):
        self._model = model
        self._was_playing = False

    def update(self, now: float, canvas) -> None:
        """Move the model on to `now`, seconds of the playback clock. `canvas`: None without a window."""
        model = self._model
        model.screen.canvas = canvas
        if model.previewer is not None and (preview := model.previewer.take()) is not None:
            model.preview = preview
            model.screen.preview(preview)
        model.screen.proceed()
        if (opened := model.engine.source) is not None and opened is not model.source:
            model.opened(opened)
        if model.source is not None:
            self._follow_source()
        model.recipe = model.engine.recipe(model.setup)
        model.contents.cuts = model.engine.cuts.get(model.recipe, frozenset())
        self._take_answers()
        if model.source is None:
            return
        model.second.compare_with(None if model.overview or model.follows else model.comparison.second)
        kept = model.second.kept
        model.comparison.same_settings = kept is not None and model.engine.recipe(kept.setup(model.n)) == model.recipe
        model.filling.others = frozenset() if kept is None else frozenset({model.engine.recipe(kept.setup(model.n))})
        result, ready = model.contents.result, None
        if result is not None and result.request.setup == model.setup:
            ready = result.request.slot
        self._ask(model.playback.tick(now, ready).request)
        model.disocclusions.update(canvas)
        model.invalid.update(canvas, model.playback.playing)
        faults = model.comparison.update(canvas), model.regions.update(canvas), model.selection.update()
        for fault in filter(None, faults):
            model.say(fault, error=True)
        self._find_worst()
        model.asking.fill(now, model.recipe, not (model.flying or model.overview or model.export or model.follows))
        kept = model.kept.b if model.comparison.by_settings else None
        idle = not (model.flying or model.export or model.playback.playing or model.second.waits or model.follows)
        model.survey.resets = sorted({0, *model.contents.resets})
        model.survey.update(model.setup, kept and kept.setup(model.n), model.source.exposure, idle)
        if self._was_playing and not model.playback.playing and model.from_cache:
            model.pointing.ask_again()
        self._was_playing = model.playback.playing
        if model.export is not None:
            model.advance_export(canvas)

    def _find_worst(self) -> None:
        """Look at the worst pixel that was asked for, once it is known."""
        model = self._model
        found, reason = model.worst.update()
        if found is not None:
            model.walk.go_to_pixel(found.pixel)
            x, y = found.pixel
            model.say(f"error {found.error:.4g} at ({x}, {y}): number {found.rank} of the slot")
        elif reason:
            model.say(reason)

    def _follow_source(self) -> None:
        """Take over another render rate that was chosen, more frames of the source, and options that a running program
        has changed."""
        model = self._model
        if model.source.live and model.parameters.render_rate != model.plan.fps:
            model.plan = model.plan._replace(fps=model.parameters.render_rate)
            model.reload()
        if (count := model.source.count) != model.playback.count:
            model.playback.extend(count, model.times(count))
        result = model.contents.result
        current = model.follows and result is not None and result.request.setup == model.setup
        if current and model.setup.options != resolved(model.source.options):  # the program itself has changed them
            model.parameters.take(model.source.options, None)

    def _take_answers(self) -> None:
        """Take everything that the engine has finished."""
        model = self._model
        while model.screen.ready and (answer := model.engine.poll()) is not None:
            if isinstance(answer, EngineError):
                self._failed(answer)
            elif model.source is not None:
                model.asking.take(answer)
        self._take_pair()
        model.scores.update()
        inspection = model.engine.poll_inspection()
        if inspection is not None and model.shows(inspection):
            model.pointing.take(inspection)

    def _failed(self, error: EngineError) -> None:
        model = self._model
        if model.second.failed(error):
            model.say(f"B: {error.message}", error=True)
            return
        if error.during != "metrics":
            model.second.forget()
        model.failure = error.message
        if error.during == "network":
            self._without_network(error.message)
            return
        model.say(error.message, error=True)
        model.notice = error.message if model.source is None else ""
        if error.during == "source" and model.keep_place:
            model.reload_fault = error.message
        model.keep_place = False
        model.pointing.story_due &= error.during != "inspection"
        if error.during == "source":
            model.asking.forget()  # requests to the old one were dropped
        model.previewer = model.preview = None
        if model.follows and (program := model.program) is not None and error.during in ("slot", "inspection"):
            if program.ended:
                model.freeze()
            model.parameters.take(program.options, None)  # others were refused
            model.asking.forget()
        if error.during in ("source", "slot"):
            model.playback.pause()
            if model.export is not None:
                model.export.cancel()

    def _without_network(self, why: str) -> None:
        """Go on without shading correction, until it is switched on again."""
        model = self._model
        model.say(f"shading correction is off: {why}", error=True)
        model.parameters.network_fault = why
        if model.export is not None:
            model.export.cancel()

    def _take_pair(self) -> None:
        model = self._model
        if model.screen.ready:
            model.asking.take_pair()

    def take(self, result: Result, second: Result | None) -> None:
        """Set the displayed results of A and B."""
        model = self._model
        model.contents.take(result, second)
        model.failure = None
        model.previewer = model.preview = None
        for made in (result, second):
            model.scores.add_result(made)
        model.screen.show(result.images, {model.view.a, model.view.b or model.view.a})
        model.timings.add(result)
        model.pointing.ask_again()

    def _ask(self, slot: int) -> None:
        """Request that a slot be shown."""
        model = self._model
        flyer = model.flyer if model.flying else None
        if flyer is not None:
            k, j = divmod(slot, model.n + 1)
            model.source.fly(k, j / (model.n + 1), flyer.pose)
        layers = model.needed.all() if model.overview else model.needed.of_first()
        layers |= model.export.layers if model.export is not None else frozenset()
        slot, passing = (0, True) if model.follows else (slot, flyer is not None)
        request = Request(slot, model.setup, layers, 0, model.measuring, keep=not passing)
        second = model.second.request(request, model.needed.of_second()) if model.second.kept else None
        recipe = None if passing else model.recipe
        anew = (flyer is not None and flyer.moved) or (model.follows and model.asking.answered)
        if model.asking.ask(request, recipe, second, anew, model.source):
            if flyer is not None:
                flyer.moved = False
            self._take_pair()
