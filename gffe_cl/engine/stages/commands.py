"""Commands of stages: enqueued on the device's queue, or also timed. `recording` records them instead."""

from __future__ import annotations

import math
from array import array
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import pyopencl as cl

from gffe_cl.engine.opencl.device import Device

_EVENTS = 4096  # at most, kept for requests of timings


@dataclass
class Launch:
    """A launch of a stage's kernel whose arguments stay set: the `kernel` object is its own.

    `of_frames` are the arguments that change with the buffers of the rendered frames: the method that sets them, index,
    owner ("rendered" or "previous") and name; `shown`: the `Bindings.frames` to which they are set. `given` are
    buffers that come with each launch: method, index, name. Nothing keeps a reference to these buffers: callers' memory
    is released when they drop it. `block` is the argument by which a kernel brings the frame block: method, index.
    `declared` is the stage's declaration, `slot` that of the frame block.
    """

    declared: Any
    slot: str | None
    kernel: cl.Kernel
    items: tuple[int, ...]
    group: tuple[int, ...]
    of_frames: list[tuple[Callable[[int, Any], None], int, str, str]] = field(default_factory=list)
    given: list[tuple[Callable[[int, Any], None], int, str]] = field(default_factory=list)
    block: tuple[Callable[[int, Any], None], int] | None = None
    shown: object = None

    def show(self, shown: object, buffer: Callable[[str, str], Any]) -> None:
        """Set the buffers of the rendered frames, which `buffer` gives by owner and name, unless `shown` was set."""
        if self.shown is not shown:
            for set_arg, index, owner, name in self.of_frames:
                set_arg(index, buffer(owner, name))
            self.shown = shown


@dataclass
class Script:
    """Commands that were enqueued for a step, to be enqueued again for later ones: `calls`, which return events (None:
    work of the host). `blocks` are the arguments that bring the frame block, `of_frames` the launches whose arguments
    change with the rendered frames, `shown` those to which they are set."""

    calls: list[Callable[[], cl.Event | None]] = field(default_factory=list)
    blocks: list[tuple[Callable[[int, Any], None], int]] = field(default_factory=list)
    of_frames: list[Launch] = field(default_factory=list)
    shown: object = None

    def show(self, shown: object, buffer: Callable[[str, str], Any]) -> None:
        """Set the buffers of the rendered frames, as `Launch.show` does, in all launches."""
        if self.shown is not shown:
            for launch in self.of_frames:
                launch.show(shown, buffer)
            self.shown = shown


class Commands:
    """Commands of the stages on a board, which are enqueued as they come and, if there is a `script`, noted in it.

    On a queue with profiling, `events` are those of the latest commands: name of the stage, of the kernel, and event.
    """

    def __init__(self, device: Device):
        self._queue, self._profiles = device.queue, device.profiles
        self.events: deque[tuple[str, str, cl.Event]] = deque(maxlen=_EVENTS)
        self.script: Script | None = None

    def repeat(self, script: Script, block: array[float]) -> cl.Event | None:
        """Enqueue the commands of a script with another frame block. Returns the event of the last one, with which all
        work enqueued so far is complete, because the queue works in order; None if the host worked last."""
        for set_arg, index in script.blocks:
            set_arg(index, block)
        event = None
        for call in script.calls:
            event = call()
        self._queue.flush()
        return event

    def call(self, function: Callable[[], cl.Event | None]) -> None:
        """Call a function, such as one of a stage that works on the host, now and whenever the script is repeated."""
        function()
        if self.script:
            self.script.calls.append(function)

    def _do(self, stage: str, name: str, call: Callable[..., cl.Event], *arguments: Any) -> None:
        """Enqueue a command, now and whenever the script is repeated."""
        enqueue = partial(call, self._queue, *arguments)
        self.call(partial(self._noted, stage, name, enqueue) if self._profiles else enqueue)

    def _noted(self, stage: str, name: str, enqueue: Callable[[], cl.Event]) -> cl.Event:
        event = enqueue()
        self.events.append((stage, name, event))
        return event

    def launch(self, stage: Any, launch: Launch, given: Mapping[str, Any]) -> None:
        """Enqueue a launch of a stage; `given`: the arguments that came with it, by name."""
        enqueue, name = cl.enqueue_nd_range_kernel, launch.declared.name
        self._do(stage.name, name, enqueue, launch.kernel, launch.items, launch.group)
        if self.script:
            if launch.given:
                raise TypeError(f"{stage.name}.{name}: buffers that a launch gives cannot be set again")
            self.script.blocks += [launch.block] if launch.block else []
            self.script.of_frames += [launch] if launch.of_frames else []

    def fill(self, stage: Any, name: str, byte: int, grid: str) -> None:
        """Enqueue setting the first texels of a stage's buffer, as many as `grid` has, to `byte`."""
        spec = stage.spec(name)
        nbytes = math.prod(stage.sizes.of(grid)) * spec.bytes_per_pixel * spec.planes
        self._do(stage.name, "fill", cl.enqueue_fill_buffer, stage.buffer[name], bytes([byte]), 0, nbytes)

    def copy(self, stage: Any, to: cl.Buffer, of: cl.Buffer) -> None:
        """Enqueue a copy between buffers of one size for a stage."""
        self._do(stage.name, "copy", cl.enqueue_copy, to, of)

    def take_events(self) -> dict[str, list[tuple[str, cl.Event]]]:
        """Return kernel and event of the commands by stage since they were last taken."""
        taken: dict[str, list[tuple[str, cl.Event]]] = {}
        for stage, kernel, event in self.events:
            taken.setdefault(stage, []).append((kernel, event))
        self.events.clear()
        return taken


def milliseconds_of(events: Mapping[str, Iterable[tuple[str, cl.Event]]]) -> dict[str, dict[str, float]]:
    """Return the milliseconds that commands took, by stage and kernel; the device must have finished."""
    taken: dict[str, dict[str, float]] = {}
    for stage, commands in events.items():
        by_kernel = taken.setdefault(stage, {})
        for kernel, event in commands:
            by_kernel[kernel] = by_kernel.get(kernel, 0.0) + (event.profile.end - event.profile.start) * 1e-6
    return taken
