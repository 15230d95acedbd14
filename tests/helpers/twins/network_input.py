"""Twin of network_input.cl, and of the μ-law."""

import numpy as np

from twins.common import COLOR_MAX, F, kernel_constants
from twins.warp import load_color

NETWORK_INPUT = kernel_constants("network_input.cl")


def encode(color, exposure):
    """μ-law: ln(1 + μ · exposure · c / 8) / ln(1 + μ) for μ = 5000; negative color is black."""
    return log(F(1) + F(5000 * exposure / 8) * np.maximum(color, F(0))) * F(1 / np.log1p(5000))


def _parts(x):
    """Mantissa and exponent: of the power of two within sqrt(2)."""
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
    """exp(x) − 1 for x from 0 to 88."""
    n = np.floor(x * F(1.44269504088896341) + F(0.5))
    r = x - n * F(0.693359375) + n * F(2.12194440e-4)
    y = F(1.9875691500e-4)
    for c in (1.3981999507e-3, 8.3334519073e-3, 4.1665795894e-2, 1.6666665459e-1, 5.0000001201e-1):
        y = y * r + F(c)
    power = ((np.nan_to_num(n).astype(np.int32) + 127) << 23).view(F)
    return (y * r * r + r) * power + (power - F(1))


def depth_median(depth):
    """Middle of the bin, 1/128 of a power of two wide, that holds the median of the finite depths in every eighth row;
    1 without."""
    depth = depth[:: NETWORK_INPUT.COUNTED_ROWS]
    bits = np.sort(depth[np.isfinite(depth) & (depth > 0)].view(np.uint32))
    if not len(bits):
        return F(1)
    dropped = NETWORK_INPUT.BIN_BITS
    bin_ = bits[(len(bits) + 1) // 2 - 1] >> dropped
    return np.array([bin_ << dropped | 1 << (dropped - 1)], np.uint32).view(F)[0]


def network_input(color, previous, depth, mask, exposure, network_size):
    """(8, h, w) float32 from the GAE frame, the warped previous frame (H, W, 4) and the input mask (H, W)."""
    inverse = np.minimum(depth_median(depth) / depth, NETWORK_INPUT.MAX_INVERSE_DEPTH)
    planes = np.concatenate([inverse[..., None], mask.astype(F)[..., None]], -1)
    (height, width), (w, h) = depth.shape, network_size
    j, i = np.mgrid[:h, :w]

    def taps(image):
        return [
            image[np.minimum(2 * j + (tap >> 1), height - 1), np.minimum(2 * i + (tap & 1), width - 1)]
            for tap in range(4)
        ]

    lifted = [taps(F(1) + F(5000 * exposure / 8) * np.maximum(load_color(c), F(0))) for c in (color, previous)]
    colors = [_log_of_product(a * c, b * d) * (F(0.25) * F(1 / np.log1p(5000))) for a, b, c, d in lifted]
    total = np.zeros((h, w, 2), F)
    for tap in taps(planes):
        total = total + tap
    return np.moveaxis(np.concatenate([*colors, F(0.25) * total], -1), -1, 0)
