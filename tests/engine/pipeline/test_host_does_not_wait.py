"""The host does not wait for a slow device: `submit` and `extrapolate` return while the device has not begun."""

from dataclasses import replace

import numpy as np
import pyopencl as cl
import pytest
from held_device import is_complete, wait_for, while_the_device_waits

from gffe_cl import Options, Pipeline
from gffe_cl.engine.core import validation
from gffe_cl.engine.frame import frame_format, rendered_frame
from gffe_cl.engine.pipeline import pipeline as pipeline_module
from gffe_cl.engine.selftest.scene import CUT, FPS, display_camera, frames
from gffe_cl.engine.stages import intake
from gffe_cl.engine.stages.commands import Commands

SIZE = (64, 36)


@pytest.fixture
def seen():
    return frames(*SIZE, count=CUT, samples=1)


def on(device, frame):
    """The frame in buffers of the device."""
    color = (
        np.concatenate([frame.color, np.zeros_like(frame.color[..., :1])], -1)
        if frame.color.shape[-1] == 3
        else frame.color
    )
    arrays = np.ascontiguousarray(color, np.float16), frame.depth, frame.motion
    flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
    buffers = [None if a is None else cl.Buffer(device.context, flags, hostbuf=np.ascontiguousarray(a)) for a in arrays]
    return replace(frame, color=buffers[0], depth=buffers[1], motion=buffers[2])


def make(pipeline, frame):
    time = frame.time + 0.5 / FPS
    return pipeline.extrapolate(display_camera(time, *SIZE), time)


def behind_a_gate(device, pipeline, frame, also):
    """Submit `frame` to a device that may not begin, do `also`, and wait for the event of `submit`."""

    def work(gate):
        done = pipeline.submit(frame, wait_for=[gate])
        also()
        assert not is_complete(done)
        return done

    wait_for(while_the_device_waits(device, work))


@pytest.mark.parametrize("detects", [True, False])
def test_submit_returns_before_the_device_has_begun(device, seen, detects):
    pipeline = Pipeline(device, *SIZE, Options(cut_detection=detects, shading_correction=False))
    for frame in seen[:-1]:
        pipeline.submit(on(device, frame))
        make(pipeline, frame)
    last = on(device, seen[-1])
    behind_a_gate(device, pipeline, last, lambda: None if detects else make(pipeline, last))


def test_arrays_are_copied_without_waiting(device, seen, monkeypatch):
    """... to a device with memory of its own, which reads pinned memory meanwhile: arrays may change at once."""
    monkeypatch.setitem(device.__dict__, "works_in_host_memory", False)
    options = Options(shading_correction=False)
    expected, found = Pipeline(device, *SIZE, options), Pipeline(device, *SIZE, options)
    for frame in seen[:-1]:
        for pipeline in (expected, found):
            pipeline.submit(frame)
    expected.submit(seen[-1])
    arrays = [np.array(getattr(seen[-1], name)) for name in ("color", "depth", "motion")]
    given = replace(seen[-1], color=arrays[0], depth=arrays[1], motion=arrays[2])

    def overwrite():
        for array in arrays:
            array[:] = 1

    behind_a_gate(device, found, given, overwrite)
    for name in ("color", "depth", "motion"):
        np.testing.assert_array_equal(make(expected, seen[-1]).numpy(name), make(found, seen[-1]).numpy(name))
    assert found.bad_pixels == expected.bad_pixels


