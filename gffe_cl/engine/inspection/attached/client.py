"""The side of the program whose pipeline is looked into: `gffe_cl.attach`."""

from __future__ import annotations

import os
import re
import sys
import threading
import time
import weakref
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyopencl as cl

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import require_kind, require_whole
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.inspection import names
from gffe_cl.engine.inspection.attached import wire
from gffe_cl.engine.inspection.attached.channel import Channel, Listener
from gffe_cl.engine.inspection.attached.encoding import decoded, encoded
from gffe_cl.engine.inspection.attached.shared_memory import Recorder, RecordingPlan, SharedBlock, placed
from gffe_cl.engine.inspection.buffers import Moment, Shot, device_layers, pixel_values, start_reading
from gffe_cl.engine.inspection.description import in_words
from gffe_cl.engine.inspection.explain.motion_trail import Passed
from gffe_cl.engine.inspection.explain.pixel_explain import pixel_story
from gffe_cl.engine.inspection.explain.pixel_explain_types import Inspection
from gffe_cl.engine.inspection.layers import LayerSpec, layers_of
from gffe_cl.engine.pipeline.made_frame import ExtrapolatedFrame
from gffe_cl.engine.pipeline.pacing import Pacer
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.buffers import DeviceFrame
from gffe_cl.engine.stages.commands import milliseconds_of
from gffe_cl.engine.stages.correction import ShadingCorrection

_GREETING_SECONDS = 2.0
_LEAST_SECONDS = 1 / 60  # between two frames that are looked at
_MOST_SHARE = 0.1  # of the program's time that looking may take
_MOST_SKIPPED = 8  # frames that wait for one of the other kind
_GENERATES = 3  # rendered frames that follow each other in a program that generates others now and then


def attach(pipeline: Pipeline, name: str | None = None, *, pacer: Pacer | None = None) -> Attachment:
    """Let the viewer look into `pipeline` while this program runs: `gffe view --attach NAME` in another process.

    One viewer at a time, of the same user on the same machine; Linux only. While nobody looks, frames take as long as
    without it. While somebody does, `Pipeline.keep` is the viewer's, and so are `Pipeline.options` as soon as a module
    is switched there. The program goes on when the viewer ends or is killed.

    Parameters
    ----------
    pipeline : Pipeline
        Frames are looked at when it submits and extrapolates them, on the thread that does. Times of kernels are shown
        if its device was opened with `profiling=True`.
    name : str or None
        What the viewer finds this program by: letters, digits, ".", "_", "-". Default: the name of the script, with a
        number if that is taken.
    pacer : Pacer or None
        Its statistics are shown beside the timings.

    Returns
    -------
    Attachment
        With `name`, `watched` and `close()`; a context manager. It ends with the pipeline or the program.

    Raises
    ------
    GffeError
        On other systems, for a name that is taken or has other characters, and for a pipeline that is attached already.
    """
    require_kind(pipeline, Pipeline, "attach: pipeline", "a Pipeline")
    if pacer is not None:
        require_kind(pacer, Pacer, "attach: pacer", "a Pacer or None")
    if pipeline.watcher is not None:
        raise GffeError("attach: this pipeline is attached already (expected close() before)")
    attachment = Attachment(pipeline, name, pacer)
    pipeline.watcher = attachment._watcher
    return attachment


class Attachment:
    """Attachment of a pipeline, returned by `attach`; a context manager.

    Attributes
    ----------
    name : str
        For `gffe view --attach`.
    """

    def __init__(self, pipeline: Pipeline, name: str | None, pacer: Pacer | None):
        stem = re.sub(r"[^\w.-]", "_", Path(sys.argv[0]).stem, flags=re.ASCII)[:48] or "python"
        listener = Listener(name, stem)
        self.name = listener.name
        self._pipeline = weakref.ref(pipeline)
        self._watcher = _Watcher(pacer)
        self._end = weakref.finalize(pipeline, _end, self._watcher, listener)  # at the program's end, too
        thread = threading.Thread(
            target=_serve, args=(self._watcher, listener, self._pipeline), name="gffe-attached", daemon=True
        )
        thread.start()

    @property
    def watched(self) -> bool:
        """Whether a viewer is looking."""
        return self._watcher.viewer is not None

    def close(self) -> None:
        """Send the viewer away, and let no other one come. A second call does nothing."""
        pipeline = self._pipeline()
        if self._end.alive and pipeline is not None:
            pipeline.watcher = None
        self._end()

    def __enter__(self) -> Attachment:
        return self

    def __exit__(self, *_) -> None:
        self.close()


def _end(watcher: _Watcher, listener: Listener) -> None:
    listener.close()
    watcher.leave(watcher.viewer)


