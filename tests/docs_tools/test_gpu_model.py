"""The model of GPUs in docs/performance.md is the arithmetic that the page describes."""

from dataclasses import replace

import gpu_model
import pytest
from gpu_model import GPUS, HARSH, KIND, PIXELS, SCENE, model
from pages import recorded

DISCRETE, INTEGRATED = GPUS


@pytest.mark.parametrize("gpu", GPUS, ids=lambda gpu: gpu.compiled)
@pytest.mark.parametrize("group", ["GAE", "SCN"])
def test_the_harsh_end_takes_longer(gpu, group):
    kind, harsh = (vars(model(gpu, assumed, group)) for assumed in (KIND, HARSH))
    for part, milliseconds in kind.items():
        assert milliseconds <= harsh[part], part
    for times in (kind, harsh):
        longer = max(times["instructions"], times["memory"])
        assert longer <= times["gpu"] - times["commands"] <= times["instructions"] + times["memory"]


def test_memory_is_what_must_move():
    """At the bandwidth of the data sheet, with perfect caches."""
    times = model(DISCRETE, replace(KIND, caches=1.0, bandwidth=1.0), "GAE")
    assert model(DISCRETE, replace(KIND, caches=0.0), "GAE").memory == 0.0
    must_move = recorded("must_move")[SCENE]["must_move"]["GAE"] * PIXELS / (DISCRETE.bandwidth * 1e6)
    assert times.memory == pytest.approx(must_move, rel=0.2)  # the traffic is that of a part of the same scene


def test_only_a_discrete_gpu_copies_what_the_network_reads():
    assert model(INTEGRATED, HARSH, "SCN").pcie == model(DISCRETE, HARSH, "GAE").pcie == 0.0
    nbytes = gpu_model.bytes_to_network()
    assert model(DISCRETE, replace(KIND, pcie=1.0), "SCN").pcie == pytest.approx(nbytes / (DISCRETE.pcie * 1e6))


def test_a_slower_gpu_and_more_commands_take_longer():
    slow = replace(DISCRETE, instructions=DISCRETE.instructions / 2)
    fast, half = (model(gpu, KIND, "GAE") for gpu in (DISCRETE, slow))
    assert half.instructions == pytest.approx(2 * fast.instructions) and half.memory == fast.memory
    commands = recorded("must_move")[SCENE]["commands"]["GAE"]
    assert model(DISCRETE, replace(KIND, per_command=1000), "GAE").commands == pytest.approx(commands)


def test_low_occupancy_hides_less_latency(monkeypatch):
    whole = recorded("gpu_compilers")
    for costs in whole["kernels"].values():
        costs["sm_86"]["occupancy"] = 0.25
    before = model(DISCRETE, KIND, "GAE").instructions
    monkeypatch.setattr(gpu_model, "recorded", lambda name: whole if name == "gpu_compilers" else recorded(name))
    assert model(DISCRETE, KIND, "GAE").instructions > 1.5 * before
