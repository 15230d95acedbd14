"""Color code: the kernel against its twin."""

from dataclasses import replace

import numpy as np
import pytest
import synthetic
import tiny_frames
import twins
from twin_cases import frames, run
from twins import codes_of, encode_color

from gffe_cl import Camera, Options, Pipeline, RenderedFrame
from gffe_cl.engine.inference.network import PACKAGED
from gffe_cl.engine.options import HOLE_FILLINGS, PRESETS

W, H = 48, 32


@pytest.mark.parametrize("resampling", ["perceptual", "linear"])
def test_kernel_equals_its_twin(device, resampling, monkeypatch):
    """NaN, infinities and negative colors included; in linear light the code is the color."""
    case = run(device, 61, 37, Options(resampling=resampling, blocks=False))
    codes, color = case.pipeline.stages["color_code"].read("codes")[..., :3], case.now.color
    if resampling == "linear":
        monkeypatch.setattr(twins, "CODE_OFFSET", np.float32(0))
    # A root that the device rounds otherwise may end in the next half.
    np.testing.assert_allclose(codes.astype(np.float32), codes_of(color).astype(np.float32), rtol=1e-3, atol=1e-7)
    assert (codes.view(np.uint16) == codes_of(color).view(np.uint16)).mean() > 0.999
    assert (color > 2).any() and np.isfinite(codes).all() and (codes < 0).any() and not np.isfinite(color).all()
    if resampling == "linear":
        assert np.array_equal(codes, twins.load_color(color).astype(np.float16))


def test_codes_are_halves_at_every_exposure(device):
    """The brightest color, resampled where everything is as bright, keeps its value."""
    for exposure in (1e-6, 1.0, 1e6):
        color = np.full((H, W, 3), 6e4, np.float32)
        pipeline = Pipeline(device, W, H, Options(shading_correction=False))
        pipeline.exposure = exposure
        for k in range(2):
            pose = np.eye(4)
            pose[0, 3] = 0.01 * k
            camera, motion = Camera(pose, W, W, W / 2, H / 2), np.full((H, W, 2), (-0.01 * W / 5, 0), np.float32)
            depth = np.full((H, W), 5, np.float32)
            pipeline.submit(RenderedFrame(color, depth, motion, camera, k / 30, reset=k == 0))
        new = pipeline.extrapolate().numpy("color").astype(np.float32)
        np.testing.assert_allclose(new, color, rtol=3e-3, err_msg=f"exposure {exposure}")


@pytest.mark.parametrize(
    "options",
    [
        *(Options.preset(name, shading_correction=name != "performance", scn_model=str(PACKAGED)) for name in PRESETS),
        *(Options(hole_filling=filling, shading_correction=False) for filling in HOLE_FILLINGS),
        Options(upscale=2.0, shading_correction=False),
    ],
    ids=[*PRESETS, *HOLE_FILLINGS, "upscaling"],
)
def test_brighter_colors_of_less_exposure_make_the_same_frames(device, options):
    """To the bit for powers of four; for other powers of two roots are rounded otherwise, which few halves show."""

    def made(power):
        size = (31, 19) if options.upscale > 1 else (61, 37)
        pipeline, scale = Pipeline(device, 61, 37, options, render_size=size), np.float32(2.0**power)
        pipeline.exposure = float(1 / scale)
        for frame in frames(*size, spoil=False):
            color = np.clip(frame.color, 0.02, 60).astype(np.float16)  # far from the ends of halves
            pipeline.submit(replace(frame, color=(color * scale).astype(np.float16)))
        new = pipeline.extrapolate(synthetic.camera(61, 37, (0.35, 0.07, 0.6), 0.075, 0.045), frame.time + 0.02)
        return new.numpy("color") / scale, new.numpy("depth")

    (color, depth), (other, _) = made(0), made(5)
    for power in (-4, 6):
        assert all(map(np.array_equal, made(power), (color, depth))), power
    assert (color != other).mean() < 2e-3 and np.allclose(color, other, rtol=2e-3)


def test_a_frame_keeps_its_exposure(device):
    """Its colors are in the code of its exposure, whatever is set before new frames are made from it."""
    seen = []
    for later in (1.0, 4.0):
        pipeline = Pipeline(device, tiny_frames.W, tiny_frames.H, Options(shading_correction=False))
        for frame in tiny_frames.frames():
            pipeline.exposure = 1.0
            pipeline.submit(frame)
            pipeline.exposure = later
            seen.append(pipeline.extrapolate().numpy("color"))
    assert np.array_equal(seen[:3], seen[3:])


def test_bright_colors_weigh_less():
    """Codes as halfs keep the order of colors; a lamp 24 times as bright as white has less than a third of the code it
    would have in linear light. `test_codes_are_halves_at_every_exposure` decodes them."""
    codes = encode_color(np.geomspace(1e-3, 6e4, 2000).astype(np.float32)).astype(np.float16)
    assert (np.diff(codes.astype(np.float32)) >= 0).all()
    assert encode_color(1.0) == 1.0 and encode_color(24.0) < 8.0
