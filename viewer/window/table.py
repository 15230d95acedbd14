"""Table of the panels: one line for each.

A panel is a module of this folder with a function `draw(app)`, which is called once per frame of the interface while
the panel is in view.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any, NamedTuple

from .interface import Interface


class Panel(NamedTuple):
    """A panel: the `space` of the window that it is docked in, the `module` that draws it, and whether it `is_open` at
    the first start."""

    space: str
    module: str
    is_open: bool = True

    def draw(self, app: Interface) -> None:
        module: Any = import_module(f".{self.module}", __package__)
        module.draw(app)


PANELS = {
    "Picture": Panel("MainDockSpace", "picture"),
    "Layers": Panel("Left", "layer_list"),
    "Histogram": Panel("Left", "histogram"),
    "Modules": Panel("Right", "modules"),
    "Compare": Panel("Right", "compare"),
    "Inspector": Panel("RightBottom", "inspector"),
    "Regions": Panel("RightBottom", "regions"),
    "Timings": Panel("RightBottom", "timings"),
    "Kernels": Panel("RightBottom", "kernels"),
    "Doctor": Panel("Right", "doctor", is_open=False),
    "Differences": Panel("Right", "differing", is_open=False),
    "Ablation": Panel("Right", "ablation", is_open=False),
    "Plot": Panel("Above", "plot", is_open=False),
    "Over time": Panel("Above", "over_time", is_open=False),
    "Timeline": Panel("Bottom", "timeline"),
}
