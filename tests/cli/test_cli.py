"""The command line: what users type, what they get, and what they are told when something is wrong."""

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from scn_models import constant_model
from synthetic import Rect, Rects, camera

from gffe_cl import open_sequence
from gffe_cl.captures.sequence import FrameEntry, SequenceWriter, named_channels

W, H = 64, 40
SCENE = Rects([Rect((0, 0, 12), frequency=0.3), Rect((-1, 0, 6), (1, 1), velocity=(6, 0, 0), frequency=1)])


def view(k):
    return camera(W, H, (0.05 * k, 0, 0.1 * k), 0.01 * k)


def write_scene(path, frames=4, truth=True):
    previous = None
    with SequenceWriter(path, W, H, 30.0) as writer:
        for k in range(frames):
            frame = SCENE.frame(view(k), k / 30, W, H, previous, reset=k == 0)
            entry = FrameEntry(f"frame_{k:06d}.exr", k / 30, "rendered", k == 0, None, view(k))
            writer.add(entry, named_channels(frame.color, frame.depth, frame.motion))
            if truth:
                color = SCENE.color(view(k + 0.5), (k + 0.5) / 30, W, H).astype(np.float16)
                between = FrameEntry(
                    f"truth_{k:06d}_0500.exr", (k + 0.5) / 30, "ground_truth", display_camera=view(k + 0.5)
                )
                writer.add(between, named_channels(color))
            previous = (view(k), k / 30)
    return path


@pytest.fixture(scope="session")
def pristine(tmp_path_factory):
    return write_scene(tmp_path_factory.mktemp("scene") / "in")


@pytest.fixture
def scene(pristine, tmp_path):
    return shutil.copytree(pristine, tmp_path / "in")


# ---- what works ----------------------------------------------------------------------------------------


def test_run_and_compare(gffe, scene, tmp_path):
    out = tmp_path / "out"
    code, _, _ = gffe("run", scene, out, "--json", tmp_path / "run.json", "--compression", "rle")
    assert code == 0
    header = OpenEXR.File(str(out / "extrapolated_000002_0500.exr"), header_only=True).header()
    assert header["compression"] == OpenEXR.RLE_COMPRESSION
    assert json.loads((tmp_path / "run.json").read_text())["extrapolated"] == 4
    made = open_sequence(out)
    assert [len(made.rendered), len(made.extrapolated), len(made.ground_truth)] == [4, 4, 0]
    for entry, truth in zip(made.extrapolated, open_sequence(scene).ground_truth, strict=True):
        assert entry.time == pytest.approx(truth.time) and entry.alpha == 0.5
        assert entry.display_camera == truth.display_camera
        assert entry.source == f"frame_{round(truth.time * 30 - 0.5):06d}.exr"
    channels = made.read_channels(
        made.extrapolated[2],
        ["R", "G", "B", "Z", "motion.x", "motion.y", "mask.dynamic", "mask.disoccluded", "mask.filled_by"],
    )
    assert channels["R"].dtype == np.float16 and channels["Z"].dtype == np.float32
    assert set(np.unique(channels["mask.filled_by"])) <= {0, 1, 2, 254, 255}
    code, text, _ = gffe("compare", out, scene, "--json", tmp_path / "c.json")
    report = json.loads((tmp_path / "c.json").read_text())
    assert code == 0 and "mean" in text and report["mean"]["psnr"] > 25 and len(report["frames"]) == 4
    assert gffe("compare", out, scene, "--fail-under", "99")[0] == 1
    assert gffe("compare", out, scene, "--fail-under", "20")[0] == 0
    assert gffe("compare", out, scene, "--mask", "mask.dynamic")[0] == 0


