"""Cost of each stage, in milliseconds and in bytes per pixel (`gffe bench`).

Bytes per pixel = time × bandwidth ÷ display pixels. Bandwidth is that of copies between the timed frames, so the figure
means the same on every machine. Stage times are sums of kernel event times; the wall time of a frame stands beside.
"""

from __future__ import annotations

import math
import statistics
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pyopencl as cl

from gffe_cl.engine.frame.rendered_frame import KEPT_BYTES_PER_PIXEL
from gffe_cl.engine.frame.window import WindowChooser, fixed_window
from gffe_cl.engine.inference.network import reason
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.opencl.program import build
from gffe_cl.engine.options import PRESETS, Options
from gffe_cl.engine.pipeline.outputs import STAGES
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.base import Board, read_some_rows
from gffe_cl.engine.stages.buffers import DeviceFrame, Sizes
from gffe_cl.engine.stages.commands import milliseconds_of
from gffe_cl.engine.stages.correction import ShadingCorrection
from gffe_cl.engine.stages.memory import NoRoomError
from gffe_cl.engine.stages.presentation import Presentation
from gffe_cl.engine.timing.footage import FrameLoop, Turn

# Bytes per pixel of the paper's table at 1080p (RTX 4070 Ti Super, 672 GB/s), by our parts. The paper's own sum for GAE
# is 1400, with "misc".
PAPER = {
    "history": 337,
    "acceleration": None,
    "connectivity": None,
    "lattices": None,
    "background, collection": 366,
    "prediction": 71,
    "backward_blocks": None,
    "color_code": None,
    "warp": 259,
    "dilated_warp": None,
    "hidden_parts": None,
    "background, projection": 246,
    "holes": None,
    "silhouettes": None,
    "GAE": 1280,
    "misc": 120,
    "SCN, trend": None,
    "SCN, inputs": None,
    "SCN, flow": None,
    "SCN, convolutions": None,
    "SCN, kernels": None,
    "SCN, network": None,
    "SCN, copies": None,
    "SCN": 745,
}
# Parts of shading correction by stage.
SCN = {
    "shading_trend": "SCN, trend",
    "shading": "SCN, inputs",
    "network_input": "SCN, inputs",
    "shading_flow": "SCN, flow",
    "convolutions": "SCN, convolutions",
    "correction": "SCN, kernels",
    "network": "SCN, network",
    "network copies": "SCN, copies",
}
# Beside extrapolation: the window, and stages that make the picture of rendered frames, too.
_APART = {"misc", *(stage.name for stage in STAGES if "rendered" in stage.pictures)}
_COPY_BYTES = 256 << 20
_COPY_RUN = 64
_WINDOW = 1.2  # times the display, for presentation


@dataclass
class SizeBench:
    """Medians for one size: `milliseconds` and `bytes_per_pixel` by part, for one rendered frame with one
    extrapolated frame. `wall`: milliseconds from submitting the rendered frame to receiving the extrapolated one;
    `presets`: the same with each preset, None where its buffers need more memory than the device has.
    "GAE": sum of its stages by kernel events. "SCN": shading correction, where it is on: kernels by their events,
    network and transfers by wall time. "misc": the adaptive window, in none of the others: its choice on the host
    and the presentation of the display part."""

    width: int
    height: int
    milliseconds: dict[str, float]
    bytes_per_pixel: dict[str, float]
    wall: float
    presets: dict[str, float | None]
    bandwidth: float  # GB/s, read and written
    memory: int  # bytes of device memory: the pipeline's buffers and two rendered frames, motion of one only
    memory_gae: int  # without shading correction
    memory_by_stage: dict[str, int]  # bytes
    kernels: dict[str, float]  # milliseconds by "stage.kernel", all launches for the two frames together
    commands: dict[str, int]  # enqueued for the two frames: kernels, fills and copies; "GAE" and "SCN"
    provider: str = ""  # "opencl", or onnxruntime's name of the network's provider
    reason: str = ""  # why that runs the network
    remark: str = ""  # a remark for the user


