"""Finding what is wrong: figures of slots, regions of errors, the survey, the way of a fragment, the worst pixel."""

import time
from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from viewer_session import wait_for

from gffe_cl import Options
from gffe_cl.captures.scenes import load_scene
from gffe_cl.captures.scenes.renderer import render_sequence
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.inspection import names
from gffe_cl.engine.inspection.explain.motion_trail import Passed, way_of
from gffe_cl.engine.opencl.device import open_device
from gffe_cl.lab.metrics import REGIONS as TABLE
from gffe_cl.lab.metrics import Flicker, Metric, psnr, to_display
from gffe_cl.lab.table.footage import find_labels
from gffe_cl.viewer.engine.figures import (
    NEEDED_BY_REGION,
    REGIONS,
    Figures,
    Measurements,
    Measurer,
    region_masks,
)
from gffe_cl.viewer.engine.jobs import Jobs
from gffe_cl.viewer.engine.messages import Failure, Frame, Key, Recipe, Setup
from gffe_cl.viewer.engine.store import Store, Want
from gffe_cl.viewer.state.playback import Playback
from gffe_cl.viewer.state.survey import Survey

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
        names.FINAL: final,
        names.TRUTH: truth,
        names.DEPTH: depth,
        names.DYNAMIC: dynamic,
        names.DISOCCLUDED: holes,
    }
    # the rendered frame saw three columns less at the right
    rendered = Camera(np.eye(4), 20.0, 20.0, WIDTH / 2 - 3 + 6, HEIGHT / 2)
    moment = SimpleNamespace(alpha=alpha, camera=CAMERA, render_camera=rendered)
    return Frame(
        key or Key(Recipe(0, Setup(n=n), ""), slot),
        frozenset(images),
        moment,
        images,
        {},
        {"warp": {"splat": 1.5}, "holes": {"fill": 0.25}},
        0.0,
        0.0,
        render_size=(WIDTH, HEIGHT),
    )


def shown(result):
    return [to_display(result.images[name][..., :3], 1.0) for name in (names.FINAL, names.TRUTH)]


def test_regions_are_those_of_the_table(tmp_path):
    """... of `gffe eval` where it finds them by the pipeline: its two kinds of disocclusions are one here."""
    from gffe_cl.lab.table.footage import FolderSubject, open_subject
    from gffe_cl.viewer.engine.engine import Engine
    from gffe_cl.viewer.engine.sources.opening import ScenePlan, make_source

    device = open_device(profiling=True)
    render_sequence(load_scene("corridor"), tmp_path, device, 96, 54, 5, 30.0, ground_truth=True, samples=1)
    joined = {"static disocclusion": "disoccluded", "dynamic disocclusion": "disoccluded"}
    one = [joined.get(name, name) for name in TABLE]
    footage = open_subject(FolderSubject(str(tmp_path), 1), device)
    slots = [2 * round(moment.time * 30 - 0.5) + 1 for shot in footage.shots() for moment in shot.moments]
    expected = [np.array(one)[labels] for labels in find_labels(footage, device)]
    assert slots and len(slots) == len(expected)
    engine = Engine(lambda: device)
    engine.start()
    engine.open_source(lambda opened: make_source(str(tmp_path), None, ScenePlan(1, 1, 0), opened))
    try:
        wait_for(lambda: engine.source, 60)
        for slot, labels in zip(slots, expected, strict=True):
            want = Want(Key(engine.recipe(Setup(Options(shading_correction=False))), slot), NEEDED_BY_REGION)
            engine.store.want([want])
            found = region_masks(wait_for(lambda want=want: engine.store.get(want), 60), engine.source.exposure)
            for name in REGIONS:
                np.testing.assert_array_equal(found[name], labels == name)
    finally:
        engine.close()
    assert len(np.unique(expected[-1])) >= 4


