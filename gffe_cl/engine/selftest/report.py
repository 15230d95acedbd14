"""Runner of the self-test, and its results. The whole workload of one device runs in a child process of its own, and so
does the network in onnxruntime:

    python -m gffe_cl.engine.selftest.report device 0:0 '{"forms": null, "cases": null, "until": null}'
    python -m gffe_cl.engine.selftest.report network

A child prints lines that begin with MARK and hold a JSON dictionary: the work in progress ("doing"), then results.
"""

from __future__ import annotations

import importlib.metadata
import json
import platform
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

import pyopencl as cl

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.inference.network import ON_CPU
from gffe_cl.engine.opencl.device import DeviceInfo, list_devices, open_info, select
from gffe_cl.engine.opencl.probing import run_child
from gffe_cl.engine.opencl.runtimes import driver_variables, vendors
from gffe_cl.engine.selftest.reference import BufferComparison, Reference, compare_network, inputs_digest, recorded
from gffe_cl.engine.selftest.scene import frames
from gffe_cl.engine.selftest.workload import CASES, SIZE, Form, forms_of, moments

TOLERANCE = 1e-3  # of the network's output, channels of a few units, where the CPU has no fused multiply-add
EQUAL, DIFFERS, FAILED, REFUSED = "equal", "differs", "failed", "refused"
MARK = "selftest: "
_MODULE = "gffe_cl.engine.selftest.report"
_FACTS = ("vendor", "version", "opencl_c_version", "driver_version", "max_compute_units", "max_clock_frequency")
_FACTS += ("global_mem_size", "max_mem_alloc_size", "local_mem_size", "max_work_group_size", "mem_base_addr_align")
_FACTS += ("address_bits", "single_fp_config", "extensions")
_PACKAGES = ("gffe-cl", "numpy", "pyopencl", "onnxruntime")


@dataclass
class DeviceResult:
    """Result of one device. `verdict`: "equal", "differs", "failed" (crash, hang or exception: `problem`) or
    "refused" (by probing: `problem`). `forms`: the child's results by form of the kernels; `other_inputs`: cases whose
    input frames differ from the references on this machine, which is no fault of the device."""

    info: DeviceInfo
    verdict: str = FAILED
    problem: str = ""
    facts: dict[str, Any] = field(default_factory=dict)
    other_inputs: list[str] = field(default_factory=list)
    forms: list[dict[str, Any]] = field(default_factory=list)
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

    `wanted` narrows the workload: lists of names of "forms" and "cases" (None: all), and the last new frame as "until".
    Raises GffeError if no device matches.
    """
    infos = list_devices()
    chosen = infos if device is None else select(infos, device)
    if not chosen:
        there = ", ".join(f"{info.index} {info.platform} / {info.name}" for info in infos) or "no OpenCL device"
        raise GffeError(f"no device matches '{device}' (there is: {there})" if device else there)
    wanted = {"forms": None, "cases": None, "until": None} | (wanted or {})
    found = []
    for info in chosen:
        on_device(info)
        found.append(_device(info, seconds, wanted))
    return SelfTest(found, [_network(seconds)] if networks else [])


def _device(info: DeviceInfo, seconds: float, wanted: dict[str, Any]) -> DeviceResult:
    if not info.works:
        return DeviceResult(info, REFUSED, info.problem)
    start = time.monotonic()
    output, failure = run_child(_MODULE, ["device", info.index, json.dumps(wanted)], seconds)
    result = DeviceResult(info, seconds=time.monotonic() - start)
    doing, done = "the start", False
    for told in _told(output):
        doing = told.get("doing", doing)
        done = done or "done" in told
        result.facts |= told.get("facts", {})
        result.other_inputs = told.get("other_inputs", result.other_inputs)
        result.problem = told.get("problem", result.problem)
        if "form" in told:
            result.forms.append(told["form"])
    if not done or failure:
        result.problem = result.problem or f"{failure or 'ended early'}, at {doing}"
    result.verdict = DIFFERS if result.worst() else FAILED if result.problem else EQUAL
    return result


def _network(seconds: float) -> NetworkResult:
    output, failure = run_child(_MODULE, ["network"], seconds)
    result = NetworkResult(ON_CPU, problem=failure)
    for told in _told(output):
        result.largest, result.problem = told.get("largest"), told.get("problem", failure)
    return result


def _told(output: str) -> list[dict[str, Any]]:
    """Return the child's answer, without other output of drivers."""
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


# ---- in the child ----------------------------------------------------------------------------------


def say(**told: Any) -> None:
    print(MARK + json.dumps(told), flush=True)


def facts_of(device: cl.Device) -> dict[str, Any]:
    """Return the properties of a device that its driver reports."""
    found: dict[str, Any] = {}
    for name in _FACTS:
        try:
            value = getattr(device, name)
        except cl.Error:
            continue
        found[name] = value if isinstance(value, int | float) else str(value).strip()
    return found


def compare_form(info: DeviceInfo, form: Form, reference: Reference, cases: list[str], until: str | None) -> dict:
    """Return how the buffers of all `cases` differ, until the moment `until` if that is not None, in a form of
    kernels."""
    told: dict[str, Any] = asdict(form) | {"cases": {}}
    for case in cases:
        comparison = BufferComparison(reference, case)
        for moment, buffers in moments(open_info(info), CASES[case], form):
            say(doing=f"{form.name}, {case}, {moment}")
            comparison.add(moment, buffers)
            if moment == until:
                break
        told["cases"][case] = {
            "moments": comparison.moments,
            "buffers": sorted(comparison.compared),
            "different": {name: asdict(found) for name, found in sorted(comparison.different.items())},
        }
    return told


def run_device(index: str, wanted: dict[str, Any]) -> None:
    info = next(info for info in list_devices() if info.index == index)
    device, reference = open_info(info), recorded()
    say(facts=facts_of(device.cl_device) | {"exact_division": device.exact_division})
    cases = wanted["cases"] or list(CASES)
    inputs = {case: inputs_digest(frames(*SIZE, CASES[case].render_size)) for case in cases}
    say(other_inputs=[case for case in cases if inputs[case] != reference.inputs[case]])
    for form in forms_of(device):
        if wanted["forms"] is None or form.name in wanted["forms"]:
            say(form=compare_form(info, form, reference, cases, wanted["until"]))
    say(done=True)


def main(arguments: list[str]) -> None:
    try:
        if arguments[0] == "network":
            say(largest=compare_network())
        else:
            run_device(arguments[1], json.loads(arguments[2]))
    except GffeError as error:
        say(problem=str(error))


if __name__ == "__main__":
    main(sys.argv[1:])
