"""Metrics of images, defined once in `METRICS`, flicker, and the regions in which errors are counted. The viewer uses
nothing else of the lab.

Images are (H, W, 3) float arrays of display values in [0, 1].
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gffe_cl.engine.core.errors import how_to_install, require_packages
from gffe_cl.engine.core.validation import QUIETLY, require_array, require_exposure
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.transfer_function import to_display as to_display  # inputs of metrics

PSNR_CAP = 100.0  # dB
FOCUS_SMAPE = 0.5  # the paper's: errors above this are the shading correction network's business
SMAPE_EPSILON = np.float32(0.01)  # the paper's: keeps black pixels from counting fully
FOCUS = "focus"  # the region where shading is wrong without shading correction
_HALF_MAX = 65504.0
_SSIM_WINDOW = 7  # scikit-image's default


# ---- measurements --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Figure:
    """A figure of tables: its key `name` in JSON, and label, unit and number of digits for people."""

    name: str
    label: str
    unit: str = ""
    digits: int = 2
    higher_is_better: bool = True

    @property
    def title(self) -> str:
        """The label with its unit, for a table's column."""
        return f"{self.label}, {self.unit}" if self.unit else self.label

    def text(self, value: float | None, signed: bool = False) -> str:
        """Return a figure for people, "–" where it is not defined."""
        if value is None or not math.isfinite(value):
            return "–"
        return f"{round(value, self.digits) + 0.0:{'+' if signed else ''}.{self.digits}f}"  # no −0


@dataclass(frozen=True, kw_only=True)
class Metric(Figure):
    """One metric. The console, JSON, studies and the viewer take its name, unit and format from here.

    Attributes
    ----------
    map : callable
        Function of two images, shown and true, that returns the value of each pixel, (H, W) float; NaN where it is not
        defined.
    of_mean : callable
        The figure from the mean of the map over the pixels that are measured, of one image or of many.
    module, package : str
        Module that must be importable, and the package that pip installs for it.
    slow : bool
        Where people wait, it is measured after the others.
    """

    map: Callable[[np.ndarray, np.ndarray], np.ndarray]
    of_mean: Callable[[float], float] = float
    module: str = "numpy"
    package: str = "numpy"
    slow: bool = False

    def sentence(self, value: float) -> str:
        """Return a figure with its name and unit: "PSNR 31.20 dB"."""
        return f"{self.label} {self.text(value)} {self.unit}".rstrip()

    def measure(self, shown: np.ndarray, truth: np.ndarray, mask=None) -> float:
        """Return the metric over all pixels, or those where `mask` (H, W) is not 0; NaN if there are none."""
        total, count = _sum_over(self.map(shown, truth), mask)
        return self.of_mean(total / count) if count else float("nan")

    def missing(self) -> str | None:
        """Return None if the metric is available, else a sentence that names the package to install."""
        what = f"{self.label} needs {self.package}: {how_to_install('lab')}"
        try:
            importlib.import_module(self.module)
        except ModuleNotFoundError:
            return what
        except (ImportError, OSError) as error:
            return f"{what} ({error})"
        return None


def measurable() -> list[Metric]:
    """Return those of `METRICS` whose packages are installed, and import these."""
    return [metric for metric in METRICS.values() if metric.missing() is None]


def missing_metrics() -> list[str]:
    """Return a sentence for each metric whose package is not installed."""
    return [reason for metric in METRICS.values() if (reason := metric.missing())]


def measured_or_reason(measure: Callable[..., float], *given: Any) -> tuple[float | None, str | None]:
    """Return the figure that the `measure` of a metric gives, or the reason why there is none."""
    try:
        return measure(*given), None
    except ModuleNotFoundError as error:
        return None, f"needs {error.name}: {how_to_install('metrics')}"
    except Exception as error:  # whatever other people's packages throw: weights that cannot be fetched, above all
        text = " ".join(str(error).split())[:160] or type(error).__name__
        return None, f"cannot run here: {text}"


def squared_error(a, b) -> np.ndarray:
    """Return the squared error per pixel, the mean over RGB, as (H, W) float32."""
    return np.square(np.subtract(a, b, dtype=np.float32)).mean(-1)


def decibels(error: float) -> float:
    """Return the PSNR of a mean squared error, for peak 1: at most `PSNR_CAP`."""
    return PSNR_CAP if error <= 10 ** (-PSNR_CAP / 10) else float(-10 * np.log10(error))


