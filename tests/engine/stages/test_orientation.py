"""Frames that are mirrored or transposed make mirrored or transposed frames."""

from dataclasses import replace

import numpy as np

from gffe_cl import Camera, Options, Pipeline
from gffe_cl.captures.scenes import SceneFrames, SceneRenderer, load_scene
from gffe_cl.engine.frame.window import WindowChooser

SIZE = 160, 96
# Of points (x, y, z), and whether x and y change places.
TURNS = {
    "mirrored": (np.diag([-1.0, 1, 1, 1]), False),
    "upside down": (np.diag([1.0, -1, 1, 1]), False),
    "transposed": (np.eye(4)[[1, 0, 2, 3]], True),
}
# Both are of the order of axes: blocks have 8×4 pixels, and the lattice of samples is rounded down.
OPTIONS = Options(shading_correction=False, blocks=False, sharpness=False)


def turned_image(image, turn):
    matrix, swaps = TURNS[turn]
    image = image[:: int(matrix[1].sum()), :: int(matrix[0].sum())]
    return np.ascontiguousarray(image.swapaxes(0, 1) if swaps else image)


def turned(frame, turn):
    (matrix, swaps), camera = TURNS[turn], frame.camera
    (width, height), signs = frame.depth.shape[::-1], matrix[:2].sum(1)
    fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
    cx, cy = (width - cx if signs[0] < 0 else cx), (height - cy if signs[1] < 0 else cy)
    seen = (fy, fx, cy, cx) if swaps else (fx, fy, cx, cy)
    motion = turned_image(np.asarray(frame.motion), turn)[..., :: -1 if swaps else 1] * np.float32(signs)
    images = {name: turned_image(np.asarray(getattr(frame, name)), turn) for name in ("color", "depth")}
    camera = Camera(matrix @ camera.world_to_view @ matrix, *seen)
    return replace(frame, **images, motion=np.ascontiguousarray(motion), camera=camera, display_camera=None)


def made(device, frames):
    pipeline = Pipeline(device, *frames[0].depth.shape[::-1], OPTIONS)
    for frame in frames:
        pipeline.submit(frame)
    new = pipeline.extrapolate(time=frame.time + 0.5 / 30)
    return new.numpy("color").astype(np.float32), new.numpy("depth")


def test_stages_do_not_depend_on_the_order_of_axes(device):
    """Colors are equal to .01 and depth to 1%, but for one pixel in 1000."""
    chooser, renderer = WindowChooser("off", SIZE, [0.5]), SceneRenderer(device, load_scene("street", 0), *SIZE)
    frames = list(SceneFrames(renderer, chooser, SIZE).sequence(4, 30.0))
    color, depth = made(device, frames)
    for turn in TURNS:
        other_color, other_depth = made(device, [turned(frame, turn) for frame in frames])
        differs = (np.abs(other_color - turned_image(color, turn)) > 0.01).any(-1)
        differs |= ~np.isclose(other_depth, turned_image(depth, turn), rtol=0.01)
        assert differs.mean() < 0.001, f"{turn}: {differs.sum()} pixels"
