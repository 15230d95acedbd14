"""Whether three clocks agree on the wall time of one frame pair, on a quiet machine.

    python docs/tools/compare_clocks.py --device intel
    python docs/tools/compare_clocks.py --device pocl --scn      with the shading correction network

The pair is the same for all: submit a rendered frame from device buffers, extrapolate, finish. A plain loop over the
public `Pipeline`, `gffe bench` and compare_speed.py time it in turns; each figure is a median of medians, each ratio
the median of the ratios to the plain loop within a turn.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from pathlib import Path

from compare_speed import Version, store
from pages import REPOSITORY

import gffe_cl as gffe
from gffe_cl.engine.timing.bench import Copier, bench_size
from gffe_cl.engine.timing.footage import FrameLoop
from gffe_cl.lab.bench.footage import SCENE, loop_of


def clocks(loop: FrameLoop, device: gffe.Device, scn: bool, turns: int, pairs: int) -> list[dict[str, float]]:
    """Return milliseconds by clock, of each turn."""
    options, copier, on_device = gffe.Options(shading_correction=scn), Copier(device), loop.on(device)
    with tempfile.TemporaryDirectory(prefix="compare_clocks_") as temporary:
        folder = Path(temporary) / "footage"
        store(loop, folder)
        version = Version(REPOSITORY, str(folder), "--device", device.info.index, *(["--scn"] if scn else []))

        def served() -> float:
            timed = [(turn, version.timed(turn, loop)["wall time"]) for turn in loop.turns(pairs)]
            return statistics.median(milliseconds for turn, milliseconds in timed if turn.counts)

        by_name = {
            "plain loop": lambda: plain_loop(on_device, device, options, pairs),
            "gffe bench": lambda: bench_size(device, copier, loop, options, pairs).wall,
            "compare_speed.py": served,
        }
        found = [{name: clock() for name, clock in by_name.items()} for _ in range(turns)]
        version.close()
    return found


def plain_loop(loop: FrameLoop, device: gffe.Device, options: gffe.Options, pairs: int) -> float:
    """Return the median wall time of a pair, milliseconds."""
    pipeline = gffe.Pipeline(device, loop.width, loop.height, options)
    pipeline.exposure, walls = loop.exposure, []
    for turn in loop.turns(pairs):
        start = time.perf_counter()
        pipeline.submit(turn.frame)
        pipeline.extrapolate(turn.camera, turn.time(loop.interval))
        device.queue.finish()
        if turn.counts:
            walls.append(1e3 * (time.perf_counter() - start))
    return statistics.median(walls)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default=SCENE)
    parser.add_argument("--size", default="1920x1080")
    parser.add_argument("--device", help="intel, pocl, …; default: the best one")
    parser.add_argument("--scn", action="store_true", help="with the shading correction network")
    parser.add_argument("--turns", type=int, default=7)
    parser.add_argument("--pairs", type=int, default=8, help="counted pairs of frames in each turn")
    asked = parser.parse_args()
    device = gffe.open_device(asked.device, profiling=True)
    width, height = (int(n) for n in asked.size.split("x"))
    loop = loop_of(device, asked.scene, (width, height))
    turns = clocks(loop, device, asked.scn, asked.turns, asked.pairs)
    print(f"{loop.name}, {width}×{height}, {device.info.name} ({device.info.platform})")
    print(f"{'wall time of a pair':20}{'ms':>10}{'ratio':>8}")
    for name in turns[0]:
        milliseconds = statistics.median(turn[name] for turn in turns)
        ratio = statistics.median(turn[name] / turn["plain loop"] for turn in turns)
        print(f"{name:20}{milliseconds:10.2f}{ratio:8.3f}")


if __name__ == "__main__":
    main()
