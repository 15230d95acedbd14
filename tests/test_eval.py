"""The table of `gffe eval`: regions, baselines, networks, flicker, cells that are kept."""

import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from gffe_cl.camera import Camera
from gffe_cl.errors import GffeError
from gffe_cl.evaluation.table import baselines, cache, engine, image_space, results, videos
from gffe_cl.evaluation.table.cells import Cell
from gffe_cl.evaluation.table.engine import Order, fill
from gffe_cl.evaluation.table.flicker import Flicker
from gffe_cl.evaluation.table.methods import GAINS, METHODS, chosen_methods
from gffe_cl.evaluation.table.network import OnnxModel, OnnxRunner
from gffe_cl.evaluation.table.page import page
from gffe_cl.evaluation.table.regions import REGIONS, exact_parts, labels_of, masks
from gffe_cl.evaluation.table.subjects import Guide, Moment, SceneSubject, Shot, parse_subject, turned
from gffe_cl.frame import RenderedFrame
from gffe_cl.metrics import RegionErrors, display_values, linear_values

W, H = 48, 32
CAMERA = Camera(np.eye(4), 40, 40, W / 2, H / 2)
CENTRES = image_space.pixel_centres(H, W)


def texture(place):
    """Smooth, linear (…, 3), anywhere."""
    x, y = place[..., 0], place[..., 1]
    waves = np.stack([np.sin(x / 3), np.cos(y / 4), np.sin((x + y) / 5)], -1)
    return (0.5 + 0.25 * waves).astype(np.float32)


def shot(k, velocity, acceleration=0.0, following=None):
    """The texture moves along x by `velocity` pixels per interval, and `acceleration`; it is at its place for k = 0."""

    def at(time):
        return velocity * time + acceleration * time * time / 2

    color = texture(CENTRES - np.float32((at(k), 0)))
    motion = np.broadcast_to(np.float32((at(k - 1) - at(k), 0)), (H, W, 2))
    frame = RenderedFrame(color, np.full((H, W), 5, np.float32), motion, CAMERA, k / 30, reset=k == 0)
    return Shot(frame, color, (), following)


def inner_error(made, k, velocity, acceleration=0.0):
    moved = velocity * k + acceleration * k * k / 2
    truth = texture(CENTRES - np.float32((moved, 0)))
    return np.abs(made - truth)[6:-6, 12:-12].max()


def moment(alpha, **more):
    return Moment(alpha, alpha, CAMERA, np.zeros((H, W, 3), np.float32), **more)


# ---- baselines -----------------------------------------------------------------------------------------------


def test_motion_vectors_go_on_in_image_space():
    """Constant speed by order 1, constant acceleration by order 2 only."""
    for acceleration, order, most in ((0.0, 1, 0.01), (0.0, 2, 0.01), (1.5, 2, 0.01)):
        runner = baselines.MotionVectors(order)
        for k in range(3):
            runner.submit(shot(k, 2.0, acceleration))
        assert inner_error(runner.make(moment(0.5)), 2.5, 2.0, acceleration) < most, (acceleration, order)
    linear = baselines.MotionVectors(1)
    for k in range(3):
        linear.submit(shot(k, 2.0, 1.5))
    assert inner_error(linear.make(moment(0.5)), 2.5, 2.0, 1.5) > 0.02


def test_optical_flow_finds_the_motion():
    pytest.importorskip("cv2")
    runner = baselines.OpticalFlow(1.0)
    for k in range(2):
        runner.submit(shot(k, 2.0))
    assert inner_error(runner.make(moment(0.5)), 1.5, 2.0) < 0.06
    assert inner_error(shot(1, 2.0).shown, 1.5, 2.0) > 0.08  # what repeating gives


