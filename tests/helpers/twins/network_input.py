"""Twin of network_input.cl, and of the μ-law."""

import numpy as np

from twins.common import COLOR_MAX, F, kernel_constants, load_color
from twins.shading import SHADING

NETWORK_INPUT = kernel_constants("network_input.cl")


def encode(color, exposure):
    """Return the μ-law code ln(1 + μ · exposure · c / 8) / ln(1 + μ) for μ = 5000; negative color is black."""
    return log(F(1) + F(5000 * exposure / 8) * np.maximum(color, F(0))) * F(1 / np.log1p(5000))


def _parts(x):
    """Return mantissa and exponent of the power of two within sqrt(2)."""
    bits = x.view(np.int32)
    exponent = (bits - 0x3F3504F3) >> 23
    return (bits - (exponent << 23)).view(F), exponent


def log(x):
    return _log_of_parts(*_parts(x))


def _log_of_product(a, b):
    (mantissa_a, of_a), (mantissa_b, of_b) = _parts(a), _parts(b)
    mantissa, more = _parts(mantissa_a * mantissa_b)
    return _log_of_parts(mantissa, of_a + of_b + more)


def _log_of_parts(mantissa, exponent):
    e, m = exponent.astype(F), mantissa - F(1)
    y = F(7.0376836292e-2)
    for c in (-1.1514610310e-1, 1.1676998740e-1, -1.2420140846e-1, 1.4249322787e-1, -1.6668057665e-1, 2.0000714765e-1):
        y = y * m + F(c)
    y = (y * m + F(-2.4999993993e-1)) * m + F(3.3333331174e-1)
    z = m * m
    y = y * m * z - F(2.12194440e-4) * e - F(0.5) * z
    return m + y + F(0.693359375) * e


def decode(encoded, exposure):
    x = np.minimum(np.maximum(encoded, F(0)) * F(np.log1p(5000)), F(88))
    return np.minimum(exp_less_one(x) * F(8 / (5000 * exposure)), COLOR_MAX)


def exp_less_one(x):
    """Return exp(x) − 1 for x from 0 to 88."""
    n = np.floor(x * F(1.44269504088896341) + F(0.5))
    r = x - n * F(0.693359375) + n * F(2.12194440e-4)
    y = F(1.9875691500e-4)
    for c in (1.3981999507e-3, 8.3334519073e-3, 4.1665795894e-2, 1.6666665459e-1, 5.0000001201e-1):
        y = y * r + F(c)
    power = ((np.nan_to_num(n).astype(np.int32) + 127) << 23).view(F)
    return (y * r * r + r) * power + (power - F(1))


