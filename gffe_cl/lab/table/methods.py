"""Methods of the table, and how each is run: our pipeline, the cheapest method that moves motion vectors with a depth
test on the same runtime, and baselines, other kinds of methods in their plainest form.

Baselines stand for a kind of method, not for a product. Published methods add further parts, above all networks, which
run through ONNX (`gffe eval --onnx NAME=FILE`, `OnnxModel`). Runners take rendered frames by `submit(shot)` and make
pictures of moments by `make(moment)`: linear (H, W, 3).
"""

from __future__ import annotations

import hashlib
import importlib.util
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pyopencl as cl

from gffe_cl.engine.core.errors import GffeError, how_to_install
from gffe_cl.engine.frame.transfer_function import linear_values, to_display
from gffe_cl.engine.inference import network as inference
from gffe_cl.engine.inference.network import NetworkError, one_line, open_session
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.opencl.program import build
from gffe_cl.engine.options import PRESETS, Options
from gffe_cl.engine.pipeline.made_frame import ExtrapolatedFrame
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.timing.footage import uploaded
from gffe_cl.lab.metrics import LUMA, same_surface
from gffe_cl.lab.table.footage import Footage, Moment, Shot, Subject, pixel_centers

_SAME_AS_BEFORE = 0.1  # of the depth, between two frames of a moving camera
_GUIDED_REACHES = (1, 2, 4, 8, 16, 32)  # pixels
_SHOWS = 0.1  # of a pixel: so much of a surface, and it shows there
_GUIDED_DEPTH = 0.05  # of the depth: how alike guides must be
_SAME_LAYER = 0.05  # of the depth: surfaces within one pixel that are mixed
_MULTIPLE = 32  # pixels, that networks take
_TENSORS = "inputs previous, next (optional), timestep (optional) and an output frame"


class Repeat:
    """Shows the last rendered frame again."""

    def submit(self, shot: Shot) -> None:
        self._shown = shot.shown

    def make(self, moment: Moment) -> np.ndarray:
        return self._shown


class MotionVectors:
    """Continues motion vectors in image space, in the manner of Mob-FGSR (Yang et al., SIGGRAPH 2024): splat to t + α
    with the depth test, holes take the nearest vector, and the color of t is looked up backward.

    `order` 1: at constant speed; 2: with the change of the vectors since the frame before, found where they point to.
    """

    def __init__(self, order: int):
        self._order, self._before = order, None

    def submit(self, shot: Shot) -> None:
        frame = shot.frame
        self._color, self._depth = shot.shown.astype(np.float32), frame.depth
        speed = np.zeros((*frame.depth.shape, 2), np.float32) if frame.motion is None else -frame.motion
        self._speed, self._change = speed, np.zeros_like(speed)
        if self._order == 2 and self._before is not None and not frame.reset:
            place = pixel_centers(*frame.depth.shape) - speed
            self._change = speed - sample(self._before, place)[0]
        self._before = np.nan_to_num(speed)

    def make(self, moment: Moment) -> np.ndarray:
        alpha = np.float32(moment.alpha)
        moved = alpha * self._speed + alpha * (alpha + 1) / 2 * self._change
        here = pixel_centers(*self._depth.shape)
        field, known = splat(here + moved, self._depth, moved)
        return sample(self._color, here - filled(field, known))[0]


class OpticalFlow:
    """Continues the flow from t to t−1 by OpenCV's DIS (Kroeger et al., ECCV 2016) on displayed pictures at constant
    speed, and warps forward. Holes take the nearest vector. It needs pictures only."""

    def __init__(self, exposure: float):
        import cv2

        self._find: Any = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
        self._exposure = exposure
        self._gray: np.ndarray | None = None

    def submit(self, shot: Shot) -> None:
        self._color = shot.shown.astype(np.float32)
        gray = (255 * (to_display(shot.shown, self._exposure) @ LUMA)).astype(np.uint8)
        before = gray if self._gray is None or shot.frame.reset else self._gray
        self._flow, self._gray = self._find.calc(gray, before, None), gray

    def make(self, moment: Moment) -> np.ndarray:
        moved = -np.float32(moment.alpha) * self._flow
        height, width = moved.shape[:2]
        here = pixel_centers(height, width)
        field, known = splat(here + moved, np.ones((height, width), np.float32), moved)
        return sample(self._color, here - filled(field, known))[0]


