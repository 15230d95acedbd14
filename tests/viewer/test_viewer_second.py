"""B as other settings in the viewer's model, without a window: A and B are of one slot, and B is what was kept."""

import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import tiny_sequence

from gffe_cl.captures.offline.run import run_sequence
from gffe_cl.captures.offline.source import Recorded
from gffe_cl.captures.sequence import open_sequence
from gffe_cl.engine.inspection import names
from gffe_cl.engine.inspection.buffers import Moment
from gffe_cl.engine.inspection.layers import FRAME_LAYERS, LayerSpec
from gffe_cl.engine.opencl.device import open_device
from gffe_cl.engine.opencl.program import kernel_folder
from gffe_cl.viewer.engine.engine import Engine
from gffe_cl.viewer.engine.figures import Figures
from gffe_cl.viewer.engine.messages import Frame, Key, Recipe, Setup
from gffe_cl.viewer.picture.current_frame import VECTORS, followed
from gffe_cl.viewer.picture.displays import FrameInfo
from gffe_cl.viewer.state.comparing import NEIGHBORS
from gffe_cl.viewer.state.presets import command_line
from gffe_cl.viewer.state.studies import Difference, Differing, difference, modules_of
from gffe_cl.viewer.window.studies import show_difference


def kept_and_changed(session):
    """B without motion estimation, A with it, compared by wipe."""
    model = session.model
    model.set("motion", False)
    session.settle()
    alone = model.contents.image("final").copy()
    model.sides.keep()
    model.set("motion", True)
    model.comparison.set("split")
    session.settle()
    return alone


def test_b_is_what_was_kept_and_a_goes_on(session):
    model = session.model
    model.playback.seek(3)
    session.settle()
    alone = kept_and_changed(session)
    np.testing.assert_array_equal(session.canvas.layers["B:final"], alone)
    assert model.view.b == "B:final" and not model.contents.second.setup.options.motion
    model.set("levels", 0)
    session.settle()
    np.testing.assert_array_equal(session.canvas.layers["B:final"], alone)
    model.show_layer("frame.depth")
    session.settle()
    assert {"frame.depth", "B:frame.depth"} <= session.canvas.layers.keys() and "B:final" not in session.canvas.layers
    model.comparison.set("off")
    session.settle()
    assert not any(name.startswith("B:") for name in session.canvas.layers) and model.contents.second is None


def test_a_and_b_are_of_one_slot_while_it_plays(session, monkeypatch):
    model, slots = session.model, []
    kept_and_changed(session)
    take = model.contents.take

    def taken(result, second=None):
        slots.append((result.slot, second and second.slot))
        take(result, second)

    monkeypatch.setattr(model.contents, "take", taken)
    model.playback.mode = "every frame"
    model.playback.play()
    session.until(lambda: len(slots) > 20)
    assert all(a == b for a, b in slots) and len({a for a, _ in slots}) > 3


def test_a_is_shown_alone_where_b_cannot_be_made(session, monkeypatch):
    model = session.model
    make = Engine._made

    def fails(engine, want):
        if not want.key.recipe.setup.options.motion:
            raise RuntimeError("no memory for B")
        return make(engine, want)

    kept_and_changed(session)
    monkeypatch.setattr(Engine, "_made", fails)
    model.playback.seek(5)
    session.settle()
    assert "no memory for B" in model.showing.fault_of_b and model.contents.second is None
    assert any("B:" in message.text and message.error for message in model.messages)
    assert model.contents.result.setup.options.motion
    for _ in range(3):
        model.playback.step()
        session.settle()
    monkeypatch.undo()
    model.playback.step(-1)
    session.settle()
    assert model.contents.second is not None and not model.showing.fault_of_b


def test_b_has_the_kernels_of_its_time(session, tmp_path, monkeypatch):
    folder = tmp_path / "kernels"
    shutil.copytree(kernel_folder(), folder)
    monkeypatch.setenv("GFFE_KERNELS", str(folder))
    model = session.model
    model.playback.seek(3)
    session.settle()
    model.sides.keep()
    model.comparison.set("difference")
    session.settle()
    assert model.comparison.builds == ("", ""), "both are the same"
    before, builds = model.contents.image("final").copy(), model.engine.builds
    path = folder / "holes.cl"
    path.write_text(path.read_text().replace("store_color(mean.xyz,", "store_color(9.0f + mean.xyz,"))
    model.engine.reload_kernels()
    session.until(lambda: model.engine.builds > builds or model.engine.build_error)
    assert model.engine.build_error is None, model.engine.build_error
    session.settle()
    np.testing.assert_array_equal(model.contents.image("B:final"), before)
    a, b = (made.key.recipe.kernels[:6] for made in (model.contents.result, model.contents.second))
    assert a != b and model.comparison.builds == (f"kernels {a}   ", f"kernels {b}   ")
    assert (model.contents.image("final") != before).any()


