"""NumPy twins of the kernels: the oracles of the device tests.

Plain float32 arithmetic in the kernels' order, whole images at a time. Cameras come as the same packed
`Reprojection` arrays that kernels get, (6, 4) float32.
"""

import numpy as np

F = np.float32
INF = F(np.inf)
EMPTY = 0xFFFFFFFF


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
    r2, where = static_residual_squared(depth, motion, to_previous)
    use = ~invalid(depth) & ~np.isinf(depth) & np.isfinite(motion).all(-1) & (where[..., 2] >= 0)
    r2 = r2[::4, ::4][use[::4, ::4]]
    bins = np.clip((r2.view(np.uint32) >> 22).astype(int) - 214, 0, 63)
    return np.bincount(bins, minlength=64).astype(np.int32)


def noise_threshold_squared(histogram, low=0.25, high=4.0):
    total = histogram.sum()
    if total == 0:
        return F(low * low)
    quartile = int(np.argmax(np.cumsum(histogram) * 4 >= total))
    r2 = np.array([(quartile + 215) << 22], np.uint32).view(F)[0]
    return np.clip(F(16) * r2, F(low * low), F(high * high))


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
    for y in range(yc - 2, yc + 3):
        for x in range(xc - 2, xc + 3):
            if not (0 <= x < width and 0 <= y < height):
                continue
            dx, dy = F(x + 0.5) - px[0], F(y + 0.5) - px[1]
            distance = dx * dx + dy * dy
            if distance < closest and plausible(depth_prev[y, x]):
                closest, found, nearest = distance, depth_prev[y, x], y * width + x
    return found, nearest


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
    """Algorithm 1; `depth_prev` None after a reset. Returns dynamic mask (H, W) and history (k−1, H, W, 4)."""
    height, width = depth.shape
    px = centres(height, width)
    p0 = unproject(px, depth, to_previous[4])
    dynamic = np.zeros((height, width), np.uint8)
    history = np.concatenate([p0, np.ones((height, width, 1), F)], -1)[None].repeat(positions - 1, 0)
    if depth_prev is None:
        return dynamic, history
    r2, where = static_residual_squared(depth, motion, to_previous)
    usable = np.isfinite(motion).all(-1)
    dynamic[:] = ~usable | (where[..., 2] < 0) | ~(r2 <= threshold_squared)
    dynamic[invalid(depth) | np.isinf(depth)] = 0
    history[:, dynamic > 0, 3] = 0
    for y, x in np.argwhere((dynamic > 0) & usable & (where[..., 2] > 0)):
        px_prev, at = px[y, x] + motion[y, x], where[y, x]
        sideways = (abs(px_prev[0] - at[0]) + abs(px_prev[1] - at[1])) * from_previous[4, 0] * at[2]
        tolerance = F(0.03) * at[2] + F(2) * sideways
        z_prev, nearest = _depth_met(px_prev, at[2], tolerance, depth_prev)
        if not z_prev > 0:
            continue
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
    return dynamic, history


# ---- prediction ----------------------------------------------------------------------------------------


def predict_positions(depth, dynamic, history, order, weights, to_target):
    """(H, W, 4) float32: px in the target image, view depth (−1: nothing), 0."""
    px = centres(*depth.shape)
    out = np.zeros((*depth.shape, 4), F)
    out[..., :3] = reproject(px, depth, to_target)
    p0 = unproject(px, depth, to_target[4])
    known = np.cumprod(history[:order, ..., 3] != 0, axis=0).sum(0)
    predicted = p0.copy()
    for k in range(order):
        weight = np.where(known > 0, weights[np.maximum(known, 1) - 1, k], F(0))
        step = weight[..., None] * (history[k, ..., :3] - p0)
        predicted = np.where((known > k)[..., None], predicted + step, predicted)
    target = move(predicted, to_target)
    moved = np.concatenate([project(target, to_target[5]), target[..., 2:]], -1)
    moved[~((target[..., 2] > 0) & (predicted[..., 2] > 0))] = (0, 0, -1)
    out[dynamic > 0, :3] = moved[dynamic > 0]
    out[invalid(depth), :3] = (0, 0, -1)
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
        near = np.abs(a - b) <= F(0.02) * size
        near |= (a2 > 0) & (np.abs((a - a2) - (b - a)) <= F(0.005) * size)
        near |= (b2 > 0) & (np.abs((b2 - b) - (b - a)) <= F(0.005) * size)
        sky = (a == 0) | (b == 0)
        same = (a >= 0) & (b >= 0) & np.where(sky, a == b, near)
        links |= (same & (_shifted(dynamic, dx, dy, 2) == dynamic)).astype(np.uint8) << bit
    return links