def test_interpolation_looks_ahead():
    runner = baselines.Interpolation()
    with pytest.raises(GffeError, match="after this one is missing"):
        runner.submit(shot(1, 2.0))
        runner.make(moment(0.5))
    runner.submit(shot(2, 2.0, 1.5, following=shot(3, 2.0, 1.5).frame))
    assert inner_error(runner.make(moment(0.25)), 2.25, 2.0, 1.5) < 0.06  # speed within the interval is constant there
    runner.submit(shot(2, 2.0, following=shot(3, 2.0).frame))
    assert inner_error(runner.make(moment(0.25)), 2.25, 2.0) < 0.01


def test_guided_extrapolation_uses_its_guide():
    """True motion of the new frame; where its surface was hidden, pixels of like depth around."""
    source = shot(0, 2.0)
    depth = np.full((H, W), 5, np.float32)
    motion = np.broadcast_to(np.float32((-1, 0)), (H, W, 2))
    hidden = np.zeros((H, W), bool)
    hidden[14:18, 20:24] = True
    guide = Guide(depth, motion, np.where(hidden, 9, depth).astype(np.float32), np.zeros((H, W), bool))
    runner = baselines.GuidedExtrapolation()
    runner.submit(source)
    made = runner.make(moment(0.5, guide=guide))
    truth = texture(CENTRES - np.float32((1, 0)))
    error = np.abs(made - truth).max(-1)[2:-2, 4:-4]
    assert error[~hidden[2:-2, 4:-4]].max() < 0.01 and error.max() < 0.25
    assert not np.isnan(made).any()


def test_splat_keeps_the_nearest():
    place = CENTRES.copy()
    place[10, 10] = place[10, 20]
    depth = np.full((H, W), 4.0, np.float32)
    depth[10, 10] = 2.0
    values = np.arange(H * W, dtype=np.float32).reshape(H, W, 1)
    got, known = image_space.splat(place, depth, values)
    assert got[10, 20, 0] == values[10, 10, 0] and not known[10, 10] and known.sum() == H * W - 1
    filled = image_space.filled(got, known)
    assert filled[10, 10, 0] in (got[9, 10, 0], got[11, 10, 0], got[10, 9, 0], got[10, 11, 0])


# ---- networks ------------------------------------------------------------------------------------------------


def network(path, frames=2, following=True, timestep=True, name="frame"):
    """(1 − α) · newest of `previous` + α · `next`; without those, the oldest of `previous`."""
    shape = (1, 3 * frames, "h", "w")
    inputs = [helper.make_tensor_value_info("previous", TensorProto.FLOAT, shape)]
    start, end = (3 * frames - 3, 3 * frames) if following else (0, 3)
    nodes = [helper.make_node("Slice", ["previous", "start", "end", "axis"], ["taken"])]
    last = "taken"
    if following:
        inputs.append(helper.make_tensor_value_info("next", TensorProto.FLOAT, (1, 3, "h", "w")))
        inputs.append(helper.make_tensor_value_info("timestep", TensorProto.FLOAT, (1, 1, 1, 1)))
        nodes += [
            helper.make_node("Sub", ["next", "taken"], ["change"]),
            helper.make_node("Mul", ["change", "timestep"], ["part"]),
            helper.make_node("Add", ["taken", "part"], ["mixed"]),
        ]
        last = "mixed"
    nodes.append(helper.make_node("Identity", [last], [name]))
    constants = [
        helper.make_tensor(n, TensorProto.INT64, [1], [v]) for n, v in (("start", start), ("end", end), ("axis", 1))
    ]
    outputs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, (1, 3, "h", "w"))]
    graph = helper.make_graph(nodes, "small", inputs, outputs, constants)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9), path)
    return path


