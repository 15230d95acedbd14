"""A scene of MPI Sintel as a sequence: python sintel.py training/final/alley_1 out/alley_1

`flow`, `depth` and `camdata_left` lie beside `final`. Flow to the next frame is inverted.
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

import gffe_cl as gffe
from gffe_cl.captures.formats.flow import inverted_flow
from gffe_cl.engine.frame.transfer_function import linear_of_srgb

colors, output = Path(sys.argv[1]).absolute(), sys.argv[2]
flows, depths, cameras = (colors.parents[1] / name / colors.name for name in ("flow", "depth", "camdata_left"))
images = sorted(colors.glob("frame_*.png"))
width, height = Image.open(images[0]).size
before = None
with gffe.SequenceWriter(output, width, height, fps=24) as writer:
    for k, image in enumerate(images):
        color = linear_of_srgb(np.asarray(Image.open(image).convert("RGB")) / np.float32(255))
        depth = np.fromfile(depths / f"{image.stem}.dpt", "<f4", offset=12).reshape(height, width)
        depth = np.where(depth >= 1e4, np.inf, depth)  # meters: sky
        numbers = np.fromfile(cameras / f"{image.stem}.cam", "<f8", 21, offset=4)
        pose = np.vstack([numbers[9:].reshape(3, 4), (0, 0, 0, 1)])
        camera = gffe.Camera(pose, *numbers[[0, 4, 2, 5]].tolist())
        motion = None
        if before:
            flow = np.fromfile(flows / f"{before[0]}.flo", "<f4", offset=12).reshape(height, width, 2)
            motion = inverted_flow(flow, *before[1:], depth, camera)
        entry = gffe.FrameEntry(f"frame_{k:06d}.exr", time=k / 24, reset=k == 0, render_camera=camera)
        writer.add(entry, gffe.named_channels(color, depth, motion))
        before = image.stem, depth, camera
