"""What the host computes for kernels and launches, by the names that `c/gffe_values.c` knows it by.

An exported argument is a constant, a buffer or one of these. Which of them it is gets found out by value: the stages
run with several probes, and an argument is what agrees with it in all of them, so nothing is written down twice but
the formulas themselves; those that no stage uses are not missed, and a new one that is not here stops the export.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from gffe_cl.frame.camera import Camera
from gffe_cl.frame.rendered_frame import OVERLAYS
from gffe_cl.frame.vectors import length
from gffe_cl.opencl.program import constants
from gffe_cl.stages.base import Step
from gffe_cl.stages.buffers import Sizes, level_starts
from gffe_cl.stages.frame_block import (
    MAX_LEVELS,
    MAX_ORDER,
    mapping,
    padded,
    pixel_size,
    polynomial_weights,
    reprojection,
    zoom,
)
from gffe_cl.stages.history import STRIDE
from gffe_cl.stages.mu_law import color_law
from gffe_cl.stages.scene_cuts import SAMPLES
from gffe_cl.stages.shading_trend import REACH_SHARE, reach_of

CAMERAS = ("FRAME", "PREVIOUS", "TARGET_CAMERA", "FRAME_DISPLAY", "PREVIOUS_DISPLAY")
GRIDS = (
    "ONCE", "SOURCE", "TARGET", "DOWNSAMPLED", "SOURCE_BLOCKS", "TARGET_BLOCKS", "CELLS", "NETWORK", "MIP", "LEVEL",
    "LEVELS"
)  # fmt: skip
_HOLES = constants("holes.cl")
MOST_PIXELS = 16384  # each way, of the images that C takes


@dataclass(frozen=True)
class Probe:
    """One set of circumstances in which the stages are asked what they launch."""

    sizes: Sizes
    step: Step
    overlays: tuple[str, ...]  # that the rendered frame brings

    @property
    def cameras(self) -> dict[str, Camera]:
        before = self.step.previous or self.step.frame
        found = (
            self.step.frame.camera,
            before.camera,
            self.step.camera,
            self.step.frame.display_camera,
            before.display_camera,
        )
        return dict(zip(CAMERAS, found, strict=True))


@dataclass(frozen=True)
class Named:
    """A value or a size: what it is called in C, and two small numbers that belong to it, or their names there."""

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


def _interval_ratio(times: list[float]) -> float:
    intervals = -np.diff(times[:3])
    return intervals[0] / intervals[1] if len(intervals) > 1 else 1.0


def _level_starts(probe: Probe, levels: int) -> np.ndarray:
    starts = level_starts(probe.sizes.source, levels)
    return np.array([*starts[1:levels], *[starts[levels]] * MAX_LEVELS][:MAX_LEVELS], np.int32)


def _camera_step(probe: Probe) -> float:
    cameras = probe.cameras
    return length((cameras["FRAME"].position - cameras["PREVIOUS"].position).tolist())


def _polynomial(probe: Probe) -> np.ndarray:
    return padded(polynomial_weights(probe.step.times, probe.step.time, MAX_ORDER))


def values() -> Iterator[tuple[Named, Callable[[Probe], object]]]:
    """Every value that C knows, with what it is in Python."""
    yield Named("GFFE_ALPHA"), lambda probe: probe.step.alpha
    yield Named("GFFE_INTERVAL_RATIO"), lambda probe: _interval_ratio(probe.step.times)
    for order in range(1, MAX_ORDER + 1):
        yield Named("GFFE_ORDER", order), lambda probe, order=order: min(order, len(probe.step.times) - 1)
    yield Named("GFFE_POLYNOMIAL", MAX_ORDER), _polynomial
    yield Named("GFFE_CAMERA_STEP"), _camera_step
    yield Named("GFFE_EXPOSURE"), lambda probe: probe.step.exposure
    yield Named("GFFE_COLOR_LAW"), lambda probe: color_law(probe.step.exposure)
    for least, share in ((8, 48), (16, 10)):  # of movers, of the far side
        value = Named("GFFE_REACH", least, share)
        yield value, lambda probe, least=least, share=share: max(least, probe.sizes.target[0] // share)
    yield Named("GFFE_CELLS_REACH", REACH_SHARE), lambda probe: reach_of(probe.sizes.source[1])
    for number, name in enumerate(OVERLAYS):
        yield Named("GFFE_HAS", number), lambda probe, name=name: int(name in probe.overlays)
    for levels in range(1, MAX_LEVELS + 1):
        yield Named("GFFE_LEVEL_STARTS", levels), lambda probe, levels=levels: _level_starts(probe, levels)
    for grid in _grids():
        for side, code in enumerate(("GFFE_WIDTH", "GFFE_HEIGHT")):
            kind, level = grid_of(grid)
            value = Named(code, f"GFFE_{kind}", level)
            yield value, lambda probe, grid=grid, side=side: probe.sizes.of(grid)[side]
    functions = {"REPROJECTION": reprojection, "ZOOM": zoom, "MAPPING": mapping, "PIXEL_SIZE": pixel_size}
    for name, function in functions.items():
        for a in CAMERAS:
            for b in CAMERAS:
                value = Named(f"GFFE_{name}", f"GFFE_{a}", f"GFFE_{b}")
                yield value, lambda probe, f=function, a=a, b=b: f(probe.cameras[a], probe.cameras[b])


def launch_sizes() -> Iterator[tuple[Named, Callable[[Probe], tuple[int, int]]]]:
    """Every size of a launch, before it is divided by a kernel's step, that C knows."""
    for grid in _grids():
        kind, level = grid_of(grid)
        yield Named("GFFE_WHOLE", f"GFFE_{kind}", level), lambda probe, grid=grid: probe.sizes.of(grid)
    yield (
        Named("GFFE_SAMPLED_SOURCE", STRIDE),
        lambda probe: tuple(-(-n // STRIDE) for n in probe.sizes.source),
    )
    yield Named("GFFE_TILED", _HOLES["TILE"], _HOLES["GROUP"]), _tiled
    yield Named("GFFE_SAMPLED_ROWS", *SAMPLES), lambda probe: (SAMPLES[0], min(probe.sizes.source[1], SAMPLES[1]))


def _tiled(probe: Probe) -> tuple[int, int]:
    width, height = (-(-side // _HOLES["TILE"]) for side in probe.sizes.of("downsampled"))
    return width * _HOLES["GROUP"], height
