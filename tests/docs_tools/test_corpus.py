"""The corpus, and the comparison of two sides on it."""

from dataclasses import replace

import corpus
import numpy as np
import pytest
import quality
from corpus import ALPHAS, Line, corpus_lines
from quality import VARIANTS, Change, Side

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.opencl.device import open_device
from gffe_cl.lab.metrics import REGIONS

LINE = Line("x", "scenes", "bars", frames=4)


def test_lines_of_the_corpus_can_be_built():
    lines = corpus_lines()
    assert len({line.name for line in lines}) == len(lines) == len({replace(line, name="") for line in lines})
    for group in {line.group for line in lines}:
        assert {line.use for line in lines if line.group == group} == {"tuned", "proof"}, group
    for line in {line.generator: line for line in lines}.values():
        times = line.times()
        assert line.scene().groups and len(times) == line.frames + 1 and (np.diff(times) > 0).all()


def test_new_frames_are_of_a_side(monkeypatch, tmp_path):
    """Without the network, colors are those before it; a side's own options count; figures are cached."""
    line = replace(LINE, condition="uneven", effect="smoke", encoding="half-uv")
    for module in (corpus, quality):
        monkeypatch.setattr(module, "CACHE", tmp_path)
    monkeypatch.setattr(corpus, "SIZE", (40, 24))
    files = {line.name: corpus.rendered(line, open_device(None))}
    with np.load(files[line.name]) as stored:
        assert stored["truth"].shape == (2 * len(ALPHAS), 24, 40, 3) and set(stored["after"]) == {2, 3}
        assert (stored["truth_time"] > stored["time"][stored["after"]]).all()
    said, sides = [], [Side.parse(text) for text in (". shading_correction=true", ". shading_correction=false")]
    with_it, without = (quality.cells_of(side, [line], files, said.append)[line.name] for side in sides)
    assert len(said) == 2 and quality.cells_of(sides[0], [line], files, said.append)[line.name] == with_it
    assert len(said) == 2
    for with_network, plain in (VARIANTS[:2], VARIANTS[2:]):
        assert without[with_network] == without[plain] == with_it[plain]


def test_figures_of_a_picture(tmp_path):
    truth = np.random.default_rng(1).uniform(0, 1, (2, 16, 20, 3)).astype(np.float16)
    labels = np.zeros((2, 16, 20), np.uint8)
    np.savez(tmp_path / "a.npz", truth=truth, labels=labels, exposure=1.0)
    made = np.repeat(truth[:, None], 2, 1)
    made[1, 0] = made[1, 0].mean()
    found = quality.measured(tmp_path / "a.npz", made)
    for variant in (*VARIANTS[:2], VARIANTS[3]):
        assert (found[variant]["psnr"], found[variant]["ssim"], found[variant]["detail"]) == (100, 1, 1)
    assert found[VARIANTS[2]]["psnr"] < 13 and found[VARIANTS[2]]["detail"] < 1e-6


def changed(name, db, group="scenes", use="tuned"):
    """The four variants of a sequence that changes by so many dB at α = ½ with the network."""
    regions = {region: [1.0, 100] for region in REGIONS}
    before = {"psnr": 30.0, "ssim": 0.9, "detail": 0.8, "regions": regions}
    after = before | {"psnr": 30.0 + db, "regions": regions | {"rest": [1.0 - db, 100]}}
    line = replace(LINE, name=name, group=group, use=use)
    return [Change(line, variant, before, after if variant == VARIANTS[0] else before) for variant in VARIANTS]


def test_what_is_worse_than_allowed():
    some = [*changed("a", 0.2), *changed("b", -0.06), *changed("c", -0.02, "fast"), *changed("d", -0.04, use="proof")]
    groups = quality.groups_of(some)
    assert list(groups) == ["scenes", "fast", "all tuned", "scenes, proof"]
    assert quality.worse(some, groups) == [
        "fast, α ½: −0.020 dB (allowed: −0.01)",
        "scenes, proof, α ½: −0.040 dB (allowed: −0.01)",
        "b, α ½: −0.060 dB (allowed: −0.05)",
    ]
    assert quality.extremes(some, -1)[0] == "  −0.060 dB  b, α ½: rest −0.25"
    assert len(quality.extremes(some, 1)) == 1


def test_sides_are_parsed(tmp_path):
    (tmp_path / "common.h").touch()
    side = Side.parse(f". {tmp_path} preset=performance order=1 blocks=false")
    assert side.kernels == tmp_path and side.options == {"preset": "performance", "order": 1, "blocks": False}
    assert Side.parse("").key == Side.parse(".").key != side.key
    with pytest.raises(GffeError, match="nonsense: expected a commit"):
        Side.parse("nonsense")
