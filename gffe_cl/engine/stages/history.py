"""History of motion: tracking with the static test (paper: 'Motion estimation', appendix Algorithm 1), the acceleration
of movers, and the prediction of positions (paper: 'Position estimation')."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.base import Board, Kernel, NearestStage, Stage, Step
from gffe_cl.engine.stages.buffers import TRUSTED, BufferSpec
from gffe_cl.engine.stages.measures import SceneCuts

_CONSTANTS = constants("history.cl")
_CLASSES = ("x", "negative_x", "y", "negative_y")
STATIC, DYNAMIC, FIXED_TO_CAMERA = (_CONSTANTS[name] for name in ("STATIC", "DYNAMIC", "FIXED_TO_CAMERA"))


_LAYERS = {name: f"lattices.{name}" for name in ("layer", "errors")}


class HistoryTracking(Stage):
    """Tracks which fragments move, and where they were in the frames before."""

    name = "history"
    paper = "Motion estimation, appendix Algorithm 1"
    buffers = (
        BufferSpec(
            "dynamic_mask",
            np.uint8,
            (),
            "source",
            "where the static test failed (M^dyn), and camera-fixed fragments",
            "label",
            labels=((STATIC, "static"), (DYNAMIC, "dynamic"), (FIXED_TO_CAMERA, "fixed to the camera")),
        ),
        BufferSpec(
            "met_depth",
            np.float32,
            (),
            "source",
            "view depth in the frame before of a dynamic fragment's surface, where its motion points to (gives P_1);"
            " 0: static, or not known",
            "depth",
            known_where=("dynamic_mask", 1),
        ),
        BufferSpec(
            "history",
            np.float32,
            ("x", "y", "z", "known"),
            "source",
            "for k > 2 only: positions P_1 … P_{k−1} of dynamic fragments in the view space of the rendered camera,"
            " world units; known = 0: static, or P_0 instead",
            "world",
            known_where=("dynamic_mask", 1),
        ),
        BufferSpec(
            "last_stir",
            np.int32,
            (),
            "source_blocks",
            "number of the last rendered frame in which something moved within 2 px of a block",
            scratch=True,
        ),
        BufferSpec("static_threshold_squared", np.float32, (), "once", "ε², px²"),
        BufferSpec(
            "motion_steps",
            np.float32,
            _CLASSES,
            "once",
            "steps of quantized motion vectors by component and sign, px; 0: not quantized",
            kept=True,
        ),
        BufferSpec(
            "quantization_error",
            np.float32,
            _CLASSES,
            "once",
            "largest error of quantized motion vectors by component and sign, px, by the steps of the frame before; ε"
            " is added to it; 0: not quantized",
        ),
        BufferSpec("sharpness", np.float32, (), "once", "how much sharper edges are than interpolated ones, 0 to 2"),
        BufferSpec(
            "residual_histogram",
            np.int32,
            tuple(f"bin{b}" for b in range(_CONSTANTS["RESIDUAL_BINS"])),
            "once",
            "squared static residual, and its squared change over 8 px, two bins per octave; steps of motion by"
            " component and sign, eight bins per octave; squared excess over errors of one and of two vectors",
            planes=_CONSTANTS["HISTOGRAMS"],
        ),
        BufferSpec(
            "pending",
            np.int32,
            (),
            "once",
            "the histograms while they are counted, the sums that tell the sharpness, and how many work-groups have"
            " added to each",
            planes=_CONSTANTS["HISTOGRAMS"] * _CONSTANTS["RESIDUAL_BINS"] + 1 + 3,
            scratch=True,
        ),
    )
    kernels = (
        Kernel(
            "measure_samples",
            "measures",
            {
                "color": "rendered.color",
                "depth": "rendered.depth",
                "motion": "rendered.motion",
                "color_prev": "previous.color",
                "depth_prev": "previous.depth",
                "steps_prev": "history.motion_steps'",
                "pending": "history.pending",
            },
            {
                "cut_counts": "scene_cuts.counts",
                "pending": "history.pending",
                "histogram": "history.residual_histogram",
                "threshold_squared": "history.static_threshold_squared",
                "motion_steps": "history.motion_steps",
                "quantization_error": "history.quantization_error",
                "sharpness": "history.sharpness",
            }
            | _LAYERS,
            step=("LANES", "RESIDUAL_ROWS"),
            group="COUNT_GROUP",
            below="source_blocks",
        ),
        Kernel(
            "track_history",
            "source",
            {
                "depth": "rendered.depth",
                "motion": "rendered.motion",
                "depth_prev": "previous.depth",
                "dynamic_prev": "history.dynamic_mask'",
                "history_prev": "history.history'",
                "threshold_squared": "history.static_threshold_squared",
                "quantization_error": "history.quantization_error",
                "color": "rendered.color",
            }
            | _LAYERS,
            {
                "dynamic_mask": "history.dynamic_mask",
                "met_depth": "history.met_depth",
                "history": "history.history",
                "last_stir": "history.last_stir",
                "codes": "color_code.codes",
                "motion_steps": "history.motion_steps",
                "lattices": "lattices.lattices",
                "plane": "lattices.plane",
            },
            step=("LANES", 1),
            below="source_blocks",
        ),
    )

    def __init__(self, board: Board):
        self.positions = board.facts["positions"] = board.options.history
        self.weighs = board.facts["lattices"] = Lattices.name in board.stages
        if not self.weighs:
            self.kernels = tuple(replace(kernel, below="") for kernel in self.kernels)
        self.detects = board.facts["detects"] = SceneCuts.name in board.stages
        if not self.detects:  # it counts nothing for them
            measure, *others = self.kernels
            nothing: dict[str, Any] = {"cut_counts": "history.pending"}
            self.kernels = (replace(measure, writes={**measure.writes, **nothing}), *others)
        changes: dict[str, dict[str, Any]]
        if self.positions > 2:  # only then are positions stored, and is anything kept of the frame before
            changes = {
                "dynamic_mask": {"kept": True},
                "history": {"kept": True, "planes": self.positions - 1},
            }
        else:  # it reads nothing of them
            *others, track = self.kernels
            nothing = {"dynamic_prev": "history.dynamic_mask", "history_prev": "history.history"}
            self.kernels = (*others, replace(track, reads={**track.reads, **nothing}))
            changes = {"history": {"grid": "once", "scratch": True, "known_where": None}}
        self.buffers = tuple(replace(spec, **changes.get(spec.name, {})) for spec in self.buffers)
        super().__init__(board)
        threshold = board.options.static_threshold
        self.automatic = board.facts["automatic"] = threshold is None and board.options.motion
        self._measured: object | None = None  # the key of the last step whose samples were measured
        if threshold is not None:
            self.upload("static_threshold_squared", np.array([threshold**2], np.float32))

    def measure(self, step: Step) -> None:
        """Count the samples of a cut, find the automatic threshold and the sharpness, and weigh blocks as layers of
        lattices, of a rendered frame with a previous one, unless that is done."""
        if self._measured is not step.key and (
            self.automatic or self.detects or self.weighs or self.board.options.sharpness
        ):
            self._measured = step.key
            self.launch("measure_samples", step)

    def rendered(self, step: Step) -> None:
        """Run Algorithm 1. Without a previous frame, or without motion estimation, everything is static."""
        if step.previous is not None:
            self.measure(step)
        self.launch("track_history", step)


class Lattices(Stage):
    """Finds blocks in which wires and gaps of fences or nets alternate at the pitch of pixels: they move as one layer,
    in the plane of the wires (not in the paper). History tracking weighs and finds them, and `Connectivity` links
    their pixels."""

    name = "lattices"
    needs_footprints = True
    builds_at_once = False  # it has no kernels of its own
    buffers = (
        BufferSpec(
            "layer", np.float32, ("x", "y", "inverse depth", "count"), "source_blocks",
            "mean place and inverse depth of a block's nearest surface, and how many pixels show it", scratch=True,
        ),
        BufferSpec(
            "errors", np.float32, ("two layers", "one layer", "across", "down"), "source_blocks",
            "what either motion leaves of the frame before, and steps of depth", scratch=True,
        ),
        BufferSpec(
            "lattices", np.uint8, (), "source_blocks",
            "blocks that are lattices if nothing moves in them: 16 this one, 1 right, 2 down, 4 left, 8 up", "label",
        ),
        BufferSpec(
            "plane", np.float32, ("inverse depth", "along x", "along y", "unused"), "source_blocks",
            "there, the layer's inverse depth at the block's center, and its slopes per pixel", scratch=True,
        ),
    )  # fmt: skip

    @classmethod
    def is_wanted(cls, options: Options) -> bool:
        return options.lattices


_CELLS = f"level{constants('mover_grid.h')['MOVER_CELL'].bit_length() - 1}"
_OF_CELLS = ("velocity", "acceleration", "bend", "view_velocity")
# What a kernel that tracks acceleration reads and writes, and its grid.
TRACKS_CELLS: tuple[dict[str, str], dict[str, str], str] = (
    {
        "depth": "rendered.depth",
        "motion": "rendered.motion",
        "dynamic_mask": "history.dynamic_mask",
        "met_depth": "history.met_depth",
    }
    | {f"{name}_prev": f"acceleration.{name}'" for name in _OF_CELLS},
    {name: f"acceleration.{name}" for name in _OF_CELLS},
    _CELLS,
)


class Acceleration(Stage):
    """Tracks the change of movers' velocity in cells of 4×4 pixels, as far as it has lasted. Prediction adds the
    change, rotated as it rotated before and interpolated between cells."""

    name = "acceleration"
    paper = "Position estimation"
    buffers = (
        BufferSpec(
            "velocity",
            np.float32,
            ("x", "y", "z", "depth"),
            _CELLS,
            "mean velocity of a cell's nearest mover, world units per interval in the view space of the rendered"
            " camera, and its view depth; 0: no mover",
            "world",
            kept=True,
        ),
        BufferSpec(
            "acceleration",
            np.float32,
            ("x", "y", "z", "trust"),
            _CELLS,
            "half the change of that velocity, world units per interval squared, and how much of it counts, 0 to 1;"
            " −1: not known",
            "world",
            kept=True,
            packing=TRUSTED,
        ),
        BufferSpec(
            "bend",
            np.float32,
            ("x", "y", "z", "trust"),
            _CELLS,
            "change of that acceleration in the next interval, as far as it counts, and the same trust: positions gain"
            " α (α + 1) (trust · acceleration + (α + 2) / 3 · this); trust −1: the mover spins, and this is the"
            " velocity of its center",
            "world",
            kept=True,
            packing=TRUSTED,
        ),
        BufferSpec(
            "view_velocity",
            np.float32,
            ("x", "y", "z", "trust"),
            _CELLS,
            "mean velocity of that mover in view space, world units per interval; trust 1: the camera carries it, and"
            " it moves on there, not in the world",
            "world",
            kept=True,
            packing=TRUSTED,
        ),
    )
    kernels = (Kernel("track_acceleration", _CELLS, *TRACKS_CELLS[:2]),)

    @classmethod
    def is_wanted(cls, options: Options) -> bool:
        return options.motion and options.acceleration and options.order == 1

    def __init__(self, board: Board):
        self.builds_at_once = not (board.options.levels and board.options.warps_footprints)
        if not self.builds_at_once:  # the background tracks it, which comes later
            self.kernels = ()
        super().__init__(board)

    def rendered(self, step: Step) -> None:
        if self.kernels:
            self.launch("track_acceleration", step)


class PositionPrediction(NearestStage):
    """Predicts where every fragment will be at t + α, projected with the target camera: by the polynomial of degree m
    through m + 1 positions. m = 1 is the paper's choice, to which the acceleration of movers may be added. Prepares
    the keys of the dilated warp, which follows."""

    name = "prediction"
    paper = "Position estimation"
    buffers = (
        BufferSpec(
            "target_position",
            np.float32,
            ("x", "y", "depth"),
            "source",
            "predicted position of each fragment: x, y in target pixels (−1e9: nowhere), view depth (−1)",
            "place",
            planar=True,
            transient=True,
        ),
    )
    kernels = (
        Kernel(
            "predict_positions",
            "predictions",
            {
                "depth": "rendered.depth",
                "motion": "rendered.motion",
                "dynamic_mask": "history.dynamic_mask",
                "met_depth": "history.met_depth",
                "history": "history.history",
                "velocity": "acceleration.velocity",
                "acceleration": "acceleration.acceleration",
                "bend": "acceleration.bend",
                "view_velocity": "acceleration.view_velocity",
                "links": "connectivity.links",
                "layer": "lattices.plane",
            },
            {
                "target_position": "prediction.target_position",
                "keys": "dilated_warp.keys",
                "winners": "dilated_warp.winners",
            },
            step=("LANES", 1),
        ),
    )

    def __init__(self, board: Board):
        board.facts["bends"] = Acceleration.name in board.stages
        board.facts["dilates"] = not board.options.warps_footprints
        super().__init__(board)

    def extrapolated(self, step: Step) -> None:
        self.launch("predict_positions", step)
