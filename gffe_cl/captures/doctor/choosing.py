"""Selection of the findings to repair: those that the user names, or all except those with a single piece of
evidence."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from gffe_cl.captures.doctor.diagnose import Diagnosis
from gffe_cl.captures.doctor.differences import jitter_id
from gffe_cl.captures.doctor.findings import BOTTOM_UP, DISPLAY_VALUES, FIXABLE, TWICE, Finding, finding_id
from gffe_cl.captures.doctor.hypotheses.depths import AS_GIVEN
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import shown

# The only evidence is antialiased silhouettes, which some renderers draw differently.
ON_REQUEST = finding_id("color", DISPLAY_VALUES)


def require_findings(names: Collection[str], option: str) -> None:
    """Raise GffeError unless all `names` are findings that can be repaired."""
    for name in names:
        if name not in FIXABLE:
            raise GffeError(f"{option} {shown(name)}: no such finding (expected one of {', '.join(FIXABLE)})")


def selected(diagnosis: Diagnosis, only: Collection[str] = (), without: Collection[str] = ()) -> Diagnosis:
    """Return `diagnosis` with the findings to repair, and the reading that repairs just these: `only`, or all but
    display values; less `without`. Raises GffeError for unknown names, and if one of `only` was not found."""
    require_findings(only, "--only")
    require_findings(without, "--except")
    found = fixed_by(diagnosis)
    for name in only:
        if name not in found:
            words = f"expected one of {', '.join(found)}" if found else "there is nothing to repair"
            raise GffeError(f"--only {name}: not found in this sequence ({words})")
    wanted = set(only or [name for name in found if name != ON_REQUEST]) - set(without)
    kept = [finding for finding in diagnosis.findings if finding.id in wanted]
    reading, order = diagnosis.reading, diagnosis.order
    reading = replace(
        reading,
        motion=reading.motion.keeping(_names(kept, "motion")),
        camera=reading.camera.keeping(_names(kept, "camera")),
        depth=reading.depth if set(_names(kept, "depth")) - {BOTTOM_UP} else AS_GIVEN,
        jitter=reading.jitter if jitter_id(reading.jitter) in wanted else "",
        rows=tuple(buffer for buffer in reading.rows if finding_id(buffer, BOTTOM_UP) in wanted),
    )
    if order is not None and not wanted & {"frames-out-of-order", finding_id("frames", TWICE)}:
        order = replace(order, order=None)
    mends = [mend for mend in diagnosis.mends if mend.finding.id in wanted]
    return replace(
        diagnosis, findings=kept, reading=reading, order=order, mends=mends, decodes_color=ON_REQUEST in wanted
    )


def fixed_by(diagnosis: Diagnosis) -> list[str]:
    """Return the ids of the findings of `diagnosis` that can be repaired or left."""
    return list(dict.fromkeys(f.id for f in diagnosis.findings if f.fix and f.id in FIXABLE))


def _names(findings: list[Finding], about: str) -> tuple[str, ...]:
    return tuple(finding.name for finding in findings if finding.about == about)
