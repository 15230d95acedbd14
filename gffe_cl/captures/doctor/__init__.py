"""The doctor: diagnosis of faults in captured sequences (`gffe check`), and the format that undoes them."""

from gffe_cl.captures.doctor.diagnose import Diagnosis, examine, quick_warning, warning_of
from gffe_cl.captures.doctor.findings import Finding
from gffe_cl.captures.doctor.found_format import FoundFormat, with_format

__all__ = [
    "Diagnosis",
    "Finding",
    "FoundFormat",
    "examine",
    "quick_warning",
    "warning_of",
    "with_format",
]
