"""Command lines with a value for each parameter of each command, for tests/cli/test_cli_hostile.py."""

import functools

import typer

from gffe_cl.cli.commands import app

CODES = (0, 1, 2)
# Arguments with which a command is quick where the value is good, or cannot work at all where it is slow.
QUICK = {
    "render": ("corridor", "{out}", "--size", "32x32", "--frames", "2"),
    "run": ("{sequence}", "{out}"),
    "compare": ("{sequence}", "{sequence}"),
    "check": ("{sequence}",),
    "import": ("{sequence}", "{out}"),
    "export": ("{out}",),
    "eval": ("{folder}", "--out", "{out}", "--methods", "repeat"),
    "bench": ("{folder}", "--sizes", "32x32"),
    "train": ("{file}", "--clips", "1"),
    "demo": ("--output", "{file}", "--size", "32x32"),
}


@functools.cache
def commands():
    return typer.main.get_command(app).commands


def parameters():
    """Yield (command, parameter) of all that take a value."""
    for name, command in commands().items():
        for parameter in command.params:
            if not getattr(parameter, "is_flag", False):
                yield name, parameter


def kind(parameter) -> str:
    """Return the type of a parameter's values, in words: "int", "float | None", "pathlib.Path"."""
    return str(getattr(getattr(parameter, "type_descriptor", None), "annotation", getattr(parameter, "type", "")))


def arguments(name: str, parameter, value: str) -> list[str]:
    """Return the command line in which `parameter` has this `value`, with {placeholders}."""
    base = list(QUICK.get(name, ()))
    if parameter.param_type_name == "option":
        option = max(parameter.opts, key=len)
        return [name, *base, *([f"{option}={value}"] if option.startswith("--") else [option, value])]
    positions = [p for p in commands()[name].params if p.param_type_name == "argument"]
    index = positions.index(parameter)
    base = [*base, *["{out}"] * (index + 1 - len(base))]
    base[index] = value
    return [name, *base[:index], *base[index + 1 :], "--", value] if index + 1 == len(positions) else [name, *base]


def wrong(code: int, errors: str) -> str:
    """Return the fault of an exit code and a text on standard error."""
    if code not in CODES or "Traceback" in errors:
        return f"exit code {code}: {errors[-300:]}"
    told = [line for line in errors.splitlines() if line.startswith("error:")]
    if code == 2 and (len(told) != 1 or len(told[0]) > 1020):
        return f"not one line: {errors[:300]}"
    return ""
