"""The viewer's parts that need neither a window nor a device: playback, actions, settings, export."""

import contextlib
import json
import os
import resource
import time
import weakref
from types import SimpleNamespace

import foreign_files
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from imgui_bundle import imgui
from PIL import Image

from gffe_cl.captures.sequence.exr import read_channels
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.inspection.layers import LayerSpec
from gffe_cl.viewer.engine import jobs
from gffe_cl.viewer.engine.figures import Timings
from gffe_cl.viewer.engine.messages import Frame, Key, Recipe, Setup
from gffe_cl.viewer.picture.displays import Display
from gffe_cl.viewer.picture.view import View
from gffe_cl.viewer.state.actions import IMGUI_KEYS, Action, Actions, parse_shortcut, slot_of
from gffe_cl.viewer.state.navigation import Framing
from gffe_cl.viewer.state.playback import EVERY_FRAME, MODES, REAL_TIME, Playback
from gffe_cl.viewer.state.saving import save_layers_exr, save_png, unused_name
from gffe_cl.viewer.state.settings import Settings, default_path
from gffe_cl.viewer.window.picture import short
from gffe_cl.viewer.window.plot import scale_of
from gffe_cl.viewer.window.running import dispatch

cases = settings(deadline=None, max_examples=100)

# -- playback --------------------------------------------------------------------------------------------------------


class Engine:
    """Answers the newest request after `latency` seconds, one at a time."""

    def __init__(self, latency, ready):
        self.latency, self.ready, self.asked, self.working, self.done = latency, ready, ready, None, 0.0

    def submit(self, now, slot):
        self.asked = slot
        self._begin(now)

    def poll(self, now):
        while self.working is not None and self.done <= now:
            self.ready, self.working = self.working, None
            self._begin(self.done)
        return self.ready

    def _begin(self, now):
        if self.working is None and self.asked != self.ready:
            self.working, self.done = self.asked, now + self.latency


def played(playback, ticks, latency=0.0, start=1000.0):
    """(now, slot, visible) after each tick; `ticks`: seconds between them. What is visible at first was delivered."""
    playback.tick(start, playback.slot)
    engine = Engine(latency, playback.slot)
    playback.play()
    now = start
    for seconds in (0.0, *ticks):
        now += seconds
        tick = playback.tick(now, engine.poll(now))
        engine.submit(now, tick.request)
        yield now, *tick


ticks = st.lists(st.floats(0, 0.3), min_size=1, max_size=60)
latencies = st.floats(0, 0.5)
increasing = st.lists(st.floats(1e-3, 0.5), min_size=1, max_size=8).map(lambda gaps: list(np.cumsum(gaps)))


@st.composite
def playbacks(draw, loop=None, mode=None):
    times = draw(st.none() | increasing)
    count = len(times) if times else draw(st.integers(1, 9))
    playback = Playback(count, draw(st.sampled_from((5.0, 30.0, 60.0))), draw(st.integers(0, 4)), times)
    playback.loop = draw(st.booleans()) if loop is None else loop
    playback.mode = draw(st.sampled_from(MODES)) if mode is None else mode
    playback.speed = draw(st.floats(0.1, 4))
    first, last = sorted(draw(st.tuples(*[st.integers(0, playback.slots - 1)] * 2)))
    playback.set_in(first)
    playback.set_out(last)
    playback.seek(draw(st.integers(first, last)))
    if not playback.loop and playback.slot == last:
        playback.seek(first)
    return playback


@cases
@given(playbacks(), ticks, latencies)
def test_playback_stays_between_the_points_and_counts_every_slot(playback, ticks, latency):
    for _, slot, visible in played(playback, ticks, latency):
        assert playback.first <= slot <= playback.last and playback.first <= visible <= playback.last
        assert playback.due == playback.shown + playback.dropped + playback.waiting
    playback.pause()
    assert playback.due == playback.shown + playback.dropped and playback.waiting == 0


@cases
@given(playbacks(loop=False, mode=REAL_TIME), ticks, latencies)
def test_real_time_never_goes_back(playback, ticks, latency):
    slots, visibles = zip(*[(slot, visible) for _, slot, visible in played(playback, ticks, latency)], strict=True)
    assert list(slots) == sorted(slots) and list(visibles) == sorted(visibles)
    assert playback.shown == len(set(visibles)) - 1  # the first one was there before
    assert playback.due <= slots[-1] - slots[0]
    assert all(visible <= slot for slot, visible in zip(slots, visibles, strict=True))


