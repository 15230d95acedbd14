"""Makes the pictures of what goes wrong, docs/pictures/limit_*.jpg, from built-in scenes.

    python docs/make_limits.py [NAME …]

Each shows a part of a frame: rendered at t, extrapolated to t + ½, and the truth there.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gffe_cl.evaluation.methods import submitted_frames
from gffe_cl.evaluation.report import contact_sheet
from gffe_cl.metrics import display_values
from gffe_cl.opencl.device import Device, open_device
from gffe_cl.options import Options
from gffe_cl.pipeline import Pipeline
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


def picture(device: Device, limit: Limit):
    """A PIL image: three parts side by side, captions above."""
    scene = load_scene(limit.scene)
    frames = SceneFrames(SceneRenderer(device, scene, *SIZE))
    pipeline = Pipeline(device, *SIZE, Options(), fps=FPS)
    pipeline.exposure = scene.exposure
    rows, columns = (slice(start, start + n) for start, n in zip((limit.y, limit.x), PART[::-1], strict=True))
    for k, frame, time in submitted_frames(frames, [pipeline], limit.frame + 1, FPS, ALPHA, lambda: None):
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
    for name in sys.argv[1:] or LIMITS:
        picture(device, LIMITS[name]).save(FOLDER / f"limit_{name}.jpg", quality=88)
        print(FOLDER / f"limit_{name}.jpg")


if __name__ == "__main__":
    main()
