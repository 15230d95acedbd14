"""A C program that calls every function of the exported header with NULL for each of its pointers in turn: made from
the declarations, so that it knows functions to come."""

import re
from collections.abc import Iterator
from pathlib import Path

MAY_BE_NULL = {  # where NULL means something
    ("gffe_destroy", "g"),
    ("gffe_submit", "display_camera"),
    ("gffe_submit", "motion"),
    ("gffe_set_format", "format"),
    ("gffe_set_overlays", "overlays"),
    ("gffe_submit_after", "display_camera"),
    ("gffe_submit_after", "motion"),
    ("gffe_submit_after", "done"),
    ("gffe_extrapolate_after", "done"),
    ("gffe_present_after", "done"),
}
# What a good call gives, by the type of a parameter, without const.
GOOD = {
    "gffe *": "g", "gffe **": "&other", "gffe_options *": "&options", "gffe_camera *": "cameras",
    "gffe_frame *": "&frame", "gffe_image *": "&image", "gffe_overlays *": "&overlays",
    "gffe_format *": "&format", "gffe_pacer *": "&pacer", "gffe_paced *": "&plan",
    "cl_context": "context", "cl_command_queue": "queue",
    "cl_mem": "memory", "char *": '"history.dynamic_mask"', 
    "double": "1.0", "int": "1", "cl_uint": "1",
}  # fmt: skip

_PROGRAM = """
#include <stdio.h>
#include <string.h>
#include "gffe.h"

int main(void) {
    cl_platform_id platform;
    cl_device_id device;
    cl_context context;
    cl_command_queue queue;
    cl_mem memory;
    cl_event complete, done = NULL;
    gffe *g = NULL, *other = NULL, *failed = NULL;
    gffe_options options = gffe_default_options(64, 48);
    gffe_format format = gffe_default_format();
    gffe_camera cameras[1];
    gffe_overlays overlays = {NULL, NULL, NULL, NULL};
    gffe_frame frame;
    gffe_image image;
    gffe_pacer pacer;
    gffe_paced plan;
    int i;
    memset(cameras, 0, sizeof cameras);
    for (i = 0; i < 4; ++i) cameras[0].world_to_view[i][i] = 1;
    cameras[0].fx = cameras[0].fy = 50;
    if (clGetPlatformIDs(1, &platform, NULL)) return 3;
    if (clGetDeviceIDs(platform, CL_DEVICE_TYPE_ALL, 1, &device, NULL)) return 3;
    context = clCreateContext(NULL, 1, &device, NULL, NULL, NULL);
    queue = clCreateCommandQueue(context, device, 0, NULL);
    memory = clCreateBuffer(context, CL_MEM_READ_WRITE, 64 * 48 * 8, NULL, NULL);
    complete = clCreateUserEvent(context, NULL);
    clSetUserEventStatus(complete, CL_COMPLETE);
    if (gffe_create(context, queue, &options, &g) || !gffe_create(context, queue, NULL, &failed)) return 4;
    if (gffe_submit(g, memory, memory, NULL, cameras, NULL, 0.5, 1)) return 5;
    if (gffe_pacer_start(&pacer, 60, 2, 30, 0) || gffe_pacer_rendered(&pacer, 0, 0)) return 6;
    setvbuf(stdout, NULL, _IONBF, 0);
%s
    gffe_destroy(failed);
    gffe_destroy(g);
    clReleaseEvent(complete);
    return 0;
}
"""


def declarations(folder: Path) -> Iterator[tuple[str, str, list[tuple[str, str]]]]:
    """Yield (type, name, [(type, name) of each parameter]) of every function of the header."""
    text = re.sub(r"/\*.*?\*/", " ", (folder / "gffe.h").read_text(), flags=re.S)
    for kind, name, listed in re.findall(r"^((?:const )?\w+(?: \*| ))(gffe_\w+)\(([^()]*)\);", text, re.M):
        parameters = []
        for one in listed.split(","):
            about, own = re.fullmatch(r"\s*(.*?)(\w+)\s*", one, re.S).groups()
            parameters.append((" ".join(about.replace("const ", "").split()), own))
        yield kind.strip(), name, parameters


def is_pointer(kind: str) -> bool:
    return kind.endswith("*") or (kind.startswith("cl_") and kind != "cl_uint")


def calls(folder: Path) -> Iterator[tuple[str, str, str, str]]:
    """Yield (function, parameter that is NULL, type of what it returns, the call); "failed": of a gffe that was not
    made."""
    for kind, name, parameters in declarations(folder):
        for wrong, (about, own) in enumerate(parameters):
            for value in [] if not is_pointer(about) else ["NULL", "failed"] if about == "gffe *" else ["NULL"]:
                given = [value if k == wrong else _good(*p) for k, p in enumerate(parameters)]
                if (name, value) != ("gffe_destroy", "failed"):
                    yield name, own if value == "NULL" else value, kind, f"{name}({', '.join(given)})"


def _good(kind: str, name: str) -> str:
    if kind == "cl_event *":
        return "&done" if name == "done" else "&complete"
    return GOOD[kind]


def program(folder: Path) -> str:
    """Return the source of a program that prints "FUNCTION PARAMETER STATUS" for each call, whose status is "-" where
    it returns none."""
    lines = []
    for function, parameter, kind, call in calls(folder):
        lines.append(f'    printf("{function} {parameter} ");')
        if kind == "gffe_status":
            lines.append(f'    printf("%d\\n", (int){call});')
        else:
            lines.append(f'    (void){call};\n    printf("-\\n");')
        if function.endswith("_after"):
            lines.append("    if (done) clReleaseEvent(done);\n    done = NULL;")
        if function == "gffe_create":
            lines.append("    gffe_destroy(other);\n    other = NULL;")
    return _PROGRAM % "\n".join(lines)
