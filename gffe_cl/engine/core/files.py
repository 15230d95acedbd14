"""File handling: files that are written whole or not at all, opened only if regular, and the files that other files may
refer to."""

from __future__ import annotations

import errno
import mimetypes
import os
import re
import stat
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO

try:
    import fcntl
except ImportError:  # not on Windows: no lock there
    fcntl = None

from gffe_cl.engine.core.errors import GffeError

_OPENING = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0)
_EXR_MAGIC = b"\x76\x2f\x31\x01"
VIDEOS = (".mp4", ".mov", ".mkv")  # that are written
_MEDIA = {  # first bytes of pictures and videos: where, and which
    ".png": (0, b"\x89PNG"),
    ".webp": (8, b"WEBP"),
    ".gif": (0, b"GIF8"),
    ".mp4": (4, b"ftyp"),
    ".mkv": (0, b"\x1aE\xdf\xa3"),
}
# In JSON that this program writes, and at the start of the metrics of `gffe demo` and the tables of `gffe eval`
_OWN = re.compile(
    rb'"(generator": "gffe-cl|frame_format":)|\A(\{\n "repeat": \{|sequence,method,region,metric,value\n)'
)
_MOST_SMALL, _MOST_PER_PIXEL, _MOST = 64 << 20, 512, 4 << 30  # bytes that an image may decode to


def open_regular(path: Path | str) -> BinaryIO:
    """Open a file for reading and return it. Raises OSError unless it is a regular file. Pipes and devices, which may
    never end or never begin, are not waited for."""
    return open(path, "rb", buffering=0, opener=lambda path, flags: descriptor_of(path, flags)[0])


def descriptor_of(path: Path | str, flags: int = os.O_RDONLY) -> tuple[int, int]:
    """Open a file as `open_regular` does, and return its file descriptor and its size in bytes. Raises OSError unless
    it is a regular file."""
    descriptor = os.open(path, flags | _OPENING)
    status = os.fstat(descriptor)
    try:
        _require_regular(status)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor, status.st_size


def read_bounded(path: Path | str, most: int) -> bytes:
    """Return the content of a regular file of at most `most` bytes. Raises OSError for any other."""
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > most:
            raise OSError(errno.EFBIG, f"{size} bytes, expected at most {most}")
        return file.read(size)


def require_readable(path: Path, label: str) -> None:
    """Raise a GffeError that begins with `label` unless the file at `path` exists and is a regular one."""
    try:
        _require_regular(os.stat(path))
    except FileNotFoundError:
        raise GffeError(f"{label}: no such file in {path.parent}") from None
    except (OSError, ValueError) as error:
        raise GffeError(f"{label}: cannot be read ({getattr(error, 'strerror', None) or error})") from None


