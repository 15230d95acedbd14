"""Commands in hostile hands: values that are none, closed streams, full disks, two at once, and long silence."""

import fcntl
import json
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from fuzz_arguments import arguments, kind, parameters, wrong

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.files import only_process
from gffe_cl.engine.opencl.device import open_device


def test_empty_and_infinite_values_are_refused(gffe, tmp_path, monkeypatch):
    """Of every parameter of every command, before any work."""
    monkeypatch.chdir(tmp_path)
    places = {"out": "out", "sequence": "none", "folder": ".", "file": "none"}
    values = {"": ("",), "float": ("", "nan", "inf"), "int": ("", "nan", str(2**70))}
    for name, parameter in parameters():
        for value in values[next((word for word in ("float", "int") if word in kind(parameter)), "")]:
            words = [word.format(**places) for word in arguments(name, parameter, value)]
            code, _, told = gffe(*words)
            assert code == 2 and not wrong(code, told), (words, told)
            assert value or "is empty" in told or "valid" in told, (words, told)
    assert not list(tmp_path.iterdir())


def test_a_word_that_is_no_command_names_what_is_meant(gffe):
    code, _, told = gffe("doctor", "out/demo")
    assert code == 2 and "doctor is no command (expected `gffe check SEQUENCE`)" in told


@pytest.mark.parametrize("streams", [">&-", "<&- >&- 2>&-", "2>/dev/full"])
def test_closed_streams(streams, tmp_path):
    """They are like /dev/null: nothing lands in a file that is opened instead of them."""
    report = tmp_path / "report.json"
    command = f"{shlex.quote(sys.executable)} -m gffe_cl formats --json {shlex.quote(str(report))} {streams}"
    child = subprocess.run(["bash", "-c", command], capture_output=True, text=True)
    assert child.returncode == 0 and not child.stderr and json.loads(report.read_text())["formats"]


def test_one_process_per_folder(tmp_path, gffe):
    """A lock of another process; it is gone with that one, and nothing is left of it."""
    folder = tmp_path / "a" / "b"
    with only_process(folder), open(folder / ".lock") as file, pytest.raises(BlockingIOError):
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    assert not list(folder.iterdir())
    with only_process(folder), pytest.raises(GffeError, match="another process"), only_process(folder):
        pass
    pytest.importorskip("torch", reason="needs torch")
    with only_process(folder):
        code, _, told = gffe("train", folder, "--clips", 2, "--steps", 1, "--minutes", 0.01)
        assert code == 2 and "another process is writing into it" in told
    (tmp_path / "file").write_text("")
    with pytest.raises(GffeError, match="cannot be written"), only_process(tmp_path / "file" / "folder"):
        pass


@pytest.mark.long
@pytest.mark.slow
def test_eval_measures_what_is_whole(gffe, tmp_path):
    """Of three sequences one has a broken description and one a broken frame: both are named with the reason."""
    whole, description, frame = (tmp_path / name for name in ("whole", "description", "frame"))
    assert gffe("render", "plaza", whole, "--size", "32x32", "--frames", 4, "--ground-truth")[0] == 0
    for copy in (description, frame):
        shutil.copytree(whole, copy)
    (description / "sequence.json").write_text("{")
    truth = max(frame.glob("truth_*"))
    truth.write_bytes(truth.read_bytes()[:-200])
    call = ("eval", description, frame, whole, "--out", tmp_path / "report", "--methods", "repeat")
    code, _, told = gffe(*call)
    assert code == 2, told
    document = json.loads((tmp_path / "report" / "results.json").read_text())
    assert [one["name"] for one in document["sequences"]] == ["whole"] and len(document["cells"]) == 1
    reasons = {Path(skip["what"]).name: skip["reason"] for skip in document["skipped"]}
    assert "sequence.json" in reasons["description"] and truth.name in reasons["frame"]
    assert told.splitlines()[-1].startswith("error: eval: 2 of the sequences")


def test_paths_are_printed_as_they_are(gffe, tmp_path, monkeypatch):
    """Neither as emoji nor as markup."""
    monkeypatch.chdir(tmp_path)
    for name in ("a:x:b", ":heart:", "[bold]b[/]", "[/]"):
        code, _, told = gffe("check", name)
        assert code == 2 and told.startswith(f"error: {name}: no such folder")


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("GFFE_LANES", "abc", 'GFFE_LANES must be 1 or 8, got "abc"'),
        ("GFFE_LANES", "3", 'GFFE_LANES must be 1 or 8, got "3"'),
        ("GFFE_SHARED_MEMORY", "2", 'GFFE_SHARED_MEMORY must be 0 or 1, got "2"'),
        ("GFFE_DEVICE", "abacus", "GFFE_DEVICE: no working device matches 'abacus' (there is: "),
        ("GFFE_KERNELS", "none", 'GFFE_KERNELS must be a folder of kernels with common.h, got "none"'),
    ],
)
def test_environment_variables_are_checked(gffe, tmp_path, monkeypatch, name, value, told):
    monkeypatch.setenv(name, value)
    if name == "GFFE_SHARED_MEMORY":  # which the network asks for
        with pytest.raises(GffeError, match=told):
            _ = open_device().shares_memory
        return
    code, _, err = gffe("render", "room", tmp_path / "out", "--size", "16x16", "--frames", 2)
    assert code == 2 and err.startswith(f"error: {told}") and err.count("\n") == 1 and not (tmp_path / "out").exists()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_reports_into_pipes_and_devices(gffe, tmp_path):
    """A pipe that nobody reads is refused instead of waited for; one that is read gets everything."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    code, _, told = gffe("formats", "--json", pipe)
    assert code == 2 and told == f"error: {pipe}: cannot be written to (expected a program that reads it)\n"
    with subprocess.Popen(["cat", pipe], stdout=subprocess.PIPE) as reader:
        while gffe("formats", "--json", pipe)[0]:  # until it has begun
            pass
        assert json.loads(reader.communicate(timeout=20)[0])["formats"]
    if os.path.exists("/dev/full"):
        code, _, told = gffe("formats", "--json", "/dev/full")
        assert code == 2 and told == "error: /dev/full: cannot write: No space left on device\n"


def test_standard_output_that_is_a_file(tmp_path):
    """The report is added to what is printed, and replaces nothing."""
    with open(tmp_path / "all", "w") as file:
        command = [sys.executable, "-m", "gffe_cl", "formats", "--json", "/dev/stdout"]
        assert subprocess.run(command, stdout=file, timeout=60).returncode == 0
    text = (tmp_path / "all").read_text()
    assert "form " in text and '"formats": [' in text


@pytest.mark.parametrize("option", ["--vgg", "--start"])
def test_training_looks_for_its_files_first(gffe, tmp_path, option):
    code, _, told = gffe("train", tmp_path / "out", option, tmp_path / "none.onnx")
    assert code == 2 and told.startswith(f"error: {option} {tmp_path}/none.onnx: no such file in {tmp_path}")
    assert not list(tmp_path.iterdir())
