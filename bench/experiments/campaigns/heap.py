"""Memory that a worker keeps from one run to the next."""

from __future__ import annotations

import ctypes
from functools import cache

_MMAP_THRESHOLD, _TRIM_THRESHOLD = -3, -1  # of `mallopt`, malloc.h
_LARGEST = 32 << 20  # array that comes from the heap [byte]; the most that glibc allows
_KEPT = 128 << 20  # at the end of the heap, unused [byte]


@cache
def keep_freed_memory() -> bool:
    """Make this process keep freed memory, and return whether this is possible.

    The runs of a campaign take the same arrays again and again. Given back to the system and taken again,
    their pages cost a twentieth of a run. Only the allocator of glibc is asked.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # another system, another allocator
        return False
    return bool(mallopt(_MMAP_THRESHOLD, _LARGEST) and mallopt(_TRIM_THRESHOLD, _KEPT))
