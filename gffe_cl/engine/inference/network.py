"""Loading the shading correction network, and running it with onnxruntime on the CPU.

A model takes `frames` (1, 8, h, w) and `candidates` (1, 16, h/2, w/2), and gives `judgement` (1, 20, h/2, w/2), all
float32, for any h and w that are multiples of 16. The model consists of convolutions. Kernels do the rest, including
its last two layers, the head, whose weights are in the model's metadata: "head", float32, base64.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
from collections.abc import Callable
from functools import cache
from importlib import import_module
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any
from weakref import WeakSet

import numpy as np
from numpy.typing import ArrayLike

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.files import model_source, read_bounded
from gffe_cl.engine.inference.layers import (
    CANDIDATE_PLANES,
    HEAD,
    HEAD_WEIGHTS,
    INPUT_PLANES,
    JUDGEMENT_PLANES,
    MOST_BYTES,
    OUTPUT,
    NotInKernels,
    head_weights,
    layers_file,
    read_layers,
    require_operators,
)


class NetworkError(GffeError):
    """Error of a network that cannot be loaded, or fails."""


AUTO, OPENCL, ON_CPU = "auto", "opencl", "cpu"  # what may be asked for: the kernels, or onnxruntime
# What runs the network of the package by default, by the kind of the device.
RUNS_ON = {
    "gpu": "with OpenCL kernels, as it is a GPU",
    "cpu": "with onnxruntime, which is faster on a CPU than kernels and has the same bits",
}
_FLOAT = "tensor(float)"
_loaded: dict[tuple, tuple] = {}  # (path, requested provider) → (stamp of the file and the process, Network)
_remarks: dict[str, None] = {}  # on networks that were asked for since `take_remarks`, in order
CPU = "CPUExecutionProvider"  # onnxruntime's name of what runs a session
PACKAGED = Path(str(files("gffe_cl.engine.inference") / "weights" / "scn.onnx"))

_sessions: WeakSet[Any] = WeakSet()  # of this process and those from which it was forked


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
    path: str | Path | None = None, provider: str | None = ON_CPU, on_gpu: bool = False
) -> Network | KernelNetwork:
    """Return the network of the ONNX file `path` (None: of the package, in 8-bit integers), as layers for OpenCL
    kernels (`OPENCL`) or in onnxruntime (`ON_CPU`). With None and `AUTO` the kernels run it `on_gpu`, and where
    onnxruntime is not installed, if they can. A network is loaded once as long as the file stays the same, and again in
    a forked child, where the threads of the parent's session are not. Raises NetworkError."""
    if path is None:
        packaged = default_model()
        if packaged is None:
            raise NetworkError(
                f"{scn_missing()}: expected gffe_cl/engine/inference/weights/scn.onnx, or another model's path"
            )
        path = cpu_model(packaged)
    path = Path(path)
    if not path.is_file():
        raise NetworkError(f"{path}: no such file (expected a shading correction network, ONNX)")
    if provider not in (None, AUTO, OPENCL, ON_CPU):
        raise NetworkError(f"provider '{provider}' is not available (there is: {AUTO}, {OPENCL}, {ON_CPU})")
    by_itself = AUTO if on_gpu or not has_onnxruntime() else ON_CPU
    wanted = by_itself if provider in (None, AUTO) else provider
    states = [each.stat() for each in (path, layers_file(path)) if each.is_file()]
    key, stamp = (path.resolve(), wanted), (os.getpid(), *((state.st_mtime_ns, state.st_size) for state in states))
    if key not in _loaded or _loaded[key][0] != stamp:
        _loaded[key] = stamp, _load(path, wanted)
    network = _loaded[key][1]
    if network.remark:
        _remarks[network.remark] = None
    return network


def _load(path: Path, wanted: str | None) -> Network | KernelNetwork:
    """Return the network that `wanted` runs; with `AUTO` the kernels, if they can."""
    if wanted == ON_CPU:
        return Network(path)
    try:
        return KernelNetwork(path)
    except NotInKernels as why:
        if wanted == AUTO:
            return Network(path, f"{path.name}: onnxruntime runs the network, as OpenCL kernels cannot: {why}")
        raise NetworkError(
            f"{path}: OpenCL kernels cannot run it: {why} (expected a network of integers, as"
            " `gffe train --integers` makes it)"
        ) from None


def reason(network: Network | KernelNetwork, provider: str | None, on_gpu: bool) -> str:
    """Return why `network` was loaded as it was for the request `provider` (see `load_network`), in words."""
    if provider not in (None, AUTO):
        return "as requested"
    if network.layers:
        return "the device is a GPU" if on_gpu else "onnxruntime is not installed"
    return "kernels cannot run it" if on_gpu else "faster on a CPU than kernels, with the same bits"


def take_remarks() -> list[str]:
    """Return notes for the user on networks loaded since the last call: those that kernels cannot run."""
    taken = list(_remarks)
    _remarks.clear()
    return taken


class KernelNetwork:
    """A network that OpenCL kernels run (`Convolutions`): its `layers`, and `head` as in `Network`."""

    provider, remark = OPENCL, ""

    def __init__(self, path: Path):
        """Read the layers of the ONNX file `path`. Raises NotInKernels where it has none, and NetworkError."""
        self.path = path
        self.layers = read_layers(path)
        self.head = _head_of(path, self.layers.head)


