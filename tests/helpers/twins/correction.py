"""Twin of correction.cl."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from twins.common import F, kernel_constants, load_color
from twins.network_input import decode, encode, exp_less_one
from twins.shading_flow import CANDIDATES, doubled, sampled

CORRECTION = kernel_constants("correction.cl")


def leaky(x):
    return np.where(x < CORRECTION.SLOPE * x, CORRECTION.SLOPE * x, x)


def sigmoid(x):
    of_negative = F(1) / (exp_less_one(np.fmin(np.abs(x), F(88))) + F(2))
    return np.where(np.isnan(x), x, np.where(x < 0, of_negative, F(1) - of_negative))


def choose_flow(judgement, candidates, differences, alpha):
    """Return (4, h, w) of a quarter of the resolution: the flow that is followed, how far the trend lasts, and how far
    the focus mask is trusted."""
    follow = F(2) * CANDIDATES.FOUND_UNIT * F(alpha) * sigmoid(judgement[2])
    lasts = np.clip(candidates[CANDIDATES.HELD] + judgement[3], F(0), F(1))
    changed, _, again, again_along = (doubled(plane) for plane in differences)
    ratio = (np.minimum(again, again_along) + CANDIDATES.LEAST) / (changed + CANDIDATES.LEAST)
    trusted = np.clip(CORRECTION.TRUSTED - CORRECTION.DISTRUST * ratio, F(0), F(1))
    return np.concatenate([follow * candidates[CANDIDATES.FOUND :][:2], lasts[None], trusted[None]])


def judge(frames, trends, judgement, chosen, head, texture, refined=False):
    """Return (5, h, w): the correction at half resolution; unless the `refined` image is made, too, only where it is
    used."""
    seen_count, hidden, said_count = CORRECTION.SEEN, CORRECTION.HIDDEN, CORRECTION.SAID
    parts = np.split(head, np.cumsum([hidden * seen_count, hidden, said_count * hidden]))
    first, bias, second, last = parts[0].reshape(hidden, -1), parts[1], parts[2].reshape(said_count, -1), parts[3]
    _, height, width = frames.shape
    flow_x, flow_y, lasts, trusted = (doubled(plane) for plane in chosen)
    y, x = np.mgrid[:height, :width]
    detail = judgement[CORRECTION.JUDGED :].reshape(CORRECTION.DETAIL, 2, 2, height // 2, width // 2)
    detail = leaky(detail.transpose(0, 3, 1, 4, 2).reshape(CORRECTION.DETAIL, height, width))
    now, before = frames[:3], frames[3:6]
    there = np.stack([sampled(plane, x.astype(F) + flow_x, y.astype(F) + flow_y) for plane in frames[:6]])
    changes = CORRECTION.CHANGE_MARGIN * np.stack([now - before, there[:3] - there[3:], np.zeros_like(now)])
    moved = np.clip(there[:3] - now, changes.min(0), changes.max(0))
    trend = np.stack([doubled(plane) for plane in trends[:3]]) * lasts
    seen = np.concatenate([detail, moved, trend, now, before])
    said = np.repeat(last, height * width).reshape(said_count, height, width)
    for k in range(hidden):
        total = np.full((height, width), bias[k])
        for i in range(seen_count):
            total = total + first[k, i] * seen[i]
        said = said + second[:, k, None, None] * leaky(total)
    number = (flow_x - flow_x) + (flow_y - flow_y)
    delta = said[:3] + moved + said[5] * trend + number
    mask = np.clip(F(2) * said[4] - CORRECTION.DOUBT, F(0), F(1))
    keep = sigmoid(said[3])
    keep = keep + (F(1) - keep) * doubled(texture)
    made = np.concatenate([delta, keep[None], (mask * trusted)[None]])
    sums = sliding_window_view(np.pad(chosen[3], 1, mode="edge"), (3, 3)).sum((-1, -2))
    unused = (sums == 0).repeat(2, 0).repeat(2, 1) & (not refined)
    return np.where(unused, np.array([0, 0, 0, 1, 0], F)[:, None, None], made)


def correct(color, frames, correction, exposure, within_mask=True):
    """Return (refined (H, W, 4) float16, focus mask (H, W) float16, final (H, W, 4) float16)."""
    height, width = color.shape[:2]
    half_height, half_width = frames.shape[1:]
    y, x = np.mgrid[:height, :width]
    x0, y0 = (x - 1) >> 1, (y - 1) >> 1
    u, v = np.where(x & 1, F(0.25), F(0.75)), np.where(y & 1, F(0.25), F(0.75))

    def full(plane):
        total = 0
        for tap in range(4):
            tx, ty = np.clip(x0 + (tap & 1), 0, half_width - 1), np.clip(y0 + (tap >> 1), 0, half_height - 1)
            total = total + (u if tap & 1 else F(1) - u) * (v if tap >> 1 else F(1) - v) * plane[ty, tx]
        return total

    rgb = load_color(color)
    with np.errstate(invalid="ignore", over="ignore"):
        low, delta = (np.stack([full(image[k]) for k in range(3)], -1) for image in (frames, correction))
        encoded = low + delta + full(correction[3])[..., None] * (encode(rgb, exposure) - low)
        m = full(correction[4])
        usable = np.isfinite(encoded.sum(-1) + m)
        m = np.where(usable & (m >= CORRECTION.LEAST_MASK), np.minimum(m, F(1)), F(0))
        corrected = decode(encoded, exposure)
        share = (m if within_mask else usable.astype(F))[..., None]
        mixed = rgb * (F(1) - share) + corrected * share
    refined, final = color.copy(), color.copy()
    refined[usable, :3], refined[usable, 3] = corrected[usable].astype(np.float16), 0
    touched = share[..., 0] > 0
    final[touched, :3], final[touched, 3] = mixed[touched].astype(np.float16), 0
    return refined, m.astype(np.float16), final


def follow_flow(extrapolated, flow, followed, color, alpha):
    """Return the final image (H, W, 4) float16 from `color`, that before."""
    height, width = color.shape[:2]
    y, x = np.mgrid[:height, :width].astype(F)

    def shrunk(plane, factor):
        scale = F(1) / F(factor)
        offset = F(0.5) * scale - F(0.5)
        return sampled(plane, scale * x + offset, scale * y + offset)

    share = (CORRECTION.FOLLOWED_SHARE * shrunk(followed, 4))[..., None]
    to_x, to_y = (p + F(4) * F(alpha) * shrunk(plane, 8) for p, plane in ((x, flow[0]), (y, flow[1])))
    with np.errstate(invalid="ignore", over="ignore"):
        moved = np.stack([sampled(extrapolated[..., c].astype(F), to_x, to_y) for c in range(3)], -1)
        mixed = load_color(color) * (F(1) - share) + load_color(moved) * share
    final, touched = color.copy(), share[..., 0] > 0
    final[touched, :3], final[touched, 3] = mixed[touched].astype(np.float16), 0
    return final
