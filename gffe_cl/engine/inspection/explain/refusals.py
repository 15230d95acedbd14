"""Why stages refused a pixel that is left to hole filling, and which pixels that and the movers' stages took.

Kernels of kernels/stories/ run the stages' own functions for one pixel of the slot, and tell what these decide by."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pyopencl as cl

from gffe_cl.engine.inspection import names
from gffe_cl.engine.inspection.buffers import Shot, around, device_layers, least, read_blocks, told
from gffe_cl.engine.inspection.explain.pixel_explain_types import Claim, Link
from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.options import MAX_LEVELS
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.background import REMEMBERED

_MOVERS, _HOLES = constants("stories/hidden_parts.cl"), constants("stories/holes.cl")
_DIRECTIONS = ((1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1))
_BESIDE = 2  # texels around a place in which the background is looked at


def _index(pipeline: Pipeline, pixel: tuple[int, int]) -> int:
    return pixel[1] * pipeline.sizes.target[0] + pixel[0]


def why_no_mover(pipeline: Pipeline, shot: Shot, pixel: tuple[int, int]) -> Claim | None:
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
        why += f" But it is {away:.1f} px away; movers own holes within {stage.reach / _MOVERS['BESIDE']:.1f} px."
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


def why_no_background(pipeline: Pipeline, shot: Shot, pixel: tuple[int, int], source_px) -> Claim | None:
    """Return what the background remembers where the pixel would be, which does not land in it; None without it."""
    if source_px is None:
        return None
    layers, said, empty, links = device_layers(pipeline, shot), [], [], []
    for level in range(MAX_LEVELS):
        named = [names.background(name, level) for name in ("state", "depth", "px")]
        if not all(name in layers for name in named):
            continue
        at = layers[named[0]].place(pixel, source_px)
        if at is None:
            return Claim(
                f"The background left it: its place ({source_px[0]:.1f}, {source_px[1]:.1f}) is outside of the rendered"
                " image."
            )
        x, y, width, height = around(at, _BESIDE, layers[named[0]].size)
        block = read_blocks(pipeline, {name: (layers[name], x, y, width, height) for name in named})
        state, depth, px = (values[0].reshape(width * height, -1) for values in block.values())
        remembered = state[:, 0].astype(np.uint8) == REMEMBERED
        best = least(np.hypot(*(px.astype(np.float64) - source_px).T), remembered)
        if best is None:
            empty.append(level)
            continue
        where = f"depth {float(depth[best][0]):.4g}, last at ({px[best][0]:.1f}, {px[best][1]:.1f})"
        said.append(f"level {level} remembers {int(remembered.sum())}, the nearest with {where}, and none lands here")
        links.append(Link(f"level {level}", names.background("color", level)))
    if empty:
        said.append(f"nothing is remembered in level {', '.join(map(str, empty))}")
    if not said:
        return None
    around_it = f"around ({source_px[0]:.1f}, {source_px[1]:.1f})"
    return Claim(f"The background left it: {around_it} {'; '.join(said)}.", *links)


def what_was_taken(
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


def where_it_reappears_from(
    pipeline: Pipeline, shot: Shot, pixel: tuple[int, int], source_px: tuple[float, float] | None
) -> Claim | None:
    """Return where the frame before showed a part of a mover that reappears. It is at `source_px` of the rendered
    image, behind what hides it, and moves as the mover beside that does."""
    if source_px is None:
        return None
    index, width = _offered(pipeline, _index(pipeline, pixel)), pipeline.sizes.source[0]
    if index is None:
        return None
    mover, layers = (index % width, index // width), device_layers(pipeline, shot)
    wanted = {name: (layers[name], *mover, 1, 1) for name in (names.RENDERED_MOTION, names.MET_DEPTH)}
    motion, depth = (values.ravel() for values in read_blocks(pipeline, wanted).values())
    x, y, before = source_px[0] + float(motion[0]), source_px[1] + float(motion[1]), shot.moment.k - 1
    said = (
        f"It moves as the mover beside it, at {mover} of rendered frame {shot.moment.k}, does. So its color is that of"
        f" frame {before} at ({x:.1f}, {y:.1f}), at the mover's depth {float(depth[0]):.4g}."
    )
    return Claim(said, Link(f"frame {before}", names.FINAL, before, (math.floor(x), math.floor(y))))


def _offered(pipeline: Pipeline, index: int) -> int | None:
    """Return the pixel of the rendered frame whose mover is offered to a pixel of the new one, from the kernel that
    offers parts which reappear; None without any. The nearest of those that are offered if nothing is shown is the
    nearest of those before what is shown, too."""
    stage, device = pipeline.stages["hidden_parts"], pipeline.device
    pixels = pipeline.sizes.target[0] * pipeline.sizes.target[1]

    def scratch(value: Any, count: int = pixels) -> cl.Buffer:
        made = cl.Buffer(device.context, cl.mem_flags.READ_WRITE, count * value.nbytes)
        cl.enqueue_fill_buffer(device.queue, made, value, 0, made.size)
        return made

    key = np.uint64(2**64 - 1) if len(stage.passes) == 1 else np.uint32(2**32 - 1)
    given = {
        "keys": scratch(key),
        "winners": scratch(np.uint32(2**32 - 1)),
        "offered": scratch(np.uint32(0), pixels + 1),
        "filled_by": scratch(np.uint8(0)),
        "shown_depth": scratch(np.float32(np.inf)),
    }
    kernel = next(one for one in stage.kernels if one.name == "offer_reappearing")
    count = pipeline.sizes.source[0] * pipeline.sizes.source[1]
    group = stage.program.constants["SCAN_GROUP"]
    items = -(-count // (group * stage.program.constants["SCAN_BYTES"])) * group
    for each in stage.passes:
        values = stage.values(kernel, "new", {**given, "pass": each})
        stage.program.launch(device.queue, kernel.name, (items,), (group,), values)
    found = np.empty(1, np.uint32)
    lower = given["keys"] if len(stage.passes) == 1 else given["winners"]
    cl.enqueue_copy(device.queue, found, lower, src_offset=index * (8 if len(stage.passes) == 1 else 4))
    return int(found[0]) if found[0] != 2**32 - 1 else None
