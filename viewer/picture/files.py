"""Files from the viewer's contents, written atomically."""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gffe_cl.captures.offline.run import _dump_channels
from gffe_cl.captures.sequence.exr import write_channels
from gffe_cl.captures.video import EncoderError, write_video
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.files import replacing, write_text

if TYPE_CHECKING:
    from gffe_cl.engine.inspection.layers import LayerSpec

VIDEO_SUFFIXES = (".mp4", ".mov", ".mkv")
_LONGEST_STEM = 120  # characters; file names end at 255 bytes


def unused_name(folder: Path, stem: str, suffix: str) -> Path:
    """Return a path in `folder` that nothing has yet: `stem`, else `stem_2`, `stem_3` …, then `suffix` (".png").
    Characters that file names should not have become "_"."""
    stem = re.sub(r"[^\w.@+=-]+", "_", stem).lstrip(".")[:_LONGEST_STEM] or "image"
    number, path = 1, Path(folder) / f"{stem}{suffix}"
    while os.path.lexists(path):
        number += 1
        path = Path(folder) / f"{stem}_{number}{suffix}"
    return path


def save_png(path: Path, rgba: np.ndarray) -> None:
    """Write (H, W, 3 or 4) uint8 display values. Raises GffeError, leaving nothing new."""
    from PIL import Image

    path = _not_a_folder(path)
    _require_image(path, rgba, (3, 4))
    with _faults(path, "the image"), replacing(path) as part:
        Image.fromarray(np.ascontiguousarray(rgba)).save(part, "PNG")


def save_json(path: Path, document: Any) -> None:
    """Write plain JSON. Raises GffeError, leaving nothing new."""
    with _faults(path, "the figures"):
        write_text(path, json.dumps(document, indent=1) + "\n")


def save_layers_exr(
    folder: Path,
    images: Mapping[str, np.ndarray],
    specs: Mapping[str, LayerSpec],
    cancelled: Callable[[], bool] = lambda: False,
    on_layer: Callable[[], None] = lambda: None,
) -> list[Path]:
    """Write each layer to `folder`/<layer>.exr, its channels named after its components ("Y" for a single one, "1.x" …
    for planes), float16 or float32. Returns the paths, none if `cancelled`, called before each layer, returned true.
    `on_layer` is called after each.

    `folder` is made if only it is missing. Then, and when GffeError is raised, no file has been added or changed.
    """
    folder = Path(folder)
    if not images:
        raise GffeError(f"{folder}: there are no layers to save")
    with _faults(folder, "the layers"):
        made = not folder.is_dir()
        if made:
            folder.mkdir()
        written = []
        try:
            written = _write_all(folder, images, specs, cancelled, on_layer)
        finally:
            if made and not written:
                shutil.rmtree(folder, ignore_errors=True)
        return written


def export_video(
    path: Path, frames: Iterator[np.ndarray], fps: float, cancelled: Callable[[], bool] = lambda: False
) -> bool:
    """Write (H, W, 3) uint8 frames of one size as H.264; odd sizes get one more row or column.

    Returns False if `cancelled` said so, asked before every frame and at the end. Then, and when GffeError is raised,
    no new file is left.
    """
    path = _not_a_folder(path)
    if path.suffix.lower() not in VIDEO_SUFFIXES:
        raise GffeError(f"{path}: a video's name must end in {', '.join(VIDEO_SUFFIXES)}")
    if not (math.isfinite(fps) and fps > 0):
        raise GffeError(f"{path}: a video's frames per second must be positive, got {fps}")
    written = 0

    def counted() -> Iterator[np.ndarray]:
        nonlocal written
        for frame in _even(path, iter(frames), cancelled):
            yield frame
            written += 1

    try:
        with _faults(path, "the video"), replacing(path) as part:
            open(part, "wb").close()  # the encoder's own message would not name the problem
            try:
                write_video(part, counted(), float(fps))
            except EncoderError as error:
                raise GffeError(f"{path}: cannot write the video: {_encoder_fault(path, str(error))}") from None
            if _frames_in(part) != written:
                raise GffeError(f"{path}: cannot write the video: {_encoder_fault(path, '')}")
    except _Cancelled:
        return False
    return True