def test_networks_get_what_the_contract_says(tmp_path):
    """Sizes that are no multiples of 32, display values, the order of frames, the time."""
    size = (37, 21)
    rng = np.random.default_rng(3)
    images = [rng.uniform(0, 1, (size[1], size[0], 3)).astype(np.float32) for _ in range(4)]

    def of(k):
        frame = RenderedFrame(images[k], None, None, CAMERA, k / 30, reset=k == 0)
        return frame

    runner = OnnxRunner(OnnxModel(network(tmp_path / "mix.onnx")), exposure=0.7)
    runner.submit(Shot(of(0), images[0], ()))
    runner.submit(Shot(of(1), images[1], (), of(2)))
    made = display_values(runner.make(moment(0.25)), 0.7)
    shown = [display_values(image, 0.7) for image in images]
    np.testing.assert_allclose(made, 0.75 * shown[1] + 0.25 * shown[2], atol=2e-6)

    oldest = OnnxRunner(OnnxModel(network(tmp_path / "old.onnx", following=False)), exposure=0.7)
    for k, expected in ((0, 0), (1, 0), (2, 1)):  # of two: after a reset the first stands for what is before it
        oldest.submit(Shot(of(k), images[k], ()))
        np.testing.assert_allclose(display_values(oldest.make(moment(0.5)), 0.7), shown[expected], atol=2e-6)


def test_networks_of_another_contract_are_refused(tmp_path):
    with pytest.raises(GffeError, match="no such file"):
        OnnxModel(tmp_path / "none.onnx")
    (tmp_path / "text.onnx").write_text("no model")
    with pytest.raises(GffeError, match="cannot be loaded"):
        OnnxModel(tmp_path / "text.onnx")
    with pytest.raises(GffeError, match=r"outputs result \(expected inputs previous"):
        OnnxModel(network(tmp_path / "other.onnx", name="result"))
    for text, words in (("small", "expected NAME=FILE"), ("gffe=x.onnx", "a method's own")):
        with pytest.raises(GffeError, match=words):
            chosen_methods([], [text])


def test_linear_values_undo_display_values():
    shown = np.linspace(0, 1, 300, dtype=np.float32).reshape(10, 10, 3)
    np.testing.assert_allclose(display_values(linear_values(shown, 2.5), 2.5), shown, atol=1e-6)


# ---- regions, flicker, budget ----------------------------------------------------------------------------------


def test_regions_by_hand():
    """A near square that moves 4 px to the right over a wall, and a view that moves 3 px to the left."""
    far, near = 10.0, 4.0
    before, after = np.full((H, W), far, np.float32), np.full((H, W), far, np.float32)
    before[10:20, 10:20], after[10:20, 17:27] = near, near
    motion = np.broadcast_to(np.float32((-3, 0)), (H, W, 2)).copy()  # what is seen at x was at x − 3
    square = after == near
    motion[square] = (-7, 0)
    moving = before == near
    frame = RenderedFrame(np.zeros((H, W, 3)), before, None, CAMERA, 0.0)
    guide = Guide(after, motion, after, square)
    parts = exact_parts(Shot(frame, frame.color, (), None, moving), guide)
    expected = np.zeros((H, W), bool)
    expected[10:20, 13:17] = True  # was behind the square, which was at 10 … 20 and stands for 13 … 23 now
    assert np.array_equal(parts["dynamic disocclusion"], expected)
    assert not parts["static disocclusion"].any()
    assert (
        np.array_equal(np.flatnonzero(parts["out of screen"].all(0)), [0, 1, 2])
        and parts["out of screen"].sum() == 3 * H
    )
    assert np.array_equal(parts["dynamic"], square)
    labels = labels_of(parts)
    found = masks(labels)
    assert sum(found[name].sum() for name in REGIONS) == H * W == found["whole"].sum()
    assert found["silhouettes"][10, 26] and found["silhouettes"][12, 27] and not found["silhouettes"][14, 22]
    assert found["dynamic disocclusion"].sum() == 40  # before silhouettes
    static = exact_parts(Shot(frame, frame.color, (), None, np.zeros_like(moving)), guide)
    assert np.array_equal(static["static disocclusion"], expected)


