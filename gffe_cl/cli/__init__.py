"""The command line: `gffe`. Exit codes: 0 done, 1 findings, 2 could not, 130 interrupted."""

from __future__ import annotations

import sys
import warnings

from gffe_cl.cli.interrupts import INTERRUPTED, Interrupts


def main() -> None:
    """Entry point: structural faults become one line and exit code 2. The commands are imported when signals are
    taken care of."""
    if not sys.warnoptions:  # what libraries warn of, of damaged files above all, is no message of ours
        warnings.simplefilter("ignore")
    with Interrupts() as interrupts:
        from gffe_cl.cli.faults import explain

        try:
            from gffe_cl.cli.commands import invoke

            interrupts.begin()
            code = invoke(sys.argv[1:] or ["--help"])
            sys.stdout.flush()
        except BaseException as error:
            code = explain(error, interrupts)
    sys.exit(code)


__all__ = ["INTERRUPTED", "main"]
