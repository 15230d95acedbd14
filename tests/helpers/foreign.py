"""Captures in other programs' conventions, written from frames whose buffers are known: the oracle of their readers.

Nothing here is shared with the readers: each convention is written down a second time, in the other direction.
"""

import json
from dataclasses import dataclass
from functools import cache

import numpy as np
import OpenEXR

from gffe_cl.captures.scenes import SceneFrames, SceneRenderer, load_scene
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.opencl.device import open_device

W, H, FPS = 97, 55, 30.0
SCENE = "forest"  # the camera turns, leaves move, and there is sky


@dataclass
class Shot:
    """A frame in our conventions; `kind` rendered or ground_truth."""

    time: float
    kind: str
    color: np.ndarray
    depth: np.ndarray
    motion: np.ndarray
    camera: Camera


@cache
def shots(scene=SCENE, count=3, start=0.4):
    """Yield rendered frames of a built-in scene, with the truth in between."""
    made = SceneFrames(SceneRenderer(open_device(), load_scene(scene, 0), W, H, samples=2))
    found = []
    for frame in made.sequence(count, FPS, start):
        found.append(Shot(frame.time, "rendered", frame.color, frame.depth, frame.motion, frame.camera))
        time = frame.time + 0.5 / FPS
        between = made.truth(time, frame).numpy()
        found.append(
            Shot(time, "ground_truth", between.color, between.depth, between.motion, made.display_camera(time))
        )
    assert any(np.abs(shot.motion).max() > 2 for shot in found) and any(np.isinf(shot.depth).any() for shot in found)
    return found


def write_exr(path, channels, part_name=None, windows=None, compression=OpenEXR.ZIP_COMPRESSION, **attributes):
    header = {"compression": compression, "type": OpenEXR.scanlineimage, **(windows or {}), **attributes}
    OpenEXR.File(header, {name: np.ascontiguousarray(c) for name, c in channels.items()}).write(str(path))


def write_parts(path, parts, compression=OpenEXR.ZIP_COMPRESSION):
    """Write `parts`: name → channels."""
    made = []
    for name, channels in parts.items():
        header = {"compression": compression, "type": OpenEXR.scanlineimage}
        made.append(OpenEXR.Part(header, {n: np.ascontiguousarray(c) for n, c in channels.items()}, name))
    OpenEXR.File(made).write(str(path))


# Blender


def blender_layers(shot, layer="ViewLayer", data="Data"):
    """Return Layer.Pass → component → (H, W), as Cycles has them: y up, 1e10 for nothing, vectors into both
    directions."""
    color = dict(zip("RGB", np.moveaxis(shot.color, -1, 0), strict=True))
    found = {f"{layer}.Combined": {**color, "A": np.ones_like(color["R"])}}
    if shot.kind == "rendered":
        found[f"{layer}.Noisy Image"] = {n: c * 0 for n, c in color.items()}
        found[f"{data}.Depth"] = {"Z": np.where(np.isinf(shot.depth), np.float32(1e10), shot.depth)}
        x, y = np.moveaxis(shot.motion.astype(np.float32), -1, 0)
        found[f"{data}.Vector"] = {"X": x, "Y": -y, "Z": x + 3, "W": y - 5}
        if data != layer:
            found[f"{data}.Combined"] = {n: c * 0 + np.float16(7) for n, c in color.items()}
    return found


def write_blender(folder, frames, multi_part=True, first=0, rename=lambda layers: layers, **names):
    folder.mkdir(parents=True, exist_ok=True)
    described = []
    for index, shot in enumerate(frames, first):
        file = f"frame_{index:04d}.exr"
        layers = rename(blender_layers(shot, **names))
        named = {layer: {f"{layer}.{c}": a for c, a in passes.items()} for layer, passes in layers.items()}
        if multi_part:
            write_parts(folder / file, named)
        else:
            write_exr(folder / file, {n: a for passes in named.values() for n, a in passes.items()})
        described.append(blender_frame(index, file, shot.kind, shot.time, shot.camera))
    height, width = frames[0].depth.shape
    document = {"width": width, "height": height, "frames": described}
    (folder / "cameras.json").write_text(json.dumps(document))
    return folder


def blender_frame(index, file, kind, time, camera):
    fx, fy, cx, cy = camera.intrinsics
    matrix = camera.world_to_view.tolist()
    return {
        **{"frame": index, "file": file, "kind": kind, "time": time, "world_to_camera": matrix},
        **{"fx": fx, "fy": fy, "cx": cx, "cy": cy},
    }


def edit_json(path, change):
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))
    return document
