"""Studies of the shown frame, found in the background: layers that differ, what modules gain, a row of pixels over
time.

A study is a list of wants and a function of their frames. A new one is a subclass of `Study` and a name in
`Studies.__init__`.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gffe_cl.engine.inspection import names
from gffe_cl.engine.inspection.layers import FRAME_GROUP, LayerSpec
from gffe_cl.engine.options import OPTIONS
from gffe_cl.lab.metrics import METRICS, RegionErrors
from ..engine.figures import NEEDED_BY_REGION, displayed, region_masks
from ..engine.jobs import Jobs
from ..engine.messages import Failure, Frame, Key, Recipe, Setup
from ..engine.store import Store, Want
from ..picture.displays import FrameInfo
from .parameters import ALWAYS, UPSCALING
from .survey import NO_B

_PATIENCE = 4  # frames of the interface that a study goes on after it was shown
_AHEAD = 2  # answers that are made at once
_MOST_SLOTS = 120  # of a row of pixels
_OF_ROWS = ("color", "depth", "motion", "mask", "label", "scalar")
ALL = "whole"  # the image, beside its regions


@dataclass(frozen=True)
class Here:
    """Place and settings of a study.

    Attributes
    ----------
    slot, slot_of_b : int
    a, b : Recipe, Recipe or None
    layers : tuple of LayerSpec
        All of A.
    shown : str
        Name of the displayed layer.
    pixel : (x, y) or None
        The picked pixel.
    slots : range
        Between the in and the out point.
    exposure : float
    recipe, info : callable
        Return the recipe of a setup, and the frame of reference of a frame's layers.
    """

    slot: int
    slot_of_b: int
    a: Recipe
    b: Recipe | None
    layers: tuple[LayerSpec, ...]
    shown: str
    pixel: tuple[int, int] | None
    slots: range
    exposure: float
    recipe: Callable[[Setup], Recipe]
    info: Callable[[Frame], FrameInfo]


class Study:
    """One question about the shown frame, answered part by part.

    Attributes
    ----------
    on : bool
        Whether it is made: for every frame that is shown, as long as somebody calls `look`.
    found : dict
        Answers by the part's name, in order, as far as they are known: what `find` returns, or a `Failure`.
    parts : int
        Number of parts of the present question.
    """

    def __init__(self):
        self.parts, self._looks = 0, 0
        self.found: dict[Any, Any] = {}

    def look(self) -> None:
        """Have it made. Call once per frame of the interface in which it is shown."""
        self._looks = _PATIENCE

    def pass_time(self) -> None:
        """Count a frame of the interface."""
        self._looks = max(self._looks - 1, 0)

    @property
    def on(self) -> bool:
        return self._looks > 0

    @property
    def busy(self) -> bool:
        return self.on and len(self.found) < self.parts

    def why_not(self, here: Here) -> str | None:
        """Return why there is no answer here; None if there is one."""
        raise NotImplementedError

    def subject(self, here: Here) -> Hashable:
        """Return what `find` reads of `here` besides what follows from the wants."""
        return ()

    def wanted(self, here: Here) -> dict[Hashable, tuple[Want, ...]]:
        """Return the frames that each part needs, in order."""
        raise NotImplementedError

    def find(self, here: Here, name: Any, *frames: Frame) -> Any:
        """Return the answer of a part. Runs in the background."""
        raise NotImplementedError


class Studies:
    """All studies. `background` runs their computations."""

    def __init__(self, store: Store, background: Jobs):
        self._store, self._background = store, background
        self.differing, self.ablation, self.over_time = Differing(), Ablation(), OverTime()
        self.all: tuple[Study, ...] = (self.differing, self.ablation, self.over_time)
        self._jobs: dict[tuple, Future] = {}
        self._known: dict[tuple, Any] = {}  # by study, subject and wants
        self._asked: dict[Study, tuple[Here, dict]] = {}  # what each wants, and where
        self._outdated = store.outdated  # when answers were dropped last
        self.here: Here | None = None

    @property
    def busy(self) -> bool:
        return any(study.busy for study in self.all)

    def forget(self) -> None:
        """Drop everything after a change of the source."""
        for job in self._jobs.values():
            job.cancel()
        self._jobs, self._known, self._asked, self.here = {}, {}, {}, None
        self._outdated = self._store.outdated
        for study in self.all:
            study.found, study.parts = {}, 0

    def update(self, here: Here, may_run: bool) -> list[Want]:
        """Take what has been found, and return the frames that are missing. Call once per frame of the interface;
        `may_run`: whether there is nothing else to do."""
        if self._outdated != self._store.outdated:
            self.forget()
        self.here, wants, keys = here, [], set()
        for study in self.all:
            study.pass_time()
            parts = self._parts(study, here)
            found = {}
            for name, needed in parts.items():
                keys.add(key := (study, study.subject(here), needed))
                self._advance(key, here, name, may_run)
                if key in self._known:
                    found[name] = self._known[key]
                elif may_run and key not in self._jobs and len(self._jobs) + len(wants) < _AHEAD:
                    wants += needed
            study.found, study.parts = found, len(parts)
        for key in [key for key in self._jobs if key not in keys]:
            self._jobs.pop(key).cancel()
        self._known = {key: made for key, made in self._known.items() if key in keys}
        return list(dict.fromkeys(wants))

    def _parts(self, study: Study, here: Here) -> dict[Hashable, tuple[Want, ...]]:
        if not study.on or study.why_not(here) is not None:
            return {}
        if (asked := self._asked.get(study)) is None or asked[0] != here:
            self._asked[study] = asked = here, study.wanted(here)
        return asked[1]

    def _advance(self, key: tuple, here: Here, name: Hashable, may_run: bool) -> None:
        """Start a part of a study that has its frames, or take its answer."""
        (study, _, needed), job = key, self._jobs.get(key)
        if key in self._known:
            return
        if job is None and may_run and len(self._jobs) < _AHEAD:
            frames = [self._store.get(want) for want in needed]
            failed = next((frame for frame in frames if isinstance(frame, Failure)), None)
            if failed is not None:
                self._known[key] = failed
            elif all(isinstance(frame, Frame) for frame in frames):
                self._jobs[key] = self._background.run(study.find, here, name, *frames)
        elif job is not None and job.done():
            del self._jobs[key]
            if not job.cancelled():
                error = job.exception()
                self._known[key] = Failure(f"{type(error).__name__}: {error}") if error else job.result()


# ---- layers that differ ----------------------------------------------------------------------------------------


_BUFFERS = frozenset({names.RENDERED_COLOR, names.RENDERED_DEPTH, names.RENDERED_MOTION})


@dataclass(frozen=True)
class Difference:
    """Difference between a layer of A and of B. `pixels` of `of` differ, by finite numbers at most by `largest` (NaN
    without any); `planes`: of several the ones that differ, from 0, that with the largest difference first; `worst`:
    the display pixel with that, if it is on the display; `remark`: why they cannot be compared, if so; `common`: both
    have it."""

    spec: LayerSpec
    pixels: int
    of: int
    largest: float
    remark: str = ""
    common: bool = True
    planes: tuple[int, ...] = ()
    worst: tuple[int, int] | None = None

    @property
    def differs(self) -> bool:
        return self.common and bool(self.pixels or self.remark)

    @property
    def label(self) -> str:
        """The layer's label, with the planes that differ."""
        listed = ", ".join(str(plane + 1) for plane in sorted(self.planes))
        return f"{self.spec.label}, plane{'s' * (len(self.planes) > 1)} {listed}" if self.planes else self.spec.label


