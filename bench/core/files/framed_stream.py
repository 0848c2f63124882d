"""Frames in a stream of bytes: each begins with a mark and contains its length and a checksum."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import BinaryIO

_BLOCK = 1 << 16


def find_frames(
    file: BinaryIO, mark: re.Pattern[bytes], longest: int, measure: Callable[[bytes, int], int]
) -> Iterator[bytes | None]:
    """Yield the sound frames of a stream, and None for a damaged part behind one of them.

    A frame begins with ``mark`` and is at most ``longest`` long [byte]. ``measure`` returns where
    the frame at a place of a content ends, 0 if it is not sound.
    """
    content, at, more, sound = b"", 0, True, False
    while more:
        block = file.read(_BLOCK)
        content, at, more = content[at:] + block, 0, bool(block)
        while match := mark.search(content, at):
            at = match.start()
            if more and len(content) - at < longest:
                break
            end = measure(content, at)
            if end:
                yield content[at:end]
            elif sound:
                yield None
            at, sound = end or at + 1, bool(end)
        else:
            at = max(at, len(content) - 3)
