"""Reading of ONNX files without the package `onnx`: nodes, constants and metadata of a graph.

An ONNX file is a message in the format of Protocol Buffers: a sequence of fields, each with a number and a value, which
may be a message itself. The numbers of fields below are those of onnx.proto3.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

_TYPES = {
    1: np.float32,
    2: np.uint8,
    3: np.int8,
    6: np.int32,
    7: np.int64,
    9: np.bool_,
    10: np.float16,
    11: np.float64,
}


class NotRead(ValueError):
    """Error of a file that is no ONNX file, or has something that this module does not read."""


@dataclass
class Node:
    """Node of a graph: the operator `op`, names of its inputs and outputs, attributes by name."""

    op: str = ""
    inputs: list[str] = field(default_factory=list)
    outputs: list[str] = field(default_factory=list)
    attributes: dict[str, Any] = field(default_factory=dict)


@dataclass
class Graph:
    """Graph of an ONNX file: its nodes in the order in which they can work, constants by name, names of inputs and
    outputs, and the file's metadata."""

    nodes: list[Node] = field(default_factory=list)
    constants: dict[str, np.ndarray] = field(default_factory=dict)
    inputs: list[str] = field(default_factory=list)
    outputs: list[str] = field(default_factory=list)
    metadata: dict[str, str] = field(default_factory=dict)


def read_graph(path: Path) -> Graph:
    """Return the graph of an ONNX file. Raises NotRead, and OSError."""
    try:
        return _graph(path.read_bytes())
    except (ValueError, IndexError, KeyError, StopIteration, struct.error, TypeError) as error:
        raise NotRead(f"{path.name} cannot be read as an ONNX file ({error})") from None


def _graph(content: bytes) -> Graph:
    graph = Graph()
    for number, value in _fields(content):
        if number == 7:
            for part, inner in _fields(value):
                if part == 1:
                    graph.nodes.append(_node(inner))
                elif part == 5:
                    name, array = _tensor(inner)
                    graph.constants[name] = array
                elif part in (11, 12):
                    names = graph.inputs if part == 11 else graph.outputs
                    names.append(next(text for tag, text in _fields(inner) if tag == 1).decode())
        elif number == 14:
            entry = dict(_fields(value))
            graph.metadata[entry[1].decode()] = entry.get(2, b"").decode()
    return graph


def _node(content: bytes) -> Node:
    node = Node()
    for number, value in _fields(content):
        if number in (1, 2):
            (node.inputs if number == 1 else node.outputs).append(value.decode())
        elif number == 4:
            node.op = value.decode()
        elif number == 5:
            name, attribute = _attribute(value)
            node.attributes[name] = attribute
    return node


def _attribute(content: bytes) -> tuple[str, Any]:
    name, single, several = "", None, []
    for number, value in _fields(content):
        if number == 1:
            name = value.decode()
        elif number == 2:
            (single,) = struct.unpack("<f", value)
        elif number == 3:
            single = _signed(value)
        elif number == 4:
            single = value.decode("utf-8", "replace")
        elif number == 5:
            single = _tensor(value)[1]
        elif number == 7:
            several += np.frombuffer(value, "<f4").tolist()
        elif number == 8:
            several += _integers(value)
    return name, several if single is None else single


def _tensor(content: bytes) -> tuple[str, np.ndarray]:
    """Return name and values of a tensor, which a file stores as bytes or as a list of numbers."""
    name, shape, kind, raw, listed = "", [], 0, None, []
    for number, value in _fields(content):
        if number == 1:
            shape += _integers(value)
        elif number == 2:
            kind = value
        elif number == 4:
            listed += np.frombuffer(value, "<f4").tolist()
        elif number in (5, 7):
            listed += _integers(value)
        elif number == 8:
            name = value.decode()
        elif number == 9:
            raw = value
    dtype = _TYPES[kind]
    values = np.array(listed, dtype) if raw is None else np.frombuffer(raw, np.dtype(dtype).newbyteorder("<"))
    return name, values.reshape(shape)


def _fields(content: bytes) -> Iterator[tuple[int, Any]]:
    """Yield number and value of each field of a message: whole numbers, or bytes."""
    at = 0
    while at < len(content):
        key, at = _number(content, at)
        kind = key & 7
        if kind == 0:
            value, at = _number(content, at)
        else:
            length = {1: 8, 5: 4}.get(kind, 0)
            if kind == 2:
                length, at = _number(content, at)
            elif not length:
                raise NotRead(f"a field of kind {kind}")
            value, at = content[at : at + length], at + length
            if at > len(content):
                raise NotRead("it ends early")
        yield key >> 3, value


def _number(content: bytes, at: int) -> tuple[int, int]:
    """Return the whole number at byte `at`, of seven bits per byte, and where it ends."""
    value = shift = 0
    while True:
        byte = content[at]
        at += 1
        value |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            return value, at


def _integers(value: int | bytes) -> list[int]:
    """Return a field's whole numbers: a single one, or several packed into bytes."""
    if isinstance(value, int):
        return [_signed(value)]
    found, at = [], 0
    while at < len(value):
        number, at = _number(value, at)
        found.append(_signed(number))
    return found


def _signed(value: int) -> int:
    return value - (1 << 64) if value >= 1 << 63 else value
