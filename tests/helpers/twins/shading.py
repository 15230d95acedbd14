"""Twin of shading.cl."""

import numpy as np

from twins.common import COLOR_MAX, F, centers, kernel_constants, load_color, reproject

SHADING = kernel_constants("warped_previous.h")


def prepare_inputs(warped, motion, color_prev, depth_prev, to_previous):
    """Return (warped previous (H, W, 4) float16, input mask (H, W) float16); `color_prev` None after a reset."""
    height, width = warped["depth"].shape
    source_height, source_width = motion.shape[:2]
    rest = np.where(warped["disoccluded"] > 0, SHADING.MASK_DISOCCLUDED, SHADING.MASK_REST)
    mask = np.where(warped["dynamic"] > 0, SHADING.MASK_DYNAMIC, rest).astype(np.float16)
    gae = load_color(warped["color"])
    out = np.concatenate([gae, np.zeros((height, width, 1), F)], -1).astype(np.float16)
    if color_prev is None:
        return out, mask
    px = centers(height, width)
    before = reproject(px, warped["depth"], to_previous)
    tolerance = SHADING.SAME_SURFACE * before[..., 2]
    for y, x in np.argwhere((warped["dynamic"] > 0) & (before[..., 2] > 0)):
        now = px[y, x] + warped["motion"][y, x]
        sx, sy = (int(np.floor(v)) for v in now)
        inside = 0 <= sx < source_width and 0 <= sy < source_height
        if not inside or not np.isfinite(motion[sy, sx]).all():
            before[y, x] = (0, 0, -1)
            continue
        moved = now + motion[sy, sx]
        sideways = np.abs(moved - before[y, x, :2]).sum() * (before[y, x, 2] / to_previous[5, 0])
        tolerance[y, x] += SHADING.DEPTH_PER_MOTION * sideways
        before[y, x, :2] = moved
    rgb = load_color(color_prev)
    for y, x in np.argwhere((before[..., 2] > 0) & (before[..., :2] > -1).all(-1)):
        bx, by, z = before[y, x]
        if not (bx < source_width + 1 and by < source_height + 1):
            continue
        x0, y0 = int(np.floor(bx - F(0.5))), int(np.floor(by - F(0.5)))
        u, v = bx - F(0.5) - F(x0), by - F(0.5) - F(y0)
        columns, weights = np.zeros((2, 3), F), F(0)
        for tap in range(4):
            tx, ty = x0 + (tap & 1), y0 + (tap >> 1)
            if not (0 <= tx < source_width and 0 <= ty < source_height):
                continue
            d = depth_prev[ty, tx]
            if not (np.isinf(d) if np.isinf(z) else abs(d - z) <= tolerance[y, x]):
                continue
            weight = (u if tap & 1 else F(1) - u) * (v if tap >> 1 else F(1) - v)
            columns[tap & 1] += weight * rgb[ty, tx]
            weights = weights + weight
        total = columns[0] + columns[1]
        if weights >= F(0.25):
            out[y, x] = (*np.clip(total / weights, -COLOR_MAX, COLOR_MAX), 1)
    return out, mask
