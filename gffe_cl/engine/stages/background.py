"""Background collection and projection (paper: 'Hierarchical Background Collection'), and parts that reappear."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pyopencl as cl

from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.base import Board, Kernel, NearestStage, Step
from gffe_cl.engine.stages.buffers import OFFSET, RGB9E5, RGBA, XY, BufferSpec, Sizes, grid_of
from gffe_cl.engine.stages.history import TRACKS_CELLS, Acceleration
from gffe_cl.engine.stages.holes import HiddenParts

_CONSTANTS = constants("background.cl")
EMPTY, SHOWN, REMEMBERED, EDGE = (_CONSTANTS[name] for name in ("EMPTY", "SHOWN", "REMEMBERED", "EDGE"))
STATES = (
    (EMPTY, "empty"),
    (SHOWN, "shown by the current frame"),
    (REMEMBERED, "remembered"),
    (EDGE, "beside a nearer static surface"),
)


_KEY_MEMORY = ("key_memory", "winner_memory")
_SPARES = 8  # times the alignment: lent memory beyond this stage's needs, because its parts are aligned


def _levels(names: str, prefix: str = "levels_", kept: str = "") -> dict[str, str]:
    """Return the arguments that are buffers of all levels."""
    return {f"{prefix}{name}": f"background.{name}{kept}" for name in names.split()}


_OFFERED = {name: f"background.level_{name}" for name in ("keys", "winners")}
_COLLECTED = _levels("state") | _OFFERED
_SURFACES = {"depth": "rendered.depth", "dynamic_mask": "history.dynamic_mask", "links": "connectivity.links"}
_PROJECTED = {"keys": "warp.keys", "winners": "warp.winners"}


class Background(NearestStage):
    """Remembers, in L levels, the static fragments that are hidden now, and fills disocclusions from them.

    After collection nothing reads the earlier content of the levels, nor their keys. Until the next collection that
    memory is lent (see `Board`).
    """

    name = "background"
    paper = "Hierarchical Background Collection"
    needs_footprints = True
    kernels = (
        Kernel(
            "scatter_level",
            "source",
            _SURFACES
            | {"last_stir": "history.last_stir", "frame_depth": "previous.depth"}
            | _levels("depth px state", "old_", "'")
            | _COLLECTED,
            _COLLECTED,
            step=("LANES", 1),
        ),
        Kernel(
            "scatter_hidden",
            "flat_level{level}",
            _SURFACES | _levels("depth px state", "old_", "'") | _COLLECTED,
            _COLLECTED,
            step=("SCAN_BYTES", 1),
            group="SCAN_GROUP",
        ),
        Kernel(
            "settle_levels",
            "levels{levels}",
            {"frame_color": "previous.color", "frame_depth": "previous.depth"}
            | _levels("color depth px", "old_", "'")
            | _COLLECTED
            | TRACKS_CELLS[0],
            _levels("color depth px") | {"levels_state": "background.state"} | TRACKS_CELLS[1],
            step=("SCAN_BYTES", 1),
            group="SCAN_GROUP",
            below=TRACKS_CELLS[2],
        ),
    )

    def __init__(self, board: Board):
        self.levels = board.options.levels
        self.starts = board.sizes.level_starts(self.levels)
        all_levels = [_all_levels(spec, self.levels) for spec in _level_buffers(0)]
        state = all_levels.pop()  # must last: memory between two levels is EMPTY
        offered = self.keys(board, "level_", f"levels{self.levels}")
        self._places = _side_by_side(all_levels, board.sizes)
        self._places |= {replace(spec, part_of=whole): 0 for spec, whole in zip(offered, _KEY_MEMORY, strict=True)}
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
        )
        if Acceleration.name not in board.stages:
            self.kernels = tuple(replace(kernel, below="") for kernel in self.kernels)
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
        if step.previous is None or self.levels > 1:  # else the connectivity stage clears what is offered to
            self.clear_keys("level_", f"levels{self.levels}")
        for level in range(1, self.levels):
            self.fill(f"state_{level}", EMPTY)
        for level in range(self.levels if step.previous is not None else 0):
            for scatter_pass in self.passes:
                if level == 0:
                    self.launch("scatter_level", step, **{"pass": scatter_pass})
                else:
                    self.launch("scatter_hidden", step, level=level, **{"pass": scatter_pass})
        self.launch("settle_levels", step, levels=self.levels)


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
        spec,
        name=spec.part_of,
        grid=f"levels{levels}",
        part_of=part_of,
        scratch=True,
        description="of all levels",
        known_where=None,
    )


def _side_by_side(specs: Iterable[BufferSpec], sizes: Sizes) -> dict[BufferSpec, int]:
    """Return the bytes at which parts of one buffer begin, by part: not all at one place of a page, where texels of one
    index would evict each other from caches."""
    starts, end = {}, 0
    for spec in specs:
        starts[spec] = end
        end = sizes.aligned(end + spec.nbytes(sizes) + 1)
    return starts


class Projection(NearestStage):
    """Fills the pixels that the warp left invalid from the background, nearest fragment of all levels first, and shows
    parts of movers that come out from behind something nearer."""

    name = "projection"
    paper = Background.paper
    needs_footprints = True
    kernels = (
        Kernel(
            "offer_hidden",
            "levels{levels}",
            _levels("depth px state")
            | {
                "disoccluded": "frame.disoccluded",
                "depth": "rendered.depth",
                "motion": "rendered.motion",
                "dynamic_mask": "history.dynamic_mask",
                "links": "connectivity.links",
                "met_depth": "history.met_depth",
                "target_position": "prediction.target_position",
                "depth_prev": "previous.depth",
                "shown_depth": "frame.depth",
            }
            | _PROJECTED,
            {"filled_by": "frame.filled_by", "offered": "hidden_parts.offered"} | _PROJECTED,
            step=("SCAN_BYTES", 1),
            group="SCAN_GROUP",
        ),
        Kernel(
            "fill_hidden",
            "walk",
            {
                "frame_color": "rendered.color",
                "frame_depth": "rendered.depth",
                "source_motion": "rendered.motion",
                "color_prev": "previous.color",
                "depth_prev": "previous.depth",
                "target_position": "prediction.target_position",
                "open": "warp.open",
                "offered": "hidden_parts.offered",
                "disoccluded": "frame.disoccluded",
                "color": "frame.color",
                "depth": "frame.depth",
                "filled_by": "frame.filled_by",
            }
            | _levels("color depth px state")
            | _PROJECTED,
            {name: f"frame.{name}" for name in ("color", "depth", "motion", "filled_by")}
            | {"is_dynamic": "frame.dynamic"},
            step=("LANES", 1),
            group="WALK_GROUP",
        ),
    )

    @classmethod
    def is_wanted(cls, options: Options) -> bool:
        return Background.is_wanted(options) or (HiddenParts.is_wanted(options) and options.reappearing)

    def extrapolated(self, step: Step) -> None:
        options = self.board.options
        reappear, levels = HiddenParts.name in self.board.stages and options.reappearing, max(options.levels, 1)
        for offer_pass in self.passes:
            self.launch("offer_hidden", step, reappear=reappear, levels=levels, **{"pass": offer_pass})
        self.launch("fill_hidden", step)
