"""Sequences that are stored as engines have them, through the command line: encodings of `gffe render --encode`,
formats of engines' interfaces and a frame's geometry, through commands that write sequences; a few through others."""

import json
import math
import shutil
from dataclasses import dataclass, fields, replace

import numpy as np
import pytest
from engine_buffers import stored

from gffe_cl import FrameFormat, Overlays, SequenceWriter, named_channels, open_sequence
from gffe_cl.cli import main
from gffe_cl.engine.frame.transfer_function import to_display

W, H, FRAMES = 96, 54, 5
HALF, THIRD = (W // 2, H // 2), (W // 3, H // 3)
JITTERS = [(0.0, 0.0), (0.25, -0.5), (-0.375, 0.125), (0.5, 0.25), (-0.25, -0.25)]  # pixels of color
SDKS = {
    "fsr3": FrameFormat.fsr3(
        renderSize=HALF, displaySize=(W, H), motionVectorScale=HALF, cameraNear=0.1, flags=0b11100
    ),
    "streamline": FrameFormat.streamline(
        mvecScale=(1 / W, 1 / H),
        cameraNear=0.1,
        cameraFar=100.0,
        depthInverted=True,
        cameraMotionIncluded=False,
        motionVectorsJittered=True,
        color_size=(W, H),
        geometry_size=HALF,
    ),
    "xess": FrameFormat.xess(
        projectionMatrix=[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1], [0, 0, -0.1, 0]], initFlags=0b1100
    ),
    "openxr": FrameFormat.openxr(nearZ=math.inf, farZ=0.1, motionVectorScale=(1, 1, 1, 0)),
}


@dataclass(frozen=True)
class Stored:
    """Sequence to make: by `gffe render --encode`, or from the exact one as `format` describes it. `sizes`: of the
    geometry, frame by frame; `jittered`: whether geometry is said to be jittered. `loss`: the most that its new frames
    may be worse than those of the exact sequence, dB; `near`: what its pixels may differ by."""

    encoding: str = ""
    format: FrameFormat | None = None
    sizes: tuple = ()
    jittered: bool = False
    loss: float = 0.05


INPUTS = {
    "exact": Stored(encoding="exact", loss=0.5),
    "engine": Stored(encoding="engine", loss=2),  # how much worse than exact frames new ones may be, dB:
    "game": Stored(encoding="game", loss=6),  # colors differ from truth
    **{name: Stored(format=format, jittered=format.motion_jittered, loss=0.6) for name, format in SDKS.items()},
    "frame.geometry_size": Stored(sizes=(HALF, (W, H), HALF, THIRD, None), loss=0.6),
    "frame.geometry_jitter": Stored(jittered=True),
}


