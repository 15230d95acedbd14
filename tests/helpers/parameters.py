"""Parameters of tests."""

import pytest


def few(cases, *kept):
    """Return all `cases` as parameters, of which those that are not `kept` are long."""
    assert set(kept) <= set(cases)
    each = ((case, case if isinstance(case, tuple) else (case,)) for case in cases)
    return [pytest.param(*values, marks=() if case in kept else pytest.mark.long) for case, values in each]
