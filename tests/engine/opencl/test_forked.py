"""Forked children: their parent's OpenCL devices are refused in one line, since drivers would wait forever there."""

import multiprocessing
import os

import numpy as np
import pytest

import gffe_cl
from gffe_cl import Camera, GffeError, Options, Pipeline, RenderedFrame

pytestmark = [
    pytest.mark.device,
    pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),  # of forking with threads
]
W, H = 32, 18
SECONDS = 60


def in_a_fork(work):
    """What `work` returns in a forked child, or the GffeError that it raises there."""
    context = multiprocessing.get_context("fork")
    receiving, sending = context.Pipe(duplex=False)

    def child():
        try:
            sending.send(("made", repr(work())))
        except GffeError as error:
            sending.send(("refused", str(error)))
        os._exit(0)

    process = context.Process(target=child)
    process.start()
    try:
        assert receiving.poll(SECONDS), "the child hangs"
        return receiving.recv()
    finally:
        process.kill()
        process.join()


def frame(time):
    color, depth = np.full((H, W, 3), 0.5, np.float16), np.full((H, W), 10, np.float32)
    return RenderedFrame(
        color, depth, np.zeros((H, W, 2), np.float32), Camera(np.eye(4), 30, 30, 16, 9), time, reset=True
    )


def test_devices_of_the_parent_are_refused(device):
    pipeline = Pipeline(device, W, H, Options(shading_correction=False))
    pipeline.submit(frame(0.0))
    made = pipeline.extrapolate(time=0.01)
    before = made.numpy("color")

    again = gffe_cl.open_device(device.info.index)
    adopted = gffe_cl.Device.from_context(device.context, device.queue)
    for use in (
        lambda: gffe_cl.open_device(device.info.index),
        lambda: Pipeline(again, W, H),
        lambda: pipeline.submit(frame(1.0)),
        lambda: pipeline.extrapolate(time=0.01),
        lambda: pipeline.bad_pixels,
        pipeline.take_timings,
        lambda: made.numpy("color"),
        lambda: device.buffer(4),
        lambda: adopted.buffer(4),
        lambda: gffe_cl.Device.from_context(device.context, device.queue),
    ):
        kind, said = in_a_fork(use)
        assert kind == "refused" and "\n" not in said
        assert "was opened before this process was forked (expected multiprocessing's start method 'spawn'" in said
    assert np.array_equal(pipeline.extrapolate(time=0.01).numpy("color"), before)  # the parent goes on


def test_other_things_work_in_a_fork():
    assert in_a_fork(lambda: Camera(np.eye(4), 30, 30, 16, 9).fx) == ("made", "30.0")
