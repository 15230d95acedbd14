"""Twin of history.cl."""

import numpy as np

from twins.common import INF, F, centers, invalid, kernel_constants, move, reproject, unproject
from twins.warp import _shifted

HISTORY = kernel_constants("history.cl")
EXACT = np.zeros(4, F)  # errors of quantization


def static_residual_squared(depth, motion, to_previous, error=EXACT):
    """Return r² of the static test, beyond `error` of quantization, NaN where it does not apply; and the place of the
    fragment if it is static."""
    px = centers(*depth.shape)
    where = reproject(px, depth, to_previous)
    with np.errstate(invalid="ignore"):
        d = beyond(where[..., :2] - (px + motion), motion, error)
        r2 = d[..., 0] * d[..., 0] + d[..., 1] * d[..., 1]
    return r2, where


def _start(b):
    """Return the squared residual at which bin b begins, px²."""
    return np.array([(b + HISTORY.RESIDUAL_FIRST_BIN) << 22], np.uint32).view(F)[0]


def _counts(vectors):
    """Return (64,) histogram of the squared lengths of (N, 2)."""
    r2 = vectors[:, 0] * vectors[:, 0] + vectors[:, 1] * vectors[:, 1]
    bins = HISTORY.RESIDUAL_BINS
    which = np.clip((r2.view(np.uint32) >> 22).astype(int) - HISTORY.RESIDUAL_FIRST_BIN, 0, bins - 1)
    return np.bincount(which, minlength=bins)


def _residuals(depth, motion, to_previous):
    """Return the residual (H, W, 2) of the static test, where it applies, and where it is sampled, both (H, W) bool."""
    px = centers(*depth.shape)
    where = reproject(px, depth, to_previous)
    with np.errstate(invalid="ignore", over="ignore"):
        residual = where[..., :2] - (px + motion)
    use = ~invalid(depth) & ~np.isinf(depth) & np.isfinite(motion).all(-1) & (where[..., 2] > 0)
    sampled = np.zeros_like(use)
    sampled[:: HISTORY.RESIDUAL_STRIDE, :: HISTORY.RESIDUAL_STRIDE] = True
    return residual, use, sampled


def residual_histogram(depth, motion, to_previous, steps=EXACT):
    """Return (8, 64) int32: of the squared residual, of its squared change over 8 px diagonally, of the steps of motion
    over that distance, by component and sign, and of the squared excess over the errors of one and of two vectors by
    `steps`, (4,), of the frame before."""
    residual, use, sampled = _residuals(depth, motion, to_previous)
    bins, apart = HISTORY.RESIDUAL_BINS, HISTORY.SCATTER_DISTANCE
    near, near_use = _shifted(residual, apart, apart, np.nan), _shifted(use, apart, apart, False)
    pairs = sampled & use & near_use
    with np.errstate(over="ignore", invalid="ignore"):
        counts = [_counts(residual[sampled & use]), _counts((residual - near)[pairs])]
    pairs[np.arange(len(pairs)) % (HISTORY.RESIDUAL_ROWS * HISTORY.RESIDUAL_STRIDE) > 0] = False
    near_motion = _shifted(motion, apart, apart, F(np.nan))
    with np.errstate(over="ignore", invalid="ignore"):
        still = np.stack([motion + residual, near_motion + near])[:, pairs]
        vectors = np.stack([motion, near_motion])[:, pairs]
        step = np.abs(vectors[0] - vectors[1])
    which = ((step.view(np.uint32).astype(int) + (1 << 19)) >> 20) - HISTORY.STEP_FIRST + 2
    which = np.where(step < F(HISTORY.STEP_NONE), 0, np.clip(which, 1, bins - 1))
    positive, negative = ((still >= 0) & (vectors >= 0)).all(0), ((still < 0) & (vectors <= 0)).all(0)
    for component in (0, 1):
        for of_class in (positive[:, component], negative[:, component]):
            counts.append(np.bincount(which[:, component][of_class], minlength=bins))
    of, quantized = sampled & use, steps.any()
    for k in range(1, HISTORY.LOOKUPS + 1):
        excess = beyond(residual[of], motion[of], F(0.5 * k) * steps)
        counts.append(_counts(excess) if quantized else np.zeros(bins, int))
    return np.stack(counts).astype(np.int32)


