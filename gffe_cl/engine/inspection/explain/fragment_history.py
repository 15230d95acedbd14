"""Data of history tracking and prediction on one fragment of a rendered frame, for the story of a pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.inspection import names
from gffe_cl.engine.inspection.buffers import Shot, around, device_layers, least, moved, read_blocks, told
from gffe_cl.engine.inspection.explain.pixel_explain_types import Claim, Link, Story
from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.history import FIXED_TO_CAMERA, STATIC

_TESTED, _PREDICTED = constants("stories/history.cl"), constants("stories/prediction.cl")
_OF_TEST = "STATIC_MOTION_X", "STATIC_MOTION_Y", "STATIC_DEPTH", "RESIDUAL", "THRESHOLD", "MOVES"


@dataclass(frozen=True)
class Fragment:
    """A fragment of the rendered frame, with its data from history tracking and prediction."""

    trajectory: tuple[tuple[float, float], ...]
    dynamic: bool
    residual: float | None
    threshold: float | None
    sentences: tuple[str, ...]
    pixel: tuple[int, int]

    def story(self, pixel, filled_by, source_px, start) -> Story:
        known = (self.trajectory, self.dynamic, self.residual, self.threshold)
        said = (*start, *self.sentences)
        return Story(pixel, filled_by, source_px, *known, sentences=said, fragment=self.pixel)

    @classmethod
    def at(cls, pipeline: Pipeline, shot: Shot, source_px, landed=None) -> Fragment | None:
        """Return the fragment at `source_px`; None out of the image. `landed`: (display pixel, whether it lands in it,
        whether it is dynamic): then the fragment next to `source_px` that does."""
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
        depth, motion, label = float(depth[0, 0]), motion[0].astype(np.float64), int(mask[0, 0])
        dynamic, src = label != STATIC, at[1] * pipeline.sizes.source[0] + at[0]
        test = None
        if pipeline.options.motion and shot.moment.previous_camera is not None and 0 < depth < np.inf:
            test = told(pipeline, "history", "track_history", "rendered", _TESTED["TOLD_OF_TEST"], src=src)
            test = {name.lower(): float(test[_TESTED[name]]) for name in _OF_TEST}
            if not (np.isfinite(motion).all() and test["static_depth"] > 0):
                test = None
        used = None
        if dynamic and shot.moment.alpha:
            count = _PREDICTED["TOLD_OF_PREDICTION"]
            used = told(pipeline, "prediction", "predict_positions", "new", count, src=src)
        known = _known_places(shot, np.add(at, 0.5) + motion, float(met[0, 0]), values.get(names.HISTORY))
        path = [_projected(place, shot.moment.display_camera) for place in (known[::-1] if dynamic else ())]
        path.append(moved(np.add(at, 0.5), shot.moment.render_camera, shot.moment.display_camera))
        if (target := values.get(names.TARGET_POSITION)) is not None and target.flat[2] > 0:
            path.append((float(target.flat[0]), float(target.flat[1])))
        sentences = _fragment_sentences(pipeline, shot, depth, motion, label, test, used)
        residual, threshold = (test["residual"], test["threshold"]) if test else (None, None)
        at = int(at[0]), int(at[1])
        return cls(tuple(point for point in path if point), dynamic, residual, threshold, sentences, at)


def _fragment_that_landed(pipeline, layers, at, pixel, inside: bool, dynamic: bool) -> tuple[int, int]:
    """Return the source pixel, `at` or beside it, of the fragment that won display pixel `pixel`; `at` if none fits.
    Without `inside`, it is the one that landed next to the pixel's center."""
    x0, y0, width, height = around(at, 1, layers[names.RENDERED_DEPTH].size)
    wanted = (names.TARGET_POSITION, names.DYNAMIC_MASK)
    block = read_blocks(pipeline, {name: (layers[name], x0, y0, width, height) for name in wanted})
    place, mask = (block[name][0].reshape(width * height, -1) for name in wanted)
    fits = (place[:, 2] > 0) & ((mask[:, 0] != STATIC) == dynamic)
    if inside:
        fits &= (np.floor(place[:, :2]) == pixel).all(1)
    distance = place[:, 2] if inside else np.hypot(*(place[:, :2] - np.add(pixel, 0.5)).T)
    best = least(distance, fits)
    return at if best is None else (x0 + best % width, y0 + best // width)


def _fragment_sentences(pipeline, shot, depth, motion, label, test, used) -> tuple[str, ...]:
    """Return what history tracking (`test`, by lower-case names) and prediction (`used`) tell of a fragment."""
    mask = Link("dynamic mask", names.DYNAMIC_MASK)
    if not depth > 0:
        return (f"Its depth ({depth:g}) is invalid, so nothing of it is splatted.",)
    if depth == np.inf:
        return (Claim("Sky turns with the camera.", mask),)
    if not pipeline.options.motion:
        return (Claim("Motion estimation is off: everything counts as static.", mask),)
    if shot.moment.previous_camera is None:
        return (Claim("No frame before this one is known: everything counts as static.", mask),)
    if label == FIXED_TO_CAMERA:
        kept = (
            "Fixed to the camera: its motion keeps it where it is in view space, though a surface that stands still"
            " would have moved. It keeps its place before the new camera."
        )
        return (Claim(kept, mask),)
    if test is None:
        why = "its motion is NaN or infinite" if not np.isfinite(motion).all() else "it was behind the camera before"
        return (Claim(f"Dynamic: {why}.", mask),)
    why = (
        f"its motion ({motion[0]:+.2f}, {motion[1]:+.2f}) px is {test['residual']:.2f} px from that of a surface that"
        f" stands still ({test['static_motion_x']:+.2f}, {test['static_motion_y']:+.2f}),"
        f" {'' if test['moves'] else 'not '}more than the threshold of {test['threshold']:.2f} px."
    )
    said: list[str] = [Claim(f"{'Dynamic' if test['moves'] else 'Static'}: {why}", mask)]
    if used is None:
        return tuple(said)
    positions, trust = int(used[_PREDICTED["KNOWN"]]), float(used[_PREDICTED["TRUST"]])
    if positions == 0:
        unknown = "No earlier position of it is known (hidden or out of the image then), so it stays where it is."
        said.append(Claim(unknown, Link("met depth", names.MET_DEPTH)))
        return tuple(said)
    how = "linearly" if positions == 1 else f"by a polynomial of order {positions}"
    predicted = f"Predicted {how} from its last {positions + 1} positions."
    said.append(Claim(predicted, Link("target position", names.TARGET_POSITION)))
    if used[_PREDICTED["CARRIED"]]:
        moves_on = (
            "The camera carries it: it is slower in view space than in the world, and when that began, its velocity"
            " there had changed less. So it moves on there, before the new camera."
        )
        said.append(Claim(moves_on, Link("velocity in view space", names.VIEW_VELOCITY)))
    if used[_PREDICTED["SPINS"]]:
        turned = "It spins by more than a quarter of a turn in an interval. So it moves on as its center does."
        said.append(Claim(turned, Link("acceleration", names.ACCELERATION)))
    if trust > 0:
        bent = f"{trust:.0%} of its acceleration counts too, by what the interval before shows of it."
        said.append(Claim(bent, Link("acceleration", names.ACCELERATION)))
    return tuple(said)


def _known_places(shot: Shot, px_prev, met_depth: float, history) -> list[np.ndarray]:
    """Return P_1 … as far as known, in the view space of the rendered camera. `history`: the stored positions, if
    any."""
    if shot.moment.previous_camera is None or not met_depth > 0:
        return []
    world = shot.moment.previous_camera.unproject(px_prev, met_depth)
    older = [] if history is None else history.reshape(-1, 4)[1:]
    matrix = shot.moment.render_camera.world_to_view
    return [matrix[:3, :3] @ world + matrix[:3, 3], *(place[:3] for place in older if place[3] != 0)]


def _projected(view_pos, camera: Camera) -> tuple[float, float] | None:
    """Return the display position, in pixels, of a position in view space; None behind the camera."""
    x, y, z = map(float, view_pos)
    return (camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy) if z > 0 else None
