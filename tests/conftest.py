"""Fixtures: every usable OpenCL device once (`GFFE_DEVICE` narrows the choice); the weights of the package are hidden,
so that nothing hangs on them but the tests of themselves (test_quality.py). What is known of devices is found out anew
by each run, and kept from the user's cache. Files of tests that take longest come first, so that processes end together
(`--no-loadscope-reorder`)."""

import functools
import os
import sys
import traceback
from pathlib import Path

import pytest

from gffe_cl.cli import main
from gffe_cl.engine.inference import network
from gffe_cl.engine.opencl.device import best_of, list_devices, open_info, select

_cache = Path(__file__).parents[1] / ".pytest_cache" / "devices"
if "PYTEST_XDIST_WORKER" not in os.environ:  # workers and children of tests share it
    for _known in _cache.glob("*.json"):
        _known.unlink(missing_ok=True)
    os.environ["GFFE_DEVICE_CACHE"] = str(_cache)
sys.path.append(str(Path(__file__).parents[1] / "docs/tools"))  # which are tested, too
_helpers = Path(__file__).parent / "helpers"
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (str(_helpers), os.environ.get("PYTHONPATH"))))


@functools.cache
def _usable():
    wanted = os.environ.get("GFFE_DEVICE")
    if wanted == "none":  # tests that need no device, with `-m "not device"`
        return []
    working = [info for info in list_devices() if info.works]
    chosen = select(working, wanted) if wanted else working
    return sorted(chosen, key=lambda info: info != best_of(chosen))  # the default first


def pytest_configure(config):
    if getattr(config.option, "numprocesses", None):
        _usable()  # so that workers find the same devices, in the same order


def pytest_generate_tests(metafunc):
    if "device" in metafunc.fixturenames:
        infos = _usable()
        assert infos or os.environ.get("GFFE_DEVICE") == "none", "no usable OpenCL device: see `gffe devices`"
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
        _opened[info.index] = open_info(info, profiling=True)
    return _opened[info.index]


@pytest.fixture
def gffe(monkeypatch, capsys):
    """Runs `gffe ARGS…` in this process: (exit code, stdout, stderr). Unless it is `checked`, `gffe run` goes without
    the doctor's look at the input, which takes most of the time of small sequences."""

    def call(*args, checked=False):
        with monkeypatch.context() as patch:
            patch.setattr(sys, "argv", ["gffe", *map(str, args)])
            if not checked:
                patch.setattr("gffe_cl.cli.run._check_quickly", lambda *_: (False, None))
            return run()

    def run():
        code = 0
        try:
            main()
        except SystemExit as stop:
            code = stop.code or 0
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call


# Files of tests that take longest, in order. The first builds the pipeline's programs, which takes PoCL two minutes:
# those that a second process begins with need none of them, so that nothing is built twice.
_LONGEST = (
    "test_recorded_bits",
    "test_compilers",
    "test_mistakes",
    "test_doctor",
    "test_oclgrind",
    "test_installed",
    "test_count_traffic",
    "test_scn",
    "test_viewer_gui",
    "test_viewer_sizes",
    "test_live_examples",
    "test_viewer_engine",
    "test_cli",
    "test_export",
    "test_export_example",
    "test_selftest",
    "test_background",
    "test_convolutions",
    "test_viewer_model",
    "test_order_of_groups",
    "test_bench",
    "test_hostile_content",
    "test_docs",
    "test_device",
    "test_viewer_cli",
    "test_scenes",
    "test_eval",
)


def pytest_collection_modifyitems(items):
    order = {f"{name}.py": number for number, name in enumerate(_LONGEST)}
    items.sort(key=lambda item: order.get(item.path.name, len(order)))
    for item in items:
        if "device" in getattr(item, "fixturenames", ()):
            item.add_marker("device")
            on_another = item.callspec.params["device"] not in _usable()[:1]
            if on_another and item.path.parent.name not in _DEPENDS_ON_DEVICE:
                item.add_marker("long")


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem):
    """Run a test that limits the size of files in a forked child: OpenCL runtimes in this process write files, too."""
    if pyfuncitem.get_closest_marker("limits") is None:
        return None
    child = os.fork()
    if child == 0:
        code = 1
        try:
            pyfuncitem.obj(**{name: pyfuncitem.funcargs[name] for name in pyfuncitem._fixtureinfo.argnames})
            code = 0
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stderr.flush()
            os._exit(code)
    assert os.waitpid(child, 0)[1] == 0, "failed in a child process: see its standard error"
    return True
