"""Measure the cameras that `gffe calibrate` recovers of built-in scenes, which it is not shown.

    python docs/tools/measure_calibration.py             prints the table of docs/calibration.md
    python docs/tools/measure_calibration.py --write     puts it there

Residuals are those of the recovered cameras against the exact motion of pixels that are static by the true cameras.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from pages import table, write_tables

from gffe_cl.captures.calibration.calibrate import calibrate_sequence
from gffe_cl.captures.offline.run import run_sequence
from gffe_cl.captures.offline.source import Recorded
from gffe_cl.captures.scenes import SCENES, load_scene
from gffe_cl.captures.scenes.render import render_sequence
from gffe_cl.captures.sequence import Sequence, open_sequence
from gffe_cl.captures.sequence.description import FILE_NAME, Description, FrameEntry, describe
from gffe_cl.captures.sequence.exr import write_channels
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.opencl.device import Device, open_device
from gffe_cl.engine.options import Options
from gffe_cl.lab.compare import compare

SIZE, FRAMES, FPS = (240, 136), 21, 30.0
MOVING = 0.4  # of the pixels, with objects of one's own
STATIC = 0.01  # px
EVERY = 3  # pixels each way, of those that are judged
HEADS = (
    "scene",
    "turns by",
    "motion vectors",
    "moving, as found",
    "focal length off by",
    "static, median",
    "90th percentile",
    "GAE, camera known, dB",
    "GAE, camera predicted, dB",
)

Change = Callable[[np.ndarray, np.ndarray], np.ndarray]  # motion (H, W, 2), where it is static (H, W) → motion


def as_rendered(motion: np.ndarray, static: np.ndarray) -> np.ndarray:
    return motion


def quantized(motion: np.ndarray, static: np.ndarray) -> np.ndarray:
    """Return motion to 1/16 px."""
    return np.round(motion * 16) / 16


def crowded(motion: np.ndarray, static: np.ndarray) -> np.ndarray:
    """Return motion to 1/16 px, with so many columns that drift and grow that two fifths of all pixels move."""
    height, width = static.shape
    own = np.concatenate([[0], np.cumsum((~static).sum(0))])  # moving pixels left of each column
    total = own + height * (width - np.arange(width + 1))
    first = int(np.argmax(total <= max(MOVING * static.size, own[-1])))
    drift = np.array([3.0, -1.5]) + 0.02 * (np.arange(height) - height / 2)[:, None, None]
    changed = motion.copy()
    changed[:, first:] += np.broadcast_to(drift, changed[:, first:].shape)
    return quantized(changed, static)


VARIANTS: dict[str, Change] = {"exact": as_rendered, "1/16 px": quantized, "1/16 px, 40% moving": crowded}


def hidden(sequence: Sequence, folder: Path, change: Change) -> Sequence:
    """Return a copy with other motion vectors and without cameras: none in `sequence.json`, none in the headers."""
    folder.mkdir()
    before, entries = None, []
    for entry in sequence.frames:
        channels = sequence.read_channels(entry, ("R", "G", "B", "Z", "motion.x", "motion.y"))
        if before is not None:
            motion = np.stack([channels["motion.x"], channels["motion.y"]], -1)
            off = off_by(channels["Z"], motion, camera_of(entry), camera_of(before))
            changed = change(motion, ~(off > STATIC))
            channels["motion.x"], channels["motion.y"] = np.moveaxis(changed.astype(np.float32), -1, 0)
        write_channels(folder / entry.file, channels, {})
        entries.append(FrameEntry(entry.file, entry.time, entry.kind, entry.reset))
        before = entry if entry.kind == "rendered" else before
    description = Description(sequence.width, sequence.height, sequence.fps, sequence.exposure, entries)
    (folder / FILE_NAME).write_text(describe(description, "measure_calibration"))
    return open_sequence(folder, cameras="optional")


def camera_of(entry: FrameEntry) -> Camera:
    return entry.render_camera or entry.display_camera


def off_by(depth: np.ndarray, motion: np.ndarray, camera: Camera, before: Camera) -> np.ndarray:
    """Return (H, W) px between a static pixel's place by the cameras and the place that its motion points to; NaN for
    sky."""
    height, width = depth.shape
    y, x = np.mgrid[:height, :width] + 0.5
    px = np.stack([x, y], -1)
    with np.errstate(invalid="ignore"):
        at = before.project(camera.unproject(px, depth))[0]
        return np.linalg.norm(at - px - motion, axis=-1)


def static_residuals(truth: Sequence, recovered: Sequence) -> np.ndarray:
    """Return pixels, of all rendered frames but the first, between the places where static pixels were and those to
    which the recovered cameras reproject them."""
    found = []
    for k in range(1, len(truth.rendered)):
        now, before = truth.rendered[k], truth.rendered[k - 1]
        channels = truth.read_channels(now, ("Z", "motion.x", "motion.y"))
        motion = np.stack([channels["motion.x"], channels["motion.y"]], -1)
        static = off_by(channels["Z"], motion, camera_of(now), camera_of(before)) < STATIC
        cameras = (camera_of(entry) for entry in (recovered.rendered[k], recovered.rendered[k - 1]))
        off = off_by(channels["Z"], motion, *cameras)
        found.append(off[::EVERY, ::EVERY][static[::EVERY, ::EVERY]])
    return np.concatenate(found)


def quality(sequence: Sequence, truth: Sequence, device: Device, folder: Path, predicted: bool) -> float:
    """Return the mean PSNR of the frames in between as `gffe compare` has it, dB."""
    options = Options(shading_correction=False)
    run_sequence(Recorded(sequence, device), folder, device, options, [0.5], predicted_camera=predicted)
    return compare(open_sequence(folder), truth).mean["psnr"]


def with_true_cameras(truth: Sequence, bare: Sequence) -> Sequence:
    """Return `bare`, in memory, with the cameras of `truth`."""
    opened = open_sequence(bare.path, cameras="optional")
    for entry, true in zip(opened.frames, truth.frames, strict=True):
        entry.render_camera, entry.display_camera = true.render_camera, true.display_camera
    return opened


def signed(value: float) -> str:
    """Return a number with two digits; zero has no sign."""
    text = f"{value:+.2f}"
    return text[1:] if text[1:] == "0.00" else text


def turned(sequence: Sequence) -> float:
    """Return the degrees that the camera turns in all."""
    matrices = [entry.render_camera.world_to_view[:3, :3] for entry in sequence.rendered]
    traces = [np.trace(a @ b.T) for a, b in zip(matrices, matrices[1:], strict=False)]
    return float(np.degrees(np.arccos(np.clip((np.array(traces) - 1) / 2, -1, 1))).sum())


def rows(device: Device, scenes: list[str], seed: int) -> Iterator[tuple[str, ...]]:
    """Yield rows of the table, one for each scene and variant."""
    for name in scenes:
        with tempfile.TemporaryDirectory() as given:
            folder = Path(given)
            render_sequence(
                load_scene(name, seed), folder / "truth", device, *SIZE, FRAMES, FPS, ground_truth=True, samples=2
            )
            truth = open_sequence(folder / "truth")
            true = truth.rendered[0].render_camera
            view = float(np.degrees(2 * np.arctan(SIZE[0] / 2 / true.fx)))
            for variant, change in VARIANTS.items():
                bare, out = hidden(truth, folder / f"bare {change.__name__}", change), folder / change.__name__
                try:
                    found, focal = calibrate_sequence(bare, out), ""
                except GffeError as error:
                    assert "not determined" in str(error), error
                    found, focal = calibrate_sequence(bare, out, view=view), "not determined by this motion"
                focal = focal or f"{signed(100 * (found.focal[0] / true.fx - 1))}%"
                recovered = open_sequence(out)
                off = np.percentile(static_residuals(truth, recovered), (50, 90))
                gae = ["", ""]
                if change is quantized:
                    for k, predicted in enumerate((False, True)):
                        pair = (recovered, with_true_cameras(truth, bare))
                        a, b = (
                            quality(s, truth, device, folder / f"run {k} {n}", predicted) for n, s in enumerate(pair)
                        )
                        gae[k] = f"{a:.2f} ({signed(a - b)})"
                turns, moving = f"{turned(truth):.1f}°", f"{100 * (1 - found.static):.0f}%"
                yield name, turns, variant, moving, focal, f"{off[0]:.3f}", f"{off[1]:.3f}", *gae


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="put the table into docs/calibration.md")
    parser.add_argument("--scenes", nargs="+", default=list(SCENES))
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--device")
    given = parser.parse_args()
    made = table(HEADS, rows(open_device(given.device), given.scenes, given.seed))
    print(made)
    if given.write:
        write_tables("calibration.md", {"calibration": made})


if __name__ == "__main__":
    main()
