"""Detection of cuts and teleports that the input does not mark (the paper requires marks)."""

from __future__ import annotations

from typing import Any

import numpy as np

from gffe_cl.frame.vectors import length
from gffe_cl.opencl.program import constants
from gffe_cl.stages.base import Access, Board, Kernel, Stage, Step
from gffe_cl.stages.buffers import CUT_SAMPLES, BufferSpec, DeviceFrame

_CONSTANTS = constants("scene_cuts.cl")
COUNTED = ("valid", "inside", "compared", "depth_right", "with_contrast", "contrast_right", "passed")
_SHARE = CUT_SAMPLES[0] * CUT_SAMPLES[1] / (1920 * 1080)  # of the pixels at 1080p: the samples are as many at any size

# Thresholds of a cut; docs/cuts.md has the margins of frames and cuts.
LEAST_SAMPLES = 64  # to say anything
LEAST_OVERLAP = 0.05  # of the samples whose motion must stay in the image: a whip pan leaves more, a cut may not
DEPTH_SURE = 0.4  # share of right depths below which it is a cut, whatever the colors
DEPTH_UNSURE = 0.8  # … and above which it is none
CONTRAST_RIGHT = 0.25  # between the two it is one if the share of right contrasts is lower
LEAST_CONTRASTS = 32  # without so many the depths decide alone, in the middle
TELEPORT = 10.0  # times the step before it, of a step beyond half of the view


class SceneCuts(Stage):
    """Test whether the previous frame shows any part of the present one. Depths are compared along the motion
    vectors, and so is the contrast between neighbors, which does not depend on the light."""

    name = "scene_cuts"
    buffers = (
        BufferSpec(
            "counts", np.int32, COUNTED, "once", "of each row of samples of the rendered frame: how many are so",
            planes=CUT_SAMPLES[1], scratch=True,
        ),
    )  # fmt: skip
    kernels = (
        Kernel(
            "compare_samples",
            "cut_samples",
            {
                "color": Access("rendered.color", 4 * _SHARE),
                "depth": Access("rendered.depth", _SHARE),
                "motion": Access("rendered.motion", _SHARE),
                "color_prev": Access("previous.color", 4 * _SHARE),
                "depth_prev": Access("previous.depth", 4 * _SHARE),
            },
            {"counts": "scene_cuts.counts"},
            group="SAMPLES_X",
        ),
    )

    def __init__(self, board: Board):
        super().__init__(board)
        self._step: float | None = None  # world units that the camera moved to the last frame; None after a reset

    @classmethod
    def is_wanted(cls, options: Any) -> bool:
        return options.cut_detection

    def is_cut(self, frame: DeviceFrame, previous: DeviceFrame | None) -> bool:
        """Whether the rendered frame is to be treated as a reset; not known without a `previous` one. Waits for the
        device."""
        before, self._step = self._step, None
        if previous is None:
            return False
        step = length((frame.camera.position - previous.camera.position).tolist())
        self.launch("compare_samples", Step(frame, previous, []))
        _, rows = self.sizes.of("cut_samples")
        counts = self.read("counts")[:rows].sum(0)
        jumped = before is not None and step > TELEPORT * before
        found = counts_say_cut(dict(zip(COUNTED, counts.tolist(), strict=True)), jumped)
        self._step = None if found else step
        return found


def counts_say_cut(counts: dict[str, int], jumped: bool = False) -> bool:
    """Return the decision from the counts of `COUNTED`; `jumped`: the camera's step is over `TELEPORT` times the one
    before."""
    valid, inside, compared = counts["valid"], counts["inside"], counts["compared"]
    if valid < LEAST_SAMPLES:
        return False
    if inside < LEAST_OVERLAP * valid or (jumped and counts["passed"] > valid / 2):
        return True
    if compared < LEAST_SAMPLES // 4:  # it is all sky, before and now
        return False
    depth = counts["depth_right"] / compared
    if counts["with_contrast"] < LEAST_CONTRASTS:
        return depth < (DEPTH_SURE + DEPTH_UNSURE) / 2
    contrast = counts["contrast_right"] / counts["with_contrast"]
    return depth < DEPTH_SURE or (depth < DEPTH_UNSURE and contrast < CONTRAST_RIGHT)
