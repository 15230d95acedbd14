"""The viewer's model with its engine, without a window: what is asked for, and that nothing outdated is shown."""

import json
import os
import shutil
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyopencl as cl
import pytest
import tiny_sequence
from doctor_clips import COUNT, clip
from fault_injection import broken
from scn_models import constant_model
from viewer_session import Session, wait_for

from gffe_cl import OPTIONS, Options
from gffe_cl.captures.sequence import FrameEntry, SequenceWriter, named_channels
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.inference import network
from gffe_cl.engine.opencl.program import kernel_folder
from gffe_cl.lab.metrics import to_display
from gffe_cl.viewer.engine.slot_maker import Seeker
from gffe_cl.viewer.state.captions import value_text
from gffe_cl.viewer.state.document import ALONE, INVALID, REPEATED, UNEVEN, Doctor
from gffe_cl.viewer.state.parameters import ALL, ALWAYS, Parameters, by_hand, parsed
from gffe_cl.viewer.state.playback import Playback
from gffe_cl.viewer.state.saving import LayersWork
from gffe_cl.viewer.window import status
from gffe_cl.viewer.window.inspector import rows_of


def test_story_is_told_and_follows_the_slot_although_the_mouse_moves_on(session):
    model, pointing = session.model, session.model.pointing
    with session.engine_waiting():
        pointing.pick((3, 4))
        pointing.hover((7.5, 5.5))
    session.until(lambda: pointing.story is not None)
    assert pointing.story.pixel == (3, 4)
    session.until(lambda: pointing.inspection is not None and pointing.inspection.pixel == (7, 5))
    session.settle()
    before, before_values, taken = pointing.story, pointing.pinned, model.contents.changes
    assert model.values == (before_values, False)
    with session.values_waiting():
        model.playback.seek(3)
        session.until(lambda: model.contents.changes > taken)
        assert not model.settled and pointing.story_is_due, "it is still that of the slot before"
        assert model.values == (before_values, True)
    session.settle()
    assert pointing.story is not before and pointing.story.pixel == (3, 4)


def test_values_under_the_pointer_are_those_of_the_picture(session):
    """In a generated frame layers on the rendered image have two: the one that is shown here, and the one where the
    pixel's content comes from. Inspector and status bar give both, and say which is which."""
    model = session.model
    model.playback.seek(3)
    model.show_layer("rendered.color")
    session.settle()
    image, spec = model.contents.image("rendered.color"), model.contents.spec("rendered.color")
    for x, y in ((x, y) for y in range(tiny_sequence.H) for x in range(tiny_sequence.W)):
        seen = inspected(session, x, y)
        origin = seen.origin.get("rendered.color")
        if origin is not None and origin.tobytes() != image[y, x].tobytes():
            break
    right, down = seen.source
    assert seen.values["rendered.color"].tobytes() == image[y, x].tobytes()
    assert origin.tobytes() == image[int(down), int(right)].tobytes()
    here, there = (value_text(spec, values) for values in (image[y, x], origin))
    assert status.parts(model)[0] == f"({x}, {y})   {here}   from ({right:.1f}, {down:.1f})   {there}"
    rows = [(row.label, row.where, row.value) for row in rows_of(model.contents.layers, seen)]
    assert [row[1:] for row in rows if row[0] == "Rendered color"] == [("here", here), ("from", there)]
    assert [row[1] for row in rows if row[0] == "Final"] == [""]


def inspected(session, x, y):
    """The values at a pixel."""
    pointing = session.model.pointing
    pointing.hover((x + 0.5, y + 0.5))
    session.until(
        lambda: pointing.inspection is not None and pointing.inspection.pixel == (x, y) and pointing.shows_values
    )
    return pointing.inspection


