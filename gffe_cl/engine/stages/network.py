"""The shading correction network on the device (paper: 'Shading Correction Network'): frames as it sees them, and its
convolutions."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
import pyopencl as cl

from gffe_cl.engine.inference.layers import (
    BLOCK,
    FIRST_CHANNELS,
    INPUT_PLANES,
    JUDGEMENT_PLANES,
    Image,
    IntegerNetwork,
    Layer,
)
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.base import Board, Kernel, Stage, Step
from gffe_cl.engine.stages.buffers import BufferSpec
from gffe_cl.engine.stages.shading import SEEN, ShadingTrend


class NetworkInput(Stage):
    """Encodes the extrapolated frame and the warped previous one at half resolution, with inverse depth and input mask.

    The code of color c is e(c) = ln(1 + μ x) / ln(1 + μ), x = exposure · c / 8. A still frame has none of it, unless
    the viewer asks for it.
    """

    name = "network_input"
    paper = "Shading Correction Network"
    buffers = (
        BufferSpec(
            "frames",
            np.float32,
            (),
            "network",
            "inputs of the network: encoded GAE color (1–3), encoded warped"
            " previous frame (4–6), inverse depth (7), input mask (8); half resolution",
            planes=INPUT_PLANES,
            mapped=True,
        ),
        BufferSpec("median_depth", np.float32, (), "once", "of the finite depths of 64×36 pixels, to 1/256"),
    )
    kernels = (
        Kernel(
            "find_median",
            "once",
            {"depth": "frame.depth"},
            {"median_depth": "network_input.median_depth"},
            group="SCANNERS",
        ),
        Kernel(
            "network_input",
            "network",
            {
                **SEEN,
                "median_depth": "network_input.median_depth",
            },
            {"planes": "network_input.frames"},
            step=("LANES", 1),
        ),
    )

    _looked_at = False

    @classmethod
    def is_wanted(cls, options: Options) -> bool:
        return options.corrects_shading

    def look_at(self, names: set[str] | None) -> None:
        self._looked_at = names is None or any(name.startswith(f"{self.name}.") for name in names)

    def extrapolated(self, step: Step) -> None:
        """Fill `frames`. After a reset there is no input."""
        if step.previous is None or (self.board.stages[ShadingTrend.name].is_still and not self._looked_at):
            return
        self.launch("find_median", step)
        self.launch("network_input", step)


_CONSTANTS = constants("convolutions.cl")
_BORDER, _ROUNDINGS = _CONSTANTS["BORDER"], _CONSTANTS["ROUNDINGS"]
assert _CONSTANTS["BLOCK"] == BLOCK and _CONSTANTS["FIRST_PART"] * BLOCK == FIRST_CHANNELS
assert _CONSTANTS["FIRST_PLANES"] == INPUT_PLANES and _CONSTANTS["JUDGED_BLOCKS"] * BLOCK == JUDGEMENT_PLANES
_NOTHING = "nothing"  # in place of an image that a layer does without

_CHANGED = {"changed": "shading_trend.changed"}
_NUMBERS = {"numbers": "convolutions.numbers{layer}"}
_WEIGHTS = {"weights": "convolutions.weights{layer}"} | _NUMBERS
_TARGET = {"target": "convolutions.{made}"}


def _convolution(name: str) -> Kernel:
    """Return a kernel that makes an image of integers."""
    return Kernel(
        name,
        "network{level}",
        _CHANGED
        | {
            "source": "convolutions.{read}",
            "beside": "convolutions.{read_beside}",
        }
        | _WEIGHTS,
        _TARGET | {"again": "convolutions.{made_again}"},
        step=(1, "OUTPUT_ROWS"),
        group="GROUP_WIDTH",
        group_rows="GROUP_HEIGHT",
        repeats="parts",
    )


class Convolutions(Stage):
    """Runs the convolutions of a network of integers, `use`, from the network's inputs to `correction.judgement`.

    All is enqueued: the host waits for nothing and copies nothing. Besides `nothing` its buffers are the images between
    the layers, bytes in blocks of four channels ("image…"), and the layers' weights and other numbers. Without a
    network (`layers` is empty) it does nothing: onnxruntime runs it then (`ShadingCorrection`). `frames` and
    `candidates` that are NaN or infinite become bytes, too, so that the judgement is finite.
    """

    name = "convolutions"
    paper = "Shading Correction Network"
    builds_at_once = False
    buffers = (
        BufferSpec(
            _NOTHING,
            np.uint8,
            (),
            "once",
            "stands in for an image that a layer does without",
            planes=BLOCK,
            scratch=True,
        ),
    )
    kernels = (
        Kernel(
            "take",
            "network1",
            _CHANGED | {"candidates": "shading_flow.candidates"} | _NUMBERS,
            _TARGET,
            repeats="parts",
        ),
        Kernel(
            "see",
            "network1",
            _CHANGED | {"frames": "network_input.frames"} | _WEIGHTS,
            _TARGET,
            group="LINE",
            repeats="parts",
        ),
        _convolution("convolve3"),
        _convolution("halve3"),
        _convolution("convolve1"),
        Kernel(
            "double_size",
            "network{level}",
            _CHANGED | {"source": "convolutions.{read}"} | _NUMBERS,
            _TARGET,
            repeats="parts",
        ),
        Kernel(
            "judge_pixels",
            "network1",
            _CHANGED | {"source": "convolutions.{read}"} | _WEIGHTS,
            {"judgement": "correction.judgement"},
            group="LINE",
        ),
    )

    def __init__(self, board: Board):
        super().__init__(board)
        self.layers: list[tuple[str, dict[str, Any]]] = []  # kernels, and arguments of their launches

    @classmethod
    def is_wanted(cls, options: Options) -> bool:
        return options.corrects_shading

    def use(self, network: IntegerNetwork | None) -> None:
        """Run `network` from now on, or none. Its weights are uploaded once per device, and kernels built for the first
        one."""
        if network:
            self._build(**({"FLOAT_SUMS": 1} if self.device.float_sums else {}))
        images = [_image_spec(image) for image in network.images] if network else []
        specs, buffers = [*type(self).buffers, *images], {_NOTHING: self.buffer[_NOTHING]} | self.allocate(images)
        self._prepared.clear()
        self.board.bindings.forget_scripts()
        self.layers = []
        for number, layer in enumerate(network.layers if network else ()):
            arrays = {"numbers": numbers_of(layer)}
            if layer.kind in _LAID_OUT:
                arrays["weights"] = _LAID_OUT[layer.kind](layer)
            for kind, array in arrays.items():
                spec = _array_spec(f"{kind}{number}", array)
                specs.append(spec)
                buffers[spec.name] = _uploaded(self.device, array)
            self.layers.append(_launch_of(layer, number))
        self.buffers, self.buffer = tuple(specs), buffers

    def extrapolated(self, step: Step) -> None:
        """Fill `correction.judgement`, unless there is no network or no previous frame. In still frames, where nobody
        reads it, the device leaves it as it was."""
        if step.previous is None:
            return
        asked = self.board.stages["correction"].asked
        for kernel, given in self.layers:
            self.launch(kernel, step, asked=asked, **given)


def _image_spec(image: Image) -> BufferSpec:
    """Return the buffer of an image. At first it holds the byte that stands for 0: that remains as its border."""
    return BufferSpec(
        image.name,
        np.uint8,
        (),
        f"network{image.level}",
        "bytes in blocks of four channels",
        planes=image.channels,
        scratch=True,
        border=_BORDER,
        byte=image.zero,
    )


def _uploaded(device: Device, array: np.ndarray) -> cl.Buffer:
    """Return a device buffer that holds `array`: one for all pipelines of an OpenCL device with the same numbers."""
    held = np.ascontiguousarray(array)
    key, known = hashlib.sha256(held.tobytes()).digest(), device.opened.constants
    if key not in known:
        made = device.buffer(held.nbytes)
        cl.enqueue_copy(device.queue, made, held)
        known[key] = made
    return known[key]


def _array_spec(name: str, array: np.ndarray) -> BufferSpec:
    about = "weights and other numbers of a layer"
    return BufferSpec(name, array.dtype.type, (), "once", about, planes=array.size, scratch=True)


def _launch_of(layer: Layer, number: int) -> tuple[str, dict[str, Any]]:
    """Return the kernel of a layer, and the arguments of its launch; `number`: that of its weights and numbers."""
    sources, blocks = layer.sources, layer.channels // BLOCK
    given: dict[str, Any] = {"layer": number}
    given |= dict(zip(("made", "made_again"), (image.name for image in layer.targets), strict=False))
    if layer.kind == "taken":
        return "take", given | {"parts": blocks}
    if layer.kind == "first":
        return "see", given | {"parts": layer.channels // FIRST_CHANNELS}
    given |= {"read": sources[0].name}
    if layer.kind == "last":
        return "judge_pixels", given | {"source_blocks": sources[0].channels // BLOCK}
    if layer.kind == "doubled":
        return "double_size", given | {"level": sources[0].level, "parts": blocks}
    beside = sources[1] if len(sources) > 1 else None
    kernel = "halve3" if layer.stride == 2 else f"convolve{layer.weights.shape[-1]}"
    return kernel, {"made_again": _NOTHING} | given | {
        "read_beside": beside.name if beside else _NOTHING,
        "level": layer.level,
        "source_blocks": sources[0].channels // BLOCK,
        "beside_blocks": beside.channels // BLOCK if beside else 0,
        "has_again": len(layer.targets) - 1,
        "parts": blocks,
    }


def _weights_of_integers(layer: Layer) -> np.ndarray:
    """Return the weights as `convolve` reads them: of each block of outputs, block of inputs, column and row those of
    four inputs for four outputs, (n,) uint32."""
    outputs, inputs, size, _ = layer.weights.shape
    split = layer.weights.reshape(outputs // BLOCK, BLOCK, inputs // BLOCK, BLOCK, size, size)
    return np.ascontiguousarray(split.transpose(0, 2, 5, 4, 1, 3)).view(np.uint32).ravel()


def _first_weights(layer: Layer) -> np.ndarray:
    """Return the weights as `see` reads them: of each part of outputs, input, row and column, (n, 4) float32."""
    parts = layer.weights.reshape(-1, FIRST_CHANNELS, INPUT_PLANES, layer.weights[0, 0].size)
    return np.ascontiguousarray(parts.transpose(0, 2, 3, 1)).reshape(-1, BLOCK)


def _last_weights(layer: Layer) -> np.ndarray:
    """Return the weights as `judge_pixels` reads them: of each input, (n, 4) float32."""
    return np.ascontiguousarray(layer.weights[:, :, 0, 0].T).reshape(-1, BLOCK)


_LAID_OUT = {"convolution": _weights_of_integers, "first": _first_weights, "last": _last_weights}


def numbers_of(layer: Layer) -> np.ndarray:
    """Return the other numbers of a layer as its kernel reads them, (n, 4) float32: limits, factors and zero points of
    its roundings, then what depends on the kind of layer."""
    kind, rows = layer.kind, []
    if kind == "last":
        (source,) = layer.sources
        return _stacked([[source.scale, source.zero, 0, 0]], layer.bias.reshape(-1, BLOCK))
    for rounding, factors in zip(layer.roundings, ((0.0, 0.0), *layer.factors), strict=True):
        rows.append([*rounding.limits, *factors])
    rows += [[0.0] * 4] * (_ROUNDINGS - 1 - len(rows))
    first, zeros = layer.roundings[0], [rounding.zero for rounding in (*layer.roundings, layer.roundings[-1])][1:3]
    rows.append([*zeros, first.scale, first.slope])
    if kind == "convolution":
        both = np.stack([layer.bias.reshape(-1, BLOCK), layer.unit.reshape(-1, BLOCK)], 1)
        return _stacked(rows, both.reshape(-1, BLOCK))
    if kind == "taken":
        return _stacked(rows, layer.weights.reshape(-1, BLOCK))
    if kind == "doubled":
        (source,) = layer.sources
        return _stacked(rows, [[source.scale, source.zero, 0, 0]])
    return _stacked(rows, layer.bias.reshape(-1, BLOCK))


def _stacked(*parts: Any) -> np.ndarray:
    return np.concatenate([np.asarray(part, np.float32) for part in parts])
