"""Hostile values for every parameter of every command, for tests/cli/test_cli_hostile.py and docs/tools/fuzz.py."""

import functools
import random
import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path

import typer

from gffe_cl.cli.commands import app

SECONDS = 10  # that a command may take to refuse a value
CODES = (0, 1, 2)
EVERYWHERE = ("", "nan", "-1", "inf", "1e99", str(2**70), "x" * 5000, "{folder}", "{file}", "/dev/null")
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
LONG = ("selftest", "view")  # take minutes, or open a window, where a value is good: only values that no command takes


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


def cases():
    """Every command line: each parameter of each command with each value."""
    for name, parameter in parameters():
        for value in EVERYWHERE if name not in LONG else ("",):
            yield arguments(name, parameter, value)


def fault(words: list[str], places: dict[str, str], folder: Path) -> str:
    """Return the fault of `gffe WORDS` in a process of its own, in `folder`; "" if there is none."""
    given = [word.format(**places) if "{" in word else word for word in words]
    before = set(folder.iterdir())
    try:
        child = subprocess.run(
            [sys.executable, "-m", "gffe_cl", *given], capture_output=True, text=True, timeout=SECONDS, cwd=folder,
            stdin=subprocess.DEVNULL, errors="replace",
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return f"takes longer than {SECONDS} s"
    return wrong(child.returncode, child.stderr) or ", ".join(
        f"wrote {path}"
        for path in set(folder.iterdir()) - before
        if str(path) not in places.values() and not any(word.endswith(path.name) for word in given)
    )


def wrong(code: int, errors: str) -> str:
    """Return the fault of an exit code and a text on standard error."""
    if code not in CODES or "Traceback" in errors:
        return f"exit code {code}: {errors[-300:]}"
    told = [line for line in errors.splitlines() if line.startswith("error:")]
    if code == 2 and (len(told) != 1 or len(told[0]) > 1020):
        return f"not one line: {errors[:300]}"
    return ""


def run(seconds: float, seed: int, folder: Path) -> list[str]:
    """Run cases in an order by chance until the time is over, and return the faults. `folder` holds the files they
    need."""
    places = {name: str(folder / name) for name in ("sequence", "folder", "file", "out")}
    Path(places["folder"]).mkdir()
    Path(places["file"]).write_text("a file\n")
    render = ["render", "corridor", places["sequence"], "--size", "32x32", "--frames", "4", "--ground-truth"]
    subprocess.run([sys.executable, "-m", "gffe_cl", *render], check=True, capture_output=True)
    every, end, found, count = list(cases()), time.monotonic() + seconds, [], 0
    random.Random(seed).shuffle(every)
    for words in every:
        count += 1
        shutil.rmtree(places["out"], ignore_errors=True)
        if said := fault(words, places, folder):
            found.append(f"gffe {shlex.join(word[:60] for word in words)}: {said}")
            print(found[-1], flush=True)
        if time.monotonic() > end:
            break
    print(f"arguments: {count} of {len(every)} command lines, {len(found)} faults")
    return found
