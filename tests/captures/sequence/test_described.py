"""Sequences whose depth and motion are an engine's: version 2 of the description."""

import json
import math
from dataclasses import replace

import numpy as np
import pyopencl as cl
import pytest
from engine_buffers import static_motion, stored
from synthetic import Rect, Rects, camera

from gffe_cl import (
    FrameEntry,
    FrameFormat,
    GffeError,
    Options,
    Pipeline,
    SequenceWriter,
    check,
    named_channels,
    open_sequence,
)
from gffe_cl.captures.offline.run import run_sequence
from gffe_cl.viewer.engine.sources.recorded import RecordedSource

W, H = 40, 26
FORMAT = FrameFormat(
    depth="device",
    near_z=0.5,
    far_z=math.inf,
    depth_range=(1, 0),
    motion_unit="ndc",
    motion_y="up",
    motion_invalid=9.0,
    motion_jittered=True,
    motion_direction="from_previous",
    motion_type="float16",
)
MOVERS = replace(FORMAT, camera_motion="movers_only", motion_jittered=False)
FROM_BELOW = replace(
    MOVERS,
    rows="up",
    color_encoding="srgb",
    depth="distance",
    near_z=0.0,
    far_z=1.0,
    depth_range=(0, 1),
    depth_scale=0.01,
)
EXCLUDED = replace(FORMAT, camera_motion="excluded", motion_invalid=None)
JITTERS = (0.0, 0.0), (0.25, -0.5), (-0.375, 0.125)


def plain_frames():
    """In our conventions: a mover before a wall, sky, a camera that turns and moves."""
    scene = Rects([Rect((0, 0, 8), (5, 3)), Rect((0, 0, 3), (0.6, 0.5), (2, 1, 0))])
    poses = [(camera(W, H, (0.1 * k, 0.02 * k, 0.05 * k), 0.03 * k, -0.01 * k), k / 30) for k in range(3)]
    return [scene.frame(*p, W, H, poses[k - 1] if k else None, reset=k == 0) for k, p in enumerate(poses)]


def as_engine_has_them(frames, format):
    """Yield frames with depth and motion as the format describes them, and those that are expected to be read."""
    for k, (before, frame) in enumerate(zip([None, *frames], frames, strict=False)):
        jitters = (JITTERS[k], JITTERS[max(k - 1, 0)]) if format.motion_jittered else ()
        if before:  # sky moves, too
            sky = np.isinf(frame.depth)[..., None]
            frame = replace(frame, motion=np.where(sky, static_motion(frame, before), frame.motion))
        expected = frame
        if format.motion_invalid and format.camera_motion == "included":
            expected = replace(frame, motion=np.where(np.arange(H)[:, None, None] < 2, np.nan, frame.motion))
        yield stored(frame, before, format, None, *jitters), expected


def write(folder, frames, format):
    with SequenceWriter(folder, W, H, 30, format=format) as writer:
        for k, frame in enumerate(frames):
            entry = FrameEntry(f"frame_{k}.exr", frame.time, render_camera=frame.camera)
            entry.geometry_jitter = frame.geometry_jitter
            writer.add(entry, named_channels(frame.color, frame.depth, frame.motion))
    return open_sequence(folder)


def on_device(pipeline):
    found = np.empty((H, W), np.float32), np.empty((H, W, 2), np.float32)
    for array, buffer in zip(found, pipeline.frames.current.buffers[1:], strict=True):
        cl.enqueue_copy(pipeline.device.queue, array, buffer)
    return found


FORMATS = {"jittered": FORMAT, "movers only": MOVERS, "from below": FROM_BELOW, "without the camera": EXCLUDED}


@pytest.mark.parametrize("format", FORMATS.values(), ids=[*FORMATS])
def test_frames_are_read_in_our_conventions(device, tmp_path, format):
    """By the reader, and by a pipeline that gets them as they are stored."""
    given, expected = zip(*as_engine_has_them(plain_frames(), format), strict=True)
    sequence = write(tmp_path / "engine", given, format)
    assert sequence.format == format and json.loads((tmp_path / "engine/sequence.json").read_text())["version"] == 2
    pipeline = Pipeline(device, W, H, Options(shading_correction=False), format=sequence.format)
    for entry, frame, ours in zip(sequence.rendered, sequence, expected, strict=True):
        np.testing.assert_allclose(frame.depth, ours.depth, rtol=1e-6)
        np.testing.assert_allclose(frame.motion, ours.motion, atol=2e-4)
        np.testing.assert_allclose(frame.color, ours.color[..., :3], rtol=2e-3, atol=1e-4)
        pipeline.submit(sequence.read_stored(entry))
        depth, motion = on_device(pipeline)
        np.testing.assert_allclose(depth, frame.depth, rtol=1e-6)
        np.testing.assert_allclose(motion, frame.motion, atol=1e-3)
        assert frame.geometry_jitter == entry.geometry_jitter


