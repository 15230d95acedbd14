"""The viewer's model with its engine, without a window."""

import functools
import threading
import time
from contextlib import contextmanager

from gffe_cl.viewer.engine.sources.opening import open_viewer_device
from gffe_cl.viewer.state import document
from gffe_cl.viewer.state.model import Model
from gffe_cl.viewer.state.settings import Settings

PATIENCE = 150.0
document.open_viewer_device = functools.cache(open_viewer_device)  # whose kernels are built once for all sessions


def wait_for(happens, seconds=PATIENCE):
    """Return what `happens()` returns, once that is true."""
    end = time.monotonic() + seconds
    while not (answer := happens()):
        assert time.monotonic() < end, "nothing happened"
        time.sleep(0.002)
    return answer


class Canvas:
    """Record of the pictures that the model has put on the screen."""

    def __init__(self):
        self.frame, self.layers = None, {}

    def upload(self, name, image, spec, frame=None):
        self.layers[name] = image

    def forget(self, names):
        for name in list(names):
            self.layers.pop(name, None)


class Session:
    """A model, and frames of an interface."""

    def __init__(self, target):
        self.model, self.canvas = Model(Settings(), save_settings=False), Canvas()
        self.model.open(str(target))
        self.until(lambda: self.model.contents.result is not None)
        self.settle()

    def frame(self):
        self.model.update(time.perf_counter(), self.canvas)

    def until(self, happens):
        wait_for(lambda: self.frame() or happens())

    def settle(self):
        self.frame()
        self.until(lambda: self.model.settled)

    @contextmanager
    def engine_waiting(self):
        """Meanwhile the engine takes nothing up."""
        with self.model.store.news:
            yield

    @contextmanager
    def values_waiting(self):
        """Meanwhile the engine makes pictures, but finds no values of pixels."""
        engine, hold = self.model.engine, threading.Event()
        inspected = engine._inspected
        engine._inspected = lambda want: hold.wait(PATIENCE) and inspected(want)
        try:
            yield
        finally:
            hold.set()
            del engine._inspected
