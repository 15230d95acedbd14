"""Running the shading correction network with onnxruntime.

A model takes `frames` (1, 8, h, w), `alpha` (1,) and, if it wants them, `trends` (1, 7, h, w), and gives `correction`
(1, 5, h, w), all float32, for any h and w that are multiples of 16.
"""

from __future__ import annotations

import os
from importlib.resources import files
from pathlib import Path
from types import ModuleType

import numpy as np

from gffe_cl.errors import GffeError

MULTIPLE = 16  # of the network's width and height
INPUT_PLANES, TREND_PLANES, OUTPUT_PLANES = 8, 7, 5
PROVIDERS = {
    "cpu": "CPUExecutionProvider",
    "cuda": "CUDAExecutionProvider",
    "directml": "DmlExecutionProvider",
    "openvino": "OpenVINOExecutionProvider",
    "webgpu": "WebGpuExecutionProvider",
    "coreml": "CoreMLExecutionProvider",
    "tensorrt": "TensorrtExecutionProvider",
}
_FLOAT = "tensor(float)"
_loaded: dict[tuple, tuple] = {}  # (path, provider) → (stamp of the file, Network)


class NetworkError(GffeError):
    """The network cannot be loaded, or fails."""


def default_model() -> Path | None:
    """The weights that come with the package, if they do."""
    path = Path(str(files("gffe_cl") / "scn" / "weights" / "scn.onnx"))
    return path if path.is_file() else None


def scn_missing() -> str | None:
    """Why the shading correction network is not on by default; None where it is."""
    if default_model() is None:
        return "no trained weights for the shading correction network are installed"
    return None


def load_network(path: str | Path | None = None, provider: str = "cpu") -> Network:
    """The network of the ONNX file `path` (None: of the package) on a provider of onnxruntime: a key of `PROVIDERS` or
    onnxruntime's own name. Loaded once as long as the file stays the same. Raises NetworkError."""
    path = default_model() if path is None else Path(path)
    if path is None:
        raise NetworkError(f"{scn_missing()}: expected gffe_cl/scn/weights/scn.onnx, or another model's path")
    if not path.is_file():
        raise NetworkError(f"{path}: no such file (expected a shading correction network, ONNX)")
    name, state = _provider(provider), path.stat()
    key, stamp = (path.resolve(), name), (state.st_mtime_ns, state.st_size)
    if key not in _loaded or _loaded[key][0] != stamp:
        _loaded[key] = stamp, Network(path, name)
    return _loaded[key][1]


def load_onnxruntime() -> ModuleType:
    """onnxruntime without its telemetry, which would write an id of the device into the user's cache folder when it is
    imported: the only place that imports it."""
    os.environ["ORT_DISABLE_TELEMETRY"] = "1"
    import onnxruntime

    onnxruntime.disable_telemetry_events()
    return onnxruntime


class Network:
    """A session of onnxruntime; see `load_network`. `provider` is onnxruntime's name of it; `takes_trends`: whether the
    model has such an input."""

    def __init__(self, path: Path, provider: str):
        onnxruntime = load_onnxruntime()
        self.path, self.provider = path, provider
        options = onnxruntime.SessionOptions()
        options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_ENABLE_ALL
        for kind in ("intra_op", "inter_op"):
            options.add_session_config_entry(f"session.{kind}.allow_spinning", "0")
        options.log_severity_level = 4  # what goes wrong is raised
        providers = list(dict.fromkeys((provider, PROVIDERS["cpu"])))
        try:
            self.session = onnxruntime.InferenceSession(str(path), options, providers)
        except Exception as error:  # onnxruntime's classes have no common base
            raise NetworkError(f"{path}: cannot be loaded (expected an ONNX model): {_one_line(error)}") from None
        if provider not in self.session.get_providers():
            raise NetworkError(f"provider {provider} does not work here (expected its libraries and a device)")
        inputs = {"frames": (1, INPUT_PLANES, None, None), "alpha": (1,)}
        self.takes_trends = any(value.name == "trends" for value in self.session.get_inputs())
        if self.takes_trends:
            inputs["trends"] = (1, TREND_PLANES, None, None)
        _require(path, "input", self.session.get_inputs(), inputs)
        _require(path, "output", self.session.get_outputs(), {"correction": (1, OUTPUT_PLANES, None, None)})

    def run(self, frames: np.ndarray, alpha: float, correction: np.ndarray, trends: np.ndarray | None = None) -> int:
        """Read `frames` (8, h, w) and, if the model `takes_trends`, `trends` (7, h, w), write `correction` (5, h, w):
        C-contiguous float32, used in place on the CPU. Returns for how many of its pixels the network gave NaN or
        infinity. Raises NetworkError."""
        inputs = {"frames": frames[None], "alpha": np.array([alpha], np.float32)}
        if trends is not None:
            inputs["trends"] = trends[None]
        binding = self.session.io_binding()
        try:
            for name, array in inputs.items():
                binding.bind_input(name, "cpu", 0, np.float32, array.shape, array.ctypes.data)
            shape = (1, *correction.shape)
            binding.bind_output("correction", "cpu", 0, np.float32, shape, correction.ctypes.data)
            self.session.run_with_iobinding(binding)
            binding.synchronize_outputs()
        except Exception as error:
            raise NetworkError(f"{self.path}: the network failed on {self.provider}: {_one_line(error)}") from None
        return _pixels_not_finite(correction)


def _pixels_not_finite(planes: np.ndarray) -> int:
    """Pixels of (n, h, w) that are NaN or infinite in any plane; one sum where there are none."""
    with np.errstate(all="ignore"):
        if np.isfinite(planes.sum()):
            return 0
    return int((~np.isfinite(planes)).any(0).sum())


def _provider(name: str) -> str:
    """onnxruntime's name of a provider that is available."""
    available = load_onnxruntime().get_available_providers()
    wanted = PROVIDERS.get(name.lower(), name)
    if wanted in available:
        return wanted
    short = {full: key for key, full in PROVIDERS.items()}
    raise NetworkError(
        f"provider '{name}' is not available in this onnxruntime (there is:"
        f" {', '.join(short.get(full, full) for full in available)})"
    )


def _require(path: Path, kind: str, values: list, expected: dict[str, tuple]) -> None:
    """NetworkError unless the model's inputs or outputs are `expected`: shapes by name, None where any size must do."""
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


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]
