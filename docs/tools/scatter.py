"""A scatter plot as SVG: labeled points over a logarithmic x axis."""

from __future__ import annotations

import math
from dataclasses import dataclass
from html import escape

WIDTH, HEIGHT = 760, 400
_LEFT, _RIGHT, _TOP, _BOTTOM = 40, 20, 30, 44  # margins
_FONT, _LETTER = 12, 7.0  # size of the font, and the mean width of a letter
_STEPS = (1, 2, 5, 10, 20, 50, 100)
_STYLE = (
    "rect { fill: #fff; } text { fill: #222; } line { stroke: #ddd; } @media (prefers-color-scheme: dark)"
    " { rect { fill: #18191b; } text { fill: #e6e6e8; } line { stroke: #34363b; } }"
)
_SIDES = ((9, 4, "start"), (-9, 4, "end"), (0, -10, "middle"), (0, 19, "middle"), (9, 16, "start"), (9, -8, "start"))


@dataclass(frozen=True)
class Point:
    x: float
    y: float
    label: str
    color: str


def scatter(points: list[Point], x_title: str, y_title: str) -> str:
    """Return an SVG document. Points left of 1 stand at 1."""
    most = 10 ** math.ceil(math.log10(max(point.x for point in points)))
    low, high = math.floor(min(p.y for p in points) - 0.5), math.ceil(max(p.y for p in points) + 0.5)

    def place(x: float, y: float) -> tuple[float, float]:
        across, up = math.log(max(x, 1.0)) / math.log(most), (y - low) / (high - low)
        return _LEFT + across * (WIDTH - _LEFT - _RIGHT), HEIGHT - _BOTTOM - up * (HEIGHT - _TOP - _BOTTOM)

    body = [*_axes(place, most, low, high), _text(WIDTH - _RIGHT, HEIGHT - 8, x_title, "end")]
    body.append(_text(6, 14, y_title, "start"))
    taken = [(x - 5, y - 5, x + 5, y + 5) for x, y in (place(p.x, p.y) for p in points)]
    for point in points:
        x, y = place(point.x, point.y)
        body.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="5" fill="{point.color}"/>')
        boxes = [(_box(x + dx, y + dy, point.label, side), (dx, dy, side)) for dx, dy, side in _SIDES]
        box, (dx, dy, side) = min(boxes, key=lambda one: sum(_overlap(one[0], other) for other in taken))
        taken.append(box)
        body.append(_text(x + dx, y + dy, point.label, side))
    size = f'width="{WIDTH}" height="{HEIGHT}" viewBox="0 0 {WIDTH} {HEIGHT}"'
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} font-family="sans-serif" font-size="{_FONT}">',
        f"<style>{_STYLE}</style>",
        '<rect width="100%" height="100%"/>',
    ]
    return "\n".join([*lines, *body, "</svg>\n"])


def _axes(place, most: float, low: int, high: int) -> list[str]:
    found = []
    for exponent in range(round(math.log10(most)) + 1):
        x, bottom = place(10**exponent, low)
        found += [_line(x, _TOP, x, bottom), _text(x, bottom + 16, str(10**exponent) if exponent else "≤ 1", "middle")]
    step = next(step for step in _STEPS if (high - low) / step <= 7)
    for y_value in range(-(-low // step) * step, high + 1, step):
        x, y = place(1, y_value)
        found += [_line(x, y, WIDTH - _RIGHT, y), _text(x - 8, y + 4, str(y_value), "end")]
    return found


def _line(x1: float, y1: float, x2: float, y2: float) -> str:
    return f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"/>'


def _text(x: float, y: float, text: str, anchor: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(text)}</text>'


def _box(x: float, y: float, text: str, anchor: str) -> tuple[float, float, float, float]:
    """Return left, top, right, bottom of a text; outside of the picture counts as taken by `_overlap`."""
    width = len(text) * _LETTER
    left = x - {"start": 0, "middle": width / 2, "end": width}[anchor]
    return left, y - _FONT, left + width, y + 3


def _overlap(a, b) -> float:
    outside = max(0.0, a[2] - WIDTH) + max(0.0, _LEFT - a[0])
    shared = max(0.0, min(a[2], b[2]) - max(a[0], b[0])) * max(0.0, min(a[3], b[3]) - max(a[1], b[1]))
    return shared + 20 * outside
