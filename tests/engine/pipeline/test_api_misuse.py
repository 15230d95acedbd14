"""Wrong calls of the Python interface, made from the right ones: each argument in turn becomes what it must not be, and
everything ends well or in a GffeError of one line. What is as good as the right value must be taken: NumPy's numbers,
read-only and strided arrays."""

import inspect
import warnings
from dataclasses import dataclass, replace
from datetime import timedelta
from decimal import Decimal
from pathlib import Path
from types import FunctionType

import numpy as np
import pyopencl as cl
import pytest
from synthetic import camera
from tiny_frames import H, W, frames

import gffe_cl
from gffe_cl import (
    Camera,
    FrameEntry,
    GffeError,
    Jitter,
    Options,
    Overlays,
    Pipeline,
    RenderedFrame,
    SequenceWriter,
    Window,
    open_sequence,
)
from gffe_cl.captures.sequence.description import checked_entry
from gffe_cl.engine.core.errors import MOST
from gffe_cl.engine.options import OPTIONS

CAMERA, TURNED = camera(W, H), camera(W, H, (0.1, 0, 0), yaw=0.2)
VIEW, PROJECTION = CAMERA.view_matrix("opengl"), CAMERA.projection_matrix("opengl", W, H, near=0.1)
DEPTH = np.full((H, W), 4.0, np.float32)
MOTION = np.zeros((H, W, 2), np.float32)
COLOR = np.full((H, W, 3), 0.5, np.float16)
FRAME = RenderedFrame(COLOR, DEPTH, MOTION, CAMERA, 0.0, reset=True)
HUGE = 1 << 20, 1 << 20  # pixels, which no memory holds; they are views of a single number
WRONG = (
    None, "", "1", b"1", float("nan"), float("inf"), -1, 0, 1.5, 1e299, 2**70, 10**5000, 1j, True, [], [1, None],
    [[1], [1, 2]], {}, {"a": 1}, object(), np.array(None), np.array([1, "x"], object), np.zeros(3, complex),
    np.zeros((2, 0)), np.ones((3, 5, 7), np.float32), np.array("now", "datetime64[s]"), np.array(["a"]), print, CAMERA,
    Options(), FRAME, np.timedelta64(3, "ns"), np.timedelta64("NaT"), timedelta(1), np.zeros(3, "i4, f4"), Decimal(1),
    1e308, np.longdouble(2), "x" * 5000, "a b " * 25000, Path("x" * 5000), "a\ud800", np.broadcast_to(np.float16(1),
    HUGE), np.broadcast_to(np.float32(1), (*HUGE, 2)), np.broadcast_to(np.uint8(1), (*HUGE, 3)),
)  # fmt: skip
# What needs a device, or a fake driver (tests/engine/opencl/test_memory_sharing.py); plain records, checked where
# they are used; what is made by others only.
ON_A_DEVICE = {
    "Pipeline", "Pipeline.submit", "Pipeline.present", "Pipeline.predict_camera", "Pipeline.extrapolate",
    "Pipeline.keep", "Pipeline.change_options", "present", "record",
    "Device.buffer", "Device.empty", "Device.from_context", "sharing_support",
}  # fmt: skip
WITH_A_FAKE_DRIVER = {
    "MemorySharing",
    "MemorySharing.acquire",
    "MemorySharing.release",
    "MemorySharing.buffer",
    "MemorySharing.semaphore",
    "MemorySharing.wait",
    "MemorySharing.signal",
}
RECORDS = {"SharingSupport", "DeviceInfo", "BadPixels", "Overlays", "RenderedFrame", "FrameEntry", "Window"}
MADE_BY_OTHERS = {"Device", "ExtrapolatedFrame", "PresentedFrame", "Sequence", "GffeError"}


@dataclass
class Call:
    """`of` is called with `good`, and with a wrong value in place of each of its arguments."""

    of: object
    good: dict

    def wrong(self):
        for name, good in self.good.items():
            for value in (*WRONG, *extremes(good)):
                yield name, value, self.good | {name: value}

    def alike(self):
        """With what is as good, which must be taken."""
        for name, value in self.good.items():
            for other in alike(value):
                yield name, self.good | {name: other}


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
    """Arrays like `value` of numbers with which arithmetic fails."""
    if not isinstance(value, np.ndarray) or value.dtype.kind != "f":
        return []
    return [
        np.where(np.arange(value.size).reshape(value.shape) % step, value, number).astype(dtype)
        for dtype in dict.fromkeys((value.dtype, np.dtype(float)))
        for ends in [np.finfo(dtype)]
        for number in (np.inf, -np.inf, np.nan, ends.max, ends.min, ends.smallest_normal)
        for step in (1, 3)
    ]


