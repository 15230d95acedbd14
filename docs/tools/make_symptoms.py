"""Make the pictures of docs/symptoms.md: a fault as it looks, the layer that shows it, and the same frame without it.

    python docs/tools/make_symptoms.py [NAME …]

A fault is injected into frames of a built-in scene (tests/helpers/fault_injection.py has some), or a module is
switched off. The pictures are not measurements: places are chosen where the fault is plain to see.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from make_stage_pictures import PINK, YELLOW, Part, depth_colors, is_hole, marked
from pages import PICTURES, REPOSITORY
from PIL import Image, ImageDraw

from gffe_cl.captures.scenes import SceneFrames, SceneRenderer, load_scene
from gffe_cl.engine.frame.rendered_frame import Overlays, RenderedFrame
from gffe_cl.engine.frame.window import WindowChooser
from gffe_cl.engine.opencl.device import Device, open_device
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.lab.demo import contact_sheet, to_image
from gffe_cl.lab.metrics import to_display
from gffe_cl.viewer.picture.displays import LABEL_COLORS

sys.path.insert(0, str(REPOSITORY / "tests" / "helpers"))
from fault_injection import Kept, broken

SIZE, CELL, QUALITY = (640, 360), 320, 82
COUNT = 6  # rendered frames, the last of which is extrapolated
OPTIONS = Options(shading_correction=False)
SLICES, SLICE_HEIGHT = 8, 5  # rendered frames of a slice through time, and pixels per displayed frame

Frames = list[RenderedFrame]
Panels = list[tuple[str, np.ndarray]]


class Footage:
    """Rendered frames of a scene, and the truth half an interval or an interval after the last one."""

    def __init__(self, device: Device, scene: str, alpha: float = 1.0, fps: float = 30.0, count: int = COUNT, **more):
        self.device, self.alpha, self.fps = device, alpha, fps
        self.source = SceneFrames(SceneRenderer(device, load_scene(scene), *SIZE), **more)
        self.exposure = self.source.scene.exposure
        self.frames: Frames = list(self.source.sequence(count, fps))

    @property
    def time(self) -> float:
        return self.frames[-1].time + self.alpha / self.fps

    def broken(self, fault: str) -> Frames:
        return broken(Kept(self.frames, self.exposure, self.fps), [fault]).images

    def objects(self, time: float, *names: str) -> np.ndarray:
        """Return a mask (H, W) of the pixels that show objects of these names."""
        named = np.array([group.name in names for group in self.source.scene.groups] + [False])  # the last one: sky
        return named[self.source.truth(time).read("object_id")]

    def shown(self, color: np.ndarray) -> np.ndarray:
        return to_display(color[..., :3], self.exposure)

    def truth(self) -> np.ndarray:
        return self.shown(self.source.truth(self.time).read("color"))

    def made(self, frames: Frames, options: Options = OPTIONS) -> Made:
        pipeline = Pipeline(self.device, *SIZE, options, fps=self.fps)
        pipeline.exposure = self.exposure
        for frame in frames:
            pipeline.submit(frame)
        made = pipeline.extrapolate(self.source.display_camera(self.time), self.time)
        dynamic = pipeline.stages["history"].read("dynamic_mask")
        return Made(self.shown(made.numpy("color")), made.numpy("filled_by"), dynamic.astype(np.float32))

    def slices(self, frames: Frames, row: int, columns: slice, options: Options = OPTIONS) -> np.ndarray:
        """Return one row of pixels of the displayed frames, rendered and generated in turn, one below the other."""
        pipeline = Pipeline(self.device, *SIZE, options, fps=self.fps)
        pipeline.exposure = self.exposure
        lines = []
        for k, frame in enumerate(frames):
            pipeline.submit(frame)
            time = frame.time + 0.5 / self.fps
            made = pipeline.extrapolate(self.source.display_camera(time), time).numpy("color")
            if k >= len(frames) - SLICES:
                lines += [self.shown(image)[row, columns] for image in (_with_effects(frame), made)]
        return np.repeat(np.stack(lines), SLICE_HEIGHT, 0)


@dataclass
class Made:
    """Extrapolated frame: display values (H, W, 3), labels, and the dynamic mask of the rendered frame."""

    image: np.ndarray
    labels: np.ndarray
    dynamic: np.ndarray

    def label_colors(self) -> np.ndarray:
        return np.array(LABEL_COLORS)[self.labels & 15]


def ghosts(device: Device) -> Panels:
    footage = Footage(device, "plaza", fps=12)
    late = [replace(frame, color=before.color) for before, frame in pairwise(footage.frames)]
    rendered = late[-1]
    overlaid = 0.5 * footage.shown(rendered.color) + 0.5 * depth_colors(rendered.depth)
    return [
        ("color is one frame older than depth", footage.made([footage.frames[0], *late]).image),
        ("color over rendered.depth", overlaid),
        ("all buffers of one frame", footage.made(footage.frames).image),
    ]


def torn(device: Device) -> Panels:
    footage = Footage(device, "corridor", count=8)
    wrong = footage.made(footage.frames, replace(OPTIONS, static_threshold=12.0))
    return [
        ("--static-threshold 12", wrong.image),
        ("history.dynamic_mask", wrong.dynamic),
        ("automatic threshold", footage.made(footage.frames).image),
    ]


def sky(device: Device) -> Panels:
    footage = Footage(device, "forest")
    without = [
        replace(frame, depth=np.where(footage.objects(frame.time, "crown", "conifer"), 0, frame.depth))
        for frame in footage.frames
    ]
    wrong = footage.made(without)
    return [
        ("leaves are not in the depth buffer", wrong.image),
        ("pink: hole filling", marked(0.6 * wrong.image, (is_hole(wrong.labels), PINK), share=0.6)),
        ("leaves write depth", footage.made(footage.frames).image),
    ]


def flicker(device: Device) -> Panels:
    """Return a picture of smoke that the engine draws into rendered frames only."""
    footage = Footage(device, "plaza", count=SLICES + 2)
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    smoke = np.zeros((*SIZE[::-1], 4), np.float32)
    smoke[..., 3] = 0.8 * np.exp(-((x - 345) ** 2 + (y - 150) ** 2) / 400)
    smoke[..., :3] = 0.3 / footage.exposure * smoke[..., 3:]
    frames = [replace(f, overlays=Overlays(effects=smoke.astype(np.float16))) for f in footage.frames]
    wrong = "smoke in rendered frames only", frames, replace(OPTIONS, overlays=False)
    return _through_time(footage, wrong, ("passed as Overlays.effects", frames), FLICKER_ROW)


def swimming(device: Device) -> Panels:
    footage = Footage(device, "room", count=SLICES + 2)
    wrong = "field of view 8% too narrow", footage.broken("camera field of view"), OPTIONS
    return _through_time(footage, wrong, ("right field of view", footage.frames), SWIMMING_ROW)


def cracks(device: Device) -> Panels:
    footage = Footage(device, "corridor")
    wrong = footage.made(footage.frames, replace(OPTIONS, crack_closing=False))
    return [
        ("--no-crack-closing", wrong.image),
        ("filled_by: lines of other sources", wrong.label_colors()),
        ("with it", footage.made(footage.frames).image),
    ]


def borders(device: Device) -> Panels:
    windowed = Footage(device, "forest", windows=WindowChooser("adaptive", SIZE, [1.0]))
    footage = Footage(device, "forest")
    wrong = footage.made(footage.frames)
    return [
        ("no window", wrong.image),
        ("pink: hole filling", marked(0.6 * wrong.image, (is_hole(wrong.labels), PINK), share=0.6)),
        ("rendered with --window adaptive", windowed.made(windowed.frames).image),
    ]


def invalid(device: Device) -> Panels:
    footage = Footage(device, "gallery", alpha=0.5)
    limit = 3.0
    bright = [np.asarray(frame.color, np.float32).max(-1, keepdims=True) > limit for frame in footage.frames]
    bad = [
        replace(frame, color=np.where(mask, np.float16(np.nan), frame.color))
        for frame, mask in zip(footage.frames, bright, strict=True)
    ]
    return [
        ("NaN where a lamp overflows", footage.made(bad).image),
        ("yellow: invalid colors", marked(0.4 * footage.shown(footage.frames[-1].color), (bright[-1][..., 0], YELLOW))),
        ("clamped by the engine", footage.made(footage.frames).image),
    ]


def hud(device: Device) -> Panels:
    footage = Footage(device, "forest")
    drawing = Image.new("RGBA", SIZE)
    draw = ImageDraw.Draw(drawing)
    draw.rectangle((14, 14, 150, 40), (12, 16, 22, 255), (230, 230, 230, 255), 2)
    draw.rectangle((20, 20, 110, 34), (200, 30, 40, 255))
    draw.text((22, 46), "AMMO 24 / 96", (255, 255, 255, 255), stroke_width=1, stroke_fill=(0, 0, 0, 255))
    pixels = np.asarray(drawing, np.float32) / 255
    ui = np.concatenate([pixels[..., :3] ** 2.2 * pixels[..., 3:] / footage.exposure, pixels[..., 3:]], -1)
    drawn = [replace(f, color=(ui[..., :3] + (1 - ui[..., 3:]) * f.color).astype(np.float16)) for f in footage.frames]
    apart = [replace(f, overlays=Overlays(ui=ui.astype(np.float16))) for f in footage.frames]
    return [
        ("drawn into the color", footage.made(drawn).image),
        ("the rendered frame", footage.shown(drawn[-1].color)),
        ("passed as Overlays.ui", footage.made(apart).image),
    ]


def cuts(device: Device) -> Panels:
    footage = Footage(device, "corridor")
    wrong, right = footage.made(footage.broken("motion negated")), footage.made(footage.frames)
    return [
        ("negated vectors: all frames are cuts", wrong.image),
        ("history.dynamic_mask: empty", wrong.dynamic),
        ("right vectors", right.image),
    ]


def slow(device: Device) -> Panels:
    footage = Footage(device, "rotors", alpha=0.5)
    return [
        ("--preset performance", footage.made(footage.frames, Options.preset("performance")).image),
        ("the default without its network", footage.made(footage.frames).image),
        ("really rendered", footage.truth()),
    ]


def _through_time(footage: Footage, wrong: tuple[str, Frames, Options], right: tuple[str, Frames], row) -> Panels:
    """Return slices of wrong and right frames through time, and between them where their row of pixels is: `row` is x
    of its first pixel, and y."""
    x, y = row
    part, columns = Part(x, y - 40, SLICED, 2 * SLICES * SLICE_HEIGHT), slice(x, x + SLICED)
    image = footage.shown(_with_effects(right[1][-1]))
    image[y] = YELLOW
    return [
        (wrong[0], footage.slices(wrong[1], y, columns, wrong[2])),
        ("the row of pixels that is shown", part.of(image)),
        (right[0], footage.slices(right[1], y, columns)),
    ]


def _with_effects(frame: RenderedFrame) -> np.ndarray:
    """Return the color of a rendered frame with its effects, as the engine displays it."""
    if frame.overlays is None:
        return frame.color
    effects = np.asarray(frame.overlays.effects, np.float32)
    return effects[..., :3] + (1 - effects[..., 3:]) * frame.color[..., :3]


FLICKER_ROW, SWIMMING_ROW, SLICED = (300, 150), (140, 300), 80  # x of the first pixel, and y; pixels
NEAR = Part(494, 281, 128, 72)
MAKERS: dict[str, tuple[Callable[[Device], Panels], Part | None]] = {
    "ghosts": (ghosts, Part(161, 178, 128, 72)),
    "torn": (torn, Part(489, 238, 128, 72)),
    "sky": (sky, Part(278, 30, 160, 90)),
    "flicker": (flicker, None),
    "swimming": (swimming, None),
    "cracks": (cracks, NEAR),
    "borders": (borders, Part(512, 200, 128, 72)),
    "invalid": (invalid, Part(374, 88, 96, 54)),
    "hud": (hud, Part(0, 0, 160, 90)),
    "cuts": (cuts, NEAR),
    "slow": (slow, Part(240, 0, 128, 72)),
}


def picture(panels: Panels, part: Part | None) -> Image.Image:
    """Return the panels in a row, or that part of each, below their captions."""
    shown = [(caption, part.of(image) if part else image) for caption, image in panels]
    shown = [(caption, np.asarray(_enlarged(image)) / 255) for caption, image in shown]
    sheet = contact_sheet([("", shown)], cell_width=CELL)
    return sheet.crop((0, 28, sheet.width, sheet.height - 8))  # without the empty line of a label


def _enlarged(image: np.ndarray) -> Image.Image:
    """Return the image as wide as a cell, its pixels as squares."""
    whole = to_image(image)
    return whole.resize((CELL, round(CELL * whole.height / whole.width)), Image.Resampling.NEAREST)


def main() -> None:
    device = open_device()
    for name in sys.argv[1:] or MAKERS:
        make, part = MAKERS[name]
        picture(make(device), part).save(PICTURES / f"symptom_{name}.jpg", quality=QUALITY)
        print(name)


if __name__ == "__main__":
    main()
