"""Memory that stages lend each other, so that the pipeline needs less of it.

A stage lends memory that it does not need itself between one `submit` and the next, or once it has worked on the
rendered frame. Transient and fleeting buffers of all stages lie there: several in one place, if no stage works with
more than one of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import Any, Protocol

import pyopencl as cl

from gffe_cl.engine.stages.buffers import BufferSpec, Sizes, grid_of

_EXTRAPOLATE = 1000  # more than there are stages


class Worker(Protocol):
    """A stage, as far as memory is concerned."""

    name: Any
    kernels: Any
    buffer: dict[str, cl.Buffer]

    def own(self, name: str) -> cl.Buffer:
        """Return a buffer of the stage."""
        ...

    def allocate(self, specs: Iterable[BufferSpec]) -> dict[str, cl.Buffer]:
        """Return new buffers by name."""
        ...


Lent = tuple[Worker, str]  # a stage, and its name for the memory


class LentMemory:
    """Places of borrowed buffers in lent memory. `stages`: all of a pipeline, by name, in the order of their work."""

    def __init__(self, sizes: Sizes, stages: Mapping[str, Worker]):
        self.borrowing: list[tuple[Worker, BufferSpec]] = []  # transient and fleeting buffers of all stages so far
        self.lent: dict[Lent, int] = {}  # the work (see `_use`) after which memory is free
        self._sizes, self._stages = sizes, stages
        self._parts: list[cl.Buffer] = []  # in the order in which they were made

    def part(self, whole: cl.Buffer, start: int, nbytes: int) -> cl.Buffer:
        """Return the part of a buffer that begins at byte `start`. It is released by `let_go`, whoever still has it:
        NVIDIA's driver (580.159) crashes unless parts that overlap, and that kernels used, are released in the reverse
        of the order in which they were made."""
        self._parts.append(whole.get_sub_region(start, nbytes))
        return self._parts[-1]

    def lend(self, stage: Worker, name: str, at_once: bool = False) -> None:
        """Lend the buffer `name` of `stage`, after `submit` or, `at_once`, after its own work there."""
        self.lent[stage, name] = list(self._stages).index(stage.name) if at_once else _EXTRAPOLATE - 1

    def place(self) -> None:
        """Give every borrowed buffer its place in lent memory, or memory of its own if none is lent. Call it once all
        stages exist, and after every swap, which moves what lies in memory of the frame before."""
        for stage, spec in self.borrowing:
            place = self.places[stage.name, spec.name]
            if spec.name in stage.buffer and not (place and place[0][1].endswith("'")):
                continue
            if place:
                (owner, name), start = place
                given = {spec.name: self.part(owner.own(name), start, spec.nbytes(self._sizes))}
            else:
                given = stage.allocate([spec])
            stage.buffer = stage.buffer | given

    @cached_property
    def places(self) -> dict[tuple[str, str], tuple[Lent, int] | None]:
        """Place of each borrowed buffer, largest first, but lists of pixels last, of which little is ever touched: the
        lent memory that holds it, and the first byte there. None where none fits."""
        places: dict = {}
        taken: dict[Lent, list] = {lent: [] for lent in self.lent}
        order = sorted(self.borrowing, key=lambda one: (grid_of(one[1].grid).is_list, -one[1].nbytes(self._sizes)))
        for stage, spec in order:
            nbytes, used = spec.nbytes(self._sizes), self.use(stage, spec)
            free = {lent: parts for lent, parts in taken.items() if self.lent[lent] < min(used)}
            starts = {lent: _free_start(parts, nbytes, used) for lent, parts in free.items()}
            fitting = (lent for lent, start in starts.items() if start + nbytes <= lent[0].own(lent[1]).size)
            lent = next(fitting, None)
            places[stage.name, spec.name] = lent and (lent, starts[lent])
            if lent:  # a byte more: texels of one index must not take each other's place in caches
                taken[lent].append((starts[lent], self._sizes.aligned(starts[lent] + nbytes + 1), used))
        return places

    def use(self, stage: Worker, spec: BufferSpec) -> frozenset[int]:
        """Return the numbers of the work during which a buffer is in use: of the stages on the rendered frame, and then
        on the new one. It ends with the last stage that names the buffer, or with all if it is of interest afterwards.
        """
        name, used = f"{stage.name}.{spec.name}", []
        for number, other in enumerate(self._stages.values()):
            names_it = any(name in kernel.buffers.values() for kernel in other.kernels)
            if names_it or other is stage or (used and not spec.scratch):
                used.append(number)
        start = 0 if spec.fleeting else _EXTRAPOLATE
        return frozenset(range(start + used[0], start + used[-1] + 1))

    def let_go(self) -> None:
        """Drop the references to the stages, and release the parts of buffers."""
        for known in (self.borrowing, self.lent, self.__dict__.get("places", {})):
            known.clear()
        while self._parts:
            self._parts.pop().release()


def _free_start(parts: Iterable[tuple[int, int, frozenset[int]]], nbytes: int, used: frozenset[int]) -> int:
    """Return the first byte from which on `nbytes` are free at the time of the stages `used`; parts: from, to, used."""
    start = 0
    for begin, end, _ in sorted(part for part in parts if part[2] & used):
        if start + nbytes <= begin:
            break
        start = max(start, end)
    return start
