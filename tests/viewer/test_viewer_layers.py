"""Layers of the viewer: what there is, ranges, legends, texts, settings. No OpenGL."""

import json
from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest

from gffe_cl import Camera, Options, Pipeline
from gffe_cl.engine.inspection.layers import FRAME_LAYERS, VIEWS, LayerSpec, layer_of, layers_of
from gffe_cl.engine.pipeline.outputs import FILLINGS, STAGES
from gffe_cl.engine.stages.background import Background, _level_buffers
from gffe_cl.engine.stages.buffers import EXTRAPOLATED, FILLED_BY, Sizes
from gffe_cl.viewer.engine.jobs import Jobs
from gffe_cl.viewer.engine.slot_maker import residual_motion
from gffe_cl.viewer.picture.current_frame import Contents
from gffe_cl.viewer.picture.displays import (
    COLOR_MAPS,
    LABEL_COLORS,
    SKY,
    TONE_MAPS,
    Display,
    FrameInfo,
    area_of,
    color_table,
    default_display,
    fitted,
    shown_as,
    wheel_color,
)
from gffe_cl.viewer.picture.looks import BINS, Histogram, Looks, counted
from gffe_cl.viewer.picture.view import View
from gffe_cl.viewer.state.captions import legend, value_text

DEPTH, MOTION, FINAL = (FRAME_LAYERS[name] for name in ("rendered.depth", "rendered.motion", "final"))
BUFFERS = [
    (stage.name, spec)
    for stage in (*STAGES, *filter(None, FILLINGS.values()))
    for spec in (_level_buffers(1) if stage is Background else stage.buffers)
    if spec.grid != "once"
] + [("frame", spec) for spec in EXTRAPOLATED]
BY_NAME = {layer.name: layer for layer in (layer_of(*of) for of in BUFFERS)} | FRAME_LAYERS
CAMERA = Camera(np.eye(4), 100.0, 110.0, 32.0, 24.0)


def ranged(spec, image, display=None, **known):
    return fitted(spec, np.asarray(image, np.float32), display or default_display(spec), **known)


def test_histograms_count_what_is_shown():
    rng = np.random.default_rng(2)
    color = rng.uniform(0, 1, (40, 50, 4)).astype(np.float16)
    color[0, 0] = np.nan
    frame = FrameInfo((50, 40))
    counts = counted(FINAL, color, Display(), frame, None, 2.0)
    assert counts.channels == ("R", "G", "B") and counts.shares.shape == (3, BINS)
    assert counts.shares.sum(1) == pytest.approx([100.0] * 3) and 1.9 < counts.edges[-1] <= 2.0, "exposed, without NaN"
    counts = counted(FINAL, color, Display(channel="G"), frame, None, 1.0)
    expected = np.histogram(color[..., 1][np.isfinite(color[..., 1])].astype(float), counts.edges)[0]
    assert counts.channels == ("G",) and np.allclose(counts.shares[0, 1:-1], expected[1:-1] * counts.least)
    depth = np.full((40, 50), 3.0, np.float32)
    depth[:, :10], depth[:, 10:20], depth[:, 20:25] = np.inf, 0, 7
    counts = counted(DEPTH, depth, Display(), frame, None, 1.0)
    assert counts.shares[0, [0, -1]] == pytest.approx([100 * 25 / 30, 100 * 5 / 30])
    motion = np.tile(np.float32((3, 4)), (40, 50, 1))
    counts = counted(MOTION, motion, Display(), frame, None, 1.0)
    assert counts.edges[0] == pytest.approx(5) and counts.shares[0, 0] == 100, "lengths"
    assert counted(BY_NAME["frame.filled_by"], np.zeros((4, 5), np.uint8), Display(), frame, None, 1.0) is None


