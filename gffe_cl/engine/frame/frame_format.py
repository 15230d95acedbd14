"""Descriptions of an engine's buffers: how they differ from our conventions, and the numbers that convert them.

Ours: color half ×4, linear; depth float, planar, in world units; motion float ×2, (position in the previous rendered
frame) − (position here) in pixels, y down, without jitter of the geometry.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import (
    is_number,
    require_array,
    require_bool,
    require_choice,
    require_kind,
    require_number,
    require_positive,
    require_size,
    require_vector,
    require_whole,
    scalar,
    shown,
)
from gffe_cl.engine.frame.conventions import DIRECTIONS, depth_planes, square

# Types of values by name, numbered as in kernels/upload.cl (0: there is no such buffer): NumPy's type, and the largest
# stored number of a normalized one, which stands for 1.
TYPES: dict[str, tuple[Any, float]] = {
    "float32": (np.float32, 1.0),
    "float16": (np.float16, 1.0),
    "unorm8": (np.uint8, 255.0),
    "unorm16": (np.uint16, 65535.0),
    "snorm16": (np.int16, 32767.0),
    "unorm24": (np.uint32, 16777215.0),
}
COLOR_TYPES = ("float16", "float32", "unorm16", "unorm8")
DEPTH_TYPES = ("float32", "unorm16", "unorm24")
MOTION_TYPES = ("float32", "float16", "unorm16", "snorm16")
DEPTHS = ("linear", "device", "logarithmic", "distance")  # numbered as in kernels/upload.cl
SCALED_DEPTHS = ("linear", "distance")
MOTION_UNITS = ("pixels", "color_pixels", "uv", "ndc")
CAMERA_MOTIONS = ("included", "movers_only", "excluded")  # numbered as in kernels/upload.cl
VERTICALS = ("down", "up")
CHANNELS = {"color_channels": (3, 4), "motion_channels": (2, 4)}  # least and most
CHOICES: dict[str, tuple[str, ...]] = {  # of fields of `FrameFormat`
    "rows": VERTICALS,
    "color_type": COLOR_TYPES,
    "color_encoding": ("linear", "srgb"),
    "depth_type": DEPTH_TYPES,
    "depth": DEPTHS,
    "motion_type": MOTION_TYPES,
    "motion_unit": MOTION_UNITS,
    "motion_direction": tuple(DIRECTIONS),
    "motion_y": VERTICALS,
    "camera_motion": CAMERA_MOTIONS,
}
MOST_JITTER = 16.0  # pixels
NO_JITTER = (0.0, 0.0)
MOST_PLANES = 1e30  # times the near plane: the far plane of logarithmic depth
MOST_RATIO = 3  # of the sides of color and geometry

# Flags of the SDKs' headers.
_FSR_DISPLAY_RESOLUTION_MOTION_VECTORS, _FSR_JITTER_CANCELLATION = 1 << 1, 1 << 2
_FSR_DEPTH_INVERTED, _FSR_DEPTH_INFINITE = 1 << 3, 1 << 4
_XEFG_INVERTED_DEPTH, _XEFG_HIGH_RES_MV, _XEFG_USE_NDC_VELOCITY, _XEFG_JITTERED_MV = 1 << 0, 1 << 2, 1 << 3, 1 << 4
_XR_USE_2D_MOTION_VECTOR = 1 << 0
_SL_INVALID_FLOAT = float(np.finfo(np.float32).max)  # what Streamline's constants hold until they are set


@dataclass(frozen=True)
class FrameFormat:
    """Description of an engine's buffers of color, depth and motion, where they differ from our conventions.

    The defaults are our conventions, except that they do not fix the sizes. `Pipeline(…, format=…)` converts such
    buffers on the device. `fsr3`, `streamline`, `xess` and `openxr` make descriptions from the fields that
    integrations of these have filled already; `dataclasses.replace` changes single fields.

    Parameters
    ----------
    color_size, geometry_size : (int, int) or None
        Width and height of color, and of depth and motion, in pixels. None: the pipeline's render size. Depth and
        motion may be up to three times smaller than color, each way; `RenderedFrame.geometry_size` changes their size
        from frame to frame.
    rows : "down" or "up"
        "up": the first row of all three buffers is the lowest one of the image, as `glReadPixels` returns it.
    color_type : "float16", "float32", "unorm16" or "unorm8"
        Type of a color channel in device buffers; unorm stands for 0 to 1. NumPy arrays are taken by their own types:
        uint8 and uint16 are unorm.
    color_channels : int
        3 or 4 (RGB or RGBA), in device buffers.
    color_encoding : "linear" or "srgb"
        Linear light, or sRGB (IEC 61966-2-1), which continues above 1 and is linear below 0.
    depth_type : "float32", "unorm16" or "unorm24"
        Type of depth in device buffers. unorm24 are the low 24 bits of 32, as in Direct3D and Vulkan.
    depth : "linear", "device", "logarithmic" or "distance"
        Planar depth; the value of a depth buffer, in which 1/z is linear; one in which the logarithm of z is:
        log(z/near_z) / log(far_z/near_z), with near_z 0 that of 1 + z: log(1 + z) / log(1 + far_z); or the distance
        from the camera, along the ray through the pixel's center.
    near_z, far_z : float
        Planar depth, or distance, where the buffer holds the first and the second value of `depth_range`: in world
        units after `depth_scale`. Device depth has no 0; one of them may be infinite.
    depth_scale : float
        Factor that makes world units of linear depth and of distances, such as .01 of centimeters. It is 1 for other
        depth, whose planes are in world units.
    depth_range : (float, float)
        (0, 1); reversed depth: (1, 0), or `near_z` and `far_z` swapped.
    motion_type : "float32", "float16", "unorm16" or "snorm16"
        Type of a motion component in device buffers. snorm16 stands for −1 to 1.
    motion_channels : int
        2 to 4, in device buffers; those after x and y are not used.
    motion_scale, motion_offset : (float, float)
        Factor and then addend that make motion in `motion_unit` from the stored values of x and y.
    motion_unit : "pixels", "color_pixels", "uv" or "ndc"
        Pixels of the motion image, pixels of the color image, 0 to 1 across the image, or −1 to 1 across it.
    motion_direction : "to_previous" or "from_previous"
        (previous − here), or (here − previous).
    motion_y : "down" or "up"
        The direction of positive y.
    motion_dilated : bool
        Whether pixels hold the vector of the nearest of the 3×3 pixels around them. Conversion undoes it.
    motion_jittered : bool
        Whether vectors include `RenderedFrame.geometry_jitter`, which conversion then removes.
    motion_invalid : float or None
        Stored value that both components have where no vector was written: motion is unknown there.
    camera_motion : "included", "movers_only" or "excluded"
        Whether vectors include the motion of the camera. "movers_only": they do, but only movers have vectors; the
        camera's own motion is taken where both components hold `motion_invalid`. "excluded": they are what remains
        after the camera's motion of a static point was subtracted; it is added.

    Raises
    ------
    GffeError
        For values other than these.
    """

    color_size: tuple[int, int] | None = None
    geometry_size: tuple[int, int] | None = None
    rows: str = "down"
    color_type: str = "float16"
    color_channels: int = 4
    color_encoding: str = "linear"
    depth_type: str = "float32"
    depth: str = "linear"
    near_z: float = 0.0
    far_z: float = 1.0
    depth_scale: float = 1.0
    depth_range: tuple[float, float] = (0.0, 1.0)
    motion_type: str = "float32"
    motion_channels: int = 2
    motion_scale: tuple[float, float] = (1.0, 1.0)
    motion_offset: tuple[float, float] = (0.0, 0.0)
    motion_unit: str = "pixels"
    motion_direction: str = "to_previous"
    motion_y: str = "down"
    motion_dilated: bool = False
    motion_jittered: bool = False
    motion_invalid: float | None = None
    camera_motion: str = "included"

    def __post_init__(self) -> None:
        checked: dict[str, Any] = {
            name: None if getattr(self, name) is None else require_size(getattr(self, name), _what(name), whole=True)
            for name in ("color_size", "geometry_size")
        }
        for name, allowed in CHOICES.items():
            require_choice(getattr(self, name), allowed, _what(name))
        for name, limits in CHANNELS.items():
            checked[name] = require_whole(getattr(self, name), _what(name), *limits)
        for name in ("depth_range", "motion_scale", "motion_offset"):
            checked[name] = tuple(require_vector(getattr(self, name), _what(name), 2).tolist())
        for name in ("near_z", "far_z"):
            infinite, label = self.depth == "device", f"{_what(name)} of {self.depth} depth"
            checked[name] = require_number(getattr(self, name), label, infinite=infinite)
        for name in ("motion_dilated", "motion_jittered"):
            checked[name] = require_bool(getattr(self, name), _what(name))
        checked["depth_scale"] = require_positive(self.depth_scale, _what("depth_scale"))
        if self.motion_invalid is not None:
            checked["motion_invalid"] = require_number(self.motion_invalid, _what("motion_invalid"))
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        self._require_planes()
        if 0.0 in self.motion_scale:
            raise GffeError(f"format: motion_scale must not contain 0, got {shown(list(self.motion_scale))}")
        if self.camera_motion == "movers_only" and self.motion_invalid is None:
            raise GffeError("format: camera_motion movers_only needs motion_invalid, the value without a vector")

    def _require_planes(self) -> None:
        planes = f"near_z {self.near_z:g}, far_z {self.far_z:g}"
        if self.near_z == self.far_z or self.depth_range[0] == self.depth_range[1]:
            raise GffeError(f"format: near_z and far_z must differ, and so must depth_range, got {planes}")
        if self.depth not in SCALED_DEPTHS and self.depth_scale != 1:
            raise GffeError(
                f"format: depth_scale must be 1 with {self.depth} depth, whose near_z and far_z are in world units, got"
                f" {self.depth_scale:g}"
            )
        near, far = sorted((self.near_z, self.far_z))
        if self.depth == "device" and not near > 0:
            raise GffeError(f"format: device depth needs near_z and far_z greater than 0, got {planes}")
        if self.depth == "logarithmic" and not 0 <= near < far <= MOST_PLANES * (near or 1):
            raise GffeError(
                f"format: logarithmic depth needs near_z and far_z of 0 or more, up to {MOST_PLANES:g} times apart,"
                f" got {planes}"
            )

    # ---- from the fields of SDKs -----------------------------------------------------------------------

    @classmethod
    def fsr3(
        cls,
        *,
        renderSize: Any,
        displaySize: Any = None,
        motionVectorScale: Any = (1.0, 1.0),
        cameraNear: float,
        cameraFar: float = math.inf,
        flags: int = 0,
        **others: Any,
    ) -> FrameFormat:
        """Return the description of what an integration of AMD FSR 3 frame generation provides.

        The arguments are fields of `ffxDispatchDescFrameGenerationPrepareV2` and
        `ffxCreateContextDescFrameGeneration` (`flags`: the bits `FFX_FRAMEGENERATION_ENABLE_…`), in the header
        `ffx_framegeneration` of the FidelityFX SDK. There vectors lead "from a pixel in the current frame to the
        position of that same pixel in the previous frame" and are in pixels after motionVectorScale, y down
        (https://gpuopen.com/manuals/fidelityfx_sdk/techniques/super-resolution-upscaler/). Infinite depth ignores
        cameraFar; near and far may be swapped. `others` are fields of `FrameFormat`. Pass `jitterOffset` as
        `RenderedFrame.geometry_jitter`. Raises GffeError for vectors at display resolution beside smaller depth.
        """
        flags = require_whole(flags, "fsr3: flags", 0)
        render = require_size(renderSize, "fsr3: renderSize", whole=True)
        display = render if displaySize is None else require_size(displaySize, "fsr3: displaySize", whole=True)
        if flags & _FSR_DISPLAY_RESOLUTION_MOTION_VECTORS and render != display:
            raise GffeError(
                f"fsr3: motion vectors at display resolution {_by(display)} beside depth at {_by(render)}"
                " (expected both at renderSize)"
            )
        planes = [
            require_number(value, f"fsr3: {name}", infinite=True)
            for name, value in (("cameraNear", cameraNear), ("cameraFar", cameraFar))
        ]
        near, far = min(planes), math.inf if flags & _FSR_DEPTH_INFINITE else max(planes)
        made: dict[str, Any] = dict(
            color_size=display,
            geometry_size=render,
            motion_scale=motionVectorScale,
            motion_jittered=bool(flags & _FSR_JITTER_CANCELLATION),
            motion_type="float16",
            **_device_depth(near, far, bool(flags & _FSR_DEPTH_INVERTED)),
        )
        return cls(**(made | others))

    @classmethod
    def streamline(
        cls,
        *,
        mvecScale: Any,
        cameraNear: float,
        cameraFar: float,
        depthInverted: bool,
        cameraMotionIncluded: bool = True,
        motionVectors3D: bool = False,
        motionVectorsDilated: bool = False,
        motionVectorsJittered: bool = False,
        motionVectorsInvalidValue: float | None = None,
        orthographicProjection: bool = False,
        **others: Any,
    ) -> FrameFormat:
        """Return the description of what an integration of NVIDIA DLSS frame generation (DLSS-G) provides.

        The arguments are fields of `sl::Constants` in the header `sl_consts` of Streamline. mvecScale brings vectors
        into the range −1 to 1 of a whole image, so 1/width for vectors in pixels
        (https://github.com/NVIDIAGameWorks/Streamline, programming guide of DLSS-G, section 7.0); they lead from the
        current to the previous frame, y down.
        Without cameraMotionIncluded pixels of motionVectorsInvalidValue (by default 0) have the camera's motion alone,
        as in its `shaders/mvec.hlsl`. `others` are fields of `FrameFormat`, such as sizes. Pass `jitterOffset`, in
        pixels, as `RenderedFrame.geometry_jitter`. Raises GffeError for an orthographic projection.
        """
        if require_bool(orthographicProjection, "streamline: orthographicProjection"):
            raise GffeError("streamline: orthographicProjection is not supported (expected a perspective projection)")
        invalid = motionVectorsInvalidValue
        if is_number(invalid) and scalar(invalid) == _SL_INVALID_FLOAT:
            invalid = None
        included = require_bool(cameraMotionIncluded, "streamline: cameraMotionIncluded")
        if not included and invalid is None:
            invalid = 0.0
        made: dict[str, Any] = dict(
            motion_scale=mvecScale,
            motion_unit="uv",
            motion_type="float16",
            motion_channels=4 if require_bool(motionVectors3D, "streamline: motionVectors3D") else 2,
            motion_dilated=motionVectorsDilated,
            motion_jittered=motionVectorsJittered,
            motion_invalid=invalid,
            camera_motion="included" if included else "movers_only",
            **_device_depth(cameraNear, cameraFar, require_bool(depthInverted, "streamline: depthInverted")),
        )
        return cls(**(made | others))

    @classmethod
    def xess(
        cls,
        *,
        projectionMatrix: Any,
        motionVectorScaleX: float = 1.0,
        motionVectorScaleY: float = 1.0,
        initFlags: int = 0,
        **others: Any,
    ) -> FrameFormat:
        """Return the description of what an integration of Intel XeSS frame generation (XeSS-FG) provides.

        The arguments are fields of `xefg_swapchain_frame_constant_data_t` (projectionMatrix: 16 numbers or 4 rows,
        row-major, for row vectors or column vectors) and `xefg_swapchain_d3d12_init_params_t` (initFlags: the bits
        `XEFG_SWAPCHAIN_INIT_FLAG_…`), in the header `xefg_swapchain`. Vectors lead from the current to the previous
        frame, in pixels y down or, by flag, in normalized device coordinates y up; those of high resolution are dilated
        (https://github.com/intel/xess, developer guide of XeSS-FG, "Motion Vectors"). `others` are fields
        of `FrameFormat`, such as sizes. Pass `jitterOffsetX` and `jitterOffsetY` as `RenderedFrame.geometry_jitter`.
        Raises GffeError for another than a perspective projection.
        """
        flags = require_whole(initFlags, "xess: initFlags", 0)
        near, far = depth_planes(square(projectionMatrix, "projectionMatrix"), bool(flags & _XEFG_INVERTED_DEPTH))
        in_ndc = flags & _XEFG_USE_NDC_VELOCITY
        made: dict[str, Any] = dict(
            motion_scale=(motionVectorScaleX, motionVectorScaleY),
            motion_type="float16",
            motion_unit="ndc" if in_ndc else "pixels",
            motion_y="up" if in_ndc else "down",
            motion_dilated=bool(flags & _XEFG_HIGH_RES_MV),
            motion_jittered=bool(flags & _XEFG_JITTERED_MV),
            **_device_depth(near, far, bool(flags & _XEFG_INVERTED_DEPTH)),
        )
        return cls(**(made | others))

    @classmethod
    def openxr(
        cls,
        *,
        motionVectorScale: Any = (1.0, 1.0, 1.0, 0.0),
        motionVectorOffset: Any = (0.0, 0.0, 0.0, 0.0),
        minDepth: float = 0.0,
        maxDepth: float = 1.0,
        nearZ: float,
        farZ: float,
        layerFlags: int = 0,
        **others: Any,
    ) -> FrameFormat:
        """Return the description of what an application provides for OpenXR's XR_EXT_frame_synthesis.

        The arguments are fields of `XrFrameSynthesisInfoEXT`. Stored values · scale + offset are "(CurrNDC −
        PrevNDC)", in Vulkan's coordinates, y down; nearZ is the distance of minDepth and farZ that of maxDepth, either
        of which may be the greater one or infinite
        (https://registry.khronos.org/OpenXR/specs/1.1/man/html/XrFrameSynthesisInfoEXT.html). Only the components x and
        y are used. `others` are fields of `FrameFormat`, such as sizes. `appSpaceDeltaPose` belongs into the cameras.
        """
        flags = require_whole(layerFlags, "openxr: layerFlags", 0)
        scale, offset = (
            require_vector(require_array(given, f"openxr: {name}", (2, 4))[:2], f"openxr: {name}", 2)
            for name, given in (("motionVectorScale", motionVectorScale), ("motionVectorOffset", motionVectorOffset))
        )
        made: dict[str, Any] = dict(
            motion_scale=tuple(scale.tolist()),
            motion_offset=tuple(offset.tolist()),
            motion_unit="ndc",
            motion_direction="from_previous",
            motion_y="down",
            motion_type="float16",
            motion_channels=2 if flags & _XR_USE_2D_MOTION_VECTOR else 4,
            depth="device",
            near_z=nearZ,
            far_z=farZ,
            depth_range=(minDepth, maxDepth),
        )
        return cls(**(made | others))

    # ---- in text ---------------------------------------------------------------------------------------

    def to_json(self) -> dict[str, Any]:
        """Return the fields that differ from the defaults, as JSON has them: infinity as "infinity"."""
        changed = {f.name: v for f in fields(self) if (v := getattr(self, f.name)) != f.default}
        return {
            name: _JSON_INFINITY if v == math.inf else list(v) if isinstance(v, tuple) else v
            for name, v in changed.items()
        }

    @classmethod
    def from_json(cls, given: Any) -> FrameFormat:
        """Return the description of which `to_json` gave the fields. Raises GffeError for others."""
        given = require_kind(given, dict, "format", "an object")
        names = [f.name for f in fields(cls)]
        unknown = [name for name in given if name not in names]
        if unknown:
            raise GffeError(f"format: unknown field '{unknown[0]}' (expected {', '.join(names)})")
        values: dict[str, Any] = {
            n: math.inf if isinstance(v, str) and v == _JSON_INFINITY else v for n, v in given.items()
        }
        return cls(**values)

    # ---- in numbers ------------------------------------------------------------------------------------

    @property
    def is_ours(self) -> dict[str, bool]:
        """Whether device buffers of "color" and "geometry" need no conversion."""
        plain = FrameFormat()
        own = {f.name: getattr(self, f.name) == getattr(plain, f.name) for f in fields(self)}
        for name in ("color_size", "geometry_size"):
            del own[name]
        color = own["rows"], *(own.pop(f"color_{name}") for name in ("type", "channels", "encoding"))
        return {"color": all(color), "geometry": all(own.values())}


_JSON_INFINITY = "infinity"


def require_render_size(
    format: FrameFormat | None, size: tuple[int, int], geometry_size: tuple[int, int] | None = None
) -> tuple[int, int]:
    """Return the size of depth and motion: `geometry_size`, that of a frame, else that of the description, else `size`,
    that of color. Raises GffeError for color of another size, and for larger or much smaller geometry."""
    color = (format and format.color_size) or size
    if color != size:
        raise GffeError(f"format: color is {_by(color)} (expected the render size {_by(size)})")
    geometry = geometry_size or (format and format.geometry_size) or size
    if not all(n // MOST_RATIO <= m <= n for n, m in zip(size, geometry, strict=True)):
        raise GffeError(
            f"format: geometry is {_by(geometry)} and color {_by(size)} (expected depth and motion of the size of color"
            f" or up to {MOST_RATIO} times smaller, each way)"
        )
    return geometry


def require_jitter(value: Any, label: str = "frame") -> tuple[float, float]:
    """Return the jitter of a frame's geometry. Raises a GffeError that begins with `label` unless it is two numbers, of
    pixels, up to 16."""
    if value is NO_JITTER:
        return NO_JITTER
    x, y = require_vector(value, f"{label}: geometry_jitter", 2).tolist()
    if max(abs(x), abs(y)) > MOST_JITTER:
        raise GffeError(f"{label}: geometry_jitter must be in pixels, up to {MOST_JITTER:g}, got {shown([x, y])}")
    return x, y


def conversion(
    format: FrameFormat,
    size: tuple[int, int],
    types: Mapping[str, str | None],
    channels: Mapping[str, int],
    jitter: tuple[float, float] = (0.0, 0.0),
    previous_jitter: tuple[float, float] = (0.0, 0.0),
    geometry: tuple[int, int] | None = None,
) -> dict[str, Any]:
    """Return the members `given_…` of the frame block (kernels/frame.h), and those about the geometry, that convert a
    frame.

    `size`: width and height of color, pixels. `types`: of color, depth and motion as given, by name, None for missing
    motion. `channels`: of color and motion. `jitter`, `previous_jitter`: of the geometry of this frame and the one
    before, pixels of color. `geometry`: width and height of depth and motion (None: `size`).
    """
    motion_type, depth_type, geometry = types["motion"], types["depth"], geometry or size
    scale = scale_of(size, geometry)
    shift = jitter if geometry != size else (0.0, 0.0)  # of geometry that is spread over color
    numbered = [_number(types[name]) for name in ("color", "depth", "motion")]
    invalid = math.nan
    if format.motion_invalid is not None and motion_type:
        invalid = _stored(format.motion_invalid, motion_type)
    return {
        "given_motion": _motion_numbers(format, size, motion_type, jitter, previous_jitter, scale),
        "given_depth": _depth_numbers(format, depth_type),
        "motion_invalid": invalid,
        "given_types": (*numbered, CAMERA_MOTIONS.index(format.camera_motion)),
        "given_channels": (channels["color"], channels["motion"]),
        "depth_law": DEPTHS.index(format.depth),
        "rows_up": int(format.rows == "up"),
        "color_srgb": int(format.color_encoding == "srgb"),
        "geometry_width": geometry[0],
        "geometry_height": geometry[1],
        "to_geometry": (*(1 / n for n in scale), *(j / n for j, n in zip(shift, scale, strict=True))),
        "from_geometry": (*scale, *(-j for j in shift)),
    }


def scale_of(size: tuple[int, int], geometry: tuple[int, int]) -> tuple[float, float]:
    """Return how many pixels of color, of `size`, are as wide and as high as one of the `geometry`."""
    return size[0] / geometry[0], size[1] / geometry[1]


def jitter_in_color(
    jitter: tuple[float, float], size: tuple[int, int], geometry: tuple[int, int]
) -> tuple[float, float]:
    """Return the jitter of the geometry in pixels of color, of `size`."""
    scale = scale_of(size, geometry)
    return jitter[0] * scale[0], jitter[1] * scale[1]


def _number(name: str | None) -> int:
    return 0 if name is None else 1 + list(TYPES).index(name)


def _stored(value: float, type_name: str) -> float:
    """Return the number that a kernel loads for `value`: rounded to the type, integers unscaled."""
    dtype, most = TYPES[type_name]
    if most == 1.0:
        with np.errstate(over="ignore"):
            return float(dtype(value))
    return float(np.round(value * most))


def _motion_numbers(
    format: FrameFormat,
    size: tuple[int, int],
    type_name: str | None,
    jitter: tuple[float, float],
    previous_jitter: tuple[float, float],
    scale: tuple[float, float],
) -> tuple[float, ...]:
    """Return factors and addends for x and y that make motion in pixels of color from stored numbers. `scale`: such
    pixels in a pixel of the motion image."""
    most = TYPES[type_name][1] if type_name else 1.0
    sign = DIRECTIONS[format.motion_direction]
    factors, addends = [], []
    for axis in range(2):
        unit = {"pixels": scale[axis], "color_pixels": 1.0, "uv": float(size[axis]), "ndc": size[axis] / 2}
        factor = sign * unit[format.motion_unit] * (-1.0 if axis and format.motion_y == "up" else 1.0)
        factors.append(factor * format.motion_scale[axis] / most)
        jittered = jitter[axis] - previous_jitter[axis] if format.motion_jittered else 0.0
        addends.append(factor * format.motion_offset[axis] + jittered)
    return (*factors, *addends)


def _depth_numbers(format: FrameFormat, type_name: str | None) -> tuple[float, ...]:
    """Return (factor, origin, addend, sky): factor · (stored − origin) + addend is depth, or 1/depth of device depth.
    The origin is the far end, from which differences are exact. Device depth `sky`, as in a cleared buffer, is sky.
    Logarithmic depth has the near end as origin, where the natural logarithm is 0, and near_z as addend."""
    assert type_name is not None
    most = TYPES[type_name][1]
    ends = sorted(zip((format.near_z, format.far_z), format.depth_range, strict=True), reverse=True)
    (far, far_value), (near, near_value) = ends
    if format.depth in SCALED_DEPTHS:
        factor = (far - near) / (far_value - near_value) / most
        return factor * format.depth_scale, near_value * most, near * format.depth_scale, math.nan
    if format.depth == "logarithmic":
        above = 0.0 if near else 1.0
        factor = math.log((far + above) / (near + above)) / (far_value - near_value) / most
        return factor, near_value * most, near, far_value * most
    factor = (1 / near - 1 / far) / (near_value - far_value) / most
    return factor, far_value * most, 1 / far, far_value * most


def _device_depth(near: Any, far: Any, inverted: bool) -> dict[str, Any]:
    return {"depth": "device", "near_z": near, "far_z": far, "depth_range": (1.0, 0.0) if inverted else (0.0, 1.0)}


def _what(name: str) -> str:
    return f"format: {name}"


def _by(size: tuple[int, int]) -> str:
    return f"{size[0]}×{size[1]}"
