"""Story of a pixel: every kind of pixel has one, which names the stage that made it."""

import pytest
from twin_cases import run

from gffe_cl.engine.inspection import names
from gffe_cl.engine.inspection.buffers import Moment, Shot
from gffe_cl.engine.inspection.explain.pixel_explain import pixel_story
from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.buffers import FILLED_BY

pytestmark = pytest.mark.device
OPTIONS = {
    "default": Options(shading_correction=False),
    "none filled": Options(shading_correction=False, hole_filling="none", levels=0),
    "dilated": Options.preset("performance"),
}


@pytest.mark.parametrize("name", OPTIONS)
def test_every_kind_of_pixel_has_a_story(device, name):
    case = run(device, 64, 48, OPTIONS[name])
    made, now = case.made, case.now
    cameras = now.camera, case.pipeline.shown_camera, case.past.camera
    on_device = case.pipeline.frames.current
    buffers = {f"rendered.{name}": getattr(on_device, name) for name in ("color", "depth", "motion")}
    buffers[names.FINAL] = made.color
    shot = Shot(Moment(3, made.alpha, made.time, made.camera, *cameras), buffers)
    filled_by, seen = made.numpy("filled_by"), {}
    for y in range(0, 48, 2):
        for x in range(0, 64, 2):
            label = int(filled_by[y, x])
            if seen.setdefault(label, 0) < 8:
                seen[label] += 1
                story = pixel_story(case.pipeline, shot, x, y)
                assert story.filled_by == dict(FILLED_BY)[label] and story.sentences and all(story.sentences)
    assert len(seen) >= (2 if name == "dilated" else 4), seen
