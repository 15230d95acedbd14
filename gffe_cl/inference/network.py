"""Running the shading correction network with onnxruntime.

A model takes `frames` (1, 8, h, w), `alpha` (1,) and, if it wants them, `trends` (1, 7, h, w), and gives `correction`
(1, 5, h, w), all float32, for any h and w that are multiples of 16.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path

import numpy as np

from gffe_cl.inference.provider_choice import AUTO, Choice, choose
from gffe_cl.inference.providers import CPU, PROVIDERS, NetworkError, load_onnxruntime, one_line, open_session
from gffe_cl.inference.sessions import FixedSession

__all__ = ["AUTO", "PROVIDERS", "Network", "NetworkError", "default_model", "load_network", "load_onnxruntime"]

MULTIPLE = 16  # of the network's width and height
INPUT_PLANES, TREND_PLANES, OUTPUT_PLANES = 8, 7, 5
_PACKAGED = Path(str(files("gffe_cl") / "scn" / "weights" / "scn.onnx"))
_FLOAT = "tensor(float)"
_MOST_SIZES = 4  # whose sessions are kept
_loaded: dict[tuple, tuple] = {}  # (path, what was asked for) → (stamp of the file, Network)
_asked_for: list[Network] = []  # since remarks were last taken


def default_model() -> Path | None:
    """The weights that come with the package, if they do."""
    return _PACKAGED if _PACKAGED.is_file() else None


def scn_missing() -> str | None:
    """Why the shading correction network is not on by default; None where it is."""
    if default_model() is None:
        return "no trained weights for the shading correction network are installed"
    return None


def load_network(path: str | Path | None = None, provider: str = CPU.name) -> Network:
    """The network of the ONNX file `path` (None: of the package) on a provider of onnxruntime: a key of `PROVIDERS`,
    onnxruntime's own name, or "auto". One that is not the CPU is compared with it in a child process first, once per
    machine. Loaded once as long as the file stays the same. Raises NetworkError."""
    path = default_model() if path is None else Path(path)
    if path is None:
        raise NetworkError(f"{scn_missing()}: expected gffe_cl/scn/weights/scn.onnx, or another model's path")
    if not path.is_file():
        raise NetworkError(f"{path}: no such file (expected a shading correction network, ONNX)")
    state = path.stat()
    wanted = next((each.name for each in PROVIDERS.values() if provider in (each.name, each.ort)), provider)
    key, stamp = (path.resolve(), wanted), (state.st_mtime_ns, state.st_size)
    if key not in _loaded or _loaded[key][0] != stamp:
        _loaded[key] = stamp, Network(path, wanted)
    network = _loaded[key][1]
    if network not in _asked_for:
        _asked_for.append(network)
    return network


def take_remarks() -> list[str]:
    """What a user should know of what ran the networks that were asked for since this was last called: providers that
    "auto" refused, or that failed, and the CPU went on."""
    remarks = [network.remark for network in _asked_for if network.remark]
    _asked_for.clear()
    return list(dict.fromkeys(remarks))


class Network:
    """A network and what runs it; see `load_network`.

    `session`: the CPU's, for any size. `copying`: milliseconds of the last run that went into copies to the provider
    and back, as far as they are known apart. `takes_trends`:
    whether the model has such an input. `remark`: what a user should know of what runs it, "" if nothing.
    """

    def __init__(self, path: Path, provider: str = CPU.name):
        self.path, self.session = path, open_session(path)
        self.copying = 0.0
        self._failure = ""
        self._fixed: dict[tuple[int, int], FixedSession] = {}  # by height and width, the latest last
        self._one_at_a_time = threading.RLock()  # on a provider; the CPU's session has no state
        inputs = {"frames": (1, INPUT_PLANES, None, None), "alpha": (1,)}
        self.takes_trends = any(value.name == "trends" for value in self.session.get_inputs())
        if self.takes_trends:
            inputs["trends"] = (1, TREND_PLANES, None, None)
        _require(path, "input", self.session.get_inputs(), inputs)
        _require(path, "output", self.session.get_outputs(), {"correction": (1, OUTPUT_PLANES, None, None)})
        self.choice: Choice = choose(path, provider)

    @property
    def provider(self) -> str:
        """onnxruntime's name of what runs it."""
        return (CPU if self._failure else self.choice.provider).ort

    @property
    def remark(self) -> str:
        return "; ".join(filter(None, (self.choice.remark, self._failure)))

    def prepare(self, height: int, width: int) -> None:
        """Make what it takes to run on images of this size, which may take seconds. Raises NetworkError."""
        self._guarded(lambda: None if self.provider == CPU.ort else self._session_of(height, width))

    def run(self, frames: np.ndarray, alpha: float, correction: np.ndarray, trends: np.ndarray | None = None) -> int:
        """Read `frames` (8, h, w) and, if the model `takes_trends`, `trends` (7, h, w), write `correction` (5, h, w):
        C-contiguous float32, used in place on the CPU. Returns for how many of its pixels the network gave NaN or
        infinity. Raises NetworkError."""
        inputs = {"frames": frames[None], "alpha": np.array([alpha], np.float32)}
        if trends is not None:
            inputs["trends"] = trends[None]
        self._guarded(lambda: self._run(inputs, correction[None]))
        return _pixels_not_finite(correction)

    def _guarded(self, work: Callable[[], object]) -> None:
        """Do `work`; where it fails on a provider that was not asked for by name, once more on the CPU, for good."""
        try:
            work()
        except Exception as error:  # whatever a driver throws
            text = one_line(error)
            if self._failure or not self.choice.may_fall_back:
                raise NetworkError(f"{self.path}: the network failed on {self.provider}: {text}") from None
            self._failure = f"{self.path.name}: the network failed on {self.provider} ({text}) and went on on the CPU"
            self._fixed.clear()
            self._guarded(work)

    def _run(self, inputs: dict[str, np.ndarray], correction: np.ndarray) -> None:
        if self.provider != CPU.ort:
            with self._one_at_a_time:
                fixed = self._session_of(*correction.shape[2:])
                fixed.run(inputs, "correction", correction)
                self.copying = fixed.copying
            return
        self.copying = 0.0
        binding = self.session.io_binding()
        for name, array in inputs.items():
            binding.bind_input(name, "cpu", 0, np.float32, array.shape, array.ctypes.data)
        binding.bind_output("correction", "cpu", 0, np.float32, correction.shape, correction.ctypes.data)
        self.session.run_with_iobinding(binding)
        binding.synchronize_outputs()

    def _session_of(self, height: int, width: int) -> FixedSession:
        """On the provider, for images of this size."""
        size = height, width
        with self._one_at_a_time:
            if size in self._fixed:
                self._fixed[size] = self._fixed.pop(size)
                return self._fixed[size]
            images = {"frames": INPUT_PLANES, "correction": OUTPUT_PLANES}
            if self.takes_trends:
                images["trends"] = TREND_PLANES
            shapes = {name: (1, planes, *size) for name, planes in images.items()} | {"alpha": (1,)}
            made = FixedSession(self.path, self.choice.provider, shapes, self.session)
            while len(self._fixed) >= _MOST_SIZES:
                del self._fixed[next(iter(self._fixed))]
            self._fixed[size] = made
            return made


def _pixels_not_finite(planes: np.ndarray) -> int:
    """Pixels of (n, h, w) that are NaN or infinite in any plane; one sum where there are none."""
    with np.errstate(all="ignore"):
        if np.isfinite(planes.sum()):
            return 0
    return int((~np.isfinite(planes)).any(0).sum())


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
