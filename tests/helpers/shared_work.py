"""Work for pipelines that share a device: its result, as a hash."""

from dataclasses import replace

from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.selftest.reference import digest
from gffe_cl.engine.selftest.scene import FPS, display_camera

SIZES = ((64, 36), (81, 47))
TURNS = 3


def work(device, size, seen, turns=TURNS):
    """Return the hash of the frames that a pipeline makes, `turns` times from a reset on."""
    pipeline, found = Pipeline(device, *size, Options(shading_correction=False)), []
    for turn in range(turns):
        for k, frame in enumerate(seen):
            pipeline.submit(replace(frame, time=frame.time + turn, reset=k == 0))
            made = pipeline.extrapolate(display_camera(frame.time + 0.5 / FPS, *size), frame.time + turn + 0.5 / FPS)
            found += [made.numpy("color"), made.numpy("depth"), made.numpy("filled_by")]
    return digest(*found)
