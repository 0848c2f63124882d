"""Generic filter of the errors of two navigation systems, and a filter that uses it (B-15 to B-22).

The first system (an INS) gives z1 = z1_true + M1 x, the second (GNSS and barometer) z2 = f(z1_true) + M2 x +
noise, and one vector of errors x holds those of both, x+ = F x + noise (B-17 to B-19, with f where the paper
prints F). The first system is never touched: its output is corrected by what is known of its errors (B-21).
"""

from __future__ import annotations

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import InitialState, SensorData
from bench.navigation.engine.session import Scratch
from bench.navigation.models.classic import Classic22
from bench.navigation.models.classic.covariance_forms import WholeForm
from bench.navigation.models.classic.filter_loop import FilterLoop
from bench.navigation.models.classic.navigator import (
    NED_OF_ENU,
    R3,
    Nav,
    ellipsoid,
    reduced,
    turn_matrix,
)
from bench.navigation.models.classic.observation_model import Fix, antenna_sweep
from bench.navigation.models.classic.process_model import SIZE

ESTIMATORS = {
    "error-ekf": {
        "title": "the generic filter of the errors of two systems, nonlinear measurement, INS never "
        "corrected, slow",
        "model": "ClassicOptions",
        "fixed": {
            "form": "joseph",
            "covariance_precision": "double",
            "rows": 7,
            "feedback": False,
            "correction_period": 0.0,
            "admissible_deg": 1.0,
        },
    },
}
"""Name of a filter -> its row in `bench.navigation.built_in`."""

_M1 = np.eye(15, SIZE)  # errors in z1
_M2 = np.zeros((7, SIZE))  # errors in z2
_M2[0, 15] = 1.0
_M2[1:, 16:] = np.eye(6)
_STEPS = np.repeat([1.0, 1.0, 1e-3, 1e-3, 1.0], 3)  # over which f is differentiated


class _ErrorEkfState(WholeForm):
    """State x and covariance P of the generic filter for the data of a loop (B-20, B-22)."""

    loop: Scratch[_Loop]  # that gives what has arrived

    def update(self, Y: FloatArray, H: FloatArray, R: FloatArray, rows: list[int], nav: Nav) -> None:
        """Update with some rows of z2, P by Joseph's form (B-19b); Y and H are of the other filter."""
        z1 = np.concatenate([np.zeros(3), nav.V, np.zeros(9)])
        x, P, z2, f = self.x, self.P, self.loop.measured(), self.loop.expect
        corrected = z1 - _M1 @ x  # less what is known of its errors (B-21)
        ends = [[f(corrected + sign * step) for step in np.diag(_STEPS)] for sign in (1.0, -1.0)]
        slope = (np.array(ends[0]) - np.array(ends[1])).T / (2.0 * _STEPS)
        H = (_M2 - slope @ _M1)[rows]
        expected = (f(corrected) + _M2 @ x)[rows]
        gain = np.asarray(np.linalg.solve(H @ P @ H.T + R, H @ P).T, float)
        left = np.eye(len(x)) - gain @ H
        self.x = x + gain @ (z2[rows] - expected)
        self.P = left @ P @ left.T + gain @ R @ gain.T


class _Loop(FilterLoop):
    """Navigator and measurements, with positions in reduced meters relative to the navigator."""

    given: Scratch[tuple[Fix | None, float | None]]  # what has arrived

    def update(self, now: float, fix: Fix | None, alt_baro: float | None) -> None:
        """Use the measurements that arrived."""
        assert isinstance(self.form, _ErrorEkfState)
        self.given, self.form.loop = (fix, alt_baro), self
        super().update(now, fix, alt_baro)

    def measured(self) -> FloatArray:
        """Return z2 (7,): height by the barometer, position and velocity of the fix, NaN without one."""
        z2, nav, (fix, alt_baro) = np.full(7, np.nan), self.nav, self.given
        if alt_baro is not None:
            z2[0] = alt_baro - nav.h
        if fix is not None:
            z2[1] = np.remainder(fix.lon - nav.lon + np.pi, 2.0 * np.pi) * R3 - np.pi * R3
            z2[2], z2[3] = (fix.lat - nav.lat) * R3, fix.h - nav.h
            z2[4:] = NED_OF_ENU @ fix.vel_n
        return z2

    def expect(self, z: FloatArray) -> FloatArray:
        """Return f(z) (7,): expected barometer height and antenna motion for the navigator state z (15,)."""
        nav = self.nav
        B = turn_matrix(*(-z[6:9]).tolist()) @ nav.B
        moved = Nav(nav.lat + z[1] / R3, nav.lon, nav.h + z[2], z[3:6], B)
        unit = np.array([*reduced(nav, ellipsoid(nav.lat, nav.h)), 1.0])
        antenna = z[:3] + unit * (B @ self.antenna)
        swept = B @ antenna_sweep(moved, self.antenna, self.w_b + z[9:12])
        return np.concatenate([z[2:3], antenna, z[3:6] + swept])


class ErrorEkfEstimator(Classic22):
    """The errors of an INS that is never corrected, by the generic filter; states as in A-5.4.1.

    Options: `bench.navigation.options.ClassicOptions`.
    """

    def make_loop(self, sensors: SensorData, initial: InitialState) -> FilterLoop:
        """Return the loop with the generic filter."""
        loop = _Loop(self.options, sensors, initial)
        loop.form = _ErrorEkfState(loop.form.covariance)
        return loop
