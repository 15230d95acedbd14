"""Wrong calls of the Python interface, from one table: every public call gets a right value for each parameter, then
values of other kinds in place of one of them, which it must refuse, and any values, made by hypothesis. All ends well
or in a GffeError of one line. What is as good as a right value must be taken: NumPy's numbers, read-only and strided
arrays."""

import copy
import inspect
import pickle
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import timedelta
from decimal import Decimal
from pathlib import Path
from types import FunctionType

import numpy as np
import pyopencl as cl
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from synthetic import camera
from tiny_frames import H, W, frames

import gffe_cl
from gffe_cl import (
    FrameEntry,
    FrameFormat,
    GffeError,
    Options,
    Overlays,
    Pacer,
    Pipeline,
    RenderedFrame,
    SequenceWriter,
    Window,
)
from gffe_cl.captures.sequence.description import checked_entry
from gffe_cl.engine.core.errors import MOST
from gffe_cl.engine.options import OPTIONS

CAMERA, TURNED = camera(W, H), camera(W, H, (0.1, 0, 0), yaw=0.2)
PROJECTION = CAMERA.projection_matrix("opengl", W, H, near=0.1)
DEPTH = np.full((H, W), 4.0, np.float32)
MOTION = np.zeros((H, W, 2), np.float32)
COLOR = np.full((H, W, 3), 0.5, np.float16)
FRAME = RenderedFrame(COLOR, DEPTH, MOTION, CAMERA, 0.0, reset=True)
NEXT = replace(FRAME, time=1.0, reset=False)
SETTINGS = settings(
    max_examples=150, deadline=None, database=None, derandomize=True, suppress_health_check=list(HealthCheck)
)
HUGE = 1 << 20, 1 << 20  # pixels, which no memory holds; they are views of a single number

# Right values by the names of parameters that have no default or None; "Call.parameter" is for one call.
GOOD = {
    **{"world_to_view": np.eye(4), "fx": 20.0, "fy": 20.0, "cx": 12.0, "cy": 8.0, "fov": 60.0},
    **{"position": (0, 0, 0), "target": (0, 0, 1), "up": (0, 1, 0), "direction": (0, 0, 1), "offset": np.ones(3)},
    **{"view": CAMERA.view_matrix("opengl"), "projection": PROJECTION, "size": (W, H), "width": W, "height": H},
    **{"location": (0, 0, 0), "rotation": (1, 2, 3), "world_pos": np.ones((5, 3)), "px": np.ones((5, 2))},
    **{"Camera.unproject.depth": np.ones(5), "api": "opengl", "near": 0.5, "far": 9.0, "scale_x": 2.0, "scale_y": 2.0},
    **{"camera": CAMERA, "other": CAMERA, "current": CAMERA, "display": CAMERA, "predicted": [CAMERA], "alpha": 0.5},
    **{"predict_camera.previous": TURNED, "cameras": [CAMERA, TURNED, CAMERA], "times": [2.0, 1.0, 0.0], "order": 2},
    **{"predict_camera_at.time": 3.0, "z": DEPTH / 8, "distance": DEPTH, "rg": MOTION, "a": COLOR, "b": COLOR},
    **{"mask": DEPTH, "color": COLOR, "depth": DEPTH, "motion": MOTION, "overlays": Overlays(), "factor": 1.25},
    **{"motion_invalid": 1.0, "color_size": (W, H), "geometry_size": (W, H), "given": {"far_z": 2}},
    **{"renderSize": (W, H), "displaySize": (W, H), "cameraNear": 0.5, "cameraFar": 9.0, "FrameFormat.fsr3.flags": 8},
    **{"mvecScale": (1, 1), "depthInverted": True, "motionVectorsInvalidValue": 1.0, "initFlags": 8, "layerFlags": 1},
    **{"projectionMatrix": CAMERA.projection_matrix("direct3d", W, H, 0.5), "nearZ": 9.0, "farZ": 0.5},
    **{"Options.changed.name": "levels", "value": 1, "Options.preset.name": "performance", "text": "halton:8"},
    **{"number": 3, "display_rate": 60.0, "now": 0.2, "frames": [FRAME, NEXT], "render_size": (W, H), "fps": 30.0},
    **{"time": 0.0, "kind": "rendered", "names": ["R"], "SequenceWriter.folder.name": "stages", "frame": NEXT},
    **{"previous": FRAME, "nbytes": 16, "shape": (3, 4), "dtype": np.float32, "Pipeline.extrapolate.time": 2.0},
    **{"Pipeline.keep.names": ["warp.color"], "path": "good", "folder": "seen", "ahead": 2},
}  # fmt: skip
# What needs a device, and what a fake driver (tests/engine/opencl/test_memory_sharing.py); plain records, checked where
# they are used; what is made by others only.
ON_A_DEVICE = {"Pipeline", "Device", "present", "record", "sharing_support"}
WITH_A_FAKE_DRIVER = {"MemorySharing"}
RECORDS = {"SharingSupport", "DeviceInfo", "BadPixels", "Overlays", "RenderedFrame", "FrameEntry", "Window"}
MADE_BY_OTHERS = {"Device", "ExtrapolatedFrame", "PresentedFrame", "Sequence", "GffeError"}

