"""Measurement of the calling thread's processor time in `submit` and `extrapolate` (`gffe bench --host`)."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.timing.footage import FrameLoop

SIZE = (320, 180)  # pixels, by default: kernels are short there, and hide nothing


@dataclass
class HostTimes:
    """Median milliseconds of the calling thread's processor time in `submit` and in `extrapolate`, and their `sum`, of
    frames on the device. The device is idle before each call, so that no call waits."""

    width: int
    height: int
    submit: float
    extrapolate: float
    sum: float


def measure_host(
    device: Device, loop: FrameLoop, options: Options, pairs: int, on_pair: Callable[[], None]
) -> HostTimes:
    """Time `pairs` pairs of a rendered and a new frame of `loop`, and return the medians."""
    loop = loop.on(device)
    pipeline = Pipeline(device, loop.width, loop.height, options, render_size=loop.render_size)
    pipeline.exposure = loop.exposure
    taken: list[tuple[float, float]] = []
    for turn in loop.turns(pairs):
        calls = (
            lambda turn=turn: pipeline.submit(turn.frame),
            lambda turn=turn: pipeline.extrapolate(turn.camera, turn.time(loop.interval)),
        )
        times = [_processor_milliseconds(device, call) for call in calls]
        if turn.counts:
            taken.append((times[0], times[1]))
            on_pair()
    submitted, extrapolated = zip(*taken, strict=True)
    return HostTimes(
        loop.width,
        loop.height,
        statistics.median(submitted),
        statistics.median(extrapolated),
        statistics.median(map(sum, taken)),
    )


def _processor_milliseconds(device: Device, call: Callable[[], object]) -> float:
    device.queue.finish()
    start = time.thread_time()
    call()
    return 1e3 * (time.thread_time() - start)
