"""`--scheduler`: the bytes of one machine, from a Dask scheduler with workers that are other processes."""

import json
import os
import subprocess
import sys
import time

import pytest
from shared_work import tried

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.lab.cluster import Cluster

pytest.importorskip("distributed")
pytest.importorskip("cryptography")
_WORKER = """
import gffe_cl.lab.cluster as cluster
if "{other}":
    cluster.package_digest = lambda: "{other}"
from distributed.cli.dask_worker import main
main()
"""


def started(folder, *command):
    """A process of Dask in a folder of its own, which other processes are not told of."""
    folder.mkdir()
    command = [sys.executable, *map(str, command), "--no-dashboard", "--host", "127.0.0.1"]
    return subprocess.Popen(command, cwd=folder, stderr=subprocess.DEVNULL, env=os.environ | {"OMP_NUM_THREADS": "1"})


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory):
    """The file of a scheduler on the loopback interface, and a function that starts a worker."""
    folder, processes = tmp_path_factory.mktemp("cluster"), []
    file = folder / "scheduler.json"

    def start(*command):
        processes.append(started(folder / str(len(processes)), *command, "--scheduler-file", file))
        return processes[-1]

    def worker(other=""):
        return start("-c", _WORKER.format(other=other), "--no-nanny", "--nthreads", 1)

    start("-m", "distributed.cli.dask_scheduler", "--port", 0)
    while not file.exists():
        assert processes[0].poll() is None
        time.sleep(0.05)
    yield file, worker
    for process in processes:
        process.kill()
        process.wait()


@pytest.fixture(scope="module")
def workers(scheduler):
    return [scheduler[1]() for _ in range(2)]


def contents(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_cells(scheduler, workers, tmp_path):
    """They come in order, with files both ways. One of which the worker is killed is computed by the other. Workers of
    another program are refused."""
    file, worker = scheduler
    folder, died = tmp_path / "input", tmp_path / "died"
    folder.mkdir()
    (folder / "same.txt").write_text("as it came")
    with Cluster(str(file)) as cluster:
        calls = [{"path": folder, "number": k, "seconds": 0.3 * (k == 1)} for k in range(9)]
        results = list(cluster.map(tried, calls))
        assert [document["number"] for document, _ in results] == list(range(9))
        assert {document["content"] for document, _ in results} == {"as it came"}
        assert [files for _, files in results] == [{os.path.join("part", "made.txt"): b"x" * k} for k in range(9)]
        assert {document["process"] for document, _ in results} == {process.pid for process in workers}
        assert cluster.summary().startswith("9 cells on 2 workers: ")
        calls[4]["dies"] = str(died)
        again = list(cluster.map(tried, calls))
        assert [document["number"] for document, _ in again] == list(range(9)) and died.exists()
        left = [process for process in workers if process.poll() is None]
        assert len(left) == 1 and again[4][0]["process"] == left[0].pid
        with pytest.raises(GffeError, match="input: no number"):
            list(cluster.map(tried, [{"path": folder, "number": -1}]))
        other = worker("another one")
        with pytest.raises(
            GffeError, match=r"^--scheduler: a worker has gffe-cl .* \(another one\) \(expected .*, as here\)"
        ):
            while True:
                list(cluster.map(tried, calls))
        other.kill()
        other.wait()
        worker()  # for other tests


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("render", "room", "{}/out", "--tls-key", "key"), "expected all three, and --scheduler"),
        (("run", "room", "{}/out", "--scheduler"), "expected a folder of several sequences"),
        (("render", "room", "{}/out", "--window", "adaptive", "--scheduler"), "need all frames before"),
    ],
)
def test_what_is_wrong_is_one_line(gffe, tmp_path, scheduler, workers, arguments, words):
    file = [scheduler[0]] if arguments[-1] == "--scheduler" else []
    code, _, err = gffe(*(str(word).format(tmp_path) for word in arguments), *file)
    assert code == 2 and words in err and not (tmp_path / "out").exists()


@pytest.mark.long
def test_rendered_and_extrapolated_sequences_are_the_same(gffe, tmp_path, scheduler, workers):
    """Parts of a scene that are joined; and sequences of which one is broken, whose results stay the second time."""
    for name in ("a", "b"):
        call = ("render", "plaza", "--size", "48x32", "--frames", 6, "--window", "fixed:1.2", "--ground-truth")
        assert gffe(*call[:2], tmp_path / "near" / name, *call[2:], "--seed", 3)[0] == 0
        code, out, err = gffe(*call[:2], tmp_path / "far" / name, *call[2:], "--seed", 3, "--scheduler", scheduler[0])
        assert code == 0 and "2 cells on " in out, err
    near = contents(tmp_path / "near")
    assert len(near) == 2 * (2 * 6 + 1) and contents(tmp_path / "far") == near
    (tmp_path / "near/b/frame_000002.exr").write_bytes(b"broken")
    made = tmp_path / "made"
    for place, *more in (("here",), ("there", "--scheduler", scheduler[0])):
        call = ("run", tmp_path / "near", made / place, "--no-scn", "--json", tmp_path / f"{place}.json")
        code, out, err = gffe(*call, *more, checked=True)
        assert code == 2 and "1 of 2 sequences failed: b" in err and f"{tmp_path / 'near/b'}" not in out
        again = gffe(*call, *more, checked=True)[1]
        assert f"{made / place / 'a'} is complete" in " ".join(again.split())
    assert len(contents(made / "here")) == 1 + 2 * 6 and contents(made / "there") == contents(made / "here")
    assert os.path.samefile(made / "there/a/frame_000000.exr", tmp_path / "near/a/frame_000000.exr")


@pytest.mark.long
def test_figures_are_the_same(gffe, tmp_path, scheduler, workers):
    """Of a scene and of a sequence, on workers of this machine; finished cells are taken by either."""
    assert gffe("render", "room", tmp_path / "in", "--size", "48x32", "--frames", 5, "--ground-truth")[0] == 0
    call = (
        "eval",
        "plaza",
        tmp_path / "in",
        "--size",
        "48x32",
        "--frames",
        5,
        "--methods",
        "dilate-splat,guided,repeat",
    )
    cells = []
    for place, *more in (("near",), ("far", "--scheduler", "local:2")):
        code, out, err = gffe(*call, "--out", tmp_path / place, *more)
        assert code == 0 and ("7 cells on 2 workers" in out) == bool(more), err
        results = json.loads((tmp_path / place / "results.json").read_text())
        times = ("milliseconds", "timed", "timed_on")
        cells.append([{k: v for k, v in cell.items() if k not in times} for cell in results["cells"]])
    assert len(cells[0]) == 5 and cells[0] == cells[1]
    assert "0 cells on" in gffe(*call, "--out", tmp_path / "near", "--scheduler", scheduler[0])[1]


@pytest.mark.long
def test_clips_are_the_same(tmp_path, scheduler, workers):
    pytest.importorskip("torch")
    from gffe_cl.engine.opencl.device import open_device
    from gffe_cl.lab.training.data import make_clips

    assert make_clips(tmp_path / "near", open_device(), 1, 1) == 1
    with Cluster(str(scheduler[0])) as cluster:
        assert make_clips(tmp_path / "far", None, 1, 1, cluster=cluster) == 1
    near = contents(tmp_path / "near")
    assert len(near) == 3 and contents(tmp_path / "far") == near
