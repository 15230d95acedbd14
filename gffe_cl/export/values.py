"""Sizes of launches, by the names that `c/gffe_values.c` knows them by.

Which of them a launch has gets found out by value: the stages run with images of several sizes, and a launch's size is
the one that agrees with it in all of them; a new one that is not here stops the export.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from gffe_cl.opencl.program import constants
from gffe_cl.stages.buffers import Sizes
from gffe_cl.stages.frame_block import (
    MAX_LEVELS,
)
from gffe_cl.stages.history import STRIDE
from gffe_cl.stages.scene_cuts import SAMPLES

GRIDS = (
    "ONCE", "SOURCE", "TARGET", "DOWNSAMPLED", "SOURCE_BLOCKS", "TARGET_BLOCKS", "CELLS", "NETWORK", "MIP", "LEVEL",
    "LEVELS"
)  # fmt: skip
_HOLES = constants("holes.cl")
MOST_PIXELS = 16384  # each way, of the images that C takes


@dataclass(frozen=True)
class Named:
    """A size: what it is called in C, and two small numbers that belong to it, or their names there."""

    code: str
    a: int | str = 0
    b: int | str = 0


def grid_of(name: str) -> tuple[str, int]:
    """The C name of a grid of `BufferSpec`, and its level or number of levels. KeyError if C does not know it."""
    for kind in ("levels", "level", "mip"):
        if name.startswith(kind):
            return kind.upper(), int(name.removeprefix(kind))
    if name.upper() not in GRIDS:
        raise KeyError(name)
    return name.upper(), 0


def _grids() -> Iterator[str]:
    yield from (grid.lower() for grid in GRIDS[:-3])
    yield from (f"mip{n}" for n in range(1, (MOST_PIXELS - 1).bit_length() + 1))
    yield from (f"level{n}" for n in range(MAX_LEVELS + 1))
    yield from (f"levels{n}" for n in range(1, MAX_LEVELS + 1))


def launch_sizes() -> Iterator[tuple[Named, Callable[[Sizes], tuple[int, int]]]]:
    """Every size of a launch, before it is divided by a kernel's step, that C knows."""
    for grid in _grids():
        kind, level = grid_of(grid)
        yield Named("GFFE_WHOLE", f"GFFE_{kind}", level), lambda sizes, grid=grid: sizes.of(grid)
    yield (
        Named("GFFE_SAMPLED_SOURCE", STRIDE),
        lambda sizes: tuple(-(-n // STRIDE) for n in sizes.source),
    )
    yield Named("GFFE_TILED", _HOLES["TILE"], _HOLES["GROUP"]), _tiled
    yield Named("GFFE_SAMPLED_ROWS", *SAMPLES), lambda sizes: (SAMPLES[0], min(sizes.source[1], SAMPLES[1]))


def _tiled(sizes: Sizes) -> tuple[int, int]:
    width, height = (-(-side // _HOLES["TILE"]) for side in sizes.of("downsampled"))
    return width * _HOLES["GROUP"], height
