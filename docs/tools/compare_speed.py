"""Compare the times of two versions of gffe-cl for the same frames, in turns on one machine.

    python docs/tools/compare_speed.py                                       HEAD and this working tree, plaza, 1080p
    python docs/tools/compare_speed.py --scene plaza --scene forest --device pocl --repeats 10
    python docs/tools/compare_speed.py --scn                                 with the shading correction network
    python docs/tools/compare_speed.py --host --size 320x180                 processor time of the calling thread, for
                                                                             each way in which frames come
    python docs/tools/compare_speed.py --preset performance                  with the options of a preset
    python docs/tools/compare_speed.py --old COMMIT --new FOLDER             a commit or a checkout's folder each

Each version runs in a process of its own with its own modules and kernels, driven through the public `Pipeline`. Both
see the same buffers and take turns from frame to frame, so that other programs on the machine slow both. The wall time
runs from submitting a rendered frame to having the extrapolated one; stages are sums of kernel event times. Times are
medians. A ratio is the median of the ratios within a turn: a quotient of two least times favors the faster version on
a busy machine, since a short frame fits between the bursts of other programs and a long one does not. "CPU time" is the
whole process's, per core: where it is far below the wall time, the machine was busy.
"""

from __future__ import annotations

import argparse
import inspect
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pages import REPOSITORY, checkout

if TYPE_CHECKING:
    from gffe_cl.engine.timing.footage import FrameLoop, Turn

# Parts by the names that `take_timings` has, where they differ.
PARTS = {
    "shading_trend": "SCN, trend",
    "shading": "SCN, inputs",
    "network_input": "SCN, inputs",
    "shading_flow": "SCN, flow",
    "convolutions": "SCN, network",
    "correction": "SCN, kernels",
    "network": "SCN, network",
    "network copies": "SCN, network",
}
CLOCKS = ("wall time", "CPU time")
# Ways in which frames come: NumPy arrays, rings of so many sets of device buffers, and new buffers every time.
HOST = ("arrays", "ring of 2", "ring of 3", "new buffers")
# From these on a warning is printed: wall time : CPU time, the load before, the range of the middle half of ratios.
BUSY, LOAD, SPREAD = 1.15, 1.0, 0.05


# ---- one version, in a process of its own ------------------------------------------------------------------


def serve(footage: Path, device: str, scn: bool, host: str | None, preset: str | None) -> None:
    """Time the frames that standard input asks for, a line of JSON each. With `host`, one of HOST, the device is idle
    before each call, so that no call waits, and the calling thread's processor time is told, without those of
    stages."""
    replies = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # output of drivers
    import pyopencl as cl

    import gffe_cl as gffe  # the public names: modules have other places in other versions

    asks = {} if host or "profiling" not in inspect.signature(gffe.open_device).parameters else {"profiling": True}
    opened = gffe.open_device(device, **asks)
    about = json.loads((footage / "about.json").read_text())
    flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
    arrays = [[np.load(footage / f"{name}_{k}.npy") for name in about["arrays"]] for k in range(len(about["cameras"]))]

    def buffers(given: list[np.ndarray]) -> list:
        return [cl.Buffer(opened.context, flags, hostbuf=array) for array in given]

    frames = [buffers(given) for given in arrays]  # on the device
    ring = [buffers(arrays[0]) for _ in range(int(host.split()[-1]))] if host and host.startswith("ring") else []

    def came(index: int) -> list:
        """Return the arrays or buffers of a frame, in the way that `host` names."""
        if host == "arrays":
            return arrays[index]
        if host == "new buffers":
            return buffers(arrays[index])
        if not ring:
            return frames[index]
        ring.append(ring.pop(0))  # the one after the last
        for buffer, array in zip(ring[-1], arrays[index], strict=True):
            cl.enqueue_copy(opened.queue, buffer, array)
        return ring[-1]

    options = gffe.Options.preset(preset or "balanced", shading_correction=scn)
    pipeline = gffe.Pipeline(opened, about["width"], about["height"], options)
    pipeline.exposure = about["exposure"]

    def say(reply: dict) -> None:
        print(json.dumps(reply), file=replies, flush=True)

    say({"device": f"{opened.info.name} ({opened.info.platform})"})
    for line in sys.stdin:
        asked = json.loads(line)
        camera = gffe.Camera(**about["cameras"][asked["index"]])
        target = about["targets"][asked["index"]]
        frame = gffe.RenderedFrame(*came(asked["index"]), camera, asked["time"], reset=asked["reset"])
        seen_by = target and gffe.Camera(**target)
        opened.queue.finish()
        wall, cpu, calling = time.perf_counter(), time.process_time(), -time.thread_time()
        pipeline.submit(frame)
        calling += time.thread_time()
        if host:
            opened.queue.finish()
        calling -= time.thread_time()
        pipeline.extrapolate(seen_by, asked["until"])
        calling += time.thread_time()
        opened.queue.finish()
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        reply = {"stages": {} if host else pipeline.take_timings(), "wall": wall * 1e3, "cpu": cpu * 1e3}
        say(reply | ({"host": calling * 1e3} if host else {}))


