"""`gffe-folder`: a built-in scene written in many conventions, and read back within the precision of the format."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from folder_captures import FILES, described, focal, rendered, write
from foreign import FPS, H, W, edit_json, shots, write_exr
from PIL import Image

from gffe_cl import Camera, FrameFormat, GffeError, Options, Pipeline, open_capture

NEAR, FAR = 0.05, 400.0
DOCS = Path(__file__).parents[3] / "docs"


def same(sequence, depth=0.0, motion=0.0, color=0.0, camera=1e-9):
    """Whether everything is as rendered: depth to a relative, motion and color to an absolute difference."""
    assert (sequence.width, sequence.height, sequence.fps, len(sequence.rendered)) == (W, H, FPS, 3)
    for k, (entry, shot) in enumerate(zip(sequence.rendered, rendered(), strict=True)):
        frame = sequence.read(entry)
        assert frame.reset == (k == 0) and frame.time == pytest.approx(k / FPS)
        np.testing.assert_allclose(frame.color, shot.color, atol=color, rtol=0)
        np.testing.assert_allclose(frame.depth, shot.depth, rtol=depth)
        assert (frame.motion is None) == (k == 0)
        if k:
            np.testing.assert_allclose(frame.motion, shot.motion, atol=motion + 1e-12, rtol=1e-6 * (motion > 0))
        np.testing.assert_allclose(frame.camera.world_to_view, shot.camera.world_to_view, atol=camera)
        np.testing.assert_allclose(frame.camera.intrinsics, shot.camera.intrinsics, atol=camera * W)
        assert frame.depth.dtype == np.float32 and frame.color.dtype in (np.float16, np.float32)


def test_plain(tmp_path):
    same(write(tmp_path))
    sequence = open_capture(tmp_path / "sequence.json")
    assert sequence.read_color(sequence.frames[0]).dtype == np.float16
    assert sequence.format is None and not sequence.notes


@pytest.mark.parametrize("ending", [".NPY", ".npy"])
def test_endings_may_be_in_capital_letters(gffe, tmp_path, ending):
    """Of files of buffers and cameras, described with either ending."""
    (tmp_path / "in").mkdir()
    write(tmp_path / "in", color=f"c%d{ending}", also=with_capitals)
    edit_json(tmp_path / "in/sequence.json", lambda d: split_cameras(tmp_path / "in", d))
    same(open_capture(tmp_path / "in"))
    assert gffe("import", tmp_path / "in", tmp_path / "out")[0] == 0


def with_capitals(folder, number, shot):
    np.save(folder / "saved.npy", shot.color)
    (folder / "saved.npy").rename(folder / f"c{number}.{'npy' if number == 4 else 'NPY'}")


def split_cameras(folder, document):
    """Move the cameras to files with endings in capital letters."""
    for number, camera in enumerate(document["cameras"].pop("list"), 3):
        (folder / f"camera{number}.JSON").write_text(json.dumps(camera))
    document["cameras"]["file"] = "camera%d.json"


# Buffers in an engine's form


def device_depth(shot, near=NEAR, far=FAR, reverse=False):
    z = np.float64(shot.depth)
    value = near / z if np.isinf(far) else near * (far - np.minimum(z, 1e30)) / (np.minimum(z, 1e30) * (far - near))
    value = np.where(np.isinf(z), 0, value)
    return (value if reverse else 1 - value).astype(np.float32 if reverse else np.float64)


def distance(shot):
    y, x = np.mgrid[:H, :W] + 0.5
    world = shot.camera.unproject(np.stack([x, y], -1), np.where(np.isinf(shot.depth), 1e9, shot.depth))
    return 100 * np.linalg.norm(world - shot.camera.position, axis=-1)


DEVICE = {"depth": "device", "near_z": NEAR, "far_z": FAR}
DEPTHS = {
    "device": (device_depth, DEVICE, {}),
    "reversed": (lambda shot: device_depth(shot, reverse=True), DEVICE | {"depth_range": [1, 0]}, {}),
    "inverse": (lambda shot: 1 / shot.depth, DEVICE | {"near_z": 1, "far_z": "infinity", "depth_range": [1, 0]}, {}),
    "distance": (distance, {"depth": "distance", "depth_scale": 0.01}, {"sky_from": 1e10}),
    "a value for sky": (lambda shot: np.where(np.isinf(shot.depth), -1, shot.depth), {}, {"sky": -1}),
}


@pytest.mark.parametrize("depth", DEPTHS)
def test_depth(tmp_path, depth):
    encode, fields, keys = DEPTHS[depth]
    made = write(tmp_path, encode, depth={"file": "depth_%d.npy", **keys}, frame_format=fields)
    same(made, depth=1e-5)
    assert made.format == (FrameFormat.from_json(fields) if fields else None)


def test_everything_at_once_and_on_the_device(tmp_path, device):
    """Rows from below, sRGB of 8 bits, vectors in UV with y up: read, and given to a pipeline as they are stored."""

    def images(folder, number, shot):
        linear = np.clip(np.float64(shot.color[::-1]), 0, 1)
        srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        Image.fromarray((srgb * 255).round().astype(np.uint8)).save(folder / f"c{number}.png")

    fields = {
        "rows": "up",
        "color_encoding": "srgb",
        "motion_unit": "uv",
        "motion_y": "up",
        "motion_scale": [2, 2],
        "motion_offset": [-1, -1],
        "motion_direction": "from_previous",
    }
    sequence = write(
        tmp_path,
        lambda shot: shot.depth[::-1],
        lambda shot: ((shot.motion / (-W, H) + 1) / 2)[::-1],
        images,
        color="c%d.png",
        frame_format=fields,
    )
    pipeline = Pipeline(device, W, H, Options(shading_correction=False), format=sequence.format)
    for entry, shot in zip(sequence.rendered, rendered(), strict=True):
        frame = sequence.read(entry)
        np.testing.assert_array_equal(frame.depth, shot.depth)
        np.testing.assert_allclose(frame.color, np.clip(shot.color, 0, 1), atol=0.006)
        np.testing.assert_array_equal(sequence.read_color(entry), frame.color)
        if not frame.reset:
            np.testing.assert_allclose(frame.motion, shot.motion, atol=1e-4)
        pipeline.submit(sequence.read_stored(entry))
        shown = pipeline.present()
        np.testing.assert_allclose(shown.numpy("color"), frame.color, atol=1e-3)
        np.testing.assert_array_equal(shown.numpy("depth"), frame.depth)


@pytest.mark.parametrize("command", ["import", "run"])
def test_commands_keep_the_format(gffe, tmp_path, command):
    """What they write of integer colors and stored depth opens with the same pixels."""

    def images(folder, number, shot):
        Image.fromarray((np.clip(np.float64(shot.color), 0, 1) * 255).astype(np.uint8)).save(folder / f"c{number}.png")

    (tmp_path / "in").mkdir()
    given = write(
        tmp_path / "in",
        lambda shot: np.float32(NEAR / shot.depth),
        also=images,
        color="c%d.png",
        frame_format=DEVICE | {"far_z": "infinity", "depth_range": [1, 0]},
    )
    assert gffe(command, tmp_path / "in", tmp_path / "out", *(["--no-scn"] if command == "run" else []))[0] in (0, 1)
    made = open_capture(tmp_path / "out")
    for entry, other in zip(given.rendered, made.rendered, strict=True):
        for name in ("color", "depth", "motion"):
            one, two = getattr(given.read(entry), name), getattr(made.read(other), name)
            assert (one is None and two is None) or np.array_equal(one, two)


def test_sixteen_bits_in_a_png(tmp_path):
    """Millimeters, as depth sensors have them: 0 is nothing."""

    def images(folder, number, shot):
        millimeters = np.where(shot.depth < 65, shot.depth * 1000, 0).round().astype(np.uint16)
        Image.fromarray(millimeters).save(folder / f"depth_{number}.png")

    said = {"file": "depth_%d.png", "values": "raw", "sky": 0}
    sequence = write(tmp_path, also=images, depth=said, frame_format={"depth_scale": 0.001})
    for entry, shot in zip(sequence.rendered, rendered(), strict=True):
        np.testing.assert_allclose(sequence.read(entry).depth, shot.depth, atol=0.00051)


def test_motion_of_integers(tmp_path):
    """16 bits from 0 to 1 around the middle, and raw ones."""
    for values, of in (
        ("normalized", {"motion_unit": "uv", "motion_scale": [2, 2], "motion_offset": [-1, -1]}),
        ("raw", {"motion_scale": [1 / 64, 1 / 64], "motion_offset": [-512, -512]}),
    ):
        made = {"normalized": lambda m: (m / (W, H) + 1) / 2 * 65535, "raw": lambda m: m * 64 + 2**15}[values]
        (tmp_path / values).mkdir()
        said = {"file": "motion.%03d.npy", "values": values}
        sequence = write(
            tmp_path / values,
            motion_as=lambda shot, made=made: made(np.float64(shot.motion)).round().astype(np.uint16),
            motion=said,
            frame_format=of,
        )
        same(sequence, motion=1 / 64)


def test_motion_without_jitter(tmp_path):
    """Cameras that jitter, and motion that does not: ours does."""
    jitter = np.array([[0.25, -0.375], [-0.125, 0.5], [0.4375, 0.0625]])
    cameras = []
    for shot, (x, y) in zip(rendered(), jitter, strict=True):
        plain = replace(shot.camera, cx=shot.camera.cx - x, cy=shot.camera.cy - y)
        jittered = {"view": plain.world_to_view.tolist(), **focal(plain), "jitter": [x / W * 2, -y / H * 2]}
        cameras.append(jittered)
    steps = iter([np.zeros(2), *np.diff(jitter, axis=0)])
    rules = {"list": cameras, "jitter": {"unit": "ndc", "y": "up", "in_projection": False}}
    said = {"file": "motion.%03d.npy", "without_jitter": True}
    same(write(tmp_path, motion_as=lambda shot: shot.motion + next(steps), cameras=rules, motion=said), motion=1e-5)


def test_flow_to_the_next_frame(tmp_path):
    """Forward flow of the frame before, inverted: as our motion wherever that surface was seen before."""
    frames = rendered()
    y, x = np.mgrid[:H, :W] + 0.5
    here = np.stack([x, y], -1)

    def flow(shot):
        after = frames[min(frames.index(shot) + 1, 2)]
        world = shot.camera.unproject(here, np.where(np.isinf(shot.depth), 1e6, shot.depth))
        return after.camera.project(world)[0] - here

    sequence = write(tmp_path, motion_as=flow, motion={"file": "motion.%03d.npy", "to_next": True})
    for entry, shot, before in zip(sequence.rendered[1:], frames[1:], frames, strict=False):
        world = shot.camera.unproject(here, np.where(np.isinf(shot.depth), 1e6, shot.depth))
        still = before.camera.project(world)[0] - here
        off = np.linalg.norm(sequence.read(entry).motion - still, axis=-1)
        assert np.percentile(off, 99) < 0.05 and np.linalg.norm(still, axis=-1).max() > 0.3


def test_buffers_of_other_frames(tmp_path):
    """Motion that was recorded a frame late is in the file of the next frame; the last one is left out."""
    given = rendered()
    sequence = write(
        tmp_path,
        motion_as=lambda shot: given[max(given.index(shot) - 1, 0)].motion,
        motion={"file": "motion.%03d.npy", "frame_offset": 1},
    )
    assert len(sequence.rendered) == 2
    np.testing.assert_array_equal(sequence.read(sequence.rendered[1]).motion, given[1].motion.astype(np.float32))


UNWRITTEN = np.random.default_rng(4).random((H, W)) < 0.3
NONES = {
    "a channel": ({"valid": "B"}, {}, lambda m: np.dstack([np.where(UNWRITTEN[..., None], 0, m), ~UNWRITTEN])),
    "a value": ({"unknown": -1}, {}, lambda m: np.where(UNWRITTEN[..., None], -1, m)),
    "a value of the format": ({}, {"motion_invalid": -1}, lambda m: np.where(UNWRITTEN[..., None], -1, m)),
    "large values": ({"unknown_from": 6e4}, {}, lambda m: np.where(UNWRITTEN[..., None], [65504, 0], m)),
}


@pytest.mark.parametrize("said", NONES)
def test_vectors_that_were_never_written_are_nan(tmp_path, said):
    keys, fields, made = NONES[said]
    sequence = write(
        tmp_path,
        motion_as=lambda shot: made(shot.motion).astype(np.float32),
        motion={"file": "motion.%03d.npy", **keys},
        frame_format=fields,
    )
    frame, shot = sequence.read(sequence.rendered[1]), rendered()[1]
    assert (np.isnan(frame.motion).all(-1) == UNWRITTEN).all()
    np.testing.assert_array_equal(frame.motion[~UNWRITTEN], shot.motion[~UNWRITTEN].astype(np.float32))


def test_depth_that_was_never_written_is_nan(tmp_path):
    said = {"file": "depth_%d.npy", "unknown": -7}
    sequence = write(tmp_path, lambda shot: np.where(UNWRITTEN, np.float32(-7), shot.depth), depth=said)
    assert (np.isnan(sequence.read(sequence.rendered[1]).depth) == UNWRITTEN).all()


WINDOWS = {
    "shifted": (-25, 10, 72, 65),
    "smaller": (20, 10, 67, 50),
    "larger": (-8, -8, 105, 63),
    "beside": (200, 0, 210, 9),
}


@pytest.mark.parametrize("window", WINDOWS)
def test_pixels_lie_where_the_data_window_says(tmp_path, window):
    """Outside color is black, depth and motion are unknown."""
    x0, y0, x1, y1 = WINDOWS[window]
    y, x = np.clip(np.arange(y0, y1), 0, H - 1), np.clip(np.arange(x0, x1), 0, W - 1)
    box = {
        "dataWindow": (np.array([x0, y0], np.int32), np.array([x1 - 1, y1 - 1], np.int32)),
        "displayWindow": (np.zeros(2, np.int32), np.array([W - 1, H - 1], np.int32)),
    }

    def files(folder, number, shot):
        planes = dict(zip("RGB", np.moveaxis(shot.color, -1, 0), strict=True)) | {"Z": shot.depth}
        planes |= {"u": np.float32(shot.motion[..., 0]), "v": np.float32(shot.motion[..., 1])}
        write_exr(folder / f"f{number}.exr", {name: plane[np.ix_(y, x)] for name, plane in planes.items()}, windows=box)

    named = {
        "color": "f%d.exr",
        "depth": {"file": "f%d.exr", "channels": ["Z"]},
        "motion": {"file": "f%d.exr", "channels": ["u", "v"]},
    }
    sequence = write(tmp_path, also=files, **named)
    frame, shot = sequence.read(sequence.rendered[1]), rendered()[1]
    inside = np.zeros((H, W), bool)
    inside[max(y0, 0) : max(y1, 0), max(x0, 0) : max(x1, 0)] = True
    np.testing.assert_array_equal(frame.color, np.where(inside[..., None], shot.color, 0))
    np.testing.assert_array_equal(frame.depth, np.where(inside, shot.depth, np.nan))
    np.testing.assert_array_equal(frame.motion, np.where(inside[..., None], shot.motion, np.nan).astype(np.float32))


# Cameras


APIS = {"opengl": "opengl", "direct3d": "direct3d", "vulkan": "vulkan", "unity": "opengl", "unreal": "direct3d"}


@pytest.mark.parametrize("layout", ["row-major", "column-major", "auto"])
@pytest.mark.parametrize("convention", APIS)
def test_matrices(tmp_path, convention, layout):
    """View and projection of every convention, with device depth that the projection explains."""
    api, cameras = APIS[convention], []
    for k, shot in enumerate(rendered()):
        v = shot.camera.view_matrix(api).copy()
        v[:3, 3] *= 100  # centimeters
        p = shot.camera.projection_matrix(api, W, H, NEAR * 100, reverse_depth=True)
        v, p = (m.T if layout == "column-major" else m for m in (v, p))
        cameras.append({"view": v.tolist(), "projection": p.ravel().tolist() if k else p.tolist()})
    rules = {"convention": convention, "layout": layout, "scale": 0.01, "opengl_buffer": False, "list": cameras}
    sequence = write(
        tmp_path,
        lambda shot: device_depth(shot, far=np.inf, reverse=True),
        frame_format={"depth": "device"},
        cameras=rules,
    )
    for entry, shot in zip(sequence.rendered, rendered(), strict=True):
        np.testing.assert_allclose(sequence.read(entry).depth, shot.depth, rtol=1e-4)
        np.testing.assert_allclose(entry.render_camera.world_to_view, shot.camera.world_to_view, atol=1e-9)
        np.testing.assert_allclose(entry.render_camera.intrinsics, shot.camera.intrinsics, rtol=1e-9)


def of_opengl(change=lambda p: None):
    cameras = []
    for shot in rendered():
        p = shot.camera.projection_matrix("opengl", W, H, NEAR, FAR)
        change(p)
        cameras.append({"view": shot.camera.view_matrix("opengl").tolist(), "projection": p.tolist()})
    return {"convention": "opengl", "list": cameras}


def test_planes_of_every_frame(tmp_path):
    """Near planes that change from frame to frame."""
    nears = iter([0.05, 0.1, 0.2])
    stored = iter([0.05, 0.1, 0.2])

    def change(p):
        near = next(nears)
        p[2, 2:] = -(FAR + near) / (FAR - near), -2 * FAR * near / (FAR - near)

    sequence = write(
        tmp_path,
        lambda shot: device_depth(shot, next(stored)),
        frame_format={"depth": "device"},
        cameras=of_opengl(change) | {"opengl_buffer": True},
    )
    same(sequence, depth=1e-5)


def test_the_range_that_a_matrix_of_opengl_leaves_open_is_named(tmp_path):
    (tmp_path / "in").mkdir()
    rules, format = of_opengl(), {"depth": "device"}
    note = write(tmp_path / "in", device_depth, cameras=rules, frame_format=format).notes[-1]
    assert "the matrix does not tell" in note and '"opengl_buffer": true or false' in note
    assert (
        len(write(tmp_path / "in", device_depth, cameras=rules | {"opengl_buffer": True}, frame_format=format).notes)
        == 1
    )

    def to_zero(p):
        p[2, 2:] = NEAR / (FAR - NEAR), NEAR * FAR / (FAR - NEAR)

    reversed_planes = write(
        tmp_path / "in", lambda shot: device_depth(shot, reverse=True), cameras=of_opengl(to_zero), frame_format=format
    )
    same(reversed_planes, depth=1e-4)
    assert len(reversed_planes.notes) == 1


def test_an_oblique_near_plane_opens_with_linear_depth_only(tmp_path):
    def oblique(p):
        p[2] = (0.1, -0.4, -0.8, -0.3)

    same(write(tmp_path, cameras=of_opengl(oblique)))
    for fields in ({"depth": "device"}, DEVICE):
        with pytest.raises(GffeError, match=r"frame 3: camera: projection has an oblique near plane \(third row 0.1"):
            write(tmp_path, device_depth, frame_format=fields, cameras=of_opengl(oblique))


def test_cameras_in_files_and_to_the_world(tmp_path):
    """One JSON per frame, camera → world, axes of OpenGL, vertical field of view."""
    (tmp_path / "cameras").mkdir()
    expected = []
    for number, shot in enumerate(rendered(), 3):
        fov = 50 + number
        document = {"view": np.linalg.inv(shot.camera.view_matrix("opengl")).tolist(), "fov_y": fov}
        (tmp_path / "cameras" / f"{number:04d}.json").write_text(json.dumps(document))
        length = H / 2 / np.tan(np.radians(fov) / 2)
        expected.append(Camera(shot.camera.world_to_view, length, length, W / 2, H / 2))
    rules = {"convention": "opengl", "matrix": "view_to_world", "file": "cameras/%04d.json"}
    for entry, camera in zip(write(tmp_path, cameras=rules).rendered, expected, strict=True):
        np.testing.assert_allclose(entry.render_camera.world_to_view, camera.world_to_view, atol=1e-9)
        np.testing.assert_allclose(entry.render_camera.intrinsics, camera.intrinsics)


# Frames


def test_frames_one_by_one_with_truth_and_resets(tmp_path):
    write(tmp_path)
    (tmp_path / "truth").mkdir()
    frames = []
    for number, shot in enumerate(shots()):
        camera = {"view": shot.camera.world_to_view.tolist(), **focal(shot.camera)}
        if shot.kind == "rendered":
            frames.append({"number": 3 + number // 2, "time": shot.time, "reset": number == 4, "camera": camera})
        else:
            frames.append({"number": number, "time": shot.time, "kind": "ground_truth", "camera": camera})
            np.save(tmp_path / "truth" / f"{number}.npy", shot.color)
    said = dict(frames=frames[::-1], cameras={}, exposure=2.0, files=FILES | {"ground_truth": "truth/%d.npy"})
    edit_json(tmp_path / "sequence.json", lambda d: d.update(said) or d.pop("fps"))
    sequence = open_capture(tmp_path)
    assert [entry.kind for entry in sequence.frames] == [shot.kind for shot in shots()]
    assert [entry.reset for entry in sequence.rendered] == [True, False, True] and sequence.exposure == 2
    np.testing.assert_array_equal(sequence.read_color(sequence.ground_truth[1]), shots()[3].color)
    assert sequence.read(sequence.rendered[2]).motion is None  # nothing before a reset may be used


def with_last_number(folder, number, **parts):
    """The frames 3, 4 and 5, the last of them with another number."""
    write(folder)
    for path in (*folder.glob("*_0005.exr"), *folder.glob("*_5.npy"), *folder.glob("*.005.npy")):
        digits = path.name.split(".")[-2].rpartition("_")[2]
        path.rename(path.with_name(path.name.replace(digits, f"{number:0{len(digits)}d}")))
    (folder / "sequence.json").write_text(json.dumps(described(**parts)))
    return open_capture(folder)


def test_a_missing_number_is_a_reset(tmp_path):
    """... where the time is missing as well: numbers alone may be the program's own."""
    times = ((3, 0.0), (4, 1 / FPS), (6, 3 / FPS))
    sequence = with_last_number(tmp_path, 6, frames=[{"number": n, "time": t} for n, t in times])
    assert [entry.reset for entry in sequence.rendered] == [True, False, True]
    assert sequence.notes == [f"{tmp_path}: frame 5 is missing: the next frame is a reset"]
    edit_json(tmp_path / "sequence.json", lambda said: said["frames"][2].update(time=2 / FPS))
    sequence = open_capture(tmp_path)
    assert [entry.reset for entry in sequence.rendered] == [True, False, False] and not sequence.notes


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.update(hue=1), 'unknown key "hue"'),
        (lambda d: d["files"].update(flow="a%d.exr"), 'files: unknown key "flow"'),
        (lambda d: d["files"].update(color={"file": "color_%04d.exr", "valid": "A"}), 'color: unknown key "valid"'),
        (lambda d: d["files"].update(depth="depth.npy"), "file must be a name with %d"),
        (lambda d: d["files"].update(depth="../depth_%d.npy"), "must stay inside"),
        (lambda d: d["files"].update(depth="d_%d.npy"), "d_3.npy: no such file"),
        (lambda d: d["files"].update(depth={"file": "depth_%d.npy", "channels": ["5"]}), "no channel '5'"),
        (lambda d: d["files"].update(motion={"file": "motion.%03d.npy", "channels": ["0"]}), "must be 2 names"),
        (lambda d: d["files"].update(motion={"file": "motion.%03d.npy", "valid": "A"}), "no channel 'A'"),
        (lambda d: d.update(frame_format={"depth": "z"}), "depth must be one of linear"),
        (lambda d: d.update(frame_format={"depth": "device"}), "device depth needs a projection"),
        (lambda d: d.update(frame_format={"unit": "uv"}), "unknown field 'unit'"),
        (lambda d: d["cameras"]["list"].pop(), "for each of the 3 frames"),
        (lambda d: d["cameras"]["list"][0].update(fx=None, fy=None), "no projection"),
        (lambda d: d["cameras"].update(list=None), "frame 3, camera is missing"),
        (lambda d: d["frames"].update(count=0), "count must be a whole number"),
        (lambda d: d["frames"].update(count=10**7), "count must be a whole number"),
        (lambda d: d.update(fps=None), "need fps"),
        (lambda d: d.update(width=W + 1), "expected 98×55"),
        (lambda d: d.update(version=3), "unknown version"),
    ],
)
def test_faults(tmp_path, change, words):
    write(tmp_path)
    edit_json(tmp_path / "sequence.json", change)
    with pytest.raises(GffeError, match=words):
        open_capture(tmp_path)


