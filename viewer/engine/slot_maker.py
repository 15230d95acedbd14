"""Computation of slots: the pipeline is brought to a slot, which is made and read back; and queries about it."""

from __future__ import annotations

import itertools
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from gffe_cl.captures.offline.run import alphas_for
from gffe_cl.captures.sequence.engine_form import described_frame
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.frame_format import FrameFormat
from gffe_cl.engine.frame.rendered_frame import BadPixels, RenderedFrame, host_arrays
from gffe_cl.engine.inspection import names
from gffe_cl.engine.inspection.buffers import (
    Moment,
    Shot,
    device_layers,
    moved,
    pixel_values,
    read_layers,
    source_position,
)
from gffe_cl.engine.inspection.description import in_words
from gffe_cl.engine.inspection.explain.motion_trail import Passed
from gffe_cl.engine.inspection.explain.pixel_explain import pixel_story
from gffe_cl.engine.inspection.explain.pixel_explain_types import Inspection
from gffe_cl.engine.inspection.layers import FRAME_GROUP, LayerSpec, layers_of
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.base import Board
from gffe_cl.engine.stages.buffers import XY, DeviceFrame, Sizes
from gffe_cl.engine.stages.upload import Upload
from gffe_cl.engine.timing.bench import memory
from gffe_cl.lab.metrics import focus_mask
from .messages import Frame, Key, Recipe, rgba_of
from .reloading import Kernels
from .sources.recorded import state_of
from .sources.source import FrameSource

_FAULTS = {  # by fields of `BadPixels`, each a bit of a mask
    "color": "its color is NaN or infinite, and counts as 0",
    "depth": "its depth is NaN, 0, negative or denormal, so it is left out",
    "motion": "its motion is NaN or infinite, so it is dynamic without history",
    "long": "its motion is longer than the image's diagonal, so it is dynamic without history",
}
INVALID = LayerSpec(
    "rendered.invalid",
    "Invalid pixels",
    FRAME_GROUP,
    "label",
    labels=((0, "valid"), (1, "color"), (2, "depth"), (4, "motion"), (8, "long motion")),
    description="pixels of the input that cannot be used, by what is wrong",
    grid="source",
)
RESIDUAL = LayerSpec(
    names.RESIDUAL,
    "Depth against motion",
    FRAME_GROUP,
    "motion",
    XY,
    description="motion vectors minus those of static points by depth and cameras, pixels: 0 where nothing moves and"
    " depth is right",
    grid="source",
    limits=(0.0, 1.0),
)
_SKY = 1e9  # world units: depth that stands for infinity, where only turning counts
_WARM_UP = 8  # rendered frames submitted before the one of a provisional slot