def call(*arguments):
    """Run `gffe` in this process and return its exit code."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["gffe", *map(str, arguments)])
        try:
            main()
        except SystemExit as stop:
            return stop.code or 0
    return 0


class Made:
    """Sequences of `INPUTS` and results of commands on them, each made once, in `folder`."""

    def __init__(self, folder):
        self._folder = folder

    def path(self, name, *parts):
        return self._folder.joinpath("_".join((name, *parts)))

    def sequence(self, name):
        """Return the folder of the sequence `name`."""
        folder, given = self.path(name), INPUTS[name]
        if folder.exists():
            return folder
        if given.encoding:
            size = ("--size", f"{W}x{H}", "--frames", FRAMES)
            assert call("render", "railings", folder, *size, "--ground-truth", "--encode", given.encoding) == 0
        else:
            write_described(folder, given, open_sequence(self.sequence("exact")))
        return folder

    def run(self, name, *again):
        """Return the folder of the new frames of the sequence `name`; with an argument of those of these."""
        out = self.path(name, "run", *again)
        if not out.exists():
            source = self.run(name) if again else self.sequence(name)
            assert call("run", source, out, "--no-scn", "--no-check", "--camera", "predicted") == 0
        return out

    def psnr(self, name):
        """Return the mean PSNR of the new frames of the sequence `name`, dB."""
        report = self.path(name, "psnr.json")
        if not report.exists():
            assert call("compare", self.run(name), self.sequence(name), "--json", report) == 0
        return json.loads(report.read_text())["mean"]["psnr"]


def write_described(folder, given, exact):
    """Write the frames of the sequence `exact` as `given` says. The last one has overlays."""
    format, before = given.format or FrameFormat(), None
    with SequenceWriter(folder, W, H, exact.fps, exact.exposure, format=given.format) as writer:
        for k, (entry, frame) in enumerate(zip(exact.rendered, exact, strict=True)):
            jitters = (JITTERS[k], JITTERS[k - 1] if k else JITTERS[k]) if given.jittered else ()
            size = given.sizes[k] if given.sizes else None
            made = stored(frame, before, format, size, *jitters)
            overlays = Overlays(fixed_mask=np.zeros((H, W), bool)) if k == FRAMES - 1 else None
            motion = made.motion if k else None
            keys = {"geometry_size": size, "geometry_jitter": made.geometry_jitter}
            writer.add(replace(entry, **keys), named_channels(made.color, made.depth, motion, overlays))
            before = frame
        for entry in exact.ground_truth:
            writer.add(entry, named_channels(exact.read_color(entry)))


@pytest.fixture(scope="session")
def made(tmp_path_factory):
    return Made(tmp_path_factory.mktemp("stored"))


def keys_of(folder):
    """Return all keys of a sequence.json about how rendered frames are stored."""
    document = json.loads((folder / "sequence.json").read_text())
    kept = (
        "file",
        "time",
        "reset",
        "render_size",
        "geometry_size",
        "geometry_jitter",
        "render_camera",
        "display_camera",
    )
    rendered = [{name: frame.get(name) for name in kept} for frame in document["frames"] if frame["kind"] == "rendered"]
    return document["version"], document.get("frame_format"), rendered


def assert_same(one, other):
    """Fields of two rendered frames."""
    for name in ("color", "depth", "motion"):
        a, b = getattr(one, name), getattr(other, name)
        assert (a is None) == (b is None)
        if a is not None:
            np.testing.assert_array_equal(a, b, name)
    for field in fields(Overlays):
        a, b = (getattr(frame.overlays, field.name, None) for frame in (one, other))
        assert np.array_equal(a, b) or (a is None and b is None), field.name
    assert one.geometry_jitter == other.geometry_jitter and one.geometry_size == other.geometry_size


FEW = ("game", "streamline", "frame.geometry_size")
every_input = pytest.mark.parametrize("name", INPUTS)
representatives = pytest.mark.parametrize("name", FEW)


@every_input
def test_run(made, name):
    """Rendered frames are as they were given, byte for byte, and described as before; new frames are in our
    conventions, as good as those of the exact sequence."""
    given, out = made.sequence(name), made.run(name)
    assert keys_of(out) == keys_of(given)
    for entry in open_sequence(given).rendered:
        assert (out / entry.file).read_bytes() == (given / entry.file).read_bytes()
    sequence = open_sequence(out)
    assert len(sequence.extrapolated) == FRAMES
    for entry in sequence.extrapolated:
        channels = sequence.read_channels(entry, ["Z", "motion.x", "motion.y"])
        assert {array.shape for array in channels.values()} == {(H, W)}
    worse = made.psnr("exact") - made.psnr(name)
    assert worse < INPUTS[name].loss, f"{worse:.3f} dB"


@representatives
def test_run_goes_on_from_its_output(made, name):
    """The same rendered frames, the same new ones."""
    first, again = made.run(name), made.run(name, "again")
    assert keys_of(first) == keys_of(again)
    for entry in open_sequence(first).frames:
        assert (first / entry.file).read_bytes() == (again / entry.file).read_bytes(), entry.file


@pytest.mark.parametrize("name", ["streamline"])
def test_run_upscaled(made, name, tmp_path):
    """Displayed frames are written, in our conventions."""
    given, out = open_sequence(made.sequence(name)), tmp_path / "out"
    assert call("run", given.path, out, "--no-scn", "--no-check", "--upscale", 2) == 0
    version, format, entries = keys_of(out)
    assert (version, format) == (1, None) and not any(entry["geometry_jitter"] for entry in entries)
    for before, frame in zip(given, open_sequence(out), strict=True):
        assert frame.depth.shape == (2 * H, 2 * W)
        colors = [to_display(color, given.exposure) for color in (before.color, frame.color)]
        means = colors[1].reshape(H, 2, W, 2, 3).mean((1, 3))
        assert np.abs(means - colors[0]).mean() < 0.03


@representatives
def test_import(made, name, tmp_path):
    """A copy is as it was given, value for value; where something is changed, all is in our conventions."""
    given = open_sequence(made.sequence(name))
    assert call("import", given.path, tmp_path / "copy") == 0
    copy = open_sequence(tmp_path / "copy")
    assert keys_of(copy.path) == keys_of(given.path)
    for entry, mine in zip(given.rendered, copy.rendered, strict=True):
        assert_same(given.read_stored(entry), copy.read_stored(mine))
    for truth, mine in zip(given.ground_truth, copy.ground_truth, strict=True):
        assert given.read_color(truth).tobytes() == copy.read_color(mine).tobytes()
    assert call("import", given.path, tmp_path / "changed", "--encode", "half-depth") == 0
    changed = open_sequence(tmp_path / "changed")
    assert changed.format is None
    for before, frame in zip(given, changed, strict=True):
        depth = before.depth.astype(np.float16).astype(np.float32)
        assert_same(replace(before, depth=depth), frame)
    assert call("import", given.path, tmp_path / "thinned", "--every", 2) == 0
    thinned, whole = open_sequence(tmp_path / "thinned"), list(given)
    assert thinned.format is None and len(thinned.ground_truth) == len(given.ground_truth) + FRAMES // 2
    for before, frame in zip(whole[::2], thinned, strict=True):
        assert_same(before, replace(frame, motion=before.motion))


@representatives
def test_check(made, name, tmp_path):
    """No faults, where vectors and cameras are exact enough for frames so small. The axes of OpenGL are found, and the
    format that says so undoes them."""
    given, turned, back = open_sequence(made.sequence(name)), tmp_path / "turned", tmp_path / "back"
    assert call("check", given.path) == 0
    if name == "streamline":  # its vectors do not fit before the cameras are turned back
        return
    shutil.copytree(given.path, turned)
    document = json.loads((turned / "sequence.json").read_text())
    for frame in document["frames"]:
        for camera in (frame.get("render_camera"), frame.get("display_camera")):
            if camera:
                camera["world_to_view"] = (np.diag([1, -1, -1, 1]) @ camera["world_to_view"]).tolist()
    (turned / "sequence.json").write_text(json.dumps(document))
    found = tmp_path / "found.json"
    assert call("check", turned, "--format-out", found) == 1
    assert call("import", turned, back, "--format", found) == 0
    fixed = open_sequence(back)
    assert fixed.format is None
    for frame, mine in zip(given, fixed, strict=True):
        assert_same(replace(frame, geometry_size=None), mine)  # of color's size
        assert frame.camera == mine.camera
