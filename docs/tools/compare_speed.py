"""How long two versions of gffe-cl take for the same frames, in turns on one machine.

    python docs/tools/compare_speed.py                                       61564f7 and this working tree, plaza, 1080p
    python docs/tools/compare_speed.py --scene plaza --scene forest --device pocl --repeats 10
    python docs/tools/compare_speed.py --sequence FOLDER                     a sequence, enlarged to --size
    python docs/tools/compare_speed.py --scn                                 with the shading correction network
    python docs/tools/compare_speed.py --old COMMIT --new FOLDER             a commit or a checkout's folder each

Each version runs in a process of its own with its own modules and kernels, driven through the public `Pipeline`; both
see the same buffers, and take turns from frame to frame, so that whatever else the machine does meets both. Times are
sums of kernel event times: for each frame of the footage the least (and the median) of the repeats, then the mean over
the frames. "CPU time" is the whole process's, per core: where other programs take the cores, it says more.
"""

from __future__ import annotations

import argparse
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

import numpy as np
from pages import REPOSITORY

OLD = "61564f7"
# What stages are called on either side: by when they work, and by the name that `take_timings` has.
PARTS = {
    ("rendered", "history"): "history",
    ("rendered", "warp"): "connectivity",
    ("rendered", "background"): "background, collection",
    ("extrapolated", "prediction"): "prediction",
    ("extrapolated", "warp"): "warp",
    ("extrapolated", "background"): "background, projection",
    ("extrapolated", "holes"): "holes",
    ("rendered", "shading_trend"): "SCN, trend",
    ("extrapolated", "shading_trend"): "SCN, trend",
    ("extrapolated", "shading"): "SCN, inputs",
    ("extrapolated", "network_input"): "SCN, inputs",
    ("extrapolated", "shading_flow"): "SCN, flow",
    ("extrapolated", "correction"): "SCN, kernels",
    ("extrapolated", "network"): "SCN, network",
    ("extrapolated", "network copies"): "SCN, network",
}
# Stages of older versions, and what they are called now.
RENAMED = {
    "surfaces": "connectivity",
    "blocks": "backward_blocks",
    "hidden": "hidden_parts",
    "trend": "shading_trend",
    "cuts": "scene_cuts",
}


# ---- one version, in a process of its own ------------------------------------------------------------------


def serve(footage: Path, device: str, scn: bool) -> None:
    """Time the frames that standard input asks for, a line of JSON each."""
    replies = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what drivers print
    import pyopencl as cl

    import gffe_cl as gffe  # the public names: modules have other places in other versions

    opened = gffe.open_device(device)
    about = json.loads((footage / "about.json").read_text())
    flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
    frames = [
        [cl.Buffer(opened.context, flags, hostbuf=np.load(footage / f"{name}_{k}.npy")) for name in about["arrays"]]
        for k in range(len(about["cameras"]))
    ]
    pipeline = gffe.Pipeline(opened, about["width"], about["height"], gffe.Options(shading_correction=scn))
    pipeline.exposure = about["exposure"]

    def say(reply: dict) -> None:
        print(json.dumps(reply), file=replies, flush=True)

    say({"device": f"{opened.info.name} ({opened.info.platform})"})
    for line in sys.stdin:
        asked = json.loads(line)
        camera = gffe.Camera(**about["cameras"][asked["index"]])
        target = about["targets"][asked["index"]]
        frame = gffe.RenderedFrame(*frames[asked["index"]], camera, asked["time"], reset=asked["reset"])
        wall, cpu = time.perf_counter(), time.process_time()
        pipeline.submit(frame)
        rendered = pipeline.take_timings()
        pipeline.extrapolate(target and gffe.Camera(**target), asked["until"])
        extrapolated = pipeline.take_timings()
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        say({"rendered": rendered, "extrapolated": extrapolated, "wall": wall * 1e3, "cpu": cpu * 1e3})


class Version:
    """A checkout, and the process that runs it."""

    def __init__(self, folder: Path, *arguments: str):
        environment = dict(os.environ) | {"PYTHONPATH": str(folder), "GFFE_KERNELS": str(folder / "kernels")}
        command = [sys.executable, str(Path(__file__).resolve()), "--serve", *arguments]
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment, cwd=folder
        )
        self.device = self._heard()["device"]

    def timed(self, asked: dict) -> dict[str, float]:
        """Milliseconds by part, "GAE" and "SCN" among them, "wall time" and "CPU time"."""
        print(json.dumps(asked), file=self.process.stdin, flush=True)
        heard = self._heard()
        parts: dict[str, float] = defaultdict(float)
        for when in ("rendered", "extrapolated"):
            for stage, milliseconds in heard[when].items():
                stage = RENAMED.get(stage, stage)
                if milliseconds or (when, stage) in PARTS:
                    parts[PARTS.get((when, stage), stage)] += milliseconds
        scn = {name: parts.pop(name) for name in list(parts) if name.startswith("SCN")}
        if not scn:
            parts["wall time"], parts["CPU time"] = heard["wall"], heard["cpu"] / (os.cpu_count() or 1)
        gae = sum(milliseconds for name, milliseconds in parts.items() if name not in ("wall time", "CPU time"))
        kernels = sum(scn.get(f"SCN, {name}", 0.0) for name in ("inputs", "flow", "kernels"))
        own = {"SCN, inputs and kernels": kernels} if scn else {}
        return dict(parts) | {"GAE": gae} | scn | own

    def close(self) -> None:
        self.process.stdin.close()
        self.process.wait()

    def _heard(self) -> dict:
        line = self.process.stdout.readline()
        if not line:
            sys.exit(f"error: a version ended with {self.process.wait()}, see above")
        return json.loads(line)


# ---- both ----------------------------------------------------------------------------------------------------


