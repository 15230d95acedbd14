"""Presets: their options, and what a pipeline of one leaves out."""

import pytest

from gffe_cl import GffeError, Options, Pipeline
from gffe_cl.engine.options import PRESETS
from gffe_cl.engine.selftest.scene import FPS, display_camera, frames
from gffe_cl.engine.stages.commands import Commands


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


@pytest.mark.parametrize(("preset", "most"), [("balanced", 16), ("performance", 6)])
def test_a_pair_takes_few_commands(device, monkeypatch, preset, most):
    """As `gffe bench` counts them: without the network, a rendered and a new frame while the camera moves."""
    size, enqueued, do = (64, 36), [], Commands._do
    monkeypatch.setattr(Commands, "_do", lambda self, *given: enqueued.append(given[:2]) or do(self, *given))
    pipeline = Pipeline(device, *size, Options.preset(preset, shading_correction=False), int64_atomics=True)
    for frame in frames(*size, count=3, samples=1):
        enqueued.clear()
        pipeline.submit(frame)
        pipeline.extrapolate(display_camera(frame.time + 0.5 / FPS, *size), frame.time + 0.5 / FPS)
        kernels = [kernel for stage, kernel in enqueued if stage != "upload"]
    assert 0 < len(kernels) <= most, kernels
