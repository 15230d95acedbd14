"""NumPy twin of kernels/upscaling.cl; `twins/__init__.py` describes all twins."""

from types import SimpleNamespace

import numpy as np

from gffe_cl.engine.opencl.program import constants
from twins.common import F, centers, invalid
from twins.warp import load_color

UP = SimpleNamespace(**{n: F(v) if isinstance(v, float) else v for n, v in constants("upscaling.cl").items()})
MOST = F(65504)


def mapped(px, mapping):
    return px * mapping[:2] + mapping[2:]


def compressed_of(rgb, exposure):
    """Return (…, 3) tone-mapped (Y, Co, Cg)."""
    c = np.maximum(rgb, F(0)) * F(exposure)
    r, g, b = np.moveaxis(c, -1, 0)
    scale = F(1) / (F(1) + c.max(-1))
    green, others = F(0.5) * g, F(0.25) * (r + b)
    return np.stack([others + green, F(0.5) * (r - b), green - others], -1) * scale[..., None]


def expanded(c, exposure):
    y, o, g = np.moveaxis(c, -1, 0)
    rgb = np.maximum(np.stack([y - g + o, y + g, y - g - o], -1), F(0))
    scale = F(1) / (np.maximum(F(1) - rgb.max(-1), F(1e-4)) * F(exposure))
    return np.minimum(rgb * scale[..., None], MOST)


def _weights(t, slope):
    t2, t3, two, three = t * t, t * t * t, F(2), F(3)
    first, last = slope * (two * t2 - t - t3), slope * (t3 - t2)
    second = F(1) + (slope - three) * t2 + (two - slope) * t3
    return first, second, slope * t + (three - two * slope) * t2 + (slope - two) * t3, last


def cubic_at(px, image):
    """Return `image` (H, W, C) at px (…, 2), with the least and the most of the inner taps."""
    height, width = image.shape[:2]
    corner = px - F(0.5)
    first = np.floor(corner)
    wx, wy = (_weights(t, UP.SHARP_SLOPE) for t in np.moveaxis(corner - first, -1, 0))
    x, y = np.moveaxis(first.astype(int), -1, 0)

    def tap(i, j):
        return image[np.clip(y + j, 0, height - 1), np.clip(x + i, 0, width - 1)]

    taps = [(i, j) for j in range(4) for i in range(4) if i in (1, 2) or j in (1, 2)]  # no corners
    scale = F(1) / sum(wx[i] * wy[j] for i, j in taps)
    total = sum((scale * wy[j] * wx[i])[..., None] * tap(i - 1, j - 1) for i, j in taps)
    inner = np.stack([tap(i, j) for j in (0, 1) for i in (0, 1)])
    low, high = inner.min(0), inner.max(0)
    return np.clip(total, low, high), low, high


def within(px, shape):
    return (px[..., 0] >= 0) & (px[..., 1] >= 0) & (px[..., 0] < shape[1]) & (px[..., 1] < shape[0])


def nearest_around(depth):
    """Return rows and columns of the nearest pixel of another surface in 3×3, else the pixel's own."""
    height, width = depth.shape
    y, x = np.mgrid[:height, :width]
    best_y, best_x = y.copy(), x.copy()
    with np.errstate(invalid="ignore"):
        least = np.where(invalid(depth), F(np.inf), UP.NOT_NEARER * depth)
        for j in (-1, 0, 1):
            for i in (-1, 0, 1):
                ny, nx = np.clip(y + j, 0, height - 1), np.clip(x + i, 0, width - 1)
                z = depth[ny, nx]
                nearer = (z > 0) & (z < least)
                least = np.where(nearer, z, least)
                best_y, best_x = np.where(nearer, ny, best_y), np.where(nearer, nx, best_x)
    return best_y, best_x


def share_seen(px, expected, depth_prev):
    height, width = depth_prev.shape
    corner = px - F(0.5)
    first = np.floor(corner)
    u, v = np.moveaxis(corner - first, -1, 0)
    nearest = np.where(np.isinf(expected), np.finfo(F).max, UP.NOT_NEARER * expected)
    seen = np.zeros(px.shape[:-1], F)
    inside = within(px, depth_prev.shape)
    x, y = np.moveaxis(np.where(inside[..., None], first, 0).astype(int), -1, 0)
    for tap in range(4):
        i, j = tap & 1, tap >> 1
        z = depth_prev[np.clip(y + j, 0, height - 1), np.clip(x + i, 0, width - 1)]
        weight = (u if i else F(1) - u) * (v if j else F(1) - v)
        seen += np.where(~(z < nearest), weight, F(0))
    return np.where(inside, seen, F(0))


