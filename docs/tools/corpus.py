"""The corpus: sequences with exact truth on which quality is measured, a line each in docs/measured/corpus.toml.

Sequences are rendered once and cached by what they depend on: their line, the sources of the scenes, and the device.
"""

from __future__ import annotations

import hashlib
import inspect
import io
import os
import tomllib
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from corpus_scenes import GENERATORS, ROWS, draw_effect
from pages import MEASURED, REPOSITORY

from gffe_cl.captures.scenes import SCENES, SITUATIONS, SceneRenderer, is_scene_name, load_scene
from gffe_cl.captures.scenes.renderer import FlatScene
from gffe_cl.captures.scenes.scene_types import Scene, rotation
from gffe_cl.captures.sequence.encoding import Encoding
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.opencl.runtimes import cache_folder, keep_file
from gffe_cl.lab.compare import NO_HISTORY
from gffe_cl.lab.metrics import focus_mask, labels_of
from gffe_cl.lab.table.footage import Guide, Shot, exact_parts, moving_pixels
from gffe_cl.lab.table.methods import sample

SIZE = 240, ROWS
ALPHAS = 0.5, 1.0
CACHE = cache_folder() / "quality"
MOST_SEQUENCES = 300  # in the cache, 6 MB each
_SCENES = "gffe_cl/captures/scenes"
_SOURCES = "kernels/scenes", f"{_SCENES}/scene_types.py", f"{_SCENES}/props.py"  # of all sequences


@dataclass(frozen=True)
class Line:
    """A sequence of the corpus.

    Attributes
    ----------
    name, group : str
        Its own name, and that of the group whose means it counts in.
    generator, seed
        A built-in scene or situation, or one of `corpus_scenes.GENERATORS`.
    fps, frames
        Rate, and number of rendered frames; new frames are made after all but the first two.
    use : "tuned" or "proof"
        Whether rules and constants may be chosen by it, or only judged.
    camera : "known" or "predicted"
        Whether new frames have the true camera.
    condition : "", "zoom", "roll", "uneven" (intervals) or "dropped" (every fourth frame)
    effect : "" or one of `corpus_scenes.draw_effect`
    encoding : of rendered frames, as of `gffe render --encode`
    quick : whether `--quick` measures it
    """

    name: str
    group: str
    generator: str
    seed: int = 0
    fps: float = 30.0
    frames: int = 8
    use: str = "tuned"
    camera: str = "known"
    condition: str = ""
    effect: str = ""
    encoding: str = ""
    quick: bool = False

    def times(self) -> list[float]:
        """Return the times of the rendered frames and of the one after them, seconds."""
        steps = np.ones(self.frames)
        if self.condition == "uneven":
            steps = np.random.default_rng(self.seed).uniform(0.5, 1.6, self.frames)
        elif self.condition == "dropped":
            steps[3::4] = 2
        return [0.0, *(np.cumsum(steps) / self.fps).tolist()]

    def scene(self) -> Scene:
        """Return the scene that it shows."""
        rng = np.random.default_rng([*self.generator.encode(), self.seed])
        known = is_scene_name(self.generator)
        return load_scene(self.generator, self.seed) if known else GENERATORS[self.generator](self.seed, rng)

    def camera_at(self, scene: Scene, time: float) -> Camera:
        """Return the true camera at `time`, of images of `SIZE`."""
        camera = scene.camera(time, *SIZE)
        if self.condition == "zoom":
            factor = 1 + 0.35 * np.sin(2 * np.pi * time / 0.8)
            return replace(camera, fx=camera.fx * factor, fy=camera.fy * factor)
        if self.condition == "roll":
            rolled = rotation("z", 15 * np.sin(2 * np.pi * time / 0.9)) @ camera.world_to_view
            return replace(camera, world_to_view=rolled)
        return camera

    def key(self, device: Device) -> str:
        """Return a hash of everything that the sequence depends on."""
        what = {**asdict(self), "name": "", "group": "", "use": "", "camera": "", "quick": ""}
        functions = Line.times, Line.camera_at, _render, FlatScene, SceneRenderer, draw_effect
        made_by = [inspect.getsource(function) for function in functions]
        of = f"{_SCENES}/places/{self.generator}.py", f"{_SCENES}/situations.py", "docs/tools/corpus_scenes.py"
        own = of[0 if self.generator in SCENES else 1 if self.generator in SITUATIONS else 2]
        made_by.append(digest_of(REPOSITORY, (*_SOURCES, own)))
        known = f"{what} {SIZE} {ALPHAS} {device.info.name} {device.info.platform} {made_by}"
        return hashlib.sha256(known.encode()).hexdigest()[:24]


