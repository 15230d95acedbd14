"""A camera that rests: blocks in which nothing stirs are skipped, and copied, with the bits that all kernels would have
made of them."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic import Rect, Rects, camera

from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.buffers import BLOCK
from gffe_cl.engine.stages.frame_block import FRAME, MOST_NUMBER, BlockWriter
from gffe_cl.engine.stages.warp import COPIED

W, H, FRAMES = 131, 75, 6
ROOM = Rects(
    [
        Rect((0, 0, 12), (9, 5), frequency=0.3),
        Rect((1.8, 0.6, 7), (1.2, 1.0), frequency=1),
        Rect((-2, -1, 6), (0.5, 0.7), velocity=(4, 1, 0), frequency=2, tint=(4, 5, 9)),
    ]
)
# How blocks are called, and the codes of colors that nobody mixes; all else is the same.
NAMES = {"backward_blocks.smooth", "backward_blocks.block_class", "backward_blocks.reach", "color_code.codes"}


def rendered(seen, spoil=False):
    """Yield frames of the room through the cameras `seen`; with `spoil` some depth is invalid in the middle ones."""
    previous = None
    for k, view in enumerate(seen):
        frame = ROOM.frame(view, k / 30, W, H, previous, reset=k == 0)
        previous = view, k / 30
        if spoil and 2 <= k <= 4:
            frame.depth[40:42, 100:103] = (np.nan, 0, -2)
        yield frame


def buffers_of(pipeline):
    return {f"{owner.name}.{spec.name}": owner.read(spec.name) for owner, spec in pipeline.named_buffers()}


def without_rests(monkeypatch):
    """Make kernels believe that every camera moves."""
    write = BlockWriter.write

    def moving(self, *given):
        made = write(self, *given)
        for name in ("rests", "stays"):
            made[FRAME.fields[name][1] // 4] = 0.0
        return made

    monkeypatch.setattr(BlockWriter, "write", moving)


CAMERA = camera(W, H, (0.1, 0, 0), 0.03, 0.01)
# A camera that rests; that stops, and is pushed on; and options that change what blocks bring along.
CASES = {
    "rests": ([CAMERA] * FRAMES, Options()),
    "stops": ([*(camera(W, H, (0.1 * k, 0, 0.1)) for k in range(3)), *[CAMERA] * 3, camera(W, H)], Options()),
    "levels": ([CAMERA] * FRAMES, Options(levels=3, history=4, order=3)),
    "plain": ([CAMERA] * FRAMES, Options(levels=0, soft_silhouettes=False, static_threshold=0.005)),
}


@pytest.mark.parametrize("case", CASES)
def test_bits_are_those_of_all_kernels(device, lanes, monkeypatch, case):
    """Of two new frames after each rendered one, with the predicted camera and with one that moves on."""
    seen, options = CASES[case]
    options = replace(options, shading_correction=False)
    pipelines, found, copied = [Pipeline(device, W, H, options) for _ in range(2)], [[], []], []
    for kind, pipeline in enumerate(pipelines):
        if kind:
            without_rests(monkeypatch)
        for frame in rendered(seen, spoil=True):
            pipeline.submit(frame)
            for to in (None, seen[0]):
                pipeline.extrapolate(to, frame.time + 0.015)
                found[kind].append(buffers_of(pipeline))
                copied.append((found[kind][-1]["backward_blocks.block_class"] == COPIED).mean())
    for number, (ours, expected) in enumerate(zip(*found, strict=True)):
        for name in expected.keys() - NAMES:
            assert ours[name].tobytes() == expected[name].tobytes(), f"{name} of new frame {number}"
    copied = np.reshape(copied, (2, -1))
    assert copied[0].max() > 0.6 and not copied[1].any()


def test_a_still_frame_is_the_rendered_one(device, lanes):
    still = next(rendered([CAMERA]))
    pipeline = Pipeline(device, W, H, Options(shading_correction=False))
    for k in range(5):
        pipeline.submit(replace(still, motion=np.zeros((H, W, 2), np.float32), time=k / 30, reset=k == 0))
        made = pipeline.extrapolate()
        classes = pipeline.stages["backward_blocks"].read("block_class")
        assert (classes[:, : W // 8] == (COPIED if k else classes[:, : W // 8])).all()
        assert np.array_equal(made.numpy("color")[..., :3], still.color)
        assert np.array_equal(made.numpy("depth"), still.depth)
        assert not any(made.numpy(name).any() for name in ("motion", "dynamic", "disoccluded", "filled_by"))


def last_stir(before, number, depth, dynamic, depth_prev):
    """Return (rows, columns) int32: the number of the last frame in which something stirred near each block, under a
    camera that rests. `before`: the same of the frame before; `depth_prev` None after a reset, when nothing is looked
    for."""
    height, width = depth.shape
    (side_x, side_y), reach = BLOCK, constants("history.cl")["STIR_REACH"]
    rows, columns = -(-height // side_y), -(-width // side_x)
    found = np.zeros((rows, columns), np.int32) if before is None else before.copy()
    if depth_prev is None:
        return found
    stirs = (dynamic > 0) | ~(depth > 0) | (depth != depth_prev)
    for by, bx in np.ndindex(rows, columns):
        y0, x0 = max(by * side_y - reach, 0), max(bx * side_x - reach, 0)
        if stirs[y0 : (by + 1) * side_y + reach, x0 : (bx + 1) * side_x + reach].any():
            found[by, bx] = number
    return found


def test_where_something_stirs(device, lanes):
    """The number of the last such frame, of each block, in NumPy; and the classes of blocks that follow."""
    pipeline, stirred, past = Pipeline(device, W, H, Options(shading_correction=False)), None, None
    for number, frame in enumerate(rendered([CAMERA] * FRAMES, spoil=True), 1):
        pipeline.submit(frame)
        dynamic = pipeline.stages["history"].read("dynamic_mask")
        stirred = last_stir(stirred, number, frame.depth, dynamic, past)
        assert np.array_equal(pipeline.stages["history"].read("last_stir"), stirred), number
        past = frame.depth
    pipeline.extrapolate()
    smooth, classes = (pipeline.stages["backward_blocks"].read(name) for name in ("smooth", "block_class"))
    assert np.array_equal(smooth == constants("backward_blocks.cl")["RESTING"], stirred != number)
    assert not (classes == COPIED)[stirred == number].any()
    assert 0.6 < (classes == COPIED).mean() < 0.95


def test_the_number_of_frames_begins_again(device):
    """After the largest one; nothing is taken for known then."""
    pipeline = Pipeline(device, W, H, Options(shading_correction=False))
    for frame in rendered([CAMERA] * 3):
        pipeline.submit(frame)
        if frame.reset:
            pipeline.frames.number = MOST_NUMBER
    found = pipeline.frames
    assert (found.number, found.rests, found.coded) == (2, 2, 0)
    pipeline.extrapolate()
    assert found.coded == 0 and (pipeline.stages["backward_blocks"].read("block_class") == COPIED).any()
    pipeline.extrapolate(camera(W, H))
    assert found.coded == 1


def test_colors_are_encoded_after_a_new_frame_that_failed(device, monkeypatch):
    """A stage fails before colors are encoded: the next new frame has the bits of one that nothing went before."""
    colors = []
    for fails in (False, True):
        pipeline = Pipeline(device, W, H, Options(shading_correction=False))
        for frame in rendered([camera(W, H, (0.1 * k, 0, 0.1)) for k in range(3)]):
            pipeline.submit(frame)
        if fails:
            with monkeypatch.context() as patch, pytest.raises(ZeroDivisionError):
                patch.setattr(pipeline.stages["prediction"], "extrapolated", lambda step: 1 / 0)
                pipeline.extrapolate()
        colors.append(pipeline.extrapolate().numpy("color"))
    assert colors[0].tobytes() == colors[1].tobytes()
