"""Error terms of an IMU other than noise, bias and the matrix M.

Input side, in this order: position and axis of each accelerometer (B-0, size effect), delay and bandwidth,
dead zone (A-2.4.S). Output side: scale factor asymmetry, nonlinearity, g-sensitivity, temperature bias. Rates
are means over a sample, so squared terms do not include motion that averages out within a sample. The angular
acceleration term C_eps of A-5.1.8 is 0, its default in the register.
"""

from __future__ import annotations

import numpy as np

from bench.core.compilation.compiled import kernel
from bench.core.files import disk_arrays
from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.records.data import Trajectory
from bench.core.records.sensor_specs import ImuSpec, ThermalSpec, TriadSpec, VibrationSpec
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.sensors.processes import apply_lag
from bench.simulation.signals.air import TOP, standard_atmosphere, to_geopotential


def check_imu(spec: ImuSpec) -> list[str]:
    """Return one line for each datasheet value that is impossible or lacks another value."""
    wrong = []
    for name, triad, limit in (("gyro", spec.gyro, "range_deg_s"), ("accel", spec.accel, "range_g")):
        if triad.nonlinearity_sd > 0 and triad.range <= 0:
            wrong.append(f"[{name}] nonlinearity_sd needs {limit} above 0: it is relative to the range")
        if triad.bias_instability > 0 and triad.bias_correlation <= 0:
            wrong.append(
                f"[{name}] bias_instability needs bias_correlation_s above 0 s: the catalog assumes 300 "
                "where no source states it"
            )
        if triad.dead_zone_kind not in ("subtractive", "hard"):
            wrong.append(f"[{name}] dead_zone_kind = {triad.dead_zone_kind!r}: not subtractive or hard")
        if triad.transient_sd > 0 and triad.transient_time <= 0:
            wrong.append(f"[{name}] transient_sd needs transient_time_s above 0 s")
        if triad.noise_shape not in ("white", "averaged", "sampled"):
            wrong.append(f"[{name}] noise_shape = {triad.noise_shape!r}: not white, averaged or sampled")
        elif triad.noise_shape != "white" and triad.bandwidth <= 0:
            wrong.append(f"[{name}] noise_shape = {triad.noise_shape!r} needs bandwidth_hz above 0 Hz")
    if spec.accel.g_sensitivity_sd > 0 or spec.accel.g2_sensitivity_sd > 0:
        wrong.append("[accel] g_sensitivity_sd and g2_sensitivity_sd are for gyros; give quadratic_sd")
    if spec.accel_arms and np.shape(spec.accel_arms) != (3, 3):
        wrong.append(f"accel_arms must be three positions of three meters, not {np.shape(spec.accel_arms)}")
    if not 0 <= spec.accel_cone < np.pi / 2:
        wrong.append(f"accel_cone must be 0 to below pi / 2 rad, not {spec.accel_cone:g}")
    shaken = spec.vibration
    engine = shaken.engine_gyro > 0 or shaken.engine_accel > 0
    if engine and not (shaken.engine_reference > 0 and shaken.engine_order > 0):
        wrong.append("[vibration] engine shaking needs engine_reference_rpm and engine_order above 0")
    if shaken.gust_gyro > 0 or shaken.gust_accel > 0:
        if shaken.mode_frequency <= 0:
            wrong.append("[vibration] shaking by gusts needs mode_frequency_hz above 0 Hz")
        if not 0 < shaken.mode_damping < 1:
            wrong.append("[vibration] shaking by gusts needs mode_damping above 0 and below 1")
    return wrong + _check_rotors(shaken)


def _check_rotors(spec: VibrationSpec) -> list[str]:
    shaken = max(spec.rotor_accel_1, spec.rotor_accel_2, spec.rotor_accel_4) > 0
    if not shaken:
        keys = {"inner_rate": "hz", "rotor_reference": "rpm"}
        if max(spec.engine_gyro, spec.engine_accel, spec.gust_gyro, spec.gust_accel) > 0:
            del keys["inner_rate"]
        keys |= dict.fromkeys(("rotor_forward", "rotor_right", "rotor_up"), "m")
        keys |= dict.fromkeys((f"gyration_{axis}" for axis in "xyz"), "m")
        keys |= dict.fromkeys(("imu_forward", "imu_right", "imu_down"), "m")
        idle = (f"{name}_{unit}" for name, unit in keys.items() if getattr(spec, name))
        needed = "rotor_accel_*_mg", "another vibration"
        return [f"[vibration] {key} has no effect without {needed[key == 'inner_rate_hz']}" for key in idle]
    if spec.rotor_reference <= 0:
        return ["[vibration] vibration by rotors needs rotor_reference_rpm above 0"]
    return []