def test_predicted_cameras_of_a_list_of_times(gffe, scene, tmp_path):
    assert gffe("run", scene, tmp_path / "out", "--camera", "predicted", "--alpha", "0.25,1.5")[0] == 0
    made = {(entry.source, entry.alpha): entry for entry in open_sequence(tmp_path / "out").extrapolated}
    assert len(made) == 8 and ("frame_000000.exr", 1.5) in made
    last = made["frame_000003.exr", 0.25]
    np.testing.assert_allclose(last.display_camera.position, (0.05 * 3.25, 0, 0.325), atol=1e-4)
    assert last.display_camera != view(3.25)


def test_nothing_of_later_frames_is_read(gffe, scene, tmp_path):
    """Changing every later pixel changes nothing in the frames extrapolated before."""
    assert gffe("run", scene, tmp_path / "a")[0] == 0
    document = json.loads((scene / "sequence.json").read_text())
    cut = write_scene(tmp_path / "short", frames=2)
    assert gffe("run", cut, tmp_path / "b")[0] == 0
    names = [f["file"] for f in document["frames"] if f["kind"] == "ground_truth"][:2]
    for name in names:
        file = name.replace("truth", "extrapolated")
        assert _pixels(tmp_path / "a" / file) == _pixels(tmp_path / "b" / file)


def _pixels(path):
    channels = OpenEXR.File(str(path), separate_channels=True).channels()
    return {name: channel.pixels.tobytes() for name, channel in channels.items()}


def test_demonstration_shows_pictures_first(gffe, tmp_path):
    """... and measures then, where there is truth; both times are printed."""
    pytest.importorskip("skimage")
    code, text, err = gffe("demo", "--size", "64x36", "--no-scn", "-o", tmp_path)
    sheet, film, head, *rows, end = text.splitlines()[1:]
    assert [sheet, film] == [str(tmp_path / name) for name in ("contact_sheet.png", "side_by_side.mp4")]
    assert Path(sheet).is_file() and Path(film).is_file() and end == f"All results are in {tmp_path}"
    assert code == 0 and "every 4th frame" in head
    assert re.search(r"^first picture after \d+ s, everything after \d+ s$", err, re.M)
    figures = json.loads((tmp_path / "metrics.json").read_text())
    assert list(figures) == ["repeat", "static", "gae"]
    assert all(f"{mean['psnr']:.2f}" in row for mean, row in zip(figures.values(), rows, strict=True))
    rendered = open_sequence(tmp_path / "rendered")
    assert [rendered.rendered_before(e.time) for e in rendered.ground_truth] == [3, 7, 11, 15]


def test_dump_stages(gffe, scene, tmp_path):
    from gffe_cl import Options, Pipeline, open_device

    assert gffe("run", scene, tmp_path / "out", "--dump-stages", "--history", "3", "--no-scn")[0] == 0
    folder = tmp_path / "out" / "stages" / "extrapolated_000003_0500"
    once = json.loads((folder / "once.json").read_text())
    pipeline = Pipeline(open_device(), 8, 8, Options(history=3, shading_inputs=True, shading_correction=False))
    assert set(pipeline.stages) >= {
        "history",
        "prediction",
        "warp",
        "background",
        "holes",
        "shading",
    }
    for stage, spec in pipeline.named_buffers():
        name = f"{stage.name}.{spec.name}"
        assert name in once or (folder / f"{name}.exr").is_file(), name
    planes = OpenEXR.File(str(folder / "history.history.exr"), separate_channels=True).channels()
    assert {"1.x", "2.known"} <= set(planes)
    dumped = _pixels(folder / "silhouettes.color.exr")
    made = _pixels(tmp_path / "out" / "extrapolated_000003_0500.exr")
    assert all(dumped[name] == made[name] for name in "RGB")


