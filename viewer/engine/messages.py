"""What the engine and the interface tell each other; all of it immutable."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from gffe_cl.frame import BadPixels
from gffe_cl.options import Options
from gffe_cl.viewer.engine.buffers import Moment
from gffe_cl.viewer.engine.layers import LayerSpec
from gffe_cl.viewer.engine.story import Story


@dataclass(frozen=True)
class Setup:
    """What is computed. `window`: of `FrameSource.configure`; `n`: generated frames per rendered one, 1 … 7."""

    options: Options = field(default_factory=Options)
    window: str | None = None
    n: int = 1


@dataclass(frozen=True)
class Request:
    """A wish for a slot. `layers`: names of what to read back; `metrics`: measure it against the truth."""

    slot: int
    setup: Setup
    layers: frozenset[str]
    serial: int
    metrics: bool = False


@dataclass(frozen=True)
class Metrics:
    """Of the extrapolated frame at `slot` against ground truth: `values` by name of the metric, as far as they are
    measured."""

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
        The layers asked for that exist: (planes?, H, W, channels?), the receiver's own; colours (H, W, 4) float16.
        At a rendered slot the stages' layers after `submit` still hold the extrapolated frame before it, if they are
        there, and "truth" is the rendered frame's display part.
    specs : dict
        All layers that can be asked for.
    milliseconds : dict
        Kernel time per stage for this slot, without warm-up.
    wall_ms, readback_ms : float
        From taking the request to its images, warm-up included; the reading back in it.
    warnings : tuple of str
    bad_pixels : BadPixels
        Of rendered frame k.
    metrics : dict
        Of "final" by name, those that are known already; for the others see `Engine.poll_metrics`.
    cuts : frozenset of int
        Rendered frames that were found to be cuts so far.
    """

    request: Request
    moment: Moment
    images: dict[str, np.ndarray]
    specs: dict[str, LayerSpec]
    milliseconds: dict[str, float]
    wall_ms: float
    readback_ms: float
    warnings: tuple[str, ...] = ()
    bad_pixels: BadPixels = field(default_factory=BadPixels)
    metrics: dict[str, float] = field(default_factory=dict)
    cuts: frozenset[int] = frozenset()


@dataclass(frozen=True)
class EngineError:
    """What went wrong with the request `serial`; `during`: "device", "source", "kernels", "slot", "inspection",
    "bandwidth", "metrics"; "network": of shading correction, while a slot was made."""

    message: str
    serial: int
    during: str = "slot"


@dataclass(frozen=True)
class Inspection:
    """What the slot last computed holds at display pixel `pixel`.

    `values` are (planes?, channels) by layer: on grid "target" those of the pixel, on "source" and "level l" those of
    `source`, the position in the rendered image (pixels) that the warp's motion points to.
    """

    pixel: tuple[int, int]
    slot: int
    source: tuple[float, float] | None
    values: dict[str, np.ndarray]
    story: Story


class Closing(Exception):
    """The engine is being closed."""
