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
        ("unorm16", [(2 * 1920 / 65535,) * 2, (2 * 1080 / 65535,) * 2]),
        ("unorm8", [(240 / 255,) * 2, (135 / 255,) * 2]),
        ("rounded", [(1, 1), (1, 1)]),
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


def test_steps_are_those_of_a_size():
    small = Encoding.parse("half-uv", (480, 270)).motion(ramp(0, 8))
    assert np.allclose(steps(small[..., 0])[0], 480 / 1024) and np.allclose(steps(small[..., 1])[0], 270 / 1024)


def test_lookups_are_added_at_the_nearest_pixel():
    """The second vector is that of the pixel that the first one, as it is stored, points into."""
    first = np.full((H, W, 2), (2.4, -1.4), np.float32)
    y, x = np.mgrid[:H, :W].astype(np.float32)
    total = Encoding.parse("rounded").looked_up([first, np.stack([x, y], -1)])
    assert np.array_equal(total[10, 20], (2 + 22, -1 + 9)) and np.array_equal(total[0, W - 1], (2 + W - 1, -1))
    assert np.isnan(EXACT.looked_up([np.full((H, W, 2), np.nan, np.float32), first])).all()


def test_depth_color_and_cameras():
    depth, color = 1 + 50 * np.random.default_rng(1).random((2, H, W)).astype(np.float32)
    view = camera(W, H, (1, 2, 3), yaw=0.3)
    depth[0, 0] = np.inf
    frame = RenderedFrame(color[..., None] * np.float16([0.02, 0.01, 0.005]), depth, ramp(0, 1), view, 0.5, view)
    stored = Encoding.parse("half-depth,8bit-color,noisy-camera").frame(frame, 2.0)
    finite = np.isfinite(depth)
    off = np.abs(stored.depth[finite] / depth[finite] - 1)
    assert stored.depth[0, 0] == np.inf and 2**-13 < off.max() <= 2**-11
    codes = 255 * to_display(stored.color, 2.0)
    assert np.abs(codes - np.round(codes)).max() < 0.2 and len(np.unique(np.round(codes))) > 50
    assert np.abs(codes - 255 * to_display(frame.color, 2.0)).max() < 0.7
    assert np.array_equal(stored.motion, frame.motion) and stored.camera == stored.display_camera != view
    assert np.array_equal(stored.camera.position, view.position) or np.allclose(stored.camera.position, view.position)


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


def test_cameras_are_off_by_a_tenth_of_a_pixel():
    view, encoding = camera(W, H), Encoding.parse("noisy-camera")
    ahead = view.unproject(np.array([W / 2, H / 2]), 10.0)
    seen = np.array([encoding.cameras(k / 30, view)[0].project(ahead)[0] for k in range(400)]) - (W / 2, H / 2)
    assert np.allclose(seen.std(0), 0.1, rtol=0.15) and np.abs(seen.mean(0)).max() < 0.02
    assert encoding.cameras(0.5, view) == encoding.cameras(0.5, view) and encoding.cameras(0.5, None) == (None,)


def test_names():
    assert Encoding.parse("rounded,half-depth").parts == {"rounded", "half-depth"} and Encoding.parse("exact") == EXACT
    assert Encoding.parse("engine").parts == {"half-uv", "two-lookups", "half-depth", "8bit-color", "noisy-camera"}
    for wrong in ("", "third", "half-uv,unorm8", "engine,rounded", "half-uv,", "engine,taa"):
        with pytest.raises(GffeError, match="--encode"):
            Encoding.parse(wrong)
