"""What the geometry promises, on exact synthetic frames."""

import functools

import numpy as np
import pytest
from moving_scene import MOVING, WALL, H, W, dolly, half, submit
from synthetic import Rect, Rects, camera, psnr

from gffe_cl import GffeError, Options, Pipeline, RenderedFrame

# ---- identity and resampling ---------------------------------------------------------------------------


@pytest.mark.parametrize("size", [(W, H), (61, 37)])
@pytest.mark.parametrize("pose", [{}, {"position": (3e5, -2e5, 1e6), "yaw": 0.7, "pitch": 0.2, "roll": 0.4}])
def test_identity_is_bit_exact(device, size, pose):
    """Equal cameras and zero motion give color and depth back bit for bit, sky and silhouettes included."""
    cam = camera(*size, **pose)
    rng = np.random.default_rng(1)
    depth = rng.choice([2.0, 3.7, np.inf, 55.1], (size[1], size[0])).astype(np.float32)
    color = half(rng.uniform(0, 300, (size[1], size[0], 3)))
    still = np.zeros((size[1], size[0], 2), np.float32)
    pipeline = Pipeline(device, *size)
    for k in range(3):
        pipeline.submit(RenderedFrame(color, depth, still, cam, k / 30, reset=k == 0))
    out = pipeline.extrapolate(cam, 2.5 / 30)
    assert out.numpy("color").tobytes() == color.tobytes()
    assert out.numpy("depth").tobytes() == depth.tobytes()
    assert not out.numpy("motion").any() and not out.numpy("dynamic").any() and not out.numpy("filled_by").any()


@pytest.mark.parametrize("pan", [(0.25, 0.0), (0.5, 0.5), (0.37, -0.81), (1.5, 0.25)])
def test_subpixel_pan_is_no_worse_than_bilinear(device, pan):
    """PSNR against the analytic image, interior pixels."""
    scene = Rects([Rect((0, 0, 10), frequency=0.9)])
    still = camera(W, H)
    shift = np.array([*pan, 0]) * 10 / still.fx
    moved = camera(W, H, tuple(shift))
    pipeline = Pipeline(device, W, H)
    frame = submit(pipeline, scene, [still, still], [0, 1 / 30], samples=4)
    got = pipeline.extrapolate(moved, 1.5 / 30).numpy("color").astype(np.float64)
    truth = scene.color(moved, 0, W, H, 4)
    y, x = np.mgrid[4 : H - 4, 4 : W - 4]
    u, v = x + pan[0], y + pan[1]
    x0, y0 = np.floor(u).astype(int), np.floor(v).astype(int)
    fu, fv = (u - x0)[..., None], (v - y0)[..., None]
    c = frame.color.astype(np.float64)
    bilinear = (c[y0, x0] * (1 - fu) + c[y0, x0 + 1] * fu) * (1 - fv) + (
        c[y0 + 1, x0] * (1 - fu) + c[y0 + 1, x0 + 1] * fu
    ) * fv
    inner = truth[4 : H - 4, 4 : W - 4]
    assert psnr(got[4 : H - 4, 4 : W - 4], inner) >= psnr(bilinear, inner)


def test_far_from_the_origin_gives_the_same_picture(device):
    """A scene shifted by 10⁶ units: within 0.05 dB of the unshifted one, both against the truth."""
    figures = []
    for offset in ((0, 0, 0), (1e6, -1e6, 1e6)):
        scene = Rects(MOVING.rects, offset)
        pipeline = Pipeline(device, W, H)
        submit(pipeline, scene, [dolly(k, offset) for k in range(4)], [k / 30 for k in range(4)])
        out = pipeline.extrapolate(dolly(3.5, offset), 3.5 / 30)
        truth = scene.color(dolly(3.5, offset), 3.5 / 30, W, H)
        figures.append(psnr(out.numpy("color"), truth))
    assert abs(figures[0] - figures[1]) < 0.05, figures


