"""Tiny sequences to test with."""

import json
from pathlib import Path

import numpy as np

from gffe_cl.captures.sequence import (
    FrameEntry,
    SequenceWriter,
    named_channels,
)
from gffe_cl.engine.frame.camera import Camera

W, H = 13, 9


def camera(x=0.0, **changes):
    return Camera.look_at((x, 0.2, -3), (0.1, 0, 0), (0, 1, 0), **{**dict(fx=12, fy=11, cx=6.2, cy=4.1), **changes})


def pixels(seed=0, height=H, width=W):
    rng = np.random.default_rng(seed)
    color = rng.normal(size=(height, width, 3)).astype(np.float16)
    depth = rng.uniform(1, 5, (height, width)).astype(np.float32)
    depth[0, 0] = np.inf
    return color, depth, rng.normal(size=(height, width, 2)).astype(np.float32)


def write(path, frames=3, **options):
    """Return a sequence of `frames` rendered frames, with truth in between."""
    with SequenceWriter(path, W, H, 30.0, **options) as writer:
        for i in range(frames):
            motion_free = named_channels(*pixels(i)[:2])
            writer.add(rendered(i), named_channels(*pixels(i)) if i else motion_free)
            truth = FrameEntry(f"truth_{i}.exr", (i + 0.5) / 30, "ground_truth", display_camera=camera(i + 0.5))
            writer.add(truth, named_channels(pixels(100 + i)[0]))
    return Path(path)


def rendered(i, **changes):
    return FrameEntry(f"frame_{i}.exr", i / 30, "rendered", i == 0, None, camera(i), **changes)


def edit(folder, change):
    document = json.loads((folder / "sequence.json").read_text())
    change(document)
    (folder / "sequence.json").write_text(json.dumps(document))


def contiguous(channels):
    return {name: np.ascontiguousarray(array) for name, array in channels.items()}


def names(path):
    return sorted(p.relative_to(path).as_posix() for p in path.rglob("*"))