def test_flicker_is_what_alternates():
    """A constant error does not flicker, one that comes and goes does; fine patterns less than flat ones."""
    truth = np.full((300, 40, 3), 0.5, np.float32)
    y, x = np.mgrid[:300, :40]
    fine = np.where((x + y) % 2, 0.1, -0.1).astype(np.float32)[..., None]

    def of(errors):
        flicker = Flicker()
        for error in errors:
            flicker.add(truth + error, truth)
        return flicker.mean

    assert of([0.1] * 4) == pytest.approx(0, abs=1e-4)
    assert of([0, 0.1, 0, 0.1]) == pytest.approx(10, abs=1e-3)
    assert 0 < of([0, fine, 0, fine]) < 2
    assert math.isnan(of([0]))
    blue = np.float32((0, 0, 0.1))
    assert of([0, blue]) == pytest.approx(0.722, abs=1e-3)
    cut = Flicker()
    assert cut.add(truth, truth) is None
    cut.cut()
    assert cut.add(truth + 0.1, truth) is None and cut.count == 0


def test_budget_of_a_known_error():
    labels = np.zeros((4, 10), np.uint8)
    labels[:] = len(REGIONS) - 1
    labels[0] = 0
    truth = np.zeros((4, 10, 3), np.float32)
    shown = truth.copy()
    shown[0], shown[1] = 0.3, 0.1
    errors = RegionErrors()
    from gffe_cl.metrics import METRICS

    errors.add(shown, truth, masks(labels), [METRICS["psnr"]])
    rows = {row["region"]: row for row in results.budget(errors)}
    assert rows["out of screen"]["error"] == pytest.approx(0.9, abs=1e-5)
    assert rows["out of screen"]["gain"] == pytest.approx(10, abs=1e-3) and rows["out of screen"]["pixels"] == 0.25
    assert rows["rest"]["gain"] == pytest.approx(-10 * math.log10(0.9), abs=1e-4)
    assert next(iter(results.budget(errors)))["region"] == "out of screen"


def test_cameras_turn_to_the_right():
    camera = turned(CAMERA, 10)
    px, _ = camera.project((0, 0, 5))
    assert px[0] == pytest.approx(W / 2 - 40 * math.tan(math.radians(10))) and px[1] == pytest.approx(H / 2)
    assert turned(CAMERA, 0) is CAMERA


def test_metrics_that_cannot_run_say_why(monkeypatch):
    monkeypatch.setitem(sys.modules, "pycvvdp", None)
    images = [np.zeros((8, 8, 3), np.float32)] * 2
    value, reason = videos.measured_or_reason(videos.VIDEO_METRICS["cvvdp"], images, images, 60)
    assert value is None and "ColorVideoVDP needs pycvvdp: pip install" in reason

    def fails(shown, truth, fps):
        raise OSError("no route\nto the weights")

    broken = replace(videos.VIDEO_METRICS["lpips"], measure=fails)
    assert videos.measured_or_reason(broken, images, images, 60)[1] == "LPIPS cannot run here: no route to the weights"


# ---- subjects, methods, cache ------------------------------------------------------------------------------------


