"""Options of the pipeline, described once: the command line, the viewer's panel, palette and settings, and the
documentation come from `OPTIONS`."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import is_number, require_choice, scalar, shown
from gffe_cl.engine.inference import network
from gffe_cl.engine.opencl.program import constants

_CONSTANTS = constants("frame.h")
MAX_ORDER, MAX_LEVELS = _CONSTANTS["MAX_ORDER"], _CONSTANTS["MAX_LEVELS"]
# Ways to fill holes: what they do with a pixel's color, for help and for the story of a pixel.
HOLE_FILLINGS = {
    "far-side": "continues the far side of the hole",
    "downsample": "comes from the image downsampled 32 times, as in the paper",
    "none": "stays black, at infinite depth",
}


@dataclass(frozen=True)
class Option:
    """One field of `Options`, described.

    Attributes
    ----------
    name, default : of the field
    label : short, for panels and menus
    sentence : for help and tooltips
    kind : bool, int, float or str
    low, high : range of a number, both included, beside `off`; `usual_high` is where sliders end
    unit : of a number
    choices : of a string, with a sentence each; empty if any will do
    automatic : the meaning of None ("auto": found out from the data), where None is allowed
    off : the value that switches a module off; False for a bool, None if it is no module
    flag : of the command line; of a bool that is on by default, the flag that switches it off
    spelled : of a bool, whether its flag is followed by "on" or "off"
    off_flag : of the command line, short for the value `off`
    remembered : by the viewer, from one start to the next
    needs : another option, a module, without which it has no effect
    """

    name: str = ""
    default: Any = None
    label: str = ""
    sentence: str = ""
    kind: type = bool
    low: float = -math.inf
    high: float = math.inf
    usual_high: float | None = None
    unit: str = ""
    choices: dict[str, str] = field(default_factory=dict)
    automatic: str | None = None
    off: Any = None
    flag: str | None = None
    spelled: bool = False
    off_flag: str | None = None
    remembered: bool = True
    needs: str | None = None

    @property
    def is_module(self) -> bool:
        """Whether the option is a module, which can be switched on and off."""
        return self.off is not None

    def words(self, value: Any) -> list[str]:
        """Return the command-line words for `value`; none for the default, or for an option without a flag."""
        if self.flag is None or value == self.default:
            return []
        if self.spelled:
            return [self.flag, "on" if value else "off"]
        if self.kind is bool:
            on, _, off = self.flag.partition("/")
            return [on if value or not off else off]
        if self.off_flag and value == self.off:
            return [self.off_flag]
        return [self.flag, str(value)]

    def checked(self, value: Any) -> Any:
        """Return `value` in the type of the field. Raises GffeError if it is invalid."""
        if value is None and self.automatic is not None:
            return None
        given = value
        value = os.fspath(value) if isinstance(value, os.PathLike) else scalar(value)
        whole = isinstance(value, int) and not isinstance(value, bool)
        within = is_number(value) and (value == self.off or self.low <= value <= self.high)
        right = {
            bool: isinstance(value, bool),
            int: whole and within,
            float: within,
            str: isinstance(value, str) and (not self.choices or value in self.choices),
        }
        if not right[self.kind]:
            raise GffeError(f"options: {self.label} must be {self.expected}, got {shown(given)}")
        return self.kind(value)

    @property
    def expected(self) -> str:
        """The values that `checked` accepts, in words."""
        either = f", or {self.automatic}" if self.automatic else ""
        if self.choices:
            return ", ".join(self.choices) + either
        if self.kind is bool:
            return "on or off (True or False)" + either
        if self.kind is str:
            return "a text" + either
        what = "a whole number" if self.kind is int else "a number"
        unit = f" of {self.unit}" if self.unit else ""
        off = "" if self.off is None or self.off >= self.low else f"{self.off:g} or "
        bounds = f"{off}{self.low:g} to {self.high:g}" if math.isfinite(self.high) else f"≥ {self.low:g}"
        return f"{what}{unit}, {bounds}{either}"


def _option(default: Any, label: str, sentence: str, **about: Any) -> Any:
    about = {"kind": type(default), **about}
    if about["kind"] is bool and "off" not in about:
        about["off"] = False
    return field(default=default, metadata={"option": Option(label=label, sentence=sentence, default=default, **about)})


@dataclass(frozen=True)
class Preset:
    """Named choice of quality against cost: `sentence`, for help texts, and `values` of options by name; all others
    have their defaults."""

    sentence: str
    values: dict[str, Any]


PRESETS = {
    "quality": Preset(
        "Everything is splatted, so that edges hardly moving apart are exact, too.",
        {"blocks": False},
    ),
    "balanced": Preset("The defaults.", {}),
    "performance": Preset(
        "The dilated warp, without background, silhouettes and shading correction.",
        {"warp": "dilated", "shading_correction": False},
    ),
}


@dataclass(frozen=True)
class Options:
    """Settings of the pipeline; the defaults are recommended. `OPTIONS` describes each field, `PRESETS` choices.

    Raises GffeError for invalid values.
    """

    def __new__(cls, *_: Any, **values: Any) -> Options:
        """Return options. Raises GffeError for `preset`, which is none of them."""
        if "preset" in values:
            raise GffeError(f"options: preset is no option (expected Options.preset({values['preset']!r}))")
        return super().__new__(cls)

    cut_detection: bool = _option(
        True,
        "cut detection",
        "Detection of cuts: a rendered frame that shares nothing with the frame before is a reset; off: only"
        " marked frames are resets.",
        flag="--no-cut-detection",
    )
    motion: bool = _option(
        True, "motion estimation", "Tracking of moving objects; off: everything is static.", flag="--no-motion"
    )
    history: int = _option(
        2,
        "history",
        "History length k: positions kept per fragment, including the current one.",
        low=2,
        high=MAX_ORDER + 1,
        unit="positions",
        flag="--history",
    )
    order: int = _option(
        1,
        "prediction order",
        "Degree m of the position prediction, less than the history length; 1 is linear, as in the paper.",
        low=1,
        high=MAX_ORDER,
        flag="--order",
    )
    camera_fixed: bool = _option(
        True,
        "camera-fixed objects",
        "Prediction in view space of objects that stay there, such as dashboards and weapons, and, with"
        " acceleration, of those that move evenly there, such as wipers and hands; off: they are predicted in"
        " world space, as in the paper.",
        flag="--no-camera-fixed",
        needs="motion",
    )
    entering: bool = _option(
        True,
        "entering movers",
        "Parts of movers that come into view, from behind others or through the image's border: they go on as they"
        " came; off: as in the paper, they stay where they are at first.",
        flag="--no-entering",
        needs="motion",
    )
    acceleration: bool = _option(
        True,
        "acceleration",
        "Curved paths of moving objects, in addition to the linear prediction of order 1; off: straight paths.",
        flag="--no-acceleration",
        needs="motion",
    )
    static_threshold: float | None = _option(
        None,
        "static threshold",
        "Static threshold ε, pixels: fragments that move farther are dynamic; auto follows the noise and the"
        " quantization of the motion vectors.",
        kind=float,
        low=0.0,
        high=1e6,
        usual_high=8.0,
        unit="pixels",
        automatic="auto",
        flag="--static-threshold",
    )
    camera_order: int | None = _option(
        None,
        "camera prediction's order",
        "Order of camera prediction, where the new camera is unknown: 1 straight, as in the paper; 2 curved;"
        " auto curved and adapted to a shaking camera.",
        kind=int,
        low=1,
        high=2,
        automatic="auto",
        flag="--camera-order",
    )
    warp: str = _option(
        "footprints",
        "warp",
        "Way in which rendered pixels are carried to the new frame.",
        choices={
            "footprints": "Pixels by the areas that they map to, with background, silhouettes and hole filling",
            "dilated": "Motion of the nearest of 3×3 pixels; for holes, too",
        },
        flag="--warp",
    )
    resampling: str = _option(
        "perceptual",
        "resampling",
        "Color values that are interpolated and blended.",
        choices={
            "perceptual": "Perceptual values, like a square root where it is dark",
            "linear": "Linear light, as in the paper",
        },
        flag="--resampling",
    )
    sharpness: bool = _option(
        True,
        "sharpness",
        "Sharpness of interpolated edges, as measured on rendered frames; off: plain cubic interpolation, which softens"
        " them.",
        flag="--no-sharpness",
    )
    detail: bool = _option(
        False,
        "detail",
        "Fine detail as strong as in rendered frames, at a larger error; off: as soft as makes the error least. Without"
        " upscaling only.",
        flag="--detail",
    )
    crack_closing: bool = _option(
        True,
        "crack closing",
        "Closing of cracks: a fragment covers the area that its pixel maps to; off: single pixels, as in the paper.",
        flag="--no-crack-closing",
    )
    lattices: bool = _option(
        True,
        "lattices",
        "Fences of wire and nets move as one layer; off: every pixel moves by its own depth.",
        flag="--no-lattices",
    )
    blocks: bool = _option(
        True,
        "backward blocks",
        "Backward warping of blocks where nothing moves apart; off: everything is splatted.",
        flag="--no-blocks",
        needs="crack_closing",
    )
    hidden_parts: bool = _option(
        True,
        "hidden parts of movers",
        "Filling of disocclusions from a moving object whose own motion explains them; off: from the background.",
        flag="--no-hidden-parts",
        needs="motion",
    )
    reappearing: bool = _option(
        True,
        "reappearing parts",
        "Parts of movers that come out from behind something nearer, as the frame before showed them; off: the surface"
        " behind them stays in view.",
        flag="--no-reappearing",
        needs="hidden_parts",
    )
    levels: int = _option(
        1,
        "background levels",
        "Background levels L: the first remembers surfaces behind movers; further ones, each at half the resolution,"
        " those behind static surfaces.",
        low=0,
        high=MAX_LEVELS,
        off=0,
        flag="--background-levels",
        off_flag="--no-background",
    )
    hole_filling: str = _option(
        "far-side",
        "hole filling",
        "Filling of pixels that neither the rendered frame nor the background shows.",
        choices=HOLE_FILLINGS,
        off="none",
        flag="--hole-filling",
    )
    soft_silhouettes: bool = _option(
        True,
        "soft silhouettes",
        "Antialiased edges of objects that move over others; off: edges as the warp leaves them, as in the paper.",
        flag="--no-soft-silhouettes",
    )
    upscale: float = _option(
        0.0,
        "upscaling",
        "Upscaling factor, display pixels per rendered pixel, each way: jittered frames are accumulated. 1:"
        " anti-aliasing only; 0: off.",
        low=1.0,
        high=3.0,
        off=0.0,
        flag="--upscale",
    )
    overlays: bool = _option(
        True,
        "overlays",
        "Overlays of rendered frames, effects and user interface, that stay in place; off: they are ignored.",
        flag="--no-overlays",
    )
    ui_detection: bool = _option(
        False,
        "user interface detection",
        "Detection of a user interface in the color: pixels that stay although vectors move them keep their place;"
        " off: they are warped.",
        flag="--ui-detection",
        spelled=True,
    )
    expected_error: bool = _option(
        False,
        "expected error",
        "Mask of the expected error of new frames: where to render anew.",
        flag="--expected-error",
    )
    shading_inputs: bool = _option(
        False,
        "inputs of shading correction",
        "Inputs of shading correction: make them even where it is off.",
        remembered=False,
    )
    shading_correction: bool | None = _option(
        None,
        "shading correction",
        "Shading correction: a network moves shadows and reflections to where they belong.",
        kind=bool,
        off=False,
        automatic="auto: if there are weights",
        flag="--scn/--no-scn",
    )
    focus_mask: bool = _option(
        True,
        "focus mask",
        "Changes only where the network finds the shading wrong; off: the network's whole image.",
        flag="--no-focus-mask",
        needs="shading_correction",
    )
    image_flow: bool = _option(
        True,
        "image flow",
        "Effects without depth, shadows and reflections: moved half way along the flow of the image where that explains"
        " the last frames and motion vectors do not; off: they move with the surface behind.",
        flag="--no-image-flow",
        needs="shading_correction",
    )
    scn_model: str | None = _option(
        None,
        "network",
        "Shading correction network of your own, an ONNX file.",
        kind=str,
        automatic="auto: the package's own",
        flag="--scn-model",
        remembered=False,
    )
    scn_provider: str | None = _option(
        None,
        "network's provider",
        f"Runner of the network: {network.OPENCL}, its kernels; {network.ON_CPU}, onnxruntime; or {network.AUTO}.",
        kind=str,
        automatic=f"auto: {network.OPENCL} on GPUs, else {network.ON_CPU}",
        flag="--scn-provider",
        remembered=False,
    )

    def __post_init__(self):
        for name, option in OPTIONS.items():
            object.__setattr__(self, name, option.checked(getattr(self, name)))
        if self.order >= self.history:
            raise GffeError(f"options: order must be 1 to history − 1 = {self.history - 1}, got {self.order}")

    @classmethod
    def preset(cls, name: str, **values: Any) -> Options:
        """Return the options of a preset, "quality", "balanced" or "performance", with `values` of single options in
        place of its own. Raises GffeError for an unknown preset or an invalid value."""
        require_choice(name, PRESETS, "options: preset")
        return cls(**PRESETS[name].values | values)

    @cached_property
    def preset_name(self) -> str | None:
        """The preset that these options are, whatever those that no preset sets; None if they are none of them."""
        usual = {option: OPTIONS[option].default for preset in PRESETS.values() for option in preset.values}
        for name, preset in PRESETS.items():
            made = replace(self, **usual | preset.values)
            if replace(made, shading_correction=self.shading_correction) != self:
                continue
            if made.corrects_shading == self.corrects_shading:
                return name
        return None

    def changed(self, name: str, value: Any) -> Options:
        """Return these options with another value of one field. If history and order conflict, the other one is
        adapted. Raises GffeError for an unknown field or an invalid value."""
        require_choice(name, OPTIONS, "options: name")
        values = {name: (value := OPTIONS[name].checked(value))}
        if name == "history":
            values["order"] = max(1, min(self.order, value - 1))
        if name == "order":
            values["history"] = max(self.history, value + 1)
        return replace(self, **values)

    @property
    def warps_footprints(self) -> bool:
        """Whether the warp splats footprints, which the stages after it add to."""
        return self.warp == "footprints"

    @property
    def corrects_shading(self) -> bool:
        """Whether the shading correction network runs."""
        if self.shading_correction is None:
            return self.scn_model is not None or network.default_model() is not None
        return self.shading_correction

    @property
    def weights(self) -> Path | None:
        """The file of the shading correction network that runs; None if none runs, or if there is none."""
        if not self.corrects_shading:
            return None
        return network.default_model() if self.scn_model is None else Path(self.scn_model)


OPTIONS: dict[str, Option] = {f.name: replace(f.metadata["option"], name=f.name) for f in fields(Options)}


def command_words(options: Options) -> list[str]:
    """Return the options of `gffe run` that give `options`; those of a network that does not run are left out."""
    without = () if options.shading_correction is not False else ("focus_mask", "scn_model", "scn_provider")
    return [
        word for name, option in OPTIONS.items() if name not in without for word in option.words(getattr(options, name))
    ]
