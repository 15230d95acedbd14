"""Presets: their options, what a pipeline of one leaves out, and the choice of one that is quick enough."""

from dataclasses import replace

import pytest
from tiny_frames import frames

from gffe_cl import GffeError, Options, Pipeline, choose_options
from gffe_cl.engine.opencl.device import open_info
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


FALLING = (8.0, 6.0, 4.0, 2.0)


@pytest.mark.parametrize(
    ("times", "budget", "name", "fits"),
    [
        (FALLING, 9, "quality", True),
        (FALLING, 7, "balanced", True),
        (FALLING, 5, "balanced without the network", True),
        (FALLING, 1, "performance", False),
        ((8.0, 6.0, 2.0, 4.0), 1, "balanced without the network", False),
    ],
)
def test_the_best_that_fits_is_chosen(device, monkeypatch, times, budget, name, fits):
    """Else the quickest, by times that are told; what was measured before it is known to be too slow."""
    told = iter(times)
    monkeypatch.setattr(choice, "_milliseconds", lambda *_: next(told))
    monkeypatch.setattr(Options, "corrects_shading", property(lambda self: self.shading_correction is not False))
    made = choose_options(device, list(frames(3)), budget, Options(ui_detection=True))
    assert (made.name, made.fits, made.options.ui_detection) == (name, fits, True)
    assert made.options.corrects_shading == (name in ("quality", "balanced"))
    assert made.milliseconds[name] == min(made.milliseconds.values()) and made.sentence.startswith(f"{name}: ")
    assert made.sentence.count(" takes ") == len(made.milliseconds) - fits  # others, and "takes the least"
    assert list(choice.LADDER)[: len(made.milliseconds)] == list(made.milliseconds)


def test_presets_that_need_too_much_memory_are_passed_over(device):
    small, given = open_info(device.info), (list(frames(3)), 1e5, Options(shading_correction=False), 1, (640, 360))
    small.memory = 8 << 20
    made = choose_options(small, *given)
    assert (made.name, made.fits, made.too_large) == ("performance", True, ("quality", "balanced"))
    assert made.sentence.endswith(
        "100000 ms; " + "; ".join(f"{name} needs more memory than the device has" for name in ("balanced", "quality"))
    )
    small.memory = 4 << 20
    with pytest.raises(GffeError, match=r"640×360 .* takes .* of the 4 MiB of .*expected at most about"):
        choose_options(small, *given)


def test_frames_may_be_smaller_than_the_display(device):
    made = choose_options(device, list(frames(3)), 1e5, Options(upscale=2, shading_correction=False), 1, size=(48, 32))
    assert made.name == "quality"


def test_presets_are_really_measured(device):
    options = Options(shading_correction=False)
    made = choose_options(device, list(frames(3)), 1e-3, options, repeats=2)
    assert list(made.milliseconds) == ["quality", "balanced", "performance"] and min(made.milliseconds.values()) > 0
    assert made.milliseconds[made.name] == min(made.milliseconds.values())
    assert made.options == replace(Options.preset(made.name), shading_correction=False)
    assert f"{made.name}: " in made.sentence and "does not fit into 0.001 ms" in made.sentence
    with pytest.raises(GffeError, match="frames must be at least 3, got 2"):
        choose_options(device, list(frames(2)), 5)
    with pytest.raises(GffeError, match="budget_ms must be a finite number from"):
        choose_options(device, list(frames(3)), 0)