class Seeker:
    """A pipeline and its position in the sequence. `check` is called before each rendered frame, and may raise to
    stop."""

    def __init__(self, device: Device, source: FrameSource, check: Callable[[], None]):
        self.device, self.source, self._check = device, source, check
        self.cuts: set[int] = set()  # rendered frames that were found to be cuts so far
        self.progress = 0, 0  # rendered frames of the last `go_to` that are submitted, and all of them
        self._options: Options | None = None
        self._versions = ("", "")  # of kernels and weights
        self._ring: list[DeviceFrame] = []  # buffers for host frames: the pipeline uses two in place
        self.drop()

    def drop(self) -> None:
        """Forget the pipeline; the next slot makes a new one."""
        self.pipeline: Pipeline | None = None
        self.shot: Shot | None = None
        self.truth: np.ndarray | None = None  # of the shot, (H, W, 3), if it was asked for
        self.focus: np.ndarray | None = None  # where that says that shading is wrong, (H, W), likewise
        self.bad_pixels = BadPixels()
        self.invalid: np.ndarray | None = None  # pixels of the frame submitted last: a mask, see `_invalid_pixels`
        self.stored: RenderedFrame | None = None  # the frame submitted last, as an engine stored it, ...
        self.converted: RenderedFrame | None = None  # ... and in our conventions
        self._at: int | None = None  # the frame submitted last
        self._is_whole = False  # whether all frames since the last reset were submitted
        self._frame: RenderedFrame | None = None
        self._before: Camera | None = None  # render camera of the frame before
        self.passed: deque[Passed] = deque(maxlen=self.source.held)  # submitted frames, the newest first
        self._presented = None

    @property
    def _running(self) -> Pipeline:
        assert self.pipeline is not None  # `go_to` made it
        return self.pipeline

    def prepare(self, recipe: Recipe) -> None:
        setup, versions = recipe.setup, (recipe.kernels, recipe.weights)
        others = (setup.options, versions) != (self._options, self._versions)
        if self.source.configure(setup.window, setup.n, setup.options.upscale) or others:
            self.drop()
            self.cuts = set()
        self._options, self._versions = setup.options, versions

    def continues_to(self, k: int, provisional: bool) -> bool:
        """Return whether the pipeline can go on to frame `k`, for a provisional slot or an exact one."""
        at = self._at
        return at is not None and at <= k and (k - at <= _WARM_UP if provisional else self._is_whole)

    def frames_to(self, k: int, provisional: bool, continues: bool) -> range:
        """Return the rendered frames to submit until frame `k` is the last one, by the pipeline as it is if that
        `continues`, else by a new one."""
        reset, at = self.source.reset_before(k), self._at
        if continues and at is not None:
            return range(max(at + 1, reset), k + 1)
        return range(max(k - _WARM_UP, reset) if provisional else reset, k + 1)

    def go_to(self, k: int, alpha: float, provisional: bool) -> list[str]:
        """Submit the missing frames up to rendered frame `k`. Unreadable frames other than `k` are left out; returns
        messages about them."""
        source = self.source
        self.shot = None  # or an interruption would leave one of another slot
        continues = self.continues_to(k, provisional)
        frames = self.frames_to(k, provisional, continues)
        if not continues:
            self._restart()
        notes = []
        for done, m in enumerate(frames):
            self.progress = done, len(frames)
            self._check()
            is_whole = self._is_whole or m == source.reset_before(m)
            try:
                self._submit(m, last=m == k)
            except GffeError as error:
                if m == k:
                    raise
                notes.append(f"rendered frame {m} is left out: {error}")
                self._restart()
            self._is_whole = is_whole
        self.progress = len(frames), len(frames)
        if self._presented is None:  # even with nothing to submit: an interruption may have come first
            self._presented = self._running.present()
        return notes

    def shoot(self, k: int, alpha: float) -> Shot:
        """Make the slot at `alpha` after rendered frame `k`, which was submitted last, and return it."""
        pipeline, frame, shown, self.truth = self._running, self._frame, self._presented, None
        self.focus = None
        assert frame is not None and shown is not None  # `go_to` came first
        buffers = {
            names.RENDERED_COLOR: frame.color,
            names.RENDERED_DEPTH: frame.depth,
            names.RENDERED_MOTION: frame.motion,
        }
        cameras = (frame.camera, shown.camera, self._before)
        if alpha:
            made = pipeline.extrapolate(self.source.camera(k, alpha), self.source.time(k, alpha))
            buffers[names.FINAL] = made.color
            if "correction" in pipeline.stages:
                buffers[names.GAE] = made.gae
            self.shot = Shot(Moment(k, alpha, made.time, made.camera, *cameras), buffers)
        else:
            buffers[names.FINAL] = shown.color
            if self.source.has_truth:
                buffers[names.TRUTH] = shown.color
            self.shot = Shot(Moment(k, 0.0, frame.time, shown.camera, *cameras), buffers)
        return self.shot

    def find_focus(self, truth: np.ndarray) -> np.ndarray:
        """Return `focus` of the shot, an extrapolated one, before shading correction; `truth`: (H, W, 4) float16."""
        color, dynamic = (self._running.board.frame.read(name) for name in ("color", "dynamic"))
        self.focus = focus_mask(color[..., :3], truth[..., :3], dynamic, self.source.exposure).astype(np.uint8)
        return self.focus

    def _restart(self) -> None:
        self.drop()  # before as much is allocated again
        source = self.source
        self.pipeline = Pipeline(
            self.device,
            source.width,
            source.height,
            self._options,
            render_size=source.render_size,
            fps=source.fps,
            format=source.format,
        )
        if not self._ring or self._ring[0].color.size != 8 * source.render_size[0] * source.render_size[1]:
            self._ring = []
            self._upload = Upload(Board(self.device, Sizes(source.render_size, source.render_size)))
        source.restart()

    def _submit(self, m: int, last: bool) -> None:
        source, before = self.source, self._frame
        frame, self.stored = source.rendered(m), source.stored(m)
        host = host_arrays(frame) if isinstance(frame.color, np.ndarray) else None  # else it is on the device
        if host and self.stored is None:
            if len(self._ring) < 3:
                self._ring.append(DeviceFrame.allocate(self.device, source.render_size, None, None, 0.0))
            else:
                self._ring.append(self._ring.pop(0))
            color, depth, motion = self._ring[-1].buffers
            self._upload.take(host, DeviceFrame(color, depth, motion, frame.camera, frame.shown_camera, frame.time))
            frame = replace(frame, color=color, depth=depth, motion=motion)
        pipeline = self._running
        if last:
            pipeline.take_timings()  # of the warm-up: not this slot's
        pipeline.exposure = self.source.exposure
        pipeline.submit(self.stored or frame)
        if self.stored:  # the pipeline has converted it
            self.converted, on_device = frame, pipeline.board.bindings.rendered
            assert on_device is not None  # as it was submitted
            color, depth, motion = on_device.buffers
            frame = replace(frame, color=color, depth=depth, motion=motion)
        self._at, self._frame, self._presented = m, frame, None
        if pipeline.is_cut:
            self.cuts.add(m)
        self._before = before.camera if before and not (frame.reset or pipeline.is_cut) else None
        pixels: Any = host or frame
        if host is not None and host.motion is None:
            pixels = host.in_device_layout()
        self.passed.appendleft(
            Passed(
                m,
                frame.camera,
                frame.shown_camera,
                source.render_size,
                pixels.depth,
                pixels.motion,
                self._before is None,
            )
        )
        self.bad_pixels = host.bad if self.stored and host else self._upload.take_bad_pixels() if host else BadPixels()
        self.invalid = _invalid_pixels(host, self.bad_pixels) if host and last else None


