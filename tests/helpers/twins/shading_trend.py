"""Twin of shading_trend.cl."""

import numpy as np

from twins.common import COLOR_MAX, F, centers, kernel_constants, load_color, reproject
from twins.network_input import log

TREND = kernel_constants("shading_trend.cl")


def measure_changes(frame, before, dynamic, exposure, to_previous):
    """Return (4, h, w) of cells, and how many samples of each change, (h, w) uint8; `frame` and `before`: (color (H, W,
    4) float16, depth)."""
    (color, depth), (color_prev, depth_prev) = frame, before
    height, width = depth.shape
    cell, stride, most = TREND.CELL, TREND.SAMPLE_STRIDE, F(TREND.MOST_CHANGE)
    cells = -(-height // cell), -(-width // cell)
    lift = F(5000 * exposure / 8)
    rgb, rgb_prev = load_color(color), load_color(color_prev)
    place = reproject(centers(height, width), depth, to_previous)
    product, known, changed = np.ones((*cells, 3), F), np.zeros(cells, F), np.zeros(cells, np.uint8)
    for dy in range(1, cell, stride):
        for dx in range(1, cell, stride):
            for cy, cx in np.ndindex(cells):
                y, x = cy * cell + dy, cx * cell + dx
                if y >= height or x >= width:
                    continue
                if dynamic[y, x]:
                    changed[cy, cx] += 1
                if dynamic[y, x] or not depth[y, x] > 0:
                    continue
                (px, py, z) = place[y, x]
                px, py = px - F(0.5), py - F(0.5)
                if not (z > 0 and 0 <= px < width - 1 and 0 <= py < height - 1):
                    continue
                x0, y0 = int(px), int(py)
                u, v = px - F(x0), py - F(y0)
                taps = [(y0 + (tap >> 1), x0 + (tap & 1)) for tap in range(4)]
                if not all(
                    np.isinf(depth_prev[at]) if np.isinf(z) else abs(depth_prev[at] - z) <= F(TREND.SAME_SURFACE) * z
                    for at in taps
                ):
                    continue
                total = np.zeros(3, F)
                for tap, at in enumerate(taps):
                    total = total + (u if tap & 1 else F(1) - u) * (v if tap >> 1 else F(1) - v) * rgb_prev[at]
                now, then = (F(1) + lift * np.clip(c, 0, COLOR_MAX).astype(F) for c in (rgb[y, x], total))
                factor = np.clip(now / then, F(1) / most, most)
                product[cy, cx] *= factor
                known[cy, cx] += F(1)
                changed[cy, cx] += bool(((factor > F(TREND.NOISE)) | (factor * F(TREND.NOISE) < 1)).any())
    share = F(stride**2 / cell**2)
    changes = log(product) * (F(1 / np.log1p(5000)) * share)
    return np.moveaxis(np.concatenate([changes, (known * share)[..., None]], -1), -1, 0), changed


def find_change(changed_samples):
    """Return whether in any tile of 4×4 cells more than a few samples change."""
    tile = TREND.TILE
    padded = np.pad(changed_samples, [(0, -side % tile) for side in changed_samples.shape])
    height, width = padded.shape
    tiles = padded.reshape(height // tile, tile, width // tile, tile).sum((1, 3), dtype=int)
    return bool((tiles > TREND.FEW).any())


def find_trend(changes, spacing):
    """Return (4, h, w): means over the neighborhood of what is known, and the share that is."""
    around = TREND.TREND_CELLS
    _, height, width = changes.shape
    padded = np.pad(changes, ((0, 0), *[(around * spacing,) * 2] * 2))
    changes = np.zeros_like(changes)
    for j, i in np.ndindex(2 * around + 1, 2 * around + 1):
        share = F((around + 1 - abs(j - around)) * (around + 1 - abs(i - around))) * F(1 / 81)
        changes += share * padded[:, j * spacing : j * spacing + height, i * spacing : i * spacing + width]
    share = np.maximum(changes[3], F(TREND.LEAST_SHARE))
    return np.concatenate([changes[:3] / share, changes[3:]])


def carry_trends(depth, trend, trend_prev, changes_prev, alpha, to_source, to_previous, network_size):
    """Return trends (8, h/2, w/2) of the network."""
    height, width = depth.shape
    w, h = (side // 2 for side in network_size)
    j, i = np.minimum(4 * np.arange(h) + 2, height - 1), np.minimum(4 * np.arange(w) + 2, width - 1)
    px = centers(height, width)[j[:, None], i]

    def look_up(trend, r):
        place = reproject(px, depth[j[:, None], i], r)
        sides = trend.shape[2], trend.shape[1]
        with np.errstate(invalid="ignore"):
            at = [np.clip(place[..., k] * F(1 / TREND.CELL) - F(0.5), 0, F(sides[k] - 1)).astype(F) for k in range(2)]
        x0, y0 = (a.astype(int) for a in at)
        u, v = at[0] - x0.astype(F), at[1] - y0.astype(F)
        x1, y1 = np.minimum(x0 + 1, sides[0] - 1), np.minimum(y0 + 1, sides[1] - 1)
        top = (F(1) - u) * (F(1) - v) * trend[:, y0, x0] + u * (F(1) - v) * trend[:, y0, x1]
        bottom = (F(1) - u) * v * trend[:, y1, x0] + u * v * trend[:, y1, x1]
        return (top + bottom) * (place[..., 2] > 0)

    now, before = look_up(trend, to_source), look_up(trend_prev, to_previous)
    again = look_up(changes_prev, to_previous)
    brightness = TREND.THIRD * again[:3].sum(0) / np.maximum(again[3], TREND.LEAST_SHARE)
    return np.concatenate([F(alpha) * now[:3], F(alpha) * before[:3], now[3:], brightness[None]]).astype(F)
