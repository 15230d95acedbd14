"""Legends: the meaning of a layer's colors, and its values in words."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gffe_cl.engine.inspection.layers import LayerSpec
from .colors import LABEL_COLORS, MASK_OFF, SKY, Rgb, color_table, label_flip, wheel_color
from .displays import Display, shown_as


@dataclass(frozen=True)
class Legend:
    """Content of a legend.

    `kind` is "none", "ramp" (`ticks` from 0, low, to 1, high, along `color_table(display.color_map)`) or "wheel"
    (`ticks` in turns, see `wheel_color`); each tick is (position, text, color). `labels` are (text, color) of single
    values, "ramp" or not. `unit` says what the numbers are.
    """

    kind: str
    ticks: tuple[tuple[float, str, Rgb], ...] = ()
    labels: tuple[tuple[str, Rgb], ...] = ()
    unit: str = ""


_DIRECTIONS = ("right", "right, down", "down", "left, down", "left", "left, up", "up", "right, up")


def legend(spec: LayerSpec, display: Display) -> Legend:
    """Return the legend of the channel that is shown; a ramp has five ticks."""
    view = shown_as(spec, display)[0]
    if view == "color":
        return Legend("none")
    if view == "mask":
        return Legend("none", labels=(("0", MASK_OFF), ("1", display.tint)))
    if view == "label":
        named = spec.labels or tuple((value, str(value)) for value in range(16))
        return Legend(
            "none", labels=tuple((text, LABEL_COLORS[value & 15 ^ label_flip(spec)]) for value, text in named)
        )
    if view in ("motion", "place"):
        wheel = ((turn / 8, text, wheel_color(turn / 8, 1)) for turn, text in enumerate(_DIRECTIONS))
        return Legend("wheel", tuple(wheel), unit=f"full color from {display.motion_scale:.3g} px")
    colors, marks = color_table(display.color_map), []
    for position in (0.0, 0.25, 0.5, 0.75, 1.0):
        value = display.low + (display.high - display.low) * position
        if view == "depth" and display.inverse and min(display.low, display.high) > 0:
            value = 1 / (1 / display.low + (1 / display.high - 1 / display.low) * position)
        marks.append((position, f"{value:.4g}", tuple(colors[round(position * 255)].tolist())))
    special = (("sky", SKY),) if view == "depth" else ()
    pixels = spec.view in ("motion", "place") and view == "scalar"
    unit = "px" if pixels else "world units" if view in ("depth", "world") or spec.view == "world" else ""
    return Legend("ramp", tuple(marks), special, unit)


def value_text(spec: LayerSpec, values) -> str:
    """Return one line for the value (channels,) of one pixel of `spec`."""
    values = [float(value) for value in np.ravel(values)]
    if spec.view == "color":
        return "  ".join(f"{n} {_text(v)}" for n, v in zip(spec.components, values, strict=False) if n != "A")
    first, labels = values[0], dict[float, str](spec.labels)
    if spec.bits:
        return f"{first:g}: {', '.join(name for bit, name in enumerate(spec.bits) if int(first) >> bit & 1) or 'none'}"
    if spec.view == "label":
        return f"{first:g}: {labels[first]}" if first in labels else f"{first:g}"
    if spec.view == "mask":
        return "yes" if first else "no"
    if spec.view == "depth":
        return (
            "sky" if first == math.inf else f"{_text(first)} world units" if first > 0 else f"no depth ({_text(first)})"
        )
    if spec.view == "motion":
        return f"({first:+.2f}, {values[1]:+.2f}) px, {math.hypot(*values[:2]):.2f} px long"
    if spec.view == "place":
        if not (values[2] > 0 if len(values) > 2 else any(values)):
            return "nothing"
        depth = f", depth {'sky' if values[2] == math.inf else _text(values[2])}" if len(values) > 2 else ""
        return f"({first:.2f}, {values[1]:.2f}) px{depth}"
    if spec.view == "world":
        return f"({', '.join(map(_text, values[:3]))}) world units" if values[3:] != [0.0] else "not known"
    return "  ".join(map(_text, values))


def _text(value: float) -> str:
    return "NaN" if math.isnan(value) else f"{value:.4g}"
