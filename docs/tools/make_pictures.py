"""Make the pictures in docs/pictures, but for those of the viewer.

    python docs/tools/make_pictures.py [NAME …]

- `demo`: a film of the scene of `gffe demo`, rendered frames beside rendered and extrapolated ones, slowed.
- `limit_*`: a part of a frame, rendered at t, extrapolated to t + ½, and the truth there.
- `gain_*`: the part that gains most from a module beyond the paper: without it, with it, and the truth.
- `shading`: the part that gains most from shading correction, with the network's whole image and both focus masks.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from pages import PICTURES
from PIL import Image
from scipy.ndimage import uniform_filter

from gffe_cl.captures.scenes import SceneFrames, SceneRenderer, load_scene
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.opencl.device import Device, open_device
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.lab.compare import NO_HISTORY
from gffe_cl.lab.demo import contact_sheet, side_by_side
from gffe_cl.lab.metrics import focus_mask, to_display

SIZE, PART = (640, 360), (128, 72)
FPS, ALPHA = 30.0, 0.5
FILMED, FILM_FRAMES, SLOWDOWN = (448, 252), 75, 4


@dataclass(frozen=True)
class Limit:
    """Part of a frame to show: number of the rendered frame, and the upper left corner in pixels."""

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
}
SEARCHED = 8  # rendered frames
SHADING = ("gallery", "courtyard")


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


def gain_picture(device: Device, gain: Gain):
    """Return a picture of the part that gains most."""
    frames = SceneFrames(SceneRenderer(device, load_scene(gain.scene), *SIZE))
    without = Options(**{"shading_correction": False, gain.option: False})
    pipelines = {
        "without": Pipeline(device, *SIZE, without, fps=FPS),
        "with": Pipeline(device, *SIZE, replace(without, **{gain.option: True}), fps=FPS),
    }
    k, x, y, parts = chosen_part(frames, pipelines, gain.alpha)
    label = f"{gain.scene}, frame {k}, t + {gain.alpha:g}, {SIZE[0]} x {SIZE[1]}, x = {x}, y = {y}"
    return contact_sheet([(label, list(parts.items()))], cell_width=320)


def shading_picture(device: Device):
    """Return a picture of shading correction, a scene in a row."""
    groups = []
    for name in SHADING:
        frames = SceneFrames(SceneRenderer(device, load_scene(name), *SIZE))
        ways = {"without": Options(shading_correction=False), "with": Options(), "whole": Options(focus_mask=False)}
        pipelines = {way: Pipeline(device, *SIZE, options, fps=FPS) for way, options in ways.items()}
        k, x, y, _ = chosen_part(frames, {way: pipelines[way] for way in ("without", "with")}, ALPHA)
        whole, full = pipelines["whole"], Pipeline(device, *SIZE, Options(), fps=FPS)
        whole.exposure = full.exposure = exposure = frames.scene.exposure
        *_, (_, _, time) = submitted_frames(frames, [full, whole], k + 1, FPS, ALPHA)
        camera, truth = frames.display_camera(time), frames.truth(time).read("color")
        made = full.extrapolate(camera, time)
        color = made.numpy("gae")
        images = {
            "extrapolated": to_display(color, exposure),
            "final": to_display(made.numpy("color"), exposure),
            "the network's whole image": to_display(whole.extrapolate(camera, time).numpy("color"), exposure),
            "truth": to_display(truth, exposure),
            "focus mask": full.stages["correction"].read("focus_mask").astype(np.float32),
            "true focus mask": focus_mask(color, truth, made.numpy("dynamic"), exposure).astype(np.float32),
        }
        part = slice(y, y + PART[1]), slice(x, x + PART[0])
        label = f"{name}, frame {k}, t + {ALPHA:g}, {SIZE[0]} x {SIZE[1]}, x = {x}, y = {y}"
        groups.append((label, [(caption, np.ascontiguousarray(image[part])) for caption, image in images.items()]))
    return contact_sheet(groups, columns=6, cell_width=264)


def chosen_part(
    frames: SceneFrames,
    pipelines: dict[str, Pipeline],
    alpha: float,
):
    """Return the part of all frames in which the second of `pipelines` gains most against the first: number of the
    rendered frame, x, y, and the display values of both and of the truth by name."""
    scene = frames.scene
    for pipeline in pipelines.values():
        pipeline.exposure = scene.exposure
    best, chosen = -np.inf, None
    for k, _, time in submitted_frames(frames, pipelines.values(), SEARCHED, FPS, alpha):
        if time is None:
            continue
        camera = frames.display_camera(time)
        shown = {
            name: to_display(p.extrapolate(camera, time).numpy("color"), scene.exposure)
            for name, p in pipelines.items()
        }
        shown["truth"] = to_display(frames.truth(time).read("color"), scene.exposure)
        errors = [np.square(shown[name] - shown["truth"]).mean(-1) for name in pipelines]
        gained = uniform_filter(errors[0] - errors[1], PART[::-1], mode="constant")
        inside = gained[PART[1] // 2 : SIZE[1] - PART[1] // 2, PART[0] // 2 : SIZE[0] - PART[0] // 2]
        y, x = np.unravel_index(inside.argmax(), inside.shape)
        if inside[y, x] > best:
            rows, columns = slice(y, y + PART[1]), slice(x, x + PART[0])
            best, chosen = inside[y, x], (k, x, y, {n: p[rows, columns].copy() for n, p in shown.items()})
    return chosen


def picture(device: Device, limit: Limit):
    """Return three parts side by side, captions above."""
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
            shown = {name: to_display(color, scene.exposure)[rows, columns] for name, color in images.items()}
            label = f"{limit.scene}, frame {limit.frame}, {SIZE[0]} x {SIZE[1]}, x = {limit.x}, y = {limit.y}"
            return contact_sheet([(label, [(n, np.ascontiguousarray(p)) for n, p in shown.items()])], cell_width=320)
    raise ValueError(f"{limit.scene}: no frame {limit.frame} with enough history")


def film(device: Device) -> list[Image.Image]:
    frames = SceneFrames(SceneRenderer(device, load_scene("corridor"), *FILMED))
    pipeline = Pipeline(device, *FILMED, Options(), fps=FPS)
    pipeline.exposure = frames.scene.exposure

    def pairs():
        for frame in frames.sequence(FILM_FRAMES, FPS):
            pipeline.submit(frame)
            rendered = to_display(frame.color, pipeline.exposure)
            time = frame.time + ALPHA / FPS
            made = pipeline.extrapolate(frames.display_camera(time), time).numpy("color")
            yield rendered, rendered
            yield rendered, to_display(made, pipeline.exposure)

    labels = f"rendered, 30 Hz, 1/{SLOWDOWN} speed", "with extrapolated frames, 60 Hz"
    return [Image.fromarray(image) for image in side_by_side(pairs(), labels)]


def main() -> None:
    device = open_device()
    makers = {f"limit_{name}": partial(picture, device, limit) for name, limit in LIMITS.items()}
    makers |= {f"gain_{name}": partial(gain_picture, device, gain) for name, gain in GAINS.items()}
    makers |= {"shading": partial(shading_picture, device)}
    for name in sys.argv[1:] or ["demo", *makers]:
        if name == "demo":
            first, *others = film(device)
            pace = round(1000 * SLOWDOWN * ALPHA / FPS)  # ms
            first.save(PICTURES / "demo.webp", save_all=True, append_images=others, duration=pace, loop=0, quality=50)
        else:
            makers[name]().save(PICTURES / f"{name}.jpg", quality=88)
        print(name)


if __name__ == "__main__":
    main()
