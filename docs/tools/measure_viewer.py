"""Measure the viewer in a window of 1600 x 900 pixels: first picture, cached playback, drags, and rest.

    xvfb-run -a -s "-screen 0 1920x1200x24" python docs/tools/measure_viewer.py SEQUENCE

The goals hold for 480 x 270 pixels on two cores, with OpenGL by llvmpipe, while nothing else runs.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator

from gffe_cl.viewer.engine.jobs import leaving
from gffe_cl.viewer.state.model import Model
from gffe_cl.viewer.state.settings import Settings
from gffe_cl.viewer.window.app import App
from gffe_cl.viewer.window.running import new_app, run

SIZE = (1600, 900)  # of the window, pixels
PLAYED, SETTLING, RESTED = 8.0, 2.0, 10.0  # seconds; it settles after the last input
DRAGS = 40  # frames


def measured(app: App) -> Iterator[None]:
    """Print one figure after the other; yields once per frame of the interface."""
    import glfw  # after ImGui, which brings its own

    model, start = app.model, time.perf_counter()
    while model.contents.result is None:
        yield
    print(f"first picture {time.perf_counter() - start:.2f} s after the window (goal: 2)")
    slots = model.playback.slots
    while not model.settled or len(model.document.ahead.cached) < min(
        slots, model.store.room(model.contents.result.nbytes)
    ):
        yield
    model.playback.loop = True
    model.playback.play()
    glfw.post_empty_event()  # as keys and mouse do
    start, busy = time.perf_counter(), time.process_time()
    while time.perf_counter() - start < PLAYED:
        yield
    playback = model.playback
    each = 1e3 * (time.process_time() - busy) / max(playback.shown, 1)
    rate = f"{playback.rate:.1f} of {playback.target_rate:.0f} frames/s, {playback.dropped} dropped"
    print(f"cached playback {rate}, {each:.1f} ms of CPU for each shown (goal: all)")
    playback.pause()
    longest, busy = 0.0, time.process_time()
    for number in range(DRAGS):
        start = time.perf_counter()
        playback.seek(number * 7919 % slots)
        glfw.post_empty_event()
        yield
        while not model.settled:
            yield
        longest = max(longest, time.perf_counter() - start)
    each = 1e3 * (time.process_time() - busy) / DRAGS
    print(f"drag to a cached frame {1e3 * longest:.0f} ms at most, {each:.1f} ms of CPU (goal: 50)")
    start = time.perf_counter()
    while time.perf_counter() - start < SETTLING:
        yield
    start, busy = time.perf_counter(), time.process_time()
    while time.perf_counter() - start < RESTED:
        yield
    share = (time.process_time() - busy) / (time.perf_counter() - start)
    print(f"at rest {100 * share:.1f} % of a core (goal: 2)")
    app.close()


def main(target: str) -> None:
    model = Model(Settings(), save_settings=False)
    steps: list[Iterator[None]] = []

    def step(app: App) -> None:
        steps[:] = steps or [measured(app)]
        next(steps[0], None)

    with leaving(model):
        model.open(target)
        run(new_app(model, on_frame=step), SIZE)


if __name__ == "__main__":
    main(sys.argv[1])
