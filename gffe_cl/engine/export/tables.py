"""The C tables from a recording: text of kernels, buffers, and launches on each occasion."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import fields

import numpy as np

from gffe_cl.engine.core import validation
from gffe_cl.engine.export.recording import MOST_PIXELS, Given, Launches, Operation
from gffe_cl.engine.frame import camera, frame_format
from gffe_cl.engine.frame.rendered_frame import BYTES_PER_PIXEL, OVERLAYS, SAME_POSE
from gffe_cl.engine.opencl.probing import TRIALS
from gffe_cl.engine.opencl.program import expand
from gffe_cl.engine.options import MAX_LEVELS, MAX_ORDER, Options
from gffe_cl.engine.pipeline.outputs import stages_of
from gffe_cl.engine.stages import frame_block, measures
from gffe_cl.engine.stages.base import Kernel, NearestStage, Stage, pictures_of
from gffe_cl.engine.stages.buffers import CUT_SAMPLES, LEAST_ALIGNMENT, BufferSpec, Sizes, grid_of
from gffe_cl.engine.stages.frame_block import FRAME
from gffe_cl.engine.stages.upload import Upload

# Inputs from callers, and their displayed part: name, grid and bytes.
GIVEN = {
    **{
        f"{frame}.{name}": ("source", nbytes)
        for frame in ("rendered", "previous")
        for name, nbytes in zip(("color", "depth", "motion"), BYTES_PER_PIXEL, strict=True)
    },
    "shown.color": ("target", 8),
    "shown.depth": ("source", 4),
    "overlays.fixed_mask": ("source", 1),
    "overlays.effects": ("source", 8),
    "overlays.effects_motion": ("source", 8),
    "overlays.ui": ("target", 8),
    **{f"engine.{name}": ("source", n) for name, n in zip(("color", "depth", "motion"), BYTES_PER_PIXEL, strict=True)},
}
_NAMED_GRIDS = ("source", "target", "network", "cells", "cut_samples")  # in C's own code
_USUAL = Sizes((1920, 1080), (1920, 1080))  # by which buffers are sorted
_FLAGS = {name: f"GFFE_TAKES_{name}" for name in ("LANES", "EXACT_DIVISION", "FLOAT_SUMS")}
# Fields of two choices, which are flags in C: whether it is the second one.
_FORMAT_FLAGS = {
    "rows": "rows_up",
    "color_encoding": "color_srgb",
    "motion_direction": "motion_from_previous",
    "motion_y": "motion_y_up",
}
# Constants of modules, and what stands before their names in C.
_TAKEN = (
    (camera, "", "MOST_ALPHA RIGIDITY_TOLERANCE MOST_FOCAL MOST_DISTANCE"),
    (frame_format, "", "MOST_JITTER MOST_PLANES MOST_RATIO"),
    (frame_block, "", "MU HEADROOM MOST_NUMBER MOST_RESTS"),
    (measures, "CUT_", "LEAST_SAMPLES LEAST_OVERLAP DEPTH_SURE DEPTH_UNSURE CONTRAST_RIGHT LEAST_CONTRASTS TELEPORT"),
)
_HEADER = "/* Made by `gffe export`; not to be edited. */\n"


def config(options: Options, occasions: Iterable[str]) -> str:
    """Return gffe_config.h: constants from Python's modules, and the options."""
    numbers = {
        "MOST_PIXELS": MOST_PIXELS,
        "LEAST_ALIGNMENT": LEAST_ALIGNMENT,
        "MAX_LEVELS": MAX_LEVELS,
        "MOST_TIMES": MAX_ORDER + 1,
        "LARGEST": validation.LARGEST,
        "LEAST_FRAME_RATE": validation.FRAME_RATES[0],
        "MOST_FRAME_RATE": validation.FRAME_RATES[1],
        "LEAST_EXPOSURE": validation.EXPOSURES[0],
        "MOST_EXPOSURE": validation.EXPOSURES[1],
        "SAME_POSE": SAME_POSE,
        "CUT_DETECTION": int(options.cut_detection),
        "CUT_SAMPLES_Y": CUT_SAMPLES[1],
    }
    numbers |= {prefix + name: getattr(module, name) for module, prefix, names in _TAKEN for name in names.split()}
    lines = [f"#define GFFE_{name} {number!r}" for name, number in numbers.items()]
    pictures = {"rendered": "", "extrapolated": "frame.color"} | pictures_of(stages_of(options))
    lines += [f'#define GFFE_{occasion.upper()}_PICTURE "{name}"' for occasion, name in pictures.items()]
    enums = {  # by the name of their number of members
        "counted": measures.COUNTED,
        "occasions": occasions,
        "named_grids": _NAMED_GRIDS,
        "first_buffers": [f"{name} = {2 * number}" for number, name in enumerate(GIVEN)],  # references
    }
    for most, names in enums.items():
        lines.append(f"enum {{ {', '.join(_constant_of(name) for name in (*names, most))} }};")
    lines.append(_frame_block())
    guard = '#ifndef GFFE_CONFIG_H\n#define GFFE_CONFIG_H\n\n#include "gffe.h"\n\n'
    return _HEADER + guard + "\n".join(lines) + "\n\n#endif\n"