def test_subjects(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    subject = parse_subject("room:7", (64, 36), 6, 30.0, (0.5, 0.75))
    assert (subject.name, subject.moments) == ("room:7", 8) and subject == replace(subject)
    assert parse_subject("room", (64, 36), 6, 30.0, (0.5,)).name == "room:0"
    for text, words in (("rom", "neither a built-in scene"), ("room:x", "seed must be")):
        with pytest.raises(GffeError, match=words):
            parse_subject(text, (64, 36), 6, 30.0, (0.5,))


def test_methods_are_chosen_by_name_and_group():
    assert list(chosen_methods(["repeat", "gffe"])) == ["gffe", "repeat"]
    assert {m.group for m in chosen_methods(["deviation"]).values()} == {"deviation"}
    assert METHODS["order-5"].options.order == 5 and METHODS["levels-3"].options.levels == 3
    assert {gain.with_it for gain in GAINS} | {gain.without for gain in GAINS} <= set(METHODS)
    assert {gain.region for gain in GAINS} <= set(REGIONS)
    assert {gain.paper for gain in GAINS} - {""} <= set(results.PAPER)
    with pytest.raises(GffeError, match="'gfe' is none of gffe, ablation"):
        chosen_methods(["gfe"])


def test_keys_hang_on_everything(monkeypatch, tmp_path):
    subject = SceneSubject("room", 0, 64, 36, 6, 30.0, (0.5,))
    method = METHODS["gffe"]
    keys = {cache.key_of(subject.identity(), method.identity())}
    for other in (replace(subject, seed=1), replace(subject, alphas=(0.25,)), replace(subject, turns=(1.0,))):
        keys.add(cache.key_of(other.identity(), method.identity()))
    keys |= {cache.key_of(subject.identity(), m.identity()) for m in METHODS.values()}
    assert len(keys) == 3 + len(METHODS)
    monkeypatch.setattr(cache, "kernels", lambda: "other kernels")
    assert cache.key_of(subject.identity(), method.identity()) not in keys
    same = "def f():\n    '''One.'''\n    return 1  # here\n"
    assert cache._code(same) == cache._code("def f():\n    '''Two.'''\n\n    return 1\n")
    assert cache._code(same) != cache._code(same.replace("1", "2", 1).replace("return 1", "return 3"))
    root = tmp_path / "sequence"
    root.mkdir()
    (root / "a.exr").write_bytes(b"1")
    identities = [engine.Subject]
    from gffe_cl.evaluation.table.subjects import FolderSubject

    identities = [FolderSubject(str(root), 1).identity()]
    (root / "a.exr").write_bytes(b"2")
    identities.append(FolderSubject(str(root), 1).identity())
    assert identities[0] != identities[1]


def test_damaged_cells_are_none(tmp_path):
    kept = cache.Cache(tmp_path / "cells")
    cell = Cell({"frames": []}, {"shown": b"webp"}, {"machine": "A", "milliseconds": 1.5})
    kept.write("k", cell)
    assert kept.read("k").document == {"frames": []} and kept.read("k").pictures == {"shown": b"webp"}
    assert kept.timing("k", "A")["milliseconds"] == 1.5 and kept.timing("k", "B")["machine"] == "A"
    kept.write("k", Cell({"frames": []}, {}, {"machine": "B", "milliseconds": 9.0}))
    assert kept.timing("k", "A")["milliseconds"] == 1.5 and kept.timing("k", "B")["milliseconds"] == 9.0
    (tmp_path / "cells" / "k.json").write_text('{"frames"')
    assert kept.read("k") is None and kept.read("none") is None
    (tmp_path / "file").write_text("")
    with pytest.raises(GffeError, match="cannot be made"):
        cache.Cache(tmp_path / "file")


# ---- the command -------------------------------------------------------------------------------------------------

SMALL = ("--size", "64x36", "--frames", 4)
FEW = "gffe,no-motion,adaptive-window,motion-vectors,guided,interpolation,repeat"


def test_eval(gffe, tmp_path, monkeypatch):
    """A scene and a sequence on disk, a network, late warp; and again, with nothing to do."""
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    sequence, report = tmp_path / "plaza<b>", tmp_path / "report"
    assert gffe("render", "plaza", sequence, "--size", "64x36", "--frames", 4, "--ground-truth")[0] == 0
    model = network(tmp_path / "mix.onnx")
    call = ("eval", "forest:2", sequence, "--out", report, *SMALL, "--methods", FEW, "--onnx", f"mix={model}")
    code, text, err = gffe(*call, "--late-warp", "--budget")
    assert code == 0 and "dB if perfect" in text and "late warp" in text, err
    assert "guided (plaza<b>): needs G-buffers" in err and "adaptive-window (plaza<b>): windows can be chosen" in err

    document = json.loads((report / "results.json").read_text())
    cells = {(c["sequence"], c["method"]): c for c in document["cells"]}
    assert len(cells) == 8 + 6 and cells["forest:2", "mix"]["psnr"] > cells["forest:2", "repeat"]["psnr"]
    best = cells["forest:2", "gffe"]
    assert best["psnr"] > cells["forest:2", "no-motion"]["psnr"] - 0.01 and best["against"] is None
    assert (
        best["psnr"] > cells["forest:2", "repeat"]["psnr"] + 3
        and best["flicker"] < cells["forest:2", "repeat"]["flicker"]
    )
    assert cells["forest:2", "repeat"]["against"] == pytest.approx(cells["forest:2", "repeat"]["psnr"] - best["psnr"])
    assert {"psnr", "ssim", "flip", "flicker", "milliseconds"} <= {c["name"] for c in document["columns"]}
    assert [row["turn"] for row in document["late"] if row["method"] == "gffe"] == [0.5, 1, 2, 4]
    shown = [row["disoccluded"] for row in document["late"] if row["method"] == "gffe"]
    assert shown == sorted(shown) and shown[-1] > 0.03
    for sequence_of in document["sequences"]:
        assert sum(sequence_of["shares"].values()) == pytest.approx(1)

    _same_as_compare(gffe, tmp_path, sequence, cells["plaza<b>", "gffe"])
    html = (report / "index.html").read_text()
    assert html.count("data:image/webp;base64,") == 2 * 3 + 2 * 14 and "plaza<b>" not in html
    assert not re.search(r"https?://(?!www\.w3\.org/2000/svg)", html)
    csv = (report / "results.csv").read_text().splitlines()
    assert csv[0] == "sequence,method,region,metric,value"
    assert f"forest:2,gffe,whole,psnr,{best['psnr']!r}" in csv

    before = {path.name: path.stat().st_mtime_ns for path in (report / "cells").iterdir()}
    start = time.process_time()
    assert gffe(*call, "--late-warp")[0] == 0
    assert time.process_time() - start < 10
    assert {path.name: path.stat().st_mtime_ns for path in (report / "cells").iterdir()} == before
    again = json.loads((report / "results.json").read_text())
    assert again["cells"] == document["cells"]


def _same_as_compare(gffe, tmp_path, sequence, cell):
    """The figures of `gffe run` and `gffe compare`, where every frame that is measured here is."""
    run, report = tmp_path / "run", tmp_path / "compare.json"
    assert gffe("run", sequence, run)[0] == 0 and gffe("compare", run, sequence, "--json", report)[0] == 0
    frames = {round(f["time"], 6): f for f in json.loads(report.read_text())["frames"]}
    assert cell["frames"]
    for frame in cell["frames"]:
        other = frames[round(frame["time"], 6)]
        for name in ("psnr", "ssim", "flip"):
            assert frame[name] == pytest.approx(other[name], abs=1e-3), name


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("rom",), "neither a built-in scene"),
        (("room", "room:0"), "two sequences have one name"),
        (("room", "--methods", "best"), "'best' is none of"),
        (("room", "--metrics", "vmaf"), "'vmaf' is none of fvvdp"),
        (("room", "--alpha", "0,0.5"), "--alpha must be different numbers within 0 and 8"),
        (("room", "--frames", 2), "--frames must be 4 to 10000"),
        (("room", "--onnx", "net"), "expected NAME=FILE"),
        (("room", "--scheduler", "tcp://127.0.0.1:9"), "--scheduler"),
    ],
)
def test_eval_says_what_is_wrong(gffe, tmp_path, arguments, words, monkeypatch):
    from gffe_cl.evaluation.table import cluster

    monkeypatch.setattr(cluster, "_PATIENCE", "0.2s")
    code, _, err = gffe("eval", *arguments, "--out", tmp_path / "report", "--size", "32x32")
    assert code == 2 and words in " ".join(err.split()) and not (tmp_path / "report" / "index.html").exists()


