"""Twin of holes.cl."""

from typing import NamedTuple

import numpy as np

from twins.common import (
    COMMON,
    INF,
    F,
    centers,
    decode_color,
    encode_color,
    invalid,
    kernel_constants,
    reproject,
)
from twins.warp import load_code, load_color

HOLES = kernel_constants("holes.cl")


def downsample(warped, source_color, source_depth):
    """Return weighted sums per 32×32 block: (color, 1) (h, w, 4) and inverse depth (h, w), float64 accuracy."""
    height, width = warped["depth"].shape
    size = HOLES.DOWNSAMPLING
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


DIRECTIONS = ((1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1))


def march(y, x, d, reach, shape):
    """Yield (distance in px, (y, x)) of the pixels from (y, x) on in direction d that lie in the image and within
    reach."""
    step = F(1.41421356) if d[0] and d[1] else F(1)
    t = 1
    while F(t) * step <= F(reach):
        qx, qy = x + t * d[0], y + t * d[1]
        if not (0 <= qx < shape[1] and 0 <= qy < shape[0]):
            return
        yield F(t) * step, (qy, qx)
        t += 1


def _border_code(at, source_color):
    """Return the code of the rendered image (height, width, 3) at a place, or at the place on its border that is
    closest."""
    height, width = source_color.shape[:2]
    x, y = np.clip(at[0] - F(0.5), 0, F(width - 1)), np.clip(at[1] - F(0.5), 0, F(height - 1))
    xs, ys = [int(x), min(int(x) + 1, width - 1)], [int(y), min(int(y) + 1, height - 1)]
    rows = [encode_color(source_color[j, xs]) for j in ys]
    across = [row[0] * (1 - x % 1) + row[1] * (x % 1) for row in rows]
    return across[0] * (1 - y % 1) + across[1] * (y % 1)


def border_lines(codes):
    """Return the structure tensor (3, h, w) of color codes (height, width, 3): sums of xx, xy and yy in cells at the
    border, 0 in others."""
    height, width = codes.shape[:2]
    cell = HOLES.CELL
    found = np.zeros((3, -(-height // cell), -(-width // cell)))
    codes = codes.astype(np.float64)
    for y, x in np.ndindex(found.shape[1:]):
        if 0 < y < found.shape[1] - 1 and 0 < x < found.shape[2] - 1:
            continue
        first = [max(min(k * cell, side - cell), 0) + 1 for k, side in ((y, height), (x, width))]
        for sy in range(first[0], min(first[0] + cell - 1, height - 1), HOLES.LINE_STRIDE):
            for sx in range(first[1], min(first[1] + cell - 1, width - 1), HOLES.LINE_STRIDE):
                dx = (codes[sy, sx + 1] - codes[sy, sx - 1]) / 2
                dy = (codes[sy + 1, sx] - codes[sy - 1, sx]) / 2
                found[:, y, x] += dx @ dx, dx @ dy, dy @ dy
    return found


def _lines_at(along, away, cells, side):
    """Return (slope, spread) of lines that cross the border at `along` px, for a place `away` px out of the image;
    `cells` (3, n): sums of products of changes along the border, of both changes, and of changes inward."""
    at = min(max(along, F(0)), F(side)) / F(HOLES.CELL) - F(0.5)
    k = np.arange(cells.shape[1])
    around = HOLES.CELLS_AROUND
    k = k[(k > np.floor(at) - around) & (k <= np.floor(at) + around)]
    off = at - k
    close_counts = HOLES.CLOSE_COUNTS / (1 + (away / F(HOLES.CELL)) ** 2)
    weight = np.maximum(1 - (off / around) ** 2, 0) ** 2 / (1 + close_counts * off**2)
    across, both, inward = (cells[:, k] * weight).sum(1)
    sure = across + HOLES.CELL_NOISE
    slope = np.clip(-both / sure, -HOLES.STEEPEST, HOLES.STEEPEST)
    return slope, np.sqrt(max(inward + slope * (2 * both + slope * across), 0) / sure)


def beyond(at, source_color, lines):
    """Return the color out of screen at `at`: `border_lines` go on from the border of the rendered image (height,
    width, 3)."""
    height, width = source_color.shape[:2]
    out = [np.clip(at[k], F(0.5), F(side - 0.5)) - at[k] for k, side in ((0, width), (1, height))]
    axis = 0 if abs(out[1]) > abs(out[0]) else 1  # along the border
    away, side = np.clip(out[1 - axis], -F(width), F(width)), (width, height)[axis]
    row = 0 if not away < 0 else -1
    cells = lines[:, row] if axis == 0 else lines[::-1, :, row]
    along = at[axis]
    for _ in range(HOLES.APPROACHES):
        slope, spread = _lines_at(along, away, cells, side)
        along = at[axis] + away * slope
    total, weights = np.zeros(3), 0.0
    for k in range(-HOLES.BLUR_TAPS, HOLES.BLUR_TAPS + 1):
        place = [at[0], at[1]]
        place[axis] = along + HOLES.FADE * spread * abs(away) * k
        weight = 1 - (k / (HOLES.BLUR_TAPS + 1)) ** 2
        total += weight * _border_code(place, source_color)
        weights += weight
    return decode_color((total / weights).astype(F))


def source_of(y, x, inverse, to_source):
    """Return the place of a static pixel of the new frame in the rendered one: x, y, depth."""
    z = np.array([F(1) / inverse if inverse > 0 else INF], F)
    return reproject(np.array([[x + 0.5, y + 0.5]], F), z, to_source)[0]


def is_outside(at, image):
    height, width = image.shape[:2]
    return not (at[2] > 0 and 0 <= at[0] < width and 0 <= at[1] < height)


def surface_behind(met):
    """Return [(weight, values)] of the surface behind a disocclusion, from [(inverse depth, weight, values, whether it
    can be there)] beside it; without candidates of the far side."""

    def are_as_far(a, b):
        return not a > b * HOLES.FAR_SIDE and not b > a * HOLES.FAR_SIDE

    candidates = [(inverse, w, values) for inverse, w, values, can_be_there in met if can_be_there]
    if not candidates:
        least = min(inverse for inverse, *_ in met)
        return [(w, values) for inverse, w, values, _ in met if not inverse > least * HOLES.FAR_SIDE]
    sums = [sum((w for b, w, _ in candidates if are_as_far(a, b)), F(0)) for a, *_ in candidates]
    first = candidates[int(np.argmax(sums))][0]
    return [(w, values) for inverse, w, values in candidates if are_as_far(inverse, first)]


class _Side(NamedTuple):
    """A direction from a hole, and what it meets.

    The pixel `q` beside the hole, inverse depth, color code, and weight; whether it is `of_mover`; continued to the
    hole, whether it is `outside` of the rendered image, and whether it `can_be_there`; the pixel of the rendered frame
    that shows what is `behind` its edge, if it ends there."""

    q: tuple
    inverse: F
    code: np.ndarray
    weight: F
    of_mover: bool
    outside: bool
    can_be_there: bool
    behind: tuple | None


def _inverse_of(z):
    return F(0) if np.isinf(z) else F(1) / z


def _at(place):
    return int(place[1]), int(place[0])


def continued_surface(warped, y, x, reach, to_source, rendered, lines):
    """Return (color, inverse depth) of the surface that goes on into one hole; `rendered`: color (height,
    width, 3), depth, and dynamic mask of the rendered frame; `lines`: `border_lines`."""
    depth, filled_by = warped["depth"], warped["filled_by"]
    source_color, source_depth, source_dynamic = rendered

    def is_made_up(q):
        return filled_by[q] in (COMMON.BY_HIDDEN_PART, COMMON.BY_REAPPEARING)

    def can_be_at(place):
        shown = source_depth[_at(place)]
        return bool(shown > 0 and not place[2] < F(HOLES.IN_FRONT) * shown)

    def behind_edge(q, d):
        """Return the pixel of the rendered frame that shows what is behind the edge of the surface met at `q`."""
        px = np.array([q[1] + 0.5, q[0] + 0.5], F)
        place = *(px + warped["motion"][q].astype(F) - F(HOLES.PAST_EDGE) * np.array(d, F)), 1
        if is_outside(place, source_color):
            return None
        z = source_depth[_at(place)]
        if invalid(z) or source_dynamic[_at(place)]:
            return None
        return _at(place) if _inverse_of(depth[q]) > _inverse_of(z) * F(HOLES.FAR_SIDE) else None

    def side(distance, q, d):
        place = source_of(y, x, _inverse_of(depth[q]), to_source)
        outside, behind = is_outside(place, source_color), behind_edge(q, d)
        of_mover = bool(warped["dynamic"][q]) or is_made_up(q)
        can_be_there = not outside and behind is None and not of_mover and can_be_at(place)
        values = q, _inverse_of(depth[q]), load_code(warped["color"][q]), F(1) / distance
        return _Side(*values, of_mover, outside and behind is None, can_be_there, behind)

    def past(way, d):
        """Return the first side on `way` that can be there; else what is behind the first one of all, or that."""
        first = side(*way[0], d)
        if first.can_be_there:
            return first
        before = F(0) if first.of_mover else depth[first.q]

        def steps(q):
            return max(abs(q[0] - y), abs(q[1] - x))

        for distance, q in way[1:]:
            if steps(q) > steps(first.q) + reach // HOLES.PAST_SHARE:
                break
            if warped["dynamic"][q] or is_made_up(q) or not depth[q] > before:
                continue
            place = source_of(y, x, _inverse_of(depth[q]), to_source)
            if not is_outside(place, source_color) and can_be_at(place):
                return side(distance, q, d)._replace(can_be_there=True, outside=False, of_mover=False)
            before = depth[q]
        if first.behind is None:
            return first
        inverse = _inverse_of(source_depth[first.behind])
        place = source_of(y, x, inverse, to_source)
        outside = is_outside(place, source_color)
        return first._replace(
            inverse=inverse,
            code=encode_color(source_color[first.behind]),
            weight=first.weight * F(HOLES.BEHIND_EDGE),
            outside=outside and not first.of_mover,
            can_be_there=first.of_mover if outside else can_be_at(place),
        )

    def mean(weighted):
        found = sum(w * values for w, values in weighted) / sum(w for w, _ in weighted)
        return np.append(decode_color(found[:3]), found[3])

    def values(one):
        return np.append(one.code, one.inverse)

    def looked(reach):
        marches = [(d, march(y, x, d, reach, depth.shape)) for d in DIRECTIONS]
        return [(way, d) for d, steps in marches if (way := [m for m in steps if filled_by[m[1]] != COMMON.BY_NOTHING])]

    is_far = not (ways := looked(reach))
    ways = ways or looked(sum(depth.shape))
    if not ways:
        return np.append(decode_color(_border_code((F(x + 0.5), F(y + 0.5)), source_color)), F(0))
    met = [side(*way[0], d) for way, d in ways]
    if not is_far and not any(one.outside for one in met) and not all(one.of_mover for one in met):
        met = [one for way, d in ways if (one := past(way, d))]
    if outside := [one for one in met if one.outside]:
        found = mean([(one.weight * one.weight, values(one)) for one in outside])
        at = source_of(y, x, found[3], to_source)
        height, width = source_dynamic.shape
        border = _at(np.clip(at[:2], 0, (width - 1, height - 1)))
        if not at[2] > 0 or source_dynamic[border]:
            return found
        return np.append(beyond(at, source_color, lines), found[3])
    return mean(surface_behind([(one.inverse, one.weight, values(one), one.can_be_there) for one in met]))


def fill_far_side(warped, reach, to_source, rendered, lines):
    """Return color, depth, motion of the warped frame with its holes filled by `continued_surface`."""
    mean, mean_inverse = np.zeros((*warped["depth"].shape, 3)), np.zeros(warped["depth"].shape)
    for at in map(tuple, np.argwhere(warped["filled_by"] == COMMON.BY_NOTHING)):
        found = continued_surface(warped, *at, reach, to_source, rendered, lines)
        mean[at], mean_inverse[at] = found[:3], found[3]
    return _filled(warped, mean, mean_inverse, to_source)


def fill_from_downsampled(warped, color_sum, inverse_sum, to_source):
    """Return color, depth, motion of the warped frame with its holes filled from the block sums."""
    height, width = warped["depth"].shape
    px = centers(height, width)
    b = px.astype(np.float64) / HOLES.DOWNSAMPLING - 0.5
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
    return _filled(warped, mean, mean_inverse, to_source)


def _filled(warped, mean, mean_inverse, to_source):
    px = centers(*warped["depth"].shape)
    holes = warped["filled_by"] == COMMON.BY_NOTHING
    with np.errstate(all="ignore"):
        z = np.where(mean_inverse > 0, 1 / mean_inverse, np.inf).astype(F)
    out = {name: warped[name].copy() for name in ("color", "depth", "motion")}
    out["color"][holes, :3] = mean[holes]
    out["depth"][holes], out["motion"][holes] = z[holes], static_motion(px, z, to_source)[holes]
    return out


def static_motion(px, z, to_source):
    """Return motion into the source image of static points at depth z of the target."""
    where = reproject(px, z, to_source)
    return np.where((where[..., 2] > 0)[..., None], where[..., :2] - px, F(0))
