"""Pacing under simulated clocks: a renderer, its delays, and a display that refreshes steadily."""

import numpy as np
import pytest

from gffe_cl import GffeError, Pacer

MAKING = 0.002  # seconds of an extrapolated frame


def played(render_rate, display_rate, delays, seconds=4.0, missing=(), making=MAKING):
    """The plans, and the pacer: rendered frames are here `delays(k)` after their time, but for the `missing` ones."""
    pacer, plans, now = Pacer(display_rate), [], 0.0
    count = int(seconds * render_rate)
    coming = [(k / render_rate + delays(k), k / render_rate) for k in range(count) if k not in missing]
    while coming or plans[-1].refresh < seconds:
        while coming and coming[0][0] <= now:
            _, time = coming.pop(0)
            pacer.rendered(time)
        if not pacer.statistics.rendered and not plans and now <= delays(0):
            now = delays(0) + 0.003  # refreshes have a phase of their own
            continue
        plan = pacer.plan(now)
        pacer.ready(now + (0 if plan.held else making))
        plans.append(plan)
        now = max(plan.refresh, now + making)
        if plan.refresh > seconds + 1:
            break
    return plans, pacer


def steps(plans):
    """Of time, from refresh to refresh; the first second is for settling."""
    late = [plan for plan in plans if plan.refresh > 1]
    return np.diff([plan.time for plan in late]), np.diff([plan.refresh for plan in late])


@pytest.mark.parametrize(
    ("rendered", "shown", "alphas"),
    [
        (24, 60, {0, 0.2, 0.4, 0.6, 0.8}),
        (30, 60, {0, 0.5}),
        (48, 144, {0, 0.333, 0.667}),
        (30, 120, {0, 0.25, 0.5, 0.75}),
        (60, 60, {0}),
    ],
)
def test_time_goes_on_evenly(rendered, shown, alphas):
    plans, pacer = played(rendered, shown, lambda k: 0.01)
    time, refresh = steps(plans[: int(3.9 * shown)])
    assert np.allclose(refresh, 1 / shown) and np.allclose(time, 1 / shown, atol=2e-5)
    assert {round(plan.alpha, 3) for plan in plans[shown : 3 * shown]} == alphas
    told = pacer.statistics
    assert told.late <= 1 and told.dropped <= 2 and told.jitter < 0.1  # how long making takes is not known at first


def test_jitter_of_the_renderer_is_not_seen():
    """Frames that are up to 8 ms late: more is extrapolated instead."""
    rng = np.random.default_rng(0)
    late = rng.uniform(0, 0.008, 200)
    plans, _ = played(30, 60, lambda k: 0.01 + late[k])
    time, _ = steps(plans[:230])
    assert (time >= 0).all() and time.std() < 0.001
    assert max(plan.alpha for plan in plans[:230]) < 1.7


def test_a_hitch_is_extrapolated_then_held_and_time_never_goes_back():
    plans, pacer = played(30, 60, lambda k: 0.01 + (0.2 if k == 60 else 0.0), missing=range(61, 66))
    times = np.array([plan.time for plan in plans])
    assert (np.diff(times) >= 0).all()
    hitch = [plan for plan in plans if 2.03 < plan.refresh < 2.2]
    assert any(plan.held for plan in hitch) and max(plan.alpha for plan in hitch) == pytest.approx(2.0)
    first = next(k for k, plan in enumerate(hitch) if plan.held)
    assert not any(plan.held for plan in hitch[:first]) and all(plan.held for plan in hitch[first:])
    after = [plan for plan in plans if 2.4 < plan.refresh < 3.8]
    assert not any(plan.held for plan in after)
    assert np.allclose(np.diff([plan.time for plan in after]), 1 / 60, atol=1e-4)
    assert pacer.statistics.held >= sum(plan.held for plan in hitch)


def test_what_is_too_slow_takes_later_refreshes():
    """Frames that take 25 ms are planned for the second refresh after."""
    plans, pacer = played(30, 60, lambda k: 0.01, making=0.025)
    _, refresh = steps(plans[:100])
    assert np.allclose(refresh, 2 / 60) and pacer.statistics.late <= 2


def test_rendered_frames_that_were_never_shown_are_counted():
    _, pacer = played(120, 60, lambda k: 0.005, seconds=2)
    assert pacer.statistics.dropped == pytest.approx(120, abs=4)


def test_wrong_order_of_calls():
    pacer = Pacer(60)
    for call in (lambda: pacer.plan(0.0), lambda: pacer.ready(0.0)):
        with pytest.raises(GffeError, match="nothing"):
            call()
    pacer.rendered(1.0)
    with pytest.raises(GffeError, match="must be after"):
        pacer.rendered(1.0)


@pytest.mark.parametrize("value", [1e-300, 1e300, 1e308, 10**400, float("nan"), -1.0, 0.0])
def test_absurd_numbers_are_refused(value):
    for make in (Pacer, lambda most: Pacer(60, most)):
        with pytest.raises(GffeError, match="must be a finite number from"):
            make(value)


def test_times_out_of_range_are_refused():
    pacer = Pacer(60)
    for call in (pacer.rendered, pacer.plan, pacer.ready):
        for value in (1e13, -1e13, 1e300, 10**400):
            with pytest.raises(GffeError, match=r"must be a finite number from .* \(out of range\)") as refused:
                call(value)
            assert len(str(refused.value)) < 120


def test_extreme_numbers_within_the_range():
    """Every plan is finite, and so are the statistics."""
    for rate in (1e-6, 1e6):
        for step in (1e-3, 1e11):
            pacer = Pacer(rate, 1e6)
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
