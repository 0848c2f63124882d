"""Estimated errors of an IMU: subtract them from samples, write rows of H, and rotate them in P.

A row ``(state, error, by)`` of drives (`state_processes.States`) says that a state adds to an error
of the unit, a bias of the gyros or accelerometers, by a factor. F, H and the corrections all follow from
these rows: whatever depends on a bias depends on each state that adds to it, times its factor.
"""

from __future__ import annotations

import numpy as np

from bench.core.compilation.compiled import inner, kernel
from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.navigation.error_state_filter.error_state import ACCEL, CORE, GYRO, PHI
from bench.navigation.error_state_filter.state_processes import ABSOLUTE, CUBE, SQUARE, STEADY, WARMTH

RATE_NOISE = 16.3
"""99.9 % of chi-squared of 3: a rate with a square of less, by the variance of a sample, may be noise."""


@inner
def factor_kernel(by: int, dt: float, dth: FloatArray, dv: FloatArray, known: FloatArray) -> float:
    """Return the integral over dt of the factor that a drive applies to its state (`state_blocks`).

    ``known`` begins with the temperature above reference [K] and the range of gyros and accelerometers.
    """
    value: float = dt
    if by < 3:
        value = dth[by]
    elif by < STEADY:
        value = dv[by - 3]
    elif by == WARMTH:
        value = known[0] * dt
    elif by != STEADY:
        axis = (by - ABSOLUTE) % 6
        x = dth[axis] if axis < 3 else dv[axis - 3]
        if by < SQUARE:
            value = abs(x)
        elif by < CUBE:
            value = x * x / dt
        else:
            u = x / (known[1 if axis < 3 else 2] * dt)
            value = x * (4.0 * u * u - 3.0)
    return value


@inner
def constants_kernel(
    state: FloatArray, drives: IntArray, known: FloatArray, bias: FloatArray, slope: FloatArray
) -> int:
    """Fill the constant part of a correction (A-5.4.11); return the first drive that depends on motion.

    Of a filter state (n + 1,): bias (6,) is all that acts like a bias of gyros and accelerometers, slope (6,)
    one over their slopes.
    """
    moving: int = drives.shape[0]
    for i in range(6):
        bias[i], slope[i] = state[GYRO + 1 + i], 1.0
    for d in range(drives.shape[0]):
        error, by, value = drives[d, 1] - GYRO, drives[d, 2], state[drives[d, 0] + 1]
        if by in (STEADY, WARMTH):
            bias[error] += value if by == STEADY else value * known[0]
            continue
        moving = min(moving, d)
        if by == error:
            slope[error] += value
        elif by == CUBE + error:
            slope[error] -= 3.0 * value
    for i in range(6):
        slope[i] = 1.0 / slope[i]
    return moving


@inner
def increments_kernel(
    state: FloatArray, dt: float, drives: IntArray, moving: int, known: FloatArray, dth: FloatArray,
    dv: FloatArray, bias: FloatArray, slope: FloatArray,
) -> None:  # fmt: skip
    """Subtract the estimated errors from measured increments over dt, in place (A-5.4.11).

    What an axis measures of a small rate or force along itself is its slope, scale factor and nonlinearity
    together. All other errors are in the measured units, too, so the slope divides them: states that tell the
    same in steady motion then stay exchangeable whatever the slope, as the covariance takes them to be.

    In the order of the drives (`state_blocks.state_model`) an error that is a product has as its
    factor a motion from which all larger errors are taken: the motion by which the covariance knows it, too.
    ``moving``, ``bias`` and ``slope`` are those of :func:`constants_kernel`.
    """
    for i in range(3):
        dth[i] = (dth[i] - bias[i] * dt) * slope[i]
        dv[i] = (dv[i] - bias[3 + i] * dt) * slope[3 + i]
    for d in range(moving, drives.shape[0]):
        error, by = drives[d, 1] - GYRO, drives[d, 2]
        if by not in (error, STEADY, WARMTH):
            part = factor_kernel(by, dt, dth, dv, known)
            if by == CUBE + error:
                part += 3.0 * factor_kernel(error, dt, dth, dv, known)
            part *= state[drives[d, 0] + 1] * slope[error]
            if error < 3:
                dth[error] -= part
            else:
                dv[error - 3] -= part


@inner
def correct_kernel(
    state: FloatArray, dt: float, drives: IntArray, known: FloatArray, dth: FloatArray, dv: FloatArray,
    constants: FloatArray,
) -> None:  # fmt: skip
    """Correct one sample, with dt = 1 for a mean motion; ``constants`` (2, 6) is memory."""
    bias, slope = constants[0], constants[1]
    moving = constants_kernel(state, drives, known, bias, slope)
    increments_kernel(state, dt, drives, moving, known, dth, dv, bias, slope)