def test_presets(gffe, tmp_path):
    """A preset sets what is not given, also where a given value is the default."""
    report = tmp_path / "r.json"
    for words, dilated in (
        (("--preset", "performance"), True),
        (("--preset", "performance", "--warp", "footprints"), False),
    ):
        given = ("--size", "32x18", "--frames", 2, "--no-scn", *words)
        assert gffe("run", "plaza", tmp_path / str(dilated), *given, "--json", report)[0] == 0
        assert ("dilated_warp" in json.loads(report.read_text())["milliseconds"]) == dilated
    assert "--preset must be one of quality, balanced" in gffe("run", "plaza", tmp_path / "x", "--preset", "best")[2]


def test_shading_correction(gffe, tmp_path):
    """Off without weights; with a model the color changes and nothing else, within the focus mask or everywhere."""
    scene = tmp_path / "in"
    assert gffe("render", "fan", scene, "--size", "128x80", "--frames", 4, "--ground-truth")[0] == 0
    model = constant_model(tmp_path / "m.onnx", delta=0.05, mask=0.5)
    runs = {
        "none": ("--no-scn",),
        "some": ("--scn-model", model, "--no-image-flow", "--dump-stages"),
        "all": ("--scn", "--scn-model", model, "--no-image-flow", "--no-focus-mask", "--scn-provider", "cpu"),
    }
    images = {}
    for name, options in runs.items():
        assert gffe("run", scene, tmp_path / name, *options, "--json", tmp_path / "r.json")[0] == 0
        made = open_sequence(tmp_path / name)
        images[name] = [made.read_channels(e, ["G", "Z", "motion.x"]) for e in made.extrapolated]
        report = json.loads((tmp_path / "r.json").read_text())["milliseconds"]
        assert ("network" in report) == ("correction" in report) == (name != "none")
    for none, some, whole in list(zip(*images.values(), strict=True))[1:]:
        assert (none["G"] < some["G"]).mean() > 0.6 and (some["G"] < whole["G"]).mean() > 0.9
        for same in ("Z", "motion.x"):
            assert np.array_equal(none[same], some[same]) and np.array_equal(none[same], whole[same])
    assert np.array_equal(images["none"][0]["G"], images["all"][0]["G"])  # nothing before it
    dumped = {path.name for path in (tmp_path / "some" / "stages" / "extrapolated_000002_0500").iterdir()}
    names = ("judgement", "correction", "refined", "focus_mask", "color")
    assert dumped >= {"warp.color.exr", "network_input.frames.exr", *(f"correction.{name}.exr" for name in names)}

    broken = constant_model(tmp_path / "nan.onnx", judgement=[float("nan")])
    words = ("--scn-model", broken, "--no-image-flow", "--json", tmp_path / "r.json")
    code, _, err = gffe("run", scene, tmp_path / "nan", *words)
    assert code == 0 and err.count("nan.onnx: the network gave NaN or infinity for about") == 1
    assert err.splitlines()[0] == "warning: " + " ".join(json.loads((tmp_path / "r.json").read_text())["warnings"])
    made = open_sequence(tmp_path / "nan")
    for before, entry in zip(images["none"], made.extrapolated, strict=True):
        assert np.array_equal(before["G"], made.read_channels(entry, ["G"])["G"])


@pytest.mark.parametrize("window", ["adaptive", "fixed:1.2"])
def test_windows(gffe, tmp_path, window):
    """Rendered through a window, extrapolated, compared; live the same frames come out as from disk."""
    options = ("--size", "64x36", "--frames", 4, "--window", window)
    assert gffe("render", "forest", tmp_path / "in", *options, "--ground-truth")[0] == 0
    recorded = open_sequence(tmp_path / "in")
    windowed = [entry.display_camera != entry.render_camera for entry in recorded.rendered]
    assert windowed == {"fixed:1.2": [True] * 4, "adaptive": [False] + [True] * 3}[window]
    assert gffe("run", tmp_path / "in", tmp_path / "out")[0] == 0
    assert gffe("run", "forest", tmp_path / "live", *options)[0] == 0
    for name in ("extrapolated_000003_0500.exr", "frame_000003.exr"):
        assert _pixels(tmp_path / "live" / name) == _pixels(tmp_path / "out" / name)
    assert gffe("compare", tmp_path / "live", tmp_path / "in")[0] == 0


