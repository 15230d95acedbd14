"""Breaks good sequences in every way alone and in pairs, lets the doctor repair them, and writes how often it did.

    python docs/tools/measure_doctor.py --write                     all cases: doctor.md and measured/doctor.json
    python docs/tools/measure_doctor.py --cases 20 --sequence DIR   20 cases drawn by chance, on a sequence of one's own

A case is repaired if the motion vectors are those of the good sequence to 0.1 px at 95% of the pixels, and depth with
cameras move static points as the good ones do, to 0.1 px at 95% of the pixels: sets of faults with the same effect
count as equal. Built-in scenes, 240×136, 12 rendered frames; none of them was used while the doctor was built. In some
the camera mostly stands still. Each record is stored at once: an interrupted run continues.
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from itertools import combinations, zip_longest
from pathlib import Path

import numpy as np
from pages import MEASURED, table, with_all, write_tables

from gffe_cl.captures.doctor.choosing import fixed_by, selected
from gffe_cl.captures.doctor.diagnose import examine
from gffe_cl.captures.doctor.repair import Repair, static_motion
from gffe_cl.captures.scenes import SceneFrames, SceneRenderer, load_scene
from gffe_cl.captures.sequence import open_sequence
from gffe_cl.lab.fault_injection import BREAKS, GAPS, HARMLESS, Kept, broken

RECORD = MEASURED / "doctor.json"
SCENES = [(name, seed) for name in ("gallery", "street", "factory", "courtyard") for seed in (5, 6)]
RESTING = [("street", 5), ("gallery", 6)]  # sequences whose camera mostly stands still
RESTS = (0, 0, 0, 0, 1, 2, 2, 2, 3, 4, 4, 4)  # for each frame: the one whose camera it has
SIZE, FRAMES, FPS = (240, 136), 12, 30.0
NEAR_ENOUGH, SHARE = 0.1, 0.95  # pixels, of the pixels
_DRAWN = 11  # seed of the order of cases
_APART = (  # faults of which no two make a case: they cancel, or one undoes the other
    {"motion to the next frame", "motion one frame late", "motion jitter not removed", "motion without the camera"},
    {"motion in UV", "motion in NDC"},
    {"motion twice", "motion half"},
    {"depth reversed", "depth device", "depth along rays", "depth range misread"},
    {"color rows", "depth rows", "motion rows", "all rows"},
    {"depth in centimeters", "camera in centimeters"},
    {"frame dropped", "two frames swapped"},
)
_ALONE = {"motion zero", "color tone-mapped"}  # these remove information that cannot be restored


def cases() -> list[tuple[str, ...]]:
    """Return harmless changes, faults alone, and pairs of faults; alone first."""
    names = [name for name in (*BREAKS, *GAPS) if name not in _ALONE]
    pairs = [pair for pair in combinations(names, 2) if not any(set(pair) <= apart for apart in _APART)]
    return [(name,) for name in (*HARMLESS, *BREAKS, *GAPS)] + pairs


class Resting(SceneFrames):
    """Frames of a scene whose camera moves only now and then: `RESTS`."""

    def display_camera(self, time: float):
        return super().display_camera(RESTS[min(round(time * FPS), FRAMES - 1)] / FPS)


def render(name: str, seed: int, made_by: type[SceneFrames] = SceneFrames) -> Kept:
    from gffe_cl.engine.opencl.device import open_device

    renderer = SceneRenderer(open_device(None), load_scene(name, seed), *SIZE, samples=4)
    source = made_by(renderer)
    frames = list(source.sequence(FRAMES, FPS))
    forward = []
    for frame in frames:
        later = frame.time + 1 / FPS
        image = renderer.render(frame.time, frame.camera, later, source.display_camera(later))
        forward.append(image.read("motion"))
    return Kept(frames, renderer.scene.exposure, FPS, forward)


def measure(good: Kept, names: tuple[str, ...]) -> dict:
    """Return the doctor's findings on `good` with the faults `names`, and whether its fix restores the buffers."""
    bad = broken(good, list(names))
    diagnosis = examine(bad, bad.exposure)
    chosen = selected(diagnosis, fixed_by(diagnosis))  # display values as well
    repaired = [frame for _, frame in Repair(bad, chosen).frames()]
    truth = {frame.time: frame for frame in good.images}
    motion, static = restored(repaired, [truth[frame.time] for frame in repaired])
    share = static if "motion zero" in names else min(motion, static)  # motion of movers is lost
    color = all(_same_color(frame, truth[frame.time]) for frame in repaired)
    return {
        "faults": list(names),
        "named": [f"{f.about}: {f.name}" for f in diagnosis.faults],
        "notes": [f"{f.about}: {f.name}" for f in diagnosis.findings if f.kind != "fault"],
        "restored": round(share, 4),
        "repaired": bool(share >= SHARE and color),
        "margin": round(diagnosis.best.total - diagnosis.given.total, 3),
    }


def restored(repaired: list, good: list) -> tuple[float, float]:
    """Return the shares of pixels whose motion vectors, and whose static reprojections, are those of the good frames,
    in frames that are no resets."""
    motion, static = [], []
    for (a, a_before), (b, b_before) in zip(
        zip(repaired[1:], repaired, strict=False), zip(good[1:], good, strict=False), strict=True
    ):
        if a.reset:
            continue
        moved = np.linalg.norm(np.subtract(a.motion, b.motion, dtype=np.float64), axis=-1)
        motion.append((moved[np.isfinite(b.motion).all(-1)] < NEAR_ENOUGH).mean())
        apart = np.linalg.norm(static_motion(a, a_before.camera) - static_motion(b, b_before.camera), axis=-1)
        static.append((apart < NEAR_ENOUGH).mean())
    return float(np.mean(motion)), float(np.mean(static))


