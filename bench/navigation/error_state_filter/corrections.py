"""The errors of an IMU as the states have them: taken off its samples, and put into the rows of H.

A row ``(state, error, by)`` of drives (`state_processes.States`) says that a state adds to an error
of the unit, a bias of the gyros or accelerometers, by a factor. F, H and the corrections all follow from
these rows: whatever depends on a bias depends on each state that adds to it, times its factor.
"""

from __future__ import annotations

from bench.arrays import FloatArray, IntArray
from bench.compiled import inner
from bench.navigation.error_state_filter.error_state import GYRO
from bench.navigation.error_state_filter.state_processes import ABSOLUTE, CUBE, SQUARE, STEADY, WARMTH

RATE_NOISE = 16.3
"""99.9 % of chi-squared of 3: a rate with a square of less, by the variance of a sample, may be noise."""


@inner
def factor_kernel(by: int, dt: float, dth: FloatArray, dv: FloatArray, known: FloatArray) -> float:
    """Return the integral over dt of what a drive multiplies its state by (`state_blocks`).

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
def increments_kernel(
    state: FloatArray, dt: float, drives: IntArray, known: FloatArray, dth: FloatArray, dv: FloatArray,
    slope: FloatArray,
) -> None:  # fmt: skip
    """Take the estimated errors out of measured increments over dt, in place (A-5.4.11).

    What an axis measures of a small rate or force along itself is its slope, scale factor and nonlinearity
    together. All other errors are in the measured units, too, so the slope divides them: states that tell the
    same in steady motion then stay exchangeable whatever the slope, as the covariance takes them to be.

    In the order of the drives (`state_blocks.state_model`) an error that is a product has as its
    factor a motion from which all larger errors are taken: the motion by which the covariance knows it, too.
    """
    for i in range(3):
        dth[i] -= state[GYRO + 1 + i] * dt
        dv[i] -= state[GYRO + 4 + i] * dt
    if drives.shape[0] == 0:
        return
    for i in range(6):
        slope[i] = 1.0
    for d in range(drives.shape[0]):
        error, by = drives[d, 1] - GYRO, drives[d, 2]
        if by == error:
            slope[error] += state[drives[d, 0] + 1]
        elif by == CUBE + error:
            slope[error] -= 3.0 * state[drives[d, 0] + 1]
    for i in range(3):
        dth[i] /= slope[i]
        dv[i] /= slope[3 + i]
    for d in range(drives.shape[0]):
        error, by = drives[d, 1] - GYRO, drives[d, 2]
        if error != by:
            part = factor_kernel(by, dt, dth, dv, known)
            if by == CUBE + error:
                part += 3.0 * factor_kernel(error, dt, dth, dv, known)
            part *= state[drives[d, 0] + 1] / slope[error]
            if error < 3:
                dth[error] -= part
            else:
                dv[error - 3] -= part


@inner
def motion_kernel(
    state: FloatArray,
    motion: FloatArray,
    drives: IntArray,
    known: FloatArray,
    slope: FloatArray,
    factor: FloatArray,
) -> None:
    """Take the estimated errors out of a measured mean motion (2, 3), and fill the factors (D,) of it.

    Rows of the motion are the rate [rad/s] and the specific force [m/s^2], b.
    """
    increments_kernel(state, 1.0, drives, known, motion[0], motion[1], slope)
    motion_factors_kernel(motion, drives, known, factor)


@inner
def newest_kernel(last: FloatArray, noise: float, motion: FloatArray) -> bool:
    """Fill a motion (2, 3) with the newest sample; tell whether its rate may be noise, and leave that out.

    That noise is in the velocity of the antenna, too. A row with it would take it for the work of each state
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
