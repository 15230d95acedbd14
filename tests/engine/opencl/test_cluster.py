"""Work on a Dask cluster of two workers, one of which is killed on the way: `gffe render`, clips for `gffe train`."""

import os
import signal

import pytest

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.opencl.device import open_device
from gffe_cl.engine.opencl.remote_workers import Cluster, fingerprint
from gffe_cl.lab.table import cluster as cells_on_cluster
from gffe_cl.lab.table.datasets import SceneSubject
from gffe_cl.lab.table.runner import Work

SEED = 3  # of two small clips
pytestmark = [pytest.mark.long, pytest.mark.slow]


@pytest.fixture(scope="module")
def workers():
    distributed = pytest.importorskip("distributed", reason="needs dask")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1"
    ) as local:
        yield local


@pytest.fixture
def cluster(workers):
    made = Cluster(workers.scheduler_address)
    yield made
    made.close()


def kill_one(workers):
    os.kill(next(iter(workers.workers.values())).pid, signal.SIGKILL)


def contents(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def test_rendered_frames_are_the_same(workers, gffe, tmp_path):
    call = ("plaza", "--size", "80x44", "--frames", 6, "--ground-truth", "--window", "fixed:1.2", "--seed", 3)
    assert gffe("render", call[0], tmp_path / "near", *call[1:])[0] == 0
    kill_one(workers)
    far = gffe("render", call[0], tmp_path / "far", *call[1:], "--scheduler", workers.scheduler_address)
    assert far[0] == 0, far[2]
    near = contents(tmp_path / "near")
    assert len(near) == 1 + 2 * 6 and contents(tmp_path / "far") == near
    code, _, err = gffe(
        "render", "plaza", tmp_path / "no", "--window", "adaptive", "--scheduler", workers.scheduler_address
    )
    assert code == 2 and "follows from frame to frame" in " ".join(err.split()) and not (tmp_path / "no").exists()


def test_clips_are_the_same(workers, cluster, tmp_path):
    pytest.importorskip("torch", reason="needs PyTorch")
    from gffe_cl.lab.training import clips

    told = []

    def on_clip(made):
        told.append(made)
        if len(told) == 1:
            kill_one(workers)

    assert clips.make_clips(tmp_path / "far", None, SEED, 2, on_clip, cluster=cluster) == 2 and told == [True] * 2
    assert clips.make_clips(tmp_path / "near", open_device(), SEED, 1) == 1
    near, far = contents(tmp_path / "near"), contents(tmp_path / "far")
    assert len(far) == 6 and near.items() <= far.items()
    assert (
        clips.make_clips(tmp_path / "far", None, SEED, 2, told.append, cluster=cluster) == 0 and told[2:] == [False] * 2
    )


def test_work_that_fails_says_why(cluster, monkeypatch):
    items = {str(k): (k,) for k in range(200)}
    assert list(cluster.compute(abs, items, in_order=True)) == [(str(k), k) for k in range(200)]
    assert dict(cluster.compute(abs, items)) == {str(k): k for k in range(200)}
    with pytest.raises(TypeError):
        list(cluster.compute(abs, {"a": ("text",)}))
    monkeypatch.setattr("gffe_cl.engine.opencl.remote_workers.fingerprint", lambda: fingerprint()[::-1])
    with pytest.raises(GffeError, match="another version of gffe-cl"):
        list(cluster.compute(abs, {"a": (1,)}))


def test_a_worker_hands_back_why_a_sequence_cannot_be_measured(monkeypatch):
    """... and the others go on; that its sources are others ends everything."""

    def damaged(*_, **__):
        raise GffeError("frame_000003.exr: truncated")

    subject = SceneSubject("room", 0, 32, 18, 4, 30.0, (0.5,))
    monkeypatch.setattr(cells_on_cluster, "compute_cell", damaged)
    monkeypatch.setattr(cells_on_cluster, "key_of", lambda *_: "here")
    made = cells_on_cluster._cell(Work(subject, None, "here"), {"onnx": (), "network": (None, "cpu")})
    assert isinstance(made, GffeError) and "truncated" in str(made)
    with pytest.raises(GffeError, match="another version"):
        cells_on_cluster._cell(Work(subject, None, "there"), {"onnx": (), "network": (None, "cpu")})
