"""An exported pipeline in C, compiled, loaded and called beside Python's, on the same device and buffers."""

import ctypes as ct
import math
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pyopencl as cl
import pytest

from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.frame_format import CAMERA_MOTIONS, DEPTHS, TYPES, FrameFormat
from gffe_cl.engine.frame.rendered_frame import OVERLAYS

STRICT = ("-Wall", "-Wextra", "-Werror", "-pedantic")
MOTION_UNITS = ("pixels", "uv", "ndc", "color_pixels")  # as gffe.h numbers them
OK, INVALID, OPENCL, OUT_OF_MEMORY = range(4)


class CCamera(ct.Structure):
    _fields_ = (("world_to_view", ct.c_double * 16), *((name, ct.c_double) for name in ("fx", "fy", "cx", "cy")))

    @classmethod
    def of(cls, camera: Camera):
        return cls((ct.c_double * 16)(*camera.world_to_view.ravel()), *camera.intrinsics)

    def camera(self) -> Camera:
        return Camera(np.array(self.world_to_view).reshape(4, 4), self.fx, self.fy, self.cx, self.cy)


class COptions(ct.Structure):
    _fields_ = (
        *((name, ct.c_int) for name in ("width", "height", "render_width", "render_height")),
        ("fps", ct.c_double),
        *((name, ct.c_int) for name in ("lanes", "int64_atomics", "float_sums")),
    )


class CFrame(ct.Structure):
    _fields_ = (
        *((name, ct.c_void_p) for name in ("color", "depth", "motion", "dynamic", "disoccluded", "filled_by", "gae")),
        ("camera", CCamera),
        ("time", ct.c_double),
        ("alpha", ct.c_double),
    )


class CImage(ct.Structure):
    _fields_ = (
        ("memory", ct.c_void_p),
        *((name, ct.c_size_t) for name in ("width", "height", "planes", "bytes_per_pixel")),
    )


class COverlays(ct.Structure):
    _fields_ = tuple((name, ct.c_void_p) for name in OVERLAYS)


class CFormat(ct.Structure):
    _fields_ = (
        *((name, ct.c_int) for name in ("geometry_width", "geometry_height", "rows_up")),
        *((name, ct.c_int) for name in ("color_type", "color_channels", "color_srgb", "depth_type", "depth")),
        *((name, ct.c_double) for name in ("depth_scale", "near_z", "far_z")),
        ("depth_range", ct.c_double * 2),
        *((name, ct.c_int) for name in ("motion_type", "motion_channels")),
        *((name, ct.c_double * 2) for name in ("motion_scale", "motion_offset")),
        *((f"motion_{name}", ct.c_int) for name in ("unit", "from_previous", "y_up", "dilated", "jittered")),
        ("motion_invalid", ct.c_double),
        ("camera_motion", ct.c_int),
    )

    @classmethod
    def of(cls, format: FrameFormat):
        numbers = {name: 1 + number for number, name in enumerate(TYPES)}
        plain = (
            "color_channels",
            "depth_scale",
            "near_z",
            "far_z",
            "motion_channels",
            "motion_dilated",
            "motion_jittered",
        )
        pairs = ("depth_range", "motion_scale", "motion_offset")
        width, height = format.geometry_size or (0, 0)
        return cls(
            geometry_width=width,
            geometry_height=height,
            **{name: getattr(format, name) for name in plain},
            **{name: numbers[getattr(format, name)] for name in ("color_type", "depth_type", "motion_type")},
            **{name: (ct.c_double * 2)(*getattr(format, name)) for name in pairs},
            rows_up=format.rows == "up",
            color_srgb=format.color_encoding == "srgb",
            depth=DEPTHS.index(format.depth),
            motion_unit=MOTION_UNITS.index(format.motion_unit),
            motion_from_previous=format.motion_direction == "from_previous",
            motion_y_up=format.motion_y == "up",
            motion_invalid=math.nan if format.motion_invalid is None else format.motion_invalid,
            camera_motion=CAMERA_MOTIONS.index(format.camera_motion),
        )


class Failed(Exception):
    """`status`, and what gffe_message says."""

    def __init__(self, status, message):
        super().__init__(message)
        self.status = status


def opencl_library() -> str:
    """Return the loader that this process uses: handles are the same for all loaders, but the tests' library needs
    one."""
    with open("/proc/self/maps") as maps:
        return next(line.split()[-1] for line in maps if "libOpenCL" in line)


def require_compiler(*names: str) -> None:
    """Skip the test where there is no C compiler or none of the headers of OpenCL."""
    for name in names:
        if not shutil.which(name):
            pytest.skip(f"no {name}")
    found = subprocess.run(
        ["cc", "-E", "-x", "c", "-"], input="#include <CL/cl.h>\n", capture_output=True, text=True, check=False
    )
    if found.returncode:
        pytest.skip("no CL/cl.h (Debian: opencl-c-headers)")


def compile_library(folder: Path, target: Path) -> Path:
    sources = sorted(map(str, folder.glob("gffe*.c")))
    command = ["cc", "-std=c99", *STRICT, "-O0", "-fPIC", "-shared", "-ffp-contract=off", "-o", str(target), *sources]
    subprocess.run([*command, opencl_library(), "-lm"], check=True)
    return target


