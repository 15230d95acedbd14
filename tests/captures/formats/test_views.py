"""EXR files with several views or parts: what is ambiguous is an error that lists the candidates."""

import json

import folder_captures
import numpy as np
import OpenEXR
import pytest
from folder_captures import rendered as frames
from foreign import FPS, H, W, edit_json, write_exr

from gffe_cl import GffeError, open_capture


def channels(shot):
    """R, G, B, Z, motion.x and motion.y."""
    color = dict(zip("RGB", np.moveaxis(shot.color, -1, 0), strict=True))
    motion = shot.motion.astype(np.float32)
    return color | {"Z": shot.depth, "motion.x": motion[..., 0], "motion.y": motion[..., 1]}


def write_parts(path, parts):
    """`parts`: name, view or None, channels."""
    made = []
    for name, view, held in parts:
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        header |= {"view": view} if view else {}
        made.append(OpenEXR.Part(header, {n: np.ascontiguousarray(c) for n, c in held.items()}, name))
    OpenEXR.File(made).write(str(path))


def picked(held, *names):
    return {name: held[name] for name in names}


def described(folder, form, **parts):
    buffers = {"color": {"file": "f%d.exr"}, "depth": {"file": "f%d.exr", "channels": ["Z"]}}
    buffers["motion"] = {"file": "f%d.exr", "channels": ["motion.x", "motion.y"]}
    said = folder_captures.described(frames={"count": 3}, **buffers | parts)
    if form == "own":
        said = {"format": "gffe-sequence", "version": 1, "width": W, "height": H, "fps": FPS, "frames": []}
        for k, shot in enumerate(frames()):
            camera = {"world_to_view": shot.camera.world_to_view.tolist(), **folder_captures.focal(shot.camera)}
            entry = {"file": f"f{k}.exr", "time": k / FPS, "kind": "rendered", "render_camera": camera}
            said["frames"].append(entry)
    (folder / "sequence.json").write_text(json.dumps(said))


@pytest.mark.parametrize("form", ["own", "folder"])
@pytest.mark.parametrize("single", [False, True])
def test_several_views_are_refused(tmp_path, form, single):
    """Parts with the attribute `view`, or one part whose `multiView` lists them: color of one eye must not meet depth
    of the other."""
    for k, shot in enumerate(frames()):
        held = channels(shot)
        if single:
            held |= {f"right.{name}": held[name] for name in "RGB"}
            write_exr(tmp_path / f"f{k}.exr", held, multiView=["left", "right"])
        else:
            write_parts(tmp_path / f"f{k}.exr", [("a", "left", held), ("b", "right", picked(held, *"RGB"))])
    described(tmp_path, form)
    with pytest.raises(GffeError, match=r"^f0.exr: holds the views left, right \(expected a file for each view\)"):
        open_capture(tmp_path)


@pytest.mark.parametrize("form", ["own", "folder"])
def test_one_name_in_several_parts_is_refused(tmp_path, form):
    for k, shot in enumerate(frames()):
        held = channels(shot)
        parts = [("depth", None, {c: held["Z"] for c in "RGB"} | {"Z": held["Z"]})]
        parts += [("motion", None, picked(held, "motion.x", "motion.y")), ("rgba", None, picked(held, *"RGB"))]
        write_parts(tmp_path / f"f{k}.exr", parts)
    described(tmp_path, form)
    with pytest.raises(GffeError, match=r"f0.exr: channel 'R' is in the parts depth, rgba \(expected part.channel"):
        open_capture(tmp_path)
    if form == "folder":
        named = {"file": "f%d.exr", "channels": ["rgba.R", "rgba.G", "rgba.B"]}
        edit_json(tmp_path / "sequence.json", lambda said: said["files"].update(color=named))
        sequence = open_capture(tmp_path)
        np.testing.assert_array_equal(sequence.read_color(sequence.rendered[0]), frames()[0].color)
