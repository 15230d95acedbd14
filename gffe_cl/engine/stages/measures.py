"""Measurements of a rendered frame before the work on it: a user interface in its color, cuts and teleports that the
input does not mark."""

from __future__ import annotations

from array import array
from collections.abc import Mapping

import numpy as np
import pyopencl as cl

from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.base import Board, Kernel, Stage, Step
from gffe_cl.engine.stages.buffers import CUT_SAMPLES, BufferSpec, DeviceFrame
from gffe_cl.engine.stages.frame_block import distance


class UserInterface(Stage):
    """Finds pixels that stay in place although vectors move them, and adds them to `Overlays.fixed_mask`.

    The evidence is that of the frames since the last reset.
    """

    name = "user_interface"
    buffers = (
        BufferSpec("evidence", np.uint8, (), "source", "pairs of frames in which the color stayed in place", "scalar"),
        BufferSpec("mask", np.uint8, (), "source", "1 where the rendered pixel stays in place, given or found", "mask"),
    )
    kernels = (
        Kernel(
            "count_evidence",
            "source",
            {
                "color": "rendered.color",
                "color_prev": "previous.color",
                "depth": "rendered.depth",
                "depth_prev": "previous.depth",
                "motion": "rendered.motion",
                "evidence": "user_interface.evidence",
            },
            {"evidence": "user_interface.evidence"},
        ),
        Kernel(
            "mark_user_interface",
            "source",
            {"evidence": "user_interface.evidence", "given_mask": "user_interface.mask"},
            {"mask": "user_interface.mask"},
        ),
    )

    @classmethod
    def is_wanted(cls, options: Options) -> bool:
        return options.ui_detection

    def found(
        self,
        layers: Mapping[str, np.ndarray | cl.Buffer],
        frame: DeviceFrame,
        previous: DeviceFrame | None,
        exposure: float,
    ) -> dict[str, np.ndarray | cl.Buffer]:
        """Return the layers of `frame`, as of `Composition.prepared`, with what was found in `fixed_mask`. `previous`:
        the frame before, None after a reset. Both have all of their depth."""
        given = layers.get("fixed_mask")
        if isinstance(given, np.ndarray):
            cl.enqueue_copy(self.device.queue, self.buffer["mask"], given)
            given = self.buffer["mask"]
        before = previous or frame
        brought = {"has_overlays": given is not None}
        step = Step(frame, previous, [frame.time], exposure=exposure, given=brought)
        self.launch(
            "count_evidence",
            step,
            color=frame.color,
            color_prev=before.color,
            depth=frame.depth,
            depth_prev=before.depth,
            motion=frame.motion,
        )
        self.launch("mark_user_interface", step, given_mask=self.buffer["mask"] if given is None else given)
        return {**layers, "fixed_mask": self.buffer["mask"]}


COUNTED = ("valid", "inside", "compared", "depth_right", "with_contrast", "contrast_right", "passed")

# Thresholds of a cut; docs/deviations.md has the margins of frames and cuts.
LEAST_SAMPLES = 64  # to say anything
LEAST_OVERLAP = 0.05  # of the samples whose motion must stay in the image: a whip pan leaves more, a cut may not
DEPTH_SURE = 0.4  # share of right depths below which it is a cut, whatever the colors
DEPTH_UNSURE = 0.8  # … and above which it is none
CONTRAST_RIGHT = 0.25  # between the two it is one if the share of right contrasts is lower
LEAST_CONTRASTS = 32  # without so many the depths decide alone, in the middle
TELEPORT = 10.0  # times the step before it, of a step beyond half of the view


class SceneCuts(Stage):
    """Tests whether the previous frame shows any part of the present one. Depths are compared along the motion vectors,
    and so is the contrast between neighbors, which does not depend on the light. History tracking counts the samples.
    """

    name = "scene_cuts"
    builds_at_once = False  # it has no kernels of its own
    buffers = (
        BufferSpec(
            "counts",
            np.int32,
            COUNTED,
            "once",
            "of each row of samples of the rendered frame: how many are so",
            planes=CUT_SAMPLES[1],
            scratch=True,
        ),
    )

    def __init__(self, board: Board):
        super().__init__(board)
        # World units that the camera moved to the last frame that was asked about; None after a reset.
        self._camera_step: float | None = None
        rows = self.sizes.of("cut_samples")[1]
        self._counts = array("i", bytes(4 * rows * len(COUNTED)))  # NumPy would take longer to add up so few
        self._counted: cl.Event | None = None  # complete when the counts are known; None: they do not count

    @classmethod
    def is_wanted(cls, options: Options) -> bool:
        return options.cut_detection

    def rendered(self, step: Step) -> None:
        """Have samples counted, and copy the counts to the host, which does not wait. Without a previous frame there is
        nothing to compare."""
        if step.previous is None:
            self.board.commands.call(self._forget)
        else:
            self.board.stages["history"].measure(step)
            self.board.commands.call(self._read)

    def _forget(self) -> None:
        self._camera_step = self._counted = None

    def _read(self) -> None:
        """Begin to copy the counts at once."""
        self._counted = cl.enqueue_copy(self.device.queue, self._counts, self.buffer["counts"], is_blocking=False)
        self.device.queue.flush()

    def is_cut(self) -> bool:
        """Return whether the last rendered frame must be treated as a reset. Ask once for each. Waits until its samples
        are counted: they are the first work on the frame."""
        if self._counted is None:
            return False
        self._counted.wait()
        bindings = self.board.bindings
        frame, previous, before = bindings.rendered, bindings.previous, self._camera_step
        assert frame and previous  # as samples of both were counted
        self._counted, self._camera_step = None, distance(frame.camera, previous.camera)
        jumped = before is not None and self._camera_step > TELEPORT * before
        counts = {name: sum(self._counts[k :: len(COUNTED)]) for k, name in enumerate(COUNTED)}
        return counts_say_cut(counts, jumped)


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