def paced(planned=False):
    pacer = gffe_cl.Pacer(60)
    pacer.rendered(0.0)
    if planned:
        pacer.plan(0.1)
    return pacer


def host_calls():
    """Of what needs neither a device nor files, by name."""
    lens = {"fx": 20.0, "fy": 20.0, "cx": 12.0, "cy": 8.0}
    engine = {"view": VIEW, "projection": PROJECTION, "size": (W, H), "layout": "row-major"}
    names = ("opengl", "direct3d", "vulkan", "unity", "unreal")
    calls = {
        "Camera": Call(Camera, {"world_to_view": np.eye(4), **lens}),
        "Camera.look_at": Call(Camera.look_at, {"position": (0, 0, 0), "target": (0, 0, 1), "up": (0, 1, 0), **lens}),
        "Camera.from_pose": Call(
            Camera.from_pose, {"position": np.zeros(3), "direction": (0, 0, 1), "up": (0, 1, 0), **lens}
        ),
        **{f"Camera.from_{name}": Call(getattr(Camera, f"from_{name}"), engine) for name in names},
        "Camera.from_unreal_pose": Call(
            Camera.from_unreal_pose, {"location": (0, 0, 0), "rotation": (1, 2, 3), "fov": 60.0, "size": (W, H)}
        ),
        "Camera.project": Call(CAMERA.project, {"world_pos": np.ones((5, 3))}),
        "Camera.unproject": Call(CAMERA.unproject, {"px": np.ones((5, 2)), "depth": np.ones(5)}),
        "Camera.view_matrix": Call(CAMERA.view_matrix, {"api": "vulkan"}),
        "Camera.projection_matrix": Call(
            CAMERA.projection_matrix,
            {"api": "opengl", "width": W, "height": H, "near": 0.5, "far": 9.0, "reverse_depth": False},
        ),
        "Camera.to_view_of": Call(CAMERA.to_view_of, {"other": CAMERA}),
        "Camera.scaled": Call(CAMERA.scaled, {"scale_x": 2.0, "scale_y": 2.0}),
        "Camera.moved": Call(CAMERA.moved, {"offset": np.ones(3)}),
        "prepare_runtimes": Call(gffe_cl.prepare_runtimes, {}),
        "to_display": Call(gffe_cl.to_display, {"color": COLOR, "exposure": 1.0}),
        "psnr": Call(gffe_cl.psnr, {"a": COLOR, "b": COLOR, "mask": DEPTH}),
        "ssim": Call(gffe_cl.ssim, {"a": COLOR, "b": COLOR, "mask": DEPTH}),
        "check, pixels": Call(
            lambda **images: gffe_cl.check([replace(FRAME, **images), replace(FRAME, **images, time=1.0, reset=False)]),
            {"color": COLOR, "depth": DEPTH, "motion": MOTION},
        ),
        "check": Call(gffe_cl.check, {"frames": [FRAME, FRAME], "exposure": 1.0, "format": gffe_cl.FrameFormat()}),
        "Pacer": Call(gffe_cl.Pacer, {"display_rate": 60.0, "most_alpha": 2.0, "fps": 30.0}),
        "Pacer.rendered": Call(lambda **given: gffe_cl.Pacer(60).rendered(**given), {"time": 0.0, "reset": False}),
        "Pacer.plan": Call(lambda now: paced().plan(now), {"now": 0.2}),
        "Pacer.ready": Call(lambda now: paced(planned=True).ready(now), {"now": 0.2}),
        "predict_camera": Call(gffe_cl.predict_camera, {"previous": TURNED, "current": CAMERA, "alpha": 0.5}),
        "predict_camera_at": Call(
            gffe_cl.predict_camera_at,
            {"time": 3.0, "cameras": [CAMERA, TURNED, CAMERA], "times": [2.0, 1.0, 0.0], "order": 2},
        ),
        "depth_from_device": Call(
            gffe_cl.depth_from_device,
            {"z": DEPTH / 8, "projection": PROJECTION, "layout": "row-major", "opengl_buffer": False, "sky": True},
        ),
        "depth_from_distance": Call(gffe_cl.depth_from_distance, {"distance": DEPTH, "camera": CAMERA}),
        "motion_from_ndc": Call(
            gffe_cl.motion_from_ndc, {"motion": MOTION, "size": (W, H), "direction": "to_previous", "y": "up"}
        ),
        "motion_from_uv": Call(
            gffe_cl.motion_from_uv, {"motion": MOTION, "size": (W, H), "direction": "to_previous", "y": "up"}
        ),
        "FrameFormat": Call(gffe_cl.FrameFormat, vars(gffe_cl.FrameFormat(motion_invalid=1.0, color_size=(W, H)))),
        "FrameFormat.from_json": Call(gffe_cl.FrameFormat.from_json, {"given": {"near_z": 1, "far_z": 2}}),
        "FrameFormat.fsr3": Call(
            gffe_cl.FrameFormat.fsr3,
            {
                **{"renderSize": (W, H), "displaySize": (W, H), "motionVectorScale": (W, H), "cameraNear": 0.5},
                **{"cameraFar": 9.0, "flags": 8},
            },
        ),
        "FrameFormat.streamline": Call(
            gffe_cl.FrameFormat.streamline,
            {
                **{"mvecScale": (1, 1), "cameraNear": 0.5, "cameraFar": 9.0, "depthInverted": True},
                **{"cameraMotionIncluded": False, "motionVectors3D": True, "motionVectorsDilated": True},
                **{"motionVectorsJittered": True, "motionVectorsInvalidValue": 1.0, "orthographicProjection": False},
            },
        ),
        "FrameFormat.xess": Call(
            gffe_cl.FrameFormat.xess,
            {
                "projectionMatrix": CAMERA.projection_matrix("direct3d", W, H, 0.5),
                **{"motionVectorScaleX": 2.0, "motionVectorScaleY": 2.0, "initFlags": 8},
            },
        ),
        "FrameFormat.openxr": Call(
            gffe_cl.FrameFormat.openxr,
            {
                **{"motionVectorScale": (1, 1, 1, 0), "motionVectorOffset": (0, 0, 0, 0), "minDepth": 0.1},
                **{"maxDepth": 0.9, "nearZ": 9.0, "farZ": 0.5, "layerFlags": 1},
            },
        ),
        "motion_from_unreal": Call(gffe_cl.motion_from_unreal, {"rg": MOTION, "size": (W, H), "scale": 2.0}),
        "Options": Call(Options, {name: option.default for name, option in OPTIONS.items()}),
        "Options.changed": Call(Options().changed, {"name": "levels", "value": 1}),
        "Options.preset": Call(Options.preset, {"name": "performance", "levels": 1}),
        "Window.camera": Call(
            Window(-1.2, -1.2, 1.2, 1.2).camera, {"display": CAMERA, "size": (W, H), "render_size": (W, H)}
        ),
        "adaptive_window": Call(
            gffe_cl.adaptive_window,
            {
                **{"current": CAMERA, "predicted": [CAMERA], "max_enlargement": 1.5, "size": (W, H), "distance": 2.0},
                **{"margin": 1.0, "least": 0.0},
            },
        ),
        "fixed_window": Call(gffe_cl.fixed_window, {"factor": 1.25}),
        "nearest_depth": Call(gffe_cl.nearest_depth, {"depth": DEPTH}),
        "Jitter": Call(Jitter, {"length": 16}),
        "Jitter.parse": Call(Jitter.parse, {"text": "halton:8"}),
        "Jitter.offset": Call(Jitter(8).offset, {"number": 3}),
        "Jitter.camera": Call(Jitter(8).camera, {"camera": CAMERA, "number": 3}),
        # Not what makes them probe all devices.
        "list_devices": Call(lambda refresh: refresh is True or gffe_cl.list_devices(refresh), {"refresh": False}),
        "open_device": Call(lambda wanted: isinstance(wanted, str) or gffe_cl.open_device(wanted), {"wanted": None}),
    }
    calls["Window, fields"] = Call(
        lambda **edges: Window(**edges).camera(CAMERA, (W, H)), {"u0": -1.25, "v0": -1.25, "u1": 1.25, "v1": 1.25}
    )
    return calls


