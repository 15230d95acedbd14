"""Hypotheses about motion vectors: sign, axes, unit, and the frames that they connect."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from gffe_cl.captures.doctor.hypotheses.sampling import NEXT, PREVIOUS, Look

_TURNS = {
    (): ((1, 0), (0, 1)),
    ("negated",): ((-1, 0), (0, -1)),
    ("y flipped",): ((1, 0), (0, -1)),
    ("negated", "y flipped"): ((-1, 0), (0, 1)),
    ("x and y swapped",): ((0, 1), (1, 0)),
    ("x and y swapped", "negated"): ((0, -1), (-1, 0)),
    ("x and y swapped", "y flipped"): ((0, 1), (-1, 0)),
    ("x and y swapped", "x flipped"): ((0, -1), (1, 0)),
}
_LEFT = {("x flipped",): ((-1, 0), (0, 1))}  # of two parts, where only the other is repaired
_UNITS = {(): None, ("in UV",): 1.0, ("in NDC",): 0.5}  # pixels of a unit, in image sizes
_FACTORS = {(): 1.0, ("twice too long",): 0.5, ("half as long as they are",): 2.0}
_HELD, _LACKING = ("one frame late", "one frame early"), ("without the camera", "zero")


@dataclass(frozen=True)
class MotionReading:
    """One way to read motion vectors: pixels = `turn` · (stored · unit · factor).

    `parts` names its differences from our convention; `step`: whether they lead to the PREVIOUS or the NEXT frame;
    `held_by`: in which frame's file those of a frame are, counted from it; `adds_camera`: they lack the motion of
    static points.
    """

    parts: tuple[str, ...] = ()
    turn: tuple = ((1, 0), (0, 1))
    unit: float | None = None
    factor: float = 1.0
    unit_first: bool = True
    step: int = PREVIOUS
    held_by: int = 0
    adds_camera: bool = False

    def matrix(self, size: tuple[int, int]) -> np.ndarray:
        """Return the matrix (2, 2) float64 from stored values to pixels, in images of `size`."""
        turn = np.array(self.turn, np.float64)
        scale = np.diag(np.full(2, self.factor) if self.unit is None else np.multiply(size, self.unit * self.factor))
        return turn @ scale if self.unit_first else scale @ turn

    def stored(self, look: Look) -> np.ndarray | None:
        """Return the vectors (N, 2), as stored, of the samples of `look`; None where there are none."""
        holder = look.neighbors.get(self.held_by) if self.held_by else look
        if holder is None or (self.step == PREVIOUS and look.reset):
            return None
        return holder.motion if self.held_by == 0 or len(holder.px) == len(look.px) else None

    def pixels(self, look: Look) -> np.ndarray | None:
        """Return the vectors (N, 2), in pixels, of the samples of `look`; None where there are none, or no frame that
        they lead to."""
        stored = self.stored(look)
        if stored is None or self.step not in look.neighbors:
            return None
        return stored @ self.matrix(look.size).T

    def mirrored(self) -> MotionReading:
        """Return this reading with y reversed."""
        turn = tuple(tuple(row) for row in (np.diag([1, -1]) @ np.array(self.turn)).tolist())
        named = next(parts for parts, other in _TURNS.items() if other == turn)
        turned = next(parts for parts, other in _TURNS.items() if other == self.turn)
        return replace(self, turn=turn, parts=(*named, *(part for part in self.parts if part not in turned)))

    def keeping(self, parts: tuple[str, ...]) -> MotionReading:
        """Return this reading with only those of its parts that are among `parts`."""
        kept = tuple(part for part in self.parts if part in parts)
        if kept == self.parts:
            return self
        pick = {
            name: next((value for key, value in table.items() if key and set(key) <= set(kept)), table[()])
            for name, table in (("unit", _UNITS), ("factor", _FACTORS))
        }
        turned = tuple(part for part in kept if any(part in key for key in _TURNS))
        step = NEXT if "to the next frame" in kept else PREVIOUS
        held_by = self.held_by if any(part in _HELD for part in kept) else 0
        adds = any(part in _LACKING for part in kept)
        pick["unit_first"] = self.unit_first or pick["unit"] is None or "x and y swapped" not in kept
        return replace(
            self, parts=kept, turn=(_TURNS | _LEFT)[turned], step=step, held_by=held_by, adds_camera=adds, **pick
        )


MOTION_AS_GIVEN = MotionReading()


def motion_readings() -> list[MotionReading]:
    """Return all hypotheses to try, the usual one first."""
    found = []
    for (turned, turn), (named, unit), (scaled, factor) in product(_TURNS.items(), _UNITS.items(), _FACTORS.items()):
        parts = turned + named + scaled
        orders = (True, False) if "x and y swapped" in turned and unit else (True,)
        for step, unit_first in product((PREVIOUS, NEXT), orders):
            towards = () if step == PREVIOUS else ("to the next frame",)
            found.append(MotionReading(parts + towards, turn, unit, factor, unit_first, step))
        if len(parts) <= 1 and "x and y swapped" not in parts:
            found.append(MotionReading((*parts, "one frame late"), turn, unit, factor, held_by=NEXT))
            found.append(MotionReading((*parts, "one frame early"), turn, unit, factor, held_by=PREVIOUS))
    return found
