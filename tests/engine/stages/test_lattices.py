"""Lattices that move as one layer: nets with wires at the pitch of pixels, and what is none."""

import numpy as np
import pytest
from synthetic import Rect, Rects, camera

from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.buffers import BY_CRACK_CLOSING, BY_WARP

WIDTH, HEIGHT, FAR_AWAY = 96, 64, 4.0
OPTIONS = Options(shading_correction=False, cut_detection=False)
_PX = FAR_AWAY / camera(WIDTH, HEIGHT).fx  # of the net, world units


def wires(along_x=True, movement=(0, 0, 0)):
    """Wires 1 px wide, 3 px apart in one direction."""
    places = 3 * _PX * np.arange(-8, 9)
    thin, long = 0.5 * _PX, 30 * _PX
    if along_x:
        return [Rect((0, y, FAR_AWAY), (long, thin), movement, tint=(0.05, 0.1, 0.05)) for y in places]
    return [Rect((x, 0, FAR_AWAY), (thin, long), movement, tint=(0.05, 0.1, 0.05)) for x in places]


WALL = [Rect((0, 0, 9), (30, 30), frequency=0.2)]


def shown(device, rects, step=0.05):
    """Submit three frames of a camera that moves aside by `step`. Returns the pipeline and the new frame."""
    scene, pipeline, previous = Rects(rects), Pipeline(device, WIDTH, HEIGHT, OPTIONS, fps=30), None
    for k in range(3):
        at = camera(WIDTH, HEIGHT, (k * step, 0.4 * k * step, 0))
        pipeline.submit(scene.frame(at, k / 30, WIDTH, HEIGHT, previous, reset=k == 0, samples=2))
        previous = at, k / 30
    return pipeline, pipeline.extrapolate(camera(WIDTH, HEIGHT, (2.5 * step, step, 0)), 2.5 / 30)


@pytest.mark.parametrize("behind", [WALL, []], ids=["wall", "sky"])
def test_a_net_moves_as_one_layer(device, lanes, behind):
    """In its plane; also before the sky, whose depth is infinite."""
    pipeline, made = shown(device, wires() + wires(along_x=False) + behind)
    lattices = pipeline.stages["lattices"]
    found = lattices.read("lattices") & 16 != 0
    assert found[2:-2, 3:-3].all() and not (found[0].any() or found[:, 0].any())
    np.testing.assert_allclose(lattices.read("plane")[found][:, 0], 1 / FAR_AWAY, rtol=1e-4)
    inner = np.s_[16:-16, 32:-32]
    assert np.isin(made.numpy("filled_by")[inner], (BY_WARP, BY_CRACK_CLOSING)).all()
    np.testing.assert_allclose(made.numpy("depth")[inner], FAR_AWAY, rtol=1e-4)
    assert np.ptp(made.numpy("motion")[inner], (0, 1)).max() < 0.05 < np.abs(made.numpy("motion")[inner]).min()


@pytest.mark.parametrize(
    ("rects", "step"),
    [
        (wires(along_x=False) + WALL, 0.05),
        (wires() + wires(along_x=False) + WALL, 0.0),
        (wires(movement=(0, 3, 0)) + wires(along_x=False, movement=(0, 3, 0)) + WALL, 0.05),
    ],
    ids=["bars", "still", "moving"],
)
def test_other_things_are_no_lattices(device, rects, step):
    pipeline, _ = shown(device, rects, step)
    assert not (pipeline.stages["connectivity"].read("links") & 16).any()
