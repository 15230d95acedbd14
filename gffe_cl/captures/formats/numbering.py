"""Numbers of frames in file names: a frame is identified by its number, not by its place in a list."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from gffe_cl.captures.sequence.description import FrameEntry
from gffe_cl.engine.core.errors import GffeError

# The last number of a name is the frame's. A minus is its sign unless it stands after a letter or digit: Shot-0001.
_NUMBER = re.compile(r"(?:(?<![^\W_])-)?\d+")
_MOST_DIGITS, _MOST_NAMED = 18, 6
_LATE = 1.5  # intervals: frames that are farther apart have one missing between them


def numbered_files(folder: Path, pattern: str) -> dict[int, Path]:
    """Return the files in `folder` whose names fit `pattern`, such as "frame_*.png", by their frames' numbers in
    ascending order. The case of letters is ignored, and so are hidden files.

    `*` is the number and other words before it; where the pattern has text behind `*`, names end with it. Raises
    GffeError for names without number and for two files of one number.
    """
    before, _, after = pattern.partition("*")
    fits = re.compile(f"{re.escape(before)}(.*){re.escape(after)}", re.IGNORECASE | re.DOTALL)
    found: dict[int, Path] = {}
    for path in visible_files(folder):
        match = fits.fullmatch(path.name)
        if match is None:
            continue
        number = number_of(match[1])
        if number is None:
            example = pattern.replace("*", "0001")
            raise GffeError(f"{path.name}: no frame number in the name (expected one, as in {example})")
        if number in found:
            raise GffeError(f"{path.name}: frame {number} like {found[number].name} (expected one file for a frame)")
        found[number] = path
    return dict(sorted(found.items()))


def visible_files(folder: Path, ending: str = "") -> list[Path]:
    """Return the files in `folder` with this `ending`, whatever the case of its letters, that are not hidden."""
    try:
        found = sorted(folder.iterdir())
    except FileNotFoundError:
        return []
    return [path for path in found if not path.name.startswith(".") and path.name.lower().endswith(ending)]


def with_ending(path: Path) -> Path:
    """Return `path`, or where there is no such file, the one whose ending is in capital letters, or in small ones."""
    if os.path.lexists(path):
        return path
    endings = path.suffix.upper(), path.suffix.lower()
    return next((other for ending in endings if os.path.lexists(other := path.with_suffix(ending))), path)


def number_of(text: str) -> int | None:
    """Return the last number in `text`, which may be negative; None if there is none."""
    found = _NUMBER.findall(text)
    return int(found[-1][:_MOST_DIGITS]) if found else None


def missing_numbers(pairs: Iterable[tuple[int, int]], step: int = 1) -> str | None:
    """Return a sentence about the numbers that are missing between `pairs` of successive ones; None if there are
    none."""
    ranges = []
    for before, number in pairs:
        first, last = before + step, number - step
        if first <= last:
            ranges.append(f"{first}" if last == first else f"{first} to {last}")
    if not ranges:
        return None
    named = ", ".join(ranges[:_MOST_NAMED]) + (", …" if len(ranges) > _MOST_NAMED else "")
    words = f"frame {named} is" if len(ranges) == 1 and " " not in named else f"frames {named} are"
    return f"{words} missing: the next frame is a reset"


def mark_gaps(frames: list[tuple[int, FrameEntry]]) -> str | None:
    """Make resets of the rendered `frames`, given with their numbers in order of time, that follow a gap: both their
    number and their time are more than the usual step after the frame before. Return a sentence about the gaps, None if
    there are none."""
    rendered = [one for one in frames if one[1].kind == "rendered"]
    pairs = list(zip(rendered, rendered[1:], strict=False))
    steps = [after[0] - before[0] for before, after in pairs]
    if len(steps) < 2 or min(steps) <= 0:
        return None
    usual = max(set(steps), key=lambda step: (steps.count(step), -step))
    interval = np.median([b[1].time - a[1].time for a, b in pairs if b[0] - a[0] == usual])
    gaps = []
    for before, (number, entry) in pairs:
        late = entry.time - before[1].time > _LATE * interval
        if number - before[0] > usual and late and not entry.reset:
            entry.reset = True
            gaps.append((before[0], number))
    return missing_numbers(gaps, usual)


def lines_of(table: np.ndarray, numbers: Sequence[int], first: int, name: str) -> list[np.ndarray]:
    """Return the lines of a `table` for frames with these `numbers`: its first line is that of the number `first`.

    Where the numbers leave that range the lines are those of the frames in order, if nothing is missing. Otherwise it
    raises a GffeError that begins with `name`.
    """
    if numbers[0] >= first and numbers[-1] - first < len(table):
        return [table[number - first] for number in numbers]
    if len(table) == len(numbers) == numbers[-1] - numbers[0] + 1:
        return list(table)
    raise GffeError(
        f"{name}: {len(table)} lines for frames {numbers[0]} to {numbers[-1]} (expected a line for each number from"
        f" {first} on, or as many lines as frames and no missing numbers)"
    )
