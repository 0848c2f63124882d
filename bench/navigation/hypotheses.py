"""A start with an unknown heading: several headings, a filter for each, until motion shows which is right.

A filter that is linear in the heading error is good for about 15 deg. With a larger error the products of
heading and tilt error that it neglects look like information: at rest it becomes sure of a wrong heading and
a wrong tilt. Here each heading psi_k is a hypothesis with its own filter. Its weight follows from the
innovations z of covariance S,

    w_k ~ p(psi_k) prod exp(-z' S^-1 z / 2) / sqrt(prod S_ii)

Until one filter stands for all, the estimate is that of one hypothesis, with the mean square of its error
over all of them. With d the rotation from hypothesis k to the estimate and e the error of hypothesis k, the
attitude error is log(exp(d) exp(e)) = d + J(d) e, J the inverse right Jacobian of rotations (J. Sola, J.
Deray, D. Atchuthan, A micro Lie theory for state estimation in robotics, 2018, eq. 144).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from bench import rotation
from bench.arrays import FloatArray, IntArray
from bench.data import EventRow, ImuData, InitialState, NavSolution, SensorData
from bench.earth import EARTH_RATE, difference_n
from bench.errors import EstimatorError
from bench.navigation.aiding import SENSORS
from bench.navigation.error_state import PHI, POS, VEL
from bench.navigation.leveling import bias_sd
from bench.navigation.rough_heading import UNKNOWN_HEADING_SD, may_stand
from bench.navigation.timeline import TIME_TOLERANCE

LINEAR = float(np.deg2rad(15.0))  # sd of a heading up to which one linear filter is good [rad]
COUNT = 16  # hypotheses around the circle
SD = np.pi / COUNT  # of the heading of each: half the distance to the next, so that their sum is flat to 2 %
FIRST = 60.0  # length of the first trial [s]; each further one is twice as long
AHEAD = 2.0  # a hypothesis becomes the estimate when it is this much more likely than the present one
MOST_NIS = 30.0  # that a measurement counts with: an outlier decides nothing
ASSUMED = ("zero_velocity", "zero_rate")  # no measurements; wrong in steady flight
_APART = 0.5  # spread of the hypotheses, over the sd of the best, from which on it stands for all

Run = Callable[[SensorData, InitialState], NavSolution]


@dataclass(frozen=True, slots=True)
class Settled:
    """The hypothesis that is left, and the estimate until then."""

    initial: InitialState  # of the most likely hypothesis
    early: NavSolution  # of all hypotheses together, at the first instants of the solution
    complete: bool  # one filter stands for all
    event: EventRow

    def join(self, late: NavSolution) -> NavSolution:
        """Return the solution of the hypothesis that is left, with the common estimate before."""
        m = len(self.early)
        columns: dict[str, Any] = {}
        for name in ("lla", "vel_n", "q_nb", "gyro_bias_b", "accel_bias_b", "cov", "extra", "extra_sd"):
            columns[name] = getattr(late, name).copy()
            columns[name][:m] = getattr(self.early, name)
        return replace(late, **columns)


def heading_is_unknown(initial: InitialState) -> bool:
    """Tell whether the heading is too uncertain for one linear filter."""
    return bool(initial.cov[8, 8] > LINEAR**2)


def refuse_unknown_heading(initial: InitialState) -> None:
    """Raise the error of a start in pieces whose heading is unknown.

    Raises
    ------
    EstimatorError
    """
    if heading_is_unknown(initial):
        raise EstimatorError(
            "it cannot run in pieces from an unknown heading: several filters have to find it on the whole "
            "record; give a heading known to 15 deg"
        )


def settle_heading(run: Run, sensors: SensorData, initial: InitialState) -> Settled:
    """Run a filter from headings around the circle until one of them stands for all.

    Parameters
    ----------
    run : callable
        The filter: record and initial state to solution.
    sensors : SensorData
        The record. Only its beginning is used, as long as it takes.
    initial : InitialState
        Complete, with a heading for which :func:`heading_is_unknown`.
    """
    turns = 2.0 * np.pi / COUNT * (np.arange(COUNT) - COUNT // 2)
    sd = np.sqrt(initial.cov[8, 8])
    prior = np.zeros(COUNT) if sd >= UNKNOWN_HEADING_SD else -0.5 * (turns / sd) ** 2
    starts = [turn_heading(initial, turn) for turn in turns]
    by_rest = ["magnetometer"]
    e_rate = EARTH_RATE * np.cos(initial.lla[0])
    if bias_sd(sensors.specs.imu.gyro, 0.0) < UNKNOWN_HEADING_SD * e_rate:  # it can gyrocompass
        by_rest = list(SENSORS)
    span, end = FIRST, float(sensors.imu.t.max(initial=initial.t))
    while True:
        until = initial.t + span
        part = _beginning(sensors, until)
        members = [run(part, start) for start in starts]
        weight = _weights(members, prior, by_rest)
        early, best = _combine(members, weight)
        spread, own = _heading_spread(members, weight, best)
        complete = spread < _APART * own and not until >= end
        if complete or until >= end:
            break
        span *= 2.0
    text = f"heading unknown: {COUNT} hypotheses; "
    text += f"settled by {until:.0f} s, sd {np.rad2deg(own):.2g} deg" if complete else "no motion told it"
    return Settled(starts[best], early, complete, (initial.t, min(until, end), "alignment", text))


def turn_heading(initial: InitialState, turn: float) -> InitialState:
    """Return an initial state with another heading, known to ``SD``; tilt errors turn with the aircraft."""
    T = np.eye(9)
    T[PHI : PHI + 2, PHI : PHI + 2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    cov, bias_cov = initial.cov.copy(), initial.bias_cov.copy()
    cov[8], cov[:, 8], bias_cov[8] = 0.0, 0.0, 0.0
    cov[8, 8] = SD**2
    q_nb = rotation.multiply(rotation.from_rotvec([0.0, 0.0, turn]), initial.q_nb)
    return replace(initial, q_nb=q_nb, cov=T @ cov @ T.T, bias_cov=T @ bias_cov)


def _beginning(sensors: SensorData, until: float) -> SensorData:
    """Return a record without IMU samples and outputs after an instant [s]."""
    imu, rows = sensors.imu, ~(sensors.imu.t > until)
    cut = ImuData(**{f.name: getattr(imu, f.name)[rows] for f in fields(imu)})
    return replace(sensors, imu=cut, output_t=sensors.output_t[sensors.output_t <= until])


def _weights(members: list[NavSolution], prior: FloatArray, by_rest: list[str]) -> FloatArray:
    """Return the weight (K, M) of each hypothesis at each instant of the solution.

    Up to an instant at which the aircraft may stand only the sensors ``by_rest`` count: in others noise and
    the drift of the filter lie along some heading by chance, and the filter would take them for motion.
    """
    t = members[0].t
    rest = np.append(may_stand(members[0].vel_n, members[0].cov), False)
    log = np.empty((len(members), len(t)))
    for k, member in enumerate(members):
        table = member.innovations
        gain = -0.5 * (np.where(table.component == 0, np.minimum(table.nis, MOST_NIS), 0.0) + np.log(table.S))
        name = np.array(table.sensor)[table.code]
        gain[np.isin(name, ASSUMED)] = 0.0
        gain[rest[np.searchsorted(t, table.t - TIME_TOLERANCE)] & ~np.isin(name, by_rest)] = 0.0
        total = np.concatenate([[0.0], np.cumsum(np.where(np.isfinite(gain), gain, -np.inf))])
        log[k] = prior[k] + total[np.searchsorted(table.t, t, side="right")]
    log -= log.max(axis=0)
    weight = np.exp(log)
    return np.asarray(weight / weight.sum(axis=0))


def _leading(weight: FloatArray) -> IntArray:
    """Return which hypothesis is the estimate at each instant; it changes only for a much likelier one."""
    leader = np.empty(weight.shape[1], np.int64)
    now = len(weight) // 2  # the heading that was given
    for j, column in enumerate(weight.T):
        if column.max() > AHEAD * column[now]:
            now = int(column.argmax())
        leader[j] = now
    return leader


def _combine(members: list[NavSolution], weight: FloatArray) -> tuple[NavSolution, int]:
    """Return the estimate of all hypotheses, and which one it is in the end."""
    leader = _leading(weight)
    rows = np.arange(weight.shape[1])

    def led(name: str) -> FloatArray:
        return np.stack([getattr(member, name) for member in members])[leader, rows]

    values = {name: led(name) for name in ("lla", "vel_n", "q_nb", "gyro_bias_b", "accel_bias_b", "extra")}
    cov, variance = np.zeros((len(rows), 9, 9)), np.zeros_like(values["extra"])
    for member, w in zip(members, weight, strict=True):
        d = np.empty((len(rows), 9))
        d[:, POS:VEL] = difference_n(values["lla"], member.lla)
        d[:, VEL:PHI] = values["vel_n"] - member.vel_n
        turn = rotation.multiply(values["q_nb"], rotation.conjugate(member.q_nb))
        d[:, PHI:] = rotation.to_rotvec(turn)
        J = np.tile(np.eye(9), (len(rows), 1, 1))
        J[:, PHI:, PHI:] = _inverse_jacobian(d[:, PHI:])
        square = J @ member.cov @ np.swapaxes(J, 1, 2) + d[:, :, None] * d[:, None, :]
        apart = values["extra"] - member.extra
        cov += np.where(w > 0, w, 0.0)[:, None, None] * np.where(w[:, None, None] > 0, square, 0.0)
        variance += np.where(w[:, None] > 0, w[:, None] * (member.extra_sd**2 + apart**2), 0.0)
    columns: dict[str, Any] = {**values, "cov": cov, "extra_sd": np.sqrt(variance)}
    early = replace(members[0], **columns)
    return early, int(leader[-1]) if len(leader) else len(members) // 2


def _inverse_jacobian(d: FloatArray) -> FloatArray:
    """Return J (M, 3, 3) of rotation vectors d (M, 3) up to pi: log(exp(d) exp(e)) = d + J e."""
    angle = np.linalg.norm(d, axis=1)
    half = 0.5 * np.maximum(angle, 1e-3)
    second = (1.0 - half / np.tan(half)) / (4.0 * half * half)
    cross = rotation.skew(d)
    J: FloatArray = np.eye(3) + 0.5 * cross + second[:, None, None] * (cross @ cross)
    return J


def _heading_spread(members: list[NavSolution], weight: FloatArray, best: int) -> tuple[float, float]:
    """Return at the last instant how far the hypotheses lie from the best, rms, and its own sd [rad]."""
    if not weight.shape[1]:
        return np.inf, SD
    last = [member.q_nb[-1] for member in members]
    apart = [rotation.to_rotvec(rotation.multiply(last[best], rotation.conjugate(q)))[2] for q in last]
    spread = np.nansum(weight[:, -1] * np.square(apart))
    return float(np.sqrt(spread)), float(np.sqrt(members[best].cov[-1, 8, 8]))
