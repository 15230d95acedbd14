"""Fixtures: every usable OpenCL device once (`GFFE_DEVICE` narrows the choice); the weights of the package are hidden,
so that nothing hangs on them but the tests of themselves (test_quality.py). What is known of devices is found out anew
by each run, and kept from the user's cache."""

import functools
import os
import sys
import tempfile
from pathlib import Path

import pytest

from gffe_cl.cli import main
from gffe_cl.engine.inference import network
from gffe_cl.engine.opencl.device import best_of, list_devices, open_info, select

_cache = tempfile.TemporaryDirectory(prefix="gffe-tests-")  # children of tests share it
os.environ["GFFE_DEVICE_CACHE"] = _cache.name
_helpers = Path(__file__).parent / "helpers"
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (str(_helpers), os.environ.get("PYTHONPATH"))))


@functools.cache
def _usable():
    wanted = os.environ.get("GFFE_DEVICE")
    working = [info for info in list_devices() if info.works]
    chosen = select(working, wanted) if wanted else working
    return sorted(chosen, key=lambda info: info != best_of(chosen))  # the default first


def pytest_generate_tests(metafunc):
    if "device" in metafunc.fixturenames:
        infos = _usable()
        assert infos, "no usable OpenCL device: see `gffe devices`"
        names = [f"{info.platform.split()[0]}-{info.index}" for info in infos]
        metafunc.parametrize("device", infos, ids=names, indirect=True, scope="session")


# Folders of tests whose outcome depends on the device: `make test` runs the others on the default device alone.
_DEPENDS_ON_DEVICE = ("stages", "opencl", "selftest", "pipeline")

_default_model = network.default_model


@pytest.fixture(scope="session")
def default_model():
    """`inference.default_model` as users have it."""
    return _default_model


@pytest.fixture(scope="session", autouse=True)
def _no_weights():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(network, "default_model", lambda: None)
        yield


_opened = {}


@pytest.fixture(scope="session")
def device(request):
    """An open Device; tests that take it run once per usable device."""
    info = request.param
    if info.index not in _opened:
        _opened[info.index] = open_info(info)
    return _opened[info.index]


@pytest.fixture
def gffe(monkeypatch, capsys):
    """Runs `gffe ARGS…` in this process: (exit code, stdout, stderr)."""

    def call(*args):
        monkeypatch.setattr(sys, "argv", ["gffe", *map(str, args)])
        code = 0
        try:
            main()
        except SystemExit as stop:
            code = stop.code or 0
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call


def pytest_collection_modifyitems(items):
    for item in items:
        if "device" in getattr(item, "fixturenames", ()):
            item.add_marker("device")
            on_another = item.callspec.params["device"] != _usable()[0]
            if on_another and item.path.parent.name not in _DEPENDS_ON_DEVICE:
                item.add_marker("long")
    items.sort(key=lambda item: item.get_closest_marker("limits") is None)
