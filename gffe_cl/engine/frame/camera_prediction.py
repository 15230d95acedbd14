"""Prediction of the camera from more than two rendered frames: how a camera speeds up, slows down and swings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import require_array, require_list, require_number, require_whole
from gffe_cl.engine.frame import vectors
from gffe_cl.engine.frame.camera import Camera, predict_camera

Vector = list[float]  # three
Vectors = list[Vector]

POSES = 12  # of which a prediction makes use
JUMP = 4.0  # times the step before: a longer step is not steady movement
LEAST = 1e-24  # squared change of velocity that is mere rounding
FORGETTING = 0.9  # weight of an error, relative to that of the error an interval later
RIDGE = 0.03  # share of the squared inputs that regularizes a regression


def predict_camera_at(
    time: float, cameras: Sequence[Camera], times: Sequence[float], order: int | None = None
) -> Camera:
    """Return the predicted camera C̄ at `time` from the cameras of the last rendered frames.

    All orders add a change of velocity to the linear prediction (`predict_camera`), of position and of rotation each:

    - Order 1 adds none.
    - Order 2 adds the change of velocity between the last three poses, scaled by the share of the change before that
      continued: fully where all of it did, not at all where it reversed or began from rest. After a jump, a step over
      four times the one before, it adds none.
    - None, automatic, corrects order 2 by an autoregressive model. Ridge regression with exponential forgetting
      predicts the next change of velocity from the velocity, its change, and the change's change. It is refitted at
      each known pose from the poses before. The correction is scaled, 0 to 1, to minimize the errors actually made
      at the known poses. Steady movement has no errors to correct, the tremor of a hand has.

    Focal lengths are predicted linearly.

    Parameters
    ----------
    time : float
        Time of the prediction in seconds, not before the last frame.
    cameras, times
        The cameras of rendered frames since the last reset, newest first, and their times in seconds; those after the
        twelfth are ignored. One camera is its own prediction, two are continued linearly. Up to four are too few to
        learn from: then None is order 2.
    order : 1, 2 or None
        Order of the prediction; 1 is the paper's, None is automatic.

    Raises
    ------
    GffeError
        For other orders, no camera, other numbers of times than of cameras, and times that do not decrease.

    Notes
    -----
    Source: paper, 'Adaptive rendering window'; beyond it for order 2 and None.
    """
    time = require_number(time, "camera: time")
    order = None if order is None else require_whole(order, "camera: order", 1, 2)
    known = POSES if order is None else 4
    cameras = require_list(cameras, Camera, "camera: cameras", "a list of cameras")[:known]
    given = require_array(times, "camera: times", None)[:known].astype(np.float64)
    if not cameras or len(cameras) != len(given) or not np.isfinite(given).all() or (np.diff(given) >= 0).any():
        raise GffeError(f"camera: needs one decreasing time per camera, got {len(cameras)} and {given.tolist()}")
    if len(cameras) == 1:
        return cameras[0]
    steps = (-np.diff(given)).tolist()
    ahead = time - float(given[0])
    predicted = predict_camera(cameras[1], cameras[0], ahead / steps[0])
    if order == 1 or len(cameras) == 2:
        return predicted
    positions = [camera.position.tolist() for camera in cameras]
    moves = [[a - b for a, b in zip(new, old, strict=True)] for new, old in pairwise(positions)]
    rotations = [camera.world_to_view[:3, :3].tolist() for camera in cameras]
    turns = [rotation_vector(vectors.product(new, vectors.transposed(old))) for new, old in pairwise(rotations)]
    factor = ahead * (ahead + steps[0])
    move, turn = ([factor * x for x in _next_change(motion, steps)] for motion in (moves, turns))
    if not (any(move) or any(turn)):
        return predicted
    rotation = vectors.product(rotation_matrix(turn).tolist(), predicted.world_to_view[:3, :3].tolist())
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = [-x for x in vectors.times(rotation, (predicted.position + move).tolist())]
    return replace(predicted, world_to_view=matrix)


def _next_change(motion: Vectors, steps: list[float]) -> Vector:
    """Return the next second divided difference, predicted from the past `motion`, newest first, in `steps` of time.

    With up to three motions it is `_lasting_change` of the last; beyond, that and a learned correction.
    """
    speeds = [[x / step for x in moved] for moved, step in zip(motion, steps, strict=True)]
    changes = [
        [(a - b) / (steps[k] + steps[k + 1]) for a, b in zip(speeds[k], speeds[k + 1], strict=True)]
        for k in range(len(speeds) - 1)
    ]
    if len(changes) == 1:
        return [0.0, 0.0, 0.0] if _is_jump(motion, 0) else changes[0]
    model = _NextChange()
    for k in range(len(changes) - 2, 0, -1):
        inputs = _inputs(speeds, changes, k)
        usual = _lasting_change(motion, steps, changes, k)
        model.learn(inputs, usual, model.correction(inputs, usual), changes[k - 1])
    inputs, usual = _inputs(speeds, changes, 0), _lasting_change(motion, steps, changes, 0)
    correction = model.correction(inputs, usual)
    trust = model.trust(correction)
    return [a + trust * b for a, b in zip(usual, correction, strict=True)]


def _is_jump(motion: Vectors, k: int) -> bool:
    return vectors.length(motion[k]) > JUMP * vectors.length(motion[k + 1])


def _lasting_change(motion: Vectors, steps: list[float], changes: Vectors, k: int) -> Vector:
    """Return the part of `changes[k]` that lasts, 0 after a jump."""
    if _is_jump(motion, k):
        return [0.0, 0.0, 0.0]
    now, before = changes[k], changes[k + 1]
    square, step = vectors.dot(before, before), steps[k + 1] * steps[k + 1]
    lasting = min(max(vectors.dot(now, before) / square, 0.0), 1.0) if square * (step * step) > LEAST else 0.0
    return [lasting * x for x in now]


def _inputs(speeds: Vectors, changes: Vectors, k: int) -> Vectors:
    """Return the further inputs from which the regression predicts the change after `changes[k]`."""
    return [speeds[k], changes[k], [a - b for a, b in zip(changes[k], changes[k + 1], strict=True)]]


class _NextChange:
    """Ridge regression with exponential forgetting: the next change of velocity is the last one, plus three inputs
    times coefficients that all components share, so that the choice of axes does not matter."""

    def __init__(self):
        self.products = [[0.0] * 3 for _ in range(3)]  # of inputs and inputs
        self.targets = [0.0] * 3  # products of inputs and targets
        self.gained = self.moved = 0.0  # correction · error of the usual prediction, and squared correction

    def correction(self, inputs: Vectors, usual: Vector) -> Vector:
        """Return the difference between the model's prediction and the `usual` one."""
        matrix = [list(row) for row in self.products]
        for i in range(3):
            scale = self.products[i][i] + vectors.dot(inputs[i], inputs[i])
            matrix[i][i] += RIDGE * scale if scale > 0 else 1.0
        a, b, c = _solved(matrix, self.targets)
        return [
            now - usually + (a * speed + b * now + c * jerk)
            for speed, now, jerk, usually in zip(*inputs, usual, strict=True)
        ]

    def trust(self, correction: Vector) -> float:
        """Return the share of `correction`, 0 to 1, that would have minimized the errors so far."""
        moved = self.moved + RIDGE * vectors.dot(correction, correction)
        return min(self.gained / moved, 1.0) if self.gained > 0 and moved > 0 else 0.0

    def learn(self, inputs: Vectors, usual: Vector, correction: Vector, change: Vector) -> None:
        """Add the `change` that came after `inputs`, for which `correction` was predicted, to the regression."""
        error = [a - b for a, b in zip(change, usual, strict=True)]
        wanted = [a - b for a, b in zip(change, inputs[1], strict=True)]
        self.gained = FORGETTING * self.gained + vectors.dot(correction, error)
        self.moved = FORGETTING * self.moved + vectors.dot(correction, correction)
        for i, x in enumerate(inputs):
            self.targets[i] = FORGETTING * self.targets[i] + vectors.dot(x, wanted)
            for j in range(i + 1):
                total = FORGETTING * self.products[i][j] + vectors.dot(x, inputs[j])
                self.products[i][j] = self.products[j][i] = total


def _solved(matrix: Vectors, right: Vector) -> Vector:
    """Return x of matrix · x = right for a symmetric matrix, or 0 where rounding leaves no solution."""
    a, b, c = matrix
    columns = vectors.cross(b, c), vectors.cross(c, a), vectors.cross(a, b)
    scale = vectors.dot(a, columns[0])
    return [vectors.dot(column, right) / scale if scale > 0 else 0.0 for column in columns]


def rotation_vector(rotation: vectors.Matrix) -> Vector:
    """Return the axis times the angle, radians, of a rotation matrix (3, 3); 0 for half a turn, whose axis has no
    direction."""
    r = rotation
    doubled = [r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1]]
    sine, cosine = vectors.length(doubled) / 2, (r[0][0] + r[1][1] + r[2][2] - 1) / 2
    if not sine > 1e-12:
        return [0.0, 0.0, 0.0]
    scale = math.atan2(sine, cosine) / sine
    return [x / 2 * scale for x in doubled]


def rotation_matrix(vector: Sequence[float]) -> np.ndarray:
    """Return the rotation matrix (3, 3) of a rotation vector: the inverse of `rotation_vector` (Rodrigues' formula)."""
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
