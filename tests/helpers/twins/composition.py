"""Twin of composition.cl."""

import numpy as np

from twins.common import COMMON, F, centers, load_color


def layer_texels(layer):
    """Return (H, W, 4) float32 of a premultiplied layer; what is no number is transparent."""
    alpha = layer[..., 3].astype(F)
    alpha = np.where(np.isnan(alpha), F(0), np.clip(alpha, F(0), F(1)))
    return np.concatenate([load_color(layer), alpha[..., None]], -1)


def layer_at(layer, px):
    """Return bilinear samples at positions (…, 2); transparent beyond the image."""
    height, width = layer.shape[:2]
    texels = np.zeros((height + 4, width + 4, 4), F)
    texels[2:-2, 2:-2] = layer_texels(layer)
    corner = np.floor(px - F(0.5))
    part = (px - F(0.5) - corner)[..., None]
    x, y = (np.clip(corner[..., k].astype(int) + 2, 0, n + 2) for k, n in enumerate((width, height)))
    inside = ((corner >= -2) & (corner < (width + 1, height + 1))).all(-1)
    u, v = part[..., 0, :], part[..., 1, :]
    total = (1 - u) * (1 - v) * texels[y, x] + u * (1 - v) * texels[y, x + 1]
    total = total + (1 - u) * v * texels[y + 1, x] + u * v * texels[y + 1, x + 1]
    return np.where(inside[..., None], total, F(0)).astype(F)


def effects_origin(px, alpha, motion):
    height, width = motion.shape[:2]
    origin, going = px.copy(), np.ones(px.shape[:-1], bool)
    for _ in range(3):
        place = np.floor(origin)
        going &= ((place >= 0) & (place < (width, height))).all(-1)
        x, y = np.where(going[..., None], place, 0).astype(int)[..., 0], np.where(going, place[..., 1], 0).astype(int)
        with np.errstate(invalid="ignore"):
            moved = F(alpha) * motion[y, x]
        going &= np.isfinite(moved).all(-1)
        origin = np.where(going[..., None], px + np.where(going[..., None], moved, 0), origin).astype(F)
    return origin


def compose(color, frame, source_color, source_depth, to_render, alpha, layers):
    """Return composed color (H, W, 4) float16; changes the dictionary `frame` (depth, motion, dynamic, disoccluded,
    filled_by). `layers`: arrays by the names of `Overlays`' fields."""
    height, width = color.shape[:2]
    px = centers(height, width)
    px_render = px * to_render[:2] + to_render[2:]
    picture = load_color(color)
    if "fixed_mask" in layers:
        mask = layers["fixed_mask"]
        place = np.floor(px_render).astype(int)
        rendered = ((place >= 0) & (place < mask.shape[::-1])).all(-1)
        x, y = np.where(rendered, place[..., 0], 0), np.where(rendered, place[..., 1], 0)
        fixed = rendered & (mask[y, x] > 0)
        picture[fixed] = load_color(source_color)[y, x][fixed]
        near = source_depth[y, x]
        valid = fixed & (near > 0)  # elsewhere that of what is behind stays
        frame["depth"][valid] = near[valid]
        frame["motion"][fixed] = (px_render - px)[fixed]
        for name, value in (("dynamic", 0), ("disoccluded", 0), ("filled_by", COMMON.BY_FIXED)):
            frame[name][fixed] = value
    if "effects" in layers:
        moving = "effects_motion" in layers
        origin = effects_origin(px_render, alpha, layers["effects_motion"]) if moving else px_render
        layer = layer_at(layers["effects"], origin)
        picture = layer[..., :3] + (1 - layer[..., 3:]) * picture
    if "ui" in layers:
        layer = layer_texels(layers["ui"])
        picture = layer[..., :3] + (1 - layer[..., 3:]) * picture
    bound = F(COMMON.COLOR_MAX) if hasattr(COMMON, "COLOR_MAX") else F(65504)
    return np.concatenate([np.clip(picture, -bound, bound), np.zeros((height, width, 1), F)], -1).astype(np.float16)
