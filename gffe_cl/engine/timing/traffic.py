"""Bytes per pixel that must move, by the stages' declarations: exact and independent of the machine (`gffe bench`).

Every kernel declares the buffers that it reads and writes, and for which share of the pixels; the shares are counted in
the frame.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.base import Access, Kernel, Share, share_of
from gffe_cl.engine.stages.commands import Commands, Launch

FOCUS = share_of("focus", "correction.focus_mask")  # where the network changes the frame

# Parts by stage.
SCN = {
    "shading_trend": "SCN, trend", "shading": "SCN, inputs", "network_input": "SCN, inputs",
    "shading_flow": "SCN, flow", "convolutions": "SCN, convolutions", "correction": "SCN, kernels",
    "network": "SCN, network", "network copies": "SCN, copies",
}  # fmt: skip


def group(stage: str) -> str:
    """Return the group of a stage in tables: "GAE", "SCN" or "upscaling"."""
    return "SCN" if stage in SCN else "upscaling" if stage == "upscaling" else "GAE"


def part(stage: str, when: str) -> str:
    """Return the name in tables of a stage's work after `submit` ("rendered") or in `extrapolate` ("extrapolated")."""
    if stage == "background":
        return f"background, {'collection' if when == 'rendered' else 'projection'}"
    return SCN.get(stage, stage)


def counters(pipeline: Pipeline) -> dict[str, float]:
    """Return the shares of pixels in the stages' declarations of reads and writes, counted in the present frame."""
    kernels = (kernel for stage in pipeline.stages.values() for kernel in stage.kernels)
    declared = (access.share for kernel in kernels for *_, access in kernel.accesses())
    shares = dict.fromkeys(share for share in declared if isinstance(share, Share))
    return {share.name: share.count(pipeline.board) for share in [*shares, FOCUS]}


Launches = dict[str, list[tuple[Kernel, Mapping[str, Any]]]]  # by stage: kernels, with the arguments of each launch


class CountingCommands(Commands):
    """Commands that are counted: `launches` are those of the pipeline's stages since they were last taken."""

    repeats = False

    def __init__(self, pipeline: Pipeline):
        super().__init__(pipeline.device)
        self._stages = (pipeline.board.blocks.name, *pipeline.stages)
        self.launches: Launches = {name: [] for name in self._stages}

    def launch(self, stage: Any, launch: Launch, given: Mapping[str, Any]) -> None:
        super().launch(stage, launch, given)
        self._note(stage, launch.declared, given)

    def fill(self, stage: Any, name: str, byte: int, grid: str) -> None:
        super().fill(stage, name, byte, grid)
        share = math.prod(stage.sizes.of(grid)) / math.prod(stage.spec(name).size(stage.sizes))
        self._note(stage, Kernel("fill", "once", writes={"": Access(f"{stage.name}.{name}", share)}), {})

    def take_launches(self) -> Launches:
        """Return `launches`, and begin anew."""
        taken, self.launches = self.launches, {name: [] for name in self._stages}
        return taken

    def _note(self, stage: Any, kernel: Kernel, given: Mapping[str, Any]) -> None:
        if stage.name in self.launches:
            self.launches[stage.name].append((kernel, given))


def launches_of(pipeline: Pipeline, work: Callable[[], Any]) -> Launches:
    """Return the launches of the pipeline during `work`."""
    board = pipeline.board
    before, board.commands = board.commands, (counting := CountingCommands(pipeline))
    try:
        work()
    finally:
        board.commands = before
        before.events += counting.events
    return counting.launches


def bytes_per_pixel(pipeline: Pipeline, launches: Launches, shares: dict[str, float]) -> dict[str, dict[str, float]]:
    """Return bytes per display pixel that launches must move, by stage and kernel; `shares`: of `counters`."""
    pixels = math.prod(pipeline.sizes.target)
    moved: dict[str, dict[str, float]] = {}
    for stage, launched in launches.items():
        by_kernel = moved.setdefault(stage, {})
        for kernel, given in launched:
            for _, _, access in kernel.accesses():
                share = shares[access.share.name] if isinstance(access.share, Share) else access.share
                spec = pipeline.board.spec(access.buffer.format(**given))
                planes = spec.planes if access.planes is None else access.planes
                nbytes = spec.bytes_per_pixel * planes * math.prod(spec.size(pipeline.sizes)) * share
                by_kernel[kernel.name] = by_kernel.get(kernel.name, 0.0) + nbytes / pixels
    return moved


def memory(pipeline: Pipeline) -> dict[str, int]:
    """Return bytes of device memory by stage, and "frame" for the extrapolated frame; rendered frames apart."""
    board = pipeline.board
    owners = {"frame": board.frame, board.blocks.name: board.blocks} | pipeline.stages
    return {name: owner.nbytes for name, owner in owners.items()}