def checkout(version: str, folder: Path) -> Path:
    """The folder of a checkout: `version` itself if it is one, else that commit's files, put into `folder`."""
    if Path(version).is_dir():
        return Path(version).resolve()
    folder.mkdir()
    archive = subprocess.run(["git", "-C", str(REPOSITORY), "archive", version], capture_output=True)
    if archive.returncode:
        sys.exit(f"error: {version}: neither a folder nor a commit of {REPOSITORY}: {archive.stderr.decode().strip()}")
    subprocess.run(["tar", "-x", "-C", str(folder)], input=archive.stdout, check=True)
    return folder


def called(version: str) -> str:
    """A version by its commit."""
    folder, commit = (version, "HEAD") if Path(version).is_dir() else (str(REPOSITORY), version)
    told = subprocess.run(["git", "-C", folder, "rev-parse", "--short", commit], capture_output=True, text=True)
    return told.stdout.strip() or version


def store(footage, folder: Path) -> None:
    """Put footage where both versions find it."""
    folder.mkdir()
    for k, frame in enumerate(footage.frames):
        packed = frame.pack()
        for name in ("color", "depth", "motion"):
            np.save(folder / f"{name}_{k}.npy", getattr(packed, name))

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


def compare(footage, folder: Path, trees: list[Path], device: str, repeats: int, scn: bool) -> dict:
    """Milliseconds of both versions by part: the least, the median, and the ratios old : new of either."""
    store(footage, folder)
    arguments = [str(folder), "--device", device, *(["--scn"] if scn else [])]
    versions = [Version(tree, *arguments) for tree in trees]
    if versions[0].device != versions[1].device:
        sys.exit(
            f"error: the versions chose different devices: {versions[0].device}, {versions[1].device}; say --device"
        )
    samples: list[dict[tuple[str, int], list[float]]] = [defaultdict(list), defaultdict(list)]
    for k, turn in enumerate(footage.turns(repeats)):
        asked = {
            "index": turn.index,
            "time": turn.frame.time,
            "reset": turn.frame.reset,
            "until": turn.time(footage.interval),
        }
        for side in (0, 1) if k % 2 else (1, 0):
            timed = versions[side].timed(asked)
            if turn.counts:
                for part, milliseconds in timed.items():
                    samples[side][part, turn.index].append(milliseconds)
    for version in versions:
        version.close()
    report = {"of": footage.name, "width": footage.width, "height": footage.height, "device": versions[1].device}
    parts = list(dict.fromkeys(part for sample in samples[::-1] for part, _ in sample))
    for name, of in (("least", min), ("median", statistics.median)):
        old, new = (
            {
                part: statistics.fmean(of(values) for (p, _), values in sample.items() if p == part)
                for part in parts
                if any(p == part for p, _ in sample)
            }
            for sample in samples
        )
        ratio = {part: old[part] / new[part] for part in parts if old.get(part) and new.get(part)}
        report[name] = {"old": old, "new": new, "ratio": ratio}
    return report


def rounded(value):
    """Without digits that mean nothing."""
    if isinstance(value, dict):
        return {key: rounded(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [rounded(inner) for inner in value]
    return round(value, 3) if isinstance(value, float) else value


def show(report: dict) -> None:
    least, median = report["least"], report["median"]
    print(f"\n{report['of']}, {report['width']}×{report['height']}, {report['device']}")
    print(f"{'ms':26}{'old':>10}{'new':>10}{'ratio':>8}   of medians")
    for part in dict.fromkeys((*least["new"], *least["old"])):
        old, new = (f"{side[part]:.2f}" if part in side else "" for side in (least["old"], least["new"]))
        ratios = (f"{side['ratio'][part]:.2f}" if part in side["ratio"] else "" for side in (least, median))
        print("{:26}{:>10}{:>10}{:>8}{:>8}".format(part, old, new, *ratios), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--old", default=OLD, help="commit, or folder of a checkout")
    parser.add_argument("--new", default=str(REPOSITORY), help="the same; default: this working tree")
    parser.add_argument("--scene", action="append", default=[], help="a built-in scene; may be repeated")
    parser.add_argument("--sequence", action="append", default=[], help="folder of a sequence; may be repeated")
    parser.add_argument("--size", default="1920x1080")
    parser.add_argument("--repeats", type=int, default=16, help="counted pairs of frames")
    parser.add_argument("--frame", type=int, help="which rendered frame; default: the bench's")
    parser.add_argument("--scn", action="store_true", help="with the shading correction network")
    parser.add_argument("--device", action="append", help="intel, pocl, …; may be repeated; default: the best one")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--serve", type=Path, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.serve:
        serve(asked.serve, asked.device[0], asked.scn)
        return

    from gffe_cl.evaluation.benchmark_input import SCENE, footage_of
    from gffe_cl.opencl.device import open_device

    width, height = (int(n) for n in asked.size.split("x"))
    reports = []
    with tempfile.TemporaryDirectory(prefix="compare_speed_") as temporary:
        folder = Path(temporary)
        trees = [checkout(asked.old, folder / "old"), checkout(asked.new, folder / "new")]
        subjects = [*asked.scene, *asked.sequence] or [SCENE]
        for number, (subject, name) in enumerate((s, d) for s in subjects for d in asked.device or [None]):
            device = open_device(name)
            footage = footage_of(device, subject, (width, height), asked.frame)
            place = folder / f"footage_{number}"
            reports.append(compare(footage, place, trees, device.info.index, asked.repeats, asked.scn))
            show(reports[-1])
            shutil.rmtree(place)
    if asked.json:
        document = {"old": called(asked.old), "new": called(asked.new), "of": reports}
        asked.json.write_text(json.dumps(rounded(document), indent=1) + "\n")


if __name__ == "__main__":
    main()
