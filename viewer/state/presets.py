"""Named settings, kept to be B while the present ones change; and the command line for given settings."""

from __future__ import annotations

import shlex
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gffe_cl.engine.core.errors import GffeError, printable
from gffe_cl.engine.options import OPTIONS, Options, command_words
from ..engine.messages import Setup
from ..engine.slot_maker import weights_of
from ..engine.sources.opening import place_of
from ..engine.sources.source import FrameSource

_MOST = 12
_LONGEST = 60  # letters of a name


@dataclass(frozen=True)
class Kept:
    """Named settings: modules, parameters, network and rendering window. `kernels`: a build that was in use since the
    viewer was started; empty: the newest. `weights`: identifies the network's weights. `place`: where pictures are
    stored that are shown instead. `foreign`: the kernels are from another folder."""

    name: str
    options: Options
    window: str | None = None
    kernels: str = ""
    weights: str = ""
    place: str = ""
    foreign: bool = False

    def setup(self, n: int) -> Setup:
        """Return the setup of these settings for `n` generated frames per rendered one, which is a matter of
        playback."""
        return Setup(self.options, self.window, n, self.kernels, self.place)

    @property
    def suspicion(self) -> str:
        """Warning if the network's file has changed since the settings were kept; empty if not."""
        if self.weights != weights_of(self.options):
            return "the network's file has changed since these settings were kept"
        return ""

    def to_json(self) -> dict[str, Any]:
        """Return the settings as plain JSON, without the kernels."""
        changed = {
            name: getattr(self.options, name)
            for name, option in OPTIONS.items()
            if getattr(self.options, name) != option.default
        }
        return {"name": self.name, "options": changed, "window": self.window}

    @classmethod
    def from_json(cls, document: Any) -> Kept | None:
        """Return the settings that `to_json` returned once; None if damaged."""
        if not isinstance(document, dict) or not isinstance(document.get("options"), dict):
            return None
        name, window = document.get("name"), document.get("window")
        if not isinstance(name, str) or not name.strip() or not (window is None or isinstance(window, str)):
            return None
        known = {key: value for key, value in document["options"].items() if key in OPTIONS}
        try:
            options = Options(**known)
        except (GffeError, TypeError):
            return None
        return cls(name[:_LONGEST], options, window, "", weights_of(options))


class KeptSettings:
    """All kept settings, the latest first, and the one that is B.

    Attributes
    ----------
    all : list of Kept
    b : Kept or None
    """

    def __init__(self):
        self.all: list[Kept] = []
        self.b: Kept | None = None

    def keep(self, setup: Setup, kernels: str, folder: Path | None = None) -> Kept:
        """Keep the present settings as B, and return them. `folder`: where the kernels are from, if they are not the
        viewer's own."""
        stem = told(setup) if folder is None else f"{told(setup)}, kernels of {of_folder(folder)}"
        weights, foreign = weights_of(setup.options), folder is not None
        return self._keep(Kept(stem, setup.options, setup.window, kernels, weights, foreign=foreign))

    def keep_stored(self, place: str, options: Options) -> Kept:
        """Make pictures that are stored at `place` B, and return it. `options`: of A."""
        self.all = [kept for kept in self.all if kept.place != place]
        return self._keep(Kept(of_folder(Path(place)), options, None, "", weights_of(options), place))

    def _keep(self, made: Kept) -> Kept:
        """Make this B, by an unused name that begins with its own, instead of equal ones, and return it."""
        made = replace(made, name=self._unused(made.name[: _LONGEST - 5].rstrip(" ,")))
        self.all = [made, *(kept for kept in self.all if replace(kept, name=made.name) != made)][:_MOST]
        self.b = made
        return made

    def rename(self, kept: Kept, name: str) -> None:
        """Give kept settings another name, unless it is taken or empty."""
        name = name.strip()[:_LONGEST]
        if not name or any(other.name == name for other in self.all):
            return
        renamed = replace(kept, name=name)
        self.all = [renamed if other == kept else other for other in self.all]
        self.b = renamed if self.b == kept else self.b

    def choose(self, name: str) -> None:
        """Make the settings of this name B, if there are any."""
        self.b = next((kept for kept in self.all if kept.name == name), self.b)

    def forget(self, kept: Kept) -> None:
        self.all = [other for other in self.all if other != kept]
        if self.b == kept:
            self.b = self.all[0] if self.all else None

    def preferences(self) -> list[dict[str, Any]]:
        """Return all kept settings as plain JSON, without stored pictures and kernels of other folders."""
        return [kept.to_json() for kept in self.all if not (kept.place or kept.foreign)]

    def restore(self, saved: list) -> None:
        """Restore the result of `preferences` without damaged entries. None of them is B."""
        found = filter(None, map(Kept.from_json, saved))
        self.all = list({kept.name: kept for kept in found}.values())[:_MOST]

    def _unused(self, stem: str) -> str:
        """Return an unused name."""
        taken, number = {kept.name for kept in self.all}, 1
        while (name := stem if number == 1 else f"{stem} ({number})") in taken:
            number += 1
        return name


def of_folder(folder: Path) -> str:
    """Return a folder's name with its parent's, as many have one name."""
    return printable("/".join(folder.absolute().parts[1:][-2:]))


def told(setup: Setup) -> str:
    """Return the deviations from the defaults, in a few words."""
    return ", ".join(_deviations(setup.options))[: _LONGEST - 5].rstrip(" ,") or "defaults"


def _deviations(options: Options) -> list[str]:
    """Return the deviations from the defaults, one by one."""
    found = []
    for name, option in OPTIONS.items():
        value = getattr(options, name)
        if value == option.default or not option.remembered:
            continue
        if option.automatic and option.kind is bool and (value or not Options().corrects_shading):
            continue  # as it would be by itself
        label = option.label
        off = option.off is not None and value == option.off
        found.append(f"no {label}" if off else label if value is True else f"{label} {value}")
    return found


def command_line(setup: Setup, source: FrameSource, seed: int) -> str:
    """Return the shell command for the frames that the viewer shows with `setup`; `seed`: of a built-in scene."""
    target = source.target if source.live else str(place_of(source.target).absolute())
    words = ["gffe", "run", target, f"{source.name}_extrapolated"]
    words += ["-n", str(setup.n)] if setup.n != 1 else []
    if source.live:
        words += ["--size", f"{source.width}x{source.height}"] + (["--seed", str(seed)] if seed else [])
    usual = "off" if source.live else None
    words += ["--window", setup.window] if setup.window not in (None, usual) else []
    return shlex.join([*words, *command_words(setup.options)])
