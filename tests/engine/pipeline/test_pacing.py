"""Pacing under simulated clocks: a renderer, its delays, stalls of every kind, and displays that are waited for, block
or follow the program. Every call is made in Python and in the exported C, which must decide alike."""

import math
import subprocess
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from paced import Pacer, library
from parameters import few

from gffe_cl import Camera, GffeError, Options, Pipeline, RenderedFrame
from gffe_cl.engine.frame.camera import FAR_ALPHA, HELD_ALPHA, interval_of

MAKING = 0.002  # seconds of an extrapolated frame
REFRESH = 1 / 60
STALLS = [0.05, 0.2, 1.0, 5.0, 20.0]  # seconds


@dataclass
class Coming:
    """A rendered frame: when it is here, its time, and whether it is a reset."""

    here: float
    time: float
    reset: bool = False


def steady(count, rate=30, delay=0.01, start=0.0, clock=0.0):
    """Frames of an even rate. The renderer's clock is `clock` seconds slow."""
    times = start + np.arange(count) / rate
    return [Coming(time + delay, time - clock) for time in times.tolist()]


def played(frames, seconds, rate=60, making=lambda k: MAKING, pauses=(), vsync=None, first=0.003, **options):
    """Return the pacer and (when it was asked for, plan) of all plans, of a program that waits for the planned refresh,
    or for the next `vsync(now)` of a display that blocks. `pauses`: (from, seconds) in which it stands still."""
    pacer, plans, frames, pauses = Pacer(rate, **options), [], list(frames), list(pauses)
    now = frames[0].here + first  # refreshes have a phase of their own
    while now < seconds:
        while pauses and now >= pauses[0][0]:
            now += pauses.pop(0)[1]
        while frames and frames[0].here <= now:
            frame = frames.pop(0)
            pacer.rendered(frame.time, frame.reset)
        plan = pacer.plan(now)
        plans.append((now, plan))
        now += 0.0 if plan.held else making(len(plans) - 1)
        pacer.ready(now)
        now = vsync(now) if vsync else max(plan.refresh, now)
    return pacer, plans


def until_even(plans, start, step=REFRESH):
    """Return how many refreshes after `start` until each later one has its frame: none is left out, and none is
    held."""
    after = [plan for now, plan in plans if now >= start - 1e-9]
    wrong = [
        k
        for k, (plan, following) in enumerate(zip(after, after[1:], strict=False))
        if following.held or abs(following.refresh - plan.refresh - step) > 1e-6
    ]
    assert len(after) > 30
    return round((after[wrong[-1] + 1].refresh - after[0].refresh) / step) if wrong else 0


def require_order(plans):
    """Time goes on or stands still, refreshes go on, and α keeps its limit."""
    times, refreshes, alphas = np.transpose([(plan.time, plan.refresh, plan.alpha) for _, plan in plans])
    assert (np.diff(times) >= 0).all() and (np.diff(refreshes) > 0).all()
    assert np.isfinite(times).all() and (alphas >= 0).all() and alphas.max() <= HELD_ALPHA + 1e-6
    return alphas.max()


def age(plans):
    """Return from a displayed moment to its display, seconds, at the end."""
    return plans[-1][1].refresh - plans[-1][1].time


@pytest.mark.parametrize(
    ("rendered", "shown", "alphas"),
    [
        (24, 60, {0, 0.2, 0.4, 0.6, 0.8}),
        (30, 60, {0, 0.5}),
        (48, 144, {0, 0.333, 0.667}),
        (30, 120, {0, 0.25, 0.5, 0.75}),
        (40, 144, {k / 18 for k in range(18)}),
        (60, 60, {0}),
        (60, 24, {0, 0.5}),
        (144, 60, {0, 0.2, 0.4, 0.6, 0.8}),
    ],
)
def test_time_goes_on_evenly(rendered, shown, alphas):
    pacer, plans = played(steady(7 * rendered, rendered), 6.9, shown)
    later = [plan for now, plan in plans if now > 1]
    assert np.allclose(np.diff([plan.refresh for plan in later]), 1 / shown)
    assert np.allclose(np.diff([plan.time for plan in later]), 1 / shown, atol=2e-5)
    assert {round(plan.alpha, 3) for plan in later} == {round(alpha, 3) for alpha in alphas}
    told = pacer.statistics
    overtaken = max(rendered - shown, 0) * 6.9
    assert told.late <= 1 and abs(told.dropped - overtaken) <= 4
    assert told.jitter < 0.1  # how long making takes is not known at first


