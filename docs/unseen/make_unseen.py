"""Make the unseen sequences, which no constant was chosen on, and measure gffe-cl on them.

    python docs/unseen/make_unseen.py OUT                     all of them, 5 to 10 minutes; NAME …: only these
    python docs/unseen/make_unseen.py --measure OUT --json docs/measured/unseen.json --label after; NAME …: only these
    python docs/tools/make_results.py                        the table in docs/results.md

The `panda_` sequences need Panda3D (the extra `examples`). All need OpenGL 3.3; a software renderer will do.
Never tune anything on these sequences: they are there to judge what was tuned elsewhere.
"""

from __future__ import annotations

import argparse
import importlib
import json
import subprocess
import sys
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(REPOSITORY / "docs"))
from unseen.recording import record  # noqa: E402

# Name → module and class of its generator.
SEQUENCES = {
    "panda_environment": ("unseen.panda_environment", "PandaEnvironment"),
    "panda_city": ("unseen.panda_city", "PandaCity"),
    "panda_live": ("unseen.panda_live", "PandaLive"),
    "panda_live_antialiased": ("unseen.panda_live", "PandaLiveAntialiased"),
    "cockpit": ("unseen.cockpit", "Cockpit"),
    "raymarched": ("unseen.raymarched", "Raymarched"),
    "aquarium": ("unseen.aquarium", "Aquarium"),
    "fairground": ("unseen.fairground", "Fairground"),
}
METHODS = ("repeat", "motion-vectors", "papers-way", "no-scn", "gffe")
FIGURES = ("psnr", "ssim", "flip")


def make(out: Path, name: str) -> None:
    """Render one sequence into the folder `out`/`name`."""
    module, generator_class = SEQUENCES[name]
    generator = getattr(importlib.import_module(module), generator_class)()
    record(generator, out / name, lambda done: print(f"{name}: {done} of {generator.frames}", flush=True))
    generator.close()


def measure(out: Path, names: list[str], path: Path, label: str) -> None:
    """Run `gffe eval` on the sequences `names` in `out`; put their figures of `label` into the record at `path`."""
    folders = [str(out / name) for name in names]
    report = out / "report"
    command = [sys.executable, "-m", "gffe_cl", "eval", *folders, "--methods", ",".join(METHODS), "--out", str(report)]
    subprocess.run(command, check=True)
    results = json.loads((report / "results.json").read_text("utf-8"))
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=REPOSITORY, check=True, capture_output=True, text=True
    )
    about = {"commit": commit.stdout.strip()} | {key: results[key] for key in ("date", "machine")}
    sequences = [{key: one[key] for key in ("name", "size", "moments")} | about for one in results["sequences"]]
    cells = [{key: cell[key] for key in ("sequence", "method", *FIGURES)} for cell in results["cells"]]
    entries = {one["label"]: one for one in (json.loads(path.read_text("utf-8")) if path.exists() else [])}
    before = entries.pop(label, {"sequences": [], "cells": []})
    sequences += [one for one in before["sequences"] if one["name"] not in names]
    cells += [cell for cell in before["cells"] if cell["sequence"] not in names]
    order = list(SEQUENCES)
    entries[label] = {
        "label": label,
        "methods": results["methods"],
        "sequences": sorted(sequences, key=lambda one: order.index(one["name"])),
        "cells": sorted(cells, key=lambda cell: order.index(cell["sequence"])),
    }
    path.write_text(json.dumps([*entries.values()], indent=1, ensure_ascii=False) + "\n", "utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, metavar="OUT", help="folder of the sequences")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"{', '.join(SEQUENCES)} (default: all)")
    parser.add_argument("--measure", action="store_true", help="measure the sequences in OUT instead of making them")
    parser.add_argument("--json", type=Path, help="file for the figures")
    parser.add_argument("--label", default="now", help="name of the figures, such as before or after (default: now)")
    given = parser.parse_intermixed_args()
    if unknown := [name for name in given.names if name not in SEQUENCES]:
        parser.error(f"{unknown[0]}: no such sequence (expected {', '.join(SEQUENCES)})")
    if given.measure:
        if given.json is None:
            parser.error("--measure needs --json FILE")
        measure(given.out, given.names or list(SEQUENCES), given.json, given.label)
    elif len(given.names) == 1:
        make(given.out, given.names[0])
    else:
        for name in given.names or SEQUENCES:  # a process each: Panda3D and moderngl share no process
            subprocess.run([sys.executable, __file__, str(given.out), name], check=True)


if __name__ == "__main__":
    main()