class _Cancelled(Exception):
    """Nothing is to be saved any more."""


def _even(path: Path, frames: Iterator[np.ndarray], cancelled: Callable[[], bool]) -> Iterator[np.ndarray]:
    """Yield frames of one size with even sides. Raises _Cancelled, and GffeError where there are none or others."""
    shape, number = None, 0
    while True:
        if cancelled():
            raise _Cancelled
        try:
            frame: Any = next(frames, None)
        except OSError as error:  # not a fault of the file that is being written
            raise GffeError(f"{path}: cannot make frame {number}: {error.strerror or error}") from None
        if frame is None:
            break
        _require_image(path, frame, (3,))
        shape = shape or frame.shape
        if frame.shape != shape:
            raise GffeError(f"{path}: frame {number} is {_size(frame.shape)}, not {_size(shape)}")
        yield np.pad(frame, ((0, shape[0] % 2), (0, shape[1] % 2), (0, 0)), mode="edge")
        number += 1
    if cancelled():  # perhaps the frames ended because of that
        raise _Cancelled
    if not number:
        raise GffeError(f"{path}: there are no frames to export")


def _write_all(folder: Path, images, specs, cancelled, on_layer) -> list[Path]:
    """Write all layers, and return their paths, none if cancelled. All are whole in a folder of their own before the
    first one gets its name."""
    with tempfile.TemporaryDirectory(prefix=".layers.", dir=folder, ignore_cleanup_errors=True) as staging:
        for name, image in images.items():
            if cancelled():
                return []
            write_channels(Path(staging) / f"{name}.exr", _channels(specs[name], np.asarray(image)))
            on_layer()
        for name in images:
            os.replace(Path(staging) / f"{name}.exr", folder / f"{name}.exr")
    return [folder / f"{name}.exr" for name in images]


def _channels(spec: LayerSpec, image: np.ndarray) -> dict[str, np.ndarray]:
    """Return the channels of an image (planes?, H, W, components?) by name, each a contiguous (H, W)."""
    if len(spec.components) == 1 and image.ndim == 2 + (spec.planes > 1):
        image = image[..., None]
    return {name: np.ascontiguousarray(plane) for name, plane in _dump_channels(spec, image).items()}


def _not_a_folder(path: Path) -> Path:
    if Path(path).is_dir():
        raise GffeError(f"{path}: is a folder")
    return Path(path)


@contextlib.contextmanager
def _faults(path: Path, what: str) -> Iterator[None]:
    """Raise GffeError in place of OSError, in one line that names `path`."""
    try:
        yield
    except OSError as error:
        raise GffeError(f"{path}: cannot write {what}: {error.strerror or error}") from None


def _encoder_fault(path: Path, message: str) -> str:
    """Return why the encoder failed; where it just stopped reading, all that is known is how full the disk is."""
    detail = message.partition(": cannot write the video: ")[2].partition(" FFMPEG ")[0]
    if detail and "Broken pipe" not in detail:
        return detail
    free = shutil.disk_usage(path.parent).free
    return f"the encoder stopped before the end ({free >> 20} MiB are free on the disk)"


def _frames_in(path: Path) -> int | None:
    """Return the number of frames that can be decoded from a video, None if it cannot be read: the encoder does not
    report that its last bytes did not arrive."""
    import imageio_ffmpeg

    try:
        return imageio_ffmpeg.count_frames_and_secs(path)[0]
    except (OSError, RuntimeError):
        return None


def _require_image(path: Path, image: np.ndarray, channels: tuple[int, ...]) -> None:
    shape = getattr(image, "shape", ())
    if len(shape) != 3 or shape[2] not in channels or 0 in shape or image.dtype != np.uint8:
        wanted = " or ".join(map(str, channels))
        raise GffeError(f"{path}: expected (H, W, {wanted}) uint8, got {shape} {getattr(image, 'dtype', type(image))}")


def _size(shape: tuple[int, ...]) -> str:
    return f"{shape[1]}×{shape[0]}"
