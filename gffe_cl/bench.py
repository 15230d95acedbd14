"""What each stage costs, in milliseconds and in bytes per pixel (`gffe bench`).

Bytes per pixel = time × bandwidth ÷ display pixels; bandwidth is what copying reaches in between the timed frames, so the figure
means the same on every machine. Stage times are sums of kernel event times; the wall time of the frame stands beside them.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pyopencl as cl

from gffe_cl.device import Device
from gffe_cl.frame import RenderedFrame, pack_frame
from gffe_cl.pipeline import Options, Pipeline
from gffe_cl.program import build
from gffe_cl.scenes import SceneRenderer, load_scene, sequence_frames

# Bytes per pixel at 1080p in the paper's table (RTX 4070 Ti Super, 672 GB/s), by stage of ours.
PAPER = {
    "history": 337,
    "prediction": 71,
    "warp": 259,
    "background (collect)": 366,
    "background (project)": 246,
    "holes": 120,
}
_COPY_BYTES = 256 << 20
_COPY_RUN = 64
_SCENE = "plaza"
_WARM_UP = 3


@dataclass
class SizeBench:
    """Medians for one size: `milliseconds` and `bytes_per_pixel` by stage, rendered-frame stages once per
    extrapolated frame (n = 1); `wall` is milliseconds per frame pair from submit to finished."""

    width: int
    height: int
    milliseconds: dict[str, float]
    bytes_per_pixel: dict[str, float]
    wall: float
    bandwidth: float  # GB/s, read + write
    memory: int  # bytes of device memory allocated for the pipeline and two rendered frames


class Copier:
    """The fastest way of copying 256 MiB on a device."""

    def __init__(self, device: Device):
        self.device = device
        program = build(device, "copy")
        a, b = (device.buffer(_COPY_BYTES) for _ in range(2))
        queue = device.queue
        floats = _COPY_BYTES // 4
        self._ways = {
            "copy buffer": lambda: cl.enqueue_copy(queue, b, a),
            "scalar kernel": lambda: program.copy_scalar(queue, (floats,), None, a, b),
            "vector kernel": lambda: program.copy_vector(queue, (floats // 4,), None, a, b),
            "run kernel": lambda: program.copy_run(
                queue, (floats // 16 // _COPY_RUN,), None, a, b, np.int32(_COPY_RUN)
            ),
        }
        cl.enqueue_fill_buffer(queue, a, np.uint8(1), 0, _COPY_BYTES)
        speeds = {name: max(self._gigabytes(way) for _ in range(3)) for name, way in self._ways.items()}
        self.way = max(speeds, key=speeds.get)

    def bandwidth(self) -> float:
        """GB/s (read + written) of one copy now."""
        return self._gigabytes(self._ways[self.way])

    def _gigabytes(self, way) -> float:
        event = way()
        event.wait()
        return 2 * _COPY_BYTES / max(event.profile.end - event.profile.start, 1)


def bench_size(
    device: Device,
    width: int,
    height: int,
    options: Options,
    repeats: int,
    on_frame: Callable[[], None] = lambda: None,
) -> SizeBench:
    """Time `repeats` frame pairs (one submitted, one extrapolated) of a built-in scene at one size."""
    frames = _scene_frames(device, width, height)
    allocated = device.allocated
    pipeline = Pipeline(device, width, height, options)
    copier = Copier(device) if not hasattr(device, "_copier") else device._copier
    device._copier = copier
    inputs = [_upload(device, frame, width, height) for frame in frames]
    memory = device.allocated - allocated - (2 * _COPY_BYTES if copier is device._copier else 0)
    samples: dict[str, list[float]] = {}
    walls, bandwidths = [], []
    for k in range(_WARM_UP + repeats):
        source = inputs[k % 2]
        source.time = k / 30
        source.reset = k == 0
        bandwidths.append(copier.bandwidth())
        device.queue.finish()
        start = time.perf_counter()
        pipeline.submit(source)
        pipeline.extrapolate(frames[2].camera, source.time + 0.5 / 30)
        device.queue.finish()
        wall = (time.perf_counter() - start) * 1e3
        timings = pipeline.take_timings(split=True)
        if k >= _WARM_UP:
            walls.append(wall)
            for name, milliseconds in timings.items():
                samples.setdefault(name, []).append(milliseconds)
        on_frame()
    bandwidth = statistics.median(bandwidths[_WARM_UP:])
    milliseconds = {name: statistics.median(values) for name, values in samples.items()}
    per_pixel = {name: ms * 1e-3 * bandwidth * 1e9 / (width * height) for name, ms in milliseconds.items()}
    return SizeBench(width, height, milliseconds, per_pixel, statistics.median(walls), bandwidth, memory)
