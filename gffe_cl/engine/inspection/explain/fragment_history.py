"""Data of history tracking and prediction on one fragment of a rendered frame, for the story of a pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.inspection import names
from gffe_cl.engine.inspection.buffers import Shot, device_layers, moved, read_blocks
from gffe_cl.engine.inspection.explain.pixel_explain_types import Link, Step, Story
from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.history import FIXED_TO_CAMERA, STATIC

_CELLS = constants("mover_grid.h")
_ROUNDED = 1e-3  # relative difference from the threshold within which the kernel may have rounded to either side


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
        dynamic = label != STATIC
        px = np.add(at, 0.5)
        history_stage = pipeline.stages["history"]
        error = history_stage.read("quantization_error").ravel()
        static = _static_motion(shot, px, depth, motion) if pipeline.options.motion else None
        residual = _residual(static, motion, error)
        threshold = None if residual is None else float(np.sqrt(history_stage.read("static_threshold_squared")[0]))
        known = _known_places(shot, px + motion, float(met[0, 0]), values.get(names.HISTORY)) if dynamic else []

        path = [_projected(place, shot.moment.display_camera) for place in known[::-1]]
        path.append(moved(px, shot.moment.render_camera, shot.moment.display_camera))
        if (target := values.get(names.TARGET_POSITION)) is not None and target.flat[2] > 0:
            path.append((float(target.flat[0]), float(target.flat[1])))
        used = min(len(known), pipeline.options.order) if shot.moment.alpha else -1
        mover = (used, *(_of_mover(pipeline, layers, at, depth) if used == 1 else (0.0, False, False)))
        sentences = _fragment_sentences(pipeline, shot, depth, motion, static, label, residual, threshold, mover)
        at = int(at[0]), int(at[1])
        return cls(tuple(point for point in path if point), dynamic, residual, threshold, sentences, at)


def _of_mover(pipeline, layers, at, depth: float) -> tuple[float, bool, bool]:
    """Return how much of its mover's acceleration counts for the fragment at source pixel `at`, 0 to 1, and whether the
    camera carries that mover, and whether it spins."""
    if names.ACCELERATION not in layers:
        return 0.0, False, False
    cell = (layers[name] for name in (names.VELOCITY, names.BEND, names.VIEW_VELOCITY))
    where = (at[0] // _CELLS["MOVER_CELL"], at[1] // _CELLS["MOVER_CELL"], 1, 1)
    values = read_blocks(pipeline, {layer.spec.name: (layer, *where) for layer in cell})
    mover_depth, trust, carried = (float(array.flat[3]) for array in values.values())
    if abs(depth - mover_depth) > _CELLS["CELL_TOLERANCE"] * mover_depth:
        return 0.0, False, False
    return max(trust, 0.0), carried > 0, trust < 0


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


def _static_motion(shot: Shot, px, depth: float, motion) -> np.ndarray | None:
    """Return the motion (2,) in pixels that the fragment would have if it stood still; None if `motion` is not compared
    with it."""
    if shot.moment.previous_camera is None or not (0 < depth < np.inf) or not np.isfinite(motion).all():
        return None
    was, z = shot.moment.previous_camera.project(shot.moment.render_camera.unproject(px, depth))
    return was - px if z > 0 else None


def _residual(static: np.ndarray | None, motion, error) -> float | None:
    """Return the distance in pixels between the fragment's motion and the static one beyond quantization errors,
    `error` (4,); None if not tested."""
    if static is None:
        return None
    off = np.abs(static - motion) - np.where(static < 0, error[1::2], error[::2])
    return float(np.hypot(*np.maximum(off, 0)))


def _fragment_sentences(pipeline, shot, depth, motion, static, label, residual, threshold, mover) -> tuple[str, ...]:
    used, bend, carried, spins = mover
    if not depth > 0:
        return (f"Its depth ({depth:g}) is invalid, so nothing of it is splatted.",)
    if depth == np.inf:
        return (_judged(label, False, "sky turns with the camera."),)
    if not pipeline.options.motion:
        return (_judged(label, False, "motion estimation is off: everything counts as static."),)
    if shot.moment.previous_camera is None:
        return (_judged(label, False, "no frame before this one is known: everything counts as static."),)
    if label == FIXED_TO_CAMERA:
        kept = (
            "Fixed to the camera: its motion keeps it where it is in view space, though a surface that stands still"
            " would have moved. It keeps its place before the new camera."
        )
        return (Step(kept, Link("dynamic mask", names.DYNAMIC_MASK)),)
    if residual is None:
        why = "its motion is NaN or infinite" if not np.isfinite(motion).all() else "it was behind the camera before"
        return (_judged(label, True, f"{why}.", named=True),)
    dynamic, moves = label != STATIC, residual > threshold
    if np.isclose(residual, threshold, rtol=_ROUNDED, atol=0):
        moves = dynamic
    why = (
        f"its motion ({motion[0]:+.2f}, {motion[1]:+.2f}) px is {residual:.2f} px from that of a surface that stands"
        f" still ({static[0]:+.2f}, {static[1]:+.2f}), {'' if moves else 'not '}more than the threshold of"
        f" {threshold:.2f} px."
    )
    said: list[str] = [_judged(label, moves, why, named=True)]
    if dynamic and used == 0:
        unknown = "No earlier position of it is known (hidden or out of the image then), so it stays where it is."
        said.append(Step(unknown, Link("met depth", names.MET_DEPTH)))
    elif dynamic and used > 0:
        how = "linearly" if used == 1 else f"by a polynomial of order {used}"
        predicted = f"Predicted {how} from its last {used + 1} positions."
        said.append(Step(predicted, Link("target position", names.TARGET_POSITION)))
        if carried:
            moves_on = (
                "The camera carries it: it is slower in view space than in the world, and when that began, its velocity"
                " there had changed less. So it moves on there, before the new camera."
            )
            said.append(Step(moves_on, Link("velocity in view space", names.VIEW_VELOCITY)))
        if spins:
            turned = "It spins by more than a quarter of a turn in an interval. So it moves on as its center does."
            said.append(Step(turned, Link("acceleration", names.ACCELERATION)))
        if bend > 0:
            bent = f"{bend:.0%} of its acceleration counts too, by what the interval before shows of it."
            said.append(Step(bent, Link("acceleration", names.ACCELERATION)))
    return tuple(said)


def _judged(label: int, dynamic: bool, why: str, named: bool = False) -> Step:
    """Return `why` the fragment is `dynamic` or not by its numbers, `named` so, or that the mask's `label` contradicts
    them."""
    by_mask, by_numbers = ("Dynamic" if of else "Static" for of in (label != STATIC, dynamic))
    said = f"{by_numbers}: {why}" if named else why[0].upper() + why[1:]
    if by_mask != by_numbers:
        said = f"The mask says {by_mask.lower()}, but {why}"
    return Step(said, Link("dynamic mask", names.DYNAMIC_MASK))


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


def least(values: np.ndarray, fits: np.ndarray) -> int | None:
    """Return the index of the least of `values` (N,), infinite ones too, where `fits` (N,); None if that is nowhere."""
    candidates = np.flatnonzero(fits)
    return int(candidates[np.argmin(values[candidates])]) if candidates.size else None


def around(at, reach: int, size) -> tuple[int, int, int, int]:
    """Return x, y, width, height of the block up to `reach` around `at`, within an image of `size`."""
    x, y = (max(c - reach, 0) for c in at)
    return x, y, min(at[0] + reach + 1, size[0]) - x, min(at[1] + reach + 1, size[1]) - y
