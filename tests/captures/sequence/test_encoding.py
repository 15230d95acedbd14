"""Encodings of buffers: what is left of them after being stored less exactly."""

import numpy as np
import pytest
from synthetic import camera

from gffe_cl.captures.sequence.encoding import EXACT, Encoding
from gffe_cl.captures.sequence.engine_form import described_frame
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.frame.transfer_function import to_display

W, H = 64, 48


def ramp(low, high):
    """(H, W, 2) float32: values that grow from pixel to pixel."""
    x = np.linspace(low, high, W * H, dtype=np.float32).reshape(H, W)
    return np.stack([x, x[::-1]], -1)


def steps(values):
    """Steps between the distinct values of an image, where they are not negative and where they are."""
    return [np.diff(np.unique(part)) for part in (values[values >= 0], values[values < 0])]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("half-uv", [(1920 / 1024, 1920 / 2048), (1080 / 1024, 1080 / 2048)]),
        ("unorm8", [(240 / 255,) * 2, (135 / 255,) * 2]),
    ],
)
def test_motion_has_steps(text, expected):
    motion = ramp(-12, 12)
    stored = Encoding.parse(text).motion(motion)
    assert stored.dtype == np.float32
    for component, of_signs in enumerate(expected):
        for found, step in zip(steps(stored[..., component]), of_signs, strict=True):
            assert np.allclose(found, step, atol=1e-4)
        assert np.abs(stored - motion)[..., component].max() <= 0.5001 * max(of_signs)


def test_depth_and_color():
    depth, color = 1 + 50 * np.random.default_rng(1).random((2, H, W)).astype(np.float32)
    view = camera(W, H, (1, 2, 3), yaw=0.3)
    depth[0, 0] = np.inf
    frame = RenderedFrame(color[..., None] * np.float16([0.02, 0.01, 0.005]), depth, ramp(0, 1), view, 0.5, view)
    stored = Encoding.parse("half-depth,8bit-color").frame(frame, 2.0)
    finite = np.isfinite(depth)
    off = np.abs(stored.depth[finite] / depth[finite] - 1)
    assert stored.depth[0, 0] == np.inf and 2**-13 < off.max() <= 2**-11
    codes = 255 * to_display(stored.color, 2.0)
    assert np.abs(codes - np.round(codes)).max() < 0.2 and len(np.unique(np.round(codes))) > 50
    assert np.abs(codes - 255 * to_display(frame.color, 2.0)).max() < 0.7
    assert np.array_equal(stored.motion, frame.motion) and stored.camera == stored.display_camera == view


def test_logarithmic_depth_is_described():
    depth = (10 ** np.random.default_rng(1).uniform(-1.5, 4, (H, W))).astype(np.float32)
    depth[0, 0] = np.inf
    view, encoding = camera(W, H), Encoding.parse("log-depth")
    frame = RenderedFrame(np.zeros((H, W, 3), np.float16), depth, ramp(0, 1), view, 0.5, view)
    stored = encoding.frame(frame)
    assert stored.depth.min() > 0 and stored.depth[0, 0] == stored.depth.max() == 1
    made = described_frame(stored, encoding.format, None, (0.0, 0.0))
    np.testing.assert_allclose(made.depth, depth, rtol=2e-6)
    assert np.array_equal(made.motion, frame.motion)


def test_names():
    assert Encoding.parse("unorm8,half-depth").parts == {"unorm8", "half-depth"} and Encoding.parse("exact") == EXACT
    assert Encoding.parse("engine").parts == {"half-uv", "half-depth", "8bit-color"}
    for wrong in ("", "third", "half-uv,unorm8", "engine,unorm8", "half-uv,"):
        with pytest.raises(GffeError, match="--encode"):
            Encoding.parse(wrong)
