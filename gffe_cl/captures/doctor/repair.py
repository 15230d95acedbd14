"""Repair of sequences (`gffe check --fix`): the sequence with the doctor's reading applied."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from gffe_cl.captures.doctor.diagnose import Diagnosis
from gffe_cl.captures.doctor.hypotheses.depths import (
    AS_GIVEN,
    DEVICE,
    PLANAR,
    RANGE,
    DepthReading,
    Planes,
    misread_range,
    rays,
)
from gffe_cl.captures.doctor.hypotheses.motions import MotionReading
from gffe_cl.captures.doctor.hypotheses.sampling import NEXT, Clip, is_long
from gffe_cl.captures.doctor.hypotheses.scoring import ResidualChange, Vectors
from gffe_cl.captures.doctor.hypotheses.search import Reading
from gffe_cl.captures.doctor.hypotheses.transfer_function import srgb_to_linear
from gffe_cl.captures.doctor.mends import mended
from gffe_cl.captures.sequence import FrameEntry, Sequence, SequenceWriter, named_channels, refuse_same_folder
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.rendered_frame import RenderedFrame

_KEPT = 3  # frames in memory as they are given
_FAR = 1e9  # stands for infinity where directions are reprojected
_OWN = 0.25  # pixels: samples that move by less than this, apart from the camera's motion, are static
_ONE_SURFACE = 0.1  # relative difference of depths
_USUAL_DEPTH = 5.0  # world units: of two units that are both consistent, the one with depths nearer to this is chosen
_REFUSED = "nothing is written (expected fewer findings to repair: --only or --except)"
_COMPARED = 20_000  # pixels of a frame in which residuals are compared
_TOLERANCES = ((1, 3e-3), (2, 1e-3), (3, 3e-4))  # significant digits to which parameters are rounded, if so near


class Repair:
    """Frames of `clip` with the mends and the reading of `diagnosis` applied, in their correct order and without those
    that were recorded twice."""

    def __init__(self, clip: Clip, diagnosis: Diagnosis):
        given = {entry.file: entry for entry in clip.rendered}
        self._read_given = lru_cache(_KEPT)(lambda file: clip.read(given[file]))
        self._clip = made = mended(clip, diagnosis.mends)
        self._reading, self._diagnosis = diagnosis.reading, diagnosis
        self._read = lru_cache(_KEPT)(lambda index: made.read(made.rendered[index]))
        self._rows = diagnosis.reading.rows
        self._cuts = {f.figures["frame"] for f in diagnosis.faults if f.name in ("cut", "gap")}
        self._comparisons: list[tuple[str, ResidualChange]] = []  # of the frames so far
        self._sky = any(f.name == "sky without motion" for f in diagnosis.findings)
        count = len(made.rendered)
        self._order = (diagnosis.order and diagnosis.order.order) or list(range(count))
        self._stored = np.concatenate([look.depth[look.solid] for look in diagnosis.looks] or [np.zeros(0)])
        self._depth, self._translation, self._far_end = _units(diagnosis.reading.depth, self._stored)

    def frames(self) -> Iterator[tuple[FrameEntry, RenderedFrame]]:
        """Yield entries with their new cameras and times, and the frames. Only one frame and its neighbors are in
        memory."""
        entries = self._clip.rendered
        times = sorted(entries[index].time for index in self._order)
        before: RenderedFrame | None = None
        for place, index in enumerate(self._order):
            entry, time = entries[index], times[place]
            reset = place == 0 or index in self._cuts or (entry.reset and index != 0)
            frame = self._geometry(index, time, reset)
            made = self._with_motion(frame, index, self._order[place - 1], None if reset else before)
            cameras = {"render_camera": made.camera, "display_camera": made.shown_camera}
            self._compare(index, made, None if reset else before)
            yield replace(entry, time=time, reset=reset, **cameras), made
            before = made

    def refuse_harm(self) -> None:
        """Raise GffeError if a repaired frame fits worse than as given. After a whole repair of vectors, depth or
        cameras, raise it also if most of the frames that are evidence do not fit better. A selection by the user is not
        judged."""
        best = self._diagnosis.best
        if best is not None and best.reading != self._reading:
            return
        for file, one in self._comparisons:
            if one.is_worse:
                off = f"vectors would be {one.read:.3g} px off, as given they are {one.given:.3g} px off"
                raise GffeError(f"the repair would make {file} worse: {off}; {_REFUSED}")
        better = sum(one.is_better for _, one in self._comparisons)
        changes = any(mend.changes_geometry for mend in self._diagnosis.mends)
        changes |= replace(self._reading, rows=tuple(row for row in self._rows if row != "color")) != Reading()
        if changes and self._comparisons and 2 * better <= len(self._comparisons):
            counts = f"{better} of the {len(self._comparisons)} frames that can tell"
            raise GffeError(f"the repair is not clearly better: only {counts} fit better by it; {_REFUSED}")

    def _compare(self, index: int, made: RenderedFrame, before: RenderedFrame | None) -> None:
        if before is None or index == 0 or made.motion is None:
            return
        entries = self._clip.rendered
        given_before, given = (self._read_given(entries[k].file) for k in (index - 1, index))
        if given.reset or given.motion is None or np.shape(given_before.depth) != np.shape(given.depth):
            return
        height, width = np.shape(given.depth)
        every = max(1, round(np.sqrt(height * width / _COMPARED)))

        def vectors(frame: RenderedFrame, other: Camera) -> Vectors:
            motion = np.asarray(frame.motion, np.float64)[::every, ::every].reshape(-1, 2)
            motion = np.where(is_long(motion, (width, height))[:, None], np.nan, motion)
            return motion, static_motion(frame, other, every).reshape(-1, 2)

        pairs = vectors(given, given_before.camera), vectors(made, before.camera)
        solid = np.isfinite(given.depth) & np.isfinite(made.depth) & (np.abs(made.depth) < _FAR)
        compared = ResidualChange.of(*pairs, solid[::every, ::every].ravel(), self._diagnosis.step)
        if compared is not None:
            self._comparisons.append((entries[index].file, compared))

    def camera(self, camera: Camera) -> Camera:
        """Return the repaired camera of the given one."""
        read = self._reading.camera.read(camera)
        if self._translation == 1:
            return read
        matrix = read.world_to_view.copy()
        matrix[:3, 3] *= self._translation
        return replace(read, world_to_view=matrix)

    def color(self, color: np.ndarray) -> np.ndarray:
        """Return the repaired color."""
        color = self._turned("color", np.asarray(color))
        return srgb_to_linear(color) if self._diagnosis.decodes_color else color

    def _turned(self, buffer: str, image: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(image[::-1]) if buffer in self._rows else image

    def _geometry(self, index: int, time: float, reset: bool) -> RenderedFrame:
        frame = self._read(index)
        display = frame.display_camera and self.camera(frame.display_camera)
        camera = self.camera(frame.camera)
        depth = self._planar(self._turned("depth", np.asarray(frame.depth)), camera)
        color = self.color(frame.color)
        return replace(frame, color=color, depth=depth, camera=camera, display_camera=display, time=time, reset=reset)

    def _planar(self, stored: np.ndarray, camera: Camera) -> np.ndarray:
        if self._depth == AS_GIVEN:
            return stored
        height, width = stored.shape
        y, x = np.mgrid[:height, :width] + 0.5
        flat = stored.astype(np.float64).ravel()
        w = self._depth.inverse(flat, rays(camera, np.stack([x.ravel(), y.ravel()], -1)))
        if self._depth.model is DEVICE or self._depth.model.added is not None:
            w[flat == self._far_end] = 0
        with np.errstate(divide="ignore", invalid="ignore"):
            z = np.where(w > 0, 1 / w, np.where(np.isnan(w), np.nan, np.inf))
        return z.reshape(height, width).astype(np.float32)

    def _with_motion(
        self, frame: RenderedFrame, index: int, index_before: int, before: RenderedFrame | None
    ) -> RenderedFrame:
        if before is None:
            return frame
        reading: MotionReading = self._reading.motion
        static = static_motion(frame, before.camera)
        if reading.step == NEXT:
            motion = self._from_the_one_before(index_before, static, frame, before)
        else:
            motion = self._converted(index + reading.held_by, static.shape)
            motion = static if motion is None else motion
            motion = motion + static if reading.adds_camera else motion
        if self._reading.jitter:
            offset = _common(motion - static, frame.depth)
            if self._reading.jitter == "motion":
                motion = motion - offset
            else:
                frame = _jittered(frame, offset)
        if self._sky:
            motion = np.where(np.isinf(frame.depth)[..., None], static, motion)
        return replace(frame, motion=np.asarray(motion, np.float32))

    def _converted(self, index: int, shape: tuple[int, ...]) -> np.ndarray | None:
        """Return the vectors (H, W, 2) float64 in the file of the frame `index`, pixels; None where there are none."""
        if not 0 <= index < len(self._clip.rendered):
            return None
        stored = self._read(index).motion
        if stored is None or np.shape(stored) != shape:
            return None
        height, width = shape[:2]
        return self._turned("motion", np.asarray(stored, np.float64)) @ self._reading.motion.matrix((width, height)).T

    def _from_the_one_before(self, index_before, static, frame, before) -> np.ndarray:
        """Return vectors made from those of the frame before, which lead here: reversed where something moves, static
        elsewhere."""
        forward = self._converted(index_before, static.shape)
        if forward is None:
            return static
        own = np.linalg.norm(forward - static_motion(before, frame.camera), axis=-1) > _OWN
        return _turned_round(forward, own, before.depth, frame.depth, static)


def _jittered(frame: RenderedFrame, offset: np.ndarray) -> RenderedFrame:
    """Return the frame with its jitter in the camera; `offset` is that of its vectors from motion to the frame before,
    whose camera is jittered already."""
    c = frame.camera
    return replace(frame, camera=replace(c, cx=c.cx - offset[0], cy=c.cy - offset[1]))


def static_motion(frame: RenderedFrame, other: Camera, every: int = 1) -> np.ndarray:
    """Return the motion (H, W, 2) float64, pixels: where everything would be seen by `other` if nothing moved, minus
    where it is. It has one of `every` pixels of a row, and one of `every` rows."""
    height, width = frame.depth.shape
    y, x = np.mgrid[:height:every, :width:every] + 0.5
    px = np.stack([x, y], -1)
    depth = np.asarray(frame.depth, np.float64)[::every, ::every]
    with np.errstate(all="ignore"):
        depth = np.where((depth > 0) & (depth < _FAR), depth, _FAR)
        return other.project(frame.camera.unproject(px, depth))[0] - px


def _turned_round(forward, own, depth_before, depth, static) -> np.ndarray:
    """Return `static` with −`forward` (H, W, 2) where the pixels `own` (H, W) of the frame before land on their own
    surface; the nearest one wins, and gaps of a pixel are closed."""
    height, width = depth.shape
    y, x = np.nonzero(own & np.isfinite(forward).all(-1))
    to_x = np.floor(x + 0.5 + forward[y, x, 0]).astype(int)
    to_y = np.floor(y + 0.5 + forward[y, x, 1]).astype(int)
    inside = (to_x >= 0) & (to_x < width) & (to_y >= 0) & (to_y < height)
    x, y, to_x, to_y = x[inside], y[inside], to_x[inside], to_y[inside]
    with np.errstate(invalid="ignore"):
        same = np.abs(depth[to_y, to_x] - depth_before[y, x]) < _ONE_SURFACE * depth_before[y, x]
    far_first = np.argsort(-depth_before[y, x][same], kind="stable")
    x, y, to_x, to_y = (values[same][far_first] for values in (x, y, to_x, to_y))
    made, hit = static.copy(), np.zeros((height, width), bool)
    made[to_y, to_x] = -forward[y, x]
    hit[to_y, to_x] = True
    padded, padded_hit = np.pad(made, ((1, 1), (1, 1), (0, 0))), np.pad(hit, 1).astype(float)
    shifts = [(dy, dx) for dy in range(3) for dx in range(3) if (dy, dx) != (1, 1)]
    count = sum((padded_hit[dy : dy + height, dx : dx + width] for dy, dx in shifts), np.zeros(hit.shape))
    weighted = padded * padded_hit[..., None]
    total = sum((weighted[dy : dy + height, dx : dx + width] for dy, dx in shifts), np.zeros(made.shape))
    gap = ~hit & (count >= 5)
    made[gap] = total[gap] / count[gap][:, None]
    return made


def _common(off: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Return the common offset (2,) of most of `off` (H, W, 2)."""
    values = off[np.isfinite(depth) & np.isfinite(off).all(-1)]
    if not len(values):
        return np.zeros(2)
    values = values[:: max(1, len(values) // 20000)]
    center = np.median(values, 0)
    for _ in range(12):
        apart = ((values - center) ** 2).sum(-1)
        weight = 1 / (1 + apart / max(float(np.quantile(apart, 0.3)), 1e-10)) ** 2
        center = weight @ values / weight.sum()
    return center


def _units(depth: DepthReading, stored: np.ndarray) -> tuple[DepthReading, float, float]:
    """Return the depth's parameters, rounded to nearby round numbers; the factor on translations; and the stored
    value of sky. `stored`: some of the depths."""
    if depth.model.added is not None:
        return depth, 1.0, 1.0 if depth.coefficients[1] > 0 else 0.0
    if depth.model is DEVICE:
        planes = Planes.of(depth, stored)
        far = planes.far if np.isinf(planes.far) else _rounded(planes.far)
        planes = replace(planes, near=_rounded(planes.near), far=far)
        return planes.reading(), 1.0, planes.far_end
    stretched = misread_range(depth.coefficients[-1]) if depth.model in (RANGE, PLANAR) else None
    if stretched:
        return replace(depth, coefficients=(*depth.coefficients[:-1], stretched)), 1.0, np.inf
    unit = _rounded(1 / depth.coefficients[0])
    if depth.model is PLANAR and unit == 1:
        return AS_GIVEN, 1.0, np.inf
    if depth.model is PLANAR and unit > 0:
        middle = float(np.median(stored))
        if middle > 0 and abs(np.log(middle / _USUAL_DEPTH)) < abs(np.log(middle * unit / _USUAL_DEPTH)):
            return AS_GIVEN, 1 / unit, np.inf
    return replace(depth, coefficients=(1 / unit,)), 1.0, np.inf


def _rounded(value: float) -> float:
    """Return `value` with few digits if that is nearly the same."""
    for digits, tolerance in _TOLERANCES:
        near = float(f"{value:.{digits - 1}e}")
        if abs(near - value) <= tolerance * abs(value):
            return near
    return value


def write_repaired(sequence: Sequence, diagnosis: Diagnosis, output: Path, on_frame=lambda: None) -> int:
    """Write `sequence` with the reading of `diagnosis` applied to the folder `output`, and return how many frames it
    has. Truth keeps its colors and gets the new cameras; extrapolated frames are left out. Raises GffeError as
    `SequenceWriter` does, and for a repair that would do harm."""
    refuse_same_folder(output, sequence.path)
    repair = Repair(sequence, diagnosis)
    size = sequence.width, sequence.height
    named = {"generator": "gffe-cl check"}
    with SequenceWriter(output, *size, sequence.fps, sequence.exposure, **named) as writer:
        count = len(sequence.ground_truth)
        for entry, frame in repair.frames():
            count += 1
            writer.add_frame(entry, frame)
            on_frame()
        repair.refuse_harm()
        for entry in sequence.ground_truth:
            color = repair.color(sequence.read_color(entry))
            cameras = {
                name: camera and repair.camera(camera)
                for name, camera in (("render_camera", entry.render_camera), ("display_camera", entry.display_camera))
            }
            writer.add(replace(entry, **cameras), named_channels(color))
            on_frame()
    return count