NO_NUMBERS = (
    "1", b"1", float("nan"), 1j, 10**400, 10**5000, 1e308, [], {}, object(), np.array(None), np.zeros(3),
    np.timedelta64(3, "ns"), np.timedelta64("NaT"), np.datetime64(3, "ns"), timedelta(1), Decimal(1), CAMERA, True,
)  # fmt: skip
NO_ARRAYS = (
    1, "a", b"a", object(), {}, [[1], [1, 2]], np.array(["a"]), np.zeros(3, complex), CAMERA, np.ones((1, 2, 3, 4)),
    np.array("now", "M8[s]"), np.zeros(3, "i4, f4"), np.broadcast_to(np.uint8(1), (*HUGE, 4)),
)  # fmt: skip
NO_OBJECTS = (1, 1.5, "a", b"a", 1j, {1: 2}, object(), np.zeros(3), Decimal(1), [object()], True, "a\0b", "x" * 5000)
# Values that must be refused, by the kind of the right value.
REFUSED = (
    (bool, (0, 1, "true", 1.0, [], np.zeros(2, bool), object())),
    (int, (*NO_NUMBERS, 1.5, float("inf"), -(2**70))),
    (float, NO_NUMBERS),
    (np.ndarray, NO_ARRAYS),
    (tuple, (*NO_ARRAYS, (1,), (1, None), (float("nan"), 1), range(9))),
    (object, NO_OBJECTS),
)
EYE, VIEW, SHEARED = np.eye(4), GOOD["view"], PROJECTION.copy()
SHEARED[0, 1] = 0.5
# Values of the right kind that must be refused, too.
OUT_OF_RANGE = {
    "Camera.world_to_view": (0 * EYE, 2 * EYE, np.nan * EYE, np.eye(3), EYE + np.eye(4, k=-3), 1e300 * EYE),
    **dict.fromkeys(("Camera.fx", "Camera.fy"), (0, -3.0, float("inf"), 1e10)), "Camera.cx": (float("inf"), 1e10),
    "Camera.from_opengl.view": (VIEW[:3], np.nan * VIEW, VIEW @ np.diag([1, 1, 3, 1]), VIEW + np.eye(4, k=-3)),
    "Camera.from_opengl.projection": (EYE, SHEARED, 0 * PROJECTION), "Camera.from_opengl.size": ((0, 3),),
    "Camera.from_opengl.layout": ("rows",), "motion_from_ndc.direction": ("next",), "motion_from_ndc.y": ("left",),
    "motion_from_uv.motion": (np.zeros((1, 1, 3)),), "Camera.from_unreal_pose.fov": (0.0, 180.0),
    "Camera.projection_matrix.near": (0.0, -1.0), "Camera.view_matrix.api": ("metal",),
    "predict_camera.alpha": (1e200, float("inf")), "fixed_window.factor": (0.5, float("nan"), 1e12),
    "adaptive_window.max_enlargement": (0.9,), "adaptive_window.distance": (0.0,), "adaptive_window.least": (-1.0,),
    "adaptive_window.size": ((0, 10), (5, float("nan"))), "adaptive_window.margin": (-100.0,),
    **dict.fromkeys(("Pacer.display_rate", "Pacer.fps", "Pacer.most_alpha"), (1e-300, 1e300, -1.0, 0.0)),
    **dict.fromkeys(("Pacer.rendered.time", "Pacer.plan.now", "Pacer.ready.now"), (1e13, -1e13, 1e300)),
    "Jitter.length": (0, 2000), "Jitter.parse.text": ("halton", "halton:1", "halton:x", "sobol:4", "halton:2000"),
    "FrameFormat.depth_range": ((0, 0),), "FrameFormat.depth_scale": (0.0,), "FrameFormat.rows": ("left",),
    "FrameFormat.color_encoding": ("gamma",), "FrameFormat.color_type": ("unorm24",),
    "FrameFormat.color_size": ((0, 5),), "Pipeline.submit, fields.color": (np.zeros((H, W, 3), np.uint8),),
    "FrameFormat.motion_unit": ("inches",), "FrameFormat.motion_scale": ((1, 0),), "FrameFormat.motion_channels": (1,),
    "FrameFormat.motion_invalid": (float("inf"),), "FrameFormat.geometry_size": ((5, 0),),
    "FrameFormat.camera_motion": ("some",), "FrameFormat.far_z": (float("inf"),),
}  # fmt: skip
# Parameters that take some of these, too: names, numbers of any size, arrays of any shape, what no user gives.
TAKEN = {
    "Camera.projection_matrix.width", "Camera.projection_matrix.height", "depth_from_device.z", "to_display.color",
    "FrameFormat.fsr3.flags", "FrameFormat.xess.initFlags", "FrameFormat.xess.motionVectorScaleX",
    "FrameFormat.xess.motionVectorScaleY", "FrameFormat.openxr.maxDepth", "FrameFormat.openxr.layerFlags",
    "Window.u0", "Window.v0", "Window.u1", "Window.v1", "Jitter.offset.number", "Jitter.camera.number",
    "Options.static_threshold", "Options.camera_order", "Options.shading_correction", "Options.scn_model",
    "Options.scn_provider", "SequenceWriter.path", "record.folder", "SequenceWriter.folder.name", "FrameEntry.file",
    "Device.empty.shape", "Pipeline.submit.wait_for", "Pipeline.present.wait_for",
    "Pipeline.extrapolate.wait_for", "FrameEntry.source", "FrameEntry.alpha",
    "named_channels.color",
}  # fmt: skip
# Others, which may be right.
ANY = st.one_of(
    st.sampled_from([
        None, -1, 0, 99, 2**63, 2**70, 1e299, float("inf"), "", "a b " * 25000, Path("x" * 5000), "a\ud800",
        print, FRAME, Options(), np.longdouble(2), [1, None], np.zeros((2, 0)), np.broadcast_to(np.float16(1), HUGE),
    ]),
    st.text(st.characters(exclude_characters="/."), max_size=9),
    st.recursive(st.none() | st.floats(), lambda one: st.lists(one, max_size=3), max_leaves=4),
    npst.arrays(npst.scalar_dtypes(), npst.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4)),
)  # fmt: skip


