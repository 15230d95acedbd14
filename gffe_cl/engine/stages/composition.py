"""Composition of overlays that are not warped with the picture (the paper's limitation 'effects without depth';
frame generation SDKs' masks and UI layers)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pyopencl as cl

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import require_array
from gffe_cl.engine.frame.rendered_frame import OVERLAYS, Overlays
from gffe_cl.engine.stages.base import Board, Kernel, Stage, Step
from gffe_cl.engine.stages.buffers import RGBA, XY, BufferSpec, DeviceFrame, given_buffer


class Composition(Stage):
    """Keeps pixels of `fixed_mask` in place, and lays effects and user interface over the picture.

    Pixels that stay in place have no depth for the other stages, so that nothing of them is warped or remembered; the
    area that they uncover is a disocclusion like others. `active`: whether the last submitted frame brought overlays.
    """

    name = "composition"
    swaps_alone = True
    buffers = (
        BufferSpec(
            "depth", np.float32, (), "source", "depth of the rendered frame without overlays that keep place", "depth",
            kept=True,
        ),
        BufferSpec("fixed_mask", np.uint8, (), "source", "1 where the rendered pixel stays in place", "mask"),
        BufferSpec("effects", np.float16, RGBA, "source", "effects without depth, premultiplied", "color"),
        BufferSpec("effects_motion", np.float32, XY, "source", "their motion t → t−1, pixels", "motion"),
        BufferSpec("ui", np.float16, RGBA, "target", "user interface, premultiplied", "color"),
        BufferSpec("color", np.float16, RGBA, "target", "the picture with all of these", "color"),
    )  # fmt: skip

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
                **{name: f"frame.{name}" for name in
                   ("depth", "motion", "dynamic", "disoccluded", "filled_by")},
            },
        ),
    )  # fmt: skip

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
