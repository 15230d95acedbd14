"""Twin of shading_flow.cl, doubling.h and sampling.h."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from twins.common import F, kernel_constants

CANDIDATES, FLOW = kernel_constants("candidates.h"), kernel_constants("shading_flow.cl")


def halved(plane):
    """Return means over 2×2 pixels."""
    a, b, c, d = (plane[y::2, x::2] for y in (0, 1) for x in (0, 1))
    return F(0.25) * ((a + b) + (c + d))


def doubled(plane):
    """Return an image interpolated to twice the size, pixel centers on one plane, borders repeated."""
    height, width = plane.shape
    y, x = np.mgrid[: 2 * height, : 2 * width]
    left, top = np.clip((x - 1) >> 1, 0, width - 1), np.clip((y - 1) >> 1, 0, height - 1)
    right, bottom = np.clip(((x - 1) >> 1) + 1, 0, width - 1), np.clip(((y - 1) >> 1) + 1, 0, height - 1)
    u, v = np.where(x & 1, F(0.25), F(0.75)), np.where(y & 1, F(0.25), F(0.75))
    a, b, c, d = plane[top, left], plane[top, right], plane[bottom, left], plane[bottom, right]
    return (F(1) - u) * (F(1) - v) * a + u * (F(1) - v) * b + (F(1) - u) * v * c + u * v * d


def sampled(plane, x, y):
    """Return values interpolated at positions in pixels, whole numbers at centers, borders repeated; NaN is the far
    border."""
    height, width = plane.shape
    x, y = (np.maximum(np.where(p < last, p, F(last)), F(0)) for p, last in ((x, width - 1), (y, height - 1)))
    x0, y0 = x.astype(int), y.astype(int)
    u, v = x - x0.astype(F), y - y0.astype(F)
    x1, y1 = np.minimum(x0 + 1, width - 1), np.minimum(y0 + 1, height - 1)
    top = (F(1) - u) * plane[y0, x0] + u * plane[y0, x1]
    return (F(1) - v) * top + v * ((F(1) - u) * plane[y1, x0] + u * plane[y1, x1])


def mean_around(plane):
    """Return means over 3×3 pixels, or over those of them that exist."""
    height, width = plane.shape
    total, columns = np.zeros_like(plane), np.zeros_like(plane)
    rows = np.minimum(np.arange(height) + 1, height - 1) - np.maximum(np.arange(height) - 1, 0) + 1
    for dx in (-1, 0, 1):
        column = np.arange(width) + dx
        there = (column >= 0) & (column < width)
        of_column = np.zeros_like(plane)
        for dy in (-1, 0, 1):
            row = np.arange(height) + dy
            inside = (row >= 0) & (row < height)
            taken = plane[np.ix_(np.clip(row, 0, height - 1), np.clip(column, 0, width - 1))]
            of_column = np.where(inside[:, None], of_column + taken, of_column)
        total = total + np.where(there, of_column, F(0))
        columns = columns + there.astype(F)
    return total / (columns * rows[:, None].astype(F))


def find_flow(now, before):
    """Return (2, h/2, w/2): the flow of every second pixel, in pixels; now and before (h, w)."""
    images = [(now, before)]
    while len(images) < FLOW.FLOW_LEVELS:
        images.append(tuple(halved(image) for image in images[-1]))
    flow = None
    for a, b in reversed(images):
        shape = 2, a.shape[0] // 2, a.shape[1] // 2
        flow = np.zeros(shape, F) if flow is None else F(2) * np.stack([doubled(plane) for plane in flow])
        for _ in range(FLOW.FLOW_STEPS):
            flow = flow + _step(a, warped(b, flow))
    return flow


def warped(image, flow):
    height, width = image.shape
    y, x = np.mgrid[:height, :width].astype(F)
    return sampled(image, x + doubled(flow[0]), y + doubled(flow[1]))


def _step(a, b):
    both = np.pad(a + b, 1, mode="edge")
    x, y = both[1:-1, 2:] - both[1:-1, :-2], both[2:, 1:-1] - both[:-2, 1:-1]
    rest = F(4) * (b - a)
    products = [_summed(p) for p in (x * x, x * y, y * y, x * rest, y * rest)]
    xx, xy, yy, xr, yr = (mean_around(F(0.25) * p) for p in products)
    xx, yy = xx + FLOW.FLAT, yy + FLOW.FLAT
    determinant = xx * yy - xy * xy
    step = np.stack([(xy * yr - yy * xr) / determinant, (xy * xr - xx * yr) / determinant])
    longer = np.maximum(np.abs(step[0]), np.abs(step[1]))
    return step / np.maximum((F(1) / FLOW.LONGEST_STEP) * longer, F(1))


def _summed(plane):
    """Return sums over 2×2 pixels, in the kernels' order."""
    a, b, c, d = (plane[y::2, x::2] for y in (0, 1) for x in (0, 1))
    return ((a + b) + c) + d


