"""The table of `gffe eval`: subjects, methods, cells that are kept, the command."""

import json
import time
from dataclasses import replace

import pytest
from frame_models import network
from scn_models import constant_model

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.lab.table import cells
from gffe_cl.lab.table.cells import Cell, TableOrder, compute_cell, fill
from gffe_cl.lab.table.footage import FolderSubject, SceneSubject
from gffe_cl.lab.table.methods import METHODS


def test_cells_are_those_of_their_subject_method_and_sources(monkeypatch, tmp_path):
    subject = SceneSubject("room", 0, 64, 36, 6, 30.0, (0.5,))
    others = (replace(subject, seed=1), replace(subject, alphas=(0.25,)))
    keys = {cells.key_of(one.identity(), METHODS["gffe"].identity()) for one in (subject, *others)}
    keys |= {cells.key_of(subject.identity(), method.identity()) for method in METHODS.values()}
    assert len(keys) == 2 + len(METHODS)
    with monkeypatch.context() as changed:
        changed.setattr(cells, "package_digest", lambda: "others")
        assert cells.key_of(subject.identity(), METHODS["gffe"].identity()) not in keys
    identities = []
    for content in (b"1", b"2"):
        (tmp_path / "a.exr").write_bytes(content)
        identities.append(FolderSubject(str(tmp_path), 1).identity())
    assert identities[0] != identities[1]


def test_damaged_cells_are_none(tmp_path):
    kept = cells.Cache(tmp_path / "cells")
    cell = Cell({"frames": []}, {"machine": "A", "milliseconds": 1.5})
    kept.write("k", cell)
    assert kept.read("k").document == {"frames": []}
    assert kept.read("k").timing == {"machine": "A", "milliseconds": 1.5}
    (tmp_path / "cells" / "k.json").write_text('{"frames"')
    assert kept.read("k") is None and kept.read("none") is None
    (tmp_path / "file").write_text("")
    with pytest.raises(GffeError, match="cannot be made"):
        cells.Cache(tmp_path / "file")


# ---- the command -------------------------------------------------------------------------------------------------

SMALL = ("--size", "128x72", "--frames", 4)
FEW = "gffe,no-motion,adaptive-window,motion-vectors,guided,interpolation,repeat"


@pytest.mark.long
def test_eval(gffe, tmp_path, monkeypatch):
    """A scene and a sequence on disk, a network; and again, with nothing to do."""
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    sequence, report = tmp_path / "plaza<b>", tmp_path / "report"
    assert gffe("render", "plaza", sequence, "--size", "64x36", "--frames", 4, "--ground-truth")[0] == 0
    model = network(tmp_path / "mix.onnx")
    call = ("eval", "forest:2", sequence, "--out", report, *SMALL, "--methods", FEW, "--onnx", f"mix={model}")
    code, text, err = gffe(*call, "--regions")
    assert code == 0 and "by region" in text, err
    assert "guided (plaza<b>): needs G-buffers" in err and "adaptive-window (plaza<b>): windows can be chosen" in err

    document = json.loads((report / "results.json").read_text())
    found = {(c["sequence"], c["method"]): c for c in document["cells"]}
    assert len(found) == 8 + 6 and found["forest:2", "mix"]["psnr"] > found["forest:2", "repeat"]["psnr"]
    best = found["forest:2", "gffe"]
    assert best["psnr"] > found["forest:2", "no-motion"]["psnr"] + 0.1 and best["against"] is None
    assert (
        best["psnr"] > found["forest:2", "repeat"]["psnr"] + 3
        and best["flicker"] < found["forest:2", "repeat"]["flicker"]
    )
    assert found["forest:2", "repeat"]["against"] == pytest.approx(found["forest:2", "repeat"]["psnr"] - best["psnr"])
    assert {"psnr", "ssim", "flip", "flicker", "milliseconds"} <= {c["name"] for c in document["columns"]}
    for sequence_of in document["sequences"]:
        assert sum(sequence_of["shares"].values()) == pytest.approx(1)

    _same_as_compare(gffe, tmp_path, sequence, found["plaza<b>", "gffe"])
    csv = (report / "results.csv").read_text().splitlines()
    assert csv[0] == "sequence,method,region,metric,value"
    assert f"forest:2,gffe,whole,psnr,{best['psnr']!r}" in csv

    before = {path.name: path.stat().st_mtime_ns for path in (report / "cells").iterdir()}
    start = time.process_time()
    assert gffe(*call)[0] == 0
    assert time.process_time() - start < 10
    assert {path.name: path.stat().st_mtime_ns for path in (report / "cells").iterdir()} == before
    again = json.loads((report / "results.json").read_text())
    assert again["cells"] == document["cells"]


def test_eval_takes_seeds_and_a_network(gffe, tmp_path):
    """A network that brightens all: the focus mask limits the harm."""
    model = constant_model(tmp_path / "m.onnx", delta=0.05, mask=0.2)
    options = ("--size", "64x36", "--frames", 4, "--seeds", 2, "--scn-model", model, "--out", tmp_path)
    assert gffe("eval", "room", *options, "--methods", "no-scn,gffe,no-focus-mask,repeat")[0] == 0
    results = json.loads((tmp_path / "results.json").read_text())
    assert [sequence["name"] for sequence in results["sequences"]] == ["room:0", "room:1"]
    means = {mean["method"]: mean["psnr"] for mean in results["means"]}
    assert means["no-scn"] > means["gffe"] > means["no-focus-mask"] and means["no-scn"] > means["repeat"]


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
        (("room:x",), "seed must be"),
        (("room", "room:0"), "two sequences have one name"),
        (("room", "--methods", "best"), "'best' is none of"),
        (("room", "--metrics", "vmaf"), "'vmaf' is none of fvvdp"),
        (("room", "--alpha", "0,0.5"), "--alpha must be different numbers within 0 and 8"),
        (("room", "--frames", 2), "--frames must be 4 to 10000"),
        (("room", "--onnx", "net"), "expected NAME=FILE"),
    ],
)
def test_eval_says_what_is_wrong(gffe, tmp_path, arguments, words):
    code, _, err = gffe("eval", *arguments, "--out", tmp_path / "report", "--size", "32x32")
    assert code == 2 and words in " ".join(err.split()) and not (tmp_path / "report" / "results.json").exists()


def test_reports_go_to_folders_of_their_own(gffe, tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "sequence.json").write_text("{}")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "results.json").write_text("[1]")
    refused = ((tmp_path / "file", "is a file"), (tmp_path, "is a sequence"), (tmp_path / "mine", "did not write"))
    for out, words in refused:
        code, _, err = gffe("eval", "room", "--out", out)
        assert code == 2 and words in err


def test_an_interrupt_leaves_finished_cells(tmp_path, monkeypatch):
    """What was computed before stays and is taken up; nothing is half-written."""
    subject = SceneSubject("room", 0, 32, 24, 4, 30.0, (0.5,))
    order = TableOrder((subject,), ("repeat", "motion-vectors", "guided"))
    done = []

    def stops(subject, method, *arguments, **named):
        if len(done) == 2:
            raise KeyboardInterrupt
        done.append(method)
        return compute_cell(subject, method, *arguments, **named)

    with monkeypatch.context() as interrupted, pytest.raises(KeyboardInterrupt):
        interrupted.setattr(cells, "compute_cell", stops)
        fill(order, tmp_path)
    assert done == [None, "repeat"]
    assert len(list(tmp_path.glob("*.json"))) == 2
    filled = fill(order, tmp_path)
    assert filled.computed == 2 and len(filled.cells) == 3
    assert "motion vectors in image space" in cells.results_of(filled)["methods"][1]["title"]
