"""Unreal's Movie Render Queue, written from frames as `foreign.py` has them."""

import numpy as np
from foreign import write_exr

from gffe_cl import Camera
from gffe_cl.captures.sequence.engine_form import static_motion


def unreal_axes(pitch, yaw, roll):
    """Return forward, right and up as columns, from rotations one after another: yaw about z, pitch about y, roll about
    x."""
    p, y, r = np.radians([pitch, yaw, roll])
    about_z = np.array([[np.cos(y), -np.sin(y), 0], [np.sin(y), np.cos(y), 0], [0, 0, 1]])
    about_y = np.array([[np.cos(p), 0, -np.sin(p)], [0, 1, 0], [np.sin(p), 0, np.cos(p)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(r), np.sin(r)], [0, -np.sin(r), np.cos(r)]])
    return about_z @ about_y @ about_x


def unreal_shots(frames):
    """Return the frames as an Unreal camera would have seen them: its poses in centimeters, in a left-handed world."""
    made = []
    for k, shot in enumerate(frames):
        height, width = shot.depth.shape
        fov = 2 * np.degrees(np.arctan(width / 2 / 70.0))
        angles, location = (3 - k, 20 + 2.0 * k, 1.5 * k), np.array([100 + 9 * k, -50 + 5 * k, 170 - 3 * k])
        axes = unreal_axes(*angles)
        view = np.eye(4)
        view[:3, :3] = (axes[:, 1], -axes[:, 2], axes[:, 0])
        view[:3, 3] = -view[:3, :3] @ location
        camera = Camera(view, 70, 70, width / 2, height / 2)
        made.append((shot, angles, location, fov, camera, shot.depth * 100))
    return made


def write_unreal(folder, frames, scale=2.0, along_rays=False, prefix="unreal/camera/", layers="", half=False):
    """Write the frames and return them as `unreal_shots` makes them."""
    seen = unreal_shots(frames)
    height, width = frames[0].depth.shape
    center = width / 2, height / 2
    here = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), -1)
    stretch = np.linalg.norm(np.dstack([(here - center) / 70, np.ones((height, width))]), axis=-1)
    kind, most = (np.float16, 65504) if half else (np.float32, 1e9)
    for k, (shot, angles, location, fov, camera, depth) in enumerate(seen):
        texts = dict(zip(("curRot/pitch", "curRot/yaw", "curRot/roll"), angles, strict=True))
        texts |= dict(zip(("curPos/x", "curPos/y", "curPos/z"), location, strict=True))
        header = {prefix + name: f"{value:.9f}" for name, value in texts.items()}
        header[f"{prefix}FinalImage/fov" if "camera" in prefix else f"{prefix}fov"] = f"{fov:.9f}"
        motion = np.zeros((height, width, 2))
        if k:
            motion = np.nan_to_num(static_motion(depth, camera, seen[k - 1][4])[0])
        depth = np.where(np.isinf(depth), 1e8, depth) * (stretch if along_rays else 1)
        channels = {f"{layers}{c}": shot.color[..., i] for i, c in enumerate("RGB")}
        channels[f"{layers}A"] = shot.color[..., 0]
        for c in "RGB":
            channels[f"FinalImageMovieRenderQueue_WorldDepth.{c}"] = np.minimum(depth, most).astype(kind)
        moved = 0.5 - motion[..., 0] / scale / width, 0.5 + motion[..., 1] / scale / height, np.zeros_like(depth)
        for c, plane in zip("RGB", moved, strict=True):
            channels[f"FinalImageMovieRenderQueue_MotionVectors.{c}"] = plane.astype(np.float32)
        write_exr(folder / f"Shot.{k + 17:04d}.exr", channels, **header)
    return seen