def test_handles_of_the_histogram_change_the_display():
    for spec, handles, handle, value, changed in (
        (FINAL, {"white": 0.5}, "white", 0.25, {"exposure": 2.0}),
        (DEPTH, {"low": 1.0, "high": 100.0}, "low", 5.0, {"low": 5.0, "high": 100.0}),
        (DEPTH, {"low": 1.0, "high": 100.0}, "high", 0.5, {"low": 1.0, "high": 1.0}),
        (MOTION, {"full length": 16.0}, "full length", -3.0, {"motion_scale": 0.01}),
    ):
        contents = Contents()
        contents.layers = [spec]
        looks = Looks(contents, {FINAL.name: {"exposure": 1.0}})
        histogram = Histogram(View(spec.name, Display()), contents, looks, Jobs("test"))
        assert histogram.handles() == handles
        histogram.drag(handle, value)
        assert {name: getattr(looks.of(spec.name), name) for name in changed} == pytest.approx(changed)


def test_stage_buffers_become_layers():
    spec = BY_NAME["frame.filled_by"]
    assert (spec.label, spec.group, spec.view, spec.grid) == ("Filled by", "frame", "label", "target")
    assert spec.labels == FILLED_BY and spec.channels == ("value",)
    assert BY_NAME["prediction.target_position"].places_in == "target"
    assert BY_NAME["background.px_1"].places_in == "rendered"
    assert all(spec.description and spec.view in VIEWS for spec in BY_NAME.values())


def test_layers_do_not_depend_on_what_is_kept(device):
    pipeline = Pipeline(device, 64, 48, Options(shading_inputs=True))
    layers = layers_of(pipeline)
    pipeline.keep(["warp.motion", "holes.color"])
    assert list(layers_of(pipeline).items()) == list(layers.items())
    generated = {name for name, spec in layers.items() if spec.of_generated}
    assert {"frame.color", "warp.color", "projection.color", "holes.color", "prediction.target_position"} <= generated
    assert not generated & {"final", "rendered.color", "history.history", "connectivity.links", "background.color_0"}


def test_channel_decides_how_it_is_shown():
    views = {("final", "RGB"): ("color", -1), ("final", "nonsense"): ("color", -1), ("final", "G"): ("color", 1)}
    views |= {("final", "A"): ("scalar", 3), ("shading.warped_previous", "valid"): ("scalar", 3)}
    views |= {("rendered.motion", "vector"): ("motion", -1), ("rendered.motion", "y"): ("scalar", 1)}
    views |= {("rendered.depth", ""): ("depth", 0), ("prediction.target_position", "depth"): ("depth", 2)}
    views |= {("history.history", "known"): ("mask", 3), ("history.history", "z"): ("scalar", 2)}
    for (name, channel), expected in views.items():
        assert shown_as(BY_NAME[name], Display(channel=channel)) == expected, (name, channel)


def test_display_survives_json():
    numbers = {"exposure": -1.5, "low": -1e6, "high": 2.5, "motion_scale": 0.1, "plane": 3, "tint": (0.1, 0.2, 1.0)}
    others = {"tone_map": TONE_MAPS[-1], "channel": "A", "color_map": COLOR_MAPS[-1], "inverse": True, "reverse": True}
    display = Display(**numbers, **others)
    assert Display.from_dict(json.loads(json.dumps(display.to_dict()))) == display
    assert all(getattr(display, field.name) != field.default for field in fields(Display))


def test_damaged_settings_fall_back():
    numbers = {"exposure": "bright", "low": float("nan"), "plane": -1, "motion_scale": 0}
    others = {"tone_map": "filmic", "color_map": 3, "tint": [1, 2], "inverse": 1, "reverse": None, "unknown": 1}
    for name, value in (numbers | others).items():
        assert Display.from_dict({"high": 7, name: value}) == Display(high=7.0), name


# ---- ranges --------------------------------------------------------------------------------------------


