"""The viewer's canvas: what the shader draws against NumPy, in an OpenGL context without a window."""

import colorsys
import os
from dataclasses import replace
from types import SimpleNamespace

import moderngl
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scn_models import constant_model

from gffe_cl import Camera, Options, Pipeline
from gffe_cl.captures.scenes import SceneFrames, SceneRenderer, load_scene
from gffe_cl.engine.inspection.layers import FRAME_LAYERS, LayerSpec, layers_of
from gffe_cl.engine.stages.buffers import Sizes, grid_of
from gffe_cl.lab.demo import error_image
from gffe_cl.lab.metrics import to_display
from gffe_cl.viewer.picture.canvas import Canvas, read
from gffe_cl.viewer.picture.displays import (
    LABEL_COLORS,
    MASK_OFF,
    SKY,
    Display,
    FrameInfo,
    color_table,
    default_display,
    fitted,
)
from gffe_cl.viewer.picture.shown_numbers import Texels, numbers_of
from gffe_cl.viewer.picture.view import CLIPPING, FLIP_MAP, View

LEVEL = 1.01 / 255  # half a level of rounding, and as much for powers
COLOR, DEPTH, MOTION = (FRAME_LAYERS[f"rendered.{name}"] for name in ("color", "depth", "motion"))
SCALAR = LayerSpec("s", "S", "test", "scalar")
MASK = LayerSpec("m", "M", "test", "mask")
LABEL = LayerSpec("l", "L", "test", "label", labels=((0, "none"), (1, "one")))
RNG = np.random.default_rng(7)


@pytest.fixture(scope="module")
def context():
    errors = []
    for how in ({"backend": "egl"}, {}):
        try:
            made = moderngl.create_context(standalone=True, **how)
        except Exception as error:  # moderngl raises plain ones
            errors.append(str(error))
            continue
        yield made
        made.release()
        return
    if os.environ.get("CI"):
        pytest.fail(f"no OpenGL context: {errors}")
    pytest.skip(f"no OpenGL context: {errors}")


@pytest.fixture(scope="module")
def kept(context):
    """One canvas for all: its programs are built once."""
    made = Canvas(context)
    yield made
    made.release()


@pytest.fixture
def canvas(kept):
    kept.forget(list(kept.layers))
    kept.frame = FrameInfo((8, 6))
    return kept


def drawn(canvas, view, size) -> np.ndarray:
    """(H, W, 3) display values in [0, 1]."""
    pixels = read(canvas.draw(view, size))
    assert (pixels[..., 3] == 255).all()
    return pixels[..., :3] / 255


def test_drawn_into_a_window(canvas):
    """A window's first row is the bottom one: the same picture as by itself, upside down, at its place."""
    image = np.random.default_rng(1).random((6, 8, 4)).astype(np.float16)
    canvas.upload("a", image, LayerSpec("a", "a", "", "color"))
    view = View("a", Display(), center=(4.0, 3.0), zoom=3.0)
    window = canvas.ctx.simple_framebuffer((60, 50), 4)
    window.clear(0.0, 0.0, 1.0, 1.0)
    canvas.draw_into(window, view, (7, 11), (40, 30))
    pixels = np.frombuffer(window.read(components=4), np.uint8).reshape(50, 60, 4)[::-1]
    np.testing.assert_array_equal(pixels[9:39, 7:47], read(canvas.draw(view, (40, 30))))
    assert (np.delete(pixels[9:39], np.s_[7:47], 1) == (0, 0, 255, 255)).all()
    assert (pixels[[*range(9), *range(39, 50)]] == (0, 0, 255, 255)).all()
    window.clear(0.0, 0.0, 1.0, 1.0)
    canvas.draw_into(window, view, (7, 11), (40, 30), alone=True)
    again = np.frombuffer(window.read(components=4), np.uint8).reshape(50, 60, 4)[::-1]
    is_picture = (again != (0, 0, 255, 255)).any(-1)
    assert is_picture[15:33, 15:39].all() and is_picture.sum() == 18 * 24, "nothing beside it is touched"
    np.testing.assert_array_equal(again[is_picture], pixels[is_picture])
    window.release()


