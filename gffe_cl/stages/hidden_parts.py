"""Hidden parts of movers: disocclusions that belong to a moving object, not to the background (beyond the paper)."""

from __future__ import annotations

from gffe_cl.stages.base import Access, Board, Kernel, Stage, Step, reprojection, zoom

_FILLED = {name: Access(f"frame.{name}", "hidden parts") for name in ("color", "depth", "motion", "filled_by")}


class HiddenParts(Stage):
    """Decides which disocclusions are a mover's own, hidden in the rendered frame, and continues it into them."""

    name = "hidden_parts"
    kernels = (
        Kernel(
            "fill_hidden_parts",
            "target",
            {
                "source_depth": Access("rendered.depth", "hidden parts"),
                "block_class": "backward_blocks.block_class",
                "disoccluded": Access("frame.disoccluded", "splatted"),
                "is_dynamic": Access("frame.dynamic", "disoccluded"),
                "color": Access("frame.color", "hidden parts"),
                "depth": Access("frame.depth", "hidden parts"),
                "motion": Access("frame.motion", "hidden parts"),
            },
            _FILLED,
            step=("RUN", "LANES"),
        ),
    )

    def __init__(self, board: Board):
        self.reach = max(8, board.sizes.target[0] // 48)  # px, in which movers are looked for
        super().__init__(board)

    @classmethod
    def is_wanted(cls, options) -> bool:
        return options.hidden_parts and options.motion

    def extrapolated(self, step: Step) -> None:
        self.launch(
            "fill_hidden_parts",
            reach=self.reach,
            zoom=zoom(step.frame.camera, step.camera),
            to_source=reprojection(step.camera, step.frame.camera),
        )
