"""Modules and parameters of the pipeline, switched live; the next frame shows the effect."""

from __future__ import annotations

import math
from functools import partial

from imgui_bundle import imgui

from gffe_cl.engine.options import PRESETS, Option
from ..state.model import Model
from ..state.parameters import by_hand
from . import widgets
from .app import App


def draw(app: App) -> None:
    model = app.model
    offered = model.parameters.offered()
    with widgets.compact():
        names = {name: preset.sentence for name, preset in PRESETS.items()}
        preset = model.parameters.options.preset_name or "own settings"
        widgets.choice("preset", preset, list(names), model.parameters.use_preset, names)
        widgets.tooltip("Quality against cost.")
        _modules(model, {name: option for name, option in offered.items() if option.is_module})
        widgets.heading("Parameters")
        for name, option in offered.items():
            if option.kind is not bool:
                _parameter(model, name, option)
    if imgui.button("all defaults###defaults"):
        model.parameters.use_defaults()


def _modules(model: Model, options: dict[str, Option]) -> None:
    """Draw the switches of modules, in two columns if they fit."""
    listed, spacing = list(options.items()), imgui.get_style().item_spacing
    first = listed[: math.ceil(len(listed) / 2)]
    column = _width(first) + spacing.x
    if column + _width(listed[len(first) :]) > imgui.get_content_region_avail().x:
        first = listed
    left = imgui.get_cursor_pos_x()
    for row, module in enumerate(first):
        _module(model, *module)
        for beside in listed[len(first) :][row : row + 1]:
            imgui.same_line(left + column)
            _module(model, *beside)


def _width(listed: list[tuple[str, Option]]) -> float:
    """Return the width of the options' switches below each other, pixels."""
    box = imgui.get_text_line_height() + imgui.get_style().item_inner_spacing.x + 2
    return box + max(imgui.calc_text_size(_label(option)).x for _, option in listed)


def _label(option: Option) -> str:
    return option.label


def _module(model: Model, name: str, option: Option) -> None:
    parameters = model.parameters
    reason = parameters.why_not(name)
    widgets.toggle(
        _label(option),
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