def test_a_frame_of_buffers_costs_the_host_little(device, seen, monkeypatch):
    """Validation is entered once for each array, and for buffers never. In whatever order buffers come again, the
    bits are those of buffers that are new each time."""
    options = Options(shading_correction=False, cut_detection=False)
    again, anew, arrays = (Pipeline(device, *SIZE, options) for _ in range(3))
    sets = [on(device, seen[k]) for k in range(3)]
    entered = []
    for k, number in enumerate((0, 1, 2, 0, 1, 0, 1, 0, 1)):
        frame = replace(seen[number], time=k / FPS, reset=k in (0, 5))
        buffers = {name: getattr(sets[number], name) for name in ("color", "depth", "motion")}
        of_buffers = replace(frame, **buffers)
        with monkeypatch.context() as patch:
            for name in (name for name in vars(validation) if name.startswith("require_")):
                for module in (intake, rendered_frame, frame_format, pipeline_module):
                    if function := vars(module).get(name):
                        patch.setattr(
                            module, name, lambda *a, f=function, **more: (entered.append(f), f(*a, **more))[1]
                        )
            again.submit(of_buffers)
            assert not entered
            arrays.submit(frame)
            assert len(entered) == 3
            entered.clear()
        anew.submit(replace(frame, **{name: getattr(on(device, frame), name) for name in buffers}))
        made = [make(pipeline, frame).numpy("color") for pipeline in (again, anew)]
        np.testing.assert_array_equal(*made)


def test_commands_are_repeated_for_buffers_of_any_number(device, monkeypatch):
    """Three sets in turn, as an engine has them, or new ones for each frame: with the bits of arrays."""
    clip, count = frames(*SIZE, count=11, samples=1), 0
    options = Options(cut_detection=False, shading_correction=False)
    pipeline, alone = Pipeline(device, *SIZE, options), Pipeline(device, *SIZE, options)
    repeat, sets = Commands.repeat, [on(device, clip[k]) for k in range(3)]

    def counted(*arguments):
        nonlocal count
        count += 1
        return repeat(*arguments)

    for k, frame in enumerate(clip):
        arrays, given = on(device, frame), sets[k % 3]
        if k < 7:
            for name in ("color", "depth", "motion"):
                of, to = getattr(arrays, name), getattr(given, name)
                if of is not None and to is not None:
                    cl.enqueue_copy(device.queue, to, of)
            arrays = replace(frame, color=given.color, depth=given.depth, motion=given.motion)
        if k == 4:
            pipeline.keep(["warp.color"])
            pipeline.keep([])
        monkeypatch.setattr(Commands, "repeat", counted)
        pipeline.submit(arrays)
        made = make(pipeline, frame)
        monkeypatch.setattr(Commands, "repeat", repeat)
        alone.submit(frame)
        expected = make(alone, frame)
        for name in ("color", "depth", "motion", "filled_by"):
            assert np.array_equal(made.numpy(name), expected.numpy(name), equal_nan=True), (k, name)
    assert count >= 10


def test_an_unmarked_cut_is_one_in_the_frame_that_is_made_next(device, seen):
    """The first frame after a cut is made as after a marked one, whatever is asked first."""
    cut = replace(seen[-1], color=seen[-1].color[::-1, ::-1], depth=np.ascontiguousarray(seen[-1].depth[::-1] * 7))
    made = {}
    for marked in (True, False):
        pipeline = Pipeline(device, *SIZE, Options(shading_correction=False))
        for frame in seen[:-1]:
            pipeline.submit(frame)
            make(pipeline, frame)
        pipeline.submit(replace(cut, reset=marked))
        made[marked] = pipeline.extrapolate(None, cut.time + 0.5 / FPS).numpy("color")
        assert pipeline.is_cut != marked and pipeline.interval == pytest.approx(1 / pipeline.fps)
    np.testing.assert_array_equal(made[True], made[False])


def test_parts_of_buffers_begin_where_the_device_asks_for(device, seen, monkeypatch):
    """... and results do not depend on that."""
    made = {}
    for alignment in (device.alignment, 4096):
        monkeypatch.setitem(device.__dict__, "alignment", alignment)
        pipeline = Pipeline(device, *SIZE, Options(levels=3, shading_correction=False))
        for frame in seen:
            pipeline.submit(frame)
            made[alignment] = make(pipeline, frame).numpy("color")
    starts = [buffer.offset for stage in pipeline.stages.values() for buffer in stage.buffer.values()]
    assert any(starts) and not any(start % 4096 for start in starts)
    first, last = made.values()
    np.testing.assert_array_equal(first, last)
