"""What `gffe run` leaves: continued after an interrupt, videos, several sequences; and files that stay as they are."""

import json
import shutil
import subprocess
import sys
import time

import pytest
import tiny_sequence

from gffe_cl import open_sequence
from gffe_cl.captures.offline import run as offline

QUICK = ("--no-scn", "--no-check")


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    return tiny_sequence.write(tmp_path_factory.mktemp("tiny") / "in", frames=6)


def interrupt_after(count, monkeypatch):
    """Let a run be interrupted when it is about to make another frame than `count`. Return the frames that are made."""
    made, channels_of = [], offline.output_channels

    def stops(frame, *arguments):
        if len(made) == count:
            raise KeyboardInterrupt
        made.append(frame.time)
        return channels_of(frame, *arguments)

    monkeypatch.setattr(offline, "output_channels", stops)
    return made


def files(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize("camera", ["truth", "predicted"])
def test_the_same_command_continues_an_interrupted_run(gffe, source, tmp_path, monkeypatch, camera):
    """With the bits of a run at one go; with other settings, or --overwrite, it begins anew."""
    words = ("-n", 2, "--camera", camera, *QUICK)
    assert gffe("run", source, tmp_path / "whole", *words)[0] == 0
    for more, fresh in (((), 5), (("--overwrite",), 12), (("--no-motion",), 12)):
        with monkeypatch.context() as patch:
            interrupt_after(7, patch)
            assert gffe("run", source, tmp_path / "out", *words)[0] == 130
        with monkeypatch.context() as patch:
            made = interrupt_after(99, patch)
            code, text, _ = gffe("run", source, tmp_path / "out", *words, *more)
        assert code == 0 and len(made) == fresh and ("7 frames of an interrupted run taken up" in text) == (not more)
        assert (files(tmp_path / "out") == files(tmp_path / "whole")) == (more != ("--no-motion",))
        assert not (tmp_path / "out.part").exists()
        shutil.rmtree(tmp_path / "out")


def test_a_killed_run_continues(gffe, tmp_path):
    """With the bits of a run at one go. Finished frames are noted after each one here, not every ten seconds."""
    source = tiny_sequence.write(tmp_path / "in", frames=40)
    part, words = tmp_path / "out.part", ("-n", "7", *QUICK)
    assert gffe("run", source, tmp_path / "whole", *words)[0] == 0
    code = "from gffe_cl.captures.sequence import writer; writer._NOTED_EVERY = 0; from gffe_cl.cli import main; main()"
    child = subprocess.Popen([sys.executable, "-c", code, "run", source, tmp_path / "out", *words])
    deadline = time.monotonic() + 120
    while len(list(part.glob("extrapolated_*.exr"))) < 20 and time.monotonic() < deadline:
        time.sleep(0.005)
    child.kill()
    assert child.wait() == -9 and not (tmp_path / "out").exists()
    kept = len(list(part.glob("extrapolated_*.exr")))
    code, text, _ = gffe("run", source, tmp_path / "out", *words)
    assert code == 0 and "frames of an interrupted run taken up" in text and 20 <= kept < 280
    assert files(tmp_path / "out") == files(tmp_path / "whole") and not part.exists()


def test_changed_input_begins_anew(gffe, source, tmp_path, monkeypatch):
    copy = shutil.copytree(source, tmp_path / "in")
    with monkeypatch.context() as patch:
        interrupt_after(3, patch)
        assert gffe("run", copy, tmp_path / "out", *QUICK)[0] == 130
    frame = copy / open_sequence(copy).rendered[0].file
    frame.write_bytes((copy / open_sequence(copy).rendered[1].file).read_bytes())
    made = interrupt_after(99, monkeypatch)
    assert gffe("run", copy, tmp_path / "out", *QUICK)[0] == 0 and len(made) == 6


def test_sequences_of_a_folder_run_one_after_the_other(gffe, source, tmp_path, monkeypatch):
    """The broken one is named at the end, and the next run of the same command makes only those that are missing."""
    for name in ("a", "b", "c"):
        shutil.copytree(source, tmp_path / "shots" / name)
    (tmp_path / "shots" / "notes").mkdir()
    broken = tmp_path / "shots" / "b" / "sequence.json"
    text = broken.read_text()
    broken.write_text("{")
    call = ("run", tmp_path / "shots", tmp_path / "out", *QUICK, "--json", tmp_path / "r.json")
    code, _, told = gffe(*call)
    assert code == 2 and "run: 1 of 3 sequences failed: b" in told and "sequence.json: not valid JSON" in told
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["a", "c"]
    assert set(json.loads((tmp_path / "r.json").read_text())["sequences"]) == {"a", "c"}
    broken.write_text(text)
    made = interrupt_after(99, monkeypatch)
    code, text, _ = gffe(*call)
    assert code == 0 and len(made) == 6 and text.count("is complete") == 2
    assert len(open_sequence(tmp_path / "out" / "b").extrapolated) == 6


def test_a_suffix_of_videos_gives_a_video(gffe, source, tmp_path):
    """Rendered and new frames in order, at the rate of both; nothing else is left."""
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    video = tmp_path / "out.mp4"
    assert gffe("run", source, video, "-n", 2, *QUICK)[0] == 0
    assert ffmpeg.count_frames_and_secs(str(video))[0] == 18 and [video] == list(tmp_path.iterdir())
    about = next(ffmpeg.read_frames(str(video)))
    assert about["fps"] == pytest.approx(3 * open_sequence(source).fps) and about["codec"] == "h264"
    assert gffe("run", source, video, *QUICK)[0] == 0  # one of this kind is replaced
    assert ffmpeg.count_frames_and_secs(str(video))[0] == 12


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("{source}", "{here}/out.png"), "is no name of a folder (expected one, or a video: .mp4, .mov, .mkv)"),
        (("{source}", "{here}/mine.mp4"), "is a file of another kind (expected another file, or --overwrite)"),
        (("{source}", "{here}/out.mp4", "--alpha", "0.3"), "expected -n in place of --alpha"),
        (("{here}/mine.mp4", "{here}/out"), "a video has no depth, motion vectors and cameras"),
        (("plazza", "{here}/out"), "plazza: no such folder, and no built-in scene (there is: corridor, plaza, "),
        (("{source}", "{source}/out"), "the output would be inside its input"),
        (("{source}", "{here}/out", "--json", "{here}/mine.json"), "is a file that gffe-cl did not write"),
    ],
)
def test_what_is_refused_before_any_work(gffe, source, tmp_path, words, told):
    pytest.importorskip("imageio_ffmpeg")
    for name in ("mine.mp4", "mine.json"):
        (tmp_path / name).write_text('{"mine": 1}')
    code, _, err = gffe("run", *(word.format(source=source, here=tmp_path) for word in words), *QUICK)
    assert code == 2 and told in err and len(err.splitlines()) == 1
    assert {path.name for path in tmp_path.iterdir()} == {"mine.mp4", "mine.json"}
    assert (tmp_path / "mine.json").read_text() == '{"mine": 1}' and not (source / "out").exists()


