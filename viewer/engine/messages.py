"""Messages between the engine and the interface, all immutable."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from gffe_cl.engine.frame.rendered_frame import HALF_MAX, BadPixels
from gffe_cl.engine.inspection.buffers import Moment
from gffe_cl.engine.inspection.layers import LayerSpec
from gffe_cl.engine.options import Options


@dataclass(frozen=True)
class Setup:
    """Setup of the computation. `window`: of `FrameSource.configure`; `n`: generated frames per rendered one, 1 … 7;
    `kernels`: a build that was in use since the viewer started, by its `Kernels.identity`; empty: the newest. `place`:
    where pictures are stored that are shown instead of computed ones; empty: nowhere."""

    options: Options = field(default_factory=Options)
    window: str | None = None
    n: int = 1
    kernels: str = ""
    place: str = ""


@dataclass(frozen=True)
class Recipe:
    """Dependencies of a source's slots: how often it was opened, the setup, version of kernels and of
    weights. Stored pictures have a version instead of `weights`."""

    source: int
    setup: Setup
    kernels: str
    weights: str = ""


@dataclass(frozen=True)
class Key:
    """Name of a slot's pictures: everything that they depend on. `provisional`: only the last few rendered frames were
    submitted, not all since the last reset as in `gffe run`."""

    recipe: Recipe
    slot: int
    provisional: bool = False


@dataclass(frozen=True)
class Frame:
    """A computed slot.

    Attributes
    ----------
    key, moment
        What it was made from, and what it shows.
    layers : frozenset of str
        The layers that were asked for.
    images : dict
        The layers asked for that exist: (planes?, H, W, channels?), the receiver's own; colors (H, W, 4) float16.
        A rendered slot has none of the layers of generated frames, and its "truth" is the rendered frame's display
        part.
    specs : dict
        All layers that can be asked for.
    kernels : dict
        Milliseconds by stage and kernel for this slot, without warm-up.
    wall_ms, readback_ms : float
        From taking the slot up to its images, warm-up included; the reading back in it.
    warnings : tuple of str
    bad_pixels : BadPixels
        Of rendered frame k.
    cuts : frozenset of int
        Rendered frames that were found to be cuts so far.
    submitted : int
        Rendered frames that were submitted for it: more than one after a jump.
    render_size : (width, height)
        Of rendered frame k.
    buffers : tuple of str
        Properties of the engine's buffers that differ from our conventions.
    """

    key: Key
    layers: frozenset[str]
    moment: Moment
    images: dict[str, np.ndarray]
    specs: dict[str, LayerSpec]
    kernels: dict[str, dict[str, float]]
    wall_ms: float
    readback_ms: float
    warnings: tuple[str, ...] = ()
    bad_pixels: BadPixels = field(default_factory=BadPixels)
    cuts: frozenset[int] = frozenset()
    submitted: int = 0
    render_size: tuple[int, int] = (0, 0)
    buffers: tuple[str, ...] = ()

    @property
    def slot(self) -> int:
        return self.key.slot

    @property
    def setup(self) -> Setup:
        return self.key.recipe.setup

    @property
    def nbytes(self) -> int:
        """Bytes of its pictures, and of what comes with them."""
        return sum(image.nbytes for image in self.images.values()) + 4096

    @property
    def milliseconds(self) -> dict[str, float]:
        """Kernel time by stage."""
        return {stage: sum(kernels.values()) for stage, kernels in self.kernels.items()}


@dataclass(frozen=True)
class Failure:
    """Reason why there is nothing, in one line. `during`: "slot", "network" (of shading correction, while a slot was
    made), "inspection", and of the engine's other work "device", "source", "kernels"."""

    error: str
    during: str = "slot"


class Closing(Exception):
    """The engine is being closed."""


class Interrupted(Exception):
    """Something else is wanted first."""


def rgba_of(color: np.ndarray) -> np.ndarray:
    """Return colors (H, W, 3) as (H, W, 4) float16 with 0 in the last channel; other types are clipped to float16's
    range."""
    out = np.zeros((*color.shape[:2], 4), np.float16)
    out[..., :3] = color if color.dtype == np.float16 else np.clip(color, -HALF_MAX, HALF_MAX)
    return out
