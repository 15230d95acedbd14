"""Legends under saved pictures, which explain the colors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .colors import color_table, wheel_color
from .legends import Legend

_GROUND, _INK, _DIM = (28, 28, 30), (232, 232, 234), (160, 160, 166)
_LEAST = 200  # pixels: narrower pictures get as wide
_LETTERS = 13  # pixels, of pictures as wide as ...
_USUAL = 480
_LARGEST = 4.0


@dataclass(frozen=True)
class Entry:
    """One legend: its `title`, and of a ramp the name of its color map."""

    title: str
    legend: Legend
    color_map: str = ""


def with_legends(rgba: np.ndarray, entries: list[Entry]) -> np.ndarray:
    """Return `rgba` (H, W, 4) uint8 with a strip under it that shows `entries`; without any, the same picture."""
    if not entries:
        return rgba
    from PIL import Image, ImageDraw, ImageFont

    height, width = rgba.shape[:2]
    whole = max(width, _LEAST)
    scale = min(max(whole / _USUAL, 0.85), _LARGEST)
    pen = _Pen(ImageFont.load_default(_LETTERS * scale), whole, scale)
    for entry in entries:
        pen.write(ImageDraw.Draw(Image.new("RGB", (1, 1))), entry)  # to see how high it gets
    strip = Image.new("RGB", (whole, pen.bottom), _GROUND)
    pen.start()
    for entry in entries:
        pen.write(ImageDraw.Draw(strip), entry, strip)
    out = np.zeros((height + strip.height, whole, 4), np.uint8)
    out[...] = (*_GROUND, 255)
    out[:height, :width] = rgba
    out[height:, :, :3] = np.asarray(strip)
    return out


class _Pen:
    """Writes legends below each other."""

    def __init__(self, font, width: int, scale: float):
        self._font, self._width = font, width
        self._gap, self._line = round(6 * scale), round(18 * scale)
        self.start()

    def start(self) -> None:
        self._y = self._gap

    @property
    def bottom(self) -> int:
        return self._y + self._gap // 2

    def write(self, draw, entry: Entry, image=None) -> None:
        """Write a legend under those before. Without an `image` only the room is taken that it needs."""
        legend = entry.legend
        words = [entry.title, *filter(None, [legend.unit])]
        together = "   ".join(words)
        fits = self._gap + draw.textlength(_plain(together), self._font) <= self._width
        for text in [together] if fits else [line for word in words for line in self._wrapped(draw, word)]:
            self._text(draw, self._gap, text, _INK, image)
            self._y += self._line
        if legend.kind == "ramp":
            self._ramp(draw, legend, entry.color_map, image)
        elif legend.kind == "wheel":
            self._wheel(draw, legend, image)
        if legend.labels:
            self._swatches(draw, legend.labels, image)
        self._y += self._gap

    def _wrapped(self, draw, text: str) -> list[str]:
        """Return the lines of a text that is broken between words where it is too wide."""
        lines = [""]
        for word in text.split(" "):
            longer = f"{lines[-1]} {word}" if lines[-1] else word
            if lines[-1] and self._gap + draw.textlength(_plain(longer), self._font) > self._width:
                lines.append(word)
            else:
                lines[-1] = longer
        return [line for line in lines if line]

    def _text(self, draw, x: float, text: str, color, image) -> None:
        if image is not None:
            draw.text((x, self._y), _plain(text), color, self._font)

    def _ramp(self, draw, legend: Legend, color_map: str, image) -> None:
        left, right, high = self._gap, self._width - self._gap, max(self._line * 2 // 3, 4)
        if image is not None:
            shown = np.linspace(0, 255, right - left).round().astype(int)
            bar = np.repeat(np.round(255 * color_table(color_map)[shown]).astype(np.uint8)[None], high, 0)
            image.paste(_image(bar), (left, self._y))
        self._y += high + self._gap // 2
        taken: list[tuple[float, float]] = []
        for position, text, _ in (legend.ticks[0], legend.ticks[-1], *legend.ticks[1:-1]):
            wide = draw.textlength(text, self._font)
            x = min(max(left + position * (right - left) - wide / 2, left), right - wide)
            if all(x > end + self._gap or x + wide < start - self._gap for start, end in taken):
                taken.append((x, x + wide))
                self._text(draw, x, text, _DIM, image)
        self._y += self._line

    def _wheel(self, draw, legend: Legend, image) -> None:
        radius = round(1.6 * self._line)
        left = self._gap
        if image is not None:
            y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]
            turns, length = np.arctan2(y, x) / (2 * np.pi) % 1, np.hypot(x, y) / radius
            disc = np.full((*x.shape, 3), _GROUND, np.uint8)
            for at in np.argwhere(length <= 1):
                color = wheel_color(float(turns[tuple(at)]), float(length[tuple(at)]))
                disc[tuple(at)] = np.round(255 * np.array(color))
            image.paste(_image(disc), (left, self._y))
            x = left + 2 * radius + 2 * self._gap
            sides = ("to the right", "down", "to the left", "up")
            top = self._y
            for turn, side in enumerate(sides):
                self._y = top + turn * self._line * 7 // 8
                size = self._line // 2
                color = tuple(round(255 * c) for c in wheel_color(turn / 4, 1.0))
                draw.rectangle((x, self._y + size // 3, x + size, self._y + size // 3 + size), color)
                self._text(draw, x + size + self._gap, side, _DIM, image)
            self._y = top
        self._y += max(2 * radius, 4 * self._line * 7 // 8) + self._gap // 2

    def _swatches(self, draw, labels, image) -> None:
        size, x = self._line * 2 // 3, self._gap
        for text, color in labels:
            wide = size + self._gap + draw.textlength(text, self._font) + 2 * self._gap
            if x > self._gap and x + wide > self._width:
                x, self._y = self._gap, self._y + self._line
            if image is not None:
                fill = tuple(round(255 * c) for c in color)
                draw.rectangle((x, self._y + 1, x + size, self._y + 1 + size), fill, _DIM)
                self._text(draw, x + size + self._gap, text, _DIM, image)
            x += wide
        self._y += self._line


def _plain(text: str) -> str:
    """Return the text in letters that the font has."""
    return text.replace("−", "-").replace("×", "x").replace("–", "-")


def _image(rgb: np.ndarray):
    from PIL import Image

    return Image.fromarray(np.ascontiguousarray(rgb))