def test_figures_of_slots():
    results, flicker, measurer = [made(slot=slot, n=3, seed=slot) for slot in (1, 2, 3)], Flicker(), Measurer()
    flicker.add(*[shown(results[0])[1]] * 2)
    for result in results:
        values, (a, b) = measurer.measure(result, 1.0).values, shown(result)
        assert values["psnr"] == pytest.approx(psnr(a, b), abs=1e-4)
        assert values["flicker"] == pytest.approx(flicker.add(a, b))
        assert values["disoccluded"] == pytest.approx(100 * 6 / WIDTH) and values["kernels"] == 1.75
    assert "flicker" not in Measurer().measure(results[1], 1.0).values, "it needs the slot before"
    del results[0].images[names.TRUTH]
    assert Measurer().measure(results[0], 1.0).values.keys() == {"disoccluded", "kernels"}


class Surveying:
    """A survey of `a` and `b`, and an engine that makes one slot at each look; its error grows with the slot."""

    def __init__(self):
        self.store, self.measured = Store(0), Measurements(Jobs("test"))
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
    return Recipe(0, Setup(replace(Setup().options, **options)), "")


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
    assert count == 7 and means["A"][0] == pytest.approx(np.mean(list(a.values())))


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
        assert means[name] == pytest.approx((np.mean(values), np.quantile(values, 0.05))), "few are worse"
    known.clear()
    assert survey.means("psnr")[1] == 7 and set(survey.means("psnr")[0]) == {"A"}, "nothing of B is known yet"


def test_what_is_measured_stays_known_and_waits_for_others():
    surveying, survey = surveyed()
    third = side(levels=0)
    assert survey.update(third, None, 1.0, False) == [], "not while there is something else to do"
    assert [want.key for want in survey.update(third, None, 1.0, True)] == [Key(third, k) for k in (1, 3, 5)]
    assert survey.update(surveying.a, surveying.b, 1.0, True) == [] and survey.progress == (16, 16)
    surveying.measured.forget()
    assert survey.progress == (0, 16)


def test_a_slot_on_screen_is_measured_by_every_metric_and_once(monkeypatch):
    """What the survey has measured is not measured again; a metric that fails is told and costs no other."""
    counted = Counter()
    metrics = {
        name: Metric(
            name, name, map=lambda shown, true, name=name: counted.update([name]) or shown[..., 0], slow=name == "slow"
        )
        for name in ("psnr", "flip", "slow")
    }
    metrics["broken"] = Metric("broken", "Broken", map=lambda shown, true: 1 / 0)
    monkeypatch.setattr("gffe_cl.viewer.engine.figures.METRICS", metrics)
    monkeypatch.setattr("gffe_cl.viewer.engine.figures.measurable", lambda: list(metrics.values()))
    measured, frame = Measurements(Jobs("test")), made(slot=3)

    def known():
        measured.update()
        return measured.of(frame.key.recipe).get(3, Figures())

    measured.survey(frame, 1.0)
    wait_for(lambda: known().surveyed, 60)
    for _ in range(2):
        measured.measure(frame, 1.0)
    wait_for(lambda: measured.faults, 60)
    assert counted == {"psnr": 1, "flip": 1, "slow": 1}
    assert measured.faults == ["Broken cannot run here: division by zero"]
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


def test_figures_of_the_input():
    """Depth against motion is a median, which movers do not rule; means leave out what is no number."""
    residual = np.full((HEIGHT, WIDTH, 2), 0.1, np.float32)
    residual[: HEIGHT // 3] = 50.0
    color, depth = np.full((HEIGHT, WIDTH, 4), 0.25, np.float16), np.zeros((HEIGHT, WIDTH), np.float32)
    color[0, 0, 1], depth[:], depth[2], color[..., 3] = np.nan, np.arange(WIDTH), np.inf, 1.0
    images = {names.RESIDUAL: residual, names.RENDERED_COLOR: color, names.RENDERED_DEPTH: depth}
    key, moment = Key(Recipe(0, Setup(), ""), 3), SimpleNamespace(alpha=0.5)
    found = Measurer().measure(Frame(key, frozenset(images), moment, images, {}, {}, 0.0, 0.0), 1.0).values
    expected = {"residual": 0.1 * 2**0.5, "mean color": 0.25, "mean depth": (WIDTH - 1) / 2}
    assert {name: found[name] for name in expected} == pytest.approx(expected)
