"""A limit on the memory that a library takes while it reads a file of a stranger."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import psutil


@contextmanager
def limit_memory(beyond: int) -> Iterator[Callable[[int], None]]:
    """Limit the memory that this process may take in addition [byte]; beyond it there is a MemoryError.

    Provides a function that makes room for columns [byte]. It has an effect on Linux only.
    """
    own = psutil.Process()
    if not hasattr(own, "rlimit"):  # not Linux: the limit of the system
        yield lambda columns: None
        return
    soft, hard = own.rlimit(psutil.RLIMIT_AS)
    most = own.memory_info().vms + beyond

    def allow(columns: int) -> None:
        limits = [limit for limit in (most + columns, soft, hard) if limit != psutil.RLIM_INFINITY]
        own.rlimit(psutil.RLIMIT_AS, (min(limits), hard))

    try:
        allow(0)
        yield allow
    finally:
        own.rlimit(psutil.RLIMIT_AS, (soft, hard))
