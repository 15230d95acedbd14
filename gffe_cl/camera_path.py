"""The predicted camera from more than two rendered frames: how a camera speeds up, slows down and swings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gffe_cl.camera import Camera, predict_camera
from gffe_cl.errors import GffeError

POSES = 4  # of which a prediction makes use
_JUMP = 4.0  # times the step before: a step that is longer is none of a steady movement
_LEAST = 1e-24  # squared change of velocity that is mere rounding


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
    cameras, times = list(cameras[:POSES]), np.asarray(times[:POSES], np.float64)
    if order not in (1, 2):
        raise GffeError(f"camera: the order of its prediction must be 1 or 2, got {order}")
    if not cameras or len(cameras) != len(times) or not np.isfinite(times).all() or (np.diff(times) >= 0).any():
        raise GffeError(f"camera: needs one decreasing time per camera, got {len(cameras)} and {times.tolist()}")
    if len(cameras) == 1:
        return cameras[0]
    steps = -np.diff(times)
    ahead = float(time) - times[0]
    predicted = predict_camera(cameras[1], cameras[0], ahead / steps[0])
    if order == 1 or len(cameras) == 2:
        return predicted
    pairs = list(zip(cameras[1:], cameras[:-1], strict=True))
    moves = [new.position - old.position for old, new in pairs]
    turns = [rotation_vector(new.world_to_view[:3, :3] @ old.world_to_view[:3, :3].T) for old, new in pairs]
    factor = ahead * (ahead + steps[0])
    move, turn = (factor * _lasting_change(motion, steps) for motion in (moves, turns))
    if not (move.any() or turn.any()):
        return predicted
    rotation = rotation_matrix(turn) @ predicted.world_to_view[:3, :3]
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = -rotation @ (predicted.position + move)
    return replace(predicted, world_to_view=matrix)


def _lasting_change(motion: list[np.ndarray], steps: np.ndarray) -> np.ndarray:
    """Second divided difference of what moves by `motion`, newest first, in `steps` of time: the part that lasts."""
    if np.linalg.norm(motion[0]) > _JUMP * np.linalg.norm(motion[1]):
        return np.zeros(3)
    speeds = [moved / step for moved, step in zip(motion, steps, strict=True)]
    changes = [(speeds[k] - speeds[k + 1]) / (steps[k] + steps[k + 1]) for k in range(len(speeds) - 1)]
    if len(changes) == 1:
        return changes[0]
    now, before = changes
    size = before @ before * steps[1] ** 4
    lasting = np.clip(now @ before / (before @ before), 0, 1) if size > _LEAST else 0.0
    return lasting * now


def rotation_vector(rotation: np.ndarray) -> np.ndarray:
    """(3,) axis times angle, radians, of a rotation matrix (3, 3); 0 for half a turn, whose axis has no direction."""
    doubled = np.array(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    )
    sine, cosine = np.linalg.norm(doubled) / 2, (np.trace(rotation) - 1) / 2
    return doubled / 2 * (np.arctan2(sine, cosine) / sine) if sine > 1e-12 else np.zeros(3)


def rotation_matrix(vector: np.ndarray) -> np.ndarray:
    """(3, 3), the inverse of `rotation_vector` (Rodrigues' formula)."""
    angle = np.linalg.norm(vector)
    if angle < 1e-15:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([(0, -z, y), (z, 0, -x), (-y, x, 0)])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
