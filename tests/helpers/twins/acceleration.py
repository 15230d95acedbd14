"""Twin of acceleration.cl."""

import numpy as np

from twins.common import INF, F, centers, kernel_constants, move, rotate, unproject

ACCELERATION = kernel_constants("acceleration.cl")


def _is_of_cell(z, cell_depth):
    return abs(z - cell_depth) <= ACCELERATION.CELL_TOLERANCE * cell_depth


def _mover_of_cell(inside, p0, p1, p1_prev, px_prev, depth, met_depth):
    """Return mean velocity in the world and in view space, position and depths of the nearest mover among pixels
    `inside`; None if there is none."""
    nearest = min((depth[at] for at in inside), default=INF)
    of_it = [at for at in inside if _is_of_cell(depth[at], nearest)]
    if not of_it:
        return None
    count = F(len(of_it))
    return [sum((a[at] for at in of_it), F(0)) / count for a in (p0 - p1, p0 - p1_prev, px_prev, depth, met_depth)]


def _lasted(velocity, found, before):
    size = (found * found).sum()
    share = (found * before).sum() / size if size > 0 else F(0)
    return np.clip(share * F(ACCELERATION.SLOWS) if (found * velocity).sum() < 0 else share, F(0), F(1))


def _trust(velocity, found, share):
    size, speed = (found * found).sum(), ACCELERATION.BEND_MOST**2 * (velocity * velocity).sum()
    return share * (speed / size) if size > speed else share


def _carried_on(found, before):
    """Return the acceleration with its change continued as at α = ½, less where that is over half of the
    acceleration."""
    change, most = found - before, F(ACCELERATION.TURN_MOST) * np.linalg.norm(found)
    size = np.linalg.norm(change)
    return found + F(ACCELERATION.TURN) * change * (F(1) if size <= most else (most / size) ** 2)


def _as_packed(acceleration):
    """Return values as they are after packing: ten bits of the mantissa, trust in steps of 1/62."""
    vector = ((np.ascontiguousarray(acceleration[..., :3]).view(np.uint32) + 0x1000) & 0xFFFFE000).view(F)
    trust, steps = acceleration[..., 3:], F(ACCELERATION.MOST_TRUST)
    return np.concatenate([vector, np.where(trust < 0, F(-1), np.floor(trust * steps + F(0.5)) / steps)], -1)


def track_acceleration(
    depth,
    motion,
    dynamic,
    met_depth,
    velocity_prev,
    acceleration_prev,
    view_velocity_prev,
    ratio,
    to_previous,
    from_previous,
    camera_fixed=True,
):
    """Return velocity and depth, acceleration and trust, the part of it that goes on, velocity in view space and
    whether the camera carries the mover, of cells, (⌈H/4⌉, ⌈W/4⌉, 4) each."""
    side, (height, width) = ACCELERATION.MOVER_CELL, depth.shape
    cells = -(-height // side), -(-width // side)
    velocity, acceleration, bend, view_velocity = (np.zeros((*cells, 4), F) for _ in range(4))
    acceleration[..., 3] = -1
    known = (dynamic == 1) & (met_depth > 0)  # not what is fixed to the camera
    px = centers(height, width)
    with np.errstate(all="ignore"):
        px_prev = px + motion
        p0 = unproject(px, depth, to_previous[4])
        p1_prev = unproject(px_prev, met_depth, from_previous[4])
        p1 = move(p1_prev, from_previous)
    for y, x in np.ndindex(cells):
        rows, columns = range(side * y, min(side * y + side, height)), range(side * x, min(side * x + side, width))
        inside = [(j, i) for j in rows for i in columns if known[j, i]]
        mover = _mover_of_cell(inside, p0, p1, p1_prev, px_prev, depth, met_depth)
        if mover is None:
            continue
        v, v_seen, at, z, z_prev = mover
        velocity[y, x] = (*v, z)
        view_velocity[y, x, :3] = v_seen
        at = at / F(side) - F(0.5)
        x0, y0 = map(int, np.floor(at))
        was, seen, before, weights, before_weights = np.zeros(3, F), np.zeros(3, F), np.zeros(3, F), F(0), F(0)
        was_carried = carried = False
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
            seen = seen + weight * view_velocity_prev[j, i, :3]
            was_carried |= view_velocity_prev[j, i, 3] > 0
            if a_prev[3] >= 0:
                before, before_weights = before + weight * a_prev[:3], before_weights + weight
        if not weights > 0:
            continue
        was, seen = ratio * rotate(was / weights, from_previous), ratio * (seen / weights)
        if camera_fixed:
            change, in_world = ((v_seen - seen) ** 2).sum(), ((v - was) ** 2).sum()
            if was_carried:
                carried = change < F(ACCELERATION.STILL_IN_VIEW) * in_world
            else:
                shaken = F(ACCELERATION.SHAKEN) * z
                carried = change < F(ACCELERATION.IN_VIEW) * in_world and in_world > shaken * shaken
        if carried:
            v, was = v_seen, seen
            view_velocity[y, x, 3] = 1
        found = (v - was) * (ratio / (1 + ratio))
        share, later = F(ACCELERATION.FIRST), found
        if before_weights > 0 and carried == was_carried:
            before = ratio * ratio * (before / before_weights)
            before = before if carried else rotate(before, from_previous)
            share, later = _lasted(v, found, before), _carried_on(found, before)
        acceleration[y, x] = (*found, _trust(v, found, share))
        bend[y, x, :3] = acceleration[y, x, 3] * later
    bend[..., 3] = np.maximum(acceleration[..., 3], F(0))
    return velocity, _as_packed(acceleration), _as_packed(bend), _as_packed(view_velocity)
