"""Which rows of a sensor record are used and when; the others are counted.

A row is used at the first step of the filter at or after its arrival. Rows that are left out are never
repaired: they become a "timeline" event of the solution. :func:`steps` bridges a gap in the IMU record with
the mean rates just before it (nothing later has arrived) and gives the variance of the unknown motion
(:func:`bridge_variance`). A filter with fixes does so for gaps of at most :data:`LONGEST_BRIDGE`; after a
longer one it starts again (`restart`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bench.core.compilation.compiled import kernel
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray, take_increasing
from bench.core.records.data import EventRow, GnssFixes, ImuData
from bench.core.records.instruments import InstrumentData
from bench.core.records.sensor_specs import ImuSpec
from bench.navigation.engine.imu_range import IN_RANGE, find_beyond, limits
from bench.navigation.engine.session import Kept, SessionState

TIME_TOLERANCE = 1e-6  # epochs closer than this are the same [s]
BRIDGE_STEP = 0.05  # longest step over a gap: the transition over it is right to second order [s]
_MOST_ROWS = 4000  # before a gap that are looked at: 2 s of a unit with 2 kHz
_BRIDGE_STEPS = 20_000  # over one gap at most, so that a wild time tag fills no memory

OUTSIDE = "outside the time of the imu"
"""Why rows are left out that arrive before the start or after the last sample."""

LONGEST_BRIDGE = 0.5  # gap over which the tilt stays small enough for a linear filter [s]
_HELD = 0.25  # time before a gap whose mean rates are held over it [s]
_RECENT = 2.0  # time before a gap that shows how much the rates vary [s]
_BLOCK = 0.1  # means whose spread that is: shorter ones show the noise of the sensors [s]

# Rates over a gap: the mean held, off by what they varied by of late, and a manoeuvre that forgets itself.
# Rolling into a 30 deg turn within a few seconds changes rates by 0.1 to 0.2 rad/s and the specific force by
# 2 to 3 m/s^2 per axis.
BRIDGE_RATE_SD = 0.15  # [rad/s]
_BRIDGE_FORCE_SD = 2.5  # [m/s^2]
BRIDGE_CORRELATION = 3.0  # [s]
# Where the last sample is near the end of its range, the true rates are likely beyond it.
_NEAR = 0.8  # [1]
_BEYOND = 10.0, 1.0  # from the held ones [m/s^2, rad/s]

_NO_ROWS = np.empty(0, np.int64)

AidingRecord = GnssFixes | InstrumentData


class Steps(NamedTuple):
    """The steps of a strapdown integration."""

    t: FloatArray  # (K,) end of each step [s]
    span: FloatArray  # (K,) its length [s]
    row: IntArray  # (K,) row of dtheta_b and dvel_b whose rates it takes
    share: FloatArray  # (K,) the step over the length of that row [1]
    unknown: FloatArray  # (K, 2) variance of velocity [m^2/s^2] and attitude [rad^2] that a gap adds
    dtheta_b: FloatArray  # (N + G, 3) increments of the record [rad], then of one second of each gap
    dvel_b: FloatArray  # (N + G, 3) the same [m/s]


def bridge_variance(elapsed: FloatArray, spread: FloatArray) -> FloatArray:
    """Return the variance (K, 2) of velocity and attitude after constant rates for a time (K,) [s].

    The true rates differ from the constant rates by ``spread`` (K, 2) [m/s^2, rad/s], for all of the time,
    and by a Gauss-Markov process less its value at the start of the gap. The variance of the integral of the
    latter is ``sd^2 2/3 T^3 / tau`` for short gaps, ``sd^2 T^2`` for long ones.
    """
    tau = BRIDGE_CORRELATION
    u = elapsed / tau
    lost = -np.expm1(-u)
    integral = 2.0 * (u - lost) + u * u - 2.0 * u * lost
    short = u < 1e-3  # the difference above is rounding
    integral = np.where(short, 2.0 / 3.0 * u**3, integral)
    sd = np.array([_BRIDGE_FORCE_SD, BRIDGE_RATE_SD])
    variance: FloatArray = integral[:, None] * (sd * tau) ** 2 + (spread * elapsed[:, None]) ** 2
    return variance


def _rates_before(imu: ImuData, rows: IntArray, spec: ImuSpec) -> tuple[FloatArray, FloatArray]:
    """Return the mean rates (2, 3) for the gap after the last of some rows, and their spread (2,).

    Both for dvel_b [m/s^2] and dtheta_b [rad/s]: the spread is computed from block means over the last
    seconds, and is larger near the end of a range.
    """
    most_rate, most_force = limits(spec)
    t, dt = imu.t[rows], imu.dt[rows]
    means, spread = np.zeros((2, 3)), np.zeros(2)
    held = t > t[-1] - max(_HELD, dt[-1]) + TIME_TOLERANCE
    recent = t > t[-1] - _RECENT + TIME_TOLERANCE
    block = np.floor((t[-1] - t[recent] + TIME_TOLERANCE) / max(_BLOCK, float(dt[-1]))).astype(np.int64)
    length = np.bincount(block, dt[recent])
    full = length > 0
    for k, increment in enumerate((imu.dvel_b[rows], imu.dtheta_b[rows])):
        means[k] = increment[held].sum(axis=0) / dt[held].sum()
        blocks = np.array([np.bincount(block, column) for column in increment[recent].T]).T
        rates = blocks[full] / length[full, None]
        spread[k] = np.sqrt(np.mean(np.var(rates, axis=0)))
        if np.abs(increment[-1]).max() > _NEAR * (most_force, most_rate)[k] * dt[-1]:
            spread[k] = np.hypot(spread[k], _BEYOND[k])
    return means, spread


def steps(
    imu: ImuData,
    rows: IntArray,
    span: FloatArray,
    start: float,
    instants: FloatArray,
    in_gaps: FloatArray,
    spec: ImuSpec,
    earlier: IntArray = _NO_ROWS,
) -> Steps:
    """Return the steps of a filter over IMU rows in use.

    Parameters
    ----------
    rows, span : (K,) arrays
        As :func:`imu_rows` returns them, from the ``start`` [s].
    instants, in_gaps : (M,) arrays
        Where a step has to end too, wherever it is, and when there is a gap [s].
    spec : ImuSpec
        Datasheet, for its ranges.
    earlier : (L,) array of int
        Rows in use before the start: what is held over a gap comes from them, too.
    """
    t, dt = take_increasing(imu.t, rows), take_increasing(imu.dt, rows)
    ends = np.concatenate([[start], t])
    gap = span > dt + TIME_TOLERANCE
    cuts = [_inside(instants, ends)]
    if gap.any():
        # a row after a gap covers its own length; what is before it has to be bridged
        for k in np.flatnonzero(gap):
            first, last = ends[k], t[k] - dt[k]
            count = min(int(np.ceil((last - first) / BRIDGE_STEP)), _BRIDGE_STEPS)
            cuts.append(np.linspace(first, last, count + 1)[1:])
        inside = _inside(in_gaps, ends)
        cuts.append(inside[gap[np.searchsorted(ends, inside) - 1]])
    extra = np.concatenate(cuts)
    if len(extra):
        extra = np.unique(extra)
        extra = extra[np.diff(extra, prepend=-np.inf) > TIME_TOLERANCE]
        extra = _inside(extra, ends)
    if len(extra) == 0:
        return Steps(t, span, rows, span / dt, np.zeros((len(t), 2)), imu.dtheta_b, imu.dvel_b)
    cut_t = np.concatenate([t, extra])
    order = np.argsort(cut_t, kind="stable")
    cut_t = cut_t[order]
    sample = np.searchsorted(t, cut_t - 0.5 * TIME_TOLERANCE)  # that a step ends at or before
    cut_span = np.diff(cut_t, prepend=start)
    row, share = rows[sample], cut_span / dt[sample]
    unknown = np.zeros((len(cut_t), 2))
    into = cut_t - ends[sample]  # since the sample before
    bridged = gap[sample] & (into <= span[sample] - dt[sample] + 0.5 * TIME_TOLERANCE)
    dtheta_b, dvel_b = imu.dtheta_b, imu.dvel_b
    if bridged.any():
        after, before = into[bridged], into[bridged] - cut_span[bridged]
        gaps, of_gap = np.unique(sample[bridged], return_inverse=True)
        held, spread = np.zeros((len(gaps), 2, 3)), np.zeros((len(gaps), 2))
        for g, k in enumerate(gaps.tolist()):
            past = np.concatenate([earlier, rows[max(k - _MOST_ROWS, 0) : k]])[-_MOST_ROWS:]
            # before the first sample there is only the first
            held[g], spread[g] = _rates_before(imu, past if len(past) else rows[:1], spec)
        dvel_b, dtheta_b = np.vstack([dvel_b, held[:, 0]]), np.vstack([dtheta_b, held[:, 1]])
        row[bridged], share[bridged] = len(imu) + of_gap, cut_span[bridged]
        spread = spread[of_gap]
        unknown[bridged] = bridge_variance(after, spread) - bridge_variance(np.maximum(before, 0.0), spread)
    return Steps(cut_t, cut_span, row, share, unknown, dtheta_b, dvel_b)


def needed_rows(imu: ImuData, rows: IntArray) -> IntArray:
    """Return the rows in use that :func:`steps` may still need as ``earlier`` after the last row."""
    kept: IntArray = rows[imu.t[rows] > imu.t[rows[-1]] - _RECENT][-_MOST_ROWS:]
    return kept


def _inside(instants: FloatArray, ends: FloatArray) -> FloatArray:
    """Return the epochs that lie between the first and the last of ``ends`` and at none of them."""
    instants = instants[(instants > ends[0]) & (instants < ends[-1])]
    if len(instants) == 0:
        return instants
    after = np.searchsorted(ends, instants)
    apart = np.minimum(ends[after] - instants, instants - ends[after - 1])
    return instants[apart > TIME_TOLERANCE]


def imu_rows(imu: ImuData, start: float, spec: ImuSpec) -> tuple[IntArray, FloatArray, list[EventRow]]:
    """Return the IMU rows to integrate, the interval that each row covers, and the events.

    Parameters
    ----------
    imu : ImuData
        Record; rows that are flagged, not finite, without length or not later than the row before are
        left out.
    start : float
        Instant of the initial state [s]; earlier rows are left out.
    spec : ImuSpec
        The unit assumed. A row at or beyond the range of a sensor is left out: it says no more than that
        there was more. Without a range the limit is what no aircraft does.

    Returns
    -------
    rows : (K,) int array
    span : (K,) array
        From the row before (or ``start``) to each row [s]. It exceeds ``imu.dt`` where rows are missing, and
        an event says so.
    events : list of (t, t_end, kind, text)
    """
    rows, span, events, _ = ImuIntake(start).take(imu, spec, last=True)
    return rows, span, events


class ImuIntake(SessionState):
    """Times up to which an IMU record in pieces was taken, after a ``start`` [s]."""

    newest: Kept[float]  # of the rows in use [s]
    before: Kept[float]  # of the sound rows after the start, the one before the next [s]

    def __init__(self, start: float) -> None:
        self.start = self.newest = self.before = start

    def take(
        self, imu: ImuData, spec: ImuSpec, *, last: bool
    ) -> tuple[IntArray, FloatArray, list[EventRow], IntArray]:
        """Return the result of :func:`imu_rows` for the next piece, and the rows to repeat with a later one.

        These are none, or the last one if it leaps ahead: the next row shows whether its time is wild. After
        the ``last`` piece there is none.
        """
        if not len(imu.t):
            return _NO_ROWS, imu.t, [], _NO_ROWS
        start = self.newest
        span, events = np.empty(len(imu.t)), list[EventRow]()
        gaps = check_kernel(imu.t, imu.dt, imu.valid, imu.dtheta_b, imu.dvel_b, start, *limits(spec), span)
        if gaps >= 0:
            rows, again = self._hold(np.arange(len(imu.t)), imu.t, last)
            span = span[: len(rows)]
        else:
            rows, again, events = self._choose(imu, spec, last)
            span = np.diff(imu.t[rows], prepend=start)
        if len(rows):
            self.newest = float(imu.t[rows[-1]])
        return rows, span, events + (_list_gaps(imu, rows, span) if gaps else []), again

    def _hold(self, rows: IntArray, t: FloatArray, last: bool) -> tuple[IntArray, IntArray]:
        """Return the sound rows without a last row that leaps ahead in time, and this row."""
        before = float(t[rows[-2]]) if len(rows) > 1 else self.before
        count = len(rows)
        if count and not last and t[rows[-1]] > before + LONGEST_BRIDGE:
            count -= 1
        if count:
            self.before = float(t[rows[count - 1]])
        return rows[:count], rows[count:]

    def _choose(self, imu: ImuData, spec: ImuSpec, last: bool) -> tuple[IntArray, IntArray, list[EventRow]]:
        """Return the rows in use, the rows to repeat, and the events that count the other rows."""
        sound = imu.valid & np.isfinite(imu.t) & np.isfinite(imu.dt) & (imu.dt > 0)
        sound &= np.isfinite(imu.dtheta_b).all(axis=1) & np.isfinite(imu.dvel_b).all(axis=1)
        beyond = find_beyond(imu, spec)
        named = np.any([out for _, out in beyond], axis=0)
        events = left_out("imu", imu.t, ~sound & ~named, "flagged, not finite or without length")
        for why, out in beyond:
            events += left_out("imu", imu.t, out, why)
        sound &= ~named
        later = sound & (imu.t > self.start + TIME_TOLERANCE)
        events += left_out("imu", imu.t, sound & ~later, "before the start")
        rows = np.flatnonzero(later)
        t = imu.t[rows]
        again = rows[:0]
        if len(t):
            # a row that leaps ahead of those after it, too: it alone has a wild time
            wild = np.zeros(len(t), np.bool_)
            wild[:-1] = t[:-1] > t[1:] + TIME_TOLERANCE
            wild &= t > np.append(self.before, t[:-1]) + LONGEST_BRIDGE
            wild[:-1] &= t[1:] > np.append(self.before, t[:-2])
            events += left_out("imu", imu.t, rows[wild], "ahead of the rows after it")
            kept, again = self._hold(rows, imu.t, last)
            rows = kept[~wild[: len(kept)]]
            t = imu.t[rows]
            newest = np.maximum.accumulate(np.concatenate([[self.newest], t]))[:-1]
            ordered = t > newest + TIME_TOLERANCE
            events += left_out("imu", imu.t, rows[~ordered], "repeated or going back in time")
            rows = rows[ordered]
        return rows, again, events


def _list_gaps(imu: ImuData, rows: IntArray, span: FloatArray) -> list[EventRow]:
    """Return the events of gaps before rows in use; ``span`` is the interval that each has to cover [s]."""
    t, gaps = imu.t[rows], np.flatnonzero(span > imu.dt[rows] + TIME_TOLERANCE)
    return [
        (float(t[k] - gap), float(t[k]), "timeline", f"imu: gap of {gap - imu.dt[rows[k]]:.6g} s", "imu")
        for k, gap in zip(gaps, span[gaps], strict=True)
    ]


@kernel
def check_kernel(
    t: FloatArray, dt: FloatArray, valid: BoolArray, dtheta_b: FloatArray, dvel_b: FloatArray,
    start: float, most_rate: float, most_force: float, span: FloatArray,
) -> int:  # fmt: skip
    """Return how many rows of a record come after a gap, -1 if any row has to be left out.

    Fill span (N,) with the intervals between the rows. In nearly every record none is left out.
    """
    newest, gaps = start, 0
    for k in range(t.shape[0]):
        now, length = t[k], dt[k]
        span[k] = now - newest
        # a NaN is not below its limit; with a dt of zero nothing is
        rate, force = IN_RANGE * most_rate * length, IN_RANGE * most_force * length
        slow = abs(dtheta_b[k, 0]) < rate and abs(dtheta_b[k, 1]) < rate and abs(dtheta_b[k, 2]) < rate
        weak = abs(dvel_b[k, 0]) < force and abs(dvel_b[k, 1]) < force and abs(dvel_b[k, 2]) < force
        timed = valid[k] and now > newest + TIME_TOLERANCE and now < np.inf and length < np.inf
        if not (timed and slow and weak):
            return -1
        gaps += span[k] > length + TIME_TOLERANCE
        newest = now
    return gaps


def sound_rows(record: AidingRecord, values: FloatArray) -> BoolArray:
    """Return which rows (M,) of a record are not flagged and have finite times and values (M, n)."""
    sound: BoolArray = record.valid & np.isfinite(record.t) & np.isfinite(record.t_arrival)
    return sound & np.isfinite(values).all(axis=1)


def fix_rows(fixes: GnssFixes, imu_t: FloatArray, start: float) -> tuple[IntArray, IntArray, list[EventRow]]:
    """Return the fixes to use, the IMU sample each is used after (-1 at the start), and the events.

    A position must be finite, a velocity need not be: one that is not finite in all of its components is
    none, and an event counts the fixes in use that have none.

    Parameters
    ----------
    fixes : GnssFixes
        Record; rows that are flagged, not finite or repeated are left out.
    imu_t : (K,) array
        Epochs of the IMU samples in use [s].
    start : float
        Instant of the initial state [s]; rows that arrive earlier are left out.
    """
    t_arrival = fixes.t_arrival
    rows, events = fresh_rows(fixes.t, t_arrival, sound_rows(fixes, fixes.lla), "gnss", -np.inf)
    sample = np.searchsorted(imu_t, t_arrival[rows] - TIME_TOLERANCE)
    inside = (sample < len(imu_t)) & (t_arrival[rows] > start - TIME_TOLERANCE)
    sample[t_arrival[rows] < start + TIME_TOLERANCE] = -1
    events += left_out("gnss", fixes.t, rows[~inside], OUTSIDE)
    rows = rows[inside]
    return rows, sample[inside].astype(np.int64), events + without_velocity(fixes, rows)


def without_velocity(fixes: GnssFixes, rows: IntArray) -> list[EventRow]:
    """Return the events that count the fixes without velocity among some rows; none if all have one."""
    finite = np.isfinite(fixes.vel_n[rows]).sum(axis=1)
    if (finite == 3).all():
        return []
    t = fixes.t[rows[finite < 3]]
    part = t[finite[finite < 3] > 0]
    counts = (t, "fixes without velocity"), (part, "velocities finite in some components alone, left out")
    return [
        (float(t.min()), float(t.max()), "timeline", f"gnss: {len(t)} {what}", "gnss")
        for t, what in counts
        if len(t)
    ]


def fresh_rows(
    t: FloatArray, t_arrival: FloatArray, sound: BoolArray, name: str, newest: float
) -> tuple[IntArray, list[EventRow]]:
    """Return the rows that are ``sound`` (M,) and newer than all before, in the order of their arrival.

    ``newest`` is the latest validity of a sound row of earlier pieces of the record [s].
    """
    events = left_out(name, t, ~sound, "flagged or not finite")
    rows = np.flatnonzero(sound)
    rows = rows[np.argsort(t_arrival[rows], kind="stable")]
    valid_t = t[rows]
    if len(rows):
        before = np.maximum.accumulate(np.concatenate([[newest], valid_t]))[:-1]
        fresh = valid_t > before + TIME_TOLERANCE
        events += left_out(name, t, rows[~fresh], "repeated or going back in time")
        rows = rows[fresh]
    return rows, events


def empty_epochs(t: FloatArray, epoch_start: IntArray, start: float, end: float) -> list[EventRow]:
    """Return the event that counts the epochs without a row; none if there is no such epoch.

    They have no time of their own: it spans the rows ``t`` (K,) next to them, within the run.
    """
    empty = np.flatnonzero(np.diff(epoch_start) == 0)
    if not len(empty):
        return []
    before, after = t[: epoch_start[empty[0]]], t[epoch_start[empty[-1]] :]
    first = before[-1] if len(before) and np.isfinite(before[-1]) else start
    last = after[0] if len(after) and np.isfinite(after[0]) else end
    first, last = np.clip([first, last], start, end).tolist()
    text = f"satellites: {len(empty)} epochs without satellites"
    return [(first, max(first, last), "timeline", text, "satellites")]


def left_out(name: str, t: FloatArray, out: BoolArray | IntArray, why: str) -> list[EventRow]:
    """Return the event that counts the rows ``out`` of a record; none if there is no such row."""
    times = t[out]
    if not len(times):
        return []
    finite = times[np.isfinite(times)]
    first, last = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    return [(first, last, "timeline", f"{name}: {len(times)} rows left out: {why}", name)]
