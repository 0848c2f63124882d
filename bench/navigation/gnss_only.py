"""Position and velocity from GNSS fixes alone, carried between them by a model of how aircraft manoeuvre.

The model, and the filter as a kernel: `bench.navigation.singer`. Attitude is not estimated: in wind the
course is not the heading. The filter runs at the times of validity of the fixes, so latency only lengthens
the prediction to the output.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bench.arrays import FloatArray, IntArray, read_only
from bench.data import (
    EventRow,
    Events,
    GnssFixes,
    InitialState,
    Innovations,
    NavSolution,
    SensorData,
    no_innovations,
)
from bench.navigation import timeline
from bench.navigation.alignment import UNKNOWN_SPEED_SD
from bench.navigation.blocks import assumed
from bench.navigation.integrity import nis_limit
from bench.navigation.measurements import LATENCY, fix_errors, fix_variance, remaining, weigh_fixes
from bench.navigation.options import GnssOnlyOptions, read_options
from bench.navigation.singer import Fixes, FixLog, Manoeuvres, Track, track_kernel, track_work
from bench.specs import AssumedSpecs

SENSORS = ("gnss_position", "gnss_velocity")
STATES = tuple(f"acceleration_{axis}_m_s2" for axis in "ned")
SWING = 0.1  # turn rate that moves the antenna about the IMU unseen, 1 sigma [rad/s]


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
        fixes, output_t = sensors.fixes, sensors.output_t
        m = len(output_t)
        x, P = np.full((m, 9), np.nan), np.full((m, 9, 9), np.nan)
        track, begin, events = None, 0, list[EventRow]()
        if initial.alignment == "given":
            track = FixTrack(self.options, initial.t, initial.lla, initial.vel_n, initial.cov[:6, :6])
        if fixes is not None and m:  # without an output no fix is used
            white = fix_variance(assumed(sensors.specs, "gnss"), gnss_markov=False)
            r = weigh_fixes(fixes, white, self.options.fix_accuracy)
            used, at, events = timeline.fix_rows(fixes, output_t, initial.t)
            if track is None and len(used):
                first, begin = used[0], int(at[0])
                track = FixTrack.begin(
                    self.options, float(fixes.t[first]), fixes.lla[first], fixes.vel_n[first], r[first]
                )
                moving = np.isfinite(fixes.vel_n[first]).all()
                origin = "position and velocity" if moving else "position"
                text = f"{origin} of the first fix; attitude is not estimated"
                events.append((initial.t, float(output_t[begin]), "alignment", text))
            if track is not None:
                x[begin:], P[begin:] = track.run(fixes, used, r, at - begin, output_t[begin:])
        elif track is not None:
            x, P = track.at(output_t)
        arm = unknown_arm(sensors.antenna_b)
        P[:, range(6), range(6)] += arm
        accelerations_sd = np.sqrt(np.einsum("kii->ki", P)[:, 6:])
        P[:, 6:], P[:, :, 6:] = np.nan, np.nan
        none = np.full((m, 4), np.nan)
        return NavSolution(
            t=output_t,
            lla=x[:, :3],
            vel_n=x[:, 3:6],
            q_nb=none,
            gyro_bias_b=none[:, :3],
            accel_bias_b=none[:, :3],
            cov=P,
            extra_names=STATES,
            extra=x[:, 6:],
            extra_sd=accelerations_sd,
            innovations=track.innovations() if track else no_innovations(),
            events=Events.from_rows(events),
        )

    def unmodelled(self, specs: AssumedSpecs) -> tuple[str, ...]:
        """Return the errors of the receiver that the estimator has no state for, in words."""
        return () if specs.gnss is None else remaining(fix_errors(specs.gnss), {LATENCY})


def unknown_arm(antenna_b: FloatArray) -> FloatArray:
    """Return the variance (6,) of position and velocity of an antenna about an IMU of unknown attitude."""
    arm2 = float(antenna_b @ antenna_b) / 3.0
    return np.array([arm2] * 3 + [SWING**2 * arm2] * 3)


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
        P = np.diag(np.repeat([0.0, 0.0, options.acceleration**2], 3))
        P[:6, :6] = cov
        self._now = Track(
            np.array([t], float), np.concatenate([lla, vel_n, np.zeros(3)]), P, np.zeros(2, np.int64)
        )
        self._model = Manoeuvres(
            float(options.acceleration),
            float(options.correlation_s),
            nis_limit(3, options.gate_probability),
            options.readmit_after,
        )
        self._work = track_work()
        self._rows = [(np.empty((0, 4)), np.empty((0, 3), np.int64))]

    @classmethod
    def begin(
        cls, options: GnssOnlyOptions, t: float, lla: FloatArray, vel_n: FloatArray, r: FloatArray
    ) -> FixTrack:
        """Begin with a fix of variance r (6,); without a velocity its covariance is wide."""
        cov = np.diag(r)
        if not np.isfinite(vel_n).all():
            vel_n, cov[3:, 3:] = np.zeros(3), UNKNOWN_SPEED_SD**2 * np.eye(3)
        return cls(options, t, lla, vel_n, cov)

    def run(
        self, fixes: GnssFixes, rows: IntArray, r: FloatArray, at: IntArray, output_t: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Use fixes and return the states (M, 9) and P (M, 9, 9) at the outputs, NaN before the track.

        Parameters
        ----------
        fixes : GnssFixes
            Record; one that is not later than the track is left out.
        rows : (K,) int array
            Those to use, in this order.
        r : (N, 6) array
            Their variance, of every row of the record.
        at : (K,) int array
            The first output after each.
        output_t : (M,) array
            Instants [s].
        """
        return self._run(Fixes(fixes.t[rows], fixes.lla[rows], fixes.vel_n[rows], r[rows], at), output_t)

    def at(self, t: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the states (M, 9) and P (M, 9, 9) carried to instants (M,) [s], NaN before the track."""
        none, rows = np.empty(0), np.empty((0, 3))
        return self._run(Fixes(none, rows, rows, np.empty((0, 6)), np.empty(0, np.int64)), t)

    def _run(self, fixes: Fixes, output_t: ArrayLike) -> tuple[FloatArray, FloatArray]:
        output_t = np.asarray(output_t, float)
        count, m = 6 * len(fixes.t), len(output_t)
        log = FixLog(np.empty((count, 4)), np.empty((count, 3), np.int64), np.zeros(1, np.int64))
        x, P = np.full((m, 9), np.nan), np.full((m, 9, 9), np.nan)
        track_kernel(self._now, fixes, read_only(output_t), self._model, log, x, P, self._work)
        if filled := int(log.filled[0]):
            self._rows.append((log.numbers[:filled], log.marks[:filled]))
        return x, P

    def innovations(self) -> Innovations:
        """Return the innovations of all fixes so far."""
        numbers, marks = (np.concatenate(parts) for parts in zip(*self._rows, strict=True))
        code, component, accepted = marks.T
        t, z, S, nis = numbers.T
        return Innovations(t, SENSORS, code, component, z, S, nis, accepted.astype(np.bool_))
