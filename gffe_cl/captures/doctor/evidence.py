"""Samples that can be evidence: vectors that were never written are set aside, and buffers without usable samples are
faults."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from gffe_cl.captures.doctor.findings import FAULT, Finding, finding
from gffe_cl.captures.doctor.hypotheses.sampling import PREVIOUS, Look

FEWEST = 16  # usable samples in all frames
_LEAST_DEPTH, _LEAST_MOTION = 0.002, 0.1  # shares of the samples: a picture may show little but sky
_SHARED, _LEADS_OUT = 0.01, 0.5  # shares of samples with one vector, and of those that it leads out of the image
_LEAST_NORMAL = np.finfo(np.float32).smallest_normal
_BITS = 0x30000000, 0x7F800000  # those of 32-bit floats from 5e-10 to infinity
_TRIED = 8  # vectors that many samples share
_MOST_NAMED = 6  # frames


def set_aside_unwritten(looks: Iterable[Look]) -> list[Finding]:
    """Make vectors that were never written NaN in `looks`, and return notes about them: vectors as long as the
    diagonal of the image, and one vector that many samples share although it leads out of the image. Vectors of resets
    lead nowhere and are left alone."""
    looks = [look for look in looks if look.motion is not None and not look.reset]
    if not looks:
        return []
    found = _long_vectors(looks)
    shared = _shared_vector(looks)
    if shared is not None:
        share = float(np.mean([_set_aside(look, lambda motion: (motion == shared).all(-1)) for look in looks]))
        found.append(_unwritten(share, "have one and the same value, which leads out of the image", shared))
    return found


def _long_vectors(looks: list[Look]) -> list[Finding]:
    long = np.concatenate([_motion(look)[look.is_long(_motion(look))] for look in looks])
    share = float(np.mean([look.bad.long / np.prod(look.size) for look in looks]))
    for look in looks:
        _set_aside(look, look.is_long)
    if not share:
        return []
    return [_unwritten(share, "are longer than the image's diagonal", _most_common(long, 0.5 * len(long)))]


def _unwritten(share: float, what: str, value: np.ndarray | None) -> Finding:
    """Return the note about vectors that were never written. `value`: that of most of them, in pixels."""
    percent = f"{share:.0%}" if share >= 0.01 else f"{100 * share:.1g}%"
    one = "" if value is None else f" ({value[0]:.6g}, {value[1]:.6g} px)"
    figures = {"share": share, "value": None if value is None else value.tolist()}
    return finding("motion: never written", figures, share=percent, what=what, value=one)


def _set_aside(look: Look, unwritten) -> float:
    """Make samples of `look` NaN where `unwritten` is true for their vectors. Return the share of them."""
    share = 0.0
    for values in (look.motion, look.mirrored.get("motion")):
        if values is not None:
            wrong = unwritten(values)
            values[wrong] = np.nan
            share = share or float(wrong.mean())
    return share


def _shared_vector(looks: list[Look]) -> np.ndarray | None:
    """Return the vector (2,) of many samples that leads many of them out of the image."""
    vectors = np.concatenate([_motion(look) for look in looks])
    px = np.concatenate([look.px for look in looks])
    size = np.concatenate([np.broadcast_to(look.size, look.px.shape) for look in looks])
    usable = np.isfinite(vectors).all(-1) & vectors.any(-1)
    values, counts = np.unique(vectors[usable], axis=0, return_counts=True)
    fewest = max(FEWEST, _SHARED * len(vectors))
    for k in np.argsort(-counts)[:_TRIED]:
        if counts[k] < fewest:
            break
        same = (vectors == values[k]).all(-1)
        to = px[same] + values[k]
        if ((to < 0) | (to > size[same])).any(-1).mean() >= _LEADS_OUT:
            return values[k]
    return None


def _most_common(vectors: np.ndarray, fewest: float) -> np.ndarray | None:
    """Return the value that at least so many of `vectors` (N, 2) have."""
    values, counts = np.unique(vectors, axis=0, return_counts=True)
    return values[counts.argmax()] if len(counts) and counts.max() >= max(fewest, 1) else None


def too_few_usable(looks: Iterable[Look]) -> list[Finding]:
    """Return a fault for each buffer of `looks` that has too few usable values to compare anything, and a note where
    this holds for some frames only."""
    looks = list(looks)
    moving = [look for look in looks if PREVIOUS in look.neighbors and look.motion is not None]
    found = _few("color", looks, _usable_color, _why_no_color, "", 0.0)
    depth = _few("depth", moving or looks, _usable_depth, _why_no_depth, "surface", _LEAST_DEPTH)
    motion = _few("motion", moving, _usable_motion, _why_no_motion, "vector", _LEAST_MOTION)
    if any(one.kind == FAULT for one in depth):  # vectors of sky are compared with nothing anyway
        return found + depth
    return found + depth + motion


def _few(about: str, looks: list[Look], usable, why, what: str, least: float) -> list[Finding]:
    shares = np.array([np.mean(usable(look)) if len(look.px) else 0.0 for look in looks])
    total = sum(len(look.px) for look in looks)
    count = sum(share * len(look.px) for share, look in zip(shares, looks, strict=True))
    if not looks:
        return []
    empty = [look.file for look, share in zip(looks, shares, strict=True) if share == 0]
    if not count or count < min(FEWEST, 0.5 * total) or count < least * total:
        number = "no pixel has" if not count else f"only {count / total:.1%} of the pixels have"
        return [finding(f"{about}: nothing usable", {"usable": count / total}, pixels=number, why=why(looks))]
    if empty and what:
        files = ", ".join(empty[:_MOST_NAMED]) + (", …" if len(empty) > _MOST_NAMED else "")
        return [finding(f"{about}: nothing usable in some frames", {"files": empty}, files=files)]
    return []


def _usable_color(look: Look) -> np.ndarray:
    return np.full(len(look.px), look.bad.color < np.prod(look.size))


def _usable_depth(look: Look) -> np.ndarray:
    return look.solid & (np.abs(look.depth) >= _LEAST_NORMAL)


def _usable_motion(look: Look) -> np.ndarray:
    surface = _usable_depth(look)
    usable = np.asarray(np.isfinite(_motion(look)).all(-1))
    return usable[surface] if surface.any() else np.ones(1, bool)


def _motion(look: Look) -> np.ndarray:
    assert look.motion is not None  # the caller chose these
    return look.motion


def _why_no_color(looks: list[Look]) -> str:
    return "all are NaN or infinite"


def _why_no_depth(looks: list[Look]) -> str:
    depth = np.concatenate([look.depth for look in looks])
    if np.mean((depth > _BITS[0]) & (depth <= _BITS[1])) > 0.5:
        return "the numbers are the bits of 32-bit floats, read as integers"
    nothing, zero = np.isnan(depth), depth == 0
    tiny = ~zero & (np.abs(depth) < _LEAST_NORMAL)
    sky = ~(nothing | zero | tiny) & ~np.concatenate([look.solid for look in looks])
    return _shares({"NaN": nothing, "zero": zero, "denormal": tiny, "sky": sky})


def _why_no_motion(looks: list[Look]) -> str:
    bad = np.sum([(look.bad.motion, look.bad.long) for look in looks], 0) / sum(np.prod(look.size) for look in looks)
    rest = float(np.mean([np.isnan(_motion(look)).any(-1).mean() for look in looks])) - bad.sum()
    named = {"NaN or infinite": bad[0], "longer than the image's diagonal": bad[1], "one value that leads out": rest}
    return ", ".join(f"{share:.0%} are {name}" for name, share in named.items() if share > 0.005)


def _shares(kinds: dict[str, np.ndarray]) -> str:
    named = [(name, float(where.mean())) for name, where in kinds.items() if where.any()]
    if len(named) == 1:
        return f"all are {named[0][0]}"
    return ", ".join(f"{share:.0%} are {name}" for name, share in named)
