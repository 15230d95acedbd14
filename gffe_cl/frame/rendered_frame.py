"""Buffers of a frame, on the host.

A frame's arrays may be NumPy arrays or OpenCL buffers (`pyopencl.Buffer` or `pyopencl.array.Array`) of the
pipeline's context; device buffers are used in place. Layouts on the device: colour half ×4, depth float,
motion float ×2, row-major.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from gffe_cl.core.errors import GffeError
from gffe_cl.core.validation import (
    as_float32,
    require_array,
    require_bool,
    require_kind,
    require_number,
    require_size,
    shown,
)
from gffe_cl.frame.camera import Camera

HALF_MAX = 65504.0
_HALF_INFINITY, _SIGN = 0x7C00, 0x8000  # bits; NaN has more
SAME_POSE = 1e-6
BYTES_PER_PIXEL = (8, 4, 8)  # of colour, depth and motion on the device
KEPT_BYTES_PER_PIXEL = 2 * (8 + 4) + 8  # of two frames: nothing reads the motion of the one before


@dataclass
class Overlays:
    """What lies over the picture and is not warped with it; NumPy arrays or device buffers, each of them optional.

    Colours are linear and scene-referred as the frame's, and premultiplied: layer.rgb + (1 − layer.a) · picture is
    shown. The frame's own colour has neither effects nor user interface in it; pixels of `fixed_mask` it has.

    Parameters
    ----------
    fixed_mask : (H, W) bool or uint8, render pixels
        Where the rendered picture stays in its place on the display: first-person hands and weapons, cockpits. It
        should cover their antialiased edges. Behind them nothing is known. On the device uchar.
    effects : (H, W, 4) float RGBA, render pixels
        Smoke, fire, particles, lens flares: without depth, over all but the user interface. On the device half ×4.
    effects_motion : (H, W, 2) float32, pixels, like the frame's motion
        Along which the effects go on; None: they stay in place. On the device float ×2.
    ui : (H, W, 4) float RGBA, display pixels
        User interface, as it is in this frame. On the device half ×4.
    """

    fixed_mask: Any = None
    effects: Any = None
    effects_motion: Any = None
    ui: Any = None


OVERLAYS = tuple(layer.name for layer in fields(Overlays))


@dataclass
class RenderedFrame:
    """One finished frame of the renderer at time t.

    Parameters
    ----------
    color : (H, W, 3 or 4) float, linear scene-referred RGB; or a device buffer of half ×4
    depth : (H, W) float32, planar view-space z in world units, +inf for sky; or a device buffer of float
    motion : (H, W, 2) float32, pixels: (position in the previous rendered frame) − (position here); or a
        device buffer of float ×2. May be None on a reset frame.
    camera : Camera
        What was rasterised (the render camera), in pixels of these arrays.
    time : float
        Seconds.
    display_camera : Camera or None
        What is shown; None if it is the render camera.
    reset : bool
        Nothing before this frame may be used (scene cut, teleport, start).
    overlays : Overlays or None
        What is not to be warped with the picture.

    The fields are checked where the frame is used: `Pipeline.submit`, `present` and `pack` raise GffeError.
    """

    color: Any
    depth: Any
    motion: Any
    camera: Camera
    time: float
    display_camera: Camera | None = None
    reset: bool = False
    overlays: Overlays | None = None
    _packed: PackedFrame | None = field(default=None, init=False, repr=False, compare=False)  # `replace` leaves it out

    def pack(self) -> PackedFrame:
        """Convert host arrays to device layout ahead of `submit`, on any thread, and count bad pixels. Done once.

        Raises GffeError for a structural fault: arrays of several sizes or of wrong types, or motion missing although
        the frame is no reset.
        """
        if self._packed is None:
            size = np.shape(self.depth)
            if len(size) < 2:
                raise GffeError(f"frame: depth must be an array (H, W), got {shown(self.depth)}")
            self._packed = pack_frame(self, *size[:2])
        return self._packed

    def packed_only(self) -> RenderedFrame:
        """This frame with the arrays of `pack` in place of its own, so that memory holds no others."""
        packed = self.pack()
        motion = None if self.motion is None else packed.motion
        frame = replace(self, color=packed.color, depth=packed.depth, motion=motion)
        frame._packed = packed
        return frame

    @property
    def shown_camera(self) -> Camera:
        """What is shown: the display camera, else the render camera."""
        return self.display_camera or self.camera


def checked_frame(frame: RenderedFrame) -> RenderedFrame:
    """`frame` with `time` and `reset` as Python has them. GffeError unless all but its arrays is what it should be."""
    require_kind(frame, RenderedFrame, "frame")
    require_kind(frame.camera, Camera, "frame: camera")
    if frame.display_camera is not None:
        require_kind(frame.display_camera, Camera, "frame: display_camera", "a Camera or None")
    if frame.overlays is not None:
        require_kind(frame.overlays, Overlays, "frame: overlays", "Overlays or None")
    time, reset = require_number(frame.time, "frame: time"), require_bool(frame.reset, "frame: reset")
    checked = replace(frame, time=time, reset=reset)
    checked._packed = frame._packed
    return checked


def require_motion(frame: RenderedFrame) -> Any:
    """The frame's motion; GffeError if it has none and is no reset."""
    if frame.motion is None and not require_bool(frame.reset, "frame: reset"):
        time = require_number(frame.time, "frame: time")
        raise GffeError(f"frame at {time:g} s: motion is missing (only reset frames may lack it)")
    return frame.motion


