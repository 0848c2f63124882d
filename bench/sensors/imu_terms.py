"""Error terms of an IMU other than noise, bias and the matrix M.

Input side, in this order: position and axis of each accelerometer (B-0, size effect), delay and bandwidth,
dead zone (A-2.4.S). Output side: scale factor asymmetry, nonlinearity, g-sensitivity, temperature bias. Rates
are means over a sample, so squared terms do not include motion that averages out within a sample. The angular
acceleration term C_eps of A-5.1.8 is 0, its default in the register.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bench.arrays import FloatArray
from bench.compiled import kernel
from bench.data import AirData
from bench.sensors.processes import apply_lag
from bench.specs import ImuSpec, ThermalSpec, TriadSpec

Draw = Callable[[str], np.random.Generator]
"""Name of a term -> its own random stream."""


def check_imu(spec: ImuSpec) -> None:
    """Check the figures of an IMU against each other.

    Raises
    ------
    ValueError
        If a figure requires another one that is missing, or is impossible.
    """
    for name, triad in (("gyro", spec.gyro), ("accel", spec.accel)):
        if triad.nonlinearity_sd > 0 and triad.range <= 0:
            raise ValueError(f"{name}.nonlinearity_sd needs a range above 0: it is a fraction of it")
        if triad.dead_zone_kind not in ("subtractive", "hard"):
            raise ValueError(
                f"{name}.dead_zone_kind must be 'subtractive' or 'hard'; got {triad.dead_zone_kind!r}"
            )
    if spec.accel.g_sensitivity_sd > 0 or spec.accel.g2_sensitivity_sd > 0:
        raise ValueError(
            "accel has no g_sensitivity_sd or g2_sensitivity_sd; quadratic_sd is its square term"
        )
    if spec.accel_arms and np.shape(spec.accel_arms) != (3, 3):
        raise ValueError(
            f"accel_arms must be three positions of three metres; got shape {np.shape(spec.accel_arms)}"
        )
    if not 0 <= spec.accel_cone < np.pi / 2:
        raise ValueError(f"accel_cone must be 0 to below pi / 2 rad; got {spec.accel_cone:g}")


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
    dtheta_b: FloatArray, dvel_b: FloatArray, dt: FloatArray, arms: FloatArray | None, N: FloatArray
) -> FloatArray:
    """Return the increments of three accelerometers along the rows of N, each at its own position.

    Parameters
    ----------
    dtheta_b, dvel_b : (K, 3) array
        Increments of the IMU's reference point [rad], [m/s].
    dt : (K,) array
        Length of the samples [s].
    arms : (3, 3) array or None
        Position of each accelerometer [m], b; None: all at the reference point.
    N : (3, 3) array
        Unit vectors of the sensing axes, b.

    Returns
    -------
    increment : (K, 3) array
        Of each accelerometer [m/s]: ``f + dw/dt x r + w x (w x r)`` along its axis (B-0). The rate w is the
        mean over a sample and its derivative a central difference; the error is of order dt^2.
    """
    out = np.empty_like(dvel_b)
    _along_kernel(dtheta_b, dvel_b, dt, np.zeros((3, 3)) if arms is None else arms, N, out)
    return out


def rotate_rows(C: FloatArray, rows: FloatArray) -> FloatArray:
    """Multiply every row (K, 3) by C: ``rows @ C.T`` without threads."""
    out = np.empty_like(rows)
    _rotate_rows_kernel(C, rows, out)
    return out


@kernel
def _rotate_rows_kernel(C: FloatArray, rows: FloatArray, out: FloatArray) -> None:
    for k in range(rows.shape[0]):
        for i in range(3):
            out[k, i] = C[i, 0] * rows[k, 0] + C[i, 1] * rows[k, 1] + C[i, 2] * rows[k, 2]


@kernel
def _along_kernel(
    dtheta_b: FloatArray, dvel_b: FloatArray, dt: FloatArray, arms: FloatArray, N: FloatArray, out: FloatArray
) -> None:
    last = dtheta_b.shape[0] - 1
    for k in range(last + 1):
        a, b = max(k - 1, 0), min(k + 1, last)
        apart = 0.5 * dt[a] + 0.5 * dt[b] + (dt[k] if b - a == 2 else 0.0)
        p, q, r = dtheta_b[k, 0] / dt[k], dtheta_b[k, 1] / dt[k], dtheta_b[k, 2] / dt[k]
        dp = (dtheta_b[b, 0] / dt[b] - dtheta_b[a, 0] / dt[a]) / apart
        dq = (dtheta_b[b, 1] / dt[b] - dtheta_b[a, 1] / dt[a]) / apart
        dr = (dtheta_b[b, 2] / dt[b] - dtheta_b[a, 2] / dt[a]) / apart
        for i in range(3):
            x, y, z = arms[i, 0], arms[i, 1], arms[i, 2]
            along = p * x + q * y + r * z  # w x (w x r) = w (w . r) - r w^2
            w2 = p * p + q * q + r * r
            fx = dq * z - dr * y + p * along - x * w2
            fy = dr * x - dp * z + q * along - y * w2
            fz = dp * y - dq * x + r * along - z * w2
            out[k, i] = (
                N[i, 0] * (dvel_b[k, 0] + dt[k] * fx)
                + N[i, 1] * (dvel_b[k, 1] + dt[k] * fy)
                + N[i, 2] * (dvel_b[k, 2] + dt[k] * fz)
            )


# --- response to motion ----------------------------------------------------------------------


def apply_response(t: FloatArray, increment: FloatArray, spec: TriadSpec) -> FloatArray:
    """Apply delay, bandwidth and dead zone to increments; return the same array if all are 0.

    Raises
    ------
    ValueError
        If bandwidth or delay is above 0 and the samples differ in length.
    """
    if max(spec.delay, spec.bandwidth, spec.dead_zone) <= 0:
        return increment
    interval = (t[-1] - t[0]) / (len(t) - 1)
    if max(spec.delay, spec.bandwidth) > 0 and np.abs(np.diff(t) - interval).max() > 1e-6 * interval:
        raise ValueError("bandwidth and delay need samples of equal length")
    cutoff = 2 * np.pi * spec.bandwidth
    step = compute_oscillator_step(cutoff, np.sqrt(0.5), interval) if cutoff > 0 else np.zeros((2, 2))
    out = np.empty_like(increment)
    width, hard = spec.dead_zone * interval, spec.dead_zone_kind == "hard"
    _response_kernel(increment, spec.delay / interval, cutoff, step, interval, width, hard, out)
    return out


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
def _response_kernel(
    increment: FloatArray,
    delay: float,
    cutoff: float,
    step: FloatArray,
    interval: float,
    width: float,
    hard: bool,
    out: FloatArray,
) -> None:
    """Delay increments (K, 3) by a number of samples, filter them and apply the dead zone.

    The rate is assumed constant within a sample and before the first one, so a fractional delay and the
    filter are exact for any cutoff [rad/s]. The filter is the second-order Butterworth ``y'' = w^2 (u - y) -
    sqrt(2) w y'`` with a delay of sqrt(2) / w at low frequencies. The integral of this equation over a sample
    gives the increment.
    """
    whole = int(delay)
    part = delay - whole
    for axis in range(3):
        y, dy = increment[0, axis] / interval, 0.0
        for k in range(increment.shape[0]):
            new, old = max(k - whole, 0), max(k - whole - 1, 0)
            x = increment[new, axis]
            if part > 0.0:
                x = (1.0 - part) * x + part * increment[old, axis]
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


# --- errors that follow the motion -------------------------------------------------------------------------


def draw_cross_axis(spec: TriadSpec, draw: Draw) -> FloatArray:
    """Draw the contributions of non-orthogonality and alignment to M (3, 3).

    Non-orthogonality is symmetric: each axis of a pair takes half of the angle. Alignment is a rotation of
    the whole triad.
    """
    M = np.zeros((3, 3))
    if spec.nonorthogonality_sd > 0:
        yz, zx, xy = 0.5 * spec.nonorthogonality_sd * draw("nonorthogonality").standard_normal(3)
        M += [[0, xy, zx], [xy, 0, yz], [zx, yz, 0]]
    if spec.alignment_sd > 0:
        x, y, z = spec.alignment_sd * draw("alignment").standard_normal(3)
        M += [[0, z, -y], [-z, 0, x], [y, -x, 0]]
    return M


def draw_motion_errors(
    t: FloatArray, increment: FloatArray, dvel_b: FloatArray, spec: TriadSpec, draw: Draw
) -> FloatArray:
    """Return the errors that depend on the motion in other ways than M: (K, 3), or no rows if all are off.

    Parameters
    ----------
    t : (K + 1,) array
        Sample instants [s].
    increment : (K, 3) array
        Increments at the triad, after its response [unit].
    dvel_b : (K, 3) array
        Increments of the specific force at the IMU [m/s].
    spec : TriadSpec
        The triad.
    draw : Draw
        The streams of the triad.

    Notes
    -----
    Asymmetry: a |x|. Nonlinearity: range times ``4 u^3 - 3 u`` with u the rate over the range; its best
    straight line is 0 and its largest deviation 1. Quadratic: q x^2. Gyros also: ``G f + H f^2`` (C_a of
    A-5.1.8, and a square term).
    """
    figures = {
        "asymmetry": spec.scale_asymmetry_sd,
        "nonlinearity": spec.nonlinearity_sd,
        "quadratic": spec.quadratic_sd,
        "g_sensitivity": spec.g_sensitivity_sd,
        "g2_sensitivity": spec.g2_sensitivity_sd,
    }
    if not any(sd > 0 for sd in figures.values()):
        return np.empty((0, 3))
    a, n, q = (
        _draw_coefficients(draw, name, figures[name], (3,))
        for name in ("asymmetry", "nonlinearity", "quadratic")
    )
    G, H = (
        _draw_coefficients(draw, name, figures[name], (3, 3)) for name in ("g_sensitivity", "g2_sensitivity")
    )
    out = np.empty_like(increment)
    full = spec.range if spec.nonlinearity_sd > 0 else 1.0
    _motion_errors_kernel(t, increment, dvel_b, a, n, q, G, H, full, out)
    return out


def _draw_coefficients(draw: Draw, name: str, sd: float, shape: tuple[int, ...]) -> FloatArray:
    """Draw the coefficients of one term; 0 without a draw if the term is off."""
    return sd * draw(name).standard_normal(shape) if sd > 0 else np.zeros(shape)


@kernel
def _motion_errors_kernel(
    t: FloatArray,
    increment: FloatArray,
    dvel_b: FloatArray,
    asymmetry: FloatArray,
    nonlinearity: FloatArray,
    quadratic: FloatArray,
    G: FloatArray,
    H: FloatArray,
    full: float,
    out: FloatArray,
) -> None:
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


def compute_temperature(t: FloatArray, air: AirData, spec: ThermalSpec) -> FloatArray:
    """Return the temperature of an IMU (B,) at instants t (B,) [K].

    It is switched on at t[0] at the temperature of the air, and approaches air plus self-heating with its
    time constant (0: immediately).
    """
    final = np.interp(t, air.t, air.temperature) + spec.self_heating
    return apply_lag(t, final, final[0] - spec.self_heating, spec.time_constant)
