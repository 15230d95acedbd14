"""The command line: `gffe`. Exit codes: 0 done, 1 findings, 2 could not, 130 interrupted."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from gffe_cl import __version__
from gffe_cl.cli import making, measuring, training, viewing  # noqa: F401 - registers the commands, in the order of `gffe --help`
from gffe_cl.cli.common import app, err, out, plain
from gffe_cl.errors import GffeError

_INTERRUPTED = 130


def main() -> None:
    """Entry point: structural faults become one line and exit code 2."""
    try:
        code = app(args=sys.argv[1:] or ["--help"], standalone_mode=False)
    except GffeError as error:
        fail(str(error))
    except MemoryError:
        fail("not enough memory (expected smaller images)")
    except (OSError, UnicodeError) as error:
        fail(f"{getattr(error, 'filename', None) or 'system'}: {getattr(error, 'strerror', None) or error}")
    except (KeyboardInterrupt, typer.Abort):
        code = _INTERRUPTED
    except Exception as error:
        if hasattr(error, "format_message"):  # usage errors of the command line library
            fail(f"{error.format_message()} (see `gffe --help`)")
        raise
    if code == _INTERRUPTED:
        err.print("interrupted: what was finished is kept")
    sys.exit(code or 0)


def fail(message: str) -> None:
    err.print(f"[bold red]error:[/] {plain(message)}")
    sys.exit(2)


def _print_version(wanted: bool) -> None:
    if wanted:
        out.print(f"gffe-cl {__version__}")
        raise typer.Exit()


@app.callback()
def _gffe(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", is_eager=True, callback=_print_version)
    ] = False,
) -> None:
    pass
