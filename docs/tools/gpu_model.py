"""Model of the time that a frame pair takes on GPUs: computed from what is recorded, never measured.

Instructions are those that `gffe bench --traffic` counts, as LLVM has them, times what a GPU's compiler makes of them
(docs/measured/gpu_compilers.json). Bytes are those that it counts, as far as caches do not serve them. The network's
convolutions are counted from its layers. The rest are the constants here.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial

from pages import recorded, table

SCENE, PIXELS = "plaza", 1920 * 1080
REFERENCE = "sm_86"  # the GPU for which `Assumptions.machine` holds


@dataclass(frozen=True)
class Gpu:
    """A GPU by its data sheet. `compiled`: the GPU of the record that stands for it; `widest`: work-items of one
    instruction, of which wider programs have several."""

    name: str
    compiled: str
    widest: int
    instructions: float  # 10⁹ per second, of all work-items that run at once
    bandwidth: float  # GB/s


GPUS = (
    Gpu("RTX 4070 Ti Super", "sm_86", 32, 66 * 128 * 2.61, 672),
    Gpu("Intel Xe, 96 EU", "dg2-g10", 16, 96 * 8 * 1.35, 100),
)


@dataclass(frozen=True)
class Assumptions:
    """Figures that no data sheet has."""

    machine: float  # instructions of the reference GPU for one of LLVM, which may compute a vector of four
    active: float  # share of active work-items among those that run in step
    issued: float  # share of the instructions per second that kernels reach, at half of the hardware's threads or more
    caches: float  # share of the bytes loaded and stored that caches do not serve
    bandwidth: float  # share of the data sheet's bandwidth that is reached
    per_command: float  # microseconds from the end of a command to the start of the next
    host: float  # microseconds of the host's processor for each command


KIND = Assumptions(1.5, 0.9, 0.8, 0.36, 0.9, 2, 30)
HARSH = Assumptions(2.5, 0.7, 0.6, 0.44, 0.7, 6, 80)


@dataclass(frozen=True)
class Times:
    """Milliseconds of a part of the work: instructions alone, memory alone, gaps between commands; `gpu`: those gaps,
    and of each kernel the longer of instructions and memory; the host's processor."""

    instructions: float
    memory: float
    commands: float
    gpu: float
    host: float

    def __add__(self, other: Times) -> Times:
        return Times(*(a + b for a, b in zip(vars(self).values(), vars(other).values(), strict=True)))


def model(gpu: Gpu, assumed: Assumptions, group: str) -> Times:
    """Return the time of a frame pair's "GAE" or "SCN", the shading correction without its convolutions."""
    from gffe_cl.engine.timing.parts import group as group_of

    kernels = {
        name: moved
        for name, moved in recorded("traffic")["lanes"]["1"].items()
        if group_of(name.partition(".")[0]) == group
    }
    instructions = {name: PIXELS * _nanoseconds(gpu, assumed, name, moved) * 1e-6 for name, moved in kernels.items()}
    per_byte = assumed.caches / (assumed.bandwidth * gpu.bandwidth * 1e6)  # milliseconds
    memory = {name: PIXELS * (moved["loaded"] + moved["stored"]) * per_byte for name, moved in kernels.items()}
    number = recorded("memory")[SCENE]["commands"][group]
    commands = number * assumed.per_command * 1e-3
    longer = sum(max(instructions[name], memory[name]) for name in kernels)
    host = number * assumed.host * 1e-3
    return Times(sum(instructions.values()), sum(memory.values()), commands, longer + commands, host)


def _nanoseconds(gpu: Gpu, assumed: Assumptions, kernel: str, counted: dict[str, float]) -> float:
    """Return the time of a kernel's instructions for one pixel of the display."""
    costs = recorded("gpu_compilers")["kernels"].get(kernel)
    if costs is None:  # fills
        return 0.0
    own, reference = costs[gpu.compiled], costs[REFERENCE]
    made = own["instructions"] * min(1.0, gpu.widest / own["simd"]) / reference["instructions"]
    executed = counted["executed"] * assumed.machine * made
    reached = assumed.issued * min(1.0, 2 * own["occupancy"])
    return executed / (assumed.active * reached * gpu.instructions)


