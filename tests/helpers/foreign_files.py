"""Pipes, devices and endless files where a file is expected, which must be neither waited for nor read to their end."""

import os
import threading

KINDS = {
    "pipe": os.mkfifo,
    "device": lambda path: path.symlink_to("/dev/zero"),
    "folder": lambda path: path.mkdir(),
    "huge": lambda path: path.touch() or os.truncate(path, 1 << 40),
}


def put(path, kind):
    path.unlink(missing_ok=True)
    KINDS[kind](path)


def within(seconds, work):
    """Return the result of `work`. AssertionError if it takes longer."""
    found = []
    thread = threading.Thread(target=lambda: found.append(work()), daemon=True)
    thread.start()
    thread.join(seconds)
    assert found, "nothing came of it"
    return found[0]
