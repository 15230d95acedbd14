"""Encoding of messages between attached programs and the viewer: all values come back, and nothing else does."""

import dataclasses
import json
import pickle

import numpy as np
import pytest
from fuzz_targets import answer_seed

from gffe_cl import Camera, GffeError
from gffe_cl.engine.inspection.attached import wire
from gffe_cl.engine.inspection.attached.encoding import decoded, encoded
from gffe_cl.engine.inspection.attached.shared_memory import About, RecordingPlan
from gffe_cl.engine.inspection.explain.motion_trail import WayPoint
from gffe_cl.engine.inspection.explain.pixel_explain_types import Inspection, Link, Step, Story
from gffe_cl.engine.options import Options

CAMERA = Camera.look_at((0.1, 1 / 3, 2), (1, 2, 7.7), (0, 1, 0), 300.1, 301.3, 160.7, 90.1)
STORY = Story(
    (3, 4), "hole", None, ((0.5, np.float32(1.5)),), np.bool_(True), np.float64(0.1), float("inf"),
    sentences=("plain", Step("linked", Link("mask", "frame.mask"), Link("before", frame=3, pixel=(1, 2)))),
    way=(WayPoint(3, (0.1, 0.2)),),
)  # fmt: skip
MESSAGES = (
    wire.Greeting(3),
    wire.Look(frozenset({"final", "warp.color"}), True),
    wire.Ask(1, 2, None),
    wire.Ask(1, 2, frozenset()),
    wire.Use(Options(motion=False, static_threshold=0.3, scn_model="é\ud800\n")),
    wire.Program(7, (160, 96), (80, 48), 29.97, "a device", Options()),
    wire.Recording(RecordingPlan(3, (160, 96), (160, 96), 30.0)),
    wire.Refused("no", Options()),
    About(np.int64(3), 0.1, CAMERA, CAMERA, False, 1.0, {0.1 + 0.2: CAMERA}),
)


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: type(message).__name__)
def test_messages_come_back(message):
    assert decoded(encoded(message), type(message)) == message


def test_frames_come_back():
    seen = decoded(answer_seed(), *wire.FROM_PROGRAM)
    assert type(seen) is wire.Seen and seen.moment.previous_camera is None and seen.images["final"].shape == (9, 12, 4)
    assert encoded(seen) == answer_seed()


def test_stories_and_arrays_come_back():
    values = {
        "half": np.array([1, 1e-5, np.nan], "f2"),
        "bytes": np.arange(12, dtype="u1").reshape(2, 2, 3)[:, ::-1],
        "empty": np.zeros((0, 3), ">f4"),
    }
    found = decoded(encoded(Inspection((3, 4), 0, None, values, STORY)), *wire.FROM_PROGRAM)
    assert found.story == STORY and found.story.sentences[1].links == STORY.sentences[1].links
    assert type(found.story.sentences[0]) is str and type(found.story.dynamic) is bool
    for name, array in values.items():
        assert found.values[name].dtype == array.dtype and np.array_equal(
            found.values[name], array, equal_nan=name == "half"
        )
        assert found.values[name].flags.writeable


def changed(**fields):
    return json.dumps(["Ask", {"x": 1, "y": 2, "layers": None} | fields]).encode()


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xff",
        b"{}",
        b"[" * 100_000,
        b'["Look",null]',
        b'["Use",{"options":{}}]',
        pickle.dumps(wire.Ask(1, 2)),
        changed(x=True),
        changed(x="1"),
        changed(x=1.0),
        changed(y=None),
        changed(more=1),
        changed(layers="final"),
        changed(layers=[1]),
        changed(layers=[[]]),
        changed() + b"\0rest",
        encoded(wire.Greeting(3)),
        encoded(wire.Use(Options())).replace(b'"far-side"', b'"nowhere"'),
    ],
)
def test_other_bytes_are_refused_in_one_line(data):
    with pytest.raises(
        GffeError, match=r"attach: message is invalid: .* \(expected Look or Ask or Use of this version"
    ):
        decoded(data, *wire.FROM_VIEWER)


@pytest.mark.parametrize(
    "described", [["O", [1]], ["<f4", [1 << 60]], ["<f4", [-1]], ["<f4", [3, 2]], ["V8", [1]], [1, 2]]
)
def test_arrays_stay_within_their_bytes(described):
    @dataclasses.dataclass(frozen=True)
    class Holder:
        array: np.ndarray

    Holder.__annotations__["array"] = np.ndarray
    with pytest.raises(GffeError, match="message is invalid"):
        decoded(json.dumps(["Holder", {"array": described}]).encode() + b"\0" + bytes(16), Holder)
