"""Figures of slots: metrics against ground truth, flicker, PSNR by regions of the image, and times."""

from __future__ import annotations

from collections import OrderedDict, deque
from concurrent.futures import Future
from dataclasses import dataclass, field, replace

import numpy as np

from gffe_cl.engine.inspection import names
from gffe_cl.lab.metrics import (
    METRICS,
    Flicker,
    focus_mask,
    labels_of,
    masks,
    measurable,
    measured_or_reason,
    shows,
    steps,
    to_display,
    world_positions,
)
from gffe_cl.lab.metrics import REGIONS as _TABLE
from .jobs import Jobs
from .messages import Frame, Key, Recipe

_INPUT = {"mean color": names.RENDERED_COLOR, "mean depth": names.RENDERED_DEPTH}  # of the rendered frame
NEEDED = frozenset({names.FINAL, names.TRUTH, names.DISOCCLUDED, names.RESIDUAL, *_INPUT.values()})
NEEDED_BY_REGION = NEEDED | {names.GAE, names.DEPTH, names.DYNAMIC}

_RECIPES = 8  # whose figures are remembered
_SLOW = 4  # slots that wait for metrics that are slow
_TO_MEASURE = 256 << 20  # bytes of slots that wait for their metrics; beyond that the oldest are given up

# As the table of methods has them (gffe_cl/lab/metrics.py), found by the pipeline; the first that holds counts.
REGIONS = {
    "out of screen": _TABLE["out of screen"],
    "disoccluded": "hidden in the rendered frame behind something else",
    "silhouettes": _TABLE["silhouettes"],
    "dynamic": _TABLE["dynamic"],
    "focus": _TABLE["focus"],
    "rest": _TABLE["rest"],
}


@dataclass(frozen=True)
class Quantity:
    """One figure of a slot. `worse`: 1 if larger is worse, −1 if smaller is, 0 if neither."""

    label: str
    unit: str
    worse: int
    digits: int = 2

    def text(self, value: float, sign: str = "") -> str:
        return f"{value:{sign}.{self.digits}f} {self.unit}".rstrip()


QUANTITIES = {
    metric.name: Quantity(metric.label, metric.unit, -1 if metric.higher_is_better else 1, metric.digits)
    for metric in METRICS.values()
} | {
    "flicker": Quantity("flicker", "%", 1, 3),
    "disoccluded": Quantity("disoccluded", "%", 1),
    "residual": Quantity("depth against motion", "px", 1, 3),
    "mean color": Quantity("mean color of the input", "", 0, 4),
    "mean depth": Quantity("mean depth of the input", "", 0, 4),
    "kernels": Quantity("kernel time", "ms", 1),
}


@dataclass(frozen=True)
class Figures:
    """Figures of one slot: by the names of `QUANTITIES` and of metrics, as far as they are known.
    `surveyed`: all quantities are there that can be."""

    values: dict[str, float] = field(default_factory=dict)
    surveyed: bool = False

    def joined(self, other: Figures) -> Figures:
        """Return these figures and the others of the same slot."""
        return Figures(self.values | other.values, self.surveyed or other.surveyed)


class Measurer:
    """Figures of slots of one setup, in the order of display as far as flicker is to be known."""

    def __init__(self):
        self._flicker = Flicker()
        self._before: int | None = None

    def measure(self, frame: Frame, exposure: float, known: dict[str, float] | None = None) -> Figures:
        """Return the figures of a generated slot, as far as its layers allow; `NEEDED` are the layers for all of them.
        `known`: values that are not measured again."""
        values = {"kernels": sum(frame.milliseconds.values())} | (known or {})
        holes = frame.images.get(names.DISOCCLUDED)
        if holes is not None:
            values["disoccluded"] = 100 * float(np.count_nonzero(holes)) / holes.size
        residual = frame.images.get(names.RESIDUAL)
        if residual is not None and np.isfinite(residual).any():
            values["residual"] = float(np.nanmedian(np.linalg.norm(residual, axis=-1)))  # movers do not rule it
        for name, layer in _INPUT.items():
            image = frame.images.get(layer)
            if image is not None:
                image = image[..., :3] if image.ndim > 2 else image
                finite = image[np.isfinite(image)]
                values |= {name: float(finite.mean(dtype=np.float64))} if finite.size else {}
        if frame.images.get(names.TRUTH) is None:
            self._before = None
            return Figures(values, surveyed=True)
        shown, true = displayed(frame, exposure)
        for metric in measurable():
            if metric.name not in values:
                value, _ = measured_or_reason(metric.measure, shown, true)  # `Measurements.measure` tells the reason
                values |= {} if value is None else {metric.name: value}
        change = self._change(frame, shown, true)
        if change is not None:
            values["flicker"] = change
        return Figures(values, surveyed=True)

    def _change(self, frame: Frame, shown: np.ndarray, true: np.ndarray) -> float | None:
        """Return the flicker since the slot before, None if that was not measured. Rendered slots have no error."""
        slot, n = frame.slot, frame.setup.n
        if slot % (n + 1) == 1:
            self._flicker.cut()
            self._flicker.add(true, true)
        elif self._before != slot - 1:
            self._flicker.cut()
        self._before = slot
        return self._flicker.add(shown, true)


