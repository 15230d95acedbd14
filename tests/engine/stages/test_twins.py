"""Every kernel against its NumPy twin, on frames that hold everything: moving parts, sky, bad pixels."""

import numpy as np
import pytest
import twins
from synthetic import Rect, Rects, camera
from twins import silhouettes as twins_silhouettes

from gffe_cl.engine.opencl.device import list_devices, open_info
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.base import Output
from gffe_cl.engine.stages.frame_block import polynomial_weights, reprojection

SCENE = Rects(
    [
        Rect((0, 0, 12), (9, 4), frequency=0.3),
        Rect((-1, 0.5, 6), (0.8, 1.5), velocity=(9, 0, 0), frequency=1, tint=(0.7, 0.2, 0.1)),
        Rect((1.5, -0.3, 5), (0.5, 0.5), velocity=(-3, 2, -12), frequency=2, tint=(4, 5, 90)),
        Rect((0.2, 0, 4), (0.05, 3), frequency=2, tint=(0.1, 0.1, 0.1)),
    ]
)


def frames(width, height, count=4, spoil=True, scene=SCENE):
    rng = np.random.default_rng(5)
    cameras = [
        camera(width, height, (0.1 * k, 0.02 * k, 0.15 * k), 0.02 * k, 0.004 * k * k, 0.01 * k) for k in range(count)
    ]
    previous = None
    for k in range(count):
        frame = scene.frame(cameras[k], k / 30, width, height, previous, reset=k == 0)
        previous = (cameras[k], k / 30)
        if spoil and k:
            for array, values in (
                (frame.depth, (np.nan, 0, -3, np.inf, 1e30)),
                (frame.motion, (np.nan, np.inf, 1e9, -1e6, 300)),
                (frame.color, (np.nan, np.inf, -np.inf, 60000, -5)),
            ):
                for value in values:
                    y, x = rng.integers(height), rng.integers(width)
                    array[y, x] = value
            frame.motion += rng.uniform(-0.01, 0.01, frame.motion.shape).astype(np.float32)
        yield frame


def run(device, width, height, options, int64=None, target=None, spoil=True):
    """Submit four frames; returns the pipeline, its last two host frames and the target camera and time."""
    pipeline = Pipeline(device, *(target or (width, height)), options, render_size=(width, height), int64_atomics=int64)
    seen = []
    pipeline.keep()
    for frame in frames(width, height, spoil=spoil):
        before = _state(pipeline, seen[-1]) if seen else None
        pipeline.submit(frame)
        seen.append(frame)
    to = camera(*(target or (width, height)), (0.35, 0.07, 0.6), 0.075, 0.045, 0.035)
    time = seen[-1].time + 0.02
    extrapolated = pipeline.extrapolate(to, time)
    return pipeline, seen, before, to, time, extrapolated


OPTIONS = [
    Options(shading_inputs=True, blocks=False),  # blocks: test_backward_blocks.py
    Options(history=4, order=3, levels=3, blocks=False),
    Options(hole_filling="push-pull", blocks=False, acceleration=False),
    Options(crack_closing=False, static_threshold=0.7, levels=0, hole_filling="downsample", resampling="linear"),
    Options(resampling="linear", levels=3, blocks=False),
]


def _state(pipeline, frame):
    """What the next frame starts from: dynamic mask, history, background levels, movers; `frame`: the last one."""
    history = pipeline.stages["history"]
    return history.read("dynamic_mask"), _planes(history), _levels(pipeline, frame), _movers(pipeline)


def _movers(pipeline):
    """Velocity, acceleration, what goes on of it, and velocity in view space, of cells, None where that is off."""
    stage = pipeline.stages.get("acceleration")
    return stage and tuple(stage.read(name) for name in ("velocity", "acceleration", "bend", "view_velocity"))


