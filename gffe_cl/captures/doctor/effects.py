"""Effects without depth: colors that move over a surface otherwise than its motion vectors."""

from __future__ import annotations

import numpy as np

from gffe_cl.captures.doctor.findings import Finding, finding
from gffe_cl.captures.doctor.hypotheses.sampling import Clip, encoded
from gffe_cl.engine.frame.rendered_frame import RenderedFrame

_WIDTH = 480  # pixels: larger frames are looked at in boxes of pixels
_BLOCK, _REACH = 8, 4  # pixels of the boxes: sides of a block, and how far colors may be from where vectors lead
_ALIKE, _ONE_SURFACE = 0.5, 1.1  # pixels, and ratio of depths, by which a block differs in itself at most
_SHOWN_BEFORE = 1.3  # ratio of its depths in both frames: beyond that, the frame before showed another surface there
_VISIBLE, _EXPLAINED = 0.02, 0.65  # mean difference of encoded colors along vectors; share of it that is left elsewhere
_APART = 1.5  # pixels between where vectors lead and where the colors are
_LEAST, _FRAMES = 0.015, 3  # share of all blocks; frames that are looked at


def effects_notes(clip: Clip, indices: list[int], exposure: float) -> list[Finding]:
    """Return a note if colors move otherwise than the surface that they are on, in frames `indices` of `clip`. Raises
    GffeError if a frame cannot be read."""
    entries, found = clip.rendered, []
    for k in [k for k in indices if k and not entries[k].reset][:_FRAMES]:
        before, frame = clip.read(entries[k - 1]), clip.read(entries[k])
        if frame.motion is not None and np.shape(before.color) == np.shape(frame.color):
            found.append(float(moving_colors(frame, before, exposure).mean()))
    share = min(found, default=0.0)  # one that lasts
    return [finding("color: moves by itself", {"share": share}, share=share)] if share >= _LEAST else []


def moving_colors(frame: RenderedFrame, before: RenderedFrame, exposure: float) -> np.ndarray:
    """Return (rows, columns) bool for blocks of `frame`: on one surface, which moves evenly and which `before` shows,
    and whose colors are found clearly elsewhere there than where motion vectors lead."""
    factor = max(1, -(-np.shape(frame.depth)[1] // _WIDTH))
    lights = (encoded(np.asarray(one.color)[..., :3], exposure).mean(-1) for one in (frame, before))
    here, there = (_boxes(light, factor) for light in lights)
    depth, depth_before, motion = (
        np.asarray(plane, np.float32)[::factor, ::factor][: here.shape[0], : here.shape[1]]
        for plane in (frame.depth, before.depth, frame.motion)
    )
    motion = motion / factor
    whole = [_blocks(image) for image in (here, depth, motion[..., 0], motion[..., 1])]
    rows, columns = whole[0].shape[:2]
    with np.errstate(invalid="ignore", over="ignore"):
        even = whole[1].max(-1) <= _ONE_SURFACE * whole[1].min(-1)
        even &= (np.ptp(whole[2], -1) <= _ALIKE) & (np.ptp(whole[3], -1) <= _ALIKE) & (whole[1].min(-1) > 0)
    even &= np.isfinite(whole[2]).all(-1) & np.isfinite(whole[3]).all(-1)
    vector = np.where(even[..., None], np.stack([whole[2].mean(-1), whole[3].mean(-1)], -1), 0.0)
    y, x = np.mgrid[: rows * _BLOCK, : columns * _BLOCK]
    x, y = (_blocks(plane) for plane in (x, y))
    base = x + vector[..., :1], y + vector[..., 1:]
    even &= (base[0] >= _REACH).all(-1) & (base[0] < here.shape[1] - 1 - _REACH).all(-1)
    even &= (base[1] >= _REACH).all(-1) & (base[1] < here.shape[0] - 1 - _REACH).all(-1)
    bx, by, block, deep = (plane[even] for plane in (*base, *whole[:2]))
    was = depth_before[np.rint(by).astype(int), np.rint(bx).astype(int)]
    shown = ((was == deep) | ((was < _SHOWN_BEFORE * deep) & (deep < _SHOWN_BEFORE * was))).all(-1)

    def differences(dx: int, dy: int) -> np.ndarray:
        return np.abs(_bilinear(there, bx + dx, by + dy) - block).mean(-1)

    led = differences(0, 0)
    steps = range(-_REACH, _REACH + 1)
    apart = [differences(dx, dy) for dy in steps for dx in steps if np.hypot(dx, dy) >= _APART]
    found = np.zeros((rows, columns), bool)
    found[even] = shown & (led > _VISIBLE) & (np.min(apart, 0) < _EXPLAINED * led)
    return found


def _boxes(image: np.ndarray, factor: int) -> np.ndarray:
    """Return the means (h, w) of boxes of `factor` × `factor` pixels of `image` (H, W)."""
    height, width = (size // factor for size in image.shape)
    return image[: height * factor, : width * factor].reshape(height, factor, width, factor).mean((1, 3))


def _blocks(image: np.ndarray) -> np.ndarray:
    """Return (rows, columns, pixels of a block) of `image` (h, w), without those that are cut by the border."""
    rows, columns = (size // _BLOCK for size in image.shape)
    cut = image[: rows * _BLOCK, : columns * _BLOCK].reshape(rows, _BLOCK, columns, _BLOCK)
    return cut.swapaxes(1, 2).reshape(rows, columns, -1)


def _bilinear(image: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    u, v = x - left, y - top
    upper = image[top, left] * (1 - u) + image[top, left + 1] * u
    lower = image[top + 1, left] * (1 - u) + image[top + 1, left + 1] * u
    return upper * (1 - v) + lower * v
