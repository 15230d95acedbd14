"""The doctor's report for people: text, and one HTML file with the pictures that are its evidence."""

from __future__ import annotations

import base64
from datetime import date
from html import escape
from importlib.metadata import version
from io import BytesIO

import numpy as np

from gffe_cl.captures.doctor.choosing import fixed_by
from gffe_cl.captures.doctor.diagnose import Diagnosis
from gffe_cl.captures.doctor.hypotheses.cameras import CAMERA_AS_GIVEN
from gffe_cl.captures.doctor.hypotheses.depths import AS_GIVEN, rays
from gffe_cl.captures.doctor.hypotheses.sampling import PREVIOUS, Clip, Look
from gffe_cl.captures.doctor.repair import Repair, static_motion
from gffe_cl.captures.report_style import heat, report_style
from gffe_cl.engine.frame.rendered_frame import RenderedFrame

_MOST_WIDTH = 960  # pixels of a picture
_STYLE = """main { max-width: 1800px; }
table { width: 100%; }
.words { text-align: left; } td.words { white-space: normal; } td { vertical-align: top; }
.fault, .warning, .note, .unknown { font-weight: 600; }
.fault { color: light-dark(#c4342a, #ff7b6b); }
.warning, .note { color: light-dark(#9a6700, #e0a63a); } .unknown { color: var(--blue); }
.pictures { display: grid; gap: 16px; grid-template-columns: repeat(auto-fit, minmax(min(420px, 100%), 1fr)); }
"""


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


def html_report(clip: Clip, diagnosis: Diagnosis, title: str, exposure: float) -> str:
    """Return one self-contained page: the findings, how well everything fits, and residuals of one frame as given and
    as repaired."""
    lines = "".join(f"<p>{escape(line)}</p>" for line in summary(diagnosis))
    made_by = f"gffe check, gffe-cl {version('gffe-cl')}, {date.today().isoformat()}"
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{report_style()}{_STYLE}</style></head><body><main>"
        f"<h1>{escape(title)}</h1><p>{made_by}</p>"
        f"<h2>Findings</h2>{_findings(diagnosis)}<h2>Fit</h2>{lines}{_pictures(clip, diagnosis, exposure)}"
        "</main></body></html>\n"
    )


def _findings(diagnosis: Diagnosis) -> str:
    if not diagnosis.findings and diagnosis.compared:
        return "<p>None: motion vectors, depth and cameras fit together.</p>"
    rows = "".join(
        f'<tr><td><span class="{"unknown" if f.kind == "cannot tell" else f.kind.split()[-1]}">{f.kind}</span></td>'
        f'<td class="words">{escape(str(f))}</td><td class="words">{escape(f.fix) or "–"}</td></tr>'
        for f in diagnosis.findings
    )
    heads = '<th>kind</th><th class="words">finding</th><th class="words">repair by gffe check --fix</th>'
    return f'<div class="scroll"><table><thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table></div>'


def _pictures(clip: Clip, diagnosis: Diagnosis, exposure: float) -> str:
    looks = [look for look in diagnosis.looks if PREVIOUS in look.neighbors]
    if not looks:
        return ""
    entries = clip.rendered
    index = looks[len(looks) // 2].index
    before, here = (clip.read(entries[k]) for k in (index - 1, index))
    repaired = _repaired_pair(clip, diagnosis, entries[index].file)
    given = _residual(here, before)
    read = _residual(*repaired) if repaired else given
    top = max(float(np.nanquantile(given, 0.98)), 1e-3)
    figures = [
        (
            "color, display values",
            np.clip(np.nan_to_num(here.color[..., :3].astype(np.float32)) * exposure, 0, 1) ** (1 / 2.2),
        ),
        (f"residual as given, pixels: 0 (black) to {top:.3g} (white)", heat(given / top)),
    ]
    if repaired and diagnosis.faults:
        figures.append((f"residual repaired, pixels: 0 (black) to {top:.3g} (white)", heat(read / top)))
    made = "".join(
        f'<figure><img alt="" src="data:image/png;base64,{_png(image)}">'
        f"<figcaption>{escape(text)}</figcaption></figure>"
        for text, image in figures
    )
    fine = (
        "The residual is the distance between a motion vector and the motion that depth and cameras give a static"
        " point. Moving objects stay bright."
    )
    return f'<h2>{escape(entries[index].file)}</h2><p>{fine}</p><div class="pictures">{made}</div>'


def _repaired_pair(clip: Clip, diagnosis: Diagnosis, file: str) -> tuple[RenderedFrame, RenderedFrame] | None:
    before = None
    for entry, frame in Repair(clip, diagnosis).frames():
        if entry.file == file:
            return (frame, before) if before is not None else None
        before = frame
    return None


def _residual(frame: RenderedFrame, before: RenderedFrame) -> np.ndarray:
    """Return the residuals (H, W) in pixels."""
    if frame.motion is None:
        return np.zeros(frame.depth.shape)
    off = np.linalg.norm(frame.motion - static_motion(frame, before.camera), axis=-1)
    return np.nan_to_num(off, nan=0.0, posinf=1e6)


def _png(image: np.ndarray) -> str:
    from PIL import Image

    picture = Image.fromarray((np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8))
    picture.thumbnail((_MOST_WIDTH, _MOST_WIDTH))
    file = BytesIO()
    picture.save(file, "PNG")
    return base64.b64encode(file.getvalue()).decode("ascii")
