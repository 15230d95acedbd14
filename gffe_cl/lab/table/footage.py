"""Subjects of evaluation: built-in scenes and sequences on disk, as rendered frames with the truth at moments between,
and the regions of these.

A `SceneSubject` or `FolderSubject` is a description: it can be sent to another process, and its `identity`
distinguishes it from all others without rendering or decoding anything. `open_subject` opens its `Footage`.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from itertools import chain, pairwise
from pathlib import Path
from typing import ClassVar

import numpy as np

from gffe_cl.captures.formats import open_capture
from gffe_cl.captures.offline.source import Recorded
from gffe_cl.captures.scenes import (
    SceneFrames,
    SceneRenderer,
    is_scene,
    is_scene_name,
    load_scene,
    scene_names,
)
from gffe_cl.captures.sequence import FrameEntry, Sequence
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.frame.window import WindowChooser
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.lab.compare import NO_HISTORY
from gffe_cl.lab.metrics import focus_mask, labels_of, same_surface, shows, steps, world_positions

_MOST_KEPT = 3 << 30  # bytes of footage that stay in memory
_BYTES_PER_PIXEL = 45  # of a rendered frame and a moment
_MOVES = 0.5  # pixels from which a surface counts as moving by itself
_MUCH = 0.25  # of a pixel: a surface shows there if it has so much of it, in some pixel


@dataclass(frozen=True)
class SceneSubject:
    """A built-in scene. `frames` rendered ones are followed by moments at `alphas` (intervals)."""

    exact: ClassVar = True  # moments have a `Guide`, as of `Footage`

    scene: str
    seed: int
    width: int
    height: int
    frames: int
    fps: float
    alphas: tuple[float, ...]

    @property
    def name(self) -> str:
        return f"{self.scene}:{self.seed}"

    @property
    def moments(self) -> int:
        """Number of moments."""
        return max(self.frames - NO_HISTORY, 0) * len(self.alphas)

    def identity(self) -> dict:
        return asdict(self)


@dataclass(frozen=True)
class FolderSubject:
    """A sequence on disk, of any form that `gffe formats` lists; it must hold ground truth in between."""

    exact: ClassVar = False
    path: str
    moments: int

    @property
    def name(self) -> str:
        return Path(self.path).resolve().name

    def identity(self) -> dict:
        """Return the identity: by the contents of all files, not by their place."""
        root = Path(self.path)
        root = root if root.is_dir() else root.parent
        total = hashlib.sha256()
        for path in sorted(p for p in root.rglob("*") if p.is_file()):
            with path.open("rb") as file:
                total.update(os.fsencode(path.relative_to(root)) + b"\0" + hashlib.file_digest(file, "sha256").digest())
        return {"folder": total.hexdigest()}


Subject = SceneSubject | FolderSubject


@dataclass(frozen=True)
class Guide:
    """Exact G-buffers of the new frame, and their correspondence with the rendered frame at t. `depth` (H, W)
    float32, view z; `motion` (H, W, 2) float32, pixels: position of the surface in the displayed image of t, minus
    here; `source_depth` (H, W) float32: its view z there (NaN behind that camera); `moving` (H, W) bool: it moves by
    itself."""

    depth: np.ndarray
    motion: np.ndarray
    source_depth: np.ndarray
    moving: np.ndarray


@dataclass(frozen=True)
class Moment:
    """A time at which a new frame is made: `time` in seconds, `alpha` in intervals after the rendered frame; `camera`
    of the new frame, None if not known; `truth` (H, W, 3) linear."""

    time: float
    alpha: float
    camera: Camera | None
    truth: np.ndarray
    guide: Guide | None = None


@dataclass(frozen=True)
class Shot:
    """A rendered frame; its displayed picture (H, W, 3) linear; the moments after it that count; the next rendered
    frame, if there is one; and, with guides, a mask (H, W) of displayed movers."""

    frame: RenderedFrame
    shown: np.ndarray
    moments: tuple[Moment, ...]
    following: RenderedFrame | None = None
    moving: np.ndarray | None = None


class Footage:
    """Rendered frames and moments of a subject. `exact`: whether moments have a `Guide`, of which rendered frames are
    the exact surfaces, and frames can be rendered through a window of choice; `labels`: of each moment in order
    (`regions`), filled in by callers that need them."""

    exact = False

    def __init__(self, name: str, width: int, height: int, fps: float, exposure: float):
        self.name, self.width, self.height, self.fps, self.exposure = name, width, height, fps, exposure
        self.labels: list[np.ndarray] = []
        self._kept: dict[str, list[Shot]] = {}

    def shots(self, window: str = "off") -> Iterator[Shot]:
        """Yield the shots in order of time. `window`: "off" for displayed frames; "given" for frames as recorded; or,
        if it is `exact`, any other mode of `WindowChooser`."""
        if window in self._kept:
            yield from self._kept[window]
            return
        made = []
        for shot in self._make(window):
            if made is not None:
                made.append(shot)
                if len(made) * self.width * self.height * _BYTES_PER_PIXEL > _MOST_KEPT:
                    made = None
            yield shot
        if made is not None:
            self._kept[window] = made

    def render_size(self, window: str) -> tuple[int, int]:
        """Return width and height of the frames of `shots(window)`, pixels."""
        return self.width, self.height

    def _make(self, window: str) -> Iterator[Shot]:
        raise NotImplementedError


class _Scene(Footage):
    exact = True

    def __init__(self, subject: SceneSubject, device: Device):
        self._scene, self._device = load_scene(subject.scene, subject.seed), device
        self._subject = subject
        size = (subject.width, subject.height)
        super().__init__(subject.name, *size, subject.fps, self._scene.exposure)
        self._renderer = SceneRenderer(device, self._scene, *size)

    def shots(self, window="off"):
        return super().shots("off" if window == "given" else window)

    def _make(self, window):
        size = (self.width, self.height)
        frames = SceneFrames(self._renderer, WindowChooser(window, size, self._subject.alphas), size)
        rendered = frames.sequence(self._subject.frames + 1, self.fps)
        for (frame, following), (shown, moments, moving) in zip(pairwise(rendered), self._reference(), strict=False):
            yield Shot(frame, shown, moments, following, moving)

    def _reference(self):
        """Yield the displayed picture, the later moments and the movers of each rendered frame: the same for all
        windows."""
        if "off" in self._kept:
            yield from ((shot.shown, shot.moments, shot.moving) for shot in self._kept["off"])
            return
        before = None
        for k in range(self._subject.frames):
            now = k / self.fps, self._scene.camera(k / self.fps, self.width, self.height)
            image = self._renderer.render(*now, *(before or now)).numpy()
            moving = moving_pixels(image.motion, image.depth, now[1], (before or now)[1])
            alphas = self._subject.alphas if k >= NO_HISTORY else ()
            yield image.color, tuple(self._moment(*now, (k + alpha) / self.fps, alpha) for alpha in alphas), moving
            before = now

    def _moment(self, source_time: float, source: Camera, time: float, alpha: float) -> Moment:
        camera = self._scene.camera(time, self.width, self.height)
        image = self._renderer.render(time, camera, source_time, source).numpy()
        moving = moving_pixels(image.motion, image.depth, camera, source)
        z = np.where(np.isinf(image.depth), np.inf, image.other_position[..., 2])
        z = np.where(np.isfinite(image.motion).all(-1), z, np.nan).astype(np.float32)
        guide = Guide(image.depth, image.motion, z, moving)
        return Moment(time, alpha, camera, image.color, guide)


class _Folder(Footage):
    def __init__(self, subject: FolderSubject, device: Device):
        self._sequence = s = open_capture(subject.path)
        super().__init__(subject.name, s.width, s.height, s.fps, s.exposure)
        self._sources = {"off": Recorded(s, device, "off"), "given": Recorded(s, device)}

    def render_size(self, window):
        return self._sources[window].render_size

    def _make(self, window):
        source, truths = self._sources[window], truths_after(self._sequence)
        shown = self.shots("off") if window != "off" else None
        frames = (frame for _, frame in source.frames([], strict=False))
        for k, (frame, following) in enumerate(pairwise(chain(frames, [None]))):
            assert frame is not None  # only the last of `following` is
            following = None if following is None or following.reset else following
            if shown is not None:
                yield replace(next(shown), frame=frame, following=following)
            else:
                moments = tuple(self._moment(source, k, truth) for truth in truths.get(k, ()))
                yield Shot(frame, frame.color[..., :3], moments, following)

    def _moment(self, source: Recorded, k: int, truth: FrameEntry) -> Moment:
        """Return the moment of `truth` after rendered frame `k`."""
        alpha = (truth.time - source.time(k)) / source.interval(k)
        return Moment(truth.time, alpha, self._sequence.camera_at(truth.time), self._sequence.read_color(truth))


def open_subject(subject: Subject, device: Device) -> Footage:
    """Return the subject's footage. Nothing is rendered or decoded before it is requested."""
    return _Scene(subject, device) if isinstance(subject, SceneSubject) else _Folder(subject, device)


