"""Records anew what `gffe selftest` compares with: after a change of kernels that is meant, or of the weights.

    python docs/tools/record_selftest.py

Records on the default device (`GFFE_DEVICE` chooses another), and says what has changed.
"""

from __future__ import annotations

from gffe_cl.engine.opencl.device import open_device
from gffe_cl.engine.selftest.reference import Reference, inputs_digest, model_digest, reference_path
from gffe_cl.engine.selftest.scene import frames
from gffe_cl.engine.selftest.workload import CASES, SIZE, forms_of, moments


def recorded_now() -> Reference:
    """Return the references as this code makes them."""
    reference = Reference(model=model_digest())
    for name, case in CASES.items():
        device = open_device()
        reference.inputs[name] = inputs_digest(frames(*SIZE, case.render_size))
        for moment, buffers in moments(device, case, forms_of(device)[0]):
            reference.record(name, moment, buffers)
    return reference


def changed_buffers(before: Reference, after: Reference) -> list[str]:
    """Return "case: buffer" of all whose hashes differ at any moment."""
    found = {}
    for case, moments_of_case in after.hashes.items():
        for moment, hashes in moments_of_case.items():
            held = before.hashes.get(case, {}).get(moment, {})
            found |= {f"{case}: {name}": None for name in hashes | held if hashes.get(name) != held.get(name)}
    return sorted(found)


if __name__ == "__main__":
    path = reference_path()
    before, after = Reference.load(path) if path.exists() else Reference(), recorded_now()
    after.save(path)
    changed = changed_buffers(before, after)
    print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB; {len(changed)} buffers have changed")
    print("\n".join(changed[:40]))
