"""Flow of shading: found where there is one, and followed where it explains what was seen."""

import numpy as np
from network_stages import made_stages, moving_frames


def test_the_flow_of_a_moved_pattern_is_found(device):
    """In pixels of a quarter of the resolution."""
    board, _, step = made_stages(device, (256, 192))
    frames = moving_frames(board.sizes.of("network"), np.random.default_rng(0))
    board.stages["network_input"].upload("frames", frames)
    board.stages["shading_flow"].extrapolated(step)
    flow = board.stages["shading_flow"].read("flow2")[:, 3:9, 4:-4]  # of the half without noise
    assert np.abs(flow - np.array([1.5, -0.8], np.float32)[:, None, None]).mean() < 0.1


def test_a_flow_is_followed_where_it_explains_the_last_interval(device):
    """Not where depth has an edge, where the flow explains nothing, nor in a still frame."""
    board, _, step = made_stages(device, (512, 192))
    frames = moving_frames(board.sizes.of("network"), np.random.default_rng(0))
    frames[6:] = 0.5
    frames[6, :, 100:] = 1.0
    stage, trends = board.stages["shading_flow"], board.stages["shading_trend"]
    board.stages["network_input"].upload("frames", frames)
    trends.upload("changed", np.ones(1, np.int32))
    stage.extrapolated(step)
    followed = stage.read("followed")
    assert followed[4:20, 8:48].mean() > 0.9 and followed[4:20, 52:88].mean() > 0.9
    assert not followed[:, 49:51].any()
    trends.upload("changed", np.zeros(1, np.int32))
    stage.extrapolated(step)
    assert not stage.read("followed").any()
