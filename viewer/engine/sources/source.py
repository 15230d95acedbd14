"""Interface of the viewer's sources of frames."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from typing import Protocol

import numpy as np

from gffe_cl.captures.offline.source import Source
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.frame_format import FrameFormat
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.inspection.explain.motion_trail import REMEMBERED

CACHE_BYTES = 512 << 20  # of frames that a source keeps


class FrameSource(Source, Protocol):
    """Source whose frames are looked at. All but `time` is called from one thread, the engine's.

    `target`: how the user named it; `render_size` may change with `configure`; `live`: rendered meanwhile; `windowed`:
    rendered through a window that can be used or not; `held`: of the frames delivered last, so many stay as they are;
    `suspicions`: sentences about the whole, more of them may come; `changed_on_disk`: files of its frames are others
    than when it was opened; `nbytes`: bytes of frames that it keeps, unless the source that it is a sibling of counts
    them; `format`: the description of `stored` frames.
    """

    target: str = ""
    live: bool = False
    windowed: bool = False
    has_truth: bool = False
    held: int = REMEMBERED
    suspicions: Iterable[str] = ()
    changed_on_disk: bool = False
    nbytes: int = 0
    format: FrameFormat | None = None

    def sibling(self) -> FrameSource:
        """Return a source of the same frames for another pipeline on the same thread, with its own window and
        position. Files are shared; `close` affects this one only."""
        return copy.copy(self)

    def configure(self, window: str | None, n: int, scale: float = 0.0) -> bool:
        """Use rendering window `window` for `n` generated frames per rendered one, and `scale` where frames are
        rendered meanwhile. Returns whether rendered frames change by that. Raises GffeError for a window that this
        source does not have."""
        ...

    def restart(self) -> None:
        """Start anew: the next frame asked for has none before it."""

    def camera(self, k: int, alpha: float) -> Camera | None:
        """Return the display camera at `time(k, alpha)`; None unless it and those of the other new frames of the
        interval are known."""

    def truth(self, k: int, alpha: float) -> np.ndarray | None:
        """Return (H, W, 3) linear RGB, float16 or float32: the ground truth at `time(k, alpha)`, None if there is
        none."""

    def stored(self, k: int) -> RenderedFrame | None:
        """Return rendered frame `k` as an engine stored it, for a pipeline with `format`; None where it is stored in
        our conventions, or where only a part of it is used."""

    def grow(self) -> bool:
        """Take over frames that were added at the end since it was opened. Returns whether there are any."""
        return False

    def look_closer(self) -> None:
        """Start the search for `suspicions`, after the first slot is made."""

    def close(self) -> None:
        """Stop background work."""
