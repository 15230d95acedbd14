"""What temporal upscaling is worth on the built-in scenes: the tables of docs/upscaling.md.

    python docs/measure_upscaling.py            measures, writes docs/measured/upscaling.json and the tables
    python docs/measure_upscaling.py --tables   writes the tables from the JSON that is there

Scenes of a seed that the pass was not tuned with, from jittered frames of half the size and one sample per pixel; truth
is rendered at the display's size with 8 samples per pixel. Shading correction is off.
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
from make_tables import between_markers, table

from gffe_cl.evaluation.table.flicker import Flicker
from gffe_cl.frame import RenderedFrame
from gffe_cl.metrics import display_values, psnr, ssim
from gffe_cl.opencl.device import Device, open_device
from gffe_cl.options import Options
from gffe_cl.pipeline import Pipeline
from gffe_cl.scenes import SCENES, SceneFrames, SceneRenderer, load_scene
from gffe_cl.source import JITTER_LENGTH, jittered_renderer
from gffe_cl.stage import Step

DOCS = Path(__file__).parent
JSON, PAGE = DOCS / "measured" / "upscaling.json", DOCS / "upscaling.md"
SIZE, SCALE, SEED = (480, 270), 2, 1
START, FRAMES, COUNTED_FROM, SSIM_EVERY = 1.0, 11, 6, 2
TIMED_SIZE, TIMED_FRAMES = (240, 136), 40


class Measured:
    """Figures of one scene, by name, and the pipelines they are of."""

    def __init__(self, device: Device, name: str):
        self.device, self.scene = device, load_scene(name, SEED)
        small, jitter = jittered_renderer(device, self.scene, SIZE, SCALE)
        self.frames = SceneFrames(small, size=SIZE, jitter=jitter, truths=SceneRenderer(device, self.scene, *SIZE, 8))
        render_size = (small.width, small.height)
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
        pictures["generated, true buffers"] = (self._with_true(depth, motion, camera, time), new_truth)
        shown = {name: (self._shown(color), of) for name, (color, of) in pictures.items()}
        for name, pair in shown.items():
            self.figures[f"{name}, PSNR"].append(psnr(*pair))
            if k % SSIM_EVERY == 0:
                self.figures[f"{name}, SSIM"].append(ssim(*pair))
        for name, pair in (("without", ("bicubic", "generated, plain")), ("with", ("upscaled", "generated"))):
            for picture in pair:
                self.flicker[name].add(*shown[picture])

    def _with_true(self, depth: np.ndarray, motion: np.ndarray, camera, time: float) -> np.ndarray:
        """The new frame again, from exact depth and motion."""
        stage, pipeline = self.upscaled.stages["upscaling"], self.upscaled
        for name, values in (("depth", depth), ("motion", np.nan_to_num(motion))):
            pipeline.board.frame.upload(name, values)
        stage.extrapolated(Step(pipeline._current, pipeline._previous, pipeline._times, camera, time, 0.5))
        return stage.read("color")[..., :3]

    def _shown(self, color: np.ndarray) -> np.ndarray:
        return display_values(color[..., :3], self.scene.exposure)


def cost(device: Device) -> dict[str, float]:
    """Milliseconds of kernels for a rendered and a generated frame, lowest tenths, frames of both pipelines in turn:
    upscaling, GAE in the same pipeline, and GAE whose rendered frames have the display's size."""
    scene, size = load_scene("corridor", SEED), TIMED_SIZE
    small, jitter = jittered_renderer(device, scene, size, SCALE)
    large = SceneFrames(SceneRenderer(device, scene, *size, 1))
    frames = SceneFrames(small, size=size, jitter=jitter)
    options = Options(shading_correction=False)
    ours = Pipeline(device, *size, replace(options, upscale=SCALE), render_size=(small.width, small.height))
    full, before, taken = Pipeline(device, *size, options), (None, None), defaultdict(list)
    for k in range(TIMED_FRAMES):
        time = START + k / scene.fps
        before = frames.rendered(time, before[0], k), large.rendered(time, before[1])
        for pipeline, frame in zip((ours, full), before, strict=True):
            pipeline.submit(frame)
            pipeline.extrapolate(frames.display_camera(time + 0.5 / scene.fps), time + 0.5 / scene.fps)
        if k > 2:
            timings = ours.take_timings()
            taken["upscaling"].append(timings.pop("upscaling"))
            taken["GAE of small frames"].append(sum(timings.values()))
            taken["GAE of the display's size"].append(sum(full.take_timings().values()))
    return {name: float(np.percentile(values, 10)) for name, values in taken.items()}


def measure() -> dict:
    device, scenes = open_device(None), {}
    for name in SCENES:
        scenes[name] = Measured(device, name).run()
        print(name, {key: round(value, 3) for key, value in scenes[name].items()}, flush=True)
    return {
        "size": SIZE, "scale": SCALE, "seed": SEED, "frames": [COUNTED_FROM, FRAMES], "jitter": JITTER_LENGTH,
        "scenes": scenes, "cost": cost(device), "device": device.info.name, "timed": TIMED_SIZE,
    }  # fmt: skip


def tables(measured: dict) -> dict[str, str]:
    rendered, generated = [], []
    rows = measured["scenes"] | {"mean": _mean(list(measured["scenes"].values()))}
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
        "cost": table(("milliseconds", f"{'×'.join(map(str, measured['timed']))}, {measured['device']}"), costs),
    }  # fmt: skip


def _mean(scenes: list[dict]) -> dict[str, float]:
    return {key: float(np.mean([scene[key] for scene in scenes])) for key in scenes[0]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tables", action="store_true", help="from the JSON that is there")
    measured = json.loads(JSON.read_text()) if parser.parse_args().tables else measure()
    JSON.write_text(json.dumps(measured, indent=1) + "\n")
    text = PAGE.read_text()
    for name, made in tables(measured).items():
        text = between_markers(text, f"upscaling-{name}", made)
    PAGE.write_text(text)


if __name__ == "__main__":
    main()