def test_reports_go_to_folders_of_their_own(gffe, tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "sequence.json").write_text("{}")
    for out, words in ((tmp_path / "file", "is a file"), (tmp_path, "is a sequence")):
        code, _, err = gffe("eval", "room", "--out", out)
        assert code == 2 and words in err


def test_an_interrupt_leaves_finished_cells(tmp_path, monkeypatch):
    """What was computed before stays and is taken up; nothing is half-written."""
    subject = SceneSubject("room", 0, 32, 24, 4, 30.0, (0.5,))
    order = Order((subject,), ("repeat", "motion-vectors", "guided"))
    done = []

    def stops(items, arguments):
        for work in items:
            if len(done) == 2:
                raise KeyboardInterrupt
            done.append(work.method)
            yield work, engine.compute_cell(work.subject, work.method, **arguments)

    with pytest.raises(KeyboardInterrupt):
        fill(order, tmp_path, executor=stops)
    assert done == [None, "repeat"]
    assert len(list(tmp_path.glob("*.json"))) == 3  # two cells, one of them timed
    filled = fill(order, tmp_path)
    assert filled.computed == 2 and len(filled.cells) == 3
    html = page(results.results_of(filled), filled)
    assert "motion vectors in image space" in html


@pytest.mark.long
@pytest.mark.slow
def test_a_killed_command_leaves_finished_cells(tmp_path):
    arguments = (
        "room",
        "--size",
        "160x90",
        "--frames",
        "12",
        "--methods",
        "baseline,deviation",
        "--out",
        str(tmp_path),
    )
    command = [sys.executable, "-m", "gffe_cl", "eval", *arguments]
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    cells = tmp_path / "cells"
    deadline = time.monotonic() + 300
    while child.poll() is None and len(list(cells.glob("*.shown.webp"))) < 2 and time.monotonic() < deadline:
        time.sleep(0.05)
    assert child.poll() is None, "it was too quick to be killed"
    os.kill(child.pid, signal.SIGKILL)
    child.wait()
    kept = cache.Cache(cells)
    names = [path.stem for path in cells.glob("*.json") if not path.name.endswith(".time.json")]
    assert len(names) >= 2 and all(kept.read(name) for name in names)


