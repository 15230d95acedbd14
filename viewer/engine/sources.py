"""Where the viewer's frames come from: a sequence on disk, or a built-in scene rendered meanwhile."""

from __future__ import annotations

import threading
from bisect import bisect_left, bisect_right, insort
from collections import OrderedDict
from collections.abc import Callable, Hashable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from gffe_cl.camera import Camera, predict_camera
from gffe_cl.errors import GffeError
from gffe_cl.frame import BYTES_PER_PIXEL, PackedFrame, RenderedFrame, pack_frame
from gffe_cl.opencl.device import Device
from gffe_cl.run import alphas_for
from gffe_cl.scenes import Scene, SceneFrames, SceneRenderer
from gffe_cl.sequence import Sequence
from gffe_cl.source import Recorded
from gffe_cl.stage import read_some_rows
from gffe_cl.stages.presentation import present
from gffe_cl.window import WindowChooser

CACHE_BYTES = 512 << 20
_AHEAD = 2  # frames read ahead
_LEAST_RING = 3  # the pipeline uses two frames in place
_TRUTHS = 4
_PAST = 9  # rendered frames that a seek submits: only their poses can make what is shown outdated
_LONGEST_GAP = 8.0  # rendered frames between two flown poses that are of one flight


class FrameSource(Protocol):
    """Rendered frames by number. All but `fly`, `forget_flight` and `time` is called from one thread, the engine's.

    `target`: how the user named it; `width`, `height`: of the display, pixels; `render_size`: (width, height) of the
    rendered frames, may change with `configure`; `count`: of rendered frames; `live`: rendered meanwhile, the camera
    may be flown; `windowed`: rendered through a window that can be used or not; `resets`: numbers of the frames
    that are told to be one, in order.
    """

    name: str
    width: int
    height: int
    render_size: tuple[int, int]
    fps: float
    exposure: float
    count: int
    target: str = ""
    live: bool = False
    windowed: bool = False
    resets: tuple[int, ...] = (0,)
    has_truth: bool = False

    def configure(self, window: str | None, n: int) -> bool:
        """Use rendering window `window` for `n` generated frames per rendered one; whether rendered frames change by
        that. Raises GffeError for a window that this source does not have."""

    def restart(self) -> None:
        """The next frame asked for has none before it."""

    def outdated(self, k: int, alpha: float) -> bool:
        """Whether frames delivered since `restart` must be delivered anew before `time(k, alpha)` is shown."""
        return False

    def reset_before(self, k: int) -> int:
        """Number of the last reset frame up to `k`."""
        return 0

    def rendered(self, k: int) -> RenderedFrame:
        """Frame `k`, of host arrays or device buffers. Raises GffeError."""

    def packed(self, k: int) -> PackedFrame | None:
        """`pack_frame` of frame `k`; None where `rendered` gives device buffers."""

    def camera(self, k: int, alpha: float) -> Camera | None:
        """Display camera at `time(k, alpha)`, if it and those of the other new frames of the interval are known."""

    def truth(self, k: int, alpha: float) -> np.ndarray | None:
        """(H, W, 3) linear RGB, float16 or float32: the ground truth at `time(k, alpha)`, if there is one."""

    def time(self, k: int, alpha: float = 0.0) -> float:
        """Seconds: of frame `k`, and `alpha` times the interval before it later."""

    def warnings(self) -> list[str]:
        """Legal but suspicious things met so far."""
        return []

    def close(self) -> None:
        """Stops what runs beside."""


