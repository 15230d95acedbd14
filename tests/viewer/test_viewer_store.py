"""The viewer's store: what is wanted is made, the most urgent first; what is kept, what goes first, and that what comes
from it is right."""

import time

import numpy as np
import pytest
import tiny_sequence

from gffe_cl import Options
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.inspection.buffers import Moment
from gffe_cl.viewer.engine.jobs import Jobs
from gffe_cl.viewer.engine.messages import Failure, Frame, Key, Recipe, Setup
from gffe_cl.viewer.engine.reloading import WATCH_SECONDS
from gffe_cl.viewer.engine.sources.recorded import RecordedSource
from gffe_cl.viewer.engine.store import Playhead, Store, Want
from gffe_cl.viewer.picture.current_frame import Contents, Picture, Showing
from gffe_cl.viewer.window.timeline import runs

BYTES = 1000
FRAMES = 4  # of the sequence that is open
FINAL = frozenset({"final"})
DEPTH = frozenset({"frame.depth", "none for this frame"})


def recipe(name="", source=0):
    return Recipe(source, Setup(), name)


def want(slot=0, layers=FINAL, name="", source=0, **more):
    return Want(Key(recipe(name, source), slot), layers, **more)


def frame(of, nbytes=BYTES):
    moment = Moment(of.key.slot, 0.0, 0.0, *[None] * 4)
    images = {name: np.zeros(nbytes, np.uint8) for name in of.layers if name != "none for this frame"}
    return Frame(of.key, of.layers, moment, images, {}, {}, 0.0, 0.0)


def put(store, of, nbytes=BYTES):
    """Whether a frame that nobody waits for is kept."""
    store.put(of, frame(of, nbytes))
    return of.key.slot in store.slots(of.key.recipe, of.layers)


def store_of(slots):
    return Store(slots * (BYTES + 4096))


def made_by(store):
    """The slots that an engine makes until nothing is missing."""
    made = []
    while (one := store.next()) is not None:
        made.append(one.key.slot)
        store.put(one, frame(one))
    return made


# ---- what is wanted ---------------------------------------------------------------------------------------------


def test_the_most_urgent_want_is_made_first_and_nothing_twice():
    store = store_of(10)
    store.want([want(slot) for slot in (7, 3, 5)])
    assert store.next() == want(7)
    store.want([want(3), want(7), want(3)])
    assert made_by(store) == [3, 7]
    store.want([want(7), want(1), want(3, DEPTH)])
    assert made_by(store) == [1, 3] and store.get(want(3)).key.slot == 3
    store.want([])
    assert store.next() is None


def test_what_is_wanted_is_there_for_as_long_as_it_is_wanted():
    store, shown, passing = store_of(0), want(3), want(4, keep=False)
    store.want([shown, passing, want(5, hold=False)])
    assert made_by(store) == [3, 4, 5], "what has no room is not made again"
    assert store.get(shown) is store.get(shown) and store.get(passing).key.slot == 4
    assert isinstance(store.get(want(5, hold=False)), Failure)
    store.want([shown])
    assert store.get(shown) is not None and store.get(passing) is None
    store.want([])
    assert store.get(shown) is None and store.nbytes == 0
    store = store_of(2)
    store.want([want(1), want(2)])
    assert made_by(store) == [1, 2]
    store.want([passing])
    assert made_by(store) == [4]
    store.leave(0)
    assert 0 < store.nbytes <= store.most / 2, "it takes room as long as it is held"


def test_no_answer_is_found_under_another_key():
    store = store_of(10)
    store.want([want(3)])
    store.put(want(3), frame(want(3)))
    for other in (want(2), want(3, name="other"), want(3, DEPTH), want(3, FINAL | DEPTH), want(3, pixel=(0, 0))):
        assert store.get(other) is None
    store.open(1)
    store.want([want(3), want(3, source=1)])
    assert store.next() == want(3, source=1) and store.get(want(3)) is None
    store.put(want(3), frame(want(3)))
    assert store.get(want(3)) is None and store.nbytes == 0, "of the source before"