def test_smaller_geometry_is_stored_at_its_size(device, tmp_path):
    """By the description, and by another size in a frame; the reader gives what a pipeline makes of it."""
    frames, made = plain_frames(), replace(FORMAT, motion_invalid=None, geometry_size=(20, 13))
    sizes = (20, 13), (27, 16), (20, 13)
    with SequenceWriter(tmp_path / "small", W, H, 30, format=made) as writer:
        for k, (frame, size) in enumerate(zip(frames, sizes, strict=True)):
            entry = FrameEntry(f"frame_{k}.exr", frame.time, render_camera=frame.camera)
            entry.geometry_jitter, entry.geometry_size = JITTERS[k], size if k == 1 else None
            y, x = (np.arange(m) * n // m for m, n in zip(size[::-1], (H, W), strict=True))
            depth, motion = (a[np.ix_(y, x)] for a in (0.5 / frame.depth, frame.motion / (W, H)))
            writer.add(entry, named_channels(frame.color, depth, motion))
            with pytest.raises(GffeError, match="channel 'Z' must have shape"):
                writer.add(replace(entry, file="a", geometry_size=(21, 13)), named_channels(frame.color, depth))
    sequence = open_sequence(tmp_path / "small")
    pipeline = Pipeline(device, W, H, Options(shading_correction=False), format=sequence.format)
    for entry, frame, size in zip(sequence.rendered, sequence, sizes, strict=True):
        stored = sequence.read_stored(entry)
        assert stored.depth.shape == size[::-1] and frame.depth.shape == (H, W) and frame.geometry_size is None
        pipeline.submit(stored)
        depth, motion = on_device(pipeline)
        np.testing.assert_allclose(depth, frame.depth, rtol=1e-6)
        np.testing.assert_allclose(motion, frame.motion, atol=1e-3)
    document = json.loads((tmp_path / "small/sequence.json").read_text())
    document["frames"][1]["geometry_size"] = [41, 16]
    (tmp_path / "small/sequence.json").write_text(json.dumps(document))
    with pytest.raises(GffeError, match="geometry is 41×16 and color 40×26"):
        open_sequence(tmp_path / "small")


def test_without_a_description_it_is_version_1(tmp_path):
    sequence = write(tmp_path / "plain", plain_frames(), None)
    document = json.loads((tmp_path / "plain/sequence.json").read_text())
    assert document["version"] == 1 and "frame_format" not in document and sequence.format is None
    assert not any("geometry_jitter" in frame for frame in document["frames"])
    jittered = [replace(f, geometry_jitter=j) for f, j in zip(plain_frames(), JITTERS, strict=True)]
    sequence = write(tmp_path / "jittered", jittered, None)
    assert [frame.geometry_jitter for frame in sequence] == [*JITTERS]


def test_the_quick_check_takes_a_description():
    """Frames in memory as an engine has them fit with the right description, and do not with another."""
    scene = Rects([Rect((0, 0, 6), frequency=0.5), Rect((0.4, 0, 3), (0.7, 0.5), frequency=2)])
    poses = [(camera(96, 64, (0.1 * k, 0.03 * k, 0), 0.02 * k), k / 30) for k in range(3)]
    frames = [scene.frame(*p, 96, 64, poses[k - 1] if k else None, reset=k == 0) for k, p in enumerate(poses)]
    stored = [
        replace(
            f,
            color=np.round(np.clip(f.color, 0, 1) * 255).astype(np.uint8),
            motion=-f.motion / (96, 64),
            depth=np.round(0xFFFFFF * 0.5 / f.depth).astype(np.uint32),
        )
        for f in frames
    ]
    right = FrameFormat(
        depth="device",
        near_z=0.5,
        far_z=math.inf,
        depth_range=(1, 0),
        motion_unit="uv",
        motion_direction="from_previous",
    )
    assert check(frames) is None and check(stored, format=right) is None
    assert "motion" in check(stored, format=replace(right, motion_direction="to_previous"))
    with pytest.raises(GffeError, match=r"color is 9×9 \(expected the render size 96×64\)"):
        check(stored, format=replace(right, color_size=(9, 9), geometry_size=(9, 9)))


def test_the_display_part_of_a_run_is_in_our_conventions(device, tmp_path):
    """The frames as they were rendered keep their description; their display parts are converted, and say so."""
    given, expected = zip(*as_engine_has_them(plain_frames(), MOVERS), strict=True)
    width, height, left, top = W - 8, H - 6, 4, 2
    with SequenceWriter(tmp_path / "wide", width, height, 30, format=MOVERS) as writer:
        for k, frame in enumerate(given):
            shown = replace(frame.camera, cx=frame.camera.cx - left, cy=frame.camera.cy - top)
            cameras = {"render_camera": frame.camera, "display_camera": shown}
            entry = FrameEntry(f"frame_{k}.exr", frame.time, render_size=(W, H), **cameras)
            writer.add_frame(entry, frame)
    sequence = open_sequence(tmp_path / "wide")
    for window, format in ((None, MOVERS), ("off", None)):
        source = RecordedSource(sequence, device, window)
        run_sequence(source, tmp_path / "out", device, Options(shading_correction=False), [0.5])
        made = open_sequence(tmp_path / "out")
        assert made.format == source.format == format and (source.stored(1) is None) == (window == "off")
        for k, (frame, ours) in enumerate(zip(made, expected, strict=True)):
            depth, motion = ours.depth, ours.motion
            if window == "off":
                depth, motion = (image[top : top + height, left : left + width] for image in (depth, motion))
            np.testing.assert_allclose(frame.depth, depth, rtol=1e-6)
            if k:
                np.testing.assert_allclose(frame.motion, motion, atol=1e-3)
        source.close()


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"version": 1}, "frame_format needs version 2, got 1"),
        ({"frame_format": {"depth": "far"}}, "sequence.json: format: depth must be one of linear, device"),
        ({"frame_format": {"colour": 1}}, "sequence.json: format: unknown field 'colour'"),
        ({"frame_format": [1]}, "sequence.json: .*must be an object"),
        ({"frame_format": {"geometry_size": [4, 4], "color_size": [4, 4]}}, r"color is 4×4 \(expected the render"),
    ],
)
def test_wrong_descriptions_are_refused(tmp_path, change, text):
    write(tmp_path, [replace(plain_frames()[0], geometry_jitter=(0.5, 0))], FORMAT)
    path = tmp_path / "sequence.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(GffeError, match=text):
        open_sequence(tmp_path)
