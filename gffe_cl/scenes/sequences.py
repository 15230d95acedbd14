"""Which frames make up a sequence of a built-in scene."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from gffe_cl.camera import Camera
from gffe_cl.errors import GffeError
from gffe_cl.scenes.vocabulary import Scene
from gffe_cl.window import WindowChooser


@dataclass(frozen=True)
class SequenceFrame:
    """One frame to render.

    `kind` is "rendered" or "ground_truth"; `source` is the number of the rendered frame before or at it. `camera` is
    what to render through, `display_camera` what is shown of that; they differ where there is a window.
    `previous_time` and `previous_camera` are those of the last rendered frame before it, which its motion
    refers to (None in the first frame, a reset). `alpha` is 0 for rendered frames.
    """

    kind: str
    time: float
    camera: Camera
    display_camera: Camera
    source: int
    alpha: float
    previous_time: float | None
    previous_camera: Camera | None

    @property
    def reset(self) -> bool:
        return self.previous_time is None


def sequence_frames(
    scene: Scene,
    width: int,
    height: int,
    frames: int,
    fps: float | None = None,
    ground_truth: bool = True,
    per_frame: int = 1,
    start: float = 0.0,
    windows: WindowChooser | None = None,
    render_size: tuple[int, int] | None = None,
) -> Iterator[SequenceFrame]:
    """The frames of a sequence in order of time.

    Parameters
    ----------
    frames : int
        Number of rendered frames, `1 / fps` apart (default: the scene's), from `start` seconds on.
    ground_truth : bool
        Also the frames in between, `per_frame` after each rendered one, the last included.
    windows : WindowChooser or None
        Chooses the window of each rendered frame when its turn comes: `observe` the depth of the frame before by then.
    render_size : (width, height) or None
        Pixels of rendered frames, the display's `width` and `height` if None.
    """
    if frames < 1 or per_frame < 0:
        raise GffeError(f"sequence: frames must be ≥ 1 and per_frame ≥ 0, got {frames} and {per_frame}")
    step = 1.0 / (fps or scene.fps)
    size, windows = (width, height), windows or WindowChooser("off", (width, height), [])
    previous_time = previous_camera = previous_shown = None
    for source in range(frames):
        time = start + source * step
        shown = scene.camera(time, *size)
        camera = windows.choose(shown, previous_shown).camera(shown, size, render_size)
        yield SequenceFrame("rendered", time, camera, shown, source, 0.0, previous_time, previous_camera)
        previous_time, previous_camera, previous_shown = time, camera, shown
        for j in range(1, per_frame + 1 if ground_truth else 1):
            alpha = j / (per_frame + 1)
            between = start + (source + alpha) * step
            shown = scene.camera(between, *size)
            yield SequenceFrame("ground_truth", between, shown, shown, source, alpha, time, camera)