class Differing(Study):
    """Differences of every layer of this frame between A's and B's settings, in the order of the stages."""

    _inputs: frozenset[str] = frozenset()  # that are of two rendered frames

    def why_not(self, here: Here) -> str | None:
        return NO_B if here.b is None else None

    def wanted(self, here: Here) -> dict[Hashable, tuple[Want, ...]]:
        assert here.b is not None  # or it has no answer
        groups: dict[Hashable, frozenset[str]] = {}
        for spec in _by_stage(here.layers):
            groups[_stage_of(spec)] = groups.get(_stage_of(spec), frozenset()) | {spec.name}
        sides = Key(here.a, here.slot), Key(here.b, here.slot_of_b)
        first, second = (key.slot // (here.a.setup.n + 1) for key in sides)
        self._inputs = frozenset() if first == second else _BUFFERS
        return {stage: tuple(Want(key, layers, keep=False) for key in sides) for stage, layers in groups.items()}

    def find(self, here: Here, name: Any, *frames: Frame) -> list[Difference]:
        a, b = frames
        specs = [spec for spec in _by_stage(here.layers) if _stage_of(spec) == name]
        return [made for spec in specs if (made := difference(spec, a, b, here.info(a))) is not None]

    @property
    def all(self) -> list[Difference]:
        """The layers of the stages that are known, in order."""
        return [one for made in self.found.values() if isinstance(made, list) for one in made]

    @property
    def stale(self) -> list[Difference]:
        """The layers of the input that are equal although they are of two rendered frames."""
        return [one for one in self.all if one.spec.name in self._inputs and one.common and not one.differs]

    @property
    def text(self) -> str:
        """The number of layers that differ, of those that both have, and of those that only one has."""
        differing, lacking = sum(one.differs for one in self.all), [one.remark for one in self.all if not one.common]
        common = len(self.all) - len(lacking)
        found = f"{differing} of {common} layers differ" if differing or self.busy else f"all {common} layers are equal"
        return ", ".join([found, *(f"{lacking.count(remark)} {remark}" for remark in dict.fromkeys(lacking))])


def _stage_of(spec: LayerSpec) -> str:
    """Return the name of a layer's stage: the input's come first, and the displayed image last."""
    if spec.group != FRAME_GROUP or spec.name.startswith("frame."):
        return spec.group if spec.group != FRAME_GROUP else "new frame"
    return "input" if spec.name.startswith("rendered.") else "displayed"


def _by_stage(layers: tuple[LayerSpec, ...]) -> list[LayerSpec]:
    """Return the layers in the order in which they are made, without those of ground truth."""
    own = [spec for spec in layers if spec.name not in (names.TRUTH, names.FOCUS_TRUTH)]
    ranks = {"input": 0, "new frame": 2, "displayed": 3}
    return sorted(own, key=lambda spec: (ranks.get(_stage_of(spec), 1), spec.name == names.FINAL))


def difference(spec: LayerSpec, a: Frame, b: Frame, info: FrameInfo) -> Difference | None:
    """Return how a layer differs between two frames; None if neither has it. `info`: of A."""
    first, second = a.images.get(spec.name), b.images.get(spec.name)
    if first is None and second is None:
        return None
    if first is None or second is None:
        return Difference(spec, 0, 0, float("nan"), f"not in {'A' if first is None else 'B'}", common=False)
    if first.shape != second.shape:
        return Difference(spec, 0, 0, float("nan"), "other size")
    height, width = first.shape[1:3] if spec.planes > 1 else first.shape[:2]
    first, second = (image.reshape(spec.planes, height, width, -1) for image in (first, second))
    differs = first != second
    if first.dtype.kind == "f":
        differs &= (first == first) | (second == second)
    by_plane = differs.any(-1)
    pixels = int(np.count_nonzero(by_plane.any(0)))
    if not pixels:
        return Difference(spec, 0, height * width, 0.0)
    apart = np.zeros(differs.shape)
    with np.errstate(invalid="ignore", over="ignore"):
        apart[differs] = np.abs(first[differs].astype(np.float64) - second[differs].astype(np.float64))
    known = apart[np.isfinite(apart)]
    largest = float(known.max()) if spec.view != "label" and known.any() else float("nan")
    apart = np.where(np.isfinite(apart), apart, 0.0).max(-1) if largest == largest else by_plane
    plane, y, x = map(int, np.unravel_index(apart.argmax(), apart.shape))
    planes = [plane, *(other for other in np.flatnonzero(by_plane.any((1, 2))).tolist() if other != plane)]
    worst = info.pixel_of(spec, ((x + 0.5) / width, (y + 0.5) / height))
    return Difference(
        spec, pixels, height * width, largest, planes=tuple(planes) if spec.planes > 1 else (), worst=worst
    )


# ---- what modules gain -----------------------------------------------------------------------------------------


class Ablation(Study):
    """Gain of each module in this frame, dB of PSNR, over the whole image and by region of A."""

    def why_not(self, here: Here) -> str | None:
        if here.slot % (here.a.setup.n + 1) == 0:
            return "a rendered frame: modules work on generated ones"
        if all(spec.name != names.TRUTH for spec in here.layers):
            return "this sequence has no ground truth"
        return None

    def wanted(self, here: Here) -> dict[Hashable, tuple[Want, ...]]:
        whole = Want(Key(here.a, here.slot), NEEDED_BY_REGION, keep=False)
        return {
            name: (whole, replace(whole, key=Key(here.recipe(without(here.a.setup, name)), here.slot)))
            for name in modules_of(here.a.setup)
        }

    def find(self, here: Here, name: Any, *frames: Frame) -> dict[str, float]:
        regions, levels = region_masks(frames[0], here.exposure), []
        for frame in frames:
            errors = RegionErrors()
            errors.add(*displayed(frame, here.exposure), regions, [METRICS["psnr"]])
            levels.append({region: errors.figure("psnr", region) for region in regions})
        return {region: levels[0][region] - levels[1][region] for region in regions}

    @property
    def sorted(self) -> list[tuple[str, dict[str, float]]]:
        """The modules whose gain is known, the largest first."""
        known = [(str(name), gains) for name, gains in self.found.items() if isinstance(gains, dict)]
        return sorted(known, key=lambda one: -one[1][ALL])


def modules_of(setup: Setup) -> list[str]:
    """Return the names of the modules that are on and can be off without another size of the image."""
    return [
        name
        for name, option in OPTIONS.items()
        if option.is_module and getattr(setup.options, name) != option.off and name not in (UPSCALING, *ALWAYS)
    ]


def without(setup: Setup, module: str) -> Setup:
    """Return the setup with a module off."""
    return replace(setup, options=setup.options.changed(module, OPTIONS[module].off))


# ---- a row of pixels over time -----------------------------------------------------------------------------------


class OverTime(Study):
    """The row of the displayed layer through the picked pixel, in every slot between the in and the out point."""

    def why_not(self, here: Here) -> str | None:
        spec = next((spec for spec in here.layers if spec.name == here.shown), None)
        if here.pixel is None or spec is None:
            return "click a pixel of the picture: its row is shown in every frame"
        return None if spec.view in _OF_ROWS else "positions and vectors to places have no rows over time"

    def wanted(self, here: Here) -> dict[Hashable, tuple[Want, ...]]:
        first = max(min(here.slot - _MOST_SLOTS // 2, here.slots.stop - _MOST_SLOTS), here.slots.start)
        slots = [slot for slot in here.slots if first <= slot < first + _MOST_SLOTS]
        layers = frozenset({here.shown})
        onward = sorted(slots, key=lambda slot: (slot < here.slot, slot))  # a pipeline goes on, and begins anew once
        return {slot: (Want(Key(here.a, slot), layers, keep=False),) for slot in onward}

    def subject(self, here: Here) -> Hashable:
        return here.pixel and here.pixel[1]

    def find(self, here: Here, name: Any, *frames: Frame) -> np.ndarray | None:
        """Return (W, channels?) of the row, W being the width of the layer's part that is displayed."""
        image, spec = frames[0].images.get(here.shown), frames[0].specs.get(here.shown)
        if image is None or spec is None or here.pixel is None:
            return None
        image = image[0] if spec.planes > 1 else image
        x0, y0, x1, y1 = (info := here.info(frames[0])).area(spec)
        height, width = image.shape[:2]
        row = int((y0 + (here.pixel[1] + 0.5) / info.display_size[1] * (y1 - y0)) * height)
        columns = slice(max(round(x0 * width), 0), max(round(x1 * width), 1))
        return image[min(max(row, 0), height - 1), columns].copy()

    def picture(self, here: Here) -> tuple[np.ndarray, range] | None:
        """Return (slots, W, channels?) of the rows that are known, zero where they are not, and their slots; None
        without any."""
        rows = {int(slot): row for slot, row in self.found.items() if isinstance(row, np.ndarray)}
        if not rows:
            return None
        slots = range(min(rows), max(rows) + 1)
        shape = rows[slots[0]].shape
        nothing = np.zeros(shape, rows[slots[0]].dtype)
        return np.stack([row if (row := rows.get(slot, nothing)).shape == shape else nothing for slot in slots]), slots