def shown(canvas, spec, array, display=None, **view) -> np.ndarray:
    """`array` drawn pixel for pixel, as pages have it, too."""
    height, width = array.shape[1:3] if spec.planes > 1 else array.shape[:2]
    canvas.frame = replace(canvas.frame, display_size=(width, height))
    canvas.upload(spec.name, array, spec)
    display = display or default_display(spec)
    made = drawn(canvas, View(spec.name, display, **{"center": (width / 2, height / 2)} | view), (width, height))
    if not view:
        depth = canvas._layers.get("rendered.depth")
        depth = depth and np.frombuffer(depth.texels.read(), np.float32).reshape(height, width)
        plane = array[min(display.plane, spec.planes - 1)] if spec.planes > 1 else array
        layer = Texels(spec, display, plane.reshape(height, width, -1), canvas.frame, depth)
        close(layer.picture(View.background) / 255, made, 3)
    return made


def close(image, expected, levels=1.0):
    np.testing.assert_allclose(image, np.broadcast_to(expected, image.shape), rtol=0, atol=levels * LEVEL)


def mapped(t, name):
    """(…, 3) of the color map at t, linear between its entries."""
    at = np.clip(t, 0, 1) * 255
    return np.stack([np.interp(at, np.arange(256), column) for column in color_table(name).T], -1)


def wheel(vectors, scale):
    angle = np.arctan2(vectors[..., 1], vectors[..., 0]) / (2 * np.pi)
    hue = np.array([colorsys.hsv_to_rgb(turn % 1, 1, 1) for turn in angle.ravel()]).reshape(*angle.shape, 3)
    share = np.sqrt(np.minimum(np.linalg.norm(vectors, axis=-1) / scale, 1))[..., None]
    return 0.08 + (hue - 0.08) * share


# ---- where pixels land ---------------------------------------------------------------------------------


@given(
    layer=st.tuples(st.integers(1, 9), st.integers(1, 9)),
    display=st.tuples(st.integers(1, 11), st.integers(1, 11)),
    size=st.tuples(st.integers(1, 40), st.integers(1, 40)),
    zoom=st.floats(0.3, 7.5),
    center=st.tuples(st.floats(-2, 12), st.floats(-2, 12)),
)
@settings(max_examples=60, deadline=None)
def test_zoom_and_pan(kept, layer, display, size, zoom, center):
    """Labels of any size stretched over a display of any size, seen anywhere, where the view says that they are; the
    first row is on top."""
    values = RNG.integers(0, 16, layer[::-1]).astype(np.uint8)
    kept.frame = FrameInfo(display)
    kept.upload("l", values, LABEL)
    view = View("l", Display(), zoom=zoom, center=center, grid=False, background=(0, 0, 0))
    made = drawn(kept, view, size)
    at = [np.array([view.display_at(size, *[n + 0.5] * 2)[i] for n in range(size[i])]) / display[i] for i in (0, 1)]
    texel = [at[i] * layer[i] for i in (0, 1)]
    sure = [np.abs(t - np.round(t)) > 1e-4 for t in texel]  # float32 may decide otherwise on a border
    inside = [(a >= 0) & (a < 1) for a in at]
    index = [np.clip(np.floor(t), 0, n - 1).astype(int) for t, n in zip(texel, layer, strict=True)]
    colors = np.array(LABEL_COLORS)[values[index[1]][:, index[0]]]
    expected = np.where((inside[1][:, None] & inside[0])[..., None], colors, 0)
    certain = sure[1][:, None] & sure[0]
    close(made[certain], expected[certain])
    assert view.screen_at(size, *view.display_at(size, 13, 44)) == pytest.approx((13, 44))
    view.fit((100, 100), (50, 20))
    assert (view.zoom, view.center) == (2, (25, 10))


def test_part_of_the_rendered_image(canvas):
    """Of a rendered image with overscan only the display part is shown."""
    values = np.arange(16, dtype=np.uint8)[None].repeat(4, 0)
    canvas.frame = FrameInfo((8, 4), source_area=(0.25, 0.0, 0.75, 1.0))
    canvas.upload("l", values, replace(LABEL, grid="source"))
    close(drawn(canvas, View("l", Display(), center=(4, 2)), (8, 4))[1], np.array(LABEL_COLORS)[4:12])


