"""Opening what the user names: a sequence's folder or a built-in scene."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from gffe_cl.doctor import quick_warning
from gffe_cl.formats import open_capture
from gffe_cl.scenes import is_scene, load_scene
from gffe_cl.viewer.engine.sources import FrameSource, RecordedSource, SceneSource


class ScenePlan(NamedTuple):
    """How built-in scenes are rendered."""

    width: int
    height: int
    seed: int


def make_source(target: str, window: str | None, plan: ScenePlan, device, check: bool = False) -> FrameSource:
    """The sequence in the folder `target` (or of its sequence.json), else the scene of that name. With `check` its
    warnings say whether the first frames of a sequence fit. Raises GffeError."""
    if is_scene(target):
        source = SceneSource(load_scene(target, plan.seed), device, plan.width, plan.height, window=window)
    else:
        sequence = open_capture(Path(target).expanduser())
        source = RecordedSource(sequence, device, window if window == "off" else None)
        suspicion = quick_warning(sequence, sequence.exposure) if check else None
        if suspicion:
            source.suspicions.append(f"{suspicion}; `gffe check {target}` says more")
    source.target = target
    return source