def parse_subject(text: str, size: tuple[int, int], frames: int, fps: float, alphas: tuple[float, ...]) -> Subject:
    """Return the subject of a text: "corridor", "corridor:3" (a seed) or a folder. Raises GffeError, also for a folder
    without ground truth."""
    name, colon, seed = text.partition(":")
    if is_scene(text) or (is_scene_name(name) and colon and not Path(text).exists()):
        if colon and not seed.isdigit():
            raise GffeError(f"'{text}': the seed must be a whole number (expected {name}:0 or the like)")
        load_scene(name, int(seed or 0))
        return SceneSubject(name, int(seed or 0), *size, frames, fps, tuple(alphas))
    if not Path(text).exists():
        raise GffeError(f"'{text}': neither a built-in scene ({scene_names()}) nor a folder")
    sequence = open_capture(text)
    count = sum(map(len, truths_after(sequence).values()))
    if not count:
        raise GffeError(
            f"{text}: no ground truth between rendered frames with history, nothing to measure against"
            " (expected frames of kind ground_truth, as `gffe render --ground-truth` writes)"
        )
    Recorded(sequence, None)  # raises for windows that no run takes
    return FolderSubject(text, count)


def truths_after(sequence: Sequence) -> dict[int, list[FrameEntry]]:
    """Return entries of ground truth by the number of the rendered frame before them. That frame must have history and
    a rendered frame after it, because interpolation needs it and all methods are measured at the same moments."""
    found: dict[int, list[FrameEntry]] = {}
    rendered, since, usable = sequence.rendered, 0, []
    for k, entry in enumerate(rendered):
        since = 0 if entry.reset or k == 0 else since + 1
        followed = k + 1 < len(rendered) and not rendered[k + 1].reset
        usable.append(since >= NO_HISTORY and followed)
    for truth in sequence.ground_truth:
        index = sequence.rendered_before(truth.time)
        if index is not None and usable[index]:
            found.setdefault(index, []).append(truth)
    return found


