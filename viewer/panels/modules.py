"""Modules and parameters of the pipeline, switched live; the next frame shows the effect."""

from __future__ import annotations

from dataclasses import replace

from imgui_bundle import imgui

from gffe_cl.options import OPTIONS, Options
from gffe_cl.viewer.panels import widgets

_DEFAULT = Options()
_WINDOWS = ("off", "adaptive", "fixed:1.1", "fixed:1.2", "fixed:1.4")


def draw(app) -> None:
    model = app.model
    options = model.options

    def change(**values):
        model.set_options(replace(options, **values))

    widgets.heading("Modules")
    widgets.toggle(
        "motion estimation", options.motion, lambda on: change(motion=on), "History tracking; off: everything is static"
    )
    widgets.toggle(
        "background collection",
        options.levels > 0,
        lambda on: change(levels=_DEFAULT.levels if on else 0),
        "Static surfaces that are hidden now, remembered in levels",
    )
    widgets.toggle(
        "crack closing",
        options.crack_closing,
        lambda on: change(crack_closing=on),
        "A fragment covers what its pixel maps to; off: single pixels, as in the paper",
    )
    widgets.toggle(
        "hole filling",
        options.hole_filling != "none",
        lambda on: change(hole_filling=_DEFAULT.hole_filling if on else "none"),
        "What neither the rendered frame nor the background shows",
    )
    _shading(model, change)
    _window(model)

    widgets.heading("Parameters")
    _threshold(options, change)
    widgets.slider(
        "background levels", options.levels, 0, 4, _DEFAULT.levels, lambda n: change(levels=n), "%d",
        "L: level 0 holds what moving objects hide, deeper ones what static surfaces do",
    )  # fmt: skip
    widgets.slider(
        "history", options.history, 2, 5, _DEFAULT.history,
        lambda n: change(history=n, order=min(options.order, n - 1)), "%d positions", "k: positions kept per fragment",
    )  # fmt: skip
    widgets.slider(
        "prediction order", options.order, 1, 4, _DEFAULT.order,
        lambda n: change(order=n, history=max(options.history, n + 1)), "%d", "m: 1 is linear, the paper's choice",
    )  # fmt: skip
    if options.hole_filling != "none":
        widgets.choice(
            "filling",
            options.hole_filling,
            [name for name in OPTIONS["hole_filling"].choices if name != "none"],
            lambda m: change(hole_filling=m),
        )
    widgets.slider(
        "generated frames", model.n, 1, 7, 1, model.set_n, "%d",
        "n after each rendered frame: α = j / (n + 1), j = 1 … n",
    )  # fmt: skip
    if imgui.button("all defaults###defaults"):
        model.use_defaults()


def _shading(model, change) -> None:
    reason, on = model.why_no_correction(), model.corrects_shading
    widgets.toggle(
        "shading correction", on and reason is None, model.correct_shading,
        model.network_fault or "A network moves shadows and reflections to where they belong", reason,
    )  # fmt: skip
    reason = reason or (None if on else "shading correction is off")
    widgets.toggle(
        "focus mask", model.options.focus_mask and reason is None, lambda on: change(focus_mask=on),
        "Only what the network says is wrong; off: its whole image", reason,
    )  # fmt: skip


def _window(model) -> None:
    info = model.info
    if info is not None and info.live:
        widgets.choice("rendering window", model.window or "off", list(_WINDOWS), model.set_window)
        widgets.tooltip("What is rendered beyond what is shown, for turning cameras")
    elif info is not None:
        reason = None if info.windowed else "this sequence was not rendered through a window (no overscan)"
        widgets.toggle(
            "rendering window",
            info.windowed and model.window != "off",
            lambda on: model.set_window(None if on else "off"),
            "Use what was rendered beyond what is shown; off: the display part only",
            reason,
        )


def _threshold(options, change) -> None:
    automatic = options.static_threshold is None
    widgets.toggle(
        "automatic static threshold",
        automatic,
        lambda on: change(static_threshold=None if on else 1.0),
        "ε follows the noise of the motion vectors",
    )
    if not automatic:
        widgets.slider(
            "static threshold", options.static_threshold, 0.0, 8.0, 1.0, lambda e: change(static_threshold=e),
            "%.2f px", "ε: from so many pixels of motion a fragment is dynamic",
        )  # fmt: skip
