"""`gffe-folder`: a built-in scene written in many conventions, and read back within the precision of the encoding."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from folder_captures import described, focal, rendered, write
from foreign import FPS, H, W, edit_json, shots, write_exr
from PIL import Image
from png_files import png

from gffe_cl import Camera, GffeError, open_capture
from gffe_cl.captures.formats.flow import static_motion

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
    assert open_capture(tmp_path / "sequence.json").read_color(open_capture(tmp_path).frames[0]).dtype == np.float16


@pytest.mark.parametrize("ending", [".NPY", ".npy"])
def test_endings_may_be_in_capital_letters(gffe, tmp_path, ending):
    """Of files of buffers and cameras, described with either ending."""
    (tmp_path / "in").mkdir()
    write(tmp_path / "in", color={"file": f"c%d{ending}"}, also=with_capitals)
    edit_json(tmp_path / "in/sequence.json", lambda d: split_cameras(tmp_path / "in", d))
    same(open_capture(tmp_path / "in"))
    assert gffe("import", tmp_path / "in", tmp_path / "out")[0] == 0


def with_capitals(folder, number, shot):
    np.save(folder / "saved.npy", shot.color)
    (folder / "saved.npy").rename(folder / f"c{number}.{'npy' if number == 4 else 'NPY'}")


def split_cameras(folder, document):
    """Move the cameras to files with endings in capital letters."""
    for number, camera in enumerate(document["camera"].pop("list"), 3):
        (folder / f"camera{number}.JSON").write_text(json.dumps(camera))
    document["camera"]["file"] = "camera%d.json"


# Depth


def device(shot, near=NEAR, far=FAR, reverse=False):
    z = np.float64(shot.depth)
    value = near / z if np.isinf(far) else near * (far - np.minimum(z, 1e30)) / (np.minimum(z, 1e30) * (far - near))
    value = np.where(np.isinf(z), 0, value)
    return (value if reverse else 1 - value).astype(np.float32 if reverse else np.float64)


@pytest.mark.parametrize("far", [FAR, np.inf])
@pytest.mark.parametrize("reverse", [True, False])
def test_device_depth_by_planes(tmp_path, reverse, far):
    said = {"file": "depth_%d.npy", "encoding": "device", "near": NEAR, "far": far if far < np.inf else "infinite"}
    made = write(tmp_path, lambda shot: device(shot, far=far, reverse=reverse), depth={**said, "reversed": reverse})
    same(made, depth=1e-5)


@pytest.mark.parametrize("reverse", [True, False])
@pytest.mark.parametrize("near", [0.02, None])
def test_logarithmic_depth(tmp_path, near, reverse):
    """As three.js has it: log(z / near) / log(far / near) with WebGPU, log2(1 + z) / log2(1 + far) with WebGL."""

    def logarithm(shot):
        z = np.minimum(np.float64(shot.depth), FAR)  # sky is at the far plane
        value = np.log(z / near) / np.log(FAR / near) if near else np.log2(1 + z) / np.log2(1 + FAR)
        return (1 - value if reverse else value).astype(np.float32)

    said = {"file": "depth_%d.npy", "encoding": "logarithmic", "far": FAR, "reversed": reverse}
    same(write(tmp_path, logarithm, depth=said | ({"near": near} if near else {})), depth=2e-6)
    with pytest.raises(GffeError, match='logarithmic depth needs "far", a number greater than 0, got inf'):
        write(tmp_path, logarithm, depth={"file": "depth_%d.npy", "encoding": "logarithmic", "near": 0.1})


def test_distance_inverse_and_millimeters(tmp_path):
    def distance(shot):
        y, x = np.mgrid[:H, :W] + 0.5
        world = shot.camera.unproject(np.stack([x, y], -1), np.where(np.isinf(shot.depth), 1e9, shot.depth))
        return np.linalg.norm(world - shot.camera.position, axis=-1)

    for name, encode, said in (
        ("a", distance, {"encoding": "distance", "sky_from": 1e8}),
        ("b", lambda shot: 1 / shot.depth, {"encoding": "inverse"}),
        ("c", lambda shot: np.where(np.isinf(shot.depth), -1, shot.depth * 100), {"scale": 0.01, "sky": -0.01}),
    ):
        (tmp_path / name).mkdir()
        same(write(tmp_path / name, encode, depth={"file": "depth_%d.npy", **said}), depth=1e-6)


def test_sixteen_bits_in_a_png(tmp_path):
    """Millimeters, as depth sensors have them: 0 is nothing."""

    def images(folder, number, shot):
        millimeters = np.where(shot.depth < 65, shot.depth * 1000, 0).round().astype(np.uint16)
        Image.fromarray(millimeters).save(folder / f"depth_{number}.png")

    said = {"file": "depth_%d.png", "values": "raw", "scale": 0.001, "sky": 0}
    assert max(shot.depth[np.isfinite(shot.depth)].max() for shot in rendered()) < 65
    sequence = write(tmp_path, also=images, depth=said)
    for entry, shot in zip(sequence.rendered, rendered(), strict=True):
        np.testing.assert_allclose(sequence.read(entry).depth, shot.depth, atol=0.00051)


@pytest.mark.parametrize("packing", ["big-endian", "little-endian", "unity"])
def test_packed_into_eight_bits(tmp_path, packing):
    """Device depth in a PNG of 8 bits per channel, by the shaders' own arithmetic."""

    def pack(value):
        if packing == "unity":  # EncodeFloatRGBA of UnityCG.cginc
            parts = np.modf(np.float64(value)[..., None] * (1, 255, 65025, 16581375))[0]
            parts[..., :3] -= parts[..., 1:] / 255
            return (parts * 255).round().astype(np.uint8)
        whole = (np.float64(value) * (2**24 - 1)).round().astype(np.int64)
        bytes_ = np.stack([whole >> 16, whole >> 8 & 255, whole & 255], -1).astype(np.uint8)
        return bytes_ if packing == "big-endian" else bytes_[..., ::-1]

    def images(folder, number, shot):
        Image.fromarray(pack(np.minimum(np.float64(shot.depth) / 200, 1 - 1e-9))).save(folder / f"d{number}.png")

    channels = ["R", "G", "B", "A"][: 4 if packing == "unity" else 3]
    said = {"file": "d%d.png", "channels": channels, "packing": packing, "scale": 200, "sky_from": 199}
    sequence = write(tmp_path, also=images, depth=said)
    for entry, shot in zip(sequence.rendered, rendered(), strict=True):
        np.testing.assert_allclose(
            sequence.read(entry).depth, shot.depth, atol=200 * (2**-24 if len(channels) == 3 else 1e-7) + 1e-6
        )


