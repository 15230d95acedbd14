"""Twin of background.cl."""

import itertools

import numpy as np

from twins.common import COMMON, INF, F, centers, decode_color, encode_color, invalid, kernel_constants, reproject
from twins.holes import DIRECTIONS, is_outside, march, static_motion
from twins.warp import _STEPS, _shifted, load_code, load_color, unmixed

BACKGROUND = kernel_constants("background.cl")
EMPTY_TEXEL, SHOWN, REMEMBERED, EDGE = BACKGROUND.EMPTY, BACKGROUND.SHOWN, BACKGROUND.REMEMBERED, BACKGROUND.EDGE


def shown_state(depth, dynamic):
    """Return (H, W) uint8: the state of level 0 before anything is remembered; only what is beside movers is open."""
    static = unmixed(np.where(invalid(depth), np.nan, F(1)), dynamic) > 0
    return np.where(unmixed(depth, dynamic) > 0, SHOWN, np.where(static, EDGE, EMPTY_TEXEL)).astype(np.uint8)


def collect_shown(color, depth, dynamic):
    """Return level 0 before anything is remembered: color (H, W, 4) float16, depth, px, state."""
    height, width = depth.shape
    packed = np.zeros((height, width, 4), np.float16)
    packed[..., :3] = load_color(color)
    return {
        "color": packed,
        "depth": depth.copy(),
        "px": centers(height, width),
        "state": shown_state(depth, dynamic),
    }


def as_rgb9e5(color):
    """Return (…, 4) float16 of colors (…, 3 or 4) once they were stored in three mantissas that share an exponent."""
    kept = np.clip(color[..., :3].astype(np.float64), 0, BACKGROUND.COLOR_MOST)
    exponent = np.floor(np.log2(np.maximum(kept.max(-1, keepdims=True), 2.0**-16)))
    carries = np.rint(kept.max(-1, keepdims=True) * 2.0 ** (8 - exponent)) == 512
    unit = 2.0 ** (exponent + carries - 8)
    out = np.zeros((*color.shape[:-1], 4), np.float16)
    out[..., :3] = np.rint(kept / unit) * unit
    return out


def as_offset(px, texel, level):
    """Return (2,) float32 of a position once it was stored as the offset from the center of `texel` (row, column)."""
    side = F(1 << level)
    center = (np.array(texel[::-1], F) + F(0.5)) * side
    units = np.clip(np.rint((px - center) * (BACKGROUND.PX_UNITS / side)), -32768, 32767)
    return center + units * (side / BACKGROUND.PX_UNITS)


def _slopes(depth, links):
    most = np.zeros(depth.shape, F)
    for bit, (dx, dy) in enumerate(_STEPS):
        with np.errstate(invalid="ignore"):
            step = np.abs(_shifted(depth, dx, dy, np.nan) - depth)
        most = np.where((links >> bit) & 1 > 0, np.fmax(most, step), most)
    return np.where(np.isinf(depth), F(0), most)


def _fragments(level):
    """Return px, depth, color and presence of all fragments of a level, flat: shown ones first."""
    shown = level.get("shown", level)
    present = [(level["state"] == state).reshape(-1) for state in (SHOWN, REMEMBERED)]
    return [
        np.concatenate([part[name].reshape(present[0].size, -1) for part in (shown, level)])
        for name in ("px", "depth", "color")
    ] + [np.concatenate(present)]


def collect_levels(levels_before, level0, depth, dynamic, links, to_current):
    """Return all levels of a rendered frame from those of the frame before (lists of dicts; "shown" of level 0 is its
    `collect_shown`) and `level0`, its `collect_shown`. Ties and order as in the kernels."""
    height, width = depth.shape
    count = len(levels_before)
    slopes = _slopes(depth, links)

    def may_be_at(sy, sx, z):
        """Return (allowed, margin, behind) for a fragment of depth z."""
        shown = depth[sy, sx]
        if invalid(shown):
            return True, F(0), True
        margin = BACKGROUND.SAME_LEVEL * shown + slopes[sy, sx]
        behind = not np.isinf(shown) if np.isinf(z) else z > shown + margin
        in_front = not np.isinf(z) if np.isinf(shown) else z < shown - margin
        return not in_front and (behind or not dynamic[sy, sx]), margin, behind

    def offer(best, cell, z, i):
        best[cell] = min(best.get(cell, (INF, 1 << 40)), (z, i))

    def settle(best, level, color, now):
        into = levels[level]
        for cell, (z, i) in best.items():
            into["state"][cell], into["depth"][cell] = REMEMBERED, z
            into["px"][cell] = as_offset(now[i, :2], cell, level)
            into["color"][cell] = as_rgb9e5(color[i])

    levels = [{name: array.copy() for name, array in level0.items()}]
    for level, before in enumerate(levels_before):
        px, depth_before, color, present = _fragments(before)
        now = reproject(px, depth_before[:, 0], to_current)
        x, y, z = now.T
        inside = (z > 0) & (x >= 0) & (x < width) & (y >= 0) & (y < height)
        fragments = np.flatnonzero(present & inside)
        if level + 1 < count:
            levels.append({name: np.zeros_like(a) for name, a in levels_before[level + 1].items()})
        current = levels[level]
        fill, push, touched = {}, {}, {}
        for i in fragments:
            sx, sy = int(np.floor(x[i])), int(np.floor(y[i]))
            allowed, margin, behind = may_be_at(sy, sx, z[i])
            if not allowed or (level > 0 and not behind):
                continue
            cell = (sy >> level, sx >> level)
            if current["state"][cell] == EMPTY_TEXEL:
                offer(fill, cell, z[i], i)
            elif level + 1 < count:
                base = current["depth"][cell]
                level_margin = margin if level == 0 else F(2) * BACKGROUND.SAME_LEVEL * base
                if not np.isinf(base) if np.isinf(z[i]) else z[i] > base + level_margin:
                    offer(push, (sy >> (level + 1), sx >> (level + 1)), z[i], i)
        settle(fill, level, color, now)
        if push:
            settle(push, level + 1, color, now)
        reach = F(0.499) * F(1 << level)
        for i in fragments:
            for dx, dy in ((-reach, -reach), (reach, -reach), (-reach, reach), (reach, reach)):
                sx, sy = int(np.floor(x[i] + dx)), int(np.floor(y[i] + dy))
                cell = (sy >> level, sx >> level)
                if not (0 <= sx < width and 0 <= sy < height):
                    continue
                if current["state"][cell] != EMPTY_TEXEL:
                    continue
                allowed, _, behind = may_be_at(sy, sx, z[i])
                if allowed and (behind or level == 0):
                    offer(touched, cell, z[i], i)
        settle(touched, level, color, now)
    return levels


