"""Background work of which only the latest request counts."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any


class Latest:
    """Result of the latest order; one is computed at a time, on a thread."""

    def __init__(self, name: str):
        self._pool = ThreadPoolExecutor(1, thread_name_prefix=f"gffe-viewer-{name}")
        self._future: Future | None = None
        self._wanted = self._coming = self._made = None  # their subject

    @property
    def ready(self) -> bool:
        """Whether the latest result belongs to the latest request."""
        return self._made is not None and self._made == self._wanted

    def want(self, key: Hashable, make: Callable[..., Any], *arguments: Any) -> None:
        """Request the result of `make`; `key` identifies the request."""
        self._wanted = key
        if self._future is None and key != self._made:
            self._coming = key
            self._future = self._pool.submit(make, *arguments)

    def take(self) -> Any:
        """Return a result finished since the last call, else None; raises its error."""
        if self._future is None or not self._future.done():
            return None
        future, self._future, self._made = self._future, None, self._coming
        return future.result()

    def close(self) -> None:
        self._pool.shutdown(wait=False, cancel_futures=True)