@dataclass
class Call:
    """`of` is called with `good`, and with a wrong value in place of each of its arguments."""

    of: object
    good: dict

    def alike(self):
        """Yield arguments that are as good, which must be taken."""
        for name, value in self.good.items():
            for other in alike(value):
                yield name, self.good | {name: other}

    def refused(self, call):
        """Yield name and value of arguments that must be refused by the call of this name."""
        for name, good in self.good.items():
            place = f"{call}.{name}"
            if place not in TAKEN:
                for value in next(values for kind, values in REFUSED if isinstance(good, kind)):
                    yield name, value
            for value in OUT_OF_RANGE.get(place, ()):
                yield name, value

    def extreme(self):
        """Yield name and value of arrays of numbers with which arithmetic fails."""
        for name, good in self.good.items():
            for value in extremes(good) if is_floats(good) else ():
                yield name, value

    def ends_in_one_line(self, name, value):
        """Return whether the value was refused."""
        try:
            self.of(**self.good | {name: value})
        except GffeError as error:
            assert "\n" not in str(error) and len(str(error)) <= MOST, f"not one line: {str(error)[:300]!r}"
            return True
        return False


def is_floats(value):
    return isinstance(value, np.ndarray) and value.dtype.kind == "f"


def alike(value):
    if isinstance(value, bool):
        return [np.bool_(value)]
    if isinstance(value, int):
        return [np.int16(value), np.array(value)]
    if isinstance(value, float) and np.isfinite(value):
        return [np.float64(value), np.array(value), np.float32(value)]
    if isinstance(value, np.ndarray) and value.size:
        strided, fixed = np.repeat(value, 2, axis=-1)[..., ::2], value.copy()
        fixed.setflags(write=False)
        return [strided, np.asfortranarray(value), fixed, value.astype(value.dtype.newbyteorder())]
    return []