def test_a_picture_of_another_slot_or_setting_is_not_current(session):
    """While the next one is made, captions name what is still shown, and its values are not given for the next."""
    model = session.model
    model.playback.seek(3)
    session.settle()
    assert model.current and model.captions.frame == "generated: frame 1 + 1/2"
    inspected(session, 3, 4)
    assert model.pointing.shows_values
    with session.values_waiting():
        with session.engine_waiting():
            model.playback.seek(1)
            session.model.update(time.perf_counter(), session.canvas)
            assert not model.current and model.captions.frame == "generated: frame 1 + 1/2"
        session.until(lambda: model.slot == 1)
        assert model.current and not model.pointing.shows_values and model.values[1], "they are still those of slot 3"
    session.until(lambda: model.pointing.shows_values)
    model.playback.n = 3
    assert model.captions.frame == "generated: frame 0 + 1/2", "which was made with n = 1"
    session.settle()
    inspected(session, 3, 4)
    with session.values_waiting():
        model.set("hole_filling", "none")
        session.until(lambda: model.contents.result.setup == model.setup)
        assert model.current and not model.pointing.shows_values


def test_the_folder_of_what_is_saved_is_chosen(session, tmp_path):
    model = session.model
    model.saving.choose_folder(str(tmp_path / "nothing"))
    assert model.messages[-1].error and "no such folder" in model.messages[-1].text
    (tmp_path / "chosen").mkdir()
    model.saving.choose_folder(str(tmp_path / "chosen"))
    model.saving.start(LayersWork)
    session.until(lambda: model.saving.work is None)
    assert model.saving.saved == next((tmp_path / "chosen").iterdir())


def test_states_are_told_as_long_as_they_last(tmp_path, monkeypatch):
    """A failed reload of kernels or of the sequence, and frames on disk that are others now."""
    shutil.copytree(kernel_folder(), tmp_path / "kernels")
    monkeypatch.setenv("GFFE_KERNELS", str(tmp_path / "kernels"))
    folder = tiny_sequence.write(tmp_path / "first")
    session = Session(folder)
    model, warp, description = session.model, tmp_path / "kernels" / "warp.cl", folder / "sequence.json"
    try:
        assert model.states == []
        good, text = warp.read_text(), description.read_text()
        warp.write_text(f"{good}\nnonsense")
        session.until(lambda: model.states)
        assert model.states == [f"kernels on disk do not build: build {model.recipe.kernels[:6]} is shown"]
        model.playback.seek(3)
        session.settle()
        assert len(model.states) == 1, "another frame does not mend them"
        warp.write_text(good)
        session.until(lambda: not model.states)
        description.write_text("{")
        model.reload()
        session.until(lambda: model.states)
        model.playback.seek(1)
        session.settle()
        assert "reading it again failed: " in model.states[0] and "sequence.json" in model.states[0]
        description.write_text(text)
        model.reload()
        session.until(lambda: not model.states)
        os.utime(folder / "frame_1.exr", ns=(1, 1))
        session.until(lambda: model.states)
        assert model.states == ["files on disk have changed: Ctrl+R reads them again"]
        model.reload()
        session.until(lambda: not model.states)
    finally:
        model.close()


def test_what_is_compared_with_itself_is_named(session):
    model, comparison = session.model, session.model.comparison
    comparison.toggle_truth()
    comparison.subtract("mean")
    assert (model.view.a, model.view.b) == ("truth", "final") and not comparison.nothing
    comparison.with_layer("truth")
    assert comparison.nothing and comparison.shown().compare == "off", "no black map as of a perfect result"
    assert "same layer" in comparison.scale_text()
    comparison.set("flip error")
    assert model.view.b == "final" and not comparison.nothing
    model.sides.keep()
    comparison.subtract("absolute")
    session.settle()
    assert "same settings" in comparison.scale_text() and comparison.shown().compare == "off"
    model.parameters.switch("motion", False)
    session.settle()
    assert comparison.scale_text() == "|A − B| × 4" and comparison.shown().compare == "difference"


def test_cuts_found_in_computing_ahead_are_marked(session, monkeypatch):
    submit = Seeker._submit

    def cutting(self, m, last):
        submit(self, m, last)
        self.cuts |= {m} & {2}

    monkeypatch.setattr(Seeker, "_submit", cutting)
    model = session.model
    assert model.slot == 0 and not model.contents.resets
    model.set("levels", 2)  # so that everything is computed anew
    session.settle()
    session.until(lambda: 5 in model.document.ahead.cached)
    session.frame()
    assert model.slot == 0 and model.contents.resets == {2: "a cut was found here"}