def convolutions(gpu: Gpu, assumed: Assumptions) -> Times:
    """Return the time of the network's convolutions: an instruction for each product in floats, and for four products
    of bytes; an image moves once for each layer that reads or writes it."""
    from gffe_cl.engine.inference.integer_layers import read_layers
    from gffe_cl.engine.inference.model_interface import CANDIDATE_PLANES, INPUT_PLANES, JUDGEMENT_PLANES
    from gffe_cl.engine.inference.sessions import PACKAGED, cpu_model
    from gffe_cl.engine.stages.buffers import Sizes

    sizes = Sizes((1920, 1080), (1920, 1080))
    pixels = [math.prod(sizes.of(f"network{level}")) for level in range(5)]
    given = {"first": 4 * INPUT_PLANES * pixels[0], "taken": 4 * CANDIDATE_PLANES * pixels[1]}
    issued = assumed.active * assumed.issued * gpu.instructions * 1e6 / assumed.machine  # a millisecond
    per_byte = 1 / (assumed.bandwidth * gpu.bandwidth * 1e6)
    layers = read_layers(cpu_model(PACKAGED)).layers
    times = []
    for layer in layers:
        products = pixels[layer.level] * layer.weights.size / (4 if layer.kind == "convolution" else 1)
        moved = given.get(layer.kind, 0) + sum(image.channels * pixels[image.level] for image in layer.sources)
        made = sum(image.channels for image in layer.targets) or 4 * JUDGEMENT_PLANES
        times.append((products / issued, (moved + made * pixels[layer.level]) * per_byte))
    instructions, memory = (sum(part) for part in zip(*times, strict=True))
    commands = len(layers) * assumed.per_command * 1e-3
    longer = sum(map(max, times))
    return Times(instructions, memory, commands, longer + commands, len(layers) * assumed.host * 1e-3)


# ---- tables ------------------------------------------------------------------------------------------------------


def model_table() -> str:
    rows = []
    for gpu in GPUS:
        parts = {
            name: [made(gpu, assumed) for assumed in (KIND, HARSH)]
            for name, made in (
                ("GAE", partial(model, group="GAE")),
                ("network, convolutions", convolutions),
                ("network, all else", partial(model, group="SCN")),
            )
        }
        parts["together"] = [a + b + c for a, b, c in zip(*parts.values(), strict=True)]
        for name, times in parts.items():
            cells = (_range(getattr(one, part) for one in times) for part in Times.__annotations__)
            rows.append((f"{gpu.name}, {name}", *cells))
    heads = ("computed, ms", "instructions", "memory", "commands", "on the GPU", "the host's commands")
    return table(heads, rows)


def on_the_gpu(group: str) -> str:
    """Return the range of milliseconds on the first GPU."""
    return _range(model(GPUS[0], assumed, group).gpu for assumed in (KIND, HARSH))


def assumptions_table() -> str:
    said = {
        "machine": "instructions of sm_86 for one of LLVM",
        "active": "active work-items among those that run in step",
        "issued": "instructions per second, share of the data sheet's",
        "caches": "share of loads and stores that caches do not serve",
        "bandwidth": "memory bandwidth, share of the data sheet's",
        "per_command": "between two commands, µs",
        "host": "processor time of the host for each command, µs",
    }
    assert list(said) == list(Assumptions.__annotations__)
    rows = [(text, f"{getattr(KIND, name):g}", f"{getattr(HARSH, name):g}") for name, text in said.items()]
    return table(("assumed", "kindly", "harshly"), rows)


def _range(values: Iterable[float], digits: int = 2) -> str:
    low, high = values
    if not high:
        return ""
    digits = digits if high < 10 else min(digits, 0 if low >= 10 else 1)
    return f"{low:.{digits}f}–{high:.{digits}f}"
