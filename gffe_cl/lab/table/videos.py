"""Metrics of whole sequences, or with networks of their own. They are optional and slow, and skipped with the reason
where they cannot run."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from gffe_cl.engine.core.errors import how_to_install


@dataclass(frozen=True)
class VideoMetric:
    """Metric of a whole sequence. `measure(shown, truth, fps)` takes lists of display values (H, W, 3), rendered and
    generated frames in the order of display, and the rate of display in frames per second; generated frames alone if
    `generated_only`. Other attributes are those of `gffe_cl.lab.metrics.Metric`."""

    name: str
    label: str
    measure: Callable[[list[np.ndarray], list[np.ndarray], float], float]
    unit: str = ""
    digits: int = 2
    higher_is_better: bool = True
    generated_only: bool = False


def _difference(package: str, metric: str, shown, truth, fps) -> float:
    """Return the figure of a metric of that package, in just-objectionable differences."""
    made = getattr(importlib.import_module(package), metric)(display_name="standard_fhd", heatmap=None)
    volumes = (np.stack(images).astype(np.float32) for images in (shown, truth))
    return float(made.predict(*volumes, dim_order="FHWC", frames_per_second=fps)[0])


def _lpips(shown, truth, fps) -> float:
    import lpips  # pyright: ignore[reportMissingImports]  # an extra
    import torch

    network = lpips.LPIPS(net="alex", verbose=False)
    values = []
    with torch.no_grad():
        for a, b in zip(shown, truth, strict=True):
            pair = [torch.from_numpy(image.transpose(2, 0, 1)[None] * 2 - 1).float() for image in (a, b)]
            values.append(float(network(*pair)))
    return float(np.mean(values))


VIDEO_METRICS = {
    metric.name: metric
    for metric in (
        VideoMetric("fvvdp", "FovVideoVDP", partial(_difference, "pyfvvdp", "fvvdp"), "JOD"),
        VideoMetric("cvvdp", "ColorVideoVDP", partial(_difference, "pycvvdp", "cvvdp"), "JOD"),
        VideoMetric("lpips", "LPIPS", _lpips, digits=4, higher_is_better=False, generated_only=True),
    )
}


def measured_or_reason(
    metric: VideoMetric, shown: list[np.ndarray], truth: list[np.ndarray], fps: float
) -> tuple[float | None, str | None]:
    """Return the figure, or the reason why there is none."""
    try:
        return metric.measure(shown, truth, fps), None
    except ModuleNotFoundError as error:
        return None, f"needs {error.name}: {how_to_install('metrics')}"
    except Exception as error:  # whatever other people's packages throw: weights that cannot be fetched, above all
        text = " ".join(str(error).split())[:160] or type(error).__name__
        return None, f"cannot run here: {text}"
