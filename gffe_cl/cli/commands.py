"""All commands, and a function that runs one."""

from __future__ import annotations

import math
import os
from functools import cache, partial
from typing import Annotated, Any

import typer

from gffe_cl.cli import captures, devices, measure, run, scenes, train, view  # noqa: F401 - registers the commands
from gffe_cl.cli.common import app, out, plain, warn_of_networks
from gffe_cl.engine.core.errors import REPOSITORY, GffeError
from gffe_cl.engine.core.public_names import __version__, removal
from gffe_cl.engine.core.validation import MOST_SEED, shown

__all__ = ["app", "invoke"]

app.registered_commands.sort(key=lambda one: one.name or getattr(one.callback, "__name__", ""))  # of `gffe --help`
RENAMED = {"--layers": "--background-levels"}  # older names of options, which are still taken
MEANT = {"doctor": "check SEQUENCE"}  # words that are no commands, and what is meant


def invoke(arguments: list[str]) -> int:
    """Run the command line. Returns the exit code. Raises usage errors, and any exception of the command."""
    if arguments[:1] and arguments[0] in MEANT:
        raise GffeError(f"{arguments[0]} is no command (expected `gffe {MEANT[arguments[0]]}`)")
    command = f"gffe {arguments[0]}" if arguments else "gffe"
    for name in (command, *(f"{command} {word.partition('=')[0]}" for word in arguments[1:])):
        if removed := removal(name):
            raise GffeError(removed)
    if "_GFFE_COMPLETE" in os.environ:  # the shell asks for completions
        _command().main(prog_name="gffe")
    try:
        words = (word.partition("=") for word in arguments)
        arguments = [RENAMED.get(name, name) + equals + value for name, equals, value in words]
        with _command().make_context("gffe", arguments) as context:
            context.command.invoke(context)
    except typer.Exit as stop:
        return stop.exit_code
    finally:
        warn_of_networks()
    return 0


@cache
def _command() -> Any:
    """Return the command line library's command, whose parameters take neither empty texts nor numbers that are not
    finite: an empty path would be the working folder."""
    group: Any = typer.main.get_command(app)
    for command in group.commands.values():
        for parameter in command.params:
            parameter.process_value = partial(_checked, parameter, parameter.process_value)
    return group


def _checked(parameter, convert, context, given: Any) -> Any:
    name = max(parameter.opts, key=len) if parameter.param_type_name == "option" else parameter.name.upper()
    if parameter.default != "" and "" in (given if isinstance(given, list | tuple) else [given]):
        raise GffeError(f"{name} is empty (expected a value)")
    value = convert(context, given)
    for number in value if isinstance(value, list | tuple) else [value]:
        if isinstance(number, float) and not math.isfinite(number):
            raise GffeError(f"{name} must be a finite number, got {number}")
        if isinstance(number, int) and abs(number) > MOST_SEED and name != "--seed":
            raise GffeError(f"{name} must be a whole number of at most {MOST_SEED}, got {shown(number)}")
    return value


def _print_version(wanted: bool) -> None:
    if wanted:
        from gffe_cl.engine.opencl.device import known_devices

        found = dict.fromkeys(f"{info.platform} ({info.driver})" for info in known_devices()[0] if info.works)
        out.print(" ".join(filter(None, (f"gffe-cl {__version__}", REPOSITORY))))
        out.print(plain(f"OpenCL: {', '.join(found) or 'nothing that works, see `gffe devices`'}"))
        raise typer.Exit()


@app.callback()
def _gffe(
    version: Annotated[
        bool,
        typer.Option(
            "--version", help="Print version and OpenCL runtimes, and exit.", is_eager=True, callback=_print_version
        ),
    ] = False,
) -> None:
    pass
