"""Presets: their options, and what a pipeline of one leaves out."""

import pytest

from gffe_cl import GffeError, Options, Pipeline
from gffe_cl.engine.options import PRESETS


def test_presets_are_options_by_name():
    assert Options.preset("balanced") == Options()
    assert Options.preset("performance").warp == "dilated" and not Options.preset("performance").corrects_shading
    assert Options.preset("performance", warp="footprints", order=1).warp == "footprints"
    with pytest.raises(GffeError, match="preset must be one of quality, balanced, performance, got"):
        Options.preset("fast")
    with pytest.raises(GffeError, match=r"preset is no option .expected Options.preset\('quality'\)"):
        Options(preset="quality")
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
