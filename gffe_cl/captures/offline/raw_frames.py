"""Rendered frames in the raw form that the exported example reads (`c/main.c` describes it)."""

from __future__ import annotations

import os
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory

from gffe_cl.captures.offline.source import Source
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.files import made_folder
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.camera_prediction import predict_camera_at
from gffe_cl.engine.frame.rendered_frame import display_camera_of, host_arrays


def write_frames(folder: Path, source: Source, count: int, alpha: float = 0.5) -> int:
    """Write the first `count` rendered frames of `source` into a folder, with the request of a new frame `alpha`
    intervals after each, seen by the camera that is known for it, else by the one that is predicted from the frames
    since the last reset. Return how many there are.

    Raises GffeError for frames with faults, and where the folder cannot be written.
    """
    cameras, times = [], []  # of the frames since the last reset, newest first
    lines = [f"gffe-raw 1 {source.width} {source.height} {' '.join(map(str, source.render_size))} {source.fps!r}"]
    try:
        with made_folder(folder), TemporaryDirectory(prefix=".gffe-frames-", dir=folder) as name:
            part = Path(name)
            for number, (_, frame) in enumerate(islice(source.frames([alpha], False), count)):
                name = f"{number:04}"
                arrays = host_arrays(frame).in_device_layout()
                for kind in ("color", "depth", "motion"):
                    getattr(arrays, kind).tofile(part / f"{name}.{kind}")
                shown = display_camera_of(frame, source.render_size, (source.width, source.height))
                both = f"{_numbers(frame.camera)} {_numbers(shown)}"
                lines.append(f"frame {name} {frame.time!r} {int(frame.reset)} {both}")
                cameras = [shown, *cameras * (not frame.reset)]
                times = [frame.time, *times * (not frame.reset)]
                time = source.time(number, alpha)
                known = source.cameras_at([time])
                camera = known[0] if known else predict_camera_at(time, cameras, times)
                lines.append(f"make {name}_made {time!r} {_numbers(camera)}")
            (part / "frames.txt").write_text("\n".join(lines) + "\n", "ascii")
            for path in sorted(part.iterdir()):
                os.replace(path, folder / path.name)
    except OSError as error:
        raise GffeError(f"{error.filename or folder}: cannot write: {error.strerror or error}") from None
    return len(lines) // 2


def _numbers(camera: Camera) -> str:
    values = [*camera.world_to_view[:3].ravel().tolist(), *camera.intrinsics]
    return " ".join(repr(float(value)) for value in values)
