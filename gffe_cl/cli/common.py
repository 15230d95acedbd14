"""Shared parts of commands: the application and its consoles, parameters and options, progress, errors in one line."""

from __future__ import annotations

import inspect
import json
import math
import os
import sys
import time
import typing
from collections.abc import Callable
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from gffe_cl.cli.interrupts import INTERRUPTED, Interrupts
from gffe_cl.engine.core.errors import GffeError, printable, shortened
from gffe_cl.engine.core.files import require_output_file, require_readable, write_text
from gffe_cl.engine.core.public_names import __version__
from gffe_cl.engine.core.validation import is_number, require_choice
from gffe_cl.engine.options import OPTIONS, PRESETS, Option, Options

if TYPE_CHECKING:
    from gffe_cl.captures.sequence.encoding import Encoding

app = typer.Typer(
    help="G-buffer free frame extrapolation: makes the frames after the ones your renderer has finished.",
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
)
for _stream in (sys.stdout, sys.stderr):
    if _reconfigure := getattr(_stream, "reconfigure", None):
        _reconfigure(errors="backslashreplace")  # whatever the terminal cannot show
_AS_WRITTEN: dict[str, Any] = {"highlight": False, "emoji": False}  # a path may hold :x:
out = Console(**_AS_WRITTEN, width=None if sys.stdout.isatty() else 120)
err = Console(**_AS_WRITTEN, stderr=True, soft_wrap=True)

DeviceOption = Annotated[
    str | None,
    typer.Option(
        "--device",
        help="OpenCL device: part of its or its platform's name, its index (0:0), gpu or cpu; see `gffe devices`.",
    ),
]


_overwriting = False  # of this command


def _set_overwriting(wanted: bool) -> bool:
    global _overwriting
    _overwriting = wanted
    return wanted


OverwriteOption = Annotated[
    bool,
    typer.Option(
        "--overwrite",
        help="Earlier output: start anew, and replace files that other programs wrote.",
        callback=_set_overwriting,
        is_eager=True,  # output files are checked by it
    ),
]


def output_file(option: str, media: bool = False):
    """Return a callback for an option that names a file to write, a report or with `media` a picture or video: it is
    checked before the work, not after it."""
    return lambda path: None if path is None else require_output_file(path, option, _overwriting, media)


def input_file(option: str):
    """Return a callback for an option that names a file to read: it is checked before the work."""

    def checked(path: Path | None) -> Path | None:
        if path is not None:
            require_readable(path, f"{option} {path}")
        return path

    return checked


JsonOption = Annotated[
    Path | None,
    typer.Option(
        "--json",
        help="JSON file for the report, written in addition to the printed one.",
        callback=output_file("--json"),
    ),
]


NoCheckOption = Annotated[
    bool, typer.Option("--no-check", help="Quick check of the first frames: skip it; see `gffe check`.")
]
CompressionOption = Annotated[
    str,
    typer.Option(
        "--compression",
        help="Compression of new EXR files: none, rle, zips, zip, piz, htj2k256, or the lossy dwaa and dwab.",
    ),
]
EncodeOption = Annotated[
    str | None,
    typer.Option(
        "--encode",
        metavar="PART,…",
        help="Encoding of rendered frames: engine, game, or parts of these, such as half-uv, taa or hud"
        " (docs/formats.md#encodings).",
    ),
]
WindowOption = Annotated[
    str, typer.Option("--window", help="Rendering window: adaptive, fixed:1.2 (times the display size) or off.")
]


def parse_size(text: str) -> tuple[int, int]:
    """Return the size of a text: '1920x1080' → (1920, 1080)."""
    try:
        width, height = (int(part) for part in text.lower().replace("×", "x").split("x"))
    except ValueError:
        raise GffeError(f"size must look like 1920x1080, got '{text}'") from None
    if not (1 <= width <= 16384 and 1 <= height <= 16384):
        raise GffeError(f"size must be 1 to 16384 pixels each way, got '{text}'")
    return width, height


def parse_encoding(text: str | None) -> Encoding:
    """Return the encoding of --encode; the exact one if it is not given."""
    from gffe_cl.captures.sequence.encoding import EXACT, Encoding

    return EXACT if text is None else Encoding.parse(text)


