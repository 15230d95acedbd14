"""What each stage costs, in milliseconds and in bytes per pixel (`gffe bench`).

Bytes per pixel = time × bandwidth ÷ display pixels. Bandwidth is what copying reaches in between the timed
frames, so the figure means the same on every machine. Stage times are sums of kernel event times; the wall
time of a frame stands beside.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pyopencl as cl

from gffe_cl.buffers import DeviceFrame
from gffe_cl.camera import Camera
from gffe_cl.evaluation import traffic
from gffe_cl.frame import BYTES_PER_PIXEL, RenderedFrame
from gffe_cl.opencl.device import Device
from gffe_cl.opencl.program import build
from gffe_cl.options import Options
from gffe_cl.pipeline import Pipeline
from gffe_cl.scenes import SceneRenderer, load_scene
from gffe_cl.stage import Board, read_some_rows
from gffe_cl.stages.presentation import Presentation
from gffe_cl.window import WindowChooser, fixed_window

# Bytes per pixel of the paper's table at 1080p (RTX 4070 Ti Super, 672 GB/s), by our parts.
PAPER = {
    "history": 337,
    "surfaces": None,
    "background, collection": 366,
    "prediction": 71,
    "warp": 259,
    "background, projection": 246,
    "holes": None,
    "misc": 120,
    "GAE": 1400,
    "SCN, inputs": None,
    "SCN, kernels": None,
    "SCN, network": None,
    "SCN": 745,
}
_SCN = {"shading": "SCN, inputs", "correction": "SCN, kernels", "network": "SCN, network"}  # parts by timing
_COPY_BYTES = 256 << 20
_COPY_RUN = 64
_SCENE, _START = "plaza", 1.0
_WARM_UP = 3
_WINDOW = 1.2  # times the display, for presentation


@dataclass
class SizeBench:
    """Medians for one size: `milliseconds` and `bytes_per_pixel` by part, for one rendered frame with one
    extrapolated frame; "misc" is the adaptive window: choosing it and presenting the display part; `wall` is
    milliseconds from submitting the one to having the other, "misc" apart;
    "GAE" is the sum of these, "SCN" that of what shading correction adds, where it is on: kernels by their events, the
    network by its wall time."""

    width: int
    height: int
    milliseconds: dict[str, float]
    bytes_per_pixel: dict[str, float]
    wall: float
    bandwidth: float  # GB/s, read and written
    memory: int  # bytes of device memory: the pipeline's buffers and two rendered frames
    must_move: dict[str, float]  # bytes per pixel by part, as the stages declare (`traffic`)
    shares: dict[str, float]  # of the pixels, by which they declare it
    memory_by_stage: dict[str, int]  # bytes


class Copier:
    """The fastest way of copying 256 MiB on a device, by event times."""

    def __init__(self, device: Device):
        program = build(device, "copy")
        queue = device.queue
        a, b = (cl.Buffer(device.context, cl.mem_flags.READ_WRITE, _COPY_BYTES) for _ in range(2))
        cl.enqueue_fill_buffer(queue, a, np.uint8(1), 0, _COPY_BYTES)
        floats = _COPY_BYTES // 4
        buffers = {"from": a, "to": b, "run": _COPY_RUN}
        self._ways = {
            "copy buffer": lambda: cl.enqueue_copy(queue, b, a),
            "scalar kernel": lambda: program.launch(queue, "copy_scalar", (floats,), None, buffers),
            "vector kernel": lambda: program.launch(queue, "copy_vector", (floats // 4,), None, buffers),
            "run kernel": lambda: program.launch(queue, "copy_run", (floats // 16 // _COPY_RUN,), None, buffers),
        }
        speeds = {name: max(self._gigabytes(name) for _ in range(3)) for name in self._ways}
        self.way = max(speeds, key=speeds.get)

    def bandwidth(self) -> float:
        """GB/s (read and written) of one copy now."""
        return self._gigabytes(self.way)

    def _gigabytes(self, name: str) -> float:
        event = self._ways[name]()
        event.wait()
        return 2 * _COPY_BYTES / max(event.profile.end - event.profile.start, 1)


def bench_size(
    device: Device,
    copier: Copier,
    width: int,
    height: int,
    options: Options,
    repeats: int,
    on_frame: Callable[[], None] = lambda: None,
) -> SizeBench:
    """Time `repeats` frame pairs (one submitted from device buffers, one extrapolated) of a built-in scene."""
    before = device.allocated
    frames, target = _scene_frames(device, width, height)
    pipeline = Pipeline(device, width, height, options)
    pipeline.exposure = load_scene(_SCENE).exposure
    memory = device.allocated - before
    presentation = Presentation(Board(device, pipeline.sizes))
    samples: dict[str, list[float]] = {}
    walls, bandwidths = [], []
    for k in range(_WARM_UP + repeats):
        frame = frames[k % 2]
        frame.time, frame.reset = k / 30, k == 0
        bandwidth = copier.bandwidth()
        device.queue.finish()
        start = time.perf_counter()
        pipeline.submit(frame)
        collection = _milliseconds(pipeline, "background")
        pipeline.extrapolate(target, frame.time + 0.5 / 30)
        device.queue.finish()
        wall = (time.perf_counter() - start) * 1e3
        parts = pipeline.take_timings()
        parts["misc"] = _windowing(device, presentation, frames, k % 2)
        if "background" in parts:
            parts["background, collection"] = collection
            parts["background, projection"] = parts.pop("background")
        parts = {_SCN.get(name, name): milliseconds for name, milliseconds in parts.items()}
        if k >= _WARM_UP:
            walls.append(wall)
            bandwidths.append(bandwidth)
            for name, milliseconds in parts.items():
                samples.setdefault(name, []).append(milliseconds)
        on_frame()
    bandwidth = statistics.median(bandwidths)
    order = [name for name in PAPER if name in samples] + [name for name in samples if name not in PAPER]
    milliseconds = {name: statistics.median(samples[name]) for name in order}
    scn = {name: milliseconds.pop(name) for name in order if name in _SCN.values()}
    milliseconds["GAE"] = sum(milliseconds.values())
    if scn:
        milliseconds |= scn | {"SCN": sum(scn.values())}
    per_pixel = {name: ms * 1e6 * bandwidth / (width * height) for name, ms in milliseconds.items()}
    must_move, shares = _must_move(pipeline, frames[_WARM_UP + repeats & 1], target, _WARM_UP + repeats)
    by_stage = traffic.memory(pipeline)
    walls_ms = statistics.median(walls)
    return SizeBench(width, height, milliseconds, per_pixel, walls_ms, bandwidth, memory, must_move, shares, by_stage)


def _must_move(pipeline: Pipeline, frame: RenderedFrame, target: Camera, k: int) -> tuple[dict, dict]:
    """Bytes per pixel by part, "GAE" and "SCN" among them, of one more pair of frames; and the shares."""
    frame.time, frame.reset = k / 30, False
    rendered = traffic.launches_of(pipeline, lambda: pipeline.submit(frame))
    made = traffic.launches_of(pipeline, lambda: pipeline.extrapolate(target, frame.time + 0.5 / 30))
    shares = traffic.counters(pipeline)
    parts: dict[str, float] = {}
    for which, launches in (("collection", rendered), ("projection", made)):
        for stage, kernels in traffic.bytes_per_pixel(pipeline, launches, shares).items():
            name = f"background, {which}" if stage == "background" else _SCN.get(stage, stage)
            parts[name] = parts.get(name, 0.0) + sum(kernels.values())
    scn = {name: parts.pop(name) for name in list(parts) if name in _SCN.values()}
    parts["GAE"] = sum(parts.values())
    return parts | (scn | {"SCN": sum(scn.values())} if scn else {}), shares


def _windowing(device: Device, presentation: Presentation, frames: list[RenderedFrame], index: int) -> float:
    """Milliseconds of what an adaptive window adds to a rendered frame: choosing it (on the host, with the nearest
    depth read back) and presenting its display part."""
    size = presentation.sizes.target
    windows = WindowChooser("adaptive", size, [0.5])
    start = time.perf_counter()
    windows.observe(read_some_rows(device, frames[index].depth, size))
    windows.choose(frames[index].camera, frames[1 - index].camera)
    host = (time.perf_counter() - start) * 1e3
    now, before = (
        DeviceFrame(f.color, f.depth, f.motion, fixed_window(_WINDOW).camera(f.camera, size), f.camera, f.time)
        for f in (frames[index], frames[1 - index])
    )
    presentation.present(now, before)
    device.queue.finish()
    return host + presentation.take_milliseconds()


def _milliseconds(pipeline: Pipeline, name: str) -> float:
    """Kernel time of the stage `name` since it was last asked; waits for the device."""
    pipeline.device.queue.finish()
    stage = pipeline.stages.get(name)
    return stage.take_milliseconds() if stage else 0.0


def _scene_frames(device: Device, width: int, height: int) -> tuple[list[RenderedFrame], Camera]:
    """Two rendered frames, as device buffers, that are played back and forth, and the camera between them."""
    scene = load_scene(_SCENE)
    renderer = SceneRenderer(device, scene, width, height, samples=1)
    times = [_START, _START + 1 / 30]
    cameras = [scene.camera(t, width, height) for t in times]
    frames = []
    for k in range(2):
        image = renderer.render(times[k], cameras[k], times[1 - k], cameras[1 - k])
        buffers = tuple(device.buffer(size * width * height) for size in BYTES_PER_PIXEL)
        image.copy_to(buffers)
        frames.append(RenderedFrame(*buffers, cameras[k], times[k]))
    return frames, scene.camera(_START + 0.5 / 30, width, height)
