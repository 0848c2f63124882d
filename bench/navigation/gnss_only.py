"""Position and velocity from GNSS fixes alone, carried between them by a model of how aircraft manoeuvre.

Along each axis of n the acceleration is a Gauss-Markov process (R. A. Singer, Estimating optimal tracking
filter performance for manned maneuvering targets, IEEE Trans. AES-6 (4), 1970): constant for a moment, zero
in the long run. Errors of nine states, position, velocity and acceleration:

    p'' = a      a' = -a / tau + w,   density of w 2 sd^2 / tau

Attitude is not estimated: in wind the course is not the heading. The filter runs at the times of validity of
the fixes, so latency only lengthens the prediction to the output.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bench import earth
from bench.arrays import FloatArray
from bench.data import EventRow, Events, InitialState, Innovations, NavSolution, SensorData
from bench.navigation import timeline
from bench.navigation.alignment import UNKNOWN_SPEED_SD
from bench.navigation.blocks import assumed
from bench.navigation.integrity import nis, nis_limit
from bench.navigation.measurements import LATENCY, fix_errors, fix_variance, remaining, weigh_fixes
from bench.navigation.options import GnssOnlyOptions, read_options
from bench.specs import AssumedSpecs

SENSORS = ("gnss_position", "gnss_velocity")
STATES = tuple(f"acceleration_{axis}_m_s2" for axis in "ned")
SWING = 0.1  # turn rate that moves the antenna about the IMU unseen, 1 sigma [rad/s]
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)


class GnssOnly:
    """A Kalman filter over the fixes of a receiver.

    Options: `bench.navigation.options.GnssOnlyOptions`.
    """

    needs = ("fixes",)

    def __init__(self, **options: Any) -> None:
        self.options = read_options(GnssOnlyOptions, options)

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        """Estimate position, velocity and their covariance; attitude and sensor errors are NaN.

        Without a given initial state it begins with the first fix.
        """
        fixes, given = sensors.fixes, initial.alignment == "given"
        track = None
        if given:
            track = FixTrack(self.options, initial.t, initial.lla, initial.vel_n, initial.cov[:6, :6])
        used, at, events = np.empty(0, np.int64), np.empty(0, np.int64), list[EventRow]()
        r = np.zeros((0, 6))
        if fixes is not None:
            white = fix_variance(assumed(sensors.specs, "gnss"), gnss_markov=False)
            r = weigh_fixes(fixes, white, self.options.fix_accuracy)
            used, at, events = timeline.fix_rows(fixes, sensors.output_t, initial.t)
        m = len(sensors.output_t)
        if m == 0:  # nobody asks: no fix is used
            used, at = used[:0], at[:0]
        out, out_P = np.full((m, 9), np.nan), np.full((m, 9, 9), np.nan)
        apart = np.diag(np.append(unknown_arm(sensors.antenna_b), np.zeros(3)))
        begin = 0  # of the outputs before the next fix
        for row, end in zip([*used, None], [*at, m], strict=True):
            if track is not None and end > begin:
                now = sensors.output_t[begin:end]
                served = np.arange(begin, end)[now >= track.t - timeline.TIME_TOLERANCE]
                out[served], P = track.at(sensors.output_t[served])
                out_P[served] = P + apart
            begin = max(begin, int(end))
            if row is not None:
                assert fixes is not None
                if track is None:
                    track = FixTrack.begin(
                        self.options, float(fixes.t[row]), fixes.lla[row], fixes.vel_n[row], r[row]
                    )
                    moving = np.isfinite(fixes.vel_n[row]).all()
                    origin = "position and velocity" if moving else "position"
                    text = f"{origin} of the first fix; attitude is not estimated"
                    events.append((initial.t, float(sensors.output_t[begin]), "alignment", text))
                elif fixes.t[row] > track.t:  # not before the start
                    track.go_to(float(fixes.t[row]))
                    track.use(fixes.lla[row], fixes.vel_n[row], r[row])
        cov = out_P[:, :9, :9].copy()
        cov[:, 6:], cov[:, :, 6:] = np.nan, np.nan
        none = np.full((m, 4), np.nan)
        return NavSolution(
            t=sensors.output_t,
            lla=out[:, :3],
            vel_n=out[:, 3:6],
            q_nb=none,
            gyro_bias_b=none[:, :3],
            accel_bias_b=none[:, :3],
            cov=cov,
            extra_names=STATES,
            extra=out[:, 6:],
            extra_sd=np.sqrt(np.einsum("kii->ki", out_P)[:, 6:]),
            innovations=Innovations.from_rows(SENSORS, track.innovations if track else []),
            events=Events.from_rows(events),
        )

    def unmodelled(self, specs: AssumedSpecs) -> tuple[str, ...]:
        """Return the errors of the receiver that the estimator has no state for, in words."""
        return () if specs.gnss is None else remaining(fix_errors(specs.gnss), {LATENCY})


def unknown_arm(antenna_b: FloatArray) -> FloatArray:
    """Return the variance (6,) of position and velocity of an antenna about an IMU of unknown attitude."""
    arm2 = float(antenna_b @ antenna_b) / 3.0
    return np.array([arm2] * 3 + [SWING**2 * arm2] * 3)


def singer(T: ArrayLike, sd: float, tau: float) -> tuple[FloatArray, FloatArray]:
    """Return Phi and Q (..., 3, 3) of position, velocity and acceleration along one axis over T seconds.

    Q by Gauss-Legendre quadrature of the impulse response, exact to rounding for T below tau; longer ways
    are made of halves.

    Parameters
    ----------
    T : float or (...) array
        [s]
    sd : float
        Standard deviation of the acceleration [m/s^2].
    tau : float
        Its correlation time [s].
    """
    T = np.asarray(T, float)
    if (tau < T).any():
        Phi, Q = singer(0.5 * T, sd, tau)
        return Phi @ Phi, Phi @ Q @ np.swapaxes(Phi, -1, -2) + Q
    x = T[..., None] * np.append(0.5 * (_NODES + 1.0), 1.0) / tau
    gone = -np.expm1(-x)
    way = np.where(x < 1e-4, 0.5 * x * x * (1.0 - x / 3.0 * (1.0 - x / 4.0)), x - gone)
    column = np.stack([tau**2 * way, tau * gone, np.exp(-x)], axis=-2)  # response to an acceleration of 1
    Phi = np.zeros((*T.shape, 3, 3))
    Phi[..., 0, 0] = Phi[..., 1, 1] = 1.0
    Phi[..., 0, 1] = T
    Phi[..., :, 2] = column[..., -1]
    response = column[..., :-1]
    weights = T[..., None, None] * _WEIGHTS * sd**2 / tau
    return Phi, (response * weights) @ np.swapaxes(response, -1, -2)


class FixTrack:
    """The filter at the instant of its last fix.

    Parameters
    ----------
    options : GnssOnlyOptions
        How it manoeuvres, and the gate.
    t : float
        Start [s].
    lla, vel_n : (3,) arrays
        Position and velocity there.
    cov : (6, 6) array
        Their covariance [m, m/s], n.
    """

    def __init__(
        self, options: GnssOnlyOptions, t: float, lla: FloatArray, vel_n: FloatArray, cov: FloatArray
    ) -> None:
        self.options, self.t = options, t
        self.gate = nis_limit(3, options.gate_probability)
        self.lla, self.vel, self.acc = lla, vel_n, np.zeros(3)
        self.P = np.zeros((9, 9))
        self.P[:6, :6] = cov
        self.P[6:, 6:] = options.acceleration**2 * np.eye(3)
        self.misses = [0, 0]
        self.innovations: list[tuple[float, int, int, float, float, float, bool]] = []

    @classmethod
    def begin(
        cls, options: GnssOnlyOptions, t: float, lla: FloatArray, vel_n: FloatArray, r: FloatArray
    ) -> FixTrack:
        """Begin with a fix of variance r (6,); without a velocity its covariance is wide."""
        cov = np.diag(r)
        if not np.isfinite(vel_n).all():
            vel_n, cov[3:, 3:] = np.zeros(3), UNKNOWN_SPEED_SD**2 * np.eye(3)
        return cls(options, t, lla, vel_n, cov)

    def at(self, t: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the state (..., 9) and P (..., 9, 9) carried to an instant [s], or to many at once."""
        T = np.asarray(t, float) - self.t
        Phi, Q = singer(T, self.options.acceleration, self.options.correlation_s)
        way = self.vel * Phi[..., 0, 1, None] + self.acc * Phi[..., 0, 2, None]
        state = [
            earth.displace(self.lla, way),
            self.vel + self.acc * Phi[..., 1, 2, None],
            self.acc * Phi[..., 2, 2, None],
        ]
        P = self.P
        for _ in range(2):  # Phi by rows, then by columns: each axis by itself
            rows = Phi @ np.reshape(P, (*P.shape[:-2], 3, 27))
            P = np.swapaxes(np.reshape(rows, (*T.shape, 9, 9)), -1, -2)
        P = P.copy()
        for axis in range(3):
            P[..., axis::3, axis::3] += Q
        return np.concatenate(state, axis=-1), P

    def go_to(self, t: float) -> None:
        """Carry the filter to an instant [s]."""
        state, self.P = self.at(t)
        self.lla, self.vel, self.acc, self.t = state[:3], state[3:6], state[6:], t

    def use(self, lla: FloatArray, vel_n: FloatArray, r: FloatArray) -> None:
        """Use a fix that is valid now, position and velocity (if it has one) each gated by itself."""
        for code in (0, 1) if np.isfinite(vel_n).all() else (0,):
            rows = slice(3 * code, 3 * code + 3)
            # y is measured less predicted
            y = earth.difference_n(lla, self.lla) if code == 0 else vel_n - self.vel
            R = np.diag(r[rows])
            S = self.P[rows, rows] + R
            value = nis(y, S)
            sound = value <= self.gate
            if not sound and self.misses[code] >= self.options.readmit_after:
                x = self.P[:, rows] @ np.linalg.solve(S, y)  # as `bench.navigation.kalman.open_kernel`
                self.P += np.outer(x, x)
                self.P[rows, rows] += np.diag(y**2)
                sound = True
            self.misses[code] = 0 if sound else self.misses[code] + 1
            for i in range(3):
                self.innovations.append((self.t, code, i, y[i], S[i, i], value, sound))
            if sound:
                K = np.linalg.solve(self.P[rows, rows] + R, self.P[rows]).T
                J = np.eye(9)
                J[:, rows] -= K
                self.P = J @ self.P @ J.T + K @ R @ K.T
                dx = K @ y
                self.lla, self.vel = earth.displace(self.lla, dx[:3]), self.vel + dx[3:6]
                self.acc = self.acc + dx[6:]
