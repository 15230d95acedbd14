"""Compare the quality of new frames with recorded values: eight scenes, small, by region.

    python docs/tools/quality.py              prints how many dB better each is; exit code 1 where a mean is worse
    python docs/tools/quality.py --write      records the values in docs/measured/quality.json

`make quality` runs it after a change of kernels. Figures are those of `gffe eval`, the same on all devices.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from pages import MEASURED, recorded, table

RECORD = MEASURED / "quality.json"
METHODS = "gffe", "no-scn"
EVAL = ("eval", "--methods", ",".join(METHODS), "--size", "240x136", "--frames", "8")
WORSE = 0.01  # dB of a mean that are no noise


def measured() -> dict[str, dict[str, dict[str, float]]]:
    """Return PSNR in dB by method, scene and region."""
    found: dict[str, dict[str, dict[str, float]]] = {method: {} for method in METHODS}
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-m", "gffe_cl", *EVAL, "--out", folder], check=True, stdout=subprocess.DEVNULL)
        for cell in json.loads((Path(folder) / "results.json").read_text("utf-8"))["cells"]:
            values = {"whole": cell["psnr"]} | {name: part["psnr"] for name, part in cell["regions"].items()}
            found[cell["method"]][cell["sequence"].partition(":")[0]] = {
                name: round(value, 3) for name, value in values.items() if value is not None
            }
    return found


def gains(now: dict, before: dict) -> dict[str, dict[str, float]]:
    """Return dB by which each region of each scene, and their means, are better than before."""
    found = {
        scene: {name: value - before[scene][name] for name, value in values.items() if name in before[scene]}
        for scene, values in now.items()
    }
    regions = dict.fromkeys(name for values in found.values() for name in values)
    each = {name: [values[name] for values in found.values() if name in values] for name in regions}
    return found | {"mean": {name: sum(values) / len(values) for name, values in each.items()}}


def main() -> int:
    now = measured()
    if "--write" in sys.argv[1:]:
        RECORD.write_text(json.dumps(now, indent=1) + "\n", "utf-8")
        return 0
    is_worse = False
    for method, before in recorded("quality").items():
        found = gains(now[method], before)
        regions = list(found["mean"])
        rows = [
            (scene, *(f"{values[name]:+.2f}" if name in values else "" for name in regions))
            for scene, values in found.items()
        ]
        print(f"{method}, dB better than recorded\n{table(('', *regions), rows)}\n")
        is_worse |= min(found["mean"].values()) < -WORSE
    print("worse than recorded" if is_worse else "as good as recorded, or better")
    return int(is_worse)


if __name__ == "__main__":
    sys.exit(main())
