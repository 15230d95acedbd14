"""What the commands share: the application, its consoles, options and helpers."""

from __future__ import annotations

import json
import math
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from gffe_cl.errors import GffeError

app = typer.Typer(
    help="G-buffer free frame extrapolation: makes the frames after the ones your renderer has finished.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
)
out = Console(highlight=False, width=None if sys.stdout.isatty() else 120)
err = Console(stderr=True, highlight=False, soft_wrap=True)

DeviceOption = Annotated[
    str | None,
    typer.Option(
        "--device",
        help="Part of a device's or platform's name, its index (0:0), 'gpu' or 'cpu'; see `gffe devices`.",
    ),
]


def _json_path(path: Path | None) -> Path | None:
    """Checked before the work, not after it."""
    if path is not None and (path.is_dir() or not path.absolute().parent.is_dir()):
        raise GffeError(f"--json {path}: must be a file in a folder that exists")
    return path


JsonOption = Annotated[
    Path | None, typer.Option("--json", help="Also write the report to this file.", callback=_json_path)
]


WindowOption = Annotated[
    str, typer.Option("--window", help="Rendering window: adaptive, fixed:1.2 (times the display) or off.")
]


def parse_size(text: str) -> tuple[int, int]:
    """'1920x1080' → (1920, 1080)."""
    try:
        width, height = (int(part) for part in text.lower().replace("×", "x").split("x"))
    except ValueError:
        raise GffeError(f"size must look like 1920x1080, got '{text}'") from None
    if not (1 <= width <= 16384 and 1 <= height <= 16384):
        raise GffeError(f"size must be 1 to 16384 pixels each way, got '{text}'")
    return width, height


def parse_numbers(text: str, option: str) -> list[float]:
    """'0.25,0.5' → [0.25, 0.5]."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise GffeError(f"{option} must be numbers separated by commas, got '{text}'") from None


@contextmanager
def progress_bars():
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=err, disable=not err.is_terminal) as progress:
        yield progress


def steps(progress: Progress):
    """A function that opens a progress bar and returns its `advance`."""

    def step(text: str, total: int):
        task = progress.add_task(text, total=total)
        return lambda: progress.advance(task)

    return step


def write_json(path: Path | None, document: dict) -> None:
    if path is None:
        return
    try:
        path.write_text(json.dumps(_finite(document), indent=1, allow_nan=False) + "\n")
    except OSError as error:
        raise GffeError(f"{path}: cannot write: {error.strerror}") from None


def _finite(value):
    """`value` with null for numbers that JSON cannot hold."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def plain(text: str) -> str:
    from rich.markup import escape

    return escape(text)
