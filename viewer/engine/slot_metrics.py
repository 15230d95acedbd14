"""Metrics of a generated slot against ground truth: figures for the plot, and the regions of its errors."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from gffe_cl.lab.metrics import METRICS, focus_mask, squared_error, to_display
from gffe_cl.lab.metrics.flicker import Flicker
from gffe_cl.lab.metrics.regions import REGIONS as _TABLE
from gffe_cl.lab.metrics.regions import shows, steps, world_positions
from . import names
from .messages import Result

NEEDED = frozenset({names.FINAL, names.GAE, names.TRUTH, names.DEPTH, names.DYNAMIC, names.DISOCCLUDED})

# As the table of methods has them (gffe_cl/lab/metrics/regions.py), found by the pipeline; the first that holds counts.
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

    def text(self, value: float) -> str:
        return f"{value:.{self.digits}f} {self.unit}".rstrip()


QUANTITIES = {
    "psnr": Quantity("PSNR", "dB", -1),
    "flip": Quantity("FLIP", "", 1, 4),
    "flicker": Quantity("flicker", "%", 1, 3),
    "disoccluded": Quantity("disoccluded", "%", 1),
    "kernels": Quantity("kernel time", "ms", 1),
}


@dataclass(frozen=True)
class Part:
    """A region: its share of the pixels and of the squared error, 0 to 1; its squared error as a mean over the whole
    image; and PSNR in it (NaN if it is empty)."""

    pixels: float
    error: float
    squared: float
    psnr: float

    @classmethod
    def of(cls, pixels: float, squared: float, whole: float) -> Part:
        """Return a region with a share `pixels` of the image; `squared` is its squared error and `whole` that of all
        regions, both as means over the whole image."""
        psnr = METRICS["psnr"].of_mean(squared / pixels) if pixels else float("nan")
        return cls(pixels, squared / whole if whole > 0 else 0.0, squared, psnr)


@dataclass(frozen=True)
class Figures:
    """Figures of one slot: by the names of `QUANTITIES`, as far as they are known, and by region."""

    values: dict[str, float]
    parts: dict[str, Part] = field(default_factory=dict)


class Measurer:
    """Figures of slots of one setup, in the order of display as far as flicker is to be known."""

    def __init__(self):
        self._flicker = Flicker()
        self._before: int | None = None

    def measure(self, result: Result, exposure: float) -> Figures:
        """Return the figures of a generated slot, as far as its layers allow; `NEEDED` are the layers for all of
        them."""
        values = {"kernels": sum(result.milliseconds.values())}
        holes = result.images.get(names.DISOCCLUDED)
        if holes is not None:
            values["disoccluded"] = 100 * float(np.count_nonzero(holes)) / holes.size
        if result.images.get(names.TRUTH) is None:
            self._before = None
            return Figures(values)
        shown, true = displayed(result, exposure)
        for name in ("psnr", "flip"):
            if not METRICS[name].missing():
                values[name] = METRICS[name].measure(shown, true)
        change = self._change(result, shown, true)
        if change is not None:
            values["flicker"] = change
        return Figures(values, parts_of(region_labels(result, exposure), squared_error(shown, true)))

    def _change(self, result: Result, shown: np.ndarray, true: np.ndarray) -> float | None:
        """Return the flicker since the slot before, None if that was not measured. Rendered slots have no error."""
        slot, n = result.request.slot, result.request.setup.n
        if slot % (n + 1) == 1:
            self._flicker.cut()
            self._flicker.add(true, true)
        elif self._before != slot - 1:
            self._flicker.cut()
        self._before = slot
        return self._flicker.add(shown, true)


def displayed(result: Result, exposure: float) -> tuple[np.ndarray, np.ndarray]:
    """Return display values (H, W, 3) as shown and as they should be."""
    shown, true = (to_display(result.images[name][..., :3], exposure) for name in (names.FINAL, names.TRUTH))
    return shown, true


def out_of_screen(result: Result, holes: np.ndarray) -> np.ndarray:
    """Return (H, W) bool: the pixels of `holes`, in a generated slot, that lie outside of the rendered frame's view.
    Needs the layer `names.DEPTH`."""
    moment, outside = result.moment, np.zeros_like(holes)
    width, height = result.render_size
    world = world_positions(moment.camera, result.images[names.DEPTH], holes)
    outside[holes] = ~shows(moment.render_camera, width, height, world)
    return outside


def region_labels(result: Result, exposure: float) -> np.ndarray:
    """Return (H, W) uint8: the region of each pixel, as an index into `REGIONS`, of a generated slot with the layers
    `NEEDED`."""
    images = result.images
    depth, dynamic = images[names.DEPTH], images[names.DYNAMIC] != 0
    holes = images[names.DISOCCLUDED] != 0
    outside = out_of_screen(result, holes)
    warped = images.get(names.GAE, images[names.FINAL])[..., :3]
    masks = {
        "out of screen": outside,
        "disoccluded": holes,
        "silhouettes": steps(depth),
        "dynamic": dynamic,
        "focus": focus_mask(warped, images[names.TRUTH][..., :3], dynamic, exposure),
    }
    labels = np.full(holes.shape, len(REGIONS) - 1, np.uint8)
    for number, name in reversed(list(enumerate(REGIONS))):
        if name in masks:
            labels[masks[name]] = number
    return labels


def parts_of(labels: np.ndarray, squared: np.ndarray) -> dict[str, Part]:
    """Return the regions' shares and errors by name. `labels`: (H, W) indices into `REGIONS`; `squared`: (H, W) squared
    error of display values."""
    counts = np.bincount(labels.ravel(), minlength=len(REGIONS))
    sums = np.bincount(labels.ravel(), squared.ravel(), minlength=len(REGIONS))
    parts = (float(sums[number]) / labels.size for number in range(len(REGIONS)))
    whole = float(sums.sum()) / labels.size
    return {
        name: Part.of(float(count) / labels.size, part, whole)
        for name, count, part in zip(REGIONS, counts, parts, strict=True)
    }
