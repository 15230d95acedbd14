"""Story of a pixel: the stages that made it, from the buffers of its slot.

Kernels of kernels/stories/ run the stages' own functions for one pixel of the slot, and tell what these decide by."""

from __future__ import annotations

import math
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
    told,
)
from gffe_cl.engine.inspection.explain.fragment_history import Fragment
from gffe_cl.engine.inspection.explain.motion_trail import Passed, way_of
from gffe_cl.engine.inspection.explain.pixel_explain_types import Claim, Link, Story
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

_MOVERS, _HOLES = constants("stories/hidden_parts.cl"), constants("stories/holes.cl")
_DIRECTIONS = ((1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1))
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
        fragment = Fragment.at(pipeline, shot, source_px)
        return (
            fragment.story((x, y), "rendered frame", source_px, said or (_as_it_is(shot),))
            if fragment
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
    if not pipeline.options.sharpness or not px or all(abs(c % 1 - 0.5) < 0.01 for c in px):
        return story
    if pipeline.options.warps_footprints and number not in (BY_WARP, BY_CRACK_CLOSING):
        return story
    measured = float(pipeline.stages["history"].read("sharpness").item())
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
        said = _hidden_sentences(pipeline, shot, source_px, values, number)
        return Story((x, y), label, source_px, sentences=said)
    if level is not None:
        return _background_story(pipeline, shot, (x, y), source_px, level, values)
    landed = (x, y), number == BY_WARP, bool(values[names.DYNAMIC][0])
    fragment = Fragment.at(pipeline, shot, source_px, landed)
    where = f"({source_px[0]:.1f}, {source_px[1]:.1f}) of rendered frame {shot.moment.k}" if source_px else "nowhere"
    own = tuple(c + 0.5 for c in fragment.pixel) if fragment else source_px
    there, filled = _to_source(shot, own), Link("filled by", names.FILLED_BY)
    start = [Claim(f"Shown by its own fragment, from {where}.", *there)]
    if number == BY_CRACK_CLOSING:
        said = f"Crack closing: the fragment from {where} covers this pixel too, none lands in it."
        start = [Claim(said, *there, filled)]
    elif number != BY_WARP:
        start = [Claim(f"Its color comes from: {label}.", filled)]
    if fragment is None:
        return Story((x, y), label, source_px, sentences=tuple(start))
    return fragment.story((x, y), label, source_px, tuple(start))


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


def _hidden_sentences(pipeline: Pipeline, shot: Shot, source_px, values, number: int) -> tuple[str, ...]:
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
    was = f"Moving like that it was{where} of rendered frame {shot.moment.k}{shown}."
    return Claim(said, Link("filled by", names.FILLED_BY)), was


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
    refused = _why_no_mover(pipeline, shot, pixel)
    said: list[str | Claim | None] = [Claim(nothing, Link("disoccluded", names.DISOCCLUDED))]
    if pipeline.options.hole_filling == "none":
        said += ["Hole filling is off: black, at infinite depth.", refused]
        return tuple(filter(None, said))
    filled = f"Hole filling: its color {HOLE_FILLINGS[pipeline.options.hole_filling]}."
    said += [
        Claim(filled, Link("filled by", names.FILLED_BY)),
        _what_was_taken(pipeline, shot, pixel, values),
        refused,
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


# ---- what kernels tell of a pixel that is left to hole filling ------------------------------------------


def _index(pipeline: Pipeline, pixel: tuple[int, int]) -> int:
    return pixel[1] * pipeline.sizes.target[0] + pixel[0]


def _why_no_mover(pipeline: Pipeline, shot: Shot, pixel: tuple[int, int]) -> Claim | None:
    """Return why hidden parts of movers left the pixel; None where that stage does not run."""
    stage = pipeline.stages.get("hidden_parts")
    if stage is None:
        return None
    ways, count = len(_DIRECTIONS), _MOVERS["TOLD_OF_MOVER"]
    hole = _index(pipeline, pixel)
    given = told(pipeline, "hidden_parts", "fill_hidden_parts", "new", ways * count, hole=hole)
    found = [
        (steps * math.hypot(*way), [at + int(steps) * d for at, d in zip(pixel, way, strict=True)], one)
        for way, one in zip(_DIRECTIONS, given.reshape(ways, count).tolist(), strict=True)
        if (steps := one[_MOVERS["STEPS"]])
    ]
    if not found:
        return Claim(
            f"Hidden parts of movers left it: nothing moves within {stage.reach} px, in eight directions.",
            Link("dynamic", names.DYNAMIC),
        )
    away, (x, y), one = min(found, key=lambda mover: mover[0])
    why = _why_refused(shot, one)
    if one[_MOVERS["REFUSED_BY"]] == _MOVERS["NOT_REFUSED"]:
        why += (
            f" But it is {away:.1f} px away; movers own holes within {stage.reach / _MOVERS['BESIDE']:.1f} px, farther"
            " ones if they are broad and far behind what hides them."
        )
    return Claim(
        f"Hidden parts of movers left it: if it moved as ({x}, {y}) does, the nearest mover, {why}",
        Link("that mover", names.DYNAMIC, pixel=(x, y)),
    )


def _why_refused(shot: Shot, given: list[float]) -> str:
    """Return why a mover has no part in a hole, by what the kernel tells of it."""

    def of(name: str) -> float:
        return given[_MOVERS[name]]

    by = of("REFUSED_BY")
    if by == _MOVERS["SURFACE_BETWEEN"]:
        between, mover = of("BETWEEN_Z"), of("MOVER_Z")
        return f"a surface between them at depth {between:.4g} does not stand before the mover at {mover:.4g}."
    was = f"it would have been at ({of('PLACE_X'):.1f}, {of('PLACE_Y'):.1f}) of rendered frame {shot.moment.k}"
    if by == _MOVERS["OUT_OF_FRAME"]:
        return f"{was}, which is outside of it."
    shown, expected = of("SHOWN_Z"), of("PART_Z")
    if by == _MOVERS["NOT_HIDDEN"]:
        return f"{was}. That shows depth {shown:.4g} there, which does not hide the mover at {expected:.4g}."
    was += f", behind depth {shown:.4g}."
    if by == _MOVERS["SEEN_THROUGH"]:
        before = f"depth {of('PREV_Z'):.4g} at ({of('PREV_X'):.1f}, {of('PREV_Y'):.1f})"
        was += f" But the frame before shows {before}, which is farther than the mover at {of('PART_PREV_Z'):.4g}."
    return was


def _what_was_taken(
    pipeline: Pipeline, shot: Shot, pixel: tuple[int, int], values: dict[str, np.ndarray]
) -> Claim | None:
    """Return which pixels the hole filling "far-side" took the color from; None for other ways."""
    if not getattr(pipeline.stages.get("holes"), "reach", 0):
        return None
    ways, count, hole = len(_DIRECTIONS), _HOLES["TOLD_OF_SIDE"], _index(pipeline, pixel)
    given = told(pipeline, "holes", "fill_far_side", "new", ways * count + 1, hole=hole)
    *sides, is_out = np.split(given, range(count, ways * count + 1, count))
    met = [side for side in sides if side[_HOLES["MEETS"]]]
    color = f"The result is ({', '.join(f'{float(c):.3g}' for c in values[names.FINAL][:3])})."
    if not met:
        return Claim(f"No direction meets a pixel beside the hole, so it took that of the rendered frame. {color}")
    used = [side for side in met if side[_HOLES["TAKEN"]]]
    listed = ", ".join(_listed(pipeline, shot, side) for side in used)
    links = [Link(f"({x}, {y})", names.FINAL, pixel=(x, y)) for x, y in (_pixel(pipeline, side) for side in used)]
    if is_out[0]:
        said = f"It took depth from {listed}, which lie outside of the rendered image here, and color from its border,"
        said += " or beside the hole where a mover stands there."
    else:
        kind = "can be behind" if any(side[_HOLES["CAN_BE_THERE"]] for side in met) else "are the farthest"
        said = f"Of {len(met)} pixels beside the hole it took the mean of those that {kind}: {listed}."
    return Claim(f"{said} {color}", *links)


def _pixel(pipeline: Pipeline, side: np.ndarray, of: str = "AT") -> tuple[int, int]:
    index, width = int(side[_HOLES[of]]) - (of == "PAST"), pipeline.sizes.target[0]
    return index % width, index // width


def _listed(pipeline: Pipeline, shot: Shot, side: np.ndarray) -> str:
    layers = device_layers(pipeline, shot)

    def at(name: str, pixel: tuple[int, int]) -> float:
        return float(read_blocks(pipeline, {name: (layers[name], *pixel, 1, 1)})[name].flat[0])

    x, y = _pixel(pipeline, side)
    said = f"({x}, {y}) at depth {at(names.DEPTH, (x, y)):.4g}"
    if side[_HOLES["ENDS"]]:
        inverse = float(side[_HOLES["INVERSE"]])
        return f"{said}, which ends there, before depth {1 / inverse if inverse else math.inf:.4g}"
    if not side[_HOLES["PAST"]]:
        return said
    past = _pixel(pipeline, side, "PAST")
    what = "a mover" if at(names.DYNAMIC, past) else "a bar"
    return f"{said} past {what} in front at depth {at(names.DEPTH, past):.4g}"
