"""What `gffe eval` measures with: baselines, networks, regions, flicker."""

import math
import sys
from dataclasses import replace

import numpy as np
import pytest
from frame_models import network

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.frame.transfer_function import to_display
from gffe_cl.lab.metrics import METRICS, REGIONS, Flicker, blurred, labels_of, masks, measured_or_reason, steps
from gffe_cl.lab.table import cells, methods
from gffe_cl.lab.table.footage import Guide, Moment, Shot, exact_parts, pixel_centers
from gffe_cl.lab.table.methods import OnnxModel, OnnxRunner, chosen_methods

W, H = 48, 32
CAMERA = Camera(np.eye(4), 40, 40, W / 2, H / 2)
CENTERS = pixel_centers(H, W)


def texture(place):
    """Smooth, linear (…, 3), anywhere."""
    x, y = place[..., 0], place[..., 1]
    waves = np.stack([np.sin(x / 3), np.cos(y / 4), np.sin((x + y) / 5)], -1)
    return (0.5 + 0.25 * waves).astype(np.float32)


def shot(k, velocity, acceleration=0.0, following=None):
    """The texture moves along x by `velocity` pixels per interval, and `acceleration`; it is at its place for k = 0."""

    def at(time):
        return velocity * time + acceleration * time * time / 2

    color = texture(CENTERS - np.float32((at(k), 0)))
    motion = np.broadcast_to(np.float32((at(k - 1) - at(k), 0)), (H, W, 2))
    frame = RenderedFrame(color, np.full((H, W), 5, np.float32), motion, CAMERA, k / 30, reset=k == 0)
    return Shot(frame, color, (), following)


def inner_error(made, k, velocity, acceleration=0.0):
    moved = velocity * k + acceleration * k * k / 2
    truth = texture(CENTERS - np.float32((moved, 0)))
    return np.abs(made - truth)[6:-6, 12:-12].max()


def moment(alpha, **more):
    return Moment(alpha, alpha, CAMERA, np.zeros((H, W, 3), np.float32), **more)


# ---- baselines -----------------------------------------------------------------------------------------------


def test_motion_vectors_go_on_in_image_space():
    """Constant speed by order 1, constant acceleration by order 2 only."""
    for acceleration, order, most in ((0.0, 1, 0.01), (0.0, 2, 0.01), (1.5, 2, 0.01)):
        runner = methods.MotionVectors(order)
        for k in range(3):
            runner.submit(shot(k, 2.0, acceleration))
        assert inner_error(runner.make(moment(0.5)), 2.5, 2.0, acceleration) < most, (acceleration, order)
    linear = methods.MotionVectors(1)
    for k in range(3):
        linear.submit(shot(k, 2.0, 1.5))
    assert inner_error(linear.make(moment(0.5)), 2.5, 2.0, 1.5) > 0.02


def test_optical_flow_finds_the_motion():
    pytest.importorskip("cv2")
    runner = methods.OpticalFlow(1.0)
    for k in range(2):
        runner.submit(shot(k, 2.0))
    assert inner_error(runner.make(moment(0.5)), 1.5, 2.0) < 0.06
    assert inner_error(shot(1, 2.0).shown, 1.5, 2.0) > 0.08  # what repeating gives


def test_interpolation_looks_ahead():
    runner = methods.Interpolation()
    with pytest.raises(GffeError, match="after this one is missing"):
        runner.submit(shot(1, 2.0))
        runner.make(moment(0.5))
    runner.submit(shot(2, 2.0, 1.5, following=shot(3, 2.0, 1.5).frame))
    assert inner_error(runner.make(moment(0.25)), 2.25, 2.0, 1.5) < 0.06  # speed within the interval is constant there
    runner.submit(shot(2, 2.0, following=shot(3, 2.0).frame))
    assert inner_error(runner.make(moment(0.25)), 2.25, 2.0) < 0.01


