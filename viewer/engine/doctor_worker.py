"""Diagnosis of the open sequence (`gffe check`), in the background."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gffe_cl.captures.sequence import Sequence
from gffe_cl.engine.core.errors import GffeError
from .background import Background

if TYPE_CHECKING:
    from gffe_cl.captures.doctor import Finding

_WRONG_PLACE = "does not follow the frame before it (doctor)"


class Doctor:
    """The doctor for `sequence`, on a thread of its own.

    Attributes
    ----------
    done : bool
    findings : list of Finding
        Faults first, then notes and what cannot be told.
    marks : dict
        Rendered frames that something is said of, with what.
    converts : bool
        Whether a format to paste undoes all faults.
    problem : str
        Why it could not be examined.
    """

    def __init__(self, sequence: Sequence):
        self.done, self.problem, self.converts = False, "", False
        self.findings: list[Finding] = []
        self.marks: dict[int, str] = {}
        Background("doctor").run(self._run, sequence)

    def _run(self, sequence: Sequence) -> None:
        from gffe_cl.captures.doctor import examine
        from gffe_cl.captures.doctor.findings import UNKNOWN, AtFrame

        try:
            found = examine(sequence, sequence.exposure, sequence.format)
        except GffeError as error:
            self.problem = str(error)
        except Exception as error:  # a window shows it; nothing else depends on it
            self.problem = f"{type(error).__name__}: {error}"
        else:
            self.findings, self.converts = found.findings, found.found is not None
            alone = [one.frame for one in self.findings if isinstance(one, AtFrame) and one.kind != UNKNOWN]
            self.marks = dict.fromkeys(alone, _WRONG_PLACE)
        self.done = True
