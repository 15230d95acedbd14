"""Text over the picture: captions, and messages to the user."""

from __future__ import annotations

from dataclasses import dataclass, replace

from gffe_cl.engine.inspection import names
from gffe_cl.engine.inspection.layers import LayerSpec
from ..engine.figures import REGIONS
from ..picture import differences, disocclusions, flip_map
from ..picture.colors import LABEL_COLORS, Rgb, color_table
from ..picture.current_frame import Contents
from ..picture.differences import Side
from ..picture.display_settings import Looks
from ..picture.displays import Display
from ..picture.legend_strip import Entry
from ..picture.legends import Legend, legend
from ..picture.view import CLIPPING, View
from .comparing import Comparison
from .playback import Playback


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


def headings(
    view: View, contents: Contents, looks: Looks, frame: str, settings: tuple[str, str], marked: str
) -> list[Entry]:
    """Return what a picture shows: the `frame`, the layers and `settings` of A and B, and the `marked` pixels."""
    shown = list(zip("AB", (view.a, view.b if view.compare != "off" else None), settings, strict=True))
    shown = [(side, name, of) for side, name, of in shown if name]
    texts = [f"{contents.source.name}   {frame}"]
    for side, name, of in shown:
        spec = contents.spec(name)
        text = names.plain(name) if spec is None else layer_text(spec, looks.of(name))
        text = text if name == names.TRUTH else f"{text}   {of}"
        texts.append(f"{side}  {text}" if len(shown) > 1 else text)
    if marked:
        texts.append(f"{marked}, checkered")
    return [Entry(text, Legend("none")) for text in texts]


REST: Rgb = (0.35, 0.35, 0.35)  # of the region that has no tint
_EDGES = (("depth", (1.0, 0.0, 0.0)), ("motion", (0.0, 1.0, 0.0)), ("color", (0.0, 0.0, 1.0)))
_MOTION = LayerSpec("residual motion", "Residual motion", "overlay", "motion", ("x", "y"))


def region_colors() -> dict[str, Rgb]:
    """Return colors by region, as the overlay tints them."""
    colors = [*LABEL_COLORS[1 : len(REGIONS)], REST]
    return dict(zip(REGIONS, colors, strict=True))


def disocclusion_colors() -> tuple[tuple[str, Rgb], ...]:
    """Return the kinds of disocclusions with their colors, as the overlay tints them."""
    return tuple(zip(disocclusions.KINDS, LABEL_COLORS[1:], strict=False))


def entries_of(view: View, contents: Contents, looks: Looks, comparison: Comparison) -> list[Entry]:
    """Return legends of the displayed layers; none for colors alone. An overlay that tints them is named beside their
    units, as its colors are not the bars'."""
    tinted = _tinted(view)
    shown = [
        replace(entry, legend=replace(entry.legend, unit=", ".join(filter(None, (entry.legend.unit, tinted)))))
        if tinted and entry.legend.kind != "none" else entry
        for entry in _shown(view, contents, looks, comparison)
    ]  # fmt: skip
    return [*shown, *_overlay(view)]


def _tinted(view: View) -> str:
    """Return how an overlay changes the colors of the layer under it; empty if it does not."""
    if view.overlay == disocclusions.OVERLAY:
        return "tinted in disocclusions"
    if view.overlay != "regions":
        return ""
    return "tinted by regions" if view.region < 0 else "dimmed outside the region"


def _shown(view: View, contents: Contents, looks: Looks, comparison: Comparison) -> list[Entry]:
    if comparison.flipped:
        return _layer(view.b, contents, looks, "B  ")
    if comparison.nothing:
        return [Entry(comparison.scale_text(), Legend("none"))]
    if view.compare in ("error", "flip error"):
        display = comparison.error_display
        shown = replace(legend(flip_map.SPEC, display), unit=_error_unit(view, contents, looks))
        return [Entry(comparison.scale_text(), shown, display.color_map)]
    if view.compare == "difference":
        return _difference(view, contents, looks, comparison)
    if view.compare == "split" and view.b and names.plain(view.b) != view.a:
        return _layer(view.a, contents, looks, "A  ") + _layer(view.b, contents, looks, "B  ")
    return _layer(view.a, contents, looks)