class SlotMaker:
    """Makes slots of `source`, one after the other. It is the only user of `source`.

    Attributes
    ----------
    check : callable
        Called between rendered frames; may raise to give up what is being made.
    key : Key or None
        The slot that was made last.
    used_at : int
        The number of slots made so far by all makers when this one was used last.
    nbytes : int
        What its pipeline has on the device.
    """

    _used = itertools.count(1)

    def __init__(self, device: Device, source: FrameSource, kernels: Kernels, check: Callable[[], None]):
        self.source, self._kernels, self.check = source, kernels, check
        self._seeker = Seeker(device, source, lambda: self.check())
        self.key: Key | None = None
        self.used_at = self.nbytes = 0

    @property
    def progress(self) -> tuple[int, int]:
        """Rendered frames that are submitted for the slot under way, and all that are needed."""
        return self._seeker.progress

    def drop(self) -> None:
        """Free the pipeline, for good."""
        self._seeker.drop()
        self.nbytes = 0

    def holds(self, key: Key) -> bool:
        """Return whether the pipeline's buffers are those of this slot."""
        return self._seeker.shot is not None and self.key == key

    def steps_to(self, key: Key) -> int:
        """Return the number of rendered frames to submit until a slot can be made."""
        k, seeker = key.slot // (key.recipe.setup.n + 1), self._seeker
        continues = self.key is not None and self.key.recipe == key.recipe
        continues = continues and seeker.continues_to(k, key.provisional)
        return len(seeker.frames_to(k, key.provisional, continues))

    def make(self, key: Key, layers: frozenset[str], to_inspect: bool = False) -> Frame:
        """Return the computed slot. `to_inspect`: the pipeline's buffers are to hold all layers, whichever are asked
        for. After an error the pipeline must be dropped; after Interrupted it goes on from there next time."""
        start = time.perf_counter()
        alphas = (0.0, *alphas_for(key.recipe.setup.n))
        k, j = divmod(key.slot, len(alphas))
        if not 0 <= k < self.source.count:
            raise GffeError(f"slot {key.slot}: expected 0 to {self.source.count * len(alphas) - 1}")
        self.key, self.used_at = key, next(self._used)
        with self._kernels.used(key.recipe.kernels):
            return self._made(key, layers, k, alphas[j], start, to_inspect)

    def _made(self, key: Key, layers: frozenset[str], k: int, alpha: float, start: float, to_inspect: bool) -> Frame:
        seeker, source = self._seeker, self.source
        seeker.prepare(key.recipe)
        notes = seeker.go_to(k, alpha, key.provisional)
        pipeline = seeker.pipeline
        assert pipeline is not None  # `go_to` made it
        pipeline.keep(None if to_inspect else layers)
        shot = seeker.shoot(k, alpha)
        specs = layers_of(pipeline)
        if not source.has_truth:
            del specs[names.TRUTH], specs[names.FOCUS_TRUTH]
        own = {RESIDUAL.name: RESIDUAL} | ({} if seeker.invalid is None else {INVALID.name: INVALID})
        place = list(specs).index(names.RENDERED_MOTION) + 1  # after the other layers of the input
        specs = dict(list(specs.items())[:place]) | own | specs
        stored, size, buffers = seeker.stored, source.render_size, ()
        if stored is None:
            del specs[names.UNDONE]
        else:
            buffers = in_words(source.format, size, stored.depth.shape[::-1], stored.geometry_jitter)
        kernels = pipeline.take_kernel_timings()
        wanted, truth = layers & specs.keys(), None
        if alpha and source.has_truth and wanted & {names.TRUTH, names.FOCUS_TRUTH}:
            seeker.truth = truth = self._truth(k, alpha, notes)
        self.nbytes = sum(memory(pipeline).values())
        reading = time.perf_counter()
        needed = {names.RENDERED_DEPTH, names.RENDERED_MOTION} if RESIDUAL.name in wanted else set()
        read = read_layers(pipeline, device_layers(pipeline, shot), wanted | needed)
        images = {name: image for name, image in read.items() if name in wanted}
        readback_ms = (time.perf_counter() - reading) * 1e3
        if stored is not None and names.UNDONE in wanted:
            assert seeker.converted is not None  # as it was stored
            images[names.UNDONE] = _changed_motion(stored, seeker.converted, source.format)
        if needed and (before := shot.moment.previous_camera) is not None:
            depth, motion = read[names.RENDERED_DEPTH], read[names.RENDERED_MOTION]
            px = np.stack(np.meshgrid(np.arange(size[0]), np.arange(size[1])), -1) + 0.5
            images[RESIDUAL.name] = residual_motion(px, depth, motion, shot.moment.render_camera, before)
        if seeker.invalid is not None and INVALID.name in wanted:
            images[INVALID.name] = seeker.invalid
        if truth is not None and names.TRUTH in wanted:
            images[names.TRUTH] = rgba_of(truth)
        if truth is not None and names.FOCUS_TRUTH in wanted:
            images[names.FOCUS_TRUTH] = seeker.find_focus(rgba_of(truth))
        return Frame(
            key,
            layers,
            shot.moment,
            images=images,
            specs=specs,
            kernels=kernels,
            wall_ms=(time.perf_counter() - start) * 1e3,
            readback_ms=readback_ms,
            warnings=(*source.warnings(), *notes),
            bad_pixels=seeker.bad_pixels,
            cuts=frozenset(seeker.cuts),
            submitted=seeker.progress[1],
            render_size=size,
            buffers=buffers,
        )

    def _truth(self, k: int, alpha: float, notes: list[str]) -> np.ndarray | None:
        """Return the ground truth, None if there is none. A fault of it becomes a warning in `notes`, because the slot
        itself can be shown."""
        try:
            return self.source.truth(k, alpha)
        except GffeError as error:
            notes.append(str(error))
            return None

    def inspect(self, x: int, y: int) -> Inspection | None:
        """Return the values of the last slot at display pixel (x, y); None outside, and without a slot."""
        seeker = self._seeker
        if not (seeker.shot and 0 <= x < self.source.width and 0 <= y < self.source.height):
            return None
        pipeline, shot = seeker.pipeline, seeker.shot
        assert pipeline is not None and self.key is not None  # as there is a shot
        values = pixel_values(pipeline, shot, x, y)
        at, moment = source_position(pipeline, shot, x, y), shot.moment
        fault = _fault_at(seeker.invalid, at)
        shown = moved((x + 0.5, y + 0.5), moment.display_camera, moment.render_camera)
        for found, px in ((values.here, shown), (values.origin, at if moment.alpha else None)):
            if (texel := _texel_at(seeker.invalid, px)) is not None:
                found[INVALID.name] = texel
            if moment.previous_camera is not None and names.RENDERED_DEPTH in found and px is not None:
                of_pixel = np.floor(px) + 0.5, found[names.RENDERED_DEPTH][0], found[names.RENDERED_MOTION]
                found[RESIDUAL.name] = residual_motion(*of_pixel, moment.render_camera, moment.previous_camera)
        story = pixel_story(pipeline, shot, x, y, values, seeker.passed, fault)
        if seeker.truth is not None:
            values.here[names.TRUTH] = rgba_of(seeker.truth[y : y + 1, x : x + 1])[0, 0]
        if seeker.focus is not None:
            values.here[names.FOCUS_TRUTH] = seeker.focus[y, x : x + 1]
        return Inspection((x, y), self.key.slot, story.source, values.here, story, fault, values.origin)


