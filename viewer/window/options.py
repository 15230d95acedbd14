"""Options: modules and parameters of the pipeline, switched live; and A and B compared by wipe, flip, difference or
error, with their quality against ground truth."""

from __future__ import annotations

from functools import partial
from itertools import zip_longest

from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from gffe_cl.engine.options import PRESETS, Option
from gffe_cl.lab.metrics import METRICS
from ..picture.view import DIFFERENCES
from ..state.comparing import FLIP_HIGH, NEIGHBORS, WAYS
from ..state.model import Model
from ..state.parameters import by_hand
from ..state.presets import Kept
from . import widgets
from .app import App


def draw_modules(app: App) -> None:
    model = app.model
    offered = model.parameters.offered()
    with widgets.compact():
        names = {name: preset.sentence for name, preset in PRESETS.items()}
        preset = model.parameters.options.preset_name or "own settings"
        widgets.choice("preset", preset, list(names), model.parameters.use_preset, names)
        widgets.tooltip("Quality against cost.")
        _modules(model, {name: option for name, option in offered.items() if option.is_module})
        imgui.separator_text("Parameters")
        for name, option in offered.items():
            if option.kind is not bool:
                _parameter(model, name, option)
    if imgui.button("all defaults###defaults"):
        model.parameters.use_defaults()


def _modules(model: Model, options: dict[str, Option]) -> None:
    """Draw the switches of modules, in two columns if there is a place to divide them so that both have room."""
    listed, spacing = list(options.items()), imgui.get_style().item_spacing.x
    box = imgui.get_text_line_height() + imgui.get_style().item_inner_spacing.x + 2
    widths = [box + imgui.calc_text_size(option.label).x for option in options.values()]
    room, count, left = imgui.get_content_region_avail().x - spacing, len(listed), imgui.get_cursor_pos_x()
    places = [at for at in range(1, count) if max(widths[:at]) + max(widths[at:]) <= room]
    rows = min(places, key=lambda at: abs(2 * at - count), default=count)
    for first, second in zip_longest(listed[:rows], listed[rows:]):
        if first:
            _module(model, first[0], first[1])
        if first and second:
            imgui.same_line()
        if second:
            imgui.set_cursor_pos_x(left + max(widths[:rows]) + spacing)
            _module(model, second[0], second[1])


def _module(model: Model, name: str, option: Option) -> None:
    parameters = model.parameters
    reason = parameters.why_not(name)
    widgets.toggle(
        option.label,
        parameters.is_on(name) and reason is None,
        partial(parameters.switch, name),
        parameters.fault(name) or option.sentence,
        reason,
    )


def _parameter(model: Model, name: str, option: Option) -> None:
    value, change = model.parameters.value(name), partial(model.set, name)
    imgui.begin_disabled(model.parameters.why_not(name) is not None)
    if option.choices:
        if value != option.off:
            choices = {choice: text for choice, text in option.choices.items() if choice != option.off}
            imgui.push_id("choice")  # the module's switch may have the same label
            widgets.choice(option.label, value, list(choices), change, choices)
            imgui.pop_id()
            widgets.tooltip(option.sentence)
    else:
        if option.automatic:
            widgets.toggle(
                f"automatic {option.label}",
                value is None,
                lambda on: change(None if on else by_hand(option)),
                option.sentence,
            )
        if value is not None:
            high = option.high if option.usual_high is None else option.usual_high
            form = "%d" if option.kind is int else "%.2f"
            text = f"{form} {option.unit}".rstrip()
            widgets.slider(option.label, value, option.low, high, by_hand(option), change, text, option.sentence)
    imgui.end_disabled()


def draw_compare(app: App) -> None:
    model = app.model
    view = model.view
    imgui.separator_text("Compare")
    with widgets.in_rows(indent=0.0) as row:
        for name, text in WAYS.items():
            reason = model.comparison.why_not(name)
            row(imgui.get_frame_height() + imgui.get_style().item_inner_spacing.x + imgui.calc_text_size(text).x)
            imgui.begin_disabled(reason is not None)
            if imgui.radio_button(f"{text}###compare {name}", view.compare == name):
                model.comparison.set(name)
            imgui.end_disabled()
            widgets.tooltip(reason or "")
    layers = {spec.name: f"{spec.group}: {spec.label}" for spec in model.contents.showable()}
    widgets.choice("A", view.a, layers, model.show_layer)
    _second(model, layers)
    if view.compare == "split":
        widgets.slider("split", view.split, 0.0, 1.0, 0.5, lambda v: setattr(view, "split", v))
    if view.compare == "difference":
        widgets.choice("difference", view.difference, list(DIFFERENCES), lambda name: setattr(view, "difference", name))
        widgets.slider("gain", view.gain, 1.0, 32.0, 4.0, lambda v: setattr(view, "gain", v), "%.1f×")
    if view.compare == "flip error":
        brightest = partial(setattr, model.comparison, "flip_high")
        widgets.slider("brightest", model.comparison.flip_high, 0.01, 1.0, FLIP_HIGH, brightest, "%.2f")
    _settings(app)
    _quality(model)


