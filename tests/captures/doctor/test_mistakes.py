"""One table of mistakes: each kind has its name on three built-in scenes, and a format to paste that undoes it."""

import functools
import json

import numpy as np
import pytest
from doctor_clips import written
from fault_injection import Kept
from mistakes import MISTAKES, UNEXPLAINED
from parameters import few

import gffe_cl
from gffe_cl.captures.doctor import FoundFormat, examine, with_format
from gffe_cl.captures.scenes import SceneFrames, SceneRenderer, load_scene
from gffe_cl.captures.scenes.renderer import EncodedFrames
from gffe_cl.captures.sequence import open_sequence
from gffe_cl.captures.sequence.encoding import Encoding
from gffe_cl.engine.opencl.device import open_device

SCENES = ["corridor", "forest", "plaza"]
SIZE, COUNT, FPS = (256, 128), 8, 30
# In a steady movement these look like sound frames, or like each other: then nothing is named.
STEADY = {name for name in MISTAKES if "of the frame" in name}
# Known limits. The camera of this clip hardly moves on: residuals of these are below 0.04 px, so the frames fit,
# and late vectors differ by so little that the difference looks like steps.
LIMITS = {
    ("forest", "distance"): [],
    ("forest", "saturated depth"): [],
    ("forest", "vectors of the frame before"): ["misfit-at-end", "motion-quantized"],
}
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
    """Return (scene, case) of which only one scene for each of `kept` is not long, in turns."""
    pairs = [(scene, case) for case in cases for scene in SCENES]
    return few(pairs, *((SCENES[k % len(SCENES)], case) for k, case in enumerate(kept)))


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
    if (scene, name) in LIMITS:
        assert sorted(names) == LIMITS[scene, name] and found.found is None
        return
    if name in STEADY and names in ([], ["misfit-at-end"], ["ambiguous"]):
        assert found.found is None
        return
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
    assert kinds - tested == {"nothing-usable", "single-frames", "still-camera"}  # of test_doctor.py


@pytest.mark.parametrize(("scene", "name"), spread(UNEXPLAINED, ["saturated depth", "split screen", "lost bytes"]))
def test_what_no_format_undoes_is_not_named(scene, name):
    frames, exposure = good(scene)
    found = examine(Kept(UNEXPLAINED[name](frames), exposure), exposure)
    if (scene, name) in LIMITS:
        assert found.found is None and faults(found) == LIMITS[scene, name]
        return
    assert found.found is None and found.faults
    assert set(faults(found)) <= {"unexplained", "unexplained-frame"}, [str(one) for one in found.findings]
    assert all("no known change explains it" in str(one) for one in found.faults)


SOUND = [(scene, code) for scene in SCENES for code in CODES]


@pytest.mark.parametrize(("scene", "code"), few(SOUND, ("plaza", "exact"), ("corridor", "engine")))
def test_sound_sequences_have_no_fault(scene, code):
    """As engines store them, too: vectors of games are dilated, which is named, and nothing else."""
    loaded, encoding = load_scene(scene, 5), Encoding.parse(code)
    source = SceneFrames(SceneRenderer(open_device(), loaded, *SIZE))
    frames = list(EncodedFrames(source, encoding).sequence(COUNT, FPS))
    said = gffe_cl.check(frames, loaded.exposure, encoding.format)
    assert said is None or ("motion: motion_dilated=True" in said and code == "game")
    if code == "exact":
        assert examine(Kept(frames, loaded.exposure), loaded.exposure).findings == []
