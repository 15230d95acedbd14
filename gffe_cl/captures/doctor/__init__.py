"""The doctor: diagnosis of faults in captured sequences (`gffe check`), and the format that undoes them."""

from gffe_cl.captures.doctor.diagnose import Diagnosis, examine
from gffe_cl.captures.doctor.findings import Finding
from gffe_cl.captures.doctor.found_format import FoundFormat, with_format
from gffe_cl.captures.doctor.quick import quick_warning, warning_of

__all__ = [
    "Diagnosis",
    "Finding",
    "FoundFormat",
    "examine",
    "quick_warning",
    "warning_of",
    "with_format",
]
