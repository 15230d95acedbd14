"""Encodings: exact frames as engines and captures keep them, by precision and by the conditions of games.

    encoding = Encoding.parse("half-uv,two-lookups,half-depth")
    stored = encoding.frame(frame, exposure, half_motions)

Most parts are functions on finished frames, so one rendering serves all of them (`gffe render --encode`, `gffe import
--encode`). Those that need jittered samples (`is_rendered`) are made by `EncodedFrames` of the built-in scenes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gffe_cl.captures.sequence.post_effects import nearest_motion, user_interface, with_grain, with_ui
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.frame_format import FrameFormat
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.frame.transfer_function import linear_values, to_display

CODE_SIZE = (1920, 1080)
CAMERA_NOISE = 0.1  # pixels, standard deviation
PLANES = 0.01, 1e5  # world units, of logarithmic depth
_SHORT_RANGE = 1 / 16  # of the image: the longest motion in 8 bits

Code = Callable[[np.ndarray], np.ndarray]


def _half(uv: np.ndarray) -> np.ndarray:
    return 2 * (0.5 * uv + 0.5).astype(np.float16).astype(np.float64) - 1


def _unorm(bits: int, reach: float) -> Code:
    most = 2**bits - 1
    return lambda uv: (2 * np.round(np.clip(0.5 * uv / reach + 0.5, 0, 1) * most) / most - 1) * reach


# Of motion in units of the image's sides, by name.
MOTION_CODES: dict[str, tuple[str, Code]] = {
    "half-uv": ("motion as half floats of 0.5 · uv + 0.5", _half),
    "unorm8": ("motion in 8 bits, at most 1/16 of the image", _unorm(8, _SHORT_RANGE)),
    "unorm16": ("motion in 16 bits of 0.5 · uv + 0.5", _unorm(16, 1.0)),
    "rounded": ("motion in whole pixels", np.array),
    "half-motion": ("motion as half floats of uv", lambda uv: uv.astype(np.float16).astype(np.float64)),
}
TWO_LOOKUPS, HALF_DEPTH, COLOR_8BIT, NOISY_CAMERA = "two-lookups", "half-depth", "8bit-color", "noisy-camera"
LOG_DEPTH = "log-depth"
TAA, JITTERED, HALF, DILATED, GRAIN, HUD = "taa", "jittered", "half", "dilated", "grain", "hud"
PARTS: dict[str, str] = {name: sentence for name, (sentence, _) in MOTION_CODES.items()} | {
    TWO_LOOKUPS: "motion is the sum of vectors over half the interval, the second one that of the nearest pixel",
    HALF_DEPTH: "depth as half floats",
    LOG_DEPTH: "depth as its logarithm, 0 to 1 between the planes {:g} and {:g}".format(*PLANES),
    COLOR_8BIT: "display values of 8 bits",
    NOISY_CAMERA: f"cameras turned by {CAMERA_NOISE:g} px (standard deviation) about each axis",
    TAA: "color by temporal antialiasing of jittered samples, one per pixel",
    JITTERED: "depth and motion jittered by parts of a pixel, color not",
    HALF: "depth and motion at half the resolution, each way, and jittered",
    DILATED: "motion is that of the nearest surface within a pixel",
    GRAIN: "film grain in the color",
    HUD: "a user interface in the color",
}
PRESETS = {
    "exact": (),
    "engine": ("half-uv", TWO_LOOKUPS, HALF_DEPTH, COLOR_8BIT, NOISY_CAMERA),
    "game": (TAA, HALF, DILATED, "half-motion", HALF_DEPTH, HUD),
}
_RENDERED, _ON_DISPLAY = {TAA, JITTERED, HALF}, {TAA, JITTERED, HALF, HUD}


@dataclass(frozen=True)
class Encoding:
    """Encoding of a frame's buffers. `parts`: names of PARTS; `size`: (width, height), pixels, of the image in whose
    sides motion is stored."""

    parts: frozenset[str] = frozenset()
    size: tuple[int, int] = CODE_SIZE

    @classmethod
    def parse(cls, text: str, size: tuple[int, int] = CODE_SIZE) -> Encoding:
        """Return the encoding of a text PART[,PART…]; the names of PRESETS stand for several parts. Raises
        GffeError."""
        parts: set[str] = set()
        for name in text.split(","):
            if name not in PARTS and name not in PRESETS:
                expected = ", ".join((*PRESETS, *PARTS))
                raise GffeError(f"--encode: unknown encoding '{name}' (expected some of {expected})")
            parts |= set(PRESETS.get(name, (name,)))
        if len(parts & set(MOTION_CODES)) > 1:
            codes = ", ".join(MOTION_CODES)
            raise GffeError(f"--encode: '{text}' stores motion in several ways (expected one of {codes})")
        if TWO_LOOKUPS in parts and parts & _RENDERED:
            raise GffeError(f"--encode: '{text}' looks up jittered vectors twice (expected {TWO_LOOKUPS} without them)")
        return cls(frozenset(parts), size)

    @property
    def looks_up_twice(self) -> bool:
        return TWO_LOOKUPS in self.parts

    @property
    def is_rendered(self) -> bool:
        """Whether frames need jittered samples, which only a renderer has."""
        return bool(self.parts & _RENDERED)

    @property
    def is_on_display(self) -> bool:
        """Whether rendered images must be the displayed ones: neither windows nor other sizes."""
        return bool(self.parts & _ON_DISPLAY)

    @property
    def format(self) -> FrameFormat | None:
        """Description of the frames, None where our conventions hold."""
        changed: dict[str, Any] = {"motion_dilated": True} if DILATED in self.parts else {}
        if LOG_DEPTH in self.parts:
            changed |= {"depth": "logarithmic", "near_z": PLANES[0], "far_z": PLANES[1]}
        return FrameFormat(**changed) if changed else None

    def motion(self, motion: np.ndarray) -> np.ndarray:
        """Return motion (H, W, 2) float32, pixels, after being stored. NaN stays NaN."""
        code = next((MOTION_CODES[name][1] for name in self.parts if name in MOTION_CODES), None)
        if code is None:
            return motion
        if "rounded" in self.parts:
            return np.round(motion)
        with np.errstate(over="ignore"):
            return (code(motion / np.array(self.size, np.float64)) * self.size).astype(np.float32)

    def frame(
        self,
        frame: RenderedFrame,
        exposure: float = 1.0,
        half_motions: Iterable[np.ndarray] | None = None,
    ) -> RenderedFrame:
        """Return `frame`, of host arrays, after being stored. `half_motions`: see `looked_up`; None: its motion is
        looked up once. Where `is_rendered`, it must be antialiased and jittered already."""
        motion = frame.motion
        if motion is not None:
            motion = self.looked_up(half_motions or [np.asarray(motion)])
            if DILATED in self.parts:
                motion = nearest_motion(motion, np.asarray(frame.depth))
        depth = np.asarray(frame.depth)
        if LOG_DEPTH in self.parts:
            near, far = PLANES
            with np.errstate(invalid="ignore"):  # sky is at the far plane
                depth = (np.log(np.minimum(depth, far) / near) / np.log(far / near)).astype(np.float32)
        if HALF_DEPTH in self.parts:
            with np.errstate(over="ignore"):
                depth = depth.astype(np.float16).astype(np.float32)
        camera, shown = self.cameras(frame.time, frame.camera, frame.display_camera)
        color = with_grain(frame.color, frame.time, exposure) if GRAIN in self.parts else frame.color
        color = self.color(self.truth(color, exposure), exposure)
        return replace(frame, color=color, depth=depth, motion=motion, camera=camera, display_camera=shown)

    def looked_up(self, motions: Iterable[np.ndarray]) -> np.ndarray:
        """Return motion (H, W, 2) over as many intervals as there are `motions` (H, W, 2), in pixels, each stored for
        itself: the first one leads one interval back, and there the second one, of the nearest pixel, goes on."""
        first, *others = motions
        height, width = first.shape[:2]
        y, x = np.mgrid[:height, :width] + 0.5
        total = self.motion(first)
        for motion in others:
            at = np.clip(np.nan_to_num(np.stack([x, y], -1) + total), 0, (width - 1, height - 1)).astype(int)
            total = (total + self.motion(motion)[at[..., 1], at[..., 0]]).astype(np.float32)
        return total

    def truth(self, color: np.ndarray, exposure: float = 1.0) -> np.ndarray:
        """Return linear color (H, W, 3) of ground truth: with the user interface, if there is one."""
        ui = self.user_interface((color.shape[1], color.shape[0]), exposure)
        return color if ui is None else with_ui(color, ui)

    def user_interface(self, size: tuple[int, int], exposure: float = 1.0) -> np.ndarray | None:
        """Return the user interface over images of `size` (width, height): (H, W, 4), as for `Overlays.ui`; None if
        there is none."""
        return user_interface(*size, exposure) if HUD in self.parts else None

    def color(self, color: np.ndarray, exposure: float = 1.0) -> np.ndarray:
        """Return linear color (H, W, 3) after being stored."""
        if COLOR_8BIT not in self.parts:
            return color
        return linear_values(np.round(to_display(color, exposure) * 255) / 255, exposure).astype(np.float16)

    def cameras(self, time: float, camera: Camera | None, *others: Camera | None) -> tuple[Camera | None, ...]:
        """Return the cameras of the frame at `time` (seconds) with the error of a camera fit: all of them turn alike,
        by pixels of the first one. None stays None."""
        if NOISY_CAMERA not in self.parts or camera is None:
            return camera, *others
        rng = np.random.default_rng(np.float64(time).view(np.uint64))
        turn = _turn(*rng.normal(0, CAMERA_NOISE, 3) / (camera.fy, camera.fx, max(abs(camera.cx), abs(camera.cy), 1)))
        return tuple(one and replace(one, world_to_view=turn @ one.world_to_view) for one in (camera, *others))


def _turn(x: float, y: float, z: float) -> np.ndarray:
    """Return the rotation (4, 4) by small angles about the view axes, radians: the nearest rotation to 1 + [v]ₓ."""
    turn = np.eye(4)
    u, _, v = np.linalg.svd(np.eye(3) + np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]))
    turn[:3, :3] = u @ v
    return turn


EXACT = Encoding()
