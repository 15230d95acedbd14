"""NumPy twins of the kernels: the oracles of the device tests.

Plain float32 arithmetic in the kernels' order, whole images at a time. Cameras come as the same packed
`Reprojection` arrays that kernels get, (6, 4) float32. Constants are read from the kernels' sources.
"""

import itertools
from types import SimpleNamespace

import numpy as np

from gffe_cl.opencl.program import constants

F = np.float32
INF = F(np.inf)
COMMON = SimpleNamespace(**constants("common.h"))
(
    HISTORY,
    ACCELERATION,
    SURFACES,
    PREDICTION,
    BLOCKS,
    WARP,
    HIDDEN,
    BACKGROUND,
    HOLES,
    SHADING,
    CORRECTION,
    TREND,
) = (
    SimpleNamespace(
        **{name: F(value) if isinstance(value, float) else value for name, value in constants(file).items()}
    )
    for file in (
        "history.cl",
        "acceleration.cl",
        "surfaces.cl",
        "prediction.cl",
        "blocks.cl",
        "warp.cl",
        "hidden.cl",
        "background.cl",
        "holes.cl",
        "warped_previous.h",
        "correction.cl",
        "trend.cl",
    )
)
NOBODY = WARP.NOBODY
COLOR_MAX = F(COMMON.COLOR_MAX)


def centres(height, width):
    """(H, W, 2) float32 pixel centres."""
    y, x = np.mgrid[:height, :width].astype(F)
    return np.stack([x + F(0.5), y + F(0.5)], -1)


def invalid(depth):
    return ~(depth > 0)


def unproject(px, z, inverse):
    scale = np.where(np.isinf(z), F(1), z)
    x = (px[..., 0] - inverse[2]) * inverse[0] * scale
    y = (px[..., 1] - inverse[3]) * inverse[1] * scale
    return np.stack([x, y, scale + np.zeros_like(x)], -1).astype(F)


def rotate(v, r):
    return np.stack([r[k, 0] * v[..., 0] + r[k, 1] * v[..., 1] + r[k, 2] * v[..., 2] for k in range(3)], -1)


def move(v, r):
    return rotate(v, r) + r[:3, 3]


def project(v, camera):
    with np.errstate(all="ignore"):
        x = camera[0] * v[..., 0] / v[..., 2] + camera[2]
        y = camera[1] * v[..., 1] / v[..., 2] + camera[3]
    return np.stack([x, y], -1)


def reproject(px, z, r):
    view = unproject(px, z, r[4])
    sky = np.isinf(z)
    target = np.where(sky[..., None], rotate(view, r), move(view, r))
    xy = project(target, r[5])
    behind = ~(target[..., 2] > 0)
    out = np.concatenate([xy, np.where(sky, INF, target[..., 2])[..., None]], -1)
    out[behind] = (0, 0, -1)
    return out.astype(F)


# ---- history -------------------------------------------------------------------------------------------


def static_residual_squared(depth, motion, to_previous):
    """r² of the static test, NaN where it does not apply; and where the fragment is if static."""
    px = centres(*depth.shape)
    where = reproject(px, depth, to_previous)
    with np.errstate(invalid="ignore"):
        d = where[..., :2] - (px + motion)
        r2 = d[..., 0] * d[..., 0] + d[..., 1] * d[..., 1]
    return r2, where


def residual_histogram(depth, motion, to_previous):
    """(2, 64) int32: of the squared residual, and of its squared change over 8 px diagonally."""
    height, width = depth.shape
    px = centres(height, width)
    where = reproject(px, depth, to_previous)
    with np.errstate(invalid="ignore", over="ignore"):
        residual = where[..., :2] - (px + motion)
    use = ~invalid(depth) & ~np.isinf(depth) & np.isfinite(motion).all(-1) & (where[..., 2] > 0)

    bins, stride, apart = HISTORY.RESIDUAL_BINS, HISTORY.RESIDUAL_STRIDE, HISTORY.SCATTER_DISTANCE

    def histogram(vectors):
        r2 = vectors[:, 0] * vectors[:, 0] + vectors[:, 1] * vectors[:, 1]
        which = np.clip((r2.view(np.uint32) >> 22).astype(int) - HISTORY.RESIDUAL_FIRST_BIN, 0, bins - 1)
        return np.bincount(which, minlength=bins)

    sampled = np.zeros_like(use)
    sampled[::stride, ::stride] = True
    near, near_use = _shifted(residual, apart, apart, np.nan), _shifted(use, apart, apart, False)
    with np.errstate(over="ignore", invalid="ignore"):
        counts = histogram(residual[sampled & use]), histogram((residual - near)[sampled & use & near_use])
    return np.stack(counts).astype(np.int32)


def noise_threshold_squared(histogram, low=0.25, high=4.0):
    residuals, changes = histogram

    def start(b):
        return np.array([(b + HISTORY.RESIDUAL_FIRST_BIN) << 22], np.uint32).view(F)[0]

    def quantile_bin(counts, share):
        return int(np.argmax(np.cumsum(counts) >= F(share) * F(counts.sum())))

    if residuals.sum() == 0:
        return F(low * low)
    first = last = quantile_bin(residuals, 0.1)
    below = residuals[: first + 1].sum()
    while last + 2 < len(residuals) and residuals[last + 1 : last + 3].sum() > F(0.01) * F(below):
        last += 1
        below += residuals[last]
    noise = min(start(last + 1), F(64) * start(quantile_bin(residuals, 0.25) + 1))
    if start(first) > F(HISTORY.CAMERA_ERROR) ** 2 and changes.sum():
        change = F(16) * start(quantile_bin(changes, 0.97) + 1)
        noise = change if change < start(first) else noise
    return np.clip(noise, F(low * low), F(high * high))


def _depth_met(px, expected, tolerance, depth_prev):
    """One fragment's look-up in the previous depth: (depth or −1, index of the pixel used)."""
    height, width = depth_prev.shape

    def plausible(z):
        return z > 0 and not np.isinf(z) and abs(z - expected) <= tolerance

    if not (-4 < px[0] < width + 4 and -4 < px[1] < height + 4):
        return F(-1), 0
    fx, fy = px[0] - F(0.5), px[1] - F(0.5)
    x0, y0 = int(np.floor(fx)), int(np.floor(fy))
    u, v = fx - F(x0), fy - F(y0)
    total = weights = heaviest = F(0)
    nearest = 0
    for tap in range(4):
        x, y = x0 + (tap & 1), y0 + (tap >> 1)
        if not (0 <= x < width and 0 <= y < height) or not plausible(depth_prev[y, x]):
            continue
        weight = (u if tap & 1 else F(1) - u) * (v if tap >> 1 else F(1) - v)
        total = total + weight * depth_prev[y, x]
        weights = weights + weight
        if weight > heaviest:
            heaviest, nearest = weight, y * width + x
    if weights > 0:
        return total / weights, nearest
    found, closest = F(-1), INF
    xc, yc = int(np.floor(px[0])), int(np.floor(px[1]))
    around = range(-HISTORY.SEARCH_RADIUS, HISTORY.SEARCH_RADIUS + 1)
    for y in (yc + k for k in around):
        for x in (xc + k for k in around):
            if not (0 <= x < width and 0 <= y < height):
                continue
            dx, dy = F(x + 0.5) - px[0], F(y + 0.5) - px[1]
            distance = dx * dx + dy * dy
            if distance < closest and plausible(depth_prev[y, x]):
                closest, found, nearest = distance, depth_prev[y, x], y * width + x
    if found > 0:
        return found, nearest
    taps = []
    for tap in range(4):
        x, y = x0 + (tap & 1), y0 + (tap >> 1)
        if not (0 <= x < width and 0 <= y < height):
            return F(-1), nearest
        z = depth_prev[y, x]
        if not (z > 0 and not np.isinf(z) and abs(z - expected) <= HISTORY.DEPTH_CHANGE_MOST * expected):
            return F(-1), nearest
        taps.append(z)
        total = total + (u if tap & 1 else F(1) - u) * (v if tap >> 1 else F(1) - v) * z
    nearest = (y0 + (v >= 0.5)) * width + x0 + (u >= 0.5)
    return (total if max(taps) - min(taps) <= HISTORY.DEPTH_TOLERANCE * min(taps) else F(-1)), nearest


