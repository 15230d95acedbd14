"""Parts of a frame's work in tables, and the memory of stages."""

from __future__ import annotations

from gffe_cl.engine.pipeline.pipeline import Pipeline

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


def memory(pipeline: Pipeline) -> dict[str, int]:
    """Return bytes of device memory by stage, and "frame" for the extrapolated frame; rendered frames apart."""
    board = pipeline.board
    owners = {"frame": board.frame, board.blocks.name: board.blocks} | pipeline.stages
    return {name: owner.nbytes for name, owner in owners.items()}
