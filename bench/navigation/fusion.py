"""The compiled filters: one kernel over whole records, state layouts as data.

An error-state extended Kalman filter in closed loop: the strapdown navigator runs on increments less the
estimated biases, the covariance follows its linear dynamics, and every accepted measurement is fed back at
once. Loose coupling: position and velocity of the GNSS antenna, barometric altitude.

    z_pos  = antenna position, predicted less measured = dp - [C l x] phi + dm_p
    z_vel  = antenna velocity, predicted less measured = dv - [C (w x l) x] phi + C [l x] db_g + dm_v
    z_baro = h + b - h_baro                            = -dp_D + db

with l the antenna in b, w the rate of b against e, and m the Markov part of the GNSS error where the layout
has it. The change of P by the turn of the frame at feedback (half the tilt correction) is neglected: below
1e-4 for corrections below 0.01 rad (equations section 10).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.arrays import FloatArray, IntArray
from bench.compiled import kernel
from bench.data import Events, InitialState, Innovations, NavSolution, SensorData, no_innovations
from bench.earth import RATE, radii_kernel
from bench.navigation import alignment, timeline
from bench.navigation.error_state import (
    ACCEL,
    CORE,
    GYRO,
    PHI,
    POS,
    VEL,
    StateLayout,
    accumulate_kernel,
    covariance_kernel,
    dynamics_kernel,
    feedback_kernel,
    transition_kernel,
)
from bench.navigation.kalman import nis_kernel, update_kernel
from bench.navigation.mechanization import STATE_SIZE, body_step_kernel, matrix_kernel, step_kernel
from bench.navigation.state_model import fix_variance, known, state_model, unmodelled
from bench.specs import AssumedSpecs

SENSORS = ("gnss_position", "gnss_velocity", "baro")
_POSITION, _VELOCITY, _BARO = 0, 1, 2


@kernel
def _aid_kernel(
    code: int,
    t: float,
    P: FloatArray,
    dx: FloatArray,
    H: FloatArray,
    z: FloatArray,
    r: FloatArray,
    gates: FloatArray,
    readmit_after: int,
    misses: IntArray,
    numbers: FloatArray,
    marks: IntArray,
    count: int,
    var: FloatArray,
    square: FloatArray,
    vectors: FloatArray,
) -> int:
    """Gate one sub-vector, use it or not, and write its rows; return the new count of rows."""
    m = z.shape[0]
    nis = nis_kernel(P, dx, H, z, r, var, square)
    accepted = nis <= gates[code] or misses[code] >= readmit_after
    misses[code] = 0 if accepted else misses[code] + 1
    for a in range(m):
        innovation = -z[a]  # measured less predicted
        for i in range(P.shape[0]):
            innovation += H[a, i] * dx[i]
        numbers[count + a, 0], numbers[count + a, 1] = t, innovation
        numbers[count + a, 2], numbers[count + a, 3] = var[a], nis
        marks[count + a, 0], marks[count + a, 1], marks[count + a, 2] = code, a, accepted
    if accepted:
        for a in range(m):
            update_kernel(P, dx, H[a], z[a], r[a], vectors[0], vectors[1])
    return count + int(m)


@kernel
def _antenna_kernel(
    nav: FloatArray,
    C: FloatArray,
    antenna_b: FloatArray,
    w_ib_b: FloatArray,
    lla: FloatArray,
    vel_n: FloatArray,
    H: FloatArray,
    z: FloatArray,
) -> None:
    """Fill z (6,) and H (6, n) of a fix: predicted less measured position [m] and velocity [m/s], n."""
    s, c = np.sin(nav[0]), np.cos(nav[0])
    meridian, prime = radii_kernel(s)
    r_m, r_p = meridian + nav[2], prime + nav[2]
    x, y, d = antenna_b[0], antenna_b[1], antenna_b[2]
    # rate of b against e: less the Earth's, seen in b
    p = w_ib_b[0] - RATE * (C[0, 0] * c - C[2, 0] * s)
    q = w_ib_b[1] - RATE * (C[0, 1] * c - C[2, 1] * s)
    r = w_ib_b[2] - RATE * (C[0, 2] * c - C[2, 2] * s)
    sx, sy, sd = q * d - r * y, r * x - p * d, p * y - q * x  # w x l
    H[:6] = 0.0
    for i in range(3):
        H[POS + i, POS + i] = 1.0
        H[VEL + i, VEL + i] = 1.0
        H[3 + i, GYRO] = C[i, 1] * d - C[i, 2] * y  # C [l x]
        H[3 + i, GYRO + 1] = C[i, 2] * x - C[i, 0] * d
        H[3 + i, GYRO + 2] = C[i, 0] * y - C[i, 1] * x
    for block, u, v, w in ((0, x, y, d), (3, sx, sy, sd)):
        a = C[0, 0] * u + C[0, 1] * v + C[0, 2] * w
        b = C[1, 0] * u + C[1, 1] * v + C[1, 2] * w
        g = C[2, 0] * u + C[2, 1] * v + C[2, 2] * w
        H[block, PHI + 1], H[block, PHI + 2] = g, -b  # -[a x]
        H[block + 1, PHI], H[block + 1, PHI + 2] = -g, a
        H[block + 2, PHI], H[block + 2, PHI + 1] = b, -a
        z[block], z[block + 1], z[block + 2] = a, b, g
    dlon = nav[1] - lla[1]
    dlon -= 2.0 * np.pi * np.round(dlon / (2.0 * np.pi))
    z[0] += (nav[0] - lla[0]) * r_m
    z[1] += dlon * r_p * c
    z[2] += lla[2] - nav[2]
    for i in range(3):
        z[3 + i] += nav[3 + i] - vel_n[i]


@kernel
def _keep_kernel(
    nav: FloatArray, biases: FloatArray, extra: FloatArray, P: FloatArray, row: FloatArray, out_P: FloatArray
) -> None:
    """Fill a row (n + 1,), navigation state, gyro and accelerometer bias, extra states, and a copy of P.

    Loops, because copies of slices take the compiler seconds each.
    """
    for i in range(10):
        row[i] = nav[i]
    for i in range(3):
        row[10 + i] = biases[0, i]
        row[13 + i] = biases[1, i]
    for i in range(extra.shape[0]):
        row[16 + i] = extra[i]
    for i in range(P.shape[0]):
        for j in range(P.shape[1]):
            out_P[i, j] = P[i, j]


@kernel
def _fusion_kernel(
    nav: FloatArray,
    biases: FloatArray,
    extra: FloatArray,
    P: FloatArray,
    q: FloatArray,
    decay_time: FloatArray,
    decay_distance: FloatArray,
    stationary: FloatArray,
    t: FloatArray,
    span: FloatArray,
    scale: FloatArray,
    rows: IntArray,
    dtheta_b: FloatArray,
    dvel_b: FloatArray,
    interval: float,
    fix_rows: IntArray,
    fix_at: IntArray,
    fix_lla: FloatArray,
    fix_vel: FloatArray,
    fix_r: FloatArray,
    antenna_b: FloatArray,
    baro_rows: IntArray,
    baro_at: IntArray,
    alt_baro: FloatArray,
    baro_r: FloatArray,
    baro_index: int,
    markov_index: int,
    gates: FloatArray,
    readmit_after: int,
    output_at: IntArray,
    out_nav: FloatArray,
    out_biases: FloatArray,
    out_extra: FloatArray,
    out_P: FloatArray,
    numbers: FloatArray,
    marks: IntArray,
    node_t: FloatArray,
    node_state: FloatArray,
    node_P: FloatArray,
    node_Phi: FloatArray,
) -> int:
    """Run the filter over a record; return the number of innovation rows written.

    ``nav``, ``biases`` (2, 3), ``extra`` and ``P`` are the start and end as the last state. ``interval`` is
    the covariance step; a measurement or an output takes one at once. ``scale`` stretches increments over a
    gap. The nodes, where there is room for any, take what a smoother needs at every instant of a measurement
    or an output: state (N, 2, n + 1) and covariance (N, 2, n, n) before and after it, and the transition
    (N, n, n) from the node before.
    """
    n = P.shape[0]
    gyro_bias, accel_bias = biases[0], biases[1]
    before = np.zeros(7)
    w_ib_b, dth, dv, rotvec, dv_start, dv_n = (
        np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3),
    )  # fmt: skip
    C, C_sum, dv_sum = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)
    F, G, A, B = np.zeros((9, 15)), np.zeros((9, 15)), np.zeros((9, n)), np.zeros((n, n))
    decay, noise, dx, reference = np.ones(n), np.zeros(n), np.zeros(n), nav.copy()
    H, z, var, square, vectors = (
        np.zeros((7, n)),
        np.zeros(7),
        np.zeros(3),
        np.zeros((3, 4)),
        np.zeros((2, n)),
    )
    square_1 = np.zeros((1, 2))
    misses = np.zeros(3, np.int64)
    keep = node_t.shape[0] > 0
    Phi = np.eye(n)
    T, count, fix, baro, output, node = 0.0, 0, 0, 0, 0, 0
    for k in range(-1, t.shape[0]):
        if k >= 0:
            row, dt = rows[k], span[k]
            for i in range(3):
                dth[i] = dtheta_b[row, i] * scale[k] - gyro_bias[i] * dt
                dv[i] = dvel_b[row, i] * scale[k] - accel_bias[i] * dt
                w_ib_b[i] = dth[i] / dt
            body_step_kernel(dt, dth, dv, before, rotvec, dv_start)
            step_kernel(nav, dt, rotvec, dv_start, C, dv_n)
            T += dt
            for i in range(3):
                dv_sum[i] += dv_n[i]
                for j in range(3):
                    C_sum[i, j] += C[i, j] * dt
        aided = (fix < fix_at.shape[0] and fix_at[fix] == k) or (
            baro < baro_at.shape[0] and baro_at[baro] == k
        )
        due = aided or (output < output_at.shape[0] and output_at[output] == k)
        if T > 0.0 and (due or interval <= T):
            for i in range(3):
                dv_sum[i] /= T
                for j in range(3):
                    C_sum[i, j] /= T
            ground_speed = np.sqrt(reference[3] * reference[3] + reference[4] * reference[4])
            for i in range(n):
                rate = decay_time[i] + decay_distance[i] * ground_speed
                decay[i] = np.exp(-rate * T) if rate > 0.0 else 1.0
                noise[i] = q[i] * T if stationary[i] == 0.0 else stationary[i] * (1.0 - decay[i] * decay[i])
            for i in range(3):
                gyro_bias[i] *= decay[GYRO + i]
                accel_bias[i] *= decay[ACCEL + i]
            for i in range(extra.shape[0]):
                extra[i] *= decay[CORE + i]
            dynamics_kernel(reference, C_sum, dv_sum, F)
            transition_kernel(F, T, G)
            covariance_kernel(P, G, decay, noise, A, B)
            if keep:
                accumulate_kernel(Phi, G, decay, A)
            T = 0.0
            C_sum[:] = 0.0
            dv_sum[:] = 0.0
            reference[:] = nav
        if keep and due:
            node_t[node] = t[k]
            _keep_kernel(nav, biases, extra, P, node_state[node, 0], node_P[node, 0])
            for i in range(n):
                for j in range(n):
                    node_Phi[node, i, j] = Phi[i, j]
                    Phi[i, j] = 1.0 if i == j else 0.0
        if aided:
            while fix < fix_at.shape[0] and fix_at[fix] == k:
                row = fix_rows[fix]
                matrix_kernel(nav, C)
                _antenna_kernel(nav, C, antenna_b, w_ib_b, fix_lla[row], fix_vel[row], H, z)
                if markov_index >= 0:
                    for i in range(6):
                        H[i, markov_index + i] = 1.0
                        z[i] += extra[markov_index - CORE + i]
                for code in (_POSITION, _VELOCITY):
                    a = 3 * code
                    count = _aid_kernel(
                        code, t[k], P, dx, H[a : a + 3], z[a : a + 3], fix_r[a : a + 3], gates, readmit_after,
                        misses, numbers, marks, count, var, square, vectors,
                    )  # fmt: skip
                feedback_kernel(nav, gyro_bias, accel_bias, extra, dx)
                fix += 1
            while baro < baro_at.shape[0] and baro_at[baro] == k:
                H[6] = 0.0
                H[6, POS + 2] = -1.0
                z[6] = nav[2] - alt_baro[baro_rows[baro]]
                if baro_index >= 0:
                    H[6, baro_index] = 1.0
                    z[6] += extra[baro_index - CORE]
                count = _aid_kernel(
                    _BARO, t[k], P, dx, H[6:7], z[6:7], baro_r, gates, readmit_after,
                    misses, numbers, marks, count, var, square_1, vectors,
                )  # fmt: skip
                feedback_kernel(nav, gyro_bias, accel_bias, extra, dx)
                baro += 1
            reference[:] = nav
        if keep and due:
            _keep_kernel(nav, biases, extra, P, node_state[node, 1], node_P[node, 1])
            node += 1
        while output < output_at.shape[0] and output_at[output] == k:
            out_nav[output] = nav
            out_biases[output] = biases
            out_extra[output] = extra
            out_P[output] = P
            output += 1
    return count


@dataclass(frozen=True, slots=True)
class Nodes:
    """A forward run at the instants of its measurements and outputs, for a smoother."""

    layout: StateLayout
    t: FloatArray  # (N,) [s]
    state: FloatArray  # (N, 2, n + 1) before and after: nav state (10), gyro bias, accelerometer bias, extra
    P: FloatArray  # (N, 2, n, n) before and after
    Phi: FloatArray  # (N, n, n) transition of the errors from the node before
    output: IntArray  # (M,) node of each instant of the solution, -1 outside the record


class Loose:
    """Loosely coupled INS/GNSS/baro filter: 15 inertial states, a barometer bias, GNSS Markov errors.

    The bias states are random walks with ``P0 = turn_on_sd^2 + instability_sd^2`` and
    ``q = 2 instability_sd^2 / correlation``; for a unit without turn-on bias they are Gauss-Markov processes
    whose mean decays too. Q, R and P0 come from the assumed specs (`bench.navigation.state_model`): R is the
    white variance of the GNSS datasheet with Markov states, and the white and Markov variance together,
    taken as white, without.

    Parameters
    ----------
    gnss, baro : bool
        Which aiding to use; without any it navigates by the IMU alone and P is its open-loop covariance.
    gnss_markov : bool
        Estimate the Markov part of the GNSS errors in six states: with all aiding the 22 states of A-5.4.1.
    covariance_hz : float or None
        Rate of the covariance step; None: at every IMU sample.
    gate_probability : float
        Chance of refusing a sound sub-vector of a matched filter, (0, 1).
    readmit_after : int
        Refusals in a row after which the next sub-vector is used all the same (A-5.4.7).
    """

    def __init__(
        self,
        *,
        gnss: bool = True,
        baro: bool = True,
        gnss_markov: bool = False,
        covariance_hz: float | None = None,
        gate_probability: float = 1e-5,
        readmit_after: int = 10,
    ) -> None:
        for name, value in (("gnss", gnss), ("baro", baro), ("gnss_markov", gnss_markov)):
            if not isinstance(value, bool):
                raise ValueError(f"{name} = {value!r} must be true or false")
        if covariance_hz is not None and not (_is_number(covariance_hz) and 0 < covariance_hz < np.inf):
            raise ValueError(
                f"covariance_hz = {covariance_hz!r} must be positive, or left out for every sample"
            )
        if not (_is_number(gate_probability) and 0 < gate_probability < 1):
            raise ValueError(f"gate_probability = {gate_probability!r} must lie between 0 and 1")
        if not (_is_number(readmit_after) and readmit_after >= 1 and readmit_after == int(readmit_after)):
            raise ValueError(f"readmit_after = {readmit_after!r} must be a whole number, at least 1")
        if gnss_markov and not gnss:
            raise ValueError("gnss_markov = True needs gnss = True: the states are errors of its fixes")
        self.gnss, self.baro, self.gnss_markov = gnss, baro, gnss_markov
        self.covariance_hz = covariance_hz
        self.gate_probability = gate_probability
        self.readmit_after = readmit_after

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        """Estimate position, velocity, attitude, biases and their covariance.

        Raises
        ------
        ValueError
            When a sensor in use has no assumed spec.
        """
        return self.forward(sensors, initial, keep=False)[0]

    def forward(self, sensors: SensorData, initial: InitialState, *, keep: bool) -> tuple[NavSolution, Nodes]:
        """Return the solution of :meth:`run` and, with ``keep``, the nodes a smoother goes back over."""
        initial, aligned = alignment.complete(sensors, initial)
        specs = sensors.specs
        fixes = sensors.fixes if self.gnss else None
        baro = sensors.baro if self.baro else None
        model = state_model(
            initial, specs, baro_bias=baro is not None, gnss_markov=self.gnss_markov and fixes is not None
        )
        layout, n = model.layout, model.layout.size

        rows, span, events = timeline.imu_rows(sensors.imu, initial.t)
        events += aligned
        t = np.concatenate([sensors.imu.t[rows], [initial.t]])  # the last one serves the start, index -1
        no_rows = np.empty(0, np.int64)
        fix_rows, fix_at, fix_r = no_rows, no_rows, np.empty(6)
        fix_lla, fix_vel = _no_values(0, 3), _no_values(0, 3)
        if fixes is not None:
            values = np.hstack([fixes.lla, fixes.vel_n])
            fix_rows, fix_at, left = timeline.aiding_rows(fixes, values, "gnss", t[:-1], initial.t)
            events += left
            fix_lla, fix_vel = fixes.lla, fixes.vel_n
            fix_r = fix_variance(specs, gnss_markov=self.gnss_markov)
        baro_rows, baro_at, alt_baro, baro_r = no_rows, no_rows, _no_values(0), np.empty(1)
        if baro is not None:
            baro_rows, baro_at, left = timeline.aiding_rows(
                baro, baro.alt_baro[:, None], "baro", t[:-1], initial.t
            )
            events += left
            alt_baro, baro_r = baro.alt_baro, np.array([known(specs.baro, "baro").white_sd ** 2])

        m = len(sensors.output_t)
        served = sensors.output_t >= initial.t - timeline.TIME_TOLERANCE
        served &= sensors.output_t <= np.max(t) + timeline.TIME_TOLERANCE
        output_at = np.searchsorted(t[:-1], sensors.output_t[served] - timeline.TIME_TOLERANCE)
        output_at[sensors.output_t[served] < initial.t + timeline.TIME_TOLERANCE] = -1
        out = {"nav": (STATE_SIZE,), "biases": (2, 3), "extra": (n - CORE,), "P": (n, n)}
        series = {name: np.full((len(output_at), *shape), np.nan) for name, shape in out.items()}
        size = 6 * len(fix_at) + len(baro_at)
        numbers, marks = np.empty((size, 4)), np.empty((size, 3), np.int64)
        at = np.unique(np.concatenate([fix_at, baro_at, output_at])) if keep else np.empty(0, np.int64)
        nodes = Nodes(
            layout,
            np.empty(len(at)),
            np.empty((len(at), 2, n + 1)),
            np.empty((len(at), 2, n, n)),
            np.empty((len(at), n, n)),
            np.full(m, -1),
        )
        if keep:
            nodes.output[served] = np.searchsorted(at, output_at)
        count = _fusion_kernel(
            np.concatenate([initial.lla, initial.vel_n, initial.q_nb]),
            np.zeros((2, 3)),
            np.zeros(n - CORE),
            model.P,
            model.q,
            model.decay_time,
            model.decay_distance,
            model.stationary,
            t[:-1],
            span,
            span / sensors.imu.dt[rows],
            rows,
            sensors.imu.dtheta_b,
            sensors.imu.dvel_b,
            0.0 if self.covariance_hz is None else (1.0 - 1e-6) / self.covariance_hz,
            fix_rows,
            fix_at,
            fix_lla,
            fix_vel,
            fix_r,
            sensors.antenna_b,
            baro_rows,
            baro_at,
            alt_baro,
            baro_r,
            layout.slice("baro_bias").start if layout.has("baro_bias") else -1,
            layout.slice("gnss_pos").start if layout.has("gnss_pos") else -1,
            _gates(self.gate_probability),
            self.readmit_after,
            output_at.astype(np.int64),
            series["nav"],
            series["biases"],
            series["extra"],
            series["P"],
            numbers,
            marks,
            nodes.t,
            nodes.state,
            nodes.P,
            nodes.Phi,
        )
        full = {name: np.full((m, *shape), np.nan) for name, shape in out.items()}
        for name, values in series.items():
            full[name][served] = values
        told = timeline.as_events(events)
        return _solution(sensors, layout, full, numbers[:count], marks[:count], told), nodes

    @property
    def needs(self) -> tuple[str, ...]:
        """What it has nothing to work on without; a barometer beside GNSS is used where there is one."""
        return ("fixes",) if self.gnss else ("baro",) if self.baro else ()

    def unmodelled(self, specs: AssumedSpecs) -> tuple[str, ...]:
        """Name the errors of these units that the state has no room for, in words."""
        return unmodelled(specs, gnss=self.gnss, baro=self.baro, gnss_markov=self.gnss_markov)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _no_values(*shape: int) -> FloatArray:
    """Return an empty column, read-only as those of a record: the kernel is compiled for one kind."""
    column = np.empty(shape)
    column.flags.writeable = False
    return column


def _gates(probability: float) -> FloatArray:
    """Return the largest NIS of each sub-vector that is accepted (A-5.4.7)."""
    from scipy.special import gammaincinv

    gates: FloatArray = 2.0 * gammaincinv(np.array([1.5, 1.5, 0.5]), 1.0 - probability)
    return gates


def _solution(
    sensors: SensorData,
    layout: StateLayout,
    out: dict[str, FloatArray],
    numbers: FloatArray,
    marks: IntArray,
    events: Events,
) -> NavSolution:
    nav, P = out["nav"], out["P"]
    states = np.concatenate([out["biases"].reshape(len(nav), 6), out["extra"]], axis=1)
    variance = np.einsum("kii->ki", P)[:, 9:]
    innovations = no_innovations()
    if len(numbers):
        innovations = Innovations(
            t=numbers[:, 0],
            sensor=SENSORS,
            code=marks[:, 0],
            component=marks[:, 1],
            z=numbers[:, 1],
            S=numbers[:, 2],
            nis=numbers[:, 3],
            accepted=marks[:, 2].astype(np.bool_),
        )
    return NavSolution(
        t=sensors.output_t,
        lla=nav[:, :3],
        vel_n=nav[:, 3:6],
        q_nb=nav[:, 6:],
        gyro_bias_b=out["biases"][:, 0],
        accel_bias_b=out["biases"][:, 1],
        cov=P[:, :9, :9],
        extra_names=layout.labels(),
        extra=states,
        extra_sd=np.sqrt(np.where(variance >= 0, variance, np.nan)),
        innovations=innovations,
        events=events,
    )