# Motion


@pytest.mark.parametrize("unit", ["pixels", "uv", "ndc"])
@pytest.mark.parametrize("direction", ["to_previous", "from_previous"])
@pytest.mark.parametrize("y", ["down", "up"])
def test_motion_units(tmp_path, unit, direction, y):
    size = {"pixels": (1, 1), "uv": (W, H), "ndc": (W / 2, H / 2)}[unit]
    turn = (-1 if direction == "from_previous" else 1) * np.array([1, -1 if y == "up" else 1])
    said = {"file": "motion.%03d.npy", "unit": unit, "direction": direction, "y": y}
    same(_write_motion(tmp_path, lambda shot: shot.motion / size * turn, said), motion=1e-5)


def _write_motion(folder, encode, said):
    write(folder, motion_as=encode)
    edit_json(folder / "sequence.json", lambda d: d.update(motion=said))
    return open_capture(folder)


def test_motion_of_sixteen_bits_around_the_middle(tmp_path):
    """As KITTI and many debug views have it: 2¹⁵ + 64 px in a PNG of 16 bits per channel."""

    def images(folder, number, shot):
        raw = np.concatenate([np.float64(shot.motion) * 64 + 2**15, np.ones((H, W, 1))], -1).round().astype(np.uint16)
        (folder / f"m{number}.png").write_bytes(png(raw, 16, 2, (1, 4)))

    write(tmp_path, also=images)
    said = {"file": "m%d.png", "values": "raw", "offset": 32768, "scale": 1 / 64}
    edit_json(tmp_path / "sequence.json", lambda d: d.update(motion=said))
    same(open_capture(tmp_path), motion=1 / 128 + 1e-6)