def similarity(a, b) -> np.ndarray:
    """Return the structural similarity per pixel, mean over channels, as (H, W) float64; scikit-image's default with
    data_range=1.

    It is NaN where its window, 7×7, does not fit into the image. Source: Wang et al., Image Quality Assessment, TIP
    2004.
    """
    require_packages("SSIM", "lab", "skimage")
    from skimage.metrics import structural_similarity

    a, b = np.asarray(a), np.asarray(b)
    out, edge = np.full(a.shape[:2], np.nan), _SSIM_WINDOW // 2
    if min(a.shape[:2]) >= _SSIM_WINDOW:
        whole = structural_similarity(a, b, data_range=1, channel_axis=-1, full=True)[1]
        inner = (slice(edge, -edge),) * 2
        out[inner] = whole[inner].mean(-1, dtype=np.float64)
    return out


def flip_error(shown, truth) -> np.ndarray:
    """Return NVIDIA's FLIP per pixel, 0 … 1, as (H, W) float32. Raises ImportError where flip-evaluator is not
    installed."""
    from flip_evaluator import evaluate

    truth, shown = (np.ascontiguousarray(image, np.float32) for image in (truth, shown))
    return evaluate(truth, shown, "LDR", applyMagma=False)[0][..., 0]


METRICS = {
    metric.name: metric
    for metric in (
        Metric("psnr", "PSNR", "dB", map=squared_error, of_mean=decibels),
        Metric("ssim", "SSIM", digits=4, map=similarity, module="skimage.metrics", package="scikit-image"),
        Metric(
            "flip",
            "FLIP",
            digits=4,
            higher_is_better=False,
            map=flip_error,
            module="flip_evaluator",
            package="flip-evaluator",
            slow=True,
        ),
    )
}


@QUIETLY
def psnr(a: ArrayLike, b: ArrayLike, mask: ArrayLike | None = None) -> float:
    """Return the peak signal-to-noise ratio in dB for peak 1, over all pixels and channels, at most 100.

    `a`, `b` (H, W, 3): display values (`to_display`). `mask` (H, W) restricts the metric to the pixels where it is not
    0. The result is NaN if there are none. Raises GffeError for arrays of other shapes.
    """
    return METRICS["psnr"].measure(*_pair(a, b, mask))


@QUIETLY
def ssim(a: ArrayLike, b: ArrayLike, mask: ArrayLike | None = None) -> float:
    """Return the structural similarity, mean over pixels: Wang et al., Image Quality Assessment, TIP 2004, over 7×7
    pixels.

    `a`, `b` (H, W, 3): display values (`to_display`). `mask` (H, W) restricts the metric to the pixels where it is not
    0. The result is NaN for images smaller than 7×7. Raises GffeError for arrays of other shapes.
    """
    return METRICS["ssim"].measure(*_pair(a, b, mask))


def _pair(a, b, mask) -> tuple:
    """Return the three arrays, checked. Raises GffeError for arrays of other shapes."""
    height, width, _ = require_array(a, "metric: a", None, None, 3).shape
    b = require_array(b, "metric: b", height, width, 3)
    mask = None if mask is None else require_array(mask, "metric: mask", height, width, kinds="biuf")
    return np.asarray(a, np.float32), np.asarray(b, np.float32), mask


# ---- where -----------------------------------------------------------------------------------------------


def relative_error(a, b):
    """Return 2|a−b| / (|a|+|b|+0.01) of exposed linear colors, arrays or tensors: SMAPE is its mean over RGB."""
    return 2 * abs(a - b) / (abs(a) + abs(b) + SMAPE_EPSILON)


def focus_mask(color, truth, dynamic, exposure: float = 1.0) -> np.ndarray:
    """Return (H, W) bool: not `dynamic`, and SMAPE > 0.5 against each of the 3×3 pixels of the truth around (M_focus).

    `color` and `truth` are linear (H, W, 3).
    """
    factor = np.float32(require_exposure(exposure))
    shown, true = (_finite(image) * factor for image in (color, truth))
    height, width = shown.shape[:2]
    padded = np.pad(true, ((1, 1), (1, 1), (0, 0)), constant_values=np.nan)  # beyond the image nothing is alike
    least = np.full((height, width), np.inf, np.float32)
    for dy in range(3):
        for dx in range(3):
            error = relative_error(shown, padded[dy : dy + height, dx : dx + width])
            least = np.fmin(least, error[..., 0] + error[..., 1] + error[..., 2])
    return (least > np.float32(3 * FOCUS_SMAPE)) & (np.asarray(dynamic) == 0)


def shading_regions(focus, disoccluded) -> dict:
    """Return the masks, by name, in which shading correction is measured: in evaluation and in the validation of its
    training.

    `focus` (M_focus) and `disoccluded` (still invalid after crack closing) are bool arrays, or tensors, of one shape:
    focus pixels less disocclusions, these, and the whole.
    """
    return {FOCUS: focus & ~disoccluded, "disoccluded": disoccluded, "whole": disoccluded | ~disoccluded}


