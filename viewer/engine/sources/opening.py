"""Opening of the device and of the user's target: a sequence's folder or a built-in scene."""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import NamedTuple

import pyopencl as cl

from gffe_cl.captures.formats import open_capture
from gffe_cl.captures.scenes import is_scene, load_scene
from gffe_cl.captures.sequence import Sequence
from gffe_cl.engine.core.errors import printable
from gffe_cl.engine.opencl.device import Device, open_device
from .live import SceneSource
from .recorded import Growth, RecordedSource
from .source import FrameSource

_IMAGES = (".exr", ".png", ".npy", ".npz", ".flo", ".flo5")


def place_of(target: str) -> Path:
    """Return the folder or JSON file to open: for an image its folder."""
    path = Path(target).expanduser()
    return path.parent if path.suffix.lower() in _IMAGES and path.is_file() else path


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


def make_source(target: str, window: str | None, plan: ScenePlan, device: Device, check: bool = False) -> FrameSource:
    """Return the sequence in the folder `target` (or of its sequence.json, or with this file), else the scene of
    that name. With `check`, its `suspicions` are those of the sequence's first frames. Raises GffeError."""
    if is_scene(target):
        source = SceneSource(load_scene(target, plan.seed), device, plan.width, plan.height, plan.fps, window)
    else:
        sequence = open_capture(place_of(target))
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