@inner
def newest_kernel(last: FloatArray, noise: float, motion: FloatArray) -> bool:
    """Fill a motion (2, 3) with the newest sample; return whether its rate may be noise and is set to zero.

    Its noise is also in the velocity of the antenna. A row with this noise would attribute it to each state
    that it multiplies (scale factors, heading, the lever arm), at every fix in the same direction.
    """
    square = 0.0
    for i in range(3):
        motion[0, i], motion[1, i] = last[0, i], last[1, i]
        square += last[0, i] * last[0, i]
    slow = bool(square < RATE_NOISE * noise)
    if slow:
        for i in range(3):
            motion[0, i] = 0.0
    return slow


@inner
def motion_factors_kernel(
    motion: FloatArray, drives: IntArray, known: FloatArray, factor: FloatArray
) -> None:
    """Fill the factors (D,) by which states act like biases in a motion (2, 3) without errors."""
    for d in range(drives.shape[0]):
        factor[d] = factor_kernel(drives[d, 2], 1.0, motion[0], motion[1], known)


@inner
def drive_rows_kernel(H: FloatArray, drives: IntArray, factor: FloatArray) -> None:
    """Fill the columns of H (m, n) of all states that act like a bias, by its column and their factors."""
    for d in range(drives.shape[0]):
        for a in range(H.shape[0]):
            H[a, drives[d, 0]] += H[a, drives[d, 1]] * factor[d]


@kernel
def axes_kernel(
    state: FloatArray, dx: FloatArray, drives: IntArray, factor: FloatArray, turn: FloatArray
) -> None:
    """Fill turn (5, 3) with the turn of the accelerometer bias axes and the sine and cosine of the tilt turn.

    A heading error turns the tilts, as given by the Jacobian of the error that remains after the feedback. A
    bias that is compensated by a tilt moves the estimate along a circle: the biases with which an IMU at rest
    measures gravity, whatever its tilt. When the estimate moves, the tangent turns; a covariance that does
    not turn takes the correction for a rotation of the IMU.

    The filter state (n + 1,) is the state before the feedback, which will subtract dx (n,). Of the drives,
    with their ``factor`` (D,), the drives of the accelerometers come first. The last row of turn is memory.
    """
    force, (w, p, q, r) = turn[4], (state[6], state[7], state[8], state[9])
    _force_kernel(dx, drives, factor, force)
    up_x, up_y, up_z = 2.0 * (w * q - p * r), -2.0 * (q * r + w * p), 2.0 * (p * p + q * q) - 1.0  # b
    x = (up_y * force[2] - up_z * force[1]) / STANDARD_GRAVITY
    y = (up_z * force[0] - up_x * force[2]) / STANDARD_GRAVITY
    z = (up_x * force[1] - up_y * force[0]) / STANDARD_GRAVITY
    angle = np.sqrt(x * x + y * y + z * z)
    s = np.sin(angle) / angle if angle > 0.0 else 1.0
    c = 0.5 * (np.sin(0.5 * angle) / (0.5 * angle)) ** 2 if angle > 0.0 else 0.5
    turn[0, 0], turn[0, 1], turn[0, 2] = 1.0 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y
    turn[1, 0], turn[1, 1], turn[1, 2] = c * x * y + s * z, 1.0 - c * (x * x + z * z), c * y * z - s * x
    turn[2, 0], turn[2, 1], turn[2, 2] = c * x * z - s * y, c * y * z + s * x, 1.0 - c * (x * x + y * y)
    turn[3, 0], turn[3, 1], turn[3, 2] = np.sin(dx[PHI + 2]), np.cos(dx[PHI + 2]), 0.0


@inner
def _force_kernel(errors: FloatArray, drives: IntArray, factor: FloatArray, force: FloatArray) -> None:
    """Fill force (3,) with the total error of the accelerometers from the errors (n,) of the states."""
    for i in range(3):
        force[i] = errors[ACCEL + i]
    d = 0
    while d < drives.shape[0] and drives[d, 1] >= ACCEL:  # those of the accelerometers come first
        force[drives[d, 1] - ACCEL] += factor[d] * errors[drives[d, 0]]
        d += 1


