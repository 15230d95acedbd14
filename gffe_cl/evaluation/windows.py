"""What rendering windows are worth while the camera turns quickly (`gffe study --windows`; paper: 'Ablation Study')."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from gffe_cl.evaluation.compare import NO_HISTORY
from gffe_cl.evaluation.disocclusions import shows, world_positions
from gffe_cl.metrics import display_values, psnr
from gffe_cl.opencl.device import Device
from gffe_cl.options import Options
from gffe_cl.pipeline import Pipeline
from gffe_cl.scenes import Scene, SceneFrames, SceneRenderer, load_scene
from gffe_cl.window import Window, WindowChooser

# The last two have rendered pixels as small as the display's, and more of them.
MODES = ("off", "fixed:1.1", "fixed:1.2", "fixed:1.4", "adaptive", "adaptive, dense", "wide")
_DENSER = {"adaptive, dense": 1.2, "wide": 1.5}  # times the display, each way


@dataclass
class WindowFigures:
    """Means over frames. `holes`: share of the extrapolated pixels that lay outside of the rendered image; PSNR in dB
    of extrapolated frames, `whole` and over the `interior`, the pixels that no mode has disoccluded; `shown`: PSNR of
    rendered frames as displayed; `texel`: display pixels per rendered pixel, along one side."""

    frames: int
    holes: float
    whole: float
    interior: float
    shown: float
    texel: float


@dataclass
class WindowStudy:
    """Of one scene and seed: figures by mode, while the camera turns steadily, and for frames within an interval of a
    reversal, which no prediction foresees."""

    scene: str
    seed: int
    steady: dict[str, WindowFigures]
    reversing: dict[str, WindowFigures]


def study_windows(
    device: Device,
    name: str,
    seed: int,
    width: int,
    height: int,
    frames: int,
    fps: float = 30.0,
    alpha: float = 0.5,
    on_frame: Callable[[], None] = lambda: None,
    rate: float = 150.0,
) -> WindowStudy:
    """Turn the camera of a built-in scene at `rate` degrees per second, back after half of the `frames`, and
    extrapolate through every kind of window."""
    half = (frames // 2) / fps
    scene = _turning(load_scene(name, seed), rate, half)
    truths = {}
    scene_frames = SceneFrames(SceneRenderer(device, scene, width, height))
    for step in range(frames):
        for time in (step / fps, (step + alpha) / fps):
            image = scene_frames.truth(time).numpy()
            truths[time] = display_values(image.color, scene.exposure), image.depth
    rows = {mode: _rows(device, scene, mode, (width, height), frames, fps, alpha, truths, on_frame) for mode in MODES}
    figures = []
    for reversing in (False, True):
        kept = [k for k in range(NO_HISTORY, frames) if ((k - 1) / fps < half < (k + alpha) / fps) == reversing]
        figures.append({mode: _figures([rows[mode][k] for k in kept], kept, rows) for mode in rows})
    return WindowStudy(name, seed, *figures)


class _Grown(WindowChooser):
    """The adaptive window, or for "wide" none, grown evenly to the size at which rendered pixels are the display's."""

    def __init__(self, mode, size, render_size, alphas):
        self._render_size = render_size
        most = min(r / s for r, s in zip(render_size, size, strict=True))
        super().__init__("off" if mode == "wide" else "adaptive", size, alphas, most)

    def choose(self, current, previous):
        window = super().choose(current, previous)
        low, high = [], []
        for k in range(2):
            shown, rendered = self.size[k], self._render_size[k]
            middle = (window[k] + window[k + 2]) / 4 * shown + shown / 2  # display pixels
            start = min(max(round(middle - rendered / 2), shown - rendered), 0)
            low.append(2 * start / shown - 1)
            high.append(2 * (start + rendered) / shown - 1)
        return Window(*low, *high)


def _rows(device, scene, mode, size, frames, fps, alpha, truths, on_frame) -> list[dict]:
    """What one mode gives after each rendered frame."""
    # Grown by whole pixels on both sides: rendered pixels lie on those of the display.
    render_size = tuple(n + 2 * round((_DENSER.get(mode, 1) - 1) / 2 * n) for n in size)
    windows = _Grown(mode, size, render_size, [alpha]) if mode in _DENSER else WindowChooser(mode, size, [alpha])
    scene_frames = SceneFrames(SceneRenderer(device, scene, *render_size), windows, size)
    pipeline = Pipeline(device, *size, Options(shading_correction=False), render_size=render_size, fps=fps)
    rows = []
    for k, frame in enumerate(scene_frames.sequence(frames, fps)):
        pipeline.submit(frame)
        time = (k + alpha) / fps
        camera = scene_frames.display_camera(time)
        made = pipeline.extrapolate(camera, time)
        truth, depth = truths[time]
        disoccluded = made.numpy("disoccluded") > 0
        outside = ~shows(frame.camera, *render_size, world_positions(camera, depth, disoccluded))
        shown = display_values(pipeline.present().numpy("color"), scene.exposure)
        texel = np.sqrt(frame.display_camera.fx / frame.camera.fx * frame.display_camera.fy / frame.camera.fy)
        rows.append(
            {
                "image": display_values(made.numpy("color"), scene.exposure),
                "truth": truth,
                "disoccluded": disoccluded,
                "holes": outside.sum() / disoccluded.size,
                "shown": psnr(shown, truths[k / fps][0]),
                "texel": texel,
            }
        )
        on_frame()
    return rows


def _figures(own: list[dict], kept: list[int], rows: dict[str, list[dict]]) -> WindowFigures:
    seen = [~np.any([of_mode[k]["disoccluded"] for of_mode in rows.values()], axis=0) for k in kept]
    interior = [psnr(r["image"], r["truth"], mask) for r, mask in zip(own, seen, strict=True)]
    whole = [psnr(r["image"], r["truth"]) for r in own]
    means = (np.mean([r["holes"] for r in own]), np.mean(whole), np.mean(interior))
    return WindowFigures(len(own), *map(float, (*means, *(np.mean([r[n] for r in own]) for n in ("shown", "texel")))))


def _turning(scene: Scene, rate: float, half: float) -> Scene:
    """The same scene with a camera that turns to the right until `half` (seconds), then back."""
    forward = scene.target(0.0) - scene.eye(0.0)
    start = np.arctan2(forward[0], -forward[2])
    level = np.hypot(forward[0], forward[2])

    def target(time):
        angle = start + np.radians(rate) * (half - abs(half - time))
        return scene.eye(time) + np.array((level * np.sin(angle), forward[1], -level * np.cos(angle)))

    return replace(scene, target=target)
