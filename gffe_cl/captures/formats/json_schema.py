"""Parser of objects in JSON documents: every key must be known, and every value of its kind."""

from __future__ import annotations

from typing import Any, overload

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import require_number, shown


class Keys:
    """Keys of the object `document`; `label` names it in errors. Keys that were not taken before `done` are unknown
    ones."""

    def __init__(self, document: Any, label: str):
        if document is None:
            raise GffeError(f"{label} is missing (expected an object)")
        if not isinstance(document, dict):
            raise GffeError(f"{label} must be an object, got {shown(document)}")
        self._left, self.label, self._known = dict(document), label, []

    def take(self, key: str, default: Any = None) -> Any:
        self._known.append(key)
        value = self._left.pop(key, None)
        return default if value is None else value

    @overload
    def number(self, key: str) -> float | None: ...
    @overload
    def number(self, key: str, default: float) -> float: ...
    def number(self, key: str, default: float | None = None) -> float | None:
        value = self.take(key)
        return default if value is None else require_number(value, f"{self.label}, {key}")

    @overload
    def numbers(self, key: str, count: int, default: tuple[float, ...]) -> tuple[float, ...]: ...
    @overload
    def numbers(self, key: str, count: int, default: None) -> tuple[float, ...] | None: ...
    def numbers(self, key: str, count: int, default: tuple[float, ...] | None) -> tuple[float, ...] | None:
        """Return `count` numbers; a single one stands for all of them. Raises GffeError for others."""
        value = self.take(key)
        if value is None:
            return default
        values = value if isinstance(value, list) else [value] * count
        if len(values) != count:
            raise GffeError(f"{self.label}, {key} must be a number or {count} of them, got {shown(value)}")
        return tuple(require_number(one, f"{self.label}, {key}") for one in values)

    def flag(self, key: str, default: bool = False) -> bool:
        value = self.take(key, default)
        if not isinstance(value, bool):
            raise GffeError(f"{self.label}, {key} must be true or false, got {shown(value)}")
        return value

    def choice(self, key: str, choices: tuple[str, ...], default: str | None = None) -> str:
        value = self.take(key, default)
        if value not in choices:
            raise GffeError(f"{self.label}, {key} must be one of {', '.join(choices)}, got {shown(value)}")
        return value

    def text(self, key: str) -> str | None:
        value = self.take(key)
        if value is not None and not isinstance(value, str):
            raise GffeError(f"{self.label}, {key} must be a text, got {shown(value)}")
        return value

    def done(self) -> None:
        """Raise GffeError if there are keys that were not taken."""
        for key in self._left:
            raise GffeError(f"{self.label}: unknown key {shown(key)} (expected some of {', '.join(self._known)})")
