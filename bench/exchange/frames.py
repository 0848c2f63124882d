"""A run as messages, in the order in which they reach a filter: NMEA for the fixes, binary frames for the
rest.

A frame, little-endian:

    offset  bytes  what
    0       2      0xAA 0x55
    2       1      kind: 1 IMU, 2 barometer, 3 magnetometer, 4 airspeed
    3       1      n, length of the payload
    4       4      number of the frame, from 0, unsigned
    8       n      payload: float64 each, then one byte, 1 when the unit calls the row valid
    8 + n   2      CRC-16/CCITT-FALSE of bytes 2 to 8 + n (polynomial 0x1021, start 0xFFFF), unsigned

Payloads: IMU t, dt [s], increments of angle x, y, z [rad] and of velocity x, y, z [m/s] over the interval
that
ends at t, forward, right, down (n = 65); barometer t [s], altitude [m], sd [m] (25); magnetometer t [s],
field x, y, z [T], sd [T] (41); airspeed t [s], true airspeed [m/s], sd [m/s] (25).
"""

from __future__ import annotations

import heapq
import struct
from binascii import crc_hqx
from collections.abc import Iterator, Sequence

import numpy as np

from bench.arrays import BoolArray, FloatArray
from bench.exchange.exports.nmea import of_fix
from bench.exchange.exports.outgoing import Outgoing

SYNC = b"\xaa\x55"
IMU, BARO, MAG, AIRSPEED = 1, 2, 3, 4

Message = tuple[float, bytes]
"""When it reaches the filter [s], and its bytes: one sentence or one frame."""


def messages(run: Outgoing) -> Iterator[Message]:
    """Yield every message of a run in the order of arrival; the rows of one sensor stay in their order."""
    imu = run.imu
    streams = [_rows(IMU, imu.t, [imu.t, imu.dt, *imu.dtheta_b.T, *imu.dvel_b.T], imu.valid)]
    if run.fixes is not None:
        streams.append(_sentences(run))
    for kind, record, columns in (
        (BARO, run.baro, run.baro and [run.baro.t, run.baro.alt_baro, run.baro.sd]),
        (MAG, run.mag, run.mag and [run.mag.t, *run.mag.field_b.T, run.mag.sd]),
        (
            AIRSPEED,
            run.airspeed,
            run.airspeed and [run.airspeed.t, run.airspeed.airspeed_true, run.airspeed.sd],
        ),
    ):
        if record is not None and columns:
            streams.append(_rows(kind, record.t_arrival, columns, record.valid))
    number = 0
    for arrival, kind, body in heapq.merge(*streams, key=lambda row: row[0]):
        if kind:
            yield arrival, frame(kind, number, body)
            number += 1
        else:
            yield arrival, body


def frame(kind: int, number: int, payload: bytes) -> bytes:
    """Return a frame.

    Examples
    --------
    >>> frame(2, 7, b"123456789")[:8].hex(), crc_hqx(b"123456789", 0xFFFF) == 0x29B1
    ('aa55020907000000', True)
    """
    checked = struct.pack("<BBI", kind, len(payload), number & 0xFFFFFFFF) + payload
    return SYNC + checked + struct.pack("<H", crc_hqx(checked, 0xFFFF))


def _rows(
    kind: int, arrival: FloatArray, columns: Sequence[FloatArray], valid: BoolArray
) -> Iterator[tuple[float, int, bytes]]:
    values, when = np.column_stack(columns), _in_order(arrival)
    layout = struct.Struct(f"<{values.shape[1]}dB")
    for k in range(len(values)):
        yield when[k], kind, layout.pack(*values[k], int(valid[k]))


def _sentences(run: Outgoing) -> Iterator[tuple[float, int, bytes]]:
    fixes = run.fixes
    assert fixes is not None  # or there is no such stream
    when, calendar = _in_order(fixes.t_arrival), run.calendar
    for k in range(len(fixes)):
        if np.isfinite(fixes.t[k]):
            for sentence in of_fix(calendar, fixes, k):
                yield when[k], 0, sentence.encode("ascii")


def _in_order(arrival: FloatArray) -> list[float]:
    """Return times that never go back: a row that is late, or has no time, comes with the one before it."""
    known = np.where(np.isfinite(arrival), arrival, -np.inf)
    running: list[float] = np.maximum(np.maximum.accumulate(known), 0.0).tolist()
    return running
