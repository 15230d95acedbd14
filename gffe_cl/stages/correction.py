"""The shading correction network in the pipeline (paper: 'Shading Correction Network')."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, ClassVar

import numpy as np
import pyopencl as cl

from gffe_cl.inference.model_interface import HEAD_LAYERS, HEAD_WEIGHTS, JUDGEMENT_PLANES
from gffe_cl.inference.network import Network, load_network
from gffe_cl.inference.providers import CPU
from gffe_cl.opencl.program import constants
from gffe_cl.stages.base import Access, Board, Kernel, Stage, Step
from gffe_cl.stages.buffers import RGBA, BufferSpec
from gffe_cl.stages.network_input import NetworkInput
from gffe_cl.stages.shading_flow import ShadingFlow
from gffe_cl.stages.shading_trend import ShadingTrend

_CONSTANTS = constants("correction.cl")
_WITHIN_MASK, _WITH_REFINED = _CONSTANTS["WITHIN_MASK"], _CONSTANTS["WITH_REFINED"]

_SEEN, _HIDDEN, _SAID = (_CONSTANTS[name] for name in ("SEEN", "HIDDEN", "SAID"))
assert ((_HIDDEN, _SEEN), (_SAID, _HIDDEN)) == HEAD_LAYERS

_IMAGE_PIXELS = 16  # per pixel of its judgement
_EVENTS = 1024  # of mapping that are kept until they are taken
_Mapped = list[tuple[np.ndarray, cl.Event]]  # buffers of the network, and when they are mapped


class ShadingCorrection(Stage):
    """Corrects shading that moves otherwise than its surface: shadows, reflections.

    The network's convolutions judge candidates at a quarter of the resolution (`judgement`); kernels make the change of
    encoded color of it, Δ = (GAE frame moved along a flow − GAE frame) + g · trend + δ (`judge`), the first of them
    within twice what changed since t − 1. With e for the code
    of color (`NetworkInput`), U for bilinear interpolation from half resolution, L for the encoded GAE color there
    and g for it at full: refined = e⁻¹(U(L) + U(Δ) + U(keep) · (g − U(L))), final = GAE · (1 − U(M)) + refined · U(M)
    in linear color. M is less, down to 0, where the last interval's change of brightness is not that of the interval
    before.

    `unusable_pixels`: of all frames so far, where the network gave NaN or infinity; they keep the GAE color.
    `with_refined`: whether `refined` is made too, from the next frame on.
    """

    name = "correction"
    pictures: ClassVar[Mapping[str, str]] = {"extrapolated": "color"}
    buffers = (
        BufferSpec(
            "judgement", np.float32, (), "network1", "output of the convolutions, at a quarter of the resolution: a"
            " flow of their own / 4 (1, 2), weight of the found flow before the sigmoid (3), how much longer trends"
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
            " focus mask (5); half resolution", planes=5,
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
                "judgement": Access("correction.judgement", planes=4),
                "candidates": Access("shading_flow.candidates", planes=3),
                "differences": Access("shading_flow.differences", planes=3),
            },
            {"chosen": "correction.chosen"},
            step=("LANES", 1),
        ),
        Kernel(
            "judge",
            "network",
            {
                "frames": Access("network_input.frames", planes=7),  # all but inverse depth
                "trends": Access("shading_trend.trends", planes=3),
                "judgement": Access("correction.judgement", planes=16),
                "chosen": "correction.chosen",
                "head": "correction.head",
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
                "frames": Access("network_input.frames", planes=3),
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
        self.network: Any = None  # a Network or a substitute
        if load:
            self.use(load_network(board.options.scn_model, board.options.scn_provider))
        self._network_milliseconds = 0.0
        self._copying_milliseconds = 0.0
        self._mappings: deque[cl.Event] = deque(maxlen=_EVENTS)
        self.unusable_pixels = 0
        self.with_refined = False
        self._true = board.device.buffer(4)
        cl.enqueue_fill_buffer(board.device.queue, self._true, np.ones(1, np.int32), 0, 4)
        self._worker: ThreadPoolExecutor | None = None
        self._begun: tuple[Step, _Mapped, Future] | None = None

    @classmethod
    def is_wanted(cls, options) -> bool:
        return options.corrects_shading

    @property
    def works_beside(self) -> bool:
        """Whether the network runs in a thread of its own while the device continues, until `finish`. This requires
        that they are different processors, and that no other stage needs the final image."""
        same = self.device.info.kind == "cpu" and self.network is not None and self.network.provider == CPU.ort
        return not same and next(reversed(self.board.stages.values())) is self

    def look_at(self, names: set[str] | None) -> None:
        self.with_refined = names is None or "correction.refined" in names

    def extrapolated(self, step: Step) -> None:
        """Make the final image of the filled frame; waits for the network, or leaves the rest to `finish`. A still
        frame has nothing to correct."""
        if step.previous is None or self.board.stages[ShadingTrend.name].is_still:
            self.skip()
        elif self.works_beside:
            mapped = self._map_all(wait=False)
            self.device.queue.flush()
            self._worker = self._worker or ThreadPoolExecutor(1, "gffe network")
            self._begun = step, mapped, self._worker.submit(self._run, mapped)
        else:
            self.infer()
            self._correct(step)

    @property
    def is_begun(self) -> bool:
        """Whether a call of `finish` is pending."""
        return self._begun is not None

    def finish(self) -> None:
        """Wait for the network and make the final image, if that is still to be done."""
        if self._begun is None:
            return
        (step, mapped, job), self._begun = self._begun, None
        try:
            job.result()
        finally:
            self._unmap(mapped)
        self._correct(step, changed=self._true)  # the stage that found it may have seen the next frame

    def _correct(self, step: Step, **given: Any) -> None:
        self.launch("choose_flow", step)
        self.launch("judge", step, **given)
        self.compose(step, self.board.options.focus_mask)

    def use(self, network: Network) -> None:
        """Set the runner of the network from now on."""
        network.prepare(*reversed(self.sizes.of("network")))
        self.network = network
        self.upload("head", network.head)

    def skip(self) -> None:
        """Nothing to go by: the final image is the extrapolated one."""
        for name in ("color", "refined") if self.with_refined else ("color",):
            self.copy(f"correction.{name}", "frame.color")
        self.fill("focus_mask", 0)

    def infer(self) -> None:
        """Fill `judgement`: the network works in the mapped buffers: no copy where host and device share memory."""
        mapped = self._map_all(wait=True)
        try:
            self._run(mapped)
        finally:
            self._unmap(mapped)

    def _map_all(self, wait: bool) -> _Mapped:
        stages = self.board.stages
        return [
            self._map(stages[NetworkInput.name], "frames", cl.map_flags.READ, wait),
            self._map(stages[ShadingFlow.name], "candidates", cl.map_flags.READ, wait),
            self._map(self, "judgement", cl.map_flags.WRITE_INVALIDATE_REGION, wait),
        ]

    def _map(self, stage: Stage, name: str, flags: cl.map_flags, wait: bool) -> tuple[np.ndarray, cl.Event]:
        spec = stage.spec(name)
        shape = spec.shape(self.sizes)
        map_buffer: Any = cl.enqueue_map_buffer  # its stub leaves the event out
        return map_buffer(
            self.device.queue, stage.buffer[name], flags, 0, shape, np.dtype(spec.dtype), is_blocking=wait
        )

    def _run(self, mapped: _Mapped) -> None:
        for _, event in mapped:
            event.wait()
        start = time.perf_counter()
        self.unusable_pixels += _IMAGE_PIXELS * self.network.run(*(array for array, _ in mapped))
        copying = self.network.copying
        self._network_milliseconds += (time.perf_counter() - start) * 1e3 - copying
        self._copying_milliseconds += copying

    def _unmap(self, mapped: _Mapped) -> None:
        for array, event in mapped:
            memory: Any = array.base
            self._record_mapping(event)
            self._record_mapping(memory.release(self.device.queue))

    def compose(self, step: Step, within_mask: bool) -> None:
        """Fill `focus_mask` and `color`; without `within_mask` the whole image is the network's."""
        asked = within_mask * _WITHIN_MASK + self.with_refined * _WITH_REFINED
        self.launch("correct", step, asked=asked)

    def _record_mapping(self, event: cl.Event) -> None:
        if self.device.profiles:
            self._mappings.append(event)

    def take_network_milliseconds(self) -> dict[str, float]:
        """Return milliseconds since the last call, kernels excluded; the device must have finished. "network": time
        in the network; "network copies": transfers between the device and the network, if the queue has profiling."""
        mapping = sum(event.profile.end - event.profile.start for event in self._mappings) * 1e-6
        taken = {"network": self._network_milliseconds}
        if self.device.profiles:
            taken["network copies"] = self._copying_milliseconds + mapping
        self._network_milliseconds = self._copying_milliseconds = 0.0
        self._mappings.clear()
        return taken
