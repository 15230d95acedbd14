"""A screen for windows: Xvfb, where CI must have it and others may."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SIZE = "1920x1200"
SCREEN = ("xvfb-run", "-a", "-s", f"-noreset -screen 0 {SIZE}x24")


def require_screen():
    """Skip the test where there is no screen to be had."""
    if shutil.which("xvfb-run") is None:
        assert not os.environ.get("CI"), "CI must have xvfb-run"
        pytest.skip("xvfb-run is not installed")


def run_window(script: Path, *arguments, folder: Path, timeout=300, size=SIZE, **environment):
    """Run a script of Python that opens a window, in `folder` on a screen of `size`, until it ends well."""
    require_screen()
    given = {"LIBGL_ALWAYS_SOFTWARE": "1", "XDG_CONFIG_HOME": str(folder)} | environment
    command = [*(word.replace(SIZE, size) for word in SCREEN), sys.executable, script, *arguments]
    child = subprocess.run(
        [*map(str, command)], env=os.environ | given, cwd=folder, capture_output=True, text=True, timeout=timeout
    )
    assert child.returncode == 0, f"{child.stdout[-3000:]}\n{child.stderr[-3000:]}"