# Version 1


def test_version_1_opens_with_a_note(tmp_path):
    """Its keys are those of version 2 and of `FrameFormat`; what has no words there is an error."""
    jittered = [{"view": s.camera.world_to_view.tolist(), **focal(s.camera), "jitter": [0, 0]} for s in rendered()]
    old = {
        "version": 1,
        "color": {"file": "color_%04d.exr", "origin": "bottom-left"},
        "depth": {"file": "depth_%d.npy", "origin": "bottom-left", "encoding": "device", "near": NEAR,
                  "far": "infinite", "reversed": True, "scale": 0.5, "offset": 1},
        "motion": {"file": "motion.%03d.npy", "origin": "bottom-left", "unit": "uv", "y": "up", "scale": 2,
                   "offset": 0.5, "direction": "from_previous", "jitter": "removed", "unknown": [7, 7]},
        "camera": {"list": jittered},
    }  # fmt: skip
    write(tmp_path, lambda s: (1 + 2 * NEAR / s.depth)[::-1], lambda s: (0.5 + s.motion / (-W, H) / 2)[::-1])
    for number, shot in enumerate(rendered(), 3):
        planes = np.moveaxis(shot.color[::-1], -1, 0)
        write_exr(tmp_path / f"color_{number:04d}.exr", dict(zip("RGB", planes, strict=True)))
    edit_json(tmp_path / "sequence.json", lambda d: d.update(old) or [d.pop(key) for key in ("files", "cameras")])
    sequence = open_capture(tmp_path)
    same(sequence, depth=1e-4, motion=1e-4)
    assert any("version 1 of the description" in text for text in sequence.warnings())
    for part, key, words in (
        ("depth", {"packing": "unity"}, "packed channels"),
        ("color", {"encoding": "gamma"}, "linear or sRGB"),
        ("motion", {"origin": "top-left"}, "origin must be that of color"),
        ("motion", {"unknown": [7, 8]}, "unknown must be one number"),
        ("motion", {"hue": 1}, 'motion: unknown key "hue"'),
    ):
        document = json.loads(json.dumps(json.loads((tmp_path / "sequence.json").read_text())))
        edit_json(tmp_path / "sequence.json", lambda d, part=part, key=key: d[part].update(key))
        with pytest.raises(GffeError, match=words):
            open_capture(tmp_path)
        (tmp_path / "sequence.json").write_text(json.dumps(document))


