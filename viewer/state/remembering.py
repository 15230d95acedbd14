"""From the model to the settings and back: options, playback and comparison survive a restart."""

from __future__ import annotations

import math
from dataclasses import asdict, replace

from gffe_cl.errors import GffeError
from gffe_cl.options import Options
from gffe_cl.viewer.picture.canvas import ERRORS, View

WAYS = ("off", "split", "flip", "difference", "error", "flip error")
_NOT_KEPT = ("shading_inputs", "scn_model", "scn_provider")  # of the options
_NUMBERS = {"split": (0.0, 1.0), "gain": (1.0, 32.0), "error_high": (0.01, 1.0)}


def restore(model) -> None:
    """Take over what is sound in the settings; the rest keeps its default."""
    settings = model.settings
    model.playback.restore(settings.playback)
    model.options = _options(model.options, settings.options)
    _compare(model.view, settings.compare)


def collect(model) -> None:
    """Put what is to be remembered into the settings."""
    settings, view = model.settings, model.view
    settings.playback = model.playback.preferences()
    settings.options = {name: value for name, value in asdict(model.options).items() if name not in _NOT_KEPT}
    settings.compare = {name: getattr(view, name) for name in ("compare", "b", "error", *_NUMBERS)}


def _options(options: Options, saved: dict) -> Options:
    """Each saved value on its own, so that a damaged one costs only itself; history before order, which it bounds.
    Shading correction stays off unless it was asked for."""
    kept = ("history", "order", "motion", "crack_closing", "levels", "hole_filling", "static_threshold", "focus_mask")
    for name in kept:
        value, kind = saved.get(name), type(getattr(Options(), name))
        if name == "static_threshold" and type(value) in (int, float):
            kind, value = float, float(value)
        if type(value) is kind:
            try:
                options = replace(options, **{name: value})
            except GffeError:
                continue
    chosen = options.shading_correction is not None or options.scn_model is not None
    if saved.get("shading_correction") is False and not chosen:
        options = replace(options, shading_correction=False)
    return options


def _compare(view: View, saved: dict) -> None:
    for name, choices in (("compare", WAYS), ("error", ERRORS)):
        if saved.get(name) in choices:
            setattr(view, name, saved[name])
    for name, (low, high) in _NUMBERS.items():
        value = saved.get(name)
        if type(value) in (int, float) and math.isfinite(value):
            setattr(view, name, min(max(float(value), low), high))
    if isinstance(saved.get("b"), str):
        view.b = saved["b"]
    elif view.compare != "off":
        view.compare = "off"
