"""kernels/baselines/dilate_splat.cl: surfaces that cover and uncover, in every form and order of execution."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic import camera
from twin_cases import frames

from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.timing.footage import uploaded
from gffe_cl.lab.table.footage import Footage, Moment, Shot
from gffe_cl.lab.table.methods import DILATE_SPLAT, METHODS, DilateSplat

pytestmark = pytest.mark.device


@pytest.fixture(params=[(lanes, int64) for lanes in (8, 1) for int64 in (True, False)], ids=str)
def form(request, device, monkeypatch):
    """The kernels' form: pixels per work-item, and whether keys take 64-bit atomics."""
    lanes, int64 = request.param
    if int64 and not device.int64_atomics:
        pytest.skip("the device has no 64-bit atomics")
    monkeypatch.setitem(device.__dict__, "lanes", lanes)
    return int64


def runner_of(device: Device, size, int64=None, kind=DilateSplat):
    return kind(Footage("moving", *size, 30.0, 1.0), device, int64)


def shot(frame):
    return Shot(frame, frame.color, ())


def moment(alpha):
    return Moment(alpha, alpha, None, np.zeros(0))


class Shuffled(DilateSplat):
    """Rows of each launch in a random order, one launch each."""

    def _launch(self, kernel, values):
        arguments = [one.packed(values[one.name]) for one in self._program.arguments[kernel]]
        columns = -(-self._width // self._device.lanes)
        for row in np.random.default_rng(3).permutation(self._height):
            self._program.kernels[kernel](
                self._device.queue, (columns, 1), None, *arguments, global_offset=(0, int(row))
            )


def made_by(kind, device, size, int64, frame):
    runner = runner_of(device, size, int64, kind)
    runner.submit(shot(frame))
    return runner.color_of(runner.extrapolated(moment(0.4)))


def test_neither_form_nor_order_of_execution_changes_a_bit(device, form, monkeypatch):
    """Bad pixels included, at widths that end within a strip."""
    for size in ((61, 37), (5, 3)):
        *_, frame = frames(*size)
        made, shuffled = (made_by(kind, device, size, form, frame) for kind in (DilateSplat, Shuffled))
        with monkeypatch.context() as patch:
            patch.setitem(device.__dict__, "lanes", 1)
            plain = made_by(DilateSplat, device, size, False, frame)
        assert made.tobytes() == shuffled.tobytes()
        np.testing.assert_array_max_ulp(made, plain, 1)  # one half: compilers may contract the sums


def halves(near_motion, far_motion):
    """A frame, 48 pixels wide: left of column 24 a red near surface, beside it a far one that gets greener."""
    width, height = 48, 16
    x = np.broadcast_to(np.arange(width), (height, width))
    near = x < 24
    color = np.stack([near, np.where(near, 0, x / 64), 0 * x], -1).astype(np.float32)
    depth = np.where(near, 1, 10).astype(np.float32)
    motion = np.where(near[..., None], np.float32(near_motion), np.float32(far_motion))
    return RenderedFrame(color, depth, motion, camera(width, height), 0.0, reset=True)


def test_the_nearer_surface_covers(device):
    """It moves onto the other one by 4 px, with the pixel beside it, which its edge may have a share of. What it
    leaves at the border shows the border."""
    frame = halves((-8, 0), (0, 0))
    runner = runner_of(device, (48, 16))
    runner.submit(shot(frame))
    made = runner.color_of(runner.extrapolated(moment(0.5))).astype(np.float32)
    np.testing.assert_allclose(made[:, :28], np.broadcast_to((1, 0, 0), (16, 28, 3)), atol=1e-3)
    np.testing.assert_allclose(made[:, 28], frame.color[:, 24], atol=1e-3)  # moved along
    np.testing.assert_allclose(made[:, 29:], frame.color[:, 29:], atol=1e-3)


def test_uncovered_pixels_show_what_was_beside(device):
    """The near surface leaves by 2 px; there the far one continues as it was beside, not the near one's color."""
    runner = runner_of(device, (48, 16))
    runner.submit(shot(halves((4, 0), (0, 0))))
    made = runner.color_of(runner.extrapolated(moment(0.5))).astype(np.float32)
    np.testing.assert_allclose(made[:, :22], np.broadcast_to((1, 0, 0), (16, 22, 3)), atol=1e-3)
    assert (made[:, 22:, 0] == 0).all() and (made[:, 22:, 1] >= 24 / 64).all()


def test_what_stands_still_keeps_its_bits(device):
    *_, frame = frames(33, 20, spoil=False)
    frame = replace(frame, motion=np.zeros_like(frame.motion))
    runner = runner_of(device, (33, 20))
    for given in (frame, uploaded(device, frame)):  # arrays, or buffers of the device
        runner.submit(Shot(given, frame.color, ()))
        made = runner.color_of(runner.extrapolated(moment(0.5)))
        assert np.array_equal(made, frame.color.astype(np.float16))


def test_times_of_kernels_are_taken(device):
    """As `gffe eval` takes them: once per new frame."""
    runner = METHODS[DILATE_SPLAT].runner(Footage("moving", 33, 20, 30.0, 1.0), device)
    *_, frame = frames(33, 20)
    runner.submit(shot(frame))
    for alpha in (0.25, 0.5):
        runner.finish()
        assert runner.make(moment(alpha)).shape == (20, 33, 3)
    assert len(runner.milliseconds) == 2 and min(runner.milliseconds) > 0 and runner._taken() == 0
