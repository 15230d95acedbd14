"""The self-test: this machine's devices give the recorded bits; what differs, crashes or hangs is told."""

import json
import os
import shutil
from dataclasses import replace

import numpy as np
import pytest

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.inference import network
from gffe_cl.engine.opencl.device import list_devices, open_info
from gffe_cl.engine.opencl.program import kernel_folder
from gffe_cl.engine.selftest import report
from gffe_cl.engine.selftest.reference import (
    KEPT_MOMENT,
    BufferComparison,
    BufferDifference,
    Reference,
    compare_network,
    digest,
    inputs_digest,
    model_digest,
    recorded,
    reference_path,
    ulps,
)
from gffe_cl.engine.selftest.report import selftest
from gffe_cl.engine.selftest.scene import CUT, frames
from gffe_cl.engine.selftest.workload import CASES, SIZE, forms_of, moments

STALE = "after a change that is meant: python docs/tools/record_selftest.py"
LITTLE = {"cases": ["paper"], "forms": ["own"], "until": "frame 1 + 1/3"}


@pytest.fixture
def weights(monkeypatch, default_model):
    monkeypatch.setattr(network, "default_model", default_model)
    monkeypatch.setattr("gffe_cl.engine.selftest.reference.default_model", default_model)
    monkeypatch.setattr("gffe_cl.engine.selftest.workload.default_model", default_model)


def differences(device, form, cases=CASES, until=None):
    """By "case: buffer"."""
    found = {}
    for name in cases:
        comparison = BufferComparison(recorded(), name)
        for moment, buffers in moments(open_info(device.info), CASES[name], form):
            comparison.add(moment, buffers)
            if moment == until:
                break
        assert len(comparison.compared) > 40
        found |= {f"{name}: {buffer}": str(told) for buffer, told in comparison.different.items()}
    return found


@pytest.mark.usefixtures("weights")
def test_devices_give_the_recorded_bits(device):
    assert differences(device, forms_of(device)[0]) == {}, STALE


@pytest.mark.long
@pytest.mark.usefixtures("weights")
def test_all_forms_of_kernels_give_the_recorded_bits(device):
    forms = forms_of(device)
    assert [form.lanes for form in forms[:2]] in ([8, 1], [1, 8])
    tried = forms[1:]
    assert {form.name: differences(device, form) for form in tried} == {form.name: {} for form in tried}, STALE


def test_references_are_of_these_frames_and_weights(default_model, weights):
    reference = recorded()
    assert reference_path().stat().st_size < 580_000
    assert set(reference.hashes) == set(reference.values) == set(CASES)
    assert {name: inputs_digest(frames(*SIZE, case.render_size)) for name, case in CASES.items()} == reference.inputs
    assert model_digest() == reference.model, STALE
    assert compare_network() == 0  # on a CPU with fused multiply-add
    assert all(len(held) == 2 * 8 for held in reference.hashes.values())
    cut = digest(np.array([1], np.uint8))
    for held in reference.hashes.values():
        found = {moment for moment, hashes in held.items() if hashes["pipeline.is_cut"] == cut}
        assert found == {f"frame {CUT} + {j}/3" for j in (1, 2)}


def test_references_are_read_as_they_were_written(tmp_path):
    reference = Reference(inputs={"a": "1"}, model="m")
    first = {"x.y": np.arange(4, dtype=np.float16).reshape(2, 2), "x.z": np.array([7], np.uint8)}
    reference.record("a", "frame 0 + 1/3", first)
    reference.record("a", KEPT_MOMENT, first)
    reference.save(tmp_path / "reference.bin")
    found = Reference.load(tmp_path / "reference.bin")
    assert (found.hashes, found.inputs, found.model) == (reference.hashes, reference.inputs, "m")
    assert {name: array.tolist() for name, array in found.values["a"].items()} == {"x.y": [[0, 1], [2, 3]], "x.z": [7]}


def test_differences_are_told_in_ulp_and_pixels():
    reference, values = Reference(), np.ones((4, 5, 3), np.float16)
    for moment in ("frame 0 + 1/3", KEPT_MOMENT):
        reference.record("a", moment, {"x.color": values, "x.mask": np.zeros((4, 5), np.uint8)})
    other = values.copy()
    other[1, 2] = np.nextafter(np.float16(1), np.float16(2))
    other[3, 4, 0] = np.nextafter(np.float16(1), np.float16(0))
    comparison = BufferComparison(reference, "a")
    comparison.add("frame 0 + 1/3", {"x.color": other, "x.mask": np.zeros((4, 5), np.uint8)})
    comparison.add(KEPT_MOMENT, {"x.color": other, "x.mask": np.zeros((4, 5), np.uint8)})
    (name, found), *others = comparison.different.items()
    assert name == "x.color" and not others and found.moments == ["frame 0 + 1/3", KEPT_MOMENT]
    assert (found.ulp, found.pixels, found.share) == (1, 2, 0.1) and str(found) == "1 ulp, 2 px (10%)"
    assert found.examples[0] == [[1, 2, 0], "1.0", "1.001"]
    assert str(BufferDifference(["frame 0 + 1/3"])) == "differs at 1 moments"
    comparison.add(KEPT_MOMENT, {"x.color": values})  # a buffer that is not made
    assert "x.mask" in comparison.different


