"""Measures what `gffe_cl.attach` costs the program: milliseconds per frame with and without a viewer that looks.

    python docs/tools/measure_attach.py [--size 960x540] [--turns 12] [--device intel] [--network] [--json F]

A frame is what a program does: submit NumPy arrays, extrapolate one frame, read its color. The cases take turns in one
run; "looked at" is by a process of its own that asks for one layer after the other frame, as the viewer does, but shows
nothing, since drawing would compete for the same cores.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import gffe_cl as gffe
from gffe_cl.pipeline.source import Live
from gffe_cl.scenes import load_scene

NAME = "measure_attach"
BLOCK = 10  # frames in a turn of a case, the first of which do not count
SETTLING = 3
CASES = ("alone", "attached", "recorded", "one layer", "one layer, recorded")


def look(frames: int, layers: frozenset[str]) -> None:
    """The viewer: until it is killed."""
    from gffe_cl.viewer.engine.attached.program import RunningProgram

    program = RunningProgram(NAME, frames)
    print("looking", flush=True)
    while layers:
        program.see(layers, False, lambda: None)
    time.sleep(3600)


def measure(pipeline: gffe.Pipeline, frames: list, turns: int) -> dict[str, list[float]]:
    """Milliseconds per frame by case, one for each turn."""
    taken: dict[str, list[float]] = {case: [] for case in CASES}
    clock = 0

    def run() -> float:
        nonlocal clock
        spent = []
        for _ in range(BLOCK):
            frame = frames[clock % len(frames)]
            frame.time, frame.reset = clock / 30, clock % len(frames) == 0
            start = time.perf_counter()
            pipeline.submit(frame)
            pipeline.extrapolate(time=frame.time + 1 / 60).numpy("color")
            spent.append(time.perf_counter() - start)
            clock += 1
        return statistics.mean(spent[SETTLING:]) * 1e3

    for turn in range(turns + 1):
        for case in CASES[:: 1 if turn % 2 else -1]:
            with ExitStack() as stack:
                if case != "alone":
                    stack.enter_context(gffe.attach(pipeline, NAME))
                if case not in ("alone", "attached"):
                    stack.callback(_viewer(case).kill)
                milliseconds = run()
            if turn:  # the first one compiles and allocates
                taken[case].append(milliseconds)
    return taken


def _viewer(case: str) -> subprocess.Popen:
    words = ["--look", "24" if "recorded" in case else "0", "final" if "layer" in case else ""]
    child = subprocess.Popen([sys.executable, __file__, *words], stdout=subprocess.PIPE, text=True)
    if child.stdout.readline() != "looking\n":
        raise SystemExit("the viewer's process did not start")
    return child


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--look", nargs=2, metavar=("FRAMES", "LAYER"), help=argparse.SUPPRESS)
    parser.add_argument("--size", default="960x540", help="width × height, pixels (default: 960x540)")
    parser.add_argument("--turns", type=int, default=12, help="turns of the cases (default: 12)")
    parser.add_argument("--device", help="as in gffe run (default: the fastest)")
    parser.add_argument("--network", action="store_true", help="with shading correction, which takes most of the time")
    parser.add_argument("--json", type=Path, metavar="F", help="write the figures there, too")
    given = parser.parse_args()
    if given.look:
        look(int(given.look[0]), frozenset(filter(None, given.look[1:])))
        return
    width, height = map(int, given.size.split("x"))
    device = gffe.open_device(given.device)
    source = Live(load_scene("plaza"), device, width, height, 12, 30.0)
    frames = [frame for _, frame in source.frames([0.5], False)]
    pipeline = gffe.Pipeline(device, width, height, gffe.Options(shading_correction=None if given.network else False))
    taken = measure(pipeline, frames, given.turns)
    figures = {}
    for case, milliseconds in taken.items():
        shares = [ms / alone for ms, alone in zip(milliseconds, taken["alone"], strict=True)]
        figures[case] = {"ms": statistics.median(milliseconds), "share": statistics.median(shares) - 1}
        print(f"{case:22}{figures[case]['ms']:8.2f} ms   {figures[case]['share']:+7.1%}")
    if given.json:
        about = {"device": device.info.name, "size": [width, height], "network": given.network, "cases": figures}
        given.json.write_text(json.dumps(about, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
