"""The doctor's report: text for people, and JSON for programs."""

from __future__ import annotations

import numpy as np

from gffe_cl.captures.doctor.choosing import fixed_by
from gffe_cl.captures.doctor.diagnose import Diagnosis
from gffe_cl.captures.doctor.hypotheses.cameras import CAMERA_AS_GIVEN
from gffe_cl.captures.doctor.hypotheses.depths import AS_GIVEN, rays
from gffe_cl.captures.doctor.hypotheses.sampling import PREVIOUS, Look


def summary(diagnosis: Diagnosis) -> list[str]:
    """Return sentences on how well the sequence fits as given and as read, and how sure that is."""
    r = diagnosis.residuals
    if not r:
        return []

    def fit(name: str) -> str:
        return f"median residual {r[f'{name}_median']:.3g} px, {r[f'{name}_inliers']:.0%} of the samples agree"

    if not diagnosis.faults:
        return [f"motion vectors, depth and cameras as given: {fit('given')}"]
    lines = [f"as given: {fit('given')}", f"repaired: {fit('read')}"]
    if diagnosis.best and diagnosis.given and diagnosis.best.reading != diagnosis.given.reading:
        lines.append(f"score {diagnosis.best.total:.2f}, {diagnosis.given.total:.2f} as given{_next_best(diagnosis)}")
    return lines


def _next_best(diagnosis: Diagnosis) -> str:
    other = diagnosis.runner_up
    if other is None:
        return ""
    parts = [*other.reading.motion.parts, *other.reading.camera.parts, other.reading.depth.model.name + " depth"]
    return f", {other.total:.2f} the next best ({', '.join(parts)})"


def changes(chosen: Diagnosis) -> list[str]:
    """Return the changes that repairing `chosen` makes: a line for each finding, and one for each buffer with an
    example."""
    known = set(fixed_by(chosen))
    lines = [f"{f.id}: {f.fix}" for f in chosen.findings if f.id in known]
    looks = [look for look in chosen.looks if PREVIOUS in look.neighbors]
    return list(dict.fromkeys(lines)) + (_example(chosen, looks[len(looks) // 2]) if looks else [])


def _example(chosen: Diagnosis, look: Look) -> list[str]:
    """Return an example in words: one sample of `look`, before → after; nothing if it does not change."""
    reading, lines = chosen.reading, []
    camera = reading.camera.read(look.camera)
    inverse = reading.depth.inverse(look.depth, rays(camera, look.px))
    motion = None if reading.motion.adds_camera else reading.motion.pixels(look)
    length = np.full(len(look.px), -1.0) if motion is None else np.nan_to_num(np.linalg.norm(motion, axis=-1))
    k = int(np.where(look.solid & (inverse > 0), length, -2).argmax())
    x, y = look.px[k]
    stored = reading.motion.stored(look)
    if motion is not None and stored is not None and reading.motion.parts:
        lines.append(f"motion vector {_numbers(stored[k])} → {_numbers(motion[k])} px")
    if reading.depth != AS_GIVEN:
        lines.append(f"depth {look.depth[k]:.4g} → {1 / inverse[k]:.4g}")
    if reading.camera != CAMERA_AS_GIVEN:
        for name, value in (
            ("position", lambda c: c.position),
            ("forward", lambda c: c.world_to_view[2, :3]),
            ("down", lambda c: c.world_to_view[1, :3]),
            ("focal length", lambda c: [c.fx]),
        ):
            before, after = _numbers(value(look.camera)), _numbers(value(camera))
            lines += [f"camera's {name} {before} → {after}"] if before != after else []
    return [f"for example {look.file} at {x:g}, {y:g}: {'; '.join(lines)}"] if lines else []


def _numbers(values) -> str:
    return "(" + ", ".join(f"{value + 0.0:.4g}" for value in values) + ")"


def as_json(diagnosis: Diagnosis) -> dict:
    """Return all results for programs."""
    return {
        "verdict": diagnosis.verdict,
        "findings": [
            {
                "id": f.id,
                "kind": f.kind,
                "about": f.about,
                "name": f.name,
                "sentence": f.sentence,
                "fix": f.fix,
                "change": f.change,
                "figures": f.figures,
            }
            for f in diagnosis.findings
        ],
        "residuals": diagnosis.residuals,
        "scores": {
            name: vars(verdict) | {"reading": None, "total": verdict.total}
            for name, verdict in (("given", diagnosis.given), ("read", diagnosis.best), ("next", diagnosis.runner_up))
            if verdict is not None
        },
        "order": diagnosis.order.order if diagnosis.order else None,
        "frames": diagnosis.frames,
    }
