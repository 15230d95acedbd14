"""Computation times of the frames that were shown last."""

from __future__ import annotations

from collections import defaultdict, deque

import numpy as np

HISTORY = 120  # computed frames in the plot
_MEAN = 20  # ... and in the means


class Timings:
    """Milliseconds of the last computed frames; `stages` are kernel times by stage, of shading correction with the time
    in the network, which `network` has alone, and that of its copies."""

    def __init__(self):
        self.stages: dict[str, deque[float]] = defaultdict(lambda: deque(maxlen=HISTORY))
        self.kernels: dict[tuple[str, str], deque[float]] = defaultdict(lambda: deque(maxlen=_MEAN))  # (stage, kernel)
        self._networks: deque[float] = deque(maxlen=_MEAN)
        self._copies: deque[float] = deque(maxlen=_MEAN)
        self._walls: deque[float] = deque(maxlen=_MEAN)
        self._readbacks: deque[float] = deque(maxlen=_MEAN)

    def add(self, frame) -> None:
        """Add the times of an computed Frame."""
        taken = dict(frame.milliseconds)
        network = taken.pop("network", 0.0)
        copies = taken.pop("network copies", 0.0)
        if "correction" in taken:
            taken["correction"] += network + copies
        self._networks.append(network)
        self._copies.append(copies)
        for name in self.stages.keys() - taken.keys():
            del self.stages[name]
        for name, milliseconds in taken.items():
            self.stages[name].append(milliseconds)
        kernels = {(stage, kernel): ms for stage, taken in frame.kernels.items() for kernel, ms in taken.items()}
        for name in self.kernels.keys() - kernels.keys():
            if name[0] in taken:
                kernels[name] = 0.0  # of a rendered frame, or of generated ones, alone
            else:
                del self.kernels[name]
        for name, milliseconds in kernels.items():
            if name not in self.kernels:  # as many frames as its stage has
                self.kernels[name].extend([0.0] * (len(self.stages[name[0]]) - 1) if name[0] in self.stages else [])
            self.kernels[name].append(milliseconds)
        self._walls.append(frame.wall_ms)
        self._readbacks.append(frame.readback_ms)

    def means(self) -> dict[str, float]:
        """Return the mean kernel times by stage, milliseconds."""
        return {name: _mean(list(values)[-_MEAN:]) for name, values in self.stages.items()}

    def of_stage(self, stage: str) -> dict[str, float]:
        """Return the mean times of a stage's kernels by their names, milliseconds."""
        return {kernel: _mean(values) for (owner, kernel), values in self.kernels.items() if owner == stage}

    def network(self) -> float:
        return _mean(self._networks)

    def copies(self) -> float:
        """Return the mean time of transfers from the device to the network's runtime and back, milliseconds."""
        return _mean(self._copies)

    def wall(self) -> float:
        """Return the mean time from taking a request to its images, milliseconds."""
        return _mean(self._walls)

    def readback(self) -> float:
        return _mean(self._readbacks)


def _mean(values) -> float:
    return float(np.mean(values)) if len(values) else 0.0
