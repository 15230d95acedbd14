"""Layers of OpenEXR files: `layer.component` in one part or in parts of their own, whatever program wrote them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence as Ordered

from gffe_cl.captures.sequence.exr_layout import ExrHeader

Place = tuple[int, str]  # part, channel in it


def layers_of(header: ExrHeader) -> dict[str, dict[str, Place]]:
    """Return a map of layer (all but the last word, "" for plain channels) → component → place, in the order of the
    file."""
    found: dict[str, dict[str, Place]] = defaultdict(dict)
    for index, part in enumerate(header.parts):
        for channel in part.channels:
            whole = len(header.parts) == 1 or not part.name or channel.startswith(f"{part.name}.")
            layer, _, component = (channel if whole else f"{part.name}.{channel}").rpartition(".")
            found[layer].setdefault(component, (index, channel))
    return dict(found)


def holding(layers: dict[str, dict[str, Place]], name: str, components: Ordered[str]) -> list[str]:
    """Return the layers whose last word is `name` and that have all `components`."""
    return [
        layer
        for layer, places in layers.items()
        if layer.rpartition(".")[2].lower() == name.lower() and all(c in places for c in components)
    ]


def owner(layer: str) -> str:
    """Return the view layer of a pass: `ViewLayer` of `ViewLayer.Combined`."""
    return layer.rpartition(".")[0]
