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


def _lasted(found, before):
    size = (found * found).sum()
    return np.clip(F(ACCELERATION.LASTS) * ((found * before).sum() / size), F(0), F(1)) if size > 0 else F(0)


def _trust(velocity, found, share):
    size, speed = (found * found).sum(), ACCELERATION.BEND_MOST**2 * (velocity * velocity).sum()
    return share * (speed / size) if share < 1 and size > speed else share


def _change_of(found, before):
    """Return the change of the acceleration `found` in the next interval, if it turns as it has turned since `before`:
    less where that is over the acceleration."""
    most, both = (found * found).sum(), (found * found).sum() + (before * before).sum()
    cosine = 2 * (found * before).sum() / both if both > 0 else F(0)
    change = (2 * cosine - 1) * found - before
    size = (change * change).sum()
    return change * (most / size) if size > most else change


def _as_packed(acceleration):
    """Return values as they are after packing: ten bits of the mantissa, trust in steps of 1/62."""
    vector = ((np.ascontiguousarray(acceleration[..., :3]).view(np.uint32) + 0x1000) & 0xFFFFE000).view(F)
    trust, steps = acceleration[..., 3:], F(ACCELERATION.MOST_TRUST)
    return np.concatenate([vector, np.where(trust < 0, F(-1), np.floor(trust * steps + F(0.5)) / steps)], -1)


def _past_of(mover, velocity_prev, acceleration_prev, bend_prev, view_velocity_prev):
    """Return mean velocity in the world and in view space, mean acceleration or None, whether the camera carried the
    mover, and whether it spun, in the frame before; None if it did not show the mover."""
    _, _, at, _, z_prev = mover
    cells = velocity_prev.shape[:2]
    at = at / F(ACCELERATION.MOVER_CELL) - F(0.5)
    x0, y0 = map(int, np.floor(at))
    was, seen, before, weights, known, spun = np.zeros(3, F), np.zeros(3, F), np.zeros(3, F), F(0), F(0), F(0)
    was_carried = False
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
            before, known = before + weight * a_prev[:3], known + weight
            spun += weight * F(bend_prev[j, i, 3] < 0)
    if not weights > 0:
        return None
    return was / weights, seen / weights, before / known if known > 0 else None, was_carried, spun > F(0.5) * weights


def _changes(mover, past, ratio, from_previous):
    was, seen = ratio * rotate(past[0], from_previous), ratio * past[1]
    return np.array((((mover[1] - seen) ** 2).sum(), ((mover[0] - was) ** 2).sum()), F)


def _is_carried(cell, movers, pasts, ratio, from_previous):
    mover, past = movers[cell], pasts[cell]
    in_world, in_view = ((velocity * velocity).sum() for velocity in mover[:2])
    if past[3] or not in_view < in_world:
        return in_view < in_world
    own = _changes(mover, past, ratio, from_previous)
    shaken = F(ACCELERATION.SHAKEN) * mover[3]
    if not (own[0] < own[1] and own[1] > shaken * shaken):
        return False
    total = own
    for dy, dx in np.ndindex(3, 3):
        other = cell[0] + (dy - 1) * ACCELERATION.NEXT_CELLS, cell[1] + (dx - 1) * ACCELERATION.NEXT_CELLS
        if other != cell and pasts.get(other) and _is_of_cell(movers[other][3], mover[3]):
            total = total + _changes(movers[other], pasts[other], ratio, from_previous)
    share = F(1) if in_view < F(ACCELERATION.KEEPS_UP) * in_world else F(ACCELERATION.IN_VIEW)
    return total[0] < share * total[1]


def _center_velocity(velocity, found, before, spun, px):
    """Return the velocity of the center of what spins; None if it does not."""
    size, size_before, both = (found * found).sum(), (before * before).sum(), (found * before).sum()
    most = F(ACCELERATION.STILL_SPINS if spun else ACCELERATION.SPIN_SIZES)
    if not (both < 0 and size > (F(ACCELERATION.SPIN_LEAST) * px) ** 2):
        return None
    if not (size < most * size_before and size_before < most * size):
        return None
    cosine = 2 * both / (size + size_before)
    return velocity - ((1 - 2 * cosine) * found + before) / (1 - cosine)


def track_acceleration(
    depth,
    motion,
    dynamic,
    met_depth,
    velocity_prev,
    acceleration_prev,
    bend_prev,
    view_velocity_prev,
    ratio,
    to_previous,
    from_previous,
    camera_fixed=True,
):
    """Return velocity and depth, acceleration and trust, the change of it that counts, velocity in view space and
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
    movers, pasts = {}, {}
    for y, x in np.ndindex(cells):
        rows, columns = range(side * y, min(side * y + side, height)), range(side * x, min(side * x + side, width))
        inside = [(j, i) for j in rows for i in columns if known[j, i]]
        mover = _mover_of_cell(inside, p0, p1, p1_prev, px_prev, depth, met_depth)
        if mover is not None:
            movers[y, x] = mover
            pasts[y, x] = _past_of(mover, velocity_prev, acceleration_prev, bend_prev, view_velocity_prev)
    for (y, x), (v, v_seen, _, z, _) in movers.items():
        velocity[y, x] = (*v, z)
        view_velocity[y, x, :3] = v_seen
        if pasts[y, x] is None:
            continue
        was, seen, before, was_carried, spun = pasts[y, x]
        was, seen = ratio * rotate(was, from_previous), ratio * seen
        carried = camera_fixed and _is_carried((y, x), movers, pasts, ratio, from_previous)
        if carried:
            v, was = v_seen, seen
            view_velocity[y, x, 3] = 1
        found = (v - was) * (ratio / (1 + ratio))
        share, change, center = F(ACCELERATION.FIRST), np.zeros(3, F), None
        if before is not None and carried == was_carried:
            before = ratio * ratio * before
            before = before if carried else rotate(before, from_previous)
            share, change = _lasted(found, before), _change_of(found, before)
            center = _center_velocity(v, found, before, spun, z * to_previous[4][0])
        trust = F(0) if center is not None else _trust(v, found, share)
        acceleration[y, x] = (*found, trust)
        bend[y, x] = (*(trust * change), trust) if center is None else (*center, -1)
    return velocity, _as_packed(acceleration), _as_packed(bend), _as_packed(view_velocity)