def compare(color, depth, motion, depth_prev, history, to_previous, to_previous_display, exposure, has_history):
    """Return compressed (H, W, 4), dilated (H, W, 2), surprise (H, W, 4)."""
    height, width = depth.shape
    near = nearest_around(depth)
    center, moved, z = centers(height, width)[near], motion[near], depth[near]
    inverse = to_previous[4]
    with np.errstate(all="ignore"):
        scale = np.where(np.isinf(z), F(1), z)
        view = np.stack([(center[..., k] - inverse[2 + k]) * inverse[k] * scale for k in (0, 1)] + [scale], -1)
        expected = view @ to_previous[2, :3] + to_previous[2, 3]
        expected = np.where(np.isinf(z), F(np.inf), expected).astype(F)
        seen = np.where(invalid(z), F(0), share_seen(center + moved, expected, depth_prev)) * F(has_history)
        px = mapped(centers(height, width) + moved, to_previous_display)
    own = load_color(color)
    here = compressed_of(own, exposure)
    _, low, high = cubic_at(np.where((seen > 0)[..., None], px, F(1)), history)
    known = (seen > 0)[..., None]
    off = np.where(known, here - compressed_of(np.clip(own, low, high), exposure), F(0))
    dilated = np.where((~invalid(z) & bool(has_history))[..., None], moved, F(np.nan))
    compressed, surprise = np.concatenate([here, seen[..., None]], -1), np.concatenate([off, known], -1)
    return compressed.astype(np.float16), dilated, surprise.astype(np.float16)


def survey(compressed, surprise):
    """Return mean (H, W, 4), deviation (H, W, 4)."""
    height, width = compressed.shape[:2]

    def sums(image):
        c = np.pad(image.astype(F), ((1, 1), (1, 1), (0, 0)), mode="edge")
        around = np.stack([c[j : j + height, i : i + width] for j in range(3) for i in range(3)])
        return around.sum(0), (around * around).sum(0)

    (total, square), (off, off_square) = sums(compressed), sums(surprise)
    mean = total * F(1 / 9)
    variance = np.maximum(square * F(1 / 9) - mean * mean, F(0))[..., :3]
    known = np.maximum(off[..., 3], F(1))
    bias = off[..., 0] / known
    scatter = np.maximum(off_square[..., 0] / known - bias * bias, F(0))
    shift = bias * (bias * bias / (bias * bias + UP.SCATTER * scatter + F(1e-8)))
    missed = np.maximum(off_square[..., :3].sum(-1) / known - shift * (F(2) * bias - shift), F(0))
    error = np.sqrt(missed / (variance.sum(-1) + UP.COMPRESSED_NOISE * UP.COMPRESSED_NOISE))
    error = np.minimum(error, UP.MOST_ERROR)
    mean = np.concatenate([mean[..., :3], error[..., None]], -1)
    return mean.astype(np.float16), np.concatenate([np.sqrt(variance), shift[..., None]], -1).astype(np.float16)


_THREE = np.array([-1, 0, 1], F)


def _near_weights(off, step):
    t = (off[..., None] + _THREE * step) * (F(1) / UP.FILTER_REACH)
    return np.maximum(F(1) - t * t, F(0)) ** 3


def _far_weights(off):
    t = np.clip(off, F(-1), F(1))[..., None] + _THREE
    return np.maximum(F(1) - t * t, F(0)) ** 2


def _lock(before, right, seen):
    counted = np.clip(before + np.where(right, F(1), F(-1)), F(0), UP.LOCK_FRAMES)
    following = np.where(before > UP.LOCK_FRAMES, before - F(1), counted)
    return np.where((seen < UP.MET) & (before >= UP.SETTLED), F(UP.THIN), following)


