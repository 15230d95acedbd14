"""The shading correction network in the pipeline (paper: 'Shading Correction Network')."""

from __future__ import annotations

import math
import time

import numpy as np
import pyopencl as cl

from gffe_cl.inference import INPUT_PLANES, OUTPUT_PLANES, Network
from gffe_cl.opencl.device import Device
from gffe_cl.stage import RGBA, BufferSpec, Sizes, Stage, int2

MU = 5000.0
HEADROOM = 8.0  # exposed colour that is encoded as 1: three stops above display white
_BINS = 32768  # as in kernels/correction.cl
_STRIP = 16


class ShadingCorrection(Stage):
    """Corrects shading that moves otherwise than its surface: shadows, reflections.

    Colour goes into the network as e(c) = ln(1 + μ x) / ln(1 + μ), x = exposure · c / 8, and comes back by the inverse.
    With U for bilinear interpolation from half resolution, L for the encoded GAE colour there and g for it at full:
    refined = e⁻¹(U(L) + U(Δ) + U(keep) · (g − U(L))), final = GAE · (1 − U(M)) + refined · U(M) in linear colour.

    `network_milliseconds`: time in the network since last taken, apart from the kernels'.
    """

    name = "correction"
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
        BufferSpec("median_depth", np.float32, (), "once", "of the finite depths, to 1/256"),
        BufferSpec("refined", np.float16, RGBA, "target", "the network's image, without focus mask", "color"),
        BufferSpec("focus_mask", np.float16, (), "target", "where it counts (M), 0 below 1/32"),
        BufferSpec("color", np.float16, RGBA, "target", "the final image: refined within M, else GAE", "color"),
    )  # fmt: skip

    def __init__(self, device: Device, sizes: Sizes, network: Network):
        super().__init__(device, sizes)
        self.network = network
        self.network_milliseconds = 0.0
        self._histogram = device.buffer(4 * _BINS)

    def correct(self, warp: Stage, shading: Stage, alpha: float, exposure: float, focus_mask: bool) -> None:
        """Make the final image of the filled frame in `warp` and the inputs in `shading`; waits for the network.

        `exposure`: factor before display; without `focus_mask` the whole image is the network's.
        """
        self.prepare(warp, shading, exposure)
        self.infer(alpha)
        self.compose(warp, exposure, focus_mask)

    def skip(self, warp: Stage) -> None:
        """Nothing to go by: the final image is the extrapolated one."""
        for name in ("color", "refined"):
            self.copy(self.buffer[name], warp.buffer["color"])
        self.fill(self.buffer["focus_mask"], 0)

    def prepare(self, warp: Stage, shading: Stage, exposure: float) -> None:
        """Fill `frames`."""
        width, height = size = self.sizes.target
        self.fill(self._histogram, 0)
        strips = (width, -(-height // _STRIP))
        self.launch("depth_histogram", strips, *int2(size), warp.buffer["depth"], self._histogram)
        self.launch("find_median", (1, 1), self._histogram, self.buffer["median_depth"])
        network = self.network_size
        inputs = (warp.buffer["color"], shading.buffer["warped_previous"], warp.buffer["depth"])
        self.launch(
            "network_input", network, *int2(size), *int2(network), _law(exposure), *inputs,
            shading.buffer["input_mask"], self.buffer["median_depth"], self.buffer["frames"],
        )  # fmt: skip

    def infer(self, alpha: float) -> None:
        """Fill `correction`: the network works in the mapped buffers: no copy where host and device share memory."""
        frames = self.map("frames", cl.map_flags.READ)
        correction = self.map("correction", cl.map_flags.WRITE_INVALIDATE_REGION)
        try:
            start = time.perf_counter()
            self.network.run(frames, alpha, correction)
            self.network_milliseconds += (time.perf_counter() - start) * 1e3
        finally:
            for array in (frames, correction):
                array.base.release(self.device.queue)

    def compose(self, warp: Stage, exposure: float, focus_mask: bool) -> None:
        """Fill `refined`, `focus_mask` and `color`."""
        size = self.sizes.target
        buffers = (self.buffer[name] for name in ("frames", "correction", "refined", "focus_mask", "color"))
        self.launch(
            "correct", size, *int2(size), *int2(self.network_size), _law(exposure), np.int32(focus_mask),
            warp.buffer["color"], *buffers,
        )  # fmt: skip

    @property
    def network_size(self) -> tuple[int, int]:
        """Width and height of the network's images."""
        return self.spec("frames").size(self.sizes)

    def map(self, name: str, flags: int) -> np.ndarray:
        """The memory of a mapped buffer, once the kernels before are done; to be released on the queue."""
        spec = self.spec(name)
        return cl.enqueue_map_buffer(
            self.device.queue, self.buffer[name], flags, 0, spec.shape(self.sizes), spec.dtype
        )[0]

    def take_network_milliseconds(self) -> float:
        taken, self.network_milliseconds = self.network_milliseconds, 0.0
        return taken


def _law(exposure: float) -> np.ndarray:
    """μ · exposure / 8, 1 / ln(1 + μ), and their reciprocals."""
    gain, log = MU * exposure / HEADROOM, math.log1p(MU)
    return np.array([gain, 1 / log, 1 / gain, log], np.float32)
