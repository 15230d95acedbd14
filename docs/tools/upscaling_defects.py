"""Defects of upscaling: ghosts, shimmer and thin bars, measured where the truth is exact.

`measure_upscaling.py` calls this. Scenes are rectangles (`tests/helpers/synthetic.py`), and built-in ones held still.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from pages import REPOSITORY, table
from scipy.ndimage import binary_dilation

from gffe_cl.captures.scenes import SCENES, SceneFrames, load_scene
from gffe_cl.engine.frame.jitter import Jitter
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.lab.metrics import to_display

sys.path.insert(0, str(REPOSITORY / "tests" / "helpers"))
from synthetic import Rect, Rects, camera

W, H, SCALE, FPS = 192, 128, 2, 30
SEED = 2
JITTER = Jitter(16)
SHIMMER_SIZE, SETTLED, SEEN = (240, 136), 24, 16
FAR, NEAR = 12, 6  # meters to the wall, and to the movers
GRAY = Rect((0, 0, FAR), (40, 40), frequency=0, tint=(0.2,) * 3)
AFTER = 6  # frames
FLAT = 1e-3


def pipeline_of(device: Device, size: tuple[int, int], upscale: float = SCALE) -> Pipeline:
    small = tuple(round(n / SCALE) for n in size)
    return Pipeline(device, *size, Options(upscale=upscale, shading_correction=False), render_size=small)


def frames(scene: Rects, count: int) -> Iterator[RenderedFrame]:
    """Jittered, of a sample per pixel, under a camera at rest."""
    shown, before = camera(W, H), None
    for k in range(count):
        render = JITTER.camera(shown.scaled(1 / SCALE, 1 / SCALE), k)
        frame = scene.frame(render, k / FPS, W // SCALE, H // SCALE, before, reset=before is None)
        before = render, k / FPS
        yield replace(frame, display_camera=shown)


def defects(device: Device) -> dict:
    return {"ghosts": ghosts(device), "shimmer": shimmer(device), "bars": bars(device)}


def ghosts(device: Device) -> dict[str, list[float]]:
    """Return, by mover, the largest error shown, in 255ths of display white, of pixels that it left 1, 2, … rendered
    frames ago, two pixels around it excepted. The wall behind is flat, so that nothing else is wrong there."""
    made = {}
    for name, tint, speed in (("bright, fast", 0.9, 9), ("bright, slow", 0.9, 1.5), ("dark, fast", 0.01, 9)):
        board = Rect(
            (-5 if speed > 5 else -1.5, 0, NEAR), (0.6, 1.5), velocity=(speed, 0, 0), frequency=0, tint=(tint,) * 3
        )
        scene, worst = Rects([GRAY, board]), np.zeros(AFTER)
        pipeline, since = pipeline_of(device, (W, H)), np.full((H, W), np.inf)
        for k, frame in enumerate(frames(scene, 30)):
            pipeline.submit(frame)
            covered = np.abs(scene.color(camera(W, H), k / FPS, W, H, 3) - GRAY.texture(np.zeros(2))).max(-1) > FLAT
            since = np.where(_grown(covered), 0, since + 1)
            error = np.abs(shown_by(pipeline) - to_display(GRAY.texture(np.zeros((1, 1, 2))), 1.0)).max(-1)
            for n in range(1, AFTER + 1):
                if (since == n).any():
                    worst[n - 1] = max(worst[n - 1], 255 * error[since == n].max())
        made[name] = worst.tolist()
    return made


def shimmer(device: Device) -> dict[str, list[float]]:
    """Return, by built-in scene in which nothing moves, the mean variance of shown frames over time, in squared 255ths,
    without upscaling and with it."""
    made = {}
    for name in SCENES:
        scene = load_scene(name, SEED)
        held = SceneFrames.for_upscaling(device, scene, SHIMMER_SIZE, SCALE)
        seen = {upscale: [] for upscale in (0, SCALE)}
        pipelines = {upscale: pipeline_of(device, SHIMMER_SIZE, upscale) for upscale in seen}
        for pipeline in pipelines.values():
            pipeline.exposure = scene.exposure
        before = None
        for k in range(SETTLED + SEEN):
            frame = _still(held, before, k)
            before = frame
            for upscale, pipeline in pipelines.items():
                pipeline.submit(frame)
                if k >= SETTLED:
                    seen[upscale].append(shown_by(pipeline, scene.exposure))
        made[name] = [float(np.var(seen[upscale], 0).mean() * 255**2) for upscale in (0, SCALE)]
    return made


def _still(held: SceneFrames, before: RenderedFrame | None, k: int) -> RenderedFrame:
    """Return the same moment again, jittered anew."""
    shown = held.display_camera(1.0)
    render = held.render_camera(shown, before, k)
    image = held.renderer.render(1.0, render, 1.0, before and before.camera, phase=k % held.jitter.length).numpy()
    return RenderedFrame(image.color, image.depth, image.motion, render, k / FPS, shown, reset=before is None)


def bars(device: Device) -> dict[str, list[float]]:
    """Return, by width in rendered pixels, the contrast of upright bars against the wall relative to the truth, mean
    over frames and least, and the least of the resampled frames."""
    focal, made = camera(W, H).fx, {}
    for width in (0.25, 0.5, 0.75, 1.0, 1.5):
        half = width * SCALE * NEAR / focal / 2
        group = [Rect((0.37 * k - 2.6, 0, NEAR), (half, 2), frequency=0, tint=(0.9,) * 3) for k in range(15)]
        scene = Rects([Rect((0, 0, FAR), (40, 40), frequency=0, tint=(0.1,) * 3), *group])
        pipelines = [pipeline_of(device, (W, H), upscale) for upscale in (SCALE, 0)]
        row = scene.color(camera(W, H), 0, W, H, 8)[H // 2, :, 1]
        kept: list[list[float]] = [[], []]
        for k, frame in enumerate(frames(scene, 48)):
            for pipeline, contrasts in zip(pipelines, kept, strict=True):
                pipeline.submit(frame)
                if k >= SETTLED:
                    shown = pipeline.present().numpy("color")[H // 4 : 3 * H // 4, :, 1].astype(np.float32)
                    contrasts.append(_contrast(shown.mean(0), row))
        made[f"{width:g}"] = [float(np.mean(kept[0])), min(kept[0]), min(kept[1])]
    return made


def _contrast(shown: np.ndarray, truth: np.ndarray) -> float:
    """Return the share of the truth's contrast that is shown: the slope of the one over the other."""
    centered = truth - truth.mean()
    return float((shown * centered).sum() / (centered**2).sum())


def defect_tables(found: dict) -> dict[str, str]:
    heads = ("mover", *(f"{n} frame{'s' * (n > 1)} after" for n in range(1, AFTER + 1)))
    ghosts_of = [(name, *(f"{error:.1f}" for error in errors)) for name, errors in found["ghosts"].items()]
    shimmers = [(name, f"{a:.1f}", f"{b:.2f}", f"{a / b:.0f}×") for name, (a, b) in found["shimmer"].items()]
    bars_of = [(f"{width} px", *(f"{share:.0%}" for share in shares)) for width, shares in found["bars"].items()]
    return {
        "ghosts": table(heads, ghosts_of),
        "shimmer": table(("scene", "bicubic", "upscaled", "less"), shimmers),
        "bars": table(("width", "upscaled, mean", "upscaled, least", "bicubic, least"), bars_of),
    }


def _grown(mask: np.ndarray, by: int = 2) -> np.ndarray:
    return binary_dilation(mask, np.ones((3, 3)), by)


def shown_by(pipeline: Pipeline, exposure: float = 1.0) -> np.ndarray:
    return to_display(pipeline.present().numpy("color"), exposure)
