"""The shading correction network in the pipeline (paper: 'Shading Correction Network')."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import pyopencl as cl

from gffe_cl.inference.network import INPUT_PLANES, OUTPUT_PLANES, Network, load_network
from gffe_cl.opencl.program import constants
from gffe_cl.stages.base import Access, Board, Kernel, Stage, Step
from gffe_cl.stages.buffers import RGBA, BufferSpec
from gffe_cl.stages.shading import SEEN
from gffe_cl.stages.shading_trend import ShadingTrend

_CONSTANTS = constants("correction.cl")
_WITHIN_MASK, _WITH_REFINED = _CONSTANTS["WITHIN_MASK"], _CONSTANTS["WITH_REFINED"]

_IMAGE_PIXELS = 4  # per pixel of the network
_EVENTS = 1024  # of mapping that are kept until they are taken


class ShadingCorrection(Stage):
    """Corrects shading that moves otherwise than its surface: shadows, reflections.

    Colour goes into the network as e(c) = ln(1 + μ x) / ln(1 + μ), x = exposure · c / 8, and comes back by the inverse.
    With U for bilinear interpolation from half resolution, L for the encoded GAE colour there and g for it at full:
    refined = e⁻¹(U(L) + U(Δ) + U(keep) · (g − U(L))), final = GAE · (1 − U(M)) + refined · U(M) in linear colour.

    `unusable_pixels`: of all frames so far, where the network gave NaN or infinity; they keep the GAE colour.
    `with_refined`: whether `refined` is made too, from the next frame on.
    """

    name = "correction"
    pictures: ClassVar[Mapping[str, str]] = {"extrapolated": "color"}
    buffers = (
        BufferSpec(
            "frames", np.float32, (), "network", "what the network sees: encoded GAE colour (1–3), encoded warped"
            " previous frame (4–6), inverse depth (7), input mask (8); half resolution",
            planes=INPUT_PLANES, mapped=True,
        ),
        BufferSpec(
            "correction", np.float32, (), "network", "what the network says: change of encoded colour (1–3), share of"
            " detail that stays (4), focus mask (5); half resolution",
            planes=OUTPUT_PLANES, mapped=True,
        ),
        BufferSpec(
            "histogram", np.uint32, (), "once", "of the depths' leading bits",
            planes=_CONSTANTS["BINS"], scratch=True,
        ),
        BufferSpec("median_depth", np.float32, (), "once", "of the finite depths of every eighth row, to 1/256"),
        BufferSpec(
            "refined", np.float16, RGBA, "target", "the network's image, without focus mask; made where somebody looks"
            " at it", "color",
        ),
        BufferSpec("focus_mask", np.float16, (), "target", "where it counts (M), 0 below 1/32"),
        BufferSpec("color", np.float16, RGBA, "target", "the final image: refined within M, else GAE", "color"),
    )  # fmt: skip

    kernels = (
        Kernel(
            "depth_histogram",
            "target",
            {"depth": Access("frame.depth", 1 / 8), "histogram": "correction.histogram"},
            {"histogram": "correction.histogram"},
            step=("LANES", "STRIP"),
        ),
        Kernel(
            "find_median",
            "once",
            {"histogram": "correction.histogram"},
            {"median_depth": "correction.median_depth"},
            group="SCANNERS",
        ),
        Kernel(
            "network_input",
            "network",
            {
                **SEEN,
                "median_depth": "correction.median_depth",
            },
            {"planes": "correction.frames"},
            step=("LANES", 1),
        ),
        Kernel(
            "correct",
            "target",
            {
                "color": "frame.color",
                "frames": Access("correction.frames", planes=3),
                "correction": "correction.correction",
            },
            {
                "refined": Access("correction.refined", 0.0),  # unless `with_refined`
                "focus_mask": "correction.focus_mask",
                "out_color": "correction.color",
            },
            step=("LANES", 1),
        ),
    )

    def __init__(self, board: Board, load: bool = True):
        """Without `load` there are the kernels alone, no network."""
        super().__init__(board)
        self.network: Network | None = None
        if load:
            self.network = load_network(board.options.scn_model, board.options.scn_provider)
            self.network.prepare(*reversed(self.network_size))
        self._network_milliseconds = 0.0
        self._copying_milliseconds = 0.0
        self._mappings: deque[cl.Event] = deque(maxlen=_EVENTS)
        self.unusable_pixels = 0
        self.with_refined = False

    @classmethod
    def is_wanted(cls, options) -> bool:
        return options.corrects_shading

    def look_at(self, names: set[str] | None) -> None:
        self.with_refined = names is None or "correction.refined" in names

    def extrapolated(self, step: Step) -> None:
        """Make the final image of the filled frame; waits for the network."""
        if step.previous is None:
            self.skip()
            return
        self.prepare(step)
        self.infer(step.alpha)
        self.compose(step, self.board.options.focus_mask)

    def skip(self) -> None:
        """Nothing to go by: the final image is the extrapolated one."""
        for name in ("color", "refined") if self.with_refined else ("color",):
            self.copy(f"correction.{name}", "frame.color")
        self.fill("focus_mask", 0)

    def prepare(self, step: Step) -> None:
        """Fill `frames`."""
        self.fill("histogram", 0)
        self.launch("depth_histogram", step)
        self.launch("find_median")
        self.launch("network_input", step)

    def infer(self, alpha: float) -> None:
        """Fill `correction`: the network works in the mapped buffers: no copy where host and device share memory."""
        frames = self.map(self, "frames", cl.map_flags.READ)
        trends = (
            self.map(self.board.stages[ShadingTrend.name], "trends", cl.map_flags.READ)
            if self.network.takes_trends
            else None
        )
        correction = self.map(self, "correction", cl.map_flags.WRITE_INVALIDATE_REGION)
        try:
            start = time.perf_counter()
            self.unusable_pixels += _IMAGE_PIXELS * self.network.run(frames, alpha, correction, trends)
            copying = self.network.copying
            self._network_milliseconds += (time.perf_counter() - start) * 1e3 - copying
            self._copying_milliseconds += copying
        finally:
            for array in filter(lambda array: array is not None, (frames, trends, correction)):
                self._mappings.append(array.base.release(self.device.queue))

    def compose(self, step: Step, within_mask: bool) -> None:
        """Fill `focus_mask` and `color`; without `within_mask` the whole image is the network's."""
        asked = within_mask * _WITHIN_MASK + self.with_refined * _WITH_REFINED
        self.launch("correct", step, asked=asked)

    @property
    def network_size(self) -> tuple[int, int]:
        """Width and height of the network's images."""
        return self.sizes.of("network")

    def map(self, stage: Stage, name: str, flags: int) -> np.ndarray:
        """The memory of a mapped buffer of a stage, once the kernels before are done; to be released on the queue."""
        spec = stage.spec(name)
        array, event = cl.enqueue_map_buffer(
            self.device.queue, stage.buffer[name], flags, 0, spec.shape(self.sizes), spec.dtype
        )
        self._mappings.append(event)
        return array

    def take_network_milliseconds(self) -> dict[str, float]:
        """Since last taken, apart from the kernels'; the device must have finished. "network": time in the network;
        "network copies": from the device to what runs the network, and back."""
        mapping = sum(event.profile.end - event.profile.start for event in self._mappings) * 1e-6
        taken = {"network": self._network_milliseconds, "network copies": self._copying_milliseconds + mapping}
        self._network_milliseconds = self._copying_milliseconds = 0.0
        self._mappings.clear()
        return taken
