"""A device that may not begin, and a host that must not wait for it."""

import faulthandler
import threading
import time

import pyopencl as cl

SECONDS = 20
COMPLETE = cl.command_execution_status.COMPLETE


def while_the_device_waits(device, work):
    """Return the result of `work(gate)`, on a thread of its own, while the device waits for the event `gate`.

    Fails where it does not return meanwhile. The gate is opened in any case: drivers wait for it in every later call.
    Some hold a lock while they do, so that not even the gate can be opened: then the process ends, with a traceback of
    each thread, because nothing else would end it.
    """
    gate, made, failed = cl.UserEvent(device.context), [], []

    def run():
        try:
            made.append(work(gate))
        except BaseException as error:
            failed.append(error)

    faulthandler.dump_traceback_later(3 * SECONDS, exit=True)
    try:
        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        thread.join(SECONDS)
        returned = bool(made)
        gate.set_status(COMPLETE)
        thread.join(SECONDS)
    finally:
        faulthandler.cancel_dump_traceback_later()
    if failed:
        raise failed[0]
    assert returned, "the host waited for the device"
    return made[0]


def is_complete(event):
    return event.command_execution_status == COMPLETE


def wait_for(event):
    """Wait until an event is complete, but not for ever."""
    until = time.monotonic() + SECONDS
    while not is_complete(event):
        assert time.monotonic() < until, "the device does not go on"
        time.sleep(0.001)
