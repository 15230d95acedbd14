"""Commands in hostile hands: values that are none, closed streams, full disks, two at once, and long silence."""

import json
import os
import shlex
import subprocess
import sys

import pytest
from fuzz_arguments import arguments, kind, parameters, wrong

from gffe_cl.cli import common
from gffe_cl.engine.core import errors
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.files import replacing
from gffe_cl.engine.opencl.remote_workers import Cluster


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


def test_lists_of_numbers_are_finite():
    for text in ("nan", "0.5,inf", "", "1e999"):
        with pytest.raises(GffeError, match="must be numbers"):
            common.parse_numbers(text, "--alpha")


@pytest.mark.parametrize("streams", [">&-", "<&- >&- 2>&-", "2>/dev/full"])
def test_closed_streams(streams, tmp_path):
    """They are like /dev/null: nothing lands in a file that is opened instead of them."""
    report = tmp_path / "report.json"
    command = f"{shlex.quote(sys.executable)} -m gffe_cl formats --json {shlex.quote(str(report))} {streams}"
    child = subprocess.run(["bash", "-c", command], capture_output=True, text=True)
    assert child.returncode == 0 and not child.stderr and json.loads(report.read_text())["formats"]


def test_addresses_of_schedulers_are_told_apart_from_others():
    """Before anybody waits for an answer."""
    pytest.importorskip("distributed", reason="needs dask")
    for address in ("-1", "/dev/null", "tcp://", "host"):
        with pytest.raises(GffeError, match="is no address"):
            Cluster(address)


def test_long_messages_keep_what_matters():
    path = "/" + "x" * 5000
    text = errors.shortened(f"{path}: cannot be read (expected a folder)")
    assert len(text) < 300 and text.startswith("/xxx") and text.endswith("cannot be read (expected a folder)")
    text = errors.shortened("kernels/a.cl does not build: " + "error: no such thing; " * 200)
    assert len(text) == errors.MOST and text.startswith("kernels/a.cl does not build: error")
    assert errors.shortened("short") == "short"


def test_silence_is_broken_where_standard_error_is_no_terminal(monkeypatch, capsys):
    """A line for each finished step, and for one that lasts, with an estimate; quick commands print none."""
    now = [0.0]
    monkeypatch.setattr(common.time, "monotonic", lambda: now[0])


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("GFFE_LANES", "abc", 'GFFE_LANES must be 1 or 8, got "abc"'),
        ("GFFE_LANES", "3", 'GFFE_LANES must be 1 or 8, got "3"'),
        ("GFFE_SHARED_MEMORY", "2", 'GFFE_SHARED_MEMORY must be 0 or 1, got "2"'),
        ("GFFE_DEVICE", "abacus", "GFFE_DEVICE: no working device matches 'abacus' (there is: "),
        ("GFFE_KERNELS", "none", 'GFFE_KERNELS must be a folder of kernels with common.h, got "none"'),
        ("GFFE_DEVICE_CACHE", __file__, "GFFE_DEVICE_CACHE must be a folder or off, got "),
    ],
)
def test_environment_variables_are_checked(tmp_path, name, value, told):
    command = [sys.executable, "-m", "gffe_cl", "render", "room", "out", "--size", "16x16", "--frames", "2"]
    if name == "GFFE_SHARED_MEMORY":  # which the network asks for
        sees = "from gffe_cl import *\ntry: open_device().shares_memory\nexcept GffeError as e: exit(f'error: {e}')"
        command = [sys.executable, "-c", sees]
    child = subprocess.run(
        command, env=os.environ | {name: value}, cwd=tmp_path, capture_output=True, text=True, timeout=100
    )
    (line,) = child.stderr.splitlines()
    assert child.returncode and line.startswith(f"error: {told}") and not (tmp_path / "out").exists()


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


def test_errors_of_writing_name_the_file(tmp_path):
    path = tmp_path / "report.txt"
    with pytest.raises(OSError) as failed, replacing(path) as part:
        part.write_text("half")
        raise OSError(28, os.strerror(28))
    assert failed.value.filename == str(path) and not list(tmp_path.iterdir())


@pytest.mark.parametrize("option", ["--vgg", "--start"])
def test_training_looks_for_its_files_first(gffe, tmp_path, option):
    code, _, told = gffe("train", tmp_path / "out", option, tmp_path / "none.onnx")
    assert code == 2 and told.startswith(f"error: {option} {tmp_path}/none.onnx: no such file in {tmp_path}")
    assert not list(tmp_path.iterdir())