# ---- cracks --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("magnification", [1.05, 1.3, 1.9, 3.0])
@pytest.mark.parametrize("roll", [0.0, 0.15])
def test_approached_surface_has_no_cracks(device, magnification, roll):
    """Also where the surface has something behind it that could shine through."""
    scene = Rects([Rect((0, 0, 40), tint=(9, 9, 9)), Rect((0, 0, 10), (4.0, 2.4), frequency=0.4)])
    start, end = camera(W, H), camera(W, H, (0, 0, 10 - 10 / magnification), roll=roll)
    pipeline = Pipeline(device, W, H)
    submit(pipeline, scene, [start, start], [0, 1 / 30])
    out = pipeline.extrapolate(end, 1.5 / 30)
    truth = scene.frame(end, 0, W, H).depth
    surface = np.abs(truth - 10 / magnification) < 1e-3
    for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        surface &= np.roll(np.abs(truth - 10 / magnification) < 1e-3, (dy, dx), (0, 1))
    assert surface.sum() > 500
    assert not out.numpy("disoccluded")[surface].any()
    np.testing.assert_allclose(out.numpy("depth")[surface], truth[surface], rtol=1e-4)


def test_slanted_floor_has_no_cracks(device):
    """A ground plane seen at a grazing angle, rushing by: depth is steep there, yet one surface."""
    y, x = np.mgrid[:H, :W] + 0.5
    start = camera(W, H, pitch=0.0)
    with np.errstate(divide="ignore"):
        depth = np.where(y > H / 2 + 2, 1.5 * start.fy / (y - H / 2), np.inf).astype(np.float32)
    color = half(np.stack([0.5 + 0.4 * np.sin(x / 3)] * 3, -1))
    pipeline = Pipeline(device, W, H)
    for k in range(2):
        pipeline.submit(RenderedFrame(color, depth, np.zeros((H, W, 2), np.float32), start, k / 30, reset=k == 0))
    out = pipeline.extrapolate(camera(W, H, (0, 0, 1.0)), 1.5 / 30)
    floor = np.s_[H // 2 + 4 : H - 1, 8 : W - 8]
    nearest_seen = depth[H - 1, 0] - 1.0  # what the source frame shows of the floor, in the new camera
    visible = 1.5 * start.fy / (y[floor] - H / 2) > nearest_seen * 1.02
    assert not out.numpy("disoccluded")[floor][visible].any()


@pytest.mark.parametrize("magnification", [1.0, 1.2, 1.7])
def test_thin_bar_stays_unbroken(device, magnification):
    """A bar one pixel wide in front of a wall, dynamic or approached: present in every row."""
    bar_depth = 5.0
    for slant in (0.0, 0.3):
        x = np.arange(W)
        column = np.clip((W / 2 + slant * (np.arange(H) - H / 2)).astype(int), 0, W - 1)
        depth = np.full((H, W), 20.0, np.float32)
        depth[np.arange(H), column] = bar_depth
        color = half(np.where((x[None] == column[:, None])[..., None], 1.0, 0.1) * np.ones(3))
        cam = camera(W, H)
        pipeline = Pipeline(device, W, H)
        still = np.zeros((H, W, 2), np.float32)
        for k in range(2):
            pipeline.submit(RenderedFrame(color, depth, still, cam, k / 30, reset=k == 0))
        end = camera(W, H, (0.013, 0, bar_depth * (1 - 1 / magnification)))
        near = pipeline.extrapolate(end, 1.5 / 30).numpy("depth") < 6
        assert near.any(1).all(), (magnification, slant)
        rows = [np.flatnonzero(row) for row in near]
        for upper, lower in zip(rows, rows[1:], strict=False):  # 8-connected down the image
            assert lower.min() - upper.max() <= 1 and upper.min() - lower.max() <= 1


# ---- motion --------------------------------------------------------------------------------------------


def test_linear_motion_is_exact(device):
    """An object in steady motion lands within 0.02 px of where it belongs, with depth; the wall stays."""
    scene = Rects([Rect((0, 0, 14), frequency=0.3), Rect((-0.5, 0, 6), (1, 1), velocity=(3, 1, 9), frequency=1)])
    pipeline = Pipeline(device, W, H)
    submit(pipeline, scene, [dolly(k) for k in range(3)], [0, 1 / 30, 2 / 30])
    out = pipeline.extrapolate(dolly(2.5), 2.5 / 30)
    truth = scene.frame(dolly(2.5), 2.5 / 30, W, H, (dolly(2), 2 / 30))
    shown = (out.numpy("disoccluded") == 0) & (np.abs(out.numpy("depth") - truth.depth) < 0.05 * truth.depth)
    moving = out.numpy("dynamic") == 1
    assert moving[shown].sum() > 150 and shown.mean() > 0.9
    np.testing.assert_allclose(out.numpy("depth")[shown], truth.depth[shown], rtol=2e-3)
    error = np.abs(out.numpy("motion") - truth.motion).max(-1)
    assert np.quantile(error[shown], 0.99) < 0.02


@pytest.mark.parametrize("times", [(0, 1, 2), (0, 1, 3), (0, 3, 4)])
def test_varying_intervals(device, times):
    """α follows the real times: an object in steady motion is met after uneven intervals too."""
    times = [t / 30 for t in times]
    pipeline = Pipeline(device, W, H)
    cam = camera(W, H)
    submit(pipeline, MOVING, [cam] * 3, times)
    out = pipeline.extrapolate(cam, times[-1] + 0.5 / 30)
    assert out.alpha == pytest.approx(0.5 / 30 / (times[2] - times[1]))
    truth = MOVING.color(cam, times[-1] + 0.5 / 30, W, H)
    assert psnr(out.numpy("color"), truth, out.numpy("disoccluded") == 0) > 30


def test_seven_frames_from_one(device):
    """n = 7: the motion of each extrapolated frame is that of its own time, on the wall and on the mover."""
    pipeline = Pipeline(device, W, H)
    submit(pipeline, MOVING, [dolly(k) for k in range(3)], [0, 1 / 30, 2 / 30])
    for j in range(1, 8):
        pose, time = dolly(2 + j / 8), (2 + j / 8) / 30
        out = pipeline.extrapolate(pose, time)
        assert out.alpha == pytest.approx(j / 8)
        truth = MOVING.frame(pose, time, W, H, (dolly(2), 2 / 30))
        for part in (out.numpy("dynamic") == 0, out.numpy("dynamic") == 1):
            part &= out.numpy("disoccluded") == 0
            error = np.abs(out.numpy("motion") - truth.motion).max(-1)[part]
            assert part.sum() > 100 and np.median(error) < 0.01


def test_polynomial_follows_acceleration(device):
    """Constant acceleration: order 2 predicts what order 1 misses, and so does order 1 with acceleration."""
    cam = camera(W, H)

    def frame(k, reset=False):
        x = -1.5 + 0.012 * k * k
        before = -1.5 + 0.012 * (k - 1) ** 2
        scene = Rects([Rect((0, 0, 14), frequency=0.3), Rect((x, 0, 6), (1, 1), frequency=1)])
        f = scene.frame(cam, k / 30, W, H, reset=reset)
        f.motion[f.depth < 10] = ((before - x) * cam.fx / 6, 0)
        return f, scene

    errors = []
    for options in (Options(acceleration=False), Options(history=3, order=2), Options()):
        pipeline = Pipeline(device, W, H, options)
        for k in range(6, 12):
            pipeline.submit(frame(k, k == 6)[0])
        out = pipeline.extrapolate(cam, 12 / 30)
        near = out.numpy("depth") < 10
        truth = frame(12)[0]
        both = near & (truth.depth < 10)
        errors.append(np.abs(out.numpy("motion") - truth.motion)[both].mean())
    assert max(errors[1:]) < 0.02 and errors[0] > 0.1, errors


def test_polynomial_of_the_highest_order(device):
    """A path of degree 5 is predicted exactly by order 5, and not by order 4."""
    cam, count = camera(W, H), 8
    path = np.polynomial.Polynomial((-0.8, 0.02, 0.012, -0.004, 0.0009, -0.00006))

    def frame(k):
        scene = Rects([Rect((0, 0, 14), frequency=0.3), Rect((path(k), 0, 6), (1, 1), frequency=1)])
        f = scene.frame(cam, k / 30, W, H, reset=k == 0)
        f.motion[f.depth < 10] = ((path(k - 1) - path(k)) * cam.fx / 6, 0)
        return f

    errors = []
    for order in (5, 4):
        pipeline = Pipeline(device, W, H, Options(history=order + 1, order=order, static_threshold=0.01))
        for k in range(count):
            pipeline.submit(frame(k))
        out = pipeline.extrapolate(cam, (count - 0.5) / 30)
        both = (out.numpy("depth") < 10) & (frame(count - 0.5).depth < 10)
        moved = (path(count - 1) - path(count - 0.5)) * cam.fx / 6
        errors.append(np.median(np.abs(out.numpy("motion")[both] - (moved, 0)).max(-1)))
    assert errors[0] < 0.02 and errors[1] > 3 * errors[0], errors


def test_sky_turns_but_does_not_move(device):
    """Sky ignores V and the camera's translation; it is static and the farthest."""
    cam, turned = camera(W, H), camera(W, H, (5, 1, 3), yaw=0.1)
    y, x = np.mgrid[:H, :W] + 0.5
    color = half(np.stack([0.5 + 0.3 * np.sin(x / 5), 0.5 + 0.3 * np.cos(y / 7), 0 * x + 0.5], -1))
    depth = np.full((H, W), np.inf, np.float32)
    motion = np.full((H, W, 2), 17.0, np.float32)
    pipeline = Pipeline(device, W, H)
    for k in range(2):
        pipeline.submit(RenderedFrame(color, depth, motion, cam, k / 30, reset=k == 0))
    out = pipeline.extrapolate(turned, 1.5 / 30)
    assert not out.numpy("dynamic").any()
    inside = out.numpy("disoccluded") == 0
    assert 0.8 < inside.mean() < 0.99 and np.isinf(out.numpy("depth")[inside]).all()
    px = np.stack([x, y], -1)
    source = cam.project(turned.unproject(px, np.ones((H, W))) - turned.position)[0]
    assert np.abs(out.numpy("motion") - (source - px))[inside].max() < 0.01


# ---- bad pixels ----------------------------------------------------------------------------------------

BAD = {
    "motion": [np.nan, np.inf, -np.inf, 1e30, -1e9, 500.0],
    "depth": [np.nan, 0.0, -1.0, -np.inf, 1e38, 1e-38],
    "color": [np.nan, 1e6, np.inf, -np.inf],
}


@functools.cache
def seen_with(device, kind=None, value=0.0, sharpness=True):
    """The new frame where a few pixels have a bad value, and the counts of these."""
    pipeline, previous = Pipeline(device, W, H, Options(sharpness=sharpness)), None
    for k in range(4):
        frame = MOVING.frame(dolly(k), k / 30, W, H, previous, reset=k == 0)
        frame.color = frame.color.astype(np.float32)
        for y, x in ((20, 30), (40, 50), (0, 0), (H - 1, W - 1)) if kind else ():
            getattr(frame, kind)[y, x] = value
        pipeline.submit(frame)
        previous = (dolly(k), k / 30)
    out = pipeline.extrapolate(dolly(3.5), 3.5 / 30)
    return {name: out.numpy(name).astype(np.float64) for name in ("color", "depth", "motion")}, pipeline.bad_pixels


@pytest.mark.parametrize(("kind", "value"), [(k, v) for k, values in BAD.items() for v in values])
def test_bad_pixels_do_no_harm(device, kind, value):
    """A few bad pixels are counted and spoil nothing but their own neighborhood."""
    (without, _), (made, bad) = seen_with(device), seen_with(device, kind, value)
    is_far = kind == "depth" and value == 1e38  # it becomes sky
    for name, image in made.items():
        assert (np.isfinite(image) | (is_far and name == "depth" and np.isposinf(image))).all(), name
    changed = np.abs(without["color"] - made["color"]).max(-1)
    assert (changed > 0.01).mean() < 0.04 and np.median(changed) < 0.002  # how sharp edges are is one value per frame
    (without, _), (made_plainly, _) = (seen_with(device, *bad_one, sharpness=False) for bad_one in ((), (kind, value)))
    assert (without["color"] != made_plainly["color"]).any(-1).mean() < 0.04
    counted = {
        "motion": 0 if np.isfinite(value) else 16,
        "depth": 0 if value >= np.finfo(np.float32).tiny else 16,
        "color": 16 if not np.isfinite(value) else 0,
    }[kind]
    assert getattr(bad, kind) == counted and bad.far == (16 if is_far else 0)
    if kind == "color" and value == 1e6:
        assert bad.clamped == 16


def test_frames_of_nothing_but_bad_pixels(device):
    for kind in ("depth", "motion", "color"):
        pipeline = Pipeline(device, W, H)
        for k in range(3):
            frame = MOVING.frame(dolly(k), k / 30, W, H, (dolly(k - 1), (k - 1) / 30), reset=k == 0)
            getattr(frame, kind)[:] = np.nan
            pipeline.submit(frame)
        out = pipeline.extrapolate(dolly(2.5), 2.5 / 30)
        for name in ("color", "motion"):
            assert np.isfinite(out.numpy(name)).all()
        assert not np.isnan(out.numpy("depth")).any()


# ---- the public interface ------------------------------------------------------------------------------


def test_predicted_camera_is_used_when_none_is_given(device):
    pipeline = Pipeline(device, W, H)
    submit(pipeline, MOVING, [camera(W, H, (0.1 * k, 0, 0)) for k in range(3)], [0, 1 / 30, 2 / 30])
    out = pipeline.extrapolate(time=2.5 / 30)
    np.testing.assert_allclose(out.camera.position, (0.25, 0, 0), atol=1e-9)


def test_misuse_is_refused(device):
    pipeline = Pipeline(device, W, H)
    with pytest.raises(GffeError, match="submit a rendered frame first"):
        pipeline.extrapolate(camera(W, H), 0.0)
    frame = MOVING.frame(dolly(0), 0.0, W, H, reset=True)
    pipeline.submit(frame)
    with pytest.raises(GffeError, match="after the previous"):
        pipeline.submit(RenderedFrame(frame.color, frame.depth, frame.motion, frame.camera, 0.0))
    with pytest.raises(GffeError, match="motion is missing"):
        pipeline.submit(RenderedFrame(frame.color, frame.depth, None, frame.camera, 1.0))
    with pytest.raises(GffeError, match=r"depth must have shape \(64, 96\), got \(96, 64\)"):
        pipeline.submit(RenderedFrame(frame.color, frame.depth.T, frame.motion, frame.camera, 1.0))
    with pytest.raises(GffeError, match="before the last rendered"):
        pipeline.extrapolate(dolly(0), -1.0)
    for bad in ({"history": 1}, {"order": 2}, {"static_threshold": -1}, {"static_threshold": float("nan")}):
        with pytest.raises(GffeError, match="options"):
            Options(**bad)


def test_mover_behind_the_rendered_camera_is_drawn_where_the_new_one_sees_it(device):
    """It flies past the rendered camera within the interval, and the new camera stands further back."""
    mover = Rect((-0.9, 0, 1.4), (0.1, 0.1), velocity=(1.15 * 30, 0, -0.9 * 30), tint=(0, 5, 0))
    still, back = camera(W, H), camera(W, H, (0, 0, -3))
    pipeline = Pipeline(device, W, H)
    submit(pipeline, Rects([WALL, mover]), [still, still], [0, 1 / 30])
    out = pipeline.extrapolate(back, 2 / 30)
    px, depth = back.project(mover.at(2 / 30))
    assert still.project(mover.at(2 / 30))[1] < 0 < depth
    shown = out.numpy("dynamic") == 1
    y, x = np.nonzero(shown)
    assert shown.sum() >= 4 and np.abs(np.stack([x, y], -1) + 0.5 - px).max() < 4
    np.testing.assert_allclose(out.numpy("depth")[shown], depth, rtol=0.02)


def test_input_mask_is_zero_where_pixels_are_disoccluded(device):
    """And nowhere else."""
    scene = Rects([WALL, Rect((-0.5, 0.3, 6), (1, 1), velocity=(14, 1, 0), frequency=1.3, tint=(6, 0.3, 0.1))])
    pipeline = Pipeline(device, W, H, Options(shading_inputs=True))
    still = camera(W, H)
    submit(pipeline, scene, [still] * 5, [k / 30 for k in range(5)], samples=4)
    out = pipeline.extrapolate(still, 4.5 / 30)
    mask = pipeline.stages["shading"].read("input_mask")
    disoccluded, dynamic = out.numpy("disoccluded") == 1, out.numpy("dynamic") == 1
    assert np.array_equal(mask == 0, disoccluded) and np.array_equal(mask == 1, dynamic & ~disoccluded)
    pipeline.take_timings()
    pipeline.keep(["final"])
    pipeline.extrapolate(still, 4.6 / 30)
    assert pipeline.take_timings()["shading"] == 0  # nobody looks


def test_outputs_of_the_stages_can_be_kept(device):
    """What each stage leaves of the frame, and only what was asked for; the last one's is the frame's own."""
    scene = Rects([WALL, Rect((-0.5, 0.3, 6), (0.3, 0.6), velocity=(14, 1, 0), frequency=1.3, tint=(6, 0.3, 0.1))])
    pipeline = Pipeline(device, W, H)
    pipeline.keep()
    cameras = [camera(W, H, (0.02 * k, 0, 0)) for k in range(5)]
    submit(pipeline, scene, cameras, [k / 30 for k in range(5)])
    pipeline.extrapolate(camera(W, H, (0.3, 0, 0)), 4.5 / 30)
    read = {f"{owner.name}.{spec.name}": owner.read(spec.name) for owner, spec in pipeline.named_buffers()}
    stages = ("warp", "hidden_parts", "projection", "holes")
    expected = {f"{s}.{n}" for s in stages for n in ("color", "depth", "motion", "filled_by")}
    expected |= {"silhouettes.color", "warp.dynamic", "projection.dynamic"}
    expected -= {"holes.filled_by"}  # labeled so by the warp
    assert {f"{stage}.{spec.name}" for stage, spec in pipeline.outputs()} == expected <= set(read)
    assert set(np.unique(read["warp.filled_by"])) == {0, 254, 255}
    assert set(np.unique(read["projection.filled_by"])) >= {1, 255}
    for name in ("color", "depth", "motion", "filled_by"):
        last = {"filled_by": "projection", "color": "silhouettes"}.get(name, "holes")
        assert read[f"{last}.{name}"].tobytes() == read[f"frame.{name}"].tobytes()
        changed = (read[f"warp.{name}"] != read[f"projection.{name}"]).reshape(H, W, -1).any(-1)
        assert changed.any() and (read["warp.filled_by"] == 255)[changed].all()
    pipeline.keep(["projection.depth", "frame.color"])
    names = {f"{owner.name}.{spec.name}" for owner, spec in pipeline.named_buffers()}
    assert names & expected == {"projection.depth"}