class RecordedSource(Recorded, FrameSource):
    """A sequence on disk, its decoded frames cached.

    `device` presents the display part for the window "off"; None is the window it was rendered through. `cache_bytes`:
    of decoded frames that are kept. Raises GffeError as `gffe_cl.source.Recorded` does; for faults of a file when its
    frame is asked for.
    """

    def __init__(self, sequence: Sequence, device: Device, window: str | None = None, cache_bytes: int = CACHE_BYTES):
        super().__init__(sequence, device, "off")
        self.windowed = self._cut
        super().__init__(sequence, device, window)
        self.name = sequence.path.resolve().name
        self.suspicions: list[str] = []  # sentences, beside what reading warns of
        self._chosen = window
        self._entries = sequence.rendered
        self.resets = tuple(k for k, entry in enumerate(self._entries) if entry.reset or k == 0)
        truths = sequence.ground_truth
        self._next_truth = dict(zip((entry.file for entry in truths), truths[1:], strict=False))
        self.has_truth = bool(truths)
        self._alphas = alphas_for(1)
        self._cache = _ReadAhead(cache_bytes)

    def configure(self, window, n):
        self._alphas = alphas_for(n)
        if window == self._chosen:
            return False
        before = self._cut
        super().__init__(self.sequence, self._device, window)
        self._chosen = window
        return self._cut != before

    def warnings(self):
        return [*super().warnings(), *self.suspicions]

    def reset_before(self, k):
        return self.resets[bisect_right(self.resets, k) - 1]

    def rendered(self, k):
        return self._frame(k)[0]

    def packed(self, k):
        return self._frame(k)[1]

    def camera(self, k, alpha):
        cameras = self.cameras_at([self.time(k, new) for new in self._alphas])
        return cameras and cameras[self._alphas.index(alpha)]

    def time(self, k, alpha=0.0):
        time = self._entries[k].time
        first = k == 0 or self._entries[k].reset
        return time + alpha * (1.0 / self.fps if first else time - self._entries[k - 1].time)

    def truth(self, k, alpha):
        entry = self.sequence.at("ground_truth", self.time(k, alpha))
        if entry is None:
            return None
        color = self._cache.get(("truth", entry.file), lambda: self.sequence.read_color(entry))
        following = self._next_truth.get(entry.file)
        ahead = {("truth", following.file): lambda: self.sequence.read_color(following)} if following else {}
        self._cache.ahead("truth", ahead)
        if color.shape[:2] != (self.height, self.width):
            raise GffeError(
                f"{entry.file}: {color.shape[1]}×{color.shape[0]} pixels, expected {self.width}×{self.height}"
            )
        return color

    def close(self):
        self._cache.close()

    def _frame(self, k: int) -> tuple[RenderedFrame, PackedFrame]:
        made = self._cache.get(("shown", k), lambda: self._shown(k)) if self._cut else self._as_rendered(k)
        following = [(k + i) % self.count for i in range(1, _AHEAD + 1)]
        self._cache.ahead("rendered", {("rendered", m): lambda m=m: self._read(m) for m in following})
        return made

    def _as_rendered(self, k: int) -> tuple[RenderedFrame, PackedFrame]:
        return self._cache.get(("rendered", k), lambda: self._read(k))

    def _read(self, k: int) -> tuple[RenderedFrame, PackedFrame]:
        frame = self.sequence.read(self._entries[k])
        packed = pack_frame(frame, *np.shape(frame.depth))
        motion = None if frame.motion is None else packed.motion
        return replace(frame, color=packed.color, depth=packed.depth, motion=motion), packed

    def _shown(self, k: int) -> tuple[RenderedFrame, PackedFrame]:
        """The display part; bad pixels are those of the whole."""
        frame, packed = self._as_rendered(k)
        entry = self._entries[max(k - 1, 0)]
        before = replace(frame, camera=entry.render_camera, display_camera=entry.display_camera)
        shown = present(frame, before, size=self.render_size, device=self._device)
        return shown, replace(pack_frame(shown, self.height, self.width), bad=packed.bad)


class _ReadAhead:
    """Results of reading, by (kind, …): the last `nbytes` of them are kept, some are read ahead on a thread."""

    def __init__(self, nbytes: int):
        self._most, self._bytes = nbytes, 0
        self._kept: OrderedDict[Hashable, Any] = OrderedDict()
        self._coming: dict[tuple, Future] = {}
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="gffe-viewer-read")

    def get(self, key: tuple, read: Callable[[], Any]) -> Any:
        """What was kept or comes, else what `read` returns; raises what reading raised, and tries again next time."""
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        future = self._coming.pop(key, None)
        value = self._kept[key] = read() if future is None else future.result()
        self._bytes += _nbytes(value)
        while self._bytes > self._most and len(self._kept) > 1:
            self._bytes -= _nbytes(self._kept.popitem(last=False)[1])
        return value

    def ahead(self, kind: str, wanted: dict[tuple, Callable[[], Any]]) -> None:
        """Read `wanted` next, and nothing else of this kind."""
        for key in [key for key in self._coming if key[0] == kind and key not in wanted]:
            self._coming.pop(key).cancel()
        for key, read in wanted.items():
            if key not in self._kept and key not in self._coming:
                self._coming[key] = self._pool.submit(read)

    def close(self) -> None:
        self._pool.shutdown(wait=False, cancel_futures=True)


def _nbytes(value: np.ndarray | tuple[RenderedFrame, PackedFrame]) -> int:
    if isinstance(value, np.ndarray):
        return value.nbytes
    return sum(array.nbytes for array in (value[1].color, value[1].depth, value[1].motion))


@dataclass
class _Made:
    """A frame of a scene on the device, where it was rendered. `previous`: render camera that its motion refers to;
    `rows`: some rows of its depth, for an adaptive window."""

    k: int
    frame: RenderedFrame
    previous: Camera | None
    rows: np.ndarray | None


