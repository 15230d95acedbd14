"""The picture from the store to the canvas: what is awaited, what is shown, and its images."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.inspection import names
from gffe_cl.engine.inspection.layers import LayerSpec
from ..engine.jobs import Derived, Jobs
from ..engine.messages import Failure, Frame
from ..engine.sources.source import FrameSource
from ..engine.store import Store, Want
from .displays import FrameInfo, area_of

if TYPE_CHECKING:
    from .canvas import Canvas


class Contents:
    """Contents of the picture and of the list of layers.

    Attributes
    ----------
    source : FrameSource or None
    result : Frame or None
        Of the slot computed last; None until there is one of this source.
    second : Frame or None
        Of the same slot by other settings, or of a neighbor, where these are compared; its layers are named by
        `names.of_second`.
    layers : list of LayerSpec
        All that can be shown.
    cuts : frozenset of int
        Rendered frames that were found to be cuts so far, in computing ahead, too.
    changes : int
        How often there were other images.
    """

    def __init__(self):
        self.source: Any = None  # a FrameSource, once something is open
        self.result: Frame | None = None
        self.second: Frame | None = None
        self.layers: list[LayerSpec] = []
        self.cuts: frozenset[int] = frozenset()
        self.changes = 0

    def open(self, source: FrameSource) -> None:
        self.source, self.result, self.second = source, None, None
        self.changes += 1

    def take(self, result: Frame, second: Frame | None = None) -> None:
        self.result, self.second, self.layers = result, second, list(result.specs.values())
        self.changes += 1

    @property
    def images(self) -> dict[str, np.ndarray]:
        """All images, those of the second frame under the names of `names.of_second`."""
        found = {} if self.result is None else dict(self.result.images)
        second = {} if self.second is None else self.second.images
        return found | {names.of_second(name): image for name, image in second.items()}

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the display, pixels."""
        return self.source.width, self.source.height

    @property
    def resets(self) -> dict[int, str]:
        """Rendered frames that start without history, with the reason: those marked in the input, and cuts found so
        far."""
        return dict.fromkeys(sorted(self.cuts), "a cut was found here") | dict.fromkeys(self.source.resets[1:], "reset")

    @property
    def asked(self) -> frozenset[str]:
        """Layers that the present images were asked for."""
        asked = self.result.layers if self.result is not None else frozenset()
        return asked | {names.of_second(name) for name in (self.second.layers if self.second else ())}

    def spec(self, name: str | None) -> LayerSpec | None:
        if names.is_second(name):
            name = names.plain(name)
            if self.second is not None:
                return self.second.specs.get(name)
        return next((spec for spec in self.layers if spec.name == name), None)

    def image(self, name: str | None) -> np.ndarray | None:
        if names.is_second(name):
            return None if self.second is None else self.second.images.get(names.plain(name))
        return None if self.result is None or name is None else self.result.images.get(name)

    def find(self, text: str) -> str | None:
        """Return the full name of a layer, given by it, by the buffer's name alone, or as it is displayed ("Depth
        against motion" or "frame: Depth"); None if there is none."""
        forms = (
            lambda spec: spec.name,
            lambda spec: spec.name.partition(".")[2],
            lambda spec: spec.label,
            lambda spec: f"{spec.group}: {spec.label}",
        )
        found = (spec.name for form in forms for spec in self.layers if form(spec).casefold() == text.casefold())
        return next(found, None)

    def why_not(self, name: str) -> str | None:
        """Return why a layer cannot be shown in this sequence; None if it can."""
        name = names.plain(name)
        if name in (names.TRUTH, names.FOCUS_TRUTH) and self.source is not None and not self.source.has_truth:
            return "this sequence has no ground truth"
        return None

    def why_absent(self, name: str) -> str | None:
        """Return why the present settings, or B's, have no layer of this name; None if they have it."""
        if self.spec(name) is not None:
            return None
        if names.is_second(name) and self.second is not None and self.second.setup.place:
            return "not stored with B (gffe run --dump-stages stores all layers)"
        return "not made with B's options" if names.is_second(name) else "not made with these options"

    def showable(self) -> list[LayerSpec]:
        return [spec for spec in self.layers if self.why_not(spec.name) is None]

    def frame_info(self, result: Frame | None = None) -> FrameInfo:
        """Return the frame of reference of the result's layers, for display; by default of A's."""
        result = result or self.result
        assert result is not None
        return replace(_info(result, self.size), exposure=self.source.exposure)