@pytest.mark.parametrize(
    ("rendered", "shown", "parts"), [(40, 144, 3), (24, 60, 2), (30, 144, 4), (60, 144, 2), (45, 60, 1), (200, 144, 0)]
)
def test_a_variable_display_gets_equal_parts_of_the_interval(rendered, shown, parts):
    """Of a renderer that is slower; of a quicker one it gets a frame as often as it can."""
    pacer, plans = played(steady(4 * rendered, rendered), 3.9, shown, variable=True)
    later = [plan for now, plan in plans if now > 1]
    step = 1 / rendered / parts if parts else 1 / shown
    assert np.allclose(np.diff([plan.refresh for plan in later]), step, atol=1e-6)
    assert np.allclose(np.diff([plan.time for plan in later]), step, atol=2e-5)
    if parts:
        assert {round(plan.alpha, 3) for plan in later} == {round(k / parts, 3) for k in range(parts)}
    assert pacer.statistics.late <= 1


def test_c_decides_as_python_does():
    if not library():
        pytest.skip("no C compiler, or no CL/cl.h (Debian: opencl-c-headers)")
    assert bytes(Pacer(60)._c).strip(b"\0")  # the tests here really call it


# Two refreshes of the example in the export's README: before the first rendered frame, and after it.
EXAMPLE = """
#include "gffe.h"
#define gffe_extrapolate(...) ++extrapolated
#define gffe_submit(...) ((void)0)
#define take_rendered_frame(frame) (refreshes == 1 && coming-- > 0)
#define present(image) (right &= extrapolated == refreshes++)
#define wait_until(time) (right = 0)
#define is_playing (refreshes < 2)
static double seconds;
static double now(void) { return seconds += 0.01; }
int main(void) {
    struct { double time; int is_cut; } frame = {0, 1};
    int refreshes = 0, extrapolated = 0, coming = 1, right = 1;
    %s
    return !right;
}
"""


def test_the_example_of_the_export_waits_for_a_rendered_frame(tmp_path):
    if not library():
        pytest.skip("no C compiler, or no CL/cl.h (Debian: opencl-c-headers)")
    c = Path(str(files("gffe_cl.engine.export") / "c"))
    example = next(part for part in (c / "README.md").read_text().split("```") if "gffe_pacer pacer;" in part)
    example = example.removeprefix("c\n").replace("gffe_paced plan;", "gffe_paced plan = {0};")
    (tmp_path / "example.c").write_text(EXAMPLE % example)
    command = ["cc", f"-I{c}", tmp_path / "example.c", c / "gffe_pacer.c", "-lm", "-o", tmp_path / "example"]
    subprocess.run(command, check=True)
    subprocess.run([tmp_path / "example"], check=True)


def test_jitter_of_the_renderer_is_not_seen():
    """Frames that are up to 8 ms late: more is extrapolated instead."""
    rng = np.random.default_rng(0)
    frames = [Coming(frame.here + rng.uniform(0, 0.008), frame.time) for frame in steady(120)]
    _, plans = played(frames, 3.8)
    time = np.diff([plan.time for now, plan in plans if now > 1])
    assert (time >= 0).all() and time.std() < 0.001
    assert require_order(plans) < 1.7


# ---- stalls ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("stall", STALLS)
def test_a_frame_that_takes_long_to_render(stall):
    """The frame of second 3 takes `stall`, then the renderer goes on in time: extrapolated over two intervals, held,
    and even again after two refreshes."""
    frames = [*steady(90), Coming(3.01 + stall, 3.0), *steady(150, start=3 + stall + 1 / 30)]
    pacer, plans = played(frames, 6 + stall)
    assert require_order(plans) == pytest.approx(HELD_ALPHA, abs=0.01)
    assert until_even(plans, 3.01 + stall) <= 4  # until the next frame, which is in time again
    held = [now for now, plan in plans if plan.held and now > 1]
    assert all(3.04 < now < 3.05 + stall for now in held) and len(held) <= stall * 60
    assert age(plans) == pytest.approx(age(played(steady(90), 2.9)[1]), abs=1e-6)
    assert pacer.statistics.dropped == 0