def test_guided_extrapolation_uses_its_guide():
    """True motion of the new frame; where its surface was hidden, pixels of like depth around."""
    source = shot(0, 2.0)
    depth = np.full((H, W), 5, np.float32)
    motion = np.broadcast_to(np.float32((-1, 0)), (H, W, 2))
    hidden = np.zeros((H, W), bool)
    hidden[14:18, 20:24] = True
    guide = Guide(depth, motion, np.where(hidden, 9, depth).astype(np.float32), np.zeros((H, W), bool))
    runner = methods.GuidedExtrapolation()
    runner.submit(source)
    made = runner.make(moment(0.5, guide=guide))
    truth = texture(CENTERS - np.float32((1, 0)))
    error = np.abs(made - truth).max(-1)[2:-2, 4:-4]
    assert error[~hidden[2:-2, 4:-4]].max() < 0.01 and error.max() < 0.25
    assert not np.isnan(made).any()


# ---- networks ------------------------------------------------------------------------------------------------


def test_networks_get_what_the_contract_says(tmp_path):
    """Sizes that are no multiples of 32, display values, the order of frames, the time."""
    size = (37, 21)
    rng = np.random.default_rng(3)
    images = [rng.uniform(0, 1, (size[1], size[0], 3)).astype(np.float32) for _ in range(4)]

    def of(k):
        frame = RenderedFrame(images[k], None, None, CAMERA, k / 30, reset=k == 0)
        return frame

    runner = OnnxRunner(OnnxModel(network(tmp_path / "mix.onnx")), exposure=0.7)
    runner.submit(Shot(of(0), images[0], ()))
    runner.submit(Shot(of(1), images[1], (), of(2)))
    made = to_display(runner.make(moment(0.25)), 0.7)
    shown = [to_display(image, 0.7) for image in images]
    np.testing.assert_allclose(made, 0.75 * shown[1] + 0.25 * shown[2], atol=2e-6)

    oldest = OnnxRunner(OnnxModel(network(tmp_path / "old.onnx", following=False)), exposure=0.7)
    for k, expected in ((0, 0), (1, 0), (2, 1)):  # of two: after a reset the first stands for what is before it
        oldest.submit(Shot(of(k), images[k], ()))
        np.testing.assert_allclose(to_display(oldest.make(moment(0.5)), 0.7), shown[expected], atol=2e-6)


def test_networks_of_another_contract_are_refused(tmp_path):
    with pytest.raises(GffeError, match="no such file"):
        OnnxModel(tmp_path / "none.onnx")
    (tmp_path / "text.onnx").write_text("no model")
    with pytest.raises(GffeError, match="cannot be loaded"):
        OnnxModel(tmp_path / "text.onnx")
    with pytest.raises(GffeError, match=r"outputs result \(expected inputs previous"):
        OnnxModel(network(tmp_path / "other.onnx", name="result"))
    for text, words in (("small", "expected NAME=FILE"), ("gffe=x.onnx", "a method's own")):
        with pytest.raises(GffeError, match=words):
            chosen_methods([], [text])


# ---- regions, flicker ----------------------------------------------------------------------------------


def test_regions_by_hand():
    """A near square that moves 4 px to the right over a wall, and a view that moves 3 px to the left."""
    far, near = 10.0, 4.0
    before, after = np.full((H, W), far, np.float32), np.full((H, W), far, np.float32)
    before[10:20, 10:20], after[10:20, 17:27] = near, near
    motion = np.broadcast_to(np.float32((-3, 0)), (H, W, 2)).copy()  # what is seen at x was at x − 3
    square = after == near
    motion[square] = (-7, 0)
    moving = before == near
    frame = RenderedFrame(np.zeros((H, W, 3)), before, None, CAMERA, 0.0)
    guide = Guide(after, motion, after, square)
    parts = exact_parts(Shot(frame, frame.color, (), None, moving), guide)
    expected = np.zeros((H, W), bool)
    expected[10:20, 13:17] = True  # was behind the square, which was at 10 … 20 and stands for 13 … 23 now
    assert np.array_equal(parts["dynamic disocclusion"], expected)
    assert not parts["static disocclusion"].any()
    assert (
        np.array_equal(np.flatnonzero(parts["out of screen"].all(0)), [0, 1, 2])
        and parts["out of screen"].sum() == 3 * H
    )
    assert np.array_equal(parts["dynamic"], square)
    labels = labels_of(parts)
    found = masks(labels)
    assert sum(found[name].sum() for name in REGIONS) == H * W == found["whole"].sum()
    assert found["silhouettes"][10, 26] and found["silhouettes"][12, 27] and not found["silhouettes"][14, 22]
    assert found["dynamic disocclusion"].sum() == 40  # before silhouettes
    assert steps(np.float32([[10, 10.9, 12.1, np.inf]])).tolist() == [[False, True, True, True]]  # a tenth of the depth
    static = exact_parts(Shot(frame, frame.color, (), None, np.zeros_like(moving)), guide)
    assert np.array_equal(static["static disocclusion"], expected)


