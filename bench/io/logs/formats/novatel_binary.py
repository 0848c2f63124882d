"""Binary logs of NovAtel OEM receivers, as the rows that their ASCII logs have.

Headers and fields are those of oem7_messages.h in github.com/novatel/novatel_oem7_driver and of the database
of messages in the package novatel-edie.
"""

from __future__ import annotations

import math
import re
import struct
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path

from bench.core.files.file_checks import check_file
from bench.core.files.framed_stream import find_frames
from bench.io.logs.table_files import MOST_BYTES
from bench.simulation.signals.orbits import WEEK

_MARK = re.compile(rb"(?s)\xaa\x44(?:\x12\x1c|\x13)")
_LONGEST = 1 << 16  # of a frame [byte]
_LONG, _SHORT, _SHORT_MARK = 28, 12, 0x13  # headers [byte], and third byte of the short one
_NOT_OWN = 0x9F  # bits of the type of a message: of the second antenna, or a response
_POS, _VEL, _INS = "<2I3dfI3f4s2f8B", "<2I2f3df", "<I10dI"
_RAW, _RAW_X = "<IdI6i", "<2BHdI6i"
_LAYOUTS = {
    42: ("BESTPOS", _POS), 1429: ("BESTGNSSPOS", _POS), 99: ("BESTVEL", _VEL), 1430: ("BESTGNSSVEL", _VEL),
    507: ("INSPVA", _INS), 508: ("INSPVAS", _INS), 1465: ("INSPVAX", "<2I3df6d9fIH"), 268: ("RAWIMU", _RAW),
    325: ("RAWIMUS", _RAW), 1461: ("RAWIMUX", _RAW_X), 1462: ("RAWIMUSX", _RAW_X),
}  # fmt: skip
"""Number of a log -> its name and fields."""
_COMPUTED, _GOOD = (0,), (3, 6, 7)  # solution; INS: good, free, alignment complete

Log = tuple[str, float, bool, Sequence[float]]
"""Name, time [s since 1980-01-06], whether the status is good, and the fields of a log; texts are NaN."""


def read_binary_logs(path: Path) -> Iterator[Log | None]:
    """Yield each binary log; None for a damaged part between two, and for one that is too short."""
    check_file(path, path.name, MOST_BYTES)
    with path.open("rb") as file:
        for frame in find_frames(file, _MARK, _LONGEST, _measure):
            if frame is None:
                yield None
                continue
            short = frame[2] == _SHORT_MARK
            name, layout = _LAYOUTS.get(int.from_bytes(frame[4:6], "little"), ("", ""))
            body = frame[_SHORT if short else _LONG : -4]
            week, milliseconds = struct.unpack_from("<Hi", frame, 6 if short else 14)
            if not name or not week or not (short or not frame[6] & _NOT_OWN):
                continue
            if len(body) < struct.calcsize(layout):
                yield None
                continue
            fields = struct.unpack_from(layout, body)
            good = fields[-1] in _GOOD if layout is _INS else fields[0] in (_GOOD, _COMPUTED)[name[0] == "B"]
            numbers = [math.nan if isinstance(field, bytes) else field for field in fields]
            yield name, week * WEEK + 1e-3 * milliseconds, good, numbers


def _measure(content: bytes, at: int) -> int:
    """Return where the frame at a place ends; 0 if its CRC is wrong."""
    if content[at + 2] == _SHORT_MARK:
        end = at + _SHORT + content[at + 3] if len(content) > at + _SHORT else len(content)
    else:
        end = at + _LONG + int.from_bytes(content[at + 8 : at + 10], "little")
    crc = zlib.crc32(content[at:end], 0xFFFFFFFF) ^ 0xFFFFFFFF
    return end + 4 if content[end : end + 4] == crc.to_bytes(4, "little") else 0