@pytest.mark.parametrize("stall", STALLS)
@pytest.mark.parametrize("reset", [False, True])
def test_a_program_that_stands_still(stall, reset):
    """Loading, or a window that is dragged: nothing happens for a while, but the clocks go on."""
    frames = [*steady(90), *steady(150, start=3 + stall)]
    frames[90].reset = reset
    pacer, plans = played(frames, 6 + stall, pauses=[(2.99, stall)])
    require_order(plans)
    assert until_even(plans, 3.01 + stall) <= 1
    assert age(plans) == pytest.approx(age(played(steady(90), 2.9)[1]), abs=1e-6)
    assert pacer.statistics.dropped == 0 and pacer.statistics.late <= 1


@pytest.mark.parametrize("stall", STALLS)
def test_a_debugger_that_stops_the_renderers_clock(stall):
    """From then on its times are late for good."""
    frames = [*steady(90), *steady(150, start=3 + stall, clock=stall)]
    pacer, plans = played(frames, 6 + stall, pauses=[(2.99, stall)])
    require_order(plans)
    assert until_even(plans, 3.01 + stall) <= 4  # two rendered frames
    assert {round(plan.alpha, 3) for now, plan in plans if now > 3.1 + stall} == {0, 0.5}
    usual = age(played(steady(90), 2.9)[1])
    assert usual + stall - 1e-6 <= age(plans) <= usual + stall + 1.01 * REFRESH
    assert pacer.statistics.dropped == 0


@pytest.mark.parametrize("stall", STALLS)
def test_a_frame_that_takes_long_to_make(stall):
    """Once, in the driver: one frame is late, and the next refresh has its own."""
    count = int(30 * (6 + stall))
    pacer, plans = played(steady(count), 5.9 + stall, making=lambda k: stall if k == 180 else MAKING)
    assert require_order(plans) == pytest.approx(0.5)
    assert until_even(plans, plans[181][0]) == 0
    gap = plans[181][1].refresh - plans[180][1].refresh
    assert stall - 1e-6 <= gap < stall + 2 * REFRESH
    assert {round(plan.alpha, 3) for now, plan in plans if now > 1} == {0, 0.5}
    told = pacer.statistics
    assert told.late <= 2 and told.dropped <= stall * 30


def test_several_long_ones_in_a_row():
    """As when somebody steps through the program, on one thread: pauses are no intervals, however many there are."""
    pauses = [(3 + 20.1 * k, 20.0) for k in range(6)]
    frames = [*steady(90), *(Coming(3.01 + 20.1 * k, 3 + 20.1 * k) for k in range(1, 6))]
    end = 3 + 6 * 20.1
    _, plans = played([*frames, *steady(150, start=end)], end + 3, pauses=pauses)
    require_order(plans)
    assert until_even(plans, end + 0.01) <= 4
    _, plans = played(steady(90 * 30), 80, making=lambda k: 5.0 if 60 <= k < 70 else MAKING)
    require_order(plans)
    assert until_even(plans, plans[70][0]) <= 8  # one plan that is 4/30 s ahead


def test_alt_tab():
    """The display sleeps for 20 s, but the renderer goes on."""
    pacer, plans = played(steady(30 * 26), 25.9, pauses=[(3.0, 20.0)])
    assert require_order(plans) <= 0.5 + 1e-6
    assert until_even(plans, 23) == 0
    assert 598 <= pacer.statistics.dropped <= 602


@pytest.mark.parametrize("delay", [0.01, "an interval"])
def test_a_rate_that_changes(delay):
    """30, 24 and 60 rendered frames per second, three seconds of each."""
    frames, start = [], 0.0
    for rate in (30, 24, 60):
        frames += steady(3 * rate, rate, 1 / rate if delay == "an interval" else delay, start)
        start += 3
    pacer, plans = played(sorted(frames, key=lambda frame: frame.here), 8.9)
    require_order(plans)
    for start in (3.0, 6.0):
        assert until_even([pair for pair in plans if pair[0] < start + 1], start + 0.1) <= 4
    for start, alphas in ((2, {0, 0.5}), (5, {0, 0.2, 0.4, 0.6, 0.8}), (8, {0})):
        assert {round(plan.alpha, 3) for now, plan in plans if start <= now < start + 0.9} == alphas
    assert pacer.statistics.held <= 4 and pacer.statistics.dropped == 0


def test_what_is_too_slow_takes_later_refreshes():
    """Frames that take 25 ms are planned for the second refresh after, even if the renderer is faster than that."""
    for rate in (30, 60):
        pacer, plans = played(steady(4 * rate, rate), 3.9, making=lambda k: 0.025)
        assert until_even(plans, 0.5, 2 * REFRESH) == 0
        assert pacer.statistics.late <= 2