@pytest.mark.long
@pytest.mark.slow
def test_a_cluster_gives_the_same_cells(tmp_path):
    """Two workers, one of which is killed on the way: nothing is lost, nothing is counted twice."""
    distributed = pytest.importorskip("distributed", reason="needs dask")
    from gffe_cl.evaluation.table.cluster import cluster

    subjects = tuple(SceneSubject(name, 0, 64, 36, 4, 30.0, (0.5,)) for name in ("room", "forest"))
    order = Order(subjects, ("static-reprojection", "motion-vectors", "guided", "repeat"))
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1"
    ) as local:
        compute, seen = cluster(local.scheduler_address), []

        def killing(items, arguments):
            for work, cell in compute(items, arguments):
                seen.append(work)
                if len(seen) == 1:
                    os.kill(next(iter(local.workers.values())).pid, signal.SIGKILL)
                yield work, cell

        with pytest.raises(GffeError, match="another version"):  # these tests hide the weights, workers have them
            fill(Order(subjects[:1], ("gffe",)), tmp_path / "other", executor=compute)
        steps = []
        far = fill(order, tmp_path / "far", executor=killing, on_plan=lambda total: lambda: steps.append(total))
    assert len(seen) == len(set(seen)) == far.computed == 2 * 5 and len(steps) == steps[0] == 2 * 2 * 4
    near = fill(order, tmp_path / "near")
    for place, cell in near.cells.items():
        other = far.cells[place].document
        assert np.allclose(
            [frame["psnr"] for frame in other["frames"]],
            [frame["psnr"] for frame in cell.document["frames"]],
            atol=1e-3,
        )
        assert other["errors"]["pixels"] == cell.document["errors"]["pixels"]
    assert fill(order, tmp_path / "far").computed == 0
