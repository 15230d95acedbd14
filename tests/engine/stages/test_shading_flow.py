"""Flow of shading and candidates for the network: the kernels against their twins."""

import numpy as np
import pytest
import twins
from network_stages import SIZES, made_stages, moving_frames


@pytest.mark.parametrize("size", [*SIZES, (130, 70)])
@pytest.mark.parametrize("alpha", [0.5, 1.0])
def test_flow_and_candidates_equal_their_twin(device, size, alpha):
    """Where the brightness moves smoothly, and where it is noise."""
    board, _, step = made_stages(device, size)
    step.alpha = alpha
    stage, rng = board.stages["shading_flow"], np.random.default_rng(7)
    frames = moving_frames(board.sizes.of("network"), rng)
    board.stages["network_input"].upload("frames", frames)
    stage.extrapolated(step)
    flow, differences, candidates = twins.find_candidates(frames, board.stages["shading_trend"].read("trends"), alpha)
    assert np.isfinite(candidates).all() and np.abs(flow).max() > 0.01
    assert stage.read("flow2").tobytes() == flow.tobytes()
    assert stage.read("differences").tobytes() == differences.tobytes()
    assert stage.read("candidates").tobytes() == candidates.tobytes()
    assert stage.read("texture").tobytes() == twins.find_texture(frames).tobytes()


def test_the_flow_of_a_moved_pattern_is_found(device):
    """In pixels of a quarter of the resolution."""
    board, _, step = made_stages(device, (256, 192))
    frames = moving_frames(board.sizes.of("network"), np.random.default_rng(0))
    board.stages["network_input"].upload("frames", frames)
    board.stages["shading_flow"].extrapolated(step)
    flow = board.stages["shading_flow"].read("flow2")[:, 3:9, 4:-4]  # of the half without noise
    assert np.abs(flow - np.array([1.5, -0.8], np.float32)[:, None, None]).mean() < 0.1