def extremes(value):
    """Return arrays like `value` of numbers with which arithmetic fails."""
    return [
        np.where(np.arange(value.size).reshape(value.shape) % step, value, number).astype(dtype)
        for dtype in dict.fromkeys((value.dtype, np.dtype(float)))
        for ends in [np.finfo(dtype)]
        for number in (np.inf, -np.inf, np.nan, ends.max, ends.min, ends.smallest_normal)
        for step in (1, 3)
    ]


def public():
    """Yield name and function of all that can be called: functions, classes, their methods."""
    for name in gffe_cl.__all__:
        thing = getattr(gffe_cl, name)
        if callable(thing) and name not in MADE_BY_OTHERS | RECORDS:
            yield name, thing
        for member, value in vars(thing).items() if isinstance(thing, type) else ():
            function = value.__func__ if isinstance(value, classmethod) else value
            if not member.startswith("_") and isinstance(function, FunctionType):
                yield f"{name}.{member}", getattr(thing, member)


def call_of(name, function, instance):
    """Return the call of a public function, whose right values come from `GOOD` and defaults. Methods are those of
    `instance()`."""
    good = {}
    for parameter in inspect.signature(function).parameters.values():
        if parameter.name == "self" or parameter.kind == parameter.VAR_KEYWORD:
            continue
        default = None if parameter.default is parameter.empty else parameter.default
        usual = GOOD.get(parameter.name) if default is None else default
        good[parameter.name] = GOOD.get(f"{name}.{parameter.name}", usual)

    def of(**given):
        bound = function if instance is None else getattr(instance(), name.partition(".")[2])
        finish(bound(**given))

    return Call(of, good)


def finish(made):
    """Use up what a call has returned."""
    if isinstance(made, Iterator):
        list(made)
    elif hasattr(made, "close"):
        made.close()


def calls_of(instances, names, special):
    """Return the calls of the public functions and methods of `names`; `special` ones are as given."""
    found = {}
    for name, function in public():
        owner, _, method = name.partition(".")
        if owner in names and name not in special:
            of_instance = method and not inspect.ismethod(function)
            call = call_of(name, function, instances.get(owner) if of_instance else None)
            if call.good:
                found[name] = call
    return found | special


