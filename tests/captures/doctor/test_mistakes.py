"""One table of mistakes: each kind has its name on a built-in scene, and a format to paste that undoes it."""

import functools
import json
from dataclasses import replace

import numpy as np
import pytest
from doctor_clips import written
from fault_injection import Kept
from mistakes import MISTAKES, UNEXPLAINED, bits_of_floats
from parameters import few

import gffe_cl
from gffe_cl.captures.doctor import FoundFormat, examine, with_format
from gffe_cl.captures.scenes import SITUATIONS, SceneFrames, SceneRenderer, load_scene
from gffe_cl.captures.scenes.renderer import EncodedFrames
from gffe_cl.captures.sequence import SequenceWriter, named_channels, open_sequence
from gffe_cl.captures.sequence.description import rendered_entry
from gffe_cl.captures.sequence.encoding import Encoding
from gffe_cl.engine.frame.frame_format import FrameFormat
from gffe_cl.engine.frame.window import Jitter
from gffe_cl.engine.opencl.device import open_device

SCENES = ["corridor", "forest", "plaza"]
SIZE, COUNT, FPS = (256, 128), 8, 30
# The cameras of the forest and of the plaza hardly move on: there these look like sound frames.
FAINT = {"distance", "saturated depth", "depth of the frame before", "vectors of the frame before"}
FAINT |= {"color of the frame before", "color of the frame after"}
CODES = ["exact", "game", "engine", "half", "taa"]


@functools.cache
def good(scene):
    """Return frames of a scene, and the exposure."""
    loaded = load_scene(scene, 5)
    source = SceneFrames(SceneRenderer(open_device(), loaded, *SIZE))
    return list(source.sequence(COUNT, FPS)), loaded.exposure


def faults(diagnosis):
    return [one.name for one in diagnosis.faults]


def spread(cases, kept):
    """Return (scene, case), the scenes in turns; only cases that are `kept` are not long."""
    pairs = [("corridor" if case in FAINT else SCENES[k % len(SCENES)], case) for k, case in enumerate(cases)]
    return few(pairs, *(pair for pair in pairs if pair[1] in kept))


SEEN = ["as of Unity", "zero", "logarithmic of 1 + z", "inverted", "field of view", "rows up", "jitter", "cut"]
SEEN += ["vectors of the frame after", "display values", "frame dropped", "at half the rate", "never written"]
SEEN += ["dilated", "reset in every second frame"]


@pytest.mark.parametrize(("scene", "name"), spread(MISTAKES, SEEN))
def test_a_mistake_has_its_name_and_a_format_that_undoes_it(scene, name, tmp_path):
    frames, exposure = good(scene)
    mistake = MISTAKES[name]
    bad = open_sequence(written(tmp_path / "bad", Kept(mistake.change(frames), exposure)))
    found = examine(bad, exposure)
    names = [one.name for one in found.findings]
    assert sorted(names) == sorted(mistake.names), [str(one) for one in found.findings]
    assert all(str(one).startswith(f"{one.about}: ") for one in found.findings)
    if mistake.off is None:
        assert found.found is None or not found.faults or name == "display values"
        return
    pasted = FoundFormat.from_json(json.loads(json.dumps(found.found.to_json())))
    assert pasted == found.found
    made = with_format(bad, pasted)
    truth = {frame.time: frame for frame in frames}
    assert len(made.rendered) >= COUNT - 2
    for entry in made.rendered:
        frame, true = made.read(entry), truth[entry.time]
        same(frame.color, true.color, 0)
        same(frame.depth, true.depth, mistake.off * true.depth)
        same(frame.camera.world_to_view, true.camera.world_to_view, 1e-5)
        same(frame.camera.fx, true.camera.fx, mistake.off * true.camera.fx)
        if not entry.reset and not (mistake.off and np.isinf(true.depth).any()):
            same(frame.motion, true.motion, 20 * mistake.off, 0.9 if name == "zero" else 0.98)  # movers are lost


def same(made, true, off, least=0.98):
    made, true = np.asarray(made), np.asarray(true)
    with np.errstate(invalid="ignore"):
        assert ((made == true) | (np.abs(made - true) <= off)).mean() > (least if np.any(off) else 1 - 1e-9)


def test_the_table_has_every_kind_of_finding():
    from gffe_cl.captures.doctor import findings

    classes = [one for one in vars(findings).values() if isinstance(one, type) and issubclass(one, findings.Finding)]
    kinds = {one.name for one in classes if isinstance(getattr(one, "name", None), str)}
    tested = {name for mistake in MISTAKES.values() for name in mistake.names}
    tested |= {"unexplained", "unexplained-frame", "ambiguous", "misfit-at-end"}  # below
    of_test_doctor = {"nothing-usable", "single-frames", "still-camera", "uneven-times", "truth-of-another-time"}
    assert kinds - tested == of_test_doctor


