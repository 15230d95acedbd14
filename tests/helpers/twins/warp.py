"""Twins of connectivity.cl, backward_blocks.cl and warp.cl."""

import numpy as np

from twins.common import (
    COLOR_MAX,
    COMMON,
    INF,
    NOBODY,
    WARP,
    F,
    centers,
    decode_color,
    encode_color,
    invalid,
    kernel_constants,
    white,
)

SURFACES = kernel_constants("connectivity.cl")
BLOCKS = kernel_constants("backward_blocks.cl")
_STEPS = ((1, 0), (0, 1), (-1, 0), (0, -1))  # right, down, left, up: bits 1, 2, 4, 8


def _shifted(image, dx, dy, fill):
    """Return image[y + dy, x + dx], `fill` outside."""
    height, width = image.shape[:2]
    out = np.full_like(image, fill)
    ys, xs = slice(max(-dy, 0), height - max(dy, 0)), slice(max(-dx, 0), width - max(dx, 0))
    yd, xd = slice(max(dy, 0), height + min(dy, 0)), slice(max(dx, 0), width + min(dx, 0))
    if ys.start < ys.stop and xs.start < xs.stop:
        out[ys, xs] = image[yd, xd]
    return out


def link_surfaces(depth, dynamic):
    links = np.zeros(depth.shape, np.uint8)

    def is_plane(a2, a, b, most):
        off = np.abs((a2 - a) * b - (a - b) * a2)
        return (a2 > 0) & (a2 < INF) & (off < SURFACES.SURFACE_CURVATURE * most * a2)

    for bit, (dx, dy) in enumerate(_STEPS):
        a2, a = _shifted(depth, -dx, -dy, np.nan), depth
        b, b2 = _shifted(depth, dx, dy, np.nan), _shifted(depth, 2 * dx, 2 * dy, np.nan)
        with np.errstate(all="ignore"):
            most = np.where(a > b, a, b)
            near = np.abs(a - b) <= SURFACES.SURFACE_STEP * most
            near |= is_plane(a2, a, b, most) | is_plane(b2, b, a, most)
            same = (a > 0) & (b > 0) & np.where(most < INF, near, a == b)
        links |= (same & (_shifted(dynamic, dx, dy, 2) == dynamic)).astype(np.uint8) << bit
    return links


def unmixed(depth, dynamic):
    """Return (H, W) uint8: 1 where depth is valid and no pixel of 3×3 is dynamic or nearer."""
    keep = ~invalid(depth)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            with np.errstate(invalid="ignore"):
                nearer = _shifted(depth, dx, dy, np.inf) < depth * SURFACES.MIXES_IN
            keep &= ~(_shifted(dynamic, dx, dy, 0) > 0) & ~nearer
    return keep.astype(np.uint8)


def flow(target_position, depth, links, zoom):
    """Return the Jacobian columns ddx, ddy (H, W, 3) and the determinant of its 2×2 part."""
    here = target_position
    sky = np.isinf(here[..., 2])

    def slope(bit, dx, dy):
        ahead, behind = _shifted(here, dx, dy, -1), _shifted(here, -dx, -dy, -1)
        use_ahead = ((links >> bit) & 1 > 0) & (ahead[..., 2] > 0)
        use_behind = ((links >> (bit + 2)) & 1 > 0) & (behind[..., 2] > 0)
        with np.errstate(invalid="ignore"):
            total = np.where(use_ahead[..., None], F(0) + (ahead - here), F(0))
            total = np.where(use_behind[..., None], total + (here - behind), total)
        total[..., 2][sky] = 0
        both = use_ahead & use_behind
        return np.where(both[..., None], total * F(0.5), total), use_ahead | use_behind

    ddx, linked_x = slope(0, 1, 0)
    ddy, linked_y = slope(1, 0, 1)
    with np.errstate(all="ignore"):
        nearer = np.where(sky, F(1), depth / here[..., 2])
        scale_x, scale_y = zoom[0] * nearer, zoom[1] * nearer
        most = WARP.STRETCH_MOST * np.maximum(scale_x, scale_y)
        zero = np.zeros_like(scale_x)
        plain_x = np.stack([scale_x, zero, zero], -1)
        plain_y = np.stack([zero, scale_y, zero], -1)
        bad_x = ~linked_x | (np.abs(ddx[..., 0]) > most) | (np.abs(ddx[..., 1]) > most)
        bad_y = ~linked_y | (np.abs(ddy[..., 0]) > most) | (np.abs(ddy[..., 1]) > most)
        ddx, ddy = np.where(bad_x[..., None], plain_x, ddx), np.where(bad_y[..., None], plain_y, ddy)
        det = ddx[..., 0] * ddy[..., 1] - ddy[..., 0] * ddx[..., 1]
        folded = ~(det > F(0.02) * scale_x * scale_y)
        ddx, ddy = np.where(folded[..., None], plain_x, ddx), np.where(folded[..., None], plain_y, ddy)
        det = np.where(folded, scale_x * scale_y, det)
    return ddx.astype(F), ddy.astype(F), det.astype(F)


