"""Expected error: the kernel against its twin, and where it finds the error of new frames."""

import numpy as np
import pytest
from twin_cases import run
from twins import load_color

from gffe_cl import GffeError, Options, Pipeline, to_display
from gffe_cl.captures.offline.run import output_channels
from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.stages.buffers import BY_HOLE_FILLING
from gffe_cl.lab.table.footage import SceneSubject, open_subject

F = np.float32
WEIGHTS = {name: F(value) for name, value in constants("shading.cl").items()}


def twin_of(color, previous, disoccluded, filled_by, alpha):
    """Return the mask of shading.cl at exposure 1."""
    shown = [np.clip(load_color(c), F(0), F(1)) for c in (color, previous)]
    now, before = (F(0.5) * (c + np.sqrt(c)) for c in shown)
    differs = WEIGHTS["THIRD"] * np.add.accumulate(np.abs(now - before), axis=-1)[..., -1]
    height, width = differs.shape
    padded, square = (np.pad(a, [(1, 1)] * 2 + [(0, 0)] * (a.ndim - 2), "edge") for a in (now, differs * differs))
    parts = [np.s_[j : j + height, i : i + width] for j, i in np.ndindex(3, 3)]
    ranges = np.ptp([padded[part] for part in parts], axis=0)
    contrast = WEIGHTS["THIRD"] * ((ranges[..., 0] + ranges[..., 1]) + ranges[..., 2])
    around = np.sqrt(WEIGHTS["NINTH"] * np.add.accumulate([square[part] for part in parts])[-1])
    change = WEIGHTS["OF_CHANGE"] * differs + WEIGHTS["OF_CHANGE_AROUND"] * around
    filling = (filled_by == BY_HOLE_FILLING).astype(F)
    weight = WEIGHTS["OF_CONTRAST"] * contrast + F(2) * F(alpha) * change
    weight += WEIGHTS["OF_UNSEEN"] * (previous[..., 3] == 0) + WEIGHTS["OF_HOLES"] * (disoccluded != 0)
    weight += WEIGHTS["OF_FILLING"] * filling
    squared = (WEIGHTS["LEAST_EXPECTED"] + WEIGHTS["FILLING"] * filling) + contrast * weight
    return np.minimum(WEIGHTS["MASK_STEPS"] * np.sqrt(squared) + F(0.5), WEIGHTS["MOST"]).astype(np.uint8)


@pytest.mark.parametrize("preset", ["balanced", "performance"])
def test_kernel_equals_its_twin(device, lanes, preset):
    case = run(device, 61, 37, Options.preset(preset, expected_error=True))
    read, stages = case.pipeline.board.frame.read, case.pipeline.stages
    masks = read("disoccluded"), read("filled_by")
    expected = twin_of(read("color"), stages["shading"].read("warped_previous"), *masks, case.made.alpha)
    found = case.made.numpy("expected_error")
    assert np.array_equal(found, expected) and masks[0].any() and (masks[1] == BY_HOLE_FILLING).any()
    assert np.array_equal(output_channels(case.made, *[case.now.camera] * 2)["mask.expected_error"], found)


def test_it_finds_the_error(device):
    """The worst 5% of the pixels hold at least a third of the squared error, more than those of any other 5%."""
    footage = open_subject(SceneSubject("room", 5, 192, 108, 5, 30.0, (0.5,)), device)
    pipeline = Pipeline(device, 192, 108, Options.preset("performance", expected_error=True))
    for shot in footage.shots():
        pipeline.submit(shot.frame)
    (moment,) = shot.moments
    made = pipeline.extrapolate(moment.camera, moment.time)
    squared = np.square(to_display(made.numpy("color")) - to_display(moment.truth)).mean(-1).ravel()
    parts = np.array_split(squared[np.argsort(made.numpy("expected_error"), axis=None, kind="stable")], 20)
    held = [part.sum() / squared.sum() for part in parts]
    assert held[-1] > 1 / 3 and held[-1] > 2 * max(held[:-1])


def test_without_the_option_there_is_none(device):
    made = run(device, 8, 8, Options(shading_correction=False)).made
    assert made.expected_error is None
    with pytest.raises(GffeError, match=r"expected Options\(expected_error=True\)"):
        made.numpy("expected_error")