@dataclass
class RegionErrors:
    """Metrics of images against the truth, pooled over images, by region: all their pixels count alike.

    `pixels` are counted by region. `sums` of a metric's map, and `counts` of its defined pixels, are by metric and
    region.
    """

    pixels: dict[str, int] = field(default_factory=dict)
    sums: dict[str, dict[str, float]] = field(default_factory=dict)
    counts: dict[str, dict[str, int]] = field(default_factory=dict)

    def add(self, shown, truth, regions: dict[str, np.ndarray], metrics: Iterable[Metric]) -> None:
        """Add one image: display values (H, W, 3) and masks (H, W) by name."""
        _increase(self.pixels, {name: int(np.count_nonzero(mask)) for name, mask in regions.items()})
        for metric in metrics:
            values = metric.map(shown, truth)
            found = {name: _sum_over(values, mask) for name, mask in regions.items()}
            _increase(self.sums.setdefault(metric.name, {}), {name: total for name, (total, _) in found.items()})
            _increase(self.counts.setdefault(metric.name, {}), {name: count for name, (_, count) in found.items()})

    @classmethod
    def pooled(cls, several: Iterable[RegionErrors]) -> RegionErrors:
        total = cls()
        for one in several:
            _increase(total.pixels, one.pixels)
            for name in one.sums:
                _increase(total.sums.setdefault(name, {}), one.sums[name])
                _increase(total.counts.setdefault(name, {}), one.counts[name])
        return total

    def figure(self, metric: str, region: str) -> float:
        """Return the figure; NaN if the region is empty or was not measured."""
        count = self.counts.get(metric, {}).get(region, 0)
        return METRICS[metric].of_mean(self.sums[metric][region] / count) if count else float("nan")

    def share(self, region: str) -> float:
        """Return the region's share of the pixels in the region "whole"."""
        return self.pixels[region] / max(self.pixels["whole"], 1)

    def figures(self) -> dict[str, dict[str, float]]:
        """Return figures by region: its `share`, and every one of `METRICS` by name."""
        return {
            region: {"share": self.share(region), **{name: self.figure(name, region) for name in METRICS}}
            for region in self.pixels
        }


def _sum_over(values: np.ndarray, mask=None) -> tuple[float, int]:
    """Return the sum and number of the defined `values` (H, W) where `mask` is not 0."""
    values = values.ravel() if mask is None else values[np.asarray(mask) != 0]
    undefined = np.isnan(values)
    values = values[~undefined] if undefined.any() else values
    return float(values.sum(dtype=np.float64)), values.size


def _increase(into: dict, by: dict) -> None:
    for name, value in by.items():
        into[name] = into.get(name, 0) + value


def _finite(color) -> np.ndarray:
    color = np.nan_to_num(np.asarray(color)[..., :3].astype(np.float32), nan=0.0, posinf=np.inf, neginf=-np.inf)
    return np.clip(color, -_HALF_MAX, _HALF_MAX)


# ---- flicker -----------------------------------------------------------------------------------------------------

LUMA = np.array((0.2126, 0.7152, 0.0722), np.float32)
_SIGMA = 1 / 300  # of the image's height


class Flicker:
    """Sum of flicker over the frames of a sequence in the order of display: visible error when rendered and generated
    frames alternate.

    At 60 Hz people do not see the error of a single frame. They see that every second frame has one: lit edges that
    pulse, shadows that jump to and fro. The eye follows moving objects, so the difference between shown and true frame
    counts, not that between successive frames; and at 30 Hz it is only sensitive to coarse patterns, falling to half at
    about three cycles per degree (Kelly, Motion and vision II, JOSA 1979). So: error of the luma that is displayed
    (Rec. 709), blurred by a Gaussian of 1/300 of the image's height (half at three cycles per degree, seen from three
    heights), and of that the mean absolute change from each shown frame to the next, rendered ones included, in per
    cent of display white. A renderer without generated frames has 0. An error that stays the same over time does not
    flicker.
    """

    def __init__(self):
        self._before: np.ndarray | None = None
        self.sum, self.count = 0.0, 0

    def add(self, shown: np.ndarray, truth: np.ndarray) -> float | None:
        """Add display values (H, W, 3) of the next frame, as shown and as it should be. Return the change from the
        frame before, per cent; None for the first."""
        error = blurred((shown - truth) @ LUMA, _SIGMA * shown.shape[0])
        before, self._before = self._before, error
        if before is None:
            return None
        change = 100 * float(np.abs(error - before).mean())
        self.sum, self.count = self.sum + change, self.count + 1
        return change

    def cut(self) -> None:
        """Start a new sequence: the next frame is not displayed right after the last one added."""
        self._before = None

    @property
    def mean(self) -> float:
        """The mean over all changes; NaN if there were none."""
        return self.sum / self.count if self.count else float("nan")


