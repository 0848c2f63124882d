"""Pack files as compress of Unix does: LZW, codes of 9 to 16 bits in groups of eight."""

from __future__ import annotations

from collections.abc import Iterable


def compress(content: bytes) -> bytes:
    """Return the .Z file of a content; its table is never begun anew."""
    return write_codes(_find_codes(content))


def _find_codes(content: bytes) -> Iterable[int]:
    table = {bytes((k,)): k for k in range(256)}
    text = b""
    for k in range(len(content)):
        longer = text + content[k : k + 1]
        if longer in table:
            text = longer
            continue
        yield table[text]
        if len(table) + 1 < 1 << 16:
            table[longer] = len(table) + 1  # 256 is the code that begins the table anew
        text = content[k : k + 1]
    if text:
        yield table[text]


def write_codes(codes: Iterable[int]) -> bytes:
    """Return the .Z file of codes; a group is filled up when the width of its codes changes."""
    out, bits, known = bytearray(b"\x1f\x9d\x90"), 9, 257
    group: list[int] = []

    def flush() -> None:
        value = sum(code << (k * bits) for k, code in enumerate(group))
        out.extend(value.to_bytes(bits, "little"))
        group.clear()

    for code in codes:
        group.append(code)
        known += 1
        if known > 1 << bits and bits < 16:
            flush()
            bits += 1
        elif len(group) == 8:
            flush()
    if group:
        value = sum(code << (k * bits) for k, code in enumerate(group))
        out.extend(value.to_bytes((bits * len(group) + 7) // 8, "little"))
    return bytes(out)