def _second(model: Model, layers: dict[str, str]) -> None:
    """Draw the choice of B: another layer, or A's layer as kept settings make it."""
    comparison, b = model.comparison, model.kept.b
    settings = {kept: f"settings: {kept.name}" for kept in model.kept.all}
    neighbors = {which: f"A's layer, {which}" for which in NEIGHBORS}
    chosen = b if comparison.by_settings else comparison.neighbor or model.view.b or ""

    def choose(one: Kept | str) -> None:
        if isinstance(one, Kept):
            comparison.with_settings(one.name)
        else:
            (comparison.with_neighbor if one in NEIGHBORS else comparison.with_layer)(one)

    widgets.choice("B", chosen, settings | neighbors | layers, choose)
    if comparison.neighbor:
        follow = partial(setattr, comparison, "follows")
        widgets.toggle(
            "along motion vectors", comparison.follows, follow, "B where vectors lead, not at the same place"
        )


def _settings(app: App) -> None:
    """Draw the kept settings, and the actions on them."""
    model, kept = app.model, app.model.kept.b
    imgui.separator_text("Settings A and B")
    for name, icon in (
        ("keep", icons.ICON_FA_BOOKMARK),
        ("swap", icons.ICON_FA_RIGHT_LEFT),
        ("copy_command", icons.ICON_FA_COPY),
        ("copy_command_b", icons.ICON_FA_CLONE),
    ):
        widgets.action_button(app.actions, name, icon)
        imgui.same_line()
    if kept is None:
        if imgui.get_content_region_avail().x < 8 * imgui.get_font_size():
            imgui.new_line()
        widgets.hint("K keeps the present settings as B")
        return
    imgui.begin_disabled(not model.comparison.by_settings)
    if imgui.button(f"{icons.ICON_FA_TRASH}###forget_settings"):
        model.kept.forget(kept)
    imgui.end_disabled()
    widgets.tooltip(f"Forget the settings {kept.name}")
    widgets.leave_room_for("name of B")
    enter = imgui.InputTextFlags_.enter_returns_true.value
    entered, text = imgui.input_text("###name_of_b", kept.name, enter)
    if entered:
        model.kept.rename(kept, text)
    widgets.beside("name of B")
    if model.showing.fault_of_b or kept.suspicion:
        imgui.text_wrapped(model.showing.fault_of_b or kept.suspicion)


def _beside(b: dict[str, float], a: dict[str, float]) -> str:
    """Return B's scores in words, each with its difference from A's."""
    return "   ".join(
        f"{metric.sentence(b[name])} ({metric.text(b[name] - a[name], signed=True)})"
        for name, metric in METRICS.items()
        if name in b and name in a
    )


def _quality(model: Model) -> None:
    imgui.separator_text("Against ground truth")
    reason = model.contents.why_not("truth")
    if reason:
        widgets.hint(reason)
        return
    widgets.toggle(
        "measure",
        model.choices.measuring,
        lambda on: setattr(model.choices, "measuring", on),
        f"{', '.join(metric.label for metric in METRICS.values())} of every generated frame that is shown",
    )
    survey = model.survey
    score, second = (survey.figures(side).get(model.slot) for side in (survey.a, survey.b))
    if score is not None:
        known = [metric for metric in METRICS.values() if metric.name in score.values]
        a = "   ".join(metric.sentence(score.values[metric.name]) for metric in known)
        imgui.text_wrapped(f"A  {a}" if second else a)
        if second is not None:
            imgui.text_wrapped(f"B  {_beside(second.values, score.values)}")
    elif model.choices.measuring and model.slot % (model.n + 1) == 0:
        imgui.text_disabled("rendered frame")
