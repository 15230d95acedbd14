"""Frame block: the struct of sizes, cameras, times and options that kernels receive in addition to buffers."""

from __future__ import annotations

import math
import operator
from array import array
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from struct import Struct, pack_into
from typing import Any

import numpy as np

from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.rendered_frame import HALF_MAX
from gffe_cl.engine.frame.vectors import length, view_to_view
from gffe_cl.engine.opencl.program import expand, parse_constants, parse_struct
from gffe_cl.engine.options import MAX_LEVELS, Options
from gffe_cl.engine.stages.buffers import DeviceFrame, Sizes

MU = 5000.0
HEADROOM = 8.0  # exposed color that is encoded as 1: three stops above display white


def color_law(exposure: float) -> np.ndarray:
    """Return (4,) float32 for kernels: μ · exposure / 8, 1 / ln(1 + μ), and their reciprocals."""
    gain, log = MU * exposure / HEADROOM, math.log1p(MU)
    return np.array([gain, 1 / log, 1 / gain, log], np.float32)


_SOURCE = expand("frame.h")
FRAME = parse_struct(_SOURCE, "Frame")
MOST_RESTS = parse_constants(_SOURCE)["MOST_RESTS"]
MOST_NUMBER = 2**30  # of rendered frames, after which they are counted from 1 again
_GRIDS = ("source", "target", "network", "cells")
# Where each member is, in words of 4 bytes.
_WORDS = {
    name: slice(member[1] // 4, (member[1] + member[0].itemsize) // 4) for name, member in (FRAME.fields or {}).items()
}
_INTEGERS = {name for name, member in (FRAME.fields or {}).items() if member[0].base.kind == "i"}


def _run(*names: str) -> tuple[Callable[..., None], int]:
    """Return the function that packs numbers into members that lie one after another, and the byte where they begin."""
    assert all(_WORDS[a].stop == _WORDS[b].start for a, b in pairwise(names)), names
    words = (f"{_WORDS[n].stop - _WORDS[n].start}{'i' if n in _INTEGERS else 'f'}" for n in names)
    return Struct("".join(words)).pack_into, 4 * _WORDS[names[0]].start


_BEFORE, _DISPLAYS = _run("to_previous", "from_previous"), _run("to_render", "to_display", "to_previous_display")
_TIMES, _PIXEL = _run("interval_ratio", "exposure", "code_offset", "camera_step"), _run("pixel_size")
_NEW, _ZOOM = _run("to_target", "to_source", "target_to_previous"), _run("zoom")
_LAW, _POLYNOMIAL = _WORDS["color_law"], 4 * _WORDS["polynomial"].start
_STATE = _run("has_previous", "number", "rests", "stays", "coded", "order", "alpha")
_TWO = Struct("2f")


class BlockWriter:
    """Writer of frame blocks for images of `sizes`; `facts`: the members that do not change from frame to frame."""

    def __init__(self, sizes: Sizes, facts: Mapping[str, Any]):
        fixed = np.zeros(1, FRAME)
        for grid in _GRIDS:
            fixed[f"{grid}_width"], fixed[f"{grid}_height"] = sizes.of(grid)
        for name, value in facts.items():
            fixed[name] = value
        self._fixed, self._facts = array("f", fixed.tobytes()), facts
        # The last cameras, other parameters, and what follows from them.
        self._rendered: tuple[tuple[Camera, ...], tuple, array[float]] | None = None
        self._exposed: tuple[float, tuple[array[float], float]] | None = None  # the last one, and what follows from it

    def write(
        self,
        frame: DeviceFrame,
        previous: DeviceFrame | None,
        times: Sequence[float],
        exposure: float,
        camera: Camera | None,
        time: float,
        alpha: float,
        rest: tuple[int, int, bool, bool],
        given: Mapping[str, Any],
    ) -> array[float]:
        """Return the `Frame` of frame.h, as words, of a rendered frame or, with a `camera`, of a new one. Parameters
        are those of `Step`."""
        order = min(self._facts.get("order", 0), len(times) - 1)
        before = previous or frame
        cameras = frame.camera, frame.display_camera, before.camera, before.display_camera
        block = self._of_rendered(cameras, times, exposure)[:]
        put, start = _STATE
        put(block, start, previous is not None, *rest, order, alpha)
        if camera is not None:
            source = frame.camera
            put, start = _NEW
            put(
                block,
                start,
                *_reprojection(source, camera),
                *_reprojection(camera, source),
                *_reprojection(camera, before.camera),
            )
            put, start = _ZOOM
            put(block, start, camera.fx / source.fx, camera.fy / source.fy)
            weights = [weight for row in _polynomial(times[: order + 1], time) for weight in row]
            pack_into(f"{len(weights)}f", block, _POLYNOMIAL, *weights)
        for name, numbers in given.items():
            words = memoryview(block).cast("B").cast("i") if name in _INTEGERS else block
            for k, number in enumerate(numbers if isinstance(numbers, tuple) else (numbers,)):
                words[_WORDS[name].start + k] = number
        return block

    def _of_rendered(self, cameras: tuple[Camera, ...], times: Sequence[float], exposure: float) -> array[float]:
        """Return the block, as words, with what does not depend on the new frame: those of one rendered frame share
        it. `cameras`: of the frame and of the frame before, each with that of its display."""
        others = (*times, exposure)
        if (last := self._rendered) and others == last[1] and all(map(operator.is_, cameras, last[0])):
            return last[2]
        camera, display, camera_before, display_before = cameras
        block = self._fixed[:]
        put, start = _BEFORE
        put(block, start, *_reprojection(camera, camera_before), *_reprojection(camera_before, camera))
        to_render = _mapping(display, camera)
        put, start = _DISPLAYS
        put(block, start, *to_render, *_mapping(camera, display), *_mapping(camera_before, display_before))
        put, start = _PIXEL
        put(
            block, start, *(1 / scale for scale in _TWO.unpack(_TWO.pack(*to_render[:2])))
        )  # scales as kernels have them
        ratio = (times[0] - times[1]) / (times[1] - times[2]) if len(times) > 2 else 1.0
        law, code_offset = self._of_exposure(exposure)
        block[_LAW] = law
        put, start = _TIMES
        put(block, start, ratio, exposure, code_offset, distance(camera, camera_before))
        self._rendered = cameras, others, block
        return block

    def _of_exposure(self, exposure: float) -> tuple[array[float], float]:
        if self._exposed is None or self._exposed[0] != exposure:
            # White is no brighter than the largest half: a brighter one has codes that are no halves.
            code_offset = self._facts.get("code_offset", 0.0) / math.sqrt(max(exposure, 1 / HALF_MAX))
            self._exposed = exposure, (array("f", color_law(exposure)), code_offset)
        return self._exposed[1]


def block_facts(options: Options, sizes: Sizes) -> dict[str, Any]:
    """Return the members of the frame block that are options, and the starts of the background's levels."""
    facts = {name: getattr(options, name) for name in FRAME.names or () if hasattr(options, name)}
    if levels := facts.get("levels", 0):
        starts = sizes.level_starts(levels)
        facts["level_starts"] = [*starts[1:levels], *[starts[levels]] * MAX_LEVELS][:MAX_LEVELS]
    return facts


def reprojection(source: Camera, target: Camera) -> np.ndarray:
    """Return (6, 4) float32, the `Reprojection` of common.h, composed in float64: source view space → target view
    space."""
    return np.array(_reprojection(source, target), np.float32).reshape(6, 4)


def _reprojection(source: Camera, target: Camera) -> tuple[float, ...]:
    row0, row1, row2 = view_to_view(source.rows, source.inverse, target.rows)
    fx, fy, cx, cy = own = source.intrinsics
    return *row0, *row1, *row2, *own, 1 / fx, 1 / fy, cx, cy, *target.intrinsics


def see_alike(a: Camera, b: Camera) -> bool:
    """Return whether two cameras show everything at the same pixels, to the bit."""
    return a is b or (a.intrinsics == b.intrinsics and a.rows == b.rows)


def mapping(a: Camera, b: Camera) -> np.ndarray:
    """Return (4,) float32: scale x, scale y, offset x, offset y from pixels of `a` to pixels of `b`; both have one
    pose."""
    return np.array(_mapping(a, b), np.float32)


def _mapping(a: Camera, b: Camera) -> tuple[float, float, float, float]:
    if a is b:
        return 1.0, 1.0, 0.0, 0.0
    scale_x, scale_y = b.fx / a.fx, b.fy / a.fy
    return scale_x, scale_y, b.cx - scale_x * a.cx, b.cy - scale_y * a.cy


def distance(a: Camera, b: Camera) -> float:
    """Return the distance between the positions of two cameras, world units."""
    (ax, ay, az), (bx, by, bz) = a.inverse[1], b.inverse[1]
    return length((ax - bx, ay - by, az - bz))


def _polynomial(times: Sequence[float], time: float) -> list[list[float]]:
    """Return the Lagrange weights of P_i − P_0 at `time`, for every order that `times` (newest first) allow: a row for
    each order o, i = 1 … o. Order 1 gives −α."""
    nodes = [node - times[0] for node in times]
    rows = []
    for order in range(1, len(times)):
        row = []
        for i in range(1, order + 1):
            others = nodes[:i] + nodes[i + 1 : order + 1]
            row.append(math.prod([(time - times[0] - other) / (nodes[i] - other) for other in others]))
        rows.append(row)
    return rows
