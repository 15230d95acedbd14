"""Messages between a program and the viewer that is attached to it. `encoding` turns them into bytes."""

from __future__ import annotations

from dataclasses import dataclass

from gffe_cl.engine.core.validation import require_frame_rate, require_size, require_whole
from gffe_cl.engine.frame.rendered_frame import BadPixels
from gffe_cl.engine.inspection.attached.shared_memory import Placed, RecordingPlan
from gffe_cl.engine.inspection.buffers import Moment
from gffe_cl.engine.inspection.explain.pixel_explain_types import Inspection
from gffe_cl.engine.inspection.layers import LayerSpec
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pacing import PacingStatistics

MOST_FRAMES = 256  # that a program records


# ---- from the viewer ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Greeting:
    """First message. `frames`: rendered frames that the program is to keep, 0 to `MOST_FRAMES`."""

    frames: int

    def __post_init__(self):
        require_whole(self.frames, "attach: frames", 0, MOST_FRAMES)


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
    """Request to change the pipeline's options before the next rendered frame. Answered by `Refused` if that fails."""

    options: Options


# ---- from the program --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Program:
    """Answer to the greeting: description of the program. Sizes are (width, height)."""

    pid: int
    display: tuple[int, int]
    render_size: tuple[int, int]
    fps: float
    device: str
    options: Options

    def __post_init__(self):
        for size in (self.display, self.render_size):
            require_size(size, "attach: size", whole=True)
        require_frame_rate(self.fps, "attach: fps")


@dataclass(frozen=True)
class Recording:
    """Layout of the last rendered frames, which are kept in the block whose descriptor comes with this message."""

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
    buffers: tuple[str, ...] = ()


@dataclass(frozen=True)
class Refused:
    """Answer to `Use` if the options could not be used: the reason, and the options that the pipeline still has."""

    why: str
    options: Options


FROM_VIEWER = Look, Ask, Use  # after the greeting
FROM_PROGRAM = Recording, Seen, Inspection, Refused  # after `Program`
