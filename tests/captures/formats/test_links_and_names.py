"""Files that other files refer to, files that are none, and names that hurt."""

import os
import subprocess
import sys

import pytest
import tiny_sequence
from tiny_sequence import edit

from gffe_cl import GffeError, open_capture, open_sequence

RAW = os.fsdecode(b"x\xff")  # no UTF-8


@pytest.fixture
def folder(tmp_path):
    return tiny_sequence.write(tmp_path / "in", frames=2)


@pytest.mark.parametrize("place", ["../beside/frame_1.exr", "/beside/frame_1.exr"])
def test_references_stay_in_the_folder(folder, place):
    edit(folder, lambda d: [f.update(file=place) for f in d["frames"] if f["file"] == "frame_1.exr"])
    for opened in (open_sequence, open_capture):
        with pytest.raises(GffeError, match=r"must stay inside.*a link of the file system"):
            opened(folder)


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