def blurred(image: np.ndarray, sigma: float) -> np.ndarray:
    """Return (H, W) float32, blurred by a Gaussian of `sigma` pixels up to 4 sigma; the image is mirrored at its
    borders."""
    radius = int(4 * sigma + 0.5)
    weights = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2)
    weights = (weights / weights.sum()).astype(np.float32)
    for _ in range(2):  # along columns, then along rows
        padded = np.pad(image, ((radius, radius), (0, 0)), mode="symmetric")
        sums = np.zeros_like(image)
        for k, weight in enumerate(weights):
            sums += weight * padded[k : k + len(image)]
        image = np.ascontiguousarray(sums.T)
    return image


# ---- regions -----------------------------------------------------------------------------------------------------

# Regions in which errors are counted: every pixel of a new frame belongs to one.
#
# Disocclusions are the paper's three ('Disocclusions'): surfaces that a new frame shows and the rendered frame does not
# lie *out of screen*, or behind something that stands still (*static*) or moves (*dynamic*). On built-in scenes that is
# exact, from the renderer. On sequences without G-buffers of the new frame it comes from the pipeline's own masks: no
# better than these, but the same for all methods.
#
# By label; where several would hold, the first does.
REGIONS = {
    "out of screen": "it shows something outside of the rendered frame",
    "static disocclusion": "hidden in the rendered frame behind something that stands still",
    "dynamic disocclusion": "hidden in the rendered frame behind something that moves",
    "silhouettes": "beside a step in depth",
    "dynamic": "surfaces that move by themselves",
    "focus": "shading is wrong although geometry is not (the paper's focus pixels)",
    "rest": "everything else",
}
_LABEL = {name: number for number, name in enumerate(REGIONS)}
_SAME_SURFACE = 0.02  # of the depth
_STEP = 0.1  # of the depth, from which two neighbors are two surfaces
_SKY = 1e7  # world units


def masks(labels: np.ndarray) -> dict[str, np.ndarray]:
    """Return masks (H, W) bool by name of the region, and "whole"."""
    found = {name: labels == number for name, number in _LABEL.items()}
    return found | {"whole": np.ones(labels.shape, bool)}


def labels_of(parts: dict[str, np.ndarray]) -> np.ndarray:
    """Return labels (H, W) uint8 of masks by name; the first of `REGIONS` wins."""
    labels = np.full(parts["dynamic"].shape, _LABEL["rest"], np.uint8)
    for name in reversed(REGIONS):
        if name in parts:
            labels[parts[name]] = _LABEL[name]
    return labels


def same_surface(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return whether depths are one surface's, to 2%; both infinite, or neither."""
    with np.errstate(invalid="ignore"):
        return np.where(np.isinf(b), np.isinf(a), np.abs(a - b) <= _SAME_SURFACE * np.abs(b))


def steps(depth: np.ndarray) -> np.ndarray:
    """Return (H, W) bool: pixels with a neighbor, of four, at another depth."""
    found = np.zeros(depth.shape, bool)
    for axis in (0, 1):
        a, b = (np.take(depth, range(k, depth.shape[axis] - 1 + k), axis) for k in (0, 1))
        with np.errstate(invalid="ignore"):
            step = np.where(np.isfinite(a) & np.isfinite(b), np.abs(a - b) > _STEP * np.minimum(a, b), a != b)
        step &= ~(np.isinf(a) & np.isinf(b))
        first = [slice(None)] * 2
        second = [slice(None)] * 2
        first[axis], second[axis] = slice(None, -1), slice(1, None)
        found[tuple(first)] |= step
        found[tuple(second)] |= step
    return found


def shows(camera: Camera, width: int, height: int, world_pos: np.ndarray) -> np.ndarray:
    """Return (N,) bool: whether world positions (N, 3) lie before `camera` and within its image, hidden or not."""
    px, depth = camera.project(world_pos)
    with np.errstate(invalid="ignore"):
        return (depth > 0) & (px >= 0).all(-1) & (px < (width, height)).all(-1)


def world_positions(camera: Camera, depth: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return the world positions (N, 3) of the pixels of `mask`; sky is put very far away."""
    y, x = np.nonzero(mask)
    z = depth[mask].astype(np.float64)
    return camera.unproject(np.stack([x + 0.5, y + 0.5], -1), np.where(np.isinf(z), _SKY, z))
