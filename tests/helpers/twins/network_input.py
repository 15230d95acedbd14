"""Twins of the μ-law and of the median of depth."""

import numpy as np

from twins.common import COLOR_MAX, F, kernel_constants

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