@kernel
def reset_kernel(
    P: FloatArray, turn: FloatArray, drives: IntArray, factor: FloatArray, force: FloatArray
) -> None:
    """Turn tilts and accelerometer biases of P (n, n) as a feedback turns the axes of the unit.

    What turns is the error of the accelerometers in all; the biases take the change. ``force`` (3, n) or more
    is memory.
    """
    n, s, c = P.shape[0], turn[3, 0], turn[3, 1]
    north, east = P[PHI], P[PHI + 1]
    for k in range(n):
        north[k], east[k] = c * north[k] + s * east[k], c * east[k] - s * north[k]
    for i in range(3):
        into, row = force[i], P[ACCEL + i]
        for k in range(n):
            into[k] = row[k]
    d = 0
    while d < drives.shape[0] and drives[d, 1] >= ACCEL:
        into, row, by = force[drives[d, 1] - ACCEL], P[drives[d, 0]], factor[d]
        for k in range(n):
            into[k] += by * row[k]
        d += 1
    x, y, z = force[0], force[1], force[2]
    for i in range(3):
        row, p, q, r = P[ACCEL + i], turn[i, 0], turn[i, 1], turn[i, 2]
        for k in range(n):
            row[k] += p * x[k] + q * y[k] + r * z[k] - force[i, k]
    _turn_columns_kernel(P[PHI], turn, drives, factor)
    _turn_columns_kernel(P[PHI + 1], turn, drives, factor)
    for i in range(3):
        _turn_columns_kernel(P[ACCEL + i], turn, drives, factor)
    for k in range(n):  # P is symmetric
        P[k, PHI], P[k, PHI + 1] = P[PHI, k], P[PHI + 1, k]
        P[k, ACCEL], P[k, ACCEL + 1], P[k, ACCEL + 2] = P[ACCEL, k], P[ACCEL + 1, k], P[ACCEL + 2, k]


@inner
def _turn_columns_kernel(row: FloatArray, turn: FloatArray, drives: IntArray, factor: FloatArray) -> None:
    """Rotate the errors of a row (n,) of P."""
    s, c, force = turn[3, 0], turn[3, 1], turn[4]
    row[PHI], row[PHI + 1] = c * row[PHI] + s * row[PHI + 1], c * row[PHI + 1] - s * row[PHI]
    _force_kernel(row, drives, factor, force)
    for i in range(3):
        row[ACCEL + i] += turn[i, 0] * force[0] + turn[i, 1] * force[1] + turn[i, 2] * force[2] - force[i]


@kernel
def turn_rows_kernel(H: FloatArray, turn: FloatArray, drives: IntArray, factor: FloatArray) -> None:
    """Rotate rows H (m, n) of measurements as :func:`reset_kernel` rotates the errors."""
    s, c, force = turn[3, 0], turn[3, 1], turn[4]
    for a in range(H.shape[0]):
        row = H[a]
        row[PHI], row[PHI + 1] = c * row[PHI] + s * row[PHI + 1], c * row[PHI + 1] - s * row[PHI]
        for i in range(3):
            force[i] = row[ACCEL + i]
        for i in range(3):
            row[ACCEL + i] = turn[i, 0] * force[0] + turn[i, 1] * force[1] + turn[i, 2] * force[2]
        d = 0
        while d < drives.shape[0] and drives[d, 1] >= ACCEL:
            e = drives[d, 1]
            row[drives[d, 0]] += factor[d] * (row[e] - force[e - ACCEL])
            d += 1


@kernel
def refer_kernel(
    P: FloatArray, dx: FloatArray, drives: IntArray, factor: FloatArray, errors: FloatArray
) -> None:
    """Refer the errors of P (n, n) to the motion that a feedback of dx (n,) leaves; fill ``errors`` (n,).

    What is known of a bias and of a state that acts by the motion is their sum at the estimated motion. A
    correction of the errors of the unit (6,), the first ``errors``, moves the estimate of all motion so far.
    The bias takes the difference: a covariance that stays takes that for a motion that parts the two.
    """
    for i in range(6):
        errors[i] = dx[GYRO + i]
    for d in range(drives.shape[0]):
        errors[drives[d, 1] - GYRO] += factor[d] * dx[drives[d, 0]]
    for d in range(drives.shape[0]):
        s, b, by = drives[d, 0], drives[d, 1], _moved_kernel(drives[d, 2], errors)
        for k in range(P.shape[0]):
            P[b, k] -= by * P[s, k]
    for d in range(drives.shape[0]):
        s, b, by = drives[d, 0], drives[d, 1], _moved_kernel(drives[d, 2], errors)
        for k in range(GYRO, CORE):
            P[k, b] -= by * P[k, s]
    for b in range(GYRO, CORE):
        for k in range(P.shape[0]):
            P[k, b] = P[b, k]


@kernel
def refer_rows_kernel(H: FloatArray, drives: IntArray, errors: FloatArray) -> None:
    """Refer rows H (m, n) of measurements as :func:`refer_kernel` refers the errors."""
    for d in range(drives.shape[0]):
        by = _moved_kernel(drives[d, 2], errors)
        for a in range(H.shape[0]):
            H[a, drives[d, 0]] += by * H[a, drives[d, 1]]


@inner
def _moved_kernel(by: int, errors: FloatArray) -> float:
    """Return by how much a correction of the errors (6,) of the unit changes the factor of a drive."""
    change: float = 0.0
    if by < STEADY:
        change = errors[by]
    elif by >= CUBE:
        change = -3.0 * errors[by - CUBE]
    return change