class SceneSource(FrameSource):
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
        self.fps = scene.fps if fps is None else fps
        if count < 1 or not 0 < self.fps < float("inf"):
            raise GffeError(f"a built-in scene needs at least 1 frame and positive fps, got {count} and {self.fps:g}")
        self.scene, self.name, self.exposure = scene, scene.name, scene.exposure
        self.width, self.height, self.count, self.render_size = width, height, count, (width, height)
        self._device, self._frames = device, SceneFrames(SceneRenderer(device, scene, width, height, samples))
        self._ring: OrderedDict[tuple, _Made] = OrderedDict()
        self._ring_size = max(_LEAST_RING, cache_bytes // (sum(BYTES_PER_PIXEL) * width * height))
        self._truths: OrderedDict[tuple, np.ndarray] = OrderedDict()
        self._since: list[_Made] = []  # delivered since `restart`
        self._flown: dict[float, Camera] = {}  # by k + alpha
        self._flown_at: list[float] = []  # its keys in order
        self._flown_last = -1.0  # key of the last call of `fly`
        self._lock = threading.Lock()  # of the flown poses
        self._way: tuple | None = None
        self.configure(window, 1)

    def configure(self, window, n):
        window = window or "off"
        way = (window, *(alphas_for(n) if window == "adaptive" else ()))
        if way == self._way:
            return False
        self._frames.windows = WindowChooser(window, self.render_size, alphas_for(n))
        self._way = way
        self.restart()
        return True

    def restart(self):
        self._frames.windows = WindowChooser(self._way[0], self.render_size, self._frames.windows.alphas)
        self._since = []

    def outdated(self, k, alpha):
        changed = [made for made in self._since if self.camera(made.k, 0.0) != made.frame.display_camera]
        with self._lock:
            for made in changed:
                if made.k not in self._flown or (made.k, 0.0) == (k, alpha):
                    return True
                self._flown[made.k] = made.frame.display_camera  # the new pose came too late
        return False

    def fly(self, k: int, alpha: float, camera: Camera) -> None:
        """From now on `camera` (display pixels) sees the scene at `time(k, alpha)`. May be called from any thread.

        Calls follow each other as a flight does: it moves evenly from one pose to the next if that is at most eight
        rendered frames later, and replaces what was flown in between. A new pose of a rendered frame that has been
        used already is taken only if that frame itself is shown next.
        """
        at = k + alpha
        with self._lock:
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
        """Back to the scene's own path. May be called from any thread."""
        with self._lock:
            self._flown, self._flown_at, self._flown_last = {}, [], -1.0

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

    def time(self, k, alpha=0.0):
        step = 1.0 / self.fps
        return k * step + alpha * (k * step - (k - 1) * step if k else step)

    def rendered(self, k):
        before = self._since[-1] if self._since and self._since[-1].k == k - 1 else None
        made = self._made(k, before)
        self._since = [*self._since[1 - _PAST :], made]
        if made.rows is not None:
            self._frames.windows.observe(made.rows)
        return replace(made.frame, reset=before is None)

    def packed(self, k):
        return None

    def truth(self, k, alpha):
        camera = self.camera(k, alpha)
        key = (k, alpha, *_bits(camera))
        if key not in self._truths:
            self._truths[key] = self._frames.image(self.time(k, alpha), camera).read("color")
            while len(self._truths) > _TRUTHS:
                self._truths.popitem(last=False)
        self._truths.move_to_end(key)
        return self._truths[key]

    def _made(self, k: int, before: _Made | None) -> _Made:
        """Frame `k` after `before`; without one, as it was made for the window in use, whatever was before it then."""
        flown = self._flown_camera(k)
        shown = flown or self.camera(k, 0.0)
        if flown:
            with self._lock:
                self._record(float(k), flown)  # what was flown through is replayed, whatever is flown later
        key = (k, *self._way, *_bits(shown))
        kept = self._ring.get(key)
        if kept is None or before is not None:
            last = before and before.frame
            camera = self._frames.render_camera(shown, last)
            if kept is None or (kept.frame.camera, kept.previous) != (camera, last.camera):
                self._ring[key] = self._render(k, shown, camera, last)
        self._ring.move_to_end(key)
        return self._ring[key]

    def _render(self, k: int, shown: Camera, camera: Camera, before: RenderedFrame | None) -> _Made:
        device, size = self._device, self.render_size
        image = self._frames.image(self.time(k), camera, before)
        if len(self._ring) >= self._ring_size:
            oldest = self._ring.popitem(last=False)[1].frame
            buffers = (oldest.color, oldest.depth, oldest.motion)
        else:
            buffers = tuple(device.buffer(nbytes * size[0] * size[1]) for nbytes in BYTES_PER_PIXEL)
        image.copy_to(buffers)
        rows = read_some_rows(device, buffers[1], size) if self._way[0] == "adaptive" else None
        return _Made(k, RenderedFrame(*buffers, camera, self.time(k), shown), before and before.camera, rows)


def _bits(camera: Camera) -> tuple[bytes, tuple[float, ...]]:
    return camera.world_to_view.tobytes(), camera.intrinsics
