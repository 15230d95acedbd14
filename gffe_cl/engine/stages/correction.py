"""The shading correction network in the pipeline (paper: 'Shading Correction Network')."""

from __future__ import annotations

import time
from collections.abc import Hashable, Mapping
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import pyopencl as cl

from gffe_cl.engine.inference.layers import HEAD_LAYERS, HEAD_WEIGHTS, JUDGEMENT_PLANES
from gffe_cl.engine.inference.network import KernelNetwork, Network, load_network
from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.base import Board, Kernel, Stage, Step
from gffe_cl.engine.stages.buffers import RGBA, BufferSpec
from gffe_cl.engine.stages.memory import HostView
from gffe_cl.engine.stages.network import Convolutions, NetworkInput
from gffe_cl.engine.stages.shading import ShadingFlow, ShadingTrend

_CONSTANTS = constants("correction.cl")
_WITHIN_MASK, _WITH_REFINED = _CONSTANTS["WITHIN_MASK"], _CONSTANTS["WITH_REFINED"]

_SEEN, _HIDDEN, _SAID = (_CONSTANTS[name] for name in ("SEEN", "HIDDEN", "SAID"))
assert ((_HIDDEN, _SEEN), (_SAID, _HIDDEN)) == HEAD_LAYERS

_IMAGE_PIXELS = 16  # per pixel of its judgement


