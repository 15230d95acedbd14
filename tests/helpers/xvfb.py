"""A screen for windows: Xvfb, where CI must have it and others may."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SCREEN = ("xvfb-run", "-a", "-s", "-noreset -screen 0 1920x1200x24")


def require_screen():
    """Skip the test where there is no screen to be had."""
    if shutil.which("xvfb-run") is None:
        assert not os.environ.get("CI"), "CI must have xvfb-run"
        pytest.skip("xvfb-run is not installed")


def run_window(script: Path, *arguments, folder: Path, timeout=300, **environment):
    """Run a script of Python that opens a window, in `folder`, until it ends well."""
    require_screen()
    given = {"LIBGL_ALWAYS_SOFTWARE": "1", "XDG_CONFIG_HOME": str(folder)} | environment
    command = [*SCREEN, sys.executable, script, *arguments]
    child = subprocess.run(
        [*map(str, command)], env=os.environ | given, cwd=folder, capture_output=True, text=True, timeout=timeout
    )
    assert child.returncode == 0, f"{child.stdout[-3000:]}\n{child.stderr[-3000:]}"
