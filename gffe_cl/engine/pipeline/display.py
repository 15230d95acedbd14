"""Display of rendered frames: one that was rendered through a window is resampled to its display camera."""

from __future__ import annotations

import pyopencl as cl

from gffe_cl.engine.frame.rendered_frame import is_shown_whole
from gffe_cl.engine.pipeline.rendered_frames import RenderedFrames
from gffe_cl.engine.stages.base import Board
from gffe_cl.engine.stages.buffers import DeviceFrame
from gffe_cl.engine.stages.presentation import Presentation


class Display:
    """Display of a pipeline's rendered `frames`. `presentation` is the stage that resamples them, None until a frame
    needs it."""

    def __init__(self, board: Board, frames: RenderedFrames):
        self._board, self._frames = board, frames
        self.presentation: Presentation | None = None

    def prepare(self) -> None:
        """Make the stage if the current frame needs it."""
        if self.presentation is None and not self._shown_whole(self._frames.needed):
            self.presentation = Presentation(self._board)

    @property
    def resampling(self) -> Presentation | None:
        """The stage if the current frame is resampled, or the one before was, whose motion must be converted."""
        frames = self._frames.current, self._frames.previous
        return self.presentation if any(frame and not self._shown_whole(frame) for frame in frames) else None

    def show(self, with_color: bool) -> tuple[cl.Buffer, cl.Buffer, cl.Buffer]:
        """Return color, depth and motion of the current frame as displayed, color as rendered unless `with_color`."""
        frame = self._frames.shown
        assert frame is not None  # as there is a current one
        if not (stage := self.resampling):
            return frame.buffers
        stage.present(frame, self._frames.previous, with_color)
        return stage.buffer["color"], stage.buffer["depth"], stage.buffer["motion"]

    def _shown_whole(self, frame: DeviceFrame) -> bool:
        sizes = self._board.sizes
        return sizes.source == sizes.target and is_shown_whole(frame.camera, frame.display_camera)
