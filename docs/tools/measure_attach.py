"""Measures what `gffe_cl.attach` costs the program, with and without a viewer that looks.

    python docs/tools/measure_attach.py [--size 960x540] [--turns 30] [--device intel] [--network] [--json F]

A frame is what a program does: submit NumPy arrays, extrapolate one frame, read its color. The cases take turns of a
few frames in one run; shares are medians of the ratios within a turn, of milliseconds and of the processor time of the
program with its device, which other work on the machine disturbs less. "One layer" is looked at by a process of its
own that asks for one frame after the other, as the viewer does, but draws nothing: that would compete for the same
cores.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import threading
import time
from contextlib import nullcontext, suppress
from pathlib import Path

import gffe_cl as gffe
from gffe_cl.captures.offline.source import Live
from gffe_cl.captures.scenes import load_scene

NAME = "measure_attach"
BLOCK, SETTLING = 8, 3  # frames in a turn of a case, and those of them that do not count
RECORDED = 8  # rendered frames that are kept
CASES = {  # the viewer's requests: recorded rendered frames, and the displayed layer
    "alone": None,
    "attached": None,
    "recorded": (RECORDED, ""),
    "one layer": (0, "final"),
    "one layer, recorded": (RECORDED, "final"),
}


def look() -> None:
    """Serve as the viewer: follow the lines of the input, "FRAMES LAYER" or "leave"."""
    from gffe_cl.viewer.engine.sources.program import RunningProgram

    program = stop = thread = None
    for line in sys.stdin:
        if line == "leave\n":
            stop.set()
            program.close()
            thread.join()
        else:
            frames, _, layer = line.rstrip("\n").partition(" ")
            program, stop = RunningProgram(NAME, int(frames)), threading.Event()
            thread = threading.Thread(target=_see, args=(program, layer, stop), daemon=True)
            thread.start()
            time.sleep(0.3)  # the program has allocated memory for the recording
        print("done", flush=True)


def _see(program, layer: str, stop: threading.Event) -> None:
    with suppress(gffe.GffeError):  # it has left
        while layer and not stop.is_set():
            program.see(frozenset({layer}), False, lambda: None)


class Viewer:
    """The process that looks."""

    def __init__(self):
        command = [sys.executable, __file__, "--look"]
        self._child = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def do(self, line: str) -> None:
        print(line, file=self._child.stdin, flush=True)
        if self._child.stdout.readline() != "done\n":
            raise SystemExit("the viewer's process failed")

    def close(self) -> None:
        self._child.stdin.close()
        self._child.wait()


class Program:
    """The program that is looked into."""

    def __init__(self, device: gffe.Device, size: tuple[int, int], network: bool):
        self._frames = [f for _, f in Live(load_scene("plaza"), device, *size, 12, 30.0).frames([0.5], False)]
        self.pipeline = gffe.Pipeline(device, *size, gffe.Options(shading_correction=None if network else False))
        self._made = 0

    def run(self) -> tuple[float, float]:
        """Return milliseconds of a frame, by the clock and of the processor."""
        walls, start = [], 0.0
        for index in range(BLOCK):
            if index == SETTLING:
                start = time.process_time()
            frame = self._frames[self._made % len(self._frames)]
            frame.time, frame.reset = self._made / 30, self._made % len(self._frames) == 0
            begun = time.perf_counter()
            self.pipeline.submit(frame)
            self.pipeline.extrapolate(time=frame.time + 1 / 60).numpy("color")
            walls.append(time.perf_counter() - begun)
            self._made += 1
        processor = (time.process_time() - start) / (BLOCK - SETTLING)
        return statistics.median(walls[SETTLING:]) * 1e3, processor * 1e3


def measure(program: Program, viewer: Viewer, turns: int) -> dict[str, list[tuple[float, float]]]:
    """Return the results of `Program.run`, by case, for each turn."""
    taken: dict[str, list[tuple[float, float]]] = {case: [] for case in CASES}
    for turn in range(turns + 1):
        for case in list(CASES)[:: 1 if turn % 2 else -1]:
            looks = CASES[case]
            with nullcontext() if case == "alone" else gffe.attach(program.pipeline, NAME):
                if looks:
                    viewer.do(f"{looks[0]} {looks[1]}")
                found = program.run()
                if looks:
                    viewer.do("leave")
            if turn:  # the first one compiles and allocates
                taken[case].append(found)
    return taken


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--look", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--size", default="960x540", help="width × height, pixels (default: 960x540)")
    parser.add_argument("--turns", type=int, default=30, help="turns of the cases (default: 30)")
    parser.add_argument("--device", help="as in gffe run (default: the fastest)")
    parser.add_argument("--network", action="store_true", help="with shading correction, which takes most of the time")
    parser.add_argument("--json", type=Path, metavar="F", help="write the figures there, too")
    given = parser.parse_args()
    if given.look:
        look()
        return
    width, height = map(int, given.size.split("x"))
    device, viewer = gffe.open_device(given.device), Viewer()
    taken = measure(Program(device, (width, height), given.network), viewer, given.turns)
    viewer.close()
    figures: dict[str, dict[str, float]] = {}
    for case, found in taken.items():
        figures[case] = made = {}
        for index, kind in enumerate(("ms", "processor ms")):
            made[kind] = statistics.median(times[index] for times in found)
            ratios = (times[index] / alone[index] for times, alone in zip(found, taken["alone"], strict=True))
            made[f"{kind}, more"] = statistics.median(ratios) - 1
        print(
            f"{case:20}{made['ms']:8.2f} ms {made['ms, more']:+7.1%}    processor {made['processor ms']:8.2f} ms"
            f" {made['processor ms, more']:+7.1%}"
        )
    if given.json:
        about = {"device": device.info.name, "size": [width, height], "network": given.network, "cases": figures}
        given.json.write_text(json.dumps(about, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
