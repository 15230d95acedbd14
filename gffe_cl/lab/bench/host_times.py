"""Measurement of the calling thread's processor time in `submit` and `extrapolate` (`gffe bench --host`)."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.timing.footage import Footage

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
    device: Device, footage: Footage, options: Options, pairs: int, on_pair: Callable[[], None]
) -> HostTimes:
    """Time `pairs` pairs of a rendered and a new frame of `footage`, and return the medians."""
    footage = footage.on(device)
    pipeline = Pipeline(device, footage.width, footage.height, options, render_size=footage.render_size)
    pipeline.exposure = footage.exposure
    taken: list[tuple[float, float]] = []
    for turn in footage.turns(pairs):
        calls = (
            lambda turn=turn: pipeline.submit(turn.frame),
            lambda turn=turn: pipeline.extrapolate(turn.camera, turn.time(footage.interval)),
        )
        times = [_processor_milliseconds(device, call) for call in calls]
        if turn.counts:
            taken.append((times[0], times[1]))
            on_pair()
    submitted, extrapolated = zip(*taken, strict=True)
    return HostTimes(
        footage.width,
        footage.height,
        statistics.median(submitted),
        statistics.median(extrapolated),
        statistics.median(map(sum, taken)),
    )


def _processor_milliseconds(device: Device, call: Callable[[], object]) -> float:
    device.queue.finish()
    start = time.thread_time()
    call()
    return 1e3 * (time.thread_time() - start)
