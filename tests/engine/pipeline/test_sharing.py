"""A device is shared, or fails: pipelines on threads and in processes do not disturb each other, and a device without
memory, or that is lost, is an error that says so, after which a pipeline can be opened again."""

import gc
import json
import subprocess
import sys
import threading
import weakref

import numpy as np
import pyopencl as cl
import pytest
from shared_work import SIZES, work
from synthetic import camera

from gffe_cl import GffeError, RenderedFrame
from gffe_cl.engine.frame.rendered_frame import KEPT_BYTES_PER_PIXEL
from gffe_cl.engine.opencl.device import open_info
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.selftest.scene import CUT, frames


@pytest.fixture(scope="module")
def seen():
    return [frames(*size, count=CUT, samples=1) for size in SIZES]


def test_two_threads_share_a_device(device, seen):
    """... and its kernels, of the same size too: arguments of one launch must not meet those of another."""
    alone = [work(device, size, clip) for size, clip in zip(SIZES, seen, strict=True)]
    found, start = {}, threading.Barrier(3)

    def thread(number):
        start.wait()
        found[number] = work(device, SIZES[number % 2], seen[number % 2])

    threads = [threading.Thread(target=thread, args=(number,)) for number in range(3)]
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    try:
        for one in threads:
            one.start()
        for one in threads:
            one.join()
    finally:
        sys.setswitchinterval(interval)
    assert found == {0: alone[0], 1: alone[1], 2: alone[0]}


PROCESS = """
import json, sys
from gffe_cl.engine.opencl.device import open_device
from gffe_cl.engine.selftest.scene import CUT, frames
from shared_work import SIZES, work
device = open_device(sys.argv[1])
print("ready", flush=True)
sys.stdin.readline()
print(json.dumps([work(device, size, frames(*size, count=CUT, samples=1)) for size in SIZES]))
"""


def test_two_processes_share_a_device(device, seen):
    command = [sys.executable, "-c", PROCESS, device.info.index]
    here = {"text": True, "stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    children = [subprocess.Popen(command, **here) for _ in range(2)]
    assert [child.stdout.readline() for child in children] == ["ready\n"] * 2
    for child in children:
        child.stdin.write("go\n")
        child.stdin.flush()
    found = [json.loads(child.communicate(timeout=300)[0]) for child in children]
    alone = [work(device, size, clip) for size, clip in zip(SIZES, seen, strict=True)]
    assert found == [alone, alone]


@pytest.mark.parametrize(
    ("memory", "at_once", "said"),
    [
        (16 << 20, 1 << 60, r"640×360 takes \d+ MiB of the 16 MiB of "),
        (1 << 40, 2 << 20, r", \d+ MiB at once of 2 MiB "),
    ],
)
def test_too_large_for_a_device(device, memory, at_once, said):
    """Nothing is allocated for images that do not fit, and what is said to fit does."""
    small = open_info(device.info)
    small.memory, small.largest_buffer = memory, at_once
    with pytest.raises(GffeError, match=said + r".*expected at most about (\d+)×(\d+)") as told:
        Pipeline(small, 640, 360)
    assert small.allocated < 4 << 20
    width, height = (int(side) for side in str(told.value).rpartition("about ")[2].split(" ")[0].split("×"))
    pipeline = Pipeline(small, width, height)
    pipeline.submit(frames(width, height, count=1, samples=1)[0])
    pipeline.extrapolate().numpy("color")
    taken = pipeline._nbytes + KEPT_BYTES_PER_PIXEL * width * height
    largest = max(buffer.size for stage in pipeline.stages.values() for buffer in stage.buffer.values())
    assert 0.75 < max(taken / memory, largest / at_once) <= 1 and width / height == pytest.approx(16 / 9, rel=0.01)


@pytest.mark.long
@pytest.mark.parametrize("size", [(7680, 4320), (16384, 1024)])
def test_large_images(device, size):
    """A still picture stays as it is, to its last pixels."""
    if device.memory < 8 << 30:
        pytest.skip("too little memory")
    pipeline = Pipeline(device, *size, Options(shading_correction=False))
    color = np.random.default_rng(0).random((size[1], size[0], 3)).astype(np.float16)
    depth, motion = np.full(color.shape[:2], 5, np.float32), np.zeros((*color.shape[:2], 2), np.float16)
    for k in range(2):
        pipeline.submit(RenderedFrame(color, depth, motion, camera(*size), k / 30, reset=k == 0))
    assert np.array_equal(pipeline.extrapolate().numpy("color"), color)


def test_a_driver_that_refuses_memory(device):
    small = open_info(device.info)
    for most in (small.memory, 1 << 60):  # unasked, and asked
        small.memory = small.largest_buffer = most
        with pytest.raises(GffeError, match="cannot allocate 4194304 MiB"):
            small.buffer(1 << 42)


@pytest.fixture
def no_collector():
    """What is freed now is freed because nobody has it."""
    gc.collect()
    gc.disable()
    yield
    gc.enable()


def test_memory_goes_with_the_pipeline(device, seen, no_collector):
    """... at once: the garbage collector comes seldom where there are few objects, however large what they hold."""
    pipeline = Pipeline(device, *SIZES[0], Options(shading_correction=False))
    pipeline.submit(seen[0][0])
    made = pipeline.extrapolate()
    stages = [weakref.ref(stage) for stage in pipeline.stages.values()]
    del pipeline
    assert stages and not any(stage() for stage in stages)
    assert np.isfinite(made.numpy("color")).all()  # its buffers are its own


def test_memory_goes_with_a_pipeline_that_is_refused(device, monkeypatch, no_collector):
    taken = []

    def allocate(self, specs):
        if len(taken) == 4:
            raise GffeError("no more")
        taken.append(weakref.ref(self))
        return {}

    monkeypatch.setattr("gffe_cl.engine.stages.buffers.Owner.allocate", allocate)
    with pytest.raises(GffeError, match="no more"):
        Pipeline(device, *SIZES[0])
    assert len(taken) == 4 and not any(stage() for stage in taken)


def driver_error(device):
    """As a driver would give it."""
    try:
        cl.Buffer(device.context, cl.mem_flags.READ_WRITE, 0)
    except cl.Error as error:
        return error
    raise AssertionError


def test_a_device_that_is_lost(device, seen, monkeypatch):
    """Errors of the driver are one line, what had been made before stays, and a new pipeline works."""
    lost = open_info(device.info)
    assert open_info(device.info).context == lost.context and open_info(device.info).programs is lost.programs
    pipeline = Pipeline(lost, *SIZES[0])
    pipeline.submit(seen[0][0])
    made = pipeline.extrapolate()
    expected = made.numpy("color")
    with monkeypatch.context() as patch:
        error = driver_error(lost)

        def fail(*_, **__):
            raise error

        patch.setattr("gffe_cl.engine.stages.base.Board.perform", fail)
        for work_on in (lambda: pipeline.submit(seen[0][1]), pipeline.extrapolate):
            said = r"(submit|extrapolate) failed: .*64×36 takes .* MiB of the .*new pipeline"
            with pytest.raises(GffeError, match=said) as told:
                work_on()
            assert "\n" not in str(told.value)
        patch.setattr(cl, "enqueue_copy", fail)
        with pytest.raises(GffeError, match=r'reading "depth" failed: .* 64×36: the device'):
            made.numpy("depth")
    assert open_info(device.info).context != lost.context
    again = Pipeline(open_info(device.info), *SIZES[0])
    again.submit(seen[0][0])
    assert np.array_equal(again.extrapolate().numpy("color"), expected)
