"""A trajectory of TartanAir as a sequence: python tartanair.py P000 out/P000

Its flow is the camera's alone and leads to the next frame: it is inverted.
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

import gffe_cl as gffe
from gffe_cl.captures.formats.flow import inverted_flow
from gffe_cl.engine.frame.transfer_function import linear_of_srgb

AXES = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]])  # x forward, y right, z down -> x right, y down, z forward
folder, output = Path(sys.argv[1]), sys.argv[2]
images, before = sorted((folder / "image_left").glob("*_left.png")), None
width, height = Image.open(images[0]).size
with gffe.SequenceWriter(output, width, height, fps=30) as writer:
    for k, (*position, x, y, z, w) in enumerate(np.loadtxt(folder / "pose_left.txt", ndmin=2)[: len(images)]):
        turn = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
        pose = np.eye(4)
        pose[:3, :3] = AXES @ np.transpose(turn)
        pose[:3, 3] = -pose[:3, :3] @ position
        camera = gffe.Camera(pose, 320, 320, width / 2, height / 2)
        color = linear_of_srgb(np.asarray(Image.open(images[k]).convert("RGB")) / np.float32(255))
        depth = np.load(folder / "depth_left" / f"{k:06d}_left_depth.npy")
        depth = np.where(depth >= 1e4, np.inf, depth)  # meters: sky
        flow = folder / "flow" / f"{k - 1:06d}_{k:06d}_flow.npy"
        motion = inverted_flow(np.load(flow), *before, depth, camera) if before else None
        entry = gffe.FrameEntry(f"frame_{k:06d}.exr", time=k / 30, reset=k == 0, render_camera=camera)
        writer.add(entry, gffe.named_channels(color, depth, motion))
        before = depth, camera
