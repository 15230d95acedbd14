"""Loading the shading correction network, and running it with onnxruntime.

A model takes `frames` (1, 8, h, w) and `candidates` (1, 16, h/2, w/2), and gives `judgement` (1, 20, h/2, w/2), all
float32, for any h and w that are multiples of 16. The model consists of convolutions. Kernels do the rest, including
its last two layers, the head, whose weights are in the model's metadata: "head", float32, base64.
"""

from __future__ import annotations

import hashlib
import os
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np

from gffe_cl.engine.inference.integer_layers import NotInKernels, read_layers
from gffe_cl.engine.inference.model_interface import (
    CANDIDATE_PLANES,
    HEAD,
    HEAD_WEIGHTS,
    INPUT_PLANES,
    JUDGEMENT_PLANES,
    OUTPUT,
    head_weights,
    shapes_at,
)
from gffe_cl.engine.inference.provider_choice import AUTO, Choice, choose
from gffe_cl.engine.inference.providers import (
    CPU,
    PACKAGED,
    PROVIDERS,
    NetworkError,
    cpu_model,
    has_onnxruntime,
    load_onnxruntime,
    one_line,
    open_session,
)
from gffe_cl.engine.inference.sessions import FixedSession

__all__ = ["AUTO", "PROVIDERS", "Network", "NetworkError", "default_model", "load_network", "load_onnxruntime"]

OPENCL = "opencl"  # the kernels, in place of a provider of onnxruntime
# What runs the network of the package by default, by the kind of the device.
RUNS_ON = {
    "gpu": "with OpenCL kernels, as it is a GPU",
    "cpu": "with onnxruntime, which is faster on a CPU than kernels and has the same bits",
}
_FLOAT = "tensor(float)"
_MOST_SIZES = 4  # whose sessions are kept
_loaded: dict[tuple, tuple] = {}  # (path, the CPU's, requested provider) → (stamp of the file and the process, Network)
_asked_for: list[Network | KernelNetwork] = []  # since remarks were last taken


def default_model() -> Path | None:
    """Return the path of the weights that come with the package, None if there are none."""
    return PACKAGED if PACKAGED.is_file() else None


def digest_of_weights(path: Path) -> str:
    """Return the hash of all files that may run in place of the network `path`."""
    return hashlib.sha256(b"".join(each.read_bytes() for each in (path, cpu_model(path)))).hexdigest()


def scn_missing() -> str | None:
    """Return why the shading correction network is not on by default, None where it is."""
    if default_model() is None:
        return "no trained weights for the shading correction network are installed"
    return None


def load_network(
    path: str | Path | None = None, provider: str | None = CPU.name, on_gpu: bool = False
) -> Network | KernelNetwork:
    """Return the network of the ONNX file `path` (None: of the package, in 8-bit integers on the CPU and in OpenCL), as
    layers for OpenCL kernels ("opencl") or on a provider of onnxruntime: a key of `PROVIDERS`, onnxruntime's own name,
    or "auto". With None and "auto" the kernels run it `on_gpu`, and where onnxruntime is not installed, if they can;
    else it is the CPU for None. A provider that is not the CPU is compared with it in a child process first, once per
    machine. A network is loaded once as long as the file stays the same, and again in a forked child, where the threads
    of the parent's session are not. Raises NetworkError."""
    packaged = path is None
    path = default_model() if path is None else Path(path)
    if path is None:
        raise NetworkError(
            f"{scn_missing()}: expected gffe_cl/engine/inference/weights/scn.onnx, or another model's path"
        )
    if not path.is_file():
        raise NetworkError(f"{path}: no such file (expected a shading correction network, ONNX)")
    state = path.stat()
    wanted = next((each.name for each in PROVIDERS.values() if provider in (each.name, each.ort)), provider)
    if wanted is None and not on_gpu and has_onnxruntime():
        wanted = CPU.name
    on_cpu = cpu_model(path) if packaged else path
    key = path.resolve(), on_cpu, wanted, on_gpu
    stamp = state.st_mtime_ns, state.st_size, os.getpid()
    if key not in _loaded or _loaded[key][0] != stamp:
        _loaded[key] = stamp, _load(path, wanted, on_cpu, on_gpu)
    network = _loaded[key][1]
    if network not in _asked_for:
        _asked_for.append(network)
    return network