class GuidedExtrapolation:
    """Warps frame t backward, guided by G-buffers of the new frame, in the manner of ExtraSS-E (Wu et al., SIGGRAPH
    Asia 2023): where any of its surface shows in t, the color is looked up there, antialiased as it is; else it is a
    mean of pixels around with similar depth. The G-buffers are exact, and their cost is not counted."""

    def submit(self, shot: Shot) -> None:
        self._color, self._depth = shot.shown.astype(np.float32), shot.frame.depth

    def make(self, moment: Moment) -> np.ndarray:
        guide = moment.guide
        assert guide is not None  # see Method.needs
        place = pixel_centers(*guide.depth.shape) + guide.motion
        seen = same_surface(taps(self._depth, place), guide.source_depth)
        height, width = guide.depth.shape
        with np.errstate(invalid="ignore"):
            seen &= (place >= 0).all(-1) & (place < (width, height)).all(-1)
        _, shows = sample(self._color, place, seen)
        return guided_fill(sample_sharp(self._color, place), shows >= _SHOWS, guide.depth)


class Interpolation:
    """Interpolates between t and the next rendered frame along the latter's motion vectors. It is a reference with the
    latency that extrapolation avoids. Where both frames show one surface they are mixed by time. Surfaces that only t
    shows follow t's own vectors."""

    def submit(self, shot: Shot) -> None:
        self._shot = shot

    def make(self, moment: Moment) -> np.ndarray:
        now, after = self._shot.frame, self._shot.following
        alpha, height = np.float32(moment.alpha), now.depth.shape[0]
        here = pixel_centers(height, now.depth.shape[1])
        if after is None:
            raise GffeError("interpolation: the rendered frame after this one is missing")
        back = after.motion
        own = np.zeros_like(back) if now.motion is None else now.motion
        field, known = splat(here + (1 - alpha) * back, after.depth, np.concatenate([back, after.depth[..., None]], -1))
        old, old_known = splat(here - alpha * own, now.depth, own)
        vectors, depth = field[..., :2], field[..., 2]
        before_place = here + alpha * vectors
        met = taps(now.depth, before_place)
        with np.errstate(invalid="ignore"):
            both = (np.abs(met - depth) <= _SAME_AS_BEFORE * depth).any(0) | (np.isinf(met).any(0) & (depth >= 1e29))
        later = sample(after.color[..., :3].astype(np.float32), here - (1 - alpha) * vectors)[0]
        earlier = sample(now.color[..., :3].astype(np.float32), before_place)[0]
        mixed = np.where(both[..., None], (1 - alpha) * earlier + alpha * later, later)
        only_old = sample(now.color[..., :3].astype(np.float32), here + alpha * filled(old, old_known))[0]
        return np.where(known[..., None], mixed, only_old)


