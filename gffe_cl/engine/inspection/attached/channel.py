"""Local sockets between processes of one user: their addresses, who may connect, and messages over them.

Addresses are abstract, as Linux has them: names without files, which the kernel drops with the last process that has
the socket. Other users can see them, and are refused by what the kernel tells of a peer.
"""

from __future__ import annotations

import errno
import os
import re
import socket
import struct
import sys
import threading
import time
import weakref
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import shown

_NAME = re.compile(r"[\w.-]{1,64}", re.ASCII)
_LARGEST = 1 << 20  # bytes of a message; the kernel refuses those that are larger than its buffers
_MOST_FDS = 2
_PROTOCOL = "gffe-cl attach"
_SEND_SECONDS = 0.2  # who does not read for so long is given up
_CONNECT_SECONDS = 5.0
_RETRY_SECONDS = 0.1
_MOST_PROGRAMS = 1000
NO_ANSWER = "no answer (another viewer may be attached, or the program is stopped)"
_SOCKETS = Path("/proc/net/unix")  # lists all, the abstract ones with "@" in place of the zero byte


def require_linux() -> None:
    """Raise GffeError on other systems than Linux."""
    if sys.platform != "linux":
        raise GffeError(f"attach: this system is {sys.platform} (expected Linux, for memfd_create and SO_PEERCRED)")


def require_name(name: str) -> str:
    """Return `name` if it can be a program's, as users type it. Raises GffeError otherwise."""
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise GffeError(f"attach: name must be 1 to 64 letters, digits, '.', '_' or '-', got {shown(name)}")
    return name


def address_of(name: str) -> str:
    """Return the abstract address of this user's program of that name."""
    return f"\0gffe-cl/{os.getuid()}/{name}"


def own_version() -> str:
    """Return the version of the package. Both sides must have the same, since messages differ between versions."""
    try:
        return version("gffe-cl")
    except PackageNotFoundError:
        return "not installed"


class OtherVersion(Exception):
    """The other side has another version of the package, the argument."""


class Channel:
    """Packets between two processes of one user, each with file descriptors if need be.

    The first packet of either side is its version, in plain text: see `agree`. A forked child has no channel: its
    copies of the sockets are closed.
    """

    def __init__(self, connected: socket.socket):
        self._socket = connected
        connected.settimeout(None)
        _set_patience(connected, _SEND_SECONDS)
        connected.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _LARGEST)
        _sockets.add(connected)

    def agree(self, seconds: float) -> None:
        """Exchange versions. Raises OtherVersion if they differ; other exceptions as `send` and `receive`."""
        hello = f"{_PROTOCOL} {own_version()}\n".encode()
        self.send(hello)
        answer = self.receive(seconds)
        if answer == hello:
            return
        text = answer[:100].decode("ascii", "replace")
        raise OtherVersion(text.removeprefix(_PROTOCOL).strip() if text.startswith(_PROTOCOL) else "another version")

    def send(self, packet: bytes, fds: tuple[int, ...] = ()) -> None:
        """Send a packet, with descriptors. Raises OSError if the other side has ended, or does not read."""
        socket.send_fds(self._socket, [packet], fds)

    def receive(self, seconds: float | None = None) -> bytes:
        """Return the next packet. The kernel closes descriptors that come with it. Raises EOFError if the other side
        has ended, TimeoutError after `seconds`."""
        self._socket.settimeout(seconds)
        try:
            return _filled(self._socket.recv(_LARGEST))
        except TimeoutError:
            raise
        except OSError as error:
            raise EOFError from error

    def receive_with_fds(self) -> tuple[bytes, list[int]]:
        """Return the next packet, and the descriptors that came with it, which the caller closes. Raises EOFError if
        the other side has ended."""
        self._socket.settimeout(None)
        try:
            data, fds, _, _ = socket.recv_fds(self._socket, _LARGEST, _MOST_FDS, socket.MSG_CMSG_CLOEXEC)
        except OSError as error:
            raise EOFError from error
        return _filled(data), fds

    def close(self) -> None:
        """Close the connection. That wakes threads that wait in `receive`, here and on the other side."""
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()