def flow(target_position, depth, links, zoom):
    """Jacobian columns ddx, ddy (H, W, 4) and the inverse of its 2×2 part (xx, xy, yx, yy)."""
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
        most = F(4) * np.maximum(scale_x, scale_y)
        zero = np.zeros_like(scale_x)
        plain_x = np.stack([scale_x, zero, zero, zero], -1)
        plain_y = np.stack([zero, scale_y, zero, zero], -1)
        bad_x = ~linked_x | (np.abs(ddx[..., 0]) > most) | (np.abs(ddx[..., 1]) > most)
        bad_y = ~linked_y | (np.abs(ddy[..., 0]) > most) | (np.abs(ddy[..., 1]) > most)
        ddx, ddy = np.where(bad_x[..., None], plain_x, ddx), np.where(bad_y[..., None], plain_y, ddy)
        det = ddx[..., 0] * ddy[..., 1] - ddy[..., 0] * ddx[..., 1]
        folded = ~(det > F(0.02) * scale_x * scale_y)
        ddx, ddy = np.where(folded[..., None], plain_x, ddx), np.where(folded[..., None], plain_y, ddy)
        det = np.where(folded, scale_x * scale_y, det)
        inverse = np.stack([ddy[..., 1], -ddy[..., 0], -ddx[..., 1], ddx[..., 0]], -1) / det[..., None]
    return ddx.astype(F), ddy.astype(F), inverse.astype(F)


def _source_offset(inverse, d):
    return np.stack(
        [
            inverse[..., 0] * d[..., 0] + inverse[..., 1] * d[..., 1],
            inverse[..., 2] * d[..., 0] + inverse[..., 3] * d[..., 1],
        ],
        -1,
    )


def splat(target_position, depth, links, zoom, target_size, close_cracks):
    """(H', W') uint64 keys: depth bits << 32 | source index; all ones where nothing lands."""
    width, height = target_size
    keys = np.full(height * width, np.iinfo(np.uint64).max, np.uint64)
    here = target_position.reshape(-1, 4)
    ddx, ddy, inverse = (a.reshape(-1, 4) for a in flow(target_position, depth, links, zoom))
    index = np.arange(len(here), dtype=np.uint64)
    reach = F(8)
    with np.errstate(invalid="ignore"):
        lands = (here[:, 2] > 0) & (here[:, :2] > -reach).all(1)
        lands &= (here[:, 0] < width + reach) & (here[:, 1] < height + reach)
    key = (np.ascontiguousarray(here[:, 2]).view(np.uint32).astype(np.uint64) << np.uint64(32)) | index
    here, ddx, ddy, inverse, key = (a[lands] for a in (here, ddx, ddy, inverse, key))
    own = np.floor(here[:, :2]).astype(int)

    def offer(x, y, use):
        use = use & (x >= 0) & (y >= 0) & (x < width) & (y < height)
        np.minimum.at(keys, y[use] * width + x[use], key[use])

    offer(own[:, 0], own[:, 1], np.ones(len(own), bool))
    if close_cracks:
        half = np.minimum(F(0.5625) * (np.abs(ddx[:, :2]) + np.abs(ddy[:, :2])), reach)
        first = np.ceil(here[:, :2] - half - F(0.5)).astype(int)
        last = np.floor(here[:, :2] + half - F(0.5)).astype(int)
        for oy in range(int((last - first)[:, 1].max(initial=-1)) + 1):
            for ox in range(int((last - first)[:, 0].max(initial=-1)) + 1):
                t = first + (ox, oy)
                d = np.abs(_source_offset(inverse, (t.astype(F) + F(0.5)) - here[:, :2]))
                offer(t[:, 0], t[:, 1], (t <= last).all(1) & (t != own).any(1) & (d <= F(0.5625)).all(1))
    return keys.reshape(height, width)