def track_history(
    depth,
    motion,
    positions,
    threshold_squared,
    to_previous,
    from_previous,
    depth_prev,
    dynamic_prev,
    history_prev,
):
    """Algorithm 1; `depth_prev` None after a reset. Returns dynamic mask (H, W), the depth met (H, W) and history
    (k−1, H, W, 4), 0 where static."""
    height, width = depth.shape
    px = centres(height, width)
    p0 = unproject(px, depth, to_previous[4])
    dynamic = np.zeros((height, width), np.uint8)
    met_depth = np.zeros((height, width), F)
    history = np.zeros((positions - 1, height, width, 4), F)
    if depth_prev is None:
        return dynamic, met_depth, history
    r2, where = static_residual_squared(depth, motion, to_previous)
    usable = np.isfinite(motion).all(-1)
    dynamic[:] = ~usable | (where[..., 2] < 0) | ~(r2 <= threshold_squared)
    dynamic[invalid(depth) | np.isinf(depth)] = 0
    history[:, dynamic > 0, :3] = p0[dynamic > 0]
    for y, x in np.argwhere((dynamic > 0) & usable & (where[..., 2] > 0)):
        px_prev, at = px[y, x] + motion[y, x], where[y, x]
        sideways = (abs(px_prev[0] - at[0]) + abs(px_prev[1] - at[1])) * from_previous[4, 0] * at[2]
        tolerance = HISTORY.DEPTH_TOLERANCE * at[2] + HISTORY.DEPTH_PER_MOTION * sideways
        z_prev, nearest = _depth_met(px_prev, at[2], tolerance, depth_prev)
        if not z_prev > 0:
            continue
        met_depth[y, x] = z_prev
        p1_prev = unproject(px_prev, z_prev, from_previous[4])
        history[0, y, x] = (*move(p1_prev, from_previous), 1)
        ny, nx = divmod(nearest, width)
        at_nearest = unproject(np.array([nx + 0.5, ny + 0.5], F), depth_prev[ny, nx], from_previous[4])
        offset = p1_prev - at_nearest
        for k in range(1, positions - 1):
            older = np.append(at_nearest, F(1))
            if dynamic_prev[ny, nx]:
                older = history_prev[k - 1, ny, nx]
            if older[3] == 0:
                break
            history[k, y, x] = (*move(older[:3] + offset, from_previous), 1)
    return dynamic, met_depth, history


# ---- acceleration --------------------------------------------------------------------------------------


def _is_of_cell(z, cell_depth):
    return abs(z - cell_depth) <= ACCELERATION.CELL_TOLERANCE * cell_depth


def _mover_of_cell(inside, p0, p1, px_prev, depth, met_depth):
    """Mean velocity, position and depths of the nearest mover among pixels `inside`; None if there is none."""
    nearest = min((depth[at] for at in inside), default=INF)
    of_it = [at for at in inside if _is_of_cell(depth[at], nearest)]
    if not of_it:
        return None
    count = F(len(of_it))
    return [sum((a[at] for at in of_it), F(0)) / count for a in (p0 - p1, px_prev, depth, met_depth)]


def _trust(velocity, found, before):
    size, speed = (found * found).sum(), ACCELERATION.BEND_MOST**2 * (velocity * velocity).sum()
    if not size > 0:
        return F(0)
    lasted = np.clip((found * before).sum() / size, F(0), F(1))
    return lasted * (speed / size) if size > speed else lasted


def _carried_on(found, before):
    """The third difference goes on as at α = ½, less where it is over a quarter of the second."""
    change, most = found - before, F(ACCELERATION.TURN_MOST) * np.linalg.norm(found)
    size = np.linalg.norm(change)
    return found + F(ACCELERATION.TURN) * change * (F(1) if size <= most else (most / size) ** 2)


def _as_packed(acceleration):
    """As it reads after packing: ten bits of the mantissa, trust in steps of 1/62."""
    vector = ((np.ascontiguousarray(acceleration[..., :3]).view(np.uint32) + 0x1000) & 0xFFFFE000).view(F)
    trust, steps = acceleration[..., 3:], F(ACCELERATION.MOST_TRUST)
    return np.concatenate([vector, np.where(trust < 0, F(-1), np.floor(trust * steps + F(0.5)) / steps)], -1)