def weights_of(options: Options) -> str:
    """Return the identity of the weights of shading correction; empty where it is off."""
    path = options.weights
    return "" if path is None else f"{path} {state_of(path)}"


def residual_motion(px: np.ndarray, depth, motion: np.ndarray, camera: Camera, before: Camera) -> np.ndarray:
    """Return (…, 2) float32, pixels: motion vectors (…, 2) minus those of static points at pixel positions (…, 2) and
    depths (…), from a frame's render camera into that of the one before; NaN where depth or motion is unknown."""
    there, z = before.project(camera.unproject(px, np.minimum(depth, _SKY)))
    known = (np.asarray(depth) > 0) & (z > 0) & np.isfinite(motion).all(-1)
    return np.where(known[..., None], motion - (there - px), np.nan).astype(np.float32)


def _changed_motion(stored: RenderedFrame, used: RenderedFrame, format: FrameFormat | None) -> np.ndarray:
    """Return motion in use minus motion as stored, (H, W, 2) float32, pixels of color; 0 without motion."""
    if stored.motion is None or used.motion is None:
        return np.zeros((*used.color.shape[:2], 2), np.float32)
    plain = replace(
        format or FrameFormat(),
        motion_dilated=False,
        motion_jittered=False,
        motion_invalid=None,
        camera_motion="included",
    )
    given = described_frame(stored, plain, None, (0.0, 0.0)).motion
    assert given is not None  # as it is stored
    return np.asarray(used.motion, np.float32) - given


