"""Presentation: the display part of a rendered frame (paper: 'Adaptive rendering window')."""

from __future__ import annotations

import threading
from dataclasses import replace
from functools import cache, lru_cache

import numpy as np

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import require_array, require_kind, require_size
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.rendered_frame import (
    Overlays,
    RenderedFrame,
    checked_frame,
    display_camera_of,
    host_arrays,
    is_shown_whole,
    require_one_pose,
)
from gffe_cl.engine.opencl.device import Device, open_device
from gffe_cl.engine.stages.base import Board, Kernel, Stage, Step
from gffe_cl.engine.stages.buffers import RGBA, XY, BufferSpec, DeviceFrame, Sizes
from gffe_cl.engine.stages.frame_block import mapping
from gffe_cl.engine.stages.upload import Upload

_ONE_AT_A_TIME = threading.Lock()  # the cached stages of `present` serve all threads


class Presentation(Stage):
    """Resamples a frame that was rendered through a window to its display camera."""

    name = "presentation"
    buffers = (
        BufferSpec(
            "color", np.float16, RGBA, "target", "color of the rendered frame as displayed, linear RGB", "color"
        ),
        BufferSpec("depth", np.float32, (), "target", "its view depth, world units, +inf sky", "depth"),
        BufferSpec(
            "motion", np.float32, XY, "target", "its motion t → t−1 between the displayed images, pixels", "motion"
        ),
    )

    kernels = (
        Kernel(
            "present_color",
            "target",
            {"color": "rendered.color"},
            {"out_color": "presentation.color"},
            step=(1, "PRESENTED_ROWS"),
        ),
        Kernel(
            "present_geometry",
            "target",
            {"depth": "rendered.depth", "motion": "rendered.motion"},
            {"out_depth": "presentation.depth", "out_motion": "presentation.motion"},
        ),
    )

    def held(self) -> tuple[BufferSpec, ...]:
        """Return the buffers that hold something."""
        return self.buffers

    def present(self, frame: DeviceFrame, previous: DeviceFrame | None, with_color: bool = True) -> None:
        """Resample `frame` to its display camera. `previous`: the rendered frame before, of which only the cameras are
        used; None after a reset."""
        step = Step(frame, previous, [frame.time])
        if with_color:
            self.launch("present_color", step, color=frame.color)
        self.launch("present_geometry", step, depth=frame.depth, motion=frame.motion)


def present(
    frame: RenderedFrame,
    previous: RenderedFrame | None = None,
    *,
    size: tuple[int, int] | None = None,
    device: Device | None = None,
) -> RenderedFrame:
    """Return a rendered frame as displayed: its display part, at display resolution.

    Parameters
    ----------
    frame : RenderedFrame of NumPy arrays
        Frame whose `display_camera` is in pixels of an image of `size`.
    previous : RenderedFrame or None
        The rendered frame before, for motion between the images as displayed (only its cameras are used).
    size : (width, height) or None
        Size of the display, pixels; that of the arrays if None.
    device : Device or None
        Device that resamples; the default one if None. In a running `Pipeline`, `Pipeline.present` does the same from
        device to device.

    Returns
    -------
    RenderedFrame
        color (H, W, 3) float32 where float32 or float64 is given, else float16, resampled (cubic); depth (H, W) float32
        and motion (H, W, 2) float32 of the nearest rendered pixel, motion None for a reset or without `previous`;
        `camera` is the display camera. A frame that was not rendered through a window keeps its bits. Where the display
        reaches beyond the rendered image, the image's border is repeated. Motion of sky is converted like all other: it
        must follow the camera, windows included. Overlays are those of the nearest rendered pixel.

    Raises
    ------
    GffeError
        If the display camera has another pose than the render camera, for wrong shapes, or for device buffers.
    """
    frame, previous = checked_frame(frame), previous if previous is None else checked_frame(previous)
    for array in (frame.color, frame.depth):
        if not isinstance(array, np.ndarray):
            raise GffeError("present: expected NumPy arrays (in a pipeline: Pipeline.present)")
    render_size = _size_of(frame)
    host = host_arrays(frame if frame.reset or previous is not None else replace(frame, reset=True))
    size = render_size if size is None else require_size(size, "present: size", whole=True)
    if device is not None:
        require_kind(device, Device, "present: device", "a Device or None")
    display = display_camera_of(frame, render_size, size)
    require_one_pose(frame.camera, display)
    before = None if frame.reset else previous and _cameras_of(previous, size)
    color = np.asarray(frame.color)[..., :3]
    color = color.astype(np.float32 if color.dtype.itemsize > 2 else np.float16, copy=False)
    depth, motion, overlays, bad = host.depth, host.motion, frame.overlays, None
    if size != render_size or not is_shown_whole(frame.camera, display) or (before and not is_shown_whole(*before)):
        stage, upload = _stages(device or _default_device(), Sizes(render_size, size))
        on_device = DeviceFrame.allocate(stage.device, render_size, frame.camera, display, frame.time)
        with _ONE_AT_A_TIME:
            upload.take(host, on_device)
            stage.present(on_device, before and replace(on_device, camera=before[0], display_camera=before[1]))
            shown, depth, motion = (stage.read(name) for name in ("color", "depth", "motion"))
            bad = upload.take_bad_pixels()
        color = shown[..., :3].astype(color.dtype)
        overlays = overlays and _shown_overlays(overlays, mapping(display, frame.camera), render_size, size)
    made = RenderedFrame(
        color, depth, motion if before else None, display, frame.time, reset=frame.reset, overlays=overlays
    )
    made._known_bad = bad
    return made


def _shown_overlays(overlays: Overlays, to_render: np.ndarray, render_size, size) -> Overlays:
    """Return the overlays of the nearest rendered pixel, and the user interface unchanged."""
    x, y = (
        np.clip(np.floor((np.arange(n) + 0.5) * to_render[k] + to_render[2 + k]).astype(int), 0, rendered - 1)
        for k, (n, rendered) in enumerate(zip(size, render_size, strict=True))
    )
    taken = {}
    for name, channels in (("fixed_mask", ()), ("effects", (4,)), ("effects_motion", (2,))):
        if (array := getattr(overlays, name)) is not None:
            array = require_array(array, f"frame: {name}", *reversed(render_size), *channels, kinds="biuf")
            taken[name] = array[y[:, None], x]
    if "effects_motion" in taken:
        taken["effects_motion"] = taken["effects_motion"] / to_render[:2]
    return Overlays(**taken, ui=overlays.ui)


def _cameras_of(frame: RenderedFrame, size: tuple[int, int]) -> tuple[Camera, Camera]:
    """Return render camera and display camera of the frame before."""
    display = display_camera_of(frame, _size_of(frame), size)
    require_one_pose(frame.camera, display)
    return frame.camera, display


def _size_of(frame: RenderedFrame) -> tuple[int, int]:
    """Return width and height of the frame's images."""
    height, width = require_array(frame.depth, "frame: depth", None, None).shape
    return require_size((width, height), "present: size of the frame", whole=True)


@cache
def _default_device() -> Device:
    return open_device()


@lru_cache(maxsize=2)
def _stages(device: Device, sizes: Sizes) -> tuple[Presentation, Upload]:
    board = Board(device, sizes)
    return Presentation(board), Upload(board)