def _serve(watcher: _Watcher, listener: Listener, pipeline: weakref.ref) -> None:
    """Take one viewer after the other, until the listener is closed."""
    while True:
        try:
            channel = listener.accept()
        except OSError:
            return
        _look(watcher, channel, pipeline)  # a function of its own, so that nothing of it is kept


def _look(watcher: _Watcher, channel: Channel, pipeline: weakref.ref) -> None:
    """Serve a viewer until it leaves."""
    viewer = None
    try:
        viewer = _welcomed(channel, pipeline)
        watcher.viewer = viewer
        while True:
            viewer.take(channel.receive())
    except Exception:  # whatever a viewer sends, the next one can come
        channel.close()
        watcher.leave(viewer)


def _welcomed(channel: Channel, pipeline: weakref.ref) -> _Viewer:
    """Return the viewer, after the greeting. Raises an exception of any type unless it is one of this version."""
    channel.agree(_GREETING_SECONDS)
    greeting = decoded(channel.receive(_GREETING_SECONDS), wire.Greeting)
    looked_into = pipeline()
    if looked_into is None:
        raise EOFError
    sizes, fps, device = looked_into.sizes, looked_into.fps, looked_into.device.info.name
    about = wire.Program(os.getpid(), sizes.target, sizes.source, fps, device, looked_into.options)
    channel.send(encoded(about))
    recorder = None
    if greeting.frames:
        recorder = Recorder(RecordingPlan.of(greeting.frames, sizes.source, sizes.target, fps))
        channel.send(encoded(wire.Recording(recorder.plan)), (recorder.block.descriptor,))
    return _Viewer(channel, recorder, sizes.target)


class _Viewer:
    """A connected viewer: its requests, which arrive on a thread of their own, and the answers sent."""

    def __init__(self, channel: Channel, recorder: Recorder | None, size: tuple[int, int]):
        self.channel, self.recorder, self._size = channel, recorder, size
        self.looks: deque[wire.Look] = deque(maxlen=1)
        self.asks: deque[wire.Ask] = deque(maxlen=1)
        self.uses: deque[wire.Use] = deque(maxlen=1)
        self.block: SharedBlock | None = None
        self.specs: dict[str, LayerSpec] | None = None
        self.pending: _Pending | None = None  # the layers it will receive

    def take(self, packet: bytes) -> None:
        """Note the request. Raises GffeError for other packets."""
        message = decoded(packet, *wire.FROM_VIEWER)
        if isinstance(message, wire.Ask):
            require_whole(message.x, "attach: x", 0, self._size[0] - 1)
            require_whole(message.y, "attach: y", 0, self._size[1] - 1)
        wishes = {wire.Look: self.looks, wire.Ask: self.asks, wire.Use: self.uses}
        wishes[type(message)].append(message)

    def send(self, message, fds: tuple[int, ...] = ()) -> None:
        self.channel.send(encoded(message), fds)