def _quantile_bin(counts, share):
    return int(np.argmax(np.cumsum(counts) >= F(share) * F(counts.sum())))


def _end(counts, last, below, share=0.01):
    """Return the last bin of a population that holds `below` up to `last`."""
    while last + 2 < len(counts) and counts[last + 1 : last + 3].sum() > F(share) * F(below):
        last += 1
        below += counts[last]
    return last


def noise_threshold_squared(histogram, low=0.25, high=4.0):
    residuals, changes = histogram[:2]
    if residuals.sum() == 0:
        return F(low * low)
    first = _quantile_bin(residuals, 0.1)
    last = _end(residuals, first, residuals[: first + 1].sum())
    noise = min(_start(last + 1), F(64) * _start(_quantile_bin(residuals, 0.25) + 1))
    if _start(first) > F(HISTORY.CAMERA_ERROR) ** 2 and changes.sum():
        change = F(16) * _start(_quantile_bin(changes, 0.97) + 1)
        noise = change if change < _start(first) else noise
    return np.clip(noise, F(low * low), F(high * high))


def _step(counts):
    """Return the step of a class of quantized motion, px; 0: not quantized, −1: not known."""
    pairs, steps = counts.sum(), counts[2:].sum()
    if pairs < HISTORY.STEP_SAMPLES or counts[0] == pairs:
        return F(-1)
    if 20 * counts[1] > pairs or not steps:
        return F(0)
    if 10 * counts[0] < pairs:
        return F(-1)
    b = 2 + int(np.argmax(50 * counts[2:] > steps))
    return np.array([(2 * (b - 2 + HISTORY.STEP_FIRST) + 1) << 19], np.uint32).view(F)[0]


def motion_steps(histogram, threshold_squared):
    """Return (4,) float32: steps of motion in x, of negative motion in x, in y, of negative motion in y; px, or 0."""
    steps = [_step(counts) for counts in histogram[2:6]]
    known = [step for step in steps if step > 0]
    if not known or threshold_squared <= max(F(HISTORY.THRESHOLD_LOW) ** 2, F(0.140625) * min(known) * min(known)):
        return np.zeros(4, F)
    found = []
    for c, step in enumerate(steps):
        other = max(steps[c ^ 2], steps[c ^ 3]) if steps[c ^ 1] < 0 else steps[c ^ 1]
        found.append(max(F(2) * other if step < 0 else step, F(0)))
    return np.array(found, F)


def beyond(residual, motion, error):
    """Return the excess of residuals (…, 2) over `error` (4,), by component and sign; float32, NaN stays."""
    with np.errstate(invalid="ignore"):
        excess = np.abs(residual) - np.where(motion + residual < 0, error[1::2], error[::2])
        return np.where(excess < 0, F(0), excess)


def static_threshold(depth, motion, to_previous, steps=EXACT):
    """Return the automatic threshold: ε², px², (4,) errors of quantization beside it, px, by `steps` of the frame
    before, and the steps of this one."""
    histogram = residual_histogram(depth, motion, to_previous, steps)
    threshold = noise_threshold_squared(histogram)
    found = motion_steps(histogram, threshold)
    if not steps.any():
        return threshold, EXACT, found
    least, excess = F(HISTORY.QUANTIZED_LOW) ** 2, histogram[6:]
    low = next(b for b in range(HISTORY.RESIDUAL_BINS) if _start(b) >= least)
    added = 0
    while added + 1 < len(excess) and 40 * (excess[added] - excess[added + 1])[low:].sum() > excess[0].sum():
        added += 1
    counts = excess[added]
    first = _quantile_bin(counts, 0.1)
    while first + 1 < len(counts) and _start(first + 1) <= least:
        first += 1
    last = _end(counts, first, counts[: first + 1].sum(), 0.005)
    epsilon = least if last == first else min(_start(last + 1), F(HISTORY.CAMERA_ERROR) ** 2)
    return F(epsilon), F(0.5 * (added + 1)) * steps, found