def test_a_goes_on_with_what_was_kept(session):
    model = session.model
    kept_and_changed(session)
    model.sides.take_second()
    assert model.parameters.value("motion") is False
    saved = model.comparison.preferences()
    assert (saved["compare"], saved["b"]) == ("off", None)
    assert "--no-motion" in command_line(model.setup, model.source, model.document.plan.seed)


# ---- studies: of the shown frame ---------------------------------------------------------------------------------


def studied(session, study):
    """Look at a study until it is made; returns it."""
    session.model.update(0.0, session.canvas)

    def looked():
        study.look()
        return study.parts and not study.busy

    study.look()
    session.frame()
    session.until(looked)
    return study


def test_the_first_layer_that_differs_is_of_the_stage_that_was_changed(session):
    model = session.model
    model.playback.seek(3)
    model.sides.keep()
    session.settle()
    assert not any(one.differs for one in studied(session, model.studies.differing).all), "equal settings"
    assert not model.studies.differing.stale
    assert model.studies.differing.text == f"all {len(model.studies.differing.all)} layers are equal"
    assert len(model.studies.differing.all) > 30
    model.set("static_threshold", 20.0)
    session.settle()
    found = studied(session, model.studies.differing)
    assert next(one for one in found.all if one.differs).spec.name == "history.dynamic_mask"
    final = next(one for one in found.all if one.spec.name == "final")
    images = [model.contents.image("final"), None]
    model.sides.take_second()
    session.settle()
    images[1] = model.contents.image("final")
    differs = (images[0] != images[1]).any(-1)
    assert (final.pixels, final.of) == (differs.sum(), differs.size) and final.pixels
    assert final.largest == np.abs(np.subtract(*images, dtype=np.float64)).max()


def test_differences_from_a_frame_before(session):
    model = session.model
    model.playback.seek(4)
    model.comparison.with_neighbor(NEIGHBORS[0])
    session.settle()
    found = {one.spec.name: one for one in studied(session, model.studies.differing).all}
    color = found["rendered.color"]
    assert "shading_trend.trend" in found and "shading_trend.trends" not in found, "these are of another, new frame"
    model.show_layer("rendered.color")
    session.settle()
    differs = (model.contents.result.images["rendered.color"] != model.contents.second.images["rendered.color"]).any(-1)
    assert model.contents.second.slot == 2 and color.pixels == differs.sum() > 0


@pytest.mark.parametrize(("slots", "stale"), [((4, 2), [names.RENDERED_COLOR]), ((5, 4), [])])
def test_equal_buffers_of_two_rendered_frames_are_stale(slots, stale):
    study, side = Differing(), Recipe(1, Setup(n=1), "")
    specs = [LayerSpec(name, "", "frame", "") for name in (names.RENDERED_COLOR, names.RENDERED_DEPTH, names.FINAL)]
    study.wanted(SimpleNamespace(slot=slots[0], slot_of_b=slots[1], a=side, b=side, layers=()))
    study.found = {"input": [Difference(spec, k % 2, 8, 0.0) for k, spec in enumerate(specs)]}
    assert [one.spec.name for one in study.stale] == stale


def test_an_ablation_tells_what_a_module_gains(session):
    model = session.model
    model.playback.seek(3)
    session.settle()
    gains = studied(session, model.studies.ablation).found
    assert gains.keys() == set(modules_of(model.setup)) > {"hole_filling", "motion"}
    scores = []
    for filling in ("far-side", "none"):
        model.set("hole_filling", filling)
        model.choices.measuring = True
        session.settle()
        known = model.measured.of(model.recipe)
        session.until(lambda known=known: "psnr" in known.get(3, Figures()).values)
        scores.append(known[3].values["psnr"])
    assert gains["hole_filling"]["whole"] == pytest.approx(scores[0] - scores[1], abs=1e-4)


