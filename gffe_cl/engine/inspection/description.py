"""Description of an engine's buffers, in words."""

from __future__ import annotations

from dataclasses import fields

from gffe_cl.engine.frame.frame_format import FrameFormat


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