def test_motion_without_jitter(tmp_path):
    """Cameras that jitter, and motion that does not: ours does."""
    jitter = np.array([[0.25, -0.375], [-0.125, 0.5], [0.4375, 0.0625]])
    cameras = []
    for shot, (x, y) in zip(rendered(), jitter, strict=True):
        plain = replace(shot.camera, cx=shot.camera.cx - x, cy=shot.camera.cy - y)
        jittered = {"view": plain.world_to_view.tolist(), **focal(plain), "jitter": [x / W * 2, -y / H * 2]}
        cameras.append(jittered)
    steps = iter([np.zeros(2), *np.diff(jitter, axis=0)])
    write(tmp_path, motion_as=lambda shot: shot.motion + next(steps), camera={
        "list": cameras, "jitter": {"unit": "ndc", "y": "up", "in_projection": False},
    })  # fmt: skip
    edit_json(tmp_path / "sequence.json", lambda d: d["motion"].update(jitter="removed"))
    same(open_capture(tmp_path), motion=1e-5)


def test_images_upside_down(tmp_path):
    """As OpenGL reads them back."""

    def images(folder, number, shot):
        Image.fromarray((np.clip(np.float64(shot.color[::-1]), 0, 1) * 255).round().astype(np.uint8)).save(
            folder / f"c{number}.png"
        )

    said = {"file": "c%d.png", "origin": "bottom-left"}
    sequence = write(tmp_path, lambda shot: shot.depth[::-1], also=images)
    edit_json(tmp_path / "sequence.json", lambda d: d.update(color=said) or d["depth"].update(origin="bottom-left"))
    sequence = open_capture(tmp_path)
    frame, shot = sequence.read(sequence.rendered[1]), rendered()[1]
    np.testing.assert_array_equal(frame.depth, shot.depth)
    np.testing.assert_allclose(frame.color, np.clip(shot.color, 0, 1), atol=0.51 / 255)


# Color


def test_display_colors(tmp_path):
    def images(folder, number, shot):
        linear = np.clip(np.float64(shot.color), 0, 1)
        srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        (folder / f"s{number}.png").write_bytes(png((srgb * 65535).round().astype(np.uint16), 16, 2, (0, 2)))
        np.save(folder / f"g{number}.npy", linear ** (1 / 1.8))

    write(tmp_path, also=images)
    for said in ({"file": "s%d.png", "encoding": "srgb"}, {"file": "g%d.npy", "encoding": "gamma", "gamma": 1.8}):
        edit_json(tmp_path / "sequence.json", lambda d, said=said: d.update(color=said))
        sequence = open_capture(tmp_path)
        for entry, shot in zip(sequence.rendered, rendered(), strict=True):
            np.testing.assert_allclose(sequence.read_color(entry), np.clip(shot.color, 0, 1), atol=2e-5)


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
    said = {"file": "depth_%d.npy", "encoding": "device", "opengl_buffer": False}
    write(tmp_path, lambda shot: device(shot, far=np.inf, reverse=True))
    rules = {"convention": convention, "layout": layout, "scale": 0.01, "list": cameras}
    edit_json(tmp_path / "sequence.json", lambda d: d.update(depth={**said}, camera=rules))
    sequence = open_capture(tmp_path)
    for entry, shot in zip(sequence.rendered, rendered(), strict=True):
        np.testing.assert_allclose(sequence.read(entry).depth, shot.depth, rtol=1e-4)
        np.testing.assert_allclose(entry.render_camera.world_to_view, shot.camera.world_to_view, atol=1e-9)
        np.testing.assert_allclose(entry.render_camera.intrinsics, shot.camera.intrinsics, rtol=1e-9)


