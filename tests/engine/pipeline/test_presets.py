"""Presets: their options, what a pipeline of one leaves out, and the choice of one that is quick enough."""

import pytest
from tiny_frames import frames

from gffe_cl import GffeError, Options, Pipeline, choose_options
from gffe_cl.engine.options import PRESETS
from gffe_cl.engine.timing import choice


def test_presets_are_options_by_name():
    assert Options.preset("balanced") == Options()
    assert Options.preset("performance").warp == "dilated" and not Options.preset("performance").corrects_shading
    assert Options.preset("performance", warp="footprints", order=1).warp == "footprints"
    with pytest.raises(GffeError, match="preset must be one of quality, balanced, performance, got"):
        Options.preset("fast")
    with pytest.raises(GffeError, match=r"preset is no option .expected Options.preset\('quality'\)"):
        Options(preset="quality")
    with pytest.raises(GffeError, match=r"preset auto depends on .*gffe.choose_options\(device, frames, budget_ms\)"):
        Options.preset("auto", budget_ms=4)
    with pytest.raises(TypeError, match="level"):
        Options.preset("quality", level=2)


def test_options_know_their_preset():
    for name in PRESETS:
        assert Options.preset(name).preset_name == name
        assert Options.preset(name, order=2, history=3).preset_name == name  # no preset sets these
    assert Options.preset("performance", blocks=False).preset_name is None


def test_performance_leaves_stages_out(device):
    made = {name: set(Pipeline(device, 64, 36, Options.preset(name)).stages) for name in PRESETS}
    assert made["performance"] - made["balanced"] == {"dilated_warp"} and made["balanced"] <= made["quality"]
    assert made["balanced"] - made["performance"] >= {"background", "silhouettes", "hidden_parts", "warp", "holes"}


@pytest.mark.parametrize(
    ("budget", "name", "fits"),
    [(9, "quality", True), (7, "balanced", True), (5, "balanced without the network", True), (1, "performance", False)],
)
def test_the_best_that_fits_is_chosen(device, monkeypatch, budget, name, fits):
    """By times that are told; what was chosen before it is known to be too slow."""
    taken = iter((8.0, 6.0, 4.0, 2.0))
    monkeypatch.setattr(choice, "_milliseconds", lambda *_: next(taken))
    monkeypatch.setattr(Options, "corrects_shading", property(lambda self: self.shading_correction is not False))
    made = choose_options(device, list(frames(3)), budget, Options(ui_detection=True))
    assert (made.name, made.fits, made.options.ui_detection) == (name, fits, True)
    assert made.options.corrects_shading == (name in ("quality", "balanced"))
    assert list(made.milliseconds)[-1] == name and made.sentence.startswith(f"{name}: ")
    assert list(choice.LADDER)[: len(made.milliseconds)] == list(made.milliseconds)


def test_presets_are_really_measured(device):
    options = Options(shading_correction=False)
    made = choose_options(device, list(frames(3)), 1e-3, options, repeats=2)
    assert list(made.milliseconds) == ["quality", "balanced", "performance"] and min(made.milliseconds.values()) > 0
    assert made.options == Options.preset("performance") and "does not fit into 0.001 ms" in made.sentence
    with pytest.raises(GffeError, match="frames must be at least 3, got 2"):
        choose_options(device, list(frames(2)), 5)
    with pytest.raises(GffeError, match="budget_ms must be a finite number from"):
        choose_options(device, list(frames(3)), 0)
