"""Background work of the viewer at the end of the program."""

import time
import weakref

from gffe_cl.viewer.engine import jobs


def test_no_job_outlives_the_program(monkeypatch):
    """Within a binary package an interrupted thread would crash the interpreter."""

    def endless():
        while True:
            time.sleep(0.01)

    monkeypatch.setattr(jobs, "_PATIENCE", 0.2)
    monkeypatch.setattr(jobs, "_all", weakref.WeakSet())  # nobody else's
    made = jobs.Jobs("endless")
    future = made.run(endless)
    while not future.running():
        time.sleep(0.001)
    jobs._end()
    assert made._thread is not None and not made._thread.is_alive()
    assert isinstance(future.exception(), SystemExit)