def test_a_row_over_time_is_that_row_of_every_frame(session):
    model = session.model
    model.playback.seek(3)
    model.pointing.pick((3, 4))
    session.settle()
    for row in (4, 6):
        model.pointing.pick((3, row))  # while it is on, and has the row before
        rows, slots = studied(session, model.studies.over_time).picture(model.studies.here)
        assert slots == range(6) and rows.shape == (6, tiny_sequence.W, 4)
        assert list(model.studies.over_time.found) == [3, 4, 5, 0, 1, 2], "as a pipeline makes them"
        np.testing.assert_array_equal(rows[3], model.contents.image("final")[row])
    model.show_layer("frame.depth")
    session.settle()
    found = studied(session, model.studies.over_time).found
    assert [found[slot] is None for slot in range(6)] == [True, False] * 3, "rendered frames have no such layer"
    model.store.forget(lambda key: True)  # as where the sequence has grown
    session.frame()
    assert not model.studies.over_time.found
    model.studies.over_time.look()
    session.frame()
    for job in (jobs := list(model.studies._jobs.values())):
        job.cancel()
    assert studied(session, model.studies.over_time).found.keys() == set(range(6)), jobs


def test_b_is_an_output_of_gffe_run_with_its_stage_dump(session, tmp_path):
    model = session.model
    model.set("motion", False)
    session.settle()
    source = open_sequence(tmp_path / "first")
    device, options = open_device(), model.setup.options
    run_sequence(Recorded(source, device), tmp_path / "out", device, options, [0.5], dump_stages=True)
    model.sides.take_b_from(str(tmp_path / "out"))
    model.playback.seek(3)
    session.settle()
    assert model.contents.second is not None, model.messages
    np.testing.assert_array_equal(session.canvas.layers["B:final"], model.contents.image("final"))
    differing = studied(session, model.studies.differing)
    assert not [one.spec.name for one in differing.all if one.pixels]
    assert sum(not one.differs for one in differing.all) > 30, "those of the dump"
    model.set("motion", True)
    session.settle()
    assert (session.canvas.layers["B:final"] != model.contents.image("final")).any()
    found = studied(session, model.studies.differing)
    assert next(one for one in found.all if one.differs).spec.group == "history"
    assert " not in B" in model.studies.differing.text
    lacking = next(one for one in model.studies.differing.all if not one.common)
    assert not lacking.differs and lacking.remark == "not in B"
    assert "not stored with B" in model.contents.why_absent(names.of_second(lacking.spec.name))
    run_sequence(Recorded(source, device), tmp_path / "again", device, replace(options, motion=True), [0.5])
    shutil.rmtree(tmp_path / "out")
    (tmp_path / "again").rename(tmp_path / "out")
    session.settle()
    np.testing.assert_array_equal(session.canvas.layers["B:final"], model.contents.image("final"))
    model.sides.take_b_from(str(tmp_path / "nothing"))
    assert "nothing: no such file or folder" in model.messages[-1].text and model.messages[-1].error
    shutil.rmtree(tmp_path / "out")
    session.settle()
    assert "out" in model.showing.fault_of_b and model.contents.second is None


def test_b_is_other_kernels_in_a_folder(session, tmp_path):
    model = session.model
    model.playback.seek(3)
    shutil.copytree(kernel_folder(), tmp_path / "edited")
    path = tmp_path / "edited" / "holes.cl"
    (tmp_path / "edited" / "warp.cl").write_text((kernel_folder() / "warp.cl").read_text() + "\n// another build\n")
    model.sides.take_b_from(str(path.parent))
    session.settle()
    assert model.comparison.by_settings and model.contents.second.key.recipe.kernels != model.recipe.kernels
    np.testing.assert_array_equal(session.canvas.layers["B:final"], model.contents.image("final"))
    path.unlink()
    model.sides.take_b_from(str(path.parent))
    assert model.messages[-1].error and "holes.cl" in model.messages[-1].text


def test_b_is_another_sequence_with_its_rendered_frames(session, tmp_path):
    model = session.model
    model.sides.take_b_from(str(tmp_path / "first"))
    model.playback.seek(2)
    session.settle()
    differing = studied(session, model.studies.differing)
    found = {one.spec.name: one for one in differing.all}
    rendered = [found[name] for name in (names.RENDERED_COLOR, names.RENDERED_DEPTH, names.RENDERED_MOTION)]
    assert [(one.common, one.pixels) for one in rendered] == [(True, 0)] * 3


