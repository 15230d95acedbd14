"""Makes the pictures of what goes wrong, docs/pictures/limit_*.jpg, and of what modules beyond the paper are worth,
docs/pictures/gain_*.jpg, from built-in scenes; and docs/pictures/situations.jpg.

    python docs/make_limits.py [NAME …]

Each of the first shows a part of a frame: rendered at t, extrapolated to t + ½, and the truth there; each of the second
the part that gains most of frames extrapolated without the module and with it, and the truth; the last one, of every
situation, the part of its region where the paper's way is worst.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from measure_deviations import FOR_SITUATIONS, NO_NETWORK, PAPER, kernels_with
from scipy.ndimage import uniform_filter
from situation_regions import region_of_situation, submitted_frames

from gffe_cl.evaluation.metrics import display_values
from gffe_cl.evaluation.report import contact_sheet
from gffe_cl.opencl.device import Device, open_device
from gffe_cl.pipeline.options import Options
from gffe_cl.pipeline.pipeline import Pipeline
from gffe_cl.scenes import SceneFrames, SceneRenderer, load_scene

FOLDER = Path(__file__).parent / "pictures"
SIZE, PART = (640, 360), (128, 72)
FPS, ALPHA = 30.0, 0.5


@dataclass(frozen=True)
class Limit:
    """Where to look: number of the rendered frame, and the upper left corner of the part in pixels."""

    scene: str
    frame: int
    x: int
    y: int


LIMITS = {
    "never_seen": Limit("corridor", 3, 440, 175),
    "bars": Limit("plaza", 3, 170, 217),
    "rims": Limit("factory", 3, 115, 25),
    "shadows": Limit("courtyard", 3, 160, 205),
    "reflections": Limit("gallery", 3, 190, 65),
    "out_of_screen": Limit("forest", 5, 512, 200),
}


@dataclass(frozen=True)
class Gain:
    """A scene that needs a module, the option that switches it, and which time after t shows it."""

    scene: str
    option: str
    alpha: float


GAINS = {
    "silhouettes": Gain("plaza", "soft_silhouettes", 0.5),
    "hidden_parts": Gain("plaza", "hidden_parts", 1.0),
    "acceleration": Gain("factory", "acceleration", 1.0),
    "shading": Gain("courtyard", "shading_correction", 0.5),
}
SEARCHED = 8  # rendered frames


def gain_picture(device: Device, gain: Gain):
    """As `picture`."""
    frames = SceneFrames(SceneRenderer(device, load_scene(gain.scene), *SIZE))
    without = Options(**{"shading_correction": False, gain.option: False})
    pipelines = {
        "without": Pipeline(device, *SIZE, without, fps=FPS),
        "with": Pipeline(device, *SIZE, replace(without, **{gain.option: True}), fps=FPS),
    }
    k, x, y, parts = chosen_part(frames, pipelines, gain.alpha)
    label = f"{gain.scene}, frame {k}, t + {gain.alpha:g}, {SIZE[0]} x {SIZE[1]}, x = {x}, y = {y}"
    return contact_sheet([(label, list(parts.items()))], cell_width=320)


def situations_picture(device: Device):
    """As `picture`: two situations in a row."""
    cells = []
    for name, (_, without, region) in FOR_SITUATIONS.items():
        frames = SceneFrames(SceneRenderer(device, load_scene(name), *SIZE))
        with kernels_with(PAPER):
            paper = Pipeline(device, *SIZE, replace(Options(camera_order=1), **(PAPER | NO_NETWORK).options), fps=FPS)
        pipelines = {f"{name}: the paper's way": paper, "ours": Pipeline(device, *SIZE, Options(), fps=FPS)}
        cells += chosen_part(frames, pipelines, 1.0, without.camera, region)[-1].items()
    label = f"situations, t + 1, parts of {SIZE[0]} x {SIZE[1]}"
    return contact_sheet([(label, cells)], columns=6, cell_width=256)


def chosen_part(
    frames: SceneFrames,
    pipelines: dict[str, Pipeline],
    alpha: float,
    camera_known: bool = True,
    region: str | None = None,
):
    """The part of all frames in which the second of `pipelines` gains most against the first; or the first is worst in
    that region of a situation. The rendered frame's number, x, y, and the part of what both make and of the truth,
    display values by name."""
    scene = frames.scene
    for pipeline in pipelines.values():
        pipeline.exposure = scene.exposure
    best, chosen = -np.inf, None
    for k, frame, time in submitted_frames(frames, pipelines.values(), SEARCHED, FPS, alpha):
        if time is None:
            continue
        camera = frames.display_camera(time) if camera_known else None
        shown = {
            name: display_values(p.extrapolate(camera, time).numpy("color"), scene.exposure)
            for name, p in pipelines.items()
        }
        shown["truth"] = display_values(frames.truth(time).read("color"), scene.exposure)
        errors = [np.square(shown[name] - shown["truth"]).mean(-1) for name in pipelines]
        score = errors[0] - errors[1]
        if region:
            known = frame.time, frame.time - 1 / FPS
            score = errors[0] * region_of_situation(region, frames, known, time)
        gained = uniform_filter(score, PART[::-1], mode="constant")
        inside = gained[PART[1] // 2 : SIZE[1] - PART[1] // 2, PART[0] // 2 : SIZE[0] - PART[0] // 2]
        y, x = np.unravel_index(inside.argmax(), inside.shape)
        if inside[y, x] > best:
            rows, columns = slice(y, y + PART[1]), slice(x, x + PART[0])
            best, chosen = inside[y, x], (k, x, y, {n: p[rows, columns].copy() for n, p in shown.items()})
    return chosen


def picture(device: Device, limit: Limit):
    """A PIL image: three parts side by side, captions above."""
    scene = load_scene(limit.scene)
    frames = SceneFrames(SceneRenderer(device, scene, *SIZE))
    pipeline = Pipeline(device, *SIZE, Options(), fps=FPS)
    pipeline.exposure = scene.exposure
    rows, columns = (slice(start, start + n) for start, n in zip((limit.y, limit.x), PART[::-1], strict=True))
    for k, frame, time in submitted_frames(frames, [pipeline], limit.frame + 1, FPS, ALPHA):
        if k == limit.frame and time is not None:
            camera = frames.display_camera(time)
            made, truth = pipeline.extrapolate(camera, time).numpy("color"), frames.truth(time).read("color")
            images = {"rendered (t)": frame.color, "extrapolated (t + 1/2)": made, "truth (t + 1/2)": truth}
            shown = {name: display_values(color, scene.exposure)[rows, columns] for name, color in images.items()}
            label = f"{limit.scene}, frame {limit.frame}, {SIZE[0]} x {SIZE[1]}, x = {limit.x}, y = {limit.y}"
            return contact_sheet([(label, [(n, np.ascontiguousarray(p)) for n, p in shown.items()])], cell_width=320)
    raise ValueError(f"{limit.scene}: no frame {limit.frame} with enough history")


def main() -> None:
    device = open_device()
    for name in sys.argv[1:] or [*LIMITS, *GAINS, "situations"]:
        if name in LIMITS:
            path, made = FOLDER / f"limit_{name}.jpg", picture(device, LIMITS[name])
        elif name == "situations":
            path, made = FOLDER / "situations.jpg", situations_picture(device)
        else:
            path, made = FOLDER / f"gain_{name}.jpg", gain_picture(device, GAINS[name])
        made.save(path, quality=88)
        print(path)


if __name__ == "__main__":
    main()
