"""Protocol between a program and the viewer that is attached to it."""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version

from gffe_cl.frame.rendered_frame import BadPixels
from gffe_cl.pipeline.options import Options
from gffe_cl.pipeline.pacing import PacingStatistics
from gffe_cl.viewer.engine.attached.shared_memory import Placed, RecordingPlan
from gffe_cl.viewer.engine.buffers import Moment
from gffe_cl.viewer.engine.layers import LayerSpec


def own_version() -> str:
    """Of the package: both sides must be the same, since they exchange its objects."""
    try:
        return version("gffe-cl")
    except PackageNotFoundError:
        return "not installed"


# ---- from the viewer ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Greeting:
    """`version`: of the package; `frames`: rendered frames that the program is to keep."""

    version: str
    frames: int


@dataclass(frozen=True)
class Look:
    """Request for the next frame with these layers. `generated`: skip rendered frames if the program generates
    others. Each request has one answer, `Seen`."""

    layers: frozenset[str]
    generated: bool = False


@dataclass(frozen=True)
class Ask:
    """Request for the next frame's values at display pixel (x, y). `layers`: None for all. The answer is an
    `Inspection`."""

    x: int
    y: int
    layers: frozenset[str] | None = None


@dataclass(frozen=True)
class Use:
    """Change the pipeline's options before the next rendered frame. Answered by `Refused` if that fails."""

    options: Options


# ---- from the program --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Program:
    """Description of the answering program: sizes are (width, height). `refused`: the reason if viewers are refused."""

    version: str
    pid: int = 0
    display: tuple[int, int] = (0, 0)
    render_size: tuple[int, int] = (0, 0)
    fps: float = 30.0
    device: str = ""
    options: Options = field(default_factory=Options)
    refused: str = ""


@dataclass(frozen=True)
class Recording:
    """Where the last rendered frames are kept: in the block whose descriptor comes with this."""

    plan: RecordingPlan


@dataclass(frozen=True)
class Seen:
    """A frame. `images`: their places in the shared block, whose descriptor comes with the first message and after
    each change of the block; `specs`: of all layers, None if unchanged; `frame_ms`: from the last frame to this one,
    without the viewer's cost; `look_ms`: that cost. Other fields as in `Result`."""

    moment: Moment
    images: dict[str, Placed]
    specs: dict[str, LayerSpec] | None
    kernels: dict[str, dict[str, float]]
    frame_ms: float
    look_ms: float
    bad_pixels: BadPixels
    exposure: float
    options: Options
    pacing: PacingStatistics | None = None


@dataclass(frozen=True)
class Refused:
    """Options could not be used."""

    why: str
    options: Options