class Copier:
    """The fastest way of copying 256 MiB on a device, by event times."""

    def __init__(self, device: Device):
        program = build(device, "copy")
        queue = device.queue
        a, b = (cl.Buffer(device.context, cl.mem_flags.READ_WRITE, _COPY_BYTES) for _ in range(2))
        cl.enqueue_fill_buffer(queue, a, b"\1", 0, _COPY_BYTES)
        floats = _COPY_BYTES // 4
        buffers = {"from": a, "to": b, "run": _COPY_RUN}
        self._ways = {
            "copy buffer": lambda: cl.enqueue_copy(queue, b, a),
            "scalar kernel": lambda: program.launch(queue, "copy_scalar", (floats,), None, buffers),
            "vector kernel": lambda: program.launch(queue, "copy_vector", (floats // 4,), None, buffers),
            "run kernel": lambda: program.launch(queue, "copy_run", (floats // 16 // _COPY_RUN,), None, buffers),
        }
        speeds = {name: max(self._gigabytes(name) for _ in range(3)) for name in self._ways}
        self.way = max(speeds, key=speeds.__getitem__)

    def bandwidth(self) -> float:
        """Return GB/s (read and written) of one copy now."""
        return self._gigabytes(self.way)

    def _gigabytes(self, name: str) -> float:
        event = self._ways[name]()
        event.wait()
        return 2 * _COPY_BYTES / max(event.profile.end - event.profile.start, 1)


@dataclass
class _Samples:
    """Times of the counted turns: milliseconds by part and by kernel, wall time, and GB/s of the copies in between."""

    parts: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    kernels: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    walls: list[float] = field(default_factory=list)
    bandwidths: list[float] = field(default_factory=list)
    commands: dict[str, int] = field(default_factory=dict)

    def medians(self) -> dict[str, float]:
        """Return milliseconds by part, with the sums."""
        return _with_sums({name: statistics.median(taken) for name, taken in self.parts.items()})


def bench_size(
    device: Device,
    copier: Copier,
    loop: FrameLoop,
    options: Options,
    repeats: int,
    on_pair: Callable[[], None] = lambda: None,
) -> SizeBench:
    """Time `repeats` frame pairs (one submitted from device buffers, one extrapolated) of `loop`, and return the
    medians."""
    loop = loop.on(device)
    presentation = Presentation(Board(device, Sizes((loop.width, loop.height), (loop.width, loop.height))))
    before = device.allocated
    pipeline = Pipeline(device, loop.width, loop.height, options, render_size=loop.render_size)
    pipeline.exposure = loop.exposure
    samples = _Samples()
    for turn in loop.turns(repeats):
        bandwidth = copier.bandwidth()
        device.queue.finish()
        _timed_pair(pipeline, loop, turn, samples)
        if turn.counts:
            if not loop.render_size:
                samples.parts["misc"].append(_windowing(device, presentation, turn))
            samples.bandwidths.append(bandwidth)
            on_pair()
    bandwidth = statistics.median(samples.bandwidths)
    milliseconds = samples.medians()
    pixels = loop.width * loop.height
    by_stage, allocated = memory(pipeline), device.allocated - before
    network = getattr(pipeline.stages.get(ShadingCorrection.name), "network", None)
    frames = KEPT_BYTES_PER_PIXEL * math.prod(loop.render_size or (loop.width, loop.height))
    return SizeBench(
        loop.width,
        loop.height,
        milliseconds,
        bytes_per_pixel={name: ms * 1e6 * bandwidth / pixels for name, ms in milliseconds.items()},
        wall=statistics.median(samples.walls),
        presets=_preset_times(device, loop, options, repeats),
        bandwidth=bandwidth,
        memory=allocated + frames,
        memory_gae=frames + sum(nbytes for name, nbytes in by_stage.items() if group(name) == "GAE"),
        memory_by_stage=by_stage,
        kernels={name: statistics.median(taken) for name, taken in samples.kernels.items()},
        commands=samples.commands,
        provider=network.provider if network else "",
        reason=reason(network, options.scn_provider, device.info.kind == "gpu") if network else "",
        remark=network.remark if network else "",
    )


def _preset_times(device: Device, loop: FrameLoop, options: Options, repeats: int) -> dict[str, float | None]:
    """Return the median milliseconds of `repeats` pairs with each preset, which keeps all options that no preset sets;
    None where there is too little memory."""
    usual = {name: getattr(Options(), name) for preset in PRESETS.values() for name in preset.values}
    usual["shading_correction"] = options.shading_correction
    times: dict[str, float | None] = {}
    for name, preset in PRESETS.items():
        made = replace(options, **usual | preset.values)
        try:
            pipeline = Pipeline(device, loop.width, loop.height, made, render_size=loop.render_size)
        except NoRoomError:
            times[name] = None
            continue
        pipeline.exposure, samples = loop.exposure, _Samples()
        for turn in loop.turns(repeats):
            device.queue.finish()
            _timed_pair(pipeline, loop, turn, samples)
        times[name] = statistics.median(samples.walls)
    return times


def growth(results: list[SizeBench]) -> float | None:
    """Return the x of time ~ pixels^x, by least squares over the sizes; None for one size. Time is that of GAE times
    the bandwidth meanwhile, so that a busy machine does not matter."""
    pixels = np.log([r.width * r.height for r in results])
    if np.ptp(pixels) == 0:
        return None
    return float(1 + np.polyfit(pixels, np.log([r.bytes_per_pixel["GAE"] for r in results]), 1)[0])


def _timed_pair(pipeline: Pipeline, loop: FrameLoop, turn: Turn, samples: _Samples) -> None:
    """Submit and extrapolate. Adds times to `samples` if the turn counts."""
    events: dict[str, dict[str, list]] = {}
    start = time.perf_counter()
    for when, work in (
        ("rendered", lambda: pipeline.submit(turn.frame)),
        ("extrapolated", lambda: pipeline.extrapolate(turn.camera, turn.time(loop.interval)).color),
    ):
        work()
        events[when] = pipeline.board.commands.take_events()
    pipeline.device.queue.finish()
    wall = (time.perf_counter() - start) * 1e3
    correction = pipeline.stages.get(ShadingCorrection.name)
    network = correction.take_network_milliseconds() if correction else {}
    if not turn.counts:
        return
    parts: dict[str, float] = defaultdict(float)
    kernels: dict[str, float] = defaultdict(float)
    commands: dict[str, int] = defaultdict(int)
    for stages in events.values():
        for stage, done in stages.items():
            for kernel, event in done:
                ms = (event.profile.end - event.profile.start) * 1e-6
                kernels[f"{stage}.{kernel}"] += ms
                parts[part(stage)] += ms
                commands[group(stage)] += 1
    parts |= {SCN[name]: milliseconds for name, milliseconds in network.items()}
    for taken, into in ((parts, samples.parts), (kernels, samples.kernels)):
        for name, milliseconds in taken.items():
            into[name].append(milliseconds)
    samples.walls.append(wall)
    samples.commands = dict(commands)


def _with_sums(parts: dict[str, float]) -> dict[str, float]:
    """Return the parts in order, with sums: those of GAE in the paper's order, "GAE", what is apart, those of SCN,
    "SCN"."""
    parts = {name: parts[name] for name in (*(n for n in PAPER if n in parts), *(n for n in parts if n not in PAPER))}
    scn = {name: value for name, value in parts.items() if name in SCN.values()}
    apart = {name: value for name, value in parts.items() if name in _APART}
    gae = {name: value for name, value in parts.items() if name not in scn and name not in apart}
    return gae | {"GAE": math.fsum(gae.values())} | apart | (scn | {"SCN": math.fsum(scn.values())} if scn else {})


def _windowing(device: Device, presentation: Presentation, turn: Turn) -> float:
    """Return the milliseconds of an adaptive window per rendered frame: its choice on the host, with the nearest
    depth read back, and the presentation of its display part."""
    size = presentation.sizes.target
    windows = WindowChooser("adaptive", size, [0.5])
    assert turn.before is not None
    start = time.perf_counter()
    windows.observe(read_some_rows(device, turn.frame.depth, size))
    windows.choose(turn.frame.camera, turn.before.camera)
    host = (time.perf_counter() - start) * 1e3
    now, before = (
        DeviceFrame(f.color, f.depth, f.motion, fixed_window(_WINDOW).camera(f.camera, size), f.camera, f.time)
        for f in (turn.frame, turn.before)
    )
    presentation.present(now, before)
    device.queue.finish()
    taken = milliseconds_of(presentation.board.commands.take_events())
    return host + sum(taken[presentation.name].values())


def group(stage: str) -> str:
    """Return the group of a stage in tables: "GAE", "SCN", or its own name."""
    return "SCN" if stage in SCN else stage if stage in _APART else "GAE"


def part(stage: str) -> str:
    """Return the name of a stage's work in tables."""
    return {"background": "background, collection", "projection": "background, projection", **SCN}.get(stage, stage)


def memory(pipeline: Pipeline) -> dict[str, int]:
    """Return bytes of device memory by stage, and "frame" for the extrapolated frame; rendered frames apart."""
    board = pipeline.board
    owners = {"frame": board.frame, board.blocks.name: board.blocks} | pipeline.stages
    return {name: owner.nbytes for name, owner in owners.items()}
