"""Opening of the device and of the user's target; the first rendered frame of a sequence, shown meanwhile."""

from __future__ import annotations

from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyopencl as cl

from gffe_cl.captures.formats import open_capture
from gffe_cl.captures.scenes import is_scene, load_scene
from gffe_cl.captures.sequence import Sequence
from gffe_cl.engine.core.errors import GffeError, printable
from gffe_cl.engine.frame.rendered_frame import HALF_MAX
from gffe_cl.engine.opencl.device import Device, open_device
from ..background import Background
from .live import SceneSource
from .recorded import Growth, RecordedSource
from .source import FrameSource

_IMAGES = (".exr", ".png", ".npy", ".npz", ".flo", ".flo5")


@dataclass(frozen=True)
class Preview:
    """Preview of `target` without a device: `color` (H, W, 4) float16 is the picture of slot 0."""

    target: str
    color: np.ndarray
    exposure: float


def place_of(target: str) -> Path:
    """Return the folder or JSON file to open: for an image its folder."""
    path = Path(target).expanduser()
    return path.parent if path.suffix.lower() in _IMAGES and path.is_file() else path


class Previewer:
    """Opens `target` and reads its first rendered frame, on a thread of its own."""

    def __init__(self, target: str):
        self.target = target
        background = Background("preview")
        self._opened: Future = background.run(open_capture, place_of(target))
        self._read: Future | None = background.run(self._first)

    def sequence(self) -> Sequence:
        """Wait until the sequence is opened, and return it. Raises GffeError if it cannot be opened."""
        try:
            return self._opened.result()
        except GffeError:
            raise
        except Exception as error:
            raise GffeError(f"{self.target}: {type(error).__name__}: {error}") from None

    def take(self) -> Preview | None:
        """Return the preview once it is ready, one time only. There is none if slot 0 needs a device."""
        if self._read is None or not self._read.done():
            return None
        read, self._read = self._read, None
        return None if read.exception() else read.result()  # opening and reading it again report errors

    def _first(self) -> Preview | None:
        sequence = self.sequence()
        if not sequence.rendered:
            return None
        entry = sequence.rendered[0]
        whole = entry.render_camera == entry.display_camera
        if not whole or sequence.size_of(entry) != (sequence.width, sequence.height):
            return None
        color = sequence.read_color(entry)
        rgba = np.zeros((*color.shape[:2], 4), np.float16)
        rgba[..., :3] = np.clip(np.nan_to_num(color), -HALF_MAX, HALF_MAX)
        return Preview(self.target, rgba, sequence.exposure)


def preview_of(target: str) -> Previewer | None:
    """Return the previewer of `target`; None for built-in scenes, which a device renders."""
    return None if is_scene(target) else Previewer(target)


def open_viewer_device(wanted: str | None = None) -> Device:
    """Return the device that `open_device` opens; of a CPU, where it can be divided, all compute units but one, which
    is left to the interface."""
    device = open_device(wanted, profiling=True)
    cl_device = device.cl_device
    if device.info.kind != "cpu" or cl_device.max_compute_units < 2:
        return device
    counts = [cl.device_partition_property.BY_COUNTS, cl_device.max_compute_units - 1]
    with suppress(cl.Error):
        return Device(cl_device.create_sub_devices(counts)[0], device.info, profiling=True)
    return device


class ScenePlan(NamedTuple):
    """Settings that built-in scenes are rendered with: size in pixels, seed, and `fps`, None for the scene's own."""

    width: int
    height: int
    seed: int
    fps: float | None = None


def make_source(
    target: str,
    window: str | None,
    plan: ScenePlan,
    device,
    check: bool = False,
    previewer: Previewer | None = None,
) -> FrameSource:
    """Return the sequence in the folder `target` (or of its sequence.json, or with this file), else the scene of
    that name. With `check`, its `suspicions` are those of the sequence's first frames. `previewer`: of this target,
    if one has opened it already. Raises GffeError."""
    if is_scene(target):
        source = SceneSource(load_scene(target, plan.seed), device, plan.width, plan.height, plan.fps, window)
    else:
        sequence = open_capture(place_of(target)) if previewer is None else previewer.sequence()
        source = RecordedSource(sequence, device, window if window == "off" else None)
        source.growth = Growth(place_of(target))
        if check:
            source.check = partial(_suspicion, sequence, target)
    source.target = target
    return source


def _suspicion(sequence: Sequence, target: str) -> str | None:
    """Return a sentence if the first frames do not fit, else None."""
    from gffe_cl.captures.doctor import quick_warning

    suspicion = quick_warning(sequence, sequence.exposure)
    return suspicion and printable(f"{suspicion}; `gffe check {target}` has details")
