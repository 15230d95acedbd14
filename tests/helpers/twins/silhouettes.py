"""NumPy twin of kernels/silhouettes.cl, pixel by pixel."""

import numpy as np

from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.stages.buffers import BLOCK
from twins.background import REMEMBERED, as_rgb9e5
from twins.common import COMMON, decode_color, encode_color
from twins.warp import codes_of

F = np.float32
CONSTANTS = constants("silhouettes.cl")
STEP, MOVES_APART, SAME_LAYER, ALONG, AT_EDGE, SHARPER = (
    F(CONSTANTS[name]) for name in ("STEP", "MOVES_APART", "SAME_LAYER", "ALONG", "AT_EDGE", "SHARPER")
)
FAR, NEAR, MARKED = CONSTANTS["FAR"], CONSTANTS["NEAR"], CONSTANTS["MARKED"]
AROUND = [(dx, dy) for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
OWN_BESIDE_CORNERS = ([(0, 0)], [(0, -1), (-1, 0), (1, 0), (0, 1)], [(-1, -1), (1, -1), (-1, 1), (1, 1)])


def tent(dx, dy):
    return F(4 >> (abs(dx) + abs(dy)))


def color_of(color):
    """Return colors as load_color gives them, or their codes, nothing negative."""
    rgb = np.nan_to_num(color[..., :3].astype(F), nan=0, posinf=COMMON.COLOR_MAX, neginf=0)
    return np.clip(rgb, 0, COMMON.COLOR_MAX)


def halfway(depths):
    """Return the middle of the sides of a step of depth; None if there is none."""
    valid = [z for z in depths if z > 0]
    if not valid or not min(valid) < (F(1) - STEP) * max(valid):
        return None
    nearest, farthest = F(min(valid)), F(max(valid))
    return F(2) * nearest * (F(1) if np.isinf(farthest) else farthest / (nearest + farthest))


def find_layers(color, depth, links, smooth, target_position, zoom, levels):
    """Return layer (H, W) uint8 and behind (H, W, 4) float32: a code and a share. `smooth`: of source blocks; `levels`:
    the background's, perhaps none."""
    height, width = depth.shape
    color, layer = color_of(codes_of(color)), np.zeros((height, width), np.uint8)
    behind = np.zeros((height, width, 4), F)
    for y, x in np.argwhere(links != 15):
        if smooth[y // BLOCK[1], x // BLOCK[0]]:
            continue
        near_by = [(x + dx, y + dy, dx, dy) for dx, dy in AROUND if 0 <= x + dx < width and 0 <= y + dy < height]
        middle = halfway([depth[v, u] for u, v, *_ in near_by])
        if middle is None or not depth[y, x] > 0:
            continue
        is_near = depth[y, x] < middle
        here = target_position[y, x]
        parts = False
        for u, v, dx, dy in near_by:
            e = np.abs(target_position[v, u, :2] - here[:2] - zoom * np.array([dx, dy], F))
            other = depth[v, u] > 0 and (depth[v, u] < middle) != is_near
            parts |= bool(other and e[0] < CONSTANTS["ANYWHERE"] and e.max() > MOVES_APART)
        if parts:
            layer[y, x] = NEAR if is_near else FAR
            remembered = None if is_near or not levels else recalled(levels[0], x, y, depth[y, x])
            behind[y, x] = unmixed(color, depth, links, x, y, near_by, middle, remembered)
    return layer, behind


def mark_blocks(layer, target_position, size):
    """Return target blocks, (rows, columns), where layers go; `size`: width and height of the new frame."""
    marked = np.zeros((-(-size[1] // BLOCK[1]), -(-size[0] // BLOCK[0])), np.uint8)
    for px in target_position[layer > 0][:, :2]:
        if (px > -MARKED).all() and (px < np.add(size, MARKED)).all():
            for k in range(4):
                at = np.trunc(px).astype(int) + np.where([k & 1, k >> 1], MARKED, -MARKED)
                x, y = np.clip(at, 0, np.subtract(size, 1)) // BLOCK
                marked[y, x] = 1
    return marked


def recalled(level, x, y, z):
    """Return the code of what a level of the background remembers of the surface of depth z at a pixel, or None."""
    d = level["depth"][y, x]
    alike = np.isinf(d) if np.isinf(z) else abs(d - z) <= STEP * z
    return encode_color(color_of(level["color"][y, x])) if level["state"][y, x] == REMEMBERED and alike else None


def unmixed(color, depth, links, x, y, near_by, middle, remembered):
    sums = np.zeros((2, 4), F)
    for u, v, dx, dy in near_by:
        if depth[v, u] > 0:
            side = int(depth[v, u] < middle)
            sums[side] += tent(dx, dy) * (F(1) if links[v, u] == 15 else AT_EDGE) * np.append(color[v, u], F(1))
    far, near = (s[:3] * (F(1) / s[3]) for s in sums)
    is_near, own, contrast = depth[y, x] < middle, color[y, x], near - far
    scale = F(1) / (F(1e-4) + max(near.max(), far.max()))
    relative, offset = contrast * scale, (own - far) * scale
    squared, along = (relative * relative).sum(), (offset * relative).sum()
    low, high = (F(0.5), F(1)) if is_near else (F(0), F(0.5))
    coverage = np.clip(along / squared, low, high) if squared > 0 else F(0.5)
    behind = far if is_near else own - coverage * contrast
    if remembered is not None and squared > 0:
        differs = (((remembered - far) * scale) ** 2).sum()
        behind = behind + F(2) * coverage * squared / (squared + differs) * (remembered - behind)
    return np.append(np.maximum(behind, 0), coverage)


def stored(code):
    return decode_color(as_rgb9e5(np.asarray(code, F))[:3])


class Softening:
    """The new frame's silhouettes. `shown`: its buffers by name, before; `layers`: what find_layers gives."""

    def __init__(self, shown, color, target_position, layers, zoom):
        self.shown, self.target_position, self.zoom = shown, target_position, zoom
        self.source, (self.layer, self.behind) = codes_of(color), layers
        self.warped = np.isin(shown["filled_by"], (COMMON.BY_WARP, COMMON.BY_CRACK_CLOSING))
        self.filled = shown["filled_by"] != COMMON.BY_NOTHING

    def run(self, marked):
        """Return coverage (H, W) uint8, color (H, W, 3) float16."""
        coverage = np.zeros(self.warped.shape, np.uint8)
        color = self.shown["color"][..., :3].copy()
        for y, x in np.ndindex(coverage.shape):
            if not marked[y // BLOCK[1], x // BLOCK[0]]:
                continue
            pair = self.pair(x, y)
            near = pair and self.near_layer(x, y, *pair[:2])
            if near is not None and pair:
                color[y, x] = stored(near[:3] + (F(1) - near[3]) * pair[2])
                coverage[y, x] = int(F(1) + F(254) * near[3] + F(0.5))
                continue
            rgb, is_other = self.without_near(x, y)
            if is_other:
                color[y, x], coverage[y, x] = stored(rgb), 1
        return coverage, color

    def taps(self, x, y, px_source, z):
        """Yield (x, y, weight, whether it goes along, depth it goes to) of the four pixels around a place that lie
        inside."""
        first = np.floor(px_source - F(0.5))
        u, v = px_source - F(0.5) - first
        for k in range(4):
            i, j = int(first[0]) + (k & 1), int(first[1]) + (k >> 1)
            if 0 <= i < self.layer.shape[1] and 0 <= j < self.layer.shape[0]:
                there = self.target_position[j, i]
                center = np.array([x, y], F) + F(0.5)
                e = np.abs(there[:2] - center - self.zoom * (np.array([i, j], F) + F(0.5) - px_source))
                along = there[2] * SAME_LAYER <= z and z * SAME_LAYER <= there[2] and e.max() < ALONG
                yield i, j, (u if k & 1 else F(1) - u) * (v if k >> 1 else F(1) - v), along, there[2]

    def far_layer(self, x, y, px_source, z):
        """Return colors around a place of the rendered frame, times their weights, and the weights."""
        total = np.zeros(4, F)
        for i, j, weight, along, _ in self.taps(x, y, px_source, z):
            if along:
                own = self.behind[j, i, :3] if self.layer[j, i] == FAR else self.signed(i, j)
                total += weight * np.append(own, F(1))
        return total

    def without_near(self, x, y):
        rgb = encode_color(np.nan_to_num(self.shown["color"][y, x, :3].astype(F), nan=0))
        if not self.warped[y, x]:
            return rgb, False
        px_source, z = np.array([x, y], F) + F(0.5) + self.shown["motion"][y, x], self.shown["depth"][y, x]
        if not any(self.layer[j, i] == FAR for i, j, *_ in self.taps(x, y, px_source, z)):
            return rgb, False
        total = self.far_layer(x, y, px_source, z)
        return (total[:3] / total[3], True) if total[3] > F(0.05) else (rgb, False)

    def far_color(self, x, y, far):
        """Return the color of the far layer. `far`: (x, y, dx, dy) of the pixels around that show it."""
        seen = np.zeros(4, F)
        if far[0] != (x, y, 0, 0):
            place = np.mean([self.place(*g) for g in far], 0, dtype=F)
            seen = self.far_layer(x, y, place, max(self.shown["depth"][v, u] for u, v, *_ in far))
            if seen[3] > F(0.99):
                return seen[:3] / seen[3]
        beside = np.mean([self.without_near(u, v)[0] for u, v, *_ in far], 0, dtype=F)
        return seen[:3] + (F(1) - seen[3]) * beside

    def signed(self, i, j):
        rgb = np.nan_to_num(self.source[j, i, :3].astype(F), nan=0, posinf=np.inf, neginf=-np.inf)
        return np.clip(rgb, -COMMON.COLOR_MAX, COMMON.COLOR_MAX)

    def near_layer(self, x, y, px_source, z):
        total, weights = np.zeros(4, F), F(0)
        for i, j, weight, along, to_z in self.taps(x, y, px_source, z):
            if not along and 0 < to_z < z:
                continue
            weights += weight
            layer, behind, own = self.layer[j, i], self.behind[j, i], color_of(self.source[j, i])
            if along and layer != NEAR:
                total += weight * np.append(np.maximum(behind[:3], 0) if layer == FAR else own, F(1))
            elif along or layer == FAR:
                share = np.maximum(own - (F(1) - behind[3]) * behind[:3], 0)
                total += weight * np.append(share, behind[3])
        if not weights > 0.5:
            return None
        coverage = np.clip(SHARPER * (total[3] / weights - F(0.5)) + F(0.5), F(0), F(1))
        return np.append(total[:3] * (coverage / total[3] if coverage > 0 else F(0)), coverage)

    def pair(self, x, y):
        """Return (place of the near layer, its depth, code of the far one)."""
        height, width = self.warped.shape
        groups = [
            [(x + dx, y + dy, dx, dy) for dx, dy in group if 0 <= x + dx < width and 0 <= y + dy < height]
            for group in OWN_BESIDE_CORNERS
        ]
        groups = [[g for g in group if self.filled[g[1], g[0]]] for group in groups]
        depth = self.shown["depth"]
        middle = halfway([depth[v, u] for group in groups for u, v, *_ in group])
        if not self.filled[y, x] or middle is None:
            return None
        near, far = [], []
        for group in groups:
            sides = [(g, depth[g[1], g[0]] < middle) for g in group]
            near = near or [g for g, is_near in sides if is_near and self.warped[g[1], g[0]]]
            far = far or [g for g, is_near in sides if not is_near]
        if not near or not far:
            return None
        near_px, far_px = (np.mean([self.place(*g) for g in side], 0, dtype=F) for side in (near, far))
        if not np.abs(near_px - far_px).max() > MOVES_APART:
            return None
        return near_px, np.mean([depth[v, u] for u, v, *_ in near], dtype=F), self.far_color(x, y, far)

    def place(self, u, v, dx, dy):
        back = (F(1) / self.zoom) * np.array([dx, dy], F)
        return np.array([u, v], F) + F(0.5) + self.shown["motion"][v, u] - back
