"""Story of a pixel: the stages that made it, from the buffers of its slot."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from gffe_cl.engine.inspection import names
from gffe_cl.engine.inspection.buffers import (
    PixelValues,
    Shot,
    around,
    device_layers,
    least,
    moved,
    pixel_values,
    read_blocks,
    source_position,
)
from gffe_cl.engine.inspection.explain.fragment_history import Fragment
from gffe_cl.engine.inspection.explain.motion_trail import Passed, way_of
from gffe_cl.engine.inspection.explain.pixel_explain_types import Claim, Link, Story
from gffe_cl.engine.inspection.explain.refusals import (
    what_was_taken,
    where_it_reappears_from,
    why_no_background,
    why_no_mover,
)
from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.options import HOLE_FILLINGS, MAX_LEVELS
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.background import REMEMBERED
from gffe_cl.engine.stages.buffers import (
    BY_CRACK_CLOSING,
    BY_HIDDEN_PART,
    BY_HOLE_FILLING,
    BY_NOTHING,
    BY_REAPPEARING,
    BY_WARP,
    FILLED_BY,
)
from gffe_cl.engine.stages.measures import Sharpness

_MIXED = 2 * constants("background.cl")["SAME_LEVEL"]  # relative depth within which texels of a level are mixed


def pixel_story(
    pipeline: Pipeline,
    shot: Shot,
    x: int,
    y: int,
    values: PixelValues | None = None,
    passed: Iterable[Passed] = (),
    fault: str = "",
) -> Story:
    """Return the story of display pixel (x, y), read from the pipeline's buffers; `values` may bring its
    `pixel_values`, `passed` are the frames submitted last, newest first. `fault`: what is wrong with its pixel of the
    rendered image."""
    values = values or pixel_values(pipeline, shot, x, y)
    story = _story(pipeline, shot, x, y, values.of_content)
    if fault:
        said = f"Invalid in the input: {fault}."
        start = [sentence for sentence in story.sentences if sentence != _as_it_is(shot)]
        story = replace(story, sentences=(Claim(said, *_to_source(shot, story.source)), *start))
    if story.fragment is None:
        return story
    own = story.fragment[0] + 0.5, story.fragment[1] + 0.5
    return replace(story, way=way_of(pipeline.device.queue, passed, own))


def _story(pipeline: Pipeline, shot: Shot, x: int, y: int, values: dict[str, np.ndarray]) -> Story:
    source_px = source_position(pipeline, shot, x, y)
    told_by_stages = (stage.told(values, not shot.moment.alpha) for stage in pipeline.stages.values())
    said = tuple(filter(None, told_by_stages))
    if not shot.moment.alpha:
        told = Fragment.at(pipeline, shot, source_px)
        return (
            told.story((x, y), "rendered frame", source_px, said or (_as_it_is(shot),))
            if told
            else Story((x, y), "rendered frame", source_px)
        )
    made = _with_sharpness(_how_it_was_made(pipeline, shot, x, y, source_px, values), pipeline, values)
    made = _with_silhouette(made, values)
    made = _with_correction(made, pipeline, values)
    return replace(made, sentences=(*made.sentences, *said))


def _as_it_is(shot: Shot) -> str:
    return f"Rendered frame {shot.moment.k} as it is."


def _with_sharpness(story: Story, pipeline: Pipeline, values: dict[str, np.ndarray]) -> Story:
    """Return the story with the sharpness measured for its pixel, if that is resampled and not copied."""
    number, px = int(values[names.FILLED_BY][0]), story.source
    if Sharpness.name not in pipeline.stages or not px or all(abs(c % 1 - 0.5) < 0.01 for c in px):
        return story
    if pipeline.options.warps_footprints and number not in (BY_WARP, BY_CRACK_CLOSING):
        return story
    measured = float(pipeline.stages[Sharpness.name].read("sharpness").item())
    said = f"Interpolated between pixels: a sharpness of {measured:.2f} was measured on rendered frames."
    return replace(story, sentences=(*story.sentences, said))


def _with_silhouette(story: Story, values: dict[str, np.ndarray]) -> Story:
    coverage = int(values.get(names.COVERAGE, (0,))[0])
    if not coverage:
        return story
    by_others = int(values[names.FILLED_BY][0]) not in (BY_WARP, BY_CRACK_CLOSING)
    said = f"Soft silhouettes: a nearer surface covers {(coverage - 1) / 254:.0%} of it."
    if coverage == 1:
        said = "Soft silhouettes: the color of a nearer surface, which was mixed in, is taken out."
    if by_others:
        said += f" The rest is what was filled in before: {story.filled_by}."
    return replace(story, sentences=(*story.sentences, Claim(said, Link("coverage", names.COVERAGE))))


def _with_correction(story: Story, pipeline: Pipeline, values: dict[str, np.ndarray]) -> Story:
    if "correction" not in pipeline.stages:
        return story
    before, after = values[names.GAE][:3], values[names.FINAL][:3]
    if before.tobytes() == after.tobytes():
        return replace(story, corrected=False)
    mask = f"focus mask {float(values[names.FOCUS_MASK][0]):.2f}"
    if not pipeline.options.focus_mask:
        mask += ", which is off"
    if pipeline.options.image_flow and values[names.FOLLOWED][0]:
        mask += "; half of it from along the flow of the image"
    colors = (f"({', '.join(f'{float(c):.4g}' for c in color)})" for color in (before, after))
    said = f"Shading correction changed it ({mask}): from {' to '.join(colors)}."
    step = Claim(said, Link("focus mask", names.FOCUS_MASK), Link("before", names.GAE))
    return replace(story, corrected=True, sentences=(*story.sentences, step))


def _how_it_was_made(pipeline: Pipeline, shot: Shot, x: int, y: int, source_px, values) -> Story:
    number = int(values[names.FILLED_BY][0])
    label, level = _filled_by(number), number - 1 if 1 <= number <= MAX_LEVELS else None
    if not pipeline.options.warps_footprints:
        return Story((x, y), label, source_px, sentences=_dilated_sentences(shot, source_px, number == BY_WARP))
    if number in (BY_HOLE_FILLING, BY_NOTHING):
        return Story((x, y), label, source_px, sentences=_hole_sentences(pipeline, shot, (x, y), source_px, values))
    if number in (BY_HIDDEN_PART, BY_REAPPEARING):
        said = _hidden_sentences(pipeline, shot, (x, y), source_px, values, number)
        return Story((x, y), label, source_px, sentences=said)
    if level is not None:
        return _background_story(pipeline, shot, (x, y), source_px, level, values)
    landed = (x, y), number == BY_WARP, bool(values[names.DYNAMIC][0])
    told = Fragment.at(pipeline, shot, source_px, landed)
    where = f"({source_px[0]:.1f}, {source_px[1]:.1f}) of rendered frame {shot.moment.k}" if source_px else "nowhere"
    own = tuple(c + 0.5 for c in told.pixel) if told else source_px
    there, filled = _to_source(shot, own), Link("filled by", names.FILLED_BY)
    start = [Claim(f"Shown by its own fragment, from {where}.", *there)]
    if number == BY_CRACK_CLOSING:
        said = f"Crack closing: the fragment from {where} covers this pixel too, none lands in it."
        start = [Claim(said, *there, filled)]
    elif number != BY_WARP:
        start = [Claim(f"Its color comes from: {label}.", filled)]
    if told is None:
        return Story((x, y), label, source_px, sentences=tuple(start))
    return told.story((x, y), label, source_px, tuple(start))


def _to_source(shot: Shot, source_px) -> tuple[Link, ...]:
    """Return a link to the pixel of the rendered frame that is shown there; no link if the position is not known."""
    if not source_px:
        return ()
    at = moved(source_px, shot.moment.render_camera, shot.moment.display_camera)
    return (Link(f"frame {shot.moment.k}", names.FINAL, shot.moment.k, (int(np.floor(at[0])), int(np.floor(at[1])))),)


def _filled_by(number: int) -> str:
    return dict(FILLED_BY).get(number, f"unknown ({number})")


def _dilated_sentences(shot: Shot, source_px, reached: bool) -> tuple[Claim, ...]:
    where = f"({source_px[0]:.1f}, {source_px[1]:.1f}) of rendered frame {shot.moment.k}" if source_px else "nowhere"
    there = _to_source(shot, source_px)
    if reached:
        return (Claim(f"It comes from {where}, with the motion of the nearest of 3×3 pixels there.", *there),)
    said = "No fragment of that frame lands here: it moves as the nearest surface beside it, or a mover that has left."
    return Claim(f"It comes from {where}.", *there), Claim(said, Link("filled by", names.FILLED_BY))


def _hidden_sentences(pipeline: Pipeline, shot: Shot, pixel, source_px, values, number: int) -> tuple[str, ...]:
    depth, front = float(values[names.DEPTH][0]), None
    if names.RENDERED_DEPTH in values:
        front = float(values[names.RENDERED_DEPTH][0])
    elif source_px:
        return _entering_sentences(shot, source_px, pipeline.sizes.source)
    said = "A hidden part of a mover: the mean of the mover around it, with its motion."
    if number == BY_REAPPEARING:
        said = "A part of a mover that comes out: the color it had in the frame before, with the mover's motion."
    where = f" at ({source_px[0]:.1f}, {source_px[1]:.1f})" if source_px else ""
    shown = "" if front is None else f", which shows depth {front:.4g} there; the depth here is {depth:.4g}"
    told: list[str | Claim | None] = [
        Claim(said, Link("filled by", names.FILLED_BY)),
        f"Moving like that it was{where} of rendered frame {shot.moment.k}{shown}.",
    ]
    if number == BY_REAPPEARING:
        told.append(where_it_reappears_from(pipeline, shot, pixel, source_px))
    return tuple(filter(None, told))


def _entering_sentences(shot: Shot, source_px, size: tuple[int, int]) -> tuple[str, ...]:
    frame = f"rendered frame {shot.moment.k}"
    x, y = (int(min(max(at, 0), side - 1)) for at, side in zip(source_px, size, strict=True))
    return (
        Claim(
            f"A part of a mover that enters: no frame has shown it, so it repeats ({x}, {y}) at the border of {frame},"
            " with the motion of the mover there.",
            Link("filled by", names.FILLED_BY),
            *_to_source(shot, (x + 0.5, y + 0.5)),
        ),
        f"Moving like that it was at ({source_px[0]:.1f}, {source_px[1]:.1f}), outside of {frame}.",
    )


def _hole_sentences(pipeline: Pipeline, shot: Shot, pixel: tuple[int, int], source_px, values) -> tuple[str, ...]:
    nothing = f"No fragment of rendered frame {shot.moment.k} lands here, nor one that the background remembers."
    if "background" not in pipeline.stages:
        nothing = f"No fragment of rendered frame {shot.moment.k} lands here, and there is no background."
    refused = [why_no_mover(pipeline, shot, pixel), why_no_background(pipeline, shot, pixel, source_px)]
    said: list[str | Claim | None] = [Claim(nothing, Link("disoccluded", names.DISOCCLUDED))]
    if pipeline.options.hole_filling == "none":
        said += ["Hole filling is off: black, at infinite depth.", *refused]
        return tuple(filter(None, said))
    filled = f"Hole filling: its color {HOLE_FILLINGS[pipeline.options.hole_filling]}."
    said += [
        Claim(filled, Link("filled by", names.FILLED_BY)),
        what_was_taken(pipeline, shot, pixel, values),
        *refused,
    ]
    if source_px and not all(0 <= c < s for c, s in zip(source_px, pipeline.sizes.source, strict=True)):
        outside = f"It lies outside the rendered image, at ({source_px[0]:.1f}, {source_px[1]:.1f})"
        if pipeline.options.hole_filling == "far-side":
            said.append(f"{outside}: its color is that of the closest place on the border.")
        else:
            said.append(f"{outside}.")
    return tuple(filter(None, said))


def _background_story(pipeline, shot, pixel, source_px, level: int, values) -> Story:
    depth = float(values[names.DEPTH][0])
    at = _remembered(pipeline, shot, pixel, source_px, level, depth)
    lies = f", last at ({at[0]:.1f}, {at[1]:.1f}) of the rendered image" if at else ""
    links = Link(f"level {level}", names.background("color", level)), Link("filled by", names.FILLED_BY)
    said: list[str | Claim] = [
        Claim(f"Filled from background level {level}: a static surface hidden now{lies}.", *links)
    ]
    if names.RENDERED_DEPTH in values:
        front = float(values[names.RENDERED_DEPTH][0])
        hides = f"At that place rendered frame {shot.moment.k} shows depth {front:.4g}; the depth here is {depth:.4g}."
        said.append(Claim(hides, *_to_source(shot, source_px)))
    if pipeline.options.hole_filling == "far-side":
        said.append("Its color is mixed with that of the surface beside the hole, which counts more the nearer it is.")
    now = (pixel[0] + 0.5, pixel[1] + 0.5)
    path = (moved(at, shot.moment.render_camera, shot.moment.display_camera), now) if at else (now,)
    return Story(pixel, _filled_by(1 + level), source_px, path, level=level, level_px=at, sentences=tuple(said))


def _remembered(pipeline, shot, pixel, source_px, level: int, depth: float) -> tuple[float, float] | None:
    """Return the position in the rendered image, in pixels, of the remembered fragment that is shown at `pixel`, at
    `depth` there; None if it is not found."""
    layers = [device_layers(pipeline, shot)[names.background(name, level)] for name in ("state", "depth", "px")]
    at = source_px and layers[0].place(pixel, source_px)
    if not at:
        return None
    x0, y0, width, height = around(at, 2, layers[0].size)
    block = read_blocks(pipeline, {layer.spec.name: (layer, x0, y0, width, height) for layer in layers})
    state, z, px = (values[0].reshape(width * height, -1) for values in block.values())
    fits = state[:, 0].astype(np.uint8) == REMEMBERED
    if np.isfinite(depth):
        world = shot.moment.camera.unproject(np.add(pixel, 0.5), depth)
        expected = float(shot.moment.render_camera.project(world)[1])
        fits &= np.abs(z[:, 0] - expected) <= _MIXED * expected
    else:
        fits &= np.isinf(z[:, 0])
    best = least(np.hypot(*(px.astype(np.float64) - source_px).T), fits)
    return None if best is None else (float(px[best][0]), float(px[best][1]))
