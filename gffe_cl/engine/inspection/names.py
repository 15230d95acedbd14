"""Names of layers with special treatment in the viewer. All others come from the pipeline."""

from __future__ import annotations

from typing import TypeGuard

FINAL, GAE, TRUTH, FOCUS_TRUTH = "final", "gae", "truth", "focus_truth"
RENDERED_COLOR, RENDERED_DEPTH, RENDERED_MOTION = "rendered.color", "rendered.depth", "rendered.motion"
UNDONE, RESIDUAL = "rendered.undone", "rendered.residual"

# of the extrapolated frame
DEPTH, MOTION, DYNAMIC = "frame.depth", "frame.motion", "frame.dynamic"
DISOCCLUDED, FILLED_BY = "frame.disoccluded", "frame.filled_by"

# of stages
HISTORY, MET_DEPTH, DYNAMIC_MASK = "history.history", "history.met_depth", "history.dynamic_mask"
VELOCITY, ACCELERATION = "acceleration.velocity", "acceleration.acceleration"
VIEW_VELOCITY, BEND = "acceleration.view_velocity", "acceleration.bend"
LINKS = "connectivity.links"  # neighbors of one surface, a bit each
TARGET_POSITION = "prediction.target_position"
COVERAGE = "silhouettes.coverage"
EXPECTED_ERROR = "shading.expected_error"
FOCUS_MASK, FOLLOWED = "correction.focus_mask", "shading_flow.followed"


def background(name: str, level: int) -> str:
    """Return the name of a layer of background level `level`; `name`: "color", "depth", "px" or "state"."""
    return f"background.{name}_{level}"


_SECOND = "B:"


def of_second(name: str) -> str:
    """Return the name of the same layer as the other settings (B) make it."""
    return name if name.startswith(_SECOND) else _SECOND + name


def is_second(name: str | None) -> TypeGuard[str]:
    return name is not None and name.startswith(_SECOND)


def plain(name: str) -> str:
    """Return the layer's own name, whichever settings make it."""
    return name.removeprefix(_SECOND)