def _load(path: Path, provider: str | None, on_cpu: Path, on_gpu: bool) -> Network | KernelNetwork:
    remark = ""
    if provider == OPENCL or (provider in (None, AUTO) and (on_gpu or not has_onnxruntime())):
        try:
            return KernelNetwork(on_cpu)
        except NotInKernels as why:
            if provider == OPENCL:
                raise NetworkError(
                    f"{on_cpu}: OpenCL kernels cannot run it: {why} (expected a network of integers, as"
                    " `gffe train --integers` makes it)"
                ) from None
            remark = f"{on_cpu.name}: onnxruntime runs the network, as OpenCL kernels cannot: {why}"
    return Network(path, provider or CPU.name, on_cpu, remark)


def reason(network: Network | KernelNetwork, provider: str | None, on_gpu: bool) -> str:
    """Return why `network` was loaded as it was for the request `provider` (see `load_network`), in words."""
    if provider not in (None, AUTO):
        return "as requested"
    if network.layers:
        return "the device is a GPU" if on_gpu else "onnxruntime is not installed"
    if provider == AUTO:
        return "the fastest with the CPU's results"
    return "kernels cannot run it" if on_gpu else "faster on a CPU than kernels, with the same bits"


def take_remarks() -> list[str]:
    """Return notes for the user since the last call on the providers that ran networks: providers that "auto" refused,
    or that failed, so that the CPU took over."""
    remarks = [network.remark for network in _asked_for if network.remark]
    _asked_for.clear()
    return list(dict.fromkeys(remarks))


class KernelNetwork:
    """A network that OpenCL kernels run (`Convolutions`): its `layers`, and `head` as in `Network`."""

    provider, remark, copying = OPENCL, "", 0.0

    def __init__(self, path: Path):
        """Read the ONNX file `path`. Raises NotInKernels where kernels cannot run it, and NetworkError."""
        self.path = path
        self.layers = read_layers(path)
        self.head = _head_of(path, self.layers.head)

    def prepare(self, height: int, width: int) -> None:
        """Do nothing: nothing depends on the size."""


