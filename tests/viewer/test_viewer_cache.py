"""The viewer's cache of computed slots: what is kept, what goes first, and that what comes from it is right."""

import time

import numpy as np
import pytest
import tiny_sequence
from viewer_session import Session

from gffe_cl import Options
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.viewer.engine.buffers import Moment
from gffe_cl.viewer.engine.cache import FrameCache, FrameKey, Playhead
from gffe_cl.viewer.engine.messages import Recipe, Request, Result, Setup
from gffe_cl.viewer.engine.reloading import WATCH_SECONDS
from gffe_cl.viewer.engine.sources.recorded import RecordedSource
from gffe_cl.viewer.panels.timeline import runs
from gffe_cl.viewer.state.navigation import Flight

BYTES = 1000
FINAL = frozenset({"final"})


def recipe(name=""):
    return Recipe(1, 0, Setup(), name)


def result(slot=0, layers=FINAL, metrics=False, nbytes=BYTES):
    moment = Moment(slot, 0.0, 0.0, *[None] * 4)
    images = {name: np.zeros(nbytes, np.uint8) for name in layers if name != "none for this frame"}
    return Result(Request(slot, Setup(), frozenset(layers), 1, metrics), moment, images, {}, {}, 0.0, 0.0)


def cache_of(slots):
    return FrameCache(slots * (BYTES + 4096))


def test_what_is_kept_has_all_layers_that_were_asked_for():
    cache, key = cache_of(10), FrameKey(recipe(), 3)
    assert cache.get(key, FINAL) is None
    assert cache.put(key, result(3)) and cache.put(key, result(3, {"frame.depth", "none for this frame"}))
    both = cache.get(key, frozenset({"final", "frame.depth"}))
    assert set(both.images) == {"final", "frame.depth"} and set(cache.get(key, FINAL).images) == {"final"}
    assert cache.get(key, frozenset({"none for this frame"})).images == {}  # known not to exist
    assert cache.get(key, frozenset({"truth"})) is None and cache.get(FrameKey(recipe("other"), 3), FINAL) is None
    assert cache.get(key, FINAL, metrics=True) is None
    cache.put(key, result(3, metrics=True))
    assert cache.get(key, FINAL, metrics=True) and cache.slots(recipe(), FINAL, True) == {3}
    with pytest.raises(ValueError, match="read-only"):
        both.images["final"][0] = 1
    cache.clear()
    assert cache.get(key, FINAL) is None and cache.nbytes == 0


def test_never_more_bytes_than_given():
    cache = cache_of(4)
    for slot in range(50):
        cache.use({recipe()}, Playhead(slot, 0, 49))
        cache.put(FrameKey(recipe(), slot), result(slot, nbytes=BYTES * (1 + slot % 3)))
        assert cache.nbytes <= cache.most
    assert not cache.put(FrameKey(recipe(), 0), result(nbytes=10**6))
    assert not FrameCache(0).put(FrameKey(recipe(), 0), result())


def test_what_is_shown_last_from_the_playhead_on_goes_first():
    cache = cache_of(4)
    cache.use({recipe()}, Playhead(5, 0, 9))
    for slot in (5, 6, 7, 8):
        assert cache.put(FrameKey(recipe(), slot), result(slot))
    assert not cache.put(FrameKey(recipe(), 4), result(4))  # shown after a whole lap
    cache.use({recipe()}, Playhead(7, 0, 9))
    assert cache.put(FrameKey(recipe(), 9), result(9)) and cache.put(FrameKey(recipe(), 0), result(0))
    assert cache.slots(recipe(), FINAL) == {7, 8, 9, 0}


def test_other_recipes_go_first_and_the_one_used_longest_ago_first_of_all():
    cache = cache_of(4)
    a, b, c = (recipe(name) for name in "abc")
    for one, slot in ((a, 0), (b, 0), (a, 1), (b, 1)):
        cache.put(FrameKey(one, slot), result(slot))
    cache.get(FrameKey(a, 0), FINAL)
    cache.use({c}, Playhead(0, 0, 9))
    cache.put(FrameKey(c, 9), result(9))
    cache.put(FrameKey(c, 8), result(8))
    assert (cache.slots(a, FINAL), cache.slots(b, FINAL)) == ({0, 1}, frozenset())
    cache.put(FrameKey(c, 7), result(7))
    assert len(cache.slots(a, FINAL)) == 1 and cache.slots(c, FINAL) == {7, 8, 9}
    assert not cache.put(FrameKey(b, 5), result(5, nbytes=2 * BYTES + 4096))  # b is not looked at


def test_stretches_of_slots():
    assert runs(frozenset()) == [] and runs(frozenset({3})) == [(3, 4)]
    assert runs(frozenset({7, 0, 1, 2, 5})) == [(0, 3), (5, 6), (7, 8)]


# ---- in the model -----------------------------------------------------------------------------------------------


@pytest.fixture
def session(tmp_path):
    session = Session(tiny_sequence.write(tmp_path / "first", frames=4))
    yield session
    session.model.close()