def _invalid_pixels(host: RenderedFrame, found: BadPixels) -> np.ndarray:
    """Return the mask of a rendered frame's invalid pixels, (H, W) uint8, a bit for each kind of fault; `found`: their
    counts."""
    mask = np.zeros(host.depth.shape, np.uint8)
    wrong = host.wrong if found else {}
    for bit, name in enumerate(_FAULTS):
        if name in wrong:
            mask |= wrong[name].astype(np.uint8) << bit
    return mask


def _texel_at(mask: np.ndarray | None, px: tuple[float, float] | None) -> np.ndarray | None:
    """Return the (1,) value of a mask at this position, pixels; None outside, and without a mask or a position."""
    if mask is None or px is None:
        return None
    x, y = int(np.floor(px[0])), int(np.floor(px[1]))
    return mask[y, x : x + 1] if 0 <= x < mask.shape[1] and 0 <= y < mask.shape[0] else None


def _fault_at(mask: np.ndarray | None, px: tuple[float, float] | None) -> str:
    """Return what is wrong with the pixel of a mask at this position, pixels; empty for a valid one, and outside."""
    texel = _texel_at(mask, px)
    bits = 0 if texel is None else int(texel[0])
    return "; ".join(text for bit, text in enumerate(_FAULTS.values()) if bits >> bit & 1)
