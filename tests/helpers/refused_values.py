"""One table of values that Python and the exported C refuse alike, and the calls that are given them."""

import ctypes as ct
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from exported import INVALID, MOTION_UNITS, Engine, Failed, c_camera, c_format

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.frame_format import CAMERA_MOTIONS, TYPES, FrameFormat
from gffe_cl.engine.pipeline.pipeline import Pipeline

NAN, INF = math.nan, math.inf
NONE = (NAN, INF, -INF, 1e300, -1e300, 1e308, -1e308)  # no finite numbers, to us
NO_RATE = (*NONE, 0.0, -1.0, 1e-7, 1.1e6)
NO_SIDE = (*NONE, 0.0, -1.0, 1e-10, 1.1e9)


@dataclass(frozen=True)
class Refused:
    """Field `name` of a call (`Calls`), as C has it, with values that are refused and some that are not."""

    call: str
    name: str
    bad: tuple
    good: tuple = ()
    base: dict = field(default_factory=dict)  # other fields of a `FrameFormat`

    def __str__(self):
        return f"{self.call}-{self.name}" + "".join(f"-{value}" for value in self.base.values())


DEVICE = {"depth": "device", "near_z": 0.1, "far_z": 100.0}
LOGARITHMIC = {"depth": "logarithmic", "near_z": 0.1, "far_z": 100.0}
MOVERS = {"camera_motion": "movers_only", "motion_invalid": 0.0}
PAIRS = (
    ("depth_range", 0, (1.0,), (0.5, -1.0)),
    ("depth_range", 1, (0.0,), (0.5, -1.0)),
    *(("motion_scale", k, (0.0, -0.0), (-2.0, 1e-300)) for k in range(2)),
    *(("motion_offset", k, (), (0.0, -3.0)) for k in range(2)),
)
TABLE = (
    # gffe_set_format
    Refused("format", "near_z", (*NONE, 1.0), (0.0, -5.0, 1e299)),
    Refused("format", "far_z", (*NONE, 0.0), (1.0, -5.0, 1e299)),
    Refused("format", "near_z", (NAN, -INF, 1e300, 1e308, 0.0, -1.0, 100.0), (0.5, 200.0, INF), DEVICE),
    Refused("format", "far_z", (NAN, -INF, 1e300, 1e308, 0.0, -1.0, 0.1), (0.5, 0.01, INF), DEVICE),
    Refused("format", "near_z", (INF, NAN), (1.0,), DEVICE | {"far_z": INF}),
    Refused("format", "near_z", (NAN, INF, -1.0, 100.0, 1e-30), (0.0, 0.5, 200.0), LOGARITHMIC),
    *(Refused("format", f"{name}[{k}]", (*NONE, *bad), good) for name, k, bad, good in PAIRS),
    Refused("format", "motion_invalid", NONE[1:], (NAN, 0.0, -1.0, 1e299)),  # NAN: there is none
    Refused("format", "motion_invalid", NONE, (0.0, 1.0), MOVERS),
    Refused("format", "color_type", (0, 5, 6, 7, -1, 2**31 - 1), (1, 2, 3, 4)),
    Refused("format", "depth_type", (0, 2, 3, 5, 7, -1, -(2**31)), (1, 4, 6)),
    Refused("format", "motion_type", (0, 3, 6, 7, -1, 99), (1, 2, 4, 5)),
    Refused("format", "color_channels", (0, 1, 2, 5, -1, 2**31 - 1), (3, 4)),
    Refused("format", "motion_channels", (0, 1, 5, -1, -(2**31)), (2, 3, 4)),
    Refused("format", "motion_unit", (-1, 4, 2**31 - 1), (0, 1, 2, 3)),
    Refused("format", "camera_motion", (1, 3, -1, 2**31 - 1), (0, 2)),
    Refused("format", "geometry_width", (-1, 0, 1, 1000, 2**31 - 1, -(2**31)), (40, 83)),
    Refused("format", "geometry_height", (-1, 0, 1, 1000, 2**31 - 1, -(2**31)), (40, 61)),
    # gffe_camera
    *(Refused("camera", name, (*NO_SIDE,), (1e-9, 60.0, 1e9)) for name in ("fx", "fy")),
    *(Refused("camera", name, (*NONE, 1.1e9, -1.1e9), (0.0, -5.0, 1e9)) for name in ("cx", "cy")),
    *(Refused("camera", f"world_to_view[{5 * k}]", (*NONE, 0.0, 1.002, 2.0), (1.0, -1.0, 1.0004)) for k in range(3)),
    *(Refused("camera", f"world_to_view[{4 * k + 3}]", (*NONE, 1.1e15, -1.1e15), (0.0, -3.0, 1e15)) for k in range(3)),
    *(Refused("camera", f"world_to_view[{k}]", (*NONE, 1e-6, 1.0), (0.0, 1e-10)) for k in range(12, 15)),
    Refused("camera", "world_to_view[15]", (*NONE, 0.0, 2.0), (1.0,)),
    # gffe_options
    *(Refused("options", name, (0, -1, 2**31 - 1, -(2**31))) for name in ("width", "height")),
    *(Refused("options", name, (0, -1, 2**31 - 1, -(2**31))) for name in ("render_width", "render_height")),
    Refused("options", "fps", NO_RATE, (1e-6, 30.0, 1e6)),
    # numbers of other calls
    Refused("jitter", "x", (*NONE, 16.1, -17.0), (0.0, -0.5, 16.0)),
    Refused("jitter", "y", (*NONE, 16.1, -17.0), (0.0, -0.5, 16.0)),
    Refused("exposure", "exposure", NO_RATE, (1e-6, 1.0, 1e6)),
    Refused("submit", "time", NONE, (-1e299, 0.0, 5.0)),
    Refused("extrapolate", "time", (*NONE, -1.0, 1e6), (0.0, 0.1, 3.0)),
)


