"""An exported pipeline in C, compiled, loaded and called beside Python's, on the same device and buffers."""

import ctypes as ct
import math
import os
import re
import shutil
import subprocess
from importlib.resources import files
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


HEADER = re.sub(r"/\*.*?\*/", " ", (files("gffe_cl.engine.export") / "c" / "gffe.h").read_text("utf-8"), flags=re.S)
SCALARS = {
    "int": ct.c_int,
    "double": ct.c_double,
    "cl_uint": ct.c_uint,
    "size_t": ct.c_size_t,
    "gffe_status": ct.c_int,
}


def _structures() -> dict[str, type]:
    """Return the structures of gffe.h by name; arrays have one dimension."""
    made = {}
    for name, body in re.findall(r"typedef struct (\w+) {(.*?)} \1;", HEADER, re.S):
        fields = []
        for kind, members in re.findall(r"(\w+) ([^;]+);", body):
            for own, *sides in (re.findall(r"\w+", member) for member in members.split(",")):
                of = (SCALARS | made).get(kind, ct.c_void_p)
                fields.append((own, of * math.prod(map(int, sides)) if sides else of))
        made[name] = type(name, (ct.Structure,), {"_fields_": fields})
    return made


STRUCTURES = _structures()
CCamera, CFormat, CFrame = (STRUCTURES[f"gffe_{name}"] for name in ("camera", "format", "frame"))
# Result, name and (type, name) of the parameters of every function.
DECLARED = [
    (kind, name, [(about.strip(), own) for about, own in re.findall(r"(?:const )?(\w+ \**)(\w+)", listed)])
    for kind, name, listed in re.findall(r"^((?:const )?\w+)(?: \*| )(gffe_\w+)\(([^()]*)\);", HEADER, re.M)
]


def declare(library: ct.CDLL) -> ct.CDLL:
    """Declare those functions of gffe.h that a library has."""
    for kind, name, parameters in DECLARED:
        if function := getattr(library, name, None):
            function.argtypes = [SCALARS.get(about, ct.c_void_p) for about, _ in parameters]
            function.restype = ct.c_char_p if "char" in kind else (SCALARS | STRUCTURES).get(kind)
    return library


def c_camera(camera: Camera) -> ct.Structure:
    return CCamera((ct.c_double * 16)(*camera.world_to_view.ravel()), *camera.intrinsics)


def camera_of(given: ct.Structure) -> Camera:
    return Camera(np.array(given.world_to_view).reshape(4, 4), given.fx, given.fy, given.cx, given.cy)


def c_format(format: FrameFormat) -> ct.Structure:
    width, height = format.geometry_size or (0, 0)
    given = {name: value for name, value in vars(format).items() if name in dict(CFormat._fields_)}
    given |= {name: (ct.c_double * 2)(*value) for name, value in given.items() if isinstance(value, tuple)}
    given |= {name: 1 + [*TYPES].index(value) for name, value in given.items() if name.endswith("_type")}
    return CFormat(
        **given
        | {
            "geometry_width": width,
            "geometry_height": height,
            "rows_up": format.rows == "up",
            "color_srgb": format.color_encoding == "srgb",
            "depth": DEPTHS.index(format.depth),
            "motion_unit": MOTION_UNITS.index(format.motion_unit),
            "motion_from_previous": format.motion_direction == "from_previous",
            "motion_y_up": format.motion_y == "up",
            "motion_invalid": math.nan if format.motion_invalid is None else format.motion_invalid,
            "camera_motion": CAMERA_MOTIONS.index(format.camera_motion),
        }
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
    return declare(ct.CDLL(str(path), mode=os.RTLD_LOCAL | os.RTLD_NOW))


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
        cameras = [c and ct.byref(c_camera(c)) for c in (camera, display)]
        handles = [b and b.int_ptr for b in buffers]
        return self._call("submit", (*handles, *cameras, time, int(reset)), wait_for)

    def set_format(self, format, jitter=(0.0, 0.0)):
        """Set `format`: a FrameFormat, a CFormat or None."""
        made = c_format(format) if isinstance(format, FrameFormat) else format
        self._check(self.library.gffe_set_format(self.handle, made and ct.byref(made)))
        self._check(self.library.gffe_set_geometry_jitter(self.handle, *jitter))

    def set_overlays(self, overlays):
        """Set `overlays` of device buffers."""
        given = {name: getattr(overlays, name) for name in OVERLAYS}
        told = STRUCTURES["gffe_overlays"](**{name: buffer.int_ptr for name, buffer in given.items() if buffer})
        self._check(self.library.gffe_set_overlays(self.handle, ct.byref(told)))

    def extrapolate(self, time, camera, wait_for=None):
        """Return the frame; with `wait_for` and the event."""
        made = CFrame()
        camera = camera and ct.byref(c_camera(camera))
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
        image = STRUCTURES["gffe_image"]()
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
