"""The viewer's model with its engine, without a window: what is asked for, and that nothing outdated is shown."""

import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import tiny_sequence
from scn_models import constant_model

from gffe_cl import Options, inference
from gffe_cl.viewer.engine.messages import Metrics, Request, Setup
from gffe_cl.viewer.state import remembering
from gffe_cl.viewer.state.model import Model
from gffe_cl.viewer.state.settings import Settings

PATIENCE = 60.0


class Canvas:
    """What the model has put on the screen."""

    def __init__(self):
        self.frame, self.layers = None, {}

    def upload(self, name, image, spec):
        self.layers[name] = image

    def forget(self, names):
        for name in list(names):
            self.layers.pop(name, None)


class Session:
    """A model, and frames of an interface."""

    def __init__(self, target):
        self.model, self.canvas = Model(Settings(), save_settings=False), Canvas()
        self.model.open(str(target))
        self.until(lambda: self.model.result is not None)
        self.settle()

    def frame(self):
        self.model.update(time.perf_counter(), self.canvas)

    def until(self, happens):
        end = time.monotonic() + PATIENCE
        while not happens():
            assert time.monotonic() < end, "nothing happened"
            self.frame()
            time.sleep(0.002)

    def settle(self):
        self.frame()
        self.until(lambda: self.model.settled)

    @contextmanager
    def engine_waiting(self):
        """Meanwhile the engine takes nothing up."""
        with self.model.engine._news:
            yield


@pytest.fixture
def session(tmp_path):
    session = Session(tiny_sequence.write(tmp_path / "first"))
    yield session
    session.model.close()


def test_story_is_told_although_the_mouse_moves_on(session):
    with session.engine_waiting():
        session.model.pointing.pick((3, 4))
        session.model.pointing.hover((7.5, 5.5))
    session.until(lambda: session.model.pointing.story is not None)
    assert session.model.pointing.story.pixel == (3, 4)
    session.until(
        lambda: session.model.pointing.inspection is not None and session.model.pointing.inspection.pixel == (7, 5)
    )


def test_story_follows_the_slot_although_the_mouse_moves_on(session):
    model = session.model
    model.pointing.pick((3, 4))
    session.settle()
    before, taken = model.pointing.story, model.taken
    model.playback.seek(3)
    session.until(lambda: model.taken > taken)
    assert not model.settled  # the story is still that of the slot before
    model.pointing.hover((7.5, 5.5))
    session.settle()
    assert model.pointing.story is not before and model.pointing.story.pixel == (3, 4)


def test_layers_of_another_slot_are_not_on_the_canvas(session):
    model = session.model
    for slot, layer in ((1, "frame.depth"), (3, "final")):
        model.show_layer(layer)
        model.playback.seek(slot)
        session.settle()
        assert set(session.canvas.layers) == {layer}


def test_pictures_of_another_sequence_are_not_on_the_canvas(session, tmp_path):
    model, source = session.model, session.model.info
    taken = model.taken
    model.open(str(tiny_sequence.write(tmp_path / "second")))
    session.until(lambda: model.engine.source is not source)
    with session.engine_waiting():
        session.frame()
        assert model.info is not source and model.result is None and session.canvas.layers == {}
        assert model.taken > taken  # what was drawn is drawn anew
    session.settle()
    assert set(session.canvas.layers) == {"final"}


def test_reload_opens_what_is_shown(session, tmp_path):
    """... not what was asked for in between and is not there yet, or never will be."""
    model, source = session.model, session.model.info
    model.open(str(tiny_sequence.write(tmp_path / "second")))
    session.until(lambda: model.engine.source is not source)
    model.open(str(tmp_path / "missing"))
    session.until(lambda: any("missing" in message.text for message in model.messages))
    assert model.info.name == "second" and model.settings.recent[0] == str(tmp_path / "second")
    model.reload()
    opened = model.info
    session.until(lambda: model.info is not opened)
    assert model.info.name == "second"


def test_requests_for_another_sequence_are_ignored(session, tmp_path):
    model, source = session.model, session.model.info
    model.open(str(tiny_sequence.write(tmp_path / "second", frames=1)))
    session.until(lambda: model.engine.source is not source)
    session.settle()
    model.engine.submit(Request(5, Setup(), frozenset(), 10**6), source)  # there is no slot 5 any more
    assert not model.engine.busy
    model.engine.submit(Request(5, Setup(), frozenset(), 10**6), model.info)
    session.until(lambda: model.failure)


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


def test_metrics_of_other_kernels_are_forgotten(session):
    model = session.model
    model.metrics[1] = Metrics(1, model.setup, 30.0)
    session.frame()
    assert 1 in model.metrics
    model.engine.builds += 1
    session.frame()
    assert model.metrics == {}


def computed(session):
    """Whether shading correction is in what is shown."""
    session.settle()
    return "correction.color" in {spec.name for spec in session.model.layers}


def test_shading_correction_runs_where_there_is_a_model(session, tmp_path, monkeypatch):
    """Weights that come and go while the viewer runs are taken up."""
    model = session.model
    model.playback.seek(3)
    assert not computed(session) and "no trained weights" in model.why_no_correction()
    weights = Path(constant_model(tmp_path / "m.onnx"))
    monkeypatch.setattr(inference, "default_model", lambda: weights)
    assert computed(session) and model.why_no_correction() is None
    model.show_layer("gae")
    session.settle()
    assert set(session.canvas.layers) == {"gae"}
    model.correct_shading(False)
    assert not computed(session) and model.options.shading_inputs
    model.correct_shading(True)
    model.set_options(replace(model.options, focus_mask=False))
    assert computed(session)
    monkeypatch.setattr(inference, "default_model", lambda: None)
    assert not computed(session) and not model.messages


def test_a_model_that_cannot_be_loaded_switches_shading_correction_off(session, tmp_path):
    """It says so once, the viewer lives on, and it is tried again when it is asked for again."""
    model, path = session.model, tmp_path / "m.onnx"
    path.write_bytes(b"junk")
    model.playback.seek(3)
    model.set_options(replace(model.options, scn_model=str(path)))
    session.until(lambda: model.network_fault)
    assert not computed(session) and not model.corrects_shading and model.failure is None
    model.playback.seek(1)
    assert not computed(session)
    (told,) = model.messages
    assert told.error and told.text.startswith(f"shading correction is off: {path}: ") and "\n" not in told.text
    model.correct_shading(True)
    session.until(lambda: len(model.messages) == 2)
    constant_model(path)
    model.correct_shading(True)
    assert computed(session) and model.network_fault is None


def test_the_choice_of_shading_correction_is_remembered_but_no_path():
    def restored(saved, **chosen):
        settings = Settings(options=saved)
        model = SimpleNamespace(settings=settings, options=Options(**chosen), view=session_view, playback=playback)
        remembering.restore(model)
        return model.options

    session_view, playback = SimpleNamespace(compare="off"), SimpleNamespace(restore=lambda saved: None)
    saved = {"shading_correction": False, "focus_mask": False, "scn_model": "x.onnx", "scn_provider": "cuda"}
    options = restored(saved)
    assert (options.shading_correction, options.focus_mask) == (False, False)
    assert (options.scn_model, options.scn_provider) == (None, "cpu")
    assert restored(saved, shading_correction=True).shading_correction is True
    assert restored(saved, scn_model="y.onnx").shading_correction is None
    assert restored({"shading_correction": True}).shading_correction is None
