"""Intake of rendered frames: everything about a frame is checked here, before any work on it begins."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import pyopencl as cl

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import shown
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.frame_format import TYPES, FrameFormat, require_render_size
from gffe_cl.engine.frame.jitter import without_jitter
from gffe_cl.engine.frame.rendered_frame import (
    HostArrays,
    RenderedFrame,
    checked_frame,
    described_arrays,
    display_camera_of,
    host_arrays,
    require_motion,
    require_one_pose,
    type_of,
)
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.stages.buffers import RENDERED, RGBA, BufferSpec, Sizes, given_buffer


@dataclass(frozen=True)
class PreparedFrame:
    """A rendered frame without structural faults.

    Attributes
    ----------
    frame : RenderedFrame
        As given, with `time` and `reset` as Python values.
    display_camera : Camera
        In pixels of the display.
    buffers : dict of str to cl.Buffer
        Device buffers of color, depth and motion, the latter missing if a reset has none; empty for NumPy arrays.
    arrays : HostArrays or None
        NumPy arrays as `Upload` takes them; None for device buffers.
    geometry : (int, int)
        Width and height of depth and motion.
    format : FrameFormat or None
        The description of its buffers; also of geometry that only the frame says to be smaller.
    types : dict of str to str or None
        With a `FrameFormat`: the types of the values given, by name as `TYPES` has them; None for missing motion.
    channels : dict of str to int
        With a `FrameFormat`: the channels of the values given.
    """

    frame: RenderedFrame
    display_camera: Camera
    buffers: dict[str, cl.Buffer]
    arrays: HostArrays | None
    geometry: tuple[int, int]
    format: FrameFormat | None
    types: dict[str, str | None] = field(default_factory=dict)
    channels: dict[str, int] = field(default_factory=dict)


def prepare(
    frame: RenderedFrame,
    sizes: Sizes,
    device: Device,
    jittered: bool = False,
    format: FrameFormat | None = None,
) -> PreparedFrame:
    """Return `frame` ready to be taken by a pipeline of `sizes` on `device`. If it is `jittered`, a display camera that
    is not given is the rendered one without jitter. `format` describes its buffers if they differ from ours.

    Raises GffeError for a structural fault: invalid values, shapes or types, buffers that the device cannot use, motion
    missing although the frame is no reset, or two cameras of different poses.
    """
    frame = checked_frame(frame)
    plain = frame
    if jittered and frame.display_camera is None:
        plain = replace(frame, camera=without_jitter(frame.camera, sizes.source))
    display_camera = display_camera_of(plain, sizes.source, sizes.target)
    require_one_pose(frame.camera, display_camera)
    given: dict[str, Any] = {spec.name: getattr(frame, spec.name) for spec in RENDERED}
    geometry = require_render_size(format, sizes.source, frame.geometry_size)
    if geometry != sizes.source and format is None:
        format = FrameFormat()
    specs = RENDERED if format is None else described_specs(format)
    buffers: dict[str, Any] = {
        s.name: given_buffer(given[s.name], s, sizes if s.name == "color" else replace(sizes, source=geometry), device)
        for s in specs
    }
    if not any(buffers.values()):
        width, height = sizes.source
        if format is None:
            return PreparedFrame(frame, display_camera, {}, host_arrays(frame, height, width), geometry, format)
        arrays = described_arrays(frame, sizes.source, geometry)
        types = {s.name: None if (a := getattr(arrays, s.name)) is None else type_of(a) for s in specs}
        channels = {"color": arrays.color.shape[2], "motion": 2}
        return PreparedFrame(frame, display_camera, {}, arrays, geometry, format, types, channels)
    if buffers["color"] and buffers["depth"] and require_motion(frame) is None:
        del buffers["motion"]
    if other := next((name for name, buffer in buffers.items() if not buffer), None):
        raise GffeError(
            "frame: color, depth and motion must be all NumPy arrays or all device buffers,"
            f" got {other} as {shown(given[other])}"
        )
    if format is None:
        return PreparedFrame(frame, display_camera, buffers, None, geometry, format)
    types = {name: getattr(format, f"{name}_type") if name in buffers else None for name in given}
    channels = {"color": format.color_channels, "motion": format.motion_channels}
    return PreparedFrame(frame, display_camera, buffers, None, geometry, format, types, channels)


def described_specs(format: FrameFormat) -> tuple[BufferSpec, ...]:
    """Return the descriptions of color, depth and motion as device buffers of an engine."""
    color, depth, motion = RENDERED
    letters = {"color": RGBA[: format.color_channels], "depth": (), "motion": "xyzw"[: format.motion_channels]}
    return tuple(
        replace(spec, dtype=TYPES[getattr(format, f"{spec.name}_type")][0], components=tuple(letters[spec.name]))
        for spec in (color, depth, motion)
    )