def test_display_part_of_a_recorded_window(gffe, tmp_path):
    """`--window off` uses what was shown: the output has no windows, and its rendered frames are the display part."""
    options = ("--size", "64x36", "--frames", 4, "--ground-truth")
    assert gffe("render", "plaza", tmp_path / "wide", *options, "--window", "fixed:1.3")[0] == 0
    assert gffe("run", tmp_path / "wide", tmp_path / "cut", "--window", "off")[0] == 0
    wide, cut = open_sequence(tmp_path / "wide"), open_sequence(tmp_path / "cut")
    assert all(entry.display_camera == entry.render_camera for entry in cut.rendered)
    assert [e.render_camera for e in cut.rendered] == [e.display_camera for e in wide.rendered]
    from gffe_cl import present

    shown = present(wide.read(wide.rendered[2]), wide.read(wide.rendered[1]))
    assert cut.read(cut.rendered[2]).color.tobytes() == shown.color.tobytes()
    assert cut.read(cut.rendered[2]).motion.tobytes() == shown.motion.tobytes()


def test_display_motion(gffe, tmp_path):
    """`motion.display.*` points into the source frame as displayed, whatever it was rendered through."""
    options = ("--size", "64x36", "--frames", 4, "--window", "adaptive")
    assert gffe("run", "forest", tmp_path / "out", *options)[0] == 0
    made = open_sequence(tmp_path / "out")
    entry, source = made.extrapolated[3], made.rendered[3]
    names = ["motion.x", "motion.y", "motion.display.x", "motion.display.y", "mask.dynamic", "mask.filled_by", "Z"]
    channels = made.read_channels(entry, names)
    static = (channels["mask.dynamic"] == 0) & (channels["mask.filled_by"] == 0) & np.isfinite(channels["Z"])
    y, x = np.nonzero(static)
    px = np.stack([x + 0.5, y + 0.5], -1)
    world = entry.display_camera.unproject(px, channels["Z"][static])
    for prefix, seen_by in (("motion.", source.render_camera), ("motion.display.", source.display_camera)):
        motion = np.stack([channels[f"{prefix}{axis}"][static] for axis in "xy"], -1)
        off = np.abs(px + motion - seen_by.project(world)[0]).max(-1)
        assert np.quantile(off, 0.95) < 0.05


def test_baseline_of_a_windowed_sequence_is_its_display_part(gffe, tmp_path):
    from gffe_cl.lab.compare import baseline_repeat, shown_color
    from gffe_cl.lab.metrics import psnr, to_display

    options = ("--size", "96x54", "--frames", 4, "--ground-truth", "--window", "fixed:1.3")
    assert gffe("render", "room", tmp_path / "in", *options)[0] == 0
    wide = open_sequence(tmp_path / "in")
    truth = to_display(wide.read_color(wide.ground_truth[3]), wide.exposure)
    whole = psnr(to_display(wide.read_color(wide.rendered[3]), wide.exposure), truth)
    shown = psnr(to_display(shown_color(wide, wide.rendered[3]), wide.exposure), truth)
    assert shown > whole + 5
    assert baseline_repeat(wide).frames[3].values["psnr"] == pytest.approx(shown)


def test_render_and_devices(gffe, tmp_path):
    out = tmp_path / "scene"
    words = ("--size", "33x21", "--frames", 2, "--ground-truth", "--seed", 4)
    assert gffe("render", "corridor", out, *words)[:2] == (0, f"4 frames in {out}\n")
    made = open_sequence(out)
    assert (made.width, made.height) == (33, 21)
    assert [len(made.rendered), len(made.ground_truth)] == [2, 2]
    code, text, _ = gffe("devices", "--json", tmp_path / "d.json")
    assert code == 0 and "yes" in text
    assert any(d["works"] and d["default"] for d in json.loads((tmp_path / "d.json").read_text())["devices"])