def test_pictures_of_another_sequence_are_not_on_the_canvas(session, tmp_path):
    model, source = session.model, session.model.source
    taken, makers = model.contents.changes, list(model.engine._makers)
    model.open(str(tiny_sequence.write(tmp_path / "second")))
    session.until(lambda: model.engine.source is not source)
    with session.engine_waiting():
        session.frame()
        assert model.source is not source and model.contents.result is None and session.canvas.layers == {}
        assert model.contents.changes > taken  # what was drawn is drawn anew
        assert makers and all(maker._seeker.pipeline is None for maker in makers), "its memory is free"
    session.settle()
    assert set(session.canvas.layers) == {"final"}


def test_reload_opens_what_is_shown(session, tmp_path):
    """... not what was asked for in between and is not there yet, or never will be."""
    model, source = session.model, session.model.source
    model.open(str(tiny_sequence.write(tmp_path / "second")))
    session.until(lambda: model.engine.source is not source)
    model.open(str(tmp_path / "missing"))
    session.until(lambda: any("missing" in message.text for message in model.messages))
    assert model.source.name == "second" and model.settings.recent[0] == str(tmp_path / "second")
    model.set("levels", 0)
    session.settle()
    model.reload()
    opened = model.source
    session.until(lambda: model.source is not opened)
    assert model.source.name == "second"


def test_holding_b_has_b_read_back(session):
    model = session.model
    model.comparison.toggle("split")
    model.comparison.toggle("split")
    session.settle()
    assert model.view.compare == "off" and model.view.b == "truth" and set(session.canvas.layers) == {"final"}
    model.playback.seek(3)
    model.comparison.flip(True)
    session.settle()
    assert model.comparison.shown().a == "truth" and "truth" in session.canvas.layers
    model.comparison.flip(False)
    assert model.comparison.shown().a == "final"


def computed(session):
    """Whether shading correction is in what is shown."""
    session.settle()
    return "correction.color" in {spec.name for spec in session.model.contents.layers}


def test_shading_correction_runs_where_there_is_a_model(session, tmp_path, monkeypatch):
    """Weights that come and go while the viewer runs are taken up."""
    model = session.model
    model.playback.seek(3)
    assert not computed(session) and "no trained weights" in model.parameters.why_not("shading_correction")
    weights = Path(constant_model(tmp_path / "m.onnx"))
    monkeypatch.setattr(network, "default_model", lambda: weights)
    assert computed(session) and model.parameters.why_not("shading_correction") is None
    model.show_layer("gae")
    session.settle()
    assert set(session.canvas.layers) == {"gae"}
    model.parameters.switch("shading_correction", False)
    assert not computed(session) and model.parameters.options.shading_inputs
    model.parameters.switch("shading_correction", True)
    model.set("focus_mask", False)
    assert computed(session)
    monkeypatch.setattr(network, "default_model", lambda: None)
    assert not computed(session) and not model.messages


def test_a_model_that_cannot_be_loaded_switches_shading_correction_off(session, tmp_path):
    """It says so once, the viewer lives on, and it is tried again when it is asked for again."""
    model, path = session.model, tmp_path / "m.onnx"
    path.write_bytes(b"junk")
    model.playback.seek(3)
    model.set("scn_model", str(path))
    session.until(lambda: model.parameters.network_fault)
    assert not computed(session) and not model.parameters.is_on("shading_correction") and model.document.failure is None
    model.playback.seek(1)
    assert not computed(session)
    (told,) = model.messages
    assert told.error and told.text.startswith(f"shading correction is off: {path}: ") and "\n" not in told.text
    model.parameters.switch("shading_correction", True)
    session.until(lambda: len(model.messages) == 2)
    constant_model(path)
    model.parameters.switch("shading_correction", True)
    assert computed(session) and model.parameters.network_fault is None


def restored(saved, **chosen):
    parameters = Parameters(Options(**chosen), Playback())
    parameters.restore(json.loads(json.dumps(saved)))
    return parameters.options


