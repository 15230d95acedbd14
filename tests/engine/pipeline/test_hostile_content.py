"""Whatever numbers a frame holds, a new frame holds finite colors, depths above 0 and finite motion, and the same bits
with one and with eight pixels per work-item."""

import re

import numpy as np
import pytest

from gffe_cl import Camera, Options, Overlays, Pipeline, RenderedFrame
from gffe_cl.engine.opencl.program import kernel_folder

W, H = 80, 48
MOVER = np.s_[10:30, 20:40]
BRIGHT = np.float32(7e4)  # above the largest half
PRESETS = {
    "default": Options(shading_correction=False),
    "performance": Options.preset("performance"),
    "quality": Options.preset("quality", shading_correction=False),
    "upscaling": Options(shading_correction=False, upscale=2.0),
    "linear": Options(shading_correction=False, resampling="linear"),
}


def clipped_patch(rng):
    color = rng.uniform(0, 1, (H, W, 3))
    color[20:24, 30:36] = np.inf
    return color


def mixed(rng):
    color = np.exp(rng.uniform(-20, 12, (H, W, 3)))
    for value in (np.nan, np.inf, -np.inf):
        color[rng.random((H, W)) < 0.05] = value
    return color


COLORS = {
    "bright": lambda rng: rng.uniform(0, BRIGHT, (H, W, 3)),
    "checkered": lambda rng: np.where((np.indices((H, W)).sum(0) % 2)[..., None], BRIGHT, 0) * np.ones(3),
    "signed": lambda rng: rng.uniform(-BRIGHT, BRIGHT, (H, W, 3)),
    "clipped patch": clipped_patch,
    "mixed": mixed,
}
EXPOSURES = {"bright": 1e-6, "checkered": 1e6, "signed": 1.0, "clipped patch": 1.0, "mixed": 1.0}


def geometry(rng, hostile):
    depth, motion = np.full((H, W), 5, np.float32), np.empty((H, W, 2), np.float32)
    depth[MOVER], motion[:] = 3, (-0.13 * W * 0.8 / 5, -0.07 * W * 0.8 / 5)
    motion[MOVER] = 2.3, -1.2
    if hostile:
        wrong = rng.random((H, W)) < 0.2
        depth[wrong] = rng.choice([np.nan, -1, 0, -np.inf, np.inf, 1e-30, 1e30], wrong.sum())
        wrong = rng.random((H, W)) < 0.1
        motion[wrong] = rng.choice([np.nan, np.inf, -np.inf, 1e30, -1e9], (wrong.sum(), 2))
    return depth, motion


def played(device, options, exposure, color, *geometry_, overlays=None):
    """The new frames after four rendered ones, and these as presented: buffers by name."""
    size = (W, H) if options.upscale == 1 else (2 * W, 2 * H)
    pipeline = Pipeline(device, *size, options, render_size=(W, H))
    pipeline.exposure = exposure
    for k in range(4):
        pose = np.eye(4)
        pose[:2, 3] = 0.13 * k, 0.07 * k
        camera = Camera(pose, 0.8 * W, 0.8 * W, W / 2, H / 2)
        frame = RenderedFrame(color, *geometry_, camera, k / 30, reset=k == 0, overlays=overlays)
        pipeline.submit(frame)
        new, shown = pipeline.extrapolate(), pipeline.present()
        buffers = {name: new.numpy(name).copy() for name in ("color", "depth", "motion", "filled_by")}
        yield buffers | {"presented": shown.numpy("color").copy()}


def require_numbers(buffers):
    assert np.isfinite(buffers["color"]).all() and np.isfinite(buffers["presented"]).all()
    assert (buffers["depth"] > 0).all() and np.isfinite(buffers["motion"]).all()


@pytest.mark.device
@pytest.mark.parametrize("colors", COLORS)
@pytest.mark.parametrize("preset", PRESETS)
def test_colors_stay_finite_in_both_forms(device, monkeypatch, preset, colors):
    """One pixel per work-item as on devices without 64-bit atomics, eight with them."""
    rng = np.random.default_rng(0)
    given = COLORS[colors](rng).astype(np.float32), *geometry(rng, hostile=False)
    forms, atomics = [], device.int64_atomics
    for lanes in (1, 8):
        monkeypatch.setitem(device.__dict__, "lanes", lanes)
        monkeypatch.setattr(device.opened, "int64_atomics", atomics and lanes == 8)
        forms.append(list(played(device, PRESETS[preset], EXPOSURES[colors], *given)))
    for one, eight in zip(*forms, strict=True):
        require_numbers(one)
        for name in one:
            np.testing.assert_array_equal(one[name], eight[name], err_msg=name)


@pytest.mark.device
@pytest.mark.parametrize("fixed", [False, True])
@pytest.mark.parametrize("preset", PRESETS)
def test_depth_and_motion_are_usable_wherever_those_given_are_not(device, preset, fixed):
    """Also below pixels that stay in place, with which the picture is their own."""
    rng = np.random.default_rng(1)
    given = COLORS["mixed"](rng).astype(np.float32), *geometry(rng, hostile=True)
    mask = (rng.random((H, W)) < 0.3) | (np.arange(W) > W // 2)
    overlays = Overlays(fixed_mask=mask) if fixed else None
    for buffers in played(device, PRESETS[preset], 1.0, *given, overlays=overlays):
        require_numbers(buffers)


def test_every_color_is_stored_by_a_function_that_limits_it():
    limiting = {"common.h", "simd_rgb.h", "simd.h"}
    storing = {path.name for path in kernel_folder().rglob("*.[ch]*") if "vstore_half" in path.read_text()}
    masks = {"shading.cl"}  # one number per pixel, from 0 to 1
    assert storing == limiting | masks
    assert not re.search(r"vstore_half\d", (kernel_folder() / "shading.cl").read_text())
