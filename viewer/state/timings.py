"""What the last computed frames took."""

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
        self._networks: deque[float] = deque(maxlen=_MEAN)
        self._copies: deque[float] = deque(maxlen=_MEAN)
        self._walls: deque[float] = deque(maxlen=_MEAN)
        self._readbacks: deque[float] = deque(maxlen=_MEAN)

    def add(self, result) -> None:
        """Of an engine's Result."""
        taken = dict(result.milliseconds)
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
        self._walls.append(result.wall_ms)
        self._readbacks.append(result.readback_ms)

    def means(self) -> dict[str, float]:
        """Kernel time by stage."""
        return {name: _mean(list(values)[-_MEAN:]) for name, values in self.stages.items()}

    def network(self) -> float:
        return _mean(self._networks)

    def copies(self) -> float:
        """From the device to what runs the network, and back."""
        return _mean(self._copies)

    def wall(self) -> float:
        """From taking a request to its images."""
        return _mean(self._walls)

    def readback(self) -> float:
        return _mean(self._readbacks)


def _mean(values) -> float:
    return float(np.mean(values)) if len(values) else 0.0