def _put(target: Any, name: str, value: Any) -> Any:
    """Set a field of a structure or array, "fx" or "depth_range[1]", and return `target`."""
    name, _, place = name.partition("[")
    if place:
        getattr(target, name)[int(place[:-1])] = value
    else:
        setattr(target, name, value)
    return target


class Calls:
    """Calls of Python and of C, by name: each takes the name of a field, its value and other fields, and raises what it
    refuses. `frame` has device buffers."""

    def __init__(self, engine: Engine, pipeline: Pipeline, frame: Any):
        self.engine, self.pipeline, self.frame = engine, pipeline, frame
        self.camera = Camera(np.eye(4), 80.0, 80.0, 41.5, 30.5)

    def python(self, row: Refused, value: Any) -> None:
        self._of("_python", row.call)(row.name, value, row.base)

    def c(self, row: Refused, value: Any) -> None:
        self._of("_c", row.call)(row.name, value, row.base)

    def _of(self, side: str, call: str) -> Callable:
        return getattr(self, f"{side}_{call.replace(' ', '_')}")

    def _require_none(self, fault: bytes | None) -> None:
        if fault is not None:
            raise Failed(INVALID, fault.decode())

    # ---- formats ---------------------------------------------------------------------------------------

    def _python_format(self, name, value, base):
        if name.startswith("geometry"):
            size = (value, 40) if name.endswith("width") else (40, value)
            self.pipeline.format = FrameFormat(**base, geometry_size=size)
            return
        name, _, place = name.partition("[")
        if name.endswith("_type"):
            value = dict(enumerate(TYPES, 1)).get(value, "none")
        elif name in ("motion_unit", "camera_motion"):
            value = dict(enumerate(MOTION_UNITS if name == "motion_unit" else CAMERA_MOTIONS)).get(value, "none")
        elif name == "motion_invalid" and math.isnan(value):
            value = None
        elif place:
            pair = list(getattr(FrameFormat(), name))
            pair[int(place[:-1])] = value
            value = tuple(pair)
        self.pipeline.format = FrameFormat(**base | {name: value})

    def _c_format(self, name, value, base):
        made = c_format(FrameFormat(**base))
        if name.startswith("geometry"):
            made.geometry_width = made.geometry_height = 40
        self.engine.set_format(_put(made, name, value))

    def _python_jitter(self, name, value, base):
        jitter = (value, 0.0) if name == "x" else (0.0, value)
        self.pipeline.format = None
        self.pipeline.submit(replace(self.frame, geometry_jitter=jitter, reset=True))

    def _c_jitter(self, name, value, base):
        self.engine.set_format(None, (value, 0.0) if name == "x" else (0.0, value))
        self.engine.set_format(None)

    # ---- cameras ---------------------------------------------------------------------------

    def _python_camera(self, name, value, base):
        name, _, place = name.partition("[")
        if place:
            matrix = np.eye(4)
            matrix.flat[int(place[:-1])] = value
            value = matrix
        replace(self.camera, **{name: value})

    def _c_camera(self, name, value, base):
        made = _put(c_camera(self.camera), name, value)
        self._require_none(self.engine.library.gffe_camera_fault(ct.byref(made)))

    # ---- pipelines -------------------------------------------------------------------------------------

    def _options(self, name, value):
        """Return the results of a call with sizes and rate, with one of them changed."""
        given = {"width": 83, "height": 61, "render_width": 40, "render_height": 30, "fps": 30.0}
        return given | {name: value}

    def _python_options(self, name, value, base):
        given = self._options(name, value)
        render = given["render_width"], given["render_height"]
        Pipeline(
            self.pipeline.device,
            given["width"],
            given["height"],
            self.pipeline.options,
            render_size=render,
            fps=given["fps"],
        )

    def _c_options(self, name, value, base):
        given = self._options(name, value)
        size = given.pop("width"), given.pop("height")
        try:  # what is wrong for certain is looked at last: nothing is built
            Engine(self.engine.library, self.engine.device, *size, lanes=3, **given)
        except Failed as refused:
            if "lanes" not in str(refused):
                raise

    def _python_exposure(self, name, value, base):
        self.pipeline.exposure = value

    def _c_exposure(self, name, value, base):
        self.engine.set_exposure(value)

    def _python_submit(self, name, value, base):
        self.pipeline.format = None
        self.pipeline.submit(replace(self.frame, time=value, reset=True))

    def _c_submit(self, name, value, base):
        frame = self.frame
        self.engine.set_format(None)
        self.engine.submit((frame.color, frame.depth, frame.motion), frame.camera, value, frame.display_camera, True)

    def _at_zero(self):
        """Submit a frame of time 0 to both pipelines."""
        self._python_submit("time", 0.0, {})
        self._c_submit("time", 0.0, {})

    def _python_extrapolate(self, name, value, base):
        self._at_zero()
        self.pipeline.extrapolate(self.camera, value)

    def _c_extrapolate(self, name, value, base):
        self._at_zero()
        self.engine.extrapolate(value, self.camera)


def refusal(call: Callable, *arguments: Any) -> str:
    """Return the message with which a call refuses its arguments, "" if it takes them."""
    try:
        call(*arguments)
    except (GffeError, Failed) as refused:
        return str(refused) or "refused without a word"
    return ""
