"""The messages of a flight with a client: frames of `bench.io.streams.frames`, and their contents.

The client begins with HELLO. The server answers with HELLO and START. Then it repeatedly sends the arrived
data and TURN; the client answers with at most one ESTIMATE and one of ATTITUDE and SURFACES, and DONE. END is
the last message of the server.
"""

from __future__ import annotations

import struct
from binascii import crc_hqx
from collections.abc import Iterator
from typing import NamedTuple

from bench.core.records.instruments import INSTRUMENTS
from bench.io.streams.frames import FIX, IMU, SYNC

VERSION = 1
"""Of the messages. It changes when an old client would misunderstand one; more kinds do not change it."""

HELLO, START, TURN, ESTIMATE, ATTITUDE, SURFACES, DONE, END = range(16, 24)

COUNTS = {
    HELLO: 1,  # of the client: the version
    ESTIMATE: 26,
    ATTITUDE: 4,
    SURFACES: 5,
    DONE: 1,
}
"""Float64 values of what a client sends: kind -> count. A byte, 1 if the values count, follows."""

_NAMES = {
    HELLO: "HELLO",
    START: "START",
    TURN: "TURN",
    ESTIMATE: "ESTIMATE",
    ATTITUDE: "ATTITUDE",
    SURFACES: "SURFACES",
    DONE: "DONE",
    END: "END",
    IMU: "IMU",
    FIX: "FIX",
    **{row.frame: name for name, row in INSTRUMENTS.items()},
}
_HEAD = struct.Struct("<2sBBI")
_CRC = struct.Struct("<H")


class FlightFrame(NamedTuple):
    """A received frame."""

    kind: int
    payload: bytes

    @property
    def name(self) -> str:
        """Kind of the frame in words."""
        return _NAMES.get(self.kind, f"kind {self.kind}")

    def values(self) -> tuple[float, ...]:
        """Return the numbers of the frame, without the last byte."""
        return struct.unpack_from(f"<{len(self.payload) // 8}d", self.payload)

    @property
    def valid(self) -> bool:
        """Return whether the last byte of the payload is 1."""
        return self.payload[-1:] == b"\x01"


class FrameReader:
    """Parser of a byte stream into frames."""

    def __init__(self) -> None:
        self._held = bytearray()

    @property
    def inside(self) -> bool:
        """Return whether a frame has arrived only in part."""
        return bool(self._held)

    def take(self, data: bytes) -> Iterator[FlightFrame]:
        """Yield the frames that are complete.

        Raises
        ------
        ValueError
            If the bytes are no frame, in words.
        """
        self._held += data
        while len(self._held) >= _HEAD.size:
            sync, kind, size, _ = _HEAD.unpack_from(self._held)
            if sync != SYNC:
                raise ValueError(f"sent {sync.hex(' ')} where a message begins with {SYNC.hex(' ')}")
            end = _HEAD.size + size
            if len(self._held) < end + _CRC.size:
                return
            if _CRC.unpack_from(self._held, end)[0] != crc_hqx(self._held[2:end], 0xFFFF):
                raise ValueError(f"sent a message {_NAMES.get(kind, kind)} whose checksum is wrong")
            frame = FlightFrame(kind, bytes(self._held[_HEAD.size : end]))
            del self._held[: end + _CRC.size]
            yield frame


def pack(*values: float, valid: bool = True) -> bytes:
    """Return a payload of numbers and the last byte.

    Examples
    --------
    >>> pack(1.0).hex()
    '000000000000f03f01'
    """
    return struct.pack(f"<{len(values)}dB", *values, valid)
