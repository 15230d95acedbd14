"""Contract of watchers of a pipeline. The program that runs the pipeline calls them on its own thread."""

from __future__ import annotations

from typing import Any, Protocol

from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.pipeline.made_frame import ExtrapolatedFrame
from gffe_cl.engine.stages.buffers import DeviceFrame


class Watcher(Protocol):
    """Contract of `Pipeline.watcher`. The argument `pipeline` is the one that calls. Methods raise nothing."""

    def before(self, pipeline: Any, rendered: bool = False) -> None:
        """React to a frame that will be made. `rendered`: a rendered one is being submitted; options may be changed
        now."""

    def submitted(self, pipeline: Any, frame: RenderedFrame, on_device: DeviceFrame) -> None:
        """React to `frame`, which was submitted. Its pixels are `on_device`; all work that is due for it is
        enqueued."""

    def extrapolated(self, pipeline: Any, frame: ExtrapolatedFrame) -> None:
        """React to `frame`, which was extrapolated: its kernels are enqueued."""
