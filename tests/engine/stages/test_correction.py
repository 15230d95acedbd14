"""What the network's judgement does to the frame."""

import numpy as np
import pytest
from network_stages import SIZES, made_stages, put


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("with_refined", [True, False])
def test_what_is_not_in_focus_stays_whatever_the_network_says(device, size, with_refined):
    """With NaN and infinities in its judgement, too."""
    rng = np.random.default_rng(3)
    board, correction, step = made_stages(device, size, seed=2)
    board.stages["network_input"].extrapolated(step)
    color = board.frame.read("color")
    said = rng.normal(0, 0.3, correction.spec("correction").shape(correction.sizes)).astype(np.float32)
    said[3] = rng.uniform(-0.5, 1.5, said[3].shape)
    said[4] = np.where(rng.random(said[4].shape) < 0.6, 0, rng.uniform(-0.1, 2, said[4].shape))
    for value in (np.nan, np.inf, -np.inf, 1e38):
        said[rng.integers(5), rng.integers(said.shape[1]), rng.integers(said.shape[2])] = value
    put(correction, correction=said)
    correction.with_refined = with_refined
    correction.compose(step, True)
    focus, got = correction.read("focus_mask"), correction.read("color")
    assert got[focus == 0].tobytes() == color[focus == 0].tobytes() and np.isfinite(got).all()
    if min(size) > 30:
        assert 0.1 < (focus == 0).mean() < 0.9 and (focus == 1).any()


def test_only_changes_of_light_move_along_the_flow(device):
    """Texture that both frames show stays where it is; where light grew, what is brighter comes half way, by 2 px."""
    board, correction, step = made_stages(device, (64, 48))
    color = np.random.default_rng(0).uniform(0.1, 0.9, (48, 64, 4)).astype(np.float16)
    inputs, flow = board.stages["network_input"], board.stages["shading_flow"]
    frames = np.full(inputs.spec("frames").shape(board.sizes), 0.5, np.float32)
    put(board.frame, color=color)
    put(flow, **{name: np.ones(flow.spec(name).shape(board.sizes), np.float32) for name in ("flow2", "followed")})
    texture, there = color[..., :3].astype(np.float32), np.roll(color[..., :3], (-2, -2), (0, 1))
    for growth, expected in ((0.0, texture), (0.5, (texture + np.maximum(texture, there)) / 2)):
        frames[:3] = 0.5 + growth
        put(inputs, frames=frames)
        put(correction, color=color)
        correction.launch("follow_flow", step)
        assert np.abs(correction.read("color")[..., :3] - expected)[:46, :62].max() < 1e-3