def file_calls(folder):
    """Of what reads and writes sequences in `folder`, by name."""
    entry = FrameEntry("frame.exr", 0.0, render_camera=CAMERA)
    channels = gffe_cl.named_channels(COLOR, DEPTH, MOTION)
    with SequenceWriter(folder / "good", W, H, 30.0) as writer:
        writer.add(entry, channels)
    sequence = open_sequence(folder / "good")
    own, stored = sequence.frames[0], folder / "good" / "frame.exr"
    moment = {"kind": "rendered", "time": 0.0}

    def written(method):
        def write(**given):
            if isinstance(given.get("channels"), dict):
                given["channels"] = dict(given["channels"])  # `owned` ones are emptied
            with SequenceWriter(folder / "written", W, H, 30.0) as writer:
                getattr(writer, method)(**given)
                if method == "folder":
                    writer.add(entry, channels)

        return write

    def started(**given):
        with SequenceWriter(**given) as writer:
            writer.add(entry, channels)

    writing = {"path": folder / "written", "width": W, "height": H, "fps": 30.0, "exposure": 1.0, "threads": 2}
    return {
        "named_channels": Call(
            gffe_cl.named_channels, {"color": COLOR, "depth": DEPTH, "motion": MOTION, "overlays": Overlays()}
        ),
        "open_sequence": Call(open_sequence, {"path": folder / "good"}),
        "open_capture": Call(gffe_cl.open_capture, {"path": folder / "good"}),
        "Sequence.at": Call(sequence.at, moment),
        "Sequence.camera_at": Call(sequence.camera_at, {"time": 0.0}),
        "Sequence.nearest": Call(sequence.nearest, moment),
        "Sequence.near_miss": Call(sequence.near_miss, moment),
        "Sequence.rendered_before": Call(sequence.rendered_before, {"time": 0.0}),
        "Sequence.size_of": Call(sequence.size_of, {"entry": own}),
        "Sequence.geometry_of": Call(sequence.geometry_of, {"entry": own}),
        "Sequence.read": Call(sequence.read, {"entry": own}),
        "Sequence.read_stored": Call(sequence.read_stored, {"entry": own}),
        "Sequence.read_channels": Call(sequence.read_channels, {"entry": own, "names": ["R"]}),
        "Sequence.read_color": Call(sequence.read_color, {"entry": own}),
        "Sequence.exr_file": Call(sequence.exr_file, {"entry": own}),
        "Sequence.prefetch": Call(
            lambda **given: [entry for entry, _ in sequence.prefetch(**given)],
            {"entries": [own], "read": sequence.read, "ahead": 2},
        ),
        "SequenceWriter": Call(
            SequenceWriter, writing | {"generator": "gffe-cl", "compression": "zip", "format": None}
        ),
        "SequenceWriter, used": Call(started, writing),
        "SequenceWriter.add": Call(written("add"), {"entry": entry, "channels": channels, "owned": False}),
        "SequenceWriter.add_frame": Call(
            written("add_frame"), {"entry": entry, "frame": gffe_cl.RenderedFrame(COLOR, DEPTH, MOTION, CAMERA, 0.0)}
        ),
        "SequenceWriter.add, Z": Call(
            lambda z: written("add")(entry=entry, channels=channels | {"Z": z}), {"z": channels["Z"]}
        ),
        "SequenceWriter.link": Call(written("link"), {"entry": entry, "source_path": stored}),
        "SequenceWriter.folder": Call(written("folder"), {"name": "stages"}),
        "FrameEntry": Call(lambda **fields: checked_entry(replace(entry, **fields)), dict(vars(entry))),
    }


