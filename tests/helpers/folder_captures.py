"""Captures in the format `gffe-folder`."""

import json

import numpy as np
from foreign import FPS, H, W, shots, write_exr

from gffe_cl import open_capture

FILES = {"color": "color_%04d.exr", "depth": "depth_%d.npy", "motion": "motion.%03d.npy"}


def rendered():
    return [shot for shot in shots() if shot.kind == "rendered"]


def described(**parts):
    """Return the JSON of a capture of three frames; `parts` of `FILES` replace its files, others its keys."""
    basic = {
        "format": "gffe-folder",
        "version": 2,
        "width": W,
        "height": H,
        "fps": FPS,
        "frames": {"first": 3, "count": 3},
        "files": FILES | {name: parts.pop(name) for name in [*parts] if name in (*FILES, "ground_truth")},
        "cameras": {"list": [{"view": s.camera.world_to_view.tolist(), **focal(s.camera)} for s in rendered()]},
    }
    return {**basic, **parts}


def focal(camera):
    return dict(zip(("fx", "fy", "cx", "cy"), camera.intrinsics, strict=True))


def write(folder, depth_as=None, motion_as=None, also=None, **parts):
    """Write buffers as `described` has them, changed by functions of a shot. Return the folder."""
    for number, shot in enumerate(rendered(), 3):
        write_exr(folder / f"color_{number:04d}.exr", dict(zip("RGB", np.moveaxis(shot.color, -1, 0), strict=True)))
        np.save(folder / f"depth_{number}.npy", depth_as(shot) if depth_as else shot.depth)
        np.save(folder / f"motion.{number:03d}.npy", motion_as(shot) if motion_as else shot.motion)
        if also:
            also(folder, number, shot)
    (folder / "sequence.json").write_text(json.dumps(described(**parts)))
    return open_capture(folder)
