"""Parameters of the computation, as chosen by the user: the pipeline's options, and the viewer's own."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.inference import network
from gffe_cl.engine.options import OPTIONS, PRESETS, Option, Options
from ..engine.messages import Setup
from ..engine.sources.source import FrameSource
from .playback import MOST_GENERATED, Playback

ALWAYS = {"shading_inputs": True}  # they are layers to look at
CORRECTION, UPSCALING = "shading_correction", "upscale"
_SHOWN = 60.0  # frames per second that are to be shown of a scene whose render rate is chosen
OWN = {
    option.name: option
    for option in (
        Option(
            "window", True, "rendering window",
            "Rendering window: the area rendered beyond the display; off: the display only.",
            off=False, remembered=False,
        ),
        Option(
            "scene_window", "off", "rendering window",
            "Rendering window: the area rendered beyond the display, for turning cameras.",
            kind=str, remembered=False,
            choices={
                "off": "the display only",
                "adaptive": "as far as the prediction of the camera reaches",
                "fixed:1.1": "1.1 times as wide and high",
                "fixed:1.2": "1.2 times as wide and high",
                "fixed:1.4": "1.4 times as wide and high",
            },
        ),
        Option(
            "render_rate", "scene", "render rate", "Rendered frames per second of a built-in scene; generated ones are"
            " chosen to make it 60.",
            kind=str, remembered=False,
            choices={
                "scene": "as the scene has it",
                "10": "10 rendered frames per second, 5 generated after each",
                "15": "15 rendered frames per second, 3 generated after each",
                "30": "30 rendered frames per second, 1 generated after each",
            },
        ),
        Option(
            "n", 1, "generated frames", "n after each rendered frame: α = j / (n + 1), j = 1 … n.", kind=int, low=1,
            high=MOST_GENERATED, remembered=False,
        ),
    )
}  # fmt: skip
ALL: dict[str, Option] = {name: option for name, option in OPTIONS.items() if name not in ALWAYS} | OWN


def by_hand(option: Option) -> Any:
    """Return the value at which an option starts that is not automatic any more."""
    return option.default if option.default is not None else option.kind(min(max(1, option.low), option.high))


def parsed(option: Option, text: str) -> float | int | None:
    """Return the value of a number that is typed; None for automatic. Raises GffeError."""
    text = text.strip()
    if option.automatic and text == option.automatic:
        return None
    try:
        return option.checked(option.kind(text.replace(",", ".")))
    except (ValueError, OverflowError, GffeError):
        raise GffeError(f"{option.label} must be {option.expected}, got '{text}'") from None


class Parameters:
    """Values of `ALL`, by name.

    Attributes
    ----------
    options : Options
        Of the pipeline.
    window : str or None
        Of `FrameSource.configure`.
    network_fault : str or None
        Why shading correction was switched off.
    """

    def __init__(self, options: Options, playback: Playback, window: str | None = None):
        self._setup, self._setup_of = Setup(), None  # the last request, and its inputs
        self.options = replace(options, **ALWAYS)
        self.window = window
        self.render_rate: float | None = None  # of built-in scenes, frames per second; None: the scene's
        self.network_fault: str | None = None
        self._playback = playback
        self._source: Any = None  # a FrameSource, once something is open

    def open(self, source: FrameSource) -> None:
        """Take over another source: its windows are others."""
        self._source = source
        if source.live:
            self.window = self.window or "off"
        else:
            self.window = "off" if self.window == "off" else None
        self.set(UPSCALING, self.options.upscale)

    @property
    def setup(self) -> Setup:
        parts = self.options, self.is_on(CORRECTION), self.window, self._playback.n
        if parts != self._setup_of:  # asked for several times per frame of the interface
            options, corrected, window, n = self._setup_of = parts
            self._setup = Setup(replace(options, shading_correction=corrected), window, n)
        return self._setup

    def offered(self) -> dict[str, Option]:
        """Return the choices in this sequence; texts without choices are the command line's."""
        return {
            name: option
            for name, option in ALL.items()
            if (option.kind is not str or option.choices) and self._applies(name)
        }

    def _applies(self, name: str) -> bool:
        live = {"window": False, "scene_window": True, "render_rate": True}
        return name not in live or (self._source is not None and self._source.live == live[name])

    def why_not(self, name: str) -> str | None:
        """Return why a parameter cannot be changed now; None if it can."""
        if not self._applies(name):
            return "only in a built-in scene" if name in ("scene_window", "render_rate") else "only of recorded frames"
        if name == "window" and not self._source.windowed:
            return "this sequence was not rendered through a window (no overscan)"
        if name == CORRECTION:
            return None if self.options.scn_model else network.scn_missing()
        needed = ALL[name].needs
        if needed is None:
            return None
        return self.why_not(needed) or (None if self.is_on(needed) else f"{ALL[needed].label} is off")

    def value(self, name: str) -> Any:
        if name == "n":
            return self._playback.n
        if name == "window":
            return self.window != "off" and self._source is not None and self._source.windowed
        if name == "scene_window":
            return self.window or "off"
        if name == "render_rate":
            return "scene" if self.render_rate is None else f"{self.render_rate:g}"
        return getattr(self.options, name)

    def set(self, name: str, value: Any) -> None:
        """Set a parameter. Raises GffeError for values that make no sense."""
        if name == "n":
            self._playback.n = ALL[name].checked(value)
        elif name == "window":
            self.window = None if ALL[name].checked(value) else "off"
        elif name == "scene_window":
            self.window = ALL[name].checked(value)
        elif name == "render_rate":
            rate = ALL[name].checked(value)
            self.render_rate = None if rate == "scene" else float(rate)
            self._playback.n = 1 if self.render_rate is None else round(_SHOWN / self.render_rate) - 1
        else:
            self.options = self.options.changed(name, self._possible(value) if name == UPSCALING else value)

    def _possible(self, upscale: float) -> float:
        """Return the nearest possible value: a sequence on disk was rendered for one factor."""
        source = self._source
        if not upscale or source is None or source.live:
            return upscale
        return max(round(source.width / source.render_size[0], 2), 1.0)

    def is_on(self, name: str) -> bool:
        """Return whether a module is on; shading correction that failed is off."""
        if name == CORRECTION:
            return self.options.corrects_shading and self.network_fault is None
        return self.value(name) != ALL[name].off

    def fault(self, name: str) -> str | None:
        """Return why a module was switched off, if it could not work; None otherwise."""
        return self.network_fault if name == CORRECTION else None

    def switch(self, name: str, on: bool) -> None:
        """Switch a module. An earlier failure of shading correction is forgotten."""
        option = ALL[name]
        if name == CORRECTION:
            self.network_fault = None
        usual = option.default if option.default != option.off else self._least(option)
        self.set(name, usual if on else option.off)

    @staticmethod
    def _least(option: Option) -> Any:
        """Return the value that switches a module on that is usually off."""
        if option.kind is bool:
            return True
        if option.choices:
            return next(choice for choice in option.choices if choice != option.off)
        return option.low if option.low != option.off else option.low + 1

    def take(self, options: Options, window: str | None) -> None:
        """Set options and window at once. An earlier failure of shading correction is forgotten."""
        self.network_fault = None
        self.options, self.window = replace(options, **ALWAYS), window

    def use_preset(self, name: str) -> None:
        """Set the options that presets set to those of preset `name`. An earlier failure of shading correction is
        forgotten."""
        self.network_fault = None
        values = PRESETS[name].values
        for option in dict.fromkeys(option for preset in PRESETS.values() for option in preset.values):
            self.set(option, values.get(option, OPTIONS[option].default))

    def use_defaults(self) -> None:
        """Set all offered parameters to their defaults, except those of rendering."""
        self.network_fault = None
        for name in self.offered().keys() - {"window", "scene_window", "render_rate"}:
            self.set(name, ALL[name].default)

    # ---- from one start to the next ------------------------------------------------------------------------

    def preferences(self) -> dict[str, Any]:
        """Return the values to remember, as plain JSON."""
        return {name: self.value(name) for name, option in ALL.items() if option.remembered}

    def restore(self, saved: dict[str, Any]) -> None:
        """Restore the result of `preferences`. Command line options stay, and a damaged value affects only itself. A
        module that may be automatic is off or automatic."""
        chosen = {name for name, option in ALL.items() if self.value(name) != option.default}
        if self.options.scn_model is not None:
            chosen.add(CORRECTION)
        for name, option in ALL.items():
            automatic = option.automatic is not None and option.is_module
            if (
                not option.remembered
                or name not in saved
                or name in chosen
                or (automatic and saved[name] != option.off)
            ):
                continue
            try:
                self.set(name, saved[name])
            except GffeError:
                continue