class _Watcher:
    """Hook of the pipeline. Any failure here disconnects the viewer, and has no other effect."""

    def __init__(self, pacer: Pacer | None):
        self.viewer: _Viewer | None = None
        self._pacer = pacer
        self._number = -1  # of the rendered frame
        self._buffers: tuple[str, ...] = ()  # its description
        self._camera: Camera | None = None  # its camera, and that of the one before
        self._before: Camera | None = None
        self._frame: DeviceFrame | None = None
        self._passed: deque[Passed] = deque(maxlen=2)  # whose buffers are not overwritten yet
        self._mark: object = None  # the last command before this frame
        self._specs: dict[str, LayerSpec] = {}  # of all layers
        self._specs_of: tuple | None = None  # their inputs
        self._kept: frozenset[str] = frozenset()  # outputs that the pipeline keeps
        self._rested = self._ended = 0.0  # from when on a frame may be looked at; when the last one was shown
        self._frame_ms = 0.0
        self._seen_generated, self._skipped = False, 0  # rendered and generated frames take turns
        self._generates = 0  # rendered frames from which on none is thought to be generated any more

    def leave(self, viewer: _Viewer | None) -> None:
        """Send this viewer away, if there is one."""
        if viewer is not None:
            if self.viewer is viewer:
                self.viewer = None
            viewer.channel.close()

    # ---- called by the pipeline ----------------------------------------------------------------------------

    def before(self, pipeline: Pipeline, rendered: bool = False) -> None:
        self._carefully(self._before_frame, pipeline, rendered)
        if self.viewer is None and self._kept:
            self._keep(pipeline, frozenset())

    def submitted(self, pipeline: Pipeline, frame: RenderedFrame, on_device: DeviceFrame) -> None:
        # Asking for cuts may wait for the device, which a program that nobody looks into must not.
        is_cut = self.viewer is not None and pipeline.is_cut
        begins = frame.reset or is_cut or self._camera is None
        self._number += 1
        geometry = frame.geometry_size or (pipeline.format and pipeline.format.geometry_size)
        self._buffers = in_words(pipeline.format, pipeline.sizes.source, geometry, frame.geometry_jitter)
        self._before, self._camera = None if begins else self._camera, frame.camera
        self._frame = on_device
        self._passed.appendleft(
            Passed(
                self._number, on_device.camera, on_device.display_camera, pipeline.sizes.source, on_device.depth,
                on_device.motion, begins,
            )
        )  # fmt: skip
        self._carefully(self._after_submit, pipeline, frame)

    def extrapolated(self, pipeline: Pipeline, frame: ExtrapolatedFrame) -> None:
        self._carefully(self._after_extrapolate, pipeline, frame)

    def _carefully(self, work, pipeline: Pipeline, *arguments) -> None:
        viewer = self.viewer
        if viewer is None:
            return
        try:
            work(viewer, pipeline, *arguments)
        except Exception:  # whatever it is, this program must go on
            self.leave(viewer)

    def _keep(self, pipeline: Pipeline, layers: frozenset[str]) -> None:
        if layers != self._kept:
            self._kept = layers
            pipeline.keep(layers)

    # ---- while a viewer looks ------------------------------------------------------------------------------

    def _before_frame(self, viewer: _Viewer, pipeline: Pipeline, rendered: bool) -> None:
        if viewer.pending is not None and (rendered or viewer.pending.moment.alpha):
            self._finish(viewer, pipeline)
        if rendered:
            if viewer.recorder:
                viewer.recorder.finish()
            if viewer.uses:
                self._use(viewer, pipeline, viewer.uses.popleft())
        if viewer.looks:
            self._keep(pipeline, viewer.looks[0].layers)
            if ShadingCorrection.name in pipeline.stages:
                with suppress(cl.Error):  # while the device is at work, they are not to be had
                    pipeline.stages[ShadingCorrection.name].take_network_milliseconds()  # of undisplayed frames
        events = pipeline.board.commands.events
        self._mark = events[-1] if events else None

    def _use(self, viewer: _Viewer, pipeline: Pipeline, use: wire.Use) -> None:
        try:
            pipeline.change_options(use.options)
        except GffeError as error:
            viewer.send(wire.Refused(str(error), pipeline.options))
        else:
            self._kept, self._camera = frozenset(), None
            self._passed.clear()

    def _after_submit(self, viewer: _Viewer, pipeline: Pipeline, frame: RenderedFrame) -> None:
        if viewer.recorder and self._frame:
            begins = frame.reset or pipeline.is_cut
            viewer.recorder.take(self._number, frame, self._frame, pipeline.device.queue, begins, pipeline.exposure)
        self._show(viewer, pipeline, None)

    def _after_extrapolate(self, viewer: _Viewer, pipeline: Pipeline, frame: ExtrapolatedFrame) -> None:
        if viewer.recorder:
            viewer.recorder.made(frame.time, frame.camera)
        if viewer.pending is not None and viewer.pending.is_there:
            self._finish(viewer, pipeline)
        self._show(viewer, pipeline, frame)

    def _show(self, viewer: _Viewer, pipeline: Pipeline, made: ExtrapolatedFrame | None) -> None:
        start = time.perf_counter()
        self._frame_ms = (start - self._ended) * 1e3 if self._ended else 0.0
        self._ended = start
        preferred = self._generates <= 0 or made is not None
        asks_for_kept = viewer.looks and viewer.looks[0].layers == self._kept  # not in the midst of this frame
        due = asks_for_kept and start >= self._rested
        if due:
            turn = (made is not None) != self._seen_generated or self._skipped >= _MOST_SKIPPED
            due = preferred if viewer.looks[0].generated else turn or (made is None and preferred)
            self._skipped = 0 if due else self._skipped + 1
        self._generates = _GENERATES if made is not None else self._generates - 1
        asked = preferred and viewer.asks
        if not due and not asked:
            return
        shot = self._shot(pipeline, made)
        if due:
            self._rested, self._seen_generated = start + _LEAST_SECONDS, made is not None
            self._start(viewer, pipeline, shot, viewer.looks.popleft(), start)
        if asked:
            self._inspect(viewer, pipeline, shot, viewer.asks.popleft())
        self._ended = time.perf_counter()

    def _shot(self, pipeline: Pipeline, made: ExtrapolatedFrame | None) -> Shot:
        frame = self._frame
        assert frame is not None  # as something was submitted
        buffers = {
            names.RENDERED_COLOR: frame.color,
            names.RENDERED_DEPTH: frame.depth,
            names.RENDERED_MOTION: frame.motion,
        }
        if made is None:
            shown = pipeline.present()
            cameras = frame.camera, shown.camera, self._before
            return Shot(Moment(self._number, 0.0, frame.time, shown.camera, *cameras), {
                **buffers, names.FINAL: shown.color
            })  # fmt: skip
        cameras = frame.camera, pipeline.shown_camera, self._before
        buffers[names.FINAL] = made.color
        if ShadingCorrection.name in pipeline.stages:
            buffers[names.GAE] = made.gae
        return Shot(Moment(self._number, made.alpha, made.time, made.camera, *cameras), buffers)

    def _start(self, viewer: _Viewer, pipeline: Pipeline, shot: Shot, look: wire.Look, start: float) -> None:
        """Start reading the layers back while the program continues."""
        converted = tuple(spec.name for _, spec, _ in pipeline.conversions())
        board, before = (
            (pipeline.board, bool(pipeline.display.presentation), bool(pipeline.intake.composition), converted),
            self._specs_of,
        )
        if before is None or before[0] is not board[0] or before[1:] != board[1:]:
            self._specs_of = board
            self._specs = {
                name: spec
                for name, spec in layers_of(pipeline).items()
                if name not in (names.TRUTH, names.FOCUS_TRUTH, names.UNDONE)  # it is not rendered, or not kept
            }
        wanted = look.layers & self._specs.keys()
        events, images = start_reading(pipeline, device_layers(pipeline, shot), wanted)
        pipeline.device.queue.flush()
        launched = self._since_mark(pipeline)
        milliseconds = (time.perf_counter() - start) * 1e3
        viewer.pending = _Pending(shot.moment, events, images, launched, self._frame_ms, milliseconds)

    def _finish(self, viewer: _Viewer, pipeline: Pipeline) -> None:
        """Wait for the layers, and send them."""
        start, pending, viewer.pending = time.perf_counter(), viewer.pending, None
        assert pending is not None
        if pending.events:
            cl.wait_for_events(pending.events)
        images = pending.images()
        places, nbytes = placed(images)
        fds = ()
        if viewer.block is None or viewer.block.nbytes < nbytes:
            viewer.block = SharedBlock(nbytes)
            fds = (viewer.block.descriptor,)
        for name, place in places.items():
            np.copyto(place.array(viewer.block.memory), images[name])
        specs = None if viewer.specs is self._specs else self._specs
        viewer.specs = self._specs
        correction = pipeline.stages.get(ShadingCorrection.name)
        network = correction.take_network_milliseconds() if correction and pending.moment.alpha else {}
        kernels = pending.kernels() | {name: {name: milliseconds} for name, milliseconds in network.items()}
        now = time.perf_counter()
        look_ms = pending.look_ms + (now - start) * 1e3
        self._rested = max(self._rested, now + look_ms * 1e-3 / _MOST_SHARE)
        viewer.send(
            wire.Seen(
                pending.moment, places, specs, kernels, pending.frame_ms, look_ms, pipeline.bad_pixels,
                pipeline.exposure, pipeline.options, self._pacer.statistics if self._pacer else None, self._buffers,
            ),
            fds,
        )  # fmt: skip

    def _inspect(self, viewer: _Viewer, pipeline: Pipeline, shot: Shot, ask: wire.Ask) -> None:
        values = pixel_values(pipeline, shot, ask.x, ask.y)
        story = pixel_story(pipeline, shot, ask.x, ask.y, values, self._passed)
        found = Inspection((ask.x, ask.y), 0, story.source, values.here, story, origin=values.origin)
        viewer.send(found.of(ask.layers))

    def _since_mark(self, pipeline: Pipeline) -> dict[str, list[tuple[str, cl.Event]]]:
        """Return the stages' launches for this frame; the program's own `take_timings` returns them, too."""
        found: dict[str, list[tuple[str, cl.Event]]] = {name: [] for name in pipeline.stages}
        for launched in reversed(pipeline.board.commands.events):
            if launched is self._mark:
                break
            stage, kernel, event = launched
            if stage in found:
                found[stage].append((kernel, event))
        return found


@dataclass
class _Pending:
    """A frame that is being read: `images` gives its layers, and `kernels` milliseconds by stage and kernel, after the
    `events`."""

    moment: Moment
    events: list[cl.Event]
    images: Callable[[], dict[str, np.ndarray]]
    launched: dict[str, list[tuple[str, cl.Event]]]
    frame_ms: float
    look_ms: float

    @property
    def is_there(self) -> bool:
        return all(event.command_execution_status == cl.command_execution_status.COMPLETE for event in self.events)

    def kernels(self) -> dict[str, dict[str, float]]:
        return milliseconds_of(self.launched)