def test_a_run_says_that_most_frames_look_like_cuts(gffe, scene, tmp_path):
    for k in (2, 3):
        _spoil(scene / f"frame_{k:06d}.exr", "Z", lambda a, k=k: a.__setitem__(slice(None), 2.0 + 3 * k))
    code, text, err = gffe("run", scene, tmp_path / "out", "--no-scn")
    said = "rendered frames look like cuts: do the motion vectors fit?"
    assert code == 0 and text.count("cut at ") == 2 and f"2 of 4 {said}" in " ".join(err.split()), text + err


def test_bad_pixels_are_counted_once_and_strict_makes_them_errors(gffe, scene, tmp_path):
    _spoil(scene / "frame_000002.exr", "motion.x", lambda a: a.__setitem__((3, 4), np.nan))
    _spoil(scene / "frame_000003.exr", "Z", lambda a: a.__setitem__((5, 5), -1))
    _spoil(scene / "frame_000003.exr", "G", lambda a: a.__setitem__((5, 6), np.nan))
    code, _, err = gffe("run", scene, tmp_path / "out")
    assert code == 0
    warnings = [line for line in err.splitlines() if line.startswith("warning:")]
    assert len(warnings) == 1
    for text in ("1 × NaN or infinite motion", "1 × invalid depth", "1 × NaN or infinite color"):
        assert text in warnings[0]
    code, _, err = gffe("run", scene, tmp_path / "strict", "--strict")
    assert code == 2 and "frame_000002.exr: 1 × NaN or infinite motion" in err
    assert not (tmp_path / "strict").exists()


def _spoil(path, channel, change):
    file = OpenEXR.File(str(path), separate_channels=True)
    header = {k: v for k, v in file.header().items() if k != "channels"}
    channels = {name: np.ascontiguousarray(c.pixels).copy() for name, c in file.channels().items()}
    change(channels[channel])
    OpenEXR.File(header, channels).write(str(path))


# ---- what is wrong -------------------------------------------------------------------------------------


WRONG = {
    "run": (
        ("--alpha 0.5 -n 2", "exclude each other"), ("-n 8", "1 to 7"), ("--alpha half", "numbers"),
        ("--alpha 0.5,0.50", "alpha 0.5 is given twice"), ("--seed 3", "for built-in"),
        ("--device abacus", "no working device matches"), ("--history 9", "history"),
        ("--history 2 --order 2", "order"), ("--static-threshold -1", "threshold"), ("--camera mine", "--camera"),
        ("--camera-order 1.5", "1 to 2, or auto"), ("--frobnicate", "--frobnicate"),
        ("--compression jpeg", "compression must be one of none, rle, zips, zip"),
        ("--no-scn --scn-model {model}", "--no-scn and --scn-model exclude each other"),
        ("--no-scn --no-focus-mask", "--no-scn and --no-focus-mask exclude each other"),
        ("--scn-model none.onnx", "none.onnx: no such file"), ("--scn-model {input}/sequence.json", "cannot be loaded"),
        ("--scn-model {model} --scn-provider abacus", "provider 'abacus' is not available"),
        ("--window fixed:1.1", "only built-in scenes are rendered through a chosen window"),
    ),
    "render room": (("--seed -1", "seed"), ("--seed 4294967296", "seed must be a whole number from 0 to 4294967295")),
    "render plaza": (("--window wide", "window must be adaptive, fixed:FACTOR (fixed:1.2) or off"),),
}  # fmt: skip