def moving_pixels(motion: np.ndarray, depth: np.ndarray, camera: Camera, other: Camera) -> np.ndarray:
    """Return (H, W) bool: where `motion` (pixels, from `camera` to `other`) is not that of a static point at
    `depth`."""
    static_px, _ = other.project(_world(camera, depth))
    with np.errstate(invalid="ignore"):
        off = np.linalg.norm(motion + pixel_centers(*depth.shape) - static_px, axis=-1)
    return (off > _MOVES) & np.isfinite(depth)


def _world(camera: Camera, depth: np.ndarray) -> np.ndarray:
    """Return the world positions (H, W, 3) of pixels; sky is put very far away."""
    return camera.unproject(pixel_centers(*depth.shape), np.where(np.isfinite(depth), depth, 1e7))


def pixel_centers(height: int, width: int) -> np.ndarray:
    """Return the pixel centers (H, W, 2) float32: x, y."""
    y, x = np.mgrid[:height, :width].astype(np.float32) + np.float32(0.5)
    return np.stack([x, y], -1)


# ---- regions ----------------------------------------------------------------------------------------------------


def find_labels(footage: Footage, device: Device) -> Iterator[np.ndarray]:
    """Yield the labels of every moment in order: (H, W) uint8, indices into `REGIONS`."""
    size = footage.width, footage.height
    gae = Pipeline(device, *size, Options(shading_correction=False, overlays=False), fps=footage.fps)
    still = Options(motion=False, levels=0, shading_correction=False, overlays=False)
    static = None if footage.exact else Pipeline(device, *size, still, fps=footage.fps)
    for shot in footage.shots():
        for pipeline in filter(None, (gae, static)):
            pipeline.submit(shot.frame)
        for moment in shot.moments:
            made = gae.extrapolate(moment.camera, moment.time)
            found = {name: made.numpy(name) for name in ("color", "depth", "dynamic", "disoccluded")}
            if moment.guide:
                parts = exact_parts(shot, moment.guide)
            else:
                assert static is not None
                seen = static.extrapolate(moment.camera, moment.time).numpy("disoccluded")
                parts = _found_parts(shot, found, seen != 0, made.camera)
            moving = parts["dynamic"]
            parts["focus"] = focus_mask(found["color"], moment.truth, moving, footage.exposure)
            yield labels_of(parts)


