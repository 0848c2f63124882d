"""Track of position and velocity from GNSS fixes alone, propagated by a maneuver model.

The model, and the filter as a kernel: `singer`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from bench.core.mathematics.arrays import FloatArray, IntArray, read_only
from bench.core.records.data import GnssFixes, Innovations
from bench.navigation.engine.gate import innovations, new_log, new_trust
from bench.navigation.engine.integrity import nis_limit
from bench.navigation.engine.session import Kept, Scratch, SessionState
from bench.navigation.error_state_filter.measurement_rows import SENSORS
from bench.navigation.options import GnssOnlyOptions
from bench.navigation.start.alignment import UNKNOWN_SPEED_SD
from bench.navigation.start.singer import Fixes, Manoeuvres, SingerTrack, TrackWork, track_kernel, track_work

SWING = 0.1  # turn rate that moves the antenna about the IMU unseen, 1 sigma [rad/s]


def unknown_arm(antenna_b: FloatArray, swing: float = SWING) -> FloatArray:
    """Return the variance (6,) of position and velocity of an antenna about an IMU of unknown attitude."""
    arm2 = float(antenna_b @ antenna_b) / 3.0
    return np.array([arm2] * 3 + [swing**2 * arm2] * 3)


class FixTrack(SessionState):
    """The filter at the time of its last fix.

    It starts at ``t`` [s] with position ``lla`` (3,), velocity ``vel_n`` (3,) and their ``cov`` (6, 6), n.
    """

    _now: Kept[SingerTrack]
    _model: Kept[Manoeuvres]
    _rows: Kept[list[tuple[FloatArray, IntArray]]]  # of the log, since it was taken
    _work: Scratch[TrackWork]

    def __init__(
        self, options: GnssOnlyOptions, t: float, lla: FloatArray, vel_n: FloatArray, cov: FloatArray
    ) -> None:
        P = np.diag(np.repeat([0.0, 0.0, options.acceleration**2], 3))
        P[:6, :6] = cov
        self._now = SingerTrack(
            np.array([t], float), np.concatenate([lla, vel_n, np.zeros(3)]), P, new_trust(2, t)
        )
        self._model = Manoeuvres(
            float(options.acceleration),
            float(options.correlation_s),
            nis_limit(3, options.gate_probability),
            float(options.readmit_after_s),
        )
        self.make_scratch()
        self._rows = [(np.empty((4, 0)), np.empty((4, 0), np.int64))]

    def expect(self, options: GnssOnlyOptions) -> None:
        """Continue with another maneuver model; the variance of the acceleration grows to its value."""
        sd = float(options.acceleration)
        self._model = self._model._replace(sd=sd, tau=float(options.correlation_s))
        for k in range(6, 9):
            self._now.P[k, k] = max(self._now.P[k, k], sd**2)

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
            Epochs [s].
        """
        return self._run(Fixes(fixes.t[rows], fixes.lla[rows], fixes.vel_n[rows], r[rows], at), output_t)

    def at(self, t: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the states (M, 9) and P (M, 9, 9) carried to epochs (M,) [s], NaN before the track."""
        none, rows = np.empty(0), np.empty((0, 3))
        return self._run(Fixes(none, rows, rows, np.empty((0, 6)), np.empty(0, np.int64)), t)

    def _run(self, fixes: Fixes, output_t: ArrayLike) -> tuple[FloatArray, FloatArray]:
        output_t = np.asarray(output_t, float)
        log, m = new_log(6 * len(fixes.t)), len(output_t)
        x, P = np.full((m, 9), np.nan), np.full((m, 9, 9), np.nan)
        track_kernel(self._now, fixes, read_only(output_t), self._model, log, x, P, self._work)
        if filled := int(log.filled[0]):
            self._rows.append((log.numbers[:, :filled], log.marks[:, :filled]))
        return x, P

    @property
    def t(self) -> float:
        """Time of the last fix, or of the start [s]."""
        return float(self._now.t[0])

    @classmethod
    def blank(cls) -> FixTrack:
        """Return a track with an arbitrary state."""
        return cls(GnssOnlyOptions(), 0.0, np.zeros(3), np.zeros(3), np.zeros((6, 6)))

    def make_scratch(self) -> None:
        """Make the memory of the kernel."""
        self._work = track_work()

    def take_innovations(self) -> Innovations:
        """Return the innovations of the fixes since the last call."""
        numbers, marks = (np.concatenate(parts, axis=1) for parts in zip(*self._rows, strict=True))
        self._rows = self._rows[:1]
        return innovations(SENSORS, numbers, marks)