def _info(frame: Frame, size: tuple[int, int]) -> FrameInfo:
    """Return the frame of reference of a frame's layers on a display of `size`, without exposure."""
    moment, rendered = frame.moment, frame.render_size
    area = area_of(moment.render_camera, rendered, moment.display_camera, size)
    return FrameInfo(size, rendered, 1.0, moment.render_camera, area)


# ---- a neighbor, followed along motion vectors ------------------------------------------------------------

VECTORS = frozenset({names.MOTION, names.RENDERED_MOTION})  # layers that both need
_STEPS, _MISSES = 8, 0.5  # of the search against vectors, and pixels by which it may miss
_FOLLOWED = ("color", "depth", "motion", "mask", "label", "scalar")  # values that do not depend on their place


def followed(a: Frame, b: Frame, size: tuple[int, int]) -> Frame:
    """Return frame `b`, of at most one rendered frame before or after `a`, with the layers that both have as seen from
    `a`: at each texel what is in `b` where motion vectors lead, of colors bilinear, else nearest; NaN where they lead
    out of the image. `size`: of the display; both have the layers `VECTORS`."""
    images = {}
    for name in a.images.keys() & b.images.keys():
        spec, there, like = b.specs[name], b.images[name], a.images[name]
        if spec.view not in _FOLLOWED or there.ndim > 2 + bool(spec.components) or there.shape != like.shape:
            continue
        height, width = like.shape[:2]
        grid = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), -1) / (width, height)
        own, other = (np.array(_info(frame, size).placed(spec)) for frame in (a, b))
        px = _way(grid * own[:2] + own[2:], a, b)
        found = _sampled(there, (px - other[2:]) / other[:2] * (width, height), smooth=spec.view == "color")
        images[name] = np.nan_to_num(found).astype(like.dtype) if like.dtype == np.uint8 else found.astype(like.dtype)
    return replace(b, images=images, moment=a.moment, render_size=a.render_size)


def _way(px: np.ndarray, a: Frame, b: Frame) -> np.ndarray:
    """Return where motion vectors lead from display positions (…, 2) of `a` on the display of `b`, pixels; NaN where
    they lead out of an image."""
    start, end = a.moment, b.moment
    if start.alpha:  # into the rendered frame that it was made of
        px = px + _sampled(a.images[names.MOTION], px)
    else:
        px = _moved(px, start.display_camera, start.render_camera)
    later = start if end.k < start.k else end
    if end.k != start.k and later.previous_camera is None:  # a reset: vectors lead nowhere
        return np.full(px.shape, np.nan)
    if end.k < start.k:
        px = px + _sampled(a.images[names.RENDERED_MOTION], px)
    elif end.k > start.k:
        px = _against(b.images[names.RENDERED_MOTION], px)
    return _against(b.images[names.MOTION], px) if end.alpha else _moved(px, end.render_camera, end.display_camera)


def _moved(px: np.ndarray, image: Camera, other: Camera) -> np.ndarray:
    return (px - (image.cx, image.cy)) / (image.fx, image.fy) * (other.fx, other.fy) + (other.cx, other.cy)


def _against(motion: np.ndarray, px: np.ndarray) -> np.ndarray:
    """Return the positions from which motion vectors lead to `px` (…, 2), NaN where none was found."""
    start = px
    for _ in range(_STEPS):
        start = px - np.nan_to_num(_sampled(motion, start))
    with np.errstate(invalid="ignore"):
        hits = np.abs(start + _sampled(motion, start) - px).max(-1, keepdims=True) < _MISSES
    return np.where(hits, start, np.nan)


def _sampled(image: np.ndarray, px: np.ndarray, smooth: bool = False) -> np.ndarray:
    """Return the values (…, channels?) float32 of an image (H, W, channels?) at pixel positions (…, 2), of the texel
    there, or `smooth`ly between four; NaN outside."""
    height, width = image.shape[:2]
    with np.errstate(invalid="ignore"):
        inside = np.asarray(((px >= 0) & (px <= (width, height))).all(-1))
    x, y = np.moveaxis(np.where(inside[..., None], px, 0.0), -1, 0)

    def texel(right: np.ndarray, down: np.ndarray) -> np.ndarray:
        at = np.clip(down, 0, height - 1).astype(np.intp), np.clip(right, 0, width - 1).astype(np.intp)
        return image[at].astype(np.float32)

    weights = inside.reshape(*inside.shape, *[1] * (image.ndim - 2))
    if not smooth:
        return np.where(weights, texel(x, y), np.nan)
    left, top = np.floor(x - 0.5), np.floor(y - 0.5)
    fx, fy = ((at - 0.5 - start).astype(np.float32)[..., None] for at, start in ((x, left), (y, top)))
    above = texel(left, top) * (1 - fx) + texel(left + 1, top) * fx
    below = texel(left, top + 1) * (1 - fx) + texel(left + 1, top + 1) * fx
    return np.where(weights, above * (1 - fy) + below * fy, np.nan)


