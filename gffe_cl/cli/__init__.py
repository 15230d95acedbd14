"""The command line: `gffe`. Exit codes: 0 done, 1 findings, 2 failed, 130 interrupted."""

from __future__ import annotations

import os
import sys
import warnings

from gffe_cl.cli.interrupts import INTERRUPTED, Interrupts


def main() -> None:
    """Run the command line: structural faults become one line and exit code 2. Signal handlers are installed before the
    commands are imported."""
    _open_missing_streams()
    if not sys.warnoptions:  # warnings of libraries, mostly about damaged files, are not the program's messages
        warnings.simplefilter("ignore")
    with Interrupts() as interrupts:
        try:
            from gffe_cl.cli.common import explain
        except ModuleNotFoundError as error:  # where the engine alone is installed
            print(f"error: the command line needs {error.name}: pip install {error.name}", file=sys.stderr)
            sys.exit(2)
        try:
            from gffe_cl.cli.commands import invoke

            interrupts.begin()
            code = invoke(sys.argv[1:] or ["--help"])
            sys.stdout.flush()
        except BaseException as error:
            code = explain(error, interrupts)
    sys.exit(code)


def _open_missing_streams() -> None:
    """Give standard streams that the caller closed to the null device. Their descriptors are the lowest free ones:
    files that are opened later would take them, and every print would write into them."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            stream = open(os.devnull, mode)  # noqa: SIM115 - stays open
            os.set_inheritable(stream.fileno(), True)
            setattr(sys, name, stream)


__all__ = ["INTERRUPTED", "main"]
