"""Frames of a built-in scene, rendered while they are looked at."""

from __future__ import annotations

import copy
import math
from collections import OrderedDict
from dataclasses import dataclass, replace

import numpy as np

from gffe_cl.captures.offline.run import alphas_for
from gffe_cl.captures.offline.source import Live
from gffe_cl.captures.scenes import Scene, SceneFrames, SceneRenderer
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.rendered_frame import BYTES_PER_PIXEL, RenderedFrame
from gffe_cl.engine.inspection.explain.motion_trail import REMEMBERED
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.stages.base import read_some_rows
from .source import CACHE_BYTES, FrameSource

_LEAST_RING = 3  # the pipeline uses two frames in place
_TRUTHS = 4


@dataclass
class _LiveFrame:
    """A frame of a scene on the device, where it was rendered. `previous`: render camera that its motion refers to;
    `rows`: some rows of its depth, for an adaptive window."""

    k: int
    frame: RenderedFrame
    previous: Camera | None
    rows: np.ndarray | None


class SceneSource(Live, FrameSource):
    """A built-in scene, rendered on the engine's device and left there.

    The last frames are kept on the device: a warm-up takes them as they were played, so their windows may come from
    frames before it.

    `window`: "adaptive", "fixed:FACTOR" or "off" (None); `samples`: per pixel, at edges; `cache_bytes`: of rendered
    frames that are kept on the device, at least three frames.
    """

    live = windowed = has_truth = True

    def __init__(
        self,
        scene: Scene,
        device: Device,
        width: int,
        height: int,
        fps: float | None = None,
        window: str | None = None,
        count: int = 600,
        samples: int = 8,
        cache_bytes: int = CACHE_BYTES,
    ):
        self._whole, self._most = SceneRenderer(device, scene, width, height, samples), cache_bytes
        self._truths: OrderedDict[tuple, np.ndarray] = OrderedDict()
        super().__init__(scene, device, width, height, count, scene.fps if fps is None else fps, window or "off")
        self._empty_ring()
        self.configure(window, 1)

    def sibling(self):
        other = copy.copy(self)  # the renderer is shared, rendered frames are not: they are used in place
        other._frames, other._most = copy.copy(self._frames), self._most // 4
        other._empty_ring()
        other.restart()
        return other

    @property
    def nbytes(self):
        return sum(BYTES_PER_PIXEL) * math.prod(self.render_size) * len(self._ring)

    def _empty_ring(self) -> None:
        """Drop the frames on the device, and set how many of the present size may be kept."""
        self._ring: OrderedDict[tuple, _LiveFrame] = OrderedDict()
        self._ring_size = max(_LEAST_RING, self._most // (sum(BYTES_PER_PIXEL) * math.prod(self.render_size)))
        self.held = min(REMEMBERED, self._ring_size - 1)

    def configure(self, window, n, scale=0.0):
        size = self.render_size
        changed = self.choose(window or "off", alphas_for(n), scale)
        if self.render_size != size:
            self._empty_ring()
        return changed

    def _frames_for(self, scale):
        return super()._frames_for(scale) if scale else SceneFrames(self._whole)

    def restart(self):
        super().restart()
        self._before: _LiveFrame | None = None  # delivered last

    def camera(self, k, alpha):
        return self._frames.display_camera(self.time(k, alpha))

    def rendered(self, k):
        before = self._before if self._before and self._before.k == k - 1 else None
        self._before = made = self._made(k, before)
        if made.rows is not None:
            self._frames.windows.observe(made.rows)
        return replace(made.frame, reset=before is None)

    def truth(self, k, alpha):
        camera = self.camera(k, alpha)
        key = (k, alpha, *_bits(camera))
        if key not in self._truths:
            self._truths[key] = self._whole.render(self.time(k, alpha), camera).read("color")
            while len(self._truths) > _TRUTHS:
                self._truths.popitem(last=False)
        self._truths.move_to_end(key)
        return self._truths[key]

    def _made(self, k: int, before: _LiveFrame | None) -> _LiveFrame:
        """Return frame `k` after `before`; without one, the frame as it was made for the window in use, whichever frame
        was before it then."""
        shown = self.camera(k, 0.0)
        key = (k, *self._way, *_bits(shown))
        kept = self._ring.get(key)
        if kept is None or before is not None:
            last = before and before.frame
            camera = self._frames.render_camera(shown, last, k)
            if kept is None or last is None or (kept.frame.camera, kept.previous) != (camera, last.camera):
                self._ring[key] = self._render(k, shown, camera, last)
        self._ring.move_to_end(key)
        return self._ring[key]

    def _render(self, k: int, shown: Camera, camera: Camera, before: RenderedFrame | None) -> _LiveFrame:
        device, size = self._device, self.render_size
        image = self._frames.image(self.time(k), camera, before, k)
        if len(self._ring) >= self._ring_size:
            oldest = self._ring.popitem(last=False)[1].frame
            buffers = (oldest.color, oldest.depth, oldest.motion)
        else:
            color, depth, motion = (device.buffer(nbytes * size[0] * size[1]) for nbytes in BYTES_PER_PIXEL)
            buffers = color, depth, motion
        image.copy_to(buffers)
        rows = read_some_rows(device, buffers[1], size) if self._way[0] == "adaptive" else None
        return _LiveFrame(
            k,
            RenderedFrame(*buffers, camera=camera, time=self.time(k), display_camera=shown),
            before and before.camera,
            rows,
        )


def _bits(camera: Camera) -> tuple[bytes, tuple[float, ...]]:
    return camera.world_to_view.tobytes(), camera.intrinsics
