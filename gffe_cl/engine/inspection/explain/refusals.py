"""Why stages refused a pixel that is left to hole filling, and which pixels that and the movers' stages took, from the
slot's buffers."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from gffe_cl.engine.inspection import names
from gffe_cl.engine.inspection.buffers import DeviceLayer, Shot, device_layers, read_blocks
from gffe_cl.engine.inspection.explain.fragment_history import around, least
from gffe_cl.engine.inspection.explain.pixel_explain_types import Link, Step
from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.options import MAX_LEVELS
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.background import REMEMBERED
from gffe_cl.engine.stages.buffers import BY_HIDDEN_PART, BY_HOLE_FILLING, BY_REAPPEARING
from gffe_cl.engine.stages.history import DYNAMIC

_MOVERS, _HOLES = constants("hidden_parts.cl"), constants("holes.cl")
_DIRECTIONS = ((1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1))
_BESIDE = 2  # texels around a place in which the background is looked at


class _Block:
    """Layers of one grid around a pixel of it, `reach` px each way."""

    def __init__(self, pipeline: Pipeline, shot: Shot, pixel: tuple[int, int], reach: int, wanted: tuple[str, ...]):
        layers = device_layers(pipeline, shot)
        self.x, self.y, self.width, self.height = around(pixel, reach, layers[wanted[0]].size)
        block = self.x, self.y, self.width, self.height
        read = read_blocks(pipeline, {name: (layers[name], *block) for name in wanted})
        self._values = {name: values[0] for name, values in read.items()}
        self.pixel, self.reach = pixel, reach

    def at(self, name: str, x: int, y: int) -> np.ndarray:
        """Return the values (channels,) of a pixel within the block."""
        return self._values[name][y - self.y, x - self.x]

    def first(self, direction: tuple[int, int], wanted, start: int = 1, most: int | None = None) -> tuple | None:
        """Return the first pixel in a direction, within reach, for which `wanted(x, y)` is true. At most `most` pixels
        are looked at, from step `start` on."""
        (x, y), last = self.pixel, int(self.reach / math.hypot(*direction))
        for t in range(start, min(last, last if most is None else start + most - 1) + 1):
            at = x + t * direction[0], y + t * direction[1]
            if not (self.x <= at[0] < self.x + self.width and self.y <= at[1] < self.y + self.height):
                return None
            if wanted(*at):
                return at
        return None


def why_no_mover(pipeline: Pipeline, shot: Shot, pixel: tuple[int, int]) -> Step | None:
    """Return why hidden parts of movers left the pixel; None where that stage does not run."""
    if "hidden_parts" not in pipeline.stages:
        return None
    reach = max(_MOVERS["MOVER_REACH"], pipeline.sizes.target[0] // _MOVERS["MOVER_REACH_SHARE"])
    wanted = (names.DYNAMIC, names.DEPTH, names.MOTION, names.DISOCCLUDED)
    block = _Block(pipeline, shot, pixel, reach, wanted)
    met = (block.first(direction, lambda x, y: bool(block.at(names.DYNAMIC, x, y)[0])) for direction in _DIRECTIONS)
    found = {way: at for way, at in zip(_DIRECTIONS, met, strict=True) if at is not None}
    if not found:
        return Step(
            f"Hidden parts of movers left it: nothing moves within {reach} px, in eight directions.",
            Link("dynamic", names.DYNAMIC),
        )
    way = min(found, key=lambda way: math.dist(found[way], pixel))
    x, y = found[way]
    hidden, why = _was_hidden(pipeline, shot, block, x, y)
    if hidden:
        away, most = math.dist((x, y), pixel), reach / _MOVERS["BESIDE"]
        why += f" But it is {away:.1f} px away; movers own holes within {most:.1f} px."
    return Step(
        f"Hidden parts of movers left it: if it moved as ({x}, {y}) does, the nearest mover, {why}",
        Link("that mover", names.DYNAMIC, pixel=(x, y)),
    )


def _moves_along(shot: Shot, block: _Block, x: int, y: int) -> tuple[float, float]:
    """Return where the pixel of `block` was in the rendered image if it moves as the mover at (x, y) does."""
    camera, rendered, motion = shot.moment.camera, shot.moment.render_camera, block.at(names.MOTION, x, y)
    off = (block.pixel[0] - x) * rendered.fx / camera.fx, (block.pixel[1] - y) * rendered.fy / camera.fy
    return float(x + 0.5 + motion[0] + off[0]), float(y + 0.5 + motion[1] + off[1])


def _was_hidden(pipeline: Pipeline, shot: Shot, block: _Block, x: int, y: int) -> tuple[bool, str]:
    """Return whether the pixel of `block` can have been a hidden part of the mover at (x, y), and the numbers that
    decide it."""
    moment, layers = shot.moment, device_layers(pipeline, shot)
    camera, rendered, depth_of = moment.camera, moment.render_camera, layers[names.RENDERED_DEPTH]
    z, place = float(block.at(names.DEPTH, x, y)[0]), _moves_along(shot, block, x, y)
    steps = max(abs(x - block.pixel[0]), abs(y - block.pixel[1]))
    for t in range(1, steps):
        between = (
            block.pixel[0] + t * (x - block.pixel[0]) // steps,
            block.pixel[1] + t * (y - block.pixel[1]) // steps,
        )
        depth = float(block.at(names.DEPTH, *between)[0])
        if not block.at(names.DISOCCLUDED, *between)[0] and not depth < _MOVERS["NEARER"] * z:
            return False, f"a surface between them at depth {depth:.4g} does not stand before the mover at {z:.4g}."
    was = f"it would have been at ({place[0]:.1f}, {place[1]:.1f}) of rendered frame {moment.k}"
    shown = _depth_at(pipeline, depth_of, place)
    if shown is None:
        return False, f"{was}, which is outside of it."
    of_mover = float(rendered.project(camera.unproject((x + 0.5, y + 0.5), z))[1])
    if shown > 0 and not shown < _MOVERS["HIDES"] * of_mover:
        return False, f"{was}. That shows depth {shown:.4g} there, which does not hide the mover at {of_mover:.4g}."
    was += f", behind depth {shown:.4g}."
    own = depth_of.place((0, 0), block.at(names.MOTION, x, y) + (x + 0.5, y + 0.5))
    previous = pipeline.frames.previous
    if previous is None or moment.previous_camera is None or own is None:
        return True, was
    motion = read_blocks(pipeline, {"motion": (layers[names.RENDERED_MOTION], *own, 1, 1)})["motion"]
    before = np.add(place, motion.ravel()[:2])
    then = _depth_at(pipeline, replace(depth_of, buffer=previous.depth), before)
    expected = float(moment.previous_camera.project(rendered.unproject(place, of_mover))[1])
    if then is not None and _MOVERS["HIDES"] * then > expected:
        said = f"{was} But the frame before shows depth {then:.4g} at ({before[0]:.1f}, {before[1]:.1f})"
        return False, f"{said}, which is farther than the mover at {expected:.4g}."
    return True, was


def _depth_at(pipeline: Pipeline, layer: DeviceLayer, place) -> float | None:
    """Return the depth that a rendered image shows at `place`; None outside of it."""
    at = layer.place((0, 0), place)
    return None if at is None else float(read_blocks(pipeline, {"depth": (layer, *at, 1, 1)})["depth"].flat[0])


def why_no_background(pipeline: Pipeline, shot: Shot, pixel: tuple[int, int], source_px) -> Step | None:
    """Return what the background remembers where the pixel would be, which does not land in it; None without it."""
    if source_px is None:
        return None
    layers, told, empty, links = device_layers(pipeline, shot), [], [], []
    for level in range(MAX_LEVELS):
        named = [names.background(name, level) for name in ("state", "depth", "px")]
        if not all(name in layers for name in named):
            continue
        at = layers[named[0]].place(pixel, source_px)
        if at is None:
            return Step(
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
        told.append(f"level {level} remembers {int(remembered.sum())}, the nearest with {where}, and none lands here")
        links.append(Link(f"level {level}", names.background("color", level)))
    if empty:
        told.append(f"nothing is remembered in level {', '.join(map(str, empty))}")
    if not told:
        return None
    around_it = f"around ({source_px[0]:.1f}, {source_px[1]:.1f})"
    return Step(f"The background left it: {around_it} {'; '.join(told)}.", *links)


class _Taken(NamedTuple):
    """A pixel beside the hole: its depth and `inverse` depth, and 1 / distance. The hole's pixel at that depth is
    `outside` of the rendered image, or may be a surface `behind` what that shows. It is of a `mover`, or was filled
    for one. `past`: what the direction met first, which cannot be there. `beyond`: the depth of what the rendered frame
    shows where its surface ends before that."""

    at: tuple[int, int]
    depth: float
    inverse: float
    closeness: float
    outside: bool
    behind: bool
    mover: bool
    past: _Taken | None = None
    beyond: float | None = None

    @property
    def told(self) -> str:
        at = f"({self.at[0]}, {self.at[1]}) at depth {self.depth:.4g}"
        if self.beyond is not None and self.inverse == _inverse_of(self.beyond):
            return f"{at}, which ends there, before depth {self.beyond:.4g}"
        if self.past is None:
            return at
        return f"{at} past {'a mover' if self.past.mover else 'a bar'} in front at depth {self.past.depth:.4g}"


def what_was_taken(
    pipeline: Pipeline, shot: Shot, pixel: tuple[int, int], values: dict[str, np.ndarray]
) -> Step | None:
    """Return which pixels the hole filling "far-side" took the color from; None for other ways."""
    reach = getattr(pipeline.stages.get("holes"), "reach", 0)
    if not reach:
        return None
    wanted = (names.FILLED_BY, names.DEPTH, names.DYNAMIC, names.MOTION)
    block = _Block(pipeline, shot, pixel, reach, wanted)

    def is_beside(x: int, y: int) -> bool:
        return int(block.at(names.FILLED_BY, x, y)[0]) != BY_HOLE_FILLING

    first = {direction: block.first(direction, is_beside) for direction in _DIRECTIONS}
    if is_far := not any(first.values()):
        block = _Block(pipeline, shot, pixel, sum(pipeline.sizes.target), wanted)
        first = {direction: block.first(direction, is_beside) for direction in _DIRECTIONS}
    ways = {way: _taken(pipeline, shot, block, way, at) for way, at in first.items() if at is not None}
    met = list(ways.values())
    color = f"The result is ({', '.join(f'{float(c):.3g}' for c in values[names.FINAL][:3])})."
    if not met:
        return Step(f"No direction meets a pixel beside the hole, so it took that of the rendered frame. {color}")
    if not any(one.outside for one in met) and not is_far and not all(one.mover for one in met):
        met = [one if one.behind else _past(pipeline, shot, block, way, one) for way, one in ways.items()]
    beyond = [one for one in met if one.outside]
    used = beyond or _behind(met)
    listed = ", ".join(one.told for one in used)
    links = [Link(f"({one.at[0]}, {one.at[1]})", names.FINAL, pixel=one.at) for one in used]
    if beyond:
        said = f"It took depth from {listed}, which lie outside of the rendered image here, and color from its border,"
        said += " or beside the hole where a mover stands there."
    else:
        kind = "can be behind" if any(one.behind for one in met) else "are the farthest"
        said = f"Of {len(met)} pixels beside the hole it took the mean of those that {kind}: {listed}."
    return Step(f"{said} {color}", *links)


def _inverse_of(depth: float) -> float:
    return 1.0 / depth if math.isfinite(depth) else 0.0


def _rendered(pipeline: Pipeline, shot: Shot, name: str, place: tuple[float, float]) -> float | None:
    """Return the value of a layer of the rendered frame at a place of it; None outside of the image."""
    layer = device_layers(pipeline, shot)[name]
    texel = layer.place((0, 0), place)
    return None if texel is None else float(read_blocks(pipeline, {name: (layer, *texel, 1, 1)})[name].flat[0])


def _taken(pipeline: Pipeline, shot: Shot, block: _Block, way: tuple[int, int], at: tuple[int, int]) -> _Taken:
    depth = float(block.at(names.DEPTH, *at)[0])
    is_filled = int(block.at(names.FILLED_BY, *at)[0]) in (BY_HIDDEN_PART, BY_REAPPEARING)
    mover = is_filled or bool(block.at(names.DYNAMIC, *at)[0])
    dx, dy = block.at(names.MOTION, *at)
    step = _HOLES["PAST_EDGE"]
    edge = at[0] + 0.5 + float(dx) - step * way[0], at[1] + 0.5 + float(dy) - step * way[1]
    beyond = _rendered(pipeline, shot, names.RENDERED_DEPTH, edge)
    if beyond is not None:
        farther = beyond > 0 and _inverse_of(depth) > _inverse_of(beyond) * _HOLES["FAR_SIDE"]
        if not farther or _rendered(pipeline, shot, names.DYNAMIC_MASK, edge):
            beyond = None
    outside, can_be = _where(pipeline, shot, block.pixel, depth)
    closeness, ends = 1.0 / math.dist(at, block.pixel), beyond is not None
    behind = can_be and not mover and not ends
    values = at, depth, _inverse_of(depth), closeness, outside and not ends, behind, mover
    return _Taken(*values, beyond=beyond)


def _where(pipeline: Pipeline, shot: Shot, pixel: tuple[int, int], depth: float) -> tuple[bool, bool]:
    """Return whether the hole's `pixel`, at that depth, is outside of the rendered image, and whether a static surface
    can be there."""
    center, moment, known = (pixel[0] + 0.5, pixel[1] + 0.5), shot.moment, math.isfinite(depth)
    place, z = moment.render_camera.project(moment.camera.unproject(center, depth if known else 1e6))
    shown = _rendered(pipeline, shot, names.RENDERED_DEPTH, (float(place[0]), float(place[1]))) if z > 0 else None
    if shown is None:
        return True, False
    return False, bool(shown > 0 and not (z if known else math.inf) < _HOLES["IN_FRONT"] * shown)


def _past(pipeline: Pipeline, shot: Shot, block: _Block, direction: tuple[int, int], one: _Taken) -> _Taken:
    """Return what a direction meets past `one`, which cannot be there: a static surface behind it that can be. Without
    any what the rendered frame shows beyond its edge counts, or it counts itself."""
    before = 0.0 if one.mover else one.depth

    def can_be_there(x: int, y: int) -> bool:
        nonlocal before
        if int(block.at(names.FILLED_BY, x, y)[0]) == BY_HOLE_FILLING:
            return False
        other = _taken(pipeline, shot, block, direction, (x, y))
        if other.mover or not other.depth > before:
            return False
        before = other.depth
        return _where(pipeline, shot, block.pixel, other.depth)[1]

    steps = max(abs(one.at[0] - block.pixel[0]), abs(one.at[1] - block.pixel[1]))
    at = block.first(direction, can_be_there, steps + 1, int(block.reach // _HOLES["PAST_SHARE"]))
    if at is not None:
        return _taken(pipeline, shot, block, direction, at)._replace(past=one, outside=False, behind=True)
    if one.beyond is None:
        return one
    outside, can_be = _where(pipeline, shot, block.pixel, one.beyond)
    return one._replace(
        inverse=_inverse_of(one.beyond),
        closeness=one.closeness * _HOLES["BEHIND_EDGE"],
        outside=outside and not one.mover,
        behind=one.mover if outside else can_be,
    )


def _behind(met: list[_Taken]) -> list[_Taken]:
    """Return the pixels of the surface behind a disocclusion: of those that can be there the surface with the largest
    sum of inverse distances; without any, the farthest one."""
    far, candidates = _HOLES["FAR_SIDE"], [one for one in met if one.behind]
    if not candidates:
        limit = far * min(one.inverse for one in met)
        return [one for one in met if not one.inverse > limit]

    def alike(a: _Taken, b: _Taken) -> bool:
        return not a.inverse > far * b.inverse and not b.inverse > far * a.inverse

    chosen = max(candidates, key=lambda one: sum(other.closeness for other in candidates if alike(one, other)))
    return [one for one in candidates if alike(one, chosen)]


def where_it_reappears_from(pipeline: Pipeline, shot: Shot, source_px: tuple[float, float] | None) -> Step | None:
    """Return where the frame before showed a part of a mover that reappears. It is at `source_px` of the rendered
    image, behind what hides it, and moves as the mover beside that does."""
    if source_px is None:
        return None
    reach = max(_MOVERS["MOVER_REACH"], pipeline.sizes.target[0] // _MOVERS["MOVER_REACH_SHARE"])
    pixel = math.floor(source_px[0]), math.floor(source_px[1])
    if not all(0 <= at < side for at, side in zip(pixel, pipeline.sizes.source, strict=True)):
        return None
    block = _Block(pipeline, shot, pixel, reach, (names.DYNAMIC_MASK, names.RENDERED_MOTION, names.MET_DEPTH))
    sides = (block.first(d, lambda x, y: block.at(names.DYNAMIC_MASK, x, y)[0] == DYNAMIC) for d in _DIRECTIONS[::2])
    found = [at for at in sides if at is not None]
    if not found:
        return None
    mover = min(found, key=lambda at: math.dist(at, pixel))
    motion = block.at(names.RENDERED_MOTION, *mover).astype(np.float64)
    x, y, before = source_px[0] + motion[0], source_px[1] + motion[1], shot.moment.k - 1
    depth = float(block.at(names.MET_DEPTH, *mover)[0])
    said = (
        f"It moves as the mover beside it, at {mover} of rendered frame {shot.moment.k}, does. So its color is that of"
        f" frame {before} at ({x:.1f}, {y:.1f}), at the mover's depth {depth:.4g}."
    )
    return Step(said, Link(f"frame {before}", names.FINAL, before, (math.floor(x), math.floor(y))))