def test_a_layer_differs_in_a_plane_that_is_named():
    spec = LayerSpec("history.history", "History", "history", "world", ("x", "y", "z", "known"), planes=3)
    a, b = (np.zeros((3, 4, 8, 4), np.float32) for _ in "AB")
    b[1, 2, 5, 0], b[2, 0, 1, 2], b[2, 3, 6, 1] = 1.0, np.nan, -4.0
    info, frames = FrameInfo((16, 8)), [SimpleNamespace(images={spec.name: image}) for image in (a, b)]
    found = difference(spec, *frames, info)
    assert (found.pixels, found.largest, found.label) == (3, 4.0, "History, planes 2, 3")
    b[2, 0, 1, 2] = 0.0
    found = difference(spec, *frames, info)
    assert found.planes == (2, 1) and found.worst == (13, 7)
    looks, shown, picked = [], [], []
    model = SimpleNamespace(
        looks=SimpleNamespace(choose_plane=lambda *given: looks.append(given)),
        show_layer=shown.append,
        comparison=SimpleNamespace(neighbor="", with_settings=lambda: None, set=shown.append),
        pointing=SimpleNamespace(pick=picked.append),
    )
    show_difference(model, found)
    assert shown == [spec.name, "difference"] and looks == [(spec.name, 2)] and picked == [(13, 7)]
    frames[1].images.clear()
    only = difference(spec, *frames, info)
    assert only.remark == "not in B" and not only.differs


def test_sky_against_a_surface_is_counted_but_not_the_largest():
    spec = LayerSpec("depth", "Depth", "frame", "depth", ("z",))
    a, b = np.full((2, 4, 8), np.inf, np.float32)
    b[0, 0], a[3, 7], b[3, 7] = 5.0, 2.0, 2.5
    info, frames = FrameInfo((8, 4)), [SimpleNamespace(images={spec.name: image}) for image in (a, b)]
    found = difference(spec, *frames, info)
    assert (found.pixels, found.largest, found.worst) == (2, 0.5, (7, 3))
    a[3, 7] = 2.5
    found = difference(spec, *frames, info)
    assert found.pixels == 1 and np.isnan(found.largest) and found.worst == (0, 0)


STEP = np.array([4, -2], np.float32)  # pixels that everything moves in a frame
PAIRS = {
    "before": ((3, 0), (2, 0)),
    "after": ((2, 0), (3, 0)),
    "source": ((3, 0.5), (3, 0)),
    "new before": ((3, 0.5), (2, 0.5)),
    "after a new one": ((2, 0.5), (3, 0)),
}


def passing(k, alpha, previous=True):
    """A frame, as the engine gives it, of what passes by."""
    wide = np.random.default_rng(3).uniform(0, 1, (80, 80, 4)).astype(np.float16)
    x, y = 36 - ((k + alpha) * STEP).astype(int)
    images = {"final": wide[y : y + 24, x : x + 32]}
    images |= {name: np.tile(-by * STEP, (24, 32, 1)) for name, by in (("rendered.motion", 1), ("frame.motion", alpha))}
    camera = tiny_sequence.camera()
    moment = Moment(k, alpha, k + alpha, camera, camera, camera, camera if previous else None)
    key, specs = Key(Recipe(0, Setup(), ""), 0), dict.fromkeys(images, FRAME_LAYERS["final"])
    return Frame(key, frozenset(images), moment, images, specs, {}, 0.0, 0.0, render_size=(32, 24))


@pytest.mark.parametrize("pair", PAIRS)
def test_a_neighbor_is_followed_along_motion_vectors(pair):
    """What both frames see is equal, and the rest is unknown; vectors of a reset lead nowhere."""
    (k, alpha), other = PAIRS[pair]
    first = passing(k, alpha)
    found = followed(first, passing(*other), (32, 24))
    known = np.isfinite(found.images["final"]).all(-1)
    assert 0.5 < known.mean() < 1 and found.moment is first.moment
    np.testing.assert_allclose(found.images["final"][known], first.images["final"][known], atol=1e-3)
    lost = followed(passing(k, alpha, False), passing(*other, False), (32, 24)).images["final"]
    assert np.isnan(lost).all() == (k != other[0])


def test_a_neighbor_is_b(session):
    model = session.model
    model.playback.seek(3)
    model.comparison.with_neighbor("new frame before")
    session.settle()
    assert (model.contents.second.slot, model.view.compare, model.view.b) == (1, "difference", "B:final")
    model.comparison.follows = True
    session.settle()
    assert model.contents.second.images.keys() == model.contents.result.images.keys() == {"final", *VECTORS}
    model.playback.seek(5)
    model.comparison.with_neighbor("rendered frame after")
    session.settle()
    assert model.contents.second is None and "no rendered frame after" in model.comparison.scale_text()
    assert model.comparison.preferences()["b"] is None


def test_an_infinite_difference_is_not_the_largest(session):
    """Of depth, of the sky and a surface."""
    model = session.model
    model.playback.seek(3)
    model.comparison.with_neighbor("new frame before")
    model.show_layer("frame.depth")
    session.settle()
    images = model.contents.result.images
    images["frame.depth"] = depth = images["frame.depth"].copy()
    depth[2, 3] = np.inf
    model.go_to_largest()
    assert np.isfinite(float(model.messages[-1].text.split()[1]))
