"""Plain encoding of messages: JSON, then the bytes of the arrays. Reading one makes values of the declared types only,
and executes nothing.

A message is JSON, `["Look", {…}]` with the type's name and its fields, and where it has arrays a zero byte and their
bytes one after the other. In the JSON an array is its NumPy type and shape.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import scalar
from gffe_cl.engine.inspection.explain.pixel_explain_types import Link, Step

NUMERIC = "biuf"  # kinds of NumPy's types
_AS_THEY_ARE = {NoneType, bool, int, float, str}
_MOST_BYTES = 1 << 30  # that an array's shape may claim


@dataclass(frozen=True)
class _Linked:
    """A `Step`, which is a text with links, in the encoding."""

    text: str
    links: tuple[Link, ...]


def encoded(message: Any) -> bytes:
    """Return the bytes of a message, which is a dataclass."""
    arrays: list[np.ndarray] = []
    text = json.dumps([type(message).__name__, _plain(message, arrays)], separators=(",", ":")).encode()
    return b"".join([text, *([b"\0"] if arrays else []), *(array.tobytes() for array in arrays)])


def decoded(data: bytes, *kinds: type) -> Any:
    """Return the message in `data`, one of the types `kinds`. Raises GffeError for anything else."""
    text, _, rest = data.partition(b"\0")
    try:
        name, content = json.loads(text)
        kind = {kind.__name__: kind for kind in kinds}[name]
        arrays = _Arrays(rest)
        message = _typed(kind, content, arrays)
        arrays.require_end()
    except Exception as error:  # data of another process may violate anything
        expected = " or ".join(kind.__name__ for kind in kinds)
        reason = f"{type(error).__name__}: {error}"[:120]
        raise GffeError(f"attach: message is invalid: {reason} (expected {expected} of this version)") from None
    return message


def _plain(value: Any, arrays: list[np.ndarray]) -> Any:
    """Return `value` as JSON holds it, and append its arrays to `arrays`."""
    kind = type(value)
    if kind in _AS_THEY_ARE:
        return value
    if kind in (tuple, list, frozenset):
        return [_plain(one, arrays) for one in value]
    if kind is dict:
        return [[_plain(key, arrays), _plain(one, arrays)] for key, one in value.items()]
    if kind is Step:
        value = _Linked(str(value), value.links)
    if is_dataclass(value):
        return {name: _plain(getattr(value, name), arrays) for name in _hints(type(value))}
    value = scalar(value)
    if isinstance(value, np.ndarray):
        arrays.append(value)
        return [value.dtype.str, value.shape]
    return value


class _Arrays:
    """Arrays that lie one after the other in `data`."""

    def __init__(self, data: bytes):
        self._data, self._at = data, 0

    def take(self, described: Any) -> np.ndarray:
        """Return a copy of the next array, which has the described type and shape."""
        name, shape = _typed(tuple[str, tuple[int, ...]], described, self)
        dtype = np.dtype(name)
        if dtype.kind not in NUMERIC or min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize > _MOST_BYTES:
            raise ValueError(f"array of type {name[:20]}")
        found = np.frombuffer(self._data, dtype, math.prod(shape), self._at) if math.prod(shape) else np.empty(0, dtype)
        self._at += found.nbytes
        return found.reshape(shape).copy()

    def require_end(self) -> None:
        if self._at != len(self._data):
            raise ValueError("bytes after the arrays")


@cache
def _hints(kind: type) -> dict[str, Any]:
    """Return the types of a dataclass's fields, by name."""
    hints = get_type_hints(kind)
    return {field.name: hints[field.name] for field in fields(kind)}


def _typed(hint: Any, value: Any, arrays: _Arrays) -> Any:
    """Return `value`, from JSON, as the type `hint`. Raises TypeError or ValueError, or whatever the type's constructor
    raises, where it is something else."""
    return _reader(hint)(value, arrays)


@cache
def _reader(hint: Any) -> Callable[[Any, _Arrays], Any]:
    """Return the function that does `_typed` for one type."""
    if hint is np.ndarray:
        return lambda value, arrays: arrays.take(value)
    if hint is Step:
        linked = _reader(_Linked)
        return lambda value, arrays: (read := linked(value, arrays)) and Step(read.text, *read.links)
    if is_dataclass(hint):
        return _reader_of_fields(hint, {name: _reader(one) for name, one in _hints(hint).items()})
    origin = get_origin(hint)
    if origin in (Union, UnionType):
        return _reader_of_either({one: _reader(one) for one in get_args(hint)})
    return _reader_of_items(origin, get_args(hint)) if origin else _reader_of_value(hint)


def _reader_of_fields(kind: Any, readers: dict[str, Callable]) -> Callable:
    def read(value: Any, arrays: _Arrays) -> Any:
        if not isinstance(value, dict) or value.keys() != readers.keys():
            raise TypeError(f"fields of {kind.__name__}")
        return kind(**{name: read_one(value[name], arrays) for name, read_one in readers.items()})

    return read


def _reader_of_either(readers: dict[Any, Callable]) -> Callable:
    """Return the reader of a type that may be None too, or of a text with or without links."""

    def read(value: Any, arrays: _Arrays) -> Any:
        if value is None and NoneType in readers:
            return None
        if Step in readers:
            return readers[Step if isinstance(value, dict) else str](value, arrays)
        (read_one,) = (reader for kind, reader in readers.items() if kind is not NoneType)
        return read_one(value, arrays)

    return read


def _reader_of_items(kind: Any, inner: tuple) -> Callable:
    readers = [_reader(one) for one in inner if one is not Ellipsis]
    one_by_one = kind is tuple and inner[-1] is not Ellipsis

    def read(value: Any, arrays: _Arrays) -> Any:
        if not isinstance(value, list):
            raise TypeError(f"{type(value).__name__} in place of a list")
        if kind is dict:
            return {readers[0](key, arrays): readers[1](one, arrays) for key, one in value}
        if one_by_one:
            return tuple(read_one(one, arrays) for read_one, one in zip(readers, value, strict=True))
        return kind([readers[0](one, arrays) for one in value])

    return read


def _reader_of_value(kind: type) -> Callable:
    def read(value: Any, arrays: _Arrays) -> Any:
        if kind is float and type(value) is int:
            return float(value)
        if type(value) is not kind:
            raise TypeError(f"{type(value).__name__} in place of {kind.__name__}")
        return value

    return read
