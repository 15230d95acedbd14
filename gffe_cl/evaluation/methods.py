"""How good each part is on the built-in scenes, where the truth of everything is known (`gffe study`)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from gffe_cl.frame import RenderedFrame, pack_frame
from gffe_cl.metrics import display_values, psnr, ssim
from gffe_cl.opencl.device import Device
from gffe_cl.options import Options
from gffe_cl.pipeline import Pipeline
from gffe_cl.scenes import SceneArrays, SceneRenderer, SequenceFrame, load_scene, sequence_frames

# "literal" is the paper taken at its word: single-pixel splats, no crack closing, 32× hole filling.
# "oracle" is the same warp with every fragment's true position at t + α in place of the predicted one.
# Shading correction is off: `shading_study` measures that.
METHODS: dict[str, Options | None] = {
    "repeat": None,
    "literal": Options(crack_closing=False, levels=2, hole_filling="downsample", shading_correction=False),
    "static": Options(motion=False, shading_correction=False),
    "gae": Options(shading_correction=False),
    "oracle": Options(shading_correction=False),
}
_NO_HISTORY = 2  # rendered frames after the reset that do not count


@dataclass
class SceneStudy:
    """Means over the frames of one scene and seed.

    `visible` is PSNR in dB over the pixels that no method but "repeat" and "literal" leaves disoccluded,
    `whole` and `ssim` are over the whole frame; each maps the names of `METHODS` to a figure.
    """

    scene: str
    seed: int
    visible: dict[str, float]
    whole: dict[str, float]
    ssim: dict[str, float]
    disoccluded: float  # share of the pixels that GAE leaves disoccluded
    dynamic: float  # share of the pixels that are dynamic

    @property
    def share(self) -> float:
        """Share of the gap between "repeat" and "oracle" that GAE closes, in dB over visible pixels."""
        floor = self.visible["repeat"]
        gap = self.visible["oracle"] - floor
        return (self.visible["gae"] - floor) / gap if gap else float("nan")


def study_scene(
    device: Device,
    name: str,
    seed: int,
    width: int,
    height: int,
    frames: int,
    fps: float = 30.0,
    alpha: float = 0.5,
    on_frame: Callable[[], None] = lambda: None,
) -> SceneStudy:
    """Extrapolate `frames` rendered frames of a built-in scene by every method and measure at t + α."""
    scene = load_scene(name, seed)
    renderer = SceneRenderer(device, scene, width, height)
    pipelines = {
        method: Pipeline(device, width, height, options, fps=fps)
        for method, options in METHODS.items()
        if options is not None
    }
    rows = []
    for frame, image, time in submitted_frames(renderer, pipelines.values(), frames, fps, alpha, on_frame):
        if time is not None:
            rows.append(_measure(renderer, pipelines, image, frame, time, scene.exposure))
    mean = {
        key: {m: float(np.mean([row[key][m] for row in rows])) for m in METHODS} for key in ("visible", "whole", "ssim")
    }
    shares = {key: float(np.mean([row[key] for row in rows])) for key in ("disoccluded", "dynamic")}
    return SceneStudy(name, seed, **mean, **shares)


def submitted_frames(
    renderer: SceneRenderer,
    pipelines: Iterable[Pipeline],
    frames: int,
    fps: float,
    alpha: float,
    on_frame: Callable[[], None],
) -> Iterator[tuple[SequenceFrame, SceneArrays, float | None]]:
    """Render a scene's frames and submit each to all pipelines. Yields the frame, its rendering, and the time t + α to
    measure at, None for frames with too little history."""
    pipelines = list(pipelines)
    for frame in sequence_frames(renderer.scene, renderer.width, renderer.height, frames, fps, ground_truth=False):
        image = renderer.render(frame.time, frame.camera, frame.previous_time, frame.previous_camera).numpy()
        rendered = RenderedFrame(image.color, image.depth, image.motion, frame.camera, frame.time, reset=frame.reset)
        packed = pack_frame(rendered, renderer.height, renderer.width)
        for pipeline in pipelines:
            pipeline.submit(rendered, packed)
        yield frame, image, frame.time + alpha / fps if frame.source >= _NO_HISTORY else None
        on_frame()


def _measure(renderer, pipelines, image, frame, time, exposure) -> dict:
    camera = renderer.scene.camera(time, renderer.width, renderer.height)
    future = renderer.render(frame.time, frame.camera, time, camera).numpy()
    truth = display_values(renderer.render(time, camera).numpy().color, exposure)
    pictures = {"repeat": display_values(image.color, exposure)}
    holes = np.zeros(truth.shape[:2], bool)
    for method, pipeline in pipelines.items():
        if method == "oracle":
            made = pipeline.extrapolate(camera, time, target_position=true_positions(future))
        else:
            made = pipeline.extrapolate(camera, time)
        pictures[method] = display_values(made.numpy("color"), exposure)
        if method != "literal":
            holes |= made.numpy("disoccluded") > 0
        if method == "gae":
            shares = {n: float(made.numpy(n).mean()) for n in ("disoccluded", "dynamic")}
    return {
        "visible": {m: psnr(p, truth, ~holes) for m, p in pictures.items()},
        "whole": {m: psnr(p, truth) for m, p in pictures.items()},
        "ssim": {m: ssim(p, truth) for m, p in pictures.items()},
        **shares,
    }


def true_positions(future) -> np.ndarray:
    """(H, W, 4) float32 `target_position` of every fragment from a rendering whose `other` is the target."""
    height, width = future.depth.shape
    y, x = np.mgrid[:height, :width].astype(np.float32) + np.float32(0.5)
    position = np.zeros((height, width, 4), np.float32)
    position[..., 0] = x + future.motion[..., 0]
    position[..., 1] = y + future.motion[..., 1]
    position[..., 2] = future.other_position[..., 2]
    position[~np.isfinite(position[..., :2]).all(-1)] = (0, 0, -1, 0)
    return position
