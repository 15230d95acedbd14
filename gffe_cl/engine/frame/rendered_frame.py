"""Rendered frames and their overlays as callers pass them, and checks of their arrays.

A frame's arrays may be NumPy arrays or OpenCL buffers (`pyopencl.Buffer`, `pyopencl.array.Array`, or integer handles)
of the pipeline's context; device buffers are used in place. Layouts on the device: color half ×4, depth float,
motion float ×2, row-major.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import (
    LARGEST,
    as_float32,
    require_array,
    require_bool,
    require_kind,
    require_number,
    require_size,
    shown,
)
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.frame_format import DEPTH_TYPES, MOTION_TYPES, NO_JITTER, TYPES, require_jitter

HALF_MAX = 65504.0
DEPTH_MOST = 1e37  # beyond, squares and products overflow: nothing is there, as with +inf
DEPTH_LEAST = float(np.finfo(np.float32).tiny)  # below, devices disagree: denormal numbers
SAME_POSE = 1e-6
BYTES_PER_PIXEL = (8, 4, 8)  # of color, depth and motion on the device
KEPT_BYTES_PER_PIXEL = 2 * (8 + 4) + 8  # of two frames: nothing reads the motion of the one before


@dataclass
class Overlays:
    """Layers that lie over the picture and are not warped. They are NumPy arrays or device buffers, each of them
    optional.

    Colors are linear and scene-referred, like the frame's, and premultiplied: layer.rgb + (1 − layer.a) · picture is
    displayed. The frame's own color must contain neither effects nor user interface, but it contains the pixels of
    `fixed_mask`.

    Parameters
    ----------
    fixed_mask : (H, W) bool or uint8, render pixels
        Where the rendered picture stays in its place on the display: first-person hands and weapons, cockpits. It
        should cover their antialiased edges. Behind them nothing is known. On the device uchar.
    effects : (H, W, 4) float RGBA, render pixels
        Smoke, fire, particles, lens flares: without depth, over all but the user interface. On the device half ×4.
    effects_motion : (H, W, 2) float32, pixels, like the frame's motion
        Motion of the effects; None: they stay in place. On the device float ×2.
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
    color : (H, W, 3 or 4) float, linear scene-referred RGB; or a device buffer of half ×4. Device buffers are
        pyopencl's, or integer handles (`cl_mem`) of the device's context, retained while the pipeline uses them.
    depth : (H, W) float32, planar view-space z in world units, +inf for sky; or a device buffer of float
    motion : (H, W, 2) float32, pixels: (position in the previous rendered frame) − (position here); or a
        device buffer of float ×2. May be None on a reset frame.
    camera : Camera
        The render camera, in pixels of these arrays.
    time : float
        Time of the frame, seconds.
    display_camera : Camera or None
        The camera of the displayed image; None if it is the render camera.
    reset : bool
        Whether frames before this one must not be used (scene cut, teleport, start).
    overlays : Overlays or None
        Layers that are not warped with the picture.
    geometry_jitter : (float, float)
        Jitter of depth and motion that color does not have, because it was antialiased over time: pixels of these to
        the right and down by which their image is shifted. It is no part of the camera. Vectors that include it need a
        `FrameFormat` with `motion_jittered`. Otherwise it has no effect where depth and motion have color's size.
    geometry_size : (int, int) or None
        Width and height of depth and motion where they are smaller than color, up to three times each way. None: those
        of the `FrameFormat`, else color's. It may change from frame to frame. Motion is then in pixels of depth and
        motion, if a `FrameFormat` does not say otherwise.

    Notes
    -----
    Arrays are NumPy's or whatever it can read in place; tensors that DLPack hands over, such as a GPU's, are copied to
    the host, which needs NumPy 2.1 or newer. With a `FrameFormat` arrays and buffers are as that describes them. The
    fields are checked when the frame is made, and when they are set: GffeError says which is wrong. Its arrays are
    checked where their size is known: `Pipeline.submit` and `present` raise GffeError.
    """

    color: Any
    depth: Any
    motion: Any
    camera: Camera
    time: float
    display_camera: Camera | None = None
    reset: bool = False
    overlays: Overlays | None = None
    geometry_jitter: tuple[float, float] = NO_JITTER
    geometry_size: tuple[int, int] | None = None
    # Of the frame of which this one is the display part; None: of its own arrays. `replace` leaves it out.
    _known_bad: BadPixels | None = field(default=None, init=False, repr=False, compare=False)

    def __setattr__(self, name: str, value: Any) -> None:
        check = _CHECKS.get(name)
        object.__setattr__(self, name, check(name, value) if check else value)

    @property
    def shown_camera(self) -> Camera:
        """The display camera if there is one, else the render camera."""
        return self.display_camera or self.camera

    @property
    def bad(self) -> BadPixels:
        """The count of bad pixels of its NumPy arrays. The host counts them unless a pipeline has."""
        if self._known_bad is not None:
            return self._known_bad
        return BadPixels(**{kind: int(np.count_nonzero(pixels)) for kind, pixels in self.wrong.items()})

    @property
    def wrong(self) -> dict[str, np.ndarray]:
        """The bad pixels of its NumPy arrays, (H, W) bool by the fields of `BadPixels`; those of motion only where
        there is motion."""
        rgb = self.color[..., :3]
        finite = np.isfinite(rgb)
        wrong = {"color": ~finite, "clamped": finite & (np.abs(rgb) > HALF_MAX)}
        of_color = {kind: np.asarray(values.any(-1)) for kind, values in wrong.items()}
        return of_color | wrong_geometry(self.depth, self.motion)

    def in_device_layout(self) -> RenderedFrame:
        """Return the frame with its NumPy arrays in the device's layout: color (H, W, 4) float16 with 0 in the fourth
        channel, missing motion as 0."""
        rgb = np.clip(np.nan_to_num(self.color[..., :3], posinf=HALF_MAX, neginf=-HALF_MAX), -HALF_MAX, HALF_MAX)
        color = color_of_planes(rgb[..., c] for c in range(3)).base
        motion = np.zeros((*self.depth.shape, 2), np.float32) if self.motion is None else self.motion
        return _with_arrays(self, color, self.depth, motion)


def _one_of(kinds: type | tuple[type, ...], expected: str) -> Callable[[str, Any], Any]:
    def checked(name: str, value: Any) -> Any:
        if not isinstance(value, kinds):
            raise GffeError(f"frame: {name} must be {expected}, got {shown(value)}")
        return value

    return checked


def _seconds(name: str, value: Any) -> float:
    return value if type(value) is float and -LARGEST < value < LARGEST else require_number(value, f"frame: {name}")


def _flag(name: str, value: Any) -> bool:
    return value if type(value) is bool else require_bool(value, f"frame: {name}")


def _jitter(name: str, value: Any) -> tuple[float, float]:
    return value if value is NO_JITTER else require_jitter(value)


def _size(name: str, value: Any) -> tuple[int, int] | None:
    return None if value is None else require_size(value, f"frame: {name}", whole=True)


# Checks of fields that do not depend on where the frame is used; they return the value to keep, of Python's own type.
_CHECKS: dict[str, Callable[[str, Any], Any]] = {
    "camera": _one_of(Camera, "a Camera"),
    "display_camera": _one_of((Camera, type(None)), "a Camera or None"),
    "overlays": _one_of((Overlays, type(None)), "Overlays or None"),
    "time": _seconds,
    "reset": _flag,
    "geometry_jitter": _jitter,
    "geometry_size": _size,
}


def _with_arrays(frame: RenderedFrame, color: Any, depth: Any, motion: Any) -> RenderedFrame:
    """Return `frame` with other arrays of the same pixels."""
    made = replace(frame, color=color, depth=depth, motion=motion)
    made._known_bad = frame._known_bad
    return made


def require_motion(frame: RenderedFrame) -> Any:
    """Return the frame's motion. Raises GffeError if it has none and is no reset."""
    if frame.motion is None and not frame.reset:
        raise GffeError(f"frame at {frame.time:g} s: motion is missing (only reset frames may lack it)")
    return frame.motion


