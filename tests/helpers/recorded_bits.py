"""Digests of what every stage leaves, for many sizes and options, recorded in recorded_bits.json:

    python tests/helpers/recorded_bits.py

records them anew, after a change of kernels that is meant, and says what has changed. All devices and all forms of the
kernels must give the same bits. The frames are the self-test's, which every machine computes alike.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

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
    """A case: options, and width and height of the new frame and of the rendered one (None: the same, no window)."""

    options: Options
    size: tuple[int, int]
    render_size: tuple[int, int] | None = None


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
    "default-larger": Recorded(_PIXELS, (64, 48), (48, 33)),
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


def digests_of(device, case, int64=None):
    """Return the digest of all buffers of each stage, and of the frames made, over all new frames of a case."""
    options = replace(case.options, shading_inputs=True, scn_model=str(PACKAGED))
    pipeline = Pipeline(device, *case.size, options, render_size=case.render_size, int64_atomics=int64)
    pipeline.keep()
    if correction := pipeline.stages.get("correction"):
        correction.use(SubstituteNetwork(HEAD, pattern))
    found: dict[str, list[np.ndarray]] = {}
    for k, frame in enumerate(frames(*case.size, case.render_size, count=_FRAMES, samples=1)):
        pipeline.submit(_spoiled(frame, k) if k else frame)
        for after, ahead in _MOMENTS:
            made = pipeline.extrapolate(display_camera(frame.time + ahead, *case.size), frame.time + after)
            for owner, spec in pipeline.named_buffers():
                found.setdefault(owner.name, []).append(owner.read(spec.name))
            found.setdefault("new", []).append(made.numpy("color"))
            found.setdefault("shown", []).extend(pipeline.present().numpy(n) for n in ("color", "depth", "motion"))
    return {name: digest(*arrays) for name, arrays in found.items()}


if __name__ == "__main__":
    before = json.loads(PATH.read_text()) if PATH.exists() else {}
    after = {name: digests_of(open_device(), case) for name, case in CASES.items()}
    PATH.write_text(json.dumps(after, indent=1) + "\n")
    changed = [
        f"{case}: {stage}"
        for case, held in after.items()
        for stage in held
        if held[stage] != before.get(case, {}).get(stage)
    ]
    print(f"{len(changed)} digests have changed", *changed, sep="\n")
