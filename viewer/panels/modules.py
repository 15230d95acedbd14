"""Modules and parameters of the pipeline, switched live; the next frame shows the effect."""

from __future__ import annotations

from functools import partial

from imgui_bundle import imgui

from gffe_cl.options import Option
from gffe_cl.viewer.panels import widgets
from gffe_cl.viewer.state.parameters import by_hand


def draw(app) -> None:
    model = app.model
    offered = model.parameters.offered()
    widgets.heading("Modules")
    for name, option in offered.items():
        if option.is_module:
            _module(model, name, option)
    widgets.heading("Parameters")
    for name, option in offered.items():
        if option.kind is not bool:
            _parameter(model, name, option)
    if imgui.button("all defaults###defaults"):
        model.parameters.use_defaults()


def _module(model, name: str, option: Option) -> None:
    parameters = model.parameters
    reason = parameters.why_not(name)
    widgets.toggle(
        option.off_label or option.label, parameters.is_on(name) and reason is None,
        partial(parameters.switch, name), parameters.fault(name) or option.off_sentence or option.sentence, reason,
    )  # fmt: skip


def _parameter(model, name: str, option: Option) -> None:
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
                f"automatic {option.label}", value is None,
                lambda on: change(None if on else by_hand(option)), option.sentence,
            )  # fmt: skip
        if value is not None:
            high = option.high if option.usual_high is None else option.usual_high
            form = "%d" if option.kind is int else "%.2f"
            text = f"{form} {option.unit}".rstrip()
            widgets.slider(option.label, value, option.low, high, by_hand(option), change, text, option.sentence)
    imgui.end_disabled()
