"""Presentation: the display part of a rendered frame (paper: 'Adaptive rendering window'), and overlays that are not
warped with the picture (the paper's limitation 'effects without depth')."""

from __future__ import annotations

import threading
from dataclasses import replace
from functools import cache, lru_cache
from typing import Any

import numpy as np
import pyopencl as cl

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import require_array, require_kind, require_size
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.rendered_frame import (
    OVERLAYS,
    Overlays,
    RenderedFrame,
    display_camera_of,
    host_arrays,
    is_shown_whole,
    require_one_pose,
)
from gffe_cl.engine.opencl.device import Device, open_device
from gffe_cl.engine.stages.base import Board, Kernel, Stage, Step
from gffe_cl.engine.stages.buffers import RGBA, XY, BufferSpec, DeviceFrame, Sizes, given_buffer
from gffe_cl.engine.stages.frame_block import mapping
from gffe_cl.engine.stages.upload import Upload


class Composition(Stage):
    """Keeps pixels of `fixed_mask` in place, and lays effects and user interface over the picture.

    Pixels that stay in place have no depth for the other stages, so that nothing of them is warped or remembered; the
    area that they uncover is a disocclusion like others. `active`: whether the last submitted frame brought overlays.
    """

    name = "composition"
    swaps_alone = True
    buffers = (
        BufferSpec(
            "depth",
            np.float32,
            (),
            "source",
            "depth of the rendered frame without overlays that keep place",
            "depth",
            kept=True,
        ),
        BufferSpec("fixed_mask", np.uint8, (), "source", "1 where the rendered pixel stays in place", "mask"),
        BufferSpec("effects", np.float16, RGBA, "source", "effects without depth, premultiplied", "color"),
        BufferSpec("effects_motion", np.float32, XY, "source", "their motion t → t−1, pixels", "motion"),
        BufferSpec("ui", np.float16, RGBA, "target", "user interface, premultiplied", "color"),
        BufferSpec("color", np.float16, RGBA, "target", "the picture with all of these", "color"),
    )

    kernels = (
        Kernel(
            "leave_out_fixed",
            "source",
            {"depth": "rendered.depth", "fixed_mask": "composition.fixed_mask"},
            {"out_depth": "composition.depth"},
        ),
        Kernel(
            "compose",
            "target",
            {
                **{name: f"composition.{name}" for name in OVERLAYS},
                "source_color": "rendered.color",
                "source_depth": "rendered.depth",
                "color": "frame.color",  # or the output of stages after the frame's
            },
            {
                "out_color": "composition.color",
                **{name: f"frame.{name}" for name in ("depth", "motion", "dynamic", "disoccluded", "filled_by")},
            },
        ),
    )

    def __init__(self, board: Board):
        super().__init__(board)
        self.layers: dict[str, cl.Buffer] = {}  # of the last frame, by the fields of Overlays
        self._given: Any = None  # the frame that brought the layers

    @property
    def active(self) -> bool:
        return bool(self.layers)

    def held(self) -> list[BufferSpec]:
        """Return the buffers that hold something, except the caller's own."""
        own = {name for name, buffer in self.layers.items() if buffer is self.buffer[name]}
        return [spec for spec in self.buffers if spec.name in own | {"color"}]

    def prepared(self, overlays: Overlays | None) -> dict[str, np.ndarray | cl.Buffer]:
        """Return the given overlays in the form that `take` expects. Raises GffeError for wrong shapes."""
        arrays = {name: getattr(overlays, name) for name in OVERLAYS} if overlays else {}
        ready = {name: self._ready(name, array) for name, array in arrays.items() if array is not None}
        if "effects_motion" in ready and "effects" not in ready:
            raise GffeError("frame: effects_motion without effects (expected both, or effects alone)")
        return ready

    def take(self, ready: dict[str, np.ndarray | cl.Buffer], frame: DeviceFrame) -> DeviceFrame:
        """Take the overlays of `frame`, and return the frame for the other stages: its depth has holes where pixels are
        fixed."""
        self._given, self.layers = frame, {}
        for name, array in ready.items():
            self.layers[name] = array if isinstance(array, cl.Buffer) else self.buffer[name]
            if not isinstance(array, cl.Buffer):
                cl.enqueue_copy(self.device.queue, self.buffer[name], array)
        self.swap()
        if "fixed_mask" not in self.layers:
            return frame
        self.launch("leave_out_fixed", self._step(), depth=frame.depth, fixed_mask=self.layers["fixed_mask"])
        return replace(frame, depth=self.buffer["depth"])

    def compose(self, color: cl.Buffer, alpha: float, rendered: bool = False) -> cl.Buffer:
        """Return `color` (display) with the overlays at t + α. `rendered`: it is the rendered frame's, which shows
        overlays fixed in place already."""
        self.launch(
            "compose",
            self._step(alpha),
            is_rendered=rendered,
            color=color,
            source_color=self._given.color,
            source_depth=self._given.depth,
            **{name: self.layers.get(name, self.buffer[name]) for name in OVERLAYS},
        )
        return self.buffer["color"]

    def _step(self, alpha: float = 0.0) -> Step:
        brought = sum((name in self.layers) << bit for bit, name in enumerate(OVERLAYS))
        return Step(self._given, None, [self._given.time], alpha=alpha, given={"has_overlays": brought})

    def _ready(self, name: str, array) -> Any:
        """Return an overlay as the device takes it: the caller's buffer, or a checked array. Raises GffeError for wrong
        shapes."""
        spec = self.spec(name)
        if buffer := given_buffer(array, spec, self.sizes, self.device):
            return buffer
        is_mask = name == "fixed_mask"
        array = require_array(array, f"frame: {name}", *spec.shape(self.sizes), kinds="biuf" if is_mask else "iuf")
        if is_mask:
            return np.ascontiguousarray(array > 0, np.uint8)
        with np.errstate(over="ignore"):
            return np.ascontiguousarray(array, spec.dtype)


_ONE_AT_A_TIME = threading.Lock()  # the cached stages of `present` serve all threads


class Presentation(Stage):
    """Resamples a frame that was rendered through a window to its display camera."""

    name = "presentation"
    paper = "Adaptive rendering window"
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
    require_kind(frame, RenderedFrame, "frame")
    if previous is not None:
        require_kind(previous, RenderedFrame, "frame")
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
