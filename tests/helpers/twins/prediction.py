"""Twin of prediction.cl."""

import numpy as np

from twins.common import F, centers, invalid, kernel_constants, move, project, reproject, unproject

PREDICTION = kernel_constants("prediction.cl")


def entering_depth(depth, motion, dynamic, met_depth, to_previous):
    """Return `met_depth` (H, W) with the depth in the frame before of dynamic fragments that it does not show."""
    height, width = depth.shape
    px = centers(height, width)
    before = px + motion
    size = np.array((width, height), F)
    with np.errstate(invalid="ignore"):
        close = (np.abs(before - F(0.5) * size) <= F(0.5) * size + F(PREDICTION.ENTERS_FROM) * F(width)).all(-1)
        static = reproject(px, depth, to_previous)[..., 2]
    return np.where((dynamic > 0) & ~(met_depth > 0) & close, np.maximum(static, F(0)), met_depth)


def predict_positions(depth, dynamic, history, order, weights, to_target, alpha=0, movers=None, in_previous=None):
    """Return (H, W, 3) float32: px in the target image, view depth (−1: nothing). `movers`: velocity, acceleration, the
    part of it that goes on, and velocity in view space, of cells, where acceleration is used; `in_previous`, with them:
    P_1 in the view space of the frame before."""
    px = centers(*depth.shape)
    out = reproject(px, depth, to_target)
    p0 = unproject(px, depth, to_target[4])
    known = np.cumprod(history[:order, ..., 3] != 0, axis=0).sum(0)
    predicted = p0.copy()
    for k in range(order):
        weight = np.where(known > 0, weights[np.maximum(known, 1) - 1, k], F(0))
        step = weight[..., None] * (history[k, ..., :3] - p0)
        predicted = np.where((known > k)[..., None], predicted + step, predicted)
    if movers:
        height, width = depth.shape
        side = PREDICTION.MOVER_CELL
        velocity, _, bend, seen = (a.repeat(side, 0).repeat(side, 1)[:height, :width] for a in movers)
        with np.errstate(invalid="ignore"):
            near = np.abs(depth - velocity[..., 3]) <= PREDICTION.CELL_TOLERANCE * velocity[..., 3]
        spins = near & (bend[..., 3] < 0)
        step = np.where(spins, F(1), F(alpha) + F(1))[..., None] * (F(alpha) * bend[..., :3])
        predicted = np.where(spins[..., None], p0, predicted)
        predicted = np.where(((known > 0) & near)[..., None], predicted + step, predicted)
    target = move(predicted, to_target)
    if movers:
        carried = (known > 0) & near & (seen[..., 3] > 0)
        linear = np.where(spins[..., None], F(0), weights[0, 0] * (in_previous - p0))
        target = np.where(carried[..., None], p0 + (linear + step), target)
    moved = np.concatenate([project(target, to_target[5]), target[..., 2:]], -1)
    out[dynamic > 0] = moved[dynamic > 0]
    fixed = dynamic == PREDICTION.FIXED_TO_CAMERA
    out[fixed] = np.concatenate([project(p0, to_target[5]), depth[..., None]], -1)[fixed]
    out[invalid(depth) | ~(out[..., 2] > 0)] = (PREDICTION.NOWHERE, PREDICTION.NOWHERE, -1)
    return out
