"""Pipelines that the twin tests of the stages share."""

import numpy as np
import pytest
import twins
from twin_cases import CASES, named_case


@pytest.fixture(params=CASES)
def case(request, device, monkeypatch):
    """A `twin_cases.Case`: every name of CASES, or those that a test chooses with `indirect`."""
    found = named_case(device, request.param)
    if found.options.resampling == "linear":
        monkeypatch.setattr(twins.common, "CODE_OFFSET", np.float32(0))
    return found


@pytest.fixture(params=[8, 1])
def lanes(request, device, monkeypatch):
    """Pixels that each work-item of the kernels that are built from here on works on."""
    monkeypatch.setitem(device.__dict__, "lanes", request.param)