# --- positions and axes of the sensors ------------------------------------------------------------------


def cone_axes(half_angle: float) -> FloatArray:
    """Return N (3, 3) with three sensing axes on a cone about x as rows, frame b (B-0).

    Examples
    --------
    >>> N = cone_axes(np.deg2rad(40.0))
    >>> print(np.linalg.norm(np.linalg.inv(N), axis=1).round(3))  # noise gains of B-0
    [0.754 1.27  1.27 ]
    """
    around = np.deg2rad([0.0, 120.0, 240.0])
    c, s = np.cos(half_angle), np.sin(half_angle)
    return np.column_stack([np.full(3, c), s * np.cos(around), s * np.sin(around)])


def resolve_along_axes(
    dtheta_b: FloatArray,
    dvel_b: FloatArray,
    dt: FloatArray,
    arms: FloatArray | None,
    N: FloatArray,
    draws: SensorDraws,
) -> FloatArray:
    """Return the increments (K, 3) [m/s] of three accelerometers along the rows of N, each at its own place.

    ``f + dw/dt x r + w x (w x r)`` along each axis (B-0). The rate w is the mean over a sample; its
    derivative is that of the parabola through this sample and the two before, with an error of order dt^2.

    Parameters
    ----------
    dtheta_b, dvel_b, dt : (K, 3), (K, 3), (K,) arrays
        Increments of the IMU's reference point [rad], [m/s], and length of the samples [s].
    arms : (3, 3) array or None
        Position of each accelerometer [m], b; None: all at the reference point.
    N : (3, 3) array
        Unit vectors of the sensing axes, b.
    draws : SensorDraws
        Keeps the last two samples for the next piece.
    """
    out = disk_arrays.empty(dvel_b.shape)
    before = draws.keep("samples before", lambda: np.empty((0, 4)))
    lead = len(before)
    if lead:
        dtheta_b = np.concatenate([before[:, :3], dtheta_b])
        dvel_b = np.concatenate([np.zeros((lead, 3)), dvel_b])
        dt = np.concatenate([before[:, 3], dt])
    along_kernel(
        dtheta_b, dvel_b, dt, np.zeros((3, 3)) if arms is None else arms, N, lead, np.empty((3, 3)), out
    )
    draws.put("samples before", np.column_stack([dtheta_b[-2:], dt[-2:]]))
    return out


def rotate_rows(C: FloatArray, rows: FloatArray) -> FloatArray:
    """Multiply every row (K, 3) by C: ``rows @ C.T`` without threads."""
    out = disk_arrays.empty(rows.shape)
    for block in disk_arrays.blocks(len(rows)):
        rotate_rows_kernel(C, rows[block], out[block])
    return out


@kernel
def rotate_rows_kernel(C: FloatArray, rows: FloatArray, out: FloatArray) -> None:
    """Fill out (N, 3) with C times each row (N, 3)."""
    for k in range(rows.shape[0]):
        for i in range(3):
            out[k, i] = C[i, 0] * rows[k, 0] + C[i, 1] * rows[k, 1] + C[i, 2] * rows[k, 2]