def _require_regular(status: os.stat_result) -> None:
    if not stat.S_ISREG(status.st_mode):
        kind = "a folder" if stat.S_ISDIR(status.st_mode) else "a pipe or a device"
        raise OSError(errno.EINVAL, f"is {kind}, expected a regular file")


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path that replaces the file `path` when the block ends. After an exception `path` is unchanged.
    OSErrors name `path`.

    What is written for a pipe or a device (`/dev/stdout`, wherever it leads) is copied into it then. Raises GffeError
    for a named pipe that nobody reads, which would be waited for forever.
    """
    target = Path(os.path.realpath(path))
    is_file = not os.path.abspath(path).startswith("/dev/") and (target.is_file() or not target.exists())
    with ExitStack() as stack:
        folder = target.parent if is_file else Path(stack.enter_context(TemporaryDirectory(prefix="gffe-")))
        part = folder / f".{target.stem}.part{target.suffix}"
        try:
            yield part
            if is_file:
                os.replace(part, target)
            else:
                _pour(part, path)
        except OSError as error:
            if error.filename in (None, str(part)):
                error.filename, error.filename2 = str(path), None
            raise
        finally:
            with suppress(OSError):
                part.unlink()


def _pour(part: Path, target: Path) -> None:
    """Append a file to a pipe, a device, or a file that is already open."""
    try:
        descriptor = os.open(target, os.O_WRONLY | os.O_APPEND | _OPENING)
    except OSError as error:
        if error.errno == errno.ENXIO:
            raise GffeError(f"{target}: cannot be written to (expected a program that reads it)") from None
        raise
    os.set_blocking(descriptor, True)
    with open(descriptor, "wb") as file:
        file.write(part.read_bytes())


Files = dict[str, bytes]  # content by relative path


def packed_files(path: Path) -> Files:
    """Return the files in a folder, or a file and those beside it that have its stem."""
    root = path if path.is_dir() else path.parent
    found = path.rglob("*") if path.is_dir() else (one for one in root.iterdir() if one.stem == path.stem)
    return {str(one.relative_to(root)): one.read_bytes() for one in sorted(found) if one.is_file()}


def unpack(packed: Files, root: Path) -> None:
    """Write files into the folder `root`."""
    for file, content in packed.items():
        (root / file).parent.mkdir(parents=True, exist_ok=True)
        (root / file).write_bytes(content)


def write_text(path: Path, text: str) -> None:
    """Write `text` as UTF-8, whole or not at all; names of files that are not UTF-8 appear in it with escapes."""
    with replacing(path) as part:
        part.write_bytes(text.encode("utf-8", "backslashreplace"))


def model_source(path: Path | str) -> str | bytes:
    """Return the argument for onnxruntime for the model at `path`: the name if it is UTF-8, else the bytes."""
    try:
        str(path).encode("utf-8")
    except UnicodeError:
        return Path(path).read_bytes()
    return str(path)


@contextmanager
def made_folder(path: Path) -> Iterator[None]:
    """Make the folder `path` and its parents; after an exception those that were made are removed, if they are empty.
    Raises OSError."""
    missing = []
    while not path.is_dir():
        missing.append(path)
        path = path.parent
    with ExitStack() as made:
        for folder in reversed(missing):
            made.callback(_remove_if_empty, folder)
            folder.mkdir(exist_ok=True)
        yield
        made.pop_all()


def _remove_if_empty(folder: Path) -> None:
    with suppress(OSError):
        folder.rmdir()


@contextmanager
def only_process(folder: Path) -> Iterator[None]:
    """Make `folder` and keep other processes that call this function out of it during the block. Raises GffeError if
    one is there, or if nothing can be written. The lock ends with its process."""
    path = folder / ".lock"
    with ExitStack() as stack:
        try:
            stack.enter_context(made_folder(folder))
            file = stack.enter_context(open(path, "a"))
            ours = lock(file) and os.path.samestat(os.fstat(file.fileno()), os.stat(path))
        except OSError as error:
            raise GffeError(f"{folder}: cannot be written to ({error.strerror or error})") from None
        if not ours:
            raise GffeError(f"{folder}: another process is writing into it (expected its end)")
        try:
            yield
        finally:
            path.unlink(missing_ok=True)


def lock(file) -> bool:
    """Return whether the lock of this file was free. Then this process holds it until the file is closed. On file
    systems without locks the result is always true."""
    if fcntl is not None:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        except OSError:
            return True
    return True


def is_video(path: Path) -> bool:
    """Return whether the name of a file is that of a video."""
    kind = mimetypes.guess_type(path.name)[0] or ""
    return path.suffix.lower() in VIDEOS or kind.startswith("video/")


def require_output_file(path: Path, option: str, overwrite: bool = False, media: bool = False) -> Path:
    """Return `path`. Raises a GffeError that names the `option` unless a report, or with `media` a picture or video,
    may be written there: into a folder that exists, not over a file of a sequence, and without `overwrite` only over a
    file of the same kind, of reports one that this program wrote."""
    folder = path.absolute().parent
    if path.is_dir() or path.is_socket() or not folder.is_dir():
        raise GffeError(f"{option} {path}: must be a file in a folder that exists")
    if not os.access(folder if path.is_file() or not path.exists() else path, os.W_OK):
        raise GffeError(f"{option} {path}: cannot be written to (expected a folder with permission)")
    if path.name == "sequence.json" or path.suffix.lower() == ".exr" or _beginning(path).startswith(_EXR_MAGIC):
        raise GffeError(f"{option} {path}: is a file of a sequence (expected another file)")
    if not overwrite and path.is_file() and not os.path.abspath(path).startswith("/dev/"):
        head = _beginning(path)
        kind = next((name for name, (start, magic) in _MEDIA.items() if head[start:].startswith(magic)), None)
        if not (kind == path.suffix.lower().replace(".mov", ".mp4") if media else not head or _OWN.search(head)):
            what = "of another kind" if media else "that gffe-cl did not write"
            raise GffeError(f"{option} {path}: is a file {what} (expected another file, or --overwrite)")
    return path


def _beginning(path: Path) -> bytes:
    """Return the first bytes of a regular file, none of one that cannot be read."""
    with suppress(OSError), open_regular(path) as file:
        return file.read(1 << 16)
    return b""


def require_moderate(nbytes: int, pixels: int, label: str) -> None:
    """Raise a GffeError that begins with `label` where decoding would take more memory than an image of so many pixels
    can need: 512 bytes for each, as in 128 channels of floats, but 64 MiB for small ones and 4 GiB at most."""
    most = min(max(_MOST_SMALL, _MOST_PER_PIXEL * pixels), _MOST)
    if nbytes > most:
        raise GffeError(
            f"{label}: {nbytes / 2**20:.4g} MiB to decode (expected at most {most / 2**20:.4g} MiB for {pixels} pixels)"
        )