@cases
@given(playbacks(loop=True, mode=REAL_TIME), ticks)
def test_real_time_follows_the_clock_through_laps(playback, ticks):
    start = playback.time_of(playback.first)
    length = playback.time_of(playback.last + 1) - start
    at = playback.time_of(playback.slot) - start
    for now, slot, _ in played(playback, ticks):
        due = start + (at + (now - 1000.0) * playback.speed) % length
        laps = np.array([due - length, due, due + length])
        end = playback.time_of(slot + 1)  # one slot later than due at the most
        end += (
            playback.time_of(playback.first + 1) - start if slot == playback.last else playback.time_of(slot + 2) - end
        )
        assert np.abs(laps - np.clip(laps, playback.time_of(slot), end)).min() < 1e-5


def test_a_late_tick_drops_nothing_and_rests_end_when_a_slot_is_due():
    playback = Playback(5, 10.0, 0)
    seen = [slot for _, slot, _ in played(playback, (0.1, 0.21, 0.05, 0.1, 0.15, 0.01))]
    assert seen == [0, 1, 2, 3, 4, 0, 1] and playback.dropped == 0 and playback.due == 6
    stalled = Playback(5, 10.0, 0)
    assert list(played(stalled, (0.75,)))[-1][1] == 2 and stalled.due == 7  # a lap of five slots, and two
    assert playback.rest(1001.0) == 0  # something is waited for
    playback = Playback(5, 10.0, 0)
    assert list(played(playback, (0.02,)))[-1][1] == 0 and playback.rest(1000.05) == pytest.approx(0.05)
    playback.speed = 2.0
    assert playback.rest(1000.05) == pytest.approx(0.01) and playback.rest(1001.0) == 0
    playback.pause()
    assert playback.rest(1000.05) == 0


@cases
@given(playbacks(mode=EVERY_FRAME), ticks, latencies)
def test_every_frame_shows_every_slot_but_none_too_early(playback, ticks, latency):
    start, length = playback.slot, playback.last - playback.first + 1
    history = list(played(playback, ticks, latency))
    shown = [history[0][2]]
    for (_, _, before), (_, _, visible) in zip(history, history[1:], strict=False):
        if visible != before:
            shown.append(visible)
    assert shown == [playback.first + (start - playback.first + i) % length for i in range(len(shown))]
    assert playback.dropped == 0
    if length > 1:
        assert playback.shown == len(shown) - 1
    asked = [now for (_, before, _), (now, slot, _) in zip(history, history[1:], strict=False) if slot != before]
    least = min(playback.time_of(s + 1) - playback.time_of(s) for s in range(playback.first, playback.last + 1))
    assert len(asked) <= (history[-1][0] - history[0][0]) * playback.speed / least + 1.001


BY_HAND = [
    lambda playback, number: playback.seek(number),
    lambda playback, number: playback.step(number),
    lambda playback, number: playback.step_rendered(-1 if number % 2 else 1),
    lambda playback, number: playback.home(),
    lambda playback, number: playback.end(),
]
OTHERWISE = [
    lambda playback, number: setattr(playback, "scrubbing", number > 20),
    lambda playback, number: setattr(playback, "n", number % 8),
    lambda playback, number: setattr(playback, "loop", not playback.loop),
    lambda playback, number: setattr(playback, "mode", MODES[number % 2]),
    lambda playback, number: setattr(playback, "speed", number / 10),
    lambda playback, number: playback.set_in(number),
    lambda playback, number: playback.set_out(number),
    lambda playback, number: playback.clear_points(),
    lambda playback, number: playback.toggle(),
    lambda playback, number: playback.play(),
    lambda playback, number: playback.play(),
]
uses = st.tuples(st.sampled_from(BY_HAND + OTHERWISE), st.integers(-3, 40), st.floats(0, 0.2))