@dataclass(frozen=True)
class Picture:
    """A picture that is due: a slot as A's settings make it, and as B's do, or a neighbor of it, where these are
    compared; `follows`: B is shown where motion vectors lead from A's pixels."""

    a: Want
    b: Want | None = None
    follows: bool = False

    @property
    def wants(self) -> list[Want]:
        return [want for want in (self.a, self.b) if want is not None]

    def is_like(self, other: Picture) -> bool:
        """Return whether both are of the same settings and layers: one may be shown on the way to the other."""
        return (len(self.wants), self.follows) == (len(other.wants), other.follows) and all(
            mine.key.recipe == its.key.recipe and mine.layers == its.layers
            for mine, its in zip(self.wants, other.wants, strict=True)
        )


class Showing:
    """The picture that is made for the screen, and the one that is on it: A and B of one slot, or neither.

    Parameters
    ----------
    contents : Contents
        Takes A's frame and B's, or None, as soon as they are there.
    fail : callable
        Called with the failure of A's or of B's, and whether it is B's, once for each picture. Without B's A is shown.
    background : Jobs
        Follows B along motion vectors.

    Attributes
    ----------
    awaited : Picture or None
        What is made first. While frames pass, it is finished before the next one is due.
    shown : Picture or None
    from_cache : bool
        What is shown was there before it was wanted.
    fault_of_b : str
        Why there is nothing of B; empty if there is.
    """

    def __init__(self, store: Store, contents: Contents, fail: Callable[[Failure, bool], None], background: Jobs):
        self._store, self._contents, self._fail = store, contents, fail
        self._followed, self._follows = Derived(background), False  # B along vectors, and whether it is being made
        self.awaited: Picture | None = None
        self.shown: Picture | None = None
        self._due: Picture | None = None
        self._told: set[Want] = set()  # failures
        self.from_cache = self._was_there = False
        self.fault_of_b = ""

    def forget(self) -> None:
        """Drop the picture after a change of the source."""
        self.awaited = self.shown = self._due = None
        self.fault_of_b = ""

    def update(self, due: Picture, passing: bool, may_show: bool = True) -> bool:
        """Show what is there of the awaited picture, and await the one that is due. Call once per frame of the
        interface; `passing`: frames pass (it plays, for example): none is given up for the next one. Returns whether
        another picture is shown."""
        before, changes = self.awaited, self._contents.changes
        self._due = due
        there = before is not None and may_show and self._take(before)
        if before is None or (before != due and (there or not passing or not before.is_like(due))):
            self.awaited, self._told, self._follows = due, set(), False
            for want in due.wants:
                self._store.retry(want)
            self._was_there = not self.is_waiting
            if may_show:
                self._take(due)
        return self._contents.changes != changes

    def skip(self) -> Picture | None:
        """Await the picture that is due by now instead of another one, and return it."""
        self.awaited = self._due
        return self.awaited

    @property
    def wants(self) -> list[Want]:
        """Parts of the awaited picture to make."""
        return self.awaited.wants if self.awaited is not None else []

    @property
    def following(self) -> list[Want]:
        """Parts of the picture that is due by now, to make next."""
        return self._due.wants if self._due is not None and self._due != self.awaited else []

    @property
    def is_waiting(self) -> bool:
        """Whether anything is still to be made of the awaited picture."""
        return self._follows or any(self._store.get(want) is None for want in self.wants)

    @property
    def failed(self) -> bool:
        """Whether A of the awaited picture cannot be made."""
        return self.awaited is not None and isinstance(self._store.get(self.awaited.a), Failure)

    @property
    def shows_due(self) -> bool:
        """Whether the picture that is due is on the screen."""
        return self._due is not None and self.shown == self._due and not self.is_waiting

    @property
    def shows_slot_due(self) -> bool:
        """Whether the slot that is due is on the screen, made as it is now, with whichever layers."""
        if self._due is None or self.shown is None or (self.shown.b is None and self._due.b is not None):
            return False
        return all(mine.key == its.key for mine, its in zip(self.shown.wants, self._due.wants, strict=False))

    def _take(self, picture: Picture) -> bool:
        """Show a picture if all of it is there. Returns whether nothing of it is to be made any more."""
        made = [self._store.get(want) for want in picture.wants]
        for want, one in zip(picture.wants, made, strict=True):
            if isinstance(one, Failure) and want not in self._told:
                self._told.add(want)
                self._fail(one, want is not picture.a)
        if not made or any(one is None for one in made):
            self._preview(picture)
            return False
        first, second = made[0], made[1] if len(made) > 1 else None
        if picture.follows and isinstance(first, Frame) and isinstance(second, Frame):
            key, size = (first.key, second.key, first.layers, first.wall_ms, second.wall_ms), self._contents.size
            second = self._followed.get(key, followed, first, second, size)
            self._follows = not self._followed.ready
            if self._follows:
                return False
            if error := self._followed.error:
                second = Failure(f"cannot be followed: {error}")
        self.fault_of_b = second.error if isinstance(second, Failure) else ""
        if isinstance(first, Frame):
            second, contents = second if isinstance(second, Frame) else None, self._contents
            if first is not contents.result or second is not contents.second:
                self.from_cache, self.shown = self._was_there, picture
                contents.take(first, second)
        return True

    def _preview(self, picture: Picture) -> None:
        """Show the provisional slots of a picture if they are there."""
        made = [self._store.get(want.provisional) for want in picture.wants if want.preview]
        frames = [frame for frame in made if isinstance(frame, Frame)]
        if frames and len(frames) == len(picture.wants):
            self.from_cache = False
            if frames[0] is not self._contents.result:
                self._contents.take(*frames[: 1 if picture.follows else 2])

    @property
    def is_preview(self) -> bool:
        """Whether provisional slots are shown until those of the awaited picture are made."""
        result, awaited = self._contents.result, self.awaited
        return result is not None and awaited is not None and awaited.a.preview and result.key.provisional