# ---- color --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
@pytest.mark.parametrize("channels", [3, 4])
def test_exposure_and_tone_maps(canvas, dtype, channels):
    image = RNG.uniform(-0.1, 6, (13, 17, channels)).astype(dtype)
    canvas.frame = FrameInfo((17, 13), exposure=1.7)
    c = np.maximum(image[..., :3].astype(np.float32), 0) * 1.7 * 2**-1.5
    for tone_map, expected in (
        ("sRGB", to_display(c)),
        ("Reinhard", to_display(c / (1 + c))),
        ("ACES", to_display((c * (2.51 * c + 0.03)) / (c * (2.43 * c + 0.59) + 0.14))),
        ("linear", np.minimum(c, 1)),
    ):
        close(shown(canvas, COLOR, image, Display(exposure=-1.5, tone_map=tone_map)), expected)


def test_channels_of_color(canvas):
    image = RNG.uniform(0, 1, (5, 7, 4)).astype(np.float32)
    for index, channel in enumerate("RGB"):
        expected = to_display(image[..., index : index + 1], 2.0)
        close(shown(canvas, COLOR, image, Display(channel=channel, exposure=1)), expected)
    alpha = shown(canvas, COLOR, image, Display(channel="A", low=0.2, high=0.6))
    close(alpha, mapped((image[..., 3] - 0.2) / 0.4, "viridis"))
    close(shown(canvas, COLOR, image, Display(channel="nonsense")), to_display(image[..., :3]))


def test_weighted_sums_show_their_mean(canvas):
    spec = replace(COLOR, name="w", components=("R", "G", "B", "weight"))
    sums = np.zeros((2, 8, 4), np.float32)
    sums[0] = (10, 20, 30, 40)
    made = shown(canvas, spec, sums)
    close(made[0], to_display(np.array([0.25, 0.5, 0.75])))
    assert set(np.round(made[1] * 255).astype(int).ravel()) <= {30, 31, 76, 77}  # hatched: no weight


def is_checkered(pixels):
    return ((pixels == (1, 0, 1)).all(-1) | (np.abs(pixels - 0.05) < 0.01).all(-1)).reshape(pixels.shape[:2])


@pytest.mark.parametrize("spec", [COLOR, DEPTH, MOTION, SCALAR], ids=lambda spec: spec.view)
def test_bad_values_are_checkered(canvas, spec):
    image = RNG.uniform(0.5, 3, (12, 10, max(len(spec.components), 1))).astype(np.float32)
    image[RNG.uniform(size=(12, 10)) < 0.2, 0] = np.nan
    image[RNG.uniform(size=(12, 10)) < 0.2, -1 if spec is MOTION else 0] = -np.inf
    bad = np.isnan(image[..., 0]) if spec is DEPTH else ~np.isfinite(image).all(-1)  # depth below 0 is hatched
    image = image[..., 0] if spec in (SCALAR, DEPTH) else image
    assert (is_checkered(shown(canvas, spec, image)) == bad).all() and 0 < bad.sum() < bad.size
    if spec is not DEPTH:  # two layers with NaN do not agree
        canvas.upload("b", image, replace(spec, name="b"))
        made = shown(canvas, spec, image, b="b", b_display=Display(), compare="difference")
        assert (is_checkered(made) == bad).all()


def test_color_is_averaged_when_small_and_masks_are_not(canvas):
    noise = RNG.uniform(0, 1, (64, 64, 3)).astype(np.float32)
    canvas.frame = FrameInfo((64, 64))
    canvas.upload("c", noise, replace(COLOR, name="c"))
    canvas.upload("m", (noise[..., 0] > 0.5).astype(np.uint8), MASK)
    view = View("c", Display(), zoom=0.25, center=(32, 32))
    close(drawn(canvas, view, (16, 16)), to_display(noise.reshape(16, 4, 16, 4, 3).mean((1, 3))), 2)
    made = drawn(canvas, replace(view, a="m", zoom=0.3), (16, 16))
    assert len(np.unique(made[..., 0])) == 2
    canvas.upload("c", np.ones((64, 64, 3), np.float32), replace(COLOR, name="c"))
    close(drawn(canvas, view, (16, 16)), 1)  # not the mipmaps of before


