"""Two threads: one renders, the other makes new frames and shows them. docs/threads.md explains it; `moderngl_live.py`
uses it with a renderer and a window. Alone it simulates both, with a clock that needs no waiting, and prints figures:

    python docs/examples/two_threads.py                                    30 → 60 frames/s for 10 s
    python docs/examples/two_threads.py --rate 40 --shown 144 --variable   on a display with a variable rate
    python docs/examples/two_threads.py --uneven 8 --stall 2:0.5 --resize 4 --cut 6 --lose 8:1
"""

import queue
import threading
import time
from dataclasses import dataclass, field

import numpy as np
import typer

import gffe_cl as gffe


@dataclass
class Shared:
    """All that both threads use. Frames go from the renderer to the display, and everything else back. Each attribute
    is replaced as a whole, by one thread only."""

    size: tuple[int, int]  # pixels of the window: set by the display, read by the renderer
    frames: queue.Queue = field(default_factory=lambda: queue.Queue(2))  # from the renderer, in order
    stopped: bool = False
    lost: int = 0  # frames that the display had no time to take


def render(renderer, shared, clock, rate):
    """Render `rate` frames per second until stopped. The thread owns the renderer, and waits for nobody."""
    before = size = None
    due = clock.now()
    while not shared.stopped:
        now = clock.now()
        if shared.size != size or renderer.cuts(now):
            size, before = shared.size, None  # motion leads nowhere: a reset
        frame = renderer.frame(now, before, size)  # arrays of its own, which the GPU has filled
        try:
            shared.frames.put_nowait(frame)
            before = now
        except queue.Full:
            shared.lost += 1  # motion of the next frame leads to the last one that was taken
        due = max(due + 1 / rate, clock.now() - 1 / rate)  # after a stall it does not catch up
        clock.wait_until(due)


def show(make_pipeline, display, shared, clock, pacer):
    """Make and show frames until stopped. The thread owns the pipeline, its queue and buffers, and the display."""
    pipeline = image = size = None
    while not shared.stopped:
        shared.size = display.size()
        for _ in range(shared.frames.qsize()):  # not until it is empty: more may come than can be taken
            frame = shared.frames.get()
            if frame.reset and frame.color.shape[1::-1] != size:
                size = frame.color.shape[1::-1]
                pipeline = make_pipeline(*size)
            pipeline.submit(frame)  # every frame, in order: the motion of each leads to the one before
            pacer.rendered(frame.time, frame.reset)
        if pipeline is None or not display.is_there():
            clock.wait_until(clock.now() + 0.01)  # frames are still taken, but none is made
            continue
        plan = pacer.plan(clock.now())
        if not plan.held:
            image = display.make(pipeline, plan, size)
        pacer.ready(clock.now())
        clock.wait_until(plan.refresh)
        display.show(image, plan)


def run(renderer, make_pipeline, display, shared, clock, rate, pacer):
    """Run both threads until one stops or fails: the renderer's, and the caller's, as windows want it."""
    failed = []

    def guarded(work, *arguments):
        try:
            clock.enter()
            work(*arguments)
        except Exception as error:
            failed.append(error)
        finally:
            shared.stopped = True
            clock.leave()

    thread = threading.Thread(target=guarded, args=(render, renderer, shared, clock, rate))
    thread.start()
    guarded(show, make_pipeline, display, shared, clock, pacer)
    thread.join()
    if failed:
        raise failed[0]


class Clock:
    """The real clock."""

    def now(self):
        return time.perf_counter()

    def wait_until(self, due):
        time.sleep(max(due - self.now(), 0))

    def enter(self):
        pass

    leave = enter


# ---- a simulation of everything but the pipeline -------------------------------------------------------------

OPTIONS = gffe.Options(shading_correction=False)


class SimulatedClock:
    """A clock for a fixed number of threads: where all of them wait, it goes on to the first that is due. One runs at
    a time, so a run can be repeated."""

    def __init__(self, threads=2):
        self.time, self.waiting, self.absent, self.changed = 0.0, {}, threads, threading.Condition()
        self.threads = threads

    def now(self):
        return self.time

    def wait_until(self, due):
        me = threading.get_ident()
        with self.changed:
            self.waiting[me] = max(due, self.time), me != threading.main_thread().ident
            self.changed.notify_all()
            while len(self.waiting) < self.threads or min(self.waiting, key=self.waiting.get) != me:
                self.changed.wait()
            self.time, _ = self.waiting.pop(me)

    def enter(self):
        self.wait_until(0)

    def leave(self):
        with self.changed:
            self.threads -= 1
            self.changed.notify_all()


@dataclass
class Events:
    """What happens in a simulation, in seconds. `stalls`, `losses`: (when, how long)."""

    seconds: float = 10.0
    rendering: float = 0.025
    taking: float = 0.001
    making: float = 0.004
    uneven: float = 0.0  # at most that much longer for a frame
    stalls: tuple[tuple[float, float], ...] = ()
    losses: tuple[tuple[float, float], ...] = ()
    cuts: tuple[float, ...] = ()
    resizes: tuple[float, ...] = ()

    def size(self, now):
        side = sum(when <= now for when in self.resizes)
        return 64 + 16 * (side % 2), 36 + 9 * (side % 2)