def exact_parts(shot: Shot, guide: Guide) -> dict[str, np.ndarray]:
    """Return masks from the renderer, all except "focus" and "rest". `shot` is without a window."""
    height, width = guide.depth.shape
    with np.errstate(invalid="ignore"):
        place = pixel_centers(height, width) + guide.motion
        inside = (place >= 0).all(-1) & (place < (width, height)).all(-1) & ~np.isnan(guide.source_depth)
    place = np.where(inside[..., None], place, 0.5)
    visible = np.zeros_like(inside)
    low = np.floor(place - 0.5)
    part = place - 0.5 - low
    for tap in range(4):
        dx, dy = tap & 1, tap >> 1
        weight = np.where(dx, part[..., 0], 1 - part[..., 0]) * np.where(dy, part[..., 1], 1 - part[..., 1])
        x = np.clip(low[..., 0].astype(int) + dx, 0, width - 1)
        y = np.clip(low[..., 1].astype(int) + dy, 0, height - 1)
        visible |= (weight >= _MUCH) & same_surface(shot.frame.depth[y, x], guide.source_depth)
    hidden = inside & ~visible
    nearest = place.astype(int)
    assert shot.moving is not None  # where there are guides
    behind_mover = shot.moving[nearest[..., 1], nearest[..., 0]]
    return {
        "out of screen": ~inside,
        "static disocclusion": hidden & ~behind_mover,
        "dynamic disocclusion": hidden & behind_mover,
        "silhouettes": steps(guide.depth),
        "dynamic": guide.moving,
    }


def _found_parts(shot: Shot, found: dict, static_holes: np.ndarray, camera: Camera) -> dict[str, np.ndarray]:
    """Return the masks of `exact_parts` by the pipeline's own buffers. `static_holes`: disocclusions if everything
    counts as static."""
    holes = found["disoccluded"] != 0
    height, width = holes.shape
    outside = np.zeros_like(holes)
    outside[holes] = ~shows(shot.frame.camera, width, height, world_positions(camera, found["depth"], holes))
    return {
        "out of screen": outside,
        "static disocclusion": holes & static_holes,
        "dynamic disocclusion": holes,
        "silhouettes": steps(found["depth"]),
        "dynamic": found["dynamic"] != 0,
    }
