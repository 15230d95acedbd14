"""The story of how a pixel came about, from what the buffers of its slot hold."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from gffe_cl.buffers import BY_CRACK_CLOSING, BY_HIDDEN_PART, BY_HOLE_FILLING, BY_NOTHING, BY_WARP, FILLED_BY
from gffe_cl.camera import Camera
from gffe_cl.opencl.program import constants
from gffe_cl.pipeline import Pipeline
from gffe_cl.stages.background import MAX_LEVELS, REMEMBERED
from gffe_cl.stages.holes import FILLINGS
from gffe_cl.stages.sharpening import Sharpening
from gffe_cl.stages.upscaling import Upscaling
from gffe_cl.viewer.engine import names
from gffe_cl.viewer.engine.buffers import Shot, device_layers, moved, pixel_values, read_blocks, source_position
from gffe_cl.viewer.engine.way import Passed, WayPoint, way_of

_MIXED = 2 * constants("background.cl")["SAME_SURFACE"]  # relative depth within which texels of a level are mixed

_CELLS = constants("cells.h")


@dataclass(frozen=True)
class Link:
    """Where a step of a story leads: to `layer`, if it is named, of this slot or of rendered frame `frame`; there to
    display pixel `pixel`, by default the same."""

    label: str
    layer: str = ""
    frame: int | None = None
    pixel: tuple[int, int] | None = None


class Step(str):
    """A sentence of a story, and where it leads."""

    links: tuple[Link, ...]

    def __new__(cls, text: str, *links: Link):
        step = super().__new__(cls, text)
        step.links = links
        return step


@dataclass(frozen=True)
class Story:
    """How a display pixel came about.

    Attributes
    ----------
    pixel : (int, int)
    filled_by : str
        Which stage its colour comes from.
    source : (float, float) or None
        Where the warp's motion points to, in pixels of the rendered image.
    trajectory : tuple of (float, float)
        Display pixels: the known positions P_i … P_1 and P_0 of its fragment as seen at the rendered frame, then where
        it is now.
    dynamic : bool or None
        None where no fragment of the rendered frame is shown.
    residual, threshold : float or None
        Pixels: how far its motion is from that of a static surface, and from where on it is dynamic.
    level : int or None
        Of the background that it was filled from.
    level_px : (float, float) or None
        Where that fragment lies in the rendered image, pixels.
    corrected : bool or None
        Whether shading correction changed its colour; None for rendered frames and where that is off.
    sentences : tuple of str
        Some are a `Step`.
    fragment : (int, int) or None
        Its pixel of the rendered image, where it is a fragment of that.
    way : tuple of WayPoint
        Of that fragment through the last rendered frames, from the present one back.
    """

    pixel: tuple[int, int]
    filled_by: str
    source: tuple[float, float] | None
    trajectory: tuple[tuple[float, float], ...] = ()
    dynamic: bool | None = None
    residual: float | None = None
    threshold: float | None = None
    level: int | None = None
    level_px: tuple[float, float] | None = None
    corrected: bool | None = None
    sentences: tuple[str, ...] = ()
    fragment: tuple[int, int] | None = None
    way: tuple[WayPoint, ...] = ()


def pixel_story(
    pipeline: Pipeline, shot: Shot, x: int, y: int, values: dict[str, np.ndarray] | None = None,
    passed: Iterable[Passed] = (),
) -> Story:  # fmt: skip
    """The story of display pixel (x, y), read from the pipeline's buffers; `values` may bring its `pixel_values`,
    `passed` are the frames submitted last, newest first."""
    story = _story(pipeline, shot, x, y, values)
    if story.fragment is None:
        return story
    own = tuple(c + 0.5 for c in story.fragment)
    return replace(story, way=way_of(pipeline.device.queue, passed, own))


def _story(pipeline: Pipeline, shot: Shot, x: int, y: int, values: dict[str, np.ndarray] | None) -> Story:
    source_px = source_position(pipeline, shot, x, y)
    if not shot.moment.alpha:
        told = _Fragment.at(pipeline, shot, source_px)
        start = f"Rendered frame {shot.moment.k} as it is."
        if Upscaling.name in pipeline.stages:
            start = _gathered(shot, values or pixel_values(pipeline, shot, x, y))
        return (
            told.story((x, y), "rendered frame", source_px, (start,))
            if told
            else Story((x, y), "rendered frame", source_px)
        )
    values = values or pixel_values(pipeline, shot, x, y)
    made = _with_silhouette(_how_it_was_made(pipeline, shot, x, y, source_px, values), values)
    return _with_upscaling(_with_correction(made, pipeline, values), pipeline, values)


def _gathered(shot: Shot, values: dict[str, np.ndarray]) -> str:
    weight, refused = float(values[names.UPSCALED][3]), float(values[names.REJECTED][0]) / 255
    locked = f" It foretold the samples for {int(values[names.LOCK][0])} frames." if values[names.LOCK][0] else ""
    return (
        f"Rendered frame {shot.moment.k}, gathered over time: {weight:.1f} samples; {refused:.0%} of the history was"
        f" refused.{locked}"
    )


def _with_upscaling(story: Story, pipeline: Pipeline, values: dict[str, np.ndarray]) -> Story:
    if Upscaling.name not in pipeline.stages:
        return story
    said = "Upscaling: seen through the history of the rendered frame."
    if values[names.DISOCCLUDED][0]:
        said = "Upscaling: no history here, its own colour is shown."
    if Sharpening.name in pipeline.stages:
        said += " Sharpened."
    return replace(story, sentences=(*story.sentences, said))


def _with_silhouette(story: Story, values: dict[str, np.ndarray]) -> Story:
    coverage = int(values.get(names.COVERAGE, (0,))[0])
    if not coverage:
        return story
    said = f"Soft silhouettes: a nearer surface covers {(coverage - 1) / 254:.0%} of it."
    if coverage == 1:
        said = "Soft silhouettes: the colour of a nearer surface, which was mixed in, is taken out."
    return replace(story, sentences=(*story.sentences, Step(said, Link("coverage", names.COVERAGE))))


def _with_correction(story: Story, pipeline: Pipeline, values: dict[str, np.ndarray]) -> Story:
    if "correction" not in pipeline.stages:
        return story
    before, after = values[names.GAE][:3], values[names.FINAL][:3]
    if before.tobytes() == after.tobytes():
        return replace(story, corrected=False)
    mask = f"focus mask {float(values[names.FOCUS_MASK][0]):.2f}"
    if not pipeline.options.focus_mask:
        mask += ", which is off"
    colors = (f"({', '.join(f'{float(c):.4g}' for c in color)})" for color in (before, after))
    said = f"Shading correction changed it ({mask}): from {' to '.join(colors)}."
    step = Step(said, Link("focus mask", names.FOCUS_MASK), Link("before", names.GAE))
    return replace(story, corrected=True, sentences=(*story.sentences, step))


def _how_it_was_made(pipeline: Pipeline, shot: Shot, x: int, y: int, source_px, values) -> Story:
    number = int(values[names.FILLED_BY][0])
    label, level = _filled_by(number), number - 1 if 1 <= number <= MAX_LEVELS else None
    if number in (BY_HOLE_FILLING, BY_NOTHING):
        return Story((x, y), label, source_px, sentences=_hole_sentences(pipeline, shot, source_px))
    if number == BY_HIDDEN_PART:
        return Story((x, y), label, source_px, sentences=_hidden_sentences(shot, source_px, values))
    if level is not None and values[names.DISOCCLUDED][0]:
        return _background_story(pipeline, shot, (x, y), source_px, level, values)
    landed = (x, y), number == BY_WARP, bool(values[names.DYNAMIC][0])
    told = _Fragment.at(pipeline, shot, source_px, landed)
    where = f"({source_px[0]:.1f}, {source_px[1]:.1f}) of rendered frame {shot.moment.k}" if source_px else "nowhere"
    own = tuple(c + 0.5 for c in told.pixel) if told else source_px
    there, filled = _to_source(shot, own), Link("filled by", names.FILLED_BY)
    start = [Step(f"Shown by its own fragment, from {where}.", *there)]
    if number == BY_CRACK_CLOSING:
        said = f"Crack closing: the fragment from {where} covers this pixel too, none lands in it."
        start = [Step(said, *there, filled)]
    elif level is not None:
        said = f"Its colour is mixed with that of a silhouette there, so it comes from {label}."
        start.append(Step(said, filled, Link(f"level {level}", names.background("color", level))))
    elif number != BY_WARP:
        start = [Step(f"Its colour comes from: {label}.", filled)]
    elif values[names.MIXED][0]:
        said = "Its colour is mixed with that of a silhouette there, so its neighbour's is shown."
        start.append(Step(said, Link("mixed", names.MIXED)))
    if told is None:
        return Story((x, y), label, source_px, sentences=tuple(start))
    return told.story((x, y), label, source_px, tuple(start), level)


def _to_source(shot: Shot, source_px) -> tuple[Link, ...]:
    """To the pixel of the rendered frame that is shown there, if it is within the display."""
    if not source_px:
        return ()
    at = moved(source_px, shot.moment.render_camera, shot.moment.display_camera)
    return (Link(f"frame {shot.moment.k}", names.FINAL, shot.moment.k, tuple(int(np.floor(c)) for c in at)),)


def _filled_by(number: int) -> str:
    return dict(FILLED_BY).get(number, f"unknown ({number})")


@dataclass(frozen=True)
class _Fragment:
    """A fragment of the rendered frame: what history tracking and prediction know of it."""

    trajectory: tuple[tuple[float, float], ...]
    dynamic: bool
    residual: float | None
    threshold: float | None
    sentences: tuple[str, ...]
    pixel: tuple[int, int]

    def story(self, pixel, filled_by, source_px, start, level=None) -> Story:
        known = (self.trajectory, self.dynamic, self.residual, self.threshold)
        said = (*start, *self.sentences)
        return Story(pixel, filled_by, source_px, *known, level, sentences=said, fragment=self.pixel)

    @classmethod
    def at(cls, pipeline: Pipeline, shot: Shot, source_px, landed=None) -> _Fragment | None:
        """The fragment at `source_px`. `landed`: (display pixel, whether it lands in it, whether it is dynamic): then
        the one next to `source_px` that does. None out of the image."""
        layers = device_layers(pipeline, shot)
        at = layers[names.RENDERED_DEPTH].place((0, 0), source_px)
        if at is None:
            return None
        if landed:
            at = _fragment_that_landed(pipeline, layers, at, *landed)
        wanted = (names.RENDERED_DEPTH, names.RENDERED_MOTION, names.DYNAMIC_MASK, names.MET_DEPTH)
        wanted += tuple(name for name in (names.HISTORY, names.TARGET_POSITION) if name in layers)
        values = read_blocks(pipeline, {name: (layers[name], *at, 1, 1) for name in wanted})
        depth, motion, mask, met, *_ = (values[name].reshape(len(values[name]), -1) for name in wanted)
        depth, motion, dynamic = float(depth[0, 0]), motion[0].astype(np.float64), bool(mask[0, 0])
        px = np.add(at, 0.5)
        residual = _residual(shot, px, depth, motion) if pipeline.options.motion else None
        history_stage = pipeline.stages["history"]
        threshold = None if residual is None else float(np.sqrt(history_stage.read("static_threshold_squared")[0]))
        known = _known_places(shot, px + motion, float(met[0, 0]), values.get(names.HISTORY)) if dynamic else []

        path = [_projected(place, shot.moment.display_camera) for place in known[::-1]]
        path.append(moved(px, shot.moment.render_camera, shot.moment.display_camera))
        if (target := values.get(names.TARGET_POSITION)) is not None and target.flat[2] > 0:
            path.append(tuple(map(float, target.flat[:2])))
        used = min(len(known), pipeline.options.order) if shot.moment.alpha else -1
        bend = _bend(pipeline, layers, at, depth) if used == 1 else 0.0
        sentences = _fragment_sentences(pipeline, shot, depth, motion, dynamic, residual, threshold, used, bend)
        at = tuple(map(int, at))
        return cls(tuple(point for point in path if point), dynamic, residual, threshold, sentences, at)


def _bend(pipeline, layers, at, depth: float) -> float:
    """How much of its mover's acceleration counts for the fragment at source pixel `at`, 0 to 1."""
    if names.ACCELERATION not in layers:
        return 0.0
    cell = (layers[name] for name in (names.VELOCITY, names.ACCELERATION))
    where = (at[0] // _CELLS["CELL"], at[1] // _CELLS["CELL"], 1, 1)
    values = read_blocks(pipeline, {layer.spec.name: (layer, *where) for layer in cell})
    mover_depth, trust = (float(array.flat[3]) for array in values.values())
    return max(trust, 0.0) if abs(depth - mover_depth) <= _CELLS["CELL_TOLERANCE"] * mover_depth else 0.0


def _fragment_that_landed(pipeline, layers, at, pixel, inside: bool, dynamic: bool) -> tuple[int, int]:
    """The winner of a display pixel: within a pixel of where its motion points to; `at` if none fits."""
    x0, y0, width, height = _around(at, 1, layers[names.RENDERED_DEPTH].size)
    wanted = (names.TARGET_POSITION, names.DYNAMIC_MASK)
    block = read_blocks(pipeline, {name: (layers[name], x0, y0, width, height) for name in wanted})
    place, mask = (block[name][0].reshape(width * height, -1) for name in wanted)
    fits = (place[:, 2] > 0) & (mask[:, 0] == dynamic)
    if inside:
        fits &= (np.floor(place[:, :2]) == pixel).all(1)
    distance = place[:, 2] if inside else np.hypot(*(place[:, :2] - np.add(pixel, 0.5)).T)
    best = _least(distance, fits)
    return at if best is None else (x0 + best % width, y0 + best // width)


def _residual(shot: Shot, px, depth: float, motion) -> float | None:
    """Pixels between where its motion says that the fragment was and where it was if static; None if not tested."""
    if shot.moment.previous_camera is None or not (0 < depth < np.inf) or not np.isfinite(motion).all():
        return None
    was, z = shot.moment.previous_camera.project(shot.moment.render_camera.unproject(px, depth))
    return float(np.hypot(*(was - px - motion))) if z > 0 else None


def _fragment_sentences(pipeline, shot, depth, motion, dynamic, residual, threshold, used, bend) -> tuple[str, ...]:
    if not depth > 0:
        return (f"Its depth ({depth:g}) is invalid, so nothing of it is splatted.",)
    if depth == np.inf:
        return ("Sky: it turns with the camera.",)
    if not pipeline.options.motion:
        return ("Motion estimation is off: everything counts as static.",)
    if shot.moment.previous_camera is None:
        return ("No frame before this one is known: everything counts as static.",)
    if residual is None:
        why = "its motion is NaN or infinite" if not np.isfinite(motion).all() else "it was behind the camera before"
        return (f"Dynamic: {why}.",)
    kind, than = ("Dynamic", "more than") if dynamic else ("Static", "not more than")
    said: list[str] = [
        Step(
            f"{kind}: its motion is {residual:.2f} px from that of a surface that stands still,"
            f" {than} the threshold of {threshold:.2f} px.",
            Link("dynamic mask", names.DYNAMIC_MASK),
        )
    ]
    if dynamic and used == 0:
        unknown = "No earlier position of it is known (hidden or out of the image then), so it stays where it is."
        said.append(Step(unknown, Link("met depth", names.MET_DEPTH)))
    elif dynamic and used > 0:
        how = "linearly" if used == 1 else f"by a polynomial of order {used}"
        predicted = f"Predicted {how} from its last {used + 1} positions."
        said.append(Step(predicted, Link("target position", names.TARGET_POSITION)))
        if bend > 0:
            bent = f"{bend:.0%} of its acceleration counts too: so much of that there was before."
            said.append(Step(bent, Link("acceleration", names.ACCELERATION)))
    return tuple(said)


def _hidden_sentences(shot: Shot, source_px, values) -> tuple[str, ...]:
    depth, front = float(values[names.DEPTH][0]), None
    if names.RENDERED_DEPTH in values:
        front = float(values[names.RENDERED_DEPTH][0])
    where = f" at ({source_px[0]:.1f}, {source_px[1]:.1f})" if source_px else ""
    shown = "" if front is None else f", which shows depth {front:.4g} there; the depth here is {depth:.4g}"
    return (
        Step(
            "A hidden part of a mover: the mean of the mover around it, with its motion.",
            Link("filled by", names.FILLED_BY),
        ),
        f"Moving like that it was{where} of rendered frame {shot.moment.k}{shown}.",
    )


def _hole_sentences(pipeline: Pipeline, shot: Shot, source_px) -> tuple[str, ...]:
    nothing = f"No fragment of rendered frame {shot.moment.k} lands here, nor one that the background remembers."
    if "background" not in pipeline.stages:
        nothing = f"No fragment of rendered frame {shot.moment.k} lands here, and there is no background."
    nothing = Step(nothing, Link("disoccluded", names.DISOCCLUDED))
    if pipeline.options.hole_filling == "none":
        return nothing, "Hole filling is off: black, at infinite depth."
    filled = f"Hole filling: its colour {FILLINGS[pipeline.options.hole_filling].sentence}."
    said = [nothing, Step(filled, Link("filled by", names.FILLED_BY))]
    if source_px and not all(0 <= c < s for c, s in zip(source_px, pipeline.sizes.source, strict=True)):
        said.append(f"It lies outside the rendered image, at ({source_px[0]:.1f}, {source_px[1]:.1f}).")
    return tuple(said)


def _background_story(pipeline, shot, pixel, source_px, level: int, values) -> Story:
    depth = float(values[names.DEPTH][0])
    at = _remembered(pipeline, shot, pixel, source_px, level, depth)
    lies = f", last at ({at[0]:.1f}, {at[1]:.1f}) of the rendered image" if at else ""
    links = Link(f"level {level}", names.background("color", level)), Link("filled by", names.FILLED_BY)
    said = [Step(f"Filled from background level {level}: a static surface hidden now{lies}.", *links)]
    if names.RENDERED_DEPTH in values:
        front = float(values[names.RENDERED_DEPTH][0])
        hides = f"At that place rendered frame {shot.moment.k} shows depth {front:.4g}; the depth here is {depth:.4g}."
        said.append(Step(hides, *_to_source(shot, source_px)))
    if getattr(pipeline.stages.get("holes"), "mixes", False):
        said.append(
            "Its colour is mixed with that of the surface beside the hole, the nearer and the more uniform the more."
        )
    now = (pixel[0] + 0.5, pixel[1] + 0.5)
    path = (moved(at, shot.moment.render_camera, shot.moment.display_camera), now) if at else (now,)
    return Story(pixel, _filled_by(1 + level), source_px, path, level=level, level_px=at, sentences=tuple(said))


def _remembered(pipeline, shot, pixel, source_px, level: int, depth: float) -> tuple[float, float] | None:
    """Where the remembered fragment lies that is shown at `pixel`, at `depth` there: pixels of the rendered image."""
    layers = [device_layers(pipeline, shot)[names.background(name, level)] for name in ("state", "depth", "px")]
    at = source_px and layers[0].place(pixel, source_px)
    if not at:
        return None
    x0, y0, width, height = _around(at, 2, layers[0].size)
    block = read_blocks(pipeline, {layer.spec.name: (layer, x0, y0, width, height) for layer in layers})
    state, z, px = (values[0].reshape(width * height, -1) for values in block.values())
    fits = state[:, 0] == REMEMBERED
    if np.isfinite(depth):
        world = shot.moment.camera.unproject(np.add(pixel, 0.5), depth)
        expected = float(shot.moment.render_camera.project(world)[1])
        fits &= np.abs(z[:, 0] - expected) <= _MIXED * expected
    else:
        fits &= np.isinf(z[:, 0])
    best = _least(np.hypot(*(px.astype(np.float64) - source_px).T), fits)
    return None if best is None else tuple(map(float, px[best]))


def _least(values: np.ndarray, fits: np.ndarray) -> int | None:
    """Index of the least of `values` (N,), infinite ones too, where `fits` (N,)."""
    candidates = np.flatnonzero(fits)
    return int(candidates[np.argmin(values[candidates])]) if candidates.size else None


def _around(at, reach: int, size) -> tuple[int, int, int, int]:
    """x, y, width, height of the block up to `reach` around `at`, within an image of `size`."""
    low = [max(c - reach, 0) for c in at]
    return (*low, *(min(c + reach + 1, s) - first for c, s, first in zip(at, size, low, strict=True)))


def _known_places(shot: Shot, px_prev, met_depth: float, history) -> list[np.ndarray]:
    """P_1 … as far as they are known, in the view space of the rendered camera. `history`: what is stored, if it is."""
    if shot.moment.previous_camera is None or not met_depth > 0:
        return []
    world = shot.moment.previous_camera.unproject(px_prev, met_depth)
    older = [] if history is None else history.reshape(-1, 4)[1:]
    matrix = shot.moment.render_camera.world_to_view
    return [matrix[:3, :3] @ world + matrix[:3, 3], *(place[:3] for place in older if place[3] != 0)]


def _projected(view_pos, camera: Camera) -> tuple[float, float] | None:
    """Display pixels of a position in view space; None behind the camera."""
    x, y, z = map(float, view_pos)
    return (camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy) if z > 0 else None
