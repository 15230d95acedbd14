"""Child processes for modules in which a driver may crash or hang."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

HANGS = "driver hangs"  # how a failure begins where time was up


def run_child(
    module: str, arguments: list[str], seconds: float, variables: dict[str, str] | None = None
) -> tuple[str, str]:
    """Run a module as a program, for at most `seconds`, with these additional environment variables. Returns its
    output and its failure ("" if none)."""
    # Without the working folder on the path, where a file may have the name of a module of Python's.
    run = f"runpy.run_module({module!r}, None, '__main__', True)"
    start = f"import runpy, sys; sys.path.append({str(Path(__file__).parents[2])!r}); {run}"
    command = [sys.executable, "-P", "-c", start, *arguments]
    environment = os.environ | (variables or {})
    try:
        child = subprocess.run(
            command, capture_output=True, text=True, errors="replace", timeout=seconds, env=environment
        )
    except subprocess.TimeoutExpired as error:
        output = error.stdout.decode(errors="replace") if isinstance(error.stdout, bytes) else (error.stdout or "")
        return output, f"{HANGS} ({seconds:g} s)"
    return child.stdout, f"driver crashed (exit code {child.returncode})" if child.returncode else ""
