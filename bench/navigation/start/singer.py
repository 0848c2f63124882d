"""Singer's maneuver model of an aircraft, and its Kalman filter for fixes, as one kernel.

Along each axis of n the acceleration is a Gauss-Markov process (R. A. Singer, Estimating optimal tracking
filter performance for manned maneuvering targets, IEEE Trans. AES-6 (4), 1970): constant for a moment, zero
in the long run. Errors of nine states, position, velocity and acceleration:

    p'' = a      a' = -a / tau + w,   density of w 2 sd^2 / tau

State i of axis a is number 3 i + a, and the axes move by themselves: Phi P Phi' is made of blocks of 3 x 3.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bench.core.compilation.compiled import inner, kernel
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.mathematics.earth import difference_kernel, displace_kernel
from bench.navigation.engine.gate import (
    DRIFTED,
    LOST,
    REFUSED,
    SOUND,
    InnovationLog,
    Trust,
    decide_kernel,
    fix_kernel,
    note_kernel,
)
from bench.navigation.engine.kalman import nis_kernel, open_kernel, stretch_kernel, update_kernel
from bench.navigation.engine.timeline import TIME_TOLERANCE

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_POINTS = np.append(0.5 * (_NODES + 1.0), 1.0)  # of an interval of 1, and its end
_SHARES = np.append(_WEIGHTS, 0.0)
_SMALL = 1e-4  # T / tau below which a series replaces a difference that is rounding


class Manoeuvres(NamedTuple):
    """The model, and the test of a fix."""

    sd: float  # of the acceleration along each axis [m/s^2]
    tau: float  # its correlation time [s]
    nis: float  # largest NIS of a position or a velocity
    readmit_after_s: float  # time of nothing but rejections after which fixes are re-admitted [s]


class SingerTrack(NamedTuple):
    """The filter at the time of its last fix."""

    t: FloatArray  # (1,) [s]
    x: FloatArray  # (9,) position [rad, rad, m], velocity [m/s] and acceleration [m/s^2], n
    P: FloatArray  # (9, 9)
    trust: Trust  # in positions and in velocities


class Fixes(NamedTuple):
    """Fixes in the order of their use."""

    t: FloatArray  # (N,) validity [s]
    lla: FloatArray  # (N, 3)
    vel_n: FloatArray  # (N, 3); not finite: none
    r: FloatArray  # (N, 6) variance
    at: IntArray  # (N,) the first output after each


class TrackWork(NamedTuple):
    """Memory of the kernels."""

    Phi: FloatArray  # (3, 3) of one axis
    Q: FloatArray  # (3, 3)
    block: FloatArray  # (3, 3)
    product: FloatArray  # (3, 3)
    response: FloatArray  # (3,)
    way: FloatArray  # (3,)
    z: FloatArray  # (6,)
    e: FloatArray  # (6,)
    innovation: FloatArray  # (6,)
    var: FloatArray  # (6,)
    dx: FloatArray  # (9,)
    row: FloatArray  # (9,)
    other_row: FloatArray  # (9,)
    H: FloatArray  # (6, 9) of a position and a velocity
    opens: BoolArray  # (2, 9) states that may have made a step
    square: FloatArray  # (6, 7)
    rows: FloatArray  # (6, 9)
    columns: IntArray  # (6, 10)
    unused: FloatArray  # (9, 9)


def track_work() -> TrackWork:
    """Return the memory of :func:`track_kernel`."""
    arrays = [
        *np.zeros((4, 3, 3)),
        *np.zeros((2, 3)),
        *np.zeros((4, 6)),
        *np.zeros((3, 9)),
        np.eye(9)[:6],
        np.repeat(np.eye(3, dtype=np.bool_)[:2], 3, axis=1),
        np.zeros((6, 7)),
        np.zeros((6, 9)),
        np.zeros((6, 10), np.int64),
        np.zeros((9, 9)),
    ]
    return TrackWork._make(arrays)


@inner
def _turn_kernel(Phi: FloatArray, block: FloatArray, product: FloatArray) -> None:
    """Replace a block (3, 3) by Phi block Phi'."""
    for i in range(3):
        for j in range(3):
            product[i, j] = Phi[i, 0] * block[0, j] + Phi[i, 1] * block[1, j] + Phi[i, 2] * block[2, j]
    for i in range(3):
        for j in range(3):
            block[i, j] = product[i, 0] * Phi[j, 0] + product[i, 1] * Phi[j, 1] + product[i, 2] * Phi[j, 2]


@kernel
def singer_kernel(T: float, sd: float, tau: float, work: TrackWork) -> None:
    """Fill Phi and Q of position, velocity and acceleration along one axis over T seconds.

    Q by Gauss-Legendre quadrature of the impulse response, exact to rounding for T below tau; longer ways
    are made of halves. ``sd`` [m/s^2] and ``tau`` [s] are those of the acceleration.
    """
    Phi, Q, block, product, response = work.Phi, work.Q, work.block, work.product, work.response
    halvings = 0
    while tau < T:
        T *= 0.5
        halvings += 1
    for i in range(3):
        for j in range(3):
            Q[i, j] = 0.0
            Phi[i, j] = 1.0 if i == j else 0.0
    for k in range(_POINTS.shape[0]):
        x = T * _POINTS[k] / tau
        gone = -np.expm1(-x)
        way = 0.5 * x * x * (1.0 - x / 3.0 * (1.0 - x / 4.0)) if x < _SMALL else x - gone
        response[0], response[1], response[2] = tau * tau * way, tau * gone, 1.0 - gone
        share = T * _SHARES[k] * sd * sd / tau
        for i in range(3):
            for j in range(3):
                Q[i, j] += share * (response[i] * response[j])
    Phi[0, 1] = T
    for i in range(3):  # the response at the end of the interval
        Phi[i, 2] = response[i]
    for _ in range(halvings):
        for i in range(3):
            for j in range(3):
                block[i, j] = Q[i, j]
        _turn_kernel(Phi, block, product)
        for i in range(3):
            for j in range(3):
                Q[i, j] += block[i, j]
                product[i, j] = Phi[i, 0] * Phi[0, j] + Phi[i, 1] * Phi[1, j] + Phi[i, 2] * Phi[2, j]
        for i in range(3):
            for j in range(3):
                Phi[i, j] = product[i, j]


