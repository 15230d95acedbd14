"""What the network's judgement does to the frame: the kernels against their twins."""

import numpy as np
import pytest
import twins
from network_stages import SIZES, made_stages, moving_frames, put


@pytest.mark.parametrize("size", [*SIZES, (130, 70)])
@pytest.mark.parametrize("refined", [False, True])
def test_judgement_makes_the_correction_of_its_twin(device, size, refined):
    board, correction, step = made_stages(device, size)
    rng = np.random.default_rng(3)
    frames = moving_frames(board.sizes.of("network"), rng)
    judgement = rng.normal(0, 0.7, correction.spec("judgement").shape(board.sizes)).astype(np.float32)
    for value in (np.nan, np.inf, -np.inf, 1e38):
        at = rng.integers(20), rng.integers(judgement.shape[1]), rng.integers(judgement.shape[2])
        judgement[at] = value
    board.stages["network_input"].upload("frames", frames)
    board.stages["shading_flow"].extrapolated(step)
    board.stages["shading_trend"].upload("changed", np.ones(1, np.int32))
    correction.upload("judgement", judgement)
    correction.with_refined = refined
    correction.judge(step, within_mask=True)
    candidates, differences = (board.stages["shading_flow"].read(name) for name in ("candidates", "differences"))
    trends = board.stages["shading_trend"].read("trends")
    with np.errstate(all="ignore"):
        chosen = twins.choose_flow(judgement, candidates, differences, step.alpha)
        assert np.array_equal(correction.read("chosen"), chosen, equal_nan=True)
        expected = twins.judge(
            frames, trends, judgement, chosen, correction.read("head").ravel(), twins.find_texture(frames), refined
        )
    got = correction.read("correction")
    sound = np.isfinite(expected).all(0)
    assert np.array_equal(sound, np.isfinite(got).all(0)) and np.array_equal(got[:, sound], expected[:, sound])
    unused = (got == np.array([0, 0, 0, 1, 0])[:, None, None]).all(0)
    assert (sound.mean() > 0.3 and unused.mean() < 0.9) or min(size) < 30
    assert unused.any() != refined


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize(("within_mask", "with_refined"), [(True, True), (True, False), (False, False)])
@pytest.mark.parametrize("exposure", [1.0, 0.05])
def test_correct_equals_its_twin(device, size, within_mask, with_refined, exposure):
    rng = np.random.default_rng(3)
    board, correction, step = made_stages(device, size, exposure, seed=2)
    board.stages["network_input"].extrapolated(step)
    color, frames = board.frame.read("color"), board.stages["network_input"].read("frames")
    said = rng.normal(0, 0.3, correction.spec("correction").shape(correction.sizes)).astype(np.float32)
    said[3] = rng.uniform(-0.5, 1.5, said[3].shape)
    said[4] = np.where(rng.random(said[4].shape) < 0.6, 0, rng.uniform(-0.1, 2, said[4].shape))
    for value in (np.nan, np.inf, -np.inf, 1e38):
        said[rng.integers(5), rng.integers(said.shape[1]), rng.integers(said.shape[2])] = value
    put(correction, correction=said)
    correction.with_refined = with_refined
    correction.compose(step, within_mask)
    refined, focus, final = twins.correct(color, frames, said, exposure, within_mask)
    assert correction.read("focus_mask").tobytes() == focus.tobytes()
    assert not with_refined or correction.read("refined").tobytes() == refined.tobytes()
    got = correction.read("color")
    assert got.tobytes() == final.tobytes()
    if within_mask:
        assert got[focus == 0].tobytes() == color[focus == 0].tobytes()
        assert np.isfinite(got).all()
    if min(size) > 30:
        assert 0.1 < (focus == 0).mean() < 0.9 and (focus == 1).any()


@pytest.mark.parametrize("size", [*SIZES, (130, 70)])
def test_the_image_follows_the_flow_as_its_twin_does(device, size):
    rng = np.random.default_rng(5)
    board, correction, step = made_stages(device, size, seed=2)
    flow = board.stages["shading_flow"]
    shape = flow.read("flow2").shape
    put(flow, flow2=rng.normal(0, 2, shape).astype(np.float32))
    followed = (rng.random((2 * shape[1], 2 * shape[2])) < 0.4).astype(np.float32)
    followed[:, followed.shape[1] // 3 :] = 0
    put(flow, followed=followed)
    before = rng.lognormal(-1, 2, board.frame.read("color").shape).astype(np.float16)
    put(correction, color=before)
    correction.launch("follow_flow", step)
    expected = twins.follow_flow(board.frame.read("color"), flow.read("flow2"), followed, before, step.alpha)
    got = correction.read("color")
    assert got.tobytes() == expected.tobytes()
    assert min(size) < 30 or 0.1 < (got != before).any(-1).mean() < 0.6


def test_encoding_is_the_mu_law_and_decoding_its_inverse():
    """Of the twins, and so of the kernels: against float64."""
    color = np.r_[0, np.logspace(-6, np.log10(65504), 5000)].astype(np.float32)
    for exposure in (1.0, 0.01, 30.0):
        exact = np.log1p(5000 * exposure / 8 * color.astype(np.float64)) / np.log1p(5000)
        np.testing.assert_allclose(twins.encode(color, exposure), exact, rtol=3e-7, atol=2e-8)
        code = exact.astype(np.float32)
        np.testing.assert_allclose(twins.decode(code, exposure), color, rtol=3e-6, atol=1e-12)
    assert twins.decode(np.array([-1, 0, 1, 50], np.float32), 1.0) == pytest.approx([0, 0, 8, 65504])
