"""Comparison of a provider with the CPU, in a child process: a driver may crash there.

A provider counts only after it has run the network on a fixed input and given the CPU's result. The verdict is stored
for later processes, as results of probing OpenCL devices are.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import sys
import time
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from gffe_cl.engine.core.files import read_bounded
from gffe_cl.engine.inference import providers, sessions
from gffe_cl.engine.inference.model_interface import INPUTS, OUTPUT, shapes_at
from gffe_cl.engine.inference.providers import CPU, NetworkError, NoDeviceError, Provider, cpu_model, open_session
from gffe_cl.engine.opencl.device_cache import fingerprint
from gffe_cl.engine.opencl.runtimes import keep_file, kept_folder, vendors
from gffe_cl.engine.opencl.subprocess_runner import HANGS, run_child

TOLERANCE = 1e-3  # of the network's output: channels of a few units
_SIZE = (64, 96)  # height and width of the fixed input
_TIMED_SIZE = (272, 480)  # the network's for frames of 960×540
_TOO_SLOW = 200.0  # milliseconds for the fixed input: not timed
_RUNS = 3
_SECONDS = 180
_NAME = "provider-{}.json"
_MOST_FILES = 64
_MOST_BYTES = 1 << 20
_HOUR = 3600.0
_TOLD = ("VK_", "ORT_", "DXVK_", "LIBVA_")  # variables that drivers and onnxruntime read, besides those of OpenCL's


@dataclass
class ProviderVerdict:
    """Result of comparing a provider with the CPU.

    Attributes
    ----------
    provider, device : names; the device's as its driver reports it, "" if it does not
    difference : largest between the outputs of provider and CPU; inf where there is none
    milliseconds, cpu_milliseconds : of one run for a frame of 960×540; inf where it was too slow to be timed
    problem : a line with the reason why it is refused; "" if it is not
    present : whether it has a device here at all
    """

    provider: str
    device: str = ""
    difference: float = math.inf
    milliseconds: float = math.inf
    cpu_milliseconds: float = math.inf
    problem: str = ""
    present: bool = True

    @property
    def passes(self) -> bool:
        return not self.problem

    def summary(self) -> str:
        """Return the verdict in one line, for people."""
        if self.problem:
            return self.problem.removeprefix(f"provider {self.provider}").lstrip(": ")
        times = f"{self.milliseconds:.1f} ms for 960×540, the CPU {self.cpu_milliseconds:.1f} ms"
        speed = times if math.isfinite(self.milliseconds) else "very slow"
        return f"{self.device + ', ' if self.device else ''}{speed}; differs from the CPU by {self.difference:.1g}"


def verdict(path: Path, provider: Provider, refresh: bool = False) -> ProviderVerdict:
    """Return the verdict on `provider` with the network in the file `path`, from the cache or from a test in a child
    process (`refresh`: always). Failures expire after an hour. Everything expires after a day if the drivers' files
    do not identify them."""
    file = _kept(path, provider)
    if file and not refresh:
        with suppress(OSError, ValueError, TypeError, AttributeError, RecursionError):
            found = _from_json(read_bounded(file, _MOST_BYTES).decode("utf-8"))
            age = time.time() - file.stat().st_mtime
            longest = _HOUR if found.problem else math.inf if vendors() else 24 * _HOUR
            if found.provider == provider.name and 0 <= age <= longest:
                return found
    found = _in_child(path, provider)
    if file:
        with suppress(OSError):
            keep_file(file, json.dumps(asdict(found)).encode(), _NAME.format("*"), _MOST_FILES)
    return found


def compare(path: Path, provider: Provider) -> ProviderVerdict:
    """Run the network on provider and CPU in this process, and return the verdict. A failure is a verdict, too; a
    driver may crash the process."""
    found = ProviderVerdict(provider.name)
    try:
        if not provider.built_in:
            found.device = _device_name(provider)
        free = open_session(path)
        inputs, name, expected = _on_cpu(free, *_SIZE)
        shapes = {key: array.shape for key, array in (inputs | {name: expected}).items()}
        session, output = sessions.FixedSession(path, provider, shapes, free), np.zeros_like(expected)
        took = min(_timed(lambda: session.run(inputs, name, output)) for _ in range(2))
        found.difference = float(np.abs(output - expected).max())
        if not found.difference <= TOLERANCE:
            found.problem = _difference(path, provider, found)
        elif took < _TOO_SLOW:
            found.milliseconds, found.cpu_milliseconds = _times(path, provider)
    except NoDeviceError as error:
        found.problem, found.present = str(error), False
    except NetworkError as error:
        found.problem = str(error)
    except Exception as error:  # whatever a driver throws
        found.problem = f"provider {provider.name}: {providers.one_line(error) or type(error).__name__}"
    return found


def _difference(path: Path, provider: Provider, found: ProviderVerdict) -> str:
    """Return the message about results that differ, as a line that a user can report."""
    where = f" on {found.device}" if found.device else ""
    return (
        f"provider {provider.name}{where}: its results differ from the CPU's by {found.difference:.3g} (expected at"
        f" most {TOLERANCE:g}); please report this line: {path.name}, {', '.join(provider.versions())}"
    )


def fixed_inputs(height: int, width: int) -> dict[str, np.ndarray]:
    """Return inputs of a network by name, for frames of this size, the same on every machine: blocks of one color with
    a little noise, 0 … 1."""
    rng, made, shapes = np.random.default_rng(17), {}, shapes_at(height, width)
    for name in INPUTS:
        *planes, rows, columns = shapes[name]
        blocks = rng.random((*planes, -(-rows // 8), -(-columns // 8)))
        image = blocks.repeat(8, 2).repeat(8, 3)[:, :, :rows, :columns]
        made[name] = (0.9 * image + 0.1 * rng.random(shapes[name])).astype(np.float32)
    return made


def _on_cpu(free, height: int, width: int) -> tuple[dict[str, np.ndarray], str, np.ndarray]:
    """Return fixed inputs, the name of the output, and the output of the CPU."""
    inputs = fixed_inputs(height, width)
    return inputs, OUTPUT, free.run([OUTPUT], inputs)[0]


def _times(path: Path, provider: Provider) -> tuple[float, float]:
    """Return milliseconds on provider and CPU, each with the file that it runs, for one frame, the copies included."""
    free = open_session(cpu_model(path))
    inputs, name, output = _on_cpu(free, *_TIMED_SIZE)
    shapes = {key: array.shape for key, array in (inputs | {name: output}).items()}
    session = sessions.FixedSession(path, provider, shapes, free)
    session.run(inputs, name, output)
    taken = [
        (_timed(lambda: session.run(inputs, name, output)), _timed(lambda: free.run(None, inputs)))
        for _ in range(_RUNS)
    ]
    return tuple(map(min, zip(*taken, strict=True)))


def _timed(work) -> float:
    start = time.perf_counter()
    work()
    return (time.perf_counter() - start) * 1e3


def _device_name(provider: Provider) -> str:
    device = providers.plugin_device(provider).device
    words = device.metadata.get("Description") or f"{device.vendor} {device.type.name}"
    return " ".join(words.split())


def _in_child(path: Path, provider: Provider) -> ProviderVerdict:
    output, failure = run_child(
        "gffe_cl.engine.inference.provider_check", [str(Path(path).resolve()), provider.name], _SECONDS
    )
    for line in [] if failure.startswith(HANGS) else reversed(output.splitlines()):
        with suppress(ValueError, TypeError, AttributeError):
            return _from_json(line)
    return ProviderVerdict(
        provider.name, problem=f"provider {provider.name}: its {failure or 'driver crashed (exit code 0)'}"
    )


def _from_json(text: str) -> ProviderVerdict:
    """Return the verdict of a JSON text. Raises TypeError unless the fields have the declared types."""
    found = ProviderVerdict(**json.loads(text))
    kinds = {"provider": str, "device": str, "problem": str, "present": bool}
    for name, value in asdict(found).items():
        if not isinstance(value, kinds.get(name, (int, float))):
            raise TypeError(name)
    return found


def _kept(path: Path, provider: Provider) -> Path | None:
    """Return the path of a stored verdict, None if there is no folder for it. The name hashes everything the verdict
    depends on."""
    folder = kept_folder()
    if folder is None:
        return None
    code = [Path(str(module.__file__)).read_bytes() for module in (providers, sessions)] + [Path(__file__).read_bytes()]
    versions = provider.versions()  # imports onnxruntime, which sets a variable of its own
    facts = [
        fingerprint(),
        sorted((name, value) for name, value in os.environ.items() if name.startswith(_TOLD)),
        provider.name,
        versions,
        [hashlib.sha256(content).hexdigest() for content in [path.read_bytes(), cpu_model(path).read_bytes(), *code]],
    ]
    digest = hashlib.sha256(repr(facts).encode("utf-8", "surrogateescape")).hexdigest()[:24]
    return folder / _NAME.format(digest)


if __name__ == "__main__":
    _provider = providers.PROVIDERS.get(sys.argv[2], CPU)
    print(json.dumps(asdict(compare(Path(sys.argv[1]), _provider))), flush=True)
