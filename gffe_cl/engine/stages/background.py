"""Background collection and projection (paper: 'Hierarchical Background Collection')."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pyopencl as cl

from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.base import Board, Kernel, NearestStage, Step
from gffe_cl.engine.stages.buffers import RGBA, XY, BufferSpec, Sizes, grid_of
from gffe_cl.engine.stages.pixel_formats import OFFSET, RGB9E5

_CONSTANTS = constants("background.cl")
EMPTY, SHOWN, REMEMBERED, EDGE = (_CONSTANTS[name] for name in ("EMPTY", "SHOWN", "REMEMBERED", "EDGE"))
STATES = (
    (EMPTY, "empty"),
    (SHOWN, "shown by the current frame"),
    (REMEMBERED, "remembered"),
    (EDGE, "beside a nearer static surface"),
)


_KEY_MEMORY = ("key_memory", "winner_memory")  # of even levels
_SPARES = 8  # times the alignment: lent memory beyond this stage's needs, because its parts are aligned


def _keys(which: str) -> dict[str, str]:
    """Return keys and winners of the candidates that "fill" a level, or that it can "push" to the next one."""
    return {f"{which}_{name}": f"background.{{{which}_by}}_{name}" for name in ("keys", "winners")}


def _level(names: str, level: str = "level", prefix: str = "level_", kept: str = "") -> dict[str, str]:
    """Return the arguments that are buffers of the level that is chosen at the launch."""
    return {f"{prefix}{name}": f"background.{name}_{{{level}}}{kept}" for name in names.split()}


def _levels(names: str) -> dict[str, str]:
    """Return the arguments that are buffers of all levels."""
    return {f"levels_{name}": f"background.{name}" for name in names.split()}


_OFFERED = _keys("fill") | _keys("push")
_SETTLED = {name: f"background.{{fill_by}}_{name}" for name in ("keys", "winners")}
_PROJECTED = {"keys": "warp.keys", "winners": "warp.winners"}


class Background(NearestStage):
    """Remembers, in L levels, the static fragments that are hidden now, and fills disocclusions from them.

    After collection nothing reads the earlier content of the levels, nor the keys of even levels. Until the next
    collection that memory is lent (see `Board`).
    """

    name = "background"
    needs_footprints = True
    kernels = (
        Kernel(
            "scatter_level",
            "level{level}",
            {
                "depth": "rendered.depth",
                "dynamic_mask": "history.dynamic_mask",
                "links": "connectivity.links",
                "last_stir": "history.last_stir",
                "frame_depth": "{depth_of_shown}",
                "taken": "background.state_{level}",
                "level_depth": "{depth_of_taken}",
            }
            | _level("depth px state", prefix="old_", kept="'")
            | _OFFERED,
            _OFFERED,
            step=("LANES", 1),
        ),
        Kernel(
            "settle_level",
            "flat_level{level}",
            {"frame_color": "previous.color", "frame_depth": "previous.depth"}
            | _level("state")
            | _SETTLED
            | _level("color depth px state", "from_level", "old_", "'"),
            _level("color depth px state") | _SETTLED,
            step=("SCAN_BYTES", 1),
            group="SCAN_GROUP",
        ),
        Kernel(
            "project_levels",
            "levels{levels}",
            _levels("depth px state") | {"disoccluded": "frame.disoccluded"} | _PROJECTED,
            _PROJECTED,
            step=("SCAN_BYTES", 1),
            group="SCAN_GROUP",
        ),
        Kernel(
            "fill_from_levels",
            "walk",
            {
                "frame_color": "rendered.color",
                "frame_depth": "rendered.depth",
                "open": "warp.open",
                "color_prev": "previous.color",
                "depth_prev": "previous.depth",
                "disoccluded": "frame.disoccluded",
                "color": "frame.color",
                "depth": "frame.depth",
                "filled_by": "frame.filled_by",
            }
            | _levels("color depth px state")
            | _PROJECTED,
            {
                "color": "frame.color",
                "depth": "frame.depth",
                "motion": "frame.motion",
                "filled_by": "frame.filled_by",
            },
            group="WALK_GROUP",
        ),
    )

    def __init__(self, board: Board):
        self.levels = board.options.levels
        self.starts = board.sizes.level_starts(self.levels)
        all_levels = [_all_levels(spec, self.levels) for spec in _level_buffers(0)]
        state = all_levels.pop()  # must last: memory between two levels is EMPTY
        even = self.keys(board, "even_", "source")
        self._places = _side_by_side(all_levels, board.sizes)
        self._places |= {replace(spec, part_of=whole): 0 for spec, whole in zip(even, _KEY_MEMORY, strict=True)}
        spare = _SPARES * board.sizes.alignment
        nbytes: dict[str, int] = dict.fromkeys(("memory", *_KEY_MEMORY), 0)
        for spec, start in self._places.items():
            nbytes[spec.part_of] = max(nbytes[spec.part_of], start + spec.nbytes(board.sizes) + spare)
        for spec, whole in zip(self.keys(board, "", "target"), _KEY_MEMORY, strict=True):  # the warp's fit in, too
            nbytes[whole] = max(nbytes[whole], spec.nbytes(board.sizes) + spare)
        self.buffers = (
            *(spec for level in range(self.levels) for spec in _level_buffers(level)),
            *(
                BufferSpec(whole, np.uint8, (), "once", "of parts", planes=n, kept=whole == "memory", scratch=True)
                for whole, n in nbytes.items()
            ),
            state,
            *self._places,
            *self.keys(board, "odd_", "level1", fleeting=True),
        )
        super().__init__(board)
        for name in ("memory'", *_KEY_MEMORY):
            board.memory.lend(self, name)

    @classmethod
    def is_wanted(cls, options: Options) -> bool:
        return options.levels > 0

    def allocate(self, specs: Iterable[BufferSpec]) -> dict[str, cl.Buffer]:
        """Return new device buffers by name. Buffers of single levels are parts of those of all levels, and these
        are parts of one; keys are parts of lent memory."""
        specs = list(specs)
        made = super().allocate(spec for spec in specs if not spec.part_of)
        places = {spec.name: start for spec, start in self._places.items()}
        for spec in specs:
            if not spec.part_of:
                continue
            whole, start = spec.part_of, places.get(spec.name, 0)
            if spec.name not in places:
                start = self.starts[grid_of(spec.grid).level] * spec.bytes_per_pixel
                if whole in places:
                    whole, start = "memory", start + places[whole]
            made[spec.name] = self.board.memory.part(made[whole], start, spec.nbytes(self.sizes))
        return made

    def rendered(self, step: Step) -> None:
        """Collect fragments behind the surfaces that the stage `Connectivity` shows. After a reset nothing is kept or
        collected, because movers are unknown yet."""
        collect = step.previous is not None
        if not collect:
            self.clear_keys("even_", "source")
            self.clear_keys("odd_", "level1")
        for level in range(self.levels):
            given = self.of_level(level)
            for scatter_pass in self.passes if collect else ():
                self.launch("scatter_level", step, level=level, **given, **{"pass": scatter_pass})
            self.launch("settle_level", step, level=level, from_level=level, **given)
            if level + 1 < self.levels:  # the next one begins with the fragments that were pushed down
                self.launch("settle_level", step, level=level + 1, from_level=level, fill_by=given["push_by"])
            if collect and level == 0 and self.levels > 2:
                self.clear_keys("even_", "level2")

    @staticmethod
    def of_level(level: int) -> dict[str, str]:
        """Return the buffers of a level: its depth before any candidate, the depth that it showed before (only level
        0 is shown), and the keys of candidates for it and for the next level. A level's keys are free once it is
        settled."""
        keys = dict(zip(("fill_by", "push_by"), ("odd", "even") if level % 2 else ("even", "odd"), strict=True))
        if level == 0:
            return keys | {"depth_of_taken": "rendered.depth", "depth_of_shown": "previous.depth"}
        return keys | {
            "depth_of_taken": f"background.depth_{level}",
            "depth_of_shown": f"background.depth_{level}'",
        }

    def extrapolated(self, step: Step) -> None:
        """Fill the pixels that the warp left invalid, nearest fragment of all levels first."""
        for project_pass in self.passes:
            self.launch("project_levels", step, levels=self.levels, **{"pass": project_pass})
        self.launch("fill_from_levels", step)


def _level_buffers(level: int) -> tuple[BufferSpec, ...]:
    where = "where remembered; visible surfaces are in the rendered frame" if level == 0 else "where it is remembered"
    about = f"background level {level}"
    known = {"known_where": (f"state_{level}", REMEMBERED)}

    def spec(name, dtype, components, description, view, **more):
        return BufferSpec(
            f"{name}_{level}", dtype, components, f"level{level}", description, view, kept=True, part_of=name, **more
        )

    return (
        spec("color", np.float16, RGBA, f"color of {about} (B_{level}) {where}", "color", packing=RGB9E5, **known),
        spec("depth", np.float32, (), f"view depth of {about} there, world units", "depth", **known),
        spec(
            "px", np.float32, XY, "where its fragment lies in the rendered image, px", "place", packing=OFFSET, **known
        ),
        spec("state", np.uint8, (), "state of the level there", "label", labels=STATES),
    )


def _all_levels(spec: BufferSpec, levels: int) -> BufferSpec:
    """Return the buffer that holds those of all levels, one after another."""
    part_of = "memory" if spec.known_where else ""
    return replace(
        spec, name=spec.part_of, grid=f"levels{levels}", part_of=part_of, scratch=True, description="of all levels",
        known_where=None,
    )  # fmt: skip


def _side_by_side(specs: Iterable[BufferSpec], sizes: Sizes) -> dict[BufferSpec, int]:
    """Return the bytes at which parts of one buffer begin, by part: not all at one place of a page, where texels of one
    index would evict each other from caches."""
    starts, end = {}, 0
    for spec in specs:
        starts[spec] = end
        end = sizes.aligned(end + spec.nbytes(sizes) + 1)
    return starts
