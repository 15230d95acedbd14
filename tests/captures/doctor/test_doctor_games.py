"""The doctor on what games do to frames: dilated vectors, geometry that is jittered under antialiased color or smaller
than color, user interfaces, effects without depth."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from doctor_clips import clip, written
from parameters import few
from synthetic import camera

from gffe_cl.captures.doctor import examine, quick_warning
from gffe_cl.captures.doctor.dilation import count_beside_edges, dilation_notes
from gffe_cl.captures.doctor.geometry_jitter import edge_shift, geometry_jitter_notes
from gffe_cl.captures.doctor.repeated_pixels import distinct_size
from gffe_cl.captures.sequence import open_sequence
from gffe_cl.captures.sequence.encoding import Encoding
from gffe_cl.captures.sequence.engine_form import described_frame
from gffe_cl.engine.frame.frame_format import FrameFormat
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.frame.window import Jitter
from gffe_cl.lab.fault_injection import Kept

W, H = 240, 136


@cache
def dilated():
    """The faster half of the clip."""
    frames = [Encoding.parse("dilated").frame(frame) for frame in clip().images[4:]]
    return Kept([replace(frames[0], reset=True), *frames[1:]])


@pytest.mark.long
def test_dilated_vectors_are_named_with_their_share():
    found = [f for f in examine(dilated()).findings if f.name == "dilated"]
    assert [f.kind for f in found] == ["note"] and found[0].figures["share"] > 0.95
    assert "FrameFormat.motion_dilated" in found[0].sentence
    assert quick_warning(dilated()).startswith("motion vectors are dilated: ")


def test_vectors_that_are_not_dilated_or_undone_raise_no_alarm():
    described = [
        described_frame(frame, FrameFormat(motion_dilated=True), before and before.camera, (0.0, 0.0))
        for before, frame in zip([None, *dilated().images], dilated().images, strict=False)
    ]
    for frames in (clip().images[4:], described):
        assert dilation_notes(Kept(frames), [1, 2, 3]) == []
        counts = np.sum([count_beside_edges(frame.depth, frame.motion) for frame in frames[1:4]], 0)
        assert counts[0] < 0.05 * counts[1] and counts[1] > 50


def disks(jitter, color_jitter=(0.0, 0.0), radius=9.0):
    """A frame with disks before a wall; depth is sampled with `jitter`, color covers pixels, or is sampled."""
    view, steps = camera(W, H), (np.arange(8) + 0.5) / 8 - 0.5
    y, x = np.mgrid[:H, :W] + 0.5

    def cover(dx, dy):
        return (np.hypot((x - dx) % 30 - 15, (y - dy) % 30 - 15) < radius).astype(float)

    covered = np.mean([cover(u, v) for u in steps for v in steps], 0) if color_jitter is None else cover(*color_jitter)
    depth = np.where(cover(*jitter) > 0, 3, 8).astype(np.float32)
    color = (0.1 + 0.5 * covered[..., None] * (1, 0.6, 0.3)).astype(np.float16)
    return RenderedFrame(color, depth, np.zeros((H, W, 2), np.float32), view, 0.0)


OFFSETS = [tuple(np.array(Jitter(16).offset(k))) for k in range(1, 6)]


def clip_of(frames):
    return Kept([replace(frame, time=k / 30) for k, frame in enumerate(frames)])


def test_edges_of_depth_shift_as_it_is_jittered():
    for x, y in OFFSETS:
        assert np.allclose(edge_shift(disks((x, y), None), 1.0), np.multiply(-0.65, (x, y)), atol=0.1)


def notes(frames, is_jittered=False):
    found = geometry_jitter_notes(clip_of(frames), [*range(len(frames))], 1.0, is_jittered)
    return [(f.kind, f.name) for f in found], "".join(f.sentence for f in found)


@pytest.mark.parametrize("in_cameras", [False, True])
def test_jitter_of_geometry_is_told_from_that_of_the_camera(in_cameras):
    frames = [disks(offset, None) for offset in OFFSETS]
    if in_cameras:
        moved = [replace(f.camera, cx=f.camera.cx + x) for f, (x, _) in zip(frames, OFFSETS, strict=True)]
        frames = [replace(f, camera=one) for f, one in zip(frames, moved, strict=True)]
    kinds, said = notes(frames)
    assert kinds == [("note", "jittered")] and ("out of the cameras" in said) == in_cameras
    assert notes([disks(offset, offset) for offset in OFFSETS])[0] == []  # color has the jitter, too
    assert notes([disks((0, 0), None) for _ in OFFSETS])[0] == []
    told = [replace(f, geometry_jitter=offset) for f, offset in zip(frames, OFFSETS, strict=True)]
    assert notes(told)[0] == []


def test_without_clear_edges_nothing_is_claimed():
    frames = [disks(offset, None, radius=0) for offset in OFFSETS]
    assert notes(frames)[0] == [] and notes(frames, True)[0] == [("cannot tell", "jittered")]


def repeated(image, ratio):
    """Every pixel of the image, rendered `ratio` times smaller each way, is repeated."""
    rows, columns = ((np.arange(n) / ratio).astype(int) for n in image.shape[:2])
    return image[(rows * ratio).astype(int)][:, (columns * ratio).astype(int)]


@pytest.mark.parametrize(("ratio", "size"), few([(1.5, (80, 45)), (2, (60, 34)), (3, (40, 23))], (1.5, (80, 45))))
def test_repeated_geometry_is_named_with_its_size(ratio, size):
    small = [replace(f, depth=repeated(f.depth, ratio), motion=repeated(f.motion, ratio)) for f in clip().images]
    notes = [f for f in examine(Kept(small)).findings if f.name == "repeated"]
    assert [(note.kind, note.about) for note in notes] == [("note", "depth"), ("note", "motion")]
    assert all((note.figures["width"], note.figures["height"]) == size for note in notes)
    assert "geometry_size" in notes[0].sentence
    assert quick_warning(Kept(small)).startswith(f"depth is repeated: {size[0]}×{size[1]} different pixels")


def test_images_that_only_look_repeated_are_not():
    rows = np.repeat(np.linspace(1, 9, 68, dtype=np.float32)[:, None], 120, 1)  # a floor
    sky = np.full((68, 120), np.inf, np.float32)
    once_off = repeated(clip().images[3].depth, 2).copy()
    once_off[10, 11] += 1
    assert [distinct_size(one) for one in (rows, sky, once_off, clip().images[3].depth)] == [None] * 4
    half = repeated(clip().images[3].depth, 2).copy()
    half[:20] = np.inf
    assert distinct_size(half) == (60, 34)


def with_interface():
    """The clip with a panel and a frame over its color."""
    frames = []
    for frame in clip().images:
        color = frame.color.copy()
        color[6:26, 8:40], color[44:60, 70:112] = (0.9, 0.7, 0.1), (0.05, 0.2, 0.6)
        frames.append(replace(frame, color=color))
    return Kept(frames)


def test_a_user_interface_is_a_warning_with_its_cost(gffe, tmp_path):
    code, text, _ = gffe("check", written(tmp_path / "in", with_interface()))
    assert code == 0 and "warning color: user interface in the color: " in text and " dB" in text


def test_a_run_detects_the_user_interface_that_its_check_sees(gffe, tmp_path):
    """... unless it may not; and not where there is none."""
    hud, plain = written(tmp_path / "hud", with_interface()), written(tmp_path / "good", clip())
    made = {}
    for name, folder, options in (
        ("auto", hud, ()), ("on", hud, ("--ui-detection", "on")), ("off", hud, ("--ui-detection", "off")),
        ("plain", plain, ()),
    ):  # fmt: skip
        code, text, error = gffe("run", folder, tmp_path / name, "--no-scn", *options, checked=True)
        assert code == 0, error
        assert ("user interface detection is on" in text) == (name == "auto")
        assert ("warning: user interface in the color" in error) == (name in ("auto", "on", "off"))
        sequence = open_sequence(tmp_path / name)
        made[name] = [sequence.read_color(entry) for entry in sequence.frames if entry.kind == "extrapolated"]

    def alike(one, other):
        return all(np.array_equal(a, b) for a, b in zip(made[one], made[other], strict=True))

    assert alike("auto", "on") and not alike("auto", "off")
    code, _, error = gffe("run", hud, tmp_path / "wrong", "--ui-detection", "maybe")
    assert code == 2 and "--ui-detection must be one of auto, on, off" in " ".join(error.split())