@pytest.mark.parametrize("height, sigma", [(45, 0.15), (90, 0.9), (3, 4.0)])
def test_blurring_is_scipys_gaussian(height, sigma):
    from scipy.ndimage import gaussian_filter

    image = np.random.default_rng(1).normal(size=(height, 61)).astype(np.float32)
    np.testing.assert_allclose(blurred(image, sigma), gaussian_filter(image, sigma), atol=1e-6)


def test_flicker_is_what_alternates():
    """A constant error does not flicker, one that comes and goes does; fine patterns less than flat ones."""
    truth = np.full((300, 40, 3), 0.5, np.float32)
    y, x = np.mgrid[:300, :40]
    fine = np.where((x + y) % 2, 0.1, -0.1).astype(np.float32)[..., None]

    def of(errors):
        flicker = Flicker()
        for error in errors:
            flicker.add(truth + error, truth)
        return flicker.mean

    assert of([0.1] * 4) == pytest.approx(0, abs=1e-4)
    assert of([0, 0.1, 0, 0.1]) == pytest.approx(10, abs=1e-3)
    assert 0 < of([0, fine, 0, fine]) < 2
    period = 3 * 300 * math.tan(math.radians(1)) / 3  # three cycles per degree, seen from three heights
    grating = np.float32(0.1) * np.sin(2 * np.pi * y / period).astype(np.float32)[..., None]
    assert of([0, grating]) == pytest.approx(50 * np.abs(grating).mean(), rel=0.05)  # half of it
    assert math.isnan(of([0]))
    blue = np.float32((0, 0, 0.1))
    assert of([0, blue]) == pytest.approx(0.722, abs=1e-3)
    cut = Flicker()
    assert cut.add(truth, truth) is None
    cut.cut()
    assert cut.add(truth + 0.1, truth) is None and cut.count == 0


def test_figures_are_those_of_the_reference_packages():
    from flip_evaluator import evaluate
    from skimage.metrics import peak_signal_noise_ratio, structural_similarity

    rng = np.random.default_rng(5)
    truth = to_display(texture(CENTERS))
    shown = np.clip(truth + rng.normal(0, 0.05, truth.shape), 0, 1).astype(np.float32)
    of = {name: metric.measure(shown, truth) for name, metric in METRICS.items()}
    assert of["psnr"] == pytest.approx(peak_signal_noise_ratio(truth, shown, data_range=1), abs=5e-5)
    assert of["ssim"] == pytest.approx(structural_similarity(truth, shown, data_range=1, channel_axis=-1), abs=5e-5)
    assert of["flip"] == pytest.approx(evaluate(truth, shown, "LDR")[1], abs=5e-5)


def test_metrics_that_cannot_run_say_why(monkeypatch):
    monkeypatch.setitem(sys.modules, "pycvvdp", None)
    images = [np.zeros((8, 8, 3), np.float32)] * 2
    value, reason = measured_or_reason(cells.VIDEO_METRICS["cvvdp"].measure, images, images, 60)
    assert value is None and reason.startswith("needs pycvvdp: pip install")

    def fails(shown, truth, fps):
        raise OSError("no route\nto the weights")

    broken = replace(cells.VIDEO_METRICS["lpips"], measure=fails)
    assert measured_or_reason(broken.measure, images, images, 60)[1] == "cannot run here: no route to the weights"
