"""All commands, and how one is called."""

from __future__ import annotations

from typing import Annotated

import typer

from gffe_cl import __version__
from gffe_cl.cli import (  # noqa: F401 - registers the commands, in the order of `gffe --help`
    checking,
    exporting,
    importing,
    making,
    measuring,
    recovering,
    tabulating,
    testing,
    timing,
    training,
    viewing,
)
from gffe_cl.cli.common import app, out, warn_of_networks
from gffe_cl.errors import REPOSITORY

__all__ = ["app", "invoke"]


def invoke(arguments: list[str]) -> int:
    """Do what the command line says; the exit code. Raises whatever the command raises, and usage errors."""
    try:
        with typer.main.get_command(app).make_context("gffe", arguments) as context:
            context.command.invoke(context)
    except typer.Exit as stop:
        return stop.exit_code
    finally:
        warn_of_networks()
    return 0


def _print_version(wanted: bool) -> None:
    if wanted:
        out.print(" ".join(filter(None, (f"gffe-cl {__version__}", REPOSITORY))))
        raise typer.Exit()


@app.callback()
def _gffe(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", is_eager=True, callback=_print_version)
    ] = False,
) -> None:
    pass
