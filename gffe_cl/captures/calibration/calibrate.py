"""Recovery of cameras for a sequence that has none (`gffe calibrate`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from gffe_cl.captures.calibration.correspondences import Correspondences, correspondences
from gffe_cl.captures.calibration.focal import find_focal, lens_of_view, view_of_lens
from gffe_cl.captures.calibration.pose import Lens, Movement, fit, reach_of, residuals
from gffe_cl.captures.sequence import FrameEntry, Sequence, SequenceWriter, named_channels, refuse_same_folder
from gffe_cl.captures.sequence.exr_layout import read_header
from gffe_cl.captures.sequence.reader import MOTION
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.rendered_frame import require_motion

LEAST_TURN = 5.0  # degrees in all: from then on the focal length is taken from the motion
MOST_DEVIATION = 0.003  # of the focal length, relative
LEAST_SAMPLES = 50  # of a pair
LEAST_STATIC = 0.2  # of its samples that one movement must explain, or there was a cut
STATIC = (0.5, 3.0)  # px: a smaller residual is never a movement of an object's own, a larger one always
GOOD, USABLE = 0.25, 1.0  # px, of the 90th percentile of static residuals


@dataclass
class Calibration:
    """Recovered cameras, and how well they fit.

    Attributes
    ----------
    frames, truths : int
        Rendered and ground-truth frames that have a camera now.
    focal : (float, float)
        fx and fy of rendered frames, pixels.
    view : float
        Degrees across the rendered image.
    deviation : float or None
        Standard deviation of the focal length, relative; None where it was given.
    turned : float
        Degrees by which the camera turned in all.
    median, percentile_90 : float
        Quantiles of the residuals of static samples, pixels.
    static : float
        Share of static samples in all samples.
    cuts : list of str
        Rendered frames that no movement of a camera explains: they are resets.
    """

    frames: int
    truths: int
    focal: tuple[float, float]
    view: float
    deviation: float | None
    turned: float
    median: float
    percentile_90: float
    static: float
    cuts: list[str] = field(default_factory=list)

    @property
    def verdict(self) -> str:
        """The verdict in plain words."""
        if self.percentile_90 > USABLE or self.static < 2 * LEAST_STATIC:
            return "poor: depth and motion vectors do not fit one camera (units, sign, another frame's?)"
        if self.percentile_90 > GOOD:
            return "usable: a little off, as with vectors that are rounded to pixels"
        return "good: static surfaces are reprojected to a fraction of a pixel"


@dataclass
class _Found:
    """Movement of the camera from the rendered frame before to one frame, and the residual of each sample, pixels."""

    movement: Movement
    off: np.ndarray

    @property
    def is_static(self) -> np.ndarray:
        return self.off < np.clip(reach_of(self.movement), *STATIC)


def calibrate_sequence(
    sequence: Sequence,
    output: Path,
    *,
    view: float | None = None,
    center: tuple[float | None, float | None] = (None, None),
    aspect: float = 1.0,
    on_frame: Callable[[], None] = lambda: None,
) -> Calibration:
    """Recover a camera for every frame of `sequence`, write the sequence with them to `output`, and return the fit.

    Cameras in the sequence are ignored. Ground truth gets a camera where it has depth and motion vectors (to the
    rendered frame before). The world is that of the first frame after each reset, in units of depth.

    Parameters
    ----------
    view : float or None
        Degrees across the rendered image; None: from the motion.
    center : (float or None, float or None)
        cx and cy of rendered frames, pixels; None: the middle.
    aspect : float
        fx / fy.
    on_frame : callable
        Called after each frame that is done.

    Raises GffeError for structural faults, and where the motion does not determine the focal length.
    """
    refuse_same_folder(output, sequence.path)
    if sequence.format and sequence.format.camera_motion != "included":
        raise GffeError(
            f"{sequence.path}: frame_format: camera_motion is {sequence.format.camera_motion} (expected included:"
            " cameras are recovered from their part of the motion vectors)"
        )
    width, height = _size_of(sequence)
    middle = np.array([width / 2 if center[0] is None else center[0], height / 2 if center[1] is None else center[1]])
    seen = _read(sequence, on_frame)
    pairs = [seen[entry.file] for entry in sequence.rendered[1:] if _is_usable(entry, seen)]
    if not pairs:
        raise GffeError(f"{sequence.path}: no pair of rendered frames with motion vectors to recover cameras from")
    deviation = None
    if view is None:
        lens, deviation = find_focal(pairs, (width, height), middle, aspect)
    else:
        lens = lens_of_view(view, (width, height), middle, aspect)
    found = _movements(sequence, seen, lens)
    turned = sum(found[entry.file].movement.degrees for entry in sequence.rendered if entry.file in found)
    if deviation is not None:
        _require_determined(sequence, turned, deviation)
    truths = _write(sequence, output, found, lens)
    off = np.concatenate([one.off[one.is_static] for one in found.values()])
    return Calibration(
        len(sequence.rendered),
        truths,
        tuple(lens.focals.tolist()),
        view_of_lens(lens, (width, height)),
        deviation,
        turned,
        *(float(np.percentile(off, share)) for share in (50, 90)),
        static=len(off) / sum(len(one.off) for one in found.values()),
        cuts=[e.file for e in sequence.rendered[1:] if not e.reset and e.file not in found],
    )


def _size_of(sequence: Sequence) -> tuple[int, int]:
    sizes = {sequence.size_of(entry) for entry in sequence.rendered}
    if len(sizes) != 1:
        raise GffeError(f"{sequence.path}: rendered frames must be there, and of one size, to recover cameras")
    return next(iter(sizes))


def _read(sequence: Sequence, on_frame: Callable[[], None]) -> dict[str, Correspondences]:
    """Return the correspondences of all frames that have depth and motion and are no reset, by file."""
    size = _size_of(sequence)
    wanted = [entry for entry in sequence.rendered if not entry.reset]
    wanted += [entry for entry in sequence.ground_truth if _has_motion(sequence, entry, size)]

    def read(entry: FrameEntry) -> Correspondences:
        if entry.kind == "rendered":
            frame = sequence.read(entry)
            return correspondences(frame.depth, require_motion(frame))
        channels = sequence.read_channels(entry, ("Z", *MOTION))
        return correspondences(channels["Z"], np.stack([channels[name] for name in MOTION], -1))

    seen = {}
    for entry, found in sequence.prefetch(wanted, read=read):
        seen[entry.file] = found
        on_frame()
    return seen


def _has_motion(sequence: Sequence, entry: FrameEntry, size: tuple[int, int]) -> bool:
    own = sequence.exr_file(entry)
    if own is None:
        return False
    header = read_header(own, entry.file)
    there = all(header.find(name) for name in ("Z", *MOTION))
    return there and sequence.size_of(entry) == size and sequence.rendered_before(entry.time) is not None


def _is_usable(entry: FrameEntry, seen: dict[str, Correspondences]) -> bool:
    return entry.file in seen and len(seen[entry.file]) >= LEAST_SAMPLES


def _movements(sequence: Sequence, seen: dict[str, Correspondences], lens: Lens) -> dict[str, _Found]:
    """Return the movements that are known from the rendered frame before, by file."""
    found, guess = {}, ()
    for entry in (*sequence.rendered, *sequence.ground_truth):
        if not _is_usable(entry, seen):
            continue
        movement = fit(seen[entry.file], lens, guess)
        off = np.linalg.norm(residuals(seen[entry.file], lens, movement), axis=-1)
        one = _Found(movement, off)
        if one.is_static.mean() >= LEAST_STATIC:
            found[entry.file], guess = one, (movement,)
    if not found:
        raise GffeError(
            f"{sequence.path}: no movement of a camera explains the motion vectors (units, sign, direction?)"
        )
    return found


def _require_determined(sequence: Sequence, turned: float, deviation: float) -> None:
    if turned < LEAST_TURN:
        reason = f"the camera turns by {turned:.1f}° in all, {LEAST_TURN:g}° are needed"
    elif deviation > MOST_DEVIATION:
        reason = f"it could be off by {100 * 3 * deviation:.1f}%"
    else:
        return
    raise GffeError(
        f"{sequence.path}: the focal length is not determined by this motion ({reason}): give the horizontal field of"
        " view, --fov DEGREES"
    )


def _write(sequence: Sequence, output: Path, found: dict[str, _Found], lens: Lens) -> int:
    """Write the sequence with cameras, and return how many ground-truth frames have one."""
    size, truths = (sequence.width, sequence.height), 0
    pose, poses = np.eye(4), []
    for entry in sequence.rendered:
        before = np.eye(4) if entry.file not in found else pose
        pose = np.linalg.inv(found[entry.file].movement.matrix) @ before if entry.file in found else before
        poses.append(pose)
    cameras = {e.file: _camera(p, lens) for e, p in zip(sequence.rendered, poses, strict=True)}
    named: dict[str, Any] = {"generator": "gffe-cl calibrate", "attributes": sequence.attributes}
    named["format"] = sequence.format  # depth and motion stay as they are stored
    with SequenceWriter(output, *size, sequence.fps, sequence.exposure, **named) as writer:
        for entry in sequence.frames:
            own = sequence.exr_file(entry)
            if entry.kind == "rendered":
                reset = entry.file not in found
                new = replace(entry, render_camera=cameras[entry.file], display_camera=None, reset=reset)
                if own is None:
                    writer.add_frame(new, sequence.read_stored(entry))
                else:
                    writer.link(new, own)
            elif entry.kind == "ground_truth" and entry.file in found:
                assert own is not None  # it has motion
                number = sequence.rendered_before(entry.time)
                assert number is not None  # the poses that were found are of frames after a rendered one
                before = poses[number]
                camera = _camera(np.linalg.inv(found[entry.file].movement.matrix) @ before, lens)
                writer.link(replace(entry, display_camera=camera), own)
                truths += 1
            elif entry.kind == "ground_truth":  # written again: its header may have a camera of another world
                writer.add(replace(entry, display_camera=None), named_channels(sequence.read_color(entry)))
    return truths


def _camera(world_to_view: np.ndarray, lens: Lens) -> Camera:
    return Camera(world_to_view, *lens.focals.tolist(), *lens.center.tolist())
