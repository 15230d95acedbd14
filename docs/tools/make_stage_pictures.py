"""Make the pictures of docs/how_it_works.md: what each stage reads and makes, in false colors where it is no color.

    python docs/tools/make_stage_pictures.py [NAME …]

Most of the geometry is shown on the situation `bars`, the warp on the scene `corridor`, the window and shading on
`courtyard`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from make_pictures import submitted_frames
from pages import PICTURES
from scipy.ndimage import binary_erosion
from skimage.color import hsv2rgb

from gffe_cl.captures.scenes import SceneFrames, SceneRenderer, load_scene
from gffe_cl.engine.frame.window import WindowChooser
from gffe_cl.engine.opencl.device import Device, open_device
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.background import REMEMBERED
from gffe_cl.engine.stages.buffers import BY_CRACK_CLOSING, BY_HIDDEN_PART, BY_HOLE_FILLING, BY_NOTHING, grid_of
from gffe_cl.engine.stages.warp import BACKWARD
from gffe_cl.lab.demo import contact_sheet, error_image
from gffe_cl.lab.metrics import to_display
from gffe_cl.viewer.picture.displays import color_table

SIZE, FPS, ALPHA = (640, 360), 30.0, 1.0
CELL = 384  # px, of a picture's columns
QUALITY = 72
LONGEST, FLOW, DIMMED = 16, 4, 0.35  # px of full brightness; pixels of the flow's grid; share
PINK, BLUE, YELLOW, RED, GRAY = (1, 0.1, 0.8), (0.1, 0.55, 1), (1, 0.85, 0), (0.95, 0.15, 0.1), (0.5, 0.5, 0.5)

Panels = list[tuple[str, np.ndarray]]


@dataclass(frozen=True)
class Part:
    """A part of the image, in pixels: upper left corner and size."""

    x: int
    y: int
    width: int = 256
    height: int = 192

    def of(self, image: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(image[self.y : self.y + self.height, self.x : self.x + self.width])


class Moment:
    """A scene's frame at t, extrapolated to t + α, with every buffer and what each stage left of the new frame."""

    def __init__(self, device: Device, scene: str, number: int, window: str = "off"):
        self.device, self.scene, self.number = device, scene, number
        windows = WindowChooser(window, SIZE, [ALPHA])
        self.frames = SceneFrames(SceneRenderer(device, load_scene(scene), *SIZE), windows=windows)
        self.pipeline = Pipeline(device, *SIZE, Options(shading_inputs=True), fps=FPS)
        self.pipeline.keep()
        self.pipeline.exposure = self.frames.scene.exposure
        *_, (_, self.rendered, time) = submitted_frames(self.frames, [self.pipeline], number + 1, FPS, ALPHA)
        camera = self.frames.display_camera(time)
        self.made = self.pipeline.extrapolate(camera, time)
        self.truth = self.shown(self.frames.truth(time).read("color"))
        self._owners = {f"{owner.name}.{spec.name}": (owner, spec) for owner, spec in self.pipeline.named_buffers()}

    def read(self, name: str) -> np.ndarray:
        """Return a buffer by its name, such as "warp.color", at full resolution."""
        owner, spec = self._owners[name]
        array = owner.read(spec.name)
        if spec.planes > 1:
            array = np.moveaxis(array, 0, -1)
        x, y = grid_of(spec.grid).texel
        return array.repeat(y, 0).repeat(x, 1)[: SIZE[1], : SIZE[0]]

    def color(self, name: str) -> np.ndarray:
        return self.shown(self.read(name)[..., :3])

    def shown(self, color: np.ndarray) -> np.ndarray:
        return to_display(color, self.pipeline.exposure)


def false_colors(values: np.ndarray, low: float, high: float, name: str = "viridis") -> np.ndarray:
    index = np.nan_to_num((values - low) / (high - low) * 255).clip(0, 255)
    return color_table(name)[index.astype(np.uint8)]


def depth_colors(depth: np.ndarray) -> np.ndarray:
    """Return colors of depth: near is red, far is blue, evenly over 1/depth; sky is black."""
    inverse = 1 / depth
    colors = false_colors(inverse, 0, np.quantile(inverse, 0.99), "turbo")
    return np.where(np.isfinite(depth)[..., None], colors, 0)


def vector_colors(vectors: np.ndarray, longest: float) -> np.ndarray:
    """Return colors of vectors: hue is the direction, brightness the length."""
    x, y = np.moveaxis(np.nan_to_num(vectors.astype(np.float32)), -1, 0)
    hue = np.arctan2(y, x) / (2 * np.pi) % 1
    return hsv2rgb(np.stack([hue, np.ones_like(hue), np.sqrt(np.clip(np.hypot(x, y) / longest, 0, 1))], -1))


def marked(image: np.ndarray, *marks: tuple[np.ndarray, tuple[float, float, float]], share: float = 1.0) -> np.ndarray:
    """Return `image` with masks in colors that cover it by a share."""
    image = image.copy()
    for mask, color in marks:
        image[mask] = (1 - share) * image[mask] + share * np.array(color)
    return image


