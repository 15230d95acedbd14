"""Settings that the viewer remembers between starts: plain JSON in the user's configuration folder."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import platformdirs

from gffe_cl.engine.core.files import read_bounded, write_text

_MOST_BYTES = 1 << 20  # of the file
_MOST_RECENT = 12
LEAST_WINDOW, _LARGEST_WINDOW = 200, 16384  # pixels
_LARGEST_SCALE = 8.0
THEMES = ("dark", "light")


def default_path() -> Path | None:
    """Return the path of viewer.json in the user's folder for configuration (Linux: $XDG_CONFIG_HOME or ~/.config, then
    gffe-cl); None if the user has no home folder."""
    folder = platformdirs.user_config_path("gffe-cl", appauthor=False)
    return folder / "viewer.json" if folder.is_absolute() else None


def can_save() -> bool:
    """Return whether the user's folder for settings can be written to; it is made if it is missing."""
    path = default_path()
    if path is None:
        return False
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(path.parent, os.W_OK)


@dataclass
class Settings:
    """Remembered choices; every field is plain JSON.

    `recent`: paths, newest first. `ui_scale`: 0 = automatic. `window_size`: (width, height) pixels. `displays`: how
    each layer is shown, by its name. `kept`: settings under a name. `panels`: which are open. `unknown`: what a
    newer version wrote, kept as it is.
    """

    recent: list[str] = field(default_factory=list)
    theme: str = "dark"
    ui_scale: float = 0.0
    window_size: tuple[int, int] = (1600, 1000)
    displays: dict[str, dict] = field(default_factory=dict)
    playback: dict = field(default_factory=dict)
    options: dict = field(default_factory=dict)
    compare: dict = field(default_factory=dict)
    kept: list[dict] = field(default_factory=list)
    panels: dict[str, bool] = field(default_factory=dict)
    unknown: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def load(cls, path: Path | None = None) -> tuple[Settings, str | None]:
        """Return (settings, warning or None) from `path`, or from the user's file. Whatever is missing or damaged has
        its default; a damaged entry costs only itself."""
        settings = cls()
        path = path or default_path()
        if path is None:
            return settings, None
        try:
            document = json.loads(read_bounded(path, _MOST_BYTES))
        except FileNotFoundError:
            return settings, None
        except OSError as error:
            return settings, f"{path}: cannot read the settings: {error.strerror or error}"
        except (ValueError, RecursionError):
            return settings, f"{path}: the settings are damaged, the defaults are used"
        if not isinstance(document, dict):
            return settings, f"{path}: the settings are damaged, the defaults are used"
        damaged = settings._take(document)
        listed = ", ".join(damaged)
        return settings, f"{path}: damaged settings have their defaults: {listed}" if damaged else None

    def save(self, path: Path | None = None) -> str | None:
        """Write to `path`, or to the user's file, whole or not at all. Returns a warning if that is not possible, else
        None."""
        path = path or default_path()
        if path is None:
            return "the settings cannot be saved: there is no home folder"
        try:
            text = json.dumps(self.to_json(), indent=1)
        except (TypeError, ValueError, RecursionError) as error:
            return f"{path}: the settings cannot be saved: {error}"
        try:
            Path(os.path.realpath(path)).parent.mkdir(parents=True, exist_ok=True)
            write_text(path, text + "\n")
        except OSError as error:
            return f"{path}: the settings cannot be saved: {error.strerror or error}"
        return None

    def to_json(self) -> dict[str, Any]:
        known = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "unknown"}
        return self.unknown | known | {"window_size": list(self.window_size)}

    def add_recent(self, path: str | Path) -> None:
        """Put `path` first."""
        self.recent = _recent([os.path.abspath(path), *self.recent]) or []

    def _take(self, document: dict[str, Any]) -> list[str]:
        """Set the valid values. Returns the names of invalid ones."""
        damaged = []
        for name, value in document.items():
            if name not in _CHECKS:
                self.unknown[name] = value
                continue
            sound = _CHECKS[name](value)
            if sound is None:
                damaged.append(name)
                continue
            setattr(self, name, sound)
            if isinstance(sound, dict) and len(sound) < len(value):
                damaged.append(f"some of {name}")
        return damaged


def _recent(value: Any) -> list[str] | None:
    if not isinstance(value, list):
        return None
    return list(dict.fromkeys(path for path in value if isinstance(path, str) and path))[:_MOST_RECENT]


def _window_size(value: Any) -> tuple[int, int] | None:
    if not isinstance(value, list) or len(value) != 2 or not all(type(v) is int for v in value):
        return None
    return tuple(value) if all(LEAST_WINDOW <= v <= _LARGEST_WINDOW for v in value) else None


def _ui_scale(value: Any) -> float | None:
    return float(value) if type(value) in (int, float) and 0 <= value <= _LARGEST_SCALE else None


def _dict_of(kind: type) -> Callable[[Any], dict | None]:
    def check(value: Any) -> dict | None:
        return {k: v for k, v in value.items() if isinstance(v, kind)} if isinstance(value, dict) else None

    return check


_CHECKS: dict[str, Callable[[Any], Any]] = {
    "recent": _recent,
    "theme": lambda value: value if value in THEMES else None,
    "ui_scale": _ui_scale,
    "window_size": _window_size,
    "displays": _dict_of(dict),
    "playback": _dict_of(object),
    "options": _dict_of(object),
    "compare": _dict_of(object),
    "kept": lambda value: [v for v in value if isinstance(v, dict)] if isinstance(value, list) else None,
    "panels": _dict_of(bool),
}
