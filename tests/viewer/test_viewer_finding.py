"""Finding what is wrong: figures of slots, regions of errors, the survey, the way of a fragment, rectangles."""

import time
from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from viewer_session import wait_for

from gffe_cl import GffeError, Options
from gffe_cl.captures.scenes import load_scene
from gffe_cl.captures.scenes.render import render_sequence
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.inspection import names
from gffe_cl.engine.inspection.explain.motion_trail import Passed, way_of
from gffe_cl.engine.inspection.layers import FRAME_LAYERS, LayerSpec
from gffe_cl.engine.opencl.device import open_device
from gffe_cl.lab.metrics import Metric, psnr, squared_error, to_display
from gffe_cl.lab.metrics.flicker import Flicker
from gffe_cl.lab.metrics.regions import REGIONS as TABLE
from gffe_cl.lab.table.footage import find_labels
from gffe_cl.viewer.engine.figures import (
    NEEDED,
    REGIONS,
    Figures,
    Measurements,
    Measurer,
    Part,
    parts_of,
    region_labels,
)
from gffe_cl.viewer.engine.invalid import seen_at, seen_through
from gffe_cl.viewer.engine.messages import Failure, Frame, Key, Recipe, Setup
from gffe_cl.viewer.engine.store import Store, Want
from gffe_cl.viewer.picture.colors import LABEL_COLORS, color_table
from gffe_cl.viewer.picture.disocclusions import Disocclusions
from gffe_cl.viewer.picture.displays import Display
from gffe_cl.viewer.picture.files import save_json
from gffe_cl.viewer.picture.invalid import InvalidPixels
from gffe_cl.viewer.picture.legend_strip import Entry, with_legends
from gffe_cl.viewer.picture.legends import Legend, legend
from gffe_cl.viewer.picture.selection import statistics
from gffe_cl.viewer.picture.view import View
from gffe_cl.viewer.picture.worst_pixels import worst_pixels
from gffe_cl.viewer.state.baseline import Baseline
from gffe_cl.viewer.state.playback import Playback
from gffe_cl.viewer.state.survey import Side, Survey

HEIGHT, WIDTH = 20, 32
CAMERA = Camera(np.eye(4), 20.0, 20.0, WIDTH / 2, HEIGHT / 2)


