"""Twin of user_interface.cl."""

import numpy as np
from twins.common import F, centers
from twins.warp import load_color

from gffe_cl.engine.opencl.program import constants

C = constants("user_interface.cl")


def exposed(color, exposure):
    return np.maximum(load_color(color) * F(exposure), F(0))


def is_within(a, b, most):
    apart = a - b
    return (apart * apart <= F(most) * (np.maximum(a, b) + F(C["DARK"]))).all(-1)


def at(places):
    """Indices (…, 2) of pixels, 0 where they are beyond the image, and whether they are within."""
    height, width = places.shape[:2]
    with np.errstate(invalid="ignore"):
        holds = ((places >= 0) & (places < np.array((width, height), F))).all(-1)
    found = np.where(holds[..., None], places, F(0)).astype(int)
    return (found[..., 1], found[..., 0]), holds


def is_one_surface(z, other):
    with np.errstate(invalid="ignore"):
        return np.where(np.isinf(z), np.isinf(other), np.abs(other - z) <= F(C["SAME_DEPTH"]) * z)


def count_evidence(evidence, color, color_prev, depth, depth_prev, motion, exposure):
    """The evidence (H, W) uint8 after a frame with another one before it."""
    c, before = exposed(color, exposure), exposed(color_prev, exposure)
    with np.errstate(invalid="ignore"):
        length = np.fmax(np.abs(motion[..., 0]), np.abs(motion[..., 1]))
        there, holds = at(centers(*depth.shape) + motion)
        stays = holds & is_one_surface(depth, depth_prev[there]) & ~is_within(before[there], c, C["CLEAR"])
        there, holds = at(centers(*depth.shape) - motion)
        apart = np.abs(motion[there] - motion)
        holds &= np.fmax(apart[..., 0], apart[..., 1]) <= F(C["SAME_MOTION"]) * length
        stays |= holds & is_one_surface(depth, depth[there]) & ~is_within(c[there], c, C["CLEAR"])
        stays &= length >= F(C["MOVES"])
    counted = np.minimum(evidence + stays, C["PAIRS"])
    return np.where(is_within(c, before, C["SAME"]), counted, 0).astype(np.uint8)


def window_sums(mask, reach):
    """For each pixel how many of those around, up to `reach` away in x and y, are set."""
    height, width = mask.shape
    padded = np.pad(mask.astype(int), reach)
    steps = range(2 * reach + 1)
    return sum(padded[y : y + height, x : x + width] for y in steps for x in steps)


def mark_user_interface(evidence, given=None):
    """The mask (H, W) uint8 of evidence, and of a given one."""
    sure = evidence == C["PAIRS"]
    sure &= window_sums(sure, C["AROUND"]) >= C["LEAST"]
    return ((window_sums(sure, 1) > 0) | (False if given is None else given > 0)).astype(np.uint8)
