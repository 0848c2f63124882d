"""Navigator and filter of the source over one record: A-5.4.4 to A-5.4.11."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import EventRow, Events, InitialState, NavSolution, SensorData
from bench.navigation.engine import timeline
from bench.navigation.engine.gate import REFUSED, SOUND, InnovationGate, growth
from bench.navigation.engine.integrity import correction_period, nis, tolerance, trace_ratio
from bench.navigation.engine.session import Kept
from bench.navigation.error_state_filter.answers import answers as join_answers
from bench.navigation.error_state_filter.corrections import RATE_NOISE
from bench.navigation.error_state_filter.error_state import StateLayout
from bench.navigation.error_state_filter.measurement_rows import SENSORS
from bench.navigation.models.classic import process_model
from bench.navigation.models.classic.covariance_forms import Form, make_form
from bench.navigation.models.classic.extrapolation import extrapolate
from bench.navigation.models.classic.navigator import (
    FRD_OF_FUR,
    NED_OF_ENU,
    R3,
    Earth,
    Nav,
    Vector,
    axes_turned,
    body_increments,
    corrected,
    ellipsoid,
    mechanize,
    reduced,
)
from bench.navigation.models.classic.observation_model import (
    Fix,
    antenna_matrix,
    antenna_sweep,
    measurement_matrix,
    measurement_noise,
    ned_matrix,
    pair_measurements,
)
from bench.navigation.models.stepped_filters import Measurement, SteppedFilter
from bench.navigation.options import ClassicOptions

_CURVE = 8  # estimates that a curve needs
_ROWS = {"baro": [0], "gnss_position": [1, 2, 3], "gnss_velocity": [4, 5, 6]}
_LAYOUT = StateLayout(("baro_bias", "m", 1), ("gnss_pos", "m", 3), ("gnss_vel", "m_s", 3))
_STATES = {"baro": [15], "gnss_position": [0, 1, 2], "gnss_velocity": [3, 4, 5]}


class FilterLoop(SteppedFilter):
    """The navigator, its filter and their book-keeping (`stepped_filters.SteppedFilter`)."""

    form: Kept[Form]
    gate: Kept[InnovationGate]
    nav: Kept[Nav]
    start: Kept[Nav]  # at the last prediction
    eps: Kept[FloatArray]  # (3,) accumulated calibration, A-5.4.11
    da: Kept[FloatArray]  # (3,)
    scale: Kept[tuple[float, float]]  # of the reduced Markov states
    elapsed: Kept[float]  # since the last prediction [s]
    lost: Kept[FloatArray]  # (2,) what a gap adds since then
    B_sum: Kept[FloatArray]  # (3, 3) since then
    dv_sum: Kept[FloatArray]  # (3,) since then
    w_b: Kept[FloatArray]  # (3,) of the last step [rad/s]
    before: Kept[tuple[float, Vector, Vector] | None]  # the step before, for coning and sculling
    next_correction: Kept[float]  # [s]
    satellites: Kept[int | None]  # of the last fix
    accepted: Kept[dict[str, tuple[float, FloatArray]]]  # last fix used: time, INS less GNSS
    known: Kept[deque[tuple[float, FloatArray]]]  # errors of the navigator after each fix
    events: Kept[list[EventRow]]

    shapes = (23,), (13,), (9, 9)
    one_antenna = True

    def __init__(self, options: ClassicOptions, sensors: SensorData, initial: InitialState) -> None:
        self.options, self.interval = options, (1.0 - 1e-6) / options.covariance_hz
        self.gate = InnovationGate(SENSORS, initial.t, options.gate_probability, options.readmit_after_s)
        self.sig = replace(
            process_model.sigmas(sensors.specs),
            jump_white=options.jump_white_sd,
            jump_markov=options.jump_markov_sd,
        )
        self.fix_interval = 1.0 / sensors.specs.gnss.rate if sensors.specs.gnss else math.inf
        self.antenna = FRD_OF_FUR.T @ sensors.antenna_b
        lat, lon, h = initial.lla.tolist()
        B = NED_OF_ENU @ rotation.matrix(initial.q_nb) @ FRD_OF_FUR
        self.nav = Nav(lat, lon, h, NED_OF_ENU @ initial.vel_n, B)
        self.eps, self.da = np.zeros(3), np.zeros(3)

        sig, earth = self.sig, ellipsoid(lat, h)
        east, north = reduced(self.nav, earth)
        P = np.zeros((process_model.SIZE, process_model.SIZE))
        of_ned = np.linalg.inv(ned_matrix(self.nav, earth))
        P[:9, :9] = of_ned @ initial.cov @ of_ned.T
        unit = np.array([east, north, 1.0, 1.0, 1.0, 1.0])
        rest = [sig.eps] * 3 + [sig.da] * 3 + [sig.bb] + (unit * process_model.per_axis(sig.markov)).tolist()
        P[np.arange(9, process_model.SIZE), np.arange(9, process_model.SIZE)] = np.square(rest)
        P[:9, 9:15] = -of_ned @ initial.bias_cov @ np.kron(np.eye(2), FRD_OF_FUR)  # true less estimate
        P[9:15, :9] = P[:9, 9:15].T
        self.floor = options.floor**2 * np.diag(P)
        self.form, self.scale = make_form(options, P), (east, north)
        self.elapsed, self.lost = 0.0, np.zeros(2)
        self.B_sum, self.dv_sum = np.zeros((3, 3)), np.zeros(3)
        self.start, self.w_b, self.before = self.nav, np.zeros(3), None
        self.next_correction, self.satellites = -np.inf, None
        self.accepted, self.known, self.events = {}, deque(), []

    def increments(self, increments_b: FloatArray) -> list[list[float]]:
        """Return increments in the axes of the source."""
        turned: list[list[float]] = (increments_b @ FRD_OF_FUR).tolist()
        return turned

    def begin(self, dt: float, dtheta: list[float]) -> None:
        """Store the rate of the first step, for measurements at the start."""
        self.w_b = np.array(dtheta) / dt

    def step(
        self, now: float, dt: float, dtheta: list[float], dvel: list[float], unknown: FloatArray, due: bool
    ) -> None:
        """Advance by a step; the filter follows at its own rate, and when something is ``due``."""
        self.advance(dt, dtheta, dvel, unknown)
        if due or self.elapsed >= self.interval:
            self.predict()

    def measure(self, now: float, arrived: list[Measurement]) -> None:
        """Use the measurements that arrived: a fix together with a barometer reading."""
        for fix, alt_baro in pair_measurements(arrived):
            self.update(now, fix, alt_baro)

    # -- the navigator

    def advance(self, dt: float, dtheta: list[float], dvel: list[float], unknown: FloatArray) -> None:
        """One IMU sample: increments less the calibration (A-5.4.11), then the mechanization.

        ``unknown`` (2,) is the variance of velocity and attitude that a gap adds.
        """
        self.lost += unknown
        (e0, e1, e2), (d0, d1, d2) = self.eps.tolist(), self.da.tolist()
        dth = (dtheta[0] - e0 * dt, dtheta[1] - e1 * dt, dtheta[2] - e2 * dt)
        dv = (dvel[0] - d0 * dt, dvel[1] - d1 * dt, dvel[2] - d2 * dt)
        turn, dv_start = body_increments(dt, dth, dv, self.before)
        self.B_sum += self.nav.B * dt
        self.nav, dv_n = mechanize(self.nav, dt, turn, dv_start)
        self.dv_sum += dv_n
        self.elapsed += dt
        self.before = (dt, dth, dv)
        self.w_b = np.array(dth) / dt

    def predict(self) -> None:
        """Carry the filter over the time since the last prediction (A-5.4.4)."""
        T = self.elapsed
        if T == 0.0:
            return
        earth = ellipsoid(self.start.lat, self.start.h)
        mean = replace(self.start, B=self.B_sum / T)
        a = self.dv_sum / T
        if self.options.discretization == "euler":
            Phi, G = process_model.model(mean, earth, a, self.sig, T)
            Q = G @ G.T
        else:
            Phi, Q = process_model.model_van_loan(mean, earth, a, self.sig, T)
        # the Markov states keep their meters while the reduced ones change (A-5.2.2, caveat)
        scale = reduced(self.nav, ellipsoid(self.nav.lat, self.nav.h))
        Phi[16, 16] *= scale[0] / self.scale[0]
        Phi[17, 17] *= scale[1] / self.scale[1]
        self.form.predict(Phi, Q, T)
        if self.lost.any():
            self._grow(range(3, 9), np.repeat(self.lost, 3))
        self.scale = scale
        self._keep_floor()
        self.elapsed = 0.0
        self.B_sum, self.dv_sum, self.start = np.zeros((3, 3)), np.zeros(3), self.nav
        self.lost = np.zeros(2)

    def _grow(self, states: Iterable[int], variance: ArrayLike) -> None:
        """Add a variance to each of some states."""
        added = np.zeros(process_model.SIZE)
        added[list(states)] = variance
        self.form.add(np.diag(np.sqrt(added)))

    def _keep_floor(self) -> None:
        """Raise the diagonal of P to at least the floor (A-5.4.F)."""
        if self.options.floor > 0:
            self._grow(range(process_model.SIZE), np.maximum(self.floor - np.diag(self.form.covariance), 0.0))

    # -- the measurements

    def update(self, now: float, fix: Fix | None, alt_baro: float | None) -> None:
        """Update with the measurements that arrived: rows of Y, tests, update and correction."""
        earth = ellipsoid(self.nav.lat, self.nav.h)
        east, north = reduced(self.nav, earth)
        jump = fix is not None and self.satellites not in (None, fix.satellites)
        if fix is not None:
            self.satellites = fix.satellites
        if jump:
            self._grow(
                range(16, process_model.SIZE),
                np.square(process_model.per_axis(self.sig.jump_markov) * [east, north, 1, 1, 1, 1]),
            )
        H, Q = measurement_matrix(), measurement_noise(self.sig, east, north, jump)
        antenna_matrix(H, self.nav, earth, self.antenna, self.w_b)
        if self.before is not None and self.w_b @ self.w_b < RATE_NOISE * self.sig.gyro**2 / self.before[0]:
            H[4:7, 6:9] = 0.0  # what may be noise shows no attitude
        R = Q @ Q.T
        Y = self._measurements(earth, fix, alt_baro)
        x, PH = self.form.x.astype(float), self.form.covariance @ H.T
        y, S = Y - H @ x, H @ PH + R
        meters = np.array([1.0, 1 / east, 1 / north, 1.0, 1.0, 1.0, 1.0, 1.0])
        error = H[:, :15] @ x[:15]  # of the INS, as far as it is known
        apart = (Y - error) * meters  # corrected INS less measured
        use = []
        moving = fix is not None and bool(np.isfinite(fix.vel_n).all())  # a fix may have no velocity
        y_m, S_m = y * meters, S * np.outer(meters, meters)
        both, r_m = slice(1, 7), np.diag(R) * meters**2
        if moving:
            self.gate.see_fix(now, y_m[both], S_m[both, both], r_m[1:4])
        else:
            self.gate.see_position()
        given = ("gnss_position", fix is not None), ("gnss_velocity", moving), ("baro", alt_baro is not None)
        for name, there in given:
            if there and self._is_sound(now, name, apart, y, S, H, PH, meters):
                use += _ROWS[name]
        if fix is not None and alt_baro is not None:
            ratio = abs(y[7]) / math.sqrt(S[7, 7])
            if ratio > self.options.monitor_sigmas:
                text = f"barometer and GNSS height differ by {ratio:.1f} sigma"
                self.events.append((now, now, "integrity", text, "gnss_position baro"))
        use.sort()
        if not use:
            return
        if self.options.rows == 8 and len(use) == 7:
            use = list(range(8))
        self.form.update(Y[use], H[use], R[np.ix_(use, use)], use, self.nav)
        self._keep_floor()
        found = H[:, :15] @ self.form.x[:15].astype(float) - error
        for name, (at, offset) in self.accepted.items():  # the correction moves the INS, not the last fix
            self.accepted[name] = (at, offset - (found * meters)[_ROWS[name]])
        for name in ("gnss_position", "gnss_velocity"):
            if set(_ROWS[name]) <= set(use):
                self.accepted[name] = (now, (apart - found * meters)[_ROWS[name]])
        if set(_ROWS["gnss_position"]) <= set(use):
            self._remember(now)
        self._correct(now)

    def _measurements(self, earth: Earth, fix: Fix | None, alt_baro: float | None) -> FloatArray:
        """Return Y (8,), INS minus measurement (A-5.4.3), NaN in the rows without a measurement."""
        Y = np.full(8, np.nan)
        nav = self.nav
        if alt_baro is not None:
            Y[0] = nav.h - alt_baro
        if fix is not None:
            east, north = reduced(nav, earth)
            arm = nav.B @ self.antenna
            dlon = nav.lon - fix.lon
            dlon -= 2.0 * math.pi * round(dlon / (2.0 * math.pi))
            Y[1] = dlon * R3 + arm[0] * east
            Y[2] = (nav.lat - fix.lat) * R3 + arm[1] * north
            Y[3] = nav.h - fix.h + arm[2]
            swept = nav.B @ antenna_sweep(nav, self.antenna, self.w_b)
            Y[4:7] = nav.V + swept - NED_OF_ENU @ fix.vel_n
        Y[7] = Y[3] - Y[0]
        return Y

    def _is_sound(
        self,
        now: float,
        name: str,
        apart: FloatArray,
        y: FloatArray,
        S: FloatArray,
        H: FloatArray,
        PH: FloatArray,
        meters: FloatArray,
    ) -> bool:
        """Return whether one sub-vector is used, by its tests in meters and the gate.

        S and PH are those before any of a time is used; the compiled filter uses one after the other.
        """
        rows = _ROWS[name]
        y, S, unit = y[rows], S[np.ix_(rows, rows)], meters[rows]
        y_m, S_m = y * unit, S * np.outer(unit, unit)
        value, tests = nis(y_m, S_m), self.options.integrity
        failed = [test for test in tests if self._fails(test, now, name, apart[rows], y_m, S_m, value)]
        along_n = -(NED_OF_ENU @ y_m) if len(rows) == 3 else -y_m  # measured less predicted
        variance = np.diag(S_m)[[1, 0, 2]] if len(rows) == 3 else np.diag(S_m)
        code, drifts = SENSORS.index(name), failed == ["nis"]
        verdict = self.gate.decide(now, code, along_n, variance, value, sound=not failed, drifts=drifts)
        if verdict not in (REFUSED, SOUND):
            opens = np.zeros(process_model.SIZE, np.bool_)
            opens[_STATES[name]] = True
            self.form.add(growth(verdict, PH[:, rows] @ np.linalg.solve(S, y), H[rows], y, opens))
        return verdict != REFUSED

    def _fails(
        self, test: str, now: float, name: str, apart: FloatArray, y: FloatArray, S: FloatArray, value: float
    ) -> bool:
        options = self.options
        if test == "nis":
            return value > self.gate.limits[len(y)]
        if test == "trace":
            return trace_ratio(y, S) > options.trace_limit
        if name not in self.accepted:  # no fix to carry on yet, or the barometer
            return False
        at, offset = self.accepted[name]
        decay = process_model.gnss_decay(self.sig, math.hypot(self.nav.V[0], self.nav.V[1]), now - at)
        part = slice(0, 3) if name == "gnss_position" else slice(3, 6)
        wander = (1.0 - decay[part]) * np.square(process_model.per_axis(self.sig.markov)[part])
        sd = np.sqrt(2.0 * (np.square(process_model.per_axis(self.sig.white)[part]) + wander))
        bound = tolerance(
            now - at,
            sd,
            order=2 if name == "gnss_position" else 1,
            max_acceleration=options.max_acceleration,
            sigmas=options.tolerance_sigmas,
        )
        return bool((np.abs(apart - offset) > bound).any())

    def _correct(self, now: float) -> None:
        """Feed the estimate back when it is due (A-5.4.8, A-5.4.9, A-5.4.11)."""
        options = self.options
        if not options.feedback or now < self.next_correction - timeline.TIME_TOLERANCE:
            return
        x = self.form.x.astype(float)
        turned, self.nav = axes_turned(self.nav, x), corrected(self.nav, x)
        self.start = self.nav
        self.eps = self.eps + x[9:12]
        self.da = self.da + x[12:15]
        self.form.x[:15] = 0.0  # what is left of these errors is zero in the mean; 15 to 21 are kept
        self.form.predict(turned, np.zeros((process_model.SIZE, process_model.SIZE)), 0.0)
        self._keep_floor()
        period = options.correction_period
        if isinstance(period, str):
            spread = 3.0 * np.sqrt(np.diag(self.form.covariance))
            attitude, gyro, accel = (spread[first : first + 3].max() for first in (6, 9, 12))
            period = correction_period(math.radians(options.admissible_deg), attitude, gyro, accel)
        self.next_correction = now + period

    def _remember(self, now: float) -> None:
        """Store the errors of the navigator for the curve that is extrapolated without fixes (#46)."""
        if self.options.outage != "prediction":
            self.known.append((now, self.form.x[:9].astype(float)))
            while self.known[0][0] < now - self.options.outage_window:
                self.known.popleft()

    def answer(self, now: float) -> tuple[FloatArray, ...]:
        """Return the corrected output (23,), the variances of its last 13 states and its covariance."""
        x, P = self.form.x.astype(float), self.form.covariance
        if len(self.known) >= _CURVE and now - self.known[-1][0] > 2.5 * self.fix_interval:
            t, errors = zip(*self.known, strict=True)
            assert self.options.outage != "prediction"
            x[:9] = extrapolate(self.options.outage, t, errors, now)
        nav = corrected(self.nav, x)
        earth = ellipsoid(nav.lat, nav.h)
        J = ned_matrix(nav, earth) @ axes_turned(self.nav, x)[:9, :9]
        east, north = reduced(nav, earth)
        to_ned = np.zeros((13, 13))
        to_ned[0:3, 0:3] = to_ned[3:6, 3:6] = FRD_OF_FUR
        to_ned[6, 6] = 1.0
        to_ned[7:10, 7:10] = NED_OF_ENU @ np.diag([1 / east, 1 / north, 1.0])
        to_ned[10:13, 10:13] = NED_OF_ENU
        states = x[9:].copy()
        states[:3] += self.eps
        states[3:6] += self.da
        q_nb = rotation.from_matrix(NED_OF_ENU @ nav.B @ FRD_OF_FUR.T)
        cov = J @ P[:9, :9] @ J.T
        return (
            np.concatenate([[nav.lat, nav.lon, nav.h], NED_OF_ENU @ nav.V, q_nb, to_ned @ states]),
            np.diag(to_ned @ P[9:, 9:] @ to_ned.T),
            np.tril(cov) + np.tril(cov, -1).T,  # in single precision P is not symmetric
        )

    def solution(
        self, t: FloatArray, answers: Sequence[FloatArray], events: list[EventRow], *, last: bool
    ) -> NavSolution:
        """Return the solution at epochs (M,) [s], with innovations and events since the last call."""
        state, variance, cov = answers
        table, refused = self.gate.take(last=last)
        events, self.events = events + self.events + refused, []
        return join_answers(t, _LAYOUT, state, cov, variance, table, Events.from_rows(events))