class Network:
    """A network in onnxruntime; see `load_network`.

    `session`: for any size; it has no state. `head`: (374,) float32, weights of its last two layers. `remark`: a note
    for the user, "" if none.
    """

    layers = None  # for kernels
    provider = CPU

    def __init__(self, path: Path, remark: str = ""):
        self.path, self.remark = path, remark
        try:
            model = read_bounded(path, MOST_BYTES)
            require_operators(model)
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or error
            raise NetworkError(f"{path}: cannot be loaded (expected an ONNX model): {why}") from None
        self.session = open_session(path, model)
        free = (None, None)
        inputs = {"frames": (1, INPUT_PLANES, *free), "candidates": (1, CANDIDATE_PLANES, *free)}
        _require(path, "input", self.session.get_inputs(), inputs)
        _require(path, "output", self.session.get_outputs(), {OUTPUT: (1, JUDGEMENT_PLANES, *free)})
        self.head = _head_of(path, self.session.get_modelmeta().custom_metadata_map.get(HEAD, ""))

    def run(self, frames: np.ndarray, candidates: np.ndarray, judgement: np.ndarray) -> int:
        """Read `frames` (8, h, w) and `candidates` (16, h/2, w/2), write `judgement` (20, h/2, w/2): C-contiguous
        float32, used in place. Returns the number of its pixels with NaN or infinity. Raises NetworkError."""
        binding = self.session.io_binding()
        for name, array in (("frames", frames[None]), ("candidates", candidates[None])):
            binding.bind_input(name, "cpu", 0, np.float32, array.shape, array.ctypes.data)
        binding.bind_output(OUTPUT, "cpu", 0, np.float32, judgement[None].shape, judgement.ctypes.data)
        try:
            self.session.run_with_iobinding(binding)
        except _errors_of_onnxruntime() as error:
            raise NetworkError(f"{self.path}: the network failed on {CPU}: {one_line(error)}") from None
        binding.synchronize_outputs()
        return _pixels_not_finite(judgement)


class SubstituteNetwork:
    """Replacement for `Network` whose judgement depends on its size alone.

    `head`: weights of the last two layers, (HEAD_WEIGHTS,) float32; `judge` gives the judgement for a shape (planes,
    height, width), with which it is broadcast.
    """

    provider, layers = CPU, None

    def __init__(self, head: np.ndarray, judge: Callable[[tuple[int, ...]], ArrayLike]):
        self.head, self._judge = head, judge

    def run(self, frames: np.ndarray, candidates: np.ndarray, judgement: np.ndarray) -> int:
        """Fill `judgement`, and return 0: no pixel has NaN or infinity."""
        judgement[:] = self._judge(judgement.shape)
        return 0


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


# ---- sessions of onnxruntime ---------------------------------------------------------------------------


def _leave_sessions() -> None:
    """Keep the sessions of the parent in a forked child for ever: releasing one waits for its threads, which are not
    there."""
    for session in _sessions:
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(session))


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_leave_sessions)


def has_onnxruntime() -> bool:
    """Return whether onnxruntime is installed. Without it OpenCL kernels run the network."""
    return find_spec("onnxruntime") is not None


@cache
def load_onnxruntime() -> ModuleType:
    """Return onnxruntime without its telemetry and its log output. On import, telemetry would write an id of the
    device into the user's cache folder. No other function imports onnxruntime. Raises NetworkError where it is not
    installed."""
    if not has_onnxruntime():
        raise NetworkError("onnxruntime is not installed (expected: pip install onnxruntime, or the provider opencl)")
    os.environ["ORT_DISABLE_TELEMETRY"] = "1"
    import onnxruntime

    onnxruntime.disable_telemetry_events()
    onnxruntime.set_default_logger_severity(4)  # failures raise
    return onnxruntime


@cache
def _errors_of_onnxruntime() -> tuple[type[Exception], ...]:
    """Return the classes of onnxruntime's errors, which have no common base."""
    state = import_module("onnxruntime.capi.onnxruntime_pybind11_state")
    own = [each for each in vars(state).values() if isinstance(each, type) and issubclass(each, Exception)]
    return *own, RuntimeError, ValueError, TypeError, OSError


def cpu_model(path: Path) -> Path:
    """Return the file that runs in place of `path`: for the package's own network its form in 8-bit integers, which
    takes half the time on a CPU."""
    integers = path.with_name(f"{path.stem}-int8.onnx")
    return integers if path == PACKAGED and integers.is_file() else path


def open_session(path: Path, content: bytes | None = None):
    """Return an onnxruntime.InferenceSession of the ONNX file `path`, or of its `content`; no other function makes any.
    Raises NetworkError."""
    onnxruntime = load_onnxruntime()
    options = onnxruntime.SessionOptions()
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_ENABLE_ALL
    for kind in ("intra_op", "inter_op"):
        options.add_session_config_entry(f"session.{kind}.allow_spinning", "0")
    options.log_severity_level = 4
    try:
        session = onnxruntime.InferenceSession(content or model_source(path), options, providers=[CPU])
    except _errors_of_onnxruntime() as error:
        raise NetworkError(f"{path}: cannot be loaded (expected an ONNX model): {one_line(error)}") from None
    _sessions.add(session)
    return session


def one_line(error: Exception) -> str:
    """Return the end of onnxruntime's message, which names the cause, in one line of at most 200 characters."""
    text = " ".join(str(error).replace("\\n", " ").split())
    return text if len(text) <= 200 else f"… {text[-198:]}"