@pytest.mark.parametrize(
    ("least", "most", "plans_per_second", "late"), [(0.002, 0.014, 60, 0.01), (0.01, 0.025, 30, 0.03)]
)
def test_making_times_that_vary(least, most, plans_per_second, late):
    """Those that fit into a refresh are shown at each. Where many do not, every second one is used, evenly."""
    taken = np.random.default_rng(1).uniform(least, most, 2000)
    pacer, plans = played(steady(600), 19, making=lambda k: taken[k])
    require_order(plans)
    assert len(plans) == pytest.approx(19 * plans_per_second, rel=0.03)
    assert pacer.statistics.late < late * len(plans) and pacer.statistics.dropped == 0


@pytest.mark.parametrize("rate", [60, 59.94, 60.06])
def test_a_display_that_blocks(rate):
    """The program is held up until the display's own refresh, whose rate and phase are not quite as told."""
    rng = np.random.default_rng(2)

    def vsync(now):
        return (np.floor((now - 0.004) * rate + 1)) / rate + 0.004 + abs(rng.normal(0, 0.0003))

    pacer, plans = played(steady(1800), 50, vsync=vsync)
    require_order(plans)
    off = abs(rate - 60) * 50  # refreshes that there are more or less
    assert len(plans) == pytest.approx(50 * rate, abs=2)
    steps = np.diff([plan.time for now, plan in plans if now > 1])
    assert (abs(steps - REFRESH) > 1e-4).sum() <= 4 * off and pacer.statistics.late <= 3
    assert pacer.statistics.held <= 2 + off and pacer.statistics.dropped == 0


# ---- any sequence of events --------------------------------------------------------------------------------


def seconds_like(rng):
    """Return a duration between 0.1 ms and 20 s."""
    return float(np.exp(rng.uniform(np.log(1e-4), np.log(20))))