def test_reports_replace_only_reports(gffe, tmp_path):
    """... of this program, without --overwrite."""
    report = tmp_path / "report.json"
    for before, more, code in ((None, (), 0), (None, (), 0), ("[1]", (), 2), ("[1]", ("--overwrite",), 0), ("", (), 0)):
        if before is not None:
            report.write_text(before)
        assert gffe("formats", "--json", report, *more)[0] == code
        assert (report.read_text() == before) == (code == 2)
    assert list(tmp_path.iterdir()) == [report]


@pytest.mark.parametrize(
    ("needs", "words", "name", "told"),
    [
        ("skimage", ("demo", "-o"), "metrics.json", "is a file that gffe-cl did not write (expected another file, or"),
        ("skimage", ("demo", "-o"), "contact_sheet.png", "is a file of another kind (expected another file, or"),
        ("skimage", ("eval", "plaza", "--out"), "results.csv", "is a file that gffe-cl did not write (expected"),
        ("torch", ("train",), "scn.onnx", "is there without a checkpoint (expected another folder, or --overwrite)"),
        ("torch", ("train",), "checkpoint.pt", "not a checkpoint of this program"),
    ],
)
def test_files_of_others_in_a_folder_of_results(gffe, tmp_path, needs, words, name, told):
    pytest.importorskip(needs)
    (tmp_path / name).write_text("mine")
    code, _, err = gffe(*words, tmp_path)
    assert code == 2 and told in err and len(err.splitlines()) == 1
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {name: "mine"}