def device_calls(pipeline, frame):
    """Of what needs a device, by name."""
    device = pipeline.device
    nbytes = {"color": 8 * W * H, "depth": 4 * W * H, "motion": 8 * W * H}
    layers = {
        "fixed_mask": DEPTH > 5,
        "effects_motion": MOTION,
        "effects": np.zeros((H, W, 4)),
        "ui": np.zeros((H, W, 4)),
    }
    submitted = {"color": frame.color, "depth": frame.depth, "motion": frame.motion, "camera": frame.camera}
    submitted |= {"time": 0.5, "display_camera": None, "reset": True, "overlays": None, "geometry_jitter": (0.1, 0.2)}
    made = pipeline.extrapolate()
    through = {
        "frame": replace(frame, display_camera=camera(W, H)),
        "previous": frame,
        "size": (W, H),
        "device": device,
    }
    exposed = Call(lambda value: setattr(pipeline, "exposure", value), {"value": 1.0})
    other = Pipeline(device, W, H, Options(shading_correction=False))
    return {
        "Pipeline": Call(
            Pipeline,
            {
                **{"device": device, "width": W, "height": H, "options": None, "render_size": (W, H), "fps": 30.0},
                **{"int64_atomics": None, "format": gffe_cl.FrameFormat()},
            },
        ),
        "Pipeline.submit": Call(lambda frame: pipeline.submit(frame), {"frame": frame}),
        "Pipeline.submit, how": Call(
            lambda **how: pipeline.submit(frame, **how),
            {"wait_for": [cl.enqueue_marker(device.queue)], "zero_copy": True},
        ),
        "Pipeline.present": Call(pipeline.present, {"wait_for": [cl.enqueue_marker(device.queue)]}),
        "Pipeline.submit, fields": Call(lambda **fields: pipeline.submit(replace(frame, **fields)), submitted),
        "Pipeline.submit, overlays": Call(
            lambda **layers: pipeline.submit(replace(frame, overlays=Overlays(**layers))), layers
        ),
        "Pipeline.submit, device buffers": Call(
            lambda **buffers: pipeline.submit(replace(frame, **buffers)),
            {name: device.buffer(size) for name, size in nbytes.items()},
        ),
        "Pipeline.predict_camera": Call(pipeline.predict_camera, {"alpha": 0.5}),
        "Pipeline.extrapolate": Call(
            pipeline.extrapolate,
            {
                **{"camera": CAMERA, "time": 2.0, "wait_for": [cl.enqueue_marker(device.queue)]},
            },
        ),
        "Pipeline.keep": Call(pipeline.keep, {"names": ["warp.color"]}),
        "Pipeline.change_options": Call(other.change_options, {"options": other.options}),
        "Pipeline.exposure": exposed,
        "record": Call(
            lambda **given: gffe_cl.record(**given).close(), {"pipeline": other, "folder": Path("seen"), "most": 3}
        ),
        "ExtrapolatedFrame.numpy": Call(made.numpy, {"name": "gae"}),
        "PresentedFrame.numpy": Call(pipeline.present().numpy, {"name": "depth"}),
        "present": Call(gffe_cl.present, through),
        "ExtrapolatedFrame.mapped": Call(lambda **given: made.mapped(**given).__enter__(), {"name": "gae"}),
        "Device.buffer": Call(device.buffer, {"nbytes": 16, "mapped": False}),
        "sharing_support": Call(gffe_cl.sharing_support, {"device": device}),
        "Device.empty": Call(device.empty, {"shape": (3, 4), "dtype": np.float32}),
        "Device.from_context": Call(type(device).from_context, {"context": device.context, "queue": device.queue}),
        "Device": Call(
            type(device),
            {"cl_device": device.cl_device, "info": device.info, "opened": device.opened, "queue": device.queue},
        ),
    }


