"""One side of `quality.py`: a process that imports gffe_cl of that side, and makes the new frames.

The argument is a JSON object of options, "preset" perhaps among them. A line comes in for each sequence, [file of the
sequence, whether the camera is known, file to write]: half (moments, 2, H, W, 3), linear colors with and without
the network. A line goes out when it is written.
"""

from __future__ import annotations

import json
import sys

import numpy as np

import gffe_cl as gffe


def made_frames(device, options, sequence, known: bool) -> np.ndarray:
    """Return the new frames of a sequence, as above."""
    height, width = sequence["depth"].shape[1:]
    pipeline = gffe.Pipeline(device, width, height, options, fps=float(sequence["fps"]))
    pipeline.exposure = float(sequence["exposure"])
    made = np.empty((len(sequence["after"]), 2, height, width, 3), np.float16)
    frames = zip(*(sequence[name] for name in ("color", "depth", "motion", "camera", "time")), strict=True)
    for k, (color, depth, motion, camera, time) in enumerate(frames):
        pipeline.submit(gffe.RenderedFrame(color, depth, motion, camera_of(camera), float(time), reset=k == 0))
        for moment in np.flatnonzero(sequence["after"] == k):
            camera = camera_of(sequence["truth_camera"][moment]) if known else None
            frame = pipeline.extrapolate(camera, float(sequence["truth_time"][moment]))
            made[moment] = frame.numpy("color"), frame.numpy("gae")
    return made


def camera_of(flat: np.ndarray) -> gffe.Camera:
    return gffe.Camera(flat[:16].reshape(4, 4), *map(float, flat[16:]))


def main() -> None:
    device, values = gffe.open_device(), json.loads(sys.argv[1])
    options = gffe.Options.preset(values.pop("preset", "balanced"), **values)
    print("ready", flush=True)
    for line in sys.stdin:
        source, known, target = json.loads(line)
        with np.load(source) as stored:
            sequence = dict(stored)
        np.save(target, made_frames(device, options, sequence, known))
        print("written", flush=True)


if __name__ == "__main__":
    main()
