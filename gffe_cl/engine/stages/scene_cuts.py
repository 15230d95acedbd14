"""Detection of cuts and teleports that the input does not mark (the paper requires marks)."""

from __future__ import annotations

import numpy as np
import pyopencl as cl

from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.base import Access, Board, Kernel, Stage, Step
from gffe_cl.engine.stages.buffers import CUT_SAMPLES, BufferSpec
from gffe_cl.engine.stages.frame_block import distance

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
    """Tests whether the previous frame shows any part of the present one. Depths are compared along the motion vectors,
    and so is the contrast between neighbors, which does not depend on the light."""

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
        self._camera_step: float | None = (
            None  # world units that the camera moved to the last frame; None after a reset
        )
        self._counts = np.empty((CUT_SAMPLES[1], len(COUNTED)), np.int32)
        self._counted: cl.Event | None = None  # complete when the counts are known; None: they do not count
        self._jumped = False

    @classmethod
    def is_wanted(cls, options: Options) -> bool:
        return options.cut_detection

    def rendered(self, step: Step) -> None:
        """Count samples, and copy the counts to the host, which does not wait. Without a previous frame there is
        nothing to compare."""
        before, self._camera_step, self._counted = self._camera_step, None, None
        if step.previous is None:
            return
        self._camera_step = distance(step.frame.camera, step.previous.camera)
        self._jumped = before is not None and self._camera_step > TELEPORT * before
        self.launch("compare_samples", step)
        self._counted = self.board.commands.read(self.buffer["counts"], self._counts)

    def is_cut(self) -> bool:
        """Return whether the last rendered frame must be treated as a reset. Waits until its samples are counted: they
        are the first work on the frame."""
        if self._counted is None:
            return False
        self._counted.wait()
        self._counted = None
        _, rows = self.sizes.of("cut_samples")
        counts = self._counts[:rows].sum(0).tolist()
        return counts_say_cut(dict(zip(COUNTED, counts, strict=True)), self._jumped)


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