def _levels(pipeline, frame):
    """The background's levels; texels that are shown are pixels of `frame`."""
    if "background" not in pipeline.stages:
        return []
    levels = [
        {name: pipeline.stages["background"].read(f"{name}_{level}") for name in ("color", "depth", "px", "state")}
        for level in range(pipeline.options.levels)
    ]
    shown = levels[0]["state"] == twins.SHOWN
    of_frame = twins.collect_shown(frame.color, frame.depth, np.zeros_like(shown), True)
    for name in ("color", "depth", "px"):
        levels[0][name][shown] = of_frame[name][shown]
    return [levels[0] | {"shown": of_frame}, *levels[1:]]


CASES = [((61, 37), None), ((48, 33), (64, 48)), ((64, 48), (40, 31))]


@pytest.mark.parametrize("options", OPTIONS, ids=["default", "cubic", "push-pull", "literal", "linear"])
@pytest.mark.parametrize(("size", "target"), CASES, ids=["odd", "larger", "smaller"])
def test_stages_equal_their_twins(device, options, size, target, monkeypatch):
    """Masks, keys and links bit for bit; floats too, but for pixels where a rounding of the device's
    division differs (at most 1 in 1000, and then by 1e-5 relative)."""
    if options.resampling == "linear":
        monkeypatch.setattr(twins.common, "CODE_OFFSET", np.float32(0))
    pipeline, seen, before, to, time, extrapolated = run(device, *size, options, target=target)
    now, past = seen[-1], seen[-2]
    color, depth, motion = now.color.copy(), now.depth, now.motion
    to_previous = reprojection(now.camera, past.camera)

    threshold, error = np.float32((options.static_threshold or 0) ** 2), twins.EXACT
    if options.static_threshold is None:
        histogram = twins.residual_histogram(depth, motion, to_previous)
        assert np.array_equal(pipeline.stages["history"].read("residual_histogram"), histogram)
        threshold, error = twins.static_threshold(depth, motion, to_previous)
    assert pipeline.stages["history"].read("static_threshold_squared") == threshold

    dynamic_before, history_before, levels_before, movers_before = before
    dynamic, met_depth, history = twins.track_history(
        depth,
        motion,
        options.history,
        threshold,
        to_previous,
        reprojection(past.camera, now.camera),
        past.depth,
        dynamic_before,
        history_before,
        error=error,
    )
    assert np.array_equal(pipeline.stages["history"].read("dynamic_mask"), dynamic)
    assert 0.02 < dynamic.mean() < 0.6
    assert_close(pipeline.stages["history"].read("met_depth"), met_depth)
    if options.history > 2:
        assert_close(_planes(pipeline.stages["history"]), history)

    times = [f.time for f in reversed(seen)]
    to_target = reprojection(now.camera, to)
    weights = polynomial_weights(times, time, 5)
    movers = _movers(pipeline)
    assert bool(movers) == (options.acceleration and options.order == 1)
    if movers:
        ratio = np.float32((times[0] - times[1]) / (times[1] - times[2]))
        turned = to_previous, reprojection(past.camera, now.camera)
        met = pipeline.stages["history"].read("met_depth")
        expected = twins.track_acceleration(
            depth, motion, dynamic, met, *np.delete(movers_before, 2, 0), ratio, *turned
        )
        assert np.array_equal(movers[0][..., 3] > 0, expected[0][..., 3] > 0)
        assert np.array_equal(movers[1][..., 3] < 0, expected[1][..., 3] < 0)
        assert (movers[1][..., 3] > 0).mean() > 0.01
        for got, wanted in zip(movers, expected, strict=True):
            np.testing.assert_allclose(got[..., :3], wanted[..., :3], atol=2e-5, rtol=2e-3)  # ten bits
        np.testing.assert_allclose(movers[1][..., 3], expected[1][..., 3], atol=0.02)  # of small accelerations
        assert np.array_equal(movers[3][..., 3], expected[3][..., 3])
    px_prev = twins.centers(*depth.shape) + motion
    in_previous = twins.unproject(px_prev, met_depth, reprojection(past.camera, now.camera)[4])
    predicted = twins.predict_positions(
        depth, dynamic, history, options.order, weights, to_target, extrapolated.alpha, movers, in_previous
    )
    got = pipeline.stages["prediction"].read("target_position")
    assert np.array_equal(got[..., 2] > 0, predicted[..., 2] > 0)
    assert_close(got, predicted)

    links = twins.link_surfaces(depth, dynamic)
    assert np.array_equal(pipeline.stages["connectivity"].read("links"), links)

    # From here on the device's own positions, so that one rounding is not counted twice.
    zoom = np.array([to.fx / now.camera.fx, to.fy / now.camera.fy], np.float32)
    keys = twins.splat(got, depth, links, zoom, pipeline.sizes.target, options.crack_closing)
    warped = twins.resolve(keys, got, color, depth, dynamic, links, zoom)
    for name in ("dynamic", "disoccluded"):
        assert np.array_equal(pipeline.board.frame.read(name), warped[name]), name
    assert np.array_equal(pipeline.stages["warp"].read("mixed"), warped["mixed"])
    assert warped["disoccluded"].any()

    to_source = reprojection(to, now.camera)
    warped |= twins.fill_hidden_parts(warped, depth, zoom, to_source, pipeline.stages["hidden_parts"].reach)
    assert (warped["filled_by"] == twins.COMMON.BY_HIDDEN_PART).any()

    if options.levels:
        to_current = reprojection(past.camera, now.camera)
        level0 = twins.collect_shown(color, depth, dynamic, True)
        levels = twins.collect_levels(levels_before, level0, depth, dynamic, links, to_current)
        for level, (got_level, expected) in enumerate(zip(_levels(pipeline, now), levels, strict=True)):
            assert np.array_equal(got_level["state"], expected["state"]), level
            kept = expected["state"] > 0
            for name in ("color", "depth", "px"):
                assert_close(got_level[name][kept], expected[name][kept])
        assert (levels[0]["state"] == twins.REMEMBERED).any()
        assert (levels[0]["state"] == twins.BOTH).any() == (options.levels == 1)
        before = (past.color, past.depth, twins.unmixed(past.depth, dynamic_before), reprojection(to, past.camera))
        warped |= twins.project_background(warped, _levels(pipeline, now), zoom, to_target, to_source, before)
        assert np.isin(warped["filled_by"], range(1, options.levels + 1)).any()
    unfilled = warped["filled_by"] == twins.COMMON.BY_NOTHING
    labels = np.where(unfilled, twins.COMMON.BY_HOLE_FILLING, warped["filled_by"])
    assert np.array_equal(extrapolated.numpy("filled_by"), labels)

    if options.levels and options.hole_filling == "far-side":
        mixed = twins.mix_far_side(warped)
        changed = np.abs(twins.load_color(mixed) - twins.load_color(warped["color"])).max()
        assert changed > 5e-4 or size == CASES[0][0]  # there the background fills only pixels of mixed color
        warped |= {"color": mixed}
    sums, reach = (None, None), pipeline.stages["holes"].reach
    if options.hole_filling != "push-pull":
        asked = twins.asked_texels(warped, reach, to_source, twins.load_color(color), depth)
        sums = tuple((array.T * asked.T).T for array in twins.downsample(warped, color, depth))
        np.testing.assert_allclose(pipeline.stages["holes"].read("downsampled_color"), sums[0], rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(
            pipeline.stages["holes"].read("downsampled_inverse_depth"), sums[1], rtol=1e-4, atol=1e-5
        )
    filled = twins.fill_holes(warped, *sums, to_source, reach, twins.load_color(color), depth)
    holes = unfilled
    before_softening = pipeline.board.frame.read("color")
    if options.soft_silhouettes:
        kept = (owner for owner, _ in pipeline.named_buffers() if isinstance(owner, Output) and owner.name == "holes")
        before_softening = next(kept).read("color")
    for name in ("color", "depth", "motion"):
        got_image = before_softening if name == "color" else pipeline.board.frame.read(name)
        assert_close(got_image[~holes], filled[name][~holes])
        # Block sums are float32 on the device and float64 in the twin.
        np.testing.assert_allclose(
            got_image[holes].astype(np.float32), filled[name][holes].astype(np.float32), rtol=2e-3, atol=2e-3
        )

    if options.soft_silhouettes:
        assert_silhouettes(pipeline, before_softening, color, depth, links, zoom)

    if options.shading_inputs:
        shown = {spec.name: pipeline.board.frame.read(spec.name) for spec in pipeline.board.frame.buffers}
        previous, mask = twins.prepare_inputs(shown, motion, past.color, past.depth, reprojection(to, past.camera))
        assert np.array_equal(pipeline.stages["shading"].read("input_mask"), mask)
        # Positions, by the device's division, are good to 1/1000 px, and halves are rounded from either side.
        np.testing.assert_allclose(pipeline.stages["shading"].read("warped_previous"), previous, rtol=2e-3, atol=1e-3)
        assert 0.5 < previous[..., 3].mean() < 1


def assert_silhouettes(pipeline, before, color, depth, links, zoom):
    """From the device's own layers, motion and positions, as far as they lie on the path of a rounding."""
    stage, positions = pipeline.stages["silhouettes"], pipeline.stages["prediction"].read("target_position")
    layer, behind = twins_silhouettes.find_layers(color, depth, links, positions, zoom)
    share = stage.read("share").astype(np.float32) / np.float32(255)
    got = stage.read("layer"), np.concatenate([stage.read("behind")[..., :3].astype(np.float32), share[..., None]], -1)
    assert np.array_equal(got[0], layer)
    assert {twins_silhouettes.FAR, twins_silhouettes.NEAR} <= set(np.unique(layer))
    assert_within_a_step(got[1][layer > 0][:, :3], behind[layer > 0][:, :3])
    np.testing.assert_allclose(got[1][layer > 0][:, 3], behind[layer > 0][:, 3], atol=0.51 / 255 + 1e-3)
    marked = twins_silhouettes.mark_blocks(layer, positions, pipeline.sizes.target)
    assert np.array_equal(stage.read("marked"), marked)
    shown = {spec.name: pipeline.board.frame.read(spec.name) for spec in pipeline.board.frame.buffers}
    twin = twins_silhouettes.Softening(
        shown | {"color": before, "mixed": pipeline.stages["warp"].read("mixed")}, color, positions, got, zoom
    )
    coverage, softened = twin.run(marked)
    difference = np.abs(stage.read("coverage").astype(int) - coverage)
    assert (difference <= 1).all() and 0.02 < (coverage > 0).mean() < 0.6
    assert_within_a_step(pipeline.board.frame.read("color")[..., :3], softened)


def assert_within_a_step(got, expected):
    """Colors that were stored in mantissas of 9 bits which share an exponent: that of the largest."""
    got, expected = got.astype(np.float32), expected.astype(np.float32)
    assert (np.abs(got - expected) <= 2e-3 + np.abs(expected).max(-1, keepdims=True) / 256).all()


def _planes(stage):
    """Positions that are stored, in planes; none for k = 2."""
    return stage.read("history") if stage.positions > 2 else None


def assert_close(got, expected):
    same = (got == expected) | (np.isnan(got) & np.isnan(expected))
    assert (~same).sum() <= same.size // 1000, f"{(~same).sum()} of {same.size} values differ"
    both = np.isfinite(got) & np.isfinite(expected)
    np.testing.assert_allclose(got[both].astype(np.float64), expected[both].astype(np.float64), rtol=1e-5, atol=1e-5)
    assert np.array_equal(np.isfinite(got), np.isfinite(expected))


@pytest.mark.parametrize(("size", "target"), CASES, ids=["odd", "larger", "smaller"])
def test_two_pass_path_gives_the_same_bits(device, size, target):
    """The 32-bit path of the warp equals the 64-bit path, where the device has that."""
    if not device.int64_atomics:
        pytest.skip("device has no 64-bit atomics")
    results = [run(device, *size, Options(), int64, target)[-1] for int64 in (True, False)]
    for name in ("color", "depth", "motion", "dynamic", "disoccluded", "filled_by"):
        a, b = (r.numpy(name) for r in results)
        assert a.tobytes() == b.tobytes(), name


def test_five_runs_give_the_same_bits(device):
    first = None
    for _ in range(5):
        extrapolated = run(device, 61, 37, Options(history=3))[-1]
        bits = [extrapolated.numpy(n).tobytes() for n in ("color", "depth", "motion", "dynamic", "filled_by")]
        first = first or bits
        assert bits == first


@pytest.mark.parametrize("options", [Options(history=3, order=2), Options()], ids=["order 2", "acceleration"])
def test_devices_agree(options):
    """All usable devices give the same bits in every buffer that can be compared."""
    infos = [info for info in list_devices() if info.works and info.platform != "Oclgrind"]
    if len(infos) < 2:
        pytest.skip("needs two devices")
    results = []
    for info in infos:
        pipeline = run(open_info(info), 96, 64, options)[0]
        results.append({f"{s.name}.{b.name}": s.read(b.name) for s, b in pipeline.named_buffers()})
    for name, first in results[0].items():
        for other in results[1:]:
            assert first.tobytes() == other[name].tobytes(), name


@pytest.mark.long
@pytest.mark.parametrize("filling", ["far-side", "downsample"])
def test_block_means_reach_over_work_groups(device, filling):
    """A large hole on an image larger than what one work-group fills: labels stay, sums and fills are the twin's."""
    width, height = 301, 170
    pipeline = Pipeline(device, width, height, Options(hole_filling=filling, soft_silhouettes=False))
    for frame in frames(width, height, count=2, spoil=False):
        pipeline.submit(frame)
    names = ("color", "depth", "motion", "filled_by")
    pipeline.keep(f"background.{name}" for name in names)
    to = camera(width, height, (0, 0, 0), 0.6)
    pipeline.extrapolate(to, 0.05)
    kept = next(owner for owner, _ in pipeline.named_buffers() if isinstance(owner, Output))
    left = {name: kept.read(name) for name in names}
    holes = left["filled_by"] == twins.COMMON.BY_HOLE_FILLING
    unfilled = np.where(holes, twins.COMMON.BY_NOTHING, left["filled_by"])
    before = left | {"filled_by": unfilled, "dynamic": pipeline.board.frame.read("dynamic")}
    if filling == "far-side":
        before |= {"color": twins.mix_far_side(before | {"disoccluded": pipeline.board.frame.read("disoccluded")})}
    stage = pipeline.stages["holes"]
    to_source = reprojection(to, frame.camera)
    source = (twins.load_color(frame.color), frame.depth)
    asked = twins.asked_texels(before, stage.reach, to_source, *source)
    assert holes.mean() > 0.1 and 5 < asked.sum() < asked.size
    sums = tuple((array.T * asked.T).T for array in twins.downsample(before, frame.color, frame.depth))
    np.testing.assert_allclose(stage.read("downsampled_color"), sums[0], rtol=1e-4, atol=1e-4)
    filled = twins.fill_holes(before, *sums, to_source, stage.reach, *source)
    for name in ("color", "depth", "motion"):
        got = pipeline.board.frame.read(name)
        assert got[~holes].tobytes() == left[name][~holes].tobytes() or (name == "color" and filling == "far-side")
        assert_close(got[~holes], filled[name][~holes])
        np.testing.assert_allclose(
            got[holes].astype(np.float32), filled[name][holes].astype(np.float32), rtol=2e-3, atol=2e-3
        )
