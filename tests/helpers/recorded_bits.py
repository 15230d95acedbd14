"""Digests of what every stage leaves, for many sizes and options, recorded in recorded_bits.json:

    python tests/helpers/recorded_bits.py

records them anew, after a change of kernels that is meant, and says what has changed. All devices and all forms of the
kernels must give the same bits. The frames are the self-test's, which every machine computes alike.
"""

import json
from dataclasses import fields, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyopencl as cl

from gffe_cl.engine.frame.frame_format import COLOR_TYPES, DEPTH_TYPES, MOTION_TYPES, TYPES, FrameFormat
from gffe_cl.engine.frame.rendered_frame import BadPixels, RenderedFrame
from gffe_cl.engine.inference.network import PACKAGED, SubstituteNetwork
from gffe_cl.engine.opencl.device import open_device
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.selftest.reference import digest
from gffe_cl.engine.selftest.scene import FPS, display_camera, frames
from gffe_cl.engine.selftest.workload import HEAD, pattern

PATH = Path(__file__).parents[1] / "engine/stages/recorded_bits.json"
_FRAMES = 4
# Of each new frame: seconds after the rendered one, and those that its camera is ahead, so that large holes open.
_MOMENTS = ((0.4 / FPS, 0.4 / FPS), (0.6 / FPS, 0.3))


class Recorded(NamedTuple):
    """A case: options, and width and height of the new frame and of the rendered one (None: the same, no window).
    `layers`: overlays of these names alone, with values that are none."""

    options: Options
    size: tuple[int, int]
    render_size: tuple[int, int] | None = None
    layers: tuple[str, ...] = ()


_BLOCKS, _PIXELS = Options(), Options(blocks=False)
_LITERAL = Options(
    crack_closing=False,
    static_threshold=0.7,
    levels=0,
    hole_filling="downsample",
    resampling="linear",
    sharpness=False,
)
CASES = {
    "default": Recorded(_PIXELS, (61, 37)),
    "default-larger": Recorded(replace(_PIXELS, detail=True), (64, 48), (48, 33)),
    "default-smaller": Recorded(_PIXELS, (40, 31), (64, 48)),
    "cubic-larger": Recorded(Options(history=4, order=3, levels=3, blocks=False), (64, 48), (48, 33)),
    "downsample-smaller": Recorded(
        Options(hole_filling="downsample", blocks=False, acceleration=False), (40, 31), (64, 48)
    ),
    "literal": Recorded(_LITERAL, (61, 37)),
    "linear-smaller": Recorded(Options(resampling="linear", levels=3, blocks=False), (40, 31), (64, 48)),
    "blocks-larger": Recorded(_BLOCKS, (70, 41), (48, 33)),
    "performance": Recorded(Options.preset("performance"), (61, 37)),
    "performance-larger": Recorded(Options.preset("performance"), (64, 48), (37, 25)),
    **{
        f"{width}x{height}": Recorded(_BLOCKS, (width, height))
        for width, height in ((1, 1), (2, 5), (8, 1), (13, 9), (16, 12), (33, 20), (128, 18), (149, 83))
    },
    "13x9-performance": Recorded(Options.preset("performance"), (13, 9)),
    "23x14-window": Recorded(_BLOCKS, (23, 14), (35, 23)),
    "67x3-window": Recorded(_BLOCKS, (67, 3), (35, 23)),
    "3x50-window": Recorded(Options.preset("performance"), (3, 50), (35, 23)),
    **{
        f"overlays-{name}": Recorded(Options.preset("performance"), size, (48, 33), layers)
        for name, size, layers in (
            ("fixed", (64, 48), ("fixed_mask",)),
            ("still", (64, 48), ("effects",)),
            ("moving", (40, 31), ("effects", "effects_motion")),
            ("ui", (40, 31), ("ui",)),
            ("all", (61, 37), ("fixed_mask", "effects", "effects_motion", "ui")),
        )
    },
}


