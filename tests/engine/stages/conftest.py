"""Forms of the kernels."""

import pytest


@pytest.fixture(params=[8, 1])
def lanes(request, device, monkeypatch):
    """Pixels that each work-item of the kernels that are built from here on works on: eight, by the path of the warp
    that the device has, or one, by that of devices without 64-bit atomics. Other pairs are the self-test's."""
    monkeypatch.setitem(device.__dict__, "lanes", request.param)
    if request.param == 1:
        monkeypatch.setattr(device.opened, "int64_atomics", False)
