"""OpenCL objects of other libraries: pyopencl's, or the integer handles of C (`cl_context`, `cl_event` …)."""

from __future__ import annotations

from typing import Any, TypeVar

import pyopencl as cl

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import scalar, shown

# A handle is the address of an object of the driver; nothing lies in the first page of memory.
_LEAST, _MOST = 1 << 12, (1 << 64) - 1

Kind = TypeVar("Kind", cl.Context, cl.CommandQueue, cl.Event, cl.Buffer)


def is_handle(value: Any) -> bool:
    """Return whether `value` is an integer that may be a handle. Drivers crash on an invalid address, and no call
    can check it beforehand."""
    number = scalar(value)
    return isinstance(number, int) and not isinstance(number, bool) and _LEAST <= number <= _MOST


def adopted(value: Any, kind: type[Kind], what: str) -> Any:
    """Return `value` as a pyopencl object of `kind`. The object of a handle is retained, and released when Python has
    no reference to the result any more; the caller keeps its own reference. Raises GffeError for anything else."""
    if isinstance(value, kind):
        return value
    if is_handle(value):
        return kind.from_int_ptr(scalar(value), retain=True)
    raise GffeError(f"{what} must be a pyopencl.{kind.__name__} or the integer handle of one, got {shown(value)}")


def adopted_events(values: Any, context: cl.Context, what: str) -> list[cl.Event]:
    """Return events to wait for, given as pyopencl's or as handles. Raises GffeError unless all are of `context`, and
    none has failed."""
    if isinstance(values, tuple) and not values:  # mostly
        return []
    try:
        listed = [None] if isinstance(values, str | bytes) else list(values)
    except TypeError:
        raise GffeError(f"{what} must be a list of OpenCL events, got {shown(values)}") from None
    events: list[Any] = [adopted(value, cl.Event, f"{what}[{number}]") for number, value in enumerate(listed)]
    for number, event in enumerate(events):
        try:
            its_context, status = event.context, event.command_execution_status
        except cl.Error as error:  # some drivers do not keep the context of an event
            raise GffeError(f"{what}[{number}]: the driver rejects it: {str(error)[:120]}") from None
        if its_context != context:
            raise GffeError(f"{what}[{number}] belongs to another OpenCL context than the pipeline's device")
        if status < 0:
            raise GffeError(f"{what}[{number}] has failed (OpenCL error {status})")
    return events


def wait_for_all(queue: cl.CommandQueue, events: list[cl.Event]) -> None:
    """Make all later commands of the queue wait for `events`."""
    if events:
        cl.enqueue_barrier(queue, wait_for=events)


def marker(queue: cl.CommandQueue) -> cl.Event:
    """Return an event that is complete when all work enqueued so far is; other queues can wait for it."""
    event = cl.enqueue_marker(queue)
    queue.flush()
    return event