def test_ulps():
    tiny = np.float32(1e-45)
    a = np.array([1, -0.0, tiny, np.nan, np.inf, 1], np.float32)
    b = np.array(
        [np.nextafter(np.float32(1), np.float32(2)), 0, -tiny, np.nan, np.finfo(np.float32).max, np.nan], np.float32
    )
    assert ulps(a, b)[:5].tolist() == [1, 0, 2, 0, 1] and ulps(a, b)[5] > 1 << 20
    assert ulps(np.array([250], np.uint8), np.array([1], np.uint8)).tolist() == [249]
    other_nan = np.array([0x7FC00001], np.uint32).view(np.float32)
    assert digest(other_nan) == digest(np.array([np.nan], np.float32))
    assert digest(np.zeros((2, 3), np.uint8)) != digest(np.zeros((3, 2), np.uint8))


@pytest.fixture
def other_kernels(tmp_path, monkeypatch):
    """Kernels that predict positions a little off."""
    folder = shutil.copytree(kernel_folder(), tmp_path / "kernels")
    for path in folder.rglob("*.pyc"):
        path.unlink()
    text = (folder / "prediction.cl").read_text()
    changed = text.replace("pixel_center(", "(1.0f / 1024.0f) + pixel_center(")
    assert changed != text
    (folder / "prediction.cl").write_text(changed)
    monkeypatch.setenv("GFFE_KERNELS", str(folder))


def first_device():
    wanted = os.environ.get("GFFE_DEVICE")
    return next(info for info in list_devices() if info.works and (not wanted or info in report.select([info], wanted)))


def test_what_differs_is_found(other_kernels, gffe, tmp_path, monkeypatch):
    info = first_device()
    little = {"wanted": LITTLE, "networks": False}
    monkeypatch.setattr("gffe_cl.engine.selftest.report.selftest", lambda *a, **more: selftest(*a, **more | little))
    code, printed, _ = gffe(
        "selftest", "--device", info.index, "--report", tmp_path / "r.json", "--json", tmp_path / "j.json"
    )
    assert code == 1 and "differs" in printed and "prediction.target_position" in printed
    told = json.loads((tmp_path / "r.json").read_text())
    assert told["exit_code"] == 1 and told["machine"]["packages"]["numpy"] == np.__version__
    assert {"machine", *json.loads((tmp_path / "j.json").read_text())} == set(told)
    (found,) = told["devices"]
    assert found["verdict"] == "differs" and found["facts"]["max_work_group_size"] > 0
    assert found["different"]["prediction.target_position"]["forms"] == ["own"] and found["other_inputs"] == []
    assert found["forms"][0]["cases"]["paper"]["moments"] == 3


def test_what_cannot_run_is_told(monkeypatch):
    info = first_device()
    found = selftest(info.index, seconds=0.05, wanted=LITTLE, networks=False)
    assert found.exit_code == 2 and found.devices[0].verdict == "failed" and "hangs" in found.devices[0].problem
    refused = replace(info, works=False, problem="driver crashed (exit code -11)")
    monkeypatch.setattr(report, "list_devices", lambda: [refused])
    found = selftest(wanted=LITTLE, networks=False)
    assert found.exit_code == 2 and found.devices[0].verdict == "refused" and "-11" in found.devices[0].problem
    crash = ('selftest: {"doing": "own, paper, frame 0 + 1/3"}\nnoise of a driver\n', "driver crashed (exit code -11)")
    monkeypatch.setattr(report, "list_devices", lambda: [info, refused])
    monkeypatch.setattr(report, "run_child", lambda *_: crash)
    found = selftest(wanted=LITTLE, networks=False)
    assert found.devices[0].problem == "driver crashed (exit code -11), at own, paper, frame 0 + 1/3"
    with pytest.raises(GffeError, match="no device matches 'abacus'"):
        selftest("abacus")


def test_networks_are_judged():
    made = report.SelfTest([report.DeviceResult(None, "equal")], [report.NetworkResult("cpu", report.TOLERANCE / 2)])
    assert made.exit_code == 0
    made.networks.append(report.NetworkResult("cpu", 0.3))
    assert made.exit_code == 1 and made.networks[1].verdict == "differs"
    made.networks[1:] = [report.NetworkResult("cpu", None, "no such library")]
    assert made.exit_code == 2
