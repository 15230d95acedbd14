"""Compares shading correction networks on built-in scenes: PSNR and SSIM of extrapolated frames against the truth.

    python docs/tools/compare_networks.py OLD.onnx NEW.onnx …

`package` stands for the package's own network as the CPU runs it. Scenes are rendered at 480×270 with 8 frames, seed 0.
Figures are those of `gffe run` and `gffe compare`. The first network's are printed whole, of the others what they have
more or less.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

SCENES = ("corridor", "courtyard", "factory", "fan", "gallery", "shadows", "street")


def gffe(*arguments: object) -> None:
    subprocess.run([sys.executable, "-m", "gffe_cl", *map(str, arguments)], check=True, stdout=subprocess.DEVNULL)


def measured(sequence: Path, network: str, folder: Path) -> tuple[float, float]:
    out, report = Path(tempfile.mkdtemp(dir=folder)) / "out", folder / "report.json"
    chosen = () if network == "package" else ("--scn-model", network)
    gffe("run", sequence, out, *chosen)
    gffe("compare", out, sequence, "--json", report)
    mean = json.loads(report.read_text())["mean"]
    return mean["psnr"], mean["ssim"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("networks", nargs="+", help="ONNX files, or package")
    parser.add_argument("--sequence", action="append", default=[], help="with ground truth, besides the scenes")
    asked = parser.parse_args()
    print("| | " + " | ".join(asked.networks) + " |\n| --- |" + " --- |" * len(asked.networks))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for scene in (*SCENES, *asked.sequence):
            sequence = Path(scene)
            if scene in SCENES:
                sequence = folder / scene
                gffe("render", scene, sequence, "--frames", 8, "--size", "480x270", "--ground-truth")
            first, *others = (measured(sequence, network, folder) for network in asked.networks)
            cells = [f"{first[0]:.3f}, {first[1]:.4f}"]
            cells += [f"{psnr - first[0]:+.3f}, {ssim - first[1]:+.4f}" for psnr, ssim in others]
            print(f"| {sequence.name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