def depth_median(depth):
    """Return the middle of the bin, 1/128 of a power of two wide, that holds the median of a lattice's finite depths; 1
    without."""
    width, height = NETWORK_INPUT.LATTICE_X, NETWORK_INPUT.LATTICE_Y
    y, x = ((2 * np.arange(n) + 1) * size // (2 * n) for n, size in zip((height, width), depth.shape, strict=True))
    depth = depth[np.ix_(y, x)]
    bits = np.sort(depth[np.isfinite(depth) & (depth > 0)].view(np.uint32))
    if not len(bits):
        return F(1)
    rest = 31 - NETWORK_INPUT.ROUNDS
    return np.array([bits[(len(bits) + 1) // 2 - 1] >> rest << rest | 1 << (rest - 1)], np.uint32).view(F)[0]


def network_input(frame, previous, mask, exposure, network_size, past, to_previous):
    """Return (8, h, w) float32 from the GAE `frame`, its pixels' warped previous frame (H, W, 4) and input mask (H, W),
    and the `past` frame, in which 2×2 pixels of one surface are looked up together."""
    color, depth = load_color(frame["color"]), frame["depth"]
    inverse = np.minimum(depth_median(depth) / depth, NETWORK_INPUT.MAX_INVERSE_DEPTH)
    (height, width), (w, h) = depth.shape, network_size
    j, i = np.mgrid[:h, :w]

    def taps(image):
        return [
            image[np.minimum(2 * j + (tap >> 1), height - 1), np.minimum(2 * i + (tap & 1), width - 1)]
            for tap in range(4)
        ]

    def mean(image):
        a, b, c, d = taps(image)
        return F(0.25) * ((a + b) + (c + d))

    before = taps(load_color(previous))
    smooth, seen = quads(frame, [F(1) / z for z in taps(depth)], taps, past, to_previous)
    smooth &= (2 * i + 2 <= width) & (2 * j + 2 <= height)
    before = [np.where(smooth[..., None], a, b) for a, b in zip(seen, before, strict=True)]
    lifted = [[F(1) + F(5000 * exposure / 8) * np.maximum(c, F(0)) for c in image] for image in (taps(color), before)]
    colors = [_log_of_product(a * c, b * d) * (F(0.25) * F(1 / np.log1p(5000))) for a, b, c, d in lifted]
    total = np.stack([mean(inverse), mean(mask.astype(F))], -1)
    return np.moveaxis(np.concatenate([*colors, total], -1), -1, 0)


def quads(frame, nearness, taps, past, to_previous):
    """Return whether 2×2 pixels show one surface that was in the previous image (h, w), and their colors there (4 × (h,
    w, 3)), with the GAE colors where it is hidden."""
    height, width = past.depth.shape
    rows, (source_inverse, target) = to_previous[:3], to_previous[4:6]
    mean = F(0.25) * ((nearness[0] + nearness[1]) + (nearness[2] + nearness[3]))
    j, i = np.mgrid[: mean.shape[0], : mean.shape[1]].astype(F)
    px = np.stack([F(2) * i + F(1), F(2) * j + F(1)], -1)
    view = np.concatenate([(px - source_inverse[2:]) * source_inverse[:2], np.ones_like(px[..., :1])], -1)
    moved = view @ rows[:, :3].T.astype(F) + rows[:, 3] * mean[..., None]
    with np.errstate(all="ignore"):
        place = target[:2] * moved[..., :2] / moved[..., 2:] + target[2:]
        z = moved[..., 2] / mean
        tolerance = SHADING.SAME_SURFACE * z
        moves = np.stack(taps(frame["dynamic"] > 0))
        smooth = (moves.all(0) | ~moves.any(0)) & (z > 0)
        smooth &= np.max(nearness, 0) - np.min(nearness, 0) <= SHADING.SAME_SURFACE * mean
        now = px + taps(frame["motion"])[0]
        inside = ((now >= 0) & (now < [width, height])).all(-1)
        src = np.where(inside[..., None], now, 0).astype(int)
        mv = past.motion[src[..., 1], src[..., 0]]
        sideways = np.abs(now + mv - place).sum(-1) * (z / target[0])
        smooth &= ~moves.all(0) | (inside & np.isfinite(mv).all(-1))
        tolerance = np.where(moves.all(0), tolerance + SHADING.DEPTH_PER_MOTION * sideways, tolerance)
        first = np.where(moves.all(0)[..., None], now + mv, place) - F(1)
        smooth &= ((first >= 0) & (first < [width - 2, height - 2])).all(-1)
        x0, y0 = np.where(smooth[..., None], first, 0).astype(int).transpose(2, 0, 1)
        u, v = first[..., 0] - x0, first[..., 1] - y0
        colors, gae = [], taps(load_color(frame["color"]))
        for pixel in range(4):
            total, weights = np.zeros((*z.shape, 3), F), np.zeros(z.shape, F)
            for tap in range(4):
                x, y = x0 + (pixel & 1) + (tap & 1), y0 + (pixel >> 1) + (tap >> 1)
                x, y = np.minimum(x, width - 1), np.minimum(y, height - 1)
                there = past.depth[y, x]
                same = np.where(np.isinf(z), np.isinf(there), np.abs(there - z) <= tolerance)
                weight = same * (u if tap & 1 else F(1) - u) * (v if tap >> 1 else F(1) - v)
                total += weight[..., None] * load_color(past.color)[y, x]
                weights += weight
            colors.append(np.where(weights[..., None] >= SHADING.LEAST_WEIGHT, total / weights[..., None], gae[pixel]))
    return smooth, [color.astype(F) for color in colors]
