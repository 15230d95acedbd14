"""Twin of convolutions.cl: a network of integers, each byte for the number that it stands for."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from twins.common import F


def judge_with(network, frames, candidates):
    """Return judgement (20, h, w) float32 and all images between the layers, (channels, h, w) uint8 by name."""
    made = {}
    for layer in network.layers:
        sources = [made[image.name] for image in layer.sources]
        if layer.kind == "last":
            return in_floats(numbers_of(layer.sources[0], sources[0]), layer, 0), made
        if layer.kind == "first":
            with np.errstate(all="ignore"):
                results = in_floats(frames, layer, 1)
                results = np.where(results < 0, F(layer.roundings[0].slope) * results, results)
        elif layer.kind == "taken":
            with np.errstate(over="ignore"):
                results = candidates * layer.weights[:, None, None]
        elif layer.kind == "doubled":
            results = doubled_image(numbers_of(layer.sources[0], sources[0]))
        else:
            results = sums_of(np.concatenate(sources), layer)
        images = rounded_in_turn(results, layer)
        made |= {image.name: pixels for image, pixels in zip(layer.targets, images, strict=True)}
    raise AssertionError("there is no last layer")


def numbers_of(image, pixels):
    return image.scale * (pixels.astype(F) - F(image.zero))


def sums_of(pixels, layer):
    """Return sums of integers, in steps of the first rounding."""
    size, zero = layer.weights.shape[-1], layer.sources[0].zero
    padded = np.pad(pixels.astype(np.int64), ((0, 0), *[(size // 2,) * 2] * 2), constant_values=zero)
    windows = sliding_window_view(padded, (size, size), (1, 2))[:, :: layer.stride, :: layer.stride]
    sums = np.einsum("oiyx,ihwyx->ohw", layer.weights.astype(np.int64), windows)
    assert np.abs(sums).max() < 1 << 24
    total = sums + layer.bias.astype(np.int64)[:, None, None]
    return total.astype(F) * layer.unit[:, None, None]


def rounded_in_turn(results, layer):
    """Return images of a layer: rounded twice and, for joining, once more."""
    steps = results if layer.kind == "convolution" else in_steps(results, layer.roundings[0])
    pixels = to_bytes(steps, layer.roundings[0])
    images = []
    for before, after in zip(layer.roundings, layer.roundings[1:], strict=False):
        every = before.scale * (np.arange(256) - before.zero).astype(F)
        every = np.where(every < 0, F(after.slope) * every, every)
        pixels = to_bytes(in_steps(every, after), after)[pixels]
        images.append(pixels)
    return images


def in_steps(numbers, rounding):
    with np.errstate(all="ignore"):
        return (numbers / rounding.scale).astype(F)


def to_bytes(steps, rounding):
    """Return values as bytes; NaN is the least one."""
    whole = np.rint(np.fmin(np.fmax(steps, F(-rounding.zero)), F(255 - rounding.zero)))
    return (whole + rounding.zero).astype(np.uint8)


def in_floats(planes, layer, border):
    """Return a convolution in floats, in the order of onnxruntime: of one input channel after the other, each from 0;
    of single pixels of all at once."""
    size, outputs = layer.weights.shape[-1], len(layer.weights)
    padded = np.pad(planes, ((0, 0), *[(border, border)] * 2))
    windows = sliding_window_view(padded, (size, size), (1, 2))[:, :: layer.stride, :: layer.stride]
    sums = np.zeros((outputs, *windows.shape[1:3]), F)
    of_channel = np.zeros_like(sums)
    for channel in range(len(planes)):
        for y, x in np.ndindex(size, size):
            of_channel = fused(layer.weights[:, channel, y, x, None, None], windows[channel, :, :, y, x], of_channel)
        if size > 1:
            sums, of_channel = sums + of_channel, np.zeros_like(sums)
    return (sums + of_channel) + layer.bias[:, None, None]


def fused(a, b, c):
    """Return a b + c in float32, rounded once: in float64 the sum is rounded to odd, so that no second rounding
    counts."""
    product, c = a.astype(np.float64) * b.astype(np.float64), c.astype(np.float64)
    total = product + c
    back = total - product
    error = (product - (total - back)) + (c - back)
    bits = total.view(np.int64)
    is_even = np.isfinite(total) & (error != 0) & (bits & 1 == 0)
    return np.where(is_even, (bits + np.where((error > 0) == (total > 0), 1, -1)).view(np.float64), total).astype(F)


def doubled_image(numbers):
    """Return numbers (channels, h, w) at twice the size, bilinear, in the order of onnxruntime."""
    (left, right, wx), (above, below, wy) = (neighbors(n) for n in numbers.shape[:0:-1])
    wy = wy[:, :, None]
    parts = (
        wx[a] * wy[b] * numbers[:, rows][:, :, columns]
        for b, rows in enumerate((above, below))
        for a, columns in enumerate((left, right))
    )
    total = next(parts)
    for part in parts:
        total = total + part
    return total


def neighbors(count):
    """Return both pixels that each doubled one lies between, and their weights (2, 2 count)."""
    centers = np.clip((np.arange(2 * count) + 0.5) / 2 - 0.5, 0, count - 1).astype(F)
    first = centers.astype(int)
    second = np.minimum(first + 1, count - 1)
    weights = np.stack([second - centers, centers - first]).astype(F)
    weights[:, first == second] = F(0.5)
    return first, second, weights