def _spoiled(frame, k):
    """Return the frame with a few values that a renderer should not write."""
    height, width = frame.depth.shape
    for j, (color, depth, motion) in enumerate(
        ((np.nan, np.nan, np.nan), (np.inf, -3, np.inf), (-5, 1e38, 1e9), (6e4, 0, -300))
    ):
        at = (7 * j + 3 * k) % height, (11 * j + 5 * k) % width
        frame.color[at][1], frame.depth[at[0], at[1] // 2], frame.motion[at[0] // 2, at[1]] = color, depth, motion
    return frame


def _with_layers(frame, layers):
    """Return the frame with these of its overlays alone, and values there that nobody should write."""
    overlays = frame.overlays
    overlays.effects[3, 14], overlays.effects[6, 16, 0], overlays.ui[3, -9, 3] = np.nan, np.inf, np.nan
    overlays.effects_motion[:, ::2] *= 3
    overlays.effects_motion[8, 15], overlays.effects_motion[9, 20], overlays.effects_motion[10, 18] = np.nan, 1e9, 9
    overlays.effects_motion[11, 18:22, 0], frame.depth[-3:-1, 5:8] = np.inf, np.nan
    chosen = replace(overlays, **{field.name: None for field in fields(overlays) if field.name not in layers})
    return replace(frame, overlays=chosen)


def digests_of(device, case):
    """Return the digest of all buffers of each stage, and of the frames made, over all new frames of a case."""
    options = replace(case.options, shading_inputs=True, scn_model=str(PACKAGED))
    pipeline = Pipeline(device, *case.size, options, render_size=case.render_size)
    pipeline.keep()
    if correction := pipeline.stages.get("correction"):
        correction.use(SubstituteNetwork(HEAD, pattern))
    found: dict[str, list[np.ndarray]] = {}
    for k, frame in enumerate(frames(*case.size, case.render_size, count=_FRAMES, samples=1)):
        if case.layers and frame.overlays:
            frame = _with_layers(frame, case.layers)
        pipeline.submit(_spoiled(frame, k) if k else frame)
        for after, ahead in _MOMENTS:
            made = pipeline.extrapolate(display_camera(frame.time + ahead, *case.size), frame.time + after)
            for owner, spec in pipeline.named_buffers():
                found.setdefault(owner.name, []).append(owner.read(spec.name))
            found.setdefault("scene_cuts", []).append(pipeline.stages["scene_cuts"].read("counts"))
            found.setdefault("new", []).append(made.numpy("color"))
            found.setdefault("shown", []).extend(pipeline.present().numpy(n) for n in ("color", "depth", "motion"))
    return {name: digest(*arrays) for name, arrays in found.items()}


# ---- frames in engines' formats ------------------------------------------------------------------------

CONVERTING = Options.preset("performance", cut_detection=False)
DESCRIPTIONS = {
    "plain": FrameFormat(),
    "OpenXR": FrameFormat.openxr(
        nearZ=np.inf,
        farZ=0.3,
        motionVectorScale=(2, 3, 1, 0),
        motionVectorOffset=(-1, 0.1, 0, 0),
        motion_invalid=1.0,
        motion_jittered=True,
        geometry_size=(61, 33),
        color_size=(61, 33),
    ),
    "logarithmic": FrameFormat(depth="logarithmic", near_z=0.02, far_z=3000),
    "logarithmic of 1 + z, reversed": FrameFormat(depth="logarithmic", near_z=0, far_z=500, depth_range=(0.9, -0.1)),
    "movers only": FrameFormat(
        depth="device",
        near_z=0.1,
        far_z=50,
        motion_unit="uv",
        motion_y="up",
        motion_invalid=0.0,
        camera_motion="movers_only",
    ),
    "sRGB from below, distances": FrameFormat(
        rows="up", color_encoding="srgb", depth="distance", depth_scale=0.01, motion_unit="uv"
    ),
    "distances after a map": FrameFormat(depth="distance", near_z=1, far_z=900, depth_range=(1, 0), depth_scale=3),
    "dilated": FrameFormat(motion_dilated=True),
    "dilated and smaller": FrameFormat(
        motion_dilated=True, geometry_size=(31, 17), color_size=(61, 33), camera_motion="movers_only", motion_invalid=1
    ),
    "excluded": FrameFormat(near_z=2, far_z=9, rows="up", motion_direction="from_previous", camera_motion="excluded"),
}


def _stored(type_name, shape, salt):
    """Return values of a type, with those that mean something else."""
    bits = (np.arange(np.prod(shape), dtype=np.uint64) + np.uint64(7919 * salt)) * np.uint64(0x9E3779B97F4A7C15)
    bits = ((bits ^ bits >> np.uint64(29)) * np.uint64(0xBF58476D1CE4E5B9) >> np.uint64(32)).reshape(shape)
    dtype = np.dtype(TYPES[type_name][0])
    if dtype.kind == "f":
        values, others = bits / 2**32 * 1.1 - 0.1, [0, 1, np.nan, np.inf, -np.inf, 1e30, 1.5e37, 1e-41]
    else:
        values, others = bits.astype(dtype), [0, np.iinfo(dtype).max]
    with np.errstate(over="ignore"):
        return np.where(bits % 10 == 0, np.array(others)[bits // 10 % len(others)], values).astype(dtype)


def in_buffers(device, frame):
    """Return the frame with its arrays in buffers, as they are."""
    flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
    arrays = {name: getattr(frame, name) for name in ("color", "depth", "motion")}
    buffers = {name: cl.Buffer(device.context, flags, hostbuf=a) for name, a in arrays.items() if a is not None}
    return replace(frame, **buffers)


def converted_digest(device, format, size=(61, 33)):
    """Return the digest of converted frames whose buffers have all types, in arrays and in buffers, and of the counts
    of bad pixels."""
    pipeline, found, geometry = Pipeline(device, *size, CONVERTING), [], format.geometry_size or size
    types = zip(2 * COLOR_TYPES, 2 * (*DEPTH_TYPES, "float32"), (*MOTION_TYPES, None, *MOTION_TYPES[1:]), strict=True)
    for k, (color, depth, motion) in enumerate(types):
        channels = 3 + k % 2, 2 + k % 3
        pipeline.format = replace(
            format,
            color_type=color,
            color_channels=channels[0],
            depth_type=depth,
            motion_type=motion or "float32",
            motion_channels=channels[1],
        )
        frame = RenderedFrame(
            _stored(color, (*size[::-1], channels[0]), 3 * k),
            _stored(depth, geometry[::-1], 3 * k + 1),
            motion and _stored(motion, (*geometry[::-1], channels[1]), 3 * k + 2),
            display_camera(k / FPS, *size),
            k / FPS,
            reset=k % 3 == 0 or motion is None,
            geometry_jitter=(0.2 - 0.1 * (k % 4), -0.4 + 0.2 * (k % 3)),
        )
        pipeline.submit(frame if k % 2 else in_buffers(device, frame))
        found += read_frame(device, pipeline.frames.current, size)
    return digest(*found, np.array([getattr(pipeline.bad_pixels, field.name) for field in fields(BadPixels)]))


def read_frame(device, frame, size):
    """Return color, depth and motion of a rendered frame on the device."""
    arrays = [np.empty((*size[::-1], *more), t) for more, t in (((4,), "f2"), ((), "f4"), ((2,), "f4"))]
    for array, buffer in zip(arrays, frame.buffers, strict=True):
        cl.enqueue_copy(device.queue, array, buffer)
    return arrays


if __name__ == "__main__":
    before = json.loads(PATH.read_text()) if PATH.exists() else {}
    device = open_device()
    after = {name: digests_of(device, case) for name, case in CASES.items()}
    after["converted"] = {name: converted_digest(device, format) for name, format in DESCRIPTIONS.items()}
    PATH.write_text(json.dumps(after, indent=1) + "\n")
    changed = [
        f"{case}: {stage}"
        for case, held in after.items()
        for stage in held
        if held[stage] != before.get(case, {}).get(stage)
    ]
    print(f"{len(changed)} digests have changed", *changed, sep="\n")