# Documentation

BLOCKS = [json.loads(text) for text in re.findall(r"```json\n(.*?)```", (DOCS / "formats.md").read_text(), re.S)]
EXAMPLES = [block for block in BLOCKS if block.get("format") == "gffe-folder"]


def write_image(path, channels):
    path.parent.mkdir(parents=True, exist_ok=True)
    image = np.random.default_rng(1).uniform(0.2, 0.8, (9, 16, len(channels))).astype(np.float32)
    if path.suffix == ".exr":
        write_exr(path, {name: image[..., i] for i, name in enumerate(channels)})
    elif path.suffix == ".png":
        Image.fromarray((image * 255).astype(np.uint8), "RGB").save(path)
    else:
        np.save(path, image)


@pytest.mark.parametrize("number", range(len(EXAMPLES)))
def test_examples_of_the_documentation(tmp_path, number):
    """Each schema opens, and all of its frames are read, with images as it says."""
    document = {**EXAMPLES[number], "width": 16, "height": 9}
    frames = document["frames"]
    first = frames.get("first", 0) if isinstance(frames, dict) else 0
    numbers = range(first, first + frames["count"]) if isinstance(frames, dict) else [f["number"] for f in frames]
    defaults = {"color": "RGB", "ground_truth": "RGB", "depth": "R", "motion": "RG"}
    for name, given in document["files"].items():
        keys = {"file": given} if isinstance(given, str) else given
        for k in numbers:
            write_image(tmp_path / (keys["file"] % k), keys.get("channels", list(defaults[name])))
    if "file" in document["cameras"]:
        (camera,) = (block for block in BLOCKS if "view" in block)
        (tmp_path / "camera").mkdir()
        for k in numbers:
            (tmp_path / (document["cameras"]["file"] % k)).write_text(json.dumps(camera))
    (tmp_path / "sequence.json").write_text(json.dumps(document))
    sequence = open_capture(tmp_path)
    for k, entry in enumerate(sequence.rendered):
        frame = sequence.read(entry)
        assert (frame.depth > 0).all() and frame.camera.fx > 0 and (frame.motion is None) == (k == 0)
    assert len(sequence.frames) == len(numbers) and len(EXAMPLES) >= 5
    for entry in sequence.ground_truth:
        assert sequence.read_color(entry).shape == (9, 16, 3)


def test_every_key_is_documented():
    from gffe_cl.captures.formats import folder

    page, source = (DOCS / "formats.md").read_text(), Path(folder.__file__).read_text()
    for key in re.findall(r"keys\.\w+\(\s*\"(\w+)\"", source):
        assert f"`{key}`" in page or f'"{key}"' in page, key
