"""Forked children: their parent's OpenCL devices are refused in one line, since drivers would wait forever there."""

import multiprocessing
import os
import subprocess
import sys

import numpy as np
import pytest
from scn_models import constant_model

import gffe_cl
from gffe_cl import Camera, GffeError, Options, Pipeline, RenderedFrame
from gffe_cl.engine.inference.layers import shapes_at
from gffe_cl.engine.inference.network import load_network

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


ONLY_OPENED = """
import os, sys
import numpy as np
import gffe_cl
device = gffe_cl.open_device(sys.argv[1])
if os.fork():
    sys.exit(os.waitstatus_to_exitcode(os.wait()[1]))
try:
    camera = gffe_cl.Camera(np.eye(4), 300, 300, 160, 90)
    for own in (device, gffe_cl.open_device(sys.argv[1])):
        pipeline = gffe_cl.Pipeline(own, 320, 180, gffe_cl.Options(shading_correction=False))
        images = np.full((180, 320, 3), 0.5, np.float16), np.full((180, 320), 10, np.float32)
        pipeline.submit(gffe_cl.RenderedFrame(*images, np.zeros((180, 320, 2), np.float32), camera, 0.0, reset=True))
        print(pipeline.extrapolate(time=0.01).numpy("color").mean())
except gffe_cl.GffeError as error:
    print(error)
sys.stdout.flush()
os._exit(0)  # as multiprocessing ends children: NVIDIA's driver crashes where it is unloaded in one
"""


def test_a_parent_that_only_opened_the_device(device):
    """Its children work on Intel's CPU runtime, with a context of their own. PoCL has started its threads by then."""
    command = [sys.executable, "-c", ONLY_OPENED, device.info.index]
    said = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS, check=True).stdout.splitlines()
    if device.info.kind == "cpu" and "Intel" in device.info.platform:
        assert said == ["0.5", "0.5"]
    else:
        assert len(said) == 1 and "was opened before this process was forked" in said[0]


def test_other_things_work_in_a_fork():
    assert in_a_fork(lambda: Camera(np.eye(4), 30, 30, 16, 9).fx) == ("made", "30.0")


LEAVES = """
import os, sys
import numpy as np
import gffe_cl
device = gffe_cl.open_device(sys.argv[1])
camera = gffe_cl.Camera(np.eye(4), 30, 30, 16, 9)
images = np.full((18, 32, 3), 0.5, np.float16), np.full((18, 32), 10, np.float32), np.zeros((18, 32, 2), np.float32)
pipeline = gffe_cl.Pipeline(device, 32, 18, gffe_cl.Options(scn_model=sys.argv[3]))
pipeline.submit(gffe_cl.RenderedFrame(*images, camera, 0.0, reset=True))
made = pipeline.extrapolate(time=0.01)
child = os.fork()
if not child:
    if sys.argv[2] == "drops":
        del pipeline, made
        gffe_cl.engine.inference.network._loaded.clear()
    sys.exit(3)
assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 3
print(made.numpy("color").mean())
"""


@pytest.mark.parametrize("leaves", ["keeps", pytest.param("drops", marks=pytest.mark.long)])
def test_children_of_a_pipeline_with_the_network_end(device, leaves, tmp_path):
    """onnxruntime would wait for the threads of its session, which are the parent's."""
    if device.info.kind != "cpu":
        pytest.skip("drivers of GPUs may crash where they are unloaded in a child")
    command = [sys.executable, "-c", LEAVES, device.info.index, leaves, constant_model(tmp_path / "model.onnx")]
    said = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS, check=True).stdout
    assert said == "0.5\n"


def test_networks_are_loaded_again_in_a_fork(tmp_path):
    """The parent's session would wait forever for its threads."""
    model = constant_model(tmp_path / "model.onnx")
    parent = load_network(model)

    def run():
        network = load_network(model)
        network.run(*(np.zeros(shape[1:], np.float32) for shape in shapes_at(16, 16).values()))
        return network is not parent

    assert in_a_fork(run) == ("made", "True")
    assert load_network(model) is parent