def test_cameras_in_files_and_to_the_world(tmp_path):
    """One JSON per frame, camera → world, axes of OpenGL, vertical field of view."""
    write(tmp_path)
    (tmp_path / "cameras").mkdir()
    expected = []
    for number, shot in enumerate(rendered(), 3):
        fov = 50 + number
        document = {"view": np.linalg.inv(shot.camera.view_matrix("opengl")).tolist(), "fov_y": fov}
        (tmp_path / "cameras" / f"{number:04d}.json").write_text(json.dumps(document))
        length = H / 2 / np.tan(np.radians(fov) / 2)
        expected.append(Camera(shot.camera.world_to_view, length, length, W / 2, H / 2))
    rules = {"convention": "opengl", "matrix": "view_to_world", "file": "cameras/%04d.json"}
    edit_json(tmp_path / "sequence.json", lambda d: d.update(camera=rules))
    for entry, camera in zip(open_capture(tmp_path).rendered, expected, strict=True):
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
    said = dict(frames=frames[::-1], camera={}, ground_truth={"file": "truth/%d.npy"}, exposure=2.0)
    edit_json(tmp_path / "sequence.json", lambda d: d.update(said) or d.pop("fps"))
    sequence = open_capture(tmp_path)
    assert [entry.kind for entry in sequence.frames] == [shot.kind for shot in shots()]
    assert [entry.reset for entry in sequence.rendered] == [True, False, True] and sequence.exposure == 2
    np.testing.assert_array_equal(sequence.read_color(sequence.ground_truth[1]), shots()[3].color)
    assert sequence.read(sequence.rendered[2]).motion is None  # nothing before a reset may be used


def test_flow_to_the_next_frame(tmp_path):
    """Forward flow of the frame before, inverted: as our motion wherever that surface was seen before."""
    write(tmp_path)
    frames = [shot for shot in rendered()]
    y, x = np.mgrid[:H, :W] + 0.5
    here = np.stack([x, y], -1)
    for number, (shot, after) in enumerate(zip(frames, frames[1:], strict=False), 3):
        world = shot.camera.unproject(here, np.where(np.isinf(shot.depth), 1e6, shot.depth))
        np.save(tmp_path / f"motion.{number:03d}.npy", after.camera.project(world)[0] - here)
    edit_json(tmp_path / "sequence.json", lambda d: d["motion"].update(direction="to_next"))
    sequence = open_capture(tmp_path)
    for entry, shot, before in zip(sequence.rendered[1:], frames[1:], frames, strict=False):
        world = shot.camera.unproject(here, np.where(np.isinf(shot.depth), 1e6, shot.depth))
        still = before.camera.project(world)[0] - here
        found = sequence.read(entry).motion
        off = np.linalg.norm(found - still, axis=-1)
        assert np.percentile(off, 99) < 0.05 and np.linalg.norm(still, axis=-1).max() > 0.3


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.update(hue=1), "unknown key \"hue\""),
        (lambda d: d["depth"].update(near=3, far=1), "0 < near < far"),
        (lambda d: d["depth"].update(encoding="z"), "depth, encoding must be one of linear"),
        (lambda d: d["depth"].update(encoding="device"), "device depth needs a projection"),
        (lambda d: d["depth"].update(file="depth.npy"), "file must be a name with %d"),
        (lambda d: d["depth"].update(file="../depth_%d.npy"), "must stay inside"),
        (lambda d: d["depth"].update(file="d_%d.npy"), "d_3.npy: no such file"),
        (lambda d: d["depth"].update(channels=["5"]), "no channel '5'"),
        (lambda d: d["motion"].update(scale=[1, 2, 3]), "a number or 2 of them"),
        (lambda d: d["motion"].update(unit="meters"), "motion, unit must be one of pixels"),
        (lambda d: d["motion"].update(packing="unity", values="raw", channels=list("RGBA")), "from 0 to 1"),
        (lambda d: d["camera"]["list"].pop(), "for each of the 3 frames"),
        (lambda d: d["camera"]["list"][0].update(fx=None), "fy|no projection"),
        (lambda d: d["camera"].update(list=None), "frame 3, camera is missing"),
        (lambda d: d["frames"].update(count=0), "count must be a whole number"),
        (lambda d: d["frames"].update(count=10**7), "count must be a whole number"),
        (lambda d: d.update(fps=None), "need fps"),
        (lambda d: d.update(width=W + 1), "expected 98×55"),
        (lambda d: d.update(version=2), "unknown version"),
    ],
)  # fmt: skip
def test_faults(tmp_path, change, words):
    write(tmp_path)
    document = edit_json(tmp_path / "sequence.json", change)
    if words == "fy|no projection":  # fy alone will do
        document["camera"]["list"][0].pop("fy")
        (tmp_path / "sequence.json").write_text(json.dumps(document))
    with pytest.raises(GffeError, match=words):
        open_capture(tmp_path)


