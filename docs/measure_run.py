"""What `gffe run` takes from disk to disk, beside what it cannot do without; and what each compression of EXRs costs.

    python docs/measure_run.py                    on plaza at 1920×1080, rendered for it
    python docs/measure_run.py --sequence SEQ     on a recorded sequence

The ratio is the wall time of the run to kernels + network + (CPU time of the EXR codec ÷ cores): with its start, in
which pipeline and kernels are made while the first frames are read, and without. Kernels and network are measured
without the codec beside them, which would slow them down: the same frames, from memory. Runs and measurements take
turns; of each the least counts.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from make_tables import between_markers

from gffe_cl.frame.rendered_frame import pack_frame
from gffe_cl.opencl.device import open_device
from gffe_cl.pipeline.options import Options
from gffe_cl.pipeline.pipeline import Pipeline
from gffe_cl.sequence import Sequence, open_sequence
from gffe_cl.sequence.exr import COMPRESSIONS, codec_seconds, read_channels, write_channels
from gffe_cl.sequence.read_ahead import usable_cores

KINDS = {"GAE": ["--no-scn"], "GAE and SCN": []}


def gffe(*arguments: object) -> float:
    """Run a command; seconds from its start to its end."""
    start = time.perf_counter()
    subprocess.run([sys.executable, "-m", "gffe_cl", *map(str, arguments)], check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - start


def least(figures: list[dict[str, float]]) -> dict[str, float]:
    return {name: min(figure[name] for figure in figures) for name in figures[0]}


def run_from_disk(sequence: Path, folder: Path, arguments: list[str]) -> dict[str, float]:
    report = folder / "report.json"
    process = gffe("run", sequence, folder / "result", *arguments, "--json", report)
    seconds = json.loads(report.read_text())["seconds"]
    names = {"start": "start", "wall": "wall", "codec": "codec_cpu"}
    return {"process": process} | {name: seconds[key] for name, key in names.items()}


def run_from_memory(sequence: Sequence, pipeline: Pipeline, frames: list) -> dict[str, float]:
    """Seconds in kernels and in the network."""
    totals: dict[str, float] = {}
    for frame, packed in frames:
        pipeline.submit(frame, packed)
        pipeline.extrapolate()
        for name, milliseconds in pipeline.take_timings().items():
            totals[name] = totals.get(name, 0.0) + milliseconds * 1e-3
    network = totals.pop("network", 0.0) + totals.pop("network copies", 0.0)
    return {"kernels": sum(totals.values()), "network": network}


def runs_table(path: Path, folder: Path, repeats: int) -> str:
    sequence, device, cores = open_sequence(path), open_device(), usable_cores()
    frames = []
    for entry in sequence.rendered:
        frame = sequence.read(entry)
        frames.append((frame, pack_frame(frame, *np.shape(frame.depth))))
    lines = [
        f"{len(frames)} frames of {sequence.width}×{sequence.height}, {device.info.name}, {device.info.platform},"
        f" {cores} cores; seconds\n",
        "| | wall | start | kernels | network | EXR codec, CPU | ratio | without start | whole process |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for kind, arguments in KINDS.items():
        options = Options(shading_correction=not arguments)
        pipeline = Pipeline(device, sequence.width, sequence.height, options, fps=sequence.fps)
        disk, memory = [], []
        for _ in range(repeats):
            disk.append(run_from_disk(path, folder, arguments))
            memory.append(run_from_memory(sequence, pipeline, frames))
        run, alone = least(disk), least(memory)
        needed = alone["kernels"] + alone["network"] + run["codec"] / cores
        ratios = run["wall"] / needed, (run["wall"] - run["start"]) / needed
        figures = (run["wall"], run["start"], alone["kernels"], alone["network"], run["codec"], *ratios, run["process"])
        lines.append(f"| {kind} | " + " | ".join(f"{figure:.2f}" for figure in figures) + " |")
    return "\n".join(lines)


def start_table(folder: Path, repeats: int) -> str:
    """The start of a command: a run of one tiny frame does little else."""
    tiny = folder / "tiny"
    gffe("render", "plaza", tiny, "--size", "64x36", "--frames", 1)
    commands = {
        "--help": ["--help"],
        "devices": ["devices"],
        "devices --refresh": ["devices", "--refresh"],
        "run, one frame of 64×36": ["run", tiny, folder / "tiny_result"],
        "the same, --no-scn": ["run", tiny, folder / "tiny_result", "--no-scn"],
    }
    lines = ["| `gffe` … | seconds |", "| --- | --- |"]
    for name, arguments in commands.items():
        lines.append(f"| {name} | {min(gffe(*arguments) for _ in range(repeats)):.2f} |")
    return "\n".join(lines)


def compression_table(path: Path, folder: Path, repeats: int) -> str:
    """Of an extrapolated frame: CPU milliseconds and MiB for each compression."""
    gffe("run", path, folder / "result", "--no-scn")
    made = open_sequence(folder / "result")
    entry = made.extrapolated[len(made.extrapolated) // 2]
    names = ("R", "G", "B", "Z", "motion.x", "motion.y", "mask.dynamic", "mask.disoccluded", "mask.filled_by")
    channels = read_channels(made.path / entry.file, names, entry.file)
    lines = ["| `--compression` | write, ms | read, ms | MiB | |", "| --- | --- | --- | --- | --- |"]
    file = folder / "frame.exr"
    for name, sentence in COMPRESSIONS.items():
        spent: dict[str, list[float]] = {"write": [], "read": []}
        for _ in range(repeats):
            for kind, work in (
                ("write", lambda name=name: write_channels(file, channels, compression=name)),
                ("read", lambda: read_channels(file, names, file.name)),
            ):
                start = codec_seconds()
                work()
                spent[kind].append(codec_seconds() - start)
        size = os.path.getsize(file) / 2**20
        write, read = (min(spent[kind]) * 1e3 for kind in ("write", "read"))
        lines.append(f"| `{name}` | {write:.0f} | {read:.0f} | {size:.1f} | {sentence} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sequence", type=Path)
    parser.add_argument("--frames", type=int, default=10, help="that are rendered where no sequence is given")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--write", action="store_true", help="the compressions into docs/sequences.md")
    setting = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder, path = Path(name), setting.sequence
        if path is None:
            path = folder / "plaza"
            gffe("render", "plaza", path, "--size", "1920x1080", "--frames", setting.frames)
        print(start_table(folder, setting.repeats), flush=True)
        made = compression_table(path, folder, setting.repeats)
        print(f"\n{made}\n", flush=True)
        if setting.write:
            page = Path(__file__).parent / "sequences.md"
            page.write_text(between_markers(page.read_text(), "compressions", made))
        print(runs_table(path, folder, setting.repeats))


if __name__ == "__main__":
    main()
