"""Renders a Blender scene (Cycles) to frames with colour, depth and motion vectors, truth in between, and cameras.

    blender -b scene.blend --python export_gffe.py -- OUT --every 2
    python export_gffe.py scene.blend -- OUT --every 2                   with the `bpy` wheel of PyPI

OUT gets `cameras.json` and one multilayer EXR per frame, `frame_NNNN.exr`. Every `--every`-th frame of the scene's range is
*rendered*; `--between` frames of truth, evenly spaced, lie between two rendered ones (by default those frames of the scene
that do). A rendered frame holds the scene's own view layer (Combined, antialiased, half) and a layer `Data` of one sample
at the pixel's centre: `Depth.Z`, planar, 1e10 where nothing is, and `Vector.X/.Y`, pixels with y up, the place in the
previous *rendered* frame minus the place here. Truth holds the colour only. The .blend file is never written to.

Files that are there already are kept, so an interrupted export goes on where it stopped; `--overwrite` renders them anew.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

LAYER = "Data"  # the view layer of depth and vectors
KINDS = ("rendered", "ground_truth", "camera_only")
_MOST = 900  # of what Blender's time remapping takes
_VIEW_AXES = np.diag((1.0, -1.0, -1.0, 1.0))  # Blender's camera looks along −z, y up


@dataclass(frozen=True)
class Moment:
    """One frame of the export."""

    index: int
    scene_frame: float
    time: float  # seconds since the first one
    kind: str

    @property
    def file(self) -> str:
        return f"frame_{self.index:04d}.exr"


def moments(start: int, end: int, every: int, between: int, fps: float, truth: bool = True) -> list[Moment]:
    """All frames of the export, in order; the range ends with what can follow the last rendered frame."""
    found = []
    for k, rendered in enumerate(range(start, end + 1, every)):
        for j in range(between + 1):
            scene_frame = rendered + every * j / (between + 1)
            if scene_frame > end + 1 - every / (between + 1) + 1e-9 and j:
                break
            kind = KINDS[0] if j == 0 else KINDS[1] if truth else KINDS[2]
            found.append(Moment(k * (between + 1) + j, scene_frame, (scene_frame - start) / fps, kind))
    return found


def export(
    out,
    every: int = 1,
    between: int | None = None,
    start: int | None = None,
    end: int | None = None,
    truth: bool = True,
    overwrite: bool = False,
) -> None:
    """Render the current scene into the folder `out`. `start` and `end` default to the scene's range, `between` to
    every − 1; without `truth`, frames in between are cameras only."""
    scene = bpy.context.scene
    between = every - 1 if between is None else between
    start, end = (scene.frame_start if start is None else start), (scene.frame_end if end is None else end)
    _require(scene, start, end, every, between)
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    color, data = _prepare(scene, every)
    every_frame = moments(start, end, every, between, scene.render.fps / scene.render.fps_base, truth)
    frames = []
    for moment in every_frame:
        _set_time(scene, moment.scene_frame / every)
        frames.append(_described(scene, moment))
        if moment.kind != "camera_only" and (overwrite or not (out / moment.file).exists()):
            _render(scene, out / moment.file, color, data if moment.kind == "rendered" else None)
            print(f"{moment.file}: {moment.kind}, frame {moment.scene_frame:g}", flush=True)
    width, height = _size(scene)
    document = {"width": width, "height": height, "frames": frames}
    _written(out / "cameras.json", lambda path: path.write_text(json.dumps(document, indent=1) + "\n"))


def _require(scene, start: int, end: int, every: int, between: int) -> None:
    if scene.render.engine != "CYCLES":
        raise SystemExit(f"the render engine is {scene.render.engine} (expected CYCLES: others have no exact vectors)")
    if scene.camera is None or scene.camera.data.type != "PERSP":
        raise SystemExit("the scene needs an active camera with a perspective lens")
    if not (1 <= every <= _MOST and between >= 0 and start <= end):
        raise SystemExit(f"expected 1 ≤ every ≤ {_MOST}, between ≥ 0 and start ≤ end")
    if scene.render.use_border or scene.render.use_multiview:
        raise SystemExit("render regions and stereo cannot be exported: switch them off")


def _prepare(scene, every: int):
    """Passes, samples and time. Returns the view layers of colour and of data."""
    color = bpy.context.view_layer
    for layer in scene.view_layers:
        layer.use = False
    data = scene.view_layers.get(LAYER) or scene.view_layers.new(LAYER)
    _copy_visibility(color.layer_collection, data.layer_collection)
    _only_passes(color, "combined")
    _only_passes(data, "z", "vector")
    if scene.cycles.use_layer_samples == "IGNORE":
        color.samples = 0
    data.samples = 1  # the first sample is the pixel's centre, and the passes are means over samples
    scene.cycles.use_layer_samples = "USE"
    data.cycles.use_denoising = False
    for one in bpy.data.objects:  # off, an object has no vectors either
        one.cycles.use_motion_blur = one.cycles.use_deform_motion = True
    render = scene.render
    render.use_motion_blur = False  # with it, vectors are zero
    if scene.camera.data.dof.use_dof:
        print("depth of field is switched off: depth and vectors of one sample do not fit to it")
        scene.camera.data.dof.use_dof = False
    render.use_compositing = render.use_sequencer = False
    render.use_persistent_data = False
    render.frame_map_new = _MOST // every  # Blender's previous frame becomes the previous rendered one
    render.frame_map_old = every * render.frame_map_new
    settings = render.image_settings
    if hasattr(settings, "media_type"):  # Blender 5
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format, settings.color_depth = "OPEN_EXR_MULTILAYER", "16"  # half for colours, float for the rest
    settings.exr_codec = "ZIP"
    render.use_file_extension = False
    return color, data


def _only_passes(layer, *wanted: str) -> None:
    for name in dir(layer):
        if name.startswith("use_pass_"):
            setattr(layer, name, name.removeprefix("use_pass_") in wanted)


def _copy_visibility(source, target) -> None:
    for name in ("exclude", "holdout", "indirect_only", "hide_viewport"):
        setattr(target, name, getattr(source, name))
    for child in source.children:
        _copy_visibility(child, target.children[child.name])


def _set_time(scene, frame: float) -> None:
    whole = int(frame // 1)
    subframe = frame - whole
    if subframe > 1 - 1e-6:
        whole, subframe = whole + 1, 0.0
    scene.frame_set(whole, subframe=subframe)


def _size(scene) -> tuple[int, int]:
    render = scene.render
    return (
        render.resolution_x * render.resolution_percentage // 100,
        render.resolution_y * render.resolution_percentage // 100,
    )


def _described(scene, moment: Moment) -> dict:
    """The frame with its camera, pixels from the top left corner, as `cameras.json` has it."""
    width, height = _size(scene)
    graph = bpy.context.evaluated_depsgraph_get()
    camera = scene.camera.evaluated_get(graph)
    aspect = {"scale_x": scene.render.pixel_aspect_x, "scale_y": scene.render.pixel_aspect_y}
    projection = camera.calc_matrix_camera(graph, x=width, y=height, **aspect)
    return {
        "frame": moment.index,
        "file": None if moment.kind == "camera_only" else moment.file,
        "kind": moment.kind,
        "time": moment.time,
        "scene_frame": moment.scene_frame,
        "world_to_camera": _world_to_view(np.array(camera.matrix_world, np.float64)).tolist(),
        "fx": projection[0][0] * width / 2,
        "fy": projection[1][1] * height / 2,
        "cx": (1 - projection[0][2]) * width / 2,
        "cy": (1 + projection[1][2]) * height / 2,
    }


def _world_to_view(camera_to_world: np.ndarray) -> np.ndarray:
    """The rigid part of the camera's matrix, which Blender keeps in single precision, inverted."""
    left, _, right = np.linalg.svd(camera_to_world[:3, :3])
    pose = camera_to_world.copy()
    pose[:3, :3] = left @ right
    return _VIEW_AXES @ np.linalg.inv(pose)


