"""Recorded references: a hash of every buffer after each new frame ("moment") of the workload, and for one of them in
each case the values, so that differences can be measured in ulp and pixels; and comparison with them."""

from __future__ import annotations

import hashlib
import json
import lzma
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from pathlib import Path

import numpy as np

from gffe_cl.engine.inference.network import Network, NetworkError, default_model, digest_of_weights, load_network

KEPT_MOMENT = "frame 3 + 2/3"  # of which values are recorded
_EXAMPLES = 4  # reported values that differ
_FILTERS = [{"id": lzma.FILTER_LZMA2, "preset": 9 | lzma.PRESET_EXTREME, "dict_size": 1 << 24}]
_DIGITS = 16  # of a hash

Buffers = dict[str, np.ndarray]


@dataclass
class Reference:
    """Recorded references. `hashes` by case, moment and buffer; `values` by case and buffer, at KEPT_MOMENT; `inputs`:
    hash of the input frames by case; `model`: hash of the weights of the shading correction network."""

    hashes: dict[str, dict[str, dict[str, str]]] = field(default_factory=dict)
    values: dict[str, Buffers] = field(default_factory=dict)
    inputs: dict[str, str] = field(default_factory=dict)
    model: str = ""

    def record(self, case: str, moment: str, buffers: Buffers) -> None:
        self.hashes.setdefault(case, {})[moment] = {name: digest(array) for name, array in buffers.items()}
        if moment == KEPT_MOMENT:
            self.values[case] = {name: np.ascontiguousarray(array) for name, array in buffers.items()}

    def save(self, path: Path) -> None:
        arrays = {f"{case}/{name}": array for case, held in self.values.items() for name, array in held.items()}
        head = {
            "hashes": self.hashes,
            "inputs": self.inputs,
            "model": self.model,
            "arrays": [(name, array.dtype.str, array.shape) for name, array in arrays.items()],
        }
        text = json.dumps(head, separators=(",", ":")).encode()
        content = b"".join([len(text).to_bytes(8, "little"), text, *(array.tobytes() for array in arrays.values())])
        path.write_bytes(lzma.compress(content, filters=_FILTERS))

    @classmethod
    def load(cls, path: Path) -> Reference:
        content = lzma.decompress(path.read_bytes())
        start = 8 + int.from_bytes(content[:8], "little")
        head = json.loads(content[8:start])
        found = cls(head["hashes"], {}, head["inputs"], head["model"])
        for name, kind, shape in head["arrays"]:
            array = np.frombuffer(content, kind, int(np.prod(shape)), start).reshape(shape)
            start += array.nbytes
            case, _, buffer = name.partition("/")
            if buffer:  # earlier recordings hold one more array
                found.values.setdefault(case, {})[buffer] = array
        return found


def reference_path() -> Path:
    """Return the path of the references in the package."""
    return Path(str(files("gffe_cl.engine.selftest") / "reference.bin"))


@cache
def recorded() -> Reference:
    """Return the references that come with the package."""
    return Reference.load(reference_path())


def digest(*arrays: np.ndarray) -> str:
    """Return the hash of types, shapes and values of arrays; NaN counts as NaN, whatever its bits."""
    made = hashlib.sha256()
    for array in arrays:
        array = np.ascontiguousarray(array)
        if array.dtype.kind == "f":
            array = np.where(np.isnan(array), np.array(np.nan, array.dtype), array)
        made.update(f"{array.dtype.str}{array.shape}".encode())
        made.update(array.tobytes())
    return made.hexdigest()[:_DIGITS]


@dataclass
class BufferDifference:
    """Difference of a buffer from the reference: the `moments` at which it differs; where values are recorded also the
    largest difference in `ulp` (for integers: in steps), the number of `pixels` that differ, and some `examples`:
    [index, expected, found]."""

    moments: list[str] = field(default_factory=list)
    ulp: int | None = None
    pixels: int | None = None
    share: float | None = None
    examples: list[list] = field(default_factory=list)

    def __str__(self) -> str:
        if self.ulp is None or self.share is None:
            return f"differs at {len(self.moments)} moments"
        return f"{self.ulp} ulp, {self.pixels} px ({100 * self.share:.2g}%)"


class BufferComparison:
    """Comparison of one case with its reference, moment by moment: `different` by buffer, and the names of the buffers
    `compared`."""

    def __init__(self, reference: Reference, case: str):
        self._hashes, self._values = reference.hashes[case], reference.values[case]
        self.different: dict[str, BufferDifference] = {}
        self.compared: set[str] = set()
        self.moments = 0

    def add(self, moment: str, buffers: Buffers) -> None:
        self.moments += 1
        expected = self._hashes[moment]
        for name in expected.keys() | buffers.keys():
            self.compared.add(name)
            if name in expected and name in buffers and digest(buffers[name]) == expected[name]:
                continue
            found = self.different.setdefault(name, BufferDifference())
            found.moments.append(moment)
            if moment == KEPT_MOMENT and name in self._values and name in buffers:
                _tell(found, self._values[name], buffers[name])


def _tell(found: BufferDifference, expected: np.ndarray, array: np.ndarray) -> None:
    if array.shape != expected.shape or array.dtype != expected.dtype:
        return
    apart = ulps(expected, array)
    places = np.argwhere(apart > 0)
    pixels = (apart > 0).any(-1) if apart.ndim > 2 else apart > 0
    found.ulp, found.pixels, found.share = int(apart.max()), int(pixels.sum()), float(pixels.mean())
    found.examples = [
        [place.tolist(), str(expected[tuple(place)]), str(array[tuple(place)])] for place in places[:_EXAMPLES]
    ]


def ulps(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return (int64) how many values of their type lie between a and b; for integers their distance. Two NaN are
    equal."""
    if a.dtype.kind != "f":
        return np.abs(a.astype(np.int64) - b.astype(np.int64))
    kind = {2: np.int16, 4: np.int32, 8: np.int64}[a.itemsize]
    ordered = []
    for values in (a, b):
        bits = np.ascontiguousarray(values).view(kind).astype(np.int64)
        ordered.append(np.where(bits < 0, np.iinfo(kind).min - bits, bits))
    return np.where(np.isnan(a) & np.isnan(b), 0, np.abs(ordered[0] - ordered[1]))


def inputs_digest(frames: Iterable) -> str:
    """Return the hash of rendered frames, the input of a device."""
    return digest(*(array for frame in frames for array in (frame.color, frame.depth, frame.motion)))


def model_digest() -> str:
    """Return the hash of the weights that come with the package, "" if there are none."""
    path = default_model()
    return "" if path is None else digest_of_weights(path)[:16]


def compare_network() -> float:
    """Return the largest difference of onnxruntime's output to the recorded one: 0 where the CPU has fused
    multiply-add, as x86-64 has since 2013. Raises NetworkError if it cannot run the network, or the weights are not the
    recorded ones."""
    reference = recorded()
    if reference.model != model_digest():
        raise NetworkError("the installed weights are not those that the references were recorded with")
    values, names = reference.values["default"], ("network_input.frames", "shading_flow.candidates")
    frames, candidates = (np.ascontiguousarray(values[name]) for name in names)
    expected = values["correction.judgement"]
    found, network = np.empty_like(expected), load_network()
    assert isinstance(network, Network)
    network.run(frames, candidates, found)
    return float(np.abs(np.where(np.isfinite(found), found, np.inf) - expected).max())
