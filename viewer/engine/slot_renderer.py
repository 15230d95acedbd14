"""Computation of slots: a pipeline, its last slot, and queries about it."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable

import numpy as np

from gffe_cl.captures.offline.run import alphas_for
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.rendered_frame import HALF_MAX
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.options import Options
from gffe_cl.engine.timing.parts import memory
from . import names
from .buffers import Shot, device_layers, moved, pixel_values, read_layers, source_position
from .description import changed_motion, in_words
from .explain.pixel_explain import pixel_story
from .invalid import Invalid, fault_at, seen_at, seen_through
from .layers import layers_of
from .messages import Frame, Inspection, Interrupted, Key
from .reloading import Kernels
from .seeker import Seeker
from .sources.source import FrameSource


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
        What its pipeline has on the device, and its source.
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

    def holds(self, key: Key) -> bool:
        """Return whether the pipeline's buffers are those of this slot."""
        return self._seeker.shot is not None and self.key == key

    def steps_to(self, key: Key) -> float:
        """Return the rendered frames to submit until a slot can be made; infinity if the pipeline starts anew."""
        if self.key is None or not self.key.recipe.continues(key.recipe):
            return math.inf
        return self._seeker.steps_to(key.slot // (key.recipe.setup.n + 1))

    def make(self, key: Key, layers: frozenset[str], to_inspect: bool = False) -> Frame:
        """Return the computed slot. `to_inspect`: the pipeline's buffers are to hold all layers, whichever are asked
        for. Raises GffeError; the pipeline is forgotten then."""
        start = time.perf_counter()
        alphas = (0.0, *alphas_for(key.recipe.setup.n))
        k, j = divmod(key.slot, len(alphas))
        if not 0 <= k < self.source.count:
            raise GffeError(f"slot {key.slot}: expected 0 to {self.source.count * len(alphas) - 1}")
        self.key, self.used_at = key, next(self._used)
        try:
            with self._kernels.used(key.recipe.kernels):
                return self._made(key, layers, k, alphas[j], start, to_inspect)
        except Interrupted:
            raise  # goes on from there next time
        except Exception:
            self._seeker.drop()
            raise

    def _made(self, key: Key, layers: frozenset[str], k: int, alpha: float, start: float, to_inspect: bool) -> Frame:
        seeker, source = self._seeker, self.source
        seeker.prepare(key.recipe)
        notes = seeker.go_to(k, alpha)
        pipeline = seeker.pipeline
        assert pipeline is not None  # `go_to` made it
        pipeline.keep(None if to_inspect else layers)
        shot = seeker.shoot(k, alpha)
        specs = layers_of(pipeline)
        if not source.has_truth:
            del specs[names.TRUTH], specs[names.FOCUS_TRUTH]
        stored, size, buffers = seeker.stored, source.render_size, ()
        if stored is None:
            del specs[names.UNDONE]
        else:
            buffers = in_words(source.format, size, stored.depth.shape[::-1], stored.geometry_jitter)
        kernels = pipeline.take_kernel_timings()
        wanted, truth = layers & specs.keys(), None
        if alpha and source.has_truth and wanted & {names.TRUTH, names.FOCUS_TRUTH}:
            seeker.truth = truth = self._truth(k, alpha, notes)
        if truth is not None and names.FOCUS_TRUTH in wanted:
            seeker.find_focus(_rgba(truth))
        self.nbytes = sum(memory(pipeline).values()) + source.nbytes
        reading = time.perf_counter()
        images = read_layers(pipeline, device_layers(pipeline, shot), wanted)
        readback_ms = (time.perf_counter() - reading) * 1e3
        if stored is not None and names.UNDONE in wanted:
            assert seeker.converted is not None  # as it was stored
            images[names.UNDONE] = changed_motion(stored, seeker.converted, source.format)
        if truth is not None and names.TRUTH in wanted:
            images[names.TRUTH] = _rgba(truth)
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
            invalid=self._invalid(shot),
            cuts=frozenset(seeker.cuts),
            render_size=size,
            buffers=buffers,
        )

    def _invalid(self, shot: Shot) -> Invalid | None:
        """Return where invalid pixels of the input are seen, None if there are none."""
        mask, pipeline, moment = self._seeker.invalid, self._seeker.pipeline, shot.moment
        if mask is None or pipeline is None:
            return None
        if moment.alpha:
            motion = read_layers(pipeline, device_layers(pipeline, shot), [names.MOTION])[names.MOTION]
            return Invalid(mask, seen_through(mask, motion))
        place = lambda x, y: moved((x, y), moment.display_camera, moment.render_camera)  # noqa: E731
        return Invalid(mask, seen_at(mask, (self.source.width, self.source.height), place))

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
        fault = fault_at(seeker.invalid, source_position(pipeline, shot, x, y))
        story = pixel_story(pipeline, shot, x, y, values, seeker.passed, fault)
        if seeker.truth is not None:
            values.here[names.TRUTH] = _rgba(seeker.truth[y : y + 1, x : x + 1])[0, 0]
        return Inspection((x, y), self.key.slot, story.source, values.here, story, fault, values.origin)


def weights_of(options: Options) -> str:
    """Return the identity of the weights of shading correction; empty where it is off."""
    path = options.weights
    if path is None:
        return ""
    try:
        state = path.stat()
    except OSError:
        return str(path)
    return f"{path} {state.st_mtime_ns} {state.st_size}"


def _rgba(color: np.ndarray) -> np.ndarray:
    """Return colors (H, W, 3) as (H, W, 4) float16 with 0 in the last channel; other types are clipped to float16's
    range."""
    out = np.zeros((*color.shape[:2], 4), np.float16)
    out[..., :3] = color if color.dtype == np.float16 else np.clip(color, -HALF_MAX, HALF_MAX)
    return out
