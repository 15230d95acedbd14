"""Warp (paper: 'Warping'): surfaces and blocks that need no splatting, the code of colors that are mixed, the warp with
crack closing and sub-pixel resampling, and the dilated warp of the preset "performance"."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace

import numpy as np

from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.base import Board, Kernel, NearestStage, Stage, Step
from gffe_cl.engine.stages.buffers import BY_HOLE_FILLING, BY_NOTHING, RGBA, BufferSpec
from gffe_cl.engine.stages.silhouettes import Silhouettes

_COLLECTING = {
    "levels_state": "background.state",
    "keys": "background.level_keys",
    "winners": "background.level_winners",
}


class Connectivity(NearestStage):
    """Links pixels of one surface that are equally static or dynamic, and shows the background those whose color
    cannot hold another one's."""

    name = "connectivity"
    needs_footprints = True
    buffers = (
        BufferSpec(
            "links", np.uint8, (), "source",
            "neighbors of the same surface: 1 right, 2 down, 4 left, 8 up; 16: the pixel is in a lattice", "label",
        ),
    )  # fmt: skip
    kernels = (
        Kernel(
            "find_links",
            "source",
            {
                "depth": "rendered.depth",
                "dynamic_mask": "history.dynamic_mask",
                "last_stir": "history.last_stir",
                "lattices": "lattices.lattices",
            },
            {"links": "connectivity.links"} | _COLLECTING,
            step=("LANES", "BLOCK_HEIGHT"),
        ),
    )

    def rendered(self, step: Step) -> None:
        self.launch("find_links", step)


_CONSTANTS = constants("backward_blocks.cl")
SPLATTED, BACKWARD, COPIED = (_CONSTANTS[name] for name in ("SPLATTED", "BACKWARD", "COPIED"))
CLASSES = (
    (SPLATTED, "splatted: edges that move apart, movers, disocclusions"),
    (BACKWARD, "nothing moves apart: warped backward"),
    (COPIED, "nothing moves, nor does the camera: copied"),
)
SMOOTHNESS = (
    (0, "not smooth"),
    (_CONSTANTS["SMOOTH"], "smooth"),
    (_CONSTANTS["RESTING"], "stays in place"),
)


class BackwardBlocks(NearestStage):
    """Finds the blocks of 8×4 pixels in which nothing moves apart, to be warped backward; the others are splatted."""

    name = "backward_blocks"
    needs_footprints = True
    buffers = (
        BufferSpec(
            "smooth", np.uint8, (), "source_blocks", "what the block shows if predicted positions are linear over it",
            "label", labels=SMOOTHNESS,
        ),
        BufferSpec("block_class", np.uint8, (), "target_blocks", "how the block is warped", "label", labels=CLASSES),
        BufferSpec(
            "reach", np.int16, ("x0", "y0", "x1", "y1"), "source_blocks", "target blocks that a block reaches",
            transient=True,
        ),
        BufferSpec(
            "reached_by", np.int32, ("x0", "y0", "x1", "y1"), "target_blocks", "source blocks that reach a block",
            scratch=True,
        ),
        BufferSpec(
            "block_source", np.float32, ("x", "y", "xx", "xy", "yx", "yy", "unused", "unused"), "target_blocks",
            "where the block's center comes from, and the inverse of its flow", scratch=True, transient=True,
        ),
    )  # fmt: skip
    kernels = (
        Kernel(
            "find_reach",
            "source",
            {
                "depth": "rendered.depth",
                "links": "connectivity.links",
                "target_position": "prediction.target_position",
                "last_stir": "history.last_stir",
                "reached_by": "backward_blocks.reached_by",
            },
            {
                "smooth": "backward_blocks.smooth",
                "reach": "backward_blocks.reach",
                "reached_by": "backward_blocks.reached_by",
            },
            step=("LANES", "BLOCK_HEIGHT"),
        ),
        Kernel(
            "classify_blocks",
            "target_blocks",
            {
                "smooth": "backward_blocks.smooth",
                "reached_by": "backward_blocks.reached_by",
                "target_position": "prediction.target_position",
            },
            {
                "reached_by": "backward_blocks.reached_by",
                "block_class": "backward_blocks.block_class",
                "block_source": "backward_blocks.block_source",
                "marked": "silhouettes.marked",
                "keys": "warp.keys",
                "winners": "warp.winners",
            },
        ),
    )

    def __init__(self, board: Board):
        self.finds = board.options.blocks and board.options.crack_closing
        board.facts["softens"] = Silhouettes.is_wanted(board.options)
        board.facts["copies"] = board.options.motion and self.finds
        if not self.finds:  # nothing is written to it
            self.buffers = tuple(replace(spec, scratch=spec.scratch or spec.name == "reach") for spec in self.buffers)
        super().__init__(board)

    def extrapolated(self, step: Step) -> None:
        if self.finds:
            self.launch("find_reach", step)
        self.launch("classify_blocks", step)


_OFFSET = 0.5  # of color_code.h, at exposure 1