# ---- false color --------------------------------------------------------------------------------------


def test_scalars_masks_and_planes(canvas):
    values = RNG.uniform(-2, 5, (11, 12)).astype(np.float32)
    for name in ("turbo", "viridis", "gray"):
        made = shown(canvas, SCALAR, values, Display(color_map=name, low=-1, high=3))
        close(made, mapped((values + 1) / 4, name), 2)
    stack = np.arange(3, dtype=np.float32)[:, None, None].repeat(4, 1).repeat(5, 2)
    for plane, expected in ((0, 0), (1, 0.5), (2, 1), (9, 1)):
        display = Display(high=2, plane=plane, color_map="gray")
        close(shown(canvas, replace(SCALAR, planes=3), stack, display), expected)
    made = shown(canvas, MASK, np.array([[0, 1]], np.uint8), Display(tint=(1, 0.5, 0.25)))
    close(made[0], [MASK_OFF, (1, 0.5, 0.25)])


@pytest.mark.parametrize("inverse", [False, True])
def test_depth(canvas, inverse):
    depth = RNG.uniform(1, 30, (10, 16)).astype(np.float32)
    depth[0, :8], depth[1, :8], depth[2, :8] = np.inf, np.nan, (-1, 0) * 4
    made = shown(canvas, DEPTH, depth, Display(low=2, high=20, color_map="turbo", inverse=inverse))
    t = (1 / depth[3:] - 0.5) / (1 / 20 - 0.5) if inverse else (depth[3:] - 2) / 18
    close(made[3:], mapped(t, "turbo"), 2)
    close(made[0, :8], SKY)
    close(made[1, :8], [(1, 0, 1)] * 4 + [(0.05,) * 3] * 4)  # checkered
    assert (np.ptp(made[2, :8], axis=-1) < 0.01).all() and made[2, :8].max() < 0.31  # hatched in gray


def test_motion(canvas):
    motion = RNG.normal(0, 4, (20, 23, 2)).astype(np.float32)
    motion[0, 0] = 0
    for sign in (1, -1):
        made = shown(canvas, MOTION, motion, Display(motion_scale=6, reverse=sign < 0))
        close(made, wheel(sign * motion, 6), 3)
        close(made[0, 0], 0.08)
    made = shown(canvas, MOTION, motion, Display(channel="y", low=-4, high=4, color_map="gray"))
    close(made, np.clip(motion[..., 1:] / 8 + 0.5, 0, 1))


@pytest.mark.parametrize("in_target", [False, True])
def test_place_is_shown_from_the_own_position(canvas, in_target):
    spec = LayerSpec("p", "P", "test", "place", ("x", "y"), grid="level1")
    own = np.stack(np.meshgrid(np.arange(7) + 0.5, np.arange(5) + 0.5), -1)
    moved = RNG.normal(0, 3, (5, 7, 2)).astype(np.float32)
    canvas.frame = FrameInfo((7, 5), render_size=(14, 10))
    if in_target:
        spec = replace(spec, components=("x", "y", "depth", "unused"), grid="target", places_in="target")
        values = np.concatenate([own + moved, np.full((5, 7, 1), 3.0), np.zeros((5, 7, 1))], -1).astype(np.float32)
        values[2, 3, 2] = -1
        depth = shown(canvas, spec, values, Display(channel="depth", low=1, high=5, color_map="gray"))
        close(depth[0], 0.5)
    else:
        values = (2 * own + moved).astype(np.float32)
        values[2, 3] = 0
    made, expected = shown(canvas, spec, values, Display(motion_scale=5)), wheel(moved, 5)
    known = np.ones((5, 7), bool)
    known[2, 3] = False
    close(made[known], expected[known], 3)
    assert np.ptp(made[2, 3]) < 0.01  # gray: nothing there


