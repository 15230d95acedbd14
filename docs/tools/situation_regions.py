"""Frames of scenes, and regions of situations: where the thing that a situation holds is seen, by the renderer.

`measure_deviations.py` uses these.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from scipy.ndimage import binary_dilation

from gffe_cl.captures.scenes import SceneFrames
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.lab.compare import NO_HISTORY
from gffe_cl.lab.metrics import to_display

BESIDE = 2  # pixels around movers that count as their silhouettes
CHANGED = 0.02  # least change by light, display values, mean over R, G and B


def region_of_situation(kind: str, frames: SceneFrames, known: tuple[float, ...], time: float) -> np.ndarray:
    """Return (H, W) bool: where, at `time`, something that moves by itself is seen or within `BESIDE` px ("movers");
    where something still was lit otherwise at one of the `known` times ("light"); or
    everything ("all")."""
    if kind == "all":
        return np.ones(frames.size[::-1], bool)
    moves = np.array([group.motion.moves for group in frames.scene.groups] + [False])  # the last one: sky
    shown = frames.truth(time)
    object_id, color = shown.read("object_id"), shown.read("color")
    movers = binary_dilation(moves[object_id], iterations=BESIDE)
    if kind == "movers":
        return movers
    found, now = np.zeros_like(movers), to_display(color, frames.scene.exposure)
    for moment in known:
        was = frames.renderer.render(moment, frames.display_camera(time))
        change = np.abs(to_display(was.read("color"), frames.scene.exposure) - now).mean(-1)
        found |= (change > CHANGED) & ~binary_dilation(moves[was.read("object_id")], iterations=BESIDE)
    return found & ~movers


def submitted_frames(
    scene_frames: SceneFrames, pipelines: Iterable[Pipeline], frames: int, fps: float, alpha: float
) -> Iterator[tuple[int, RenderedFrame, float | None]]:
    """Render a scene's frames and submit each to all pipelines. Yields the number of the frame, the frame, and the time
    t + α to measure at, None for frames with too little history."""
    pipelines = list(pipelines)
    for k, frame in enumerate(scene_frames.sequence(frames, fps)):
        for pipeline in pipelines:
            pipeline.submit(frame)
        yield k, frame, frame.time + alpha / fps if k >= NO_HISTORY else None