_BUDGET = 0.02  # seconds per frame of the interface, but at least one image


class Screen:
    """Puts the images of `contents` on a canvas.

    Attributes
    ----------
    canvas : Canvas or None
        None: there is nothing to draw on.
    upload_ms : float
        What the images on the canvas took.
    """

    def __init__(self, contents: Contents):
        self._contents = contents
        self._on_canvas: dict[str, np.ndarray] = {}
        self._uploaded: set[str] = set()  # names, with those whose images are other ones by now
        self._changes = self._coming = 0  # of the contents that are on the canvas, and of those that come
        self.canvas: Canvas | None = None
        self.upload_ms = 0.0

    @property
    def ready(self) -> bool:
        """Whether all images are on the canvas."""
        return self._changes == self._contents.changes

    def update(self, first: set[str]) -> None:
        """Upload the images of the contents that are not on the canvas yet, and remove all others, which belong to
        another time: those of `first` at once, the others as time permits. Call once per frame of the interface, and
        after the contents have changed."""
        if self.ready:
            return
        images = self._contents.images
        if self._coming != self._contents.changes:
            self._coming, self.upload_ms = self._contents.changes, 0.0
            if self.canvas is not None:
                if self._contents.result is not None:
                    self.canvas.frame = self._contents.frame_info()
                self.canvas.forget(self._uploaded - images.keys())
                self._uploaded &= images.keys()
        self._on_canvas = {name: image for name, image in self._on_canvas.items() if images.get(name) is image}
        end = time.perf_counter() + _BUDGET
        left = sorted(images.keys() - self._on_canvas.keys(), key=lambda name: name not in first)
        for place, name in enumerate(left):
            if place and name not in first and time.perf_counter() > end:
                return
            self._upload(name, images[name])
        self._changes = self._contents.changes

    def _upload(self, name: str, image: np.ndarray) -> None:
        start = time.perf_counter()
        if self.canvas is not None:
            own = [self._contents.frame_info(self._contents.second)] if names.is_second(name) else []
            spec = self._contents.spec(name)
            assert spec is not None  # there is an image of it
            self.canvas.upload(name, image, spec, *own)
            self._uploaded.add(name)
        self._on_canvas[name] = image
        self.upload_ms += (time.perf_counter() - start) * 1e3