def test_ranges_skip_sky_invalid_pixels_and_outliers():
    rng = np.random.default_rng(1)
    depth, motion = rng.uniform(2, 10, (60, 80)), rng.normal(0, 3, (50, 70, 2))
    depth[0, :6], motion[0, 0] = (np.inf, np.nan, 0, -5, 1e9, 1e-9), np.inf
    made = ranged(DEPTH, depth)
    valid = depth[np.isfinite(depth) & (depth > 0)]
    assert (made.low, made.high) == pytest.approx(tuple(np.quantile(valid, (0.01, 0.99))), rel=1e-5)
    expected = np.quantile(np.hypot(*motion.reshape(-1, 2)[1:].T), 0.99)
    assert ranged(MOTION, motion).motion_scale == pytest.approx(expected, rel=1e-5)


def test_range_of_nothing_is_left_alone():
    display = Display(low=3, high=4, motion_scale=5)
    for spec, size, value in (
        (DEPTH, (4, 4), np.inf),
        (MOTION, (4, 4, 2), np.nan),
        (DEPTH, (0, 4), 0),
        (FINAL, (4, 4, 4), 1),
    ):
        assert ranged(spec, np.full(size, value), display) == display


def test_range_of_few_values_holds_zero_and_all_of_them():
    spec, values = BY_NAME["shading.input_mask"], np.full((100, 100), 0.5)
    for value in (0.0, 1.0, -3.0):
        made = ranged(spec, np.full((9, 9), value))
        assert made.low <= min(value, 0) and made.high >= max(value, 0) and made.high > made.low
    values[50, :20] = 1
    for zeros in (0, 80):  # a rare value of a code, too
        values[:zeros], values[50, :5] = 0, 1
        made = ranged(spec, values)
        assert (made.low, made.high) == (0, 1)


def test_ranges_of_places_count_from_the_own_position():
    """... in the rendered image, here of twice the size, or in the target."""
    x, y = np.meshgrid(np.arange(40) + 0.5, np.arange(30) + 0.5)
    px = np.stack([2 * x + 3, 2 * y - 4], -1)
    ahead = np.stack([4 * x + 6, 4 * y, np.ones_like(x), np.zeros_like(x)], -1)
    px[0, 0], ahead[1, 1] = 0, (1e6, 0, -1, 0)  # nothing there
    for name, places, rendered, scale in (
        ("background.px_1", px, (80, 60), 5),
        ("prediction.target_position", ahead, (40, 30), 6),
    ):
        frame = FrameInfo((160, 120), render_size=rendered)
        assert ranged(BY_NAME[name], places, frame=frame).motion_scale == pytest.approx(scale, rel=1e-4)


def test_world_range_is_of_distances_from_the_own_fragment():
    depth = np.full((48, 64), 5.0, np.float32)
    x, y = np.meshgrid(np.arange(64) + 0.5, np.arange(48) + 0.5)
    own = CAMERA.unproject(np.stack([x, y], -1), depth)
    history = np.concatenate([own, np.ones((48, 64, 1))], -1)
    history[10:20, 10:20, :3] += (0, 2, 0)
    history[30, 30] = (9e9, 0, 0, 0)  # not known
    spec = BY_NAME["history.history"]
    made = ranged(spec, history, frame=FrameInfo((64, 48), source=CAMERA), depth=depth)
    assert (made.low, made.high) == (0, pytest.approx(2, rel=2e-3))
    assert ranged(spec, history) == default_display(spec)  # unknown without depth and camera


def test_plane_is_ranged_on_its_own():
    spec = replace(BY_NAME["shading.input_mask"], planes=2)
    image = np.stack([np.linspace(0, 1, 400).reshape(20, 20), np.linspace(5, 9, 400).reshape(20, 20)])
    assert ranged(spec, image, Display(plane=1)).low > 5


# ---- geometry ------------------------------------------------------------------------------------------


def test_area_of_a_window():
    display = Camera(np.eye(4), 100.0, 100.0, 50.0, 40.0)
    render = Camera(np.eye(4), 80.0, 90.0, 55.0, 38.0)
    area = area_of(render, (100, 80), display, (100, 80))
    corner = display.unproject(np.array([[0.0, 0.0], [100.0, 80.0]]), np.ones(2))
    px = render.project(corner)[0] / (100, 80)
    np.testing.assert_allclose(area, px.ravel())