def _constant_of(name: str) -> str:
    return f"GFFE_{name.upper().replace('.', '_')}"


class Tables:
    """Text of gffe_tables.c from two plans: without and with 64-bit atomics."""

    def __init__(self, plans: tuple[Launches, Launches]):
        self.plans = plans
        self.launched = sorted(
            {
                (operation.stage, operation.kernel)
                for plan in plans
                for operations in plan.operations.values()
                for operation in operations
                if operation.kind == "LAUNCH"
            }
        )
        self.programs = sorted({stage for stage, _ in self.launched})
        self.constants = bytearray(4)  # words; there is at least one
        self.grids = [*_NAMED_GRIDS]

    def text(self) -> str:
        parts = [
            _HEADER + '#include <math.h>\n#include <stddef.h>\n\n#include "gffe_internal.h"\n',
            *map(self._source, self.programs),
            self._programs(),
        ]
        parts += map(_trial, TRIALS)
        parts.append(_table("gffe_kernel", "gffe_kernels", map(self._kernel, self.launched)))
        parts += [f"const int gffe_kernel_count = {len(self.launched)};\n", _format_tables()]
        plans, rows = zip(*(self._plan(number, plan) for number, plan in enumerate(self.plans)), strict=True)
        parts += [_words("gffe_constants", bytes(self.constants)), _words("gffe_facts", _facts(self.plans[0]))]
        parts += [_table("gffe_grid", "gffe_grids", map(_layout, self.grids)), *plans]
        parts.append(_table("gffe_plan", "gffe_plans", rows))
        return "\n".join(parts)

    # ---- kernels ---------------------------------------------------------------------------------------

    def _stage(self, name: str) -> Stage:
        return self.plans[1].stages[name]

    def _source(self, name: str) -> str:
        return _lines(f"source_{name}", expand(f"{name}.cl"))

    def _programs(self) -> str:
        rows = []
        for name in self.programs:
            text = expand(f"{name}.cl")
            flags = [flag for choice, flag in _FLAGS.items() if choice in text]
            flags += ["GFFE_TAKES_INT64"] * isinstance(self._stage(name), NearestStage)
            flags += ["GFFE_OF_FORMATS"] * (name == Upload.name)
            count = len(text.splitlines())
            rows.append(f'"{name}", source_{name}, {count}, {" | ".join(flags) or "0"}')
        return _table("gffe_program", "gffe_programs", rows) + f"const int gffe_program_count = {len(rows)};\n"

    def _kernel(self, launched: tuple[str, str]) -> str:
        stage = self._stage(launched[0])
        kernel: Kernel = next(kernel for kernel in stage.kernels if kernel.name == launched[1])

        def number(value: int | str) -> str:
            if isinstance(value, str):
                return "GFFE_LANES" if value == "LANES" else str(int(stage.program.constants[value]))
            return str(value)

        sides = ", ".join(map(number, (*kernel.step, kernel.group or 0, kernel.group_rows)))
        if kernel.below and kernel.below not in self.grids:
            self.grids.append(kernel.below)
        below = self.grids.index(kernel.below) if kernel.below else -1
        return f'{self.programs.index(launched[0])}, "{kernel.name}", {sides}, {below}'

    # ---- plans -----------------------------------------------------------------------------------------

    def _plan(self, number: int, plan: Launches) -> tuple[str, str]:
        """Return the tables of a plan, and its row, which has pointers to them and their lengths."""
        buffers = _Buffers(plan, self.grids)
        arguments: list[str] = []
        lists = {
            occasion: [self._operation(operation, buffers, arguments) for operation in operations]
            for occasion, operations in plan.operations.items()
        }
        initial = [
            f"{buffers.names.index(name)}, {self._constant(content)}, {len(content)}"
            for name, content in plan.initial.items()
        ]
        parts = [
            _table("gffe_buffer", f"buffers_{number}", [buffers.row(name) for name in buffers.names], static=True),
            _table("gffe_argument", f"arguments_{number}", arguments, static=True),
            *(
                _table("gffe_operation", f"{occasion}_{number}", rows or ["0, 0, 0, 0, 0, 0, 0"], static=True)
                for occasion, rows in lists.items()
            ),
            _table("gffe_initial", f"initial_{number}", initial or ["0, 0, 0"], static=True),
        ]
        counted = ", ".join(f"{{{occasion}_{number}, {len(rows)}}}" for occasion, rows in lists.items())
        own = f"buffers_{number}, {len(buffers.names)}, arguments_{number}, initial_{number}, {len(initial)}"
        return "\n".join(parts), f"{own}, {{{counted}}}"

    def _operation(self, operation: Operation, buffers: _Buffers, arguments: list[str]) -> str:
        first = len(arguments)
        arguments += [self._argument(given, buffers) for given in operation.arguments]
        kernel = self.launched.index((operation.stage, operation.kernel)) if operation.kernel else 0
        grid = buffers.grid(operation.grid)
        target = buffers.reference(operation.buffer) if operation.buffer else "0"
        other = buffers.reference(operation.source) if operation.source else str(operation.byte)
        return f"GFFE_{operation.kind}, {kernel}, {grid}, {operation.repeats}, {first}, {target}, {other}"

    def _argument(self, given: Given, buffers: _Buffers) -> str:
        if given.buffer is not None:
            return f"GFFE_BUFFER, {buffers.reference(given.buffer)}, 0"
        if given.is_frame_block:
            return "GFFE_FRAME_BLOCK, 0, 0"
        assert given.constant is not None  # values other than buffers and the frame block
        return f"GFFE_CONSTANT, {self._constant(given.constant)}, {len(given.constant)}"

    def _constant(self, content: bytes) -> int:
        """Return where `content` is among the constants, in words. It is appended if it is not there yet."""
        content = content.ljust(-(-len(content) // 4) * 4, b"\0")
        start = self.constants.find(content)
        while start >= 0:
            if start % 4 == 0:
                return start // 4
            start = self.constants.find(content, start + 1)
        self.constants += content
        return (len(self.constants) - len(content)) // 4


def _layout(name: str) -> str:
    """Return the row of a grid, whose size gffe_values.c computes."""
    layout = grid_of(name).layout
    return ", ".join(f"{{{given[0]}, {given[1]}}}" if isinstance(given, tuple) else f"{given:d}" for given in layout)


class _Buffers:
    """The plan's buffers in C: those that launches name, those for callers, and memory that contains them. Parts
    come after their wholes."""

    def __init__(self, plan: Launches, grids: list[str]):
        self.plan, self.grids = plan, grids
        named = {
            name.removesuffix("'")
            for operations in plan.operations.values()
            for operation in operations
            for name in operation.buffers()
        }
        layers = {f"composition.{name}" for name in OVERLAYS}  # C takes those of its caller
        specs = {name: spec for name, spec in plan.buffers.items() if name in named or not spec.scratch}
        specs = {name: spec for name, spec in specs.items() if name not in layers}
        self.memory = {whole for name, spec in specs.items() if (whole := _whole(name, spec)) and whole not in specs}
        self.specs = specs | {name: plan.buffers[name] for name in sorted(self.memory)}
        self.names = [*GIVEN, *sorted(self.specs, key=self._order)]

    def reference(self, name: str) -> str:
        """Return a buffer's reference: twice its number, plus one for the previous frame's."""
        return str(2 * self.names.index(name.removesuffix("'")) + name.endswith("'"))

    def grid(self, name: str) -> int:
        """Return a grid's number. It is appended if it is not there yet."""
        if name not in self.grids:
            self.grids.append(name)
        return self.grids.index(name)

    def row(self, name: str) -> str:
        """Return the buffer's row of the C table."""
        if name in GIVEN:
            grid, nbytes = GIVEN[name]
            return f'"{name}", {self.grid(grid)}, 0, {nbytes}, 1, 0, 0, -1, GFFE_GIVEN, -1, -1'
        spec, whole = self.specs[name], _whole(name, self.specs[name])
        flags = ["GFFE_KEPT"] * spec.kept
        late = {"presentation": ["GFFE_LATE"], "composition": ["GFFE_OF_OVERLAYS"], "upload": ["GFFE_OF_FORMATS"]}
        flags += late.get(name.partition(".")[0], []) + ["GFFE_MEMORY"] * (name in self.memory)
        flags += ["GFFE_LENT"] * (name in self.plan.lent) + ["GFFE_LENT_BEFORE"] * (f"{name}'" in self.plan.lent)
        planes = 1 if name in self.memory else spec.planes
        number = self.names.index(whole) if whole else -1
        grid, level = self.grid(spec.grid), grid_of(spec.grid).level
        numbers = f"{grid}, {level}, {spec.bytes_per_pixel}, {planes}, {spec.border}, {spec.byte}, {number}"
        return f'"{name}", {numbers}, {" | ".join(flags) or "0"}, {self._use(name)}'

    def _order(self, name: str) -> tuple[int, int]:
        """Return the key by which buffers are sorted: wholes before their parts, large ones before small ones, so that
        C finds places for transient ones."""
        whole = _whole(name, self.specs[name])
        return 1 + self._order(whole)[0] if whole else 0, -self.specs[name].nbytes(_USUAL)

    def _use(self, name: str) -> str:
        """Return the numbers of the first and the last stage that use a transient buffer within an extrapolation, "-1,
        -1" for other buffers. The last is the number of stages if the buffer is of interest afterwards."""
        spec, stages = self.specs[name], list(self.plan.stages)
        if not spec.transient:
            return "-1, -1"
        lists = (self.plan.operations[occasion] for occasion in ("extrapolated", "extrapolated_first"))
        used = [stages.index(o.stage) for operations in lists for o in operations if name in o.buffers()]
        used = used or [stages.index(name.partition(".")[0])]
        return f"{min(used)}, {max(used) if spec.scratch else len(stages)}"


def _whole(name: str, spec: BufferSpec) -> str | None:
    """Return the name of the buffer that contains this one, None if it is no part of another."""
    return f"{name.partition('.')[0]}.{spec.part_of}" if spec.part_of else None


def _lines(name: str, text: str) -> str:
    """Return C code for a text as an array of lines: not every compiler takes long literals."""
    rows = [json.dumps(line + "\n", ensure_ascii=True) for line in text.splitlines()]
    return f"static const char *const {name}[] = {{\n    {f',{chr(10)}    '.join(rows)}\n}};\n"


def _trial(capability: str) -> str:
    """Return a kernel that shows a capability of devices."""
    name, source, items, expected = TRIALS[capability]
    lines = f"source_{capability}, {len(source.splitlines())}"
    numbers = ", ".join(f"(cl_ulong){number >> 32}u << 32 | {number & 0xFFFFFFFF}u" for number in expected)
    row = f'"{name}", {lines}, {items}, {{{numbers}}}'
    return _lines(f"source_{capability}", source) + f"const gffe_trial gffe_{capability} = {{{row}}};\n"


def _words(name: str, content: bytes) -> str:
    words = np.frombuffer(content, np.uint32)
    rows = [", ".join(f"{word}u" for word in words[k : k + 8]) for k in range(0, len(words), 8)]
    return f"const cl_uint {name}[] = {{\n    {f',{chr(10)}    '.join(rows)}\n}};\n"


def _format_tables() -> str:
    """Return the fields of gffe_format and the types of values, which are those of `FrameFormat`."""
    usual, rows, numbers = frame_format.FrameFormat(), [], {name: 1 + k for k, name in enumerate(frame_format.TYPES)}
    for name in (field.name for field in fields(usual) if field.name != "color_size"):
        value, choices = getattr(usual, name), frame_format.CHOICES.get(name, ())
        of = "GFFE_OF_COLOR" if name.startswith("color") else "GFFE_OF_GEOMETRY"
        if name == "geometry_size":  # counts by itself
            rows += [_field(side, "WHOLE", 0, 0, MOST_PIXELS, of="0") for side in ("geometry_width", "geometry_height")]
        elif name in _FORMAT_FLAGS or isinstance(value, bool):
            of = "GFFE_OF_COLOR | GFFE_OF_GEOMETRY" if name == "rows" else of
            rows.append(_field(_FORMAT_FLAGS.get(name, name), "FLAG", 0, of=of))
        elif name.endswith("_type"):
            allowed = sum(1 << numbers[each] for each in choices)
            rows.append(_field(name, "WHOLE", numbers[value], 1, len(numbers), allowed, of))
        elif choices:
            rows.append(_field(name, "WHOLE", choices.index(value), 0, len(choices) - 1, of=of))
        elif name in frame_format.CHANNELS:
            rows.append(_field(name, "WHOLE", value, *frame_format.CHANNELS[name], of=of))
        elif isinstance(value, tuple):
            rows += [
                _field(name, "REAL", each, of=of, place=f" + {k} * sizeof(double)") for k, each in enumerate(value)
            ]
        else:
            kind = "PLANE" if name in ("near_z", "far_z") else "OPTIONAL" if value is None else "REAL"
            rows.append(_field(name, kind, "NAN" if value is None else value, of=of))
    most = ", ".join(f"{most!r}" for _, most in frame_format.TYPES.values())
    sizes = ", ".join(str(np.dtype(dtype).itemsize) for dtype, _ in frame_format.TYPES.values())
    parts = [_table("gffe_field", "gffe_fields", rows), f"const int gffe_field_count = {len(rows)};\n"]
    parts += [
        f"const double gffe_type_most[] = {{1, {most}}};\n",
        f"const size_t gffe_type_bytes[] = {{0, {sizes}}};\n",
    ]
    return "".join(parts)


def _field(
    name: str, kind: str, usual: object, least: int = 0, most: int = 0, types: int = 0, of: str = "", place: str = ""
) -> str:
    """Return a row of `gffe_fields`."""
    return f'"{name}", offsetof(gffe_format, {name}){place}, GFFE_{kind}, {usual}, {least}, {most}, {types}, {of}'


def _facts(plan: Launches) -> bytes:
    """Return a frame block with the values that depend neither on the frame nor on the size."""
    block = np.zeros((), FRAME)
    for name in plan.facts.keys() - {"level_starts"}:
        block[name] = plan.facts[name]
    return block.tobytes()


def _frame_block() -> str:
    """Return the struct of frame.h in C."""
    lines = []
    for name in FRAME.names or ():
        dtype = FRAME[name]
        base, shape = (np.dtype(np.float32), (len(dtype.names), 4)) if dtype.names else dtype.subdtype or (dtype, ())
        kind = "cl_int" if base.kind == "i" else "cl_float"
        vector, count = str(shape[-1]) if shape else "", f"[{shape[0]}]" if len(shape) > 1 else ""
        lines.append(f"    {kind}{vector} {name}{count};")
    return "typedef struct gffe_frame_block {\n" + "\n".join(lines) + "\n} gffe_frame_block;"


def _table(kind: str, name: str, rows: Iterable[str], static: bool = False) -> str:
    body = ",\n".join(f"    {{{row}}}" for row in rows)
    return f"{'static ' * static}const {kind} {name}[] = {{\n{body}\n}};\n"
