"""Local sockets between processes of one user: where they are, who may connect, and messages over them."""

from __future__ import annotations

import errno
import fcntl
import os
import pickle
import re
import socket
import stat
import struct
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from gffe_cl.core.errors import GffeError
from gffe_cl.core.validation import shown

_NAME = re.compile(r"[\w.-]{1,64}", re.ASCII)
_LONGEST_PATH = 107  # bytes, of a Unix socket
_LARGEST = 1 << 20  # bytes of a message; the kernel refuses those that are larger than its buffers
_MOST_FDS = 2
_SEND_SECONDS = 0.2  # who does not read for so long is given up


def require_linux() -> None:
    """GffeError on other systems."""
    if sys.platform != "linux":
        raise GffeError(f"attach: this system is {sys.platform} (expected Linux, for memfd_create and SO_PEERCRED)")


def require_name(name: str) -> str:
    """The name of a program, as users type it."""
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise GffeError(f"attach: name must be 1 to 64 letters, digits, '.', '_' or '-', got {shown(name)}")
    return name


def socket_folder() -> Path:
    """Where the sockets are: made if it is missing. GffeError unless it belongs to this user alone."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    there = runtime if runtime and os.path.isdir(runtime) else None  # some containers name one that there is not
    folder = Path(there) / "gffe-cl" if there else Path(tempfile.gettempdir()) / f"gffe-cl-sockets-{os.getuid()}"
    try:
        with suppress(FileExistsError):
            folder.mkdir(mode=0o700)
        state = folder.lstat()
    except OSError as error:
        raise GffeError(f"attach: {folder}: {error.strerror} (expected a folder that can be written to)") from None
    if not stat.S_ISDIR(state.st_mode) or state.st_uid != os.getuid() or state.st_mode & 0o077:
        raise GffeError(f"attach: {folder} must be a folder that only you can enter (chmod 700)")
    return folder


class Channel:
    """Messages between two processes of one user, each with file descriptors if need be.

    Messages are pickled: that is safe, since whoever could send others may do all that this process may.
    """

    def __init__(self, connected: socket.socket):
        self._socket = connected
        connected.settimeout(None)
        seconds = struct.pack("ll", int(_SEND_SECONDS), int(_SEND_SECONDS % 1 * 1e6))
        connected.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, seconds)
        connected.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _LARGEST)

    def send(self, message: Any, fds: tuple[int, ...] = ()) -> None:
        """OSError if the other side has ended, or does not read."""
        socket.send_fds(self._socket, [pickle.dumps(message)], fds)

    def receive(self, seconds: float | None = None) -> tuple[Any, list[int]]:
        """The next message, and the descriptors that came with it. EOFError if the other side has ended; TimeoutError
        after `seconds`."""
        self._socket.settimeout(seconds)
        try:
            data, fds, _, _ = socket.recv_fds(self._socket, _LARGEST, _MOST_FDS)
        except TimeoutError:
            raise
        except OSError as error:
            raise EOFError from error
        if not data:
            raise EOFError
        return pickle.loads(data), fds

    def close(self) -> None:
        """Wakes who waits in `receive`, here and on the other side."""
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()


class Listener:
    """Waits for viewers at a socket of the name `name`, or of `stem` with a number if that is taken; GffeError for a
    `name` that is."""

    def __init__(self, name: str | None, stem: str):
        require_linux()
        self._pid = os.getpid()
        with _folder_to_oneself() as folder:
            taken = set(_living(folder))
            if name is None:
                name, number = stem, 1
                while name in taken:
                    name, number = f"{stem}-{number + 1}", number + 1
            if require_name(name) in taken:
                raise GffeError(f"attach: a program is attached as '{name}' already (expected another name)")
            self.name, self._path = name, _path(folder, name)
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            self._socket.bind(str(self._path))
            self._socket.listen(8)

    def accept(self) -> Channel:
        """The next viewer of this user; others are sent away. OSError once it is closed."""
        while True:
            connected, _ = self._socket.accept()
            if _peer_uid(connected) == os.getuid():
                return Channel(connected)
            connected.close()

    def close(self) -> None:
        """Wakes who waits in `accept`. In a forked child the socket stays the parent's."""
        if os.getpid() == self._pid:
            with suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)
            with suppress(OSError):
                self._path.unlink()
        self._socket.close()


def connect(name: str) -> Channel:
    """Connect to the program attached as `name`. Raises GffeError if there is none, or if it is another user's."""
    require_linux()
    require_name(name)
    with _folder_to_oneself() as folder:
        living = list(_living(folder))
        connected = _connected(_path(folder, name))
    if connected is None:
        there = f"there are: {', '.join(living)}" if living else "no program is: gffe_cl.attach(pipeline) does it"
        raise GffeError(f"no program is attached as '{name}' ({there})")
    if _peer_uid(connected) != os.getuid():
        connected.close()
        raise GffeError(f"the program '{name}' is another user's (expected one of your own)")
    return Channel(connected)


def _peer_uid(connected: socket.socket) -> int:
    """Return the user of the process at the other end, from the kernel."""
    _, uid, _ = struct.unpack("3i", connected.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i")))
    return uid


def _path(folder: Path, name: str) -> Path:
    path = folder / f"{name}.socket"
    if len(os.fsencode(path)) > _LONGEST_PATH:
        raise GffeError(f"attach: {path} is longer than {_LONGEST_PATH} bytes (expected a shorter name)")
    return path


@contextmanager
def _folder_to_oneself() -> Iterator[Path]:
    """The folder, in which no other process binds or cleans meanwhile."""
    folder = socket_folder()
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield folder
    finally:
        os.close(descriptor)


def _living(folder: Path) -> Iterator[str]:
    """Return names of attached programs, and remove the files of dead ones."""
    for path in sorted(folder.glob("*.socket"), key=lambda path: path.stem):
        connected = _connected(path)
        if connected is not None:
            connected.close()
            yield path.stem
        else:
            path.unlink(missing_ok=True)


def _connected(path: Path) -> socket.socket | None:
    """Return the connection, None if nobody listens any more."""
    connected = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    try:
        connected.connect(str(path))
    except OSError as error:
        connected.close()
        if error.errno in (errno.ECONNREFUSED, errno.ENOENT):
            return None
        raise GffeError(f"attach: {path}: {error.strerror}") from None
    return connected