def test_captures_without_cameras(tmp_path):
    """Injectors have none."""
    write(tmp_path)
    edit_json(tmp_path / "sequence.json", lambda d: d.pop("camera"))
    with pytest.raises(GffeError, match="camera is missing"):
        open_capture(tmp_path)
    sequence = open_capture(tmp_path, cameras="optional")
    frame = sequence.read(sequence.rendered[1])
    assert sequence.rendered[1].render_camera is None and sequence.warnings() == []
    np.testing.assert_array_equal(frame.motion, rendered()[1].motion)
    for part, said in (("depth", {"encoding": "distance"}), ("motion", {"direction": "to_next"})):
        document = edit_json(tmp_path / "sequence.json", lambda d, part=part, said=said: d[part].update(said))
        with pytest.raises(GffeError, match="without a camera"):
            open_capture(tmp_path, cameras="optional")
        for key in said:
            document[part].pop(key)
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
        Image.fromarray((image * 255).astype(np.uint8), "RGBA" if len(channels) == 4 else "RGB").save(path)
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
    for name, default in defaults.items():
        for k in numbers if name in document else ():
            channels = document[name].get("channels", list(default))
            write_image(tmp_path / (document[name]["file"] % k), channels)
    if "file" in document["camera"]:
        (camera,) = (block for block in BLOCKS if "view" in block)
        (tmp_path / "camera").mkdir()
        for k in numbers:
            (tmp_path / (document["camera"]["file"] % k)).write_text(json.dumps(camera))
    (tmp_path / "sequence.json").write_text(json.dumps(document))
    sequence = open_capture(tmp_path)
    for k, entry in enumerate(sequence.rendered):
        frame = sequence.read(entry)
        assert (frame.depth > 0).all() and frame.camera.fx > 0 and (frame.motion is None) == (k == 0)
    assert len(sequence.frames) == len(numbers) and len(EXAMPLES) >= 5
    for entry in sequence.ground_truth:
        assert sequence.read_color(entry).shape == (9, 16, 3)


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


def test_negative_numbers(tmp_path):
    write(tmp_path)
    for number in (3, 4, 5):
        for before, after in (
            (f"color_{number:04d}.exr", f"color_{number - 4:04d}.exr"),
            (f"depth_{number}.npy", f"depth_{number - 4}.npy"),
            (f"motion.{number:03d}.npy", f"motion.{number - 4:03d}.npy"),
        ):
            (tmp_path / before).rename(tmp_path / after)
    (tmp_path / "sequence.json").write_text(json.dumps(described(frames={"first": -1, "count": 3})))
    same(open_capture(tmp_path))