@cases
@given(playbacks(), st.lists(uses, max_size=40))
def test_any_use_of_playback_is_sound(playback, uses):
    now = 5.0
    for use, number, seconds in uses:
        use(playback, number)
        assert not (playback.playing and (use in BY_HAND or playback.scrubbing))
        visible, was_playing = playback.visible, playback.playing
        now += seconds
        tick = playback.tick(now, number)
        assert tick == (playback.slot, playback.visible)
        assert 0 <= tick.request < playback.slots and 0 <= playback.first <= playback.last < playback.slots
        if was_playing:
            assert playback.first <= tick.request <= playback.last
            assert tick.visible == visible or playback.first <= tick.visible <= playback.last
        assert playback.due == playback.shown + playback.dropped + playback.waiting
        assert min(playback.due, playback.shown, playback.dropped, playback.waiting) >= 0


def test_real_time_drops_what_is_late_and_reports_rates():
    playback = Playback(100, 30.0, 1)
    playback.loop = False
    fast = list(played(playback, [1 / 60] * 90, latency=0.001))
    assert (playback.dropped, playback.target_rate) == (0, 60) and playback.rate == pytest.approx(60, abs=1.1)
    assert fast[-1][1:] == (90, 89)
    playback.home()
    list(played(playback, [1 / 60] * 120, latency=0.045))  # 22.2 slots a second
    assert playback.rate == pytest.approx(22.2, abs=1.1)
    assert playback.due == 120 and playback.shown == pytest.approx(44.4, abs=2) and playback.dropped > 70


def test_every_frame_keeps_the_pace_between_ticks_but_does_not_catch_up():
    playback = Playback(1000, 50.0, 0)
    playback.mode = EVERY_FRAME
    assert list(played(playback, [1 / 60] * 120, latency=0.005))[-1][1] == 100
    playback.home()
    late = [slot for _, slot, _ in played(playback, [0.001] * 10 + [0.9] + [0.001] * 90)]
    assert late[10:14] == [0, 1, 2, 2] and late[-1] == 6  # a slot each 20 ms, one of them early


@cases
@given(st.floats(-1e6, 1e6), st.floats(0, 1e6) | st.floats(0, 1e-9))
@example(15.0, 0.0)
def test_axis_of_the_plot_has_room_and_a_few_round_numbers(least, more):
    low, high, levels, texts = scale_of(least, least + more)
    assert low < least <= least + more < high and 2 <= len(levels) <= 6
    assert all(low <= level <= high for level in levels) and len(set(texts)) == len(texts)


def test_speed_and_stalls():
    playback = Playback(1000, 10.0, 0)
    playback.speed = 0.01
    assert playback.speed == 0.1
    playback.speed = 9
    assert playback.speed == 4 and playback.target_rate == 40
    assert [slot for _, slot, _ in played(playback, [0.5, 0.25])] == [0, 20, 30]
    playback.tick(5000.0, None)  # the machine was asleep
    assert playback.slot == 70
    playback.tick(4000.0, None)
    assert playback.slot == 70


def test_stops_at_the_out_point_or_loops():
    playback = Playback(10, 10.0, 0)
    playback.loop = False
    playback.set_in(2)
    playback.set_out(5)
    assert [slot for _, slot, _ in played(playback, [0.1] * 7)] == [2, 3, 4, 5, 5, 5, 5, 5] and not playback.playing
    playback.loop = True
    assert [slot for _, slot, _ in played(playback, [0.1] * 7)] == [5, 2, 3, 4, 5, 2, 3, 4]
    playback.loop = False
    playback.seek(8)
    assert next(played(playback, []))[1] == 2
    playback.seek(5)
    playback.mode = EVERY_FRAME
    assert [slot for _, slot, _ in played(playback, [0.1] * 5)] == [2, 3, 4, 5, 5, 5] and not playback.playing


MOVES = (  # by how much, and to where
    "seek -4 0, step -1 0, step_rendered -1 0, step 4 4, step_rendered -1 3, step_rendered -1 0, step_rendered 1 3,"
    " seek 11 11, step_rendered 1 12, seek 99 14, step_rendered 1 14, step 1 14"
)


def test_moving_by_hand_clamps_and_pauses():
    playback = Playback(5, 30.0, 2)
    for move, argument, slot in [step.split() for step in MOVES.split(", ")]:
        playback.play()
        getattr(playback, move)(int(argument))
        assert playback.slot == int(slot) and not playback.playing
    playback.set_in(4)
    playback.set_out(9)
    for move, slot in (("home", 4), ("home", 0), ("end", 9), ("end", 14), ("end", 14)):
        getattr(playback, move)()
        assert playback.slot == slot


