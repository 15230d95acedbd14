"""Work of other processes: of pipelines that share a device, its result a hash; and a cell of a cluster."""

import os
import signal
import time
from dataclasses import replace
from pathlib import Path

from gffe_cl.engine.core.errors import GffeError
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


def tried(output, path, number, seconds=0.0, dies=""):
    """A cell for workers of a cluster. `dies`: a file; the process that makes it is killed."""
    time.sleep(seconds)
    if dies and not Path(dies).exists():
        Path(dies).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if number < 0:
        raise GffeError(f"{path.name}: no number")
    (output / "part").mkdir()
    (output / "part" / "made.txt").write_bytes(b"x" * number)
    (output / "same.txt").write_text("as it came")
    return {"number": number, "content": (path / "same.txt").read_text(), "process": os.getpid()}
