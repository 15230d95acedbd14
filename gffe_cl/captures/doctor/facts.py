"""First pass: facts of single frames, which no comparison with cameras is needed for."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from gffe_cl.captures.doctor.findings import (
    FAULT,
    ColorUpsideDown,
    Dilated,
    DisplayValues,
    FewBits,
    Finding,
    InvalidPixels,
    NeverWritten,
    NothingUsable,
    Quantized,
    RepeatedPixels,
)
from gffe_cl.captures.doctor.readings import PREVIOUS, Look, encoded
from gffe_cl.captures.sequence.encoding import nearest_motion
from gffe_cl.engine.frame.frame_format import FrameFormat, conversion
from gffe_cl.engine.frame.rendered_frame import BadPixels, RenderedFrame
from gffe_cl.engine.frame.transfer_function import linear_values, to_display
from gffe_cl.engine.opencl.program import constants

LEADS_OUT = "the others are NaN, or lead out of the image"
FEWEST = 16  # usable samples in all frames
_LEAST_DEPTH, _LEAST_MOTION = 0.002, 0.1  # shares of the samples: a picture may show little but sky
_SHARED, _LEADS_OUT, _TRIED = 0.01, 0.5, 8  # samples with one vector, that lead out; vectors that are looked at
_LEAST_NORMAL = np.finfo(np.float32).smallest_normal
_FINEST, _COARSEST, _SAME_VALUE = 1 / 64, 64.0, 1 / 1024  # pixels: steps of vectors, and equal ones
_VALUES, _REPEATED, _RARE, _OFF_GRID = 64, 4, 1 / 500, 0.06  # samples; for each value; shares of samples and of a step
_RATIOS, _LINES, _DIFFER = (4.0, 3.0, 2.0, 1.5), 8, 0.25  # pixels of color for one of geometry; lines, and their share
_C = {name: np.float32(value) for name, value in constants("upload.cl").items()}
_OF_NEAR, _APART, _REACH = 0.25, 1.0, 2  # of two surfaces' vectors; pixels between these; from which dilation is away
_BESIDE, _DILATED = 50, 0.7  # pixels beside edges, and the share of them with the nearer surface's vector
_STEP, _EDGES, _LINES_OF, _SILENT = 5, 150, 200_000, 0.08  # of depths at an edge; edges; pixels; agreement by chance
_CONTRAST, _FLAT, _TELLING, _MIXTURE, _TIGHT = 0.08, 0.15, 0.03, 0.25, 0.06  # of the two sides of a silhouette
_CLEAR, _MIXED, _ENCODED = 50, 0.25, 0.75  # silhouettes, and the shares of mixtures and of those that mix sRGB values
_ALIKE, _HUES = 25, 3  # silhouettes of one hue that count, at most; steps of hues


def facts_of_samples(looks: list[Look], format: FrameFormat) -> list[Finding]:
    """Make vectors that were never written NaN in `looks`, or 0 if they are most, and return findings about these,
    about invalid pixels, and about buffers with too few usable values. `format`: that the looks were converted from."""
    return [*_invalid(looks), *_set_aside_unwritten(looks, format), *_too_few_usable(looks)]


def _invalid(looks: list[Look]) -> list[Finding]:
    total, first = BadPixels(), {}
    for look in looks:
        total = total + look.bad
        for name, (x, y) in look.first_bad.items():
            first.setdefault(name, (look.file, look.index, x, y))
    total.long = 0  # these have a note of their own
    first.pop("long", None)
    return [InvalidPixels(total, first)] if total else []


def _set_aside_unwritten(looks: list[Look], format: FrameFormat) -> list[Finding]:
    """Set vectors aside that were never written, and return findings of them: as long as the diagonal of the image, or
    shared by many samples and leading out of it. Vectors of resets lead nowhere and are left alone."""
    looks = [look for look in looks if look.motion is not None and not look.reset]
    if not looks:
        return []
    vectors = np.concatenate([_vectors(look) for look in looks])
    px = np.concatenate([look.px for look in looks])
    size = np.concatenate([np.broadcast_to(look.size, look.px.shape) for look in looks])
    with np.errstate(over="ignore", invalid="ignore"):
        long = np.square(vectors).sum(-1) >= np.square(size).sum(-1)
        leads_out = ((px + vectors < 0) | (px + vectors > size)).any(-1)
    usable = np.isfinite(vectors).all(-1) & vectors.any(-1) & ~long
    shared = np.zeros(len(vectors), bool)
    values, counts = np.unique(vectors[usable], axis=0, return_counts=True)
    for k in np.argsort(-counts)[:_TRIED]:
        same = np.all(vectors == values[k], -1)
        if counts[k] >= max(FEWEST, _SHARED * len(vectors)) and np.mean(leads_out, where=same) >= _LEADS_OUT:
            shared = same
            break
    unwritten, at = long | shared, 0
    share = float(np.mean(shared)) + float(np.mean([look.bad.long / np.prod(look.size) for look in looks]))
    made = NeverWritten(min(share, 1.0), _stored_value(vectors[unwritten], looks[0].size, format))
    for look in looks:
        _vectors(look)[unwritten[at : at + len(look.px)]] = 0.0 if made.is_most else np.nan
        at += len(look.px)
    return [made] if share else []


def _stored_value(vectors: np.ndarray, size: tuple[int, int], format: FrameFormat) -> float | None:
    """Return the number that both components of all `vectors` (N, 2), in pixels, have in `format`; None if they
    differ."""
    types = {"color": None, "depth": "float32", "motion": "float32"}
    *factors, x, y = conversion(format, size, types, {"color": 3, "motion": 2})["given_motion"]
    exact = (factors, x, y) == ([1.0, 1.0], 0.0, 0.0)
    values = np.unique((vectors - (x, y)) / factors)
    if not len(values) or np.ptp(values) > (0 if exact else 1e-5 * (1 + abs(values[0]))):
        return None
    return float(values[0]) if exact else float(f"{values[0]:.5g}") if abs(values[0]) > 1e-5 else 0.0


def _vectors(look: Look) -> np.ndarray:
    assert look.motion is not None  # the caller chose these
    return look.motion


def _too_few_usable(looks: list[Look]) -> list[Finding]:
    moving = [look for look in looks if PREVIOUS in look.neighbors and look.motion is not None]
    found = []
    for buffer, chosen, least in (
        ("color", looks, 0.0),
        ("depth", moving or looks, _LEAST_DEPTH),
        ("motion", moving, _LEAST_MOTION),
    ):
        usable = np.concatenate([_usable(look, buffer) for look in chosen] or [np.ones(1, bool)])
        if usable.sum() < max(min(FEWEST, 0.5 * len(usable)), least * len(usable)) or not usable.any():
            found.append(NothingUsable(buffer, float(usable.mean()), _why(chosen, buffer)))
        if buffer == "depth" and any(one.kind == FAULT for one in found):
            break  # vectors of sky are compared with nothing anyway
    return found


def _usable(look: Look, buffer: str) -> np.ndarray:
    surface = look.solid & (np.abs(look.depth) >= _LEAST_NORMAL)
    if buffer == "color":
        return np.full(len(look.px), look.bad.color < np.prod(look.size))
    if buffer == "depth":
        return surface
    known = np.all(np.isfinite(_vectors(look)), -1)
    return known[surface] if surface.any() else np.ones(0, bool)


def _why(looks: list[Look], buffer: str) -> str:
    if buffer == "color":
        return "all are NaN or infinite"
    if buffer == "motion":
        return LEADS_OUT
    depth = np.concatenate([look.depth for look in looks])
    kinds = {"NaN": np.isnan(depth), "zero": depth == 0, "sky": ~np.isnan(depth) & ~(np.abs(depth) < 1e9)}
    shares = {name: float(where.mean()) for name, where in kinds.items() if where.any()}
    return ", ".join(f"{share:.0%} are {name}" for name, share in shares.items()) or "the others are denormal"


# ---- precision -----------------------------------------------------------------------------------------


def quantization(looks: Iterable[Look], fewest: int = 3) -> float:
    """Return the step of quantized vectors in pixels, the largest one of their components and signs; 0 for others. A
    sign without enough samples counts as twice the other one, which half floats may have. `fewest`: distinct values
    that make a grid."""
    motion = np.concatenate([look.motion for look in looks if look.motion is not None] or [np.zeros((0, 2))])
    motion = motion[np.isfinite(motion).all(-1)]
    steps = np.array([[_grid_step(of[side], fewest) for side in (of >= 0, of < 0)] for of in motion.T])
    known = np.where(np.isfinite(steps), steps, 2 * steps[:, ::-1])
    return float(np.nanmax(np.where(np.isfinite(known), known, 2 * known[::-1]), initial=0.0))


def _grid_step(values: np.ndarray, fewest: int) -> float:
    """Return the grid step of values (N,) in pixels, for any offset; NaN if there is none."""
    distinct, counts = np.unique(np.round(values / _SAME_VALUE), return_counts=True)
    if len(values) < max(_VALUES, _REPEATED * len(distinct)):
        return np.nan
    common = distinct[counts > _RARE * len(values)] * _SAME_VALUE
    step = float(np.diff(common).min()) if len(common) >= fewest else 0.0
    if not _FINEST / 2 < step < _COARSEST:
        return np.nan
    offsets = values - common[0]
    for reach in (8, 64, np.inf):  # ever more exactly: multiples are far apart
        near = offsets[np.abs(offsets) <= reach * step]
        multiples = np.round(near / step)
        if multiples.any():
            step = float(near @ multiples / (multiples @ multiples))
    off_grid = np.abs(offsets / step - np.round(offsets / step)) > _OFF_GRID
    return step if off_grid.mean() <= _OFF_GRID and step >= _FINEST else np.nan


def precision(looks: list[Look], exposure: float, step: float) -> list[Finding]:
    """Return notes on quantized vectors, depth of half floats and colors of 8 bits."""
    found: list[Finding] = [Quantized(step)] if step else []
    depth = np.concatenate([look.depth for look in looks])
    depth = depth[np.isfinite(depth) & (depth > 0)]
    with np.errstate(over="ignore"):
        exact = depth.astype(np.float16) == depth
    if len(np.unique(depth)) >= _VALUES and exact.all():
        found.append(FewBits("depth"))
    colors = np.concatenate([look.image[::4, ::4].reshape(-1) for look in looks if look.image is not None] or [[]])
    if any(_are_codes(values) for values in (to_display(colors, exposure), colors)):
        found.append(FewBits("color"))
    return found


def _are_codes(colors: np.ndarray) -> bool:
    """Return whether values (N,) are multiples of 1/255."""
    codes = 255 * colors.astype(np.float32)
    codes = codes[(codes > 0.5) & (codes < 254.5)]
    off = np.abs(codes - np.round(codes))
    return len(codes) > 0 and len(np.unique(np.round(codes))) >= 16 and bool((off < 0.1).mean() > 0.99)


# ---- pixels that share a value -------------------------------------------------------------------------


def repeated_pixels(frames: list[RenderedFrame]) -> list[Finding]:
    """Return notes if the pixels of depth, or of motion vectors, are repeated in all of `frames`."""
    found: list[Finding] = []
    for buffer in ("depth", "motion"):
        sizes = {distinct_size(np.asarray(image)) for f in frames if (image := getattr(f, buffer)) is not None}
        size = sizes.pop() if len(sizes) == 1 else None
        found += [RepeatedPixels(buffer, *size)] if size else []
    return found


def distinct_size(image: np.ndarray) -> tuple[int, int] | None:
    """Return (width, height) of the smaller image whose pixels are repeated, evenly, in `image` (H, W[, C]); None if
    there is none."""
    bits = np.ascontiguousarray(image, np.float32).view(np.uint32).reshape(*image.shape[:2], -1)
    columns, rows = (bits[:, 1:] == bits[:, :-1]).all((0, 2)), (bits[1:] == bits[:-1]).all((1, 2))
    for ratio in _RATIOS:
        width, height = _distinct(columns, ratio), _distinct(rows, ratio)
        if width and height:
            return width, height
    return None


def _distinct(equal: np.ndarray, ratio: float) -> int:
    """Return how many lines there were before each was repeated `ratio` times; 0 if they were not. `equal` (N − 1,):
    whether a line is as the one before it."""
    source = (np.arange(len(equal) + 1) / ratio).astype(int)
    repeated = source[1:] == source[:-1]
    differ = np.count_nonzero(~equal & ~repeated)
    if not equal[repeated].all() or differ < max(_LINES, _DIFFER * np.count_nonzero(~repeated)):
        return 0
    return int(source[-1]) + 1


def dilation(frames: list[RenderedFrame]) -> list[Finding]:
    """Return a note if motion vectors of `frames`, in our conventions, are dilated."""
    counts = [count_beside_edges(np.asarray(f.depth), np.asarray(f.motion)) for f in frames if f.motion is not None]
    dilated, total = np.sum(counts, 0).tolist() if counts else (0, 0)
    return [Dilated(dilated / total)] if total >= _BESIDE and dilated >= _DILATED * total else []


def count_beside_edges(depth: np.ndarray, motion: np.ndarray) -> tuple[int, int]:
    """Return counts of pixels beside a nearer surface: those with its vector, and those with that or with the vector
    of their own surface `_REACH` pixels away, where the two differ. `depth` (H, W), `motion` (H, W, 2)."""
    height, width = depth.shape
    depth = np.asarray(depth, np.float32)
    around = nearest_motion(np.dstack([motion, depth]), depth)  # of the nearest of 3×3 pixels
    near_motion, nearest = around[..., :2], around[..., 2]
    with np.errstate(invalid="ignore"):
        beside = (depth > 0) & (nearest < _C["NEARER"] * depth)
        y, x = np.nonzero(beside)
        own, z, near = motion[y, x], depth[y, x], near_motion[y, x]
        dilated, total, undecided = 0, 0, np.ones(len(y), bool)
        for step_y, step_x in ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, 1), (1, -1), (-1, -1)):
            row, column = y + _REACH * step_y, x + _REACH * step_x
            use = undecided & (row >= 0) & (row < height) & (column >= 0) & (column < width)
            row, column = np.where(use, row, 0), np.where(use, column, 0)
            other, far = depth[row, column], motion[row, column]
            use &= np.where(np.isinf(z), np.isinf(other), np.abs(other - z) <= _C["SAME_SURFACE"] * z)
            apart = np.linalg.norm(far - near, axis=-1)
            use &= ~beside[row, column] & (apart > _APART)
            of_near = use & (np.linalg.norm(own - near, axis=-1) < _OF_NEAR * apart)
            of_far = use & (np.linalg.norm(own - far, axis=-1) < _OF_NEAR * apart)
            dilated, total = dilated + int(of_near.sum()), total + int((of_near | of_far).sum())
            undecided &= ~(of_near | of_far)
    return dilated, total


# ---- silhouettes: where depth jumps from one surface to another, colors change -------------------------


def silhouettes(depth: np.ndarray) -> np.ndarray:
    """Return (H, W − 4) bool: of every five pixels in a line, whether the first two and the last two show two surfaces,
    whatever the depth means."""
    first, second, _, fourth, fifth = (depth[:, k : depth.shape[1] - 4 + k] for k in range(5))
    along = np.maximum(np.abs(second - first), np.abs(fifth - fourth))
    apart = np.abs(fourth - second)
    return (apart > _STEP * along) & (apart > 1e-6 * np.abs(second + fourth))


def _lines_of(look: Look) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return (color, color upside down, depth) of lines across the image of `look`, and of lines down."""
    assert look.image is not None and look.deep is not None  # kept of the looks that are asked for
    image, deep = look.image, np.nan_to_num(look.deep, posinf=0.0, neginf=0.0)
    every = max(1, deep.size // _LINES_OF)
    across = image[::every], image[::-1][::every], deep[::every]
    down, down_turned, deep_down = (array[:, ::every].swapaxes(0, 1) for array in (image, image[::-1], deep))
    return [across, (down, down_turned, deep_down)]


def color_rows(looks: list[Look]) -> list[Finding]:
    """Return a fault if edges of color match silhouettes better when it is turned upside down."""
    found = []
    for look in looks:
        if look.image is None or min(look.size) < 8:
            continue
        changes, count = np.zeros(2), 0
        for *colors, depth in _lines_of(look):
            at = silhouettes(depth)
            count += int(at.sum())
            for k, color in enumerate(colors):
                before, after = (encoded(side[at], look.exposure) for side in (color[:, 1:-3], color[:, 3:-1]))
                changes[k] += np.abs(after - before).mean(-1).sum()
        if count >= _EDGES and changes.sum() > 0:
            found.append((changes[0] - changes[1]) / changes.sum())
    return [ColorUpsideDown()] if found and np.median(found) < -_SILENT else []


def display_values(looks: list[Look]) -> list[Finding]:
    """Return a fault if colors are display values: a pixel that a silhouette crosses mixes both surfaces with the same
    share in red, green and blue only if these are linear. Edges inside of surfaces do not count, as renderers may
    filter encoded textures. All edges of one hue of the nearer side count as a few: its rim may just have another
    shade."""
    hues, votes, counts = [], [], np.zeros(2, int)
    for look in looks:
        for color, _, depth in _lines_of(look):
            color = np.nan_to_num(np.asarray(color, np.float32))
            if color.max() > 1.001 or color.min() < 0:  # no display values
                return []
            hue, wrong, *count = _votes(color, depth)
            hues, votes, counts = [*hues, hue], [*votes, wrong], counts + count
    if not votes or counts[0] < _MIXED * counts[1]:
        return []
    _, group = np.unique(np.concatenate(hues), axis=0, return_inverse=True)
    total, wrong = np.bincount(group), np.bincount(group, np.concatenate(votes))
    telling = np.minimum(total, _ALIKE)
    share = float((wrong / total) @ telling / max(telling.sum(), 1))
    return [DisplayValues(share, int(telling.sum()))] if telling.sum() >= _CLEAR and share >= _ENCODED else []


def _votes(color: np.ndarray, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray, int, int]:
    """Return the vertical silhouettes one pixel wide between two flat sides that are evidence: hues (N, 3) of the
    nearer side and whether they fit sRGB values better than linear ones, (N,) bool. And counts: of those with a mixture
    of the sides, and of all."""
    at = silhouettes(depth)
    far_left, left, middle, right, far_right = (color[:, k : color.shape[1] - 4 + k][at] for k in range(5))
    contrast = np.abs(right - left)
    flat = np.maximum(np.abs(left - far_left), np.abs(right - far_right)) < _FLAT * contrast
    edge = ((contrast > _CONTRAST) & flat).all(-1)
    sides = left[edge], middle[edge], right[edge]
    given, decoded = _spread(*sides), _spread(*(linear_values(np.clip(one, 0, 1)) for one in sides))
    is_left = (depth[:, 1:-3] < depth[:, 3:-1])[at][edge]
    near = np.where(is_left[:, None], sides[0], sides[2])
    with np.errstate(invalid="ignore"):
        best = np.fmin(given, decoded)
        mixed, telling = best < _MIXTURE, (best < _TIGHT) & (np.abs(given - decoded) > _TELLING)
    hues = np.round(_HUES * near / np.maximum(near.max(-1, keepdims=True), 1e-6))
    return hues[telling], (decoded < given)[telling], int(mixed.sum()), int(edge.sum())


def _spread(a: np.ndarray, m: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return (N,) how much the shares of the channels (N, 3) differ; NaN where `m` is no mixture of `a` and `b`."""
    with np.errstate(all="ignore"):
        share = (m - a) / (b - a)
    inside = ((share > 0.1) & (share < 0.9)).all(-1)
    return np.where(inside, share.max(-1) - share.min(-1), np.nan)
