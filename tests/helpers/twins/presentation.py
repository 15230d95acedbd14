"""Twin of presentation.cl."""

import numpy as np

from twins.common import WARP, F, centers, cubic_weights, load_color


def present(color, depth, motion, size, to_render, to_display, to_previous_display):
    """Return displayed color, depth and motion; mappings are (scale x, scale y, offset x, offset y) float32."""
    height, width = depth.shape
    px = centers(size[1], size[0]) * to_render[:2] + to_render[2:]
    corner = np.floor(px - F(0.5))
    u, v = np.moveaxis(px - F(0.5) - corner, -1, 0)
    x0, y0 = np.moveaxis(corner.astype(int) - 1, -1, 0)
    rgb = load_color(color)
    wx, wy = (cubic_weights(t, WARP.CATMULL_ROM) for t in (u, v))

    def cubic(weights, taps):
        a, b, c, d = (weights[k][..., None] * taps[k] for k in range(4))
        return np.clip(a + b + c + d, np.minimum(taps[1], taps[2]), np.maximum(taps[1], taps[2]))

    def tap(tx, ty):
        return rgb[np.clip(y0 + ty, 0, height - 1), np.clip(x0 + tx, 0, width - 1)]

    total = cubic(wy, [cubic(wx, [tap(tx, ty) for tx in range(4)]) for ty in range(4)])
    sx = np.clip(np.floor(px[..., 0]).astype(int), 0, width - 1)
    sy = np.clip(np.floor(px[..., 1]).astype(int), 0, height - 1)
    center = np.stack([sx, sy], -1).astype(F) + F(0.5)
    with np.errstate(invalid="ignore"):
        before = (center + motion[sy, sx]) * to_previous_display[:2] + to_previous_display[2:]
    shown = np.concatenate([total, np.zeros((*u.shape, 1), F)], -1).astype(np.float16)
    return shown, depth[sy, sx], before - (center * to_display[:2] + to_display[2:])
