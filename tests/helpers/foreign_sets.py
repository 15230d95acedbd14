"""Unreal's Movie Render Queue and public data sets, written from frames as `foreign.py` has them."""

import struct

import numpy as np
from foreign import write_exr
from PIL import Image

from gffe_cl import Camera
from gffe_cl.captures.formats.motion_conversion import static_motion


def flow_to(shot, after):
    """Return the flow of what stands still in `shot`, to where it is in `after`."""
    return static_motion(shot.depth, shot.camera, after.camera)[0].astype(np.float32)


# Unreal


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


# Data sets


def srgb_png(path, color):
    linear = np.clip(np.float64(color), 0, 1)
    shown = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray((shown * 255).round().astype(np.uint8)).save(path)


def write_sintel(root, frames):
    """Write a shot of MPI Sintel and return the folder that is opened."""
    tag = struct.pack("<f", 202021.25)
    for name in ("flow", "depth", "camdata_left"):
        (root / name / "alley_1").mkdir(parents=True)
    for k, shot in enumerate(frames, 1):
        srgb_png(root / "final" / "alley_1" / f"frame_{k:04d}.png", shot.color)
        size = tag + struct.pack("<ii", *shot.depth.shape[::-1])
        depth = np.where(np.isinf(shot.depth), 1e10, shot.depth).astype("<f4")
        (root / "depth" / "alley_1" / f"frame_{k:04d}.dpt").write_bytes(size + depth.tobytes())
        fx, fy, cx, cy = shot.camera.intrinsics
        numbers = np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1, *shot.camera.world_to_view[:3].ravel()], "<f8")
        (root / "camdata_left" / "alley_1" / f"frame_{k:04d}.cam").write_bytes(tag + numbers.tobytes())
        if k < len(frames):
            flow = flow_to(shot, frames[k]).astype("<f4")
            (root / "flow" / "alley_1" / f"frame_{k:04d}.flo").write_bytes(size + flow.tobytes())
    return root / "final" / "alley_1"


def write_tartanair(folder, frames):
    """Write a trajectory of TartanAir and return its cameras."""
    poses = []
    for name in ("depth_left", "flow"):
        (folder / name).mkdir()
    height, width = frames[0].depth.shape
    cameras = [Camera(shot.camera.world_to_view, 320, 320, width / 2, height / 2) for shot in frames]
    for k, shot in enumerate(frames):
        srgb_png(folder / "image_left" / f"{k:06d}_left.png", shot.color)
        np.save(folder / "depth_left" / f"{k:06d}_left_depth.npy", np.where(np.isinf(shot.depth), 2e4, shot.depth))
        if k + 1 < len(frames):
            flow = static_motion(shot.depth, cameras[k], cameras[k + 1])[0]
            np.save(folder / "flow" / f"{k:06d}_{k + 1:06d}_flow.npy", np.float32(flow))
        right, down, forward = cameras[k].world_to_view[:3, :3]
        poses.append([*cameras[k].position, *quaternion(np.stack([forward, right, down], -1))])
    np.savetxt(folder / "pose_left.txt", poses, fmt="%.12f")
    return cameras


def quaternion(matrix):
    """Return x, y, z, w of a rotation: the eigenvector that the rotation's own quaternion matrix has."""
    m = matrix
    k = np.array(
        [
            [m[0, 0] - m[1, 1] - m[2, 2], m[1, 0] + m[0, 1], m[2, 0] + m[0, 2], m[2, 1] - m[1, 2]],
            [m[1, 0] + m[0, 1], m[1, 1] - m[0, 0] - m[2, 2], m[2, 1] + m[1, 2], m[0, 2] - m[2, 0]],
            [m[2, 0] + m[0, 2], m[2, 1] + m[1, 2], m[2, 2] - m[0, 0] - m[1, 1], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], m[0, 0] + m[1, 1] + m[2, 2]],
        ]
    )
    return np.linalg.eigh(k)[1][:, -1]


def write_spring(root, frames, inverted=False):
    """Write a scene of Spring; `inverted`: with poses of the camera in the world."""
    import h5py

    intrinsics, extrinsics = [], []
    for name in ("disp1_left", "flow_BW_left", "cam_data"):
        (root / name).mkdir()
    for k, shot in enumerate(frames, 1):
        srgb_png(root / "frame_left" / f"frame_left_{k:04d}.png", shot.color)
        disparity = np.float32(shot.camera.fx * 0.065 / shot.depth)
        stored = [(root / "disp1_left" / f"disp1_left_{k:04d}.dsp5", "disparity", disparity)]
        if k > 1:
            flow = flow_to(shot, frames[k - 2])
            stored.append((root / "flow_BW_left" / f"flow_BW_left_{k:04d}.flo5", "flow", flow))
        for path, name, array in stored:
            with h5py.File(path, "w") as file:
                file[name] = array.repeat(2, 0).repeat(2, 1)
        intrinsics.append(shot.camera.intrinsics)
        matrix = shot.camera.world_to_view
        extrinsics.append((np.linalg.inv(matrix) if inverted else matrix).ravel())
    np.savetxt(root / "cam_data" / "intrinsics.txt", intrinsics)
    np.savetxt(root / "cam_data" / "extrinsics.txt", extrinsics)
