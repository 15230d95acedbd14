"""Background collection and projection (paper: 'Hierarchical Background Collection')."""

from __future__ import annotations

import numpy as np

from gffe_cl.buffers import RGBA, XY, BufferSpec
from gffe_cl.opencl.program import constants
from gffe_cl.stage import Access, Board, Kernel, NearestStage, Step, reprojection, zoom

MAX_LEVELS = 4
_CONSTANTS = constants("background.cl")
_OWN_TEXEL, _TOUCHED_TEXELS = _CONSTANTS["OWN_TEXEL"], _CONSTANTS["TOUCHED_TEXELS"]  # phases of scatter_level
REMEMBERED = _CONSTANTS["REMEMBERED"]
STATES = (
    (_CONSTANTS["EMPTY"], "empty"),
    (_CONSTANTS["SHOWN"], "shown by the current frame"),
    (REMEMBERED, "remembered"),
)

_FRAME = {"depth": "rendered.depth", "dynamic_mask": "history.dynamic_mask", "links": "surfaces.links"}


def _keys(which: str, share: str | float = 1.0, prefix: str = "") -> dict:
    """Keys and winners, as arguments that begin with `prefix`."""
    return {f"{prefix}{name}": Access(f"background.{which}_{name}", share) for name in ("keys", "winners")}


_OFFERED = _keys("fill", "remembered", "fill_") | _keys("push", "remembered", "push_")
_PROJECTED = _keys("target", "holes")


def _level(names: str, level: str = "level", share: str | float = 1.0, prefix: str = "level_", kept: str = "") -> dict:
    """Buffers of the level that the launch gives."""
    return {f"{prefix}{name}": Access(f"background.{name}_{{{level}}}{kept}", share) for name in names.split()}


class Background(NearestStage):
    """Remembers, in L levels, the static fragments that are hidden now, and fills disocclusions from them."""

    name = "background"
    kernels = (
        Kernel(
            "collect_shown",
            "source",
            {"color": "rendered.color", "depth": "rendered.depth", "dynamic_mask": "history.dynamic_mask"},
            _level("color depth px state"),
        ),
        Kernel(
            "scatter_level",
            "level{level}",
            _FRAME | _level("depth px state", prefix="old_", kept="'") | _level("depth state") | _OFFERED,
            _OFFERED,
        ),
        Kernel(
            "settle_level",
            "level{level}",
            _keys("{which}") | _level("color depth px", "old", "remembered", "old_", "'"),
            _level("color depth px state", share="remembered"),
        ),
        Kernel(
            "project_level",
            "level{level}",
            _level("depth px", share="remembered")
            | _level("state")
            | {
                "disoccluded": Access("frame.disoccluded", "remembered"),
                "mixed": Access("frame.mixed", "remembered"),
                "depth": Access("frame.depth", "remembered"),
            }
            | _PROJECTED,
            _PROJECTED,
        ),
        Kernel(
            "fill_from_level",
            "target",
            _keys("target")
            | _level("color depth px state", share="holes")
            | {
                "disoccluded": Access("frame.disoccluded", "holes"),
                "is_dynamic": Access("frame.dynamic", "holes"),
                "out_depth": Access("frame.depth", "holes"),
            },
            {
                "color": Access("frame.color", "holes"),
                "out_depth": Access("frame.depth", "disoccluded"),
                "motion": Access("frame.motion", "disoccluded"),
                "filled_by": Access("frame.filled_by", "holes"),
            },
        ),
    )

    def __init__(self, board: Board):
        self.levels = board.options.levels
        self.buffers = (
            *(spec for level in range(self.levels) for spec in _level_buffers(level)),
            *self.keys(board, "fill_", "source"),
            *self.keys(board, "push_", "level1"),
            *self.keys(board, "target_", "target"),
        )
        super().__init__(board)

    @classmethod
    def is_wanted(cls, options) -> bool:
        return options.levels > 0

    def rendered(self, step: Step) -> None:
        """Collect; after a reset nothing is kept, nor collected, because what moves is not known yet."""
        self.swap()
        self.launch("collect_shown", level=0, collect=step.previous is not None)
        if step.previous is None:
            for level in range(1, self.levels):
                self.fill(f"state_{level}", 0)
            return
        to_current = reprojection(step.previous.camera, step.frame.camera)
        for level in range(self.levels):
            self.clear_keys("push_", self.sizes.of(f"level{level + 1}"))
            self._scatter(level, _OWN_TEXEL, to_current)
            self._settle(level, level, "fill", to_current)
            if level + 1 < self.levels:
                self._settle(level + 1, level, "push", to_current)
            self._scatter(level, _TOUCHED_TEXELS, to_current)
            self._settle(level, level, "fill", to_current)

    def _scatter(self, level: int, phase: int, to_current: np.ndarray) -> None:
        self.clear_keys("fill_", self.sizes.of(f"level{level}"))
        for scatter_pass in self.passes:
            self.launch(
                "scatter_level",
                level=level,
                last_level=self.levels - 1,
                phase=phase,
                to_current=to_current,
                **{"pass": scatter_pass},
            )

    def _settle(self, level: int, old: int, which: str, to_current: np.ndarray) -> None:
        """Put the winners of the old level `old` into `level`; what was pushed down begins it anew."""
        self.launch("settle_level", level=level, old=old, which=which, restart=which == "push", to_current=to_current)

    def extrapolated(self, step: Step) -> None:
        """Fill the pixels that the warp left invalid, nearest fragment of all levels first."""
        source, target = step.frame.camera, step.camera
        cameras = {"zoom": zoom(source, target), "to_target": reprojection(source, target)}
        self.clear_keys("target_", self.sizes.target)
        for project_pass in self.passes:
            for level in range(self.levels):
                self.launch("project_level", level=level, **cameras, **{"pass": project_pass})
        for level in range(self.levels):
            self.launch("fill_from_level", level=level, to_source=reprojection(target, source), **cameras)


def _level_buffers(level: int) -> tuple[BufferSpec, ...]:
    grid = f"level{level}"
    return (
        BufferSpec(
            f"color_{level}", np.float16, RGBA, grid, f"colour of background level {level} (B_{level})", "color",
            kept=True,
        ),
        BufferSpec(
            f"depth_{level}", np.float32, (), grid, f"view depth of background level {level}, world units", "depth",
            kept=True,
        ),
        BufferSpec(
            f"px_{level}", np.float32, XY, grid, "where its fragment lies in the rendered image, pixels", "place",
            kept=True,
        ),
        BufferSpec(
            f"state_{level}", np.uint8, (), grid, "what the level knows there", "label", labels=STATES, kept=True
        ),
    )  # fmt: skip