def public():
    """Names of all that can be called with arguments: functions, classes, their methods."""
    found = set()
    for name in gffe_cl.__all__:
        thing = getattr(gffe_cl, name)
        if callable(thing) and name not in MADE_BY_OTHERS | RECORDS:
            found.add(name)
        for member, value in vars(thing).items() if isinstance(thing, type) else ():
            function = value.__func__ if isinstance(value, classmethod) else value
            is_method = not member.startswith("_") and isinstance(function, FunctionType)
            if is_method and len(inspect.signature(function).parameters) > 1:
                found.add(f"{name}.{member}")
    return found


def check(call, name):
    """Make the call rightly, and wrongly in all ways; returns how many wrong ones there were."""
    count = 0
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)  # users would see NumPy's
        call.of(**call.good)
        for argument, good in call.alike():
            try:
                call.of(**good)
            except Exception as error:
                pytest.fail(f"{name}: {argument}={good[argument]!r}, as good, raises {error!r}")
        for argument, value, wrong in call.wrong():
            count += 1
            try:
                call.of(**wrong)
            except GffeError as error:
                text = str(error)
                assert "\n" not in text and len(text) <= MOST, f"not one line: {text[:300]!r}"
            except Exception as error:
                shown = type(value) if isinstance(value, int | np.ndarray) else repr(value)[:80]
                pytest.fail(f"{name}: {argument}={shown} raises {error!r}"[:400])
    with pytest.raises(TypeError):
        call.of(**call.good, color=1)
    return count