def display_camera_of(frame: RenderedFrame, render_size: tuple[int, int], size: tuple[int, int]) -> Camera:
    """Return the camera of displayed frames, in pixels of a display of `size`. The default is the rendered frustum."""
    if frame.display_camera or render_size == size:
        return frame.display_camera or frame.camera
    return frame.camera.scaled(*(s / r for r, s in zip(render_size, size, strict=True)))


def require_one_pose(render: Camera, display: Camera) -> None:
    """Raise GffeError unless both cameras have the same position and direction: a window is a part of an image."""
    if display is render:
        return
    turned = np.abs(render.world_to_view[:3, :3] - display.world_to_view[:3, :3]).max()
    apart = np.abs(render.world_to_view[:3, 3] - display.world_to_view[:3, 3]).max()
    if turned > SAME_POSE or apart > SAME_POSE * (1 + np.abs(render.world_to_view[:3, 3]).max()):
        raise GffeError("frame: display_camera must have the pose of the render camera (expected equal world_to_view)")


def require_later(time: float, before: float) -> None:
    """Raise GffeError unless a frame's `time` is after that of the frame `before`."""
    if time <= before:
        raise GffeError(f"frame: time {time:g} s must be after the previous rendered frame's ({before:g} s)")


def require_consecutive(frames: list[RenderedFrame]) -> None:
    """Raise GffeError unless `Pipeline.submit` would take the frames, one after the other, as far as it does not depend
    on their `FrameFormat`: in order of time, of one size, both cameras of one pose."""
    for before, frame in zip([None, *frames], frames, strict=False):
        require_one_pose(frame.camera, frame.shown_camera)
        shape = require_array(frame.color, "frame: color", None, None, (3, 4)).shape
        if before and not frame.reset:
            require_later(frame.time, before.time)
        if before and shape[:2] != np.shape(before.color)[:2]:
            raise GffeError(f"frame at {frame.time:g} s: color has shape {shape}, not that of the frame before")


