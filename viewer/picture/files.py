"""Files from the viewer's contents, written atomically."""

from __future__ import annotations

import contextlib
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
from gffe_cl.captures.video import require_video, write_video
from gffe_cl.engine.core.errors import GffeError

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

    path = Path(path)
    _require_image(path, rgba, (3, 4))
    with _faults(path, "the image"), _partial(path) as part:
        with open(part, "wb") as file:
            Image.fromarray(np.ascontiguousarray(rgba)).save(file, "PNG")
        os.replace(part, path)


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
    path = Path(path)
    if path.suffix.lower() not in VIDEO_SUFFIXES:
        raise GffeError(f"{path}: a video's name must end in {', '.join(VIDEO_SUFFIXES)}")
    if not (math.isfinite(fps) and fps > 0):
        raise GffeError(f"{path}: a video's frames per second must be positive, got {fps}")
    require_video()
    feed = _Feed(path, iter(frames), cancelled)
    with _faults(path, "the video"), _partial(path) as part:
        open(part, "wb").close()  # the encoder's own message would not name the problem
        first = feed.next()
        if first is not None:
            try:
                write_video(part, feed.rest(first), float(fps))
            except GffeError as error:
                feed.reraise()
                raise GffeError(f"{path}: cannot write the video: {_encoder_fault(path, str(error))}") from None
        feed.reraise()
        if feed.cancelled:
            return False
        if first is None:
            raise GffeError(f"{path}: there are no frames to export")
        if _frames_in(part) != feed.done:
            raise GffeError(f"{path}: cannot write the video: {_encoder_fault(path, '')}")
        os.replace(part, path)
    return True


class _Feed:
    """Hands frames to the encoder and ends early, so that it always ends in good order, where it is cancelled or
    where making a frame fails: the fault is kept for `reraise`."""

    def __init__(self, path: Path, frames: Iterator[np.ndarray], is_cancelled: Callable[[], bool]):
        self.path, self.frames, self.is_cancelled = path, frames, is_cancelled
        self.cancelled, self.done = False, 0
        self.fault: BaseException | None = None
        self.shape: tuple[int, ...] | None = None

    def next(self) -> np.ndarray | None:
        """Return the next frame, its sides even; None at the end."""
        try:
            frame: Any = None if self.is_cancelled() else next(self.frames, None)
            if frame is None:  # perhaps because it was cancelled while the frame was awaited
                self.cancelled = self.is_cancelled()
                return None
            _require_image(self.path, frame, (3,))
            self.shape = first = self.shape or frame.shape
            if frame.shape != first:
                raise GffeError(f"{self.path}: frame {self.done} is {_size(frame.shape)}, not {_size(first)}")
        except OSError as error:  # not a fault of the file that is being written
            self.fault = GffeError(f"{self.path}: cannot make frame {self.done}: {error.strerror or error}")
            return None
        except BaseException as fault:
            self.fault = fault
            return None
        self.done += 1
        height, width = frame.shape[:2]
        return np.pad(frame, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")

    def rest(self, frame: np.ndarray | None) -> Iterator[np.ndarray]:
        while frame is not None:
            yield frame
            frame = self.next()

    def reraise(self) -> None:
        if self.fault is not None:
            raise self.fault


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


@contextlib.contextmanager
def _partial(path: Path) -> Iterator[Path]:
    """Yield the path at which `path` is written until it is whole, with its suffix; remove that file at the end. Raises
    GffeError if `path` is a folder."""
    if path.is_dir():
        raise GffeError(f"{path}: is a folder")
    part = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        yield part
    finally:
        with contextlib.suppress(OSError):
            part.unlink()


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
