"""Parallel work on the next few items of a series while the consumer has the current one."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import islice


def usable_cores() -> int:
    """Return how many processor cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def read_ahead(items: Iterable, function: Callable, ahead: int = 2) -> Iterator[tuple]:
    """Yield (item, function(item)) in order, `function` running on threads for the next `ahead`, from now on.

    An exception of `function` is raised when its item's turn comes. Leaving the loop (break, exception, Ctrl-C) drops
    items that were not started and waits for the others.
    """
    ahead = max(1, ahead)
    items = iter(items)
    pool = ThreadPoolExecutor(ahead, thread_name_prefix="gffe-read")
    pending = deque((item, pool.submit(function, item)) for item in islice(items, ahead))
    return _in_order(items, function, pool, pending)


def _in_order(items: Iterator, function: Callable, pool: ThreadPoolExecutor, pending: deque) -> Iterator[tuple]:
    try:
        while pending:
            item, future = pending.popleft()
            result = future.result()
            for following in islice(items, 1):
                pending.append((following, pool.submit(function, following)))
            yield item, result
            del result, future
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
