"""Workload of the self-test, always the same: frames of `scene` through pipelines with every stage on. Every buffer is
compared after each new frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.inference.layers import HEAD_WEIGHTS
from gffe_cl.engine.inference.network import OPENCL, SubstituteNetwork, default_model, load_network
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.selftest.scene import ALPHAS, FPS, display_camera, frames
from gffe_cl.engine.stages.correction import ShadingCorrection

SIZE, RENDER_SIZE = (61, 45), (73, 54)  # width and height, pixels
EXPOSURE = 1.25


@dataclass(frozen=True)
class Case:
    """A pipeline of the workload; `render_size` of the frames where they come through a window, else None.
    `has_pattern`: a fixed pattern, which holds all kinds of values, is in place of the network's judgement."""

    sentence: str
    options: Options
    render_size: tuple[int, int] | None
    knows_cameras: bool = True
    has_pattern: bool = False


CASES = {
    "default": Case("the recommended options, an adaptive window, overlays", Options(), RENDER_SIZE),
    "other": Case(
        "other orders and levels, no hole filling, predicted cameras, antialiasing over time",
        Options(
            history=3,
            order=2,
            levels=3,
            hole_filling="none",
            focus_mask=False,
            static_threshold=0.5,
            upscale=1,
        ),
        None,
        knows_cameras=False,
        has_pattern=True,
    ),
    "paper": Case(
        "as in the paper: single pixels, no hidden parts, hole filling from the downsampled image",
        Options(
            acceleration=False,
            camera_order=1,
            crack_closing=False,
            hidden_parts=False,
            hole_filling="downsample",
            soft_silhouettes=False,
            lattices=False,
            levels=4,
            resampling="linear",
        ),
        None,
    ),
    "performance": Case("the preset for performance", Options.preset("performance"), RENDER_SIZE),
}


@dataclass(frozen=True)
class Form:
    """Form in which kernels are built: `lanes` pixels per work-item, and whether keys take 64-bit atomics. All forms
    must give the same bits."""

    name: str
    lanes: int
    int64_atomics: bool


def forms_of(device: Device) -> list[Form]:
    """Return the device's own form, and those that devices of other kinds take."""
    own = Form("own", device.lanes, device.int64_atomics)
    lanes = 1 if own.lanes > 1 else 8
    others = [replace(own, name=f"{lanes} lane{'s' * (lanes > 1)}", lanes=lanes)]
    return [own, *others, *([replace(own, name="32-bit atomics", int64_atomics=False)] if own.int64_atomics else [])]


HEAD = ((np.arange(HEAD_WEIGHTS) * 37 % 64).astype(np.float32) - 32) / 256


def pattern(shape: tuple[int, ...]) -> np.ndarray:
    """Return a judgement (planes, height, width) float32 that holds all kinds of values."""
    plane, y, x = np.ogrid[: shape[0], : shape[1], : shape[2]]
    return ((x * 7 + y * 13 + plane * 29 + (x // 4) * (y // 4) * 3) % 64).astype(np.float32) / 64 - 0.5


def moments(device: Device, case: Case, form: Form) -> Iterator[tuple[str, dict[str, np.ndarray]]]:
    """Yield the name of each new frame, such as "frame 2 + 1/3", and the contents of every buffer by name.

    `device` must not have built anything yet. Without weights of the network there is no shading correction.
    """
    device.lanes = form.lanes
    options = replace(case.options, shading_inputs=True, shading_correction=default_model() is not None)
    pipeline = Pipeline(device, *SIZE, options, render_size=case.render_size, int64_atomics=form.int64_atomics)
    pipeline.exposure = EXPOSURE
    pipeline.keep()
    if correction := pipeline.stages.get(ShadingCorrection.name):
        correction.use(SubstituteNetwork(HEAD, pattern) if case.has_pattern else load_network(None, OPENCL))
    for k, frame in enumerate(frames(*SIZE, case.render_size)):
        pipeline.submit(frame)
        for j, alpha in enumerate(ALPHAS, 1):
            made = pipeline.extrapolate(*_moment(frame.time + alpha / FPS, case))
            shown = pipeline.present()
            buffers = {f"{owner.name}.{spec.name}": owner.read(spec.name) for owner, spec in pipeline.named_buffers()}
            buffers["new.color"] = made.numpy("color")
            buffers |= {f"shown.{name}": shown.numpy(name) for name in ("color", "depth", "motion")}
            buffers["pipeline.is_cut"] = np.array([pipeline.is_cut], np.uint8)
            yield f"frame {k} + {j}/{len(ALPHAS) + 1}", buffers


def _moment(time: float, case: Case) -> tuple[Camera | None, float]:
    return display_camera(time, *SIZE) if case.knows_cameras else None, time