def test_world_is_shown_as_distance_from_the_own_fragment(canvas):
    camera = Camera(np.eye(4), 9.0, 8.0, 3.7, 2.9)
    depth = RNG.uniform(2, 6, (6, 8)).astype(np.float32)
    depth[0, :] = np.inf
    x, y = np.meshgrid(np.arange(8) + 0.5, np.arange(6) + 0.5)
    offset = RNG.normal(0, 1, (6, 8, 3))
    offset[2, 2] = (2.5, 0, 0)
    with np.errstate(invalid="ignore"):
        own = np.nan_to_num(camera.unproject(np.stack([x, y], -1), depth))
    history = np.zeros((2, 6, 8, 4), np.float32)
    history[1] = np.concatenate([own + offset, np.ones((6, 8, 1))], -1)
    history[1, 2, 2, 3] = 0
    canvas.frame = FrameInfo((8, 6), source=camera)
    canvas.upload("rendered.depth", depth, DEPTH)
    spec = LayerSpec("w", "W", "test", "world", ("x", "y", "z", "known"), planes=2, grid="source")
    made = shown(canvas, spec, history, Display(high=3, plane=1, color_map="gray"))
    expected = np.clip(np.linalg.norm(offset, axis=-1) / 3, 0, 1)[..., None]
    known = np.isfinite(depth)
    known[2, 2] = False
    close(made[known], np.broadcast_to(expected, made.shape)[known], 2)
    assert made[~known].max() < 0.31  # hatched
    canvas.forget(["rendered.depth"])
    assert shown(canvas, spec, history, Display(high=3, plane=1, color_map="gray")).max() < 0.31


def test_labels(canvas):
    values = np.array([[0, 1, 2, 3, 4, 254, 255, 16]], np.uint8)
    made = shown(canvas, LABEL, values)
    close(made[0], [LABEL_COLORS[i] for i in (0, 1, 2, 3, 4, 14, 15, 0)])
    bits = shown(canvas, replace(LABEL, labels=()), values)
    close(bits[0, :2], [LABEL_COLORS[15], LABEL_COLORS[14]])


# ---- comparison ----------------------------------------------------------------------------------------


@pytest.fixture
def pair(canvas):
    canvas.frame = FrameInfo((24, 18), exposure=1.3)
    a, b = (RNG.uniform(0, 1, (18, 24, 3)).astype(np.float32) for _ in range(2))
    canvas.upload("a", a, replace(COLOR, name="a"))
    canvas.upload("b", b, replace(COLOR, name="b"))
    view = View("a", Display(), "b", Display(), center=(12, 9))
    return view, to_display(a, 1.3), to_display(b, 1.3)


@pytest.mark.parametrize(("split", "line"), [(0.0, 2.0), (0.27, 2.0), (0.31, 4.0), (0.5, 4.0), (1.0, 2.0)])
def test_split(canvas, pair, split, line):
    view, a, b = pair
    made = drawn(canvas, replace(view, compare="split", split=split, line=line), (24, 18))
    from_line = np.arange(24) + 0.5 - split * 24
    close(made[:, from_line <= -line / 2], a[:, from_line <= -line / 2])
    close(made[:, from_line >= line / 2], b[:, from_line >= line / 2])
    close(made[:, np.abs(from_line) < line / 2], 1)
    canvas.upload("l", np.full((2, 3), 3, np.uint8), LABEL)  # of any kind and size
    made = drawn(canvas, replace(view, compare="split", b="l", split=split, line=line), (24, 18))
    close(made[:, from_line >= line / 2], LABEL_COLORS[3])


def contents_of(canvas, images):
    """What numbers are made of, for layers on the canvas."""
    return SimpleNamespace(image=images.get, spec=canvas.layers.get, frame_info=lambda of: canvas.frame)


def numbers(canvas, view, images):
    """(H, W, channels): the numbers of the whole picture."""
    (found,) = numbers_of(view, contents_of(canvas, images), None)
    rows, columns = (at.ravel() for at in np.mgrid[: found.grid.image.shape[0], : found.grid.image.shape[1]])
    return found.of(rows, columns).reshape(*found.grid.image.shape[:2], -1)


DEPTHS = {
    "absolute": ({}, "heat", (0, 0.5, 0, 1, 1), (0, 5, 0, np.inf, 30)),
    "signed": ({"difference": "signed", "gain": 1}, "diverging", (0.5, 0.4375, 0.5, 1, 0.875), (0, -5, 0, np.inf, 30)),
    "relative": ({"difference": "relative", "gain": 2}, "heat", (0, 0.4, 0, 1, 2 / 3), (0, 0.2, 0, 1, 1 / 3)),
    "mean": ({"difference": "mean", "gain": 2}, "heat", (0, 0.25, 0, 1, 1), (0, 5, 0, np.inf, 30)),
}


