"""A run as messages in their order of arrival: NMEA sentences for the fixes, binary frames for the rest.

A frame, little-endian:

    offset  bytes  content
    0       2      0xAA 0x55
    2       1      kind: 1 IMU; the others are `bench.core.records.instruments.Instrument.frame`: 2 barometer,
                   3 magnetometer, 4 airspeed, 5 radar altimeter, 6 odometer, 7 heading
    3       1      n, length of the payload
    4       4      number of the frame, from 0, unsigned
    8       n      payload: float64 values, then one byte, 1 if the sensor marks the row as valid
    8 + n   2      CRC-16/CCITT-FALSE of bytes 2 to 8 + n (polynomial 0x1021, start 0xFFFF), unsigned

Payloads: IMU t, dt [s], increments of angle x, y, z [rad] and of velocity x, y, z [m/s] over the interval
that ends at t, forward, right, down (n = 65); other instruments t [s], value or values, and sd, in SI:
barometer altitude [m] (n = 25), magnetometer field x, y, z [T] (41), airspeed [m/s] (25), radar height above
the runway [m] (25), odometer speed [m/s] (25), heading [rad] (25).

A flight with a client (`hil.flight_messages`) has fixes as frames, too, kind 8: t [s], latitude,
longitude [rad], altitude [m], velocity north, east, down [m/s], the upper triangles row by row of their
covariances [m^2], [m^2/s^2], and the number of satellites (n = 161).
"""

from __future__ import annotations

import heapq
import itertools
import struct
from binascii import crc_hqx
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.records.data import ImuData, SensorData
from bench.core.records.instruments import INSTRUMENTS
from bench.io.exports.nmea import make_fix_sentences
from bench.io.exports.outgoing import ExportData

SYNC = b"\xaa\x55"
IMU, FIX = 1, 8

Message = tuple[float, bytes]
"""Time of arrival at the filter [s], and the bytes of one sentence or frame."""


def make_messages(run: ExportData) -> Iterator[Message]:
    """Yield every message of a run in order of arrival; rows of one sensor keep their order."""
    streams = _make_streams(run.imu, run.instruments)
    if run.fixes is not None:
        streams.append(_make_sentences(run))
    number = 0
    for arrival, kind, body in heapq.merge(*streams, key=_find_arrival):
        if kind:
            yield arrival, make_frame(kind, number, body)
            number += 1
        else:
            yield arrival, body


def make_frames(data: SensorData) -> list[tuple[int, bytes]]:
    """Return kind and payload of every row of a piece of a record in order of arrival, fixes as frames."""
    streams = _make_streams(data.imu, data.instruments)
    if (fixes := data.fixes) is not None and len(fixes):
        upper = np.triu_indices(3)
        covariances = [cov[:, upper[0], upper[1]].T for cov in (fixes.cov_pos_n, fixes.cov_vel_n)]
        columns = [fixes.t, *fixes.lla.T, *fixes.vel_n.T, *covariances[0], *covariances[1], fixes.satellites]
        streams.append(_make_payloads(FIX, fixes.t_arrival, columns, fixes.valid))
    rows = sorted(
        itertools.chain.from_iterable(streams), key=_find_arrival
    )  # of one time in order of streams
    return [(kind, body) for _, kind, body in rows]


def _find_arrival(row: tuple[float, int, bytes]) -> float:
    return row[0]


def _make_streams(imu: ImuData, instruments: Mapping[str, Any]) -> list[Iterator[tuple[float, int, bytes]]]:
    """Return the rows of IMU and instruments by record, each in order of arrival."""
    streams = [_make_payloads(IMU, imu.t, [imu.t, imu.dt, *imu.dtheta_b.T, *imu.dvel_b.T], imu.valid)]
    for name, record in instruments.items():
        row = INSTRUMENTS[name]
        columns = [record.t, *row.values(record).T, record.sd]
        streams.append(_make_payloads(row.frame, record.t_arrival, columns, record.valid))
    return streams


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
    values, layout = zip(*(column.tolist() for column in columns), strict=True), f"<{len(columns)}dB"
    for when, row, mark in zip(_order_arrivals(arrival), values, valid.tolist(), strict=True):
        yield when, kind, struct.pack(layout, *row, mark)


def _make_sentences(run: ExportData) -> Iterator[tuple[float, int, bytes]]:
    fixes = run.fixes
    assert fixes is not None  # or there is no such stream
    when, calendar = _order_arrivals(fixes.t_arrival), run.calendar
    for k in range(len(fixes)):
        if np.isfinite(fixes.t[k]):
            for sentence in make_fix_sentences(calendar, fixes, k):
                yield when[k], 0, sentence.encode("ascii")


def _order_arrivals(arrival: FloatArray) -> list[float]:
    """Return non-decreasing times: a row without a time, or too early, gets the time of the row before."""
    known = np.where(np.isfinite(arrival), arrival, -np.inf)
    running: list[float] = np.maximum(np.maximum.accumulate(known), 0.0).tolist()
    return running
