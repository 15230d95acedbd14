"""Files that other files refer to, files that are none, and names that hurt."""

import os
import subprocess
import sys

import numpy as np
import pytest
import tiny_sequence
from tiny_sequence import edit

from gffe_cl import GffeError, open_capture, open_sequence

RAW = os.fsdecode(b"x\xff")  # no UTF-8


@pytest.fixture
def folder(tmp_path):
    return tiny_sequence.write(tmp_path / "in", frames=2)


@pytest.mark.parametrize("absolute", [False, True])
def test_references_leave_the_folder_only_where_that_is_allowed(gffe, folder, tmp_path, absolute):
    expected = open_sequence(folder).read(open_sequence(folder).rendered[1])
    (tmp_path / "beside").mkdir()
    moved = (folder / "frame_1.exr").rename(tmp_path / "beside" / "frame_1.exr")
    place = str(moved) if absolute else "../beside/frame_1.exr"
    edit(folder, lambda d: [f.update(file=place) for f in d["frames"] if f["file"] == "frame_1.exr"])
    for opened in (open_sequence, open_capture):
        with pytest.raises(GffeError, match=r"must stay inside.*--follow-links"):
            opened(folder)
        sequence = opened(folder, follow_links=True)
        np.testing.assert_array_equal(sequence.read(sequence.rendered[1]).color, expected.color)
    for command in ("import", "run") if absolute else ("import",):
        assert gffe(command, folder, tmp_path / command)[2].endswith("(--follow-links allows it)\n")
        more = ["--no-scn", "--no-check"] if command == "run" else []
        assert gffe(command, folder, tmp_path / command, "--follow-links", *more)[0] == 0
        made = open_sequence(tmp_path / command)
        file = made.rendered[1].file
        assert file.endswith("beside/frame_1.exr") and (tmp_path / command / file).is_file()
        np.testing.assert_array_equal(made.read(made.rendered[1]).color, expected.color)
    assert gffe("check", folder)[2].endswith("(--follow-links allows it)\n")  # not for ever
    assert os.listdir(tmp_path / "beside") == ["frame_1.exr"]
    edit(folder, lambda d: d["frames"][0].update(file=made.rendered[1].file))
    with pytest.raises(GffeError, match="would be called"):
        open_sequence(folder, follow_links=True)


@pytest.mark.parametrize(
    ("command", "kind"),
    [("check", "pipe"), ("run", "device"), ("compare", "loop")]
    + [("import", kind) for kind in ("pipe", "device", "folder", "dangling", "loop")],
)
def test_files_that_are_none(gffe, folder, tmp_path, kind, command):
    path = folder / "frame_1.exr"
    path.unlink()
    ways = {
        "pipe": os.mkfifo,
        "device": lambda path: path.symlink_to("/dev/zero"),
        "folder": os.mkdir,
        "dangling": lambda path: path.symlink_to("nowhere"),
        "loop": lambda path: path.symlink_to(path),
    }
    ways[kind](path)
    more = {"run": [tmp_path / "out"], "import": [tmp_path / "out"], "compare": [folder]}.get(command, [])
    code, out, err = gffe(command, folder, *more)
    where = f"{folder}: " if command == "compare" else ""  # which of the two
    assert code == 2 and out == "" and err.startswith(f"error: {where}frame_1.exr: ") and err.count("\n") == 1
    assert not (tmp_path / "out").exists()
    if kind != "folder" and command == "import":  # in the place of the capture, and of the output
        ways[kind](tmp_path / "place")
        for words in (
            [tmp_path / "place", tmp_path / "out"],
            [tiny_sequence.write(tmp_path / "good"), tmp_path / "place"],
        ):
            code, _, err = gffe(command, *words)
            assert code == 2 and err.startswith(f"error: {tmp_path / 'place'}") and err.count("\n") == 1, err


@pytest.mark.parametrize("name", [RAW, "a\nb\x1b[31m%d'\"\u202egpj", "n" * 240])
def test_names_that_hurt(gffe, folder, tmp_path, name):
    (folder / "frame_1.exr").rename(folder / f"{name}.exr")
    edit(folder, lambda d: [f.update(file=f"{name}.exr") for f in d["frames"] if f["file"] == "frame_1.exr"])
    made, report = tmp_path / f"out{name}", tmp_path / f"{name}.json"
    commands = {
        ("import", folder, made, "--json", report): (0,),
        ("check", made) if name == RAW else ("formats",): (0, 1),
        ("compare", made, made, "--json", report): (2,),
        ("run", tmp_path / f"no{name}", tmp_path / f"other{name}"): (2,),
    }
    for command, expected in commands.items():
        code, out, err = gffe(*command)
        assert code in expected, err
        assert all(line.isprintable() for line in (out + err).splitlines()) and (code < 2 or err.count("\n") == 1)
    assert (made / f"{name}.exr").is_file() and open_sequence(made).rendered[1].file == f"{name}.exr"
    assert report.read_text("ascii")


def test_names_in_a_locale_without_them(folder):
    """A good sequence is one whatever the locale."""
    (folder / "frame_1.exr").rename(folder / "ü.exr")
    edit(folder, lambda d: [f.update(file="ü.exr") for f in d["frames"] if f["file"] == "frame_1.exr"])
    code = "import sys, gffe_cl; s = gffe_cl.open_sequence(sys.argv[1]); s.read(s.rendered[1])"
    env = {**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    child = subprocess.run([sys.executable, "-c", code, folder], env=env, capture_output=True, text=True)
    assert (child.returncode, child.stdout, child.stderr) == (0, "", "")