def host_calls(folder):
    """Return the calls of what needs no device, by name; sequences are in `folder`."""
    entry, second = (FrameEntry(f"{k}.exr", float(k), render_camera=CAMERA) for k in range(2))
    channels = gffe_cl.named_channels(COLOR, DEPTH, MOTION)
    with SequenceWriter(folder / "good", W, H, 30.0) as writer:
        writer.add(entry, channels)
    sequence, stored = gffe_cl.open_sequence(folder / "good"), folder / "good" / "0.exr"
    own = sequence.frames[0]
    GOOD.update({"entry": own, "entries": [own], "read": sequence.read})

    def paced():
        pacer = Pacer(60)
        pacer.rendered(0.0)
        pacer.plan(0.1)
        return pacer

    def written(method, **good):
        def of(**given):
            with SequenceWriter(folder / "written", W, H, 30.0) as writer:
                writer.add(entry, dict(channels))
                writer.finished = {second.file: second}  # as of a stopped run
                getattr(writer, method)(**given)

        return Call(of, good)

    def started(**given):
        with SequenceWriter(**given) as writer:
            writer.add(entry, dict(channels))

    def checked(**images):
        gffe_cl.check([replace(frame, **images) for frame in (FRAME, NEXT)])

    writing = {"path": folder / "written", "width": W, "height": H, "fps": 30.0, "exposure": 1.0, "threads": 2}
    writing |= {"generator": "gffe-cl", "compression": "zip", "format": FrameFormat()}
    edges = {"u0": -1.25, "v0": -1.25, "u1": 1.25, "v1": 1.25}
    instances = {
        **{"Camera": lambda: CAMERA, "Options": Options, "Jitter": lambda: gffe_cl.Jitter(8), "Pacer": paced},
        **{"Sequence": lambda: sequence, "Window": lambda: Window(-1.2, -1.2, 1.2, 1.2)},
    }
    special = {
        "Pacer.rendered": Call(lambda **given: Pacer(60).rendered(**given), {"time": 0.0, "reset": False}),
        "Options": Call(Options, {name: option.default for name, option in OPTIONS.items()}),
        "SequenceWriter": Call(started, writing),
        "SequenceWriter.add": written("add", entry=second, channels=channels, owned=False),
        "SequenceWriter.take_up": written("take_up", entry=second),
        "SequenceWriter.add_frame": written("add_frame", entry=second, frame=NEXT),
        "SequenceWriter.link": written("link", entry=second, source_path=stored),
        "SequenceWriter.folder": written("folder", name="stages"),
        # Not what makes them probe all devices.
        "list_devices": Call(lambda refresh: refresh is True or gffe_cl.list_devices(refresh), {"refresh": False}),
        "open_device": Call(lambda profiling: gffe_cl.open_device(None, profiling), {"profiling": False}),
        "FrameEntry": Call(lambda **fields: checked_entry(replace(entry, **fields)), dict(vars(entry))),
        "Window": Call(lambda **edges: Window(**edges).camera(CAMERA, (W, H)), edges),
        "check, pixels": Call(checked, {"color": COLOR, "depth": DEPTH, "motion": MOTION}),
    }
    own_names = {name.partition(".")[0] for name, _ in public()} - ON_A_DEVICE - WITH_A_FAKE_DRIVER
    return calls_of(instances, own_names, special)


def device_calls(pipeline, frame):
    """Return the calls of what needs a device, by name."""
    device, made = pipeline.device, pipeline.extrapolate()
    other = Pipeline(device, W, H, Options(shading_correction=False))
    nbytes = {"color": 8 * W * H, "depth": 4 * W * H, "motion": 8 * W * H}
    wait_for = [cl.enqueue_marker(device.queue)]
    layers = {"fixed_mask": DEPTH > 5, "effects_motion": MOTION}
    layers |= dict.fromkeys(("effects", "ui"), np.zeros((H, W, 4)))
    submitted = {name: getattr(frame, name) for name in ("color", "depth", "motion", "camera")}
    submitted |= {"time": 0.5, "display_camera": None, "reset": True, "overlays": None, "geometry_jitter": (0.1, 0.2)}
    GOOD.update(
        {
            "device": device,
            "options": other.options,
            "pipeline": other,
            "context": device.context,
            "queue": device.queue,
        }
    )
    GOOD.update({"Pipeline.submit.frame": frame, "wait_for": wait_for, "int64_atomics": False})
    GOOD.update({"present.frame": replace(frame, display_camera=CAMERA), "present.previous": frame})
    special = {
        "Pipeline.change_options": Call(other.change_options, {"options": other.options}),
        "Pipeline.exposure": Call(lambda value: setattr(pipeline, "exposure", value), {"value": 1.0}),
        "Pipeline.submit, fields": Call(lambda **fields: pipeline.submit(replace(frame, **fields)), submitted),
        "Pipeline.submit, overlays": Call(
            lambda **layers: pipeline.submit(replace(frame, overlays=Overlays(**layers))), layers
        ),
        "Pipeline.submit, device buffers": Call(
            lambda **buffers: pipeline.submit(replace(frame, **buffers)),
            {name: device.buffer(size) for name, size in nbytes.items()},
        ),
        "ExtrapolatedFrame.numpy": Call(made.numpy, {"name": "gae"}),
        "PresentedFrame.numpy": Call(pipeline.present().numpy, {"name": "depth"}),
        "ExtrapolatedFrame.dlpack": Call(made.dlpack, {"name": "color"}),
        "ExtrapolatedFrame.mapped": Call(lambda **given: made.mapped(**given).__enter__(), {"name": "gae"}),
    }
    return calls_of({"Pipeline": lambda: pipeline, "Device": lambda: device}, ON_A_DEVICE, special)