class Version:
    """A checkout, and the process that runs it."""

    def __init__(self, folder: Path, *arguments: str):
        environment = dict(os.environ) | {"PYTHONPATH": str(folder), "GFFE_KERNELS": str(folder / "kernels")}
        command = [sys.executable, str(Path(__file__).resolve()), "--serve", *arguments]
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment, cwd=folder
        )
        self.device = self._heard()["device"]

    def timed(self, turn: Turn, footage: FrameLoop) -> dict[str, float]:
        """Return milliseconds by part, "GAE" and `CLOCKS` among them."""
        until = turn.time(footage.interval)
        asked = {"index": turn.index, "time": turn.frame.time, "reset": turn.frame.reset, "until": until}
        print(json.dumps(asked), file=self.process.stdin, flush=True)
        heard = self._heard()
        parts: dict[str, float] = defaultdict(float)
        for stage, milliseconds in heard["stages"].items():
            parts[PARTS.get(stage, stage)] += milliseconds
        scn = {name: parts.pop(name) for name in list(parts) if name.startswith("SCN")}
        own = {"SCN, inputs and kernels": sum(scn.get(f"SCN, {name}", 0.0) for name in ("inputs", "flow", "kernels"))}
        clocks = dict(zip(CLOCKS, (heard["wall"], heard["cpu"] / (os.cpu_count() or 1)), strict=True))
        host = {"host": heard["host"]} if "host" in heard else {}
        gae = {"GAE": sum(parts.values())} if parts else {}
        return parts | gae | (scn | own if scn else {}) | clocks | host

    def close(self) -> None:
        self.process.stdin.close()
        self.process.wait()

    def _heard(self) -> dict:
        line = self.process.stdout.readline()
        if not line:
            sys.exit(f"error: a version ended with {self.process.wait()}, see above")
        return json.loads(line)


# ---- both ----------------------------------------------------------------------------------------------------


def folder_of(version: str, folder: Path) -> Path:
    """Return the folder of a checkout: `version` itself if it is one, else that commit's files, put into `folder`."""
    if Path(version).is_dir():
        return Path(version).resolve()
    folder.mkdir()
    checkout(version, folder)
    return folder


def called(version: str) -> str:
    """Return the commit of a version."""
    folder, commit = (version, "HEAD") if Path(version).is_dir() else (str(REPOSITORY), version)
    told = subprocess.run(["git", "-C", folder, "rev-parse", "--short", commit], capture_output=True, text=True)
    return told.stdout.strip() or version


def store(footage: FrameLoop, folder: Path) -> None:
    """Put footage where both versions find it."""
    from gffe_cl.engine.frame.rendered_frame import host_arrays

    folder.mkdir()
    for k, frame in enumerate(footage.frames):
        host = host_arrays(frame).in_device_layout()
        for name in ("color", "depth", "motion"):
            np.save(folder / f"{name}_{k}.npy", getattr(host, name))

    def described(camera):
        if camera is None:
            return None
        intrinsics = dict(zip(("fx", "fy", "cx", "cy"), camera.intrinsics, strict=True))
        return {"world_to_view": camera.world_to_view.tolist()} | intrinsics

    about = {
        "width": footage.width,
        "height": footage.height,
        "exposure": footage.exposure,
        "arrays": ["color", "depth", "motion"],
        "cameras": [described(frame.camera) for frame in footage.frames],
        "targets": [described(camera) for camera in footage.cameras],
    }
    (folder / "about.json").write_text(json.dumps(about))


