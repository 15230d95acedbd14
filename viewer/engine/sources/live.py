"""Frames of a built-in scene, rendered while they are looked at; its camera may be flown."""

from __future__ import annotations

import copy
import math
import threading
from bisect import bisect_left, bisect_right, insort
from collections import OrderedDict
from dataclasses import dataclass, replace

import numpy as np

from gffe_cl.captures.offline.run import alphas_for
from gffe_cl.captures.offline.source import Live
from gffe_cl.captures.scenes import Scene, SceneFrames, SceneRenderer
from gffe_cl.engine.frame.camera import Camera, predict_camera
from gffe_cl.engine.frame.rendered_frame import BYTES_PER_PIXEL, RenderedFrame
from gffe_cl.engine.inspection.explain.motion_trail import REMEMBERED
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.stages.base import read_some_rows
from .source import CACHE_BYTES, FrameSource

_LEAST_RING = 3  # the pipeline uses two frames in place
_TRUTHS = 4
_LONGEST_GAP = 8.0  # rendered frames between two flown poses that are of one flight


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

    The camera follows the scene's path where it has not been flown. The last frames are kept on the device: a warm-up
    takes them as they were played, so their windows may come from frames before it.

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
        self._flown: dict[float, Camera] = {}  # by k + alpha
        self._flown_at: list[float] = []  # its keys in order
        self._flown_last = -1.0  # key of the last call of `fly`
        self._lock = threading.Lock()  # of the flown poses
        super().__init__(scene, device, width, height, count, scene.fps if fps is None else fps, window or "off")
        self._empty_ring()
        self.configure(window, 1)

    def sibling(self):
        other = copy.copy(self)  # renderer and poses are shared, rendered frames are not: they are used in place
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
        self._seen: dict[int, Camera] = {}  # display cameras of the frames delivered since then
        self._was_flown = False  # when one of them was delivered

    def outdated(self, k, alpha):
        if not (self._flown or self._was_flown):
            return False
        changed = [(seen, camera) for seen, camera in self._seen.items() if self.camera(seen, 0.0) != camera]
        with self._lock:
            for seen, camera in changed:
                if seen not in self._flown or (seen, 0.0) == (k, alpha):
                    return True
                self._flown[seen] = camera  # the new pose came too late
        return False

    def fly(self, k: int, alpha: float, camera: Camera, flight: int) -> None:
        """Fly the camera: from now on `camera` (display pixels) sees the scene at `time(k, alpha)`; `flight`: a new
        number for each pose. May be called from any thread.

        Calls follow each other as a flight does: it moves evenly from one pose to the next if that is at most eight
        rendered frames later, and replaces what was flown in between. A new pose of a rendered frame that has been
        used already is taken only if that frame itself is shown next.
        """
        at = k + alpha
        with self._lock:
            self.flight = flight
            if self._flown_last < at <= self._flown_last + _LONGEST_GAP:
                skipped = slice(bisect_right(self._flown_at, self._flown_last), bisect_left(self._flown_at, at))
                for between in self._flown_at[skipped]:
                    del self._flown[between]
                del self._flown_at[skipped]
            self._flown_last = at
            self._record(at, camera)

    def _record(self, at: float, camera: Camera) -> None:
        if at not in self._flown:
            insort(self._flown_at, at)
        self._flown[at] = camera

    def forget_flight(self) -> None:
        """Put the camera back on the scene's own path. May be called from any thread."""
        with self._lock:
            self._flown.clear()
            self._flown_at.clear()
            self._flown_last, self.flight = -1.0, 0

    def camera(self, k, alpha):
        return self._flown_camera(k + alpha) or self._frames.display_camera(self.time(k, alpha))

    def _flown_camera(self, at: float) -> Camera | None:
        with self._lock:
            if at in self._flown:
                return self._flown[at]
            after = bisect_left(self._flown_at, at)
            if not 0 < after < len(self._flown_at):
                return None
            start, end = self._flown_at[after - 1 : after + 1]
            if end - start > _LONGEST_GAP:
                return None
            return predict_camera(self._flown[start], self._flown[end], (at - end) / (end - start))

    def rendered(self, k):
        before = self._before if self._before and self._before.k == k - 1 else None
        self._before = made = self._made(k, before)
        self._seen[k], self._was_flown = made.frame.shown_camera, self._was_flown or bool(self._flown)
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
        flown = self._flown_camera(k)
        shown = flown or self.camera(k, 0.0)
        if flown:
            with self._lock:
                self._record(float(k), flown)  # past poses are replayed, independent of later ones
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
