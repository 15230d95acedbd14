"""Text over the picture: legends of colors, values in words, captions, and messages to the user."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gffe_cl.engine.inspection import names
from gffe_cl.engine.inspection.layers import LayerSpec
from ..picture.current_frame import Contents
from ..picture.displays import LABEL_COLORS, MASK_OFF, SKY, Display, Rgb, color_table, label_flip, shown_as
from ..picture.looks import Looks
from ..picture.view import COLOR, FLIP_SPEC, Side, View, compared_as, full_scale, has_direction, unit_of
from .comparing import Comparison
from .playback import Playback


@dataclass(frozen=True)
class Legend:
    """Content of a legend.

    `kind` is "none", "ramp" (`ticks` from 0, low, to 1, high, along `color_table(display.color_map)`) or "wheel", of
    directions; each tick is (position, text, color). `labels` are (text, color) of single values, "ramp" or not. `unit`
    says what the numbers are.
    """

    kind: str
    ticks: tuple[tuple[float, str, Rgb], ...] = ()
    labels: tuple[tuple[str, Rgb], ...] = ()
    unit: str = ""


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
        what = "motion − static: " * (spec.name == names.RESIDUAL)
        return Legend("wheel", unit=f"{what}full color from {display.motion_scale:.3g} px")
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


@dataclass
class Message:
    """A message of the kind "note", "error", or "title" of a script; `since`: first display, seconds of the playback
    clock; `dismissed`: the user removed it from the picture."""

    text: str
    kind: str
    since: float | None = None
    dismissed: bool = False

    @property
    def error(self) -> bool:
        return self.kind == "error"


def slot_text(slot: int, n: int) -> str:
    """Return the name of a slot with `n` generated frames per rendered one."""
    k, j = divmod(slot, n + 1)
    return f"generated: frame {k} + {j}/{n + 1}" if j else f"rendered frame {k}"


def layer_text(spec: LayerSpec, display: Display) -> str:
    """Return the name of a layer with changed settings of its display."""
    exposed = spec.view == "color" and display.exposure
    return f"{spec.group}: {spec.label}" + (f"   {display.exposure:+.1f} EV" if exposed else "")


_VECTORS = LayerSpec("vectors", "Vectors", "overlay", "motion", ("x", "y"))


class Captions:
    """Captions of the displayed picture."""

    def __init__(self, contents: Contents, view: View, looks: Looks, comparison: Comparison, playback: Playback):
        self._contents, self._view, self._looks = contents, view, looks
        self._comparison, self._playback = comparison, playback

    @property
    def frame(self) -> str:
        """The name of the displayed frame."""
        result = self._contents.result
        if result is None:
            return slot_text(self._playback.slot, self._playback.n)
        return slot_text(result.slot, result.setup.n)

    def legends(self) -> list[tuple[str, Legend]]:
        """Return the ramps and wheels of the picture, each with "A" if it is that of A in a wipe, else ""."""
        return [(side, shown) for side, shown in self._shown() if shown is not None and shown.kind != "none"]

    def _shown(self) -> list[tuple[str, Legend | None]]:
        view, comparison = self._view, self._comparison
        if comparison.flipped:
            return [("", self._layer(view.b))]
        if comparison.nothing:
            return []
        if view.compare == "flip error":
            return [("", replace(legend(FLIP_SPEC, comparison.error_display), unit="FLIP, 0 to 1"))]
        if view.compare == "difference":
            return [("", self._difference())]
        if view.compare == "split" and view.b and names.plain(view.b) != view.a:
            return [("A", self._layer(view.a)), ("", self._layer(view.b))]
        return [("", self._layer(view.a))]

    def _layer(self, name: str | None) -> Legend | None:
        spec = self._contents.spec(name)
        if name is None or spec is None or self._contents.image(name) is None:
            return None
        return legend(spec, self._looks.of(name))

    def _sides(self) -> tuple[Side, Side] | None:
        """Return the layers that are compared, with their displays; None if one is missing."""
        view, contents, looks = self._view, self._contents, self._looks
        a, b = contents.spec(view.a), contents.spec(view.b)
        return None if a is None or b is None or view.b is None else ((a, looks.of(view.a)), (b, looks.of(view.b)))

    def _difference(self) -> Legend | None:
        """Return the legend of a difference: a color bar, or a wheel of directions."""
        sides, view = self._sides(), self._view
        if sides is None or (kind := compared_as(*sides)) in ("label", "mask"):
            return None
        how = view.difference
        high, unit = full_scale(kind, how, view.gain, sides[0][1]), unit_of(*sides, how)
        if has_direction(kind, how):
            return legend(_VECTORS, Display(motion_scale=high))
        color_map = "diverging" if how == "signed" and kind != "world" else "heat"
        if how == "absolute" and kind == COLOR:
            color_map = "gray"
        display = Display(low=-high if color_map == "diverging" else 0.0, high=high, color_map=color_map)
        return replace(legend(FLIP_SPEC, display), unit=unit)