@pytest.mark.parametrize("kind", DEPTHS)
def test_depths_are_compared_by_their_values(canvas, kind):
    """Whatever colors both have: equal ones beyond the range of the color map would hide a difference."""
    changes, color_map, colors, values = DEPTHS[kind]
    canvas.frame = FrameInfo((5, 1))
    images = {
        "a": np.array([[10, 20, np.inf, np.inf, 90]], np.float32),
        "b": np.array([[10, 25, np.inf, 7, 60]], np.float32),
    }
    masks = {"a": np.array([[1, 2, 3, 4, 5]], np.uint8), "b": np.array([[1, 3, 3, 4, 5]], np.uint8)}
    display = Display(low=0.0, high=40.0, color_map="turbo")
    view = replace(View("a", display, "b", display, "difference", center=(2.5, 0.5), gain=4.0), **changes)
    for name, image in images.items():
        canvas.upload(name, image, DEPTH)
    close(drawn(canvas, view, (5, 1))[0], mapped(np.array(colors), color_map), 2)
    np.testing.assert_allclose(numbers(canvas, view, images)[0, :, 0], values)
    for name, labels in masks.items():
        canvas.upload(name, labels, LABEL)
    close(drawn(canvas, view, (5, 1))[0], mapped(np.array((0, 1, 0, 0, 0)), "heat"), 2)
    assert numbers(canvas, view, masks).ravel().tolist() == [0, 1, 0, 0, 0]


def test_difference_of_motion_is_of_its_vectors(canvas):
    canvas.frame = FrameInfo((3, 1))
    a, b = np.array([[[3, 4], [8, 0], [0, 0]]], np.float32), np.array([[[0, 0], [8, 0], [0, -8]]], np.float32)
    canvas.upload("a", a, MOTION)
    canvas.upload("b", b, MOTION)
    display = Display(motion_scale=20.0)
    view = View("a", display, "b", display, "difference", center=(1.5, 0.5), gain=2.0)
    close(drawn(canvas, view, (3, 1))[0], mapped(np.array([0.5, 0, 0.8]), "heat"), 2)
    close(drawn(canvas, replace(view, difference="signed"), (3, 1))[0], wheel((a - b)[0], 10.0), 2)
    assert numbers(canvas, view, {"a": a, "b": b})[0, :, 0].tolist() == [5, 0, 8]
    assert numbers(canvas, replace(view, difference="signed"), {"a": a, "b": b})[0].tolist() == (a - b)[0].tolist()


@pytest.mark.parametrize("tone_map", ["sRGB", "ACES", "linear"])
def test_numbers_over_a_comparison_of_colors_are_what_is_shown(canvas, tone_map):
    canvas.frame = FrameInfo((8, 6), exposure=0.5)
    images = {name: RNG.uniform(0, 2, (6, 8, 3)).astype(np.float32) for name in "ab"}
    for name, image in images.items():
        canvas.upload(name, image, replace(COLOR, name=name))
    display = Display(exposure=0.5, tone_map=tone_map)
    view = View("a", display, "b", display, "difference", center=(4, 3), gain=2.0, grid=False)
    close(drawn(canvas, view, (8, 6)), np.minimum(2 * numbers(canvas, view, images), 1), 2)
    signed = replace(view, difference="signed")
    close(drawn(canvas, signed, (8, 6)), mapped(0.5 + numbers(canvas, signed, images)[..., 0], "diverging"), 4)
    shares = replace(view, difference="relative")
    close(drawn(canvas, shares, (8, 6)), mapped(2 * numbers(canvas, shares, images)[..., 0], "heat"), 12)
    errors = replace(view, difference="mean")
    close(drawn(canvas, errors, (8, 6)), mapped(2 * numbers(canvas, errors, images)[..., 0], "heat"), 6)
    if tone_map == "sRGB":
        a, b = (to_display(image, 0.5 * 2**0.5) for image in images.values())
        np.testing.assert_allclose(numbers(canvas, view, images), np.abs(a - b), atol=1e-5)
        close(drawn(canvas, errors, (8, 6)), error_image(a, b, 2.0), 6)


