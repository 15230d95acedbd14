"""Twin of upload.cl."""

import numpy as np

from gffe_cl.captures.sequence.engine_form import spread_geometry as spread_geometry  # of sequences on disk, too
from gffe_cl.captures.sequence.engine_form import undilated as undilated
from twins.common import COLOR_MAX, INF, F, centers, kernel_constants, reproject
from twins.network_input import exp_less_one, log

UPLOAD = kernel_constants("upload.cl")
UNITS = {np.uint8: F(1) / F(255), np.uint16: F(1) / F(65535)}


def convert_color(color):
    """Return (H, W, 4) float16 from (H, W, 3 or 4) half or float, with 0 in the fourth channel; how many pixels hold
    NaN or infinity; and how many were clamped."""
    rgb = color[..., :3].astype(F)
    finite = np.isfinite(rgb)
    over = finite & (np.abs(rgb) > COLOR_MAX)
    out = np.zeros((*color.shape[:2], 4), np.float16)
    out[..., :3] = np.where(np.isnan(rgb), F(0), np.minimum(np.maximum(rgb, -COLOR_MAX), COLOR_MAX))
    return out, (~finite).any(-1).sum(), over.any(-1).sum()


def convert_geometry(depth, motion, size=None):
    """Return, of images of `size`, by default that of depth (height, width): depth without denormal numbers and with
    sky beyond 1e37, motion without vectors as long as the diagonal, and how many depths are invalid, how many vectors
    not finite, how many depths too far, and how many vectors too long."""
    invalid, far = ~(depth >= np.finfo(F).tiny), np.isfinite(depth) & (depth > 1e37)
    finite = np.isfinite(motion).all(-1)
    with np.errstate(over="ignore", invalid="ignore"):
        short = np.square(motion).sum(-1, dtype=F) < np.square(size or depth.shape, dtype=F).sum(dtype=F)
    converted = np.where(far, F(np.inf), np.where(invalid & (depth >= 0), F(0), depth))
    unwritten = finite & ~short
    vectors = np.where(unwritten[..., None], F(np.nan), motion)
    return converted, vectors, (invalid.sum(), (~finite).sum(), far.sum(), unwritten.sum())


def convert_described_color(color, given):
    """Return `convert_color` of color of any type; integers stand for 0 to 1. `given`: members of the frame block."""
    unit = UNITS.get(color.dtype.type)
    color = color if unit is None else color.astype(F) * unit
    color = color[::-1] if given["rows_up"] else color
    if given["color_srgb"]:
        with np.errstate(all="ignore"):
            color = linear_of_srgb(color[..., :3].astype(F))
    return convert_color(color)


def linear_of_srgb(c):
    """Return linear light of sRGB."""
    lifted = np.minimum(np.maximum((c + F(0.055)) * (F(1) / F(1.055)), F(UPLOAD.SRGB_LEAST)), COLOR_MAX)
    curve = exp_less_one(F(2.4) * log(np.nan_to_num(lifted, nan=1))) + F(1)
    return np.where(c <= F(UPLOAD.SRGB_TOE), c * (F(1) / F(12.92)), np.where(np.isfinite(c), curve, c))


def convert_described_geometry(depth, motion, given, to_previous=None, size=None, source_inverse=None):
    """Return depth and motion in pixels of stored ones, converted by the members `given` of the frame block (motion
    None: there is none), and the counts as of `convert_geometry`. `to_previous` (6, 4): None without a frame before.
    `size`: height and width of color, by default those of depth. `source_inverse` (4,): of the camera, for
    distances."""
    if given["rows_up"]:
        depth, motion = depth[::-1], None if motion is None else motion[::-1]
    factor, origin, addend, sky = F(given["given_depth"])
    stored = (depth & 0xFFFFFF if depth.dtype == np.uint32 else depth).astype(F)
    with np.errstate(all="ignore"):
        if given["depth_law"] == UPLOAD.DEPTH_LOGARITHMIC:
            power = np.clip(factor * (stored - origin), -UPLOAD.MOST_POWER, UPLOAD.MOST_POWER)
            value = addend + (addend if addend > 0 else F(1)) * exp_less_one(power)
            value = np.where(stored == sky, INF, value)
        else:
            value = factor * (stored - origin) + addend
        if given["depth_law"] == UPLOAD.DEPTH_DEVICE:
            is_sky = (stored == sky) | (value <= F(1) / F(1e37))
            value = np.where(is_sky, INF, F(1) / value)
        if given["depth_law"] == UPLOAD.DEPTH_DISTANCE:
            here = centers(*depth.shape) * F(given["from_geometry"][:2]) + F(given["from_geometry"][2:])
            x, y = np.moveaxis((here - source_inverse[2:]) * source_inverse[:2], -1, 0)
            value = value / np.sqrt(F(1) + x * x + y * y)
    if motion is None:
        z, _, (invalid, _, far, _) = convert_geometry(value, np.zeros((*depth.shape, 2), F))
        return z, np.zeros((*depth.shape, 2), F), (invalid, 0, far, 0)
    numbers = F(given["given_motion"])
    unwritten = (motion.astype(F) == F(given["motion_invalid"])).all(-1, keepdims=True)
    with np.errstate(all="ignore"):
        vectors = np.where(unwritten, F(0), motion.astype(F) * numbers[:2] + numbers[2:])
    z, vectors, counts = convert_geometry(value, vectors, size)
    if given["given_types"][3] == UPLOAD.CAMERA_INCLUDED:
        return z, np.where(unwritten, F(np.nan), vectors), counts
    if to_previous is None:
        return z, vectors, counts
    camera = motion_by_camera(z, given, to_previous)
    added = given["given_types"][3] == UPLOAD.CAMERA_EXCLUDED
    with np.errstate(all="ignore"):
        return z, np.where(added | unwritten, vectors + camera, vectors), counts


def motion_by_camera(z, given, to_previous):
    """Return (H, W, 2): motion of static points at depth z, in pixels of color."""
    here = centers(*z.shape) * F(given["from_geometry"][:2]) + F(given["from_geometry"][2:])
    before = reproject(here, z, to_previous)
    camera = np.where(before[..., 2:] > 0, before[..., :2] - here, F(np.nan))
    return np.where((z > 0)[..., None], camera, F(0))