def check(calls):
    """Make calls rightly, with what is as good, and wrongly."""
    for name, call in calls.items():
        call.of(**call.good)
        with pytest.raises(TypeError):
            call.of(**call.good, colour=1)
        for argument, good in call.alike():
            try:
                call.of(**good)
            except Exception as error:
                pytest.fail(f"{name}: {argument}={good[argument]!r}, as good, raises {error!r}")
        for argument, value in call.refused(name):
            assert call.ends_in_one_line(argument, value), f"{name}: {argument}: a {type(value)} is taken"
        for argument, value in call.extreme():
            call.ends_in_one_line(argument, value)

    @SETTINGS
    @given(st.sampled_from([(name, argument) for name, call in calls.items() for argument in call.good]), ANY)
    def ends_in_one_line(place, value):
        calls[place[0]].ends_in_one_line(place[1], value)

    ends_in_one_line()


@pytest.mark.filterwarnings("error::RuntimeWarning")  # users would see NumPy's
def test_misuse_ends_in_one_line(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # some values are paths, from here
    calls = host_calls(tmp_path)
    del calls["check, pixels"]
    check(calls)


@pytest.mark.long
def test_misused_pixels_are_checked_without_a_traceback(tmp_path):
    check({"check": host_calls(tmp_path)["check, pixels"]})


def bits(pipeline):
    pipeline.exposure = 1.0
    pipeline.keep([])
    for frame in frames():
        pipeline.submit(frame)
    made = pipeline.extrapolate()
    return [made.numpy(name).tobytes() for name in ("color", "depth", "motion", "filled_by")]


@pytest.mark.filterwarnings("ignore:extrapolate. time")  # far ahead
def test_misuse_leaves_a_pipeline_that_works(device, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # some values are paths, from here
    pipeline = Pipeline(device, W, H, Options(shading_correction=False))
    right = bits(pipeline)
    check(device_calls(pipeline, next(frames())))
    assert bits(pipeline) == right


@pytest.mark.parametrize("double", [copy.copy, copy.deepcopy, pickle.dumps])
def test_objects_with_native_memory_have_no_copy(device, double):
    """The end of a copy would destroy the original."""
    pipeline = Pipeline(device, W, H, Options(shading_correction=False))
    pipeline.submit(next(frames()))
    for thing in (device, pipeline, pipeline.extrapolate(), pipeline.present()):
        with pytest.raises(GffeError, match="cannot be copied"):
            double(thing)
    pipeline.submit(replace(next(frames()), time=2.0))


def test_check_takes_what_submit_takes(device):
    pipeline = Pipeline(device, W, H, Options(shading_correction=False))
    pipeline.submit(FRAME)
    small = {"color": COLOR[1:], "depth": DEPTH[1:], "motion": MOTION[1:]}
    for wrong in ({"time": 0.0}, small, {"display_camera": TURNED}, {"motion": None}, {"depth": None}):
        frame = replace(NEXT, **wrong)
        for call in (lambda frame=frame: gffe_cl.check([FRAME, frame]), lambda frame=frame: pipeline.submit(frame)):
            with pytest.raises(GffeError):
                call()


@pytest.mark.device
def test_far_times_are_warned_of(device):
    """As of milliseconds, or of another clock; a frame is made nevertheless."""
    pipeline = Pipeline(device, W, H, Options(shading_correction=False))
    pipeline.submit(next(frames()))
    with pytest.warns(UserWarning, match=r"time 10 s is 300 intervals after .* in seconds") as told:
        pipeline.extrapolate(time=10)
    assert told[0].filename == __file__