def accumulate(
    size, to_render, to_previous_display, exposure, has_history, compressed, dilated, mean, deviation, state
):
    """Return history (H, W, 4), lock (H, W), share of the history that is rejected (H, W) float; `state`: history and
    lock before."""
    width, height = size
    rows, columns = dilated.shape[:2]
    compressed, mean, deviation = (a.astype(F) for a in (compressed, mean, deviation))
    px = mapped(centers(height, width), to_render)
    x = np.clip(np.floor(px[..., 0]).astype(int), 0, columns - 1)
    y = np.clip(np.floor(px[..., 1]).astype(int), 0, rows - 1)
    off = np.stack([x, y], -1).astype(F) + F(0.5) - px
    step = F(1) / to_render[:2]

    def summed(wx, wy):
        return sum(
            (wy[..., j] * wx[..., i])[..., None]
            * compressed[np.clip(y + j - 1, 0, rows - 1), np.clip(x + i - 1, 0, columns - 1)]
            for j in range(3)
            for i in range(3)
        )

    wx, wy = (_near_weights(off[..., k] * step[k], step[k]) for k in (0, 1))
    near, total = summed(wx, wy), wx.sum(-1) * wy.sum(-1)
    wx, wy = (_far_weights(off[..., k]) for k in (0, 1))
    fresh = summed(wx, wy) / (wx.sum(-1) * wy.sum(-1))[..., None]
    history, lock = state[0].astype(F), state[1]
    px_previous = mapped(px + dilated[y, x], to_previous_display)
    known = within(px_previous, (height, width)) & bool(has_history)
    at = np.where(known[..., None], px_previous, F(0))
    motion = np.abs(at - centers(height, width)).sum(-1)
    rest = F(1) / (F(1) + UP.UNREST * motion * motion)
    middle, around, seen = mean[y, x], deviation[y, x], fresh[..., 3]
    trust = np.maximum(F(1) - middle[..., 3] / (UP.WRONG + (UP.WRONG_AT_REST - UP.WRONG) * rest), F(0))
    before = lock[at[..., 1].astype(int), at[..., 0].astype(int)].astype(F)
    locked = np.where(known & (motion < UP.AT_REST), _lock(before, trust * seen >= UP.AGREED, seen), F(0))
    thin = locked > UP.LOCK_FRAMES
    found, _, _ = cubic_at(at, history)
    past = compressed_of(found[..., :3], exposure)
    past = past * (np.maximum(past[..., :1] + around[..., 3:], F(0)) / (past[..., :1] + F(1e-4)))
    room = UP.DEVIATIONS * around[..., :3] + UP.COMPRESSED_NOISE + np.where(thin, UP.LOCKED_ROOM, F(0))[..., None]
    kept = np.minimum(np.maximum(past, middle[..., :3] - room), middle[..., :3] + room)
    believed = np.where(known, trust * np.where(thin, F(1), seen), F(0))
    most = UP.MOVED_WEIGHT + (UP.MOST_WEIGHT - UP.MOVED_WEIGHT) * rest
    own = np.where(known, np.minimum(found[..., 3] * believed, most), F(0))
    held = np.maximum(own, UP.LEAST_SHOWN)
    part = np.minimum(own * (F(1) / UP.LEAST_SHOWN), F(1))[..., None]
    past = np.where(known[..., None], kept + (fresh[..., :3] - kept) * (UP.FRESH * (F(1) - part)), fresh[..., :3])
    counted = np.where(known, part[..., 0], F(1))
    total = counted * total + held
    mixed = (counted[..., None] * near[..., :3] + held[..., None] * past) / total[..., None]
    now = expanded(mixed, exposure)
    weight = np.minimum(total, UP.MOST_WEIGHT)
    return np.concatenate([now, weight[..., None]], -1).astype(np.float16), locked.astype(np.uint8), F(1) - believed


def generate(depth, motion, disoccluded, gae, color, history, to_shown):
    """Return a generated frame (H, W, 3)."""
    height, width = depth.shape
    near = nearest_around(depth)
    center = centers(height, width)[near]
    px = centers(height, width) + (mapped(center + motion[near], to_shown) - center)
    seen = (disoccluded == 0) & (disoccluded[near] == 0) & within(px, depth.shape)
    past, _, _ = cubic_at(np.where(seen[..., None], px, F(1)), history[..., :3].astype(F))
    own = load_color(color)
    changed = np.clip(past + (own - load_color(gae)), F(0), MOST)
    return np.where(seen[..., None], changed, own).astype(np.float16)
