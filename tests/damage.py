"""Files that end early or have wrong bits, as readers of strangers' files meet them."""

from __future__ import annotations

import numpy as np


def spoil(content: bytes, seed: int, bits: int = 10) -> list[bytes]:
    """Return 20 beginnings of a file, and 50 copies with so many flipped bits in each."""
    rng = np.random.default_rng(seed)
    found = [content[: rng.integers(len(content))] for _ in range(20)]
    for _ in range(50):
        flipped = np.frombuffer(content, np.uint8).copy()
        for at in rng.integers(len(content), size=bits):
            flipped[at] ^= 1 << rng.integers(8)
        found.append(flipped.tobytes())
    return found
