"""The doctor: diagnosis and repair of faults in captured sequences (`gffe check`)."""

from gffe_cl.captures.doctor.choosing import require_findings, selected
from gffe_cl.captures.doctor.diagnose import Diagnosis, examine
from gffe_cl.captures.doctor.findings import Finding
from gffe_cl.captures.doctor.opening import open_for_check
from gffe_cl.captures.doctor.quick import first_diagnosis, has_interface, quick_warning, warning_of
from gffe_cl.captures.doctor.repair import Repair, write_repaired

__all__ = [
    "Diagnosis",
    "Finding",
    "Repair",
    "examine",
    "first_diagnosis",
    "has_interface",
    "open_for_check",
    "quick_warning",
    "require_findings",
    "selected",
    "warning_of",
    "write_repaired",
]