def test_a_failure_is_what_is_there_until_it_is_asked_for_again():
    store, broken = store_of(10), want(2)
    store.want([broken, want(3)])
    store.put(broken, Failure("truncated"))
    assert store.next() == want(3) and store.get(broken).error == "truncated"
    store.retry(broken)
    assert store.next() == broken
    store.put(broken, Failure("truncated"))
    store.want([want(3)])
    store.want([broken])
    assert store.next() == broken


class Shown(Contents):
    """Contents that remember all that was shown."""

    def __init__(self):
        super().__init__()
        self.given = []

    def take(self, result, second=None):
        super().take(result, second)
        self.given.append((result, second))


@pytest.fixture
def showing():
    failed, contents = [], Shown()
    showing = Showing(store_of(10), contents, lambda failure, of_b: failed.append((failure.error, of_b)), Jobs("test"))
    showing.given, showing.failures = contents.given, failed
    return showing


def update(showing, due, passing=False):
    showing.update(due, passing)
    showing._store.want([*showing.wants, *showing.following])


def test_a_and_b_are_shown_when_both_are_there(showing):
    store, pair = showing._store, Picture(want(3), want(3, name="b"))
    update(showing, pair)
    assert store.next() == pair.a and showing.is_waiting
    store.put(pair.a, frame(pair.a))
    update(showing, pair)
    assert not showing.given and store.next() == pair.b
    store.put(pair.b, frame(pair.b))
    update(showing, pair)
    update(showing, pair)
    assert [tuple(one.key for one in both) for both in showing.given] == [(pair.a.key, pair.b.key)]
    assert showing.shows_due and not showing.from_cache
    other = Picture(want(4), want(4, name="b"))
    update(showing, other)
    assert not showing.shows_due
    store.put(other.a, frame(other.a))
    store.put(other.b, Failure("no memory"))
    update(showing, other)
    assert showing.failures == [("no memory", True)] and showing.fault_of_b == "no memory"
    assert (showing.given[-1][0].key, showing.given[-1][1]) == (other.a.key, None)
    update(showing, pair)
    assert showing.shows_due and showing.from_cache and not showing.fault_of_b


def test_frames_that_pass_are_finished_and_none_is_when_one_seeks(showing):
    store = showing._store
    update(showing, Picture(want(1)), passing=True)
    update(showing, Picture(want(5)), passing=True)
    assert store.next() == want(1)
    store.put(want(1), frame(want(1)))
    assert store.next() == want(5), "which is due by now, without a pause"
    update(showing, Picture(want(8)), passing=True)
    assert [first.key.slot for first, _ in showing.given] == [1] and showing.awaited == Picture(want(8))
    update(showing, Picture(want(9, DEPTH)), passing=True)
    assert store.next() == want(9, DEPTH), "another layer"
    update(showing, Picture(want(2)))
    assert store.next() == want(2)
    store.put(want(2), Failure("truncated"))
    for _ in range(2):
        update(showing, Picture(want(2)))
    assert showing.failures == [("truncated", False)] and showing.failed and not showing.shows_due


# ---- what is kept -----------------------------------------------------------------------------------------------


def test_what_is_kept_has_all_layers_that_were_asked_for():
    store = store_of(10)
    assert store.get(want(3)) is None
    assert put(store, want(3)) and put(store, want(3, DEPTH))
    both = store.get(want(3, frozenset({"final", "frame.depth"})))
    assert set(both.images) == {"final", "frame.depth"} and set(store.get(want(3)).images) == {"final"}
    assert store.get(want(3, frozenset({"none for this frame"}))).images == {}  # known not to exist
    with pytest.raises(ValueError, match="read-only"):
        both.images["final"][0] = 1
    store.open(0)
    assert store.get(want(3)) is None and store.nbytes == 0