def test_own_place_in_the_target_seen_through_a_window():
    """A texel in the middle of the part of the rendered image that is shown lies in the middle of the target."""
    frame = FrameInfo((100, 80), source_area=(0.1, 0.2, 0.7, 0.9))
    scale_x, scale_y, offset_x, offset_y = frame.own_place(BY_NAME["prediction.target_position"])
    assert (0.4 * scale_x + offset_x, 0.55 * scale_y + offset_y) == pytest.approx((50, 40))
    assert frame.own_place(BY_NAME["background.px_1"]) == (100, 80, 0, 0)


# ---- colors, legends, texts ---------------------------------------------------------------------------


def test_color_maps_run_as_they_should():
    ends = {
        "turbo": ("30123b", "7a0403"),
        "viridis": ("440154", "fde725"),
        "gray": ("000000", "ffffff"),
        "heat": ("000000", "ffffff"),
        "diverging": ("33ffff", "ffff33"),
    }
    for name in COLOR_MAPS:
        table = color_table(name)
        assert table.shape == (256, 3) and table.min() >= 0 and table.max() <= 1
        expected = [[byte / 255 for byte in bytes.fromhex(end)] for end in ends[name]]
        np.testing.assert_allclose(table[[0, -1]], expected, atol=0.13)  # the polynomials' error at turbo's ends
    assert color_table("diverging")[127:129].max() < 0.01
    np.testing.assert_allclose(color_table("viridis")[128], (0.128, 0.567, 0.551), atol=0.02)


def test_labels_can_be_told_apart():
    shown = legend(BY_NAME["frame.filled_by"], Display()).labels
    assert [text for text, _ in shown] == [text for _, text in FILLED_BY] and len(LABEL_COLORS) == 16
    for colors, least in ((np.array(LABEL_COLORS), 0.15), (np.array([color for _, color in shown]), 0.35)):
        apart = np.linalg.norm(colors[:, None] - colors[None], axis=-1) + np.eye(len(colors))
        assert apart.min() > least
    bits = dict(legend(BY_NAME["connectivity.links"], Display()).labels)
    assert bits["15"] == LABEL_COLORS[0] and bits["0"] == LABEL_COLORS[15], "the full set is calm"


def test_legends():
    made = legend(DEPTH, Display(low=2, high=10, color_map="viridis"))
    assert [text for _, text, _ in made.ticks] == ["2", "4", "6", "8", "10"]
    assert made.labels == (("sky", SKY),) and made.unit == "world units"
    np.testing.assert_allclose(made.ticks[0][2], color_table("viridis")[0])
    inverse = legend(DEPTH, Display(low=2, high=10, inverse=True)).ticks
    assert float(inverse[2][1]) == pytest.approx(1 / (0.5 * (1 / 2 + 1 / 10)), rel=1e-3)
    made = legend(MOTION, Display(motion_scale=8))
    assert made.kind == "wheel" and made.unit == "full color from 8 px"
    assert legend(MOTION, Display(channel="x")).kind == "ramp" and legend(FINAL, Display()).kind == "none"
    assert legend(BY_NAME["frame.disoccluded"], Display(tint=(1, 0, 0))).labels[1] == ("1", (1, 0, 0))
    assert wheel_color((0, 0.5, 0.3), (1, 5, 0)).tolist() == [[1, 0, 0], [0, 1, 1], [0.08] * 3]