@pytest.mark.parametrize(("command", "given", "expected"), [(c, *row) for c, rows in WRONG.items() for row in rows])
def test_wrong_options(gffe, pristine, tmp_path, command, given, expected):
    places = {"model": constant_model(tmp_path / "m.onnx"), "input": pristine}
    words = command.split() + ([str(pristine)] if command == "run" else [])
    code, _, err = gffe(*words, tmp_path / "out", *given.format(**places).split())
    assert code == 2 and expected in err and len(err.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_impossible_outputs(gffe, pristine, tmp_path):
    (tmp_path / "file").write_text("x")
    for output in (tmp_path / "file", tmp_path / "file" / "below", "/proc/nowhere", pristine):
        code, _, err = gffe("run", pristine, output)
        assert code == 2 and len(err.strip().splitlines()) == 1 and err.startswith("error:"), (output, err)
    assert (pristine / "sequence.json").is_file() and (tmp_path / "file").read_text() == "x"
    assert gffe("render", "nowhere", tmp_path / "s")[0] == 2
    assert gffe("render", "corridor", tmp_path / "s", "--size", "big")[0] == 2
    assert gffe("render", "corridor", tmp_path / "s", "--frames", 0)[0] == 2
    assert not (tmp_path / "s").exists()


def test_no_device_says_why(tmp_path, pristine):
    (tmp_path / "vendors").mkdir()
    environment = os.environ | {"OCL_ICD_VENDORS": str(tmp_path / "vendors"), "OCL_ICD_FILENAMES": ""}
    for args in (
        ["run", str(pristine), str(tmp_path / "out")],
        ["devices"],
    ):
        child = subprocess.run(
            [sys.executable, "-m", "gffe_cl", *args], env=environment, capture_output=True, text=True
        )
        assert child.returncode == 2 and "OCL_ICD_VENDORS is" in child.stderr, child.stderr
        assert len(child.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_interrupt_keeps_what_is_finished(tmp_path):
    source = write_scene(tmp_path / "in", frames=80, truth=False)
    out = tmp_path / "out"
    child = subprocess.Popen(
        [sys.executable, "-m", "gffe_cl", "run", str(source), str(out), "-n", "7"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 60
    part = tmp_path / "out.part"
    while len(list(part.rglob("extrapolated_*.exr"))) < 10 and time.monotonic() < deadline:
        time.sleep(0.02)
    child.send_signal(signal.SIGINT)
    _, err = child.communicate(timeout=60)
    made = open_sequence(part)
    assert child.returncode == 130 and err == f"interrupted: {len(made.frames)} finished frames are in {part}\n"
    assert 10 <= len(made.extrapolated) < 560
    assert {p.name for p in part.glob("*.exr")} == {e.file for e in made.frames} and not out.exists()


def test_nothing_heavy_before_the_handlers():
    heavy = ("numpy", "pyopencl", "typer", "rich", "ctypes", "json", "gffe_cl.engine.opencl")
    for module in ("gffe_cl.cli", "gffe_cl"):
        code = f"import sys, {module}; print([name for name in {heavy} if name in sys.modules])"
        child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        assert child.stdout == "[]\n"


ENDLESS = {
    "run": ("corridor", "out", "--frames", "9999"),
    "render": ("corridor", "out", "--frames", "9999"),
    "demo": ("-o", "out"),
    "eval": ("corridor", "--out", "out"),
    "bench": ("--repeats", "9999"),
    "export": ("out",),
    "selftest": (),
    "train": ("out",),
    "devices": ("--refresh",),
}


@pytest.mark.long
@pytest.mark.parametrize("command", ENDLESS)
def test_one_signal_ends_every_command(tmp_path, command):
    """Within five seconds, whatever it does. Where the interrupt comes through `exec`, Python ends itself by SIGINT,
    which shells call 130, too."""
    words = [sys.executable, "-m", "gffe_cl", command, *ENDLESS[command]]
    child = subprocess.Popen(words, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    with pytest.raises(subprocess.TimeoutExpired):
        child.wait(timeout=1 if command in ("devices", "export") else 4)
    child.send_signal(signal.SIGTERM)
    try:
        assert "interrupted" in child.communicate(timeout=5)[1] and child.returncode in (130, -signal.SIGINT)
    finally:
        child.kill()


@pytest.mark.parametrize(("working", "signals", "seconds"), [(False, 1, 1), (True, 2, 1), (True, 1, 5)])
def test_a_library_that_never_returns_is_interrupted(working, signals, seconds):
    """At once by the second signal, or by the first before the work; else after a grace. Python itself would not
    notice any."""
    program = (
        "import hashlib\n"
        "from gffe_cl.cli.interrupts import Interrupts\n"
        "with Interrupts() as interrupts:\n"
        f"    {working} and interrupts.begin()\n"
        "    print('working', flush=True)\n"
        "    hashlib.pbkdf2_hmac('sha256', b'', b'', (1 << 31) - 1)\n"
    )
    child = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert child.stdout.readline() == "working\n"
    time.sleep(0.5)  # until the call has begun
    for _ in range(signals):
        child.send_signal(signal.SIGTERM)
        time.sleep(0.2)
    try:
        assert child.communicate(timeout=seconds)[1] == "interrupted\n"
    finally:
        child.kill()
    assert child.returncode == 130


def test_outputs_do_not_land_on_sequences(gffe, scene, tmp_path):
    """Not on its files, whatever they are called, and nowhere that nothing can be written."""
    shutil.copy(scene / "frame_000001.exr", scene / "picture.png")
    before = {path: path.read_bytes() for path in scene.iterdir()}
    targets = [scene / "sequence.json", scene / "frame_000001.exr", scene / "new.exr", scene / "picture.png", scene]
    (tmp_path / "alias.json").symlink_to(scene / "frame_000002.exr")
    for target in (*targets, tmp_path / "alias.json", tmp_path / "nowhere" / "r.json"):
        commands = {
            "--json": ("run", scene, tmp_path / "out"),
            "--screenshot": ("view", scene),
        }
        for option, command in commands.items():
            code, _, err = gffe(*command, option, target)
            assert code == 2 and f"{option} {target}" in err and len(err.splitlines()) == 1, err
    assert {path: path.read_bytes() for path in scene.iterdir()} == before and not (tmp_path / "out").exists()


def test_names_do_not_reach_the_terminal_raw(gffe, scene, tmp_path):
    name = "\x1b[31mred[bold]\n.exr"
    (scene / "truth_000002_0500.exr").rename(scene / name)
    for frame in (document := json.loads((scene / "sequence.json").read_text()))["frames"]:
        if frame["file"] == "truth_000002_0500.exr":
            frame["file"], frame["kind"], frame["alpha"] = name, "extrapolated", 0.5
    (scene / "sequence.json").write_text(json.dumps(document))
    made = tmp_path / "\x1b[2Jout\n"
    outputs = [gffe("compare", scene, scene), gffe("compare", scene, tmp_path / name), gffe("run", scene, made)]
    assert [code for code, _, _ in outputs] == [2, 2, 0]
    _, text, err = gffe("compare", made, scene)
    for shown in (text, err, *(part for output in outputs for part in output[1:])):
        assert "\x1b" not in shown and all(line.isprintable() for line in shown.splitlines())
    assert r"\x1b[2Jout\n" in outputs[2][1]


def test_output_that_nobody_reads():
    """A closed pipe ends the command quietly, a full disk is one line."""
    for target, code, said in (("| head -1", 141, ""), (">/dev/full", 2, "error: system: No space left on device\n")):
        command = f"{shlex.quote(sys.executable)} -m gffe_cl run --help {target}"
        child = subprocess.run(["bash", "-o", "pipefail", "-c", command], capture_output=True, text=True)
        assert (child.returncode, child.stderr) == (code, said)


def test_shells_complete_commands(tmp_path):
    (tmp_path / ".bashrc").write_text("")
    home = os.environ | {"HOME": str(tmp_path), "SHELL": "/bin/bash"}
    gffe = [sys.executable, "-m", "gffe_cl"]
    installing = ["bash", "-c", f"{shlex.join(gffe)} --install-completion; exit $?"]
    assert subprocess.run(installing, env=home, capture_output=True).returncode == 0
    assert "gffe.sh" in (tmp_path / ".bashrc").read_text()
    asked = home | {"_GFFE_COMPLETE": "complete_bash", "COMP_WORDS": "gffe ren", "COMP_CWORD": "1"}
    assert subprocess.run(gffe, env=asked, capture_output=True, text=True).stdout == "render\n"


def test_an_unfinished_sequence_says_so(gffe, scene, tmp_path):
    with pytest.raises(KeyboardInterrupt), SequenceWriter(tmp_path / "cut", W, H, 30.0) as writer:
        for entry in open_sequence(scene).rendered:
            writer.link(entry, scene / entry.file)
        raise KeyboardInterrupt
    code, _, err = gffe("run", tmp_path / "cut.part", tmp_path / "out")
    assert code == 0 and "unfinished: its writer was interrupted after 4 frames" in err
    document = json.loads((tmp_path / "out" / "sequence.json").read_text())
    (tmp_path / "out" / "sequence.json").write_text(json.dumps(document | {"unfinished": True}))
    code, _, err = gffe("compare", tmp_path / "out", scene)
    assert code == 0 and f"{tmp_path / 'out'}: unfinished" in err


def test_errors_of_commands_with_several_sequences_name_the_folder(gffe, scene, tmp_path):
    bad = tmp_path / "bad"
    shutil.copytree(scene, bad)
    (bad / "sequence.json").write_text("{")
    for command in (("compare", scene, bad), ("compare", bad, scene), ("eval", bad, bad, "--out", tmp_path / "report")):
        code, _, err = gffe(*command)
        assert code == 2
        assert err.startswith(f"error: {bad}: sequence.json: not valid JSON")


def test_failed_run_leaves_other_files_alone(gffe, scene, tmp_path):
    """A `stages` folder of the user's, and sequences that are no output of `gffe run`, survive."""
    out = tmp_path / "out"
    (out / "stages").mkdir(parents=True)
    (out / "stages" / "notes.txt").write_text("mine")
    _spoil(scene / "frame_000002.exr", "Z", lambda a: a.__setitem__((3, 4), np.nan))
    for extra in ([], ["--dump-stages"]):
        assert gffe("run", scene, out, "--strict", *extra)[0] == 2
        assert [p.name for p in (out / "stages").iterdir()] == ["notes.txt"]
    assert gffe("run", scene, tmp_path / "made")[0] == 0
    code, _, err = gffe("run", tmp_path / "made", scene)  # arguments swapped
    assert code == 2 and "so it stays" in err
    assert len(open_sequence(scene).ground_truth) == 4


def test_names_are_unique(gffe, scene, tmp_path):
    assert gffe("run", scene, tmp_path / "out", "--alpha", "0.5,0.3333,0.33331")[0] == 0
    assert len(open_sequence(tmp_path / "out").extrapolated) == 12
    document = json.loads((scene / "sequence.json").read_text())
    for index, frame in enumerate(document["frames"]):
        if frame["kind"] == "rendered":
            (scene / frame["file"]).rename(scene / f"shot{index}_0001.exr")
            frame["file"] = f"shot{index}_0001.exr"
    (scene / "sequence.json").write_text(json.dumps(document))
    assert gffe("run", scene, tmp_path / "shots")[0] == 0


def test_unwritable_home(tmp_path):
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("XDG_", "POCL_", "PYOPENCL_"))}
    child = subprocess.run(
        [sys.executable, "-m", "gffe_cl", "devices"],
        env=environment | {"HOME": "/proc"},
        capture_output=True,
        text=True,
    )
    assert child.returncode == 0 and "no:" not in child.stdout, child.stdout + child.stderr
