"""Runner of the self-test, and its results."""

from __future__ import annotations

import importlib.metadata
import json
import platform
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.inference.network import ON_CPU
from gffe_cl.engine.opencl.device import DeviceInfo, list_devices, select
from gffe_cl.engine.opencl.probing import run_child
from gffe_cl.engine.opencl.runtimes import driver_variables, vendors
from gffe_cl.engine.selftest.worker import MARK

TOLERANCE = 1e-3  # of the network's output, channels of a few units, where the CPU has no fused multiply-add
EQUAL, DIFFERS, FAILED, REFUSED = "equal", "differs", "failed", "refused"
_PACKAGES = ("gffe-cl", "numpy", "pyopencl", "onnxruntime")


@dataclass
class DeviceResult:
    """Result of one device. `verdict`: "equal", "differs", "failed" (crash, hang or exception: `problem`) or
    "refused" (by probing: `problem`). `forms`: the worker's results by form of the kernels; `speed`: GB/s of copying
    ("bandwidth"), "bytes_per_pixel" and "milliseconds" of GAE; `other_inputs`: cases whose input frames differ from
    the references on this machine, which is no fault of the device."""

    info: DeviceInfo
    verdict: str = FAILED
    problem: str = ""
    facts: dict[str, Any] = field(default_factory=dict)
    other_inputs: list[str] = field(default_factory=list)
    forms: list[dict[str, Any]] = field(default_factory=list)
    speed: dict[str, float] = field(default_factory=dict)
    seconds: float = 0.0

    def worst(self) -> dict[str, dict[str, Any]]:
        """Return the worst result by buffer, of buffers that differ in any form and case: the largest `ulp` and
        `pixels` (None where no values are recorded), the number of `moments`, and the `forms` and `cases`."""
        found: dict[str, dict[str, Any]] = {}
        for form in self.forms:
            for case, told in form["cases"].items():
                for name, difference in told["different"].items():
                    into = found.setdefault(
                        name, {"ulp": None, "pixels": None, "moments": 0, "forms": set(), "cases": set()}
                    )
                    for figure in ("ulp", "pixels"):
                        if difference[figure] is not None:
                            into[figure] = max(into[figure] or 0, difference[figure])
                    into["moments"] += len(difference["moments"])
                    into["forms"].add(form["name"])
                    into["cases"].add(case)
        return found

    @property
    def buffers(self) -> list[str]:
        """Names of all compared buffers."""
        return sorted({name for form in self.forms for case in form["cases"].values() for name in case["buffers"]})


@dataclass
class NetworkResult:
    """Result of the shading correction network on the `provider` "cpu": the `largest` difference from the recorded
    output, or the `problem` that prevented it."""

    provider: str
    largest: float | None = None
    problem: str = ""

    @property
    def verdict(self) -> str:
        if self.largest is None:
            return FAILED
        return EQUAL if self.largest <= TOLERANCE else DIFFERS


@dataclass
class SelfTest:
    """Results of the self-test, by device, and of the network."""

    devices: list[DeviceResult]
    networks: list[NetworkResult]

    @property
    def exit_code(self) -> int:
        """Exit code of the command: 0 if all is equal; 1 if something differs; 2 if something could not be run and
        nothing differs."""
        verdicts = [result.verdict for result in (*self.devices, *self.networks)]
        if DIFFERS in verdicts:
            return 1
        return 2 if FAILED in verdicts or EQUAL not in [result.verdict for result in self.devices] else 0

    def document(self) -> dict[str, Any]:
        """Return the results as a document for JSON."""
        return {
            "exit_code": self.exit_code,
            "devices": [asdict(result) | {"different": _listed(result.worst())} for result in self.devices],
            "networks": [asdict(result) | {"verdict": result.verdict} for result in self.networks],
        }


def selftest(
    device: str | None = None,
    *,
    seconds: float = 600.0,
    wanted: dict[str, Any] | None = None,
    networks: bool = True,
    on_device: Callable[[DeviceInfo], None] = lambda info: None,
) -> SelfTest:
    """Run the workload on every device, or on those that `device` matches (as in `open_device`), each in a child
    process that may take so many `seconds`, and the network in onnxruntime. Return the results.

    `wanted` narrows the workload: lists of names of "forms" and "cases" (None: all), the last new frame as "until", and
    whether to measure "speed". Raises GffeError if no device matches.
    """
    infos = list_devices()
    chosen = infos if device is None else select(infos, device)
    if not chosen:
        there = ", ".join(f"{info.index} {info.platform} / {info.name}" for info in infos) or "no OpenCL device"
        raise GffeError(f"no device matches '{device}' (there is: {there})" if device else there)
    wanted = {"forms": None, "cases": None, "until": None, "speed": True} | (wanted or {})
    found = []
    for info in chosen:
        on_device(info)
        found.append(_device(info, seconds, wanted))
    return SelfTest(found, [_network(seconds)] if networks else [])


def _device(info: DeviceInfo, seconds: float, wanted: dict[str, Any]) -> DeviceResult:
    if not info.works:
        return DeviceResult(info, REFUSED, info.problem)
    start = time.monotonic()
    output, failure = run_child("gffe_cl.engine.selftest.worker", ["device", info.index, json.dumps(wanted)], seconds)
    result = DeviceResult(info, seconds=time.monotonic() - start)
    doing, done = "the start", False
    for told in _told(output):
        doing = told.get("doing", doing)
        done = done or "done" in told
        result.facts |= told.get("facts", {})
        result.other_inputs = told.get("other_inputs", result.other_inputs)
        result.problem = told.get("problem", result.problem)
        result.speed = told.get("speed", result.speed)
        if "form" in told:
            result.forms.append(told["form"])
    if not done or failure:
        result.problem = result.problem or f"{failure or 'ended early'}, at {doing}"
    result.verdict = DIFFERS if result.worst() else FAILED if result.problem else EQUAL
    return result


def _network(seconds: float) -> NetworkResult:
    output, failure = run_child("gffe_cl.engine.selftest.worker", ["network"], seconds)
    result = NetworkResult(ON_CPU, problem=failure)
    for told in _told(output):
        result.largest, result.problem = told.get("largest"), told.get("problem", failure)
    return result


def _told(output: str) -> list[dict[str, Any]]:
    """Return the worker's answer, without other output of drivers."""
    return [json.loads(line.removeprefix(MARK)) for line in output.splitlines() if line.startswith(MARK)]


def _listed(worst: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return the results for JSON, which has no sets."""
    return {
        name: {key: sorted(value) if isinstance(value, set) else value for key, value in told.items()}
        for name, told in worst.items()
    }


def machine() -> dict[str, Any]:
    """Return the machine's description: system, versions, OpenCL drivers, variables that drivers read."""
    versions = {}
    for name in _PACKAGES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = None
    return {
        "system": platform.platform(),
        "processor": platform.machine(),
        "python": platform.python_version(),
        "packages": versions,
        "drivers": [icd.name for icd in vendors()],
        "variables": driver_variables(),
        "time": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }
