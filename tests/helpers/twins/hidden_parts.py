"""Twin of hidden_parts.cl."""

import numpy as np

from twins.common import COMMON, F, centers, decode_color, kernel_constants, reproject
from twins.holes import DIRECTIONS, march
from twins.warp import _STEPS, load_code, load_color

HIDDEN = kernel_constants("hidden_parts.cl")
FRAME = kernel_constants("frame.h")


def fill_hidden_parts(warped, source_depth, zoom, to_source, reach, entering, before=None):
    """Return color, depth, motion and filled_by of the warped frame with the hidden parts of movers, and of those that
    enter, if `entering` is color, dynamic mask and predicted positions of the rendered frame. `before`: motion from
    the rendered frame to the one before it, depth there, and the reprojection."""
    out = {name: warped[name].copy() for name in ("color", "depth", "motion", "filled_by")}
    depth, holes, dynamic = warped["depth"], warped["disoccluded"] > 0, warped["dynamic"] > 0
    height, width = source_depth.shape

    def moves_along(q, y, x):
        offset = [F(x - q[1]) / zoom[0], F(y - q[0]) / zoom[1]]
        return np.array([q[1] + 0.5, q[0] + 0.5], F) + warped["motion"][q] + np.array(offset, F)

    def mover(y, x, d):
        """Return (distance, pixel) of the first mover in direction d, or None."""
        before = []
        for distance, q in march(y, x, d, reach, depth.shape):
            if not dynamic[q]:
                before += [] if holes[q] else [depth[q]]
                continue
            if any(not z < depth[q] * HIDDEN.NEARER for z in before):
                return None
            px = moves_along(q, y, x)
            if not (0 <= px[0] < width and 0 <= px[1] < height):
                return None
            shown = source_depth[int(px[1]), int(px[0])]
            then = reproject(np.array([[q[1] + 0.5, q[0] + 0.5]], F), depth[q][None], to_source)[0, 2]
            hidden = not shown > 0 or shown < HIDDEN.HIDES * then
            return (distance, q) if hidden and not seen_through(q, px, then) else None
        return None

    def seen_through(q, px, z):
        """Return whether the frame before showed something farther where the part at `px`, at depth z, was then."""
        if before is None:
            return False
        motion, depth_prev, to_previous = before
        x, y = np.clip(moves_along(q, *q).astype(int), 0, (width - 1, height - 1))
        then = px + motion[y, x]
        if not (0 <= then[0] < width and 0 <= then[1] < height):
            return False
        z_prev = depth_prev[int(then[1]), int(then[0])]
        return HIDDEN.HIDES * z_prev > reproject(px[None], F(z)[None], to_previous)[0, 2]

    def enters(place, px):
        """Return (pixel, place, depth) of the mover at the border of the rendered image that enters there, or None."""
        _, dynamic_mask, target_position = entering
        for _ in range(2):
            x, y = np.clip(place, 0, (width - 1, height - 1)).astype(int)
            there = target_position[y, x]
            if not dynamic_mask[y, x] or not there[2] > 0:
                return None
            place = np.array([x + 0.5, y + 0.5], F) + (px - there[:2]) / zoom
        x, y = np.clip(place, 0, (width - 1, height - 1)).astype(int)
        is_inside = 0 <= place[0] < width and 0 <= place[1] < height
        return None if is_inside or not dynamic_mask[y, x] else ((y, x), place, there[2])

    def entered(y, x):
        """Return what `enters` the hole through the border close to it or, in a corner, through the other one."""
        (rows, columns), px = depth.shape, np.array([x + 0.5, y + 0.5], F)
        across = np.array([0 if 2 * x < columns else width, px[1] / zoom[1]], F)
        upright = np.array([px[0] / zoom[0], 0 if 2 * y < rows else height], F)
        ways = [(min(x, columns - 1 - x), across), (min(y, rows - 1 - y), upright)]
        found = [enters(place, px) for _, place in sorted(ways, key=lambda way: way[0])]
        return found[0] or found[1]

    for y, x in np.argwhere(holes):
        if entering and (q := entered(y, x)):
            at, place, out["depth"][y, x] = q
            out["color"][y, x, :3], out["filled_by"][y, x] = load_color(entering[0][at]), COMMON.BY_HIDDEN_PART
            out["motion"][y, x] = place - np.array([x + 0.5, y + 0.5], F)
            continue
        met = [mover(y, x, d) for d in DIRECTIONS]
        found = [m for m in met if m]
        if not found:
            continue
        distance, of = min(found, key=lambda m: m[0])
        if distance * F(HIDDEN.BESIDE) > F(reach):
            continue
        z = depth[of]
        alike = [(F(1) / d, q) for d, q in found if abs(depth[q] - z) <= HIDDEN.ONE_OBJECT * z]
        total = sum(w for w, _ in alike)
        out["color"][y, x, :3] = decode_color(sum(w * load_code(warped["color"][q]) for w, q in alike) / total)
        out["depth"][y, x] = sum(w * depth[q] for w, q in alike) / total
        px = sum(w * moves_along(q, y, x) for w, q in alike) / total
        out["motion"][y, x] = px - np.array([x + 0.5, y + 0.5], F)
        out["filled_by"][y, x] = COMMON.BY_HIDDEN_PART
    return out