class ShadingCorrection(Stage):
    """Corrects shading that moves otherwise than its surface: shadows, reflections.

    The network's convolutions judge candidates at a quarter of the resolution (`judgement`): those of `Convolutions`,
    or onnxruntime's. Kernels make the change of
    encoded color of it, Δ = (GAE frame moved along a flow − GAE frame) + g · trend + δ (`judge`), the first of them
    limited to twice the change since t − 1. With e for the code of color (`NetworkInput`), U for bilinear interpolation
    from half resolution, L for the encoded GAE color there and g for it at full: refined = e⁻¹(U(L) + U(Δ) + U(keep) ·
    (g − U(L))), final = GAE · (1 − U(M)) + refined · U(M) in linear color. M is less, down to 0, where the last
    interval's change of brightness is not that of the interval before. Of detail, at least the share stays that is
    `texture` (`ShadingFlow`). Where the image follows the flow (`followed` there), the final image is half of that, and
    half the GAE frame moved along the flow (`follow_flow`), by at most four times the change since t − 1.

    `unusable_pixels`: number of pixels of all frames so far where the network gave NaN or infinity; they keep the GAE
    color. `with_refined`: whether `refined` is made too, from the next frame on.
    """

    name = "correction"
    paper = "Shading Correction Network"
    pictures: ClassVar[Mapping[str, str]] = {"extrapolated": "color"}
    buffers = (
        BufferSpec(
            "judgement", np.float32, (), "network1", "output of the convolutions, at a quarter of the resolution:"
            " nothing (1, 2), weight of the found flow before the sigmoid (3), how much longer trends"
            " last (4); four pixels of each of four channels of detail (5–20)",
            planes=JUDGEMENT_PLANES, mapped=True,
        ),
        BufferSpec(
            "head", np.float32, (), "once", "weights of the network's last two layers, for each pixel of `correction`",
            planes=HEAD_WEIGHTS, scratch=True,
        ),
        BufferSpec(
            "chosen", np.float32, (), "network1", "the flow that is followed until t + α, x (1) and y (2), in pixels of"
            " half the resolution, how far the trend lasts (3), and how far the focus mask is trusted (4)", planes=4,
        ),
        BufferSpec(
            "correction", np.float32, (), "network", "change of encoded color (1–3), share of detail that stays (4),"
            " focus mask (5); half resolution; nothing changes where the mask is not trusted", planes=5,
        ),
        BufferSpec(
            "refined", np.float16, RGBA, "target", "the network's image, without focus mask; computed only on"
            " demand", "color",
        ),
        BufferSpec("focus_mask", np.float16, (), "target", "where it counts (M), 0 below 1/32"),
        BufferSpec("color", np.float16, RGBA, "target", "the final image: refined within M, else GAE", "color"),
    )  # fmt: skip

    kernels = (
        Kernel(
            "choose_flow",
            "network1",
            {
                "judgement": "correction.judgement",
                "candidates": "shading_flow.candidates",
                "differences": "shading_flow.differences",
            },
            {"chosen": "correction.chosen"},
            step=("LANES", 1),
        ),
        Kernel(
            "judge",
            "network",
            {
                "frames": "network_input.frames",  # all but inverse depth
                "trends": "shading_trend.trends",
                "judgement": "correction.judgement",
                "chosen": "correction.chosen",
                "head": "correction.head",
                "texture": "shading_flow.texture",
                "changed": "shading_trend.changed",
            },
            {"correction": "correction.correction"},
            step=("LANES", 1),
        ),
        Kernel(
            "correct",
            "target",
            {
                "color": "frame.color",
                "frames": "network_input.frames",
                "correction": "correction.correction",
            },
            {
                "refined": "correction.refined",  # unless `with_refined`
                "focus_mask": "correction.focus_mask",
                "out_color": "correction.color",
            },
            step=("LANES", 1),
        ),
        Kernel(
            "follow_flow",
            "target",
            {
                "extrapolated": "frame.color",
                "frames": "network_input.frames",
                "flow": "shading_flow.flow2",
                "followed": "shading_flow.followed",
                "color": "correction.color",
            },
            {"color": "correction.color"},
            step=("LANES", "FOLLOWED_ROWS"),
        ),
    )

    def __init__(self, board: Board, load: bool = True):
        """Create the stage on `board`. Without `load` there are the kernels alone, and no network."""
        super().__init__(board)
        self.network: Any = None  # a Network or a substitute
        self.runs_on_device = False  # whether the stage before makes `judgement`
        if load:
            on_gpu = board.device.info.kind == "gpu"
            self.use(load_network(board.options.scn_model, board.options.scn_provider, on_gpu))
        self._network_milliseconds = 0.0
        self._copying_milliseconds = 0.0
        self._transfers: list[cl.Event] = []  # between these and the device, of the last frame
        self.unusable_pixels = 0
        self.with_refined = False

    @cached_property
    def _views(self) -> tuple[HostView, HostView, HostView]:
        """The network's inputs and output on the host. They are made on first use."""
        staged, inputs = not self.device.shares_memory, self.board.stages
        return (
            HostView(inputs[NetworkInput.name], "frames", staged=staged),
            HostView(inputs[ShadingFlow.name], "candidates", staged=staged),
            HostView(self, "judgement", writes=True, staged=staged),
        )

    @classmethod
    def is_wanted(cls, options: Options) -> bool:
        return options.corrects_shading

    def look_at(self, names: set[str] | None) -> None:
        self.with_refined = names is None or "correction.refined" in names

    def variant(self, step: Step) -> Hashable | None:
        if step.slot == "rendered":
            return True
        return self.asked if self.runs_on_device else None

    def extrapolated(self, step: Step) -> None:
        """Make the final image of the filled frame; waits for onnxruntime, if that runs the network. A still frame has
        nothing to correct."""
        if step.previous is None or self.board.stages[ShadingTrend.name].is_still:
            self.skip()
        else:
            if not self.runs_on_device:
                self.infer()
            self.judge(step, self.board.options.focus_mask)
            self.compose(step, self.board.options.focus_mask)
            if self.board.options.image_flow:
                self.launch("follow_flow", step)

    def use(self, network: Network | KernelNetwork) -> None:
        """Set the runner of the network from now on: onnxruntime or, for a network of `layers`, the kernels."""
        self.network = network
        self.upload("head", network.head)
        self.board.stages[Convolutions.name].use(network.layers)
        self.runs_on_device = network.layers is not None
        self.board.stages[ShadingTrend.name].host_decides = not self.runs_on_device

    def skip(self) -> None:
        """Make the extrapolated image the final one: the network has no input."""
        for name in ("color", "refined") if self.with_refined else ("color",):
            self.copy(f"correction.{name}", "frame.color")
        self.fill("focus_mask", 0)

    def infer(self) -> None:
        """Fill `judgement`, and wait for the network. It works in the buffers themselves where host and device share
        memory, else in host memory, with one copy of each buffer."""
        try:
            events = [event for view in self._views for event in view.open()]
            for event in events:
                event.wait()
            self._copying_milliseconds += self._take_transfers()  # complete by now: they came before these
            self._transfers = events
            start = time.perf_counter()
            self.unusable_pixels += _IMAGE_PIXELS * self.network.run(*(view.array for view in self._views))
            self._network_milliseconds += (time.perf_counter() - start) * 1e3
        finally:
            self._transfers += [event for view in self._views for event in view.close()]

    def judge(self, step: Step, within_mask: bool) -> None:
        """Fill `correction`; within the mask alone, only where the mask may count."""
        self.launch("choose_flow", step)
        self.launch("judge", step, asked=self._asked(within_mask))

    def compose(self, step: Step, within_mask: bool) -> None:
        """Fill `focus_mask` and `color`. Without `within_mask` the whole image is the network's."""
        self.launch("correct", step, asked=self._asked(within_mask))

    @property
    def asked(self) -> int:
        """The request to the kernels, in bits of correction.cl."""
        return self._asked(self.board.options.focus_mask)

    def _asked(self, within_mask: bool) -> int:
        return within_mask * _WITHIN_MASK + self.with_refined * _WITH_REFINED

    def _take_transfers(self) -> float:
        """Return milliseconds of the last frame's transfers, which must be complete; 0 without profiling."""
        events, self._transfers = self._transfers, []
        if not self.device.profiles:
            return 0.0
        return sum(event.profile.end - event.profile.start for event in events) * 1e-6

    def take_network_milliseconds(self) -> dict[str, float]:
        """Return milliseconds since the last call, kernels excluded; the device must have finished. "network": time
        in onnxruntime; "network copies": transfers between the device and that, if the queue has profiling. Nothing
        where kernels run the network."""
        if self.runs_on_device:
            return {}
        copying = self._copying_milliseconds + self._take_transfers()
        taken = {"network": self._network_milliseconds}
        if self.device.profiles:
            taken["network copies"] = copying
        self._network_milliseconds = self._copying_milliseconds = 0.0
        return taken
