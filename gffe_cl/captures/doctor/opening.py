"""Opening of sequences to examine, including those with camera matrices that need repair first."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from gffe_cl.captures.doctor.findings import Finding, finding
from gffe_cl.captures.formats import open_capture
from gffe_cl.captures.sequence import Sequence, open_sequence
from gffe_cl.engine.core.errors import GffeError

_CAMERAS = ("render_camera", "display_camera")
_LAST = np.array([0.0, 0.0, 0.0, 1.0])
_NEAR = 1e-6
_SAME_SCALE = 1e-3


def open_for_check(path: Path) -> tuple[Sequence, list[Finding]]:
    """Return the sequence, and the faults of its matrices that had to be repaired to open it: written for row
    vectors, or column by column."""
    try:
        return open_capture(path), []
    except GffeError as error:
        findings: list[Finding] = []
        try:
            return open_sequence(path, mend=lambda text: _repaired(text, findings)), findings
        except GffeError:
            raise error from None


def _repaired(text: str, findings: list[Finding]) -> str:
    try:
        document = json.loads(text)
        cameras = [frame[name] for frame in document["frames"] for name in _CAMERAS if frame.get(name)]
        matrices = np.array([camera["world_to_view"] for camera in cameras], np.float64).reshape(-1, 4, 4)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return text
    if not len(matrices) or not np.isfinite(matrices).all():
        return text
    off_last_row, off_last_column = (np.abs(part - _LAST).max() for part in (matrices[:, 3], matrices[:, :, 3]))
    if off_last_column < _NEAR < off_last_row:
        matrices = matrices.swapaxes(1, 2)
        findings.append(finding("camera: transposed"))
    scales = np.linalg.norm(matrices[:, :3, :3], axis=2)
    scale = float(np.median(scales))
    if scale > 0 and abs(scale - 1) > _SAME_SCALE and np.abs(scales / scale - 1).max() < _SAME_SCALE:
        matrices[:, :3] /= scale
        findings.append(finding("camera: scaled", scale=scale))
    for camera, matrix in zip(cameras, matrices, strict=True):
        camera["world_to_view"] = matrix.tolist()
    return json.dumps(document)