def project_background(warped, levels, zoom, to_target, to_source):
    """Return color, depth, motion and filled_by of the warped frame after background projection, without the far side;
    levels as for `collect_levels`."""
    out = {name: warped[name].copy() for name in ("color", "depth", "motion", "filled_by")}
    height, width = warped["depth"].shape
    holes = warped["disoccluded"] > 0
    best: dict = {}
    there = [reproject(level["px"], level["depth"], to_target) for level in levels]
    current = levels[0]["shown"]
    there_shown = reproject(current["px"], current["depth"], to_target)
    for number, level in enumerate(levels):
        wide = level["depth"].shape[1]
        for ty, tx in np.argwhere(level["state"] == REMEMBERED):
            x, y, z = there[number][ty, tx]
            reach = BACKGROUND.TEXEL_REACH
            if not (z > 0 and -reach < x < width + reach and -reach < y < height + reach):
                continue
            nearer = F(1) if np.isinf(z) else level["depth"][ty, tx] / z
            side = F(1 << number) * BACKGROUND.TEXEL_HALF * nearer
            half = [min(max(side * zoom[k], F(0.5)), reach) for k in range(2)]
            x0, x1 = max(int(np.ceil(x - half[0] - F(0.5))), 0), min(int(np.floor(x + half[0] - F(0.5))), width - 1)
            y0, y1 = max(int(np.ceil(y - half[1] - F(0.5))), 0), min(int(np.floor(y + half[1] - F(0.5))), height - 1)
            key = (z, number, ty * wide + tx)
            for cell in ((cy, cx) for cy in range(y0, y1 + 1) for cx in range(x0, x1 + 1)):
                if holes[cell]:
                    best[cell] = min(best.get(cell, (INF, 99, 0)), key)
    px = centers(height, width)

    def of_one_surface(d, winner):
        return np.isinf(d) if np.isinf(winner) else abs(d - winner) <= F(2) * BACKGROUND.SAME_LEVEL * winner

    def is_supported(y, x, z):
        d, shown = BACKGROUND.SUPPORT_AT, 0
        for at in ((y, x - d), (y, x + d), (y - d, x), (y + d, x)):
            if 0 <= at[0] < height and 0 <= at[1] < width:
                there = best.get(at, (F(np.nan),))[0] if holes[at] else warped["depth"][at]
                shown += np.isinf(there) if np.isinf(z) else abs(there - z) <= BACKGROUND.SUPPORT_ALIKE * z
        return shown >= BACKGROUND.SUPPORT_LEAST

    for (y, x), (z, number, i) in best.items():
        if warped["filled_by"][y, x] in (COMMON.BY_HIDDEN_PART, COMMON.BY_REAPPEARING):
            continue
        at = reproject(px[y, x][None], np.array([z], F), to_source)[0]
        if is_outside(at, levels[0]["depth"]) or (number > 0 and not is_supported(y, x, z)):
            continue
        level = levels[number]
        level_height, level_width = level["depth"].shape
        ty, tx = divmod(i, level_width)
        winner = level["depth"][ty, tx]
        nearer = F(1) if np.isinf(z) else winner / z
        sides = [F(1 << number) * nearer * zoom[k] for k in range(2)]
        total, weights = np.zeros(3, F), F(0)
        for ny in range(max(ty - 1, 0), min(ty + 2, level_height)):
            for nx in range(max(tx - 1, 0), min(tx + 2, level_width)):
                state = level["state"][ny, nx]
                if state == SHOWN and of_one_surface(current["depth"][ny, nx], winner):
                    at, tap = there_shown[ny, nx], current["color"][ny, nx]
                elif state == REMEMBERED and of_one_surface(level["depth"][ny, nx], winner):
                    at, tap = there[number][ny, nx], level["color"][ny, nx]
                else:
                    continue
                if not at[2] > 0:
                    continue
                wx, wy = (F(1) - abs(at[k] - px[y, x, k]) * (F(1) / sides[k]) for k in range(2))
                if wx > 0 and wy > 0:
                    total = total + wx * wy * load_code(tap)
                    weights = weights + wx * wy
        found = total / weights if weights > F(0.01) else load_code(level["color"][ty, tx])
        out["color"][y, x, :3] = decode_color(found)
        out["filled_by"][y, x] = 1 + number
        out["depth"][y, x] = z
        out["motion"][y, x] = static_motion(px[y, x][None], np.array([z], F), to_source)[0]
    return out


