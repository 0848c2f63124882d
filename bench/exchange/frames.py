"""A run as messages in their order of arrival: NMEA sentences for the fixes, binary frames for the rest.

A frame, little-endian:

    offset  bytes  content
    0       2      0xAA 0x55
    2       1      kind: 1 IMU; the others are `bench.instruments.Instrument.frame`: 2 barometer,
                   3 magnetometer, 4 airspeed, 5 radar altimeter, 6 odometer, 7 heading
    3       1      n, length of the payload
    4       4      number of the frame, from 0, unsigned
    8       n      payload: float64 values, then one byte, 1 if the sensor marks the row as valid
    8 + n   2      CRC-16/CCITT-FALSE of bytes 2 to 8 + n (polynomial 0x1021, start 0xFFFF), unsigned

Payloads: IMU t, dt [s], increments of angle x, y, z [rad] and of velocity x, y, z [m/s] over the interval
that ends at t, forward, right, down (n = 65); other instruments t [s], value or values, and sd, in SI:
barometer altitude [m] (n = 25), magnetometer field x, y, z [T] (41), airspeed [m/s] (25), radar height above
the runway [m] (25), odometer speed [m/s] (25), heading [rad] (25).
"""

from __future__ import annotations

import heapq
import struct
from binascii import crc_hqx
from collections.abc import Iterator, Sequence

import numpy as np

from bench.arrays import BoolArray, FloatArray
from bench.exchange.exports.nmea import make_fix_sentences
from bench.exchange.exports.outgoing import ExportData
from bench.instruments import INSTRUMENTS

SYNC = b"\xaa\x55"
IMU = 1

Message = tuple[float, bytes]
"""Time of arrival at the filter [s], and the bytes of one sentence or frame."""


def make_messages(run: ExportData) -> Iterator[Message]:
    """Yield every message of a run in order of arrival; rows of one sensor keep their order."""
    imu = run.imu
    streams = [_make_payloads(IMU, imu.t, [imu.t, imu.dt, *imu.dtheta_b.T, *imu.dvel_b.T], imu.valid)]
    if run.fixes is not None:
        streams.append(_make_sentences(run))
    for name, record in run.instruments.items():
        row = INSTRUMENTS[name]
        columns = [record.t, *row.values(record).T, record.sd]
        streams.append(_make_payloads(row.frame, record.t_arrival, columns, record.valid))
    number = 0
    for arrival, kind, body in heapq.merge(*streams, key=lambda row: row[0]):
        if kind:
            yield arrival, make_frame(kind, number, body)
            number += 1
        else:
            yield arrival, body


def make_frame(kind: int, number: int, payload: bytes) -> bytes:
    """Return a frame around a payload.

    Examples
    --------
    >>> make_frame(2, 7, b"123456789")[:8].hex(), crc_hqx(b"123456789", 0xFFFF) == 0x29B1
    ('aa55020907000000', True)
    """
    checked = struct.pack("<BBI", kind, len(payload), number & 0xFFFFFFFF) + payload
    return SYNC + checked + struct.pack("<H", crc_hqx(checked, 0xFFFF))


def _make_payloads(
    kind: int, arrival: FloatArray, columns: Sequence[FloatArray], valid: BoolArray
) -> Iterator[tuple[float, int, bytes]]:
    values, when = np.column_stack(columns), _order_arrivals(arrival)
    layout = struct.Struct(f"<{values.shape[1]}dB")
    for k in range(len(values)):
        yield when[k], kind, layout.pack(*values[k], int(valid[k]))


def _make_sentences(run: ExportData) -> Iterator[tuple[float, int, bytes]]:
    fixes = run.fixes
    assert fixes is not None  # or there is no such stream
    when, calendar = _order_arrivals(fixes.t_arrival), run.calendar
    for k in range(len(fixes)):
        if np.isfinite(fixes.t[k]):
            for sentence in make_fix_sentences(calendar, fixes, k):
                yield when[k], 0, sentence.encode("ascii")


def _order_arrivals(arrival: FloatArray) -> list[float]:
    """Return non-decreasing times: a row without a time, or too early, gets that of the row before."""
    known = np.where(np.isfinite(arrival), arrival, -np.inf)
    running: list[float] = np.maximum(np.maximum.accumulate(known), 0.0).tolist()
    return running
