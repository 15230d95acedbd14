"""Mistakes of live integrations: buffers of good frames that are exchanged, late, or jittered by halves."""

from dataclasses import replace
from functools import cache

import numpy as np
from doctor_clips import H, W
from synthetic import Rect, Rects, camera

from gffe_cl.engine.frame.window import Jitter
from gffe_cl.lab.fault_injection import BREAKS, GAPS

COUNT, FPS = 8, 30
SIGN_OF_Y, Y_UP = np.array([1, -1]), np.diag([1.0, -1, -1, 1])


@cache
def good_frames(seed=11):
    """Return frames of rectangles past which a camera sways, in a world whose y is up, and the same ones jittered in
    everything."""
    rng = np.random.default_rng(seed)
    rects = [
        Rect((0, 0, 22), (40, 30), frequency=0.4),
        Rect((-1.1, 0.2, 5), (0.6, 0.8), (1.2, 0.3, 0), 1.2, (0.3, 0.5, 0.7)),
    ]
    for k in range(8):
        place = (rng.uniform(-5, 5), rng.uniform(-2.5, 2.5), rng.uniform(4, 13))
        tint = tuple(rng.uniform(0.2, 0.8, 3))
        rects.append(Rect(place, tuple(rng.uniform(0.5, 1.6, 2)), frequency=0.5 + 0.1 * k, tint=tint))
    world, jitter = Rects(rects), Jitter(8)
    found = []
    for is_jittered in (False, True):
        frames, before = [], None
        for k in range(COUNT):
            sway = np.sin(0.7 * k)
            view = camera(W, H, (-0.1 * k, 0.08 * sway, 0.05 * k), yaw=0.02 * sway, pitch=0.006 * k, roll=-0.004 * k)
            view = jitter.camera(view, k) if is_jittered else view
            frames.append(world.frame(view, k / FPS, W, H, before, reset=k == 0, samples=2))
            before = view, k / FPS
        turned = [replace(f.camera, world_to_view=f.camera.world_to_view @ Y_UP) for f in frames]
        found.append([replace(f, camera=c) for f, c in zip(frames, turned, strict=True)])
    return tuple(found)


def of_another_frame(field, by):
    """Return a mistake: each frame has the `field` of the frame `by` before it."""

    def change(frames):
        sources = np.clip(np.arange(len(frames)) - by, 0, len(frames) - 1)
        shown = {"display_camera": None} if field == "camera" else {}
        return [
            replace(frame, **{field: getattr(frames[k], field)}, **shown)
            for frame, k in zip(frames, sources, strict=True)
        ]

    return change


def field_of_view(factor):
    def change(frames):
        cameras = [replace(f.camera, fx=factor(f, f.camera.fx), fy=factor(f, f.camera.fy)) for f in frames]
        return [replace(f, camera=c, display_camera=None) for f, c in zip(frames, cameras, strict=True)]

    return change


def sides_mistaken(frame, focal):
    """Return frames whose vertical angle is taken for the horizontal one."""
    height, width = frame.depth.shape
    return focal * width / height


def radians_as_degrees(frame, focal):
    half = frame.depth.shape[1] / 2
    return half / np.tan(np.radians(2 * np.arctan(half / focal)) / 2)


def near_mistaken(frames):
    """Return frames in which device depth of near plane 0.1 and an infinite far plane is made linear by 0.5."""
    return [replace(frame, depth=(frame.depth / 0.1 * 0.5).astype(np.float32)) for frame in frames]


def red_for_blue(frames):
    return [replace(frame, color=np.ascontiguousarray(frame.color[..., ::-1])) for frame in frames]