def _taps(px, shape):
    """Yield (y, x, weight) of the four pixels around a place that are in the image."""
    fx, fy = px[0] - F(0.5), px[1] - F(0.5)
    x0, y0 = int(np.floor(fx)), int(np.floor(fy))
    u, v = fx - F(x0), fy - F(y0)
    for tap in range(4):
        y, x = y0 + (tap >> 1), x0 + (tap & 1)
        if 0 <= x < shape[1] and 0 <= y < shape[0]:
            yield y, x, (u if tap & 1 else F(1) - u) * (v if tap >> 1 else F(1) - v)


def _depth_at(px, expected, tolerance, depth_prev):
    """Return the depth of the surface around a place that is closest to one of the expected depths: (depth or −1, index
    of the pixel that is closest)."""
    likeliest, met, nearest = F(0), F(-1), 0
    for y, x, weight in _taps(px, depth_prev.shape):
        z = depth_prev[y, x]
        if not z > 0 or np.isinf(z):
            continue
        likely = weight * (tolerance - min(abs(z - e) for e in expected))
        if likely > likeliest:
            likeliest, met, nearest = likely, z, y * depth_prev.shape[1] + x
    if not met > 0:
        return met, nearest
    total = weights = F(0)
    for y, x, weight in _taps(px, depth_prev.shape):
        z = depth_prev[y, x]
        if z > 0 and not np.isinf(z) and abs(z - met) <= F(HISTORY.DEPTH_TOLERANCE) * met:
            total, weights = total + weight * z, weights + weight
    return total / weights, nearest


def _depth_met(px, expected, tolerance, depth_prev):
    """Return one fragment's depth in the previous frame: (depth or −1, index of the pixel used)."""
    height, width = depth_prev.shape

    def plausible(z):
        return z > 0 and not np.isinf(z) and abs(z - expected) <= tolerance

    met, nearest = _depth_at(px, [expected], tolerance, depth_prev)
    if met > 0:
        return met, nearest
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
    taps = list(_taps(px, depth_prev.shape))
    depths = [depth_prev[y, x] for y, x, _ in taps]
    if len(taps) < 4 or not all(
        z > 0 and not np.isinf(z) and abs(z - expected) <= HISTORY.DEPTH_CHANGE_MOST * expected for z in depths
    ):
        return F(-1), nearest
    total = F(0)
    for (_, _, weight), z in zip(taps, depths, strict=True):
        total = total + weight * z
    y0, x0, _ = taps[0]
    u, v = px[0] - F(0.5) - F(x0), px[1] - F(0.5) - F(y0)
    nearest = (y0 + (v >= 0.5)) * width + x0 + (u >= 0.5)
    return (total if max(depths) - min(depths) <= HISTORY.DEPTH_TOLERANCE * min(depths) else F(-1)), nearest