def test_misuse_ends_in_one_line(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # some values are paths, from here
    calls = host_calls()
    count = sum(check(call, name) for name, call in calls.items() if name != "check, pixels")
    files = file_calls(tmp_path)
    count += sum(check(call, name) for name, call in files.items())
    assert count > 3000
    assert public() - set(calls) - set(files) - WITH_A_FAKE_DRIVER == ON_A_DEVICE


@pytest.mark.long
def test_misused_pixels_are_checked_without_a_traceback():
    assert check(host_calls()["check, pixels"], "check, pixels") > 100


# ---- on a device -----------------------------------------------------------------------------------------


def bits(pipeline):
    pipeline.exposure = 1.0
    pipeline.keep([])
    for frame in frames():
        pipeline.submit(frame)
    made = pipeline.extrapolate()
    return [made.numpy(name).tobytes() for name in ("color", "depth", "motion", "filled_by")]


def test_misuse_leaves_a_pipeline_that_works(device, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # some values are paths, from here
    pipeline = Pipeline(device, W, H, Options(shading_correction=False))
    right = bits(pipeline)
    calls = device_calls(pipeline, next(frames()))
    assert sum(check(call, name) for name, call in calls.items()) > 1000
    assert set(calls) >= ON_A_DEVICE
    assert bits(pipeline) == right


@pytest.mark.device
def test_far_times_are_warned_of(device):
    """As of milliseconds, or of another clock; a frame is made nevertheless."""
    pipeline = Pipeline(device, W, H, Options(shading_correction=False))
    pipeline.submit(next(frames()))
    with pytest.warns(
        UserWarning, match=r"time 10 s is 300 intervals after .* \(expected up to 16, in seconds"
    ) as told:
        pipeline.extrapolate(time=10)
    assert told[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pipeline.extrapolate(time=16 / 30)


def test_numbers_out_of_range_are_called_that():
    eye = np.eye(4)
    for value, told in (
        (1e308, r"must be a finite number from -1e\+300 to 1e\+300, got 1e\+308 \(out of range\)"),
        (10**400, r"to 1e\+300, got a number too large \(out of range\)"),
        (float("inf"), r"must be a finite number, got inf$"),
        (True, r"must be a finite number, got true$"),
    ):
        with pytest.raises(GffeError, match=told):
            Camera(eye, value, 1.0, 1.0, 1.0)
    with pytest.raises(GffeError, match=r"3 finite numbers from -1e\+300 to 1e\+300"):
        Camera.look_at((1e308, 0, 0), (0, 0, 0), (0, 1, 0), 1, 1, 1, 1)


def test_times_of_numpy_are_no_numbers():
    """Of nanoseconds they would become Python's integers."""
    for value in (np.timedelta64(3, "ns"), np.array(3, "m8[ns]"), np.datetime64(3, "ns"), np.timedelta64(3, "s")):
        with pytest.raises(GffeError, match=r"camera: fx must be a finite number, got a (timedelta64|datetime64)"):
            Camera(np.eye(4), value, 1.0, 1.0, 1.0)
        with pytest.raises(GffeError, match="jitter: length must be a whole number"):
            Jitter(value)


def test_messages_print_no_endless_numbers():
    assert str(GffeError(f"size {'7' * 400}x5")) == f"size {'7' * 12}…x5"
    assert str(GffeError("digest " + "1a" * 32)) == "digest " + "1a" * 32
    for digits in (400, 5000):
        with pytest.raises(GffeError) as refused:
            gffe_cl.Jitter.parse("halton:" + "9" * digits)
        assert len(str(refused.value)) < 150
    for text in ("x" * 100_000, "a b " * 25_000):
        told = str(GffeError(f"in {text} there is something wrong (expected something right)"))
        assert len(told) < 1001 and told.startswith("in ") and told.endswith(" (expected something right)")
