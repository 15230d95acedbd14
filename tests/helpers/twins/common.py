"""Shared parts of twins: projections, constants of kernels."""

from types import SimpleNamespace

import numpy as np

from gffe_cl.engine.opencl.program import constants

F = np.float32
INF = F(np.inf)
COMMON = SimpleNamespace(**constants("common.h"))


def kernel_constants(file):
    """Return the constants of a kernel file as attributes; fractions are float32."""
    return SimpleNamespace(**{name: F(v) if isinstance(v, float) else v for name, v in constants(file).items()})


WARP = kernel_constants("warp.cl")
CODE = kernel_constants("color_code.h")
NOBODY = WARP.NOBODY
COLOR_MAX = F(COMMON.COLOR_MAX)


CODE_OFFSET = F(0.5)  # of color_code.h, at exposure 1; tests set it to 0 for linear light


def encode_color(c):
    """Return codes of colors."""
    c = np.asarray(c, F)
    if not CODE_OFFSET:
        return c
    size, white_root = np.abs(c), F(2) * CODE_OFFSET
    root = np.sqrt(size)
    dark = F(0.5) * size + CODE_OFFSET * root
    bright = CODE.KNEE * white_root * np.sqrt(white_root * root) - (CODE.KNEE - F(1)) * white_root * white_root
    return np.copysign(np.where(root > white_root, bright, dark), c)


def white():
    """Return the code of display white; 1 in linear light."""
    return F(4) * CODE_OFFSET * CODE_OFFSET if CODE_OFFSET else F(1)


def decode_color(code):
    """Return colors of codes."""
    code = np.asarray(code, F)
    if not CODE_OFFSET:
        return code
    size, white_root = np.abs(code), F(2) * CODE_OFFSET
    white = white_root * white_root
    dark = np.sqrt(F(2) * size + CODE_OFFSET * CODE_OFFSET) - CODE_OFFSET
    total = size + (CODE.KNEE - F(1)) * white
    bright = total * total * (F(1) / (CODE.KNEE * CODE.KNEE) / (white * white_root))
    root = np.where(size > white, bright, dark)
    return np.copysign(root * root, code)


def centers(height, width):
    """Return (H, W, 2) float32 pixel centers."""
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


def load_color(color):
    c = np.nan_to_num(color[..., :3].astype(F), nan=0.0, posinf=COLOR_MAX, neginf=-COLOR_MAX)
    return np.clip(c, -COLOR_MAX, COLOR_MAX)


def codes_of(color):
    """Return codes of an image's colors in half storage."""
    return encode_color(load_color(color)).astype(np.float16)


def cubic_weights(t, slope):
    """Return weights of cubic convolution of the four taps around t, with `slope` at the taps."""
    t2 = t * t
    t3 = t2 * t
    slope = F(slope)
    return np.stack(
        [
            slope * (F(2) * t2 - t - t3),
            F(1) + (slope - F(3)) * t2 + (F(2) - slope) * t3,
            slope * t + (F(3) - F(2) * slope) * t2 + (slope - F(2)) * t3,
            slope * (t3 - t2),
        ]
    )


def doubled(plane):
    """Return an image interpolated to twice the size, pixel centers on one plane, borders repeated."""
    height, width = plane.shape
    y, x = np.mgrid[: 2 * height, : 2 * width]
    left, top = np.clip((x - 1) >> 1, 0, width - 1), np.clip((y - 1) >> 1, 0, height - 1)
    right, bottom = np.clip(((x - 1) >> 1) + 1, 0, width - 1), np.clip(((y - 1) >> 1) + 1, 0, height - 1)
    u, v = np.where(x & 1, F(0.25), F(0.75)), np.where(y & 1, F(0.25), F(0.75))
    a, b, c, d = plane[top, left], plane[top, right], plane[bottom, left], plane[bottom, right]
    return (F(1) - u) * (F(1) - v) * a + u * (F(1) - v) * b + (F(1) - u) * v * c + u * v * d
