"""Soak: thousands of frames of mixed content through one pipeline. Memory must not grow, and results stay the same.

    python docs/tools/soak.py --frames 20000

Runs on the default device (`GFFE_DEVICE` chooses another). Exit code 1 if memory grows by 1% or results differ.

The content is the self-test's, in rounds that are laid out by a seed: cuts that are told and not told, pauses, frames
that must be refused, new frames at odd times, layers that are kept and dropped; beside it pipelines of other sizes and
options, on devices that are opened again. Each round ends with the same frames after a reset, and what is made of them
must be the same bits in each round, and those of a fresh pipeline.
"""

from __future__ import annotations

import argparse
import gc
import os
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.opencl.device import Device, open_device, open_info
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.selftest.reference import digest
from gffe_cl.engine.selftest.scene import FPS, frames

SIZE, RENDER_SIZE = (96, 54), (112, 64)  # width and height, pixels
ROUND = 250  # rendered frames
_OTHERS = (
    ((64, 36), Options(shading_correction=False)),
    ((33, 71), Options(hole_filling="downsample", history=3, order=2, shading_correction=False)),
    ((120, 68), Options(levels=0, soft_silhouettes=False, shading_correction=False)),
    ((96, 54), Options(motion=False, hidden_parts=False, acceleration=False, blocks=False, shading_correction=False)),
)
_OTHERS_EVERY = 25  # frames
_REOPENED_EVERY = 4  # rounds, a device is opened again
_SETTLED = 1000  # frames from which on memory must not grow
_FINALE = 6  # frames of the end of a round
_PAGE = os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else 4096


