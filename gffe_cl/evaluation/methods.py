"""How good each part is on the built-in scenes, where the truth of everything is known (`gffe study`)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from gffe_cl.evaluation.compare import NO_HISTORY
from gffe_cl.frame import RenderedFrame, pack_frame
from gffe_cl.metrics import display_values, measurable, psnr
from gffe_cl.opencl.device import Device
from gffe_cl.options import Options
from gffe_cl.pipeline import Pipeline
from gffe_cl.scenes import SceneFrames, SceneRenderer, load_scene

# "literal" is the paper taken at its word: single-pixel splats, no crack closing, 32× hole filling.
# "oracle" is the same warp with every fragment's true position at t + α in place of the predicted one.
# Shading correction is off: `shading_study` measures that.
METHODS: dict[str, Options | None] = {
    "repeat": None,
    "literal": Options(
        crack_closing=False, levels=2, hole_filling="downsample", soft_silhouettes=False, shading_correction=False
    ),
    "static": Options(motion=False, shading_correction=False),
    "gae": Options(shading_correction=False),
    "oracle": Options(shading_correction=False),
}


@dataclass
class SceneStudy:
    """Means over the frames of one scene and seed.

    `visible` is PSNR in dB over the pixels that no method but "repeat" and "literal" leaves disoccluded, by method;
    `whole`, by metric and method, is over the whole frame.
    """

    scene: str
    seed: int
    visible: dict[str, float]
    whole: dict[str, dict[str, float]]
    disoccluded: float  # share of the pixels that GAE leaves disoccluded
    dynamic: float  # share of the pixels that are dynamic

    @property
    def share(self) -> float:
        """Share of the gap between "repeat" and "oracle" that GAE closes, in dB over visible pixels."""
        floor = self.visible["repeat"]
        gap = self.visible["oracle"] - floor
        return (self.visible["gae"] - floor) / gap if gap else float("nan")

    def to_json(self) -> dict:
        """PSNR over the whole frame is "whole" there, other metrics have their names."""
        whole = {"whole" if name == "psnr" else name: by_method for name, by_method in self.whole.items()}
        plain = {name: getattr(self, name) for name in ("scene", "seed", "visible", "disoccluded", "dynamic", "share")}
        return plain | whole


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
    scene_frames = SceneFrames(SceneRenderer(device, scene, width, height))
    pipelines = {
        method: Pipeline(device, width, height, options, fps=fps)
        for method, options in METHODS.items()
        if options is not None
    }
    rows = []
    for _, frame, time in submitted_frames(scene_frames, pipelines.values(), frames, fps, alpha, on_frame):
        if time is not None:
            rows.append(_measure(scene_frames, pipelines, frame, time))

    def mean(*keys):
        return {m: float(np.mean([row[(*keys, m)] for row in rows])) for m in METHODS}

    whole = {metric.name: mean("whole", metric.name) for metric in measurable()}
    shares = {key: float(np.mean([row[key] for row in rows])) for key in ("disoccluded", "dynamic")}
    return SceneStudy(name, seed, mean("visible"), whole, **shares)


def submitted_frames(
    scene_frames: SceneFrames,
    pipelines: Iterable[Pipeline],
    frames: int,
    fps: float,
    alpha: float,
    on_frame: Callable[[], None],
) -> Iterator[tuple[int, RenderedFrame, float | None]]:
    """Render a scene's frames and submit each to all pipelines. Yields the number of the frame, the frame, and the time
    t + α to measure at, None for frames with too little history."""
    pipelines = list(pipelines)
    for k, frame in enumerate(scene_frames.sequence(frames, fps)):
        packed = pack_frame(frame, *np.shape(frame.depth))
        for pipeline in pipelines:
            pipeline.submit(frame, packed)
        yield k, frame, frame.time + alpha / fps if k >= NO_HISTORY else None
        on_frame()


def _measure(scene_frames: SceneFrames, pipelines: dict[str, Pipeline], frame: RenderedFrame, time: float) -> dict:
    """Figures of one frame, by (what, …, method)."""
    exposure, camera = scene_frames.scene.exposure, scene_frames.display_camera(time)
    future = scene_frames.renderer.render(frame.time, frame.camera, time, camera).numpy()
    truth = display_values(scene_frames.truth(time).read("color"), exposure)
    pictures = {"repeat": display_values(frame.color, exposure)}
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
            row = {n: float(made.numpy(n).mean()) for n in ("disoccluded", "dynamic")}
    metrics = measurable()
    for method, picture in pictures.items():
        row["visible", method] = psnr(picture, truth, ~holes)
        row |= {("whole", metric.name, method): metric.measure(picture, truth) for metric in metrics}
    return row


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
