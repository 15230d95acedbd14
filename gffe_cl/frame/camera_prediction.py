"""The predicted camera from more than two rendered frames: how a camera speeds up, slows down and swings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gffe_cl.core.errors import GffeError
from gffe_cl.core.validation import require_array, require_list, require_number, require_whole
from gffe_cl.frame import vectors
from gffe_cl.frame.camera import Camera, predict_camera

POSES = 4  # of which a prediction makes use
JUMP = 4.0  # times the step before: a step that is longer is none of a steady movement
LEAST = 1e-24  # squared change of velocity that is mere rounding


def predict_camera_at(time: float, cameras: Sequence[Camera], times: Sequence[float], order: int = 2) -> Camera:
    """The predicted camera C̄ at `time` from the last rendered frames.

    To the linear prediction (`predict_camera`), order 2 adds what the quadratic through three poses has beyond it, of
    position and of rotation, each by as much as the change of velocity before the last one has gone on: by all of it
    where it did, by nothing where it turned round or came out of rest. So a steady swing goes on, and the noise of a
    hand does not. After a jump, a step over four times the one before, the prediction is linear, as are focal lengths.

    Parameters
    ----------
    time : float
        Seconds, not before the last frame.
    cameras, times
        Of rendered frames since the last reset, newest first, and their times in seconds; what is beyond the fourth
        does not count. With one camera the prediction is that.
    order : 1 or 2
        1 is the paper's.

    Raises GffeError for other orders, no camera, other numbers of times than of cameras, and times that do not
    decrease. Source: paper, 'Adaptive rendering window'; beyond it from order 2 on.
    """
    time, order = require_number(time, "camera: time"), require_whole(order, "camera: order", 1, 2)
    cameras = require_list(cameras, Camera, "camera: cameras", "a list of cameras")[:POSES]
    times = require_array(times, "camera: times", None)[:POSES].astype(np.float64)
    if not cameras or len(cameras) != len(times) or not np.isfinite(times).all() or (np.diff(times) >= 0).any():
        raise GffeError(f"camera: needs one decreasing time per camera, got {len(cameras)} and {times.tolist()}")
    if len(cameras) == 1:
        return cameras[0]
    steps = -np.diff(times)
    ahead = time - float(times[0])
    predicted = predict_camera(cameras[1], cameras[0], ahead / steps[0])
    if order == 1 or len(cameras) == 2:
        return predicted
    pairs = list(zip(cameras[1:], cameras[:-1], strict=True))
    moves = [(new.position - old.position).tolist() for old, new in pairs]
    turns = [rotation_vector(_turn(old, new)).tolist() for old, new in pairs]
    factor = ahead * (ahead + float(steps[0]))
    move, turn = ([factor * x for x in _lasting_change(motion, steps.tolist())] for motion in (moves, turns))
    if not (any(move) or any(turn)):
        return predicted
    rotation = vectors.product(rotation_matrix(turn).tolist(), predicted.world_to_view[:3, :3].tolist())
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = [-x for x in vectors.times(rotation, (predicted.position + move).tolist())]
    return replace(predicted, world_to_view=matrix)


def _turn(old: Camera, new: Camera) -> np.ndarray:
    """(3, 3) rotation from the view space of `old` to that of `new`."""
    rotations = new.world_to_view[:3, :3].tolist(), old.world_to_view[:3, :3].T.tolist()
    return np.array(vectors.product(*rotations))


def _lasting_change(motion: list[list[float]], steps: list[float]) -> list[float]:
    """Second divided difference of what moves by `motion`, newest first, in `steps` of time: the part that lasts."""
    if vectors.length(motion[0]) > JUMP * vectors.length(motion[1]):
        return [0.0, 0.0, 0.0]
    speeds = [[x / step for x in moved] for moved, step in zip(motion, steps, strict=True)]
    changes = [
        [(a - b) / (steps[k] + steps[k + 1]) for a, b in zip(speeds[k], speeds[k + 1], strict=True)]
        for k in range(len(speeds) - 1)
    ]
    if len(changes) == 1:
        return changes[0]
    now, before = changes
    square, step = vectors.dot(before, before), steps[1] * steps[1]
    lasting = min(max(vectors.dot(now, before) / square, 0.0), 1.0) if square * (step * step) > LEAST else 0.0
    return [lasting * x for x in now]


def rotation_vector(rotation: np.ndarray) -> np.ndarray:
    """(3,) axis times angle, radians, of a rotation matrix (3, 3); 0 for half a turn, whose axis has no direction."""
    r = np.asarray(rotation).tolist()
    doubled = [r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1]]
    sine, cosine = vectors.length(doubled) / 2, (r[0][0] + r[1][1] + r[2][2] - 1) / 2
    if not sine > 1e-12:
        return np.zeros(3)
    scale = math.atan2(sine, cosine) / sine
    return np.array([x / 2 * scale for x in doubled])


def rotation_matrix(vector: Sequence[float]) -> np.ndarray:
    """(3, 3), the inverse of `rotation_vector` (Rodrigues' formula)."""
    angle = vectors.length(vector)
    if angle < 1e-15:
        return np.eye(3)
    x, y, z = (component / angle for component in vector)
    sine, versine = math.sin(angle), 1 - math.cos(angle)
    crossed = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    twice = vectors.product(crossed, crossed)
    return np.array(
        [[(1.0 if i == j else 0.0) + sine * crossed[i][j] + versine * twice[i][j] for j in range(3)] for i in range(3)]
    )
