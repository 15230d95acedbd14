"""Metrics against values known without them."""

import sys

import numpy as np
import pytest

from gffe_cl.engine.core.errors import GffeError, how_to_install
from gffe_cl.lab import metrics
from gffe_cl.lab.metrics import METRICS, RegionErrors, focus_mask, psnr, ssim, to_display


def test_display_values():
    color = np.array([[[0.0, 1.0, 0.5], [np.nan, 7.0, -3.0], [np.inf, -np.inf, 0.002]]], np.float16)
    shown = to_display(color)
    assert shown.dtype == np.float32
    expected = [[[0, 1, 0.7353569], [0, 1, 0], [1, 0, 12.92 * np.float32(color[0, 2, 2])]]]
    np.testing.assert_allclose(shown, expected, atol=1e-6)
    np.testing.assert_allclose(to_display([[[0.25, 0, 0]]], exposure=2.0)[0, 0, 0], 0.7353569, atol=1e-6)


def test_figures_that_are_known():
    a, mask = np.zeros((4, 5, 3), np.float32), np.zeros((4, 5), np.float16)
    assert psnr(a, a) == psnr(a, a + 1e-6) == 100.0 and psnr(a, a + 0.1) == pytest.approx(20.0, abs=1e-5)
    b = a.copy()
    b[1, 2], mask[1, 2] = 0.1, 1
    assert psnr(a, b, mask) == pytest.approx(20.0, abs=1e-5) and psnr(a, b, 1 - mask) == 100.0
    flat = np.full((16, 17, 3), 0.5, np.float32)  # only the luminance term (2ab + C1) / (a² + b² + C1) is left
    assert ssim(flat, flat * 0.5) == pytest.approx((0.25 + 1e-4) / (0.3125 + 1e-4), abs=1e-5)


def test_focus_mask_is_where_a_shadow_has_moved():
    """A shadow a pixel off is forgiven, one further off is not; movers are never in focus."""
    color, truth, dynamic = np.ones((16, 32, 3)), np.ones((16, 32, 3)), np.zeros((16, 32), np.uint8)
    color[:, 8:14], truth[:, 9:15] = 0.2, 0.2
    assert not focus_mask(color, truth, dynamic).any()
    truth[:, 9:15], truth[:, 12:18] = 1, 0.2
    expected = np.zeros_like(dynamic)
    expected[:, 8:11], expected[:, 14:17] = 1, 1
    assert np.array_equal(focus_mask(color, truth, dynamic), expected)
    dynamic[:8] = 1
    expected[:8] = 0
    assert np.array_equal(focus_mask(color, truth, dynamic), expected)
    assert not focus_mask(color, truth, dynamic, 1e-4).any()  # too dark to see


def images(seed=0, shape=(20, 30, 3)):
    rng = np.random.default_rng(seed)
    truth = rng.random(shape).astype(np.float32)
    return np.clip(truth + rng.normal(0, 0.1, shape), 0, 1).astype(np.float32), truth


def test_ssim_under_a_mask_is_scikit_images_map():
    from skimage.metrics import structural_similarity

    shown, truth = images()
    mask = np.zeros((20, 30))
    mask[:10, :10] = 1  # the window does not fit where the three outermost pixels are
    _, whole = structural_similarity(shown, truth, data_range=1, channel_axis=-1, full=True)
    assert ssim(shown, truth, mask) == pytest.approx(whole[3:10, 3:10].mean(), abs=1e-6)
    mask[3:10, 3:10] = 0
    assert np.isnan(ssim(shown, truth, mask)) and psnr(shown, truth, mask) > 0


def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "flip_evaluator", None)
    assert [metric.name for metric in metrics.measurable()] == ["psnr", "ssim"]
    assert metrics.missing_metrics() == [f"FLIP needs flip-evaluator: {how_to_install('lab')}"]
    monkeypatch.setitem(sys.modules, "skimage", None)
    monkeypatch.delitem(sys.modules, "skimage.metrics", raising=False)
    assert [metric.name for metric in metrics.measurable()] == ["psnr"]
    with pytest.raises(GffeError, match="SSIM needs skimage: pip install"):
        ssim(*images())


def test_regions_are_pooled_over_images():
    pairs = [images(seed) for seed in range(2)]
    masks = [np.zeros((20, 30), bool), np.ones((20, 30), bool)]
    masks[0][:5] = True
    several = []
    for (shown, truth), mask in zip(pairs, masks, strict=True):
        several.append(RegionErrors())
        several[-1].add(shown, truth, {"some": mask, "whole": np.ones_like(mask)}, [METRICS["psnr"], METRICS["ssim"]])
    pooled = RegionErrors.pooled(several)
    both = [np.concatenate(side) for side in zip(*pairs, strict=True)]
    assert pooled.figure("psnr", "some") == pytest.approx(psnr(*both, np.concatenate(masks)))
    assert pooled.figure("ssim", "whole") == pytest.approx(np.mean([ssim(*pair) for pair in pairs]))
    figures = pooled.figures()
    assert figures["some"]["share"] == 750 / 1200 and np.isnan(figures["some"]["flip"])
    nothing = RegionErrors()
    nothing.add(*pairs[0], {"some": np.zeros((20, 30)), "whole": masks[1]}, [METRICS["psnr"]])
    assert np.isnan(nothing.figure("psnr", "some")) and np.isnan(nothing.figure("ssim", "whole"))
    same = RegionErrors()
    same.add(pairs[0][1], pairs[0][1], {"whole": masks[1]}, [METRICS["psnr"]])
    assert same.figure("psnr", "whole") == metrics.PSNR_CAP