def fixed_to_camera(depth, motion, moves, z_static, to_previous, depth_prev):
    """Return (H, W) bool: constant in view space, though a static fragment would not be."""
    height, width = depth.shape
    px, inverse, before = centers(height, width), to_previous[4], to_previous[5]
    with np.errstate(invalid="ignore"):
        e = before[:2] * ((px - inverse[2:]) * inverse[:2]) + before[2:] - (px + motion)
        stays = e[..., 0] * e[..., 0] + e[..., 1] * e[..., 1] <= F(HISTORY.FIXED_MOST) * F(HISTORY.FIXED_MOST)
        changes = np.abs(z_static - depth) > F(2) * F(HISTORY.FIXED_DEPTH) * depth
        may_be = ~invalid(depth) & ~np.isinf(depth) & stays & (moves | changes)
        px_prev = np.where(may_be[..., None], px + motion, F(0))
        x, y = np.moveaxis(np.floor(px_prev).astype(int), -1, 0)
        z_prev = depth_prev[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)]
        return may_be & (np.abs(z_prev - depth) <= F(HISTORY.FIXED_DEPTH) * depth)


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
    camera_fixed=True,
    error=EXACT,
):
    """Algorithm 1; `depth_prev` None after a reset; `error`: of quantization. Returns dynamic mask (H, W), the depth
    met (H, W) and history (k−1, H, W, 4), 0 where static."""
    height, width = depth.shape
    px, outside = centers(height, width), F(HISTORY.OUTSIDE)
    p0 = unproject(px, depth, to_previous[4])
    dynamic = np.zeros((height, width), np.uint8)
    met_depth = np.zeros((height, width), F)
    history = np.zeros((positions - 1, height, width, 4), F)
    if depth_prev is None:
        return dynamic, met_depth, history
    r2, where = static_residual_squared(depth, motion, to_previous, error)
    usable = np.isfinite(motion).all(-1)
    dynamic[:] = ~usable | (where[..., 2] < 0) | ~(r2 <= threshold_squared)
    dynamic[invalid(depth) | np.isinf(depth)] = 0
    if camera_fixed:
        dynamic[fixed_to_camera(depth, motion, dynamic > 0, where[..., 2], to_previous, depth_prev)] = (
            HISTORY.FIXED_TO_CAMERA
        )
    history[:, dynamic > 0, :3] = p0[dynamic > 0]
    for y, x in np.argwhere((dynamic > 0) & usable):
        px_prev, at = px[y, x] + motion[y, x], where[y, x]
        sideways = (abs(px_prev[0] - at[0]) + abs(px_prev[1] - at[1])) * from_previous[4, 0] * at[2]
        tolerance = HISTORY.DEPTH_TOLERANCE * at[2] + HISTORY.DEPTH_PER_MOTION * sideways
        if not (-outside < px_prev[0] < width + outside and -outside < px_prev[1] < height + outside):
            continue
        z, own = depth[y, x], F(HISTORY.DEPTH_TOLERANCE) * depth[y, x]
        z_prev, nearest = _depth_at(px_prev, [at[2], z] if camera_fixed else [at[2]], own, depth_prev)
        if not z_prev > 0 and at[2] > 0:
            z_prev, nearest = _depth_met(px_prev, at[2], tolerance, depth_prev)
        if not z_prev > 0 and camera_fixed:  # it may travel with the camera
            z_prev, nearest = _depth_met(px_prev, z, own, depth_prev)
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


def last_stir(before, number, depth, dynamic, depth_prev):
    """Return (rows, columns) int32: the number of the last frame in which something stirred near each block, under a
    camera that rests. `before`: the same of the frame before; `depth_prev` None after a reset, when nothing is looked
    for."""
    height, width = depth.shape
    side_y, side_x, reach = HISTORY.BLOCK_HEIGHT, HISTORY.BLOCK_WIDTH, HISTORY.STIR_REACH
    rows, columns = -(-height // side_y), -(-width // side_x)
    found = np.zeros((rows, columns), np.int32) if before is None else before.copy()
    if depth_prev is None:
        return found
    stirs = (dynamic > 0) | invalid(depth) | (depth != depth_prev)
    for by, bx in np.ndindex(rows, columns):
        y0, x0 = max(by * side_y - reach, 0), max(bx * side_x - reach, 0)
        if stirs[y0 : (by + 1) * side_y + reach, x0 : (bx + 1) * side_x + reach].any():
            found[by, bx] = number
    return found
