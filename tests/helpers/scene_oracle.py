"""NumPy float64 ray caster and distances for built-in scenes; shares no code with the kernels or the
flattening.
"""

import numpy as np

from gffe_cl.captures.scenes.scene_types import BOX, CAPSULE, CONE, ELLIPSOID


def _quadratic(a, b, c):
    """Return both roots of a t² + 2 b t + c, NaN where there is none; the smaller first where a > 0."""
    root = np.sqrt(b * b - a * c)
    return (-b - root) / a, (-b + root) / a


def _sphere(center, radius, o, d):
    p = o - center
    return _quadratic((d * d).sum(-1), (p * d).sum(-1), (p * p).sum(-1) - radius**2)[0]


def _box(a, b, o, d):
    one, two = (a[:3] - b[:3] - o) / d, (a[:3] + b[:3] - o) / d
    enter, leave = np.minimum(one, two).max(-1), np.maximum(one, two).min(-1)
    return np.where(enter < leave, enter, np.nan)


def _round_body(a, b, o, d, flat_caps):
    """Return a frustum around the axis a → b (a cylinder for equal radii), with flat caps or with spheres at its
    ends."""
    axis = b[:3] - a[:3]
    length = np.linalg.norm(axis)
    axis = axis / length
    side = np.cross(axis, (1.0, 0.0, 0.0) if abs(axis[0]) < 0.7 else (0.0, 1.0, 0.0))
    side /= np.linalg.norm(side)
    basis = np.stack([side, axis, np.cross(side, axis)])
    p, v = (o - a[:3]) @ basis.T, d @ basis.T
    slope = (b[3] - a[3]) / length
    r, dr = a[3] + slope * p[:, 1], slope * v[:, 1]
    hits = []
    roots = _quadratic(
        v[:, 0] ** 2 + v[:, 2] ** 2 - dr**2,
        p[:, 0] * v[:, 0] + p[:, 2] * v[:, 2] - r * dr,
        p[:, 0] ** 2 + p[:, 2] ** 2 - r**2,
    )
    for t in roots:
        y = p[:, 1] + t * v[:, 1]
        hits.append(np.where((y >= 0) & (y <= length), t, np.nan))
    if flat_caps:
        for y, radius in ((0.0, a[3]), (length, b[3])):
            t = (y - p[:, 1]) / v[:, 1]
            x, z = p[:, 0] + t * v[:, 0], p[:, 2] + t * v[:, 2]
            hits.append(np.where(x * x + z * z <= radius**2, t, np.nan))
    else:
        hits += [_sphere(a[:3], a[3], o, d), _sphere(b[:3], b[3], o, d)]
    hits = np.stack(hits)
    return np.where(hits > 0, hits, np.inf).min(0)


def cast(scene, time, camera):
    """Return the surface at each pixel's center: view depth (H, W), object (H, W), world position or, for sky,
    direction (H, W, 3)."""
    height, width = round(camera.cy * 2), round(camera.cx * 2)
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    view = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], -1).reshape(-1, 3)
    d = view @ camera.world_to_view[:3, :3]
    o = camera.position
    depth, object_id = np.full(len(d), np.inf), np.full(len(d), -1)
    with np.errstate(all="ignore"):
        for index, group in enumerate(scene.groups):
            to_local = np.linalg.inv(group.motion(time))
            o_local = np.broadcast_to(to_local[:3, :3] @ o + to_local[:3, 3], d.shape)
            d_local = d @ to_local[:3, :3].T
            for primitive in group.primitives:
                a, b = np.array(primitive.a, np.float64), np.array(primitive.b, np.float64)
                if primitive.kind == BOX:
                    t = _box(a, b, o_local, np.where(d_local == 0, 1e-30, d_local))
                elif primitive.kind == ELLIPSOID:
                    t = _sphere(0.0, 1.0, (o_local - a[:3]) / b[:3], d_local / b[:3])
                else:
                    t = _round_body(a, b, o_local, d_local, primitive.kind == CONE)
                nearer = (t > 1e-4) & (t < depth)
                depth[nearer], object_id[nearer] = t[nearer], index
    position = np.where(np.isfinite(depth)[:, None], o + d * np.where(np.isfinite(depth), depth, 1.0)[:, None], d)
    shape = (height, width)
    return depth.reshape(shape), object_id.reshape(shape), position.reshape(*shape, 3)


def followed(scene, time, other_time, other_camera, object_id, position):
    """Return view positions at the other time (H, W, 3) of `cast`'s points; for sky the direction in the other view
    space."""
    rotation, shift = other_camera.world_to_view[:3, :3], other_camera.world_to_view[:3, 3]
    result = position @ rotation.T
    for index in np.unique(object_id[object_id >= 0]):
        motion = scene.groups[index].motion
        moved = motion(other_time) @ np.linalg.inv(motion(time))
        at = object_id == index
        result[at] = (position[at] @ moved[:3, :3].T + moved[:3, 3]) @ rotation.T + shift
    return result


def clearances(scene, times, points):
    """Return, of each world position at its time, the distance to the nearest solid (a lower bound for ellipsoids), ≤ 0
    inside."""
    bounds = []
    for group in scene.groups:
        low, high = (np.array(side) for side in zip(*(q.bounds() for q in group.primitives), strict=True))
        bounds.append((low.min(0), high.max(0)))
    return [_clearance(scene, bounds, time, point) for time, point in zip(times, points, strict=True)]


def _clearance(scene, bounds, time, point):
    least = np.inf
    for group, (low, high) in zip(scene.groups, bounds, strict=True):
        to_local = np.linalg.inv(group.motion(time))
        p = to_local[:3, :3] @ point + to_local[:3, 3]
        if np.linalg.norm(np.maximum(np.maximum(low - p, p - high), 0)) > min(least, 1.0):
            continue
        for primitive in group.primitives:
            a, b = np.array(primitive.a, np.float64), np.array(primitive.b, np.float64)
            if primitive.kind == BOX:
                q = np.abs(p - a[:3]) - b[:3]
                distance = np.linalg.norm(np.maximum(q, 0)) + min(q.max(), 0)
            elif primitive.kind == ELLIPSOID:
                distance = (np.linalg.norm((p - a[:3]) / b[:3]) - 1) * b[:3].min()
            else:
                axis = b[:3] - a[:3]
                h = np.clip((p - a[:3]) @ axis / (axis @ axis), 0, 1)
                radius = a[3] if primitive.kind == CAPSULE else a[3] + h * (b[3] - a[3])
                distance = np.linalg.norm(p - a[:3] - h * axis) - radius
            least = min(least, distance)
    return least