def is_shown_whole(camera: Camera, display_camera: Camera) -> bool:
    """Return whether the rendered image is displayed pixel for pixel, if both have one size."""
    return camera.intrinsics == display_camera.intrinsics


@dataclass
class BadPixels:
    """Counts of pixels with invalid values in a frame. They are no errors: the pipeline works without these pixels."""

    color: int = 0  # NaN or infinite; NaN counts as 0
    clamped: int = 0  # magnitude over 65504, clamped
    depth: int = 0  # NaN, ≤ 0 or denormal: neither splatted nor collected
    motion: int = 0  # NaN or infinite: dynamic without history
    far: int = 0  # depth that is finite but beyond 1e37, taken as sky
    long: int = 0  # motion as long as the image's diagonal, which no pixel can have: taken as NaN

    def __add__(self, other: BadPixels) -> BadPixels:
        return BadPixels(*(getattr(self, n) + getattr(other, n) for n in self.__dataclass_fields__))

    def __bool__(self) -> bool:
        return any(getattr(self, n) for n in self.__dataclass_fields__)

    def __str__(self) -> str:
        words = {
            "color": "NaN or infinite color",
            "clamped": "color over 65504",
            "depth": "invalid depth (NaN, ≤ 0 or denormal)",
            "motion": "NaN or infinite motion",
            "far": "depth beyond 1e37, taken as sky",
            "long": "motion longer than the image's diagonal, taken as unknown",
        }
        return ", ".join(f"{getattr(self, n)} × {text}" for n, text in words.items() if getattr(self, n))


def wrong_geometry(depth: np.ndarray, motion: np.ndarray | None) -> dict[str, np.ndarray]:
    """Return which pixels are bad by depth (H, W) and motion (H, W, 2), bool (H, W) for each such field of
    `BadPixels`."""
    wrong = {"depth": ~(depth >= DEPTH_LEAST), "far": np.isfinite(depth) & (depth > DEPTH_MOST)}
    if motion is None:
        return wrong
    finite = np.isfinite(motion).all(-1)
    return wrong | {"motion": ~finite, "long": finite & is_long(motion)}


def is_long(motion: np.ndarray) -> np.ndarray:
    """Return where motion (H, W, 2) is as long as the diagonal of its image, or longer: (H, W) bool. Such vectors lead
    out of the image from every pixel, so they were never written, or are no motion."""
    height, width = motion.shape[:2]
    x, y = motion[..., 0], motion[..., 1]
    with np.errstate(over="ignore", invalid="ignore"):
        return x * x + y * y >= np.float32(width) * np.float32(width) + np.float32(height) * np.float32(height)


def host_arrays(frame: RenderedFrame, height: int | None = None, width: int | None = None) -> RenderedFrame:
    """Check a frame's NumPy arrays, by default for the size of its depth, and return it with arrays as `Upload` takes
    them, C-contiguous and aligned: color (H, W, 3 or 4) float16 or float32, whose fourth channel is not used, depth
    (H, W) and motion (H, W, 2) float32, or None. Arrays that are so already are not copied.

    Raises GffeError for a structural fault: a wrong shape or type, or motion missing although the frame is no reset.
    """
    if not isinstance(frame, RenderedFrame):
        require_kind(frame, RenderedFrame, "frame")
    if height is None:
        height, width = require_array(frame.depth, "frame: depth", None, None, kinds="f").shape
        width, height = require_size((width, height), "frame: size", whole=True)
    if getattr(frame.color, "dtype", None) in (np.uint8, np.uint16):
        raise GffeError(
            f"frame: color must be floating point, got {frame.color.dtype} (expected float16 or float32, or a pipeline"
            " with format=gffe.FrameFormat(), which takes linear color of 8 and 16 bits)"
        )
    color = require_array(frame.color, "frame: color", height, width, (3, 4), kinds="f")
    depth = require_array(frame.depth, "frame: depth", height, width, kinds="f")
    motion = require_motion(frame)
    if motion is not None:
        motion = _floats(require_array(motion, "frame: motion", height, width, 2, kinds="f"))
    return _with_arrays(frame, _uploadable(color), _floats(depth), motion)


