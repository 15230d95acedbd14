"""Description of an engine's buffers, in words, and what conversion changed in them."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from gffe_cl.captures.sequence.described import described_frame
from gffe_cl.engine.frame.frame_format import FrameFormat
from gffe_cl.engine.frame.rendered_frame import RenderedFrame


def in_words(
    format: FrameFormat | None,
    size: tuple[int, int],
    geometry: tuple[int, int] | None,
    jitter: tuple[float, float],
) -> tuple[str, ...]:
    """Return a line for each property in which buffers differ from our conventions; `size`: width and height of color,
    `geometry`: of depth and motion, None: `size`; `jitter`: of these, pixels. Nothing if they do not differ."""
    said = []
    if geometry and geometry != size:
        said.append(f"depth and motion {geometry[0]}×{geometry[1]}, color {size[0]}×{size[1]}")
    if any(jitter):
        said.append(f"geometry_jitter ({jitter[0]:+.2f}, {jitter[1]:+.2f}) px")
    for field in fields(FrameFormat) if format else ():
        value = getattr(format, field.name)
        if value != field.default and not field.name.endswith("_size"):
            said.append(field.name if value is True else f"{field.name} {_text(value)}")
    return tuple(said)


def _text(value: object) -> str:
    if isinstance(value, tuple):
        return ", ".join(_text(one) for one in value)
    return f"{value:g}" if isinstance(value, float) else str(value)


def changed_motion(stored: RenderedFrame, used: RenderedFrame, format: FrameFormat | None) -> np.ndarray:
    """Return motion in use minus motion as stored, (H, W, 2) float32, pixels of color; 0 without motion."""
    if stored.motion is None or used.motion is None:
        return np.zeros((*used.color.shape[:2], 2), np.float32)
    plain = replace(
        format or FrameFormat(),
        motion_dilated=False,
        motion_jittered=False,
        motion_invalid=None,
        camera_motion="included",
    )
    given = described_frame(stored, plain, None, (0.0, 0.0)).motion
    assert given is not None  # as it is stored
    return np.asarray(used.motion, np.float32) - given
