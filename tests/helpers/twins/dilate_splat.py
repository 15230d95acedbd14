"""Twin of baselines/dilate_splat.cl."""

import numpy as np

from twins.common import COLOR_MAX, NOBODY, F, centers, kernel_constants

SPLAT = kernel_constants("baselines/dilate_splat.cl")
ROWS = np.arange(-1, 2)
TAPS = np.roll(np.stack(np.meshgrid(ROWS, ROWS, indexing="ij"), -1).reshape(9, 2), -4, axis=0)  # y, x; (0, 0) first
NOTHING = np.iinfo(np.uint64).max


def dilate(depth):
    """Return the least depth (H, W) of each 3x3 and the index of its pixel; of sky the pixel's own."""
    height, width = depth.shape
    y, x = np.mgrid[:height, :width]
    least, nearest = np.full(depth.shape, np.inf, F), y * width + x
    for dy, dx in TAPS:
        tap_y, tap_x = np.clip(y + dy, 0, height - 1), np.clip(x + dx, 0, width - 1)
        z = depth[tap_y, tap_x]
        nearer = (z > 0) & (z < least)
        least, nearest = np.where(nearer, z, least), np.where(nearer, tap_y * width + tap_x, nearest)
    return least, nearest


def dilate_splat(depth, motion, alpha):
    """Return keys (H, W) uint64 that the splat leaves: depth bits << 32 | word, or all bits."""
    height, width = depth.shape
    least, nearest = dilate(depth)
    move = -F(alpha) * motion.reshape(-1, 2)[nearest]
    px = centers(height, width) + move
    with np.errstate(invalid="ignore"):
        lands = (np.abs(move) <= SPLAT.LONGEST).all(-1) & (px >= 0).all(-1) & (px < (width, height)).all(-1)
    half_words = (move[lands] * SPLAT.STEPS + (SPLAT.ZERO + F(0.5))).astype(np.uint64)
    words = half_words[:, 1] << np.uint64(16) | half_words[:, 0]
    dst = px[lands].astype(int)
    keys = np.full((height, width), NOTHING)
    offers = least[lands].view(np.uint32).astype(np.uint64) << np.uint64(32) | words
    np.minimum.at(keys, (dst[:, 1], dst[:, 0]), offers)
    return keys


def with_neighbors(keys, accepts=lambda y, x, offered: np.ones(len(offered), bool)):
    """Return keys in which pixels that none reached have the least of the nearest ring around them that `accepts`
    accepts for the pixel, if there is one."""
    found = keys.copy()
    for y, x in np.argwhere(words_of(keys) == NOBODY):
        for reach in range(1, SPLAT.FILL_REACH + 1):
            first_y, first_x = max(y - reach, 0), max(x - reach, 0)
            around = keys[first_y : y + reach + 1, first_x : x + reach + 1]
            ring_y, ring_x = np.mgrid[: around.shape[0], : around.shape[1]]
            ring = np.maximum(abs(ring_y + first_y - y), abs(ring_x + first_x - x)) == reach
            offered = np.unique(around[ring & (words_of(around) != NOBODY)])  # the least first
            if (accepted := offered[accepts(y, x, offered)]).size:
                found[y, x] = accepted[0]
                break
    return found


def components(words):
    """Return the vectors (…, 2) in words."""
    return (np.stack([words & 0xFFFF, words >> 16], -1).astype(F) - SPLAT.ZERO) * (F(1) / SPLAT.STEPS)


def warp_back(keys, motion, color, alpha):
    """Return color (H, W, 4) float32 of the new frame from those keys; of `color` as halfs."""
    height, width = keys.shape
    filling = with_neighbors(keys)
    move = components(words_of(filling))
    own = -F(alpha) * motion
    move = np.where((filling == NOTHING)[..., None], np.where(np.isnan(own), F(0), own), move)
    px = np.clip(centers(height, width) - F(0.5) - move, 0, F((width - 1, height - 1)))
    first = px.astype(int)
    u, v = np.moveaxis((px - first.astype(F))[..., None], 2, 0)
    (x, y), texels = np.moveaxis(first, -1, 0), color.astype(F)
    right, below = np.minimum(x + 1, width - 1), np.minimum(y + 1, height - 1)
    with np.errstate(invalid="ignore", over="ignore"):
        mixed = (1 - v) * ((1 - u) * texels[y, x] + u * texels[y, right]) + v * (
            (1 - u) * texels[below, x] + u * texels[below, right]
        )
    return np.clip(np.nan_to_num(mixed, nan=0.0), -COLOR_MAX, COLOR_MAX)


def words_of(keys):
    return (keys & np.uint64(NOBODY)).astype(np.uint32)
