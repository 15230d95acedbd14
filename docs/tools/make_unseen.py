"""Make the unseen sequences, which no constant was chosen on, and measure gffe-cl on them.

    python docs/tools/make_unseen.py OUT                     all of them; NAME …: only these
    python docs/tools/make_unseen.py --measure OUT --json docs/measured/unseen.json --label after
    python docs/make_results.py                              the table in docs/results.md

The two `panda_` sequences need Panda3D (`pip install gffe-cl[examples]`), the others OpenGL 3.3; a software renderer will do.
Never tune anything on these sequences: they are there to judge what was tuned elsewhere.
"""

from __future__ import annotations

import argparse
import importlib
import json
import subprocess
import sys
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
sys.path.insert(0, str(FOLDER))

from unseen.recording import record  # noqa: E402

# Name → module and class of its generator.
SEQUENCES = {
    "panda_environment": ("unseen.panda_environment", "PandaEnvironment"),
    "panda_city": ("unseen.panda_city", "PandaCity"),
    "cockpit": ("unseen.cockpit", "Cockpit"),
    "raymarched": ("unseen.raymarched", "Raymarched"),
}
METHODS = ("repeat", "motion-vectors", "papers-way", "no-scn", "gffe")


def make(out: Path, names: list[str]) -> None:
    """Write the sequences `names` into folders below `out`, each in a process of its own."""
    for name in names:
        module, kind = SEQUENCES[name]
        generator = getattr(importlib.import_module(module), kind)()
        record(generator, out / name, lambda done, g=generator, n=name: print(f"{n}: {done} of {g.frames}", flush=True))
        generator.close()


def measure(out: Path, record_path: Path, label: str) -> None:
    """Add what `gffe eval` measures on the sequences in `out` to the record, as `label`."""
    from gffe_cl.core.files import write_text  # noqa: F401
    folders = [out / name for name in SEQUENCES if (out / name).is_dir()]
    report = out / "report"
    command = [sys.executable, "-m", "gffe_cl", "eval", *map(str, folders), "--methods", ",".join(METHODS)]
    subprocess.run([*command, "--out", str(report)], check=True)
    results = json.loads((report / "results.json").read_text("utf-8"))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, metavar="OUT", help="folder of the sequences")
    parser.add_argument("names", nargs="*", metavar="NAME", choices=[*SEQUENCES, []], help="default: all")
    given = parser.parse_args()
    make(given.out, given.names or list(SEQUENCES))


if __name__ == "__main__":
    main()