def jittered(color, depth, motion, cameras):
    """Return a mistake: frames in which each part has so much of the jitter: 0, 1, −1, or (2,) for x and y."""

    def change(plain, jittered):
        frames, before = [], np.zeros(2)
        for still, moved in zip(plain, jittered, strict=True):
            jitter = np.array([moved.camera.cx - still.camera.cx, moved.camera.cy - still.camera.cy])
            frame, added = (moved if depth else still), (np.multiply(motion, 1.0) - depth) * (before - jitter)
            x, y = np.multiply(cameras, jitter)
            one = replace(still.camera, cx=still.camera.cx + x, cy=still.camera.cy + y)
            vectors = frame.motion if frame.reset else (frame.motion + added).astype(np.float32)
            shown = moved if color else still
            frames.append(replace(frame, color=shown.color, motion=vectors, camera=one, display_camera=None))
            before = jitter
        return frames

    return change


# By name: the change of good frames, and the finding that names it; "" where nothing in the buffers tells.
MISTAKES = {
    "camera of the frame before": (of_another_frame("camera", 1), "camera-one-frame-late"),
    "camera of the frame after": (of_another_frame("camera", -1), "camera-one-frame-early"),
    "depth of the frame before": (of_another_frame("depth", 1), "depth-one-frame-late"),
    "depth of the frame after": (of_another_frame("depth", -1), "depth-one-frame-early"),
    "color of the frame before": (of_another_frame("color", 1), "color-one-frame-late"),
    "color of the frame after": (of_another_frame("color", -1), "color-one-frame-early"),
    "vectors of the frame before": (BREAKS["motion one frame late"][1], "motion-one-frame-late"),
    "vectors of the frame after": (of_another_frame("motion", -1), "motion-one-frame-early"),
    "vectors negated": (BREAKS["motion negated"][1], "motion-negated"),
    "vectors halved": (BREAKS["motion half"][1], "motion-half-as-long-as-they-are"),
    "vectors with y up": (BREAKS["motion y flipped"][1], "motion-y-flipped"),
    "vectors in NDC": (BREAKS["motion in NDC"][1], "motion-in-ndc"),
    "vectors to the next frame": (BREAKS["motion to the next frame"][1], "motion-to-the-next-frame"),
    "matrices transposed": (BREAKS["camera transposed"][1], "camera-rotation-transposed"),
    "matrices inverted": (BREAKS["camera inverted"][1], "camera-inverted"),
    "vertical angle for horizontal": (field_of_view(sides_mistaken), "camera-field-of-view"),
    "radians for degrees": (field_of_view(radians_as_degrees), "camera-field-of-view"),
    "depth reversed": (BREAKS["depth reversed"][1], "depth-reversed"),
    "depth along rays": (BREAKS["depth along rays"][1], "depth-along-rays"),
    "near plane mistaken": (near_mistaken, "depth-units"),
    "red for blue": (red_for_blue, ""),
    "frame dropped": (GAPS["frame dropped"], "frames-gap"),
}
# The same for jitter: color, depth, motion, cameras.
JITTERED = {
    "cameras jittered, color antialiased": (jittered(0, 0, 0, 1), "camera-jitter-not-removed"),
    "cameras and depth jittered, color antialiased": (jittered(0, 1, 0, 1), "camera-jitter-not-removed"),
    "cameras, depth and vectors jittered, color antialiased": (jittered(0, 1, 1, 1), "camera-jitter-not-removed"),
    "vectors without jitter": (jittered(1, 1, 0, 1), "motion-jitter-missing"),
    "vectors with jitter alone": (jittered(0, 0, 1, 0), "motion-jitter-not-removed"),
    "cameras without jitter": (jittered(1, 1, 1, 0), "camera-jitter-missing"),
    "jitter of cameras negated": (jittered(1, 1, 1, -1), "camera-jitter-of-the-opposite-sign"),
    "jitter of cameras with y up": (jittered(1, 1, 1, SIGN_OF_Y), "camera-jitter-of-the-opposite-sign-in-y"),
    "jitter of vectors negated": (jittered(1, 1, -1, 1), "motion-jitter-of-the-opposite-sign"),
}
