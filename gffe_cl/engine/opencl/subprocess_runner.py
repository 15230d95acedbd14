"""Child processes for modules in which a driver may crash or hang."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

HANGS = "driver hangs"  # how a failure begins where time was up
_MOST_SLOWDOWN = 10.0
_NICENESS = 1.25  # less processor time per step of niceness, of Linux's scheduler


def run_child(
    module: str, arguments: list[str], seconds: float, variables: dict[str, str] | None = None
) -> tuple[str, str]:
    """Run a module as a program, for at most `seconds` of an idle machine, with these additional environment variables.
    Returns its output and its failure ("" if none)."""
    # Without the working folder on the path, where a file may have the name of a module of Python's.
    run = f"runpy.run_module({module!r}, None, '__main__', True)"
    start = f"import runpy, sys; sys.path.append({str(Path(__file__).parents[2])!r}); {run}"
    command = [sys.executable, "-P", "-c", start, *arguments]
    environment = os.environ | (variables or {})
    try:
        child = subprocess.run(
            command,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=seconds * slowdown(),
            env=environment,
        )
    except subprocess.TimeoutExpired as error:
        output = error.stdout.decode(errors="replace") if isinstance(error.stdout, bytes) else (error.stdout or "")
        return output, f"{HANGS} ({seconds:g} s)"
    return child.stdout, f"driver crashed (exit code {child.returncode})" if child.returncode else ""


def slowdown() -> float:
    """Return how many times longer work takes because of other processes, estimated from the load average."""
    try:
        load = os.getloadavg()[0] / (os.cpu_count() or 1)
    except (AttributeError, OSError):  # the system does not have it
        return 1.0
    return 1.0 if load <= 1 else min(load * _NICENESS ** max(os.nice(0), 0), _MOST_SLOWDOWN)