def find_texture(frames):
    """Return (h/2, w/2) from frames (8, h, w): how far detail of brightness within 2×2 pixels is the same in both
    frames."""
    change, power = F(0), FLOW.FAINT
    third, parts = FLOW.THIRD, _brightness(frames)
    means = [third * _in_order([halved(plane) for plane in c]) for c in (frames[:3], frames[3:6])]
    for y in (0, 1):
        for x in (0, 1):
            now, before = (part[y::2, x::2] - mean for part, mean in zip(parts, means, strict=True))
            changed = now - before
            change, power = change + changed * changed, power + (now * now + before * before)
    return np.clip(FLOW.TEXTURE - FLOW.TEXTURE_CHANGE * (change / power), F(0), F(1))


def _brightness(frames):
    """Return that of both frames, at half resolution."""
    third = FLOW.THIRD
    return [(third * c[0] + third * c[1]) + third * c[2] for c in (frames[:3], frames[3:6])]


def find_followed(frames, flow):
    """Return (h/2, w/2) from frames (8, h, w) and flow (2, h/4, w/4): 1 where the image follows the flow."""
    now, before = _brightness(frames)
    finer = F(2) * np.stack([doubled(plane) for plane in flow])
    still, along = (mean_around(F(0.25) * _summed((a - now) ** 2)) for a in (before, warped(before, finer)))
    follows = (still > FLOW.UNLIKE) & (along < FLOW.EXPLAINED * still)
    follows &= (np.abs(finer) < F(now.shape[1]) * (F(1) / F(FLOW.LONGEST_FLOW))).all(0)
    around = sliding_window_view(np.pad(finer, ((0, 0), (1, 1), (1, 1)), mode="edge"), (3, 3), axis=(1, 2))
    follows &= (around.max((-1, -2)) - around.min((-1, -2)) < FLOW.FLOW_VARIES).all(0)
    inverse = frames[FLOW.INVERSE_DEPTH]
    p, most = np.pad(inverse, 1, mode="edge"), FLOW.BENT * inverse
    across = p[1:-1, :-2] + p[1:-1, 2:] - F(2) * inverse
    down = p[:-2, 1:-1] + p[2:, 1:-1] - F(2) * inverse
    rough = (np.abs(across) > most) | (np.abs(down) > most)
    return (follows & (_summed(rough.astype(F)) == 0)).astype(F)


def find_candidates(frames, trends, alpha):
    """Return (flow (2, h/4, w/4), differences (4, h/4, w/4), candidates (16, h/2, w/2)) from frames (8, h, w)."""
    halves = np.stack([halved(plane) for plane in frames[:6]])
    now, before = (FLOW.THIRD * ((c[0] + c[1]) + c[2]) for c in (halves[:3], halves[3:]))
    flow = find_flow(now, before)
    squares = [(image - now) ** 2 for image in (before, warped(before, flow))]
    last, earlier, share, repeated = np.split(trends, (3, 6, 7))
    changed, again = halved(now) - halved(before), halved(repeated[0])
    y, x = np.mgrid[: again.shape[0], : again.shape[1]].astype(F)
    along = sampled(repeated[0], F(2) * x + F(0.5) + flow[0], F(2) * y + F(0.5) + flow[1])
    squares = [F(0.25) * _summed(square) for square in squares] + [(changed - a) ** 2 for a in (again, along)]
    differences = np.stack([mean_around(square) for square in squares])
    found = np.stack([doubled(plane) for plane in flow])
    still, along = (doubled(plane) + CANDIDATES.LEAST for plane in differences[:2])
    height, width = now.shape
    y, x = np.mgrid[:height, :width].astype(F)
    alpha = F(alpha)
    moved = np.stack([sampled(c, x + alpha * found[0], y + alpha * found[1]) - c for c in halves[:3]])
    product, square, total = (_in_order(last * earlier), _in_order(last * last), _in_order(earlier))
    held = np.clip(product / (square + FLOW.LITTLE), F(0), F(1))
    gain = FLOW.GAIN
    known = [
        (F(1) / CANDIDATES.FOUND_UNIT) * found,
        gain * np.sqrt(still)[None],
        gain * np.sqrt(along)[None],
        (along / still)[None],
        gain * moved,
        gain * last,
        gain * (FLOW.THIRD * total)[None],
        (gain * (now - before))[None],
        held[None],
        share,
        np.full_like(share, alpha),
    ]
    return flow, differences, np.concatenate(known)


def _in_order(planes):
    return (planes[0] + planes[1]) + planes[2]
