"""Forward warp: the kernels against their twins."""

import numpy as np
import pytest
import twins
from twin_cases import assert_close, run

from gffe_cl.engine.options import Options


def test_kernels_equal_their_twins(case):
    """Which fragment lands where, masks and labels exactly; colors, depth and motion to a rounding of a division."""
    now, links = case.now, case.read("connectivity", "links")
    got, dynamic = case.read("prediction", "target_position"), case.read("history", "dynamic_mask")
    target = case.pipeline.sizes.target
    keys = twins.splat(got, now.depth, links, case.zoom, target, case.options.crack_closing)
    warped = twins.resolve(keys, got, now.color, now.depth, dynamic, links, case.zoom, case.sharpness)
    left = case.after("warp")
    for name in ("dynamic", "disoccluded", "filled_by"):
        assert np.array_equal(left[name], warped[name]), name
    for name in ("color", "depth", "motion"):
        assert_close(left[name], warped[name])
    assert warped["disoccluded"].any() and warped["dynamic"].any()


@pytest.mark.parametrize(("size", "target"), [((61, 37), None), ((48, 33), (64, 48)), ((64, 48), (40, 31))])
def test_two_pass_path_gives_the_same_bits(device, size, target):
    """The 32-bit path of the warp equals the 64-bit path, where the device has that."""
    if not device.int64_atomics:
        pytest.skip("device has no 64-bit atomics")
    results = [run(device, *size, Options(), int64, target).made for int64 in (True, False)]
    for name in ("color", "depth", "motion", "dynamic", "disoccluded", "filled_by"):
        a, b = (r.numpy(name) for r in results)
        assert a.tobytes() == b.tobytes(), name