def test_points_push_each_other_out_and_scrubbing_stands_still():
    playback = Playback(10, 30.0, 0)
    playback.set_out(4)
    playback.set_in(6)
    assert (playback.first, playback.last) == (6, 9)
    playback.set_out(2)
    assert (playback.first, playback.last) == (0, 2)
    playback.clear_points()
    assert (playback.first, playback.last) == (0, 9)
    playback.play()
    playback.scrubbing = True
    playback.seek(4)
    playback.toggle()
    assert [playback.tick(t, 4).request for t in (0.0, 0.5, 1.0)] == [4, 4, 4]
    playback.scrubbing = False
    assert playback.tick(2.0, 4).request == 4 and not playback.playing


def test_n_changes_live_and_keeps_the_time():
    playback = Playback(10, 30.0, 3)
    playback.set_in(8)
    playback.set_out(31)
    playback.seek(22)  # frame 5, α = 1/2
    playback.tick(0.0, 22)
    found = []
    for n in (0, 1, 2, 7, 3):
        playback.n = n
        found.append((playback.slot, playback.visible, playback.first, playback.last))
    assert found == [(5, 5, 2, 7), (11, 10, 4, 15), (16, 15, 6, 23), (44, 40, 16, 62), (22, 20, 8, 31)]
    playback.play()
    playback.tick(0.0, 22)
    playback.tick(0.01, 22)
    playback.n = 0
    assert playback.playing and playback.slot == 5 and playback.tick(0.031, None).request == 6


def test_gaps_in_time_are_waited_for():
    playback = Playback(4, 10.0, 1, [5.0, 5.1, 5.6, 5.7])
    playback.loop = False
    assert [playback.time_of(s) for s in range(9)] == pytest.approx([5, 5.05, 5.1, 5.15, 5.6, 5.65, 5.7, 5.75, 5.8])
    slots = [slot for _, slot, _ in played(playback, [0.05] * 15)]
    assert slots == [0, 1, 2, *[3] * 9, 4, 5, 6, 7]
    playback.home()
    playback.mode = EVERY_FRAME
    assert [slot for _, slot, _ in played(playback, [0.05] * 15)] == slots


def test_another_sequence():
    playback = Playback(10, 30.0, 1)
    playback.set_in(6)
    playback.seek(14)
    playback.open(8, 30.0, keep=True)
    assert (playback.slot, playback.first, playback.count, playback.slots) == (14, 6, 8, 16)
    playback.open(3, 30.0, keep=True)
    assert (playback.slot, playback.first, playback.last) == (5, 5, 5)
    playback.play()
    playback.open(20, 24.0)
    assert (playback.slot, playback.first, playback.fps, playback.visible) == (0, 0, 24.0, None)
    assert not playback.playing


def test_preferences_come_back_and_damaged_ones_do_not():
    playback, other = Playback(), Playback()
    playback.mode, playback.speed, playback.loop = EVERY_FRAME, 0.5, False
    other.restore(json.loads(json.dumps(playback.preferences())))
    assert other.preferences() == {"mode": EVERY_FRAME, "speed": 0.5, "loop": False}
    other.restore({"mode": ["x"], "speed": float("nan"), "loop": 1, "more": None})
    assert other.preferences() == playback.preferences()


# -- actions ---------------------------------------------------------------------------------------------------------


def make(*rows):
    """Actions from (label, shortcut, reason or None), ids and what ran."""
    actions, ran = Actions(None), []
    for label, shortcut, reason in rows:
        id = label.lower().replace(" ", "_")
        actions.register(
            Action(id, label, "Group", shortcut, lambda app, id=id: ran.append(id), lambda app, reason=reason: reason)
        )
    return actions, ran


def test_shortcuts_are_read():
    written = {"Ctrl+O": "Ctrl O", "Space": "Space", "Super+Alt+Left": "Super Alt Left", "1": "1", "Shift+1": "Shift 1"}
    written |= {"?": "?", "Shift+/": "?", "Shift+?": "?", "Ctrl++": "Ctrl +", "+": "+"}
    for text, parts in written.items():
        *modifiers, key = parts.split()
        assert parse_shortcut(text) == (set(modifiers), key)


