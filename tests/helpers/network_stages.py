"""The stages around the shading correction network, on images made up of everything that a frame may hold."""

from dataclasses import replace

import numpy as np
import pyopencl as cl
from device_arrays import copy_to, of_arrays
from held_device import while_the_device_waits
from synthetic import camera

from gffe_cl import Options
from gffe_cl.engine.inference.layers import HEAD_WEIGHTS
from gffe_cl.engine.stages.base import Board, Step
from gffe_cl.engine.stages.buffers import DeviceFrame, Sizes
from gffe_cl.engine.stages.correction import ShadingCorrection
from gffe_cl.engine.stages.network import Convolutions, NetworkInput
from gffe_cl.engine.stages.shading import ShadingFlow, ShadingInputs, ShadingTrend

SIZES = [(61, 37), (64, 48), (1, 5), (7, 1), (1, 1), (33, 66)]


def put(stage, **arrays):
    """Copy arrays into buffers of a stage, by name."""
    for name, array in arrays.items():
        cl.enqueue_copy(stage.device.queue, stage.buffer[name], np.ascontiguousarray(array))


def images(size, rng):
    """Return images of a frame: colors (H, W, 4), and depth (H, W) of patches at many distances, which change a little
    with each call."""
    height, width = size[1], size[0]
    color = rng.lognormal(-1, 2, (height, width, 4)).astype(np.float16)
    for value in (0, -3, 60000, -0.0, 6e-8):
        color[rng.integers(height), rng.integers(width), rng.integers(3)] = value
    patches = np.random.default_rng(0).lognormal(1, 2, (height // 9 + 1, width // 21 + 1)).astype(np.float32)
    patches[rng.random(patches.shape) < 0.2] = np.inf
    depth = patches.repeat(9, 0).repeat(21, 1)[:height, :width]
    return color, np.ascontiguousarray(depth * rng.uniform(0.99, 1.01, depth.shape).astype(np.float32))


def made_stages(device, size, exposure=1.0, seed=1):
    """Return a board with the extrapolated frame and the stages around the network, and their inputs."""
    board, rng = Board(device, Sizes(size, size), Options()), np.random.default_rng(seed)
    now, before = (camera(*size, position) for position in ((0.02, 0.01, 0.005), (0, 0, 0)))
    color, depth = images(size, rng)
    motion = rng.uniform(-2, 2, (*depth.shape, 2)).astype(np.float32)
    color[rng.random(depth.shape) < 0.01] = np.nan
    motion[rng.random(depth.shape) < 0.1] = np.inf
    board.bindings.previous = DeviceFrame.allocate(device, size, before, before, 0.0)
    copy_to(device, board.bindings.previous, of_arrays(color, depth, motion))
    board.bindings.rendered = board.bindings.previous
    frame, some = board.frame, rng.random((2, *depth.shape)) < 0.1
    color, depth = images(size, rng)
    put(frame, color=color, depth=depth, motion=motion[::-1])
    put(frame, dynamic=some[0].astype(np.uint8), disoccluded=some[1].astype(np.uint8))
    step = Step(board.bindings.rendered, board.bindings.previous, [1.0, 0.0], now, 1.5, 0.5, exposure)
    for stage in (ShadingInputs, ShadingTrend, NetworkInput, ShadingFlow, Convolutions):
        stage(board)
    correction = ShadingCorrection(board, load=False)
    trends = board.stages["shading_trend"]
    put(trends, trends=rng.normal(0, 0.05, trends.spec("trends").shape(board.sizes)).astype(np.float32))
    put(correction, head=rng.normal(0, 0.3, HEAD_WEIGHTS).astype(np.float32))
    return board, correction, step


def moving_frames(size, rng):
    """Return (8, h, w): a smooth pattern that moved by (3, −1.6) pixels from the previous frame on, with noise
    below."""
    (width, height), shift = size, (3.0, -1.6)
    y, x = np.mgrid[:height, :width].astype(np.float32)
    frames = rng.random((8, height, width)).astype(np.float32)
    for k, (dx, dy) in ((0, (0, 0)), (3, shift)):
        for c in range(3):
            frames[k + c] = 0.5 + 0.1 * (np.sin((x - dx) / 5) + np.cos((y - dy) / 6) + np.sin((x - dx + y - dy) / 8))
    frames[:6, height // 2 :] += rng.normal(0, 0.02, (6, height - height // 2, width)).astype(np.float32)
    return frames


def made_before_the_device_begins(pipeline, frame):
    """Return the new frame that is made while the device has not begun with `frame`, of arrays; the host must not
    wait."""
    device, size = pipeline.device, frame.depth.shape[::-1]
    buffers = DeviceFrame.allocate(device, size, frame.camera, frame.camera, frame.time)
    color = np.concatenate([frame.color, np.zeros_like(frame.color[..., :1])], -1)
    copy_to(device, buffers, of_arrays(color, frame.depth, frame.motion))
    frame = replace(frame, **{name: getattr(buffers, name) for name in ("color", "depth", "motion")})

    def make(gate):
        pipeline.submit(frame, wait_for=[gate])
        return pipeline.extrapolate()

    return while_the_device_waits(device, make)