@pytest.mark.parametrize(
    ("name", "values", "text"),
    [
        ("final", (0.5, 0.25, 12.345, 0), "R 0.5  G 0.25  B 12.35"),
        ("final", (np.nan, np.inf, 0), "R NaN  G inf  B 0"),
        ("shading.warped_previous", (1, 2, 3, 0), "R 1  G 2  B 3  valid 0"),
        ("rendered.depth", np.float32(3.25), "3.25 world units"),
        ("rendered.depth", np.inf, "sky"),
        ("rendered.depth", -1, "no depth (-1)"),
        ("rendered.depth", np.nan, "no depth (NaN)"),
        ("rendered.motion", (3, -4), "(+3.00, -4.00) px, 5.00 px long"),
        ("prediction.target_position", (1.5, 2, 7, 0), "(1.50, 2.00) px, depth 7"),
        ("prediction.target_position", (1.5, 2, np.inf, 0), "(1.50, 2.00) px, depth sky"),
        ("prediction.target_position", (0, 0, -1, 0), "nothing"),
        ("background.px_1", (0, 0), "nothing"),
        ("history.history", (1, 2, 3, 1), "(1, 2, 3) world units"),
        ("history.history", (1, 2, 3, 0), "not known"),
        ("frame.dynamic", np.uint8(1), "yes"),
        ("frame.filled_by", np.uint8(254), "254: crack closing"),
        ("frame.filled_by", np.uint8(77), "77"),
        ("connectivity.links", np.uint8(5), "5: right, left"),
        ("holes.downsampled_inverse_depth", 0.123456, "0.1235"),
    ],
)
def test_value_texts(name, values, text):
    assert value_text(BY_NAME[name], values) == text


def test_every_buffer_of_the_stages_has_a_display_and_texts():
    for stage, buffer in BUFFERS:
        spec, array = layer_of(stage, buffer), np.ones(buffer.shape(Sizes((64, 48), (64, 48))), buffer.dtype)
        for channel in spec.channels:
            display = fitted(spec, array, replace(default_display(spec), channel=channel), FrameInfo((64, 48)))
            assert legend(spec, display).kind in ("none", "ramp", "wheel")
        assert value_text(spec, array[:, 0, 0] if spec.planes > 1 else array[0, 0])


def test_depth_against_motion():
    """0 for what is static, with sky and a camera that turns and moves; else what moves, or what a wrong depth adds."""
    rng, source = np.random.default_rng(2), Camera.look_at((0, 0, 0), (0.1, 0, 1), (0, 1, 0), 30, 31, 16.2, 11.7)
    before = Camera.look_at((0.3, -0.1, -0.2), (0.2, 0, 1), (0, 1, 0), 29, 30, 16, 12)
    depth = rng.uniform(2, 9, (24, 32)).astype(np.float32)
    depth[:4], depth[5, 5] = np.inf, -1.0
    px = np.stack(np.meshgrid(np.arange(32), np.arange(24)), -1) + 0.5
    static = before.project(source.unproject(px, np.minimum(depth, 1e12)))[0] - px
    moving = np.zeros((24, 32, 2))
    moving[10:16, 10:20] = rng.normal(0, 2, (6, 10, 2))
    found = residual_motion(px, depth, (static + moving).astype(np.float32), source, before)
    assert np.isnan(found[5, 5]).all()
    found[5, 5] = 0
    np.testing.assert_allclose(found, moving, atol=1e-5)
    far = residual_motion(px, 1.1 * depth, static.astype(np.float32), source, before)
    assert np.abs(far[:4]).max() < 1e-4 and np.linalg.norm(far[6:], axis=-1).min() > 0.05


def test_a_picture_without_motion_gives_no_range():
    """The first frame has none: all later ones would be as bright as can be."""
    spec, moving = LayerSpec("m", "m", "", "motion"), np.full((4, 6, 2), 3.0, np.float32)
    images = {"m": np.zeros_like(moving)}
    contents = SimpleNamespace(spec=lambda name: spec, image=images.get, frame_info=lambda: None)
    looks = Looks(contents, {})
    assert looks.of("m") == default_display(spec)
    images["m"] = moving
    assert looks.of("m").motion_scale == pytest.approx(3 * 2**0.5)
    images["m"] = 2 * moving
    assert looks.of("m").motion_scale == pytest.approx(3 * 2**0.5), "one range for all"