def _same_color(a, b) -> bool:
    good = np.asarray(b.color, np.float32)
    shown = (good < 1).all(-1)
    return (
        bool(np.quantile(np.abs(np.asarray(a.color, np.float32) - good)[shown], 0.99) < 0.01) if shown.any() else True
    )


def drawn(sequence: str, wanted: list) -> list:
    """Return all cases in an order of chance that is another one for every sequence; alone and pairs by turns."""
    rng = np.random.default_rng([*sequence.encode(), _DRAWN])
    alone, pairs = ([names for names in wanted if (len(names) > 1) == paired] for paired in (False, True))
    rng.shuffle(alone)
    rng.shuffle(pairs)
    turns = [names for both in zip_longest(alone, pairs[: len(alone)]) for names in both if names]
    return [tuple(names) for names in turns + pairs[len(alone) :]]


def run(sequences: dict, wanted: list, most: int | None, record: Path | None) -> list[dict]:
    done = json.loads(record.read_text())["cases"] if record and record.exists() else []
    known = {(c["sequence"], tuple(c["faults"])) for c in done}
    chosen = [(name, names) for name in sequences for names in drawn(name, wanted)[:most] if (name, names) not in known]
    loaded: dict = {}
    for name, faults in chosen:
        if name not in loaded:
            loaded = {name: sequences[name]()}
        case = {"sequence": name} | measure(loaded[name], faults)
        done.append(case)
        verdict = "ok  " if is_right(case) else "FAIL"
        named = ", ".join(case["named"]) or "intact"
        print(f"{verdict} {name}: {' + '.join(faults)} → {named} ({case['restored']:.1%})", flush=True)
        if record:
            record.write_text(json.dumps({"cases": done}, indent=0) + "\n")
    return done


def is_right(case: dict) -> bool:
    """Return whether harmless changes raised no alarm and faults were repaired. Zero vectors must also be reported:
    static points get correct ones even if nothing is found. So must dropped frames, by a
    note where the camera rests."""
    if "frame dropped" in case["faults"] and not {"frames: gap", "frames: late"} & {*case["named"], *case["notes"]}:
        return False
    if "motion zero" in case["faults"] and "motion: zero" not in case["named"]:
        return False
    return not case["named"] if case["faults"][0] in HARMLESS else case["repaired"]


def tables(done: list[dict]) -> dict[str, str]:
    """Return the tables of the page, by name."""
    groups = {
        "intact": [c for c in done if c["faults"][0] in HARMLESS],
        "alone": [c for c in done if len(c["faults"]) == 1 and c["faults"][0] not in HARMLESS],
        "pairs": [c for c in done if len(c["faults"]) == 2],
    }
    rows = []
    for name, group in groups.items():
        right = sum(map(is_right, group))
        words = {"intact": "intact: no alarm", "alone": "one fault: repaired", "pairs": "two faults: repaired"}[name]
        rows.append((words, str(len(group)), f"{right / len(group):.1%}" if group else "–"))
    confusion = _confusion(groups["intact"] + groups["alone"], groups["pairs"])
    return {"summary": table(("", "cases", "right"), rows), "confusion": confusion}


def _confusion(single: list[dict], pairs: list[dict]) -> str:
    named: dict = defaultdict(lambda: defaultdict(int))
    repaired: dict = defaultdict(list)
    in_pairs: dict = defaultdict(list)
    for case in single:
        named[case["faults"][0]][" + ".join(case["named"]) or "nothing"] += 1
        repaired[case["faults"][0]].append(is_right(case))
    for case in pairs:
        for fault in case["faults"]:
            in_pairs[fault].append(case["repaired"])
    rows = []
    for fault in (*HARMLESS, *BREAKS, *GAPS):
        if fault in named:
            words = "; ".join(f"{text} ({n})" for text, n in sorted(named[fault].items(), key=lambda item: -item[1]))
            paired = f"{sum(in_pairs[fault])} of {len(in_pairs[fault])}" if in_pairs[fault] else "–"
            rows.append((fault, words, f"{sum(repaired[fault])} of {len(repaired[fault])}", paired))
    return table(("broken by", "the doctor names", "right", "in pairs"), rows)


def with_tables(page: str) -> str:
    return with_all(page, tables(json.loads(RECORD.read_text())["cases"]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sequence", type=Path, action="append", default=[], help="instead of the built-in scenes")
    parser.add_argument("--cases", type=int, help="of each sequence, drawn by chance")
    parser.add_argument("--scene", action="append", default=[], help="only this of the built-in ones, as gallery-1")
    parser.add_argument("--only", help="cases with this fault")
    parser.add_argument("--write", action="store_true", help="keep records, and write the page")
    parser.add_argument("--record", type=Path, default=RECORD)
    given = parser.parse_args()
    sequences = {p.name: lambda p=p: Kept.of(open_sequence(p)) for p in given.sequence} or {
        f"{name}-{seed}": lambda name=name, seed=seed: render(name, seed)
        for name, seed in SCENES
        if not given.scene or f"{name}-{seed}" in given.scene
    } | {
        f"{name}-{seed}-resting": lambda name=name, seed=seed: render(name, seed, Resting)
        for name, seed in RESTING
        if not given.scene or f"{name}-{seed}-resting" in given.scene
    }
    wanted = [names for names in cases() if not given.only or any(given.only in name for name in names)]
    done = run(sequences, wanted, given.cases, given.record if given.write else None)
    print(tables(done)["summary"])
    if given.write and given.record == RECORD:
        write_tables("doctor.md", tables(done))


if __name__ == "__main__":
    main()
