"""The one exception that users meet, the form of the user's values in messages, and the text on missing extras."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any

# The address of the repository, for users; empty until it is known, then lines that would name it are left out.
REPOSITORY = ""
_LONG_NUMBER = re.compile(r"(\d{12})\d{48,}")


class GffeError(Exception):
    """Error for a structural fault in the caller's input: bad file, size, camera, device, option.

    The message is one line of at most `MOST` characters with the fault, its place, and the expected input; control
    characters in it, for example from file names, are escaped, and numbers of 60 digits and more are cut. The command
    line prints it and exits with code 2. Bad *pixels* never raise it, except in strict mode.
    """

    def __init__(self, message: str):
        super().__init__(shortened(printable(_LONG_NUMBER.sub(r"\1…", message))))


class Unique:
    """Base of objects with native memory: a copy of one would release what the original uses."""

    def __reduce_ex__(self, protocol: Any) -> Any:
        raise GffeError(f"{type(self).__name__}: it cannot be copied or stored (expected another one to be made)")


@contextmanager
def within(place: str) -> Iterator[None]:
    """Raise a GffeError of the block again, with the `place` of the fault before its message."""
    try:
        yield
    except GffeError as error:
        raise GffeError(f"{place}: {error}") from None


MOST = 1000  # characters of a message
_MOST_WORD = 200


def shortened(text: str) -> str:
    """Return `text` in at most `MOST` characters. First, long words (paths, values) lose their middle, then the whole
    text does, so that the problem and the expected values stay readable."""
    if len(text) <= MOST:
        return text
    text = " ".join(_without_middle(word, _MOST_WORD) for word in text.split(" "))
    return _without_middle(text, MOST)


def _without_middle(text: str, most: int) -> str:
    end = (most - 1) // 2
    return text if len(text) <= most else f"{text[: most - 1 - end]}…{text[-end:]}"


def printable(text: str) -> str:
    """Return `text`, with everything that is no visible character (line breaks, terminal controls, halves of surrogate
    pairs) as an escape: `\\n`, `\\x1b`."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def how_to_install(extra: str) -> str:
    """Return the text that explains how to install an extra of this package, which is on no package index."""
    return f"pip install '.[{extra}]' in a checkout of gffe-cl, or 'THE-WHEEL.whl[{extra}]'"


def require_packages(what: str, extra: str, *modules: str) -> None:
    """Raise GffeError, with the extra to install, unless all `modules` that `what` needs are installed."""
    for module in modules:
        if find_spec(module) is None:
            raise GffeError(f"{what} needs {module}: {how_to_install(extra)}")
