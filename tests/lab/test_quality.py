"""How good the pictures are: floors under the extrapolation of every built-in scene, and what the package's own weights
gain on scenes that they were not trained on."""

import numpy as np
import pytest

from gffe_cl.engine.inference import network
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.lab.metrics import focus_mask, to_display
from gffe_cl.lab.table.footage import SceneSubject, open_subject

WIDTH, HEIGHT, FRAMES, FPS = 320, 180, 7, 30.0


def extrapolated(device, name, seed, options):
    """(GAE, final, truth, focus mask) half an interval after each rendered frame that has enough history; colors
    (H, W, 3) as displayed."""
    footage = open_subject(SceneSubject(name, seed, WIDTH, HEIGHT, FRAMES, FPS, (0.5,)), device)
    pipeline = Pipeline(device, WIDTH, HEIGHT, options, fps=FPS)
    pipeline.exposure = footage.exposure
    for shot in footage.shots():
        pipeline.submit(shot.frame)
        for moment in shot.moments:
            made = pipeline.extrapolate(moment.camera, moment.time)
            focus = focus_mask(made.numpy("gae"), moment.truth, made.numpy("dynamic"), footage.exposure)
            gae, final = (to_display(made.numpy(buffer), footage.exposure) for buffer in ("gae", "color"))
            yield gae, final, to_display(moment.truth, footage.exposure), focus


def psnr(pairs):
    """Of all pixels of all pairs together, dB."""
    squared = np.concatenate([((a - b) ** 2).ravel() for a, b in pairs])
    return -10 * np.log10(squared.mean())


# 0.3 dB below what PoCL and Intel's runtime both gave. Bits of the other scenes are recorded (test_recorded_sequences).
FLOORS = {"plaza": 30.2, "street": 27.0}


@pytest.mark.long
@pytest.mark.parametrize("name", FLOORS)
def test_geometry_is_extrapolated_as_well_as_it_was(device, name):
    frames = extrapolated(device, name, 0, Options(shading_correction=False))
    assert psnr([(gae, truth) for gae, _, truth, _ in frames]) > FLOORS[name]


@pytest.fixture
def shipped_weights(monkeypatch, default_model):
    """The weights that come with the package are there, and on by default as for a user."""
    monkeypatch.setattr(network, "default_model", default_model)
    assert default_model() is not None, "gffe_cl/engine/inference/weights/scn.onnx is missing"


# About three quarters of the gain that was measured, dB.
@pytest.mark.parametrize(
    ("name", "seed", "gain"),
    [
        ("courtyard", 1, 3.8),
        pytest.param("street", 0, 0.12, marks=pytest.mark.long),
    ],
)
def test_shipped_weights_gain_where_shading_moves_and_lose_nothing(device, shipped_weights, name, seed, gain):
    frames = list(extrapolated(device, name, seed, Options()))
    before, after = (psnr([(frame[k][frame[3]], frame[2][frame[3]]) for frame in frames]) for k in (0, 1))
    assert after > before + gain
    before, after = (psnr([(frame[k], frame[2]) for frame in frames]) for k in (0, 1))
    assert after > before
