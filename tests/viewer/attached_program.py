"""A program of its own for tests of `gffe_cl.attach`: it renders the plaza, generates a frame after each, and writes
what it does into a file, a line per rendered frame.

    attached_program.py NAME LOG [WIDTHxHEIGHT]
"""

import sys
import time

import gffe_cl as gffe
from gffe_cl.captures.offline.source import Live
from gffe_cl.captures.scenes import load_scene

name, log = sys.argv[1:3]
width, height = map(int, (sys.argv[3] if len(sys.argv) > 3 else "160x96").split("x"))
device = gffe.open_device(profiling=True)
pipeline = gffe.Pipeline(device, width, height)
pacer = gffe.Pacer(60)
source = Live(load_scene("plaza"), device, width, height, 100_000, 30.0)
with gffe.attach(pipeline, name, pacer=pacer), open(log, "w", buffering=1) as report:
    for _, frame in source.frames([0.5], False):
        start = time.perf_counter()
        pipeline.submit(frame)
        pacer.rendered(frame.time)
        for _ in range(2):
            plan = pacer.plan(time.perf_counter())
            made = pipeline.extrapolate(time=frame.time + 1 / 60)
            pacer.ready(time.perf_counter())
        print(f"{frame.time:.4f} {made.numpy('color').mean():.6f} {pipeline.options.motion}", file=report)
        time.sleep(max(1 / 30 - (time.perf_counter() - start), 0.0))
