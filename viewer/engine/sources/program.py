"""The viewer's side: a running program that it looks into."""

from __future__ import annotations

import mmap
import os
import threading
from collections import deque
from collections.abc import Callable
from pathlib import Path

import numpy as np

from gffe_cl.captures.formats.capture import described
from gffe_cl.captures.sequence.description import FrameEntry, rendered_entry
from gffe_cl.captures.sequence.pixel_source import ForeignPixels
from gffe_cl.captures.sequence.reader import Sequence
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.inspection.attached import wire
from gffe_cl.engine.inspection.attached.channel import NO_ANSWER, OtherVersion, connect, own_version
from gffe_cl.engine.inspection.attached.encoding import decoded, encoded
from gffe_cl.engine.inspection.attached.shared_memory import About, RecordingPlan, mapped, recorded
from gffe_cl.engine.inspection.explain.pixel_explain_types import Inspection
from gffe_cl.engine.inspection.layers import LayerSpec
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pacing import PacingStatistics
from ..background import Background

FRAMES = 24  # rendered frames that are recorded unless asked otherwise
_ANSWER_SECONDS = 5.0
_POLL_SECONDS = 0.05
_PACINGS = 240


class RunningProgram:
    """The program that is attached as `name`, which records its last `frames` rendered frames from now on.

    Attributes
    ----------
    about : Program
    options : Options
        That its pipeline has.
    specs : dict of LayerSpec
        Layers that can be seen, by their names.
    ended : bool
        Whether it has closed, or died. What it recorded last can still be read.
    pacing : deque of PacingStatistics
        Of the last frames that were seen, if it told any.

    Raises GffeError if there is none of that name, or if it does not answer.
    """

    def __init__(self, name: str, frames: int = FRAMES):
        self.name, self.frames, self.ended = name, frames, False
        self.pacing: deque[PacingStatistics] = deque(maxlen=_PACINGS)
        self.specs: dict[str, LayerSpec] = {}
        self._channel = connect(name)
        self._news = threading.Condition()
        self._seen: tuple[wire.Seen, dict[str, np.ndarray]] | None = None
        self._owed = False  # an answer to `see`
        self._inspection: Inspection | None = None
        self._refused: wire.Refused | None = None
        self._block: mmap.mmap | None = None  # images of displayed frames
        self._plan: RecordingPlan | None = None
        self._recorded: mmap.mmap | None = None
        try:
            self._channel.agree(_ANSWER_SECONDS)
            self._channel.send(encoded(wire.Greeting(frames)))
            self.about: wire.Program = decoded(self._channel.receive(_ANSWER_SECONDS), wire.Program)
        except BaseException as error:
            self._channel.close()
            reasons = {
                TimeoutError: NO_ANSWER,
                OtherVersion: f"it runs gffe-cl {error}, this viewer is of {own_version()} (expected the same version)",
            }
            if isinstance(error, EOFError | OSError | OtherVersion):
                said = reasons.get(type(error), "the program has ended, or cannot record so many frames")
                raise GffeError(f"{name}: {said}") from None
            raise
        self.options = self.about.options
        Background("attached").run(self._listen)

    def close(self) -> None:
        self._channel.close()

    def use(self, options: Options) -> None:
        """Have the pipeline work with `options` from its next rendered frame on."""
        self._send(wire.Use(options))

    def see(self, layers: frozenset[str], generated: bool, check: Callable[[], None]) -> tuple[wire.Seen, dict]:
        """Return the next frame and its images, copied. Waits for it; `check` is called meanwhile and may raise. Raises
        GffeError if the program has ended, and if it refused options."""
        if self._owed:  # the caller did not wait for it, and may have requested other layers
            self._wait("_seen", check)
        self._owed = True
        self._send(wire.Look(layers, generated))
        seen, images = self._wait("_seen", check)
        self._owed = False
        return seen, {name: np.array(image) for name, image in images.items()}

    def inspect(self, x: int, y: int, layers: frozenset[str] | None, check: Callable[[], None]) -> Inspection:
        """Return the next frame's values at a pixel. Waits and raises as `see` does."""
        self._send(wire.Ask(x, y, layers))
        return self._wait("_inspection", check)

    def recording(self) -> Sequence:
        """Return the last rendered frames, copied, as a sequence; also of a program that has ended. Raises GffeError if
        it has recorded none."""
        plan, memory = self._plan, self._recorded
        kept = recorded(plan, memory) if plan is not None and memory is not None else []
        if plan is None or not kept:
            raise GffeError(f"{self.name}: no rendered frame was recorded yet")
        return sequence_of(kept, plan, self.name)

    def _send(self, message) -> None:
        try:
            self._channel.send(encoded(message))
        except OSError:
            self.ended = True

    def _wait(self, kind: str, check: Callable[[], None]):
        while True:
            check()
            with self._news:
                if getattr(self, kind) is None and not self.ended and self._refused is None:
                    self._news.wait(_POLL_SECONDS)
                refused, self._refused = self._refused, None
                answer = getattr(self, kind)
                setattr(self, kind, None)
            if refused is not None:
                raise GffeError(f"{self.name}: {refused.why}")
            if answer is not None:
                return answer
            if self.ended:
                why = f"the program '{self.name}' has ended or made a new pipeline"
                raise GffeError(f"{why}; its last frames can be looked at and written")

    # ---- on a thread of its own ----------------------------------------------------------------------------

    def _listen(self) -> None:
        try:
            while True:
                packet, fds = self._channel.receive_with_fds()
                try:
                    self._take(decoded(packet, *wire.FROM_PROGRAM), [mapped(descriptor) for descriptor in fds])
                finally:
                    for descriptor in fds:
                        os.close(descriptor)
        except Exception:  # the program has ended, or sends something else
            self._channel.close()
            with self._news:
                self.ended = True
                self._news.notify_all()

    def _take(self, message, blocks: list[mmap.mmap]) -> None:
        with self._news:
            if isinstance(message, wire.Recording):
                (block,) = blocks
                if message.plan.nbytes > len(block):
                    raise GffeError(f"{self.name}: its recording is larger than its memory")
                self._plan, self._recorded = message.plan, block
            elif isinstance(message, wire.Seen):
                if blocks:
                    (self._block,) = blocks
                if self._block is None:
                    raise GffeError(f"{self.name}: no memory came with its images")
                images = {name: place.array(self._block) for name, place in message.images.items()}
                self.options, self.specs = message.options, message.specs or self.specs
                if message.pacing is not None:
                    self.pacing.append(message.pacing)
                self._seen = message, images
            elif isinstance(message, Inspection):
                self._inspection = message
            elif isinstance(message, wire.Refused):
                self.options, self._refused = message.options, message
            self._news.notify_all()


def sequence_of(kept: list[tuple[About, list[np.ndarray]]], plan: RecordingPlan, name: str) -> Sequence:
    """Return recorded frames, at least one, as a sequence."""
    entries, cameras, pixels = [], [], _RecordedPixels()
    for about, (color, depth, motion) in kept:
        images = color[..., :3], depth, motion
        frame = RenderedFrame(*images, about.camera, about.time, about.display_camera, about.reset)
        entries.append(rendered_entry(about.number, frame, plan.display))
        pixels.images[entries[-1].file] = images
        for time, camera in about.cameras.items():
            cameras.append(FrameEntry("", time, "camera_only", display_camera=camera))
    exposure = kept[-1][0].exposure
    return Sequence(Path(name), described(name, plan.display, entries, plan.fps, exposure, cameras), pixels)


class _RecordedPixels(ForeignPixels):
    """Pixels of recorded frames, in memory: `images` by the entries' file names."""

    def __init__(self):
        super().__init__()
        self.images: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}

    def rendered(self, entry, size):
        return self.images[entry.file]

    def color(self, entry, size):
        return self.images[entry.file][0]
