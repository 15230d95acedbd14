"""EXR files of stereo cameras: all buffers come from one view, whatever the order of parts; what stays ambiguous is an
error that lists the candidates."""

import json

import folder_captures
import numpy as np
import OpenEXR
import pytest
from folder_captures import rendered as frames
from foreign import FPS, H, W, blender_layers, edit_json, shots, write_blender, write_exr

from gffe_cl import GffeError, open_capture

VIEWS = {"left": 1.0, "right": 3.0}  # every value of a view's buffers is that many times the scene's


def channels(shot, view):
    """R, G, B, Z, motion.x and motion.y of one eye."""
    factor = VIEWS[view]
    color = dict(zip("RGB", np.moveaxis((shot.color * np.float16(factor)), -1, 0), strict=True))
    motion = shot.motion.astype(np.float32) * np.float32(factor)
    return color | {"Z": shot.depth * np.float32(factor), "motion.x": motion[..., 0], "motion.y": motion[..., 1]}


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


def several_parts(path, shot, first="right", only="left"):
    """The color of both views, the first one's before; depth and motion of one only."""
    last = next(view for view in VIEWS if view != first)
    one = channels(shot, only)
    write_parts(
        path,
        [
            (f"rgba_{first}", first, picked(channels(shot, first), *"RGB")),
            (f"depth_{only}", only, picked(one, "Z")),
            (f"motion_{only}", only, picked(one, "motion.x", "motion.y")),
            (f"rgba_{last}", last, picked(channels(shot, last), *"RGB")),
        ],
    )


def single_part(path, shot, first="right", only="left"):
    """`multiView` lists the views; channels of its first one have plain names."""
    last = next(view for view in VIEWS if view != first)
    held = {}
    for view in (first, last):
        names = "RGB" if view != only else channels(shot, view)
        for name in names:
            layer, _, component = name.rpartition(".")
            inserted = ".".join(filter(None, (layer, view, component)))
            held[name if view == first and not layer else inserted] = channels(shot, view)[name]
    write_exr(path, held, multiView=[first, last])


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


def is_view(sequence, view):
    """Whether color, depth and motion of all frames are those of one view."""
    for k, (entry, shot) in enumerate(zip(sequence.rendered, frames(), strict=True)):
        frame, held = sequence.read(entry), channels(shot, view)
        np.testing.assert_array_equal(np.moveaxis(frame.color, -1, 0), [held[name] for name in "RGB"])
        np.testing.assert_array_equal(frame.depth, held["Z"])
        if k:
            np.testing.assert_array_equal(frame.motion[..., 1], held["motion.y"])
    return True


@pytest.mark.parametrize("form", ["own", "folder"])
@pytest.mark.parametrize("write", [several_parts, single_part])
@pytest.mark.parametrize("first", VIEWS)
@pytest.mark.parametrize("only", VIEWS)
def test_color_is_that_of_the_view_with_depth(tmp_path, form, write, first, only):
    for k, shot in enumerate(frames()):
        write(tmp_path / f"f{k}.exr", shot, first, only)
    described(tmp_path, form)
    sequence = open_capture(tmp_path)
    assert is_view(sequence, only)
    assert [text for text in sequence.notes if "views left, right" in text and f"{only} is used" in text]


def test_a_view_is_chosen_by_the_description(tmp_path):
    for k, shot in enumerate(frames()):
        parts = [(view, view, channels(shot, view)) for view in VIEWS]
        write_parts(tmp_path / f"f{k}.exr", parts)
    described(tmp_path, "folder")
    assert is_view(open_capture(tmp_path), "left")  # the first of equals
    edit_json(tmp_path / "sequence.json", lambda said: said.update(view="right"))
    assert is_view(open_capture(tmp_path), "right")
    edit_json(tmp_path / "sequence.json", lambda said: said.update(view="middle"))
    with pytest.raises(GffeError, match=r"no view middle of all buffers \(the files hold color of left, right; depth"):
        open_capture(tmp_path)


def test_files_of_several_views_and_of_one(tmp_path):
    """The color has both, depth and motion are in files of their own, of one."""
    for k, shot in enumerate(frames()):
        one = channels(shot, "right")
        write_parts(tmp_path / f"f{k}.exr", [(v, v, picked(channels(shot, v), *"RGB")) for v in VIEWS])
        write_parts(tmp_path / f"z{k}.exr", [("a", "right", picked(one, "Z"))])
        write_parts(tmp_path / f"m{k}.exr", [("b", "right", picked(one, "motion.x", "motion.y"))])
    motion = {"file": "m%d.exr", "channels": ["motion.x", "motion.y"]}
    described(tmp_path, "folder", depth={"file": "z%d.exr", "channels": ["Z"]}, motion=motion)
    assert is_view(open_capture(tmp_path), "right")


@pytest.mark.parametrize("form", ["own", "folder"])
def test_one_name_in_several_parts_is_refused(tmp_path, form):
    for k, shot in enumerate(frames()):
        held = channels(shot, "left")
        parts = [("depth", None, {c: held["Z"] for c in "RGB"} | {"Z": held["Z"]})]
        parts += [("motion", None, picked(held, "motion.x", "motion.y")), ("rgba", None, picked(held, *"RGB"))]
        write_parts(tmp_path / f"f{k}.exr", parts)
    described(tmp_path, form)
    with pytest.raises(GffeError, match=r"f0.exr: channel 'R' is in the parts depth, rgba \(expected part.channel"):
        open_capture(tmp_path)
    if form == "folder":
        named = {"file": "f%d.exr", "channels": ["rgba.R", "rgba.G", "rgba.B"]}
        edit_json(tmp_path / "sequence.json", lambda said: said.update(color=named))
        assert is_view(open_capture(tmp_path), "left")


@pytest.mark.parametrize("first", VIEWS)
@pytest.mark.parametrize("ending", ["", "-", "."])
def test_blender_renders_several_views(tmp_path, ending, first):
    """A part for each pass and view, of which the first one counts; or with no `ending` a single part, with views in
    the names of channels."""
    write_blender(tmp_path, shots())
    views = sorted(VIEWS, key=lambda view: view != first)
    for k, shot in enumerate(shots()):
        parts, single = [], {}
        for view in views:
            for layer, passes in blender_layers(shot).items():
                held = {name: c if view == first else c * 0 for name, c in passes.items()}
                parts.append((f"{layer}{ending}{view}", view, {f"{layer}.{name}": c for name, c in held.items()}))
                single |= {f"{layer}.{view}.{name}": c for name, c in held.items()}
        path = tmp_path / f"frame_{k:04d}.exr"
        write_parts(path, parts) if ending else write_exr(path, single, multiView=views)
    sequence = open_capture(tmp_path)
    for entry, shot in zip(sequence.rendered, frames(), strict=True):
        frame = sequence.read(entry)
        np.testing.assert_array_equal(frame.color, shot.color)
        np.testing.assert_array_equal(frame.depth, shot.depth)
        np.testing.assert_array_equal(frame.motion, shot.motion)
    assert any(f"{first} is used" in text for text in sequence.notes)
