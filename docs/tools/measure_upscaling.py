"""Gain of temporal upscaling on the built-in scenes: the tables of docs/upscaling.md.

    python docs/tools/measure_upscaling.py                  measures, writes docs/measured/upscaling.json and the tables
    python docs/tools/measure_upscaling.py --only cost …    these parts only: scenes by name, cost, defects
    python docs/tools/measure_upscaling.py --tables         writes the tables from the JSON that is there

Scenes of a seed that the pass was not tuned with, from jittered frames of half the size and one sample per pixel; truth
is rendered at the display's size with 8 samples per pixel. Shading correction is off. What is wrong with the pictures
(ghosts, shimmer, thin bars) is measured by `upscaling_defects.py` beside it, on scenes whose truth is exact.
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from dataclasses import replace
from time import process_time

import numpy as np
from pages import MEASURED, table, write_tables
from upscaling_defects import defect_tables, defects

from gffe_cl.captures.scenes import SCENES, SceneFrames, SceneRenderer, load_scene
from gffe_cl.captures.scenes.sequences import JITTER_LENGTH
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.opencl.device import Device, open_device
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.lab.metrics import psnr, ssim, to_display
from gffe_cl.lab.metrics.flicker import Flicker

JSON = MEASURED / "upscaling.json"
SIZE, SCALE, SEED = (960, 540), 2, 2
START, FRAMES, COUNTED_FROM, SSIM_EVERY = 1.0, 22, 17, 2  # counted once the jitter has gone round
TIMED_SIZE, TIMED_FRAMES = (960, 540), 24


class Measured:
    """Figures of one scene, by name, and the pipelines they are of."""

    def __init__(self, device: Device, name: str):
        self.device, self.scene = device, load_scene(name, SEED)
        truths = SceneRenderer(device, self.scene, *SIZE, 8)
        self.frames = SceneFrames.for_upscaling(device, self.scene, SIZE, SCALE, truths=truths)
        render_size = self.frames.render_size
        self.upscaled, self.plain = (
            Pipeline(device, *SIZE, Options(upscale=u, shading_correction=False), render_size=render_size)
            for u in (SCALE, 0)
        )
        for pipeline in (self.upscaled, self.plain):
            pipeline.exposure = self.scene.exposure
        self.figures: dict[str, list[float]] = defaultdict(list)
        self.flicker = {name: Flicker() for name in ("with", "without")}

    def run(self) -> dict[str, float]:
        before = None
        for k in range(FRAMES):
            time = START + k / self.scene.fps
            before = self.frames.rendered(time, before, k)
            for pipeline in (self.upscaled, self.plain):
                pipeline.submit(before)
            if k >= COUNTED_FROM:
                self._count(k, before)
        figures = {name: float(np.mean(values)) for name, values in self.figures.items()}
        return figures | {f"flicker {name}": flicker.mean for name, flicker in self.flicker.items()}

    def _count(self, k: int, frame: RenderedFrame) -> None:
        truth = self._shown(self.frames.truth(frame.time).read("color"))
        time = frame.time + 0.5 / self.scene.fps
        image = self.frames.truth(time, frame)
        new_truth, depth, motion = self._shown(image.read("color")), image.read("depth"), image.read("motion")
        pictures = {
            "bicubic": (self.plain.present().numpy("color"), truth),
            "upscaled": (self.upscaled.present().numpy("color"), truth),
        }
        camera = self.frames.display_camera(time)
        made = self.upscaled.extrapolate(camera, time)
        pictures["generated, plain"] = (made.numpy("gae"), new_truth)
        pictures["generated"] = (made.numpy("color"), new_truth)
        made = self.upscaled.extrapolate(camera, time, seen_through=(depth, np.nan_to_num(motion)))
        pictures["generated, true buffers"] = (made.numpy("color"), new_truth)
        shown = {name: (self._shown(color), of) for name, (color, of) in pictures.items()}
        for name, pair in shown.items():
            self.figures[f"{name}, PSNR"].append(psnr(*pair))
            if k % SSIM_EVERY == 0:
                self.figures[f"{name}, SSIM"].append(ssim(*pair))
        for name, pair in (("without", ("bicubic", "generated, plain")), ("with", ("upscaled", "generated"))):
            for picture in pair:
                self.flicker[name].add(*shown[picture])

    def _shown(self, color: np.ndarray) -> np.ndarray:
        return to_display(color[..., :3], self.scene.exposure)


def cost(device: Device) -> dict[str, float]:
    """Return milliseconds of a processor core for a rendered and a generated frame, medians, which other work on the
    machine hardly changes: with upscaling less without, and GAE whose rendered frames have the display's size. The
    pipelines take turns from frame to frame."""
    scene, size = load_scene("corridor", SEED), TIMED_SIZE
    large = SceneFrames(SceneRenderer(device, scene, *size, 1))
    frames = SceneFrames.for_upscaling(device, scene, size, SCALE)
    options, render_size = Options(shading_correction=False), frames.render_size
    with_it, without = (
        Pipeline(device, *size, replace(options, upscale=upscale), render_size=render_size) for upscale in (SCALE, 0)
    )
    full, before, taken = Pipeline(device, *size, options), (None, None), defaultdict(list)
    for k in range(TIMED_FRAMES):
        time = START + k / scene.fps
        before = frames.rendered(time, before[0], k), large.rendered(time, before[1])
        for name, pipeline, frame in (
            ("with", with_it, before[0]),
            ("small", without, before[0]),
            ("full", full, before[1]),
        ):
            device.queue.finish()
            start = process_time()
            pipeline.submit(frame)
            pipeline.extrapolate(frames.display_camera(time + 0.5 / scene.fps), time + 0.5 / scene.fps)
            device.queue.finish()
            if k >= COUNTED_FROM:
                taken[name].append(1e3 * (process_time() - start))
    small_cost, full_cost = (float(np.median(taken[name])) for name in ("small", "full"))
    upscaling = float(np.median(np.subtract(taken["with"], taken["small"])))
    return {"upscaling": upscaling, "GAE of small frames": small_cost, "GAE of the display's size": full_cost}


def measure(only: list[str]) -> None:
    """Measure parts, and keep each as soon as it is there."""
    device = open_device(None)
    for name in only or (*SCENES, "cost", "defects"):
        found = (
            cost(device) if name == "cost" else defects(device) if name == "defects" else Measured(device, name).run()
        )
        measured = json.loads(JSON.read_text()) if JSON.exists() else {"scenes": {}}
        measured |= {"size": SIZE, "scale": SCALE, "seed": SEED, "frames": [COUNTED_FROM, FRAMES], "timed": TIMED_SIZE}
        measured |= {"jitter": JITTER_LENGTH, "device": device.info.name}
        (measured["scenes"] if name in SCENES else measured)[name] = found
        JSON.write_text(json.dumps(measured, indent=1) + "\n")
        print(name, found, flush=True)


def tables(measured: dict) -> dict[str, str]:
    rendered, generated = [], []
    scenes = {name: measured["scenes"][name] for name in SCENES}
    rows = scenes | {"mean": _mean(list(scenes.values()))}
    for name, f in rows.items():
        p, s = (lambda key, f=f: f[f"{key}, PSNR"]), (lambda key, f=f: f[f"{key}, SSIM"])
        gain = f"{p('upscaled') - p('bicubic'):+.2f} / {s('upscaled') - s('bicubic'):+.3f}"
        pair = [f"{p(key):.2f} / {s(key):.3f}" for key in ("bicubic", "upscaled")]
        rendered.append((name, *pair, gain))
        pair = [f"{p(key):.2f} / {s(key):.3f}" for key in ("generated, plain", "generated", "generated, true buffers")]
        off = f"{p('generated') - p('generated, true buffers'):+.2f}"
        generated.append((name, *pair, off, f"{f['flicker without']:.3f} → {f['flicker with']:.3f}"))
    cost = measured["cost"]
    share = cost["upscaling"] / cost["GAE of the display's size"]
    costs = [(name, f"{value:.2f}") for name, value in cost.items()]
    costs.append(("upscaling, in GAE of the display's size", f"{share:.2f}"))
    return {
        "rendered": table(("scene", "bicubic", "upscaled", "gain over bicubic"), rendered),
        "generated": table(
            ("scene", "GAE alone", "upscaled", "true depth and motion", "lost to these, dB", "flicker, %"), generated
        ),
        "cost": table(("milliseconds of a core", f"{SIZE[0]}×{SIZE[1]}, {measured['device']}"), costs),
        **defect_tables(measured["defects"]),
    }  # fmt: skip


def _mean(scenes: list[dict]) -> dict[str, float]:
    return {key: float(np.mean([scene[key] for scene in scenes])) for key in scenes[0]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tables", action="store_true", help="from the JSON that is there")
    parser.add_argument("--only", nargs="*", default=[], metavar="PART", help="scenes by name, cost, defects")
    asked = parser.parse_args()
    if not asked.tables:
        measure(asked.only)
    made = tables(json.loads(JSON.read_text()))
    write_tables("upscaling.md", {f"upscaling-{name}": text for name, text in made.items()})


if __name__ == "__main__":
    main()