@pytest.mark.parametrize(("scene", "name"), spread(UNEXPLAINED, ["saturated depth", "split screen", "lost bytes"]))
def test_what_no_format_undoes_is_not_named(scene, name):
    frames, exposure = good(scene)
    found = examine(Kept(UNEXPLAINED[name](frames), exposure), exposure)
    assert found.found is None and found.faults
    assert set(faults(found)) <= {"unexplained", "unexplained-frame"}, [str(one) for one in found.findings]
    assert all("no known change explains it" in str(one) for one in found.faults)


def test_bits_of_floats_are_no_logarithms():
    """Nearly they are: to a far plane at 1e26, or by planes that no format can have."""
    frames, exposure = good("plaza")
    (fault,) = examine(Kept(bits_of_floats(frames), exposure), exposure).faults
    assert fault.name == "unexplained"


@pytest.mark.parametrize(("scene", "code"), spread(CODES, ["exact", "engine"]))
def test_sound_sequences_have_no_fault(scene, code):
    """As engines store them, too: vectors of games are dilated, which is named, and nothing else."""
    loaded, encoding = load_scene(scene, 5), Encoding.parse(code)
    source = SceneFrames(SceneRenderer(open_device(), loaded, *SIZE))
    stored = EncodedFrames(source, encoding)
    frames = [stored.encoded(frame, k) for k, frame in enumerate(source.sequence(COUNT, FPS))]
    said = gffe_cl.check(frames, loaded.exposure, encoding.format)
    assert said is None or ("motion: motion_dilated=True" in said and code == "game")
    if code == "exact":
        assert examine(Kept(frames, loaded.exposure), loaded.exposure).findings == []


@pytest.mark.parametrize("name", few(list(SITUATIONS), "wipers", "bars"))
def test_situations_have_no_fault(name):
    """Among them a cab that fills half the picture and travels with the camera, and bars of one color."""
    scene = load_scene(name)
    frames = list(SceneFrames(SceneRenderer(open_device(), scene, 192, 108)).sequence(COUNT, FPS))
    found = examine(Kept(frames, scene.exposure), scene.exposure)
    assert [one.name for one in found.findings] in ([], ["still-camera"])
    assert found.given.fits


CAMERA = {"jitter": "geometry_jitter"}
# By name: whether color is jittered, cameras are, the declared format takes jitter out of vectors, and their sign; what
# is found. Vectors and geometry have the jitter, which each frame says.
JITTERED = {
    "taken out": ((True, True, True, 1), {}, {}),
    "taken out of negated vectors": ((True, True, True, -1), {"motion_direction": "from_previous"}, {}),
    "in cameras": ((False, True, True, 1), {"motion_jittered": True}, CAMERA),
    "in cameras and vectors": ((False, True, False, 1), {"motion_jittered": True}, CAMERA),
    "in vectors": ((False, False, False, 1), {"motion_jittered": True}, {}),
}


@functools.cache
def jittered(scene):
    loaded = load_scene(scene, 5)
    source = SceneFrames(SceneRenderer(open_device(), loaded, *SIZE, samples=1), jitter=Jitter(8))
    return list(source.sequence(COUNT, FPS))


@pytest.mark.parametrize(("scene", "name"), spread(JITTERED, ["taken out of negated vectors", "in cameras"]))
def test_jitter_in_cameras_and_vectors_is_written_as_it_was_diagnosed(gffe, scene, name, tmp_path):
    (frames, exposure), (case, fields, keys) = good(scene), JITTERED[name]
    of_color, of_cameras, is_declared, sign = case
    bad, found, made = tmp_path / "bad", tmp_path / "found.json", tmp_path / "made"
    with SequenceWriter(bad, *SIZE, FPS, exposure, format=FrameFormat(motion_jittered=is_declared)) as writer:
        for k, (plain, f) in enumerate(zip(frames, jittered(scene), strict=True)):
            shift = f.camera.cx - SIZE[0] / 2, f.camera.cy - SIZE[1] / 2
            color, camera = (f if of_color else plain).color, (f if of_cameras else plain).camera
            frame = replace(f, color=color, camera=camera, motion=sign * f.motion, geometry_jitter=shift)
            writer.add(rendered_entry(k, frame, SIZE), named_channels(frame.color, frame.depth, frame.motion))
    assert gffe("check", bad, "--format-out", found, "--json", tmp_path / "bad.json")[0] == 1
    expected = {"frame_format": fields} | ({"cameras": keys} if keys else {})
    assert json.loads(found.read_text()) == expected
    assert gffe("import", bad, made, "--format", found)[0] == 0
    assert gffe("check", made, "--json", tmp_path / "made.json")[0] == 0
    diagnosed, written = (json.loads((tmp_path / one).read_text())["residuals"] for one in ("bad.json", "made.json"))
    assert written["given"] == pytest.approx(diagnosed["read"], abs=1e-5)