def grayed(image: np.ndarray) -> np.ndarray:
    return np.repeat(image.mean(-1, keepdims=True), 3, -1) * DIMMED


def is_hole(labels: np.ndarray) -> np.ndarray:
    return (labels == BY_HOLE_FILLING) | (labels == BY_NOTHING)


def with_holes(at: Moment, stage: str) -> np.ndarray:
    """Return the new frame as a stage left it; empty pixels are pink."""
    return marked(at.color(f"{stage}.color"), (is_hole(at.read(f"{stage}.filled_by")), PINK))


def inputs(at: Moment) -> Panels:
    rendered = at.rendered
    return [
        ("color", at.shown(rendered.color)),
        ("depth: near red, far blue", depth_colors(rendered.depth)),
        ("motion vectors: hue is direction", vector_colors(rendered.motion, LONGEST)),
    ]


def window(at: Moment) -> Panels:
    """Return the same frame rendered with and without a window."""
    without = Moment(at.device, at.scene, at.number)
    image, camera, shown = at.shown(at.rendered.color), at.rendered.camera, at.rendered.shown_camera
    scale = camera.fx / shown.fx, camera.fy / shown.fy
    left, top = camera.cx - shown.cx * scale[0], camera.cy - shown.cy * scale[1]
    columns = slice(round(left), round(left + SIZE[0] * scale[0]) - 1)
    rows = slice(round(top), round(top + SIZE[1] * scale[1]) - 1)
    frame = np.zeros(image.shape[:2], bool)
    frame[rows, columns] = True
    border = frame & ~binary_erosion(frame, iterations=3)
    return [
        ("rendered through the window; yellow: shown", marked(image, (border, YELLOW))),
        ("t + 1 without it: holes at the border", with_holes(without, "warp")),
        ("t + 1 with it", with_holes(at, "warp")),
    ]


def history(at: Moment) -> Panels:
    dynamic = at.read("history.dynamic_mask") > 0
    return [
        ("rendered frame t", at.shown(at.rendered.color)),
        ("dynamic mask", dynamic.astype(np.float32)),
        ("motion vectors of dynamic pixels", vector_colors(at.rendered.motion * dynamic[..., None], LONGEST)),
    ]


def acceleration(at: Moment) -> Panels:
    velocity, bend = (at.read(f"acceleration.{name}") for name in ("velocity", "bend"))
    speed, change = (np.linalg.norm(array[..., :3].astype(np.float32), axis=-1) for array in (velocity, bend))
    most = [np.quantile(values[values > 0], 0.98) for values in (speed, change)]
    return [
        ("rendered frame t", at.shown(at.rendered.color)),
        ("speed of movers, in cells of 4 x 4 pixels", false_colors(speed, 0, most[0], "heat")),
        ("change of velocity that goes on", false_colors(change, 0, most[1], "heat")),
    ]


def connectivity(at: Moment) -> Panels:
    links = at.read("connectivity.links")
    unlinked = ((links & 1) == 0) | ((links & 2) == 0)
    return [
        ("rendered frame t", at.shown(at.rendered.color)),
        ("depth", depth_colors(at.rendered.depth)),
        ("white: no link to the right or down", unlinked.astype(np.float32)),
    ]


def prediction(at: Moment) -> Panels:
    y, x = np.mgrid[: SIZE[1], : SIZE[0]] + 0.5
    displacement = at.read("prediction.target_position")[..., :2] - np.stack([x, y], -1)
    return [
        ("rendered frame t", at.shown(at.rendered.color)),
        ("motion vectors, t to t - 1", vector_colors(at.rendered.motion, LONGEST)),
        ("predicted motion, t to t + 1", vector_colors(displacement, LONGEST)),
    ]


def warp(at: Moment) -> Panels:
    labels = at.read("warp.filled_by")
    backward = at.read("backward_blocks.block_class") == BACKWARD
    image = at.color("warp.color")
    return [
        ("blue: blocks of one smooth surface", marked(image, (backward, BLUE), share=0.5)),
        ("yellow: closed cracks", marked(grayed(image), (labels == BY_CRACK_CLOSING, YELLOW))),
        ("the new frame; pink: disoccluded", with_holes(at, "warp")),
    ]


def hidden_parts(at: Moment) -> Panels:
    filled = at.read("hidden_parts.filled_by") == BY_HIDDEN_PART
    after = with_holes(at, "hidden_parts")
    return [
        ("before", with_holes(at, "warp")),
        ("yellow: hidden parts of movers", marked(grayed(after), (filled, YELLOW))),
        ("after", after),
    ]


def collection(at: Moment) -> Panels:
    remembered = at.read("background.state_0") == REMEMBERED
    image, dynamic = at.shown(at.rendered.color), at.read("history.dynamic_mask") > 0
    background = np.where(remembered[..., None], at.color("background.color_0"), marked(image, (dynamic, (0, 0, 0))))
    return [
        ("rendered frame t", image),
        ("blue: remembered behind what is shown", marked(grayed(image), (remembered, BLUE))),
        ("background: black where nothing is known", background),
    ]


