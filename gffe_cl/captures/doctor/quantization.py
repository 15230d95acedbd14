"""Detection of the precision with which buffers were stored: steps of motion vectors, half-float depth, 8-bit color."""

from __future__ import annotations

import numpy as np

from gffe_cl.captures.doctor.findings import Finding, finding
from gffe_cl.captures.doctor.hypotheses.sampling import Look
from gffe_cl.engine.frame.transfer_function import to_display

_FINEST, _COARSEST = 1 / 64, 64.0  # pixels: steps that are looked for
_SAME_VALUE = 1 / 1024  # pixels
_FEWEST = 64  # least number of samples
_REPEATED = 4  # samples for each value, in the mean
_RARE = 1 / 500  # of the samples: values that may be those of another encoding
_OFF_GRID = 0.06  # of a step, and the share of samples that may be
_SIZES = ((1920, 1080), (1280, 720), (2560, 1440), (3840, 2160))
_CODES = {  # steps where not negative and where negative, in units of the image's sides
    "half floats of 0.5 + 0.5 · uv": (2.0**-10, 2.0**-11),
    "half floats of 0.5 − 0.5 · uv": (2.0**-11, 2.0**-10),
    "16 bits of 0.5 + 0.5 · uv": (2 / 65535, 2 / 65535),
}
_CODE_SLACK = 0.02
_MOST_ONCE = 0.2  # share of errors between half a step and a whole one, of vectors that were rounded once
_CLASSES = "x", "negative x", "y", "negative y"


def motion_steps(looks: list[Look]) -> np.ndarray:
    """Return the quantization steps (4,) of stored vectors, pixels: in x for positive values, in x for negative ones,
    and the same for y; NaN if not quantized or with too few samples."""
    motion = _motion(looks)
    motion = motion[np.isfinite(motion).all(-1)]
    return np.array([_step(of[side]) for of in motion.T for side in (of >= 0, of < 0)])


def largest_step(steps: np.ndarray) -> float:
    """Return the largest step in pixels, 0 where nothing is quantized. Where nothing is known of a sign, twice the
    other's step is assumed, which half floats may have, else twice that of the other component."""
    pairs = steps.reshape(2, 2)
    known = np.where(np.isfinite(pairs), pairs, 2 * pairs[:, ::-1])
    return float(np.nanmax(np.where(np.isfinite(known), known, 2 * known[::-1]), initial=0.0))


def _motion(looks: list[Look]) -> np.ndarray:
    return np.concatenate([look.motion for look in looks if look.motion is not None] or [np.zeros((0, 2))])


def _step(values: np.ndarray) -> float:
    """Return the grid step of values (N,) in pixels, for any offset; NaN if there is none."""
    distinct, counts = np.unique(np.round(values / _SAME_VALUE), return_counts=True)
    if len(values) < max(_FEWEST, _REPEATED * len(distinct)):
        return np.nan
    common = distinct[counts > _RARE * len(values)] * _SAME_VALUE
    if len(common) < 3:
        return np.nan
    step = float(np.diff(common).min())
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


def motion_finding(steps: np.ndarray, looks: list[Look], added: bool) -> Finding:
    """Return the note on vectors quantized in `steps`. `added`: they are sums of two."""
    told = [f"{step:.3g} px ({name})" for name, step in zip(_CLASSES, steps, strict=True) if np.isfinite(step)]
    alike = np.ptp(steps[np.isfinite(steps)]) <= _CODE_SLACK * np.nanmax(steps)
    grid = f"{_fraction(np.nanmedian(steps))} px" if alike else ", ".join(told)
    motion = _motion(looks)
    distinct = [len(np.unique(motion[:, c])) for c in (0, 1)]
    code = _code(steps, looks[0].size)
    figures = {name: float(step) for name, step in zip(_CLASSES, steps, strict=True) if np.isfinite(step)}
    figures |= {"distinct_x": distinct[0], "distinct_y": distinct[1], "code": code, "added": added}
    words = {"code": f", as of {code}" if code else "", "added": ", and sums of two" if added else ""}
    return finding("motion: quantized", figures, grid=grid, x=distinct[0], y=distinct[1], **words)


def _fraction(step: float) -> str:
    parts = round(1 / step) if step < 1 else 0
    return f"1/{parts}" if parts and abs(step * parts - 1) < _CODE_SLACK else f"{step:.3g}"


def _code(steps: np.ndarray, size: tuple[int, int]) -> str:
    """Return the encoding that has such steps, with its size, in words; "" if none is known."""
    for sides in (size, *_SIZES):
        for name, units in _CODES.items():
            expected = np.outer(sides, units).ravel()
            known = np.isfinite(steps)
            if known.sum() > 1 and (np.abs(steps / expected - 1)[known] < _CODE_SLACK).all():
                return f"{name} at {sides[0]}×{sides[1]}"
    return ""


def are_sums(motion: np.ndarray, static: np.ndarray, steps: np.ndarray) -> bool:
    """Return whether the errors of vectors (N, 2) against static motion (N, 2) are those of sums of two quantized
    ones."""
    half = 0.5 * np.where(motion < 0, steps[1::2], steps[::2])
    with np.errstate(invalid="ignore"):
        off = np.nanmax(np.abs(motion - static) / half, axis=-1, initial=0)
    return bool((off > 1.1).mean() - (off > 2.2).mean() > _MOST_ONCE)


def precision_notes(looks: list[Look], exposure: float) -> list[Finding]:
    """Return notes on depth of half floats and colors of 8 bits, also such that are read as linear ones."""
    found = []
    depth = np.concatenate([look.depth for look in looks])
    depth = depth[np.isfinite(depth) & (depth > 0)]
    with np.errstate(over="ignore"):
        exact = depth.astype(np.float16) == depth
    if len(np.unique(depth)) >= _FEWEST and exact.all():
        found.append(finding("depth: half floats"))
    colors = np.concatenate([look.image[::4, ::4].reshape(-1) for look in looks if look.image is not None] or [[]])
    if _are_codes(to_display(colors, exposure)):
        found.append(finding("color: 8 bits"))
    elif _are_codes(colors):
        found.append(finding("color: 8 bits linear"))
    return found


def _are_codes(colors: np.ndarray) -> bool:
    """Return whether values (N,) are multiples of 1/255."""
    codes = 255 * colors.astype(np.float32)
    codes = codes[(codes > 0.5) & (codes < 254.5)]
    off = np.abs(codes - np.round(codes))
    return len(codes) > 0 and len(np.unique(np.round(codes))) >= 16 and bool((off < 0.1).mean() > 0.99)