def load_color(color):
    c = np.nan_to_num(color[..., :3].astype(F), nan=0.0, posinf=65504.0, neginf=-65504.0)
    return np.clip(c, F(-65504), F(65504))


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
    s = np.where(holes, 0, keys & np.uint64(EMPTY)).astype(int)
    sy, sx = np.divmod(s, source_width)
    here = target_position[sy, sx]
    ddx, ddy, inverse = (a[sy, sx] for a in flow(target_position, depth, links, zoom))
    centre = centres(height, width)
    with np.errstate(invalid="ignore"):
        exact = np.clip(_source_offset(inverse, centre - here[..., :2]), F(-1), F(1))
    d = np.rint(exact * F(256)) * F(1 / 256)

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
            away = inside & (depth[y, x] < own_depth * F(0.97)) & (e > 1)
        step_x -= dx * away
        step_y -= dy * away
    inside, e = deviation(step_x, step_y)
    stays = ~(inside & (e <= F(0.5)))
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
            alike[ty, tx], taps[ty, tx] = inside & (e <= F(0.5)), rgb[y, x]
    everywhere = np.all(list(alike.values()), axis=0)
    wx, wy = _cubic_weights(u), _cubic_weights(v)
    cubic = np.zeros((height, width, 3), F)
    for ty in range(4):
        row = np.zeros((height, width, 3), F)
        for tx in range(4):
            row = row + wx[tx][..., None] * taps[ty, tx]
        cubic = cubic + wy[ty][..., None] * row
    stack = np.stack(list(taps.values()))
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
    out = np.clip(out, F(-65504), F(65504))

    z = here[..., 2] + ddx[..., 2] * d[..., 0] + ddy[..., 2] * d[..., 1]
    source_centre = np.stack([sx + 0.5, sy + 0.5], -1).astype(F)
    own_pixel = (np.floor(here[..., :2]) == np.floor(centre)).all(-1)
    result = {
        "color": np.concatenate([out, np.zeros((height, width, 1), F)], -1).astype(np.float16),
        "depth": np.where(z > 0, z, here[..., 2]),
        "motion": source_centre + d - centre,
        "dynamic": dynamic[sy, sx].copy(),
        "disoccluded": holes.astype(np.uint8),
        "filled_by": np.where(own_pixel, 0, 254).astype(np.uint8),
    }
    for name, empty in (("color", 0), ("depth", INF), ("motion", 0), ("dynamic", 0), ("filled_by", 255)):
        result[name][holes] = empty
    return result


# ---- holes ---------------------------------------------------------------------------------------------


def downsample(warped, source_color, source_depth):
    """Weighted sums per 32×32 block: (colour, 1) (h, w, 4) and inverse depth (h, w), float64 accuracy."""
    height, width = warped["depth"].shape
    blocks = (-(-height // 32), -(-width // 32))
    color_sum, inverse_sum = np.zeros((*blocks, 4)), np.zeros(blocks)
    y, x = np.mgrid[:height, :width]
    sy, sx = y * source_depth.shape[0] // height, x * source_depth.shape[1] // width
    rendered = (load_color(source_color)[sy, sx], source_depth[sy, sx], 1 / 1024)
    warp = (load_color(warped["color"]), warped["depth"], 1.0)
    for (c, z, pixel_weight), use in (
        (warp, warped["disoccluded"] == 0),
        (rendered, ~invalid(rendered[1])),
    ):
        c = c.astype(np.float64)
        weight = np.where(use, pixel_weight / (1 + np.maximum(c.max(-1), 0)), 0)
        with np.errstate(all="ignore"):
            inverse = np.where(np.isinf(z) | ~use, 0, 1 / z.astype(np.float64))
        np.add.at(color_sum, (y // 32, x // 32), weight[..., None] * np.dstack([c, np.ones_like(weight)]))
        np.add.at(inverse_sum, (y // 32, x // 32), weight * inverse)
    return color_sum, inverse_sum


def fill_holes(warped, color_sum, inverse_sum, to_source):
    """Colour, depth, motion of the warped frame with its holes filled."""
    height, width = warped["depth"].shape
    px = centres(height, width)
    b = px.astype(np.float64) / 32 - 0.5
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
        z = np.where(inverse > 0, total[..., 3] / inverse, np.inf).astype(F)
    where = reproject(px, z, to_source)
    motion = np.where((where[..., 2] > 0)[..., None], where[..., :2] - px, F(0))
    holes = warped["disoccluded"] > 0
    out = {name: warped[name].copy() for name in ("color", "depth", "motion")}
    out["color"][holes, :3] = mean[holes]
    out["depth"][holes], out["motion"][holes] = z[holes], motion[holes]
    return out