def test_numbers_are_those_of_the_half_or_of_the_map(canvas):
    images = {name: RNG.uniform(0, 1, (6, 8)).astype(np.float32) for name in ("a", "b")}
    for name, image in images.items():
        canvas.upload(name, image, replace(SCALAR, name=name))
    view = View("a", Display(), "b", Display(), "split", split=0.3)
    at = np.array([2]), np.array([3])
    halves = numbers_of(view, contents_of(canvas, images), None)
    assert [(half.part, float(half.of(*at)[0, 0])) for half in halves] == [
        ((0.0, 0.3), float(images["a"][2, 3])),
        ((0.3, 1.0), float(images["b"][2, 3])),
    ]
    held = replace(view, a="b", compare="off")
    assert numbers(canvas, held, images)[2, 3, 0] == images["b"][2, 3]
    flip = RNG.uniform(0, 1, (6, 8)).astype(np.float32)
    (found,) = numbers_of(replace(view, a=FLIP_MAP, compare="off"), contents_of(canvas, images), flip)
    assert float(found.of(*at)[0, 0]) == flip[2, 3]
    canvas.upload("b", images["b"], replace(MASK, name="b"))
    assert numbers_of(replace(view, compare="difference"), contents_of(canvas, images), None) == []


# ---- overlays ------------------------------------------------------------------------------------------


def test_negative_and_clipped_colors_are_marked_as_they_are_exposed(canvas):
    image = np.full((1, 4, 3), 0.3, np.float32)
    image[0, 1, 2], image[0, 2, 0], image[0, 3, 1] = -0.01, 0.6, 1.2
    for exposure, clipped in ((0.0, [3]), (1.0, [2, 3])):
        made = shown(canvas, COLOR, image, Display(exposure=exposure), overlay="clipping")[0]
        np.testing.assert_allclose(made[1], CLIPPING["below 0"], atol=0.01)
        reds = [x for x in range(4) if np.allclose(made[x], CLIPPING["above white"], atol=0.01)]
        assert reds == clipped


def test_grid_only_when_zoomed_in(canvas):
    canvas.frame = FrameInfo((4, 4))
    canvas.upload("m", np.zeros((4, 4), np.uint8), MASK)
    view = View("m", Display(), center=(2, 2), zoom=7.9)
    assert len(np.unique(drawn(canvas, view, (28, 28)).reshape(-1, 3), axis=0)) == 1
    made = drawn(canvas, replace(view, zoom=32), (128, 128))
    line = np.zeros(128, bool)
    line[::32] = True
    assert (made[16, line] > 0.2).all()
    close(made[16, ~line], MASK_OFF)
    close(drawn(canvas, replace(view, zoom=32, grid=False), (128, 128)), MASK_OFF)


