"""Parts of the picture that fit another law than the rest are named, movers are none."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from doctor_clips import COUNT, H, W, clip, made_world, names
from parameters import few
from synthetic import camera

from gffe_cl.captures.doctor import examine, quick_warning
from gffe_cl.lab.fault_injection import Kept


@cache
def other_view(width, height, focal):
    """The clip's world, seen by a camera of its own on the way back: images of a size."""
    frames, before, world = [], None, made_world()
    for k in range(COUNT):
        view = camera(width, height, (-0.1 * k, 0.05 * k, -0.02 * k * k), yaw=-0.02 * k, pitch=0.004 * k)
        view = replace(view, fx=focal, fy=focal)
        frames.append(world.frame(view, k / 30, width, height, before, reset=k == 0, samples=2))
        before = view, k / 30
    return frames


def with_part(left, top, others):
    """The exact clip with other images in a rectangle of it."""
    frames = []
    for frame, other in zip(clip().images, others, strict=True):
        made = {}
        for name in ("color", "depth", "motion"):
            if (image := getattr(frame, name)) is not None:
                made[name] = image.copy()
                part = getattr(other, name)
                height, width = other.depth.shape
                made[name][top : top + height, left : left + width] = part
        frames.append(replace(frame, **made))
    return Kept(frames)


VIEWS = {
    "side by side": (W // 2, 0, W // 2, H, 1, f"the part of the picture with x ≥ {W // 2} fits another camera"),
    "one above the other": (0, 0, W, H // 2, 0.5, f"y < {H // 2} fits another camera"),
    "picture in picture": (0, 34, 45, 34, 45 / W, "x < 45 and y ≥ 34 fits another camera"),
}


@pytest.mark.parametrize("kind", few(VIEWS, "side by side"))
def test_a_picture_of_several_views_is_noted(kind):
    left, top, width, height, scale, said = VIEWS[kind]
    bad = with_part(left, top, other_view(width, height, clip().images[0].camera.fx * scale))
    diagnosis = examine(bad)
    found = [finding for finding in diagnosis.findings if finding.name == "several views"]
    assert found and said in found[0].sentence and not diagnosis.faults, diagnosis.findings


def test_a_mover_before_others_is_no_view():
    """A car ahead of the camera: nearly all of a rectangle moves as a whole, but only the rest of it is farther."""
    near = np.arange(34)[:, None] >= 4
    depth = np.broadcast_to(np.where(near, np.float32(2), np.float32(20)), (34, 45))
    motion = np.broadcast_to(np.where(near[..., None], np.float32((3, 1)), np.float32((-5, 2))), (34, 45, 2))
    others = [
        replace(frame, color=frame.color[34:68, :45], depth=depth, motion=None if frame.motion is None else motion)
        for frame in clip().images
    ]
    found = examine(with_part(0, 34, others)).findings
    assert "several views" not in [finding.name for finding in found], found


PARTS = {
    "negated": (lambda v: -v, "motion vectors are negated"),
    "half": (lambda v: v / 2, "motion vectors are half as long"),
    "flipped": (lambda v: v * (1, -1), "the y of motion vectors is flipped"),
}


@pytest.mark.long
@pytest.mark.parametrize("kind", few(PARTS, "half"))
def test_vectors_of_another_convention_in_a_part_are_a_fault(kind):
    change, said = PARTS[kind]
    others = [
        replace(frame, color=frame.color[40:], depth=frame.depth[40:], motion=None if frame.motion is None else
                np.float32(change(frame.motion[40:]))) for frame in clip().images
    ]  # fmt: skip
    bad = with_part(0, 40, others)
    diagnosis = examine(bad)
    assert names(diagnosis) == ["motion: partly another convention"], diagnosis.findings
    assert said in diagnosis.faults[0].sentence and diagnosis.faults[0].fix == ""
    assert abs(diagnosis.faults[0].figures["top"] - 40 / H) < 0.04
    assert said in quick_warning(bad)
