"""Frame generation networks of others, through ONNX (`gffe eval --onnx NAME=FILE`).

The contract, all tensors float32, pictures (1, 3 · K, h, w) of display values from 0 to 1 in RGB, padded at the right
and the bottom by repeating the border to multiples of 32 (or to a size that the model fixes, if it is large enough):

    previous   the K newest rendered frames, the oldest first; K is the model's number of channels / 3
    next       optional, (1, 3, h, w): the rendered frame after them; with it the model interpolates, and waits
    timestep   optional, any shape of one element: α, the time from the newest of `previous` in intervals
    frame      the output, (1, 3, h, w)
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.transfer_function import linear_values, to_display
from gffe_cl.engine.inference.network import NetworkError, one_line, open_session
from gffe_cl.lab.table.datasets import Moment, Shot

_MULTIPLE = 32
_TENSORS = "inputs previous, next (optional), timestep (optional) and an output frame"


class OnnxModel:
    """A model of that contract. Raises GffeError unless it is one."""

    def __init__(self, path: str | Path):
        self.path = Path(path)
        if not self.path.is_file():
            raise GffeError(f"--onnx {path}: no such file (expected an ONNX model)")
        try:
            self._session = open_session(self.path)
        except NetworkError as error:
            raise GffeError(f"--onnx {error}") from None
        shapes = {value.name: value.shape for value in self._session.get_inputs()}
        outputs = [value.name for value in self._session.get_outputs()]
        channels = shapes.get("previous", [0, 0])[1]
        if (
            not {"previous"} <= set(shapes) <= {"previous", "next", "timestep"}
            or "frame" not in outputs
            or not isinstance(channels, int)
            or channels < 3
            or channels % 3
        ):
            raise GffeError(
                f"--onnx {path}: has inputs {', '.join(shapes)} and outputs {', '.join(outputs)} (expected {_TENSORS},"
                " previous of 3, 6, 9 … channels)"
            )
        self.frames, self.interpolates = channels // 3, "next" in shapes
        self._timestep = [n if isinstance(n, int) else 1 for n in shapes["timestep"]] if "timestep" in shapes else None
        self._fixed = [n if isinstance(n, int) else None for n in shapes["previous"][2:]]

    def run(self, previous: list[np.ndarray], following: np.ndarray | None, alpha: float) -> np.ndarray:
        """Return the display values (H, W, 3) of the new frame. `previous`: display values (H, W, 3) of as many
        rendered frames as the model takes, oldest first."""
        height, width = previous[0].shape[:2]
        size = [fixed or -(-n // _MULTIPLE) * _MULTIPLE for fixed, n in zip(self._fixed, (height, width), strict=True)]
        if size[0] < height or size[1] < width:
            raise GffeError(f"--onnx {self.path}: takes {size[1]}×{size[0]} pixels, got {width}×{height}")

        def packed(images):
            planes = np.concatenate([image.transpose(2, 0, 1) for image in images])[None].astype(np.float32)
            return np.pad(planes, ((0, 0), (0, 0), (0, size[0] - height), (0, size[1] - width)), mode="edge")

        feed = {"previous": packed(previous)}
        if self.interpolates:
            feed["next"] = packed([following])
        if self._timestep is not None:
            feed["timestep"] = np.full(self._timestep, alpha, np.float32)
        try:
            (frame,) = self._session.run(["frame"], feed)
        except Exception as error:
            raise GffeError(f"--onnx {self.path}: the network failed: {one_line(error)}") from None
        if frame.shape != (1, 3, *size):
            raise GffeError(f"--onnx {self.path}: frame must be (1, 3, {size[0]}, {size[1]}), got {frame.shape}")
        return np.clip(frame[0, :, :height, :width].transpose(1, 2, 0), 0, 1)


class OnnxRunner:
    """Runs a model on the newest rendered frames. After a reset the first one stands for those before it."""

    def __init__(self, model: OnnxModel, exposure: float):
        self._model, self._exposure, self._frames = model, exposure, []

    def submit(self, shot: Shot) -> None:
        shown = to_display(shot.shown, self._exposure)
        kept = [] if shot.frame.reset else self._frames
        self._frames = [*kept, shown][-self._model.frames :]
        self._following = shot.following

    def make(self, moment: Moment) -> np.ndarray:
        missing = self._model.frames - len(self._frames)
        after = None
        if self._model.interpolates:
            if self._following is None:
                raise GffeError("interpolation: the rendered frame after this one is missing")
            after = to_display(self._following.color[..., :3], self._exposure)
        made = self._model.run([self._frames[0]] * missing + self._frames, after, moment.alpha)
        return linear_values(made, self._exposure)
