"""Writer of videos of display values (`gffe run`, `gffe demo`)."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import closing
from itertools import chain
from pathlib import Path
from typing import cast

import numpy as np

from gffe_cl.engine.core.errors import GffeError, require_packages


def write_video(path: Path, frames: Iterable[np.ndarray], fps: float) -> None:
    """Write (H, W, 3) uint8 frames as H.264, in the container that the file's suffix names. Where a side is odd, the
    last row or column is doubled. Raises GffeError without the encoder's package, or when it fails, and
    whatever `frames` raise; the encoder has ended then."""
    require_video()
    import imageio_ffmpeg

    frames = (np.pad(frame, [(0, n % 2) for n in frame.shape[:2]] + [(0, 0)], "edge") for frame in frames)
    first = next(frames)
    try:
        writer = imageio_ffmpeg.write_frames(
            str(path),
            (first.shape[1], first.shape[0]),
            fps=cast(int, fps),  # its stub takes no fractions, ffmpeg does
            codec="libx264",
            macro_block_size=1,
            ffmpeg_log_level="error",
            output_params=["-crf", "16", "-preset", "fast", "-movflags", "+faststart"],
        )
        with closing(writer):
            writer.send(None)
            for frame in chain([first], frames):
                writer.send(np.ascontiguousarray(frame))
        if not path.stat().st_size:
            raise OSError("the encoder wrote nothing")
    except (OSError, RuntimeError) as error:
        raise GffeError(f"{path}: cannot write the video: {' '.join(str(error).split())[:200]}") from None


def require_video() -> None:
    """Raise GffeError unless the package that encodes videos is installed."""
    require_packages("a video", "video", "imageio_ffmpeg")
