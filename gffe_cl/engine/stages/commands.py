"""Commands of stages: enqueued on the device's queue, or also timed. `traffic` counts them, and `recording` records
them instead."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyopencl as cl

from gffe_cl.engine.opencl.device import Device

_EVENTS = 4096  # at most, kept for requests of timings


@dataclass
class Launch:
    """A launch of a stage's kernel whose arguments stay set: the `kernel` object is its own.

    `of_frames` are the arguments that change with the buffers of the rendered frames: the method that sets them, index,
    owner ("rendered" or "previous") and name; `shown`: the frames (`Board.shown`) to which they are set. `given` are
    those that come with each launch: method, index, name. Nothing keeps a reference to these buffers: callers' memory
    is released when they drop it. `declared` is the stage's declaration, `slot` that of the frame block.
    """

    declared: Any
    slot: str | None
    kernel: cl.Kernel
    items: tuple[int, ...]
    group: tuple[int, ...]
    of_frames: list[tuple[Callable[[int, Any], None], int, str, str]] = field(default_factory=list)
    given: list[tuple[Callable[[int, Any], None], int, str]] = field(default_factory=list)
    shown: object = None


class Commands:
    """Commands of the stages on a board, which are enqueued as they come.

    On a queue with profiling, `events` are those of the latest commands: name of the stage, of the kernel, and event.
    """

    def __init__(self, device: Device):
        self._queue, self._profiles = device.queue, device.profiles
        self.events: deque[tuple[str, str, cl.Event]] = deque(maxlen=_EVENTS)

    def launch(self, stage: Any, launch: Launch, given: Mapping[str, Any]) -> None:
        """Enqueue a launch of a stage; `given`: the arguments that came with it, by name."""
        event = cl.enqueue_nd_range_kernel(self._queue, launch.kernel, launch.items, launch.group)
        if self._profiles:
            self.events.append((stage.name, launch.declared.name, event))

    def fill(self, stage: Any, name: str, byte: int, grid: str) -> None:
        """Enqueue setting the first texels of a stage's buffer, as many as `grid` has, to `byte`."""
        spec = stage.spec(name)
        nbytes = math.prod(stage.sizes.of(grid)) * spec.bytes_per_pixel * spec.planes
        event = cl.enqueue_fill_buffer(self._queue, stage.buffer[name], bytes([byte]), 0, nbytes)
        if self._profiles:
            self.events.append((stage.name, "fill", event))

    def copy(self, stage: Any, to: cl.Buffer, of: cl.Buffer) -> None:
        """Enqueue a copy between buffers of one size for a stage."""
        event = cl.enqueue_copy(self._queue, to, of)
        if self._profiles:
            self.events.append((stage.name, "copy", event))

    def read(self, buffer: cl.Buffer, into: np.ndarray) -> cl.Event | None:
        """Begin to copy a buffer to the host at once. Returns the event that is complete when it is there; None if
        nothing is enqueued."""
        event = cl.enqueue_copy(self._queue, into, buffer, is_blocking=False)
        self._queue.flush()
        return event

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
