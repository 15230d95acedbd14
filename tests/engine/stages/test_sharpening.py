"""Sharpening of what upscaling shows: the kernel against its twin, and that the history does not notice."""

import numpy as np
import pytest
from synthetic import Rect, Rects
from twins import upscaling as twin
from upscaling_frames import MOVING, STILL, H, W, color_of, frames, path, pipeline_for

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.options import Options


def sharp_and_not(device, scene=MOVING, strength=0.6, count=5, size=(W, H), **about):
    """Two pipelines that have seen the same frames, with sharpening and without."""
    both = [pipeline_for(device, size, upscale_sharpening=s, shading_correction=False) for s in (strength, 0.0)]
    for frame in frames(scene, count, size, **about):
        for pipeline in both:
            pipeline.submit(frame)
    return both


@pytest.mark.parametrize("size, strength", [((W, H), 0.6), ((53, 37), 1.0), ((3, 2), 0.3)])
def test_the_kernel_does_what_its_twin_does(device, size, strength):
    """Of rendered frames and of generated ones, of light far beyond white, too; to a rounding to half."""
    bright = Rects(MOVING.rects + [Rect((0.3, 0, 4), (0.4, 3), tint=(900, 300, 5))])
    sharp, plain = sharp_and_not(device, bright, strength, 3, size, still=False)
    np.testing.assert_allclose(color_of(sharp), twin.sharpen(color_of(plain), strength), rtol=2e-3, atol=1e-5)
    at = path(3, still=False) if size == (W, H) else None, 2.5 / 30
    made, soft = sharp.extrapolate(*at), plain.extrapolate(*at)
    shown = made.numpy("color").astype(np.float32)
    np.testing.assert_allclose(shown, twin.sharpen(soft.numpy("color"), strength), rtol=2e-3, atol=1e-5)
    np.testing.assert_array_equal(made.numpy("gae"), soft.numpy("gae"))
    assert size[0] < 9 or np.abs(color_of(sharp) - color_of(plain)).max() > 0.01


def test_the_history_is_never_sharpened(device):
    """Frame after frame it is what it is without."""
    sharp, plain = sharp_and_not(device, count=8, still=False)
    for name in ("history", "lock", "rejected"):
        np.testing.assert_array_equal(sharp.stages["upscaling"].read(name), plain.stages["upscaling"].read(name))


def test_it_does_more_the_stronger_and_nothing_to_flat_places(device):
    """Contrast of neighbors grows with the strength; a flat wall stays as it is; a hard edge hardly overshoots."""

    def contrast(color):
        return np.abs(np.diff(color, axis=1)).mean()

    seen = {s: color_of(sharp_and_not(device, STILL, s, 12)[0]) for s in (0.0, 0.3, 0.6, 1.0)}
    made = [contrast(color) for color in seen.values()]
    assert made == sorted(made) and made[-1] > 1.1 * made[0]
    edge = Rects([Rect((0, 0, 12), (20, 20), frequency=0, tint=(0.2,) * 3),
                  Rect((2, 0, 6), (2, 9), frequency=0, tint=(0.9,) * 3)])  # fmt: skip
    sharp, plain = (color_of(pipeline)[4:-4] for pipeline in sharp_and_not(device, edge, 1.0, 20))
    np.testing.assert_allclose(sharp[:, :30], plain[:, :30], atol=2e-3)
    assert sharp.min() > plain.min() - 0.06 and sharp.max() < plain.max() + 0.2


def test_strengths_are_checked(gffe, tmp_path):
    with pytest.raises(GffeError, match=r"sharpening must be a number, 0 to 1, got 1\.5"):
        Options(upscale=1, upscale_sharpening=1.5)
    code, _, err = gffe("run", "room", tmp_path / "out", "--upscale", 2, "--sharpening", -1)
    assert code == 2 and "--sharpening must be" in err and not (tmp_path / "out").exists()
