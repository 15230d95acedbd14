"""A scene of Spring, left camera, as a sequence: python spring.py 0001 out/0001 (needs h5py)

Flow leads to the previous frame, as motion does. Flow and disparities have twice the size of the colors.
"""

import sys
from pathlib import Path

import h5py
import numpy as np
from PIL import Image

import gffe_cl as gffe
from gffe_cl.engine.frame.transfer_function import linear_of_srgb

folder, output = Path(sys.argv[1]), sys.argv[2]
images = sorted((folder / "frame_left").glob("*.png"))
width, height = Image.open(images[0]).size
intrinsics = np.loadtxt(folder / "cam_data/intrinsics.txt", ndmin=2)
poses = np.loadtxt(folder / "cam_data/extrinsics.txt", ndmin=2).reshape(-1, 4, 4)  # world -> camera


def stored(name, number, ending, data_set):
    with h5py.File(folder / name / f"{name}_{number}{ending}") as file:
        return file[data_set][::2, ::2]


with gffe.SequenceWriter(output, width, height, fps=24) as writer:
    for k, image in enumerate(images):
        number = image.stem.rpartition("_")[2]
        color = linear_of_srgb(np.asarray(Image.open(image).convert("RGB")) / np.float32(255))
        camera = gffe.Camera(poses[k], *intrinsics[k].tolist())
        with np.errstate(divide="ignore"):
            depth = 0.065 * camera.fx / np.abs(stored("disp1_left", number, ".dsp5", "disparity"))  # meters
        depth = np.where(depth >= 1e4, np.inf, depth)  # sky
        motion = stored("flow_BW_left", number, ".flo5", "flow") if k else None
        entry = gffe.FrameEntry(f"frame_{k:06d}.exr", time=k / 24, reset=k == 0, render_camera=camera)
        writer.add(entry, gffe.named_channels(color, depth, motion))