def show_reappearing(shown, now, past, tracked, target_position, zoom, reach):
    """Return color, depth, motion, dynamic and filled_by of the frame `shown` with the parts of movers that reappear.
    `now`, `past`: the rendered frame and the one before; `tracked`: dynamic mask, links, and depth met in the frame
    before."""
    out = {name: shown[name].copy() for name in ("color", "depth", "motion", "dynamic", "filled_by")}
    dynamic, links, met = tracked
    height, width = now.depth.shape
    rows, columns = shown["depth"].shape
    at, half = centers(height, width), np.maximum(F(HIDDEN.COVERS) * zoom, F(0.5))

    def alike(z, of):
        return abs(z - of) <= HIDDEN.SAME_PART * of

    def is_inside(px):
        return 0 <= px[0] < width and 0 <= px[1] < height

    def is_hidden(q, z):
        """Return whether something else, nearer than `z`, is shown at pixel `q`."""
        hides = HIDDEN.HIDES if dynamic[q] == FRAME.STATIC else HIDDEN.MOVER_HIDES
        return 0 < now.depth[q] < hides * z

    def was_shown(px, of):
        """Return whether the frame before showed a mover of depth `of` at `px`."""
        if not is_inside(px):
            return False
        q = int(px[1]), int(px[0])
        return alike(past.depth[q], of)

    def place(src, dst, there):
        off = np.array([dst[1] + 0.5, dst[0] + 0.5], F) - there[:2]
        return at[src] + off / zoom

    best = {}
    for y, x in np.argwhere((dynamic == FRAME.DYNAMIC) & (links != COMMON.ALL_LINKS) & (met > 0)):
        there = target_position[y, x]
        if not (there[2] > 0 and abs(there[0]) < 2 * columns and abs(there[1]) < 2 * rows):
            continue
        for dx, dy in _STEPS:
            end = 1
            while end <= reach and is_inside((x + end * dx, y + end * dy)):
                if not is_hidden((y + end * dy, x + end * dx), now.depth[y, x]):
                    break
                end += 1
            if end == 1:
                continue
            axis, sign = (0, F(dx)) if dx else (1, F(dy))
            apart = (there[axis] - target_position[y + dy, x + dx, axis]) * sign / zoom[axis] + F(1)
            if not HIDDEN.LEAST_APART < abs(apart) < width:
                continue
            some = int(abs(apart)) + 2
            for t in range(max(end - some, 1), end) if apart > 0 else range(1, min(end - 1, some) + 1):
                to = there[:2] + np.array([t * dx, t * dy], F) * zoom
                first = np.maximum(np.ceil(to - half - F(0.5)).astype(int), 0)
                last = np.minimum(np.floor(to + half - F(0.5)).astype(int), (columns - 1, rows - 1))
                for dst in np.ndindex(*np.maximum(last - first + 1, 0)[::-1]):
                    dst = dst[0] + first[1], dst[1] + first[0]
                    if not there[2] < HIDDEN.HIDES * shown["depth"][dst]:
                        continue
                    px = place((y, x), dst, there)
                    if not is_inside(px) or not is_hidden((int(px[1]), int(px[0])), now.depth[y, x]):
                        continue
                    if was_shown(px + now.motion[y, x], met[y, x]):
                        best[dst] = min(best.get(dst, (np.inf, ())), (there[2], (y, x)))
    for dst, (z, src) in best.items():
        source_px = place(src, dst, target_position[src])
        px = source_px + now.motion[src]
        out["color"][dst][:3] = load_color(past.color[int(px[1]), int(px[0])])
        out["depth"][dst], out["dynamic"][dst], out["filled_by"][dst] = z, 1, COMMON.BY_REAPPEARING
        out["motion"][dst] = source_px - np.array([dst[1] + 0.5, dst[0] + 0.5], F)
    return out