def _shown_before(px, z, color_prev, depth_prev, to_previous):
    """Return the code of the color of a static point in the frame before, or None."""
    height, width = depth_prev.shape
    x, y, z_prev = reproject(px[None], np.array([z], F), to_previous)[0]
    if not (z_prev > 0 and 0.5 <= x < width - 0.5 and 0.5 <= y < height - 0.5):
        return None
    x0, y0 = int(x - F(0.5)), int(y - F(0.5))
    u, v = x - F(0.5) - F(x0), y - F(0.5) - F(y0)
    found = np.zeros(3, F)
    for tap in range(4):
        at = y0 + (tap >> 1), x0 + (tap & 1)
        d = depth_prev[at]
        if not (np.isinf(d) if np.isinf(z_prev) else abs(d - z_prev) <= F(2) * BACKGROUND.SAME_LEVEL * z_prev):
            return None
        weight = (u if tap & 1 else F(1) - u) * (v if tap >> 1 else F(1) - v)
        found = found + weight * load_code(color_prev[at])
    return found


def _change_around(q, d, warped, before):
    """Return (code in the frame before, squared change since), or None, of what lies in direction d beyond the edge (y,
    x) of a hole."""
    y, x = q[0] + BACKGROUND.BEYOND_EDGE * d[1], q[1] + BACKGROUND.BEYOND_EDGE * d[0]
    depth = warped["depth"]
    if not (0 <= y < depth.shape[0] and 0 <= x < depth.shape[1]) or warped["disoccluded"][y, x]:
        return None
    with np.errstate(divide="ignore"):
        here, edge = F(1) / depth[y, x], F(1) / depth[q]
    if here > edge * BACKGROUND.FAR_SIDE or edge > here * BACKGROUND.FAR_SIDE:
        return None
    shown = _shown_before(np.array([x + 0.5, y + 0.5], F), depth[y, x], *before)
    return None if shown is None else (shown, ((load_code(warped["color"][y, x]) - shown) ** 2).sum())


def _staleness(remembered, changes):
    """Return how far the code of a remembered color is out of date, 0 to 1, at exposure 1; `changes`: those
    known of `_change_around`."""
    if not changes:
        return F(0)
    shown, change = (np.mean(part, axis=0) for part in zip(*changes, strict=True))
    contrast = ((remembered - shown) ** 2).sum()
    return change / (change + BACKGROUND.CONTRAST_COUNTS * contrast + 3 * BACKGROUND.LEAST_CHANGE)


def mix_far_side(warped, before):
    """Return color of the frame as the background left it, its fills mixed with the far side; `before`: color and depth
    of the frame before, and the reprojection into it."""
    color, shown = warped["color"].copy(), load_color(warped["color"])
    hole = warped["disoccluded"] != 0
    others = COMMON.BY_NOTHING, COMMON.BY_HIDDEN_PART, COMMON.BY_REAPPEARING
    remembered = hole & ~np.isin(warped["filled_by"], others)
    with np.errstate(divide="ignore"):
        inverse = F(1) / warped["depth"]
    for y, x in np.argwhere(remembered):
        met = []
        for d in DIRECTIONS:
            found = (m for m in march(y, x, d, BACKGROUND.MIXED_REACH, hole.shape) if not hole[m[1]])
            met += [(F(1) / distance, q, d) for distance, q in itertools.islice(found, 1)]
        least = min((inverse[q] for _, q, _ in met), default=F(0))
        far = [m for m in met if inverse[m[1]] <= least * BACKGROUND.FAR_SIDE]
        if not far:
            continue
        weights = np.array([closeness for closeness, *_ in far], F)
        colors = np.array([shown[q] for _, q, _ in far])
        mean = decode_color(np.average(encode_color(colors), axis=0, weights=weights))
        counts = BACKGROUND.FAR_COUNTS * weights.max()
        code = encode_color(shown[y, x])
        stale = _staleness(code, [c for _, q, d in far if (c := _change_around(q, d, warped, before))])
        total = (1 - stale) * code + (stale + counts) * encode_color(mean)
        color[y, x, :3] = decode_color(total / (1 + counts))
    return color
