"""`--encode` of `gffe render` and `gffe import`: one rendering serves all encodings."""

import numpy as np

from gffe_cl.captures.scenes.renderer import JITTER_LENGTH
from gffe_cl.captures.sequence import open_sequence
from gffe_cl.captures.sequence.encoding import Encoding
from gffe_cl.engine.frame.window import Jitter

SIZE = ("--size", "160x90")


def test_import_encodes_what_render_does(gffe, tmp_path):
    """The same vectors, depths and colors, bit for bit."""
    exact, rendered, imported = (tmp_path / name for name in ("exact", "rendered", "imported"))
    gffe("render", "forest", exact, *SIZE, "--frames", 4)
    code, *_ = gffe("render", "forest", rendered, *SIZE, "--frames", 4, "--ground-truth", "--encode", "engine")
    assert code == 0
    code, *_ = gffe("import", exact, imported, "--encode", "engine")
    assert code == 0
    ours, theirs, good = (open_sequence(folder) for folder in (rendered, imported, exact))
    assert len(ours.rendered) == len(theirs.rendered) == 4
    for k, (mine, other) in enumerate(zip(ours.rendered, theirs.rendered, strict=True)):
        a, b, c = ours.read(mine), theirs.read(other), good.read(good.rendered[k])
        assert np.array_equal(a.depth, b.depth) and np.array_equal(a.color, b.color)
        assert not np.array_equal(a.depth, c.depth) and not np.array_equal(a.color, c.color)
        assert a.camera == b.camera == c.camera and mine.display_camera == mine.render_camera
        if k:
            assert np.array_equal(a.motion, b.motion) and len(np.unique(a.motion[..., 0])) < 40
    assert all(truth.display_camera is not None for truth in ours.ground_truth)


def test_render_as_a_game_does(gffe, tmp_path):
    """Small, jittered geometry with its jitter, described dilated vectors, a user interface in color and truth."""
    exact, game = tmp_path / "exact", tmp_path / "game"
    for folder, more in ((exact, ()), (game, ("--encode", "game"))):
        assert gffe("render", "forest", folder, *SIZE, "--frames", 2, "--ground-truth", *more)[0] == 0
    ours, good = open_sequence(game), open_sequence(exact)
    assert ours.format.motion_dilated and good.format is None
    ui = Encoding.parse("hud").user_interface((160, 90), ours.exposure)[..., 3]
    for k, entry in enumerate(ours.rendered):
        made, plain = ours.read(entry), good.read(good.rendered[k])
        assert entry.geometry_jitter == tuple(-np.array(Jitter(JITTER_LENGTH).offset(k)))
        assert entry.geometry_size == (80, 45) and made.depth.shape == (90, 160) and made.camera == plain.camera
        off = np.abs(made.depth - plain.depth)[np.isfinite(made.depth) & np.isfinite(plain.depth)]
        assert np.median(off) < 0.01 * np.median(plain.depth)
    truths = [sequence.read_color(sequence.ground_truth[1]) for sequence in (ours, good)]
    assert np.array_equal(*(truth[ui == 0] for truth in truths)) and not np.array_equal(*truths)


def test_errors(gffe, tmp_path):
    gffe("render", "forest", tmp_path / "in", *SIZE, "--frames", 1)
    for arguments, said in (
        (("render", "forest", tmp_path / "out", "--encode", "third"), "unknown encoding 'third'"),
        (("render", "forest", tmp_path / "out", "--size", "0x5"), "size must be 1 to 16384 pixels each way"),
        (("render", "forest", tmp_path / "out", "--size", "5x0"), "size must be 1 to 16384 pixels each way"),
        (("render", "forest", tmp_path / "out", "--encode", "hud", "--window", "fixed:1.2"), "exclude --window"),
        (("import", tmp_path / "in", tmp_path / "out", "--encode", "game"), "need a renderer"),
    ):
        code, _, err = gffe(*arguments)
        assert code == 2 and said in err and not (tmp_path / "out").exists()