# ---- overview ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 3, 7])
def test_overview(canvas, count):
    canvas.frame = FrameInfo((16, 9))
    for index in range(count):
        values = np.full((9, 16), index, np.uint8)
        values[0, 0] = 15
        canvas.upload(f"l{index}", values, LABEL)
    names = [f"l{index}" for index in range(count)] + ["absent"]
    texture, tiles = canvas.overview([(name, Display()) for name in names], (301, 207), caption=15, gap=4)
    made = read(texture)[..., :3] / 255
    assert made.shape == (207, 301, 3) and [tile.name for tile in tiles] == names
    taken = np.zeros((207, 301), int)
    for index, tile in enumerate(tiles):
        taken[tile.y : tile.y + tile.height + 15, tile.x : tile.x + tile.width] += 1
        if tile.name != "absent":
            close(made[tile.y + tile.height // 2, tile.x + tile.width // 2], LABEL_COLORS[index])
            close(made[tile.y + 1, tile.x + 1], LABEL_COLORS[15])  # upper left corner
        assert tile.width / tile.height == pytest.approx(16 / 9, rel=0.1)
    assert taken.max() == 1 and taken.sum() == sum(t.width * (t.height + 15) for t in tiles)  # apart, and within


# ---- uploads -------------------------------------------------------------------------------------------


def test_size_and_type_may_change_any_time(canvas):
    display = Display(high=8, color_map="gray")
    for array in (
        np.full((5, 7), 4, np.float32),
        np.full((50, 70), 4, np.float16),
        np.full((1, 1), 4, np.uint8),
        np.full((9, 4), 4, np.float64),
        np.full((9, 4), 4, np.int32),
        np.full((3, 4), True),
        np.asfortranarray(np.full((6, 7), 4, np.float32)),
        np.full((12, 14, 2), 4, np.float32)[::2, ::-2, 0],
        np.full((6, 7, 1), 4, np.float32),
        np.full((6, 7, 6), 4, np.float32),
    ):
        canvas.upload("s", array, SCALAR)
        close(drawn(canvas, View("s", display, center=(4, 3)), (8, 6)), 0.125 if array.dtype == bool else 0.5)
    canvas.upload("s", np.zeros((0, 7), np.float32), SCALAR)
    canvas.upload("s", np.float32(3), SCALAR)
    close(drawn(canvas, View("s", display, center=(4, 3)), (8, 6)), 0.5)  # as before
    for spec, color in ((LABEL, LABEL_COLORS[1]), (MASK, 0.95)):  # another meaning
        canvas.upload("s", np.ones((6, 8), np.uint8), replace(spec, name="s"))
        close(drawn(canvas, View("s", Display(), center=(4, 3)), (8, 6)), color)


def test_missing_layer_is_background(canvas):
    view = View("absent", Display(), "gone", None, background=(0.2, 0.4, 0.6))
    for compare in ("off", "difference", "flip"):
        close(drawn(canvas, replace(view, compare=compare, overlay="clipping"), (8, 6)), (0.2, 0.4, 0.6), 130)
        close(drawn(canvas, replace(view, compare=compare), (8, 6)), (0.2, 0.4, 0.6))


# ---- a real pipeline -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "grid", ["source", "target", "level2", "cells", "residuals", "target_blocks", "downsampled", "network"]
)
def test_a_texel_is_shown_where_its_pixels_are(canvas, grid):
    """Also of an image whose sides are no multiple of the texels: the picture shows what inspection reads."""
    size = (61, 37)
    canvas.frame = FrameInfo(size)
    wide, high = Sizes(size, size).of(grid)
    texels = np.arange(wide * high, dtype=np.float32).reshape(high, wide) / (wide * high)
    canvas.upload("n", texels, LayerSpec("n", "N", "g", "scalar", grid=grid))
    y, x = np.mgrid[: size[1], : size[0]]
    image = drawn(canvas, View("n", Display(color_map="gray"), center=(30.5, 18.5)), size)
    side = grid_of(grid).texel
    close(image, np.repeat(texels[y // side[1], x // side[0]][..., None], 3, -1), 1.5)


def test_layers_of_a_pipeline(canvas, device, tmp_path):
    """Every buffer of every stage can be shown, and none is full of NaN."""
    size = (96, 54)
    scene = load_scene("corridor")
    frames = SceneFrames(SceneRenderer(device, scene, *size))
    pipeline = Pipeline(device, *size, Options(history=3, scn_model=constant_model(tmp_path / "m.onnx")), fps=scene.fps)
    *_, last = made = list(frames.sequence(3, start=1.0))
    for frame in made:
        pipeline.submit(frame)
    pipeline.extrapolate()
    frame = FrameInfo(size, exposure=scene.exposure, source=last.camera)
    canvas.frame = frame
    specs = layers_of(pipeline)
    images = {f"{s.name}.{b.name}": s.read(b.name) for s, b in pipeline.named_buffers() if b.grid != "once"}
    images["rendered.depth"] = last.depth
    displays = {}
    for name, array in images.items():
        canvas.upload(name, array, specs[name])
        displays[name] = fitted(specs[name], array, default_display(specs[name]), frame, last.depth)
    texture, tiles = canvas.overview(list(displays.items()), (900, 600))
    made = read(texture)[..., :3]
    for tile in tiles:
        part = made[tile.y : tile.y + tile.height, tile.x : tile.x + tile.width]
        assert (part != (255, 0, 255)).any(-1).all(), tile.name
    full = View("frame.color", displays["frame.color"], center=(48, 27))
    close(drawn(canvas, full, size), to_display(images["frame.color"][..., :3], scene.exposure))
