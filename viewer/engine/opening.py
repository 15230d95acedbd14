"""Opening what the user names: a sequence's folder or a built-in scene."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from gffe_cl.formats import open_capture
from gffe_cl.scenes import is_scene, load_scene
from gffe_cl.viewer.engine.sources import FrameSource, RecordedSource, SceneSource


class ScenePlan(NamedTuple):
    """How built-in scenes are rendered."""

    width: int
    height: int
    seed: int


def make_source(target: str, window: str | None, plan: ScenePlan, device) -> FrameSource:
    """The sequence in the folder `target` (or of its sequence.json), else the scene of that name. Raises GffeError."""
    if is_scene(target):
        source = SceneSource(load_scene(target, plan.seed), device, plan.width, plan.height, window=window)
    else:
        source = RecordedSource(open_capture(Path(target).expanduser()), device, window if window == "off" else None)
    source.target = target
    return source
