"""Order of the stages, and all of them on a board."""

from __future__ import annotations

from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.acceleration import Acceleration
from gffe_cl.engine.stages.background import Background
from gffe_cl.engine.stages.backward_blocks import BackwardBlocks
from gffe_cl.engine.stages.base import Board, Stage
from gffe_cl.engine.stages.buffers import Sizes
from gffe_cl.engine.stages.color_code import ColorCode
from gffe_cl.engine.stages.connectivity import Connectivity
from gffe_cl.engine.stages.convolutions import Convolutions
from gffe_cl.engine.stages.correction import ShadingCorrection
from gffe_cl.engine.stages.dilated_warp import DilatedWarp
from gffe_cl.engine.stages.hidden_parts import HiddenParts
from gffe_cl.engine.stages.history import HistoryTracking
from gffe_cl.engine.stages.holes import FILLINGS, HoleFilling
from gffe_cl.engine.stages.network_input import NetworkInput
from gffe_cl.engine.stages.prediction import PositionPrediction
from gffe_cl.engine.stages.scene_cuts import SceneCuts
from gffe_cl.engine.stages.shading import ShadingInputs
from gffe_cl.engine.stages.shading_flow import ShadingFlow
from gffe_cl.engine.stages.shading_trend import ShadingTrend
from gffe_cl.engine.stages.sharpness import Sharpness
from gffe_cl.engine.stages.silhouettes import Silhouettes
from gffe_cl.engine.stages.upscaling import Upscaling
from gffe_cl.engine.stages.user_interface import UserInterface
from gffe_cl.engine.stages.warp import Warp

# In the order in which they work, on rendered frames and on new ones.
STAGES: tuple[type[Stage], ...] = (
    UserInterface,
    SceneCuts,
    HistoryTracking,
    Sharpness,
    Acceleration,
    Connectivity,
    PositionPrediction,
    BackwardBlocks,
    ColorCode,
    Warp,
    DilatedWarp,
    HiddenParts,
    Background,
    HoleFilling,
    Silhouettes,
    ShadingInputs,
    NetworkInput,
    ShadingTrend,
    ShadingFlow,
    Convolutions,
    ShadingCorrection,
    Upscaling,
)


def stages_of(options: Options) -> list[type[Stage]]:
    """Return the stages that the options ask for, in order."""
    chosen = (FILLINGS[options.hole_filling] if stage is HoleFilling else stage for stage in STAGES)
    wanted = [stage for stage in chosen if stage and stage.is_wanted(options)]
    return [stage for stage in wanted if options.warps_footprints or not stage.needs_footprints]


def board_of(device: Device, sizes: Sizes, options: Options, int64: bool | None) -> Board:
    """Return a board with all stages that the options ask for, and their buffers. `int64` is that of `Board`."""
    board = Board(device, sizes, options, int64)
    try:
        for stage in stages_of(options):
            stage(board)
        board.memory.place()
        _ = board.frame  # made when it is first asked for
    except BaseException:
        board.let_go()
        raise
    return board
