"""Tuning of this process's allocator: where new pages are expensive, freed ones are kept for the next arrays."""

from __future__ import annotations

import ctypes
from contextlib import suppress

# Parameters of mallopt (malloc.h of glibc): memory freed at the end of the heap goes back to the system above so many
# bytes; so many allocations have pages of their own, which go back when they are freed; so many heaps.
_M_TRIM_THRESHOLD, _M_MMAP_MAX, _M_ARENA_MAX = -1, -4, -8
_NEVER = 2**31 - 1


def keep_freed_memory() -> None:
    """Keep freed pages in this process, to be used again, for a command that allocates images of one size over and
    over. Fetching new ones from the system costs more time than filling them, in virtual machines ten times as much.
    Does nothing but with glibc."""
    with suppress(OSError, AttributeError, TypeError):
        mallopt = ctypes.CDLL(None).mallopt
        for parameter, value in ((_M_TRIM_THRESHOLD, _NEVER), (_M_MMAP_MAX, 0), (_M_ARENA_MAX, 1)):
            mallopt(parameter, value)
