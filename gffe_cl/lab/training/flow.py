"""Flow of shading between two frames, by least squares (Lucas and Kanade, 1981), coarse to fine.

The shading correction network may follow it (`network.ShadingCorrectionNetwork`). This is the version for training; the
pipeline uses kernels/shading_flow.cl.
"""

from __future__ import annotations

import torch
import torch.nn.functional as functional
from torch import Tensor

from gffe_cl.lab.training.images import double, halve, warp

_LEVELS = 3
_STEPS = 2  # per level
_FLAT = 1e-4  # squared gradient of encoded color below which nothing moves
_LONGEST = 2.0  # pixels of a step


def find_flow(now: Tensor, before: Tensor, repeated: Tensor) -> tuple[Tensor, Tensor]:
    """Return the flow and its errors. The content at x in `now` is at x + flow[x] in `before`, both (N, 1, h, w), sides
    multiples of 8.

    The flow is (N, 2, h, w) in pixels. The errors are (N, 4, h, w) mean squared differences around: of `now` from
    `before` as it is and along the flow, and of that change from the one of the interval before, `repeated` (N, 1, h,
    w), as it is and along the flow. Sums are over some 6×6 pixels of each level; the flow of every second pixel is
    found.
    """
    images = [(now, before)]
    while len(images) < _LEVELS:
        a, b = images[-1]
        images.append((halve(a), halve(b)))
    flow = None
    for a, b in reversed(images):
        height, width = a.shape[-2] // 2, a.shape[-1] // 2
        flow = a.new_zeros(a.shape[0], 2, height, width) if flow is None else 2.0 * double(flow)
        for _ in range(_STEPS):
            flow = flow + _step(a, warp(b, double(flow)))
    assert flow is not None
    finest = double(flow)
    squares = halve(torch.cat((before - now, warp(before, finest) - now), 1).square())
    changed = halve(now - before)
    again = torch.cat((changed - halve(repeated), changed - warp(repeated, flow)), 1).square()
    return finest, double(_means(torch.cat((squares, again), 1)))


def _step(a: Tensor, b: Tensor) -> Tensor:
    """Return by how much to move b, by least squares, to equal a; at half the resolution, in pixels of a."""
    x, y = _gradient(a + b)
    rest = 4.0 * (b - a)
    xx, xy, yy, xr, yr = _mean_around(torch.cat((x * x, x * y, y * y, x * rest, y * rest), 1)).split(1, 1)
    xx, yy = xx + _FLAT, yy + _FLAT
    step = torch.cat((xy * yr - yy * xr, xy * xr - xx * yr), 1) / (xx * yy - xy * xy)
    return step / (step.abs().amax(1, keepdim=True) / _LONGEST).clamp(min=1)


def _gradient(image: Tensor) -> tuple[Tensor, Tensor]:
    """Return twice the gradient along x and y."""
    padded = functional.pad(image, (1, 1, 1, 1), mode="replicate")
    return padded[..., 1:-1, 2:] - padded[..., 1:-1, :-2], padded[..., 2:, 1:-1] - padded[..., :-2, 1:-1]


def _mean_around(image: Tensor) -> Tensor:
    """Return means of 3×3 pixels at half the resolution."""
    return _means(halve(image))


def _means(image: Tensor) -> Tensor:
    """Return means of the 3×3 pixels around each, or at borders of those that exist."""
    return functional.avg_pool2d(image, 3, 1, 1, count_include_pad=False)
