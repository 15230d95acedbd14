"""Pacer of Python and of the exported C at once: every call goes to both, which must decide alike, bit for bit."""

import ctypes as ct
import math
import shutil
import subprocess
import tempfile
from functools import cache
from importlib.resources import files
from pathlib import Path

import pytest
from exported import STRICT, STRUCTURES, declare

import gffe_cl
from gffe_cl import GffeError


@cache
def library() -> ct.CDLL | None:
    """Return the compiled gffe_pacer.c; None where it cannot be compiled."""
    source = Path(str(files("gffe_cl.engine.export") / "c" / "gffe_pacer.c"))
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "pacer.so"
        command = ["cc", "-std=c99", *STRICT, "-fPIC", "-shared", "-ffp-contract=off", "-o", made, source, "-lm"]
        if not shutil.which("cc") or subprocess.run(command, capture_output=True, check=False).returncode:
            return None
        return declare(ct.CDLL(str(made)))


def _number(value) -> float:
    return float(value) if abs(value) < 1e308 else math.inf


class Pacer(gffe_cl.Pacer):
    """Pacer of both; of Python alone where C cannot be compiled."""

    def __init__(self, display_rate, most_alpha=2.0, fps=30.0, variable=False):
        self._c, rates = STRUCTURES["gffe_pacer"](), map(_number, (display_rate, most_alpha, fps))
        self._both(super().__init__, (display_rate, most_alpha, fps, variable), "start", *rates, variable)

    def rendered(self, time, reset=False):
        if reset in (0, 1) and not isinstance(reset, bool):
            return super().rendered(time, reset)  # C's flags are numbers
        return self._both(super().rendered, (time, reset), "rendered", _number(time), reset)

    def plan(self, now):
        found = STRUCTURES["gffe_paced"]()
        plan = self._both(super().plan, (now,), "plan", _number(now), ct.byref(found))
        if library():
            assert (found.refresh, found.time, found.alpha) == (plan.refresh, plan.time, plan.alpha)
            assert bool(found.held) == plan.held
        return plan

    def ready(self, now):
        return self._both(super().ready, (now,), "ready", _number(now))

    @property
    def statistics(self):
        told = super().statistics
        if library():
            found = library().gffe_pacer_statistics(ct.byref(self._c))
            for name, _ in STRUCTURES["gffe_pacing"]._fields_[:-1]:
                assert getattr(found, name) == getattr(told, name), name
            assert found.jitter == pytest.approx(told.jitter, rel=1e-6, abs=1e-9)
        return told

    def _both(self, call, arguments, name, *numbers):
        """Return what Python's `call` returns or raises; C's must take or refuse the same."""
        status = library() and getattr(library(), f"gffe_pacer_{name}")(ct.byref(self._c), *numbers)
        try:
            made = call(*arguments)
        except GffeError:
            assert status in (1, None)
            raise
        assert not status
        return made
