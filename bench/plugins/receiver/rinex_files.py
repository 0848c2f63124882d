"""RINEX 3: the ranges of a receiver with [sky] and the orbits of its satellites, for RTKLIB and others.

RINEX 3.04 (IGS, RTCM-SC104, 2018), tables A2, A3, A5, A6, A8, A10, A14.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime, timedelta
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bench.core.files import durable
from bench.core.mathematics import earth
from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.records.data import GnssObservations
from bench.core.records.orbit_sets import (
    BEIDOU,
    GALILEO,
    GLONASS,
    GPS,
    LETTERS,
    GlonassSets,
    KeplerSets,
    name_satellite,
)
from bench.core.words.exceptions import ExportError
from bench.io.exports.outgoing import ExportData
from bench.plugins.receiver.rinex.lines import BEIDOU_LATE
from bench.simulation.signals import orbits
from bench.simulation.signals.delays import find_range
from bench.simulation.signals.gps_time import leap_seconds
from bench.simulation.signals.orbit_fit import fit_glonass, fit_kepler
from bench.simulation.signals.orbits import DAY, GPS_EARTH_RATE, WEEK, C

FORMATS = {
    "rinex": "RINEX 3 for RTKLIB and others: ranges, Doppler and C/N0 of a receiver with [sky], orbits"
}
OBSERVATIONS, NAVIGATION = "run.obs", "run.nav"
_EPOCH = datetime(1980, 1, 6)
_CODES = {GPS: ("1C", "2W"), GLONASS: ("1C", "2C"), GALILEO: ("1C", "5Q"), BEIDOU: ("2I", "6I")}
"""Codes of the carriers of `orbits.carrier_frequencies`."""
_VALID = {GLONASS: 900.0}
"""Time for which a message is fitted [s]; the others `_KEPLER_VALID`.

Of GLONASS about a multiple of it in UTC: RTKLIB rounds the reference time to such a one.
"""
_KEPLER_VALID = 300.0
_NEAR = 1.0  # an epoch so near to a fix has a place; in a gap of 2 s it is good to meters [s]
_ACCURACY = {GPS: 2.0, GALILEO: 3.12, BEIDOU: 2.0}  # stated by a sound satellite [m]: URA 0, SISA 107
_LEAST = 1e-99
_INAV = 517.0  # data source of Galileo: I/NAV of E1, clock of E5b and E1, table A8


class _Ranges(NamedTuple):
    """Epochs to write, and when signals left, by GPS time since 1980-01-06."""

    tag: FloatArray  # (M,) of each epoch by the clock of the receiver [s]
    start: IntArray  # (M + 1,)
    rows: IntArray  # (K,) of the observations
    sent: FloatArray  # (K,) epochs of transmission [s]


def write(folder: Path, out: ExportData, kind: str) -> str:
    """Write the observation and the navigation file; return their description for the README."""
    o = out.observations
    if o is None:
        raise ExportError("the run has no ranges: its receiver must be one with [sky], such as 'sky-l1'")
    midnight = WEEK * out.calendar.week + out.calendar.second - o.gps_t0
    ranges, frozen, lost = _place_in_time(o, out, midnight)
    where = earth.to_ecef(out.select_fixes().lla[:1])[0]
    durable.write(folder / OBSERVATIONS, "".join(_write_observations(o, ranges, where)))
    messages, far = _fit_messages(o, ranges)
    durable.write(folder / NAVIGATION, "".join(_write_navigation(o, messages, ranges.tag[0])))
    systems = ", ".join(LETTERS[system] for system in np.unique(o.system))
    left_out = f" {frozen} epochs that a frozen receiver repeats are left out." if frozen else ""
    if lost:
        left_out += (
            f" {lost} epochs more than {_NEAR:g} s from a fix are left out, because their place is not "
            "known: `--with solution:NAME` gives it."
        )
    minutes = _KEPLER_VALID / 60, _VALID[GLONASS] / 60
    return f"""RINEX 3.04, for RTKLIB and other programs of GNSS. `bench fixes` solves both files.

- `{OBSERVATIONS}`, {len(ranges.tag)} epochs: pseudorange [m], Doppler [Hz] and C/N0 [dB-Hz] of the systems
  {systems}. Times are GPS time by the clock of the receiver. Carrier phase is not simulated.{left_out}