class Measurements:
    """Figures of slots by what they were made from, measured in the background: the slot on screen first.

    Attributes
    ----------
    faults : list of str
        Why figures could not be measured, since the last look.
    """

    def __init__(self, background: Jobs):
        self._background = background
        self._known: OrderedDict[Recipe, dict[int, Figures]] = OrderedDict()
        self._surveying: set[Key] = set()
        self._asked: set[Key] = set()  # slots on screen
        self._quick: deque[tuple[Key, Future]] = deque()
        self._slow: deque[tuple[Key, Future]] = deque()
        self._made: deque[tuple[Key, Figures]] = deque()
        self._measurers: dict[Recipe, Measurer] = {}
        self.faults: list[str] = []

    def of(self, recipe: Recipe) -> dict[int, Figures]:
        """Return the figures that are known, by slot."""
        known = self._known.setdefault(recipe, {})
        self._known.move_to_end(recipe)
        while len(self._known) > _RECIPES:
            dropped, _ = self._known.popitem(last=False)
            self._asked = {key for key in self._asked if key.recipe != dropped}
        return known

    def forget(self) -> None:
        """Drop everything after a change of the source."""
        self._known.clear()
        self._asked.clear()
        self._surveying.clear()

    def update(self) -> None:
        """Take what has been measured. Call once per frame of the interface."""
        while self._made:
            key, figures = self._made.popleft()
            self.note(key, figures)
            if figures.surveyed:
                self._surveying.discard(key)

    def note(self, key: Key, figures: Figures) -> None:
        """Add figures of a slot."""
        known = self.of(key.recipe)
        known[key.slot] = known.get(key.slot, Figures()).joined(figures)

    def measure(self, frame: Frame, exposure: float) -> None:
        """Measure a slot that is shown by every metric, if it has ground truth."""
        is_measurable = frame.moment.alpha and {names.FINAL, names.TRUTH} <= frame.images.keys()
        if not is_measurable or frame.key in self._asked:
            return
        self._asked.add(frame.key)
        known = self.of(frame.key.recipe).get(frame.key.slot, Figures()).values
        for slow, waiting, most in (
            (False, self._quick, 1 + _TO_MEASURE // frame.nbytes),
            (True, self._slow, _SLOW),
        ):
            job = self._background.run(self._by_metrics, frame, exposure, known, slow, soon=not slow)
            waiting.append((frame.key, job))
            while len(waiting) > most:
                key, oldest = waiting.popleft()
                if oldest.cancel():
                    self._asked.discard(key)

    def _by_metrics(self, frame: Frame, exposure: float, known: dict[str, float], slow: bool) -> None:
        shown, true = displayed(frame, exposure)
        for metric in measurable():
            if metric.slow == slow and metric.name not in known:
                value, reason = measured_or_reason(metric.measure, shown, true)
                if value is None:
                    self.faults.append(f"{metric.label} {reason}")
                else:
                    self._made.append((frame.key, Figures({metric.name: value})))

    def survey(self, frame: Frame, exposure: float) -> None:
        """Measure all quantities of a slot."""
        recipe, known = frame.key.recipe, self.of(frame.key.recipe).get(frame.key.slot, Figures()).values
        self._surveying.add(frame.key)
        if recipe not in self._measurers:
            self._measurers = {**dict(list(self._measurers.items())[-1:]), recipe: Measurer()}
        self._background.run(self._by_quantities, self._measurers[recipe], frame, exposure, known)

    def _by_quantities(self, measurer: Measurer, frame: Frame, exposure: float, known: dict[str, float]) -> None:
        figures = Figures({"kernels": sum(frame.milliseconds.values())}, surveyed=True)
        try:
            figures = measurer.measure(frame, exposure, known)
        finally:
            self._made.append((frame.key, figures))

    @property
    def surveying(self) -> frozenset[Key]:
        """Slots whose quantities are being measured."""
        return frozenset(self._surveying)


def displayed(frame: Frame, exposure: float) -> tuple[np.ndarray, np.ndarray]:
    """Return display values (H, W, 3) as shown and as they should be."""
    shown, true = (to_display(frame.images[name][..., :3], exposure) for name in (names.FINAL, names.TRUTH))
    return shown, true


def region_masks(frame: Frame, exposure: float) -> dict[str, np.ndarray]:
    """Return (H, W) bool by the names of `REGIONS`, and the "whole", of a generated slot with the layers
    `NEEDED_BY_REGION`; each pixel is in one region."""
    images, moment = frame.images, frame.moment
    depth, dynamic, holes = images[names.DEPTH], images[names.DYNAMIC] != 0, images[names.DISOCCLUDED] != 0
    outside = np.zeros_like(holes)
    outside[holes] = ~shows(moment.render_camera, *frame.render_size, world_positions(moment.camera, depth, holes))
    warped = images.get(names.GAE, images[names.FINAL])[..., :3]
    parts = {
        "out of screen": outside,
        "static disocclusion": holes,  # of any kind
        "silhouettes": steps(depth),
        "dynamic": dynamic,
        "focus": focus_mask(warped, images[names.TRUTH][..., :3], dynamic, exposure),
    }
    found = masks(labels_of(parts))
    return found | {"disoccluded": found["static disocclusion"]}


_MEAN = 20  # computed frames that the means are of


class Timings:
    """Milliseconds of the frames that were computed and shown last, each once: one that comes from the cache again has
    its old times, which do not count. Kernel times of shading correction include the time in the network."""

    def __init__(self):
        self._frames: deque[Frame] = deque(maxlen=_MEAN)

    def add(self, frame: Frame) -> None:
        """Add a shown frame, unless it is one of those that are there."""
        if all((frame.key, frame.wall_ms) != (other.key, other.wall_ms) for other in self._frames):
            self._frames.append(replace(frame, images={}))

    @property
    def text(self) -> str:
        """The frames that the means are of, in words."""
        count, generated = len(self._frames), sum(frame.moment.alpha > 0 for frame in self._frames)
        return f"mean of the last {count} computed frame{'s' * (count != 1)}, {generated} generated"

    def means(self) -> dict[str, float]:
        """Return the mean kernel times, milliseconds, of the stages that the last frame has."""
        times = [_by_stage(frame) for frame in self._frames]
        return {name: _mean([of.get(name, 0.0) for of in times]) for name in (times[-1] if times else ())}

    def of_stage(self, stage: str) -> dict[str, float]:
        """Return the mean times of a stage's kernels by their names, milliseconds."""
        found = [frame.kernels.get(stage, {}) for frame in self._frames]
        kernels = dict.fromkeys(name for of in found for name in of)
        return {name: _mean([of.get(name, 0.0) for of in found]) for name in kernels}

    def network(self) -> tuple[float, float]:
        """Return the mean times in the network's runtime, and of transfers to it and back, milliseconds."""
        times = [frame.milliseconds for frame in self._frames]
        inside, copies = (_mean([of.get(name, 0.0) for of in times]) for name in ("network", "network copies"))
        return inside, copies

    def walls(self) -> tuple[int, float, float]:
        """Return the number of those frames that followed the one before, and their mean times from taking the request
        to its images, and of reading back in it, milliseconds."""
        followed = [frame for frame in self._frames if frame.submitted <= 1]
        whole, readback = (_mean([getattr(frame, name) for frame in followed]) for name in ("wall_ms", "readback_ms"))
        return len(followed), whole, readback


def _by_stage(frame: Frame) -> dict[str, float]:
    taken = dict(frame.milliseconds)
    network = taken.pop("network", 0.0) + taken.pop("network copies", 0.0)
    return taken | ({"correction": taken["correction"] + network} if "correction" in taken else {})


def _mean(values: list[float]) -> float:
    return float(np.mean(values)) if values else 0.0