@dataclass
class Soak:
    """`memory` (MiB) of the process and `milliseconds` (median of a frame) at the end of each round of `ROUND` frames;
    `frames` submitted, `made`: extrapolated, `refused`, `cuts` found; `pipelines` and `devices` opened beside;
    `longest` milliseconds of a frame; `ends`: the hashes of what the rounds ended with, and `fresh` that of a fresh
    pipeline."""

    frames: int = 0
    made: int = 0
    refused: int = 0
    cuts: int = 0
    pipelines: int = 0
    devices: int = 0
    longest: float = 0.0
    memory: list[float] = field(default_factory=list)
    milliseconds: list[float] = field(default_factory=list)
    ends: set[str] = field(default_factory=set)
    fresh: str = ""

    @property
    def growth(self) -> float:
        """Growth of memory, from frame `_SETTLED` (of short soaks the first half) to its largest after that, as a
        share."""
        settled = self.memory[min(_SETTLED // ROUND, (len(self.memory) + 1) // 2) - 1 :]
        return max(settled) / settled[0] - 1

    @property
    def is_equal(self) -> bool:
        """Whether all rounds ended alike, and as a fresh pipeline does."""
        return self.ends == {self.fresh}


def soak(device: Device, count: int, seed: int = 0, on_round: Callable[[Soak], None] = lambda told: None) -> Soak:
    """Submit `count` rendered frames, rounded up to whole rounds, to one pipeline on `device`. Return the findings."""
    told, rng, clock = Soak(), np.random.default_rng(seed), 0.0
    clip = frames(*SIZE, RENDER_SIZE)
    others = [frames(*size) for size, _ in _OTHERS]
    pipeline = _pipeline(device)
    for number in range(-(-count // ROUND)):
        taken = []
        for k, frame in enumerate(_round(clip, rng)):
            start = time.perf_counter()
            clock += 1 / FPS
            _step(pipeline, replace(frame, time=clock), rng, told)
            if k % _OTHERS_EVERY == 0:
                _beside(device, others, rng, told, anew=k == 0 and number % _REOPENED_EVERY == 0)
            taken.append((time.perf_counter() - start) * 1e3)
        told.ends.add(_finale(pipeline, clip, np.ceil(clock) + 1))
        told.frames += _FINALE
        clock = np.ceil(clock) + 2
        gc.collect()
        told.memory.append(_resident())
        told.milliseconds.append(float(np.median(taken)))
        told.longest = max(told.longest, *taken)
        on_round(told)
    told.fresh = _finale(_pipeline(device), clip, np.ceil(clock) + 1)
    return told


def _pipeline(device: Device) -> Pipeline:
    return Pipeline(device, *SIZE, Options(shading_inputs=True), render_size=RENDER_SIZE)


def _round(clip: list[RenderedFrame], rng: np.random.Generator) -> Iterator[RenderedFrame]:
    """Yield `ROUND` frames less those of the end: pieces of the clip, some of which start without a reset: unmarked
    cuts."""
    left = ROUND - _FINALE
    while left > 0:
        start = int(rng.integers(len(clip) - 1))
        piece = clip[start : start + 1 + int(rng.integers(len(clip)))][:left]
        for k, frame in enumerate(piece):
            yield replace(frame, reset=frame.reset and k == 0 and bool(rng.integers(2)))
        left -= len(piece)


def _step(pipeline: Pipeline, frame: RenderedFrame, rng: np.random.Generator, told: Soak) -> None:
    if rng.integers(20) == 0:
        told.refused += _is_refused(pipeline, frame, int(rng.integers(5)))
    if rng.integers(200) == 0:
        frame = replace(frame, reset=True)
    pipeline.exposure = float(rng.choice([0.5, 1.0, 4.0]))
    if rng.integers(50) == 0:
        pipeline.keep(None if rng.integers(2) else {"warp.color"})
    pipeline.submit(frame)
    told.frames += 1
    told.cuts += pipeline.is_cut
    for alpha in sorted(rng.uniform(0, 1.5, rng.integers(4))):
        pipeline.extrapolate(time=frame.time + alpha * pipeline.interval).numpy("color")
        told.made += 1
    if rng.integers(3) == 0:
        pipeline.present().numpy("motion")
    pipeline.take_timings()


def _is_refused(pipeline: Pipeline, frame: RenderedFrame, kind: int) -> bool:
    """Return whether the pipeline refuses a frame that it must not take."""
    bad = (
        replace(frame, color=frame.color[:-1]),
        replace(frame, depth=frame.depth[:, :5]),
        replace(frame, motion=None, reset=False),
        replace(frame, time=float("nan")),
        replace(frame, display_camera=frame.camera.moved((0.0, 1.0, 0.0))),
    )[kind]
    try:
        pipeline.submit(bad)
    except GffeError:
        return True
    raise AssertionError(f"a bad frame was taken (kind {kind})")


def _beside(device: Device, others: list, rng: np.random.Generator, told: Soak, anew: bool) -> None:
    """Another pipeline, that is made, used and left; on the device opened anew, every now and then."""
    number = int(rng.integers(len(_OTHERS)))
    size, options = _OTHERS[number]
    if anew:
        device = open_info(device.info)
        told.devices += 1
    pipeline = Pipeline(device, *size, options)
    told.pipelines += 1
    for frame in others[number][: 2 + int(rng.integers(3))]:
        pipeline.submit(frame)
        pipeline.extrapolate().numpy("depth")


def _finale(pipeline: Pipeline, clip: list[RenderedFrame], start: float) -> str:
    """Return the hash of all buffers after the same frames from a reset on, a refused one among them."""
    pipeline.exposure = 1.0
    pipeline.keep()
    found = []
    for k, frame in enumerate(clip[:_FINALE]):
        timed = replace(frame, time=start + k / 32, reset=k == 0)  # intervals are exact whenever it is
        if k == 3:
            _is_refused(pipeline, timed, 0)
        pipeline.submit(timed)
        made, shown = pipeline.extrapolate(time=timed.time + 1 / 64), pipeline.present()
        found += [made.numpy("color"), shown.numpy("color")]
        if k:  # some buffers are made from two frames only
            found += [owner.read(spec.name) for owner, spec in pipeline.named_buffers()]
    return digest(*found)


def _resident() -> float:
    """Return MiB of memory of this process; the most there was where the system does not tell."""
    try:
        with open("/proc/self/statm", encoding="ascii") as file:
            return int(file.read().split()[1]) * _PAGE / 2**20
    except OSError:
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def say(told: Soak) -> None:
    print(
        f"{told.frames} frames: {told.memory[-1]:.1f} MiB, {told.milliseconds[-1]:.1f} ms a frame,"
        f" longest {told.longest:.0f} ms, {len(told.ends)} different ends",
        flush=True,
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=20000)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    device, start = open_device(profiling=True), time.monotonic()
    print(device)
    told = soak(device, chosen.frames, chosen.seed, say)
    quarter = max(len(told.milliseconds) // 4, 1)
    print(
        f"{told.frames} frames submitted, {told.made} made, {told.refused} refused, {told.cuts} cuts found;"
        f" {told.pipelines} pipelines and {told.devices} devices opened beside; {time.monotonic() - start:.0f} s"
    )
    print(f"memory at the end: {told.memory[-1]:.1f} MiB, at most {told.growth:+.2%} from frame 1000 on")
    print(f"results: {'equal' if told.is_equal else 'DIFFERENT'}")
    first, last = (np.median(part) for part in (told.milliseconds[:quarter], told.milliseconds[-quarter:]))
    print(f"milliseconds a frame: {first:.1f} in the first quarter, {last:.1f} in the last")
    return int(told.growth >= 0.01 or not told.is_equal)


if __name__ == "__main__":
    sys.exit(main())
