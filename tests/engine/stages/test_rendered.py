"""Stages of a rendered frame, bit for bit, for all numbers of lanes and images smaller than a lane's reach."""

import numpy as np
import pyopencl as cl
import pytest
import twins
from device_arrays import copy_to
from synthetic import Rect, Rects, camera
from test_twins import frames

from gffe_cl.captures.sequence.encoding import Encoding
from gffe_cl.engine.frame.rendered_frame import host_arrays
from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.base import Board, Step
from gffe_cl.engine.stages.buffers import DeviceFrame, Sizes
from gffe_cl.engine.stages.connectivity import Connectivity
from gffe_cl.engine.stages.frame_block import FRAME, reprojection
from gffe_cl.engine.stages.history import HistoryTracking

SIZES = [(1, 1), (2, 5), (8, 1), (13, 9), (16, 12), (61, 37)]


@pytest.fixture(params=[8, 1])
def lanes(request, device, monkeypatch):
    monkeypatch.setitem(device.__dict__, "lanes", request.param)


def uneven_depth(rng, width, height):
    """Planes, steps of depth of all sizes, sky, bad values."""
    y, x = np.mgrid[:height, :width]
    depth = (8 + 0.3 * x + 0.05 * y * rng.uniform(0, 1)) * (
        1 + rng.choice([0, 0.0195, 0.02, 0.021, 0.12], (height, width))
    )
    smooth = rng.random((height, width)) < np.where(x % 32 < 20, 0.999, 0.5)
    depth = np.where(smooth, 9 + 0.01 * y + 0.02 * x, depth).astype(np.float32)
    for value in (np.inf, np.nan, 0, -2, 1e30, 1e-30):
        depth[rng.random((height, width)) < 0.01] = value
    depth[: height // 4] = np.inf
    return depth


def uploaded(device, array):
    buffer = device.buffer(array.nbytes)
    cl.enqueue_copy(device.queue, buffer, array)
    return buffer


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_surfaces(device, lanes, size):
    """Where depth jumps, and where it does not."""
    width, height = size
    rng = np.random.default_rng(width)
    board = Board(device, Sizes(size, size))
    stage = Connectivity(board)
    block = np.zeros(1, FRAME)
    block["source_width"], block["source_height"], block["has_previous"], block["collects"] = width, height, 1, 1
    for k in range(4):
        depth = uneven_depth(rng, width, height)
        dynamic = (rng.random((height, width)) < 0.02 * (k > 1)).astype(np.uint8)
        given = {"depth": uploaded(device, depth), "dynamic_mask": uploaded(device, dynamic)}
        state, keys = np.full((height, width), 7, np.uint8), np.zeros((height, width), np.uint64)
        pushed = {name: uploaded(device, keys) for name in ("push_keys", "push_winners")}
        written = {"state": uploaded(device, state), "fill_keys": uploaded(device, keys)}
        given |= written | pushed | {"fill_winners": uploaded(device, keys)}
        stage.launch("find_links", frame=uploaded(device, block), **given)
        cl.enqueue_copy(device.queue, state, written["state"])
        cl.enqueue_copy(device.queue, keys, written["fill_keys"])
        assert np.array_equal(stage.read("links"), twins.link_surfaces(depth, dynamic)), k
        assert np.array_equal(state, twins.unmixed(depth, dynamic)), k
        emptied = keys.view(np.uint32 if len(stage.passes) > 1 else np.uint64).ravel()[: state.size]
        assert (~emptied[state.ravel() == 0] == 0).all()
        cl.enqueue_copy(device.queue, keys, pushed["push_keys"])
        emptied = keys.view(emptied.dtype).ravel()
        level1 = -(-width // 2) * -(-height // 2)
        assert (~emptied[:level1] == 0).all() and not emptied[level1:].any()


@pytest.mark.parametrize("positions", [2, 4])
@pytest.mark.parametrize("size", SIZES, ids=str)
def test_history(device, lanes, size, positions):
    """Masks and thresholds over four frames; the histogram begins each frame empty, and nothing is known of what is
    static, or has become so."""
    width, height = size
    board = Board(device, Sizes(size, size), Options(history=positions, order=1))
    stage = HistoryTracking(board)
    past = dynamic = history = None
    for frame in frames(width, height, 5):
        host = host_arrays(frame).in_device_layout()
        board.previous = board.rendered
        board.rendered = DeviceFrame.allocate(device, size, frame.camera, frame.camera, frame.time)
        copy_to(device, board.rendered, host)
        stage.swap()
        stage.rendered(Step(board.rendered, board.previous, []))
        if past is None:
            expected = *(np.zeros((height, width)) for _ in range(2)), np.zeros((positions - 1, height, width, 4))
        else:
            to_previous = reprojection(frame.camera, past.camera)
            histogram = twins.residual_histogram(frame.depth, frame.motion, to_previous)
            assert np.array_equal(stage.read("residual_histogram"), histogram)
            threshold, error = twins.static_threshold(frame.depth, frame.motion, to_previous)
            assert stage.read("static_threshold_squared") == threshold
            turned = to_previous, reprojection(past.camera, frame.camera)
            before = past.depth, dynamic, history
            expected = twins.track_history(
                frame.depth, frame.motion, positions, threshold, *turned, *before, error=error
            )
        dynamic, met, history = (stage.read(name) for name in ("dynamic_mask", "met_depth", "history"))
        assert np.array_equal(dynamic, expected[0])
        assert np.array_equal(met > 0, expected[1] > 0) and np.allclose(met, expected[1], rtol=1e-5)
        if positions > 2:  # else the depth met is all that is stored
            assert np.array_equal(history[..., 3], expected[2][..., 3])
            assert np.allclose(history[:, dynamic > 0], expected[2][:, dynamic > 0], rtol=1e-5, atol=1e-5)
        past = frame
    assert dynamic.any() or width * height < 200


@pytest.mark.parametrize(("lookups", "sign"), [(1, 1), (2, 1), (1, -1)])
def test_threshold_beside_quantization(device, lanes, lookups, sign):
    """Half floats of UV, counted either way: the steps of each component and sign are found, and how many of them were
    added; the static world stays static, and a mover of 3 px is dynamic."""
    width, height, encoding = 320, 180, Encoding.parse("half-uv")
    world = Rects([Rect((0, 0, 14), (40, 30)), Rect((0, 0, 6), (1.2, 1.2), velocity=(4, 0, 0))])
    board = Board(device, Sizes((width, height), (width, height)), Options())
    stage, past = HistoryTracking(board), None
    for k in range(2):
        view = camera(width, height, (0.02 * k, 0.02 * k, 0.6 * k))
        frame = world.frame(view, k / 30, width, height, past and (past.camera, past.time), reset=k == 0)
        mover = frame.depth < 10
        frame.motion = sum(sign * encoding.motion(sign * frame.motion / lookups) for _ in range(lookups))
        board.previous = board.rendered
        board.rendered = DeviceFrame.allocate(device, (width, height), view, view, frame.time)
        copy_to(device, board.rendered, host_arrays(frame).in_device_layout())
        stage.swap()
        stage.rendered(Step(board.rendered, board.previous, []))
        if past is None:
            past = frame
    threshold, error = twins.static_threshold(frame.depth, frame.motion, reprojection(frame.camera, past.camera))
    assert stage.read("static_threshold_squared") == threshold and threshold <= 0.25**2
    assert np.array_equal(stage.read("quantization_error").ravel(), error)
    steps = np.array(((1920 / 1024, 1920 / 2048)[::sign], (1080 / 1024, 1080 / 2048)[::sign])).ravel()
    assert np.allclose(error, lookups * steps / 2, rtol=0.07)
    dynamic = stage.read("dynamic_mask") > 0
    assert dynamic[mover].mean() > 0.9 and dynamic[~mover].mean() < 0.02, (
        dynamic[mover].mean(),
        dynamic[~mover].mean(),
    )