def test_the_choice_of_shading_correction_is_remembered_but_no_path():
    saved = {"shading_correction": False, "focus_mask": False, "scn_model": "x.onnx", "scn_provider": "cuda"}
    options = restored(saved)
    assert (options.shading_correction, options.focus_mask) == (False, False)
    assert (options.scn_model, options.scn_provider) == (None, None)
    assert restored(saved, shading_correction=True).shading_correction is True
    assert restored(saved, scn_model="y.onnx").shading_correction is None
    assert restored({"shading_correction": True}).shading_correction is None


def test_every_option_that_is_remembered_comes_back():
    for name, option in OPTIONS.items():
        usual = getattr(Options(**ALWAYS), name)
        for other in (
            [True, False]
            if option.kind is bool
            else option.choices or ["some text" if option.kind is str else by_hand(option)]
        ):
            if option.is_module and option.automatic and other:
                continue  # is off or automatic
            parameters = Parameters(Options(), Playback())
            if option.kind in (int, float):
                other += 1 if other < option.high else -1
            parameters.set(name, other)
            kept = parameters.value(name)
            assert getattr(restored(parameters.preferences()), name) == (kept if option.remembered else usual), name


def test_a_damaged_option_costs_only_itself():
    for damaged in ({"levels": 99}, {"levels": True}, {"order": "2"}, {"hole_filling": 1}, {"motion": 0}):
        assert restored({"crack_closing": False} | damaged) == Options(crack_closing=False, **ALWAYS)


def test_a_sequence_is_upscaled_by_what_it_was_rendered_for():
    for render_size, factor in (((32, 20), 2.0), ((64, 40), 1.0), ((77, 48), 1.0)):
        parameters = Parameters(Options(upscale=3.0), Playback())
        parameters.open(SimpleNamespace(live=True, width=64, height=40, render_size=(64, 40)))
        assert parameters.options.upscale == 3
        parameters.open(SimpleNamespace(live=False, width=64, height=40, render_size=render_size))
        assert parameters.options.upscale == factor
        parameters.set("upscale", 2.5)
        assert parameters.options.upscale == factor
        parameters.switch("upscale", False)
        assert parameters.options.upscale == 0


def test_modules_and_parameters_come_from_the_descriptions(session):
    """Toggles switch between off and the usual value, everything comes back; each has its action in the palette."""
    parameters = session.model.parameters
    offered = parameters.offered()
    assert set(OPTIONS) - set(offered) == {"shading_inputs", "scn_model", "scn_provider"}
    assert set(offered) - set(OPTIONS) == {"window", "n"}
    for name, option in offered.items():
        if option.is_module and parameters.why_not(name) is None:
            for on in (False, True):
                parameters.switch(name, on)
                assert parameters.is_on(name) == on
            assert parameters.value(name) == (by_hand(option) if option.default != option.off else 1)
    session.model.set("levels", 99)
    assert (
        parameters.options.levels == Options().levels and "background levels must be" in session.model.messages[-1].text
    )
    parameters.set("n", 3)
    parameters.set("order", 3)
    assert parameters.setup.n == 3 and parameters.options.history == 4
    parameters.use_preset("performance")
    assert parameters.options.warp == "dilated" and parameters.options.order == 3  # which no preset sets
    assert parameters.options.preset_name == "performance"
    parameters.use_preset("balanced")
    assert parameters.options.levels == Options().levels
    parameters.use_defaults()
    assert parameters.options == Options(**ALWAYS) and session.model.n == 1
    assert "no trained weights" in parameters.why_not("shading_correction") == parameters.why_not("focus_mask")
    assert "overscan" in parameters.why_not("window") and "built-in scene" in parameters.why_not("scene_window")


def test_numbers_of_scripts():
    threshold, levels = ALL["static_threshold"], ALL["levels"]
    assert parsed(threshold, " auto ") is None and parsed(threshold, "1,5") == 1.5 and parsed(levels, "3") == 3
    order = ALL["camera_order"]
    assert parsed(order, "auto") is None and parsed(order, "2") == 2
    assert parsed(order, "1") == 1
    for option, text in ((levels, "9"), (levels, "1.5"), (levels, ""), (threshold, "nan"), (threshold, "much")):
        with pytest.raises(GffeError, match=f"{option.label} must be"):
            parsed(option, text)


