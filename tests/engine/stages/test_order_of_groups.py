"""Work-groups of a launch may run in any order: results have the same bits."""

from collections import defaultdict
from itertools import product

import numpy as np
import pyopencl as cl
import pytest
from twin_cases import run

from gffe_cl.engine.options import Options

pytestmark = pytest.mark.device
W, H = 48, 150
OPTIONS = Options(shading_correction=False, levels=2)
# Kernels in which several work-groups change one place, by atomics, or append to one list.
SHARING = (
    "measure_samples",
    "find_reach",
    "splat",
    "scatter_level",
    "scatter_hidden",
    "offer_hidden",
    "resolve",
    "fill_hidden_parts",
    "soften",
)


def in_shuffled_pieces(monkeypatch):
    """Enqueue each work-group of the kernels `SHARING` on its own, in a random order. Returns in how many, by
    kernel, for each launch."""
    enqueue, random, pieces = cl.enqueue_nd_range_kernel, np.random.default_rng(1), defaultdict(list)

    def shuffled(queue, kernel, size, group):
        if kernel.function_name not in SHARING:
            return enqueue(queue, kernel, size, group)
        starts = list(product(*(range(0, items, step) for items, step in zip(size, group, strict=True))))
        for k in random.permutation(len(starts)):
            event = enqueue(queue, kernel, group, group, starts[k])
        pieces[kernel.function_name].append(len(starts))
        return event

    monkeypatch.setattr(cl, "enqueue_nd_range_kernel", shuffled)
    return pieces


def bits(pipeline):
    """All buffers of the last frames that are of interest afterwards, by name."""
    owners = {"frame": pipeline.board.frame} | pipeline.stages
    return {
        f"{owner}.{spec.name}": stage.read(spec.name).tobytes()
        for owner, stage in owners.items()
        for spec in stage.buffers
        if not spec.scratch
    }


@pytest.mark.parametrize("lanes", [pytest.param(8, marks=pytest.mark.long), 1], indirect=True)
def test_the_order_of_work_groups_changes_no_bit(device, lanes, monkeypatch):
    expected = bits(run(device, W, H, OPTIONS).pipeline)
    pieces = in_shuffled_pieces(monkeypatch)
    found = bits(run(device, W, H, OPTIONS).pipeline)
    assert all(min(pieces[name], default=0) > 1 for name in SHARING), pieces
    assert [name for name in expected if found[name] != expected[name]] == []