def _floats(array: np.ndarray) -> np.ndarray:
    """Return an array as float32, C-contiguous and aligned, without a copy if it is that already."""
    if array.dtype == np.float32 and array.flags.carray:
        return array
    return np.require(as_float32(array), requirements="A")


def described_arrays(frame: RenderedFrame, size: tuple[int, int], geometry: tuple[int, int]) -> RenderedFrame:
    """Check a frame's NumPy arrays, which a `FrameFormat` describes, and return it with arrays of the types in `TYPES`.
    Those in a type that kernels take are not copied. Depth of uint32 is unorm24. `size`, `geometry`: width and height
    of color, and of depth and motion.

    Raises GffeError for a structural fault: a wrong shape or type, or motion missing although the frame is no reset.
    """
    color = require_array(frame.color, "frame: color", size[1], size[0], (3, 4))
    depth = require_array(frame.depth, "frame: depth", geometry[1], geometry[0])
    motion = require_motion(frame)
    if motion is not None:
        motion = require_array(motion, "frame: motion", geometry[1], geometry[0], (2, 3, 4))[..., :2]
        motion = _described(motion, "motion", MOTION_TYPES)
    color = _uploadable(color) if color.dtype.kind == "f" else _described(color, "color", ("unorm16", "unorm8"))
    return _with_arrays(frame, color, _described(depth, "depth", DEPTH_TYPES), motion)


def _described(array: np.ndarray, name: str, allowed: tuple[str, ...]) -> np.ndarray:
    """Return an array as native and C-contiguous, floats in an `allowed` type. Raises GffeError for other types than
    those."""
    if array.dtype.kind == "f" and not (array.dtype.itemsize == 2 and "float16" in allowed):
        array = as_float32(array)
    array = np.require(array.astype(array.dtype.newbyteorder("="), copy=False), requirements=["C", "A"])
    if type_of(array) not in allowed:
        expected = ", ".join(np.dtype(TYPES[name][0]).name for name in allowed)
        raise GffeError(f"frame: {name} must be of type {expected}, got {array.dtype}")
    return array


def type_of(array: np.ndarray) -> str | None:
    """Return the name of an array's type in `TYPES`, None if it is of another one."""
    return next((name for name, (dtype, _) in TYPES.items() if array.dtype == dtype), None)


def color_of_planes(planes: Iterable[np.ndarray]) -> np.ndarray:
    """Return color (H, W, 3) float16 from three images (H, W), laid out for the device: a fourth channel, which is not
    visible, is 0. `host_arrays` takes it without a copy."""
    first, *others = planes
    color = np.zeros((*first.shape, 4), np.float16)
    for c, plane in enumerate((first, *others)):  # several times as fast as all at once
        color[..., c] = plane
    return color[..., :3]


def _uploadable(color: np.ndarray) -> np.ndarray:
    """Return `color` as native float16 or float32, C-contiguous. Where it is the first three channels of such an array,
    that array is returned and nothing is copied."""
    if color.dtype.itemsize > 4:
        color = _rounded_to_odd(color)
    color = color.astype(color.dtype.newbyteorder("="), copy=False)
    whole = color.base
    if isinstance(whole, np.ndarray) and whole.shape == (*color.shape[:2], 4) and whole.flags.c_contiguous:
        same_texels = color.dtype == whole.dtype and color.strides == whole.strides
        if same_texels and color.ctypes.data == whole.ctypes.data:
            return np.require(whole, requirements="A")
    return np.require(color, requirements=["C", "A"])


def _rounded_to_odd(values: np.ndarray) -> np.ndarray:
    """Return float32 that rounds to the same float16 as the more precise `values`: rounded toward 0, with an odd
    last bit unless exact. Finite values stay finite."""
    with np.errstate(over="ignore", invalid="ignore"):
        rounded = values.astype(np.float32)
        too_large, inexact = np.abs(rounded) > np.abs(values), rounded != values
    bits = rounded.view(np.uint32)
    bits -= too_large
    bits |= inexact
    return rounded