def guided_fill(color: np.ndarray, known: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Return `color` (H, W, 3), filled where it is not `known`: with means of known pixels of similar `depth` (H,
    W), from increasing distances, or else with the nearest pixel."""
    color, known = color.copy(), known.copy()
    nearness = np.where(np.isfinite(depth), 1 / np.maximum(depth, 1e-6), 0).astype(np.float32)
    height, width = depth.shape
    for reach in _GUIDED_REACHES:
        y, x = np.nonzero(~known)
        if not len(y):
            return color
        total, weights = np.zeros((len(y), 3), np.float32), np.zeros(len(y), np.float32)
        for dy in (-2, -1, 0, 1, 2):
            for dx in (-2, -1, 0, 1, 2):
                ny, nx = y + dy * reach, x + dx * reach
                inside = (ny >= 0) & (ny < height) & (nx >= 0) & (nx < width)
                ny, nx = np.clip(ny, 0, height - 1), np.clip(nx, 0, width - 1)
                apart = np.abs(nearness[ny, nx] - nearness[y, x]) / np.maximum(nearness[y, x], 1e-6)
                weight = inside * known[ny, nx] * np.exp(-((apart / _GUIDED_DEPTH) ** 2) - 0.2 * (dx * dx + dy * dy))
                total += weight[:, None] * color[ny, nx]
                weights += weight
        found = weights > 1e-3
        color[y[found], x[found]] = total[found] / weights[found, None]
        known[y[found], x[found]] = True
    return filled(color, known)


# ---- networks ---------------------------------------------------------------------------------------------------


class OnnxModel:
    """Frame generation network of others. Raises GffeError unless it fulfils the contract.

    All tensors float32, pictures (1, 3 · K, h, w) of display values from 0 to 1 in RGB, padded at the right
    and the bottom by repeating the border to multiples of 32, or to a size that the model fixes, if it is large enough:

        previous   the K newest rendered frames, the oldest first; K is the model's number of channels / 3
        next       optional, (1, 3, h, w): the rendered frame after them; with it the model interpolates, and waits
        timestep   optional, any shape of one element: α, the time from the newest of `previous` in intervals
        frame      the output, (1, 3, h, w)
    """

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


# ---- warping by motion in pixels, without geometry --------------------------------------------------------------


def sample(image: np.ndarray, place: np.ndarray, mask: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Sample `image` (H, W, C) at `place` (h, w, 2) pixels, bilinear, the border repeated. Only taps where `mask` (4,
    h, w), in reading order, is set count. Return (h, w, C) float32, and the weight (h, w) of the taps that counted."""
    height, width = image.shape[:2]
    finite = np.where(np.isfinite(place), place, -1e6) - np.float32(0.5)
    low = np.floor(finite).astype(np.int64)
    part = (finite - low).astype(np.float32)
    total = np.zeros((*place.shape[:2], image.shape[2]), np.float32)
    weights = np.zeros(place.shape[:2], np.float32)
    for tap in range(4):
        dx, dy = tap & 1, tap >> 1
        weight = (part[..., 0] if dx else 1 - part[..., 0]) * (part[..., 1] if dy else 1 - part[..., 1])
        if mask is not None:
            weight = weight * mask[tap]
        y, x = np.clip(low[..., 1] + dy, 0, height - 1), np.clip(low[..., 0] + dx, 0, width - 1)
        total += weight[..., None] * image[y, x]
        weights += weight
    return total / np.maximum(weights, 1e-6)[..., None], weights


def sample_sharp(image: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return cubic samples (Catmull-Rom), within the range of the four nearest taps, the border repeated: (h, w, C)
    float32."""
    height, width = image.shape[:2]
    finite = np.where(np.isfinite(place), place, -1e6) - np.float32(0.5)
    low = np.floor(finite).astype(np.int64)
    t = (finite - low).astype(np.float32)
    one = np.stack([-t + 2 * t**2 - t**3, 2 - 5 * t**2 + 3 * t**3, t + 4 * t**2 - 3 * t**3, t**3 - t**2]) / 2
    total = np.zeros((*place.shape[:2], image.shape[2]), np.float32)
    least, most = np.full_like(total, np.inf), np.full_like(total, -np.inf)
    for k in range(16):
        dx, dy = k & 3, k >> 2
        y, x = np.clip(low[..., 1] + dy - 1, 0, height - 1), np.clip(low[..., 0] + dx - 1, 0, width - 1)
        value = image[y, x]
        total += (one[dx, ..., 0] * one[dy, ..., 1])[..., None] * value
        if dx in (1, 2) and dy in (1, 2):
            least, most = np.minimum(least, value), np.maximum(most, value)
    return np.clip(total, least, most)


def taps(image: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return the four neighbors (4, h, w) of `place` in `image` (H, W), in reading order, the border repeated."""
    height, width = image.shape
    low = np.floor(np.where(np.isfinite(place), place, -1e6) - 0.5).astype(np.int64)
    return np.stack(
        [
            image[np.clip(low[..., 1] + (t >> 1), 0, height - 1), np.clip(low[..., 0] + (t & 1), 0, width - 1)]
            for t in range(4)
        ]
    )


def splat(place: np.ndarray, depth: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Carry `values` (H, W, C) of every pixel to `place` (H, W, 2), onto the four pixels around. The nearest `depth`
    (H, W) wins; surfaces within 5% of it are mixed by their share of the pixel. Return (H, W, C) float32, and (H, W)
    bool of the pixels reached."""
    height, width = depth.shape
    finite = np.isfinite(place).all(-1) & ~np.isnan(depth)
    at, z, carried = place[finite] - np.float32(0.5), depth[finite].astype(np.float32), values[finite]
    z = np.minimum(z, np.float32(1e30))
    low = np.floor(np.clip(at, -2, (width + 1, height + 1))).astype(np.int64)
    part = at - low
    where, share, source = [], [], []
    for tap in range(4):
        dx, dy = tap & 1, tap >> 1
        x, y = low[:, 0] + dx, low[:, 1] + dy
        weight = (part[:, 0] if dx else 1 - part[:, 0]) * (part[:, 1] if dy else 1 - part[:, 1])
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height) & (weight > 0.02)
        where.append((y * width + x)[inside])
        share.append(weight[inside])
        source.append(np.nonzero(inside)[0])
    where, share, source = (np.concatenate(parts) for parts in (where, share, source))
    nearest = np.full(height * width, np.inf, np.float32)
    np.minimum.at(nearest, where, z[source])
    front = z[source] <= nearest[where] * np.float32(1 + _SAME_LAYER)
    where, share, source = where[front], share[front], source[front]
    weights = np.bincount(where, share, height * width)
    sums = [np.bincount(where, share * carried[source, c], height * width) for c in range(values.shape[2])]
    mixed = np.stack(sums, -1) / np.maximum(weights, 1e-9)[:, None]
    return mixed.reshape(height, width, -1).astype(np.float32), (weights > 0).reshape(height, width)


def filled(values: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return `values` (H, W, C) with those of the nearest known pixel where `known` (H, W) is not set."""
    if known.all() or not known.any():
        return values
    from scipy.ndimage import distance_transform_edt

    nearest: Any = distance_transform_edt(~known, return_distances=False, return_indices=True)
    y, x = nearest
    return values[y, x]


_GROUP = 64  # work-items of a work-group, in a row
_EVENTS = 64  # kept at most


class DeviceRunner:
    """A method at work on a device. `milliseconds` of the device per rendered frame with one new one; of pipelines with
    the network."""

    def __init__(self):
        self._submitted: float | None = None
        self.milliseconds: list[float] = []

    def submit(self, shot: Shot) -> None:
        """Take the next rendered frame, whose buffers may lie on the device."""
        self._submitted = None

    def finish(self) -> None:
        """Wait for the device. Its work since `submit` counts for each new frame."""
        taken = self._taken()
        self._submitted = taken if self._submitted is None else self._submitted

    def make(self, moment: Moment) -> np.ndarray:
        """Return the picture of a moment: (H, W, 3) linear."""
        color = self.color_of(self.extrapolated(moment))
        assert self._submitted is not None  # `finish` was called
        self.milliseconds.append(self._submitted + self._taken())
        return color

    def extrapolated(self, moment: Moment) -> Any:
        """Enqueue the work for a moment and return its frame on the device."""
        raise NotImplementedError

    def color_of(self, made: Any) -> np.ndarray:
        """Return the color of a frame from `extrapolated`: (H, W, 3) float16, linear."""
        raise NotImplementedError

    def _taken(self) -> float:
        """Wait for the device and return the milliseconds of its work since the last call."""
        raise NotImplementedError


class PipelineRunner(DeviceRunner):
    """The project's pipeline with the options of a method. `window`: rule of the rendering window; `knows_camera`:
    whether the new frame's camera is given."""

    def __init__(self, options: Options, window: str, knows_camera: bool, footage: Footage, device: Device):
        super().__init__()
        size, render_size = (footage.width, footage.height), footage.render_size(window)
        self.pipeline = Pipeline(device, *size, options, render_size=render_size, fps=footage.fps)
        self.pipeline.exposure = footage.exposure
        self._known = knows_camera

    def submit(self, shot: Shot) -> None:
        super().submit(shot)
        self.pipeline.submit(shot.frame)

    def present(self) -> np.ndarray:
        """Return the displayed rendered frame; windows make it a little softer."""
        return self.pipeline.present().numpy("color")

    def extrapolated(self, moment: Moment) -> ExtrapolatedFrame:
        return self.pipeline.extrapolate(moment.camera if self._known else None, moment.time)

    def color_of(self, made: ExtrapolatedFrame) -> np.ndarray:
        return made.numpy("color")

    def _taken(self) -> float:
        return sum(self.pipeline.take_timings().values())


class DilateSplat(DeviceRunner):
    """Continues motion vectors of t at constant speed, in the manner of Mob-FGSR (Yang et al., SIGGRAPH 2024): see
    `kernels/baselines/dilate_splat.cl`. `int64`: whether kernels use 64-bit atomics (None: where the
    device has them); results have the same bits without. Frames of NumPy arrays are uploaded when they are
    submitted."""

    def __init__(self, footage: Footage, device: Device, int64: bool | None = None):
        super().__init__()
        int64 = device.int64_atomics if int64 is None else int64
        self._device, self._width, self._height = device, footage.width, footage.height
        self._program = build(device, "baselines/dilate_splat", **({"INT64_ATOMICS": 1} if int64 else {}))
        self._passes = 1 if int64 else 2
        pixels = self._width * self._height
        self._offers = [device.buffer(8 * pixels)] if int64 else [device.buffer(4 * pixels) for _ in range(2)]
        self._color = device.buffer(8 * pixels)
        self._events: deque[cl.Event] = deque(maxlen=_EVENTS)

    def submit(self, shot: Shot) -> None:
        super().submit(shot)
        on_device = isinstance(shot.frame.color, cl.Buffer)
        self._frame = shot.frame if on_device else uploaded(self._device, shot.frame)

    def extrapolated(self, moment: Moment) -> cl.Buffer:
        """Enqueue the work for a moment and return the buffer of its color, half ×4; it holds until the next call."""
        frame = self._frame
        values = {"width": self._width, "height": self._height, "alpha": moment.alpha}
        values |= {"depth": frame.depth, "motion": frame.motion, "color": frame.color, "out_color": self._color}
        values |= {"keys": self._offers[0], "winners": self._offers[-1]}
        for buffer in self._offers:
            self._events.append(cl.enqueue_fill_buffer(self._device.queue, buffer, b"\xff", 0, buffer.size))
        for number in range(self._passes):
            self._launch("splat", values | {"pass": number})
        self._launch("warp", values)
        return self._color

    def color_of(self, made: cl.Buffer) -> np.ndarray:
        color = np.empty((self._height, self._width, 4), np.float16)
        cl.enqueue_copy(self._device.queue, color, made)
        return color[..., :3]

    def _launch(self, kernel: str, values: dict) -> None:
        columns = -(-self._width // (self._device.lanes * _GROUP)) * _GROUP
        size, group = (columns, self._height), (_GROUP, 1)
        self._events.append(self._program.launch(self._device.queue, kernel, size, group, values))

    def _taken(self) -> float:
        self._device.queue.finish()
        events = list(self._events)
        self._events.clear()
        return sum(event.profile.end - event.profile.start for event in events) * 1e-6


FULL = "gffe"
DILATE_SPLAT = "dilate-splat"
GIVEN = "given"  # rendered frames as the sequence has them


class Runner(Protocol):
    """A method at work on one sequence."""

    def submit(self, shot: Shot) -> None:
        """Take the next rendered frame."""
        ...

    def make(self, moment: Moment) -> np.ndarray:
        """Return the picture of a moment after it: (H, W, 3) linear."""
        ...


@dataclass(frozen=True)
class Method:
    """One row of the table.

    Attributes
    ----------
    name, title : on the command line and in JSON; for people
    group : "gffe", "preset", "ablation", "deviation" (a deviation from the paper, switched to the paper's way) or
        "baseline"
    options : of the pipeline, if it is one
    window : window of its rendered frames, as of `Footage.shots`
    camera : False: the pipeline predicts the camera of the new frame
    needs : "guide" (G-buffers of the new frame), "following" (the next rendered frame), "windows" (built-in scenes)
    package : module that must be importable, and the extra that brings it
    model : of the ONNX contract
    make : footage → Runner, where it works on the host
    on_device : footage, device → DeviceRunner, where it has kernels of its own
    """

    name: str
    title: str
    group: str
    options: Options | None = None
    window: str = "off"
    camera: bool = True
    needs: frozenset[str] = frozenset()
    package: tuple[str, str] | None = None
    model: Path | None = None
    make: Callable[[Footage], Runner] | None = None
    on_device: Callable[[Footage, Device], DeviceRunner] | None = None

    def missing(self, footage: Subject | Footage) -> str | None:
        """Return why the method cannot be run on `footage`; None if it can."""
        if self.package and importlib.util.find_spec(self.package[0]) is None:
            return f"needs {self.package[0]}: {how_to_install(self.package[1])}"
        if "guide" in self.needs and not footage.exact:
            return "needs G-buffers of the new frames, which only exact built-in scenes have"
        if "windows" in self.needs and not footage.exact:
            return "windows can be chosen for exact built-in scenes only"
        return None

    def identity(self) -> dict:
        """Return the identity of the computation for the cache, besides the sources of the program."""
        known = {"name": self.name, "window": self.window, "camera": self.camera}
        if self.options:
            known["options"] = asdict(self.options)
            if self.options.corrects_shading:
                weights = Path(self.options.scn_model) if self.options.scn_model else inference.default_model()
                assert weights is not None  # the package's own
                known["weights"] = inference.digest_of_weights(weights)
        if self.model:
            known["model"] = hashlib.sha256(self.model.read_bytes()).hexdigest()
        return known

    def runner(self, footage: Footage, device: Device) -> Runner:
        """Return a runner at the start of a sequence. Raises GffeError."""
        if self.options is not None:
            return PipelineRunner(self.options, self.window, self.camera, footage, device)
        if self.on_device is not None:
            return self.on_device(footage, device)
        assert self.make is not None
        return self.make(footage)


def _gffe(name: str, title: str, group: str, window: str = GIVEN, camera: bool = True, **options) -> Method:
    needs = frozenset() if window in (GIVEN, "off") else frozenset({"windows"})
    return Method(name, title, group, Options(**options), window, camera, needs)


def _baseline(name: str, title: str, make: Callable[[Footage], Runner], *needs: str) -> Method:
    return Method(name, title, "baseline", needs=frozenset(needs), make=make)


_PAPERS_WAY = {
    "resampling": "linear",
    "sharpness": False,
    "crack_closing": False,
    "blocks": False,
    "lattices": False,
    "camera_fixed": False,
    "entering": False,
    "acceleration": False,
    "hidden_parts": False,
    "hole_filling": "downsample",
    "soft_silhouettes": False,
}

_ALL = (
    _gffe(FULL, "GFFE", "gffe"),
    *(_gffe(name, f"preset {name}", "preset", **PRESETS[name].values) for name in ("quality", "performance")),
    _gffe("no-motion", "no motion estimation", "ablation", motion=False),
    _gffe("order-2", "prediction of order 2", "ablation", history=3, order=2),
    _gffe("order-5", "prediction of order 5", "ablation", history=6, order=5),
    _gffe("no-background", "no background", "ablation", levels=0),
    _gffe("levels-2", "two levels of background: what static surfaces hide, too", "ablation", levels=2),
    _gffe("adaptive-window", "adaptive rendering window", "ablation", "adaptive"),
    _gffe("fixed-window", "fixed rendering window, 1.2 times", "ablation", "fixed:1.2"),
    _gffe("no-scn", "no shading correction", "ablation", shading_correction=False),
    _gffe("no-focus-mask", "no focus mask", "ablation", focus_mask=False),
    _gffe("predicted-camera", "camera of the new frame predicted", "ablation", camera=False),
    _gffe("single-pixel-splats", "fragments are single pixels", "deviation", crack_closing=False, blocks=False),
    _gffe("no-entering", "movers that enter stay where they are", "deviation", entering=False),
    _gffe("constant-speed", "movers keep their speed", "deviation", acceleration=False),
    _gffe("background-only", "holes are never a mover's", "deviation", hidden_parts=False),
    _gffe("no-reappearing", "movers that come out from behind bars lose their front", "deviation", reappearing=False),
    _gffe("downsampled-holes", "holes from the image downsampled 32×", "deviation", hole_filling="downsample"),
    _gffe("hard-silhouettes", "silhouettes as the warp leaves them", "deviation", soft_silhouettes=False),
    _gffe("linear-camera", "camera predicted along a line", "deviation", camera=False, camera_order=1),
    _gffe("papers-way", "all of these the paper's way", "deviation", **_PAPERS_WAY),
    _baseline("repeat", "repeat the last frame", lambda footage: Repeat()),
    _gffe(
        "static-reprojection",
        "static reprojection (depth and camera only)",
        "baseline",
        "off",
        motion=False,
        levels=0,
        hole_filling="downsample",
        soft_silhouettes=False,
        shading_correction=False,
        overlays=False,
    ),
    Method(
        "flow",
        "optical flow (DIS), extrapolated",
        "baseline",
        package=("cv2", "opencv"),
        make=lambda footage: OpticalFlow(footage.exposure),
    ),
    _baseline("motion-vectors", "motion vectors in image space, linear", lambda footage: MotionVectors(1)),
    _baseline("motion-vectors-2", "motion vectors in image space, quadratic", lambda footage: MotionVectors(2)),
    Method(
        DILATE_SPLAT, "motion vectors, dilated and splatted, bilinear, in OpenCL", "baseline", on_device=DilateSplat
    ),
    _baseline(
        "guided",
        "extrapolation guided by G-buffers of the new frame",
        lambda footage: GuidedExtrapolation(),
        "guide",
    ),
    _baseline(
        "interpolation",
        "interpolation with the next frame (adds latency)",
        lambda footage: Interpolation(),
        "following",
    ),
)
METHODS: dict[str, Method] = {method.name: method for method in _ALL}
GROUPS = tuple(dict.fromkeys(method.group for method in _ALL))


@dataclass(frozen=True)
class Gain:
    """Gain of a part of the method: the rows `with_it` and `without`, the region that it is for, and the name of the
    paper's row without it."""

    title: str
    with_it: str
    without: str
    region: str
    paper: str = ""


GAINS = (
    Gain("motion estimation", FULL, "no-motion", "dynamic", "w/o ME"),
    Gain("background collection", FULL, "no-background", "dynamic disocclusion", "w/o BGC"),
    Gain("adaptive window", "adaptive-window", FULL, "out of screen", "w/o AW"),
    Gain("shading correction", FULL, "no-scn", "focus", "w/o SCN"),
    Gain("focus mask", FULL, "no-focus-mask", "rest", "w/o FM"),
    Gain("linear prediction, against order 5", FULL, "order-5", "dynamic"),
    Gain("background behind static surfaces", "levels-2", FULL, "static disocclusion"),
    Gain("fragments cover what they map to", FULL, "single-pixel-splats", "rest"),
    Gain("acceleration of movers", FULL, "constant-speed", "dynamic"),
    Gain("hidden parts of movers", FULL, "background-only", "static disocclusion"),
    Gain("holes continue their far side", FULL, "downsampled-holes", "static disocclusion"),
    Gain("soft silhouettes", FULL, "hard-silhouettes", "silhouettes"),
)


def onnx_method(name: str, path: str | Path) -> Method:
    """Return a method that runs a network of the contract of `OnnxModel`. Raises GffeError."""
    if not name or name in METHODS:
        raise GffeError(f"--onnx {name}={path}: the name is empty or a method's own (expected another one)")
    model = OnnxModel(path)
    needs = frozenset({"following"}) if model.interpolates else frozenset()
    title = f"{name} (ONNX{', adds latency' if needs else ''})"
    return Method(
        name,
        title,
        "baseline",
        needs=needs,
        model=Path(path),
        make=lambda footage: OnnxRunner(model, footage.exposure),
    )


def chosen_methods(
    words: Iterable[str] | None,
    onnx: Iterable[str] = (),
    network: tuple[str | None, str | None] = (None, None),
) -> dict[str, Method]:
    """Return methods and groups by name (None: all of them), and networks as "NAME=FILE", in the order of the table;
    rows of the shading correction network only where there are weights. `network`: file (None: the package's own) and
    execution provider of that. Raises GffeError."""
    networks = {}
    for text in onnx:
        name, equals, path = text.partition("=")
        if not equals:
            raise GffeError(f"--onnx {text}: expected NAME=FILE")
        networks[name] = onnx_method(name, path)
    known = METHODS | networks
    wanted = set(known) if words is None else set()
    for word in words or ():
        found = {word} if word in known else {name for name, method in known.items() if method.group == word}
        if not found:
            raise GffeError(f"--methods: '{word}' is none of {', '.join((*GROUPS, *known))}")
        wanted |= found
    wanted |= set(networks)
    if network[0] is None and inference.default_model() is None:
        wanted -= {"no-scn", "no-focus-mask"}
    return {name: _with_network(method, *network) for name, method in known.items() if name in wanted}


def _with_network(method: Method, model: str | None, provider: str | None) -> Method:
    """Return the method with another shading correction network or provider, where it has a network."""
    options = method.options
    if options is None or options.shading_correction is False or (model is None and provider == options.scn_provider):
        return method
    corrects = True if model else options.shading_correction
    return replace(
        method, options=replace(options, shading_correction=corrects, scn_model=model, scn_provider=provider)
    )
