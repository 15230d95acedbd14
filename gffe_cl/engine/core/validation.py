"""Checks of input values: from files, scripts, the command line and Python callers. Each range is defined once. All
messages have one form: the name, the expected value, and the actual one."""

from __future__ import annotations

import errno
import json
import math
import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal, overload

import numpy as np

from gffe_cl.engine.core.errors import GffeError

EXPOSURES = (1e-6, 1e6)
FRAME_RATES = (1e-6, 1e6)
MOST_SEED = 2**32 - 1
MOST_SIDE = 1 << 15  # pixels: kernels multiply two sides ...
MOST_PIXELS = 1 << 28  # ... and count the channels of an image in 31 bits
SIDES = (1e-9, 1e9)  # where they need not be whole
LARGEST = 1e300
QUIETLY = np.errstate(all="ignore")  # for functions whose results say where arithmetic failed: NumPy warns nobody
NUMBERS = (int, float, np.integer, np.floating)
TIMES = (np.timedelta64, np.datetime64)  # NumPy's timedelta64 is one of its integers


def scalar(value: Any) -> Any:
    """Return `value`. NumPy scalars and arrays without dimensions become Python numbers, but for times, which are none:
    depending on their unit they would become one."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    return value.item() if isinstance(value, np.generic) and not isinstance(value, TIMES) else value


def is_number(value: Any) -> bool:
    """Return whether `value` is a finite number: no bool, no text, nothing over 1e300."""
    if type(value) is float:  # mostly
        return -LARGEST < value < LARGEST
    value = scalar(value)
    return isinstance(value, NUMBERS) and not isinstance(value, (bool, *TIMES)) and bool(-LARGEST < value < LARGEST)


def require_number(value: Any, what: str, *, infinite: bool = False) -> float:
    """Return `value` as a float. Raises a GffeError that begins with `what` unless it is a finite number, or
    `infinite` and +inf."""
    if is_number(value) or (infinite and isinstance(scalar(value), float | np.floating) and scalar(value) == math.inf):
        return float(value)
    bounds = f" from {-LARGEST:g} to {LARGEST:g}" if _is_finite(value) else ""
    raise GffeError(f"{what} must be a {'' if infinite else 'finite '}number{bounds}, got {_shown_number(value)}")


def require_positive(value: Any, what: str, *, infinite: bool = False) -> float:
    number = require_number(value, what, infinite=infinite)
    if number <= 0:
        raise GffeError(f"{what} must be greater than 0, got {number:g}")
    return number


def require_exposure(value: Any, what: str = "exposure") -> float:
    """Return the exposure, the factor on linear color before display, as a float. Raises GffeError unless it is a
    number from 1e-6 to 1e6.

    Beyond that everything is black or white, and measurements of display values mean nothing.
    """
    return require_within(value, what, *EXPOSURES)


def require_frame_rate(value: Any, what: str = "fps") -> float:
    """Return a rate in frames per second as a float. Raises GffeError unless it is a number from 1e-6 to 1e6."""
    return require_within(value, what, *FRAME_RATES)


def require_within(value: Any, what: str, low: float, high: float) -> float:
    """Return `value` as a float. Raises GffeError unless it is a number from `low` to `high`."""
    if is_number(value) and low <= float(value) <= high:
        return float(value)
    raise GffeError(f"{what} must be a finite number from {low:g} to {high:g}, got {_shown_number(value)}")


def require_whole(value: Any, what: str, low: float = -math.inf, high: float = math.inf) -> int:
    """Return `value` as an int. Raises GffeError unless it is an integer, of Python or NumPy, from `low` to `high`."""
    number = scalar(value)
    if isinstance(number, int) and not isinstance(number, bool) and low <= number <= high:
        return number
    upto = f" to {high}" if high < math.inf else " on"
    bounds = f" from {low}{upto}" if low > -math.inf else ""
    raise GffeError(f"{what} must be a whole number{bounds}, got {shown(value)}")


@overload
def require_size(value: Any, what: str = "size", *, whole: Literal[True]) -> tuple[int, int]: ...
@overload
def require_size(value: Any, what: str = "size", *, whole: Literal[False] = False) -> tuple[float, float]: ...
def require_size(value: Any, what: str = "size", *, whole: bool = False) -> tuple[float, float]:
    """Return width and height of an image in pixels. Raises GffeError unless they are two positive numbers, or `whole`
    ones up to MOST_SIDE, whose product is MOST_PIXELS at most."""
    try:
        width, height = value
        if not whole:
            return require_within(width, what, *SIDES), require_within(height, what, *SIDES)
        width, height = (require_whole(side, what, 1, MOST_SIDE) for side in (width, height))
    except (GffeError, TypeError, ValueError):
        kind = f"whole pixels from 1 to {MOST_SIDE}" if whole else "pixels"
        raise GffeError(f"{what} must be (width, height) in {kind}, got {shown(value)}") from None
    if width * height > MOST_PIXELS:
        most = f"{what} must have at most {MOST_PIXELS} pixels, whose channels kernels count in 31 bits"
        raise GffeError(f"{most}, got {width}×{height}")
    return width, height


def environment_number(name: str, choices: tuple[int, ...]) -> int | None:
    """Return the environment variable `name`, None if it is not set or empty. Raises GffeError unless it is one of the
    numbers `choices`."""
    value = os.environ.get(name)
    if not value:
        return None
    if value in map(str, choices):
        return int(value)
    raise GffeError(f"{name} must be {' or '.join(map(str, choices))}, got {shown(value)}")


def require_seed(value: Any, what: str = "seed") -> int:
    """Return the seed of a random variation. Raises GffeError unless it is a whole number from 0 to 2³² − 1."""
    return require_whole(value, what, 0, MOST_SEED)


def require_bool(value: Any, what: str) -> bool:
    """Return `value` as a bool. Raises GffeError for everything but the truth values of Python and NumPy."""
    given = scalar(value)
    if isinstance(given, bool):
        return given
    raise GffeError(f"{what} must be True or False, got {shown(value)}")


def require_choice(value: Any, choices: Iterable[str], what: str) -> str:
    """Return `value`. Raises GffeError unless it is one of the texts `choices`."""
    choices = tuple(choices)
    if isinstance(value, str) and value in choices:
        return value
    raise GffeError(f"{what} must be one of {', '.join(choices)}, got {shown(value)}")


def require_kind(value: Any, kind: Any, what: str, expected: str = "") -> Any:
    """Return `value`. Raises GffeError unless it is a `kind`; the message calls that `expected`."""
    if isinstance(value, kind):
        return value
    raise GffeError(f"{what} must be {expected or f'a {kind.__name__}'}, got {shown(value)}")


def require_path(value: Any, what: str) -> Path:
    """Return `value` as a path. Raises GffeError unless it is a text or path-like, and one that a file can have."""
    reason = ""
    if isinstance(value, str | os.PathLike) and isinstance(os.fspath(value), str):
        try:
            os.lstat(value)
        except OSError as error:
            reason = f" ({error.strerror})" if error.errno == errno.ENAMETOOLONG else ""
        except ValueError as error:  # a null character, or half of a surrogate pair
            reason = f" ({error})"
        if not reason:
            return Path(value)
    raise GffeError(f"{what} must be a path, got {shown(value)}{reason}")


def require_list(value: Any, kind: type, what: str, expected: str) -> list:
    """Return `value` as a list. Raises GffeError unless all items are of the type `kind`. A text is no list."""
    try:
        found = [None] if isinstance(value, str | bytes) else list(value)
    except TypeError:
        found = [None]
    if all(isinstance(one, kind) for one in found):
        return found
    raise GffeError(f"{what} must be {expected}, got {shown(value)}")


def require_array(value: Any, what: str, *shape: Any, kinds: str = "iuf") -> np.ndarray:
    """Return `value` as an array of real numbers (of the `kinds` of NumPy's types). Raises GffeError unless it has the
    `shape`: for each axis its length, several lengths, or None for any. With an ellipsis in front, only the last axes
    are checked."""
    array, reason = _as_array(value)
    if array is None or array.dtype.kind not in "biufc":
        raise GffeError(f"{what} must be an array of numbers, got {shown(value)}{reason}")
    lengths = shape[1:] if shape[:1] == (...,) else shape
    last = array.shape[array.ndim - len(lengths) :] if len(lengths) < len(shape) else array.shape
    fits = len(last) == len(lengths) and all(
        want is None or (n in want if isinstance(want, tuple) else n == want)
        for n, want in zip(last, lengths, strict=True)
    )
    if not fits:
        raise GffeError(f"{what} must have shape {_shape_words(shape)}, got {array.shape}")
    if array.dtype.kind not in kinds:
        expected = {"f": "floating point", "iuf": "real numbers"}.get(kinds, "numbers or truth values")
        raise GffeError(f"{what} must be {expected}, got {array.dtype}")
    return array


def _as_array(value: Any) -> tuple[np.ndarray | None, str]:
    """Return `value` as an array, None if it is not one; and why a tensor is none, for a message. Tensors that only
    DLPack hands over, as those in a GPU's memory, are copied into host memory once."""
    with suppress(ValueError, TypeError, RuntimeError):  # rows of several lengths, or no array at all
        array = np.asarray(value)
        if array.dtype != object:
            return array, ""
    if not hasattr(value, "__dlpack__"):
        return None, ""
    if np.lib.NumpyVersion(np.__version__) < "2.1.0":
        return None, f" (tensors of a GPU need NumPy 2.1 or newer, this is {np.__version__})"
    try:
        return np.from_dlpack(value, device="cpu"), ""
    except (AttributeError, BufferError, MemoryError, RuntimeError, TypeError, ValueError) as error:
        return None, f" ({type(error).__name__}: {error})"


def require_vector(value: Any, what: str, count: int = 3) -> np.ndarray:
    """Return `value` as an array (count,) float64. Raises GffeError unless it holds so many finite numbers."""
    array = as_float64(require_array(value, what, count))
    if not (np.abs(array) < LARGEST).all():
        bounds = f" from {-LARGEST:g} to {LARGEST:g}" if np.isfinite(array).all() else ""
        raise GffeError(f"{what} must be {count} finite numbers{bounds}, got {shown(array.tolist())}")
    return array


def as_float32(array: np.ndarray) -> np.ndarray:
    """Return `array` as C-contiguous float32, without a copy if it is that already. Values that are too large become
    infinite. Raises GffeError without memory for it."""
    try:
        with np.errstate(over="ignore"):
            return np.asarray(array, np.float32, order="C")
    except MemoryError:
        raise GffeError(f"no memory for an array of shape {array.shape} (expected a smaller one)") from None


def as_float64(array: np.ndarray) -> np.ndarray:
    """Return a copy of `array` as float64. Check its shape before: an array of another size may be a view of a single
    number. Raises GffeError without memory for it."""
    try:
        with np.errstate(all="ignore"):
            return array.astype(np.float64)
    except MemoryError:
        raise GffeError(f"no memory for an array of shape {array.shape} (expected a smaller one)") from None


def _shape_words(shape: tuple) -> str:
    """Return a shape of `require_array` as it is written in docstrings: (4, 6, 3 or 4)."""
    axes = iter(("N",) * 9 if len(shape) != 2 else ("H", "W"))
    words = []
    for want in shape:
        free = next(axes)
        if isinstance(want, tuple):
            words.append(" or ".join(map(str, want)))
        else:
            words.append("…" if want is ... else free if want is None else str(want))
    return f"({', '.join(words)})"


def _is_finite(value: Any) -> bool:
    value = scalar(value)
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < math.inf


def _shown_number(value: Any) -> str:
    """Return the text for a value that is not the number that it should be, as `shown` does for others."""
    return f"{shown(value)} (out of range)" if _is_finite(value) else shown(value)


def shown(value: Any) -> str:
    """Return a short text of `value` for a message: JSON where that is possible, the type for arrays and objects."""
    value = scalar(value)
    if value is None:
        return "nothing"
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape} and type {value.dtype}"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, int) and abs(value) > LARGEST:
        return "a number too large"
    if not isinstance(value, bool | int | float | str | list | tuple | dict):
        return _kind_words(value)
    try:
        text = json.dumps(value, default=_kind_words)
    except (ValueError, TypeError, RecursionError):  # more digits than Python turns into text; keys that are no text
        return "a number too large" if isinstance(value, int) else _kind_words(value)
    return text if len(text) <= 60 else text[:59] + "…"


def _kind_words(value: Any) -> str:
    name = type(value).__name__
    return f"a{'n' * (name[:1].lower() in 'aeiou')} {name}"
