"""Metrics against values known without them."""

import numpy as np
import pytest

from gffe_cl.metrics import display_values, psnr, smape, ssim


def test_display_values():
    color = np.array([[[0.0, 1.0, 0.5], [np.nan, 7.0, -3.0], [np.inf, -np.inf, 0.002]]], np.float16)
    shown = display_values(color)
    assert shown.dtype == np.float32
    expected = [[[0, 1, 0.7353569], [0, 1, 0], [1, 0, 12.92 * np.float32(color[0, 2, 2])]]]
    np.testing.assert_allclose(shown, expected, atol=1e-6)
    np.testing.assert_allclose(display_values([[[0.25, 0, 0]]], exposure=2.0)[0, 0, 0], 0.7353569, atol=1e-6)
    assert np.isnan(color[0, 1, 0])  # the input is left as it was


def test_display_values_does_not_overflow_half():
    assert display_values(np.full((1, 1, 3), 60000, np.float16), exposure=4).max() == pytest.approx(1, abs=1e-6)


def test_psnr():
    a = np.zeros((4, 5, 3), np.float32)
    assert psnr(a, a) == 100.0
    assert psnr(a, a + 1e-6) == 100.0
    assert psnr(a, a + 0.1) == pytest.approx(20.0, abs=1e-5)
    assert psnr(a, a + 0.01) == pytest.approx(40.0, abs=1e-4)
    b = a.copy()
    b[0, 0, 0] = 1
    assert psnr(a, b) == pytest.approx(10 * np.log10(60))


def test_psnr_mask():
    a = np.zeros((4, 5, 3), np.float32)
    b, mask = a.copy(), np.zeros((4, 5), np.float16)
    b[1, 2], mask[1, 2] = 0.1, 1
    assert psnr(a, b, mask) == pytest.approx(20.0, abs=1e-5)
    assert psnr(a, b, 1 - mask) == 100.0
    assert np.isnan(psnr(a, b, np.zeros((4, 5))))


def test_ssim():
    rng = np.random.default_rng(1)
    a = rng.random((16, 17, 3)).astype(np.float32)
    assert ssim(a, a) == pytest.approx(1.0)
    # flat images: only the luminance term (2ab + C1) / (a² + b² + C1) is left
    flat = np.full((16, 17, 3), 0.5, np.float32)
    assert ssim(flat, flat * 0.5) == pytest.approx((0.25 + 1e-4) / (0.3125 + 1e-4), abs=1e-5)
    assert ssim(a, 1 - a) < 0
    assert np.isnan(ssim(a[:6], a[:6]))


def test_smape():
    a = np.array([[[1.0, 0, np.nan], [0, 0, 0]]], np.float16)
    b = np.array([[[0.0, 0, 0], [0, 0, 0]]], np.float16)
    out = smape(a, b)
    assert out.shape == (1, 2)
    np.testing.assert_allclose(out, [[2 / 1.01 / 3, 0]], rtol=1e-6)
    np.testing.assert_allclose(smape(a, b, exposure=0.01)[0, 0], 0.02 / 0.02 / 3, rtol=1e-5)
