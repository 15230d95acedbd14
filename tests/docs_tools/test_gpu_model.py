"""The model of GPUs in docs/performance.md is the arithmetic that the page describes."""

from dataclasses import replace
from functools import partial

import gpu_model
import pytest
from gpu_model import GPUS, HARSH, KIND, SCENE, Gpu, convolutions, model
from pages import recorded

DISCRETE = GPUS[0]


@pytest.mark.parametrize("gpu", GPUS, ids=lambda gpu: gpu.compiled)
@pytest.mark.parametrize("of", [partial(model, group="GAE"), partial(model, group="SCN"), convolutions])
def test_the_harsh_end_takes_longer(gpu, of):
    kind, harsh = (vars(of(gpu, assumed)) for assumed in (KIND, HARSH))
    for part, milliseconds in kind.items():
        assert milliseconds <= harsh[part], part
    for times in (kind, harsh):
        longer = max(times["instructions"], times["memory"])
        assert longer <= times["gpu"] - times["commands"] <= times["instructions"] + times["memory"] + 1e-12


def test_memory_is_what_caches_leave_of_loads_and_stores():
    whole, half = (model(DISCRETE, replace(KIND, caches=share), "GAE").memory for share in (1.0, 0.5))
    assert whole == pytest.approx(2 * half) and model(DISCRETE, replace(KIND, caches=0.0), "GAE").memory == 0.0


def test_the_model_of_convolutions_holds_what_was_measured():
    """On a GPU whose data sheet is known: 132 multiprocessors at 1.755 GHz, 3350 GB/s."""
    h100 = Gpu("H100", "sm_86", 32, 132 * 128 * 1.755, 3350)
    measured = recorded("gpu")["devices"][0]
    assert "H100" in measured["device"]
    kind, harsh = (convolutions(h100, assumed).gpu for assumed in (KIND, HARSH))
    assert kind < measured["sizes"][0]["milliseconds"]["SCN, convolutions"] < harsh


def test_a_slower_gpu_and_more_commands_take_longer():
    slow = replace(DISCRETE, instructions=DISCRETE.instructions / 2)
    fast, half = (model(gpu, KIND, "GAE") for gpu in (DISCRETE, slow))
    assert half.instructions == pytest.approx(2 * fast.instructions) and half.memory == fast.memory
    commands = recorded("memory")[SCENE]["commands"]["GAE"]
    assert model(DISCRETE, replace(KIND, per_command=1000), "GAE").commands == pytest.approx(commands)


def test_low_occupancy_hides_less_latency(monkeypatch):
    whole = recorded("gpu_compilers")
    for costs in whole["kernels"].values():
        costs["sm_86"]["occupancy"] = 0.25
    before = model(DISCRETE, KIND, "GAE").instructions
    monkeypatch.setattr(gpu_model, "recorded", lambda name: whole if name == "gpu_compilers" else recorded(name))
    assert model(DISCRETE, KIND, "GAE").instructions > 1.5 * before
