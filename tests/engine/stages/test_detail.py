"""Detail: new frames between pixels are finer with it, whole pixels and ranges are kept."""

import numpy as np
import pytest
from synthetic import Rect, Rects, camera

from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline

SIZE = 96, 54
WALL = Rects([Rect((0, 0, 4), frequency=5)])


def fine_energy(color):
    """Return the mean square of what a pixel differs from the mean over itself and its four neighbors."""
    green = np.sqrt(color[..., 1].astype(np.float64))
    around = green[:-2, 1:-1] + green[2:, 1:-1] + green[1:-1, :-2] + green[1:-1, 2:] + green[1:-1, 1:-1]
    return np.square(green[1:-1, 1:-1] - around / 5)[8:-8, 8:-8].mean()


@pytest.mark.parametrize("preset", ["balanced", "performance"])
def test_a_pan_between_pixels_is_as_fine_as_rendered_frames(device, preset):
    step = 4 / 96  # of the camera: one pixel, of which the new frame is half way
    cameras = [camera(*SIZE, (step * k, 0, 0)) for k in (0, 1, 2, 2.5)]
    truth = WALL.color(cameras[3], 0, *SIZE, samples=4)
    energies = []
    for detail in (False, True):
        pipeline = Pipeline(device, *SIZE, Options.preset(preset, detail=detail, shading_correction=False))
        for k in range(3):
            previous = (cameras[k - 1], (k - 1) / 30) if k else None
            pipeline.submit(WALL.frame(cameras[k], k / 30, *SIZE, previous, reset=k == 0, samples=4))
        made = pipeline.extrapolate(cameras[3], 2.5 / 30)
        energies.append(fine_energy(made.numpy("color")) / fine_energy(truth))
        if detail:
            sharp, plain = (made.numpy(name).astype(np.float32) for name in ("color", "gae"))
            padded = np.pad(plain, ((1, 1), (1, 1), (0, 0)), "edge")
            parts = [padded[j : j + 54, i : i + 96] for j, i in np.ndindex(3, 3)]
            assert (sharp >= np.min(parts, 0) - 1e-3).all() and (sharp <= np.max(parts, 0) + 1e-3).all()
            rests = pipeline.extrapolate(cameras[2], 2 / 30)
            assert np.array_equal(rests.numpy("color"), rests.numpy("gae"))
    assert energies[0] < 0.85 < energies[1] < 1.1, energies