def test_every_key_is_one_of_imgui():
    assert [name for name in IMGUI_KEYS if not hasattr(imgui.Key, name)] == []
    assert {"A", "0", "F12", "Space", "/", "Left", "Escape"} <= set(IMGUI_KEYS.values())


def test_dispatch_runs_what_is_enabled():
    actions, ran = make(("Open", "Ctrl+O", None), ("Save", "Ctrl+S", "nothing is open"), ("Help", "?", None))
    assert actions.dispatch({"Ctrl"}, "O") == "open"
    assert actions.dispatch(set(), "O") is None and actions.last_refusal is None
    assert actions.dispatch({"Ctrl", "Shift"}, "O") is None
    assert actions.dispatch({"Ctrl"}, "S") is None and actions.last_refusal == "nothing is open"
    assert actions.dispatch({"Shift"}, "/") == "help" and actions.last_refusal is None
    assert actions.dispatch({"Ctrl"}, "O", repeated=True) is None
    assert actions.dispatch({"Ctrl"}, "O", covered=True) is None
    actions.register(Action("quit", "Quit", "File", "Ctrl+Q", lambda app: None, anywhere=True))
    assert actions.dispatch({"Ctrl"}, "Q", covered=True) == "quit"
    assert actions.run("open") and not actions.run("save") and actions.last_refusal == "nothing is open"
    assert ran == ["open", "help", "open"]
    with pytest.raises(KeyError, match="'opne'"):
        actions["opne"]


def test_held_keys():
    actions, state, steps = Actions("app"), [], []
    reason = []
    hold = {"run": lambda app: state.append(True), "release": lambda app: state.append(False)}
    flip = Action("flip", "Flip", "Compare", "Shift+R", enabled=lambda app: reason[0] if reason else None, **hold)
    actions.register(flip)
    actions.register(Action("step", "Step", "Playback", "Right", lambda app: steps.append(1), repeat=True))
    assert actions.dispatch({"Shift"}, "R") == "flip"
    assert actions.dispatch({"Shift"}, "R", repeated=True) is None and state == [True]
    reason.append("no reference")  # what is held is let go all the same
    assert actions.release("X") is None and actions.release("R") == "flip" and state == [True, False]
    assert actions.release("R") is None
    assert actions.dispatch({"Shift"}, "R") is None and actions.last_refusal == "no reference"
    reason.clear()
    assert actions.run("flip") and actions.run("flip") and state == [True, False] * 2
    actions.run("flip")
    actions.release_all()
    assert state == [True, False] * 3
    for _ in range(3):
        assert actions.dispatch(set(), "Right", repeated=True) == "step"
    assert len(steps) == 3
    actions.register(Action("what", "What", "Help", "?", **hold))
    assert actions.dispatch({"Shift"}, "/") == "what" and actions.release("/") == "what"
    assert actions.dispatch(set(), "?") == "what" and actions.release("/") == "what"  # Shift went up first
    actions.run("what")
    assert actions.dispatch(set(), "?") == "what" and actions.release("?") == "what"


def test_duplicates_are_refused():
    actions, _ = make(("Open", "Ctrl+O", None), ("Help", "?", None))
    for id, shortcut, also, words in (
        ("open", "", (), ["'open'", "Open", "Other"]),
        ("other", "Ctrl+O", (), ["Ctrl", "'open'", "'other'"]),
        ("other", "Shift+/", (), ["?", "'help'", "'other'"]),
        ("other", "F1", ("Ctrl+O",), ["Ctrl", "'open'", "'other'"]),
        ("other", "F1", ("F1",), ["F1", "'other'"]),
        ("other", "Ctrl+Nope", (), ["Nope"]),
    ):
        with pytest.raises(ValueError) as info:
            actions.register(Action(id, "Other", "Group", shortcut, print, also=also))
        assert all(word in str(info.value) for word in words) and len(list(actions)) == 2
    actions.register(Action("other", "Other", "Group", "F1", print))
    assert actions.dispatch({"Ctrl"}, "O") == "open"


