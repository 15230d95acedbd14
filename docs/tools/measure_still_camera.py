"""Measure the cost of a frame under a camera that moves, under one that rests while movers move, and of a still one.

    python docs/tools/measure_still_camera.py --scene plaza --device intel --device pocl

Milliseconds of GAE by kernel events, for one rendered and one extrapolated frame: the median of rounds in turn.
"""

import argparse
import statistics
from dataclasses import replace

import numpy as np

from gffe_cl.captures.scenes import SceneRenderer, load_scene
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.opencl.device import open_device
from gffe_cl.engine.options import Options
from gffe_cl.engine.timing.bench import Copier, bench_size
from gffe_cl.engine.timing.footage import FrameLoop
from gffe_cl.lab.bench.footage import scene_loop

KINDS = ("camera moves", "camera rests", "still")


def loop_of(device, name, size, kind):
    """Return the loop of `scene_loop`, or the one that the camera of its second frame sees, with or without movers."""
    loop = scene_loop(device, name, *size)
    if kind == "camera moves":
        return loop
    scene, (first, last) = load_scene(name), loop.frames
    camera, renderer = last.camera, SceneRenderer(device, scene, *size, samples=1)
    times = (first.time, last.time) if kind == "camera rests" else (last.time,) * 2
    frames = []
    for now, before, frame in zip(times, times[::-1], loop.frames, strict=True):
        image = renderer.render(now, camera, before, camera)
        color, depth, motion = (image.read(buffer) for buffer in ("color", "depth", "motion"))
        motion = motion if kind == "camera rests" else np.zeros_like(motion)
        frames.append(RenderedFrame(color, depth, motion, camera, frame.time))
    return replace(loop, frames=tuple(frames), cameras=(camera,) * 2)


def measure(device, loops: list[FrameLoop], rounds, repeats):
    """Return the milliseconds of GAE of each loop."""
    copier, options = Copier(device), Options(shading_correction=False)
    taken = [
        [bench_size(device, copier, loop, options, repeats).milliseconds["GAE"] for loop in loops]
        for _ in range(rounds)
    ]
    return [statistics.median(column) for column in zip(*taken, strict=True)]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", action="append", help="built-in scene (repeatable); default: plaza")
    parser.add_argument("--device", action="append", help="device (repeatable); default: the default one")
    parser.add_argument("--size", default="1920x1080", help="WIDTHxHEIGHT; default: 1920x1080")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--repeats", type=int, default=10, help="timed frames of each loop in a round; default: 10")
    given = parser.parse_args()
    for wanted in given.device or [None]:
        device = open_device(wanted, profiling=True)
        for name in given.scene or ["plaza"]:
            loops = [loop_of(device, name, tuple(map(int, given.size.split("x"))), kind) for kind in KINDS]
            found = measure(device, loops, given.rounds, given.repeats)
            shown = ", ".join(
                f"{kind} {ms:.1f} ms ({ms / found[0]:.2f})" for kind, ms in zip(KINDS, found, strict=True)
            )
            print(f"{device.info.name}, {name} {given.size}: {shown}")


if __name__ == "__main__":
    main()
