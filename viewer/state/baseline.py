"""Baselines: figures of frames that were stored, as B beside those of the present settings."""

from __future__ import annotations

import json
import math
from bisect import bisect_left
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gffe_cl.engine.core.errors import GffeError, printable
from gffe_cl.engine.core.files import read_bounded
from ..engine.figures import QUANTITIES, REGIONS, Figures, Part
from .playback import Playback

_MOST_BYTES = 64 << 20  # of a file
_SAME_TIME = 0.02  # intervals of rendered frames by which times differ at most, as `gffe compare` has it


def document_of(figures: Mapping[int, Figures], counted: Iterable[int], playback: Playback) -> dict[str, Any]:
    """Return the figures of slots as plain JSON, in the form of `gffe compare --json`: "mean", over the `counted`
    slots, and "frames", each with its time, values, and shares of the regions."""
    counted, known = set(counted), {name for of in figures.values() for name in of.values}
    frames: list[dict[str, Any]] = [
        {"time": playback.time_of(slot)}
        | {name: float(value) for name, value in of.values.items() if math.isfinite(value)}
        | {"counted": slot in counted}
        | {"regions": {name: {"pixels": part.pixels, "squared": part.squared} for name, part in of.parts.items()}}
        for slot, of in sorted(figures.items())
        if of.values
    ]
    values = {name: [frame[name] for frame in frames if frame["counted"] and name in frame] for name in sorted(known)}
    return {"mean": {name: float(np.mean(of)) for name, of in values.items() if of}, "frames": frames}


@dataclass(frozen=True)
class Baseline:
    """Figures by the time of their frame, seconds, in order; `name`: of the file."""

    name: str
    frames: tuple[tuple[float, Figures], ...]

    @classmethod
    def load(cls, path: Path) -> Baseline:
        """Return what the viewer or `gffe compare --json` wrote. Raises GffeError for another file."""
        try:
            document = json.loads(read_bounded(path, _MOST_BYTES))
            frames = [(_number(frame["time"]), _figures(frame)) for frame in document["frames"]]
        except OSError as error:
            raise GffeError(f"{path}: {error.strerror or error}") from None
        except (KeyError, TypeError, ValueError, AttributeError, RecursionError):
            raise GffeError(f"{path}: no stored figures (expected those of the viewer or of gffe compare)") from None
        return cls(printable(path.name), tuple(sorted(frames, key=lambda frame: frame[0])))

    def by_slot(self, playback: Playback) -> dict[int, Figures]:
        """Return the figures of the generated slots that are at the times of stored frames."""
        times, near, found = [time for time, _ in self.frames], _SAME_TIME / playback.fps, {}
        for slot in range(playback.slots):
            time = playback.time_of(slot)
            at = bisect_left(times, time - near)
            if slot % (playback.n + 1) and at < len(times) and times[at] <= time + near:
                found[slot] = self.frames[at][1]
        return found


def _number(value: Any) -> float:
    """Return a finite number. Raises ValueError for anything else."""
    if type(value) not in (int, float) or not math.isfinite(value):
        raise ValueError
    return float(value)


def _figures(frame: dict[str, Any]) -> Figures:
    """Return the figures of a stored frame. Raises an exception of one of several types if it is damaged."""
    values = {name: _number(frame[name]) for name in QUANTITIES if frame.get(name) is not None}
    stored = frame.get("regions") or {}
    if not stored:
        return Figures(values)
    shares = {name: (_number(stored[name]["pixels"]), _number(stored[name]["squared"])) for name in REGIONS}
    whole = sum(squared for _, squared in shares.values())
    return Figures(values, {name: Part.of(pixels, squared, whole) for name, (pixels, squared) in shares.items()})
