"""The gate: the decision on a measurement after its tests, the memory of each channel, and the log.

Compiled filters call the kernels, filters in Python an :class:`InnovationGate` around the same kernels.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from bench.core.compilation.compiled import inner, kernel
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.core.records.data import EventRow, Innovations, no_innovations
from bench.navigation.engine.integrity import nis, nis_limit
from bench.navigation.engine.kalman import nis_kernel
from bench.navigation.engine.session import Growing, Kept, SessionState
from bench.navigation.engine.timeline import TIME_TOLERANCE

OUTAGE = 10.0
"""Time without fixes after which a filter takes its own drift for possible [s]."""
LEAST_REFUSALS = 3
"""So many measurements of a sensor are rejected before one is re-admitted, however long that takes."""
NOISIER = 3.0
"""A receiver may be so many times as noisy as its datasheet says and is still re-admitted."""
REFUSED, SOUND, DRIFTED, STEPPED, LOST = range(5)
"""What becomes of a measurement. It is used where it is sound, or tells that the filter drifted while there
were no fixes, and after long rejections: then the instrument made a step, or the filter itself may be
lost."""

Refused = dict[int, tuple[float, float, int]]
"""Channel -> epochs of the first and the last [s] and number of the rejections that have not ended."""


class Trust(NamedTuple):
    """Memory of a gate for each channel; a channel is a part of a sensor that is tested separately.

    Channels 0 and 1 are position and velocity of a fix.
    """

    misses: Growing[IntArray]  # (channels,) rejections in a row
    since: Growing[FloatArray]  # (channels,) time of the first of them [s]
    used: Growing[FloatArray]  # (channels,) time of the last measurement used [s]
    way: (
        FloatArray  # (3, 3) of rejected fixes: first innovation of position, integral of velocity's, its last
    )
    way_t: FloatArray  # (2,) epochs of the first, since which they agree, and of the last of them [s]
    jumped: IntArray  # (1,) 1 if the first of them jumped away from the fixes before (`jumps_kernel`)

    def with_channels(self, channels: int, start: float) -> Trust:
        """Return a memory of at least so many channels."""
        new = channels - len(self.misses)
        if new <= 0:
            return self
        late = np.full(new, start)
        misses = np.append(self.misses, np.zeros(new, np.int64))
        since, used = np.append(self.since, late), np.append(self.used, late)
        return self._replace(misses=misses, since=since, used=used)


def new_trust(channels: int, start: float) -> Trust:
    """Return the memory at the start of a record [s]."""
    first = np.full(channels, start)
    none = np.zeros(1, np.int64)
    return Trust(np.zeros(channels, np.int64), first, first.copy(), np.zeros((3, 3)), np.full(2, start), none)


class InnovationLog(NamedTuple):
    """Rows of the innovation table."""

    numbers: FloatArray  # (4, N) t, innovation, its variance, NIS
    marks: IntArray  # (4, N) sensor, component, accepted, channel
    filled: IntArray  # (1,) number of rows written


def new_log(size: int) -> InnovationLog:
    """Return an empty log with room for ``size`` rows."""
    return InnovationLog(np.empty((4, size)), np.empty((4, size), np.int64), np.zeros(1, np.int64))


def innovations(sensors: tuple[str, ...], numbers: FloatArray, marks: IntArray) -> Innovations:
    """Return the table of the rows of a log."""
    if numbers.shape[1] == 0:
        return no_innovations()
    t, z, S, found = numbers
    code, component, accepted = marks[:3]
    return Innovations(t, sensors, code, component, z, S, found, accepted.astype(np.bool_))


def refusals(
    t: FloatArray,
    marks: IntArray,
    names: list[str],
    so_far: Refused,
    *,
    last: bool,
) -> list[EventRow]:
    """Return an event for every finished series of rejections of a channel, from the first to the last.

    ``so_far`` holds those of earlier pieces that have not; after the ``last`` piece all have.
    """
    if not so_far and marks[2].all():
        return []
    ended: list[tuple[int, tuple[float, float, int]]] = []
    first = marks[1] == 0
    for channel in {*np.unique(marks[3, first & (marks[2] == 0)]).tolist(), *so_far}:
        rows = np.flatnonzero(first & (marks[3] == channel))
        refused = marks[2, rows] == 0
        edges = np.flatnonzero(np.diff(np.concatenate([[False], refused, [False]]).astype(np.int64)))
        before = so_far.pop(channel, None)
        if before is not None and not refused[:1].any():
            ended.append((channel, before))
        for begin, end in edges.reshape(-1, 2).tolist():
            row = float(t[rows[begin]]), float(t[rows[end - 1]]), end - begin
            if before is not None and begin == 0:
                row = before[0], row[1], before[2] + row[2]
            ended.append((channel, row))
        if ended and ended[-1][0] == channel and not last and (not len(rows) or refused[-1]):
            so_far[channel] = ended.pop()[1]
    return sorted(
        (begin, end, "refused", f"{names[channel]}: {count} in a row rejected", names[channel])
        for channel, (begin, end, count) in ended
    )


@kernel
def decide_kernel(
    t: float,
    channel: int,
    sound: bool,
    drifted: bool,
    opens: bool,
    readmit_after_s: float,
    satellites: int,
    trust: Trust,
) -> int:
    """Decide on a measurement at t [s], and remember the decision (A-5.4.7).

    ``sound``: it passes its tests; ``drifted``: it fails by a drift of the filter (:func:`drift_kernel`);
    ``opens``: the filter has states that may have made a step, and can grow for it. After
    ``readmit_after_s`` of nothing but rejections, at least `LEAST_REFUSALS`, it is re-admitted. Where GNSS
    was used meanwhile another instrument made a step, and the filter is not lost; nor is it where fixes
    jumped. Channels of satellites begin at ``satellites``.
    """
    verdict, waited = REFUSED, t - trust.since[channel]
    if sound:
        verdict = SOUND
    elif drifted:
        verdict = DRIFTED
    elif opens and trust.misses[channel] >= LEAST_REFUSALS and waited >= readmit_after_s - TIME_TOLERANCE:
        verdict = STEPPED if channel < 2 and trust.jumped[0] else LOST
        if 2 <= channel < satellites:
            for other in range(trust.used.shape[0]):
                if (other < 2 or other >= satellites) and trust.used[other] > trust.since[channel]:
                    verdict = STEPPED
    if verdict == REFUSED:
        if trust.misses[channel] == 0:
            trust.since[channel] = t
        trust.misses[channel] += 1
    else:
        trust.misses[channel] = 0
        trust.used[channel] = t
    return verdict


@kernel
def returns_kernel(t: float, trust: Trust) -> bool:
    """Return whether a fix comes after an outage, in which no fix was used or rejected.

    Channels 0 and 1 are its position and velocity.
    """
    waited = t - max(trust.used[0], trust.used[1])
    return bool(trust.misses[0] + trust.misses[1] == 0 and waited >= OUTAGE)


@kernel
def jumps_kernel(dt: float, position: float, velocity: float, off: float, speed: float, limit: float) -> bool:
    """Return whether a fix jumped: no filter drifts as far in the time dt [s] since it used the last.

    Of a fix that is rejected, either the position alone is beyond twice the gate, and further off than a
    wrong attitude takes it; after an `OUTAGE`, whose drift would show in the velocity, it is beyond the gate.
    Or the velocity is, by more than a wrong attitude makes of gravity: twice a free fall. Given are the NIS
    of both and their ``limit``, and how far they are ``off`` in place [m] and ``speed`` [m/s].
    """
    fall = 2.0 * STANDARD_GRAVITY * dt
    if velocity > limit:
        return velocity > 4.0 * limit and speed > fall
    return dt >= OUTAGE or (position > 4.0 * limit and off > (speed + 0.5 * fall) * dt)


@kernel
def moves_kernel(
    t: float, y: FloatArray, var: FloatArray, limit: float, readmit_after_s: float, trust: Trust
) -> bool:
    """Return whether rejected fixes moved as their velocities for readmit_after_s; remember this fix.

    A receiver that is right where the filter is wrong does; one whose output is frozen, or whose position
    alone is pulled away, does not, and is not re-admitted. y (6,) are the innovations of position [m] and
    velocity [m/s] in axes that do not turn, var (6,) their variances, ``limit`` the largest NIS of three
    components.
    """
    first, way, last, at = trust.way[0], trust.way[1], trust.way[2], trust.way_t
    begins, squares = trust.misses[0] + trust.misses[1] == 0, 0.0
    if trust.misses[0] == 0 and trust.misses[1] > 0 and at[1] < trust.since[1]:
        begins = True  # the position of the fix before was within its gate, the velocity was not
    if not begins:
        dt, T = t - at[1], t - at[0]
        for i in range(3):
            way[i] += 0.5 * dt * (last[i] + y[3 + i])
            off = y[i] - first[i] - way[i]
            squares += off * off / (2.0 * NOISIER * NOISIER * var[i] + T * T * var[3 + i])
    if begins:
        position, velocity, off, speed = 0.0, 0.0, 0.0, 0.0
        for i in range(3):
            position, velocity = position + y[i] ** 2 / var[i], velocity + y[3 + i] ** 2 / var[3 + i]
            off, speed = off + y[i] ** 2, speed + y[3 + i] ** 2
        dt = t - min(trust.used[0], trust.used[1])
        jumps = jumps_kernel(dt, position, velocity, math.sqrt(off), math.sqrt(speed), limit)
        trust.jumped[0] = jumps and trust.used[0] > trust.since[0]  # one that never used a fix may be wrong
    if begins or not squares <= limit:
        at[0] = t
        for i in range(3):
            first[i], way[i] = y[i], 0.0
    at[1] = t
    for i in range(3):
        last[i] = y[3 + i]
    return bool(t - at[0] >= readmit_after_s - TIME_TOLERANCE)


@kernel
def drift_kernel(position: float, velocity: float, both: float, apart: float, limit: float) -> bool:
    """Return whether a position is beyond the gate because of a drift without fixes, not because of a fault.

    A drift moves the velocity, too, a step of the receiver the position alone. So the velocity of the fix has
    to be beyond the gate as well; or to be expected once the position is used, if the filter reports
    a larger position sigma than the fix. Given are the NIS of the position, of the velocity and of both, the
    ``limit`` for three components, and how far ``apart`` the trace of S and twice that of the noise of the
    position are [m^2]: above 0 for such a covariance.
    """
    return position > limit and (velocity > limit or (apart > 0.0 and both - position <= limit))


@kernel
def contradicts_kernel(position: float, velocity: float, both: float, limit: float) -> bool:
    """Return whether position and velocity of a fix are each within the gate, but not together.

    After an outage the position may be anywhere within kilometers, and the velocity tells where: a fix whose
    position was moved alone passes both gates, and would turn the velocity and the attitude. Given are the
    NIS of the position, of the velocity and of both, and the ``limit`` for three components.
    """
    return position <= limit and velocity <= limit and both - position > limit


@inner
def fix_kernel(
    t: float,
    P: FloatArray,
    dx: FloatArray,
    H: FloatArray,
    z: FloatArray,
    r: FloatArray,
    limit: float,
    readmit_after_s: float,
    trust: Trust,
    y: FloatArray,
    var: FloatArray,
    work: FloatArray,
    HP: FloatArray,
    at: IntArray,
) -> tuple[bool, bool, bool]:
    """Return `drift_kernel`, `moves_kernel` and `contradicts_kernel` of a fix z (6,) = H dx + v.

    The first asks only after an outage, the last also while fixes are rejected.

    dx is 0. ``work`` (6, 7), ``HP`` (6, n) and ``at`` (6, n + 1) end as `kalman.nis_kernel` of the position
    leaves them.
    """
    both = nis_kernel(P, dx, H, z, r, var, work, HP, at)
    for i in range(6):
        y[i] = -z[i]
    moves = moves_kernel(t, y, var, limit, readmit_after_s, trust)
    velocity = nis_kernel(P, dx, H[3:], z[3:], r[3:], var, work, HP, at)
    position = nis_kernel(P, dx, H[:3], z[:3], r[:3], var, work, HP, at)
    apart = 0.0
    for a in range(3):
        apart += var[a] - 2.0 * r[a]
    returns, refused = returns_kernel(t, trust), trust.misses[0] + trust.misses[1] > 0
    drifted = returns and drift_kernel(position, velocity, both, apart, limit)
    contradicts = (returns or refused) and contradicts_kernel(position, velocity, both, limit)
    return drifted, moves, contradicts


@inner
def note_kernel(
    t: float,
    code: int,
    channel: int,
    component: int,
    z: float,
    S: float,
    value: float,
    used: bool,
    log: InnovationLog,
) -> None:
    """Write a row of the log: an innovation z of variance S, and whether it was used."""
    row = log.filled[0]
    log.numbers[0, row], log.numbers[1, row] = t, z
    log.numbers[2, row], log.numbers[3, row] = S, value
    log.marks[0, row], log.marks[1, row] = code, component
    log.marks[2, row], log.marks[3, row] = used, channel
    log.filled[0] = row + 1


def growth(verdict: int, x: FloatArray, H: FloatArray, e: FloatArray, opens: BoolArray) -> FloatArray:
    """Return columns E (n, m + 1): P grows by E E', as in compiled filters in place.

    `kalman.open_kernel` says why. ``x`` (n,) is the correction that the filter rejected, P H' S^-1 e; H (m,
    n) and e (m,) are those of the sub-vector, ``opens`` (n,) the states that may have made a step.
    """
    along = np.where(opens, H, 0.0)
    size2 = np.sum(along**2, axis=1)
    steps = along * np.divide(e, size2, out=np.zeros_like(e), where=size2 > 0)[:, None]
    return np.column_stack([x * (verdict != STEPPED), steps.T * (verdict != DRIFTED)])


class InnovationGate(SessionState):
    """The gate of a filter in Python.

    The code of one of the ``sensors`` is its channel; the first two are position and velocity of a fix. The
    record begins at ``start`` [s], and ``probability`` is the chance of rejecting a sound measurement.
    """

    trust: Kept[Trust]
    drifted: Kept[bool]  # the fix in use: by a drift of the filter
    moves: Kept[bool]  # the fix in use: as it says itself
    contradicts: Kept[bool]  # the fix in use: its position is rejected
    refused: Kept[Refused]
    _numbers: Kept[list[tuple[float, float, float, float]]]  # the log
    _marks: Kept[list[tuple[int, int, int, int]]]

    def __init__(
        self, sensors: tuple[str, ...], start: float, probability: float, readmit_after_s: float
    ) -> None:
        self.sensors, self.readmit_after_s = sensors, readmit_after_s
        self.limits = {m: nis_limit(m, probability) for m in (1, 2, 3)}
        self.trust = new_trust(len(sensors), start)
        self.drifted, self.moves, self.contradicts = False, True, False
        self.refused, self._numbers, self._marks = {}, [], []

    def decide(
        self,
        t: float,
        code: int,
        z: Iterable[float],
        S: Iterable[float],
        value: float,
        *,
        sound: bool,
        drifts: bool = True,
        opens: bool = True,
    ) -> int:
        """Decide on a measurement, and log it.

        It is measured less predicted z (m,) of variances S (m,), with the NIS ``value``. ``drifts``: a drift
        of the filter may be why it is not sound.
        """
        of_fix = code < 2
        sound = bool(sound) and not (code == 0 and self.contradicts)
        drifted, opens = of_fix and drifts and self.drifted, opens and (self.moves or not of_fix)
        verdict = decide_kernel(
            t, code, sound, drifted, opens, self.readmit_after_s, len(self.sensors), self.trust
        )
        for component, (one, variance) in enumerate(zip(z, S, strict=True)):
            self._numbers.append((t, float(one), float(variance), value))
            self._marks.append((code, component, int(verdict != REFUSED), code))
        return int(verdict)

    def see_fix(self, t: float, y: FloatArray, S: FloatArray, r: FloatArray) -> None:
        """Process a fix with a velocity before the decision on its parts (:func:`fix_kernel`).

        y (6,) and S (6, 6) are in axes that do not turn, r (3,) the variance of its position.
        """
        self.drifted, self.contradicts, limit = False, False, self.limits[3]
        returns = bool(returns_kernel(t, self.trust))
        if returns or self.trust.misses[:2].any():
            apart = float(np.trace(S[:3, :3])) - 2.0 * float(np.sum(r))
            found = nis(y[:3], S[:3, :3]), nis(y[3:], S[3:, 3:]), nis(y, S)
            self.drifted = returns and bool(drift_kernel(*found, apart, limit))
            self.contradicts = bool(contradicts_kernel(*found, limit))
        self.moves = bool(moves_kernel(t, y, np.diag(S).copy(), limit, self.readmit_after_s, self.trust))

    def see_position(self) -> None:
        """Process a fix without a velocity: the reason why it is beyond the gate cannot be determined."""
        self.drifted, self.moves, self.contradicts = False, True, False

    def take(self, *, last: bool) -> tuple[Innovations, list[EventRow]]:
        """Return the innovations and the events of finished rejections since the last call."""
        numbers = np.array(self._numbers).reshape(-1, 4).T
        marks = np.array(self._marks, np.int64).reshape(-1, 4).T
        self._numbers, self._marks = [], []
        events = refusals(numbers[0], marks, list(self.sensors), self.refused, last=last)
        return innovations(self.sensors, numbers, marks), events