def parse_numbers(text: str, option: str) -> list[float]:
    """Return the numbers of a text: '0.25,0.5' → [0.25, 0.5]."""
    with suppress(ValueError):
        numbers = [float(part) for part in text.split(",")]
        if all(map(is_number, numbers)):
            return numbers
    raise GffeError(f"{option} must be numbers separated by commas, got '{text}'")


@contextmanager
def progress_bars(shown: bool = True):
    """Show the progress of steps on standard error, if `shown`: bars on a terminal, lines elsewhere."""
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    columns = (*columns, TextColumn("left"), TimeRemainingColumn())
    how = {"redirect_stdout": sys.stdout.isatty(), "disable": not shown}  # printed results stay in their pipe or file
    bars = Progress(*columns, console=err, **how) if err.is_terminal or not shown else _Lines()
    with bars as progress:
        yield progress


class _Lines(Progress):
    """Progress for a standard error that is no terminal: one line for each finished step, and one every `_PERIOD`
    seconds during a long step, with an estimate. Commands shorter than `_SOON` seconds print none."""

    _SOON, _PERIOD = 3.0, 10.0

    def __init__(self):
        super().__init__(console=err, disable=True)
        self._started = self._told = time.monotonic()

    def advance(self, task_id, advance=1):
        super().advance(task_id, advance)
        self._tell(self._tasks[task_id])

    def update(self, task_id, **changes):
        super().update(task_id, **changes)
        self._tell(self._tasks[task_id])

    def _tell(self, task) -> None:
        now = time.monotonic()
        if not task.total or now - self._started < self._SOON:
            return
        if not task.finished and now - self._told < self._PERIOD:
            return
        self._told, remaining = now, task.time_remaining
        left = "" if task.finished or remaining is None else f", about {remaining:.0f} s left"
        say(plain(f"{task.description}: {task.completed:g} of {task.total:g}, {task.elapsed:.0f} s{left}"))


def steps(progress: Progress):
    """Return a function that opens a progress bar and returns its `advance`."""

    def step(text: str, total: int):
        task = progress.add_task(text, total=total)
        return lambda: progress.advance(task)

    return step


def write_json(path: Path | None, document: dict) -> None:
    if path is None:
        return
    try:
        marked = _finite({"generator": f"gffe-cl {__version__}", **document})
        write_text(path, json.dumps(marked, indent=1, allow_nan=False) + "\n")
    except OSError as error:
        raise GffeError(f"{path}: cannot write: {error.strerror or error}") from None