@inner
def _carry_kernel(
    T: float, now: SingerTrack, model: Manoeuvres, x: FloatArray, P: FloatArray, work: TrackWork
) -> None:
    """Fill x (9,) and P (9, 9) with a track propagated over T seconds; they may be the track's own."""
    Phi, Q, block = work.Phi, work.Q, work.block
    singer_kernel(T, model.sd, model.tau, work)
    for i in range(3):
        velocity, acceleration = now.x[3 + i], now.x[6 + i]
        work.way[i] = velocity * Phi[0, 1] + acceleration * Phi[0, 2]
        x[3 + i] = velocity + acceleration * Phi[1, 2]
        x[6 + i] = acceleration * Phi[2, 2]
    displace_kernel(now.x, work.way, x)
    for a in range(3):
        for b in range(a + 1):
            for i in range(3):
                for j in range(3):
                    block[i, j] = now.P[3 * i + a, 3 * j + b]
            _turn_kernel(Phi, block, work.product)
            for i in range(3):
                for j in range(3):
                    value = block[i, j] + Q[i, j] if a == b else block[i, j]
                    P[3 * i + a, 3 * j + b] = value
                    P[3 * j + b, 3 * i + a] = value


@inner
def _use_kernel(
    k: int, now: SingerTrack, fixes: Fixes, model: Manoeuvres, log: InnovationLog, work: TrackWork
) -> None:
    """Use a fix that is valid now, position and velocity (if it has one) each with its own test."""
    x, P, z, e, dx, r = now.x, now.P, work.z, work.e, work.dx, fixes.r[k]
    t, trust, vel_n, drifted, moves = now.t[0], now.trust, fixes.vel_n[k], False, True
    parts = 2 if np.isfinite(vel_n[0] + vel_n[1] + vel_n[2]) else 1
    for code in range(parts):
        part = slice(3 * code, 3 * code + 3)
        difference_kernel(fixes.lla[k], x, e)
        for i in range(3):
            e[3 + i] = vel_n[i] - x[3 + i]
        for i in range(6):
            z[i] = -e[i]
        nis = nis_kernel(
            P, dx, work.H[part], z[part], r[part], work.var, work.square, work.rows, work.columns
        )
        sound = nis <= model.nis
        if code == 0 and parts == 2:
            drifted, moves, contradicts = fix_kernel(
                t, P, dx, work.H, z, r, model.nis, model.readmit_after_s, trust,
                work.innovation, work.var, work.square, work.rows, work.columns,
            )  # fmt: skip
            sound = sound and not contradicts
        verdict = decide_kernel(t, code, sound, drifted, moves, model.readmit_after_s, 2, trust)
        for i in range(3):
            note_kernel(t, code, code, i, e[3 * code + i], work.var[i], nis, verdict != REFUSED, log)
        if verdict != REFUSED:
            if verdict == DRIFTED:
                stretch_kernel(P, work.H[part], work.square, work.row)
            elif verdict != SOUND:
                opens, lost = work.opens[code], verdict == LOST
                open_kernel(P, work.unused, work.H[part], e[part], opens, lost, work.square, work.row)
            for i in range(3 * code, 3 * code + 3):
                update_kernel(P, dx, work.H[i], z[i], r[i], work.row, work.other_row)
            for i in range(3):
                work.way[i] = -dx[i]
                x[3 + i] -= dx[3 + i]
                x[6 + i] -= dx[6 + i]
            displace_kernel(x, work.way, x)
            for i in range(9):
                dx[i] = 0.0


@kernel
def track_kernel(
    now: SingerTrack,
    fixes: Fixes,
    output_t: FloatArray,
    model: Manoeuvres,
    log: InnovationLog,
    x: FloatArray,
    P: FloatArray,
    work: TrackWork,
) -> None:
    """Fill x (M, 9) and P (M, 9, 9) at the epochs output_t (M,) [s], none before the track.

    Each fix is used before the output ``at`` it, unless it is older than the track.
    """
    begin, count = 0, fixes.t.shape[0]
    for k in range(count + 1):
        end = fixes.at[k] if k < count else output_t.shape[0]
        for output in range(begin, end):
            T = output_t[output] - now.t[0]
            if T >= -TIME_TOLERANCE:
                _carry_kernel(T, now, model, x[output], P[output], work)
        begin = max(begin, end)
        if k < count and fixes.t[k] > now.t[0]:
            _carry_kernel(fixes.t[k] - now.t[0], now, model, now.x, now.P, work)
            now.t[0] = fixes.t[k]
            _use_kernel(k, now, fixes, model, log, work)