def made(slot=1, n=1, error=0.1, seed=0, alpha=0.5, key=None):
    """A generated slot as the engine gives it: depth steps in the middle, a mover left, holes at the right rim."""
    rng = np.random.default_rng(seed)
    truth = np.zeros((HEIGHT, WIDTH, 4), np.float16)
    truth[..., :3] = rng.uniform(0.2, 0.6, (HEIGHT, WIDTH, 3))
    final = truth.copy()
    final[..., :3] += (error * rng.uniform(0.5, 1, (HEIGHT, WIDTH, 1))).astype(np.float16)
    depth = np.full((HEIGHT, WIDTH), 4.0, np.float32)
    depth[:, WIDTH // 2 :] = 8.0
    dynamic, holes = (np.zeros((HEIGHT, WIDTH), np.uint8) for _ in range(2))
    dynamic[:, :5], holes[:, -6:] = 1, 1
    images = {
        names.FINAL: final, names.TRUTH: truth, names.DEPTH: depth, names.DYNAMIC: dynamic, names.DISOCCLUDED: holes,
        names.FILLED_BY: np.where(holes, 255, 0).astype(np.uint8),
        names.MOTION: np.broadcast_to(np.float32((3, 4)), (HEIGHT, WIDTH, 2)).copy(),
    }  # fmt: skip
    # the rendered frame saw three columns less at the right
    rendered = Camera(np.eye(4), 20.0, 20.0, WIDTH / 2 - 3 + 6, HEIGHT / 2)
    moment = SimpleNamespace(alpha=alpha, camera=CAMERA, render_camera=rendered)
    return Frame(
        key or Key(Recipe(0, 0, Setup(n=n), ""), slot), frozenset(images), moment, images, {},
        {"warp": {"splat": 1.5}, "holes": {"fill": 0.25}}, 0.0, 0.0, render_size=(WIDTH, HEIGHT),
    )  # fmt: skip


def shown(result):
    return [to_display(result.images[name][..., :3], 1.0) for name in (names.FINAL, names.TRUTH)]


def test_regions_and_their_shares():
    result = made()
    labels = region_labels(result, 1.0)
    number = {name: index for index, name in enumerate(REGIONS)}
    assert (labels[:, -3:] == number["out of screen"]).all()
    assert (labels[:, -6:-3] == number["disoccluded"]).all()
    assert (labels[:, WIDTH // 2 - 1 : WIDTH // 2 + 1] == number["silhouettes"]).all()
    assert (labels[:, :5] == number["dynamic"]).all()
    assert set(np.unique(labels[:, 5 : WIDTH // 2 - 1])) <= {number["focus"], number["rest"]}
    parts = parts_of(labels, squared_error(*shown(result)))
    mask, (a, b) = labels == number["disoccluded"], shown(result)
    assert parts["disoccluded"].psnr == pytest.approx(psnr(a, b, mask), abs=1e-4)
    assert parts["disoccluded"].pixels == mask.mean()
    assert sum(part.error for part in parts.values()) == pytest.approx(1)
    assert np.isnan(parts_of(np.zeros_like(labels), np.zeros(labels.shape))["rest"].psnr)


def test_disocclusions_over_the_picture():
    """Three columns out of screen and three that are hidden; nothing of a rendered frame; means by settings."""
    uploads = {}
    canvas = SimpleNamespace(
        upload=lambda name, image, spec: uploads.update({name: image}),
        forget=lambda gone: [uploads.pop(name, None) for name in gone],
    )
    contents = SimpleNamespace(result=made(), changes=1)
    found = Disocclusions(View("final", Display()), contents)
    found.update(canvas)
    assert not uploads and found.needed == frozenset()
    found.switch(True)
    found.update(canvas)
    labels = uploads["disocclusions"]
    assert labels.shape == (HEIGHT, WIDTH) and found.needed <= contents.result.images.keys()
    assert [list(np.unique(part)) for part in (labels[:, :-6], labels[:, -6:-3], labels[:, -3:])] == [[255], [1], [0]]
    assert found.share == (6 / WIDTH, 3 / WIDTH) and found.text() == "disoccluded 18.8% (9.4% out of screen)"
    contents.result, contents.changes = made(3), 2
    contents.result.images[names.DISOCCLUDED][:] = 0
    found.update(canvas)
    assert found.share == (0, 0) and found.mean == (3 / WIDTH, 1.5 / WIDTH)
    contents.result, contents.changes = made(4), 3
    contents.result.moment.alpha = 0.0
    found.update(canvas)
    assert found.share is None and not uploads and found.mean == (3 / WIDTH, 1.5 / WIDTH)
    contents.result, contents.changes = made(5, n=2), 4
    found.update(canvas)
    assert found.mean == (6 / WIDTH, 3 / WIDTH)


def test_regions_are_those_of_the_table(tmp_path):
    """... of `gffe eval` where it finds them by the pipeline: its two kinds of disocclusions are one here."""
    from gffe_cl.lab.table.footage import FolderSubject, open_subject
    from gffe_cl.viewer.engine.engine import Engine
    from gffe_cl.viewer.engine.sources.opening import ScenePlan, make_source

    device = open_device(profiling=True)
    render_sequence(load_scene("corridor"), tmp_path, device, 96, 54, 5, 30.0, ground_truth=True, samples=1)
    joined = {"static disocclusion": "disoccluded", "dynamic disocclusion": "disoccluded"}
    one = [list(REGIONS).index(joined.get(name, name)) for name in TABLE]
    footage = open_subject(FolderSubject(str(tmp_path), 1), device)
    slots = [2 * round(moment.time * 30 - 0.5) + 1 for shot in footage.shots() for moment in shot.moments]
    expected = [np.take(one, labels) for labels in find_labels(footage, device)]
    assert slots and len(slots) == len(expected)
    engine = Engine(lambda: device)
    engine.start()
    engine.open_source(lambda opened: make_source(str(tmp_path), None, ScenePlan(1, 1, 0), opened))
    try:
        wait_for(lambda: engine.source, 60)
        for slot, labels in zip(slots, expected, strict=True):
            want = Want(Key(engine.recipe(Setup(Options(shading_correction=False))), slot), NEEDED)
            engine.store.want([want])
            found = region_labels(wait_for(lambda want=want: engine.store.get(want), 60), engine.source.exposure)
            np.testing.assert_array_equal(found, labels)
    finally:
        engine.close()
    assert len(np.unique(expected[-1])) >= 4


def test_figures_of_a_slot():
    result, measurer = made(slot=1), Measurer()
    figures = measurer.measure(result, 1.0)
    a, b = shown(result)
    flicker = Flicker()
    flicker.add(b, b)
    assert figures.values["psnr"] == pytest.approx(psnr(a, b), abs=1e-4)
    assert figures.values["flicker"] == pytest.approx(flicker.add(a, b))
    assert figures.values["disoccluded"] == pytest.approx(100 * 6 / WIDTH)
    assert figures.values["kernels"] == 1.75
    without = made(slot=1)
    del without.images[names.TRUTH]
    assert Measurer().measure(without, 1.0).values.keys() == {"disoccluded", "kernels"}


def test_flicker_needs_the_slot_before():
    first, second, third = (made(slot=slot, n=3, seed=slot) for slot in (1, 2, 3))
    flicker = Flicker()
    flicker.add(*reversed([shown(first)[1]] * 2))
    expected = [flicker.add(*shown(result)) for result in (first, second, third)]
    measurer = Measurer()
    found = [measurer.measure(result, 1.0).values["flicker"] for result in (first, second, third)]
    assert found == pytest.approx(expected)
    assert "flicker" not in Measurer().measure(second, 1.0).values


class Surveying:
    """A survey of `a` and `b`, and an engine that makes one slot at each look; its error grows with the slot."""

    def __init__(self):
        self.store, self.measured = Store(0), Measurements()
        self.survey = Survey(self.store, self.measured, Playback(count=8))
        self.a, self.b = side(), side(motion=False)
        self.made = []

    def look(self, a, b, may_run=True):
        """One frame of the interface."""
        self.measured.update()
        self.store.want(self.survey.update(a, b, 1.0, may_run))

    def make(self):
        want = self.store.next()
        if want is not None:
            self.made.append(want.key)
            slot, options = want.key.slot, want.key.recipe.setup.options
            worse = 0.02 * (1 + (7 * slot) % 16) * (2 if options.motion else 1)
            self.store.put(want, Failure("truncated") if slot == 5 else made(slot, error=worse, key=want.key))


def side(**options):
    setup = Setup(replace(Setup().options, **options))
    return Side(setup, Recipe(0, 0, setup, ""))


def surveyed():
    surveying = Surveying()
    survey, sides = surveying.survey, (surveying.a, surveying.b)
    surveying.look(*sides)
    surveying.make()
    assert not surveying.made and survey.worst() is None, "nothing is measured before it is asked for"
    survey.on = True
    end = time.perf_counter() + 20
    while survey.busy and time.perf_counter() < end:
        surveying.look(*sides)
        surveying.make()
        time.sleep(0.002)
    assert survey.progress == (16, 16)
    return surveying, survey


def test_the_survey_finds_the_worst_frames():
    surveying, survey = surveyed()
    assert len(surveying.made) == len(set(surveying.made)) == 16, "every slot once"
    xs, ys = survey.curve(survey.a)
    assert xs.tolist() == [1, 3, 7, 9, 11, 13, 15], "slot 5 could not be made"
    order = xs[np.argsort(ys)].astype(int).tolist()
    assert [survey.worst(), survey.next(), survey.next()] == order[:3]
    assert survey.place == "worst: 3 of 7"
    assert survey.worst() == order[0]
    a, b = (dict(zip(*survey.curve(side), strict=True)) for side in (survey.a, survey.b))
    apart = sorted(a, key=lambda slot: -abs(a[slot] - b[slot]))
    assert [survey.most_different(), survey.most_different()] == apart[:2]
    survey.quantity = "flicker"
    xs, ys = survey.curve(survey.a)
    assert survey.next() == int(xs[ys.argmax()]), "more flicker is worse; another quantity starts anew"
    means, count = survey.means("psnr")
    assert count == 7 and means["A"] == pytest.approx(np.mean(list(a.values())))


def test_invalid_pixels_are_seen_where_the_motion_leads():
    rng = np.random.default_rng(3)
    mask, motion = rng.integers(0, 8, (9, 14), np.uint8), rng.normal(0, 4, (7, 11, 2)).astype(np.float32)
    motion[2, 3], motion[4, 5] = np.nan, np.inf
    seen = seen_through(mask, motion)
    for y, x in np.ndindex(seen.shape):
        to = np.floor(motion[y, x] + (x + 0.5, y + 0.5))
        inside = np.isfinite(to).all() and (to >= 0).all() and to[0] < 14 and to[1] < 9
        assert seen[y, x] == (mask[int(to[1]), int(to[0])] if inside else 0)
    seen = seen_at(mask, (5, 4), lambda x, y: (2 * x + 1, 2 * y - 2))
    assert (seen[1:] == mask[1:6:2, 2:11:2]).all() and not seen[0].any(), "the row above the image is empty"


def test_the_next_invalid_pixel_is_in_another_group():
    view, contents = View("final", Display()), SimpleNamespace(result=None)
    pixels = InvalidPixels(view, contents)
    assert pixels.next(None) is None and pixels.text() == ""
    pixels.places = np.array([(4, 1), (5, 1), (3, 2), (9, 2), (0, 7)])
    assert [pixels.next(at) for at in (None, (4, 1), (9, 2), (0, 7))] == [(4, 1), (9, 2), (0, 7), (4, 1)]
    assert pixels.text() == "5 invalid pixels"
    pixels.close()


def test_means_of_both_are_over_the_slots_that_both_have():
    _, survey = surveyed()
    known = survey.figures(survey.b)
    for slot in (1, 3, 7):
        del known[slot]
    common = [9, 11, 13, 15]
    means, count = survey.means("psnr")
    assert count == len(common)
    for name, side in (("A", survey.a), ("B", survey.b)):
        values = [survey.figures(side)[slot].values["psnr"] for slot in common]
        assert means[name] == pytest.approx(np.mean(values))
    parts, count = survey.parts()
    assert count == len(common)
    shares = [survey.figures(survey.a)[slot].parts["dynamic"].pixels for slot in common]
    assert parts["A"]["dynamic"].pixels == pytest.approx(np.mean(shares))
    known.clear()
    assert survey.means("psnr")[1] == 7 and set(survey.means("psnr")[0]) == {"A"}, "nothing of B is known yet"


def test_worst_pixels_are_apart_and_in_order():
    rng = np.random.default_rng(5)
    true = rng.uniform(0.2, 0.6, (40, 60, 4)).astype(np.float16)
    shown = true.copy()
    for (x, y), error in (((50, 30), 0.4), ((52, 31), 0.3), ((5, 6), 0.2), ((30, 10), 0.1)):
        shown[y, x, :3] += np.float16(error)
    found = worst_pixels(FRAME_LAYERS["final"], shown, true, (60, 40), 1.0)
    assert [worst.pixel for worst in found] == [(50, 30), (5, 6), (30, 10)], "(52, 31) belongs to the first"
    assert [worst.rank for worst in found] == [1, 2, 3]
    expected = np.abs(to_display(shown[..., :3], 1.0) - to_display(true[..., :3], 1.0)).mean(-1)[30, 50]
    assert found[0].error == pytest.approx(expected)
    assert found[1].text.endswith(" at (5, 6): number 2 of the frame")
    spec = LayerSpec("l", "L", "stage", "label", labels=((0, "static"), (5, "mover")))
    label, other = np.zeros((2, 40, 60), np.uint8)
    other[3, 4], label[20, 30] = 5, 1
    texts = [worst.text for worst in worst_pixels(spec, label, other, (60, 40), 1.0)]
    assert texts[0] == "A 0: static, B 5: mover at (4, 3): number 1 of the frame" and "A 1, B 0: static" in texts[1]
    spec, (first, second) = LayerSpec("p", "P", "stage", "scalar", planes=2), np.zeros((2, 2, 8, 8), np.float32)
    second[1, 6, 7] = 2.0
    assert [len(worst_pixels(spec, first, second, (8, 8), 1.0, plane)) for plane in (0, 1)] == [0, 1]
    depth = np.full((20, 30), 3.0, np.float32)
    other = depth.copy()
    depth[0, 0] = other[0, 0] = np.inf
    other[7, 9], other[15, 20] = 3.5, np.nan
    found = worst_pixels(FRAME_LAYERS["rendered.depth"], depth, other, (60, 40), 1.0)
    assert [worst.pixel for worst in found] == [(41, 31), (19, 15)], "display pixels; NaN is the worst, sky is equal"


def test_the_survey_sums_up_its_regions():
    _, survey = surveyed()
    figures = [figures for figures in survey.figures(survey.a).values() if figures.parts]
    parts = survey.parts()[0]["A"]
    for name in REGIONS:
        assert parts[name].pixels == pytest.approx(np.mean([of.parts[name].pixels for of in figures]))
    assert sum(part.error for part in parts.values()) == pytest.approx(1)
    mean = np.mean([10 ** (-of.values["psnr"] / 10) for of in figures])
    assert sum(part.squared for part in parts.values()) == pytest.approx(mean, rel=1e-4)


def test_equal_settings_are_counted_once():
    _, survey = surveyed()
    survey.update(survey.a, survey.a, 1.0, True)
    assert survey.progress == (8, 8)


def test_what_is_measured_stays_known_and_waits_for_others():
    surveying, survey = surveyed()
    third = side(levels=0)
    assert survey.update(third, None, 1.0, False) == [], "not while there is something else to do"
    assert [want.key for want in survey.update(third, None, 1.0, True)] == [Key(third.recipe, k) for k in (1, 3, 5)]
    assert survey.update(surveying.a, surveying.b, 1.0, True) == [] and survey.progress == (16, 16)
    surveying.measured.forget()
    assert survey.progress == (0, 16)


def test_a_slot_on_screen_is_measured_by_every_metric_and_once(monkeypatch):
    """What the survey has measured is not measured again; a metric that fails is told and costs no other."""
    counted = Counter()
    metrics = {
        name: Metric(
            name, name, lambda shown, true, name=name: counted.update([name]) or shown[..., 0], slow=name == "slow"
        )
        for name in ("psnr", "flip", "slow")
    }
    metrics["broken"] = Metric("broken", "Broken", lambda shown, true: 1 / 0)
    monkeypatch.setattr("gffe_cl.viewer.engine.figures.METRICS", metrics)
    monkeypatch.setattr("gffe_cl.viewer.engine.figures.measurable", lambda: list(metrics.values()))
    monkeypatch.setattr("gffe_cl.viewer.engine.figures.Part.of", lambda *shares: Part(*shares, 0.0))
    measured, frame = Measurements(), made(slot=3)

    def known():
        measured.update()
        return measured.of(frame.key.recipe).get(3, Figures())

    measured.survey(frame, 1.0)
    wait_for(lambda: known().surveyed, 60)
    for _ in range(2):
        measured.measure(frame, 1.0)
    wait_for(lambda: measured.faults, 60)
    assert counted == {"psnr": 1, "flip": 1, "slow": 1} and known().parts
    assert measured.faults == ["ZeroDivisionError: division by zero"]
    measured.measure(made(slot=2, alpha=0.0), 1.0)
    measured.measure(made(slot=4), 1.0)
    wait_for(lambda: measured.update() or "slow" in measured.of(frame.key.recipe).get(4, Figures()).values, 60)
    assert 2 not in measured.of(frame.key.recipe) and counted["psnr"] == 2


def passed(k, motion, depth=4.0, begins=False):
    size = (WIDTH, HEIGHT)
    planes = np.full((HEIGHT, WIDTH), depth, np.float32), np.full((HEIGHT, WIDTH, 2), motion, np.float32)
    return Passed(k, CAMERA, replace_camera(CAMERA, 2.0), size, *planes, begins)


def replace_camera(camera, factor):
    """The same pose on a display `factor` times as large."""
    return Camera(camera.world_to_view, *(factor * value for value in camera.intrinsics))


def test_the_way_of_a_fragment():
    way = way_of(
        None, [passed(5, (2, 1)), passed(4, (3, 1)), passed(3, (0, 0), begins=True), passed(2, (9, 9))], (8, 6)
    )
    assert [(point.k, point.px) for point in way] == [(5, (16, 12)), (4, (20, 14)), (3, (26, 16))]
    assert len(way_of(None, [passed(5, (40, 0)), passed(4, (0, 0))], (8, 6))) == 1, "out of the image"
    assert len(way_of(None, [passed(5, (1, 0)), passed(4, (0, 0), depth=2.0)], (8, 6))) == 1, "hidden then"
    assert len(way_of(None, [passed(5, (np.nan, 0)), passed(4, (0, 0))], (8, 6))) == 1
    edge = passed(4, (1, 0), depth=2.0)
    edge.depth[6, 10] = 4.1
    way = way_of(None, [passed(5, (1, 0)), edge, passed(3, (0, 0))], (8, 6))
    assert way[1].px == (20, 12), "the right surface is beside the place that its motion tells"


def test_statistics_of_a_rectangle():
    result = made()
    found = statistics(result, (20, 4, 30, 12), 1.0)
    a, b = (image[4:12, 20:30] for image in shown(result))
    assert found.count == 80 and found.psnr == pytest.approx(psnr(a, b), abs=1e-4)
    assert found.filled == {"its own fragment": 0.6, "hole filling": 0.4}
    error = np.abs(a - b).mean(-1)
    assert error[found.worst[1] - 4, found.worst[0] - 20] == error.max() == pytest.approx(found.largest_error)
    assert found.motion == (3, 4) and found.lengths[-1] == 80 and found.edges[-1] == 5
    rendered = made()
    rendered.moment.alpha = 0.0
    found = statistics(rendered, (0, 0, 2, 2), 1.0)
    assert (found.psnr, found.filled, found.motion) == (None, {}, None)


def test_nothing_is_known_of_no_figures():
    assert Part.of(0.0, 0.0, 0.0).error == 0 and np.isnan(Part.of(0.0, 0.0, 0.0).psnr)
    assert Figures({}).parts == {}


def test_legends_under_saved_pictures():
    """The picture stays as it is; below it are the colors that its legends tell."""
    spec = LayerSpec("rendered.depth", "Rendered depth", "frame", "depth")
    labels = LayerSpec("a.b", "B", "a", "label", labels=((0, "none"), (1, "some")))
    motion = LayerSpec("m", "Motion", "frame", "motion", ("x", "y"))
    rng = np.random.default_rng(1)
    for width in (40, 300, 1000):
        picture = rng.integers(0, 256, (30, width, 4), np.uint8)
        assert with_legends(picture, []) is picture
        ramp = with_legends(picture, [Entry("depth", legend(spec, Display(color_map="turbo")), "turbo")])
        np.testing.assert_array_equal(ramp[:30, :width], picture)
        strip = ramp[30:, :, :3].astype(int)
        table = np.round(255 * color_table("turbo")).astype(int)
        rows = [row for row in strip if all((np.abs(row - color).sum(-1) == 0).any() for color in table[[0, 128, 255]])]
        assert rows, "the whole ramp is there"
        more = [Entry("labels", legend(labels, Display())), Entry("motion", legend(motion, Display()))]
        found = with_legends(picture, more)
        colors = {tuple(color) for color in found[30:, :, :3].reshape(-1, 3).tolist()}
        assert {tuple(round(255 * c) for c in color) for color in LABEL_COLORS[:2]} <= colors
        assert {(255, 0, 0), (128, 255, 0)} & colors, "directions of motion"
        assert len(found) > len(with_legends(picture, more[:1])) > 30
        lines = [with_legends(picture, [Entry("wide words " * count, Legend("none"))]) for count in (1, 30)]
        assert lines[1].shape[1] == lines[0].shape[1] and len(lines[1]) > len(lines[0]), "long lines are broken"


def test_a_stored_baseline_is_b(tmp_path):
    """Its figures, also by region, stand beside A's by the time of the frame; nothing is measured for it."""
    surveying, survey = surveyed()
    expected, parts = survey.means("psnr")[0], survey.parts()[0]
    survey.update(surveying.a, None, 1.0, True)
    save_json(path := tmp_path / "baseline.json", survey.document())
    survey.baseline = Baseline.load(path)
    assert survey.update(surveying.b, None, 1.0, True) == [] and survey.progress == (8, 8)
    stored, known = survey.figures(survey.b), survey.figures(surveying.a)
    assert {slot: of.values for slot, of in stored.items()} == {s: of.values for s, of in known.items() if of.values}
    assert survey.means("psnr") == ({"A": expected["B"], "B": expected["A"]}, 7)
    assert survey.parts()[0]["B"]["rest"].psnr == pytest.approx(parts["A"]["rest"].psnr)
    assert survey.most_different() is not None
    survey.forget()
    survey.update(surveying.b, None, 1.0, True)
    assert survey.b is None
    path.write_text('{"mean": {}, "frames": [{"time": 0.0501, "psnr": 30.5, "ssim": null, "counted": true}]}')
    (found,) = Baseline.load(path).by_slot(Playback(count=8)).items()
    assert found == (3, Figures({"psnr": 30.5})), "what gffe compare --json writes"
    for damaged in ("", "[]", '{"frames": [{"time": "0"}]}', '{"frames": [{"time": 0, "psnr": "x"}]}'):
        path.write_text(damaged)
        with pytest.raises(GffeError, match=r"no stored figures \(expected those of the viewer or of gffe compare\)"):
            Baseline.load(path)