class Network:
    """A network and its runtime; see `load_network`.

    `session`: the CPU's, for any size; where the CPU was chosen, of the file `on_cpu` (None: `path`). `head`: (374,)
    float32, weights of its last two layers. `copying`: milliseconds of the last run that went into copies to the
    provider and back, as far as they are known apart. `remark`: a note for the user on the provider, "" if none.
    """

    layers = None  # for kernels

    def __init__(self, path: Path, provider: str = CPU.name, on_cpu: Path | None = None, remark: str = ""):
        self.path, self._remark = path, remark
        self.session = open_session(on_cpu if on_cpu and provider == CPU.name else path)
        self.copying = 0.0
        self._failure = ""
        self._fixed: dict[tuple[int, int], FixedSession] = {}  # by height and width, the latest last
        self._one_at_a_time = threading.RLock()  # on a provider; the CPU's session has no state
        free = (None, None)
        inputs = {"frames": (1, INPUT_PLANES, *free), "candidates": (1, CANDIDATE_PLANES, *free)}
        _require(path, "input", self.session.get_inputs(), inputs)
        _require(path, "output", self.session.get_outputs(), {OUTPUT: (1, JUDGEMENT_PLANES, *free)})
        self.choice: Choice = choose(path, provider)
        if on_cpu and provider != CPU.name and self.choice.provider == CPU:
            self.session = open_session(on_cpu)
        self.head = _head_of(path, self.session.get_modelmeta().custom_metadata_map.get(HEAD, ""))

    @property
    def provider(self) -> str:
        """Name of the execution provider in onnxruntime."""
        return (CPU if self._failure else self.choice.provider).ort

    @property
    def remark(self) -> str:
        return "; ".join(filter(None, (self._remark, self.choice.remark, self._failure)))

    def prepare(self, height: int, width: int) -> None:
        """Prepare for images of this size, which may take seconds. Raises NetworkError."""
        self._guarded(lambda: None if self.provider == CPU.ort else self._session_of(height, width))

    def run(self, frames: np.ndarray, candidates: np.ndarray, judgement: np.ndarray) -> int:
        """Read `frames` (8, h, w) and `candidates` (16, h/2, w/2), write `judgement` (20, h/2, w/2): C-contiguous
        float32, used in place on the CPU. Returns the number of its pixels with NaN or infinity. Raises NetworkError.
        """
        inputs = {"frames": frames[None], "candidates": candidates[None]}
        self._guarded(lambda: self._run(inputs, judgement[None]))
        return _pixels_not_finite(judgement)

    def _guarded(self, work: Callable[[], object]) -> None:
        """Do `work`. Where it fails on a provider that was not asked for by name, do it once more on the CPU, and stay
        there."""
        try:
            work()
        except Exception as error:  # whatever a driver throws
            text = one_line(error)
            if self._failure or not self.choice.may_fall_back:
                raise NetworkError(f"{self.path}: the network failed on {self.provider}: {text}") from None
            self._failure = f"{self.path.name}: the network failed on {self.provider} ({text}) and went on on the CPU"
            self._fixed.clear()
            self._guarded(work)

    def _run(self, inputs: dict[str, np.ndarray], judgement: np.ndarray) -> None:
        if self.provider != CPU.ort:
            with self._one_at_a_time:
                fixed = self._session_of(*inputs["frames"].shape[2:])
                fixed.run(inputs, OUTPUT, judgement)
                self.copying = fixed.copying
            return
        self.copying = 0.0
        binding = self.session.io_binding()
        for name, array in inputs.items():
            binding.bind_input(name, "cpu", 0, np.float32, array.shape, array.ctypes.data)
        binding.bind_output(OUTPUT, "cpu", 0, np.float32, judgement.shape, judgement.ctypes.data)
        self.session.run_with_iobinding(binding)
        binding.synchronize_outputs()

    def _session_of(self, height: int, width: int) -> FixedSession:
        """Return the session on the provider for images of this size."""
        size = height, width
        with self._one_at_a_time:
            if size in self._fixed:
                self._fixed[size] = self._fixed.pop(size)
                return self._fixed[size]
            made = FixedSession(self.path, self.choice.provider, shapes_at(height, width), self.session)
            while len(self._fixed) >= _MOST_SIZES:
                del self._fixed[next(iter(self._fixed))]
            self._fixed[size] = made
            return made


def _head_of(path: Path, text: str) -> np.ndarray:
    weights = head_weights(text)
    if len(weights) != HEAD_WEIGHTS or not np.isfinite(weights).all():
        raise NetworkError(
            f"{path}: no shading correction network: metadata '{HEAD}' has {len(weights)} numbers (expected"
            f" {HEAD_WEIGHTS} finite float32, base64, as `gffe train` writes them)"
        )
    return weights


def _pixels_not_finite(planes: np.ndarray) -> int:
    """Return the number of pixels of (n, h, w) that are NaN or infinite in any plane. Without any it costs one sum."""
    with np.errstate(all="ignore"):
        if np.isfinite(planes.sum()):
            return 0
    return int((~np.isfinite(planes)).any(0).sum())


def _require(path: Path, kind: str, values: list, expected: dict[str, tuple]) -> None:
    """Raise NetworkError unless the model's inputs or outputs are `expected`: shapes by name, None where any size is
    accepted."""
    found = {value.name: value for value in values}
    if set(found) != set(expected):
        raise NetworkError(
            f"{path}: no shading correction network: {kind}s {', '.join(sorted(found))}"
            f" (expected {', '.join(sorted(expected))})"
        )
    for name, shape in expected.items():
        value = found[name]
        fits = len(value.shape) == len(shape) and all(
            not isinstance(have, int) or have == want for have, want in zip(value.shape, shape, strict=True)
        )
        if not fits or value.type != _FLOAT:
            raise NetworkError(
                f"{path}: no shading correction network: {kind} {name} is {value.type} {_shape(value.shape)}"
                f" (expected {_FLOAT} {_shape(shape)})"
            )


def _shape(shape) -> str:
    return "×".join("any" if n is None else str(n) for n in shape)
