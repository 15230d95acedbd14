"""Thousands of frames through one pipeline: whether memory stays, and results stay the same.

    python docs/measure_soak.py --frames 20000

Runs on the default device (`GFFE_DEVICE` chooses another). Exit code 1 if memory grows by 1% or results differ.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

from gffe_cl.opencl.device import open_device
from gffe_cl.selftest.soak import Soak, soak


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
    device, start = open_device(), time.monotonic()
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
