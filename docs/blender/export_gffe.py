"""Renders a Blender scene (Cycles) to frames with color, depth and motion vectors, truth in between, and cameras.

    blender -b scene.blend --python export_gffe.py -- OUT --every 2
    python export_gffe.py scene.blend -- OUT --every 2                   with the `bpy` wheel of PyPI

OUT gets `cameras.json` and one multilayer EXR per frame, `frame_NNNN.exr`. Of the scene's range, every `--every`-th
frame is *rendered*; between two of them lie `--between` frames of truth, evenly spaced, by default those frames of the
scene that do. A rendered frame holds the scene's own view layer (`Combined`: antialiased, half) and a layer `Data` of
one sample at the pixel's center: `Depth.Z`, planar, 1e10 where nothing is, and `Vector.X`, `.Y`, pixels with y up, the
place in the previous *rendered* frame minus the place here. Truth holds the color only. The .blend file is never
written to.

Files that are there already are kept, so that an interrupted export goes on where it stopped; `--overwrite` renders
them anew.
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
    """All frames of the export, in order: of the frames `start` … `end`, up to the end of the last one's duration."""
    found = []
    for rendered in range(start, end + 1, every):
        for j in range(between + 1):
            scene_frame = rendered + every * j / (between + 1)
            if scene_frame < end + 1:
                kind = KINDS[0] if j == 0 else KINDS[1] if truth else KINDS[2]
                found.append(Moment(len(found), scene_frame, (scene_frame - start) / fps, kind))
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
    """Render the current scene, whose settings are changed, into the folder `out`. `start` and `end` default to the
    scene's range, `between` to every − 1; without `truth`, frames in between are cameras only."""
    scene = bpy.context.scene
    between = every - 1 if between is None else between
    start, end = (scene.frame_start if start is None else start), (scene.frame_end if end is None else end)
    _require(scene, start, end, every, between)
    data = _prepare(scene, every)
    frames = moments(start, end, every, between, scene.render.fps / scene.render.fps_base, truth)
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    _write_cameras(scene, out / "cameras.json", frames, every, overwrite)
    for moment in frames:
        if moment.kind != "camera_only" and (overwrite or not (out / moment.file).exists()):
            _set_time(scene, moment.scene_frame / every)
            data.use = moment.kind == "rendered"
            _render(scene, out / moment.file)
            print(f"{moment.file}: {moment.kind}, frame {moment.scene_frame:g}", flush=True)


def _require(scene, start: int, end: int, every: int, between: int) -> None:
    render = scene.render
    if render.engine != "CYCLES":
        raise SystemExit(f"the render engine is {render.engine} (expected CYCLES: only its vectors are exact)")
    if scene.camera is None or scene.camera.data.type != "PERSP":
        raise SystemExit("the scene needs an active camera with a perspective lens")
    if not (1 <= every <= _MOST and between >= 0 and start <= end):
        raise SystemExit(f"expected 1 ≤ every ≤ {_MOST}, between ≥ 0 and start ≤ end")
    if render.use_border or render.use_multiview:
        raise SystemExit("a render region or stereo cannot be exported: switch it off")
    if render.pixel_aspect_x != render.pixel_aspect_y:
        raise SystemExit("pixels must be square: Blender cannot write others to multi-part EXR")
    if render.frame_map_old != render.frame_map_new:
        raise SystemExit("the scene stretches time: set Time Stretching's Old and New to the same value")


def _prepare(scene, every: int) -> bpy.types.ViewLayer:
    """Set passes, samples, output and time. Returns the view layer of data."""
    color = bpy.context.view_layer
    for layer in scene.view_layers:
        layer.use = layer == color
    data = scene.view_layers.new("Data")
    for name in ("use_solid", "use_strand", "use_volumes", "material_override"):
        setattr(data, name, getattr(color, name))
    _copy_visibility(color.layer_collection, data.layer_collection)
    _only_passes(color, "combined")
    _only_passes(data, "z", "vector")
    cycles, render = scene.cycles, scene.render
    if cycles.use_layer_samples == "IGNORE":
        color.samples = 0
    cycles.use_layer_samples = "USE"
    data.samples = 1  # passes are means over samples, of which the first lies at the pixel's center
    cycles.sample_offset = 0
    data.cycles.use_denoising = False
    for one in bpy.data.objects:  # of the camera: else its part of the vectors is missing
        one.cycles.use_motion_blur = one.cycles.use_deform_motion = True
    render.use_motion_blur = False  # with it, all vectors are zero
    if scene.camera.data.dof.use_dof:
        print("depth of field is switched off: depth and vectors cannot be out of focus")
        scene.camera.data.dof.use_dof = False
    render.use_compositing = render.use_sequencer = False
    render.frame_map_new = _MOST // every  # Blender's previous frame becomes the previous rendered one
    render.frame_map_old = every * render.frame_map_new
    settings = render.image_settings
    if hasattr(settings, "media_type"):  # Blender 5
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format, settings.exr_codec = "OPEN_EXR_MULTILAYER", "ZIP"
    settings.color_depth = "16"  # of colors: depth and vectors are float all the same
    render.use_file_extension = False
    return data


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


def _write_cameras(scene, path: Path, frames: list[Moment], every: int, overwrite: bool) -> None:
    described = []
    for moment in frames:
        _set_time(scene, moment.scene_frame / every)
        described.append(_described(scene, moment))
    width, height = _size(scene)
    text = json.dumps({"width": width, "height": height, "frames": described}, indent=1) + "\n"
    if path.exists() and path.read_text() != text and not overwrite:
        raise SystemExit(f"{path.parent} holds another export: choose another folder, or --overwrite")
    _whole(path, lambda part: part.write_text(text))


def _described(scene, moment: Moment) -> dict:
    """The frame with its camera: x right, y down, z forward; pixels from the top left corner."""
    width, height = _size(scene)
    graph = bpy.context.evaluated_depsgraph_get()
    camera = scene.camera.evaluated_get(graph)
    projection = camera.calc_matrix_camera(graph, x=width, y=height)
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


def _render(scene, path: Path) -> None:
    def render(part: Path) -> None:
        scene.render.filepath = os.fspath(part.absolute())
        bpy.ops.render.render(write_still=True)

    _whole(path, render)


def _whole(path: Path, write) -> None:
    """A file is whole or not there at all."""
    part = path.with_name(f".{path.name}.part")
    write(part)
    os.replace(part, path)


def main(argv: list[str]) -> None:
    at = argv.index("--") if "--" in argv else len(argv)
    before, after = argv[:at], argv[at + 1 :]
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


if __name__ == "__main__":
    main(sys.argv[1:])
