"""Counts the bytes that kernels load and store per pixel, and the instructions that they execute, by Oclgrind:
independent of the machine.

    python docs/tools/count_traffic.py                       of plaza, one pixel per work-item, as on GPUs
    python docs/tools/count_traffic.py --lanes 1,8 --write   into docs/measured/traffic.json

A process under Oclgrind makes a few frames of a small part of the images; the kernels of the last pair are counted.
Caches count for nothing: a pixel that four work-items load is loaded four times. An atomic loads and stores.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import pickle
import re
import shutil
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from pages import write_record

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.inference.layers import HEAD_WEIGHTS
from gffe_cl.engine.inference.network import SubstituteNetwork
from gffe_cl.engine.opencl.device import open_device
from gffe_cl.engine.opencl.program import kernel_folder
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.correction import ShadingCorrection
from gffe_cl.engine.stages.shading import ShadingTrend
from gffe_cl.engine.timing.footage import FrameLoop
from gffe_cl.lab.bench import SCENE, scene_loop

SIZE = (1920, 1080)  # pixels, by default
PART = (192, 108)  # of which so many are counted,
CENTER = (0.3, 0.5)  # around here: on plaza edges, movers, holes and blocks are about as frequent as in all of it
# Samples stand for an image of any size: in the part there are as many fewer, and work-groups as much shorter.
SAMPLES = {"SAMPLES_X": 6, "SAMPLES_Y": 4, "COUNT_GROUP": 7}
_PLATFORM = "Oclgrind"
_HIDDEN = ("GFFE_DEVICE", "OCL_ICD_VENDORS", "OCL_ICD_FILENAMES")  # would choose other devices
_KERNEL = re.compile(r"^Instructions executed for kernel '(\w+)':$")
_COUNT = re.compile(r"^\s*(\d+) - (.*)$")
_MEMORY = re.compile(r"(load|store) global \((\d+) bytes\)")
_GLOBAL = r"PU3AS1V?K?(Dh|[a-z])"  # a pointer to global memory, and its type, in C++'s mangled names
_VECTOR = re.compile(rf"call _Z\d+v(load|store)a?_?(?:half)?(\d*)(?:_rt[ezpn])?(?:Dv\d+_)?\w*{_GLOBAL}\w*\(\)")
_ATOMIC = re.compile(rf"call _Z\d+atom(?:ic)?_\w+{_GLOBAL}\w*\(\)")
_FRAME_BLOCK = "call llvm.memcpy.p1i8.p0i8"  # its copy from an argument to global memory, once a frame
# Instructions that leave nothing for a GPU to execute: addresses, moves between names, variables that are registers.
_FREE = re.compile(
    r"(getelementptr|phi|bitcast|extractelement|insertelement|shufflevector|alloca|(load|store) private)\b"
)
_BYTES = {"Dh": 2} | dict(zip("ahcstijflmd", (1, 1, 1, 2, 2, 4, 4, 4, 8, 8, 8), strict=True))


@dataclass(frozen=True)
class KernelTraffic:
    """Bytes per display pixel that all launches of a kernel for a rendered and an extrapolated frame load and store.
    `executed`: instructions of LLVM per display pixel, those that compute or reach memory."""

    loaded: float
    stored: float
    executed: float


def count(loop: FrameLoop, lanes: int) -> dict[str, KernelTraffic]:
    """Return the traffic by "stage.kernel" in a part of the loop (of host arrays), with so many lanes (simd.h).
    Raises GffeError if Oclgrind is missing or fails."""
    loop = loop.part(*PART, CENTER)
    command = shutil.which("oclgrind")
    if command is None:
        raise GffeError("oclgrind is not installed (Debian, Ubuntu: apt install oclgrind)")
    with tempfile.TemporaryDirectory(prefix="gffe_traffic_") as temporary:
        folder = Path(temporary)
        (folder / "asked").write_bytes(pickle.dumps(loop))
        variables = {name: value for name, value in os.environ.items() if name not in _HIDDEN}
        variables |= {"GFFE_LANES": str(lanes), "PYOPENCL_NO_CACHE": "1", "GFFE_KERNELS": str(folder / "kernels")}
        _copy_kernels(folder / "kernels")
        # One thread: the order of execution, and so the result of atomics, is always the same.
        started = [command, "--inst-counts", "--num-threads", "1", sys.executable, __file__, "--under", str(folder)]
        with open(folder / "counts", "w") as counts:
            child = subprocess.run(started, stdout=counts, stderr=subprocess.PIPE, text=True, env=variables)
        if child.returncode:
            last = (child.stderr.strip().splitlines() or ["it said nothing"])[-1]
            raise GffeError(f"oclgrind ended with {child.returncode}: {last}")
        launched = json.loads((folder / "launched").read_text())
        blocks = list(parse_counts((folder / "counts").read_text()))
    return _joined(launched, blocks, math.prod((loop.width, loop.height)))


def _copy_kernels(folder: Path) -> None:
    """Copy the kernels, with `SAMPLES` of the part."""
    shutil.copytree(kernel_folder(), folder)
    for name in ("scene_cuts.h", "history.cl"):
        text = (folder / name).read_text()
        for constant, number in SAMPLES.items():
            text = re.sub(rf"(#define {constant}) +\d+", rf"\1 {number}", text)
        (folder / name).write_text(text)


def parse_counts(text: str) -> Iterator[tuple[str, int, int, int]]:
    """Yield (kernel, bytes loaded, bytes stored, instructions) of each launch from the output of `oclgrind
    --inst-counts`, in order. Frame blocks, which are written once a frame, do not count."""
    kernel, loaded, stored, executed = None, 0, 0, 0
    for line in text.splitlines():
        if head := _KERNEL.match(line):
            if kernel is not None:
                yield kernel, loaded, stored, executed
            kernel, loaded, stored, executed = (None if head[1] == "set_frame" else head[1]), 0, 0, 0
        elif kernel is not None and (entry := _COUNT.match(line)):
            times, instruction = int(entry[1]), entry[2]
            moved = _moved(times, instruction)
            loaded, stored = loaded + moved[0], stored + moved[1]
            executed += 0 if _FREE.match(instruction) else times
    if kernel is not None:
        yield kernel, loaded, stored, executed


def _moved(times: int, instruction: str) -> tuple[int, int]:
    """Return the bytes loaded from and stored to global memory by an instruction that was executed so often."""
    if memory := _MEMORY.match(instruction):
        nbytes = int(memory[2])
        return (nbytes, 0) if memory[1] == "load" else (0, nbytes)
    if vector := _VECTOR.match(instruction):
        nbytes = times * int(vector[2] or 1) * _BYTES[vector[3]]
        return (nbytes, 0) if vector[1] == "load" else (0, nbytes)
    if atomic := _ATOMIC.match(instruction):
        nbytes = times * _BYTES[atomic[1]]
        return nbytes, nbytes
    if instruction.startswith(_FRAME_BLOCK):
        return 0, 0
    if "AS1" in instruction or re.search(r"llvm\.mem\w+\.[\w.]*p1", instruction):
        raise GffeError(f"oclgrind: how many bytes does '{instruction}' move?")
    return 0, 0


def _joined(launched: list, blocks: list[tuple[str, int, int, int]], pixels: int) -> dict[str, KernelTraffic]:
    blocks = blocks[len(blocks) - len(launched) :]
    stages = {kernel: stage for stage, kernel in launched}
    if sorted(kernel for _, kernel in launched) != sorted(kernel for kernel, *_ in blocks):
        raise GffeError("oclgrind: the counted kernels are not the launched ones")
    counted: dict[str, list[float]] = defaultdict(lambda: [0.0, 0.0, 0.0])
    for kernel, *figures in blocks:
        of = counted[f"{stages[kernel]}.{kernel}"]
        for k, figure in enumerate(figures):
            of[k] += figure / pixels
    order = dict.fromkeys(f"{stage}.{kernel}" for stage, kernel in launched)
    return {name: KernelTraffic(*counted[name]) for name in order}


def _make(folder: Path) -> None:
    """Make the frames under Oclgrind, and write the launches of the last pair to a file, by stage, in order."""
    loop = pickle.loads((folder / "asked").read_bytes())
    device = open_device(profiling=True)  # its commands are noted
    if device.info.platform != _PLATFORM:
        raise GffeError(f"expected {_PLATFORM}, got {device.info.platform}")
    loop = loop.on(device)
    pipeline = Pipeline(device, loop.width, loop.height)
    pipeline.exposure = loop.exposure
    if correction := pipeline.stages.get(ShadingCorrection.name):
        # Kernels load more or less by the focus mask, which is 0 here.
        correction.use(SubstituteNetwork(np.zeros(HEAD_WEIGHTS, np.float32), lambda shape: 0))
        pipeline.stages[ShadingTrend.name].never_still = True  # with vectors it finds no change of light
    *before, last = (turn for turn in loop.turns(1))
    for turn in before:
        pipeline.submit(turn.frame)
    pipeline.board.commands.take_events()
    pipeline.submit(last.frame)
    pipeline.extrapolate(last.camera, last.time(loop.interval))
    device.queue.finish()
    events = pipeline.board.commands.take_events()
    kernels = {name: {kernel.name for kernel in stage.kernels} for name, stage in pipeline.stages.items()}
    launched = [(name, kernel) for name in kernels for kernel, _ in events.get(name, ()) if kernel in kernels[name]]
    (folder / "launched").write_text(json.dumps(launched))


def report(by_lanes: dict[int, dict[str, KernelTraffic]], loop: FrameLoop) -> dict:
    """Return what docs/measured/traffic.json has."""
    return {
        "of": loop.name,
        "size": [loop.width, loop.height],
        "part": list(PART),
        "lanes": {
            str(lanes): {
                name: {key: round(value, 3) for key, value in asdict(moved).items()} for name, moved in kernels.items()
            }
            for lanes, kernels in by_lanes.items()
        },
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default=SCENE)
    parser.add_argument("--lanes", default="1", help="pixels per work-item: 1 as on GPUs, 8 as on CPUs, or 1,8")
    parser.add_argument("--write", action="store_true", help="record them in docs/measured/traffic.json")
    parser.add_argument("--under", type=Path, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.under:
        _make(asked.under)
        return
    loop = scene_loop(open_device(), asked.scene, *SIZE)
    counted = {int(lanes): count(loop, int(lanes)) for lanes in asked.lanes.split(",")}
    for lanes, kernels in counted.items():
        print(f"\n{f'per pixel, {lanes} a work-item':40}{'loaded':>10}{'stored':>10}{'instructions':>14}")
        for name, moved in kernels.items():
            print(f"{name:40}{moved.loaded:10.1f}{moved.stored:10.1f}{moved.executed:14.1f}")
    if asked.write:
        write_record("traffic", report(counted, loop))


if __name__ == "__main__":
    main()
