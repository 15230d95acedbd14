"""Messages between the engine and the interface, all immutable."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from gffe_cl.engine.frame.rendered_frame import BadPixels
from gffe_cl.engine.options import Options
from .buffers import Moment
from .explain.pixel_explain_types import Story
from .invalid import Invalid
from .layers import LayerSpec


@dataclass(frozen=True)
class Setup:
    """Setup of the computation. `window`: of `FrameSource.configure`; `n`: generated frames per rendered one, 1 … 7;
    `kernels`: a build that was in use since the viewer started, by its `Kernels.identity`; empty: the newest."""

    options: Options = field(default_factory=Options)
    window: str | None = None
    n: int = 1
    kernels: str = ""


@dataclass(frozen=True)
class Recipe:
    """Dependencies of a source's slots: how often it was opened, flown poses, the setup, version of kernels and of
    weights."""

    source: int
    flight: int
    setup: Setup
    kernels: str
    weights: str = ""


@dataclass(frozen=True)
class Request:
    """Request for a slot. `layers`: names of the layers to read back; `metrics`: measure it against the truth;
    `role`: the pipeline that makes it, so that each can continue: "a" and "b" are displayed, "ahead" fills the
    cache; `keep`: store it in the cache."""

    slot: int
    setup: Setup
    layers: frozenset[str]
    serial: int
    metrics: bool = False
    role: str = "a"
    keep: bool = True


@dataclass(frozen=True)
class Metrics:
    """Metrics of the extrapolated frame at `slot` against ground truth: `values` by name of the metric, as far as they
    are measured."""

    slot: int
    setup: Setup
    values: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Result:
    """A computed slot.

    Attributes
    ----------
    request, moment
        What was asked for, and what it shows.
    images : dict
        The layers asked for that exist: (planes?, H, W, channels?), the receiver's own; colors (H, W, 4) float16.
        A rendered slot has none of the layers of generated frames, and its "truth" is the rendered frame's display
        part.
    specs : dict
        All layers that can be asked for.
    kernels : dict
        Milliseconds by stage and kernel for this slot, without warm-up.
    wall_ms, readback_ms : float
        From taking the request to its images, warm-up included; the reading back in it.
    warnings : tuple of str
    bad_pixels : BadPixels
        Of rendered frame k.
    invalid : Invalid or None
        Where those of them are that the pipeline cannot use; None if there are none, or if that is not known.
    metrics : dict
        Of "final" by name, those that are known already; for the others see `Engine.poll_metrics`.
    cuts : frozenset of int
        Rendered frames that were found to be cuts so far.
    render_size : (width, height)
        Of rendered frame k.
    buffers : tuple of str
        Properties of the engine's buffers that differ from our conventions.
    recipe : Recipe or None
        Everything that it was made from.
    """

    request: Request
    moment: Moment
    images: dict[str, np.ndarray]
    specs: dict[str, LayerSpec]
    kernels: dict[str, dict[str, float]]
    wall_ms: float
    readback_ms: float
    warnings: tuple[str, ...] = ()
    bad_pixels: BadPixels = field(default_factory=BadPixels)
    invalid: Invalid | None = None
    metrics: dict[str, float] = field(default_factory=dict)
    cuts: frozenset[int] = frozenset()
    render_size: tuple[int, int] = (0, 0)
    buffers: tuple[str, ...] = ()
    recipe: Recipe | None = None

    @property
    def milliseconds(self) -> dict[str, float]:
        """Kernel time by stage."""
        return {stage: sum(kernels.values()) for stage, kernels in self.kernels.items()}


@dataclass(frozen=True)
class EngineError:
    """Failure of the request `serial`; `during`: "device", "source", "kernels", "slot", "inspection",
    "bandwidth", "metrics"; "network": of shading correction, while a slot was made."""

    message: str
    serial: int
    during: str = "slot"


@dataclass(frozen=True)
class Inspection:
    """Values of the slot last computed at display pixel `pixel`.

    `values` are (planes?, channels) by layer, as the picture shows them at the pixel. `source` is the position in the
    rendered image (pixels) that the warp's motion points to, and `origin` the values there of the layers on that image;
    of a rendered slot, whose pixels come from where they are, there are none. `fault`: why the pixel at `source` is
    invalid; empty if it is not. `recipe`: of the slot.
    """

    pixel: tuple[int, int]
    slot: int
    source: tuple[float, float] | None
    values: dict[str, np.ndarray]
    story: Story
    fault: str = ""
    origin: dict[str, np.ndarray] = field(default_factory=dict)
    recipe: Recipe | None = None

    def of(self, layers: frozenset[str] | None) -> Inspection:
        """Return the same with the values of `layers` alone; None: of all."""
        if layers is None:
            return self
        values, origin = ({name: of[name] for name in of if name in layers} for of in (self.values, self.origin))
        return replace(self, values=values, origin=origin)


class Closing(Exception):
    """The engine is being closed."""


class Interrupted(Exception):
    """Something else is wanted first."""
