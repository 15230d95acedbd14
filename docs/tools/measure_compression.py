"""Cost of each compression of EXRs, on an extrapolated frame with all its channels.

    python docs/tools/measure_compression.py                    of plaza at 1920×1080, rendered for it
    python docs/tools/measure_compression.py --sequence SEQ     of a recorded sequence
    python docs/tools/measure_compression.py --write            puts the table into docs/sequences.md

Milliseconds are CPU time, the least of the repeats.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

from pages import table, write_tables

from gffe_cl.captures.offline.run import run_sequence
from gffe_cl.captures.offline.source import Recorded
from gffe_cl.captures.scenes import load_scene
from gffe_cl.captures.scenes.render import render_sequence
from gffe_cl.captures.sequence import open_sequence
from gffe_cl.captures.sequence.exr import COMPRESSIONS, codec_seconds, read_channels, write_channels
from gffe_cl.engine.opencl.device import open_device
from gffe_cl.engine.options import Options

NAMES = ("R", "G", "B", "Z", "motion.x", "motion.y", "mask.dynamic", "mask.disoccluded", "mask.filled_by")
SIZE, FRAMES, FPS = (1920, 1080), 10, 30.0


def compression_table(path: Path, folder: Path, repeats: int) -> str:
    """Return CPU milliseconds and MiB of the middle frame made of the sequence `path`, for each compression."""
    device = open_device()
    run_sequence(
        Recorded(open_sequence(path), device), folder / "result", device, Options(shading_correction=False), [0.5]
    )
    made = open_sequence(folder / "result")
    entry = made.extrapolated[len(made.extrapolated) // 2]
    channels = read_channels(made.path / entry.file, NAMES, entry.file)
    file, rows = folder / "frame.exr", []
    for name, sentence in COMPRESSIONS.items():
        write = least(lambda name=name: write_channels(file, channels, compression=name), repeats)
        read = least(lambda: read_channels(file, NAMES, file.name), repeats)
        size = os.path.getsize(file) / 2**20
        rows.append((f"`{name}`", f"{write:.0f}", f"{read:.0f}", f"{size:.1f}", sentence))
    return table(("`--compression`", "write, ms", "read, ms", "MiB", ""), rows)


def least(work: Callable[[], object], repeats: int) -> float:
    """Return CPU milliseconds of the EXR codec, the least of the repeats."""
    spent = []
    for _ in range(repeats):
        start = codec_seconds()
        work()
        spent.append(codec_seconds() - start)
    return min(spent) * 1e3


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sequence", type=Path)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--write", action="store_true", help="put the table into docs/sequences.md")
    setting = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder, path = Path(name), setting.sequence
        if path is None:
            path = folder / "plaza"
            render_sequence(load_scene("plaza"), path, open_device(), *SIZE, FRAMES, FPS)
        made = compression_table(path, folder, setting.repeats)
        print(made)
        if setting.write:
            write_tables("sequences.md", {"compressions": made})


if __name__ == "__main__":
    main()