def _source_offset(ddx, ddy, d):
    """Return the offset in the source, times the determinant."""
    x, y = d[..., 0], d[..., 1]
    return np.stack([ddy[..., 1] * x - ddy[..., 0] * y, ddx[..., 0] * y - ddx[..., 1] * x], -1)


def _deviation_from_linear(around):
    """Return the largest deviation of a coordinate over a block and its margin from the linear function through the
    corners, with that function's (center, slope along, slope down)."""
    height, width = around.shape
    (a, b), (c, d) = around[0, [0, -1]], around[-1, [0, -1]]
    center = F(0.25) * ((a + d) + (b + c))
    along = ((b - a) + (d - c)) * (F(0.5) / F(width - 1))
    down = ((c - a) + (d - b)) * (F(0.5) / F(height - 1))
    y, x = (np.arange(n, dtype=F) - F(0.5 * (n - 1)) for n in (height, width))
    linear = (center + along * x)[None] + (down * y)[:, None]
    return np.abs(around - linear).max(), center, along, down


def smooth_blocks(target_position, zoom):
    """Return (rows, columns) uint8: SMOOTH or 0 of source blocks, and (rows, columns, 4): the boxes that those with a
    value reach, in target pixels."""
    height, width = target_position.shape[:2]
    side_x, side_y, margin = BLOCKS.BLOCK_WIDTH, BLOCKS.BLOCK_HEIGHT, BLOCKS.MARGIN
    rows, columns = -(-height // side_y), -(-width // side_x)
    smooth, boxes = np.zeros((rows, columns), np.uint8), np.zeros((rows, columns, 4), F)
    for by, bx in np.ndindex(rows, columns):
        y0, x0 = by * side_y - margin, bx * side_x - margin
        y1, x1 = y0 + side_y + 2 * margin, x0 + side_x + 2 * margin
        if y0 < 0 or x0 < 0 or y1 > height or x1 > width:
            continue
        around = target_position[y0:y1, x0:x1]
        off_x, x, xx, yx = _deviation_from_linear(around[..., 0])
        off_y, y, xy, yy = _deviation_from_linear(around[..., 1])
        flat = max(off_x, off_y) <= BLOCKS.LINEAR_MOST
        for along, across, size in ((xx, yx, zoom[0]), (yy, xy, zoom[1])):
            flat &= BLOCKS.STRETCH_LOW * size <= along <= BLOCKS.STRETCH_HIGH * size
            flat &= abs(across) <= BLOCKS.SHEAR_MOST * size
        if not flat:
            continue
        smooth[by, bx] = BLOCKS.SMOOTH
        slopes = np.abs(np.array([(xx, yx), (xy, yy)], F))
        half = F(0.5 * (side_x - 1)) * slopes[:, 0] + F(0.5 * (side_y - 1)) * slopes[:, 1] + BLOCKS.LINEAR_MOST
        half = half + np.maximum(WARP.FOOTPRINT_HALF * (slopes[:, 0] + slopes[:, 1]), BLOCKS.HALF_LEAST)
        boxes[by, bx] = *((x, y) - half), *((x, y) + half)
    return smooth, boxes


def block_classes(smooth, boxes, target_position, depth, links, zoom, target_size):
    """Return (rows, columns) bool: target blocks that are warped backward."""
    width, height = target_size
    side = np.array((BLOCKS.BLOCK_WIDTH, BLOCKS.BLOCK_HEIGHT))
    rows, columns = -(-height // side[1]), -(-width // side[0])
    low, high = np.full((rows, columns, 2), 10**6), np.full((rows, columns, 2), -1)
    spoilt = np.zeros((rows, columns), bool)
    ddx, ddy, _ = flow(target_position, depth, links, zoom)
    here = target_position[..., :2]
    reach = F(WARP.FOOTPRINT_REACH)
    half = np.minimum(WARP.FOOTPRINT_HALF * (np.abs(ddx[..., :2]) + np.abs(ddy[..., :2])), reach)
    half = np.maximum(half, BLOCKS.HALF_LEAST)
    with np.errstate(invalid="ignore"):
        lands = (
            (target_position[..., 2] > 0) & (here > -reach).all(-1) & (here < np.array(target_size, F) + reach).all(-1)
        )
    for by, bx in np.ndindex(*smooth.shape):
        part = np.s_[by * side[1] : (by + 1) * side[1], bx * side[0] : (bx + 1) * side[0]]
        use = lands[part]
        if smooth[by, bx]:
            first, last = boxes[by, bx, :2], boxes[by, bx, 2:]
        elif use.any():
            first, last = (here[part] - half[part])[use].min(0), (here[part] + half[part])[use].max(0)
        else:
            continue
        first, last = np.ceil(first - F(0.5 + BLOCKS.ROUNDING)), np.floor(last - F(0.5 - BLOCKS.ROUNDING))
        if (last < 0).any() or (first >= target_size).any():
            continue
        x0, y0 = (np.maximum(first, 0).astype(int) // side).tolist()
        x1, y1 = (np.minimum(last, np.array(target_size) - 1).astype(int) // side).tolist()
        reached = np.s_[y0 : y1 + 1, x0 : x1 + 1]
        low[reached], high[reached] = np.minimum(low[reached], (bx, by)), np.maximum(high[reached], (bx, by))
        spoilt[reached] |= not smooth[by, bx]
    backward = np.zeros((rows, columns), bool)
    for by, bx in np.argwhere(~spoilt & (high >= low).all(-1)):
        (x0, y0), (x1, y1) = low[by, bx], high[by, bx]
        near = x1 - x0 < BLOCKS.COLUMNS_MOST and y1 - y0 < BLOCKS.ROWS_MOST
        backward[by, bx] = near and (smooth[y0 : y1 + 1, x0 : x1 + 1] > 0).all()
    if width % side[0]:
        backward[:, -1] = False
    if height % side[1]:
        backward[-1] = False
    return backward


def splat(target_position, depth, links, zoom, target_size, close_cracks):
    """Return (H', W') uint64 keys: depth bits << 32 | source index; all ones where nothing lands."""
    width, height = target_size
    keys = np.full(height * width, np.iinfo(np.uint64).max, np.uint64)
    here = target_position.reshape(-1, 3)
    ddx, ddy, det = flow(target_position, depth, links, zoom)
    ddx, ddy, limit = ddx.reshape(-1, 3), ddy.reshape(-1, 3), WARP.FOOTPRINT_HALF * det.reshape(-1)
    index = np.arange(len(here), dtype=np.uint64)
    reach = F(WARP.FOOTPRINT_REACH)
    with np.errstate(invalid="ignore"):
        lands = (here[:, 2] > 0) & (here[:, :2] > -reach).all(1)
        lands &= (here[:, 0] < width + reach) & (here[:, 1] < height + reach)
    key = (np.ascontiguousarray(here[:, 2]).view(np.uint32).astype(np.uint64) << np.uint64(32)) | index
    here, ddx, ddy, limit, key = (a[lands] for a in (here, ddx, ddy, limit, key))
    own = np.floor(here[:, :2]).astype(int)

    def offer(x, y, use):
        use = use & (x >= 0) & (y >= 0) & (x < width) & (y < height)
        np.minimum.at(keys, y[use] * width + x[use], key[use])

    offer(own[:, 0], own[:, 1], np.ones(len(own), bool))
    if close_cracks:
        half = np.minimum(WARP.FOOTPRINT_HALF * (np.abs(ddx[:, :2]) + np.abs(ddy[:, :2])), reach)
        half = half + F(0.51)
        first = np.ceil(here[:, :2] - half).astype(int)
        last = np.floor(here[:, :2] + half - F(1)).astype(int)
        for oy in range(int((last - first)[:, 1].max(initial=-1)) + 1):
            for ox in range(int((last - first)[:, 0].max(initial=-1)) + 1):
                t = first + (ox, oy)
                d = np.abs(_source_offset(ddx, ddy, (t.astype(F) + F(0.5)) - here[:, :2]))
                offer(t[:, 0], t[:, 1], (t <= last).all(1) & (t != own).any(1) & (d <= limit[:, None]).all(1))
    return keys.reshape(height, width)


def load_color(color):
    c = np.nan_to_num(color[..., :3].astype(F), nan=0.0, posinf=COLOR_MAX, neginf=-COLOR_MAX)
    return np.clip(c, -COLOR_MAX, COLOR_MAX)


def load_code(color):
    """Return codes of an image's colors."""
    return encode_color(load_color(color))


def codes_of(color):
    """Return codes of an image's colors in half storage."""
    return encode_color(load_color(color)).astype(np.float16)


def cubic_weights(t, slope):
    """Return weights of cubic convolution of the four taps around t, with `slope` at the taps."""
    t2 = t * t
    t3 = t2 * t
    slope = F(slope)
    return np.stack([
        slope * (F(2) * t2 - t - t3),
        F(1) + (slope - F(3)) * t2 + (F(2) - slope) * t3,
        slope * t + (F(3) - F(2) * slope) * t2 + (slope - F(2)) * t3,
        slope * (t3 - t2),
    ])  # fmt: skip


def cubic_of(taps, u, v, sharpness, white):
    """Return codes at (u, v) from the first inner tap of 4×4 `taps`, by row and column, without corners."""
    slope = WARP.CATMULL_ROM + WARP.SHARPER_SLOPE * sharpness
    wx, wy = cubic_weights(u, slope), cubic_weights(v, slope)
    wx = wx * (F(1) / (F(1) - (wx[0] + wx[3]) * (wy[0] + wy[3])))
    cubic = F(0)
    for tx in (1, 2, 0, 3):
        column = wy[1][..., None] * taps[1, tx] + wy[2][..., None] * taps[2, tx]
        if tx in (1, 2):
            column = column + (wy[0][..., None] * taps[0, tx] + wy[3][..., None] * taps[3, tx])
        cubic = cubic + wx[tx][..., None] * column
    left, right = (taps[1, tx] + taps[2, tx] for tx in (0, 3))
    above, below = (taps[ty, 1] + taps[ty, 2] for ty in (0, 3))
    sides = np.stack([left, above, below, right])
    inner = np.stack([taps[ty, tx] for ty in (1, 2) for tx in (1, 2)])
    low, high = inner.min(0), inner.max(0)
    span = WARP.FULL_EDGE - WARP.LEAST_EDGE
    per_range = F(1 / span) / white
    goes_on = F(0.5) * np.maximum(np.abs(right - left), np.abs(below - above)) - WARP.GOES_ON * (high - low)
    edge = np.clip((high - low) * per_range - F(WARP.LEAST_EDGE / span), F(0), F(1))
    edge = edge * np.clip(goes_on * per_range, F(0), F(1))
    midway = F(1) - np.abs(F(2) * u - F(1)) * np.abs(F(2) * v - F(1))
    amount = (WARP.STEEPER * sharpness * midway)[..., None]
    cubic = cubic - amount * edge * (F(0.25) * (sides.min(0) + sides.max(0)) - cubic)
    return np.clip(cubic, low, high)


def resampled(taps, alike, u, v, own, sharpness):
    """Return color (…, 3) at (u, v) from the first inner tap: of codes `taps`, by row and column of 4×4, those `alike`;
    `own` where none is."""
    told_by = [(ty, tx) for ty in range(4) for tx in range(4) if (ty in (1, 2)) == (tx in (1, 2))]
    everywhere = np.all([alike[tap] for tap in told_by], axis=0)
    cubic = cubic_of(taps, u, v, sharpness, white())
    linear, weights = np.zeros((*u.shape, 3), F), np.zeros(u.shape, F)
    for tap in range(4):
        tx, ty = tap & 1, tap >> 1
        weight = (u if tx else F(1) - u) * (v if ty else F(1) - v)
        weight = np.where(alike[ty + 1, tx + 1], weight, F(0))
        linear = linear + weight[..., None] * taps[ty + 1, tx + 1]
        weights = weights + weight
    with np.errstate(all="ignore"):
        linear = decode_color(linear / weights[..., None])
        linear = np.where((weights > F(0.01))[..., None], linear, own)
    return np.where(everywhere[..., None], decode_color(cubic), linear)


def resolve(keys, target_position, color, depth, dynamic, links, zoom, sharpness):
    """Return all outputs of the warp, as a dict of (H', W', …) arrays named like the stage's buffers."""
    height, width = keys.shape
    source_height, source_width = depth.shape
    holes = keys == np.iinfo(np.uint64).max
    s = np.where(holes, 0, keys & np.uint64(NOBODY)).astype(int)
    sy, sx = np.divmod(s, source_width)
    here = target_position[sy, sx]
    ddx, ddy, det = (a[sy, sx] for a in flow(target_position, depth, links, zoom))
    center = centers(height, width)
    with np.errstate(invalid="ignore"):
        d = np.clip(_source_offset(ddx, ddy, center - here[..., :2]) / det[..., None], F(-1), F(1))
    d = np.where(np.abs(d) < WARP.STILL, F(0), d)

    def at(dx, dy):
        x, y = sx + dx, sy + dy
        inside = (x >= 0) & (y >= 0) & (x < source_width) & (y < source_height)
        return inside, np.clip(y, 0, source_height - 1), np.clip(x, 0, source_width - 1)

    def deviation(dx, dy):
        inside, y, x = at(dx, dy)
        there = target_position[y, x]
        dx, dy = np.asarray(dx).astype(F), np.asarray(dy).astype(F)
        ex = there[..., 0] - here[..., 0] - ddx[..., 0] * dx - ddy[..., 0] * dy
        ey = there[..., 1] - here[..., 1] - ddx[..., 1] * dx - ddy[..., 1] * dy
        e = np.maximum(np.abs(ex), np.abs(ey))
        return inside, np.where(there[..., 2] > 0, e, INF)

    own_depth = depth[sy, sx]
    off, nearest = np.zeros_like(d), own_depth * WARP.NEARER
    for dx, dy in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        inside, y, x = at(dx, dy)
        with np.errstate(invalid="ignore"):
            nearer = inside & (depth[y, x] < nearest)
            there = target_position[y, x, :2] - here[..., :2] - ddx[..., :2] * F(dx) - ddy[..., :2] * F(dy)
        off[nearer], nearest[nearer] = there[nearer], depth[y, x][nearer]
    with np.errstate(invalid="ignore"):
        carried = -_source_offset(ddx, ddy, off) / det[..., None]
        carried[~(np.abs(off) <= WARP.SAME_MOTION).all(-1)] = 0
    carried[np.abs(carried) < WARP.STILL] = 0

    step_x, step_y = np.zeros_like(sx), np.zeros_like(sy)
    for dx, dy in _STEPS:
        inside, e = deviation(dx, dy)
        _, y, x = at(dx, dy)
        with np.errstate(invalid="ignore"):
            away = inside & (depth[y, x] < own_depth * WARP.NEARER) & (e > WARP.MOVES_AWAY)
        step_x -= dx * away
        step_y -= dy * away
    inside, e = deviation(step_x, step_y)
    stays = ~(inside & (e <= WARP.SAME_MOTION))
    step_x[stays] = step_y[stays] = 0

    p = d + (carried + np.stack([step_x, step_y], -1).astype(F))
    o = np.floor(p).astype(int)
    u, v = (p - o.astype(F))[..., 0], (p - o.astype(F))[..., 1]
    rgb, codes = load_color(color), codes_of(color).astype(F)
    alike, taps = {}, {}
    for ty in range(4):
        for tx in range(4):
            inside, e = deviation(o[..., 0] + tx - 1, o[..., 1] + ty - 1)
            _, y, x = at(o[..., 0] + tx - 1, o[..., 1] + ty - 1)
            alike[ty, tx], taps[ty, tx] = inside & (e <= WARP.SAME_MOTION), codes[y, x]
    out = resampled(taps, alike, u, v, rgb[sy, sx], sharpness)
    out = np.where(((p == 0).all(-1))[..., None], rgb[sy, sx], out)
    out = np.clip(out, -COLOR_MAX, COLOR_MAX)

    z = here[..., 2] + ddx[..., 2] * d[..., 0] + ddy[..., 2] * d[..., 1]
    source_center = np.stack([sx + 0.5, sy + 0.5], -1).astype(F)
    own_pixel = (np.floor(here[..., :2]) == np.floor(center)).all(-1)
    result = {
        "color": np.concatenate([out, np.zeros((height, width, 1), F)], -1).astype(np.float16),
        "depth": np.where(z > 0, z, here[..., 2]),
        "motion": source_center + d - center,
        "dynamic": (dynamic[sy, sx] > 0).astype(np.uint8),
        "disoccluded": holes.astype(np.uint8),
        "filled_by": np.where(own_pixel, COMMON.BY_WARP, COMMON.BY_CRACK_CLOSING).astype(np.uint8),
    }
    for name, empty in (
        ("color", 0),
        ("depth", INF),
        ("motion", 0),
        ("dynamic", 0),
        ("filled_by", COMMON.BY_NOTHING),
    ):
        result[name][holes] = empty
    return result
