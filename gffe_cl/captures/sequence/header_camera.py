"""Cameras in OpenEXR headers: the standard attributes `worldToCamera` and `worldToNDC`.

OpenEXR's semantics: camera space is left-handed, x right, y up, z forward; in NDC the upper left corner of
the display window is (0, 0), the lower right one (1, 1); vectors are rows, v·M. Some writers transpose.
"""

from __future__ import annotations

import numpy as np

from gffe_cl.captures.sequence.exr_layout import ExrPart
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.camera import Camera

_FLIP_Y = np.diag([1.0, -1.0, 1.0, 1.0])
_NAMES = ("worldToCamera", "worldToNDC")
_TOLERANCE = 1e-3


def camera_attributes(camera: Camera, width: int, height: int) -> dict[str, np.ndarray]:
    """Return the header attributes of `camera` for a display window of `width` × `height` pixels: (4, 4) float32, v·M.

    NDC depth is 1 − 1/z (z in world units); the standard leaves it open.
    """
    projection = np.array(
        [
            [camera.fx / width, 0, camera.cx / width, 0],
            [0, camera.fy / height, camera.cy / height, 0],
            [0, 0, 1, -1],
            [0, 0, 1, 0],
        ]
    )
    matrices = (_FLIP_Y @ camera.world_to_view, projection @ camera.world_to_view)
    return {name: np.ascontiguousarray(m.T, np.float32) for name, m in zip(_NAMES, matrices, strict=True)}


def has_camera(part: ExrPart) -> bool:
    return all(name in part.matrices for name in _NAMES)


def header_cameras(part: ExrPart) -> tuple[Camera, Camera]:
    """Return (render camera, display camera) of a part with both attributes, in pixels of its data window and of its
    display window; the data window may be larger (overscan) or lie elsewhere.

    Raises GffeError if the matrices are not finite, singular or do not belong together.
    """
    stored = [part.matrices[name] for name in _NAMES]
    if not all(np.isfinite(m).all() for m in stored):
        raise GffeError("camera: worldToCamera and worldToNDC must be finite")
    fits = [_decompose(*matrices) for matrices in ([m.T for m in stored], stored)]
    residual, world_to_view, projection = min(fits, key=lambda fit: fit[0])
    if residual > _TOLERANCE:
        Camera(_FLIP_Y @ stored[0].T, 1, 1, 0, 0)  # raises for a singular pose
        raise GffeError(
            "camera: worldToNDC is no pinhole projection of worldToCamera"
            " (expected OpenEXR's: z forward, y up, NDC (0, 0) at the upper left)"
        )
    (width, height), (left, top) = part.shown_size, part.offset
    display = Camera(
        world_to_view,
        projection[0, 0] * width,
        projection[1, 1] * height,
        projection[0, 2] * width,
        projection[1, 2] * height,
    )
    render = Camera(world_to_view, display.fx, display.fy, display.cx - left, display.cy - top)
    return render, display


def _decompose(world_to_camera, world_to_ndc):
    """Return (how far from a pinhole, world_to_view, (3, 3) projection to NDC) of column-vector matrices."""
    world_to_view = _FLIP_Y @ world_to_camera
    left, scale, right = np.linalg.svd(world_to_view[:3, :3])
    if np.abs(world_to_view[3] - (0, 0, 0, 1)).max() > 1e-5 or np.abs(scale - 1).max() > 1e-2:
        return np.inf, world_to_view, np.eye(3)
    world_to_view[:3, :3] = left @ right  # float32 leaves it a little off
    world_to_view[3] = (0, 0, 0, 1)
    to_ndc = world_to_ndc[[0, 1, 3]]
    projection = to_ndc[:, :3] @ world_to_view[:3, :3].T  # up to a factor
    if not (projection[2, 2] > 0 and projection[0, 0] and projection[1, 1]):
        return np.inf, world_to_view, projection
    offset = to_ndc[:, 3] - projection @ world_to_view[:3, 3]
    reach = np.abs(projection) @ (1 + np.abs(world_to_view[:3, 3]))
    skew = (projection[0, 1] / projection[0, 0], projection[1, 0] / projection[1, 1])
    skew += tuple(projection[2, :2] / projection[2, 2])
    residual = max(np.abs(skew).max(), (np.abs(offset) / reach).max())
    return residual, world_to_view, projection / projection[2, 2]