@kernel
def along_kernel(
    dtheta_b: FloatArray, dvel_b: FloatArray, dt: FloatArray, arms: FloatArray, N: FloatArray, lead: int,
    w: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    """Fill out (K, 3) for the samples (lead + K, 3); the first ``lead`` are of the piece before.

    ``w`` (3, 3) holds the rates of a sample and the two before it.
    """
    for k in range(lead, dtheta_b.shape[0]):
        for j in range(3):
            row = max(k - j, 0)
            for i in range(3):
                w[j, i] = dtheta_b[row, i] / dt[row]
        p, q, r = w[0, 0], w[0, 1], w[0, 2]
        here, one, two = 0.0, 0.0, 0.0  # weights of the three rates
        if k > 1:
            near = 0.5 * (dt[k] + dt[k - 1])
            far = near + 0.5 * (dt[k - 1] + dt[k - 2])
            here, one, two = 1.0 / near + 1.0 / far, -far / (near * (far - near)), near / (far * (far - near))
        elif k == 1:
            here = 2.0 / (dt[1] + dt[0])
            one = -here
        elif dtheta_b.shape[0] > 1:  # the first sample of all: the difference to the next
            here = -2.0 / (dt[1] + dt[0])
            one = -here
            for i in range(3):
                w[1, i] = dtheta_b[1, i] / dt[1]
        dp = here * p + one * w[1, 0] + two * w[2, 0]
        dq = here * q + one * w[1, 1] + two * w[2, 1]
        dr = here * r + one * w[1, 2] + two * w[2, 2]
        for i in range(3):
            x, y, z = arms[i, 0], arms[i, 1], arms[i, 2]
            along = p * x + q * y + r * z  # w x (w x r) = w (w . r) - r w^2
            w2 = p * p + q * q + r * r
            fx = dq * z - dr * y + p * along - x * w2
            fy = dr * x - dp * z + q * along - y * w2
            fz = dp * y - dq * x + r * along - z * w2
            out[k - lead, i] = (
                N[i, 0] * (dvel_b[k, 0] + dt[k] * fx)
                + N[i, 1] * (dvel_b[k, 1] + dt[k] * fy)
                + N[i, 2] * (dvel_b[k, 2] + dt[k] * fz)
            )


# --- response to motion ----------------------------------------------------------------------


def apply_response(t: FloatArray, increment: FloatArray, spec: TriadSpec, draws: SensorDraws) -> FloatArray:
    """Apply delay, bandwidth and dead zone to increments; return the same array if all are 0.

    ``draws`` keeps the state of the filter, and what the delay holds back, for the next piece.

    Raises
    ------
    ValueError
        If bandwidth or delay is above 0 and the samples differ in length.
    """
    if max(spec.delay, spec.bandwidth, spec.dead_zone) <= 0:
        return increment
    interval = draws.keep("interval", lambda: float(t[1] - t[0]))
    if max(spec.delay, spec.bandwidth) > 0 and find_largest_deviation(t, interval) > 1e-6 * interval:
        raise ValueError("bandwidth and delay need samples of equal length")
    cutoff = 2 * np.pi * spec.bandwidth
    step = np.zeros((2, 2))
    if cutoff > 0:
        step = draws.keep("response", lambda: compute_oscillator_step(cutoff, np.sqrt(0.5), interval))
    out = disk_arrays.empty(increment.shape)
    width, hard, delay = spec.dead_zone * interval, spec.dead_zone_kind == "hard", spec.delay / interval
    state = draws.keep("filter", lambda: np.array([increment[0] / interval, np.zeros(3)]))
    held = draws.keep("delayed", lambda: np.tile(increment[0], (int(delay) + 1, 1)))
    response_kernel(increment, delay, cutoff, step, interval, width, hard, held, state, out)
    held[:] = np.concatenate([held, increment[-len(held) :]])[-len(held) :]
    return out


def find_largest_deviation(t: FloatArray, interval: float) -> float:
    """Return the largest difference of the sampling intervals from an interval [s]."""
    parts = (t[rows.start : rows.stop + 1] for rows in disk_arrays.blocks(len(t) - 1))
    return max(float(np.abs(np.diff(part) - interval).max()) for part in parts)


def compute_oscillator_step(w: float, damping: float, interval: float) -> FloatArray:
    """Return the exact transition matrix (2, 2) of ``y'' + 2 damping w y' + w^2 y = 0``, damping < 1.

    Examples
    --------
    >>> print(compute_oscillator_step(2 * np.pi, 0.0, 0.125).round(3))  # an eighth of a period
    [[ 0.707  0.113]
     [-4.443  0.707]]
    """
    swing = w * np.sqrt(1 - damping**2)
    c = np.cos(swing * interval)
    s = np.sin(swing * interval) / swing
    fade = np.exp(-damping * w * interval)
    step: FloatArray = fade * np.array([[c + damping * w * s, s], [-(w**2) * s, c - damping * w * s]])
    return step


@kernel
def response_kernel(
    increment: FloatArray, delay: float, cutoff: float, step: FloatArray, interval: float, width: float,
    hard: bool, held: FloatArray, state: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    """Delay increments (K, 3) by a number of samples, filter them and apply the dead zone.

    The rate is assumed constant within a sample, so a fractional delay and the filter are exact for any
    cutoff [rad/s]. The filter is the second-order Butterworth ``y'' = w^2 (u - y) - sqrt(2) w y'`` with a
    delay of sqrt(2) / w at low frequencies. The integral of this equation over a sample gives the increment.
    ``held`` (whole samples of the delay + 1, 3) are the increments before; ``state`` (2, 3) is y and y'
    before them, then at the end.
    """
    whole = int(delay)
    part = delay - whole
    for axis in range(3):
        y, dy = state[0, axis], state[1, axis]
        for k in range(increment.shape[0]):
            new, old = k - whole, k - whole - 1
            x = increment[new, axis] if new >= 0 else held[new, axis]
            if part > 0.0:
                late = increment[old, axis] if old >= 0 else held[old, axis]
                x = (1.0 - part) * x + part * late
            if cutoff > 0.0:
                u = x / interval
                y0, dy0 = y - u, dy
                y = u + step[0, 0] * y0 + step[0, 1] * dy0
                dy = step[1, 0] * y0 + step[1, 1] * dy0
                x -= ((dy - dy0) + np.sqrt(2.0) * cutoff * (y - u - y0)) / (cutoff * cutoff)
            if abs(x) < width:
                x = 0.0
            elif not hard:
                x -= np.copysign(width, x)
            out[k, axis] = x
        state[0, axis], state[1, axis] = y, dy


# --- errors that follow the motion -------------------------------------------------------------------------


def draw_cross_axis(spec: TriadSpec, draws: SensorDraws) -> FloatArray:
    """Draw the contributions of non-orthogonality and alignment to M (3, 3).

    Non-orthogonality is symmetric: each axis of a pair takes half of the angle. Alignment is a rotation of
    the whole triad.
    """
    M = np.zeros((3, 3))
    if spec.nonorthogonality_sd > 0:
        yz, zx, xy = 0.5 * spec.nonorthogonality_sd * draws.constant("nonorthogonality", 3)
        M += [[0, xy, zx], [xy, 0, yz], [zx, yz, 0]]
    if spec.alignment_sd > 0:
        x, y, z = spec.alignment_sd * draws.constant("alignment", 3)
        M += [[0, z, -y], [-z, 0, x], [y, -x, 0]]
    return M


def draw_motion_errors(
    t: FloatArray, increment: FloatArray, dvel_b: FloatArray, spec: TriadSpec, draws: SensorDraws
) -> FloatArray:
    """Return the motion-dependent errors not in M (K, 3); no rows if all are switched off.

    ``increment`` (K, 3) [unit] is that of the triad after its response, between the epochs t (K + 1,) [s];
    ``dvel_b`` (K, 3) [m/s] that of the specific force at the IMU.

    Notes
    -----
    Asymmetry: a |x|. Nonlinearity: range times ``4 u^3 - 3 u`` with u the rate over the range; its best
    straight line is 0 and its largest deviation 1. Quadratic: q x^2. Gyros also: ``G f + H f^2`` (C_a of
    A-5.1.8, and a square term).
    """
    figures = draws.keep("motion errors", lambda: _draw_figures(spec, draws))
    if figures is None:
        return np.empty((0, 3))
    out = disk_arrays.empty(increment.shape)
    full = spec.range if spec.nonlinearity_sd > 0 else 1.0
    for rows in disk_arrays.blocks(len(out)):
        instants = t[rows.start : rows.stop + 1]
        motion_errors_kernel(instants, increment[rows], dvel_b[rows], *figures, full, out[rows])
    return out


def _draw_figures(
    spec: TriadSpec, draws: SensorDraws
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray] | None:
    """Draw the random coefficients of the motion-dependent errors; None if all are switched off."""
    terms: dict[str, tuple[FloatArray, tuple[int, ...]]] = {
        "asymmetry": (spec.by_axis("scale_asymmetry_sd"), (3,)),
        "nonlinearity": (spec.by_axis("nonlinearity_sd"), (3,)),
        "quadratic": (spec.by_axis("quadratic_sd"), (3,)),
        "g_sensitivity": (spec.by_axis("g_sensitivity_sd"), (3, 3)),
        "g2_sensitivity": (spec.by_axis("g2_sensitivity_sd"), (3, 3)),
    }
    if not any(sd.any() for sd, _ in terms.values()):
        return None
    a, n, q, G, H = (
        sd * draws.constant(name, *shape) if sd.any() else np.zeros(shape)
        for name, (sd, shape) in terms.items()
    )
    return a, n, q, G, H


@kernel
def motion_errors_kernel(
    t: FloatArray, increment: FloatArray, dvel_b: FloatArray,
    asymmetry: FloatArray, nonlinearity: FloatArray, quadratic: FloatArray, G: FloatArray, H: FloatArray,
    full: float, out: FloatArray,
) -> None:  # fmt: skip
    """Fill out (K, 3) with the errors of increments that depend on the motion."""
    for k in range(increment.shape[0]):
        dt = t[k + 1] - t[k]
        f0, f1, f2 = dvel_b[k, 0], dvel_b[k, 1], dvel_b[k, 2]
        for i in range(3):
            x = increment[k, i]
            u = x / (full * dt)
            out[k, i] = (
                asymmetry[i] * abs(x)
                + nonlinearity[i] * full * dt * u * (4.0 * u * u - 3.0)
                + quadratic[i] * x * x / dt
                + G[i, 0] * f0
                + G[i, 1] * f1
                + G[i, 2] * f2
                + (H[i, 0] * f0 * f0 + H[i, 1] * f1 * f1 + H[i, 2] * f2 * f2) / dt
            )


# --- temperature -------------------------------------------------------------------------------------------


def compute_temperature(
    truth: Trajectory, rows: IntArray, spec: ThermalSpec, before: list[float] | None = None
) -> FloatArray:
    """Return the temperature of an IMU (B,) at rows (B,) of a truth [K].

    It is switched on at the first at the temperature of the air, and approaches air plus self-heating with
    its time constant (0: immediately). ``before`` holds its temperature there, if it is on already, and then
    the last one. Without air data the air is that of the standard atmosphere.
    """
    t, air = truth.t[rows], truth.air
    if len(air.t):
        final = np.interp(t, air.t, air.temperature) + spec.self_heating
    else:
        height = np.minimum(to_geopotential(truth.lla[rows, 2]), TOP)
        final = standard_atmosphere(height)[1] + spec.self_heating
    start = before[0] if before else final[0] - spec.self_heating
    found = apply_lag(t, final, start, spec.time_constant)
    if before is not None:
        before[:] = [float(found[-1])]
    return found


def list_warmth(temperature: FloatArray, spec: ThermalSpec, draws: SensorDraws) -> FloatArray:
    """Return what the temperature biases of an IMU are proportional to, for its temperatures (B,) [K].

    Returns
    -------
    warmth : (B, 3) array
        Difference from the reference temperature [K], its square [K^2], and the hysteresis [1].

    Notes
    -----
    The hysteresis r tends to 1 while the unit warms and to -1 while it cools, ``dr = (1 -+ r) |dT| / width``,
    so that its loop is closed and does not depend on the speed of the change (Duhem's model). It is 0 at the
    start. ``draws`` keeps it, and the temperature, for the next piece.
    """
    apart = temperature - spec.reference
    state = draws.keep("hysteresis", lambda: np.array([temperature[0], 0.0]))
    turned = np.empty(len(temperature))
    hysteresis_kernel(temperature, spec.hysteresis, state, turned)
    return np.column_stack([apart, apart**2, turned])


@kernel
def hysteresis_kernel(temperature: FloatArray, width: float, state: FloatArray, out: FloatArray) -> None:
    """Fill out (B,); ``state`` (2,) is temperature and hysteresis before the first row, then at the last."""
    last, r = state[0], state[1]
    for k in range(len(temperature)):
        change = temperature[k] - last
        if change != 0.0:
            towards = np.copysign(1.0, change)
            r = towards - (towards - r) * np.exp(-abs(change) / width)
        last = temperature[k]
        out[k] = r
    state[0], state[1] = last, r
