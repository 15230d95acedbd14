"""Twin of dilated_warp.cl."""

import numpy as np

from twins.common import COLOR_MAX, COMMON, INF, NOBODY, F, centers, kernel_constants, reproject
from twins.dilate_splat import NOTHING, SPLAT, TAPS, components, dilate, with_neighbors, words_of
from twins.warp import codes_of, load_color, resampled

DILATED = kernel_constants("dilated_warp.cl")


def dilated_splat(target_position, depth, zoom, target_size):
    """Return keys (H', W') uint64 that the splat leaves: depth bits << 32 | word, or all bits."""
    height, width = depth.shape
    target_width, target_height = target_size
    _, nearest = dilate(depth)
    y, x = np.mgrid[:height, :width]
    step = y * width + x - nearest
    down = np.clip(np.where(np.abs(step) > 1, step, 0), -1, 1)
    away = np.stack([step - down * width, down], -1).astype(F)
    there = target_position.reshape(-1, 3)[nearest]
    px = there[..., :2] + zoom * away
    come_from = centers(height, width) - px * (F(1) / zoom)
    lands = (there[..., 2] > 0) & (px >= 0).all(-1) & (px < target_size).all(-1)
    lands &= (np.abs(come_from) <= SPLAT.LONGEST).all(-1)
    half_words = (come_from[lands] * SPLAT.STEPS + (SPLAT.ZERO + F(0.5))).astype(np.uint64)
    dst, z = px[lands].astype(int), np.ascontiguousarray(there[..., 2][lands])
    keys = np.full((target_height, target_width), NOTHING)
    offers = z.view(np.uint32).astype(np.uint64) << np.uint64(32) | half_words[:, 1] << np.uint64(16) | half_words[:, 0]
    np.minimum.at(keys, (dst[:, 1], dst[:, 0]), offers)
    return keys


def places_beside(keys, target_position, dynamic, zoom, to_source):
    """Return where all pixels come from, (H', W', 2) px in the rendered frame. Those that none reached: as the nearest
    surface beside that shows nothing nearer where it leads them, or as far surfaces; but as the mover that is shown
    there if it has gone elsewhere, or stands at the border of the image; and as a static surface that has gone from
    where far surfaces lead. Places beside nearer static surfaces that have gone are a pixel aside."""
    height, width = dynamic.shape
    center = centers(*keys.shape)
    own = center * (F(1) / zoom)

    def pixel_at(px):
        return tuple(np.moveaxis(np.clip(np.trunc(px), 0, (width - 1, height - 1)).astype(int), -1, 0)[::-1])

    def shows_itself(y, x, offered):
        depth = (offered >> np.uint64(32)).astype(np.uint32).view(F)
        return target_position[pixel_at(components(words_of(offered)) + own[y, x])][:, 2] >= SPLAT.NEARER * depth

    found = with_neighbors(keys, shows_itself)
    far = reproject(center, np.full(keys.shape, INF, F), to_source)
    beside = np.where((found == NOTHING)[..., None], far[..., :2], components(words_of(found)) + own)
    place = np.where(((found == NOTHING) & ~(far[..., 2] > 0))[..., None], own, beside)

    there, off = target_position[pixel_at(place)], target_position[pixel_at(place)][..., :2] - center
    within = (place >= 0).all(-1) & (place < (width, height)).all(-1)
    stays = within & (np.abs(off) <= DILATED.GONE).all(-1)
    moved = np.stack(pixel_at(place)[::-1], -1).astype(F) + F(0.5) - off * (F(1) / zoom)
    moves = dynamic[pixel_at(place)] > 0
    is_free = target_position[pixel_at(moved)][..., 2] >= DILATED.NEARER * there[..., 2]
    is_free &= moves | ((dynamic[pixel_at(moved)] == 0) & (moved >= 0).all(-1) & (moved < (width, height)).all(-1))
    holes = keys == NOTHING
    goes = holes & (moves | (within & (found == NOTHING))) & ~stays & (there[..., 2] > 0) & is_free
    place = np.where(goes[..., None], moved, place)
    return np.where(holes[..., None], off_outlines(place, center, target_position, dynamic, zoom), place)