def compare(footage: FrameLoop, folder: Path, trees: list[Path], device: str, repeats: int, flags: list[str]) -> dict:
    """Return milliseconds of both versions by part, and the ratios old : new."""
    store(footage, folder)
    arguments = [str(folder), "--device", device, *flags]
    versions = [Version(tree, *arguments) for tree in trees]
    if versions[0].device != versions[1].device:
        sys.exit(
            f"error: the versions chose different devices: {versions[0].device}, {versions[1].device}; say --device"
        )
    turns: list[tuple[dict[str, float], dict[str, float]]] = []
    for k, turn in enumerate(footage.turns(repeats)):
        timed = {side: versions[side].timed(turn, footage) for side in ((0, 1) if k % 2 else (1, 0))}
        if turn.counts:
            turns.append((timed[0], timed[1]))
    for version in versions:
        version.close()
    old, new = (
        {part: statistics.median(turn[side][part] for turn in turns) for part in turns[0][side]} for side in (0, 1)
    )
    shared = [part for part in old if old[part] and new.get(part)]
    ratios = {part: sorted(a[part] / max(b[part], 1e-6) for a, b in turns) for part in shared}
    ratio = {part: statistics.median(found) for part, found in ratios.items()}
    of_cpu = ratios[CLOCKS[1]]
    spread = (of_cpu[3 * len(of_cpu) // 4] - of_cpu[len(of_cpu) // 4]) / ratio[CLOCKS[1]]
    way = f", {flags[flags.index('--host') + 1]}" if "--host" in flags else ""
    named = {"of": footage.name + way, "width": footage.width, "height": footage.height, "device": versions[1].device}
    return named | {"old": old, "new": new, "ratio": ratio, "spread": spread}


def rounded(value):
    """Return the report without meaningless digits."""
    if isinstance(value, dict):
        return {key: rounded(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [rounded(inner) for inner in value]
    return round(value, 3) if isinstance(value, float) else value


def show(report: dict, load: float) -> None:
    old, new, ratio = (report[key] for key in ("old", "new", "ratio"))
    print(f"\n{report['of']}, {report['width']}×{report['height']}, {report['device']}")
    print(f"{'ms':26}{'old':>10}{'new':>10}{'ratio':>8}")
    for part in dict.fromkeys((*new, *old)):
        figures = (f"{side[part]:.2f}" if part in side else "" for side in (old, new, ratio))
        print("{:26}{:>10}{:>10}{:>8}".format(part, *figures), flush=True)
    wall, cpu = (new[clock] for clock in CLOCKS)
    waits = wall > BUSY * cpu and "SCN, network" not in new
    if waits or load > LOAD or report["spread"] > SPREAD:
        print(
            f"warning: too busy to tell: load {load:.1f} at the start, {wall:.1f} ms for {cpu:.1f} ms of CPU time,"
            f" half of the ratios differ by up to {report['spread']:.0%}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--old", default="HEAD", help="commit, or folder of a checkout")
    parser.add_argument("--new", default=str(REPOSITORY), help="the same; default: this working tree")
    parser.add_argument("--scene", action="append", default=[], help="a built-in scene; may be repeated")
    parser.add_argument("--size", default="1920x1080")
    parser.add_argument("--repeats", type=int, default=16, help="counted pairs of frames")
    parser.add_argument("--frame", type=int, help="which rendered frame; default: the bench's")
    parser.add_argument("--scn", action="store_true", help="with the shading correction network")
    parser.add_argument(
        "--host", nargs="?", const="all", choices=("all", *HOST), help="processor time of the calling thread alone"
    )
    parser.add_argument("--preset", help="balanced (the default), quality or performance")
    parser.add_argument("--device", action="append", help="intel, pocl, …; may be repeated; default: the best one")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--serve", type=Path, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.serve:
        serve(asked.serve, asked.device[0], asked.scn, asked.host, asked.preset)
        return

    from gffe_cl.engine.opencl.device import open_device
    from gffe_cl.lab.bench import SCENE, loop_of

    width, height = (int(n) for n in asked.size.split("x"))
    reports, load = [], os.getloadavg()[0]
    with tempfile.TemporaryDirectory(prefix="compare_speed_") as temporary:
        folder = Path(temporary)
        trees = [folder_of(asked.old, folder / "old"), folder_of(asked.new, folder / "new")]
        subjects = asked.scene or [SCENE]
        for number, (subject, name) in enumerate((s, d) for s in subjects for d in asked.device or [None]):
            device = open_device(name)
            footage = loop_of(device, subject, (width, height), asked.frame)
            place = folder / f"footage_{number}"
            flags = ["--scn"] * asked.scn + (["--preset", asked.preset] if asked.preset else [])
            for way in HOST if asked.host == "all" else [asked.host]:
                more = ["--host", way] if way else []
                reports.append(compare(footage, place, trees, device.info.index, asked.repeats, flags + more))
                show(reports[-1], load)
                shutil.rmtree(place)
    if asked.json:
        document = {"old": called(asked.old), "new": called(asked.new), "of": reports}
        asked.json.write_text(json.dumps(rounded(document), indent=1) + "\n")


if __name__ == "__main__":
    main()
