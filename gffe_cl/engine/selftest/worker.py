"""Child process of the self-test: the whole workload on one device, or the network in onnxruntime.

    python -m gffe_cl.engine.selftest.worker device 0:0 '{"forms": null, "cases": null, "until": null, "speed": true}'
    python -m gffe_cl.engine.selftest.worker network

Prints lines that begin with MARK and hold a JSON dictionary: the work in progress ("doing"), then results.
"""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from typing import Any

import pyopencl as cl

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.opencl.device import DeviceInfo, list_devices, open_info
from gffe_cl.engine.selftest.network import compare_network
from gffe_cl.engine.selftest.reference import BufferComparison, Reference, inputs_digest, recorded
from gffe_cl.engine.selftest.scene import frames
from gffe_cl.engine.selftest.speed import figures, speed
from gffe_cl.engine.selftest.workload import CASES, SIZE, Form, forms_of, moments

MARK = "selftest: "
_FACTS = (
    "vendor", "version", "opencl_c_version", "driver_version", "max_compute_units", "max_clock_frequency",
    "global_mem_size", "max_mem_alloc_size", "local_mem_size", "max_work_group_size", "mem_base_addr_align",
    "address_bits", "single_fp_config", "extensions",
)  # fmt: skip


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
    device = open_info(info, profiling=True)
    reference = recorded()
    say(facts=facts_of(device.cl_device), exact_division=device.exact_division)
    cases = wanted["cases"] or list(CASES)
    say(
        inputs=[
            case for case in cases if inputs_digest(frames(*SIZE, CASES[case].render_size)) != reference.inputs[case]
        ]
    )
    for form in forms_of(device):
        if wanted["forms"] is None or form.name in wanted["forms"]:
            say(form=compare_form(info, form, reference, cases, wanted["until"]))
    if wanted["speed"]:
        say(doing="speed")
        say(speed=figures(speed(device)))
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