def test_a_file_of_a_capture_opens_its_folder(session, tmp_path):
    model, source = session.model, session.model.source
    model.open(str(tiny_sequence.write(tmp_path / "second", frames=2) / "frame_1.exr"))
    session.until(lambda: model.source is not source)
    session.settle()
    assert model.source.name == "second" and model.source.count == 2


def test_a_device_that_is_lost_for_a_while(session, monkeypatch):
    """What it was asked for is told; what is in the cache can be looked at; it is used again when it is back."""
    model, shoot = session.model, Seeker.shoot
    session.until(lambda: len(model.document.ahead.cached) == model.playback.slots)

    def lost(self, k, alpha):
        raise cl.RuntimeError("clEnqueueNDRangeKernel failed: OUT_OF_RESOURCES")

    monkeypatch.setattr(Seeker, "shoot", lost)
    model.show_layer("frame.depth")
    model.playback.seek(3)
    session.until(lambda: model.messages)
    assert model.messages[0].error and "OUT_OF_RESOURCES" in model.messages[0].text
    model.show_layer("final")
    model.playback.seek(1)
    session.settle()
    assert model.slot == 1 and set(session.canvas.layers) == {"final"}
    monkeypatch.setattr(Seeker, "shoot", shoot)
    model.show_layer("frame.depth")
    session.settle()
    assert model.slot == 1 and set(session.canvas.layers) == {"frame.depth"} and model.document.failure is None


def test_the_doctor_marks_frames_in_the_wrong_place():
    told = []
    for names in ([], ["two frames swapped"]):
        doctor = Doctor(broken(clip(), names))
        wait_for(lambda doctor=doctor: doctor.done)
        told.append(doctor)
    assert told[0].findings == [] and told[0].marks == {} and told[0].problem == told[1].problem == ""
    assert any(finding.name == "gap" for finding in told[1].findings) and set(told[1].marks) <= set(range(COUNT))
    assert not told[1].converts
    assert told[1].marks


def test_the_worst_pixel_is_looked_at(session):
    model = session.model
    model.playback.seek(1)
    model.comparison.with_layer("truth")
    model.comparison.subtract("mean")
    session.settle()
    model.go_to_largest()
    images = (to_display(model.contents.image(name)[..., :3], 1.0) for name in ("final", "truth"))
    error, (x, y) = np.abs(np.subtract(*images)).mean(-1), model.pointing.picked
    assert error[y, x] == error.max() and f"at ({x}, {y})" in model.messages[-1].text
    model.sides.keep()
    session.settle()
    model.go_to_largest()
    assert model.messages[-1].text == "A and B are equal here"


def test_legends_have_the_units_of_what_is_compared(session):
    model = session.model
    model.playback.seek(3)
    model.parameters.switch("crack_closing", False)
    model.sides.keep()
    model.parameters.switch("crack_closing", True)
    model.show_layer("frame.depth")
    session.settle()

    def unit():
        return model.captions.legends()[0][1].unit

    model.comparison.subtract("mean")
    assert unit() == "world units"
    model.show_layer("final")
    model.comparison.with_layer("truth")
    assert unit() == "of display values"
    if model.comparison.why_not("flip error") is None:
        model.comparison.set("flip error")
        session.settle()
        assert unit().startswith("FLIP") and model.comparison.flip_map.shape == model.contents.size[::-1]


def test_a_picture_under_way_is_stopped_and_gone_on_with(session):
    model = session.model
    with session.engine_waiting():
        model.playback.seek(5)
        session.frame()
        model.stop_computing()
        session.frame()
        assert model.store.next() is None and "stopped" in model.waiting_text
    assert not model.busy
    session.frame()
    assert model.slot == 0
    model.stop_computing()
    session.settle()
    assert model.slot == 5
    assert model.engine.progress[0] == model.engine.progress[1] > 0
    with session.engine_waiting():
        model.set("levels", 0)
        model.playback.play()
        session.frame()
        model.stop_computing()
        session.frame()
        assert model.stopped and not model.playback.playing
        model.playback.scrubbing = True
        model.playback.seek(2)
        session.frame()
        assert not model.stopped and model.store.next().key.slot == 2, "another one is due"