def track_acceleration(
    depth, motion, dynamic, met_depth, velocity_prev, acceleration_prev, ratio, to_previous, from_previous
):
    """Velocity and depth, acceleration and trust, what goes on of it, of cells, (⌈H/4⌉, ⌈W/4⌉, 4) each."""
    side, (height, width) = ACCELERATION.CELL, depth.shape
    cells = -(-height // side), -(-width // side)
    velocity, acceleration, bend = (np.zeros((*cells, 4), F) for _ in range(3))
    acceleration[..., 3] = -1
    known = (dynamic > 0) & (met_depth > 0)
    px = centres(height, width)
    with np.errstate(all="ignore"):
        px_prev = px + motion
        p0 = unproject(px, depth, to_previous[4])
        p1 = move(unproject(px_prev, met_depth, from_previous[4]), from_previous)
    for y, x in np.ndindex(cells):
        rows, columns = range(side * y, min(side * y + side, height)), range(side * x, min(side * x + side, width))
        inside = [(j, i) for j in rows for i in columns if known[j, i]]
        mover = _mover_of_cell(inside, p0, p1, px_prev, depth, met_depth)
        if mover is None:
            continue
        v, at, z, z_prev = mover
        velocity[y, x] = (*v, z)
        at = at / F(side) - F(0.5)
        x0, y0 = map(int, np.floor(at))
        was, before, weights, before_weights = np.zeros(3, F), np.zeros(3, F), F(0), F(0)
        for tap in range(4):
            i, j = x0 + (tap & 1), y0 + (tap >> 1)
            if not (0 <= i < cells[1] and 0 <= j < cells[0]):
                continue
            v_prev, a_prev = velocity_prev[j, i], acceleration_prev[j, i]
            if not v_prev[3] > 0 or not _is_of_cell(v_prev[3], z_prev):
                continue
            u, w = at - (x0, y0)
            weight = F(u if tap & 1 else 1 - u) * F(w if tap >> 1 else 1 - w)
            was, weights = was + weight * v_prev[:3], weights + weight
            if a_prev[3] >= 0:
                before, before_weights = before + weight * a_prev[:3], before_weights + weight
        if not weights > 0:
            continue
        found = (v - ratio * rotate(was / weights, from_previous)) * (ratio / (1 + ratio))
        acceleration[y, x] = (*found, 0)
        if before_weights > 0:
            before = ratio * ratio * rotate(before / before_weights, from_previous)
            acceleration[y, x, 3] = _trust(v, found, before)
            bend[y, x, :3] = acceleration[y, x, 3] * _carried_on(found, before)
    bend[..., 3] = np.maximum(acceleration[..., 3], F(0))
    return velocity, _as_packed(acceleration), _as_packed(bend)


# ---- prediction ----------------------------------------------------------------------------------------


def predict_positions(depth, dynamic, history, order, weights, to_target, alpha=0, movers=None):
    """(H, W, 3) float32: px in the target image, view depth (−1: nothing). `movers`: velocity, acceleration and
    what goes on of it, of cells, where acceleration is used."""
    px = centres(*depth.shape)
    out = reproject(px, depth, to_target)
    p0 = unproject(px, depth, to_target[4])
    known = np.cumprod(history[:order, ..., 3] != 0, axis=0).sum(0)
    predicted = p0.copy()
    for k in range(order):
        weight = np.where(known > 0, weights[np.maximum(known, 1) - 1, k], F(0))
        step = weight[..., None] * (history[k, ..., :3] - p0)
        predicted = np.where((known > k)[..., None], predicted + step, predicted)
    if movers:
        height, width = depth.shape
        side = PREDICTION.CELL
        velocity, _, bend = (a.repeat(side, 0).repeat(side, 1)[:height, :width] for a in movers)
        with np.errstate(invalid="ignore"):
            near = np.abs(depth - velocity[..., 3]) <= PREDICTION.CELL_TOLERANCE * velocity[..., 3]
        step = F(alpha) * (F(alpha) + F(1)) * bend[..., :3]
        predicted = np.where(((known > 0) & near)[..., None], predicted + step, predicted)
    target = move(predicted, to_target)
    moved = np.concatenate([project(target, to_target[5]), target[..., 2:]], -1)
    out[dynamic > 0] = moved[dynamic > 0]
    out[invalid(depth) | ~(out[..., 2] > 0)] = (PREDICTION.NOWHERE, PREDICTION.NOWHERE, -1)
    return out


# ---- warp ----------------------------------------------------------------------------------------------

_STEPS = ((1, 0), (0, 1), (-1, 0), (0, -1))  # right, down, left, up: bits 1, 2, 4, 8


def _shifted(image, dx, dy, fill):
    """image[y + dy, x + dx], `fill` outside."""
    height, width = image.shape[:2]
    out = np.full_like(image, fill)
    ys, xs = slice(max(-dy, 0), height - max(dy, 0)), slice(max(-dx, 0), width - max(dx, 0))
    yd, xd = slice(max(dy, 0), height + min(dy, 0)), slice(max(dx, 0), width + min(dx, 0))
    if ys.start < ys.stop and xs.start < xs.stop:
        out[ys, xs] = image[yd, xd]
    return out


def link_surfaces(depth, dynamic):
    with np.errstate(all="ignore"):
        w = np.where(invalid(depth), F(-1), np.where(np.isinf(depth), F(0), F(1) / depth)).astype(F)
    links = np.zeros(depth.shape, np.uint8)
    for bit, (dx, dy) in enumerate(_STEPS):
        a2, a = _shifted(w, -dx, -dy, -1), w
        b, b2 = _shifted(w, dx, dy, -1), _shifted(w, 2 * dx, 2 * dy, -1)
        size = np.maximum(a, b)
        near = np.abs(a - b) <= SURFACES.SURFACE_STEP * size
        near |= (a2 > 0) & (np.abs((a - a2) - (b - a)) <= SURFACES.SURFACE_CURVATURE * size)
        near |= (b2 > 0) & (np.abs((b2 - b) - (b - a)) <= SURFACES.SURFACE_CURVATURE * size)
        sky = (a == 0) | (b == 0)
        same = (a >= 0) & (b >= 0) & np.where(sky, a == b, near)
        links |= (same & (_shifted(dynamic, dx, dy, 2) == dynamic)).astype(np.uint8) << bit
    return links


def unmixed(depth, dynamic):
    """(H, W) uint8: 1 where depth is valid and no pixel within 2 px is dynamic or nearer."""
    keep = ~invalid(depth)
    around = range(-SURFACES.GROW, SURFACES.GROW + 1)
    for dy in around:
        for dx in around:
            with np.errstate(invalid="ignore"):
                nearer = _shifted(depth, dx, dy, np.inf) < depth * SURFACES.NEARER
            keep &= ~(_shifted(dynamic, dx, dy, 0) > 0) & ~nearer
    return keep.astype(np.uint8)


def flow(target_position, depth, links, zoom):
    """Jacobian columns ddx, ddy (H, W, 3) and the determinant of its 2×2 part."""
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
    """Times the determinant."""
    x, y = d[..., 0], d[..., 1]
    return np.stack([ddy[..., 1] * x - ddy[..., 0] * y, ddx[..., 0] * y - ddx[..., 1] * x], -1)


def smooth_blocks(target_position, depth, links, zoom):
    """(rows, columns) bool: source blocks over which predicted positions change linearly."""
    height, width = depth.shape
    rows, columns = -(-height // BLOCKS.BLOCK_HEIGHT), -(-width // BLOCKS.BLOCK_WIDTH)
    linked = np.zeros((height + 4, width + 4), bool)  # with a border that is not
    linked[2:-2, 2:-2] = links == BLOCKS.ALL_LINKS
    smooth = np.zeros((rows, columns), bool)
    for by in range(rows):
        for bx in range(columns):
            y, x = by * BLOCKS.BLOCK_HEIGHT, bx * BLOCKS.BLOCK_WIDTH
            y1, x1 = y + BLOCKS.BLOCK_HEIGHT, x + BLOCKS.BLOCK_WIDTH
            if y1 > height or x1 > width or not linked[y : y1 + 4, x : x1 + 4].all():
                continue
            around = target_position[y - 1 : y1 + 1, x - 1 : x1 + 1]
            here = around[1:-1, 1:-1]
            left, right, up, down = around[1:-1, :-2], around[1:-1, 2:], around[:-2, 1:-1], around[2:, 1:-1]
            z, z_source = here[..., 2], depth[y:y1, x:x1]
            left, right, up, down, here = (a[..., :2] for a in (left, right, up, down, here))
            most = BLOCKS.STRETCH_HIGH
            flat = (z > 0) & (z_source <= most * z) & (z <= most * z_source)
            for a, b in ((left, right), (up, down)):
                bend = np.abs((b - here) - (here - a))
                flat &= (bend <= BLOCKS.BEND_MOST).all(-1)
            ddx, ddy = F(0.5) * (right - left), F(0.5) * (down - up)
            for along, across, size in ((ddx[..., 0], ddy[..., 0], zoom[0]), (ddy[..., 1], ddx[..., 1], zoom[1])):
                flat &= (along >= BLOCKS.STRETCH_LOW * size) & (along <= most * size)
                flat &= np.abs(across) <= BLOCKS.SHEAR_MOST * size
            turn = np.abs(ddx[1:] - ddx[:-1]) <= BLOCKS.BEND_MOST
            smooth[by, bx] = flat.all() and turn.all()
    return smooth


def block_classes(smooth, target_position, depth, links, zoom, target_size):
    """(rows, columns) bool: target blocks that are warped backward."""
    width, height = target_size
    side = np.array((BLOCKS.BLOCK_WIDTH, BLOCKS.BLOCK_HEIGHT))
    rows, columns = -(-height // side[1]), -(-width // side[0])
    low, high = np.full((rows, columns, 2), 10**6), np.full((rows, columns, 2), -1)
    spoilt = np.zeros((rows, columns), bool)
    ddx, ddy, _ = flow(target_position, depth, links, zoom)
    here = target_position[..., :2]
    reach = F(WARP.FOOTPRINT_REACH)
    half = np.minimum(WARP.FOOTPRINT_HALF * (np.abs(ddx[..., :2]) + np.abs(ddy[..., :2])), reach)
    with np.errstate(invalid="ignore"):
        lands = (
            (target_position[..., 2] > 0) & (here > -reach).all(-1) & (here < np.array(target_size, F) + reach).all(-1)
        )
    for by, bx in np.ndindex(*smooth.shape):
        part = np.s_[by * side[1] : (by + 1) * side[1], bx * side[0] : (bx + 1) * side[0]]
        use = lands[part]
        if not use.any():
            continue
        first, last = (here[part] - half[part])[use].min(0), (here[part] + half[part])[use].max(0)
        if (last <= 0).any() or (first >= target_size).any():
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
        backward[by, bx] = near and smooth[y0 : y1 + 1, x0 : x1 + 1].all()
    if width % side[0]:
        backward[:, -1] = False
    return backward


def splat(target_position, depth, links, zoom, target_size, close_cracks):
    """(H', W') uint64 keys: depth bits << 32 | source index; all ones where nothing lands."""
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


def _cubic_weights(t):
    t2, t3 = t * t, t * t * t
    t3 = t2 * t
    h = F(0.5)
    return np.stack(
        [
            -h * t + t2 - h * t3,
            F(1) - F(2.5) * t2 + F(1.5) * t3,
            h * t + F(2) * t2 - F(1.5) * t3,
            h * t3 - h * t2,
        ]
    )


def resolve(keys, target_position, color, depth, dynamic, links, zoom):
    """All outputs of the warp, as a dict of (H', W', …) arrays named like the stage's buffers."""
    height, width = keys.shape
    source_height, source_width = depth.shape
    holes = keys == np.iinfo(np.uint64).max
    s = np.where(holes, 0, keys & np.uint64(NOBODY)).astype(int)
    sy, sx = np.divmod(s, source_width)
    here = target_position[sy, sx]
    ddx, ddy, det = (a[sy, sx] for a in flow(target_position, depth, links, zoom))
    centre = centres(height, width)
    with np.errstate(invalid="ignore"):
        d = np.clip(_source_offset(ddx, ddy, centre - here[..., :2]) / det[..., None], F(-1), F(1))
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

    p = d + np.stack([step_x, step_y], -1).astype(F)
    o = np.floor(p).astype(int)
    u, v = (p - o.astype(F))[..., 0], (p - o.astype(F))[..., 1]
    rgb = load_color(color)
    alike, taps = {}, {}
    for ty in range(4):
        for tx in range(4):
            inside, e = deviation(o[..., 0] + tx - 1, o[..., 1] + ty - 1)
            _, y, x = at(o[..., 0] + tx - 1, o[..., 1] + ty - 1)
            alike[ty, tx], taps[ty, tx] = inside & (e <= WARP.SAME_MOTION), rgb[y, x]
    told_by = [(ty, tx) for ty in range(4) for tx in range(4) if (ty in (1, 2)) == (tx in (1, 2))]
    everywhere = np.all([alike[tap] for tap in told_by], axis=0)
    wx, wy = _cubic_weights(u), _cubic_weights(v)
    cubic = np.zeros((height, width, 3), F)
    for tx in range(4):
        column = np.zeros((height, width, 3), F)
        for ty in range(4):
            column = column + wy[ty][..., None] * taps[ty, tx]
        cubic = cubic + wx[tx][..., None] * column
    stack = np.stack([taps[ty, tx] for ty in (1, 2) for tx in (1, 2)])
    cubic = np.clip(cubic, stack.min(0), stack.max(0))
    linear, weights = np.zeros((height, width, 3), F), np.zeros((height, width), F)
    for tap in range(4):
        tx, ty = tap & 1, tap >> 1
        weight = (u if tx else F(1) - u) * (v if ty else F(1) - v)
        weight = np.where(alike[ty + 1, tx + 1], weight, F(0))
        linear = linear + weight[..., None] * taps[ty + 1, tx + 1]
        weights = weights + weight
    with np.errstate(all="ignore"):
        linear = np.where((weights > F(0.01))[..., None], linear / weights[..., None], rgb[sy, sx])
    out = np.where(everywhere[..., None], cubic, linear)
    out = np.where(((p == 0).all(-1))[..., None], rgb[sy, sx], out)
    out = np.clip(out, -COLOR_MAX, COLOR_MAX)

    z = here[..., 2] + ddx[..., 2] * d[..., 0] + ddy[..., 2] * d[..., 1]
    source_centre = np.stack([sx + 0.5, sy + 0.5], -1).astype(F)
    own_pixel = (np.floor(here[..., :2]) == np.floor(centre)).all(-1)
    result = {
        "color": np.concatenate([out, np.zeros((height, width, 1), F)], -1).astype(np.float16),
        "depth": np.where(z > 0, z, here[..., 2]),
        "motion": source_centre + d - centre,
        "dynamic": dynamic[sy, sx].copy(),
        "disoccluded": holes.astype(np.uint8),
        "mixed": ((step_x != 0) | (step_y != 0)).astype(np.uint8),
        "filled_by": np.where(own_pixel, COMMON.BY_WARP, COMMON.BY_CRACK_CLOSING).astype(np.uint8),
    }
    for name, empty in (
        ("color", 0),
        ("depth", INF),
        ("motion", 0),
        ("dynamic", 0),
        ("mixed", 0),
        ("filled_by", COMMON.BY_NOTHING),
    ):
        result[name][holes] = empty
    return result


# ---- holes ---------------------------------------------------------------------------------------------


def downsample(warped, source_color, source_depth):
    """Weighted sums per 32×32 block: (colour, 1) (h, w, 4) and inverse depth (h, w), float64 accuracy."""
    height, width = warped["depth"].shape
    size = HOLES.BLOCK
    blocks = (-(-height // size), -(-width // size))
    color_sum, inverse_sum = np.zeros((*blocks, 4)), np.zeros(blocks)
    y, x = np.mgrid[:height, :width]
    sy, sx = y * source_depth.shape[0] // height, x * source_depth.shape[1] // width
    rendered = (load_color(source_color)[sy, sx], source_depth[sy, sx], HOLES.RENDERED_WEIGHT)
    warp = (load_color(warped["color"]), warped["depth"], 1.0)
    for (c, z, pixel_weight), use in (
        (warp, warped["filled_by"] != COMMON.BY_NOTHING),
        (rendered, ~invalid(rendered[1])),
    ):
        c = c.astype(np.float64)
        weight = np.where(use, pixel_weight / (1 + np.maximum(c.max(-1), 0)), 0)
        with np.errstate(all="ignore"):
            inverse = np.where(np.isinf(z) | ~use, 0, 1 / z.astype(np.float64))
        np.add.at(color_sum, (y // size, x // size), weight[..., None] * np.dstack([c, np.ones_like(weight)]))
        np.add.at(inverse_sum, (y // size, x // size), weight * inverse)
    return color_sum, inverse_sum


def _upsample(mean, height, width):
    """Bilinear interpolation of a level (h, w, 4) at the texels of the next finer one."""
    y, x = np.mgrid[:height, :width]
    u, v = np.where(x & 1, F(0.25), F(0.75)), np.where(y & 1, F(0.25), F(0.75))
    total = np.zeros((height, width, 4), F)
    for tap in range(4):
        tx = np.clip(((x - 1) >> 1) + (tap & 1), 0, mean.shape[1] - 1)
        ty = np.clip(((y - 1) >> 1) + (tap >> 1), 0, mean.shape[0] - 1)
        weight = np.where(tap & 1, u, F(1) - u) * np.where(tap >> 1, v, F(1) - v)
        total = total + weight[..., None] * mean[ty, tx]
    return total


def _quads(image):
    """(4, h/2, w/2, …): the four children of each texel of the next level, zeros beyond the border."""
    height, width = image.shape[:2]
    padded = np.pad(image, ((0, height % 2), (0, width % 2)) + ((0, 0),) * (image.ndim - 2))
    return np.stack([padded[k >> 1 :: 2, k & 1 :: 2] for k in range(4)])


def push_pull(warped):
    """(H, W, 4) colour and inverse depth for every pixel, from a pyramid of means of the valid ones."""
    height, width = warped["depth"].shape
    valid = (warped["filled_by"] != COMMON.BY_NOTHING).astype(F)
    color = load_color(warped["color"])
    with np.errstate(all="ignore"):
        inverse = np.where(np.isinf(warped["depth"]), F(0), F(1) / warped["depth"])
    weight = valid / (F(1) + np.maximum(color.max(-1), F(0)))
    values = np.concatenate([color, np.where(valid > 0, inverse, F(0))[..., None]], -1).astype(F)
    total, count = (_quads(weight[..., None] * values).sum(0), _quads(weight).sum(0))
    with np.errstate(all="ignore"):
        means = [np.where(count[..., None] > 0, total / count[..., None], F(0)).astype(F)]
    weights = [(count > 0).astype(F)]
    for _ in range(max(1, (max(height, width) - 1).bit_length()) - 1):
        total, count = _quads(weights[-1][..., None] * means[-1]).sum(0), _quads(weights[-1]).sum(0)
        with np.errstate(all="ignore"):
            means.append(np.where(count[..., None] > 0, total / count[..., None], F(0)).astype(F))
        weights.append(np.minimum(count, F(1)))
    for level in range(len(means) - 2, -1, -1):
        w = weights[level][..., None]
        means[level] = w * means[level] + (F(1) - w) * _upsample(means[level + 1], *means[level].shape[:2])
    return _upsample(means[0], height, width)


_DIRECTIONS = ((1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1))


def march(y, x, d, reach, shape):
    """(distance in px, (y, x)) of the pixels from (y, x) on in direction d that lie in the image and within reach."""
    step = F(1.41421356) if d[0] and d[1] else F(1)
    t = 1
    while F(t) * step <= F(reach):
        qx, qy = x + t * d[0], y + t * d[1]
        if not (0 <= qx < shape[1] and 0 <= qy < shape[0]):
            return
        yield F(t) * step, (qy, qx)
        t += 1


def continued(beside, at, source_color):
    """What is beside a hole that lies out of screen, with the border of the rendered image (height, width, 3)."""
    if not at[2] > 0:
        return beside
    height, width = source_color.shape[:2]
    x, y = np.clip(at[0] - F(0.5), 0, F(width - 1)), np.clip(at[1] - F(0.5), 0, F(height - 1))
    xs, ys = [int(x), min(int(x) + 1, width - 1)], [int(y), min(int(y) + 1, height - 1)]
    across = [source_color[j, xs[0]] * (1 - x % 1) + source_color[j, xs[1]] * (x % 1) for j in ys]
    return (beside + across[0] * (1 - y % 1) + across[1] * (y % 1)) / 2


def source_of(y, x, inverse, to_source):
    """Where a static pixel of the new frame is in the rendered one: x, y, depth."""
    z = np.array([F(1) / inverse if inverse > 0 else INF], F)
    return reproject(np.array([[x + 0.5, y + 0.5]], F), z, to_source)[0]


def is_outside(at, image):
    height, width = image.shape[:2]
    return not (at[2] > 0 and 0 <= at[0] < width and 0 <= at[1] < height)


def far_side(warped, y, x, reach, to_source, source_color):
    """(colour, inverse depth) of the far side around one hole, or None; `source_color`: (height, width, 3)."""
    met = []
    for d in _DIRECTIONS:
        for distance, q in march(y, x, d, reach, warped["depth"].shape):
            if warped["filled_by"][q] != COMMON.BY_NOTHING:
                z = warped["depth"][q]
                inverse = F(0) if np.isinf(z) else F(1) / z
                met.append((inverse, F(1) / distance, np.append(load_color(warped["color"][q]), inverse)))
                break
    if not met:
        return None

    def mean(weighted):
        return sum(w * values for w, values in weighted) / sum(w for w, _ in weighted)

    ways = [source_of(y, x, inverse, to_source) for inverse, _, _ in met]
    outside = [(w * w, values) for at, (_, w, values) in zip(ways, met, strict=True) if is_outside(at, source_color)]
    if outside:
        found = mean(outside)
        return np.append(continued(found[:3], source_of(y, x, found[3], to_source), source_color), found[3])
    least = min(inverse for inverse, _, _ in met)
    return mean([(w, values) for inverse, w, values in met if not inverse > least * HOLES.FAR_SIDE])


def mix_far_side(warped):
    """Colour of the frame as the background left it, its fills mixed with the far side."""
    color, shown = warped["color"].copy(), load_color(warped["color"])
    hole = warped["disoccluded"] != 0
    remembered = hole & ~np.isin(warped["filled_by"], (COMMON.BY_NOTHING, COMMON.BY_HIDDEN_PART))
    with np.errstate(divide="ignore"):
        inverse = F(1) / warped["depth"]
    for y, x in np.argwhere(remembered):
        met = []
        for d in _DIRECTIONS:
            found = (m for m in march(y, x, d, HOLES.MIXED_REACH, hole.shape) if not hole[m[1]])
            met += [(F(1) / distance, q) for distance, q in itertools.islice(found, 1)]
        least = min((inverse[q] for _, q in met), default=F(0))
        far = [(closeness, q) for closeness, q in met if inverse[q] <= least * HOLES.FAR_SIDE]
        if not far:
            continue
        weights = np.array([closeness for closeness, _ in far], F)
        colors = np.array([shown[q] for _, q in far])
        mean = np.average(colors, axis=0, weights=weights)
        spread = np.average((colors.mean(1) - mean.mean()) ** 2, weights=weights)
        typical = (HOLES.CONTRAST * mean.mean()) ** 2
        counts = weights.max() * (typical / (typical + spread) if spread > 0 else 1)
        color[y, x, :3] = (shown[y, x] + counts * mean) / (1 + counts)
    return color


def asked_blocks(warped, reach, to_source, source_color):
    """(h, w) bool: the 32×32 blocks between whose centres a hole lies that has no far side."""
    height, width = warped["depth"].shape
    asked = np.zeros((-(-height // HOLES.BLOCK), -(-width // HOLES.BLOCK)), bool)
    for y, x in np.argwhere(warped["filled_by"] == COMMON.BY_NOTHING):
        if far_side(warped, y, x, reach, to_source, source_color) is None:
            y0, x0 = ((c + 0.5) / HOLES.BLOCK - 0.5 for c in (y, x))
            for tap in range(4):
                ty, tx = int(np.floor(y0)) + (tap >> 1), int(np.floor(x0)) + (tap & 1)
                asked[np.clip(ty, 0, asked.shape[0] - 1), np.clip(tx, 0, asked.shape[1] - 1)] = True
    return asked


def fill_holes(warped, color_sum, inverse_sum, to_source, reach, source_color):
    """Colour, depth, motion of the warped frame with its holes filled: from the far side within `reach` px,
    else from the block sums; by push-pull if these are None."""
    if color_sum is None:
        filled = push_pull(warped)
        return _filled(warped, filled[..., :3], filled[..., 3], to_source)
    height, width = warped["depth"].shape
    px = centres(height, width)
    b = px.astype(np.float64) / HOLES.BLOCK - 0.5
    b0 = np.floor(b).astype(int)
    f = b - b0
    total, inverse = np.zeros((height, width, 4)), np.zeros((height, width))
    for tap in range(4):
        x = np.clip(b0[..., 0] + (tap & 1), 0, color_sum.shape[1] - 1)
        y = np.clip(b0[..., 1] + (tap >> 1), 0, color_sum.shape[0] - 1)
        weight = np.abs(1 - (tap & 1) - f[..., 0]) * np.abs(1 - (tap >> 1) - f[..., 1])
        total += weight[..., None] * color_sum[y, x]
        inverse += weight * inverse_sum[y, x]
    with np.errstate(all="ignore"):
        mean = np.where(total[..., 3:] > 0, total[..., :3] / total[..., 3:], 0)
        mean_inverse = np.where(total[..., 3] > 0, inverse / total[..., 3], 0)
    holes = warped["filled_by"] == COMMON.BY_NOTHING
    for y, x in np.argwhere(holes):
        found = far_side(warped, y, x, reach, to_source, source_color)
        if found is not None:
            mean[y, x], mean_inverse[y, x] = found[:3], found[3]
        elif reach > 0:
            at = source_of(y, x, mean_inverse[y, x], to_source)
            if is_outside(at, source_color):
                mean[y, x] = continued(mean[y, x], at, source_color)
    return _filled(warped, mean, mean_inverse, to_source)


def _filled(warped, mean, mean_inverse, to_source):
    px = centres(*warped["depth"].shape)
    holes = warped["filled_by"] == COMMON.BY_NOTHING
    with np.errstate(all="ignore"):
        z = np.where(mean_inverse > 0, 1 / mean_inverse, np.inf).astype(F)
    out = {name: warped[name].copy() for name in ("color", "depth", "motion")}
    out["color"][holes, :3] = mean[holes]
    out["depth"][holes], out["motion"][holes] = z[holes], static_motion(px, z, to_source)[holes]
    return out


def static_motion(px, z, to_source):
    """Motion into the source image of static points at depth z of the target."""
    where = reproject(px, z, to_source)
    return np.where((where[..., 2] > 0)[..., None], where[..., :2] - px, F(0))


# ---- hidden parts of movers ----------------------------------------------------------------------------


def fill_hidden_parts(warped, source_depth, zoom, to_source, reach):
    """color, depth, motion and filled_by of the warped frame with the hidden parts of movers."""
    out = {name: warped[name].copy() for name in ("color", "depth", "motion", "filled_by")}
    depth, holes, dynamic = warped["depth"], warped["disoccluded"] > 0, warped["dynamic"] > 0
    height, width = source_depth.shape

    def moves_along(q, y, x):
        offset = [F(x - q[1]) / zoom[0], F(y - q[0]) / zoom[1]]
        return np.array([q[1] + 0.5, q[0] + 0.5], F) + warped["motion"][q] + np.array(offset, F)

    def mover(y, x, d):
        """(distance, pixel) of the first mover in direction d, or None."""
        before = []
        for distance, q in march(y, x, d, reach, depth.shape):
            if not dynamic[q]:
                before += [] if holes[q] else [depth[q]]
                continue
            if any(not z < depth[q] * HIDDEN.STANDS_BEFORE for z in before):
                return None
            px = moves_along(q, y, x)
            if not (0 <= px[0] < width and 0 <= px[1] < height):
                return None
            shown = source_depth[int(px[1]), int(px[0])]
            then = reproject(np.array([[q[1] + 0.5, q[0] + 0.5]], F), depth[q][None], to_source)[0, 2]
            return (distance, q) if not shown > 0 or shown < HIDDEN.HIDES * then else None
        return None

    def same(a, b):
        return abs(a - b) <= HIDDEN.ONE_OBJECT * min(a, b)

    for y, x in np.argwhere(holes):
        met = [mover(y, x, d) for d in _DIRECTIONS]
        found = [m for m in met if m]
        if not found:
            continue
        distance, of = min(found, key=lambda m: m[0])
        if distance * F(HIDDEN.BESIDE) > F(reach):
            pairs = [(met[k], met[(k + 4) % 8]) for k in range(8) if met[k] and met[(k + 4) % 8]]
            pairs = [a for a, b in pairs if a[0] + b[0] <= F(reach) and same(depth[a[1]], depth[b[1]])]
            if not pairs:
                continue
            of = min(pairs, key=lambda m: m[0])[1]
        z = depth[of]
        alike = [(F(1) / d, q) for d, q in found if abs(depth[q] - z) <= HIDDEN.ONE_OBJECT * z]
        total = sum(w for w, _ in alike)
        out["color"][y, x, :3] = sum(w * load_color(warped["color"][q]) for w, q in alike) / total
        out["depth"][y, x] = sum(w * depth[q] for w, q in alike) / total
        px = sum(w * moves_along(q, y, x) for w, q in alike) / total
        out["motion"][y, x] = px - np.array([x + 0.5, y + 0.5], F)
        out["filled_by"][y, x] = COMMON.BY_HIDDEN_PART
    return out


# ---- background ----------------------------------------------------------------------------------------

EMPTY_TEXEL, SHOWN, REMEMBERED = BACKGROUND.EMPTY, BACKGROUND.SHOWN, BACKGROUND.REMEMBERED


def collect_shown(color, depth, dynamic, collect):
    """Level 0 before anything is remembered: a dict of color (H, W, 4) float16, depth, px, state."""
    height, width = depth.shape
    keep = collect & (unmixed(depth, dynamic) > 0)
    packed = np.zeros((height, width, 4), np.float16)
    packed[..., :3] = load_color(color)
    return {
        "color": packed,
        "depth": depth.copy(),
        "px": centres(height, width),
        "state": np.where(keep, SHOWN, EMPTY_TEXEL).astype(np.uint8),
    }


def as_rgb9e5(color):
    """(…, 4) float16 of colours (…, 3 or 4) once they were stored in three mantissas that share an exponent."""
    kept = np.clip(color[..., :3].astype(np.float64), 0, BACKGROUND.COLOR_MOST)
    exponent = np.floor(np.log2(np.maximum(kept.max(-1, keepdims=True), 2.0**-16)))
    carries = np.rint(kept.max(-1, keepdims=True) * 2.0 ** (8 - exponent)) == 512
    unit = 2.0 ** (exponent + carries - 8)
    out = np.zeros((*color.shape[:-1], 4), np.float16)
    out[..., :3] = np.rint(kept / unit) * unit
    return out


def as_offset(px, texel, level):
    """(2,) float32 of a position once it was stored as the offset from the centre of `texel` (row, column)."""
    side = F(1 << level)
    centre = (np.array(texel[::-1], F) + F(0.5)) * side
    units = np.clip(np.rint((px - centre) * (BACKGROUND.PX_UNITS / side)), -32768, 32767)
    return centre + units * (side / BACKGROUND.PX_UNITS)


def _slopes(depth, links):
    most = np.zeros(depth.shape, F)
    for bit, (dx, dy) in enumerate(_STEPS):
        with np.errstate(invalid="ignore"):
            step = np.abs(_shifted(depth, dx, dy, np.nan) - depth)
        most = np.where((links >> bit) & 1 > 0, np.fmax(most, step), most)
    return np.where(np.isinf(depth), F(0), most)


def collect_levels(levels_before, level0, depth, dynamic, links, to_current):
    """All levels of a rendered frame from those of the frame before (lists of dicts) and `level0`, its
    `collect_shown`. Ties and order as in the kernels."""
    height, width = depth.shape
    count = len(levels_before)
    slopes = _slopes(depth, links)

    def may_be_at(sy, sx, z):
        """(allowed, margin, behind) for a fragment of depth z."""
        shown = depth[sy, sx]
        if invalid(shown):
            return True, F(0), True
        margin = BACKGROUND.SAME_SURFACE * shown + slopes[sy, sx]
        behind = not np.isinf(shown) if np.isinf(z) else z > shown + margin
        in_front = not np.isinf(z) if np.isinf(shown) else z < shown - margin
        return not in_front and (behind or not dynamic[sy, sx]), margin, behind

    def offer(best, cell, z, i):
        best[cell] = min(best.get(cell, (INF, 1 << 40)), (z, i))

    def settle(best, level, before, now):
        into = levels[level]
        for cell, (z, i) in best.items():
            into["state"][cell], into["depth"][cell] = REMEMBERED, z
            into["px"][cell] = as_offset(now[i, :2], cell, level)
            into["color"][cell] = as_rgb9e5(before["color"].reshape(-1, 4)[i])

    levels = [{name: array.copy() for name, array in level0.items()}]
    for level, before in enumerate(levels_before):
        now = reproject(before["px"].reshape(-1, 2), before["depth"].reshape(-1), to_current)
        x, y, z = now.T
        inside = (z > 0) & (x >= 0) & (x < width) & (y >= 0) & (y < height)
        fragments = np.flatnonzero((before["state"].reshape(-1) != EMPTY_TEXEL) & inside)
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
                level_margin = margin if level == 0 else F(2) * BACKGROUND.SAME_SURFACE * base
                if not np.isinf(base) if np.isinf(z[i]) else z[i] > base + level_margin:
                    offer(push, (sy >> (level + 1), sx >> (level + 1)), z[i], i)
        settle(fill, level, before, now)
        if push:
            settle(push, level + 1, before, now)
        reach = F(0.499) * F(1 << level)
        for i in fragments:
            for dx, dy in ((-reach, -reach), (reach, -reach), (-reach, reach), (reach, reach)):
                sx, sy = int(np.floor(x[i] + dx)), int(np.floor(y[i] + dy))
                cell = (sy >> level, sx >> level)
                if not (0 <= sx < width and 0 <= sy < height) or current["state"][cell] != EMPTY_TEXEL:
                    continue
                allowed, _, behind = may_be_at(sy, sx, z[i])
                if allowed and (level == 0 or behind):
                    offer(touched, cell, z[i], i)
        settle(touched, level, before, now)
    return levels


def shown_before(px, z, color_prev, depth_prev, unmixed_prev, to_previous):
    """Colour of a static point in the frame before, or None."""
    height, width = depth_prev.shape
    x, y, z_prev = reproject(px[None], np.array([z], F), to_previous)[0]
    if not (z_prev > 0 and 0.5 <= x < width - 0.5 and 0.5 <= y < height - 0.5) or not unmixed_prev[int(y), int(x)]:
        return None
    x0, y0 = int(x - F(0.5)), int(y - F(0.5))
    u, v = x - F(0.5) - F(x0), y - F(0.5) - F(y0)
    found = np.zeros(3, F)
    for tap in range(4):
        at = y0 + (tap >> 1), x0 + (tap & 1)
        d = depth_prev[at]
        if not (np.isinf(d) if np.isinf(z_prev) else abs(d - z_prev) <= F(2) * BACKGROUND.SAME_SURFACE * z_prev):
            return None
        weight = (u if tap & 1 else F(1) - u) * (v if tap >> 1 else F(1) - v)
        found = found + weight * load_color(color_prev[at])
    return found


def project_background(warped, levels, zoom, to_target, to_source, before):
    """color, depth, motion and filled_by of the warped frame after background projection; `before`: the arguments of
    `shown_before` from color_prev on."""
    out = {name: warped[name].copy() for name in ("color", "depth", "motion", "filled_by")}
    height, width = warped["depth"].shape
    holes = warped["disoccluded"] > 0
    best: dict = {}
    there = [reproject(level["px"], level["depth"], to_target) for level in levels]
    for number, level in enumerate(levels):
        wide = level["depth"].shape[1]
        for ty, tx in np.argwhere(level["state"] == REMEMBERED):
            x, y, z = there[number][ty, tx]
            reach = BACKGROUND.REACH
            if not (z > 0 and -reach < x < width + reach and -reach < y < height + reach):
                continue
            nearer = F(1) if np.isinf(z) else level["depth"][ty, tx] / z
            side = F(1 << number) * BACKGROUND.FOOTPRINT_HALF * nearer
            half = [min(max(side * zoom[k], F(0.5)), reach) for k in range(2)]
            x0, x1 = max(int(np.ceil(x - half[0] - F(0.5))), 0), min(int(np.floor(x + half[0] - F(0.5))), width - 1)
            y0, y1 = max(int(np.ceil(y - half[1] - F(0.5))), 0), min(int(np.floor(y + half[1] - F(0.5))), height - 1)
            key = (z, number, ty * wide + tx)
            for cell in ((cy, cx) for cy in range(y0, y1 + 1) for cx in range(x0, x1 + 1)):
                shown = warped["depth"][cell]
                alike = np.isinf(z) if np.isinf(shown) else abs(z - shown) <= BACKGROUND.SAME_SURFACE * shown
                if holes[cell] or (warped["mixed"][cell] and alike):
                    best[cell] = min(best.get(cell, (INF, 99, 0)), key)
    px = centres(height, width)

    for (y, x), (z, number, i) in best.items():
        if warped["filled_by"][y, x] == COMMON.BY_HIDDEN_PART:
            continue
        at = reproject(px[y, x][None], np.array([z], F), to_source)[0]
        if is_outside(at, levels[0]["depth"]):
            continue
        level = levels[number]
        level_height, level_width = level["depth"].shape
        ty, tx = divmod(i, level_width)
        winner = level["depth"][ty, tx]
        nearer = F(1) if np.isinf(z) else winner / z
        sides = [F(1 << number) * nearer * zoom[k] for k in range(2)]
        for reach in (1, 2):
            total, weights = np.zeros(3, F), F(0)
            for ny in range(max(ty - reach, 0), min(ty + reach + 1, level_height)):
                for nx in range(max(tx - reach, 0), min(tx + reach + 1, level_width)):
                    d = level["depth"][ny, nx]
                    alike = (
                        np.isinf(d) if np.isinf(winner) else abs(d - winner) <= F(2) * BACKGROUND.SAME_SURFACE * winner
                    )
                    at = there[number][ny, nx]
                    if level["state"][ny, nx] == EMPTY_TEXEL or not alike or not at[2] > 0:
                        continue
                    wx, wy = (F(1) - abs(at[k] - px[y, x, k]) * (F(1) / (sides[k] * F(reach))) for k in range(2))
                    if wx > 0 and wy > 0:
                        total = total + wx * wy * load_color(level["color"][ny, nx])
                        weights = weights + wx * wy
            if weights >= BACKGROUND.ENOUGH_WEIGHT:
                break
        found = total / weights if weights > F(0.01) else load_color(level["color"][ty, tx])
        sharp = shown_before(px[y, x], z, *before)
        found = found if sharp is None else sharp
        out["color"][y, x, :3] = found if holes[y, x] else F(0.5) * (found + load_color(warped["color"][y, x]))
        out["filled_by"][y, x] = 1 + number
        if holes[y, x]:
            out["depth"][y, x] = z
            out["motion"][y, x] = static_motion(px[y, x][None], np.array([z], F), to_source)[0]
    return out


# ---- shading inputs ------------------------------------------------------------------------------------


def prepare_inputs(warped, motion, color_prev, depth_prev, to_previous):
    """(warped previous (H, W, 4) float16, input mask (H, W) float16); `color_prev` None after a reset."""
    height, width = warped["depth"].shape
    source_height, source_width = motion.shape[:2]
    rest = np.where(warped["disoccluded"] > 0, SHADING.MASK_DISOCCLUDED, SHADING.MASK_REST)
    mask = np.where(warped["dynamic"] > 0, SHADING.MASK_DYNAMIC, rest).astype(np.float16)
    gae = load_color(warped["color"])
    out = np.concatenate([gae, np.zeros((height, width, 1), F)], -1).astype(np.float16)
    if color_prev is None:
        return out, mask
    px = centres(height, width)
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


# ---- trend of shading ----------------------------------------------------------------------------------


def measure_changes(frame, before, dynamic, exposure, to_previous):
    """(4, h, w) of cells; `frame` and `before`: (color (H, W, 4) float16, depth)."""
    (color, depth), (color_prev, depth_prev) = frame, before
    height, width = depth.shape
    cell, stride, most = TREND.CELL, TREND.SAMPLE_STRIDE, F(TREND.MOST_CHANGE)
    cells = -(-height // cell), -(-width // cell)
    lift = F(5000 * exposure / 8)
    rgb, rgb_prev = load_color(color), load_color(color_prev)
    place = reproject(centres(height, width), depth, to_previous)
    product, known = np.ones((*cells, 3), F), np.zeros(cells, F)
    for dy in range(1, cell, stride):
        for dx in range(1, cell, stride):
            for cy, cx in np.ndindex(cells):
                y, x = cy * cell + dy, cx * cell + dx
                if y >= height or x >= width or dynamic[y, x] or not depth[y, x] > 0:
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
                product[cy, cx] *= np.clip(now / then, F(1) / most, most)
                known[cy, cx] += F(1)
    share = F(stride**2 / cell**2)
    changes = _log(product) * (F(1 / np.log1p(5000)) * share)
    return np.moveaxis(np.concatenate([changes, (known * share)[..., None]], -1), -1, 0)


def find_trend(changes, reach):
    """(4, h, w): means over the neighbourhood of what is known, and the share that is."""
    weights = np.arange(reach + 1, 0, -1, dtype=F) / F((reach + 1) ** 2)
    for axis in (2, 1):
        total, size = np.zeros_like(changes), changes.shape[axis]
        for d in range(-reach, reach + 1):
            to, of = slice(max(-d, 0), max(size - max(d, 0), 0)), slice(max(d, 0), size + min(d, 0))
            if abs(d) < size:
                index = (slice(None),) * axis
                total[(*index, to)] += weights[abs(d)] * changes[(*index, of)]
        changes = total
    share = np.maximum(changes[3], F(TREND.LEAST_SHARE))
    return np.concatenate([changes[:3] / share, changes[3:]])


def carry_trends(depth, trend, trend_prev, alpha, to_source, to_previous, network_size):
    """(7, h, w) of the network."""
    height, width = depth.shape
    w, h = network_size
    j, i = np.minimum(2 * np.arange(h), height - 1), np.minimum(2 * np.arange(w), width - 1)
    px = centres(height, width)[j[:, None], i]

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
    return np.concatenate([F(alpha) * now[:3], F(alpha) * before[:3], now[3:]]).astype(F)


# ---- shading correction --------------------------------------------------------------------------------


def encode(color, exposure):
    """μ-law: ln(1 + μ · exposure · c / 8) / ln(1 + μ) for μ = 5000; negative colour is black."""
    return _log(F(1) + F(5000 * exposure / 8) * np.maximum(color, F(0))) * F(1 / np.log1p(5000))


def _parts(x):
    """Mantissa and exponent: of the power of two within sqrt(2)."""
    bits = x.view(np.int32)
    exponent = (bits - 0x3F3504F3) >> 23
    return (bits - (exponent << 23)).view(F), exponent


def _log(x):
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
    n = np.floor(x * F(1.44269504088896341) + F(0.5))
    r = x - n * F(0.693359375) + n * F(2.12194440e-4)
    y = F(1.9875691500e-4)
    for c in (1.3981999507e-3, 8.3334519073e-3, 4.1665795894e-2, 1.6666665459e-1, 5.0000001201e-1):
        y = y * r + F(c)
    power = ((np.nan_to_num(n).astype(np.int32) + 127) << 23).view(F)
    return np.minimum(((y * r * r + r) * power + (power - F(1))) * F(8 / (5000 * exposure)), COLOR_MAX)


def depth_median(depth):
    """Middle of the bin, 1/128 of a power of two wide, that holds the median of the finite depths in every eighth row;
    1 without."""
    depth = depth[:: CORRECTION.COUNTED_ROWS]
    bits = np.sort(depth[np.isfinite(depth) & (depth > 0)].view(np.uint32))
    if not len(bits):
        return F(1)
    dropped = CORRECTION.BIN_BITS
    bin_ = bits[(len(bits) + 1) // 2 - 1] >> dropped
    return np.array([bin_ << dropped | 1 << (dropped - 1)], np.uint32).view(F)[0]


def network_input(color, previous, depth, mask, exposure, network_size):
    """(8, h, w) float32 from the GAE frame, the warped previous frame (H, W, 4) and the input mask (H, W)."""
    inverse = np.minimum(depth_median(depth) / depth, CORRECTION.MAX_INVERSE_DEPTH)
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


def correct(color, frames, correction, exposure, within_mask=True):
    """(refined (H, W, 4) float16, focus mask (H, W) float16, final (H, W, 4) float16)."""
    height, width = color.shape[:2]
    half_height, half_width = frames.shape[1:]
    y, x = np.mgrid[:height, :width]
    x0, y0 = (x - 1) >> 1, (y - 1) >> 1
    u, v = np.where(x & 1, F(0.25), F(0.75)), np.where(y & 1, F(0.25), F(0.75))

    def full(plane):
        total = 0
        for tap in range(4):
            tx, ty = np.clip(x0 + (tap & 1), 0, half_width - 1), np.clip(y0 + (tap >> 1), 0, half_height - 1)
            total = total + (u if tap & 1 else F(1) - u) * (v if tap >> 1 else F(1) - v) * plane[ty, tx]
        return total

    rgb = load_color(color)
    with np.errstate(invalid="ignore", over="ignore"):
        low, delta = (np.stack([full(image[k]) for k in range(3)], -1) for image in (frames, correction))
        encoded = low + delta + full(correction[3])[..., None] * (encode(rgb, exposure) - low)
        m = full(correction[4])
        usable = np.isfinite(encoded.sum(-1) + m)
        m = np.where(usable & (m >= CORRECTION.LEAST_MASK), np.minimum(m, F(1)), F(0))
        corrected = decode(encoded, exposure)
        share = (m if within_mask else usable.astype(F))[..., None]
        mixed = rgb * (F(1) - share) + corrected * share
    refined, final = color.copy(), color.copy()
    refined[usable, :3], refined[usable, 3] = corrected[usable].astype(np.float16), 0
    touched = share[..., 0] > 0
    final[touched, :3], final[touched, 3] = mixed[touched].astype(np.float16), 0
    return refined, m.astype(np.float16), final


# ---- presentation --------------------------------------------------------------------------------------


def present(color, depth, motion, size, to_render, to_display, to_previous_display):
    """Displayed colour, depth and motion; mappings are (scale x, scale y, offset x, offset y) float32."""
    height, width = depth.shape
    px = centres(size[1], size[0]) * to_render[:2] + to_render[2:]
    corner = np.floor(px - F(0.5))
    u, v = np.moveaxis(px - F(0.5) - corner, -1, 0)
    x0, y0 = np.moveaxis(corner.astype(int) - 1, -1, 0)
    rgb = load_color(color)
    wx, wy = _cubic_weights(u), _cubic_weights(v)

    def cubic(weights, taps):
        a, b, c, d = (weights[k][..., None] * taps[k] for k in range(4))
        return np.clip(a + b + c + d, np.minimum(taps[1], taps[2]), np.maximum(taps[1], taps[2]))

    def tap(tx, ty):
        return rgb[np.clip(y0 + ty, 0, height - 1), np.clip(x0 + tx, 0, width - 1)]

    total = cubic(wy, [cubic(wx, [tap(tx, ty) for tx in range(4)]) for ty in range(4)])
    sx = np.clip(np.floor(px[..., 0]).astype(int), 0, width - 1)
    sy = np.clip(np.floor(px[..., 1]).astype(int), 0, height - 1)
    centre = np.stack([sx, sy], -1).astype(F) + F(0.5)
    with np.errstate(invalid="ignore"):
        before = (centre + motion[sy, sx]) * to_previous_display[:2] + to_previous_display[2:]
    shown = np.concatenate([total, np.zeros((*u.shape, 1), F)], -1).astype(np.float16)
    return shown, depth[sy, sx], before - (centre * to_display[:2] + to_display[2:])


# ---- composition ---------------------------------------------------------------------------------------


def layer_texels(layer):
    """(H, W, 4) float32 of a premultiplied layer; what is no number is transparent."""
    alpha = layer[..., 3].astype(F)
    alpha = np.where(np.isnan(alpha), F(0), np.clip(alpha, F(0), F(1)))
    return np.concatenate([load_color(layer), alpha[..., None]], -1)


def layer_at(layer, px):
    """Bilinear at positions (…, 2); transparent beyond the image."""
    height, width = layer.shape[:2]
    texels = np.zeros((height + 4, width + 4, 4), F)
    texels[2:-2, 2:-2] = layer_texels(layer)
    corner = np.floor(px - F(0.5))
    part = (px - F(0.5) - corner)[..., None]
    x, y = (np.clip(corner[..., k].astype(int) + 2, 0, n + 2) for k, n in enumerate((width, height)))
    inside = ((corner >= -2) & (corner < (width + 1, height + 1))).all(-1)
    u, v = part[..., 0, :], part[..., 1, :]
    total = (1 - u) * (1 - v) * texels[y, x] + u * (1 - v) * texels[y, x + 1]
    total = total + (1 - u) * v * texels[y + 1, x] + u * v * texels[y + 1, x + 1]
    return np.where(inside[..., None], total, F(0)).astype(F)


def effects_origin(px, alpha, motion):
    height, width = motion.shape[:2]
    origin, going = px.copy(), np.ones(px.shape[:-1], bool)
    for _ in range(3):
        place = np.floor(origin)
        going &= ((place >= 0) & (place < (width, height))).all(-1)
        x, y = np.where(going[..., None], place, 0).astype(int)[..., 0], np.where(going, place[..., 1], 0).astype(int)
        with np.errstate(invalid="ignore"):
            moved = F(alpha) * motion[y, x]
        going &= np.isfinite(moved).all(-1)
        origin = np.where(going[..., None], px + np.where(going[..., None], moved, 0), origin).astype(F)
    return origin


def compose(color, frame, source_color, source_depth, to_render, alpha, layers):
    """Composed colour (H, W, 4) float16; changes the dictionary `frame` (depth, motion, dynamic, disoccluded,
    filled_by). `layers`: arrays by the names of `Overlays`' fields."""
    height, width = color.shape[:2]
    px = centres(height, width)
    px_render = px * to_render[:2] + to_render[2:]
    picture = load_color(color)
    if "fixed_mask" in layers:
        mask = layers["fixed_mask"]
        place = np.floor(px_render).astype(int)
        rendered = ((place >= 0) & (place < mask.shape[::-1])).all(-1)
        x, y = np.where(rendered, place[..., 0], 0), np.where(rendered, place[..., 1], 0)
        fixed = rendered & (mask[y, x] > 0)
        picture[fixed] = load_color(source_color)[y, x][fixed]
        frame["depth"][fixed] = source_depth[y, x][fixed]
        frame["motion"][fixed] = (px_render - px)[fixed]
        for name, value in (("dynamic", 0), ("disoccluded", 0), ("filled_by", COMMON.BY_FIXED)):
            frame[name][fixed] = value
    if "effects" in layers:
        moving = "effects_motion" in layers
        origin = effects_origin(px_render, alpha, layers["effects_motion"]) if moving else px_render
        layer = layer_at(layers["effects"], origin)
        picture = layer[..., :3] + (1 - layer[..., 3:]) * picture
    if "ui" in layers:
        layer = layer_texels(layers["ui"])
        picture = layer[..., :3] + (1 - layer[..., 3:]) * picture
    bound = F(COMMON.COLOR_MAX) if hasattr(COMMON, "COLOR_MAX") else F(65504)
    return np.concatenate([np.clip(picture, -bound, bound), np.zeros((height, width, 1), F)], -1).astype(np.float16)