- `{NAVIGATION}`, {len(messages)} broadcast messages, one every {minutes[0]:g} minutes, of GLONASS every
  {minutes[1]:g}. They are fitted to the satellites of the run, to {_describe_errors(far)}. The ionosphere is
  the Klobuchar model; group delays are 0, as in the ranges.

The same ranges beside the IMU of the run, `imu.csv` of `bench export --to csv`, in a log:

```toml
[gnss]
observations = ["{OBSERVATIONS}"]
navigation = ["{NAVIGATION}"]
time_offset_s = {-(WEEK * out.calendar.week + out.calendar.second):.6f}   # to the times of the run
```"""


def _describe_errors(far: Mapping[int, float]) -> str:
    """Return the largest error of the messages of each system [m] in words."""
    others = [one for system, one in far.items() if system != GLONASS]
    words = [f"{1e3 * max(others):.2g} mm"] if others else []
    if GLONASS in far:
        words.append(
            f"{1e3 * far[GLONASS]:.2g} mm with GLONASS, whose messages know no change of the acceleration"
        )
    return ", ".join(words)


def _place_in_time(o: GnssObservations, out: ExportData, midnight: float) -> tuple[_Ranges, int, int]:
    """Return the epochs by the receiver's clock, how many a frozen receiver repeats, how many have no place.

    The distances follow from its fixes: their errors move neither clock nor satellites by a millimeter. Where
    it has none they follow from the tracks that are exported, too.
    """
    fixes = out.select_fixes()
    start = o.epoch_start
    first = start[:-1][np.diff(start) > 0]
    count = np.diff(start)[np.diff(start) > 0]
    t = o.t[first]
    same = np.zeros(len(first), np.bool_)
    for m in range(1, len(first)):
        a, b, n = first[m - 1], first[m], count[m]
        same[m] = count[m - 1] == n and bool((o.sat_pos_e[a : a + n] == o.sat_pos_e[b : b + n]).all())
    tracks = out.tracks.values()
    known_t = np.concatenate([fixes.t, *(track.t for track in tracks)])
    lla = np.concatenate([fixes.lla, *(track.lla for track in tracks)])
    at = np.flatnonzero(np.isfinite(lla).all(axis=1))
    known_t, first_of = np.unique(known_t[at], return_index=True)
    lla = lla[at[first_of]]
    after, last = np.searchsorted(known_t, t), len(known_t) - 1
    far = np.abs(known_t[np.minimum([(after - 1).clip(0), after], last)] - t).min(axis=0) > _NEAR
    keep = ~same & ~far
    if not keep.any():
        raise ExportError(f"no epoch with ranges is within {_NEAR:g} s of a fix, so no position is known")
    first, count, t = first[keep], count[keep], t[keep]
    rows = np.concatenate([np.arange(a, a + n) for a, n in zip(first, count, strict=True)])
    pos_e = np.column_stack([np.interp(t, known_t, column) for column in earth.to_ecef(lla).T])
    epoch = np.repeat(np.arange(len(first)), count)
    distance = np.asarray(find_range(*o.sat_pos_e[rows].T, *pos_e[epoch].T, GPS_EARTH_RATE)[0])
    new = np.concatenate([[0], np.cumsum(count)])
    late = o.pseudorange[rows, 0] + o.sat_clock[rows] - distance
    clock = np.array([np.median(late[a:b]) for a, b in pairwise(new)]) / C
    received = midnight + o.gps_t0 + t
    return (
        _Ranges(received + clock, new, rows, received[epoch] - distance / C),
        int(same.sum()),
        int((far & ~same).sum()),
    )


def _write_observations(o: GnssObservations, ranges: _Ranges, where: FloatArray) -> Iterator[str]:
    systems, bands, begin = np.unique(o.system[ranges.rows]), o.pseudorange.shape[1], ranges.tag[0]
    yield _label("     3.04           OBSERVATION DATA    M", "RINEX VERSION / TYPE")
    yield _label(f"{'bench':40}{_find_calendar(begin):%Y%m%d %H%M%S} GPS", "PGM / RUN BY / DATE")
    yield _label("BENCH", "MARKER NAME")
    yield _label("AIRBORNE", "MARKER TYPE")
    yield _label(f"{'simulated':20}{'bench'}", "OBSERVER / AGENCY")
    yield _label(f"{'0':20}{'simulated':20}0", "REC # / TYPE / VERS")
    yield _label(f"{'0':20}NONE", "ANT # / TYPE")
    yield _label("".join(f"{x:14.4f}" for x in where), "APPROX POSITION XYZ")
    yield _label(3 * f"{0.0:14.4f}", "ANTENNA: DELTA H/E/N")
    for system in systems:
        types = [f"{what}{code}" for code in _CODES[system][:bands] for what in "CDS"]
        listed = "".join(f" {name}" for name in types)
        yield _label(f"{LETTERS[system]}  {len(types):3d}{listed}", "SYS / # / OBS TYPES")
    first = _find_calendar(begin)
    yield _label(f"{_format_first(first)}     GPS", "TIME OF FIRST OBS")
    slots = _find_channels(o)
    for k in range(0, len(slots), 8):
        begun = f"{len(slots):3d} " if k == 0 else "    "
        listed = "".join(f"R{sat:02d} {channel:2d} " for sat, channel in slots[k : k + 8])
        yield _label(begun + listed, "GLONASS SLOT / FRQ #")
    if slots:
        yield _label(" C1C    0.000 C1P    0.000 C2C    0.000 C2P    0.000", "GLONASS COD/PHS/BIS")
    yield _label(f"{leap_seconds(first.date()):6d}", "LEAP SECONDS")
    yield _label("", "END OF HEADER")
    doppler = -o.range_rate * o.frequency / C
    for m, tag in enumerate(ranges.tag):
        rows = ranges.rows[ranges.start[m] : ranges.start[m + 1]]
        yield f"> {_format_tag(tag)}  0{len(rows):3d}\n"
        for row in rows:
            values = [
                f"{value:14.3f}  " if np.isfinite(value) else 16 * " "
                for band in range(bands)
                for value in (o.pseudorange[row, band], doppler[row, band], o.cn0[row, band])
            ]
            yield name_satellite(o.system[row], o.sat[row]) + "".join(values).rstrip() + "\n"


def _find_channels(o: GnssObservations) -> list[tuple[int, int]]:
    """Return slot and frequency channel of the GLONASS satellites."""
    ours = o.system == GLONASS
    sat, at = np.unique(o.sat[ours], return_index=True)
    step = orbits.find_frequency(np.array([GLONASS] * 2), np.array([1, 1]), np.array([0, 1]))
    channel = np.round((o.frequency[ours, 0][at] - step[0]) / (step[1] - step[0])).astype(int)
    return list(zip(sat.tolist(), channel.tolist(), strict=True))


def _fit_messages(
    o: GnssObservations, ranges: _Ranges
) -> tuple[list[KeplerSets | GlonassSets], dict[int, float]]:
    """Return a message for each satellite and time, of one set each, and the largest error by system [m]."""
    channels, found, far = dict(_find_channels(o)), list[KeplerSets | GlonassSets](), dict[int, float]()
    sat, system = o.sat[ranges.rows], o.system[ranges.rows]
    utc = leap_seconds(_find_calendar(ranges.tag[0]).date())
    late = np.select([system == BEIDOU, system == GLONASS], [BEIDOU_LATE, utc - 0.5 * _VALID[GLONASS]], 0.0)
    valid = np.array([_VALID.get(s, _KEPLER_VALID) for s in system.tolist()])
    window = np.floor((ranges.sent - late) / valid)
    order = np.lexsort((window, sat, system))
    keys = np.column_stack([system, sat, window])[order]
    begin = np.flatnonzero(np.append(True, (np.diff(keys, axis=0) != 0).any(axis=1)))
    for a, b in zip(begin, np.append(begin[1:], len(order)), strict=True):
        those = order[a:b]
        rows, which = ranges.rows[those], int(system[those[0]])
        middle = (window[those[0]] + 0.5) * valid[those[0]]  # in the time of the system
        reference = middle + late[those[0]]
        states = ranges.sent[those], o.sat_pos_e[rows], o.sat_vel_e[rows], o.sat_clock[rows]
        number = int(sat[those[0]])
        one: KeplerSets | GlonassSets
        if which == GLONASS:
            one = fit_glonass(number, channels[number], reference, *states)
        else:
            one = fit_kepler(number, which, reference, middle % WEEK, *states)
        again = orbits.compute_states(one, np.zeros(len(those), np.int64), states[0])
        error = float(np.linalg.norm(again.pos_e - states[1], axis=1).max())
        far[which] = max(far.get(which, 0.0), error)
        found.append(one)
    return found, far


def _write_navigation(
    o: GnssObservations, messages: Sequence[KeplerSets | GlonassSets], begin: float
) -> Iterator[str]:
    yield _label("     3.04           N: GNSS NAV DATA    M: MIXED", "RINEX VERSION / TYPE")
    yield _label(f"{'bench':40}{_find_calendar(begin):%Y%m%d %H%M%S} GPS", "PGM / RUN BY / DATE")
    for name, values in (("GPSA", o.klobuchar[:4]), ("GPSB", o.klobuchar[4:])):
        yield _label(f"{name} {''.join(f'{v:12.4E}' for v in values)}", "IONOSPHERIC CORR")
    leap = leap_seconds(_find_calendar(begin).date())
    yield _label(f"{leap:6d}", "LEAP SECONDS")
    yield _label("", "END OF HEADER")
    for one in messages:
        if isinstance(one, GlonassSets):
            yield from _write_glonass(one, leap)
        else:
            yield from _write_kepler(one)


def _write_kepler(one: KeplerSets) -> Iterator[str]:
    late = BEIDOU_LATE if one.system == BEIDOU else 0.0
    t_oe = float(one.get("t_oe")[0]) - late

    def get(name: str) -> float:
        return float(one.get(name)[0])

    week, issue = t_oe // WEEK, t_oe % WEEK // _KEPLER_VALID % 256
    week -= {BEIDOU: 1356.0}.get(one.system, 0.0)
    source = {GPS: 1.0, GALILEO: _INAV}.get(one.system, 0.0)
    yield _begin(one.system, int(one.sat[0]), t_oe, get("af_0"), get("af_1"), get("af_2"))
    lines = (
        (issue, get("c_rs"), get("delta_n"), get("mean_anomaly")),
        (get("c_uc"), get("e"), get("c_us"), get("sqrt_a")),
        (t_oe % WEEK, get("c_ic"), get("node_0"), get("c_is")),
        (get("i_0"), get("c_rc"), get("perigee"), get("node_rate")),
        (get("i_rate"), source, week, 0.0),
        (_ACCURACY[one.system], 0.0, 0.0, issue if one.system == GPS else 0.0),
        (t_oe % WEEK, 4.0 if one.system == GPS else 0.0, 0.0, 0.0),
    )
    for line in lines:
        yield "    " + "".join(f"{_format_value(v)}" for v in line) + "\n"


def _write_glonass(one: GlonassSets, leap: int) -> Iterator[str]:
    state = one.state[0]
    t_b = float(state[0]) - leap  # UTC
    yield _begin(GLONASS, int(one.sat[0]), t_b, state[10], state[11], t_b % WEEK)
    for k, last in enumerate((0.0, float(one.channel[0]), 0.0)):
        values = (1e-3 * state[1 + k], 1e-3 * state[4 + k], 1e-3 * state[7 + k], last)
        yield "    " + "".join(f"{_format_value(float(v))}" for v in values) + "\n"


def _begin(system: int, sat: int, t: float, *values: float) -> str:
    day = _find_calendar(t)
    numbers = "".join(f"{_format_value(float(v))}" for v in values)
    return f"{name_satellite(system, sat)} {day:%Y %m %d %H %M %S}{numbers}\n"


def _format_value(value: float) -> str:
    """Return a number in Fortran's D19.12, which has two digits of exponent."""
    return f"{value if abs(value) > _LEAST else 0.0:19.12E}".replace("E", "D")


def _find_calendar(seconds: float) -> datetime:
    return _EPOCH + timedelta(seconds=float(seconds))


def _format_tag(seconds: float) -> str:
    """Return a time for the line of an epoch, to 1e-7 s."""
    whole, rest = divmod(round(seconds % DAY * 1e7), 10**7)
    day = _EPOCH + timedelta(days=seconds // DAY, seconds=whole)
    return f"{day:%Y %m %d %H %M} {day.second + 1e-7 * rest:10.7f}"


def _format_first(day: datetime) -> str:
    second = day.second + 1e-6 * day.microsecond
    return f"{day.year:6d}{day.month:6d}{day.day:6d}{day.hour:6d}{day.minute:6d}{second:13.7f}"


def _label(content: str, label: str) -> str:
    return f"{content:60}{label:20}".rstrip() + "\n"