def load(path: Path) -> ct.CDLL:
    library = ct.CDLL(str(path), mode=os.RTLD_LOCAL | os.RTLD_NOW)
    library.gffe_default_options.restype = COptions
    for name in ("message", "camera_fault", "buffer_name"):
        getattr(library, f"gffe_{name}").restype = ct.c_char_p
    library.gffe_default_format.restype = CFormat
    library.gffe_set_format.argtypes = [ct.c_void_p] * 2
    library.gffe_set_geometry_jitter.argtypes = [ct.c_void_p, *[ct.c_double] * 2]
    library.gffe_interval.restype = ct.c_double
    library.gffe_create.argtypes = [ct.c_void_p] * 4
    library.gffe_destroy.argtypes = library.gffe_interval.argtypes = library.gffe_is_cut.argtypes = [ct.c_void_p]
    library.gffe_message.argtypes = [ct.c_void_p]
    library.gffe_buffer_name.argtypes = [ct.c_void_p, ct.c_int]
    library.gffe_set_exposure.argtypes = [ct.c_void_p, ct.c_double]
    library.gffe_submit.argtypes = [*[ct.c_void_p] * 6, ct.c_double, ct.c_int]
    library.gffe_extrapolate.argtypes = [ct.c_void_p, ct.c_void_p, ct.c_double, ct.c_void_p]
    events = [ct.c_uint, ct.c_void_p, ct.c_void_p]
    library.gffe_submit_after.argtypes = [*library.gffe_submit.argtypes, *events]
    library.gffe_extrapolate_after.argtypes = [*library.gffe_extrapolate.argtypes, *events]
    library.gffe_present_after.argtypes = [ct.c_void_p, ct.c_void_p, *events]
    library.gffe_set_overlays.argtypes = [ct.c_void_p] * 2
    library.gffe_present.argtypes = [ct.c_void_p] * 2
    library.gffe_get.argtypes = [ct.c_void_p, ct.c_char_p, ct.c_void_p]
    return library


class Engine:
    """A `gffe` of the C library on a Device."""

    def __init__(self, library, device, width, height, *, context=None, queue=None, **options):
        self.library, self.device, self.handle = library, device, ct.c_void_p()
        self.options = library.gffe_default_options(width, height)
        for name, value in options.items():
            setattr(self.options, name, value)
        context = device.context.int_ptr if context is None else context
        queue = device.queue.int_ptr if queue is None else queue
        self._check(library.gffe_create(context, queue, ct.byref(self.options), ct.byref(self.handle)))

    def _check(self, status):
        if status:
            raise Failed(status, self.library.gffe_message(self.handle).decode())

    def destroy(self):
        self.library.gffe_destroy(self.handle)
        self.handle = ct.c_void_p()

    def set_exposure(self, exposure):
        self._check(self.library.gffe_set_exposure(self.handle, exposure))

    def _call(self, name, arguments, wait_for=None):
        """Call a function and return its result; with a list of events its `_after` variant, and the event that it
        makes."""
        if wait_for is None:
            self._check(getattr(self.library, f"gffe_{name}")(self.handle, *arguments))
            return None
        done = ct.c_void_p(1)
        events = (ct.c_void_p * len(wait_for))(*(event and event.int_ptr for event in wait_for)) if wait_for else None
        after = getattr(self.library, f"gffe_{name}_after")
        try:
            self._check(after(self.handle, *arguments, len(wait_for), events, ct.byref(done)))
        except Failed:
            assert done.value is None
            raise
        return cl.Event.from_int_ptr(done.value, retain=False)

    def submit(self, buffers, camera, time, display=None, reset=False, wait_for=None):
        cameras = [c and ct.byref(CCamera.of(c)) for c in (camera, display)]
        handles = [b and b.int_ptr for b in buffers]
        return self._call("submit", (*handles, *cameras, time, int(reset)), wait_for)

    def set_format(self, format, jitter=(0.0, 0.0)):
        """Set `format`: a FrameFormat, a CFormat or None."""
        made = CFormat.of(format) if isinstance(format, FrameFormat) else format
        self._check(self.library.gffe_set_format(self.handle, made and ct.byref(made)))
        self._check(self.library.gffe_set_geometry_jitter(self.handle, *jitter))

    def set_overlays(self, overlays):
        """Set `overlays` of device buffers."""
        given = {name: getattr(overlays, name) for name in OVERLAYS}
        told = COverlays(**{name: buffer.int_ptr for name, buffer in given.items() if buffer})
        self._check(self.library.gffe_set_overlays(self.handle, ct.byref(told)))

    def extrapolate(self, time, camera, wait_for=None):
        """Return the frame; with `wait_for` and the event."""
        made = CFrame()
        camera = camera and ct.byref(CCamera.of(camera))
        event = self._call("extrapolate", (camera, time, ct.byref(made)), wait_for)
        return made if wait_for is None else (made, event)

    def present(self, wait_for=None):
        """Return the displayed frame; with `wait_for` and the event."""
        made = CFrame()
        event = self._call("present", (ct.byref(made),), wait_for)
        return made if wait_for is None else (made, event)

    @property
    def is_cut(self):
        return bool(self.library.gffe_is_cut(self.handle))

    @property
    def names(self):
        found = []
        while name := self.library.gffe_buffer_name(self.handle, len(found)):
            found.append(name.decode())
        return found

    def get(self, name):
        image = CImage()
        self._check(self.library.gffe_get(self.handle, name.encode(), ct.byref(image)))
        return image

    def bytes_of(self, name):
        """Return (planes · height · width, bytes per pixel) uint8."""
        image = self.get(name)
        shape = image.planes * image.height * image.width, image.bytes_per_pixel
        return self.read(image.memory, int(np.prod(shape))).reshape(shape)

    def read(self, memory, nbytes):
        values = np.empty(nbytes, np.uint8)
        cl.enqueue_copy(self.device.queue, values, cl.Buffer.from_int_ptr(memory, True))
        return values