def _sides(view: View, contents: Contents, looks: Looks) -> tuple[Side, Side] | None:
    """Return the layers that are compared, with their displays; None if one is missing."""
    a, b = contents.spec(view.a), contents.spec(view.b)
    return None if a is None or b is None or view.b is None else ((a, looks.of(view.a)), (b, looks.of(view.b)))


def _error_unit(view: View, contents: Contents, looks: Looks) -> str:
    """Return the unit of the error map's numbers."""
    sides = _sides(view, contents, looks)
    if view.compare == "flip error":
        return "FLIP, 0 to 1"
    unit = differences.unit_of(*sides) if sides else ""
    return f"{unit}, squared" if view.error == "squared" and unit else unit


def _difference(view: View, contents: Contents, looks: Looks, comparison: Comparison) -> list[Entry]:
    """Return the legend of a difference: a color bar, or a wheel of directions."""
    sides, title = _sides(view, contents, looks), comparison.scale_text()
    if sides is None:
        return [Entry(title, Legend("none"))]
    kind, how = differences.compared_as(*sides), view.difference
    high, unit = differences.full_scale(kind, how, view.gain, sides[0][1]), differences.unit_of(*sides, how)
    if kind in ("label", "mask"):
        ends = color_table("heat")
        labels = (("equal", tuple(ends[0].tolist())), ("different", tuple(ends[-1].tolist())))
        return [Entry(title, Legend("none", labels=labels))]
    if differences.has_direction(kind, how):
        return [Entry(title, legend(_MOTION, Display(motion_scale=high)))]
    color_map = "diverging" if how == "signed" and kind != "world" else "heat"
    if how == "absolute" and kind == differences.COLOR:
        color_map = "gray"
    display = Display(low=-high if color_map == "diverging" else 0.0, high=high, color_map=color_map)
    return [Entry(title, replace(legend(flip_map.SPEC, display), unit=unit), color_map)]


def _layer(name: str | None, contents: Contents, looks: Looks, prefix: str = "") -> list[Entry]:
    spec = contents.spec(name)
    if name is None or spec is None or contents.image(name) is None:
        return []
    display = looks.of(name)
    shown = legend(spec, display)
    channel = f", {display.channel}" if len(spec.channels) > 1 and display.channel not in ("", spec.channels[0]) else ""
    entry = Entry(f"{prefix}{spec.group}: {spec.label}{channel}", shown, display.color_map)
    return [entry] if shown.kind != "none" or shown.labels else []


def _overlay(view: View) -> list[Entry]:
    if view.overlay == "regions":
        colors = region_colors()
        if view.region >= 0:
            return [Entry(f"bright: {list(REGIONS)[view.region]}", Legend("none"))]
        return [Entry("regions of errors", Legend("none", labels=tuple(colors.items())))]
    if view.overlay == disocclusions.OVERLAY:
        return [Entry("disocclusions", Legend("none", labels=disocclusion_colors()))]
    if view.overlay == "clipping":
        return [Entry("clipping", Legend("none", labels=tuple(CLIPPING.items())))]
    if view.overlay == "edges":
        return [Entry("edges", Legend("none", labels=_EDGES))]
    if view.overlay == "residual motion":
        return [Entry("residual motion", legend(_MOTION, Display(motion_scale=view.residual_scale)))]
    return []


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

    def legends(self) -> list[Entry]:
        """Return the legends of the picture."""
        return entries_of(self._view, self._contents, self._looks, self._comparison)

    def under_picture(self, settings: tuple[str, str], marked: str) -> list[Entry]:
        """Return what is written under a saved picture; `settings` of A and B, and the `marked` pixels."""
        shown = headings(self._view, self._contents, self._looks, self.frame, settings, marked)
        return [*shown, *self.legends()]
