"""Twin of prediction.cl."""

import numpy as np

from twins.common import F, centers, invalid, kernel_constants, move, project, reproject, unproject

PREDICTION = kernel_constants("prediction.cl")


def entering_depth(depth, motion, dynamic, met_depth, to_previous, previous_inverse):
    """Return `met_depth` (H, W) with the depth in the frame before of dynamic fragments that it does not show.
    `previous_inverse`: 1 / fx, 1 / fy, cx, cy of that frame."""
    height, width = depth.shape
    px = centers(height, width)
    before = px + motion
    with np.errstate(invalid="ignore"):
        out = np.maximum(-before, before - np.array((width, height), F))
        entered = (dynamic > 0) & ~(met_depth > 0) & (out.max(-1) <= PREDICTION.ENTERS_FROM * width)
        static = reproject(px, depth, to_previous)[..., 2]
        rested = move(unproject(px, depth, to_previous[4]), to_previous)
        a = (before - previous_inverse[2:]) * previous_inverse[:2]
        known = np.abs(motion).sum(-1) <= 2 * width
    found = met_depth.copy()
    least = (PREDICTION.LEAST_SPREAD * previous_inverse[0]) ** 2
    for y, x in np.argwhere(entered):
        axis = int(out[y, x, 0] < out[y, x, 1])
        d = [0, 0]
        d[axis] = 1 if before[y, x, axis] < 0 else -1
        z = depth[y, x]
        found[y, x] = max(static[y, x], 0)
        if not out[y, x].max() > 0:
            continue
        met, ratio = [], None
        for way in (1, -1):
            z_before = z
            for k in range(0 if way > 0 else 1, PREDICTION.INWARD_STEPS + 1):
                step = k * way * PREDICTION.INWARD_STEP
                there = y + step * d[1], x + step * d[0]
                if not (0 <= there[0] < height and 0 <= there[1] < width) or dynamic[there] != PREDICTION.DYNAMIC:
                    break
                if not abs(depth[there] - z_before) <= PREDICTION.ONE_MOVER * z_before:
                    break
                if ratio is None and met_depth[there] > 0:
                    ratio = met_depth[there] / depth[there]
                if ratio is not None or not known[there]:
                    break
                met.append(there)
                z_before = depth[there]
        if ratio is not None:
            found[y, x] = z * ratio
        elif met:
            at = tuple(np.transpose(met))
            slopes, offsets = a[at], a[at] * rested[at][:, 2:] - rested[at][:, :2]
            came = depth_translation(slopes, offsets, least)
            found[y, x] = max(static[y, x] + came, PREDICTION.LEAST_BEFORE * z)
    return found


def depth_translation(a, b, least):
    """Return the z of the translation T with T.xy − a T.z = b for all rows of `a` and `b`, (N, 2) float32, by least
    squares."""
    a_sum, b_sum, aa, ab = np.zeros(2, F), np.zeros(2, F), F(0), F(0)
    for one, other in zip(a, b, strict=True):
        a_sum, b_sum = a_sum + one, b_sum + other
        aa += one[0] * one[0] + one[1] * one[1]
        ab += one[0] * other[0] + one[1] * other[1]
    share = F(1) / F(len(a))
    aa -= share * (a_sum[0] * a_sum[0] + a_sum[1] * a_sum[1])
    ab -= share * (a_sum[0] * b_sum[0] + a_sum[1] * b_sum[1])
    return -(ab / (aa + F(len(a)) * least))


def _bent(depth, movers, carried, alpha):
    """Return the displacement (H, W, 3) by acceleration after `alpha` intervals: that of the cells around whose mover
    each fragment may belong to, interpolated."""
    velocity, acceleration, bend, seen = movers
    side, cells = F(PREDICTION.MOVER_CELL), velocity.shape[:2]
    at = centers(*depth.shape) / side - F(0.5)
    first = np.floor(at).astype(int)
    total, weights = np.zeros((*depth.shape, 3), F), np.zeros(depth.shape, F)
    for tap in range(4):
        x, y = first[..., 0] + (tap & 1), first[..., 1] + (tap >> 1)
        inside = (x >= 0) & (x < cells[1]) & (y >= 0) & (y < cells[0])
        cell = np.clip(y, 0, cells[0] - 1), np.clip(x, 0, cells[1] - 1)
        z = velocity[cell][..., 3]
        with np.errstate(invalid="ignore"):
            counts = inside & (np.abs(depth - z) <= F(PREDICTION.CELL_TOLERANCE) * z)
        counts &= (acceleration[cell][..., 3] >= 0) & (bend[cell][..., 3] >= 0) & ((seen[cell][..., 3] > 0) == carried)
        u, v = np.moveaxis((at - first).astype(F), -1, 0)
        weight = np.where(counts, (u if tap & 1 else 1 - u) * (v if tap >> 1 else 1 - v), F(0))
        part = acceleration[cell][..., 3:] * acceleration[cell][..., :3] + (F(alpha) + 2) / F(3) * bend[cell][..., :3]
        total, weights = total + weight[..., None] * part, weights + weight
    mean = total / np.where(weights > 0, weights, F(1))[..., None]
    return F(alpha) * (F(alpha) + F(1)) * mean


def predict_positions(depth, dynamic, history, order, weights, to_target, alpha=0, movers=None, in_previous=None):
    """Return (H, W, 3) float32: px in the target image, view depth (−1: nothing). `movers`: velocity, acceleration, its
    change, and velocity in view space, of cells, where acceleration is used; `in_previous`, with them:
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
        carried = near & (seen[..., 3] > 0)
        step = np.where(spins[..., None], F(alpha) * bend[..., :3], _bent(depth, movers, carried, alpha))
        predicted = np.where(spins[..., None], p0, predicted)
        predicted = np.where(((known > 0) & near)[..., None], predicted + step, predicted)
    target = move(predicted, to_target)
    if movers:
        carried &= known > 0
        linear = np.where(spins[..., None], F(0), weights[0, 0] * (in_previous - p0))
        target = np.where(carried[..., None], p0 + (linear + step), target)
    moved = np.concatenate([project(target, to_target[5]), target[..., 2:]], -1)
    out[dynamic > 0] = moved[dynamic > 0]
    fixed = dynamic == PREDICTION.FIXED_TO_CAMERA
    out[fixed] = np.concatenate([project(p0, to_target[5]), depth[..., None]], -1)[fixed]
    out[invalid(depth) | ~(out[..., 2] > 0)] = (PREDICTION.NOWHERE, PREDICTION.NOWHERE, -1)
    return out
