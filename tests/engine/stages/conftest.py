"""Forms of the kernels."""

import pytest


@pytest.fixture(params=[8, 1])
def lanes(request, device, monkeypatch):
    """Pixels that each work-item of the kernels that are built from here on works on."""
    monkeypatch.setitem(device.__dict__, "lanes", request.param)