def projection(at: Moment) -> Panels:
    before, after = at.read("hidden_parts.filled_by"), at.read("projection.filled_by")
    image = with_holes(at, "projection")
    return [
        ("before", with_holes(at, "hidden_parts")),
        ("blue: from the background", marked(grayed(image), (is_hole(before) & ~is_hole(after), BLUE))),
        ("after", image),
    ]


def holes(at: Moment) -> Panels:
    return [
        ("before", with_holes(at, "projection")),
        ("after: holes continue their far side", at.color("holes.color")),
        ("ground truth", at.truth),
    ]


def silhouettes(at: Moment) -> Panels:
    coverage = at.read("silhouettes.coverage")
    return [
        ("before", at.color("holes.color")),
        ("coverage of the nearer surface", np.where(coverage > 0, (coverage.astype(np.float32) - 1) / 254, 0)),
        ("after", at.color("silhouettes.color")),
        ("ground truth", at.truth),
    ]


def shading(at: Moment) -> Panels:
    return [
        ("extrapolated frame", at.color("frame.color")),
        ("previous frame, warped to t + 1", at.color("shading.warped_previous")),
        ("input mask: 1 dynamic, 0 hole", at.read("shading.input_mask").astype(np.float32)),
    ]


def candidates(at: Moment) -> Panels:
    trend = at.read("shading_trend.trends")[..., :3].mean(-1)
    reach = np.quantile(np.abs(trend), 0.995)
    return [
        ("extrapolated frame", at.color("frame.color")),
        ("flow of shading: hue is direction", vector_colors(at.read("shading_flow.flow2"), FLOW)),
        ("trend: yellow brighter, violet darker", false_colors(trend, -reach, reach)),
    ]


def correction(at: Moment) -> Panels:
    before, after = at.color("frame.color"), at.color("correction.color")
    return [
        ("before", before),
        ("focus mask", at.read("correction.focus_mask").astype(np.float32)),
        ("after", after),
        ("error before", error_image(before, at.truth)),
        ("error after", error_image(after, at.truth)),
        ("ground truth", at.truth),
    ]


def labels(at: Moment) -> Panels:
    by, image = at.read("frame.filled_by"), at.color("frame.color")
    filled = by == BY_HOLE_FILLING
    background = (by >= 1) & (by <= 4)
    marks = (by == BY_CRACK_CLOSING, GRAY), (background, BLUE), (by == BY_HIDDEN_PART, YELLOW), (filled, RED)
    return [
        ("where each pixel comes from", marked(grayed(image), *marks)),
        ("extrapolated frame, t + 1", image),
        ("ground truth", at.truth),
    ]


PERSON, EDGE = Part(0, 130), Part(87, 157, 64, 48)
BARS, CORRIDOR = ("bars", 11, "off"), ("corridor", 5, "off")
TURN, SHADOWS = ("courtyard", 27, "adaptive"), ("courtyard", 8, "off")
# By the picture's name: scene, number of the rendered frame and window; part of the image (None: all); maker.
MAKERS: dict[str, tuple[tuple[str, int, str], Part | None, Callable[[Moment], Panels]]] = {
    "inputs": (BARS, None, inputs),
    "window": (TURN, None, window),
    "history": (BARS, PERSON, history),
    "acceleration": (BARS, PERSON, acceleration),
    "connectivity": (BARS, PERSON, connectivity),
    "collection": (BARS, PERSON, collection),
    "prediction": (BARS, PERSON, prediction),
    "warp": (CORRIDOR, None, warp),
    "hidden_parts": (BARS, PERSON, hidden_parts),
    "projection": (BARS, PERSON, projection),
    "holes": (BARS, PERSON, holes),
    "silhouettes": (BARS, EDGE, silhouettes),
    "labels": (BARS, None, labels),
    "shading": (SHADOWS, None, shading),
    "candidates": (SHADOWS, None, candidates),
    "correction": (SHADOWS, None, correction),
}


def picture(moment: Moment, part: Part | None, panels: Panels):
    label = f"{moment.scene}, frame {moment.number}, {SIZE[0]} x {SIZE[1]}"
    if part:
        panels = [(caption, part.of(image)) for caption, image in panels]
        label += f", x = {part.x}, y = {part.y}"
    columns = 2 if len(panels) == 4 else 3
    return contact_sheet([(label, panels)], columns=columns, cell_width=CELL)


def main() -> None:
    device = open_device()
    moments: dict[tuple[str, int, str], Moment] = {}
    for name in sys.argv[1:] or MAKERS:
        place, part, make = MAKERS[name]
        if place not in moments:
            moments[place] = Moment(device, *place)
        moment = moments[place]
        picture(moment, part, make(moment)).save(PICTURES / f"stage_{name}.webp", quality=QUALITY)
        print(name)


if __name__ == "__main__":
    main()