@pytest.mark.parametrize("far", [FAR, np.inf])
@pytest.mark.parametrize("key", [{}, {"opengl_buffer": True}, {"opengl_buffer": False}], ids=str)
def test_matrices_of_opengl_with_reversed_depth_tell_the_range(tmp_path, far, key):
    cameras = []
    for shot in rendered():
        p = shot.camera.projection_matrix("opengl", W, H, NEAR)
        p[2, 2:] = (0, NEAR) if np.isinf(far) else (NEAR / (far - NEAR), NEAR * far / (far - NEAR))
        cameras.append({"view": shot.camera.view_matrix("opengl").tolist(), "projection": p.tolist()})
    said = {"file": "depth_%d.npy", "encoding": "device", **key}
    rules = {"convention": "opengl", "list": cameras}
    sequence = write(tmp_path, lambda shot: device(shot, far=far, reverse=True), depth=said, camera=rules)
    for entry, shot in zip(sequence.rendered, rendered(), strict=True):
        np.testing.assert_allclose(sequence.read(entry).depth, shot.depth, rtol=1e-3)
    assert not sequence.notes


def test_the_range_that_a_matrix_of_opengl_leaves_open_is_named(tmp_path):
    cameras = []
    for shot in rendered():
        p = shot.camera.projection_matrix("opengl", W, H, NEAR, FAR)
        cameras.append({"view": shot.camera.view_matrix("opengl").tolist(), "projection": p.tolist()})
    said = {"file": "depth_%d.npy", "encoding": "device"}
    rules = {"convention": "opengl", "list": cameras}
    (note,) = write(tmp_path, lambda shot: device(shot), depth=said, camera=rules).notes
    assert "the matrix does not tell" in note and '"opengl_buffer": true or false' in note
    edit_json(tmp_path / "sequence.json", lambda described: described["depth"].update(opengl_buffer=True))
    assert not open_capture(tmp_path).notes


def test_an_oblique_near_plane_opens_with_linear_depth_only(tmp_path):
    cameras = []
    for shot in rendered():
        p = shot.camera.projection_matrix("opengl", W, H, NEAR, FAR)
        p[2] = (0.1, -0.4, -0.8, -0.3)
        cameras.append({"view": shot.camera.view_matrix("opengl").tolist(), "projection": p.tolist()})
    rules = {"convention": "opengl", "list": cameras}
    same(write(tmp_path, camera=rules))
    for planes in ({}, {"near": NEAR, "far": FAR}):
        said = {"file": "depth_%d.npy", "encoding": "device", **planes}
        with pytest.raises(
            GffeError, match=r"frame 3, camera: projection has an oblique near plane \(third row 0.1 -0.4"
        ):
            write(tmp_path, device, depth=said, camera=rules)


UNWRITTEN = np.random.default_rng(4).random((H, W)) < 0.3


def without_unwritten(sequence, of="motion"):
    """The first frame with motion, and where its buffer is NaN; everywhere else it is as rendered."""
    frame, shot = sequence.read(sequence.rendered[1]), rendered()[1]
    values = np.atleast_3d(getattr(frame, of))
    unknown = np.isnan(values).any(-1)
    assert np.isnan(values).all(-1)[unknown].all()
    np.testing.assert_allclose(values[~unknown], np.atleast_3d(getattr(shot, of))[~unknown], atol=1 / 64, rtol=1e-6)
    return unknown


def kitti(folder, number, shot):
    """(v − 32768) / 64 in 16 bits; the third channel is 1 where a vector was written, else all are 0."""
    coded = np.where(UNWRITTEN[..., None], 0, np.round(np.nan_to_num(shot.motion) * 64 + 32768))
    image = png(np.dstack([coded, ~UNWRITTEN]).astype(np.uint16), 16, 2)
    (folder / f"motion_{number}.png").write_bytes(image)