def _render(scene, path: Path, color, data) -> None:
    color.use = True
    scene.view_layers[LAYER].use = data is not None

    def render(path: Path) -> None:
        scene.render.filepath = os.fspath(path.absolute())
        bpy.ops.render.render(write_still=True)

    _written(path, render)


def _written(path: Path, write) -> None:
    """A file is whole or not there at all."""
    part = path.with_name(f".{path.name}.part")
    write(part)
    os.replace(part, path)


def main(argv: list[str]) -> None:
    before, _, after = _split(argv)
    parser = argparse.ArgumentParser("export_gffe.py", description=__doc__.partition("\n")[0])
    parser.add_argument("out", help="folder to write")
    parser.add_argument("--every", type=int, default=1, help="every so many frames of the scene are rendered")
    parser.add_argument("--between", type=int, help="frames of truth after each; default: every - 1")
    parser.add_argument("--start", type=int, help="first frame; default: the scene's")
    parser.add_argument("--end", type=int, help="last frame; default: the scene's")
    parser.add_argument("--no-truth", action="store_true", help="of frames in between, write the camera only")
    parser.add_argument("--overwrite", action="store_true", help="render frames anew whose files are there")
    given = parser.parse_args(after)
    if not bpy.app.binary_path:  # the wheel: nothing is open yet
        if len(before) != 1:
            parser.error("expected: export_gffe.py scene.blend -- OUT …")
        bpy.ops.wm.open_mainfile(filepath=before[0])
    export(given.out, given.every, given.between, given.start, given.end, not given.no_truth, given.overwrite)


def _split(argv: list[str]) -> tuple[list[str], str, list[str]]:
    at = argv.index("--") if "--" in argv else len(argv)
    return argv[:at], "--", argv[at + 1 :]


if __name__ == "__main__":
    main(sys.argv[1:])
