"""A pipeline on several threads: one at a time calls it, and all others are refused in one line; what it made may be
read on any thread."""

import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import numpy as np
import pytest
from scn_models import constant_model
from tiny_frames import H, W, frames

from gffe_cl import GffeError, Options, Pipeline

pytestmark = pytest.mark.device
SECONDS = 20


@pytest.fixture
def with_network(tmp_path):
    return Options(scn_model=str(constant_model(tmp_path / "model.onnx", delta=0.2)), cut_detection=False)


def on_another_thread(work, *arguments):
    """What `work` returns there; its exception is raised here."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(work, *arguments).result(SECONDS)


@contextmanager
def submitting(pipeline, frame):
    """Have another thread within `submit` of `frame` during the block."""
    inside, may_end = threading.Event(), threading.Event()

    def watcher(*_):
        inside.set()
        assert may_end.wait(SECONDS)

    pipeline.watcher = watcher
    thread = threading.Thread(target=pipeline.submit, args=(frame,), daemon=True)
    thread.start()
    assert inside.wait(SECONDS)
    try:
        yield
    finally:
        may_end.set()
        thread.join(SECONDS)
        pipeline.watcher = None


@pytest.mark.parametrize("corrects", [False, True], ids=["without the network", "with it"])
def test_one_thread_at_a_time(device, with_network, corrects):
    options = with_network if corrects else Options(shading_correction=False)
    first, second, third = frames(3)
    pipeline, alone = Pipeline(device, W, H, options), Pipeline(device, W, H, options)
    for frame in (first, second):
        pipeline.submit(frame)
        alone.submit(frame)
    made = pipeline.extrapolate()
    before = made.numpy("color")
    calls = {
        "submit": lambda: pipeline.submit(third),
        "extrapolate": pipeline.extrapolate,
        "present": pipeline.present,
        "predict_camera": lambda: pipeline.predict_camera(0.5),
        "change_options": lambda: pipeline.change_options(options),
        "interval": lambda: pipeline.interval,
        "is_cut": lambda: pipeline.is_cut,
        "bad_pixels": lambda: pipeline.bad_pixels,
        "keep": pipeline.keep,
        "named_buffers": pipeline.named_buffers,
        "take_timings": pipeline.take_timings,
        "take_kernel_timings": pipeline.take_kernel_timings,
    }
    with submitting(pipeline, third):
        for name, call in calls.items():
            with pytest.raises(GffeError, match=f"^{name}: another thread is using this pipeline .expected one") as one:
                call()
            assert "\n" not in str(one.value)
        assert np.array_equal(made.numpy("color"), before)  # `submit` leaves it as it is
    alone.submit(third)
    here, there = pipeline.extrapolate(), on_another_thread(alone.extrapolate)  # handed over between calls
    assert np.array_equal(here.numpy("color"), on_another_thread(there.numpy, "color"))


def test_several_threads_read_one_frame(device):
    """PoCL 3.1 crashed where two threads mapped one buffer."""
    pipeline = Pipeline(device, W, H, Options(shading_correction=False))
    for frame in frames(2):
        pipeline.submit(frame)
    made = pipeline.extrapolate()
    expected = made.numpy("color")

    def read(_):
        for _ in range(300):
            with made.mapped("color") as color:
                assert np.array_equal(color, expected)

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(read, range(4)))


def test_buffers_of_earlier_options_are_refused(device):
    pipeline = Pipeline(device, W, H, Options(shading_correction=False))
    pipeline.submit(next(frames(1)))
    pipeline.extrapolate()
    held = [(owner, spec) for owner, spec in pipeline.named_buffers() if owner.name == "history"]
    pipeline.change_options(Options(shading_correction=False, levels=2))
    assert held
    for owner, spec in held:
        with pytest.raises(GffeError, match=rf"history\.{spec.name}: the pipeline has dropped this buffer"):
            owner.read(spec.name)