class ColorCode(Stage):
    """Encodes the rendered frame's colors: like a square root where it is dark, linear where it is bright. History
    tracking does so while the camera moves; while it rests, this stage encodes those that a new frame mixes."""

    name = "color_code"
    buffers = (
        BufferSpec(
            "codes",
            np.float16,
            RGBA,
            "source",
            "colors in the code for interpolation, as far as they are mixed; NaN is 0, infinities are clamped",
            "color",
        ),
    )
    kernels = (
        Kernel(
            "encode_colors",
            "source",
            {"color": "rendered.color", "block_class": "backward_blocks.block_class"},
            {"codes": "color_code.codes"},
            step=("LANES", "BLOCK_HEIGHT"),
        ),
    )

    def __init__(self, board: Board):
        board.facts["code_offset"] = _OFFSET if board.options.resampling == "perceptual" else 0.0
        super().__init__(board)

    def variant(self, step: Step) -> Hashable:
        return step.rest.coded or step.slot == "rendered"

    def extrapolated(self, step: Step) -> None:
        if not step.rest.coded:  # what is exported asks the frame block
            self.launch("encode_colors", step)


_OPEN = BufferSpec(
    "open",
    np.uint32,
    (),
    "list_target",
    "how many pixels are holes, then their indices",
    scratch=True,
    transient=True,
)
_KEYS = {name: f"warp.{name}" for name in ("keys", "winners")}
NEW_FRAME = {
    "out_color": "frame.color",
    "out_depth": "frame.depth",
    "out_motion": "frame.motion",
    "out_dynamic": "frame.dynamic",
    "disoccluded": "frame.disoccluded",
    "filled_by": "frame.filled_by",
}


class Warp(NearestStage):
    """Splats every fragment's footprint, keeps the nearest fragment of each pixel, and resamples the rendered frame."""

    name = "warp"
    paper = "Warping"
    needs_footprints = True
    kernels = (
        Kernel(
            "splat",
            "source",
            {
                "reach": "backward_blocks.reach",
                "block_class": "backward_blocks.block_class",
                "smooth": "backward_blocks.smooth",
                "depth": "rendered.depth",
                "codes": "color_code.codes",
                "links": "connectivity.links",
                "target_position": "prediction.target_position",
            }
            | {f"level_{name}": f"background.{name}_0" for name in ("state", "depth", "color")}
            | _KEYS,
            _KEYS
            | {"open": "warp.open"}
            | {name: f"silhouettes.{name}" for name in ("layer", "behind", "share", "marked", "soft")},
            step=("LANES", 1),
        ),
        Kernel(
            "resolve",
            "target",
            {
                "block_class": "backward_blocks.block_class",
                "block_source": "backward_blocks.block_source",
                "source_smooth": "backward_blocks.smooth",
                "color": "rendered.color",  # where nothing moves
                "codes": "color_code.codes",
                "depth": "rendered.depth",
                "links": "connectivity.links",
                "dynamic_mask": "history.dynamic_mask",
                "target_position": "prediction.target_position",
                "sharpness": "history.sharpness",
            }
            | _KEYS,
            NEW_FRAME | {"open": "warp.open"},
            step=("LANES", 1),
        ),
    )

    def __init__(self, board: Board):
        self.buffers = (_OPEN, *self.keys(board, "", "target", transient=True))
        super().__init__(board)

    def extrapolated(self, step: Step) -> None:
        for splat_pass in self.passes:
            self.launch("splat", step, **{"pass": splat_pass})
        fills = self.board.options.hole_filling != "none"
        self.launch("resolve", step, unfilled_label=BY_HOLE_FILLING if fills else BY_NOTHING)


_DILATED_WARP_KEYS = {"keys": "dilated_warp.keys", "winners": "dilated_warp.winners"}


class DilatedWarp(NearestStage):
    """Carries every pixel's place to where the nearest surface around it moves, and resamples the rendered frame from
    there. Every pixel is filled. Position prediction has emptied the keys."""

    name = "dilated_warp"
    kernels = (
        Kernel(
            "splat_dilated",
            "source",
            {"depth": "rendered.depth", "target_position": "prediction.target_position"} | _DILATED_WARP_KEYS,
            _DILATED_WARP_KEYS,
            step=("LANES", 1),
        ),
        Kernel(
            "resample_dilated",
            "target",
            {
                "color": "rendered.color",  # where nothing moves
                "codes": "color_code.codes",
                "dynamic_mask": "history.dynamic_mask",
                "target_position": "prediction.target_position",
                "sharpness": "history.sharpness",
            }
            | _DILATED_WARP_KEYS,
            NEW_FRAME,
            step=("LANES", 1),
        ),
    )

    @classmethod
    def is_wanted(cls, options: Options) -> bool:
        return not options.warps_footprints

    def __init__(self, board: Board):
        self.buffers = self.keys(board, "", "target", transient=True)
        super().__init__(board)

    def extrapolated(self, step: Step) -> None:
        for splat_pass in self.passes:
            self.launch("splat_dilated", step, **{"pass": splat_pass})
        self.launch("resample_dilated", step)
