"""An attitude filter (AHRS): gyros, gravity from the accelerometers, the magnetic field; no position.

Error-state filter: attitude phi_b, the biases of gyros and accelerometers, scale factors and misalignments of
the gyros; with a magnetometer its iron and its matrix of calibration. Errors are estimate minus truth,
``C_nb_est = C_nb_true exp([phi_b x])``: in axes b the biases act the same at any heading, known or not.

The accelerometers are used as their mean over a period in axes n: averaged there, an acceleration counts by
the change of velocity that it makes, as in VQF (D. Laidig, T. Seel, Information Fusion 91, 2023).
With f = a - g,

    f_est + g = g x phi - db_a + a + noise,   |f|^2 = g^2 + a^2 if a is horizontal.

``a`` is noise. Its variance is acceleration_sd^2 of the options; where |f| differs from g by more than three
standard deviations, plus a^2 = |f|^2 - g^2 (a horizontal) if |f| > g, else (g - |f|)^2 (a vertical). a^2 is
multiplied by the number of periods that it has lasted, because an acceleration that lasts, as in a turn, is
no white noise. A turn therefore widens the covariance and hardly moves the attitude.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.core.compilation.compiled import kernel
from bench.core.mathematics import earth, rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.earth import EARTH_RATE
from bench.core.records.data import EventRow, Events, InitialState, NavSolution, SensorData
from bench.core.records.instruments import MagSpec
from bench.core.records.sensor_specs import AssumedSpecs
from bench.navigation.engine.gate import REFUSED, SOUND, InnovationGate, growth
from bench.navigation.engine.integrity import nis
from bench.navigation.engine.piecewise import InPieces
from bench.navigation.engine.session import Kept, Scratch
from bench.navigation.engine.timeline import TIME_TOLERANCE
from bench.navigation.error_state_filter.aiding_sensors import MAGNETOMETER, unmodeled
from bench.navigation.error_state_filter.answers import answers as join_answers
from bench.navigation.error_state_filter.error_state import StateLayout
from bench.navigation.error_state_filter.measurement_rows import MAGNETIC, SENSORS
from bench.navigation.error_state_filter.schedule import Schedule
from bench.navigation.models.classic.process_model import bias_and_walk
from bench.navigation.models.stepped_filters import Measurement, SteppedFilter, SteppedPassage
from bench.navigation.options import AhrsOptions, read_options
from bench.navigation.start import alignment
from bench.simulation.signals.magnetic import field_n

PHI, GYRO, ACCEL, IRON = (slice(k, k + 3) for k in (0, 3, 6, 18))
TURN, CALIBRATION = slice(9, 18), slice(21, 30)
"""Matrices of gyros and magnetometer, row by row; the states from 18 on are those of a magnetometer."""
GRAVITY = len(SENSORS)
"""Code of the innovations of gravity."""

_SHOWN = 3.0  # standard deviations by which |f| differs from g in an acceleration
_LONGEST = 60.0  # an acceleration is remembered so long [s]
_MODELED = ("gyro scale factor", "gyro misalignment", "gyro non-orthogonality", "magnetometer calibration")
_VAGUE = np.radians(20.0)  # above this sigma the heading is that of the magnetometer [rad]
_UNKNOWN = 1.0  # above this sigma the heading is unknown: no linear error describes it [rad]


class Ahrs:
    """Attitude, its covariance and the biases of the IMU; position and velocity are NaN.

    Options: `bench.navigation.options.AhrsOptions`.

    Examples
    --------
    >>> import bench
    >>> result = bench.run("approach", estimators=["ahrs"], causes=False)
    >>> bool(result.metrics["ahrs"]["tilt_rmse_deg"] < 3.0)
    True
    """

    needs: tuple[str, ...] = ()

    def __init__(self, **options: Any) -> None:
        self.options = read_options(AhrsOptions, options)

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        """Estimate attitude and biases."""
        initial, events = alignment.complete(sensors, initial)
        return self.in_pieces(sensors, initial, events).update(sensors, 0.0, last=True)

    def in_pieces(self, first: SensorData, initial: InitialState, events: list[EventRow]) -> InPieces:
        """Return the filter before its first piece (`piecewise.RunsInPieces`)."""
        used = [MAGNETOMETER] if self.options.magnetometer and first.mag is not None else []
        flight = AhrsFlight(self.options, first.specs, initial, first.date)
        schedule = Schedule(initial.t, first.specs.imu, compensate=False, cut=True)
        schedule.events += events
        return SteppedPassage(flight, schedule, used, first, initial, StateLayout())

    def unmodeled_errors(self, specs: AssumedSpecs) -> tuple[str, ...]:
        """Return the errors of these sensors that the filter has no state for, in words."""
        magnetic = self.options.magnetometer and specs.mag is not None
        found = unmodeled(specs, [MAGNETOMETER] if magnetic else [], _MODELED)
        return ("sustained acceleration too small to show in the magnitude of the specific force", *found)


class AhrsFlight(SteppedFilter):
    """The filter over one record (`stepped_filters.SteppedFilter`), of 18 or 30 states."""

    C_nb: Kept[FloatArray]  # (3, 3)
    wrong: Kept[FloatArray]  # (n - 3,) the states but attitude: [rad/s], [m/s^2], [1], and [T], [1], b
    P: Kept[FloatArray]
    earth_n: Kept[FloatArray]  # (3,) rate of the Earth, of an unknown heading its vertical part [rad/s], n
    sums: Kept[FloatArray]  # (3, 12) integral of C_nb, and by the rates, since P is as it is [s], [rad]
    gained: Kept[FloatArray]  # (3, 16) integrals in this period: specific force, n, C_nb, ``sums`` by time
    before: Kept[FloatArray]  # (3, 3) C_nb when P was as it is
    spans: Kept[FloatArray]  # (3,) [s] since P is as it is, in this period; variance of ``gained`` by gaps
    unknown: Kept[float]  # variance of attitude by gaps since P is as it is [rad^2]
    lasting: Kept[float]  # number of periods that an acceleration has lasted
    gate: Kept[InnovationGate]
    work: Scratch[FloatArray]  # (9, 3) of the kernel

    shapes = (16,), (9, 9), (6,)
    one_antenna = False

    def __init__(self, options: AhrsOptions, specs: AssumedSpecs, initial: InitialState, date: float) -> None:
        self.options, self.imu = options, specs.imu
        lat, _, alt = initial.lla
        self.w_n = EARTH_RATE * np.array([np.cos(lat), 0.0, -np.sin(lat)])
        self.g_n = earth.gravity_n(lat, alt)
        self.C_nb, gyro = rotation.matrix(initial.q_nb), specs.imu.gyro
        magnetic = options.magnetometer and specs.mag is not None
        n = 30 if magnetic else 18
        self.P, self.walk, self.wrong = np.zeros((n, n)), np.zeros(n), np.zeros(n - 3)
        across = self.C_nb.T @ initial.bias_cov[6:]
        self.P[PHI, PHI] = self.C_nb.T @ initial.cov[6:, 6:] @ self.C_nb
        self.P[PHI, 3:9], self.P[3:9, PHI] = across, across.T
        for rows, triad in ((GYRO, gyro), (ACCEL, specs.imu.accel)):
            start, walk = bias_and_walk(triad)
            self.P[rows, rows] = np.eye(3) * start**2
            self.walk[rows] = walk**2
        tilted = gyro.misalignment_sd**2 + gyro.nonorthogonality_sd**2
        turned = np.full((3, 3), tilted) + np.diag(gyro.by_axis("scale_factor_sd") ** 2 - tilted)
        self.P[TURN, TURN] = np.diag(turned.ravel())
        self.field_n = np.zeros(3)
        if magnetic:
            assert specs.mag is not None
            self.field_n = field_n(initial.lla[None], date)[0]
            self.P[IRON, IRON] = np.eye(3) * specs.mag.hard_iron_sd**2
            self.P[CALIBRATION, CALIBRATION] = _calibration(specs.mag)
        self.sums, self.gained, self.spans = np.zeros((3, 12)), np.zeros((3, 16)), np.zeros(3)
        self.before = self.C_nb.copy()
        self.unknown, self.lasting = 0.0, 0.0
        self.earth_n = self._find_earth_rate()
        self.make_scratch()
        self.gate = InnovationGate(
            (*SENSORS, "gravity"), initial.t, options.gate_probability, options.readmit_after_s
        )

    def make_scratch(self) -> None:
        """Allocate the memory of the kernel."""
        self.work = np.zeros((9, 3))

    def increments(self, increments_b: FloatArray) -> FloatArray:
        """Return increments as they are."""
        return increments_b

    def begin(self, dt: float, dtheta: FloatArray) -> None:
        """Nothing is known of the first step in advance."""

    def step(
        self, now: float, dt: float, dtheta: FloatArray, dvel: FloatArray, unknown: FloatArray, due: bool
    ) -> None:
        """Advance by a step; use gravity at the end of its period."""
        turn_kernel(
            self.C_nb, self.wrong, self.earth_n, dt, dtheta, dvel,
            self.sums, self.gained, self.spans, self.work,
        )  # fmt: skip
        self.spans[2] += unknown[0]
        self.unknown += float(unknown[1])
        if self.spans[1] >= self.options.gravity_period_s - TIME_TOLERANCE:
            self._use_gravity(now)

    def measure(self, now: float, arrived: list[Measurement]) -> None:
        """Use the magnetometer."""
        for _, values, variance in arrived:
            self._use_field(now, values[:3], variance[:3])

    def answer(self, now: float) -> tuple[FloatArray, ...]:
        """Return state and biases (16,), the covariance (9, 9) and the variances of the biases (6,)."""
        self._propagate()
        cov = np.full((9, 9), np.nan)
        cov[6:, 6:] = self.C_nb @ self.P[PHI, PHI] @ self.C_nb.T
        state = np.concatenate([np.full(6, np.nan), rotation.from_matrix(self.C_nb), self.wrong[:6]])
        return state, cov, np.diag(self.P)[3:9].copy()

    def solution(
        self, t: FloatArray, answers: Sequence[FloatArray], events: list[EventRow], *, last: bool
    ) -> NavSolution:
        """Return the solution at epochs (M,) [s], with the innovations since the last call."""
        table, refused = self.gate.take(last=last)
        state, cov, variance = answers
        return join_answers(t, StateLayout(), state, cov, variance, table, Events.from_rows(events + refused))

    def _propagate(self) -> None:
        """Bring P to the time of the attitude."""
        T = float(self.spans[0])
        if T <= 0.0:
            return
        F, C_bn = np.eye(len(self.P)), self.C_nb.T
        F[PHI, PHI] = C_bn @ (self.before - T * np.cross(self.earth_n, self.before, axisb=0, axisc=0))
        F[PHI, GYRO], F[PHI, TURN] = -C_bn @ self.sums[:, :3], -C_bn @ self.sums[:, 3:]
        Q = np.diag(self.walk * T)
        added = self.unknown + self.walk[GYRO.start] * T**3 / 3.0
        Q[PHI, PHI] = np.diag(self.imu.gyro.by_axis("random_walk") ** 2 * T + added)
        Q[PHI, GYRO] = F[PHI, GYRO] * self.walk[GYRO.start] * T / 2.0
        Q[GYRO, PHI] = Q[PHI, GYRO].T
        self._keep(F @ self.P @ F.T + Q)
        self.sums, self.unknown, self.before = np.zeros((3, 12)), 0.0, self.C_nb.copy()
        self.spans[0] = 0.0

    def _keep(self, P: FloatArray) -> None:
        self.P = 0.5 * (P + P.T)

    def _use_gravity(self, t: float) -> None:
        """Compare the mean specific force of the period that ends with gravity."""
        self._propagate()
        T, g = float(self.spans[1]), float(self.g_n[2])
        f_b, mean, turned = np.split(self.C_nb.T @ self.gained / T, [1, 4], axis=1)
        f_b = f_b[:, 0]
        white = np.diag(self.imu.accel.by_axis("random_walk") ** 2 / T + self.spans[2] / T**2)
        self.gained, self.spans[1:] = np.zeros((3, 16)), 0.0
        length, g_b = float(np.linalg.norm(f_b)), self.C_nb.T @ self.g_n
        along = f_b / length if length > 0.0 else g_b / g
        spread = float(along @ (mean @ self.P[ACCEL, ACCEL] @ mean.T + white) @ along)
        shown = (length - g) ** 2 > _SHOWN**2 * spread
        self.lasting = min(self.lasting + 1.0, _LONGEST / T) if shown else 0.0
        size2 = length**2 - g**2 if length > g else (g - length) ** 2  # no horizontal one shortens f
        moved = self.options.acceleration_sd**2 + self.lasting * size2
        H = np.zeros((3, len(self.P)))
        H[:, PHI], H[:, ACCEL] = rotation.skew(g_b), -mean
        for rows, part in ((GYRO, turned[:, :3]), (TURN, turned[:, 3:])):  # the attitude was another before
            H[:, rows] = H[:, PHI] @ part
        self._update(t, GRAVITY, f_b + g_b, H, white + np.eye(3) * moved, PHI)
        self.earth_n = self._find_earth_rate()

    def _find_earth_rate(self) -> FloatArray:
        """Return the rate of the Earth to use: its horizontal direction needs a heading that is known."""
        known = self.C_nb[2] @ self.P[PHI, PHI] @ self.C_nb[2] <= _UNKNOWN**2
        return self.w_n if known else self.w_n * np.array([0.0, 0.0, 1.0])

    def _use_field(self, t: float, field_b: FloatArray, variance: FloatArray) -> None:
        """Compare the magnetic field measured (3,) [T], b, with the field of the model."""
        self._propagate()
        iron, matrix = self.wrong[15:18], self.wrong[18:].reshape(3, 3)
        if self.C_nb[2] @ self.P[PHI, PHI] @ self.C_nb[2] > _VAGUE**2:
            found_n = self.C_nb @ (field_b - iron)
            off = np.arctan2(found_n[1], found_n[0]) - np.arctan2(self.field_n[1], self.field_n[0])
            self._turn(rotation.matrix(rotation.from_rotvec(np.array([0.0, 0.0, -off]))))
        p_b = self.C_nb.T @ self.field_n
        H = np.zeros((3, len(self.P)))
        H[:, PHI], H[:, IRON] = -rotation.skew(p_b), -np.eye(3)
        H[:, CALIBRATION] = -np.kron(np.eye(3), p_b)
        self._update(t, MAGNETIC, field_b - iron - matrix @ p_b - p_b, H, np.diag(variance), IRON)

    def _turn(self, turn: FloatArray) -> None:
        """Turn the attitude by a matrix (3, 3), n; what C_nb lacks to a rotation is not carried on."""
        self.C_nb, self.gained = rotation.matrix(rotation.from_matrix(turn @ self.C_nb)), turn @ self.gained
        self.before = self.C_nb.copy()

    def _update(
        self, t: float, code: int, d: FloatArray, H: FloatArray, R: FloatArray, opened: slice
    ) -> None:
        """Gate and use d (3,) = H x + noise of covariance R; ``opened`` states may have made a step."""
        S = H @ self.P @ H.T + R
        value = nis(d, S)
        sound = value <= self.gate.limits[3]
        spread = np.diag(self.C_nb @ S @ self.C_nb.T)
        verdict = self.gate.decide(t, code, -self.C_nb @ d, spread, value, sound=sound)
        if verdict == REFUSED:
            return
        if verdict != SOUND:
            opens = np.zeros(len(self.P), np.bool_)
            opens[opened] = True
            E = growth(verdict, self.P @ H.T @ np.linalg.solve(S, d), H, d, opens)
            self.P = self.P + E @ E.T
            S = H @ self.P @ H.T + R
        K = np.linalg.solve(S, H @ self.P).T
        J = np.eye(len(self.P)) - K @ H
        x = K @ d
        back = rotation.matrix(rotation.from_rotvec(-x[PHI]))
        J[PHI], K[PHI] = back.T @ J[PHI], back.T @ K[PHI]  # by the whole angle, as in `error_state`
        self._keep(J @ self.P @ J.T + K @ R @ K.T)
        self._turn(self.C_nb @ back @ self.C_nb.T)
        self.wrong = self.wrong - x[3:]


def _calibration(mag: MagSpec) -> FloatArray:
    """Return the covariance (9, 9) of the matrix of calibration [1], row by row; soft iron is symmetric."""
    soft, rows = mag.soft_iron_sd**2, np.arange(9).reshape(3, 3)
    cov = np.diag(np.where(np.eye(3) > 0, mag.scale_factor_sd**2, mag.misalignment_sd**2).ravel())
    cov[rows, rows] += soft
    cov[rows, rows.T] = np.where(np.eye(3) > 0, cov[rows, rows], soft)
    return cov


@kernel
def turn_kernel(
    C_nb: FloatArray,
    wrong: FloatArray,
    w_n: FloatArray,
    dt: float,
    dtheta: FloatArray,
    dvel: FloatArray,
    sums: FloatArray,
    gained: FloatArray,
    spans: FloatArray,
    work: FloatArray,
) -> None:
    """Turn C_nb (3, 3) by a step in place; add to ``sums``, ``gained`` and the first two ``spans``.

    ``work`` (9, 3) is memory.
    """
    turn, push, half, old, step = work[0], work[1], work[2], work[3:6], work[6:9]
    for i in range(3):
        turn[i] = dtheta[i] - wrong[i] * dt
        push[i] = dvel[i] - wrong[3 + i] * dt
        for j in range(3):
            turn[i] -= wrong[6 + 3 * i + j] * dtheta[j]
            old[i, j] = C_nb[i, j]
            turn[i] -= C_nb[j, i] * w_n[j] * dt
    x, y, z, since = turn[0], turn[1], turn[2], spans[1] + 0.5 * dt
    size2 = x * x + y * y + z * z
    size = np.sqrt(size2)
    s, c = 1.0 - size2 / 6.0, 0.5 - size2 / 24.0
    if size > 1e-3:
        s, c = np.sin(size) / size, (1.0 - np.cos(size)) / size2
    half[0] = push[0] + 0.5 * (y * push[2] - z * push[1])
    half[1] = push[1] + 0.5 * (z * push[0] - x * push[2])
    half[2] = push[2] + 0.5 * (x * push[1] - y * push[0])
    for i in range(3):
        for j in range(3):
            step[i, j] = c * turn[i] * turn[j]
        step[i, i] += 1.0 - c * size2
    step[0, 1] -= s * z
    step[1, 0] += s * z
    step[0, 2] += s * y
    step[2, 0] -= s * y
    step[1, 2] -= s * x
    step[2, 1] += s * x
    for i in range(3):
        for j in range(3):
            gained[i, 0] += old[i, j] * half[j]
            C_nb[i, j] = 0.0
            for k in range(3):
                C_nb[i, j] += old[i, k] * step[k, j]
            mean = 0.5 * (old[i, j] + C_nb[i, j])
            sums[i, j] += mean * dt
            gained[i, 1 + j] += mean * dt
            gained[i, 4 + j] += mean * dt * since
            for k in range(3):
                sums[i, 3 + 3 * j + k] += mean * dtheta[k]
                gained[i, 7 + 3 * j + k] += mean * dtheta[k] * since
    spans[0] += dt
    spans[1] += dt