@pytest.fixture
def computed(monkeypatch):
    """Slots that were computed, with their roles, since this list was cleared."""
    from gffe_cl.viewer.engine.slot_renderer import SlotMaker

    slots, make = [], SlotMaker.make

    def counted(self, request, **how):
        slots.append((request.slot, request.role))
        return make(self, request, **how)

    monkeypatch.setattr(SlotMaker, "make", counted)
    return slots


def filled(session):
    """Until all slots are in the cache."""
    session.settle()
    session.until(lambda: len(session.model.filling.cached) == session.model.playback.slots)


def shown(session):
    session.settle()
    return {name: image.tobytes() for name, image in session.canvas.layers.items()}


def test_idle_time_fills_the_cache_ahead_of_the_playhead(computed, session):
    session.model.playback.seek(3)
    session.settle()
    computed.clear()
    filled(session)
    # slot 0 was shown on opening, 3 just now; 4 may have been begun before `computed` was cleared
    ahead = [slot for slot, role in computed if role == "ahead"]
    assert ahead in ([4, 5, 6, 7, 1, 2], [5, 6, 7, 1, 2])
    computed.clear()
    for slot in (6, 1, 7, 0):
        session.model.playback.seek(slot)
        session.settle()
        assert session.model.contents.result.request.slot == slot and session.model.slot == slot
    assert computed == []


def test_what_comes_from_the_cache_is_what_is_computed(session):
    """... of a pipeline that came to the slot in order."""
    model, direct = session.model, {}
    model.engine.cache.most, cache = 0, model.engine.cache.most
    for slot in range(model.playback.slots):
        model.playback.seek(slot)
        direct[slot] = shown(session), model.contents.frame_info()
    model.engine.cache.most = cache
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
    assert shown(session) == first and (5, "a") not in computed


def test_another_layer_is_computed_and_then_kept_beside(computed, session):
    model = session.model
    filled(session)
    model.show_layer("frame.depth")
    filled(session)
    computed.clear()
    for layer, slot in (("final", 3), ("frame.depth", 3), ("frame.depth", 7), ("final", 7)):
        model.show_layer(layer)
        model.playback.seek(slot)
        session.settle()
        assert set(session.canvas.layers) == {layer}
    assert computed == []


def test_other_kernels_and_other_weights_find_nothing(computed, session):
    model = session.model
    filled(session)
    model.engine._kernels.identity += " and another one"
    session.frame()
    assert model.filling.find(model.recipe, model.contents.result.request) is None


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


def test_nothing_is_kept_without_a_cache(computed, session):
    model = session.model
    model.engine.cache.clear()
    model.engine.cache.most = 0
    for slot in (3, 5, 3):
        model.playback.seek(slot)
        session.settle()
    assert model.engine.cache.nbytes == 0
    assert [slot for slot, role in computed if role == "a"][-3:] == [3, 5, 3]


def test_another_sequence_starts_with_an_empty_cache(session, tmp_path):
    filled(session)
    before = shown(session)
    session.model.open(str(tiny_sequence.write(tmp_path / "second", frames=2)))
    session.until(lambda: session.model.source.name == "second")
    filled(session)
    assert session.model.playback.slots == 4 and shown(session) == before  # its first frame has the same pixels


def test_playback_of_kept_slots_drops_nothing(computed, session):
    """One frame of the interface for each slot that is due."""
    model = session.model
    filled(session)
    computed.clear()
    model.playback.play()
    now, seen = time.perf_counter(), []
    for i in range(3 * model.playback.slots):
        model.update(now + (i + 0.5) / model.playback.target_rate, session.canvas)
        seen.append(model.contents.result.request.slot)
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
    session.until(lambda: model.filling.cached == {0, 1, 2, 3, 6, 7})
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
    assert {slot for slot, _ in computed} == {6, 7, 8, 9, 10, 11} and model.slot == 11
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
def test_the_render_rate_of_a_flight(session):
    """Generated frames make up for rendered ones that are fewer; the camera stays where it was flown to."""
    model = session.model
    model.open("corridor")
    session.until(lambda: model.source.live)
    session.settle()
    model.toggle_flying()
    for _ in range(20):
        model.fly(Flight((0.0, 0.0, 1.0), 1.0, 2.0, 0.0), time.perf_counter())
        session.frame()
        time.sleep(0.01)
    pose = model.flyer.pose.position
    assert not np.allclose(pose, model.source.scene.camera(0.0, 8, 8).position)
    for rate, n in (("10", 5), ("15", 3), ("30", 1)):
        source = model.source
        model.set("render_rate", rate)
        session.until(lambda source=source: model.source is not source and model.contents.result is not None)
        assert (model.source.fps, model.n, model.playback.target_rate) == (float(rate), n, 60.0)
        assert model.flying and model.playback.playing and np.array_equal(model.flyer.pose.position, pose)
        session.until(lambda: model.contents.result.moment.alpha > 0)
        assert model.contents.result.moment.camera.position == pytest.approx(pose, abs=1e-6)
    model.stop_flying()
    model.set("render_rate", "scene")
    session.until(lambda: model.source.fps == 30.0 and model.plan.fps is None)
    assert not model.flying and model.n == 1