def test_search():
    actions, _ = make(
        ("Reload frames", "", None),
        ("Toggle loop", "", "nothing is open"),
        ("Load settings", "", None),
        ("Loop", "", None),
        ("Step to the next rendered frame", "", None),
    )

    def found(text):
        return [action.label for action in actions.search(text)]

    assert found("loop") == ["Loop", "Toggle loop"]
    assert found("load") == ["Load settings", "Reload frames"]
    assert found("LO")[0] == "Loop" and found("LO")[-1] == "Toggle loop"
    assert found("frame step") == ["Step to the next rendered frame"]
    assert len(found("group load")) == 2 and found("grou")[0] == "Loop"
    assert found("xyzzy") == [] and len(found("")) == 5 and found(" … ")[-1] == "Toggle loop"


# -- settings --------------------------------------------------------------------------------------------------------

plain = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)
sound = {
    "recent": ["/a", "/b"],
    "theme": "light",
    "ui_scale": 1.5,
    "window_size": [800, 600],
    "displays": {"final": {"exposure": 1.0}},
    "playback": {"loop": False},
    "options": {"order": 2},
    "compare": {"b": "truth"},
    "panels": {"timings": True},
}


@pytest.fixture(scope="module")
def scratch(tmp_path_factory):
    return tmp_path_factory.mktemp("viewer")


@cases
@given(
    damage=st.dictionaries(st.sampled_from(sorted(sound)), plain), unknown=st.dictionaries(st.text(), plain, max_size=2)
)
def test_damaged_settings_cost_only_themselves(scratch, damage, unknown):
    path = scratch / "viewer.json"
    path.write_text(json.dumps(unknown | sound | damage))
    loaded, warning = Settings.load(path)
    again = loaded.to_json()
    for name in set(sound) - set(damage):
        assert again[name] == sound[name]
    for name, value in unknown.items():
        assert name in sound or again[name] == value
    for name in damage:  # either taken as it is, or of the right type
        assert type(again[name]) is type(sound[name])
    if damage and all(isinstance(value, str) for value in damage.values()) and "theme" not in damage:
        assert warning is not None and all(name in warning for name in damage)
    assert loaded.save(path) is None
    assert Settings.load(path) == (loaded, None)


@cases
@given(
    st.binary(max_size=40) | st.sampled_from([b"[" * 100000, b'{"ui_scale": 1e999}', b"\xff\xfe{", b"[]", b"9" * 5000])
)
def test_any_file_gives_settings(scratch, data):
    path = scratch / "any.json"
    path.write_bytes(data)
    loaded, warning = Settings.load(path)
    if warning is not None:
        assert str(path) in warning and "\n" not in warning
        assert loaded == Settings(unknown=loaded.unknown)


def test_settings_without_a_file_or_a_folder(tmp_path, monkeypatch):
    assert Settings.load(tmp_path / "none.json") == (Settings(), None)
    for kind in foreign_files.KINDS:
        foreign_files.put(tmp_path / kind, kind)
        loaded, warning = foreign_files.within(10, lambda: Settings.load(tmp_path / kind))  # noqa: B023
        assert loaded == Settings() and "cannot read" in warning and "expected" in warning
        (tmp_path / kind).rmdir() if kind == "folder" else (tmp_path / kind).unlink()
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file" / "viewer.json", tmp_path):
        warning = Settings().save(path)
        assert str(path) in warning and "cannot be saved" in warning
    assert os.listdir(tmp_path) == ["file"]
    assert "cannot be saved" in Settings(options={"x": object()}).save(tmp_path / "x.json")
    assert os.listdir(tmp_path) == ["file"]
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    assert Settings(theme="light").save() is None
    assert default_path() == tmp_path / "config" / "gffe-cl" / "viewer.json"
    assert Settings.load()[0].theme == "light" and len(os.listdir(default_path().parent)) == 1
    monkeypatch.setenv("XDG_CONFIG_HOME", "relative")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert default_path() == tmp_path / ".config" / "gffe-cl" / "viewer.json"