def camera_at(now, size):
    """A camera that goes sideways, one unit a second."""
    pose = np.eye(4)
    pose[0, 3] = -now
    return gffe.Camera(pose, size[0], size[0], size[0] / 2, size[1] / 2)


class SimulatedRenderer:
    """A wall ten units away, in the time that `events` give."""

    def __init__(self, events, clock):
        self.events, self.clock, self.random = events, clock, np.random.default_rng(0)
        self.left = {"cuts": list(events.cuts), "stalls": list(events.stalls)}

    def cuts(self, now):
        return bool(self.left["cuts"] and self.left["cuts"][0] <= now and self.left["cuts"].pop(0))

    def frame(self, now, before, size):
        width, height = size
        x = np.arange(width) + 0.5 + now * width / 10
        color = np.broadcast_to((0.5 + 0.4 * np.sin(x / 4))[None, :, None], (height, width, 3)).astype(np.float32)
        motion = np.zeros((height, width, 2), np.float32)
        motion[..., 0] = 0 if before is None else (now - before) * width / 10
        taken = self.events.rendering + self.random.uniform(0, self.events.uneven)
        if self.left["stalls"] and now >= self.left["stalls"][0][0]:
            taken += self.left["stalls"].pop(0)[1]
        self.clock.wait_until(now + taken)
        depth = np.full((height, width), 10, np.float32)
        return gffe.RenderedFrame(color, depth, motion, camera_at(now, size), now, reset=before is None)


class SimulatedPipeline(gffe.Pipeline):
    """A pipeline that takes a while for each call."""

    events: Events
    clock: SimulatedClock

    def submit(self, frame):
        super().submit(frame)
        self.clock.wait_until(self.clock.now() + self.events.taking)

    def extrapolate(self, camera, moment):
        made = super().extrapolate(camera, moment)
        self.clock.wait_until(self.clock.now() + self.events.making)
        return made


class SimulatedDisplay:
    """A display that notes what it showed: (when, time of the picture, its size, plan)."""

    def __init__(self, events, shared, clock):
        self.events, self.shared, self.clock, self.shown = events, shared, clock, []

    def size(self):
        self.shared.stopped |= self.clock.now() >= self.events.seconds
        return self.events.size(self.clock.now())

    def is_there(self):
        return not any(when <= self.clock.now() < when + lasting for when, lasting in self.events.losses)

    def make(self, pipeline, plan, size):
        return pipeline.extrapolate(camera_at(plan.time, size), plan.time).numpy("color")

    def show(self, image, plan):
        self.shown.append((self.clock.now(), plan.time, image.shape[1::-1], plan))


def figures(shown, pacer, shared):
    """Return what a viewer of the display notices; times in ms."""
    when, moments = np.array([(now, moment) for now, moment, *_ in shown]).T * 1e3
    interval, age, told = np.diff(when), when - moments, pacer.statistics
    made = {"shown": len(shown), "rendered": told.rendered, "extrapolated": told.extrapolated, "held": told.held}
    made |= {"late": told.late, "dropped": told.dropped, "lost": shared.lost}
    made |= {"interval": float(np.median(interval)), "longest interval": float(interval.max())}
    return made | {"age": float(np.median(age)), "oldest": float(age.max()), "jitter": told.jitter}


def simulate(events, rate=30.0, shown=60.0, variable=False, device=None):
    """Return (figures, what was shown) of both threads under a simulated clock."""
    clock, shared = SimulatedClock(), Shared(events.size(0))
    pacer = gffe.Pacer(shown, fps=rate, variable=variable)
    display, device = SimulatedDisplay(events, shared, clock), device or gffe.open_device()

    def make_pipeline(*size):
        pipeline = SimulatedPipeline(device, *size, OPTIONS, fps=rate)
        pipeline.events, pipeline.clock = events, clock
        return pipeline

    run(SimulatedRenderer(events, clock), make_pipeline, display, shared, clock, rate, pacer)
    return figures(display.shown, pacer, shared), display.shown


def pairs(text):
    """Read "WHEN:SECONDS WHEN:SECONDS …"."""
    return tuple(tuple(map(float, word.split(":"))) for word in text.split())


def main(
    rate: float = 30,
    shown: float = 60,
    seconds: float = 10,
    rendering: float = 25,
    taking: float = 1,
    making: float = 4,
    uneven: float = 0,
    variable: bool = False,
    stall: str = "",
    lose: str = "",
    cut: str = "",
    resize: str = "",
):
    """Simulate a renderer (`rate`, frames per second) and a display (`shown`), of a variable rate if `variable`.
    `rendering`, `taking`, `making`, `uneven`: ms of a rendered frame, to take it, of a new frame, and by which rendered
    ones may take longer. `stall`, `lose`: WHEN:SECONDS of long frames and of no display; `cut`, `resize`: WHEN."""
    times = (number / 1e3 for number in (rendering, taking, making, uneven))
    cuts, resizes = (tuple(map(float, text.split())) for text in (cut, resize))
    events = Events(seconds, *times, pairs(stall), pairs(lose), cuts, resizes)
    for name, value in simulate(events, rate, shown, variable)[0].items():
        print(f"{name:>17} {value:.2f} ms" if isinstance(value, float) else f"{name:>17} {value}")


if __name__ == "__main__":
    typer.run(main)
