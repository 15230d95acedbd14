"""Stored slots: pictures of another sequence, or of an output or stage dump of `gffe run`, beside computed ones."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from gffe_cl.captures.formats import open_capture
from gffe_cl.captures.offline.run import MASKS, alphas_for
from gffe_cl.captures.sequence import FrameEntry
from gffe_cl.captures.sequence.exr import read_channels
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.inspection import names
from gffe_cl.engine.inspection.buffers import Moment
from gffe_cl.engine.inspection.layers import FRAME_LAYERS, LayerSpec
from ..messages import Frame, Key, rgba_of
from .opening import place_of
from .recorded import state_of_capture
from .source import FrameSource

_IN_OUTPUT = {names.DEPTH: ("Z",), names.MOTION: ("motion.x", "motion.y")} | {
    f"frame.{name}": (channel,) for channel, name in MASKS.items()
}
_IN_OUTPUT[names.EXPECTED_ERROR] = ("mask.expected_error",)
_OF_RENDERED = {names.RENDERED_COLOR, names.RENDERED_DEPTH, names.RENDERED_MOTION}


def version_of(place: str) -> str:
    """Return another text after something else was stored at `place`."""
    return str(state_of_capture(place_of(place)))


class StoredSlots:
    """Frames on disk as slots; `version`: of `version_of`, before. Raises GffeError if `place` cannot be
    opened.

    A slot's picture is the frame of its time: of a generated slot the extrapolated one, else ground truth, else a
    rendered one. Depth, motion and masks are those of the output's files, rendered color, depth and motion those of the
    sequence, and all other layers those of its stage dump (`gffe run --dump-stages`).
    """

    def __init__(self, place: str, version: str):
        self.place, self.version, self._sequence = place, version, open_capture(place_of(place))

    def make(self, key: Key, layers: frozenset[str], source: FrameSource, known: Mapping[str, LayerSpec]) -> Frame:
        """Return a slot with those of `layers` that are stored. `source`: of A's frames, whose times count; `known`:
        A's layers. Raises GffeError if there is no such frame."""
        start, sequence, known = time.perf_counter(), self._sequence, {**FRAME_LAYERS, **known}
        if (sequence.width, sequence.height) != (source.width, source.height):
            sizes = f"{sequence.width}×{sequence.height} pixels, expected {source.width}×{source.height}"
            raise GffeError(f"{self.place}: {sizes}")
        alphas = (0.0, *alphas_for(key.recipe.setup.n))
        k, j = divmod(key.slot, len(alphas))
        at = source.time(k, alphas[j])
        kinds = ("extrapolated", "ground_truth", "rendered") if j else ("rendered",)
        entry = next((found for kind in kinds if (found := sequence.at(kind, at)) is not None), None)
        if entry is None:
            raise GffeError(f"{self.place}: no frame at {at:.4f} s")
        base = sequence.at("rendered", source.time(k))
        images = {name: made for name in layers if (made := self._image(entry, name, known.get(name))) is not None}
        images = self._of_rendered(base, layers - images.keys()) | images
        if j and names.TRUTH in layers and (truth := source.truth(k, alphas[j])) is not None:
            images[names.TRUTH] = rgba_of(truth)
        camera = entry.display_camera or source.camera(k, alphas[j])
        assert camera is not None  # every frame of a sequence has one
        seen = (camera, camera) if base is None else (base.render_camera or camera, base.display_camera or camera)
        size = (sequence.width, sequence.height) if base is None else sequence.size_of(base)
        specs = {name: spec for name, spec in known.items() if name in images} | {
            names.FINAL: FRAME_LAYERS[names.FINAL]
        }
        moment = Moment(k, alphas[j], at, camera, *seen, None)
        wall_ms = (time.perf_counter() - start) * 1e3
        return Frame(key, layers, moment, images, specs, {}, wall_ms, wall_ms, render_size=size)

    def _of_rendered(self, base: FrameEntry | None, layers: frozenset[str]) -> dict[str, np.ndarray]:
        """Return those of `layers` that are of the rendered frame; none where it is stored without depth, as in an
        output."""
        if base is None or not base.render_camera or not layers & _OF_RENDERED:
            return {}
        frame = self._sequence.read(base)
        found = {
            names.RENDERED_COLOR: rgba_of(frame.color),
            names.RENDERED_DEPTH: frame.depth,
            names.RENDERED_MOTION: frame.motion,
        }
        return {name: image for name, image in found.items() if name in layers and image is not None}

    def _image(self, entry: FrameEntry, name: str, spec: LayerSpec | None) -> np.ndarray | None:
        if name == names.FINAL:
            return rgba_of(self._sequence.read_color(entry))
        if spec is None or entry.kind != "extrapolated":
            return None
        dumped = Path(self._sequence.path) / "stages" / Path(entry.file).stem / f"{name}.exr"
        if dumped.is_file():
            return _dumped(dumped, spec)
        if name not in _IN_OUTPUT:
            return None
        read = self._sequence.read_channels(entry, _IN_OUTPUT[name])
        return _typed(np.stack([read[channel] for channel in _IN_OUTPUT[name]], -1), spec)


def _dumped(path: Path, spec: LayerSpec) -> np.ndarray:
    """Return a layer, (planes?, H, W, channels?), from a stage dump's file."""
    planes = [f"{plane + 1}." for plane in range(spec.planes)] if spec.planes > 1 else [""]
    wanted = [[prefix + component for component in spec.components or ("Y",)] for prefix in planes]
    read = read_channels(path, [channel for plane in wanted for channel in plane], path.name)
    made = np.stack([np.stack([read[channel] for channel in plane], -1) for plane in wanted])
    return _typed(made if spec.planes > 1 else made[0], spec)


def _typed(image: np.ndarray, spec: LayerSpec) -> np.ndarray:
    """Return a layer in the type that shaders take, without the axis of a single channel."""
    image = image if spec.components else image[..., 0]
    return image.astype(np.uint8) if spec.view in ("mask", "label") else image