def test_never_more_bytes_than_given():
    store = store_of(4)
    for slot in range(50):
        store.use({recipe()}, Playhead(slot, 0, 49))
        put(store, want(slot), BYTES * (1 + slot % 3))
        assert store.nbytes <= store.most
    assert not put(store, want(0), 10**6) and not put(Store(0), want(0))


def test_what_is_shown_last_from_the_playhead_on_goes_first():
    store = store_of(4)
    store.use({recipe()}, Playhead(5, 0, 9))
    assert all(put(store, want(slot)) for slot in (5, 6, 7, 8))
    assert not put(store, want(4))  # shown after a whole lap
    store.use({recipe()}, Playhead(7, 0, 9))
    assert put(store, want(9)) and put(store, want(0))
    assert store.slots(recipe(), FINAL) == {7, 8, 9, 0}
    assert runs(store.slots(recipe(), FINAL)) == [(0, 1), (7, 10)] and runs(frozenset()) == []


# ---- in the model -----------------------------------------------------------------------------------------------


@pytest.fixture
def computed(monkeypatch):
    """Slots that were computed since this list was cleared."""
    from gffe_cl.viewer.engine.slot_maker import SlotMaker

    slots, make = [], SlotMaker.make

    def counted(self, key, layers, **how):
        made = make(self, key, layers, **how)
        slots.append(key.slot)
        return made

    monkeypatch.setattr(SlotMaker, "make", counted)
    return slots


def filled(session):
    """Until all slots are in the cache."""
    session.settle()
    session.until(lambda: len(session.model.document.ahead.cached) == session.model.playback.slots)


def shown(session):
    session.settle()
    return {name: image.tobytes() for name, image in session.canvas.layers.items()}


def test_idle_time_fills_the_cache_ahead_of_the_playhead(computed, session):
    session.model.playback.seek(3)
    session.settle()
    computed.clear()
    filled(session)
    # slot 0 was shown on opening, 3 just now; 4 may have been made before `computed` was cleared
    assert computed in ([4, 5, 6, 7, 1, 2], [5, 6, 7, 1, 2])
    computed.clear()
    for slot in (6, 1, 7, 0):
        session.model.playback.seek(slot)
        session.settle()
        assert session.model.contents.result.slot == slot and session.model.slot == slot
    assert computed == []


def test_what_comes_from_the_cache_is_what_is_computed(session):
    """... of a pipeline that came to the slot in order."""
    model, direct = session.model, {}
    model.store.most, cache = 0, model.store.most
    for slot in range(model.playback.slots):
        model.playback.seek(slot)
        direct[slot] = shown(session), model.contents.frame_info()
    model.store.most = cache
    model.playback.seek(0)
    filled(session)
    for slot in reversed(range(model.playback.slots)):
        model.playback.seek(slot)
        assert (shown(session), model.contents.frame_info()) == direct[slot]


def test_a_module_that_is_toggled_back_finds_what_was_there(computed, session):
    model = session.model
    model.playback.seek(5)
    first = shown(session)
    model.set("hole_filling", "none")
    assert shown(session) != first
    computed.clear()
    model.set("hole_filling", Options().hole_filling)
    assert shown(session) == first and 5 not in computed


def test_a_pixel_of_a_kept_slot_is_inspected_where_it_is(session):
    model = session.model
    model.playback.seek(5)
    session.settle()
    model.pointing.pick((3, 4))
    session.settle()
    story = model.pointing.story
    filled(session)
    model.playback.seek(2)
    session.settle()
    model.playback.seek(5)
    session.settle()
    assert model.pointing.inspection.slot == 5 and model.pointing.story == story