@pytest.mark.parametrize("key", [{"valid": "B"}, {"unknown": 0}, {"unknown": [0, 0]}])
def test_vectors_that_were_never_written_are_nan(tmp_path, key):
    """By a channel, or by the value that stands in their place, before offset and scale."""
    said = {"file": "motion_%d.png", "values": "raw", "offset": 32768, "scale": 1 / 64, **key}
    assert (without_unwritten(write(tmp_path, also=kitti, motion=said)) == UNWRITTEN).all()


@pytest.mark.parametrize(
    ("value", "key"), [(-1, {"unknown": -1}), (2, {"unknown_from": 1}), (65504, {"unknown_from": 6e4})]
)
def test_values_of_engines_for_none(tmp_path, value, key):
    """Godot 4 with FSR 2 clears to -1 in UV, Unity's HDRP writes more than 1 in x, others the largest half float."""

    def coded(shot):
        made = (shot.motion / (W, H)).astype(np.float32)
        made[UNWRITTEN] = (value, 0) if value == 2 else value
        return made

    said = {"file": "motion.%03d.npy", "unit": "uv", **key}
    assert (without_unwritten(write(tmp_path, motion_as=coded, motion=said)) == UNWRITTEN).all()


def test_one_component_alone_is_not_unknown(tmp_path):
    def coded(shot):
        made = np.array(shot.motion)
        made[UNWRITTEN, 0] = -1
        return made

    sequence = write(tmp_path, motion_as=coded, motion={"file": "motion.%03d.npy", "unknown": -1})
    assert np.isfinite(sequence.read(sequence.rendered[1]).motion).all()


def test_depth_that_was_never_written_is_nan(tmp_path):
    said = {"file": "depth_%d.npy", "unknown": -7}
    sequence = write(tmp_path, depth_as=lambda shot: np.where(UNWRITTEN, np.float32(-7), shot.depth), depth=said)
    assert (without_unwritten(sequence, "depth") == UNWRITTEN).all()


def test_flow_that_was_never_written_is_not_mixed_with_other_flow(tmp_path):
    """To the next frame, every 50th vector is the largest half float: the vectors around it stay as they are."""
    made = []
    for bad in (False, True):
        folder = tmp_path / str(bad)
        folder.mkdir()

        def flow(shot, bad=bad):
            after = rendered()[min(rendered().index(shot) + 1, 2)]
            made = static_motion(shot.depth, shot.camera, after.camera)[0].astype(np.float32)
            made.reshape(-1, 2)[:: 50 if bad else 10**9] = 65504 if bad else made[0, 0]
            return made

        sequence = write(folder, motion_as=flow, motion={"file": "motion.%03d.npy", "direction": "to_next"})
        made.append(sequence.read(sequence.rendered[1]).motion)
    assert np.percentile(np.linalg.norm(made[1] - made[0], axis=-1), 99.9) < 0.5


def test_a_channel_of_validity_must_be_there(tmp_path):
    with pytest.raises(GffeError, match=r"motion_4.png: no channel 'A' \(the file holds R, G, B\)"):
        write(tmp_path, also=kitti, motion={"file": "motion_%d.png", "values": "raw", "valid": "A"})
    with pytest.raises(GffeError, match='color: unknown key "valid"'):
        write(tmp_path, color={"file": "color_%04d.exr", "valid": "A"})


def test_every_key_is_documented():
    from gffe_cl.captures.formats import buffers, cameras, folder

    page = (DOCS / "formats.md").read_text()
    for module in (buffers, cameras, folder):
        source = Path(module.__file__).read_text()
        for key in re.findall(r"keys\.\w+\(\s*\"(\w+)\"", source):
            assert f"`{key}`" in page or f'"{key}"' in page, key