def _finite(value):
    """Return `value` with null for numbers that JSON cannot hold."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def counted(count: int, what: str) -> str:
    """Return a number of things: "1 frame", "2 frames"."""
    return f"{count} {what}" + ("" if count == 1 else "s")


def say(markup: str) -> None:
    """Print a line on standard error. If that fails (closed pipe, full disk), the command continues."""
    try:
        err.print(markup)
    except (OSError, SystemExit):  # rich ends the process where a pipe has no reader
        err.file = open(os.devnull, "w")  # noqa: SIM115


_warned: set[str] = set()


def warn(text: str) -> None:
    """Print a warning, each text once in a command."""
    if text not in _warned:
        _warned.add(text)
        say(f"[yellow]warning:[/] {plain(shortened(text))}")


def warn_of_networks() -> None:
    """Warn, at the end of any command, if the network did not run on the requested provider."""
    if inference := sys.modules.get("gffe_cl.engine.inference.network"):
        for remark in inference.take_remarks():
            warn(remark)
    _warned.clear()


def named(place: str | Path, message: str) -> str:
    """Return `message` with `place` at its beginning, for commands with several inputs."""
    place = printable(str(place))
    return message if message.startswith((f"{place}:", f"{place}{os.sep}")) else f"{place}: {message}"


def plain(text: object) -> str:
    """Return `text` for the consoles without effects: neither markup nor control characters of the terminal in it,
    perhaps in the name of a file, are interpreted."""
    return escape(printable(str(text)))


NOBODY_READS = 141  # exit code of a program that SIGPIPE ends
SCN = ("shading_correction", "focus_mask", "scn_model", "scn_provider")  # options of the commands that only measure


def takes_options(*names: str) -> Callable[[Callable], Callable]:
    """Return a decorator that gives a command the options `names` (all that have a flag if none are named) in place of
    its parameter `options`, an `Options`. A command with all that a preset sets has `--preset`, too."""

    def decorate(command: Callable) -> Callable:
        chosen = [OPTIONS[name] for name in names or OPTIONS if OPTIONS[name].flag]
        made = [parameter for option in chosen for parameter in _parameters(option)]
        if {name for preset in PRESETS.values() for name in preset.values} <= {option.name for option in chosen}:
            made.insert(0, _PRESET)

        def value(context: typer.Context, **values: Any) -> Options:
            preset = values.pop(_PRESET.name, _PRESET.default)
            require_choice(preset, PRESETS, "--preset")
            sources = {name: context.get_parameter_source(name) for name in values}
            said = {name for name, source in sources.items() if source is not None and source.name != "DEFAULT"}
            return _options(chosen, values, said, PRESETS[preset].values)

        return _with_parameters(command, "options", [*made, _CONTEXT], value)

    return decorate


def takes_scheduler(command: Callable) -> Callable:
    """Give a command `--scheduler` and the files of TLS in place of its parameter `cluster`, a context: of the
    `Cluster` of that scheduler, of which a line on its work is printed at the end, or of None."""
    made = [_parameter(name, kind, None, flag, text) for name, kind, flag, text in _CLUSTER]
    return _with_parameters(command, "cluster", made, lambda scheduler, **tls: _cluster_at(scheduler, [*tls.values()]))


def _with_parameters(
    command: Callable, name: str, made: list[inspect.Parameter], value: Callable[..., Any]
) -> Callable:
    """Return a command with the parameters `made` in place of its parameter `name`, which becomes their `value`."""
    resolved = typing.get_type_hints(command, localns={"Options": Options}, include_extras=True)
    own = [p for p in inspect.signature(command).parameters.values() if p.name != name]
    own = [p.replace(annotation=resolved[p.name], kind=inspect.Parameter.KEYWORD_ONLY) for p in own]

    def changed(**given: Any) -> Any:
        taken = {p.name: given.pop(p.name) for p in made}
        return command(**given, **{name: value(**taken)})

    changed.__signature__ = inspect.Signature([*own, *made])
    changed.__annotations__ = {p.name: p.annotation for p in (*own, *made)}
    changed.__name__, changed.__doc__ = command.__name__, command.__doc__
    return changed


@contextmanager
def _cluster_at(scheduler: str | None, tls: list[Path | None]):
    if any(tls) and (scheduler is None or None in tls):
        raise GffeError("--tls-ca-file, --tls-cert and --tls-key: expected all three, and --scheduler")
    if scheduler is None:
        yield None
        return
    from gffe_cl.lab.cluster import Cluster

    with Cluster(scheduler, tuple(filter(None, tls))) as cluster:
        yield cluster
        out.print(cluster.summary())


_CLUSTER = (
    (
        "scheduler",
        str | None,
        "--scheduler",
        "Dask scheduler whose workers compute: address, file, or local:N.",
    ),
    ("tls_ca_file", Path | None, "--tls-ca-file", "Certificate of the authority of the cluster's TLS."),
    ("tls_cert", Path | None, "--tls-cert", "Certificate of this client for the cluster's TLS."),
    ("tls_key", Path | None, "--tls-key", "Key of the certificate of --tls-cert."),
)


def _parameters(option: Option) -> list[inspect.Parameter]:
    """Return the parameters for typer: one, and a second for the short way to switch a module off."""
    assert option.flag is not None  # of the options that have one
    made = [_parameter(option.name, *_kind(option), option.flag, _help(option))]
    if option.off_flag:
        made.append(
            _parameter(
                f"no_{option.name}",
                bool,
                False,
                option.off_flag,
                f"Switch off {option.label}: the same as {option.flag} {option.off}.",
            )
        )
    return made


def _kind(option: Option) -> tuple[Any, Any]:
    """Return type and default of the command line's parameter."""
    if option.spelled:
        return str, "on" if option.default else "off"
    if option.kind is bool:
        return (bool | None, None) if option.automatic else (bool, False)
    if option.kind is str:
        return (str | None, None) if option.automatic else (str, option.default)
    if option.automatic:
        return str, option.automatic
    return option.kind, option.default