def corpus_lines() -> list[Line]:
    """Return the lines of docs/measured/corpus.toml."""
    return [Line(**line) for line in tomllib.loads((MEASURED / "corpus.toml").read_text("utf-8"))["sequences"]]


def digest_of(root: Path, names: tuple[str, ...]) -> str:
    """Return a hash of the files `names` under `root`, and of all files in the folders among them but compiled ones."""
    total = hashlib.sha256()
    for name in names:
        inside = sorted((root / name).rglob("*")) if (root / name).is_dir() else [root / name]
        for path in (path for path in inside if path.is_file() and "__pycache__" not in path.parts):
            total.update(os.fsencode(path.relative_to(root)) + b"\0" + path.read_bytes())
    return total.hexdigest()


def rendered(line: Line, device: Device) -> Path:
    """Return the file of a sequence, rendered if it is not cached: arrays `color`, `depth`, `motion`, `camera` (F, 20),
    `time` of rendered frames; `truth`, `truth_camera`, `after` (frame), `truth_time` and `labels` of the moments, those
    of one frame by α; `exposure`, `fps`."""
    path = CACHE / f"corpus-{line.key(device)}.npz"
    if path.exists():
        path.touch()
        return path
    stored = io.BytesIO()
    np.savez_compressed(stored, **_render(line, device))
    keep_file(path, stored.getvalue(), "corpus-*.npz", MOST_SEQUENCES)
    return path


def _render(line: Line, device: Device) -> dict[str, np.ndarray]:
    scene, times = line.scene(), line.times()
    renderer, images = SceneRenderer(device, scene, *SIZE), {}
    encoding = Encoding.parse(line.encoding) if line.encoding else None
    first = line.camera_at(scene, 0.0)

    def image(time: float, before: float):
        if (time, before) not in images:
            made = renderer.render(time, line.camera_at(scene, time), before, line.camera_at(scene, before)).numpy()
            if line.effect:
                camera = line.camera_at(scene, time)
                drawn = draw_effect(line.effect, made.color, made.depth, camera, first, time, scene.exposure)
                made = replace(made, color=drawn)
            images[time, before] = made
        return images[time, before]

    frames, moments = [], []
    for k, time in enumerate(times[: line.frames]):
        before, camera = times[max(k - 1, 0)], line.camera_at(scene, time)
        shown = image(time, before)
        frame = RenderedFrame(shown.color, shown.depth, shown.motion, camera, time, reset=k == 0)
        moving = moving_pixels(shown.motion, shown.depth, camera, line.camera_at(scene, before))
        stored = encoding.frame(frame, scene.exposure) if encoding else frame
        frames.append((stored.color, stored.depth, stored.motion, _flat(camera), time))
        for alpha in ALPHAS if k >= NO_HISTORY else ():
            at = time + alpha * (time - before)
            at = times[k + 1] if abs(at - times[k + 1]) < 1e-9 else at  # it is the next rendered frame
            made, new = image(at, time), line.camera_at(scene, at)
            z = np.where(np.isinf(made.depth), np.inf, made.other_position[..., 2])
            z = np.where(np.isfinite(made.motion).all(-1), z, np.nan).astype(np.float32)
            guide = Guide(made.depth, made.motion, z, moving_pixels(made.motion, made.depth, new, camera))
            parts = exact_parts(Shot(frame, shown.color, (), None, moving), guide)
            place = np.mgrid[: SIZE[1], : SIZE[0]][::-1].transpose(1, 2, 0) + np.float32(0.5) + made.motion
            pulled, _ = sample(shown.color.astype(np.float32), place)
            parts["focus"] = focus_mask(pulled, made.color, guide.moving, scene.exposure)
            moments.append((made.color, _flat(new), k, at, labels_of(parts)))
    names = "color", "depth", "motion", "camera", "time"
    arrays = dict(zip(names, map(np.array, zip(*frames, strict=True)), strict=True))
    names = "truth", "truth_camera", "after", "truth_time", "labels"
    arrays |= dict(zip(names, map(np.array, zip(*moments, strict=True)), strict=True))
    return arrays | {"exposure": np.float64(scene.exposure), "fps": np.float64(line.fps)}


def _flat(camera: Camera) -> np.ndarray:
    """Return a camera as 20 numbers: the matrix, row by row, then fx, fy, cx, cy."""
    return np.array([*camera.world_to_view.ravel(), camera.fx, camera.fy, camera.cx, camera.cy])