def test_recent_paths_and_links(tmp_path):
    link, remembered = tmp_path / "viewer.json", Settings()
    for i in range(15):
        remembered.add_recent(tmp_path / str(i))
    remembered.add_recent(tmp_path / "9")
    names = [os.path.basename(path) for path in remembered.recent]
    assert names == ["9", "14", "13", "12", "11", "10", "8", "7", "6", "5", "4", "3"]
    link.symlink_to(tmp_path / "dotfiles" / "viewer.json")
    assert remembered.save(link) is None and link.is_symlink(), "linked settings stay linked"
    assert Settings.load(tmp_path / "dotfiles" / "viewer.json")[0].recent == remembered.recent


# -- export ----------------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def limited(nbytes):
    """No file may grow beyond `nbytes`, as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (nbytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def fault(path, call, *arguments):
    """The one line of the GffeError, which names `path`; nothing new is left beside it."""
    before = sorted(os.listdir(path.parent)) if path.parent.is_dir() else None
    with pytest.raises(GffeError) as info:
        call(path, *arguments)
    assert str(path) in str(info.value) and "\n" not in str(info.value)
    assert before == (sorted(os.listdir(path.parent)) if path.parent.is_dir() else None)
    return str(info.value)


def test_png(tmp_path):
    for channels in (3, 4):
        image = np.random.default_rng(1).integers(0, 256, (6, 9, channels), np.uint8)[::-1]
        save_png(tmp_path / "a.png", image)
        np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "a.png")), image)
    assert os.listdir(tmp_path) == ["a.png"]


def layers():
    rng = np.random.default_rng(2)
    components = {"final": tuple("RGBA"), "one.named": ("depth",), "history.positions": ("x", "y")}
    images = {
        "final": rng.random((5, 7, 4)).astype(np.float16),
        "rendered.depth": np.where(rng.random((5, 7)) < 0.3, np.inf, rng.random((5, 7))).astype(np.float32),
        "one.named": rng.random((5, 7)).astype(np.float32),
        "holes.filled_by": rng.integers(0, 5, (5, 7), np.uint8),
        "history.positions": rng.random((2, 5, 7, 2)).astype(np.float32),
    }
    listed = ((name, components.get(name, ()), 1 + (image.ndim == 4)) for name, image in images.items())
    return images, {name: LayerSpec(name, name, "group", "scalar", parts, planes) for name, parts, planes in listed}


def test_layers_as_exr(tmp_path):
    images, specs = layers()
    folder, written = tmp_path / "layers", []
    paths = save_layers_exr(folder, images, specs, on_layer=lambda: written.append(1))
    assert len(written) == len(images), "each is counted"
    assert paths == [folder / f"{name}.exr" for name in images] and sorted(paths) == sorted(folder.iterdir())
    channels = {"final": list("RGBA"), "one.named": ["depth"], "history.positions": ["1.x", "1.y", "2.x", "2.y"]}
    for name, image in images.items():
        found = list(read_channels(folder / f"{name}.exr", channels.get(name, ["Y"]), name, (7, 5)).values())
        planes = np.moveaxis(image, 0, 2).reshape(5, 7, 4) if name == "history.positions" else image
        np.testing.assert_array_equal(np.stack(found, -1), planes.reshape(*planes.shape[:2], -1), name)
        assert found[0].dtype == np.float16 or name != "final"


@pytest.mark.limits
def test_layers_are_all_written_or_none(tmp_path):
    images, specs = layers()
    images["large"], specs["large"] = np.random.default_rng(3).random((99, 99)), specs["rendered.depth"]
    assert "No such file" in fault(tmp_path / "none" / "layers", save_layers_exr, images, specs)
    with limited(4000):
        fault(tmp_path / "layers", save_layers_exr, images, specs)
    asked = []
    assert save_layers_exr(tmp_path / "layers", *layers(), lambda: asked.append(1) or len(asked) == 3) == []
    assert len(asked) == 3 and os.listdir(tmp_path) == [], "cancelled"


def test_unused_names(tmp_path):
    assert unused_name(tmp_path, "frame.color", ".png") == tmp_path / "frame.color.png"
    for expected in ("a", "a_2", "a_3"):
        path = unused_name(tmp_path, "a", ".exr")
        assert path.stem == expected
        path.write_text("")
    (tmp_path / "link.png").symlink_to(tmp_path / "nowhere")
    assert unused_name(tmp_path, "link", ".png").name == "link_2.png"
    assert unused_name(tmp_path, "../x y\n/z", "").name == "_x_y_z"
    assert unused_name(tmp_path, "..", ".png").name == "image.png"


# -- timings ---------------------------------------------------------------------------------------------------------


def test_timings_are_means_of_computed_frames():
    """Each counts once, and only those that followed the frame before tell how long a picture takes."""
    timings, recipe = Timings(), Recipe(1, Setup(), "")

    def add(slot, wall, submitted, **milliseconds):
        kernels = {stage: {stage: taken} for stage, taken in milliseconds.items()}
        moment = SimpleNamespace(alpha=0.5 * (slot % 2))
        timings.add(Frame(Key(recipe, slot), frozenset(), moment, {}, {}, kernels, wall, 1.0, submitted=submitted))

    for _ in range(2):  # the second time from the cache
        add(1, 900.0, 12, warp=1.0, correction=2.0, network=4.0)
        add(2, 10.0, 1, warp=1.0, correction=2.0, network=8.0)
    assert timings.means() == {"warp": 1.0, "correction": 8.0} and timings.network() == (6.0, 0.0)
    assert timings.walls() == (1, 10.0, 1.0)
    add(3, 20.0, 0, warp=4.0)  # shading correction is off
    assert timings.means() == {"warp": 2.0} and timings.of_stage("warp") == {"warp": 2.0}
    assert timings.walls() == (2, 15.0, 1.0) and timings.text == "mean of the last 3 computed frames, 2 generated"


def test_numbers_in_pixels_have_room():
    written = {0.15936: ".159", -0.15936: "-.16", 0.012345: ".012", 1234.5: "1e+03", 10.0: "10", 0.0: "0"}
    written |= {float("inf"): "inf", float("nan"): "nan"}
    assert [short(value, 4) for value in written] == list(written.values()) and short(0.012345, 7) == ".0123"


def test_frames_are_written_as_slots_or_as_parts_of_the_way():
    playback = Playback(count=6, n=3)
    written = {"0": 0, "23": 23, "4+1/4": 17, "4 + 1/2": 18, "4+3/4": 19, "4+2/8": 17, "4+0": 16}
    assert {text: slot_of(text, playback) for text in written} == written
    for text, message in (
        ("24", r"expected 0 to 23 \(0 to 5\+3/4\), got 24"),
        ("6+1/4", "got 6"),
        ("4+1/3", r"4\+1/3: generated frames are at 4\+1/4"),
    ):
        with pytest.raises(GffeError, match=message):
            slot_of(text, playback)
    for text in ("4+", "-1", "1.5", "4+1", "4+0/2", "4+2/2", "4+1/0", "", "x", "٣"):
        with pytest.raises(GffeError, match=r"generated ones counted \(9\)"):
            slot_of(text, playback)


def test_zooming_in_goes_to_the_picked_pixel_if_it_is_seen():
    view = View("final", Display(), zoom=2.0, center=(50.0, 50.0))
    for picked, center in (((60, 40), (60.5, 40.5)), ((20, 40), (60.5, 40.5)), (None, (60.5, 40.5))):
        Framing(view).zoom_in((100, 100), picked)
        assert view.center == center
    assert view.zoom == 16.0


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


def test_a_chord_whose_modifier_is_let_go_in_the_frame_of_its_key():
    """Where frames are long: Ctrl down, then K down and Ctrl up in one frame is Ctrl+K; K alone afterwards is K."""
    ran, actions = [], Actions(None)
    for shortcut in ("K", "Ctrl+K"):
        actions.register(Action(shortcut, shortcut, "", shortcut, lambda app, shortcut=shortcut: ran.append(shortcut)))
    context, key = imgui.create_context(), imgui.Key
    try:
        io = imgui.get_io()
        io.set_ini_filename("")
        io.display_size, io.delta_time = (640, 480), 0.1
        io.backend_flags |= imgui.BackendFlags_.renderer_has_textures.value
        frames = [[(key.mod_ctrl, True)], [(key.k, True), (key.mod_ctrl, False)], [(key.k, False)], [(key.k, True)]]
        for events in frames:
            for which, down in events:
                io.add_key_event(which, down)
            imgui.new_frame()
            dispatch(actions)
            imgui.end_frame()
    finally:
        imgui.destroy_context(context)
    assert ran == ["Ctrl+K", "K"]