def display_camera_of(frame: RenderedFrame, render_size: tuple[int, int], size: tuple[int, int]) -> Camera:
    """The camera of what is shown, in pixels of a display of `size`: by default the rendered frustum."""
    if frame.display_camera or render_size == size:
        return frame.display_camera or frame.camera
    return frame.camera.scaled(*(s / r for r, s in zip(render_size, size, strict=True)))


def require_one_pose(render: Camera, display: Camera) -> None:
    """GffeError unless both cameras stand in one place and look one way: a window is a part of an image."""
    turned = np.abs(render.world_to_view[:3, :3] - display.world_to_view[:3, :3]).max()
    apart = np.abs(render.world_to_view[:3, 3] - display.world_to_view[:3, 3]).max()
    if turned > SAME_POSE or apart > SAME_POSE * (1 + np.abs(render.world_to_view[:3, 3]).max()):
        raise GffeError("frame: display_camera must have the pose of the render camera (expected equal world_to_view)")


def is_shown_whole(camera: Camera, display_camera: Camera) -> bool:
    """Whether the rendered image is what is shown, pixel for pixel, where both have one size."""
    return camera.intrinsics == display_camera.intrinsics


@dataclass
class BadPixels:
    """How many pixels of a frame could not be taken at face value (they are survived, not errors)."""

    color: int = 0  # NaN or infinite; NaN counts as 0
    clamped: int = 0  # magnitude over 65504, clamped
    depth: int = 0  # NaN or ≤ 0: neither splatted nor collected
    motion: int = 0  # NaN or infinite: dynamic without history

    def __add__(self, other: BadPixels) -> BadPixels:
        return BadPixels(*(getattr(self, n) + getattr(other, n) for n in self.__dataclass_fields__))

    def __bool__(self) -> bool:
        return any(getattr(self, n) for n in self.__dataclass_fields__)

    def __str__(self) -> str:
        words = {
            "color": "NaN or infinite colour",
            "clamped": "colour over 65504",
            "depth": "invalid depth (NaN or ≤ 0)",
            "motion": "NaN or infinite motion",
        }
        return ", ".join(f"{getattr(self, n)} × {text}" for n, text in words.items() if getattr(self, n))


