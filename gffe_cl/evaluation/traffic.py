"""Bytes per pixel that must move, from what the stages declare: exact, whatever the machine (`gffe bench`).

Every kernel declares what it reads and writes, and for which share of the pixels; the shares are counted in the frame.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from gffe_cl.inference.network import MULTIPLE
from gffe_cl.pipeline.pipeline import Pipeline
from gffe_cl.stages.background import REMEMBERED, SHOWN
from gffe_cl.stages.backward_blocks import SPLATTED, BackwardBlocks
from gffe_cl.stages.base import Kernel
from gffe_cl.stages.buffers import BY_HIDDEN_PART, BY_HOLE_FILLING, BY_NOTHING

_STILL = 1 / 64  # change of encoded colour from t − 1 to t + α


def still_tiles(frames: np.ndarray) -> np.ndarray:
    """(h/16, w/16) bool, from (8, h, w), what the network sees: whether nothing changes visibly within a tile from the
    frame before on, so that it cannot hold any focus."""
    change = np.abs(frames[:3] - frames[3:6]).max(0)
    height, width = change.shape
    return change.reshape(height // MULTIPLE, MULTIPLE, width // MULTIPLE, MULTIPLE).max((1, 3)) < _STILL


# Shares of the pixels by name, as `Access.share` has them: the buffer that tells, and which of its values count.
SHARES: dict[str, tuple[str, Callable[[np.ndarray], np.ndarray]]] = {
    "dynamic": ("history.dynamic_mask", lambda mask: mask != 0),
    "disoccluded": ("frame.disoccluded", lambda mask: mask != 0),
    "splatted": ("backward_blocks.block_class", lambda block: block == SPLATTED),
    "hidden parts": ("frame.filled_by", lambda label: label == BY_HIDDEN_PART),
    "mixed": ("warp.mixed", lambda mask: mask != 0),
    "unfilled": ("frame.filled_by", lambda label: (label == BY_HOLE_FILLING) | (label == BY_NOTHING)),
    "beyond reach": ("holes.downsampled_color", lambda sums: sums[..., 3] != 0),
    "remembered": ("background.state_0", lambda state: state == REMEMBERED),
    "not shown": ("background.state_0", lambda state: state != SHOWN),
    "layers": ("silhouettes.layer", lambda layer: layer != 0),
    "near silhouettes": ("silhouettes.marked", lambda marked: marked != 0),
    "softened": ("silhouettes.coverage", lambda coverage: coverage != 0),
    "focus": ("correction.focus_mask", lambda mask: mask != 0),
    "still tiles": ("correction.frames", still_tiles),  # of the network
}

# Parts by stage.
SCN = {
    "shading_trend": "SCN, trend", "shading": "SCN, inputs", "correction": "SCN, kernels", "network": "SCN, network",
    "network copies": "SCN, copies",
}  # fmt: skip
UPSCALING = ("upscaling", "sharpening")


def group(stage: str) -> str:
    """Whose work a stage is: "GAE", "SCN" or "upscaling"."""
    return "SCN" if stage in SCN else "upscaling" if stage in UPSCALING else "GAE"


def part(stage: str, when: str, kernel: str) -> str:
    """What the work of a stage after `submit` ("rendered") or in `extrapolate` ("extrapolated") is called in tables."""
    if stage == "background":
        return f"background, {'collection' if when == 'rendered' else 'projection'}"
    if stage == "correction" and kernel != "correct":
        return SCN["shading"]
    return SCN.get(stage, stage)


def counters(pipeline: Pipeline) -> dict[str, float]:
    """The share of the pixels that each of `SHARES` has in the present frame, 0 where its stage is off; and "holes":
    the disoccluded or mixed pixels, which the background may fill; "splatting": the source blocks that are splatted."""
    counted = {}
    for name, (buffer, counts) in SHARES.items():
        owner, _, rest = buffer.partition(".")
        found = pipeline.board.frame if owner == "frame" else pipeline.stages.get(owner)
        there = found and any(spec.name == rest for spec in found.buffers)
        counted[name] = float(counts(found.read(rest)).mean()) if there else 0.0
    return counted | {
        "holes": counted["disoccluded"] + counted["mixed"],
        "splatting": float(pipeline.stages[BackwardBlocks.name].splatting().mean()),
    }


Launches = dict[str, list[tuple[Kernel, dict[str, Any]]]]  # by stage: kernels, with what was given to each launch


def launches_of(pipeline: Pipeline, work: Callable[[], Any]) -> Launches:
    """What `work` makes the pipeline launch."""
    for stage in pipeline.stages.values():
        stage.launches = []
    try:
        work()
        return {name: stage.launches for name, stage in pipeline.stages.items()}
    finally:
        for stage in pipeline.stages.values():
            stage.launches = None


def bytes_per_pixel(pipeline: Pipeline, launches: Launches, shares: dict[str, float]) -> dict[str, dict[str, float]]:
    """Bytes per display pixel that launches must move, by stage and kernel; `shares`: of `counters`."""
    pixels = math.prod(pipeline.sizes.target)
    moved: dict[str, dict[str, float]] = {}
    for stage, launched in launches.items():
        by_kernel = moved.setdefault(stage, {})
        for kernel, given in launched:
            for _, _, access in kernel.accesses():
                share = shares[access.share] if isinstance(access.share, str) else access.share
                spec = pipeline.board.spec(access.buffer.format(**given))
                planes = spec.planes if access.planes is None else access.planes
                nbytes = spec.bytes_per_pixel * planes * math.prod(spec.size(pipeline.sizes)) * share
                by_kernel[kernel.name] = by_kernel.get(kernel.name, 0.0) + nbytes / pixels
    return moved


def memory(pipeline: Pipeline) -> dict[str, int]:
    """Bytes of device memory by stage, and "frame" for the extrapolated frame; rendered frames apart."""
    return {name: owner.nbytes for name, owner in ({"frame": pipeline.board.frame} | pipeline.stages).items()}