def _help(option: Option) -> str:
    if option.kind is bool and option.default is True and not option.spelled:
        return f"Switch off {option.label}: {option.sentence.partition('; off: ')[2]}"
    values = ""
    if option.spelled:
        values = "on or off"
    elif option.choices:
        values = ", ".join(option.choices)
    elif option.kind in (int, float) and not option.automatic:
        values = option.expected.partition(", ")[2]
    default = ""
    if option.kind in (bool, str) and option.automatic:
        default = f" [dim](default: {option.automatic.removeprefix('auto: ')})[/]"
    return f"{option.sentence.removesuffix('.')}{f' ({values})' if values else ''}{default}."


def _parameter(name: str, kind: Any, default: Any, flag: str, text: str) -> inspect.Parameter:
    annotation = Annotated[kind, typer.Option(flag, help=text)]
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


_CONTEXT = inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)
_PRESET = _parameter(
    "preset",
    str,
    "balanced",
    "--preset",
    f"Preset of all options that are not given: {', '.join(PRESETS)}; balanced are the defaults.",
)


def _options(chosen: list[Option], values: dict[str, Any], said: set[str], preset: dict[str, Any]) -> Options:
    """Return the options from the `values` of parameters, of which those `said` stand on the command line, and those of
    a preset where nothing is said."""
    made: dict[str, Any] = {}
    for option in chosen:
        if option.name in preset and not {option.name, f"no_{option.name}"} & said:
            made[option.name] = preset[option.name]
            continue
        value = values[option.name]
        if values.get(f"no_{option.name}"):
            value = option.off
        elif option.spelled:
            value = {"on": True, "off": False}.get(value, value)
        elif option.kind is bool and option.default is True:
            value = not value
        elif option.kind in (int, float) and isinstance(value, str):
            value = None if value == option.automatic else _number(option, value)
        try:
            made[option.name] = option.checked(value)
        except GffeError:
            raise GffeError(f"{option.flag} must be {option.expected}, got '{value}'") from None
    if made.get("shading_correction") is False:
        for name, meant in (
            ("scn_model", made.get("scn_model") is not None),
            ("focus_mask", made.get("focus_mask") is False),
        ):
            if meant:
                raise GffeError(f"--no-scn and {OPTIONS[name].flag} exclude each other")
    return Options(**made)


def _number(option: Option, text: str) -> float | int:
    try:
        return option.kind(text)
    except ValueError:
        raise GffeError(f"{option.flag} must be {option.expected}, got '{text}'") from None


def explain(error: BaseException, interrupts: Interrupts) -> int:
    """Print the user's message for `error`, and return the exit code. Unexpected exceptions are raised again."""
    if interrupts.received or isinstance(error, KeyboardInterrupt):
        interrupts.told = True
        kept = "; ".join(_notes(error))
        say(plain(shortened(f"interrupted: {kept}" if kept else "interrupted")))
        return INTERRUPTED
    if isinstance(error, SystemExit) and not error.code:  # completion is installed, or printed
        return 0
    if isinstance(error, BrokenPipeError | SystemExit):  # rich ends the process where a pipe has no reader
        _drop_unwritable_output()
        return NOBODY_READS
    if isinstance(error, GffeError):
        message = str(error)
    elif isinstance(error, ModuleNotFoundError) and not str(error.name).startswith("gffe_cl"):
        message = f"{error.name} is not installed (expected: all packages that `pip install .` brings)"
    elif isinstance(error, MemoryError):
        message = "not enough memory (expected smaller images)"
    elif isinstance(error, OSError | UnicodeError):
        message = f"{getattr(error, 'filename', None) or 'system'}: {getattr(error, 'strerror', None) or error}"
        if isinstance(error, OSError):
            _drop_unwritable_output()
    elif format_message := getattr(error, "format_message", None):  # usage errors of the command line library
        message = f"{format_message()} (see `gffe --help`)"
    else:
        raise error
    say(f"[bold red]error:[/] {plain(shortened(message))}")
    return 2


def _notes(error: BaseException) -> list[str]:
    """Return the notes that the handlers of an interrupt added about saved results."""
    seen, notes = set(), []
    link: BaseException | None = error
    while link is not None and id(link) not in seen:
        seen.add(id(link))
        if isinstance(link, KeyboardInterrupt):
            notes += [*map(str, link.args), *getattr(link, "__notes__", ())]
        link = link.__cause__ or link.__context__
    return list(dict.fromkeys(notes))


def _drop_unwritable_output() -> None:
    """Discard the remaining output if the reader is gone or the disk full: Python would try again at its
    end, and complain."""
    try:
        sys.stdout.flush()
    except (OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