@dataclass
class PackedFrame:
    """A frame's arrays as the device wants them: color (H, W, 4) float16, depth (H, W) float32,
    motion (H, W, 2) float32; and the count of bad pixels met on the way."""

    color: np.ndarray
    depth: np.ndarray
    motion: np.ndarray
    bad: BadPixels = field(default_factory=BadPixels)

    def require_size(self, width: int, height: int) -> None:
        """GffeError unless the arrays are those of images of this size."""
        for name, channels, kind in (
            ("color", (4,), np.float16),
            ("depth", (), np.float32),
            ("motion", (2,), np.float32),
        ):
            array, shape = getattr(self, name), (height, width, *channels)
            if not (isinstance(array, np.ndarray) and array.shape == shape and array.dtype == kind):
                raise GffeError(f"packed frame: {name} must be {np.dtype(kind)} of shape {shape}, got {shown(array)}")


def pack_frame(frame: RenderedFrame, height: int, width: int) -> PackedFrame:
    """Check shapes and convert a host frame to device layout, counting bad pixels.

    Raises GffeError for a structural fault: a wrong shape or type, or motion missing although the frame is no reset.
    """
    require_kind(frame, RenderedFrame, "frame")
    width, height = require_size((width, height), "frame: size", whole=True)
    color = require_array(frame.color, "frame: color", height, width, (3, 4), kinds="f")
    depth = require_array(frame.depth, "frame: depth", height, width, kinds="f")
    bad = BadPixels()

    rgb = color[..., :3]
    packed = _lies_as_on_device(color)
    if not _fits_half(rgb if packed is None else packed):
        finite = np.isfinite(rgb)
        over = np.abs(rgb) > HALF_MAX
        bad.color = int((~finite).any(-1).sum())
        bad.clamped = int((over & finite).any(-1).sum())
        rgb = np.clip(np.nan_to_num(rgb, nan=0.0, posinf=HALF_MAX, neginf=-HALF_MAX), -HALF_MAX, HALF_MAX)
        packed = None
    if packed is None:
        packed = color_of_planes(rgb[..., c] for c in range(3)).base

    depth = as_float32(depth)
    bad.depth = depth.size - int(np.count_nonzero(depth > 0))

    if require_motion(frame) is None:
        motion = np.zeros((height, width, 2), np.float32)
    else:
        motion = as_float32(require_array(frame.motion, "frame: motion", height, width, 2, kinds="f"))
        finite = np.isfinite(motion)
        bad.motion = 0 if finite.all() else int((~finite).any(-1).sum())
    return PackedFrame(packed, depth, motion, bad)


def color_of_planes(planes: Iterable[np.ndarray]) -> np.ndarray:
    """(H, W, 3) float16 from three images (H, W), as the device wants them: a fourth channel, which is not seen, is 0.
    `pack_frame` takes it without a copy."""
    first, *others = planes
    color = np.zeros((*first.shape, 4), np.float16)
    for c, plane in enumerate((first, *others)):  # several times as fast as all at once
        color[..., c] = plane
    return color[..., :3]


def _lies_as_on_device(color: np.ndarray) -> np.ndarray | None:
    """The (H, W, 4) array of what `color_of_planes` made; None for any other array."""
    whole = color.base
    if not isinstance(whole, np.ndarray) or whole.dtype != np.float16 or whole.shape != (*color.shape[:2], 4):
        return None
    same = color.dtype == whole.dtype and color.strides == whole.strides and color.ctypes.data == whole.ctypes.data
    return whole if same and whole.flags.c_contiguous and not whole[..., 3].view(np.uint16).any() else None


def _fits_half(values: np.ndarray) -> bool:
    """Whether all of (H, W, n) are finite and within ±65504."""
    if values.dtype == np.float16:  # NumPy's arithmetic of halves is slow, but their bits are in order, by sign
        positive, negative = values.view(np.int16).max(), values.view(np.uint16).max()
        return bool(positive < _HALF_INFINITY and negative < _SIGN + _HALF_INFINITY)
    return bool(max(values.max(), -values.min()) <= HALF_MAX)  # both are NaN if one value is