def _set_patience(waiting: socket.socket, seconds: float) -> None:
    """Set how long sending and connecting may wait."""
    timeval = struct.pack("ll", int(seconds), int(seconds % 1 * 1e6))
    waiting.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, timeval)


def _filled(packet: bytes) -> bytes:
    if not packet:
        raise EOFError
    return packet


class Listener:
    """Socket that waits for viewers, with the name `name`, or `stem` with a number if that is taken. Raises GffeError
    for a `name` that is."""

    def __init__(self, name: str | None, stem: str):
        require_linux()
        names = [require_name(name)] if name is not None else [stem, *(f"{stem}-{n}" for n in range(2, _MOST_PROGRAMS))]
        try:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            _sockets.add(self._socket)
            found = next((one for one in names if _bound(self._socket, one)), None)
            if found is not None:
                self._socket.listen(8)
        except OSError as error:
            raise GffeError(f"attach: no socket: {error.strerror or error}") from None
        if found is None:
            raise GffeError(f"attach: a program is attached as '{names[-1]}' already (expected another name)")
        self.name, self._accepting = found, threading.RLock()

    def accept(self) -> Channel:
        """Return a channel to the next viewer of this user; others are sent away. Raises OSError once the listener is
        closed."""
        while True:
            try:
                with self._accepting:
                    connected, _ = self._socket.accept()
            except OSError as error:
                if error.errno in (errno.EBADF, errno.EINVAL):  # what `close` leads to
                    raise
                time.sleep(_RETRY_SECONDS)  # no descriptor is free, perhaps
                continue
            with suppress(OSError):
                if _peer_uid(connected) == os.getuid():
                    return Channel(connected)
            connected.close()

    def close(self) -> None:
        """Wake the thread that waits in `accept`; the name is free then. In a forked child the socket stays the
        parent's."""
        if self._socket.fileno() < 0:
            return
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        with self._accepting:
            self._socket.close()


def _bound(binding: socket.socket, name: str) -> bool:
    """Bind the socket to the address of `name`. Returns whether that was free."""
    try:
        binding.bind(address_of(name))
    except OSError as error:
        if error.errno != errno.EADDRINUSE:
            raise
        return False
    return True


def connect(name: str) -> Channel:
    """Connect to the program attached as `name`, and return the channel. Raises GffeError if there is none, if it does
    not answer, or if it is another user's."""
    require_linux()
    require_name(name)
    connected = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    _set_patience(connected, _CONNECT_SECONDS)
    try:
        connected.connect(address_of(name))
        uid = _peer_uid(connected)
    except BlockingIOError:  # many viewers wait already
        connected.close()
        raise GffeError(f"{name}: {NO_ANSWER}") from None
    except OSError:
        connected.close()
        living = programs()
        none = "there is none: call gffe_cl.attach(pipeline) in the program"
        there = f"there are: {', '.join(living)}" if living else none
        raise GffeError(f"no program is attached as '{name}' ({there})") from None
    if uid != os.getuid():
        connected.close()
        raise GffeError(f"the program '{name}' is another user's (expected one of your own)")
    return Channel(connected)


# ---- forked children ---------------------------------------------------------------------------------------------

_sockets: weakref.WeakSet[socket.socket] = weakref.WeakSet()  # of this process


def _drop_copies() -> None:
    """Close a forked child's copies of the sockets. Otherwise the other side would not notice the parent's end."""
    for copy in list(_sockets):
        copy.close()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_drop_copies)


# ---- other processes ---------------------------------------------------------------------------------------------


def _peer_uid(connected: socket.socket) -> int:
    """Return the user of the process at the other end, from the kernel."""
    _, uid, _ = struct.unpack("3i", connected.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i")))
    return uid


def programs() -> list[str]:
    """Return the names of attached programs."""
    try:
        lines = _SOCKETS.read_text("utf-8", "replace").splitlines()
    except OSError:  # some containers have no such file
        return []
    begin = address_of("").replace("\0", "@")
    addresses = {line.split(maxsplit=7)[-1] for line in lines}
    return sorted(one.removeprefix(begin) for one in addresses if one.startswith(begin))