def off_outlines(place, center, target_position, dynamic, zoom):
    """Return `place`, or a pixel aside where it is beside a nearer static surface that has gone from `center`."""
    height, width = dynamic.shape
    inner = (place >= 1).all(-1) & (place < (width - 1, height - 1)).all(-1)
    x, y = np.moveaxis(np.where(inner[..., None], place, 1).astype(int), -1, 0)
    depth = target_position[..., 2]
    if min(width, height) < 3:
        return place
    z, away, tap = depth[y, x], np.zeros(place.shape, int), np.zeros(place.shape, int)
    for dy, dx in TAPS[1:]:
        nearer = (depth[y + dy, x + dx] > 0) & (depth[y + dy, x + dx] < DILATED.NEARER * z)
        away -= nearer[..., None] * (dx, dy)
        tap = np.where(nearer[..., None], (dx, dy), tap)
    there_y, there_x = y + tap[..., 1], x + tap[..., 0]
    shown = target_position[there_y, there_x][..., :2] - zoom * tap.astype(F)
    goes = inner & tap.any(-1) & (dynamic[there_y, there_x] == 0) & (np.abs(shown - center) > DILATED.GONE).any(-1)
    away = np.clip(away, -1, 1)
    z_aside = depth[y + away[..., 1], x + away[..., 0]]
    alike = ~(z_aside < DILATED.NEARER * z) & ~(z < DILATED.NEARER * z_aside)
    return np.where((goes & alike)[..., None], place + away.astype(F), place)


def resample_dilated(keys, target_position, color, dynamic, zoom, to_source, sharpness):
    """Return all outputs of the stage, as a dict of (H', W', …) arrays named like the frame's buffers."""
    height, width = keys.shape
    source_height, source_width = dynamic.shape
    center = centers(height, width)
    reached = words_of(keys) != NOBODY
    come_from = places_beside(keys, target_position, dynamic, zoom, to_source)
    px = np.clip(come_from, F(0.5), np.array((source_width, source_height), F) - F(0.5))
    sx, sy = np.moveaxis(px.astype(int), -1, 0)
    first = np.floor(px - F(0.5))
    u, v = np.moveaxis(px - F(0.5) - first, -1, 0)
    x0, y0 = np.moveaxis(first.astype(int), -1, 0)
    whole = (x0 >= 1) & (y0 >= 1) & (x0 < source_width - 2) & (y0 < source_height - 2)
    rgb, codes = load_color(color), codes_of(color).astype(F)
    taps, alike = {}, {}
    for ty in range(4):
        for tx in range(4):
            x, y = x0 + tx - 1, y0 + ty - 1
            inside = (x < source_width) & (y < source_height) & (tx in (1, 2)) & (ty in (1, 2))
            alike[ty, tx] = whole | inside
            taps[ty, tx] = codes[np.clip(y, 0, source_height - 1), np.clip(x, 0, source_width - 1)]
    out = resampled(taps, alike, u, v, rgb[sy, sx], sharpness)
    out = np.where(((u == 0) & (v == 0))[..., None], rgb[sy, sx], out)
    z = target_position[sy, sx, 2]
    return {
        "color": np.clip(out, -COLOR_MAX, COLOR_MAX).astype(np.float16),
        "depth": np.where(z > 0, z, INF),
        "motion": px - center,
        "dynamic": (dynamic[sy, sx] > 0).astype(np.uint8),
        "disoccluded": (~reached).astype(np.uint8),
        "filled_by": np.where(reached, COMMON.BY_WARP, COMMON.BY_HOLE_FILLING).astype(np.uint8),
    }
