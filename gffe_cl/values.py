"""Numbers that come from outside: from files, scripts and the command line. One definition of each range."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np

from gffe_cl.errors import GffeError

EXPOSURES = (1e-6, 1e6)
MOST_SEED = 2**32 - 1
_LARGEST = 1e300
NUMBERS = (int, float, np.integer, np.floating)


def is_number(value: Any) -> bool:
    """Whether `value` is a finite number: no bool, no text, nothing over 1e300."""
    return isinstance(value, NUMBERS) and not isinstance(value, bool) and abs(value) < _LARGEST


def require_number(value: Any, what: str) -> float:
    """`value` as a float; GffeError, beginning with `what`, unless it is a finite number."""
    if is_number(value):
        return float(value)
    raise GffeError(f"{what} must be a finite number, got {shown(value)}")


def require_positive(value: Any, what: str) -> float:
    number = require_number(value, what)
    if number <= 0:
        raise GffeError(f"{what} must be greater than 0, got {number:g}")
    return number


def require_exposure(value: Any, what: str = "exposure") -> float:
    """The factor on linear colour before display as a float; GffeError unless it is a number from 1e-6 to 1e6.

    Beyond that everything is black or white, and what is measured on display values means nothing.
    """
    low, high = EXPOSURES
    if is_number(value) and low <= value <= high:
        return float(value)
    raise GffeError(f"{what} must be a finite number from {low:g} to {high:g}, got {shown(value)}")


def require_seed(value: Any, what: str = "seed") -> int:
    """The variation of something made by chance; GffeError unless it is a whole number from 0 to 2³² − 1."""
    if isinstance(value, int | np.integer) and not isinstance(value, bool) and 0 <= value <= MOST_SEED:
        return int(value)
    raise GffeError(f"{what} must be a whole number from 0 to {MOST_SEED}, got {shown(value)}")


def shown(value: Any) -> str:
    """`value` for a message: short, in JSON's words where it has some."""
    if value is None:
        return "nothing"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    try:
        text = json.dumps(value, default=repr)
    except ValueError:  # more digits than Python turns into text
        return "a number too large"
    return text if len(text) <= 60 else text[:59] + "…"
