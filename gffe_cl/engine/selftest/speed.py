"""Quick measurement of copy bandwidth and GAE on a device; `gffe bench` measures with more care."""

from __future__ import annotations

import math

from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.options import Options
from gffe_cl.engine.selftest.scene import CUT, FPS, display_camera, frames
from gffe_cl.engine.timing.bench import Copier, SizeBench, bench_size
from gffe_cl.engine.timing.footage import FrameLoop

SIZE = (640, 360)  # width and height, pixels
_REPEATS = 5


def speed(device: Device) -> SizeBench:
    """Return medians over a few frames of the self-test's scene."""
    interval = 1 / FPS
    seen = tuple(frames(*SIZE, count=CUT, samples=1))
    cameras = tuple(display_camera(frame.time + interval / 2, *SIZE) for frame in seen)
    loop = FrameLoop("self-test", *SIZE, 1.0, interval, seen, cameras, forward=True)
    options = Options(shading_correction=False, cut_detection=False)
    return bench_size(device, Copier(device), loop, options, _REPEATS)


def figures(measured: SizeBench) -> dict[str, float]:
    """Return GB/s of copying (read and written), bytes per pixel and milliseconds of GAE."""
    found = {
        "bandwidth": measured.bandwidth,
        "bytes_per_pixel": measured.bytes_per_pixel["GAE"],
        "milliseconds": measured.milliseconds["GAE"],
    }
    return {name: value for name, value in found.items() if math.isfinite(value)}
