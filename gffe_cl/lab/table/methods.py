"""Methods of the table, and how each is run: our pipeline, the cheapest method that moves motion vectors with a depth
test on the same runtime, and baselines."""

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
from gffe_cl.engine.inference import network as inference
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.opencl.program import build
from gffe_cl.engine.options import PRESETS, Options
from gffe_cl.engine.pipeline.made_frame import ExtrapolatedFrame
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.timing.footage import uploaded
from gffe_cl.lab.table import baselines
from gffe_cl.lab.table.footage import Footage, Moment, Shot, Subject

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
    _baseline("repeat", "repeat the last frame", lambda footage: baselines.Repeat()),
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
        make=lambda footage: baselines.OpticalFlow(footage.exposure),
    ),
    _baseline("motion-vectors", "motion vectors in image space, linear", lambda footage: baselines.MotionVectors(1)),
    _baseline(
        "motion-vectors-2", "motion vectors in image space, quadratic", lambda footage: baselines.MotionVectors(2)
    ),
    Method(
        DILATE_SPLAT, "motion vectors, dilated and splatted, bilinear, in OpenCL", "baseline", on_device=DilateSplat
    ),
    _baseline(
        "guided",
        "extrapolation guided by G-buffers of the new frame",
        lambda footage: baselines.GuidedExtrapolation(),
        "guide",
    ),
    _baseline(
        "interpolation",
        "interpolation with the next frame (adds latency)",
        lambda footage: baselines.Interpolation(),
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
    model = baselines.OnnxModel(path)
    needs = frozenset({"following"}) if model.interpolates else frozenset()
    title = f"{name} (ONNX{', adds latency' if needs else ''})"
    return Method(
        name,
        title,
        "baseline",
        needs=needs,
        model=Path(path),
        make=lambda footage: baselines.OnnxRunner(model, footage.exposure),
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