def test_statistics_and_values_of_a_and_b(session):
    """... of a rectangle, and at a pixel in the status bar, as they are stored."""
    model = session.model
    model.playback.seek(3)
    model.comparison.with_layer("truth")
    model.comparison.set("split")
    session.settle()
    a, b = (model.contents.image(name)[2:6, 3:8, :3].astype(np.float64) for name in ("final", "truth"))
    model.pointing.mark((3.2, 2.9), (7.9, 5.1))
    assert model.pointing.rectangle == (3, 2, 8, 6)
    rows = wait_for(model.statistics)
    assert [name for name, *_ in rows] == [f"{side} {c}" for side in ("A", "B", "A − B") for c in "RGB"]
    for (_, found, share), values in zip(rows, (s[..., c] for s in (a, b, a - b) for c in range(3)), strict=True):
        assert share == 1 and found == pytest.approx([of(values) for of in (np.min, np.max, np.mean, np.median)])
    model.pointing.hover((4.5, 3.5))
    place, *texts = status.parts(model)[:4]
    assert place == "(4, 3)" and texts[0] == f"A  {value_text(model.contents.spec('final'), a[1, 1])}"
    assert texts[2] == "A − B  " + "  ".join(f"{v:+.4g}" for v in (a - b)[1, 1])
    model.show_layer("rendered.depth")  # whose grid may be another one, with sky
    session.settle()
    (name, found, _), *_ = wait_for(model.statistics)
    assert name == "A" and found[0] == model.contents.image("rendered.depth")[2:6, 3:8].min()
    model.pointing.mark((-9, -9), (-1, -1))
    assert model.pointing.rectangle is None


def test_faults_of_all_frames_are_marked(tmp_path):
    """Invalid pixels, stale buffers, repeated frames and uneven times, on a thread and only in idle time."""
    folder = tmp_path / "faulty"
    with SequenceWriter(folder, tiny_sequence.W, tiny_sequence.H, 30.0) as writer:
        for k in range(14):
            seen, late = min(k, 10), 0.01 * (k >= 4)
            color, depth, motion = tiny_sequence.pixels(seen)
            color = tiny_sequence.pixels(4)[0] if k == 5 else color
            depth = tiny_sequence.pixels(6)[1] if k == 7 else depth
            motion[1, 2:5] = np.nan if k == 2 else motion[1, 2:5]
            camera = tiny_sequence.camera(3 if k == 4 else seen)
            entry = replace(tiny_sequence.rendered(seen), file=f"frame_{k}.exr", time=k / 30 + late, reset=k == 0)
            entry = replace(entry, render_camera=camera)
            writer.add(entry, named_channels(color, depth, motion if k else None))
        for file, time in (("known.exr", 7.75 / 30 + 0.01), ("alone.exr", 8.45 / 30 + 0.01)):
            truth = FrameEntry(file, time, "ground_truth", display_camera=tiny_sequence.camera(8))
            writer.add(truth, named_channels(tiny_sequence.pixels(8)[0]))
    document = Session(folder).model.document
    scan = document.scan
    scan.update(False)
    assert scan._job is None or wait_for(scan._job.done)
    wait_for(lambda: scan.update(True) or not scan.busy)
    found = {k: list(kinds) for k, kinds in scan.marks.items()}
    assert found == {2: [INVALID], 4: [REPEATED, UNEVEN], 8: [REPEATED, ALONE]} | {
        k: [REPEATED] for k in (5, 7, 11, 12, 13)
    }
    assert "alone.exr equals known.exr" in scan.marks[8][REPEATED] and "camera of" in scan.marks[4][REPEATED]
    assert "alone.exr" in scan.marks[8][ALONE], "which no generated frame is compared with"
    assert "3 × NaN" in scan.marks[2][INVALID] and "43.3 ms" in scan.marks[4][UNEVEN]
    assert "color of the frame before" in scan.marks[5][REPEATED] and "depth of" in scan.marks[7][REPEATED]
    assert list(document.faults) == sorted(found)
