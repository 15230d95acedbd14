"""Errors and interrupts of commands, reported in one line."""

from __future__ import annotations

import os
import sys

from gffe_cl.cli.common import plain, say
from gffe_cl.cli.interrupts import INTERRUPTED, Interrupts
from gffe_cl.engine.core.errors import GffeError, shortened


def explain(error: BaseException, interrupts: Interrupts) -> int:
    """Print the user's message for `error`, and return the exit code. Unexpected exceptions are raised again."""
    if interrupts.received or isinstance(error, KeyboardInterrupt):
        kept = "; ".join(_notes(error))
        say(plain(shortened(f"interrupted: {kept}" if kept else "interrupted")))
        return INTERRUPTED
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
    elif isinstance(error, SystemExit):  # the console's, which has dropped its output then
        message = "system: Broken pipe"
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
