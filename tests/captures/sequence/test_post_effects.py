"""Post-processing of games: temporal antialiasing, grain, a user interface, dilated vectors."""

import numpy as np
from synthetic import camera

from gffe_cl.captures.sequence.encoding import (
    EXACT,
    Encoding,
    TemporalAntialiasing,
    nearest_motion,
    user_interface,
    with_ui,
)
from gffe_cl.engine.frame.frame_format import FrameFormat
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.frame.window import Jitter

W, H = 64, 48


def frame(color, jitter=(0.0, 0.0), reset=False, motion=(0.0, 0.0), time=0.5):
    depth = np.full(color.shape[:2], 3, np.float32)
    vectors = np.broadcast_to(np.float32(motion), (*depth.shape, 2))
    return RenderedFrame(color, depth, vectors, camera(W, H), time, reset=reset, geometry_jitter=jitter)


def waves(x, y):
    """Smooth color (H, W, 3) at places in pixels."""
    red, green = 0.5 + 0.4 * np.sin(x / 5 + 0.3 * y), 0.5 + 0.3 * np.cos(y / 4)
    return np.stack([red, green, 0.4 + 0 * x], -1).astype(np.float32)


def test_antialiasing_follows_motion_and_jitter():
    """Samples of a picture that moves: the result is that picture where it is now, neither jittered nor late."""
    y, x = np.mgrid[:H, :W] + 0.5
    taa, speed = TemporalAntialiasing(), np.array((0.7, -0.4))
    for k in range(12):
        jitter = -np.array(Jitter(8).offset(k))
        at = np.stack([x, y], -1) - k * speed
        samples = waves(*np.moveaxis(at - jitter, -1, 0))
        truth = waves(*np.moveaxis(at, -1, 0))
        made = taa.resolve(frame(samples, tuple(jitter), k == 0, -speed), truth)
    inside = (slice(8, -8),) * 2
    error = np.abs(made.astype(np.float32) - truth)[inside].mean()
    shifted = np.abs(waves(*np.moveaxis(at - 0.3, -1, 0)) - truth)[inside].mean()
    assert made.dtype == np.float16 and error < 0.007 < 0.5 * shifted


def test_antialiasing_clamps_what_is_gone():
    taa = TemporalAntialiasing()
    dark, bright = (np.full((H, W, 3), value, np.float32) for value in (0.1, 4.0))
    assert np.allclose(taa.resolve(frame(bright, reset=True), bright), 4, rtol=1e-2)
    assert np.allclose(taa.resolve(frame(dark), bright), 0.1, rtol=1e-2)


def test_dilated_vectors_are_those_of_the_nearest_pixel():
    depth, motion = np.full((H, W), 5, np.float32), np.zeros((H, W, 2), np.float32)
    depth[10, 20], motion[10, 20] = 2, (3, 1)
    depth[30, 30] = np.nan
    found = nearest_motion(motion, depth)
    assert (found[9:12, 19:22] == (3, 1)).all() and np.count_nonzero(found[..., 0]) == 9
    encoding = Encoding.parse("dilated")
    stored = encoding.frame(frame(np.zeros((H, W, 3), np.float16)))
    assert encoding.format == FrameFormat(motion_dilated=True) and EXACT.format is None
    assert np.array_equal(stored.motion, np.zeros((H, W, 2)))


def test_user_interface_is_in_color_and_truth():
    """It has opaque and half-transparent parts, and one place at all sizes."""
    encoding, color = Encoding.parse("hud"), np.full((90, 160, 3), 0.2, np.float16)
    ui = encoding.user_interface((160, 90), 2.0)
    assert np.array_equal(encoding.truth(color, 2.0), with_ui(color, ui))
    own = RenderedFrame(color, np.ones((90, 160), np.float32), np.zeros((90, 160, 2), np.float32), camera(160, 90), 0.0)
    assert np.array_equal(encoding.frame(own, 2.0).color, with_ui(color, ui))
    alpha = ui[..., 3].astype(np.float32)
    assert 0.015 < (alpha == 1).mean() < 0.1 and 0.02 < ((alpha > 0.3) & (alpha < 0.6)).mean() < 0.1
    assert np.array_equal(with_ui(color, ui)[alpha == 0], color[alpha == 0])
    assert np.array_equal(with_ui(color, ui)[alpha == 1], ui[alpha == 1][:, :3])
    larger = user_interface(320, 180)[..., 3].astype(np.float32).reshape(90, 2, 160, 2).mean((1, 3))
    assert np.abs(larger - alpha).mean() < 0.003