class AnyProgram:
    """A program with random clocks and rates, which checks each plan."""

    def __init__(self, rng, variable):
        self.rate, self.shown = int(rng.choice([24, 30, 48, 60])), int(rng.choice([60, 120, 144]))
        self.most = float(rng.choice([0.5, 1.0, HELD_ALPHA, FAR_ALPHA]))
        self.variable = variable
        self.step = 1 / (self.rate * (self.shown // self.rate)) if self.variable else 1 / self.shown
        self.pacer = Pacer(self.shown, self.most, fps=self.rate, variable=self.variable)
        self.now = float(rng.choice([0.0, 1e5, -1e5]))
        self.behind = rng.uniform(0, 1 / self.rate) + rng.choice([0.0, -1e6, 123.0])  # the renderer's clock
        self.times, self.last = [], None

    def render(self, now, reset=False):
        time = now - self.behind
        if reset or not self.times or time > self.times[0]:
            self.pacer.rendered(time, reset)
            self.times = [time, *([] if reset else self.times)]
            self.last = None if reset else self.last

    def show(self, making):
        plan = self.pacer.plan(self.now)
        self.now += 0 if plan.held else making
        self.pacer.ready(self.now)
        assert np.isfinite([plan.refresh, plan.time, plan.alpha, self.pacer.statistics.jitter]).all()
        assert 0 <= plan.alpha <= self.most
        if self.last:
            assert plan.refresh > self.last.refresh and plan.time >= self.last.time
        if not plan.held:  # what `Pipeline.extrapolate` would be given
            interval = interval_of(self.times, self.rate)
            rounding = 1e-6 + 2 * np.spacing(abs(self.times[0])) / interval
            assert 0 <= (plan.time - self.times[0]) / interval <= self.most + rounding
        self.last = plan
        return plan


@pytest.mark.parametrize("seed", few(range(10), 0, 1))
def test_any_events_keep_the_limits_and_are_forgotten(seed):
    """Eighty sequences for each seed. After random events 24 rendered frames come evenly, and are paced evenly
    from the third on, after a renderer's clock that stood still from the sixth on."""
    for turn in range(80):
        rng = np.random.default_rng([seed, turn])
        program, stands_still = AnyProgram(rng, variable=turn % 4 == 3), rng.random() < 0.3
        rate, shown = program.rate, program.shown
        program.render(program.now)
        for _ in range(rng.integers(0, 40)):
            program.now += seconds_like(rng)
            program.behind += seconds_like(rng) if stands_still and rng.random() < 0.1 else 0.0
            if rng.random() < 0.5:
                program.render(program.now, reset=rng.random() < 0.1)
            else:
                program.show(rng.choice([0.0, 0.2 / shown, seconds_like(rng) + 1 / rate]))
        start, plans, count = program.now + seconds_like(rng), [], 0
        program.now = start
        while count < 24:
            while program.now >= start + count / rate - 1e-9:
                program.render(start + count / rate)
                count += 1
            plans.append((count, program.show(0.2 / shown)))
            program.now = max(program.now, program.last.refresh)
        refreshes = [plan.refresh for count, plan in plans if count > (6 if stands_still else 3)]
        follows = program.variable and stands_still  # the display follows that clock
        assert follows or np.allclose(np.diff(refreshes), program.step, rtol=1e-3), turn
        beat = rate // math.gcd(rate, shown)  # rendered frames, of which the quickest is the delay
        held = sum(plan.held for count, plan in plans if count > 2 + 2 * beat)
        assert program.most < 1 or stands_still or held <= 1, turn  # where the last quicker frame is thirty frames old


def test_alpha_is_the_pipelines(device):
    """For intervals of all lengths, and resets."""
    pipeline = Pipeline(device, 16, 9, Options(shading_correction=False, cut_detection=False), fps=50.0)
    pacer, camera = Pacer(60, fps=50.0), Camera(np.eye(4), 16, 16, 8, 4.5)
    arrays = np.zeros((9, 16, 3), np.float16), np.ones((9, 16), np.float32), np.zeros((9, 16, 2), np.float32)
    found, clock, before = [], 0.0, 0.0
    for time, reset in (
        (0, True),
        (0.04, False),
        (0.08, False),
        (2.0, False),
        (2.03, False),
        (1.0, True),
        (1.1, False),
    ):
        pipeline.submit(RenderedFrame(*arrays, camera, time, reset=reset))
        pacer.rendered(time, reset)
        clock = max(clock, clock + time - before - 4 / 60)
        before = time
        for _ in range(4):
            clock += 1 / 60
            plan = pacer.plan(clock)
            pacer.ready(clock + 0.001)
            if plan.alpha and not plan.held:
                made = pipeline.extrapolate(camera, plan.time)
                assert made.alpha == pytest.approx(plan.alpha, abs=1e-9)
                found.append(plan.alpha)
    assert len(found) > 9 and max(found) <= HELD_ALPHA + 1e-9


# ---- arguments ---------------------------------------------------------------------------------------------


def test_a_reset_takes_any_time():
    pacer = Pacer(60)
    pacer.rendered(100.0)
    pacer.plan(0.0)
    pacer.rendered(5.0, reset=True)
    plan = pacer.plan(0.02)
    assert (plan.time, plan.alpha, plan.held) == (5.0, 0.0, False)
    with pytest.raises(GffeError, match="pacer: reset must be True or False"):
        pacer.rendered(6.0, reset=1)
    assert pacer.statistics.jitter == 0


def test_wrong_order_of_calls():
    pacer = Pacer(60)
    for call in (lambda: pacer.plan(0.0), lambda: pacer.ready(0.0)):
        with pytest.raises(GffeError, match="nothing"):
            call()
    pacer.rendered(1.0)
    with pytest.raises(GffeError, match="must be after"):
        pacer.rendered(1.0)


def test_extreme_numbers_within_the_range():
    """Every plan is finite, and so are the statistics."""
    for rate in (1e-6, 1e6):
        for step in (1e-3, 1e11):
            pacer = Pacer(rate, 16, fps=rate)
            for k in range(5):
                pacer.rendered(k * step)
                plan = pacer.plan(k * step)
                pacer.ready(k * step)
                assert np.isfinite([plan.refresh, plan.time, plan.alpha]).all()
            assert np.isfinite(pacer.statistics.jitter)


def test_a_clock_that_goes_back_is_refused():
    pacer = Pacer(60)
    pacer.rendered(0.0)
    pacer.plan(1.0)
    for call in (pacer.plan, pacer.ready):
        with pytest.raises(GffeError, match=r"pacer: now 0.5 s is before the last call's \(1 s, expected a clock"):
            call(0.5)
    pacer.ready(1.0)
    assert pacer.plan(1.0).refresh >= 1.0  # as if nothing had been asked
