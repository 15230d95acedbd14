"""Every kernel leaves the recorded bits, on every device, with one and with eight lanes, and by either path of the
warp: the oracle of kernels whose NumPy form would only repeat them."""

import json

import pytest
from recorded_bits import CASES, PATH, digests_of

RECORDED = json.loads(PATH.read_text())


@pytest.mark.parametrize("name", CASES)
def test_every_stage_leaves_the_recorded_bits(device, lanes, name):
    assert digests_of(device, CASES[name]) == RECORDED[name]