def test_playback_of_kept_slots_drops_nothing(computed, session):
    """One frame of the interface for each slot that is due."""
    model = session.model
    filled(session)
    computed.clear()
    model.playback.play()
    now, seen = time.perf_counter(), []
    for i in range(3 * model.playback.slots):
        model.update(now + (i + 0.5) / model.playback.target_rate, session.canvas)
        seen.append(model.contents.result.slot)
    assert seen[: model.playback.slots] == list(range(model.playback.slots)) and model.playback.dropped == 0
    assert computed == []


def test_a_frame_that_cannot_be_read_is_told_when_it_is_looked_at(session, tmp_path, monkeypatch):
    """Filling leaves it out."""
    read = RecordedSource._read

    def faulty(self, k):
        if k == 2:
            raise GffeError("frame_2.exr: truncated")
        return read(self, k)

    monkeypatch.setattr(RecordedSource, "_read", faulty)
    model, source = session.model, session.model.source
    model.open(str(tiny_sequence.write(tmp_path / "broken", frames=4)))
    session.until(lambda: model.source is not source)
    session.settle()
    session.until(lambda: model.document.ahead.cached == {0, 1, 2, 3, 6, 7})
    assert not any(message.error for message in model.messages)
    model.playback.seek(4)
    session.until(lambda: any("frame_2.exr: truncated" in message.text for message in model.messages))


# ---- sequences that grow ----------------------------------------------------------------------------------------


def lengthen(folder, longer):
    """Put the files of the sequence `longer` into `folder`, the description last."""
    for path in sorted(longer.iterdir(), key=lambda path: path.name == "sequence.json"):
        (folder / path.name).write_bytes(path.read_bytes())


def test_new_frames_of_a_sequence_appear(computed, session, tmp_path):
    """What is in the cache stays, but for the last frame, whose camera was a guess; who looked at the end sees the new
    end; a description in the middle of being written does no harm."""
    model, folder = session.model, tmp_path / "first"
    filled(session)
    model.playback.seek(7)
    session.settle()
    longer = tiny_sequence.write(tmp_path / "longer", frames=6)
    whole = (longer / "sequence.json").read_bytes()
    (longer / "sequence.json").write_bytes(whole[:-20])
    lengthen(folder, longer)
    end = time.monotonic() + 3 * WATCH_SECONDS
    while time.monotonic() < end:
        session.frame()
        time.sleep(0.01)
    assert model.playback.count == 4 and not model.messages
    computed.clear()
    (folder / "sequence.json").write_bytes(whole)
    session.until(lambda: model.playback.count == 6)
    assert model.playback.slot == 11
    filled(session)
    assert set(computed) == {6, 7, 8, 9, 10, 11} and model.slot == 11
    kept = shown(session)
    (longer / "sequence.json").write_bytes(whole)
    source = model.source
    model.open(str(longer))
    session.until(lambda: model.source is not source)
    model.playback.seek(11)
    assert shown(session) == kept


def test_another_sequence_in_the_same_place_is_not_taken_for_more_of_it(session, tmp_path):
    model, folder = session.model, tmp_path / "first"
    lengthen(folder, tiny_sequence.write(tmp_path / "other", frames=6))
    tiny_sequence.edit(folder, lambda document: document.update(fps=15.0))
    end = time.monotonic() + 4 * WATCH_SECONDS
    while time.monotonic() < end:
        session.frame()
        time.sleep(0.01)
    assert model.playback.count == 4 and not model.messages


@pytest.mark.long
def test_the_render_rate(session):
    """Generated frames make up for rendered ones that are fewer."""
    model = session.model
    model.open("corridor")
    session.until(lambda: model.source.live)
    session.settle()
    for rate, n in (("10", 5), ("15", 3), ("30", 1)):
        source = model.source
        model.set("render_rate", rate)
        session.until(lambda source=source: model.source is not source and model.contents.result is not None)
        assert (model.source.fps, model.n, model.playback.target_rate) == (float(rate), n, 60.0)
    model.set("render_rate", "scene")
    session.until(lambda: model.source.fps == 30.0 and model.document.plan.fps is None)
    assert model.n == 1
