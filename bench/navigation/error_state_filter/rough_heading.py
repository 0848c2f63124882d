"""Corrections of the linear error model for a heading with a large uncertainty.

With psi the error of the heading, an estimate with an error is an aircraft turned by psi and tilted, its
motion turned by psi. At rest nothing is turned, so velocity and position tell nothing of psi. The linear
model thinks they do, for two reasons: its own drifting velocity, which the next fix takes away, would be
turned; the horizontal Earth rate would be turned without end, not by the sine of psi.
"""

from __future__ import annotations

import numpy as np

from bench.core.compilation.compiled import inner, kernel
from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.mathematics.earth import EARTH_RATE, radii_kernel

WIDE = float(np.deg2rad(30.0))  # sd of a heading from which on one linear filter is not enough [rad]
UNKNOWN_HEADING_SD = float(np.pi / np.sqrt(3.0))  # a heading anywhere from -180 to 180 deg [rad]
_ROUGH = 0.05  # sd from which on motion that may be none does not tell it [rad]
_CURVED = float(np.deg2rad(2.0))  # sd of a heading from which on second-order terms are added [rad]
_SIGMAS = 3.0  # a velocity within these of zero may be none
_NOISE_SIGMAS = 3.0  # a force within these of a steady flight's may be noise
_VEL_SD = 1.0  # a velocity known worse than this tells nothing of standing [m/s]


@inner
def stands_kernel(state: FloatArray, P: FloatArray) -> bool:
    """Return whether the horizontal velocity may be zero."""
    variance = P[3, 3] + P[4, 4]
    speed2 = state[3] * state[3] + state[4] * state[4]
    return bool(variance < _VEL_SD**2 and speed2 < _SIGMAS**2 * variance)


def may_stand(vel_n: FloatArray, cov: FloatArray) -> BoolArray:
    """Return for velocities (M, 3) and covariances (M, 9, 9) whether the horizontal velocity may be zero."""
    variance = cov[:, 3, 3] + cov[:, 4, 4]
    slow: BoolArray = np.square(vel_n[:, :2]).sum(axis=1) < _SIGMAS**2 * variance
    return slow & (variance < _VEL_SD**2)


@kernel
def motion_share(more2: float, variance: float) -> float:
    """Return the fraction of a force beyond the force of a steady flight that is attributed to motion.

    ``more2``: its horizontal square, mean of an interval; ``variance``: variance of the mean, along an axis,
    by noise [m^2/s^4]. A heading error also turns the noise of the accelerometers, but its part of a measured
    force is unknown: a filter that takes it for motion finds a heading that nothing observes. So the possible
    noise is left out (James and Stein, with three sigma).
    """
    share = 1.0 - _NOISE_SIGMAS * _NOISE_SIGMAS * variance / more2 if more2 > 0.0 else 0.0
    return max(share, 0.0)


@kernel
def steady_kernel(nav: FloatArray, f_n: FloatArray, variance: float, F: FloatArray) -> None:
    """Let an attitude error rotate the horizontal force due to motion, but not the accelerometer noise.

    Change F (9, 15) of a navigation state (10,) under a mean specific force f_n (3,) [m/s^2], n, of a
    ``variance`` by noise along each axis. What is beyond the force of a steady flight is taken for motion as
    :func:`motion_share` says.
    """
    s, c = np.sin(nav[0]), np.cos(nav[0])
    meridian, prime = radii_kernel(s)
    e_n, e_e = nav[4] / (prime + nav[2]), -nav[3] / (meridian + nav[2])
    k_n, k_e, k_d = 2.0 * EARTH_RATE * c + e_n, e_e, -2.0 * EARTH_RATE * s - e_n * s / c
    north, east = k_e * nav[5] - k_d * nav[4], k_d * nav[3] - k_n * nav[5]
    more_n, more_e = f_n[0] - north, f_n[1] - east
    told = motion_share(more_n * more_n + more_e * more_e, variance)
    north, east = north + told * more_n, east + told * more_e
    F[3, 8], F[4, 8], F[5, 6], F[5, 7] = -east, north, east, -north


@kernel
def second_order_velocity_kernel(f_n: FloatArray, T: float, P: FloatArray) -> None:
    """Add to P (n, n) the second-order velocity error by an uncertain heading, for a force over a step.

    With a heading error psi, a velocity v gained by a force is wrong by psi v across itself and by
    -psi^2 v / 2 along itself; the mean square of the latter is 3/4 sd^4 v^2. The kernel takes v from P: its
    covariance of velocity and heading over the variance of the heading.

    f_n (3,) is the mean specific force of the step [m/s^2], frame n; T its length [s].
    """
    if not _CURVED**2 < P[8, 8] < WIDE**2:
        return
    north, east = P[4, 8] / P[8, 8], -P[3, 8] / P[8, 8]
    before2 = north * north + east * east
    north, east = north + f_n[0] * T, east + f_n[1] * T
    after2 = north * north + east * east
    if after2 > before2:
        more = 0.75 * P[8, 8] * P[8, 8] * (after2 - before2) / after2
        P[3, 3] += more * north * north
        P[4, 4] += more * east * east
        P[3, 4] += more * north * east
        P[4, 3] += more * north * east


@kernel
def second_order_tilt_kernel(more: float, P: FloatArray) -> None:
    """Add to P (n, n) the second-order tilt error by a drift of the heading in a step.

    A tilt that compensates an accelerometer bias turns with the IMU. The filter turns the bias with its
    estimated heading and holds the tilt in n, so a heading drift psi separates them by psi times the tilt.

    ``more`` is the increase of the heading variance in the step [rad^2].
    """
    if more > 0.0 and P[8, 8] < WIDE**2:
        north, east, both = P[6, 6], P[7, 7], P[6, 7]
        P[6, 6] += more * east
        P[7, 7] += more * north
        P[6, 7] -= more * both
        P[7, 6] = P[6, 7]


@kernel
def stand_kernel(state: FloatArray, T: float, P: FloatArray, F: FloatArray, noise: FloatArray) -> bool:
    """Remove the effect of an uncertain heading from F (9, 15) over T [s], while the vehicle may stand.

    Return whether the heading is unknown: its error then begins anew, independent of what it was. P (n, n) of
    a filter state (n + 1,) and the variance ``noise`` (n,) that the interval adds change with it.

    With an sd above ``WIDE`` the heading may be any, independent of all the rest. What it does to the rate of
    the tilts, no more than the horizontal Earth rate, is left to the gyro biases: they wander more in a unit
    that loses it. The tilts turn with the heading, at a rate as unknown as the bias about the vertical, and
    so forget themselves in the time of a turn by a radian.
    """
    if not (P[8, 8] > _ROUGH**2 and stands_kernel(state, P)):
        return False
    F[3, 8], F[4, 8] = 0.0, 0.0
    lost = bool(P[8, 8] > WIDE**2)
    if lost:
        F[6, 8], F[7, 8] = 0.0, 0.0
        turn = 2.0 * np.sqrt(P[11, 11]) * T
        noise[6] += turn * P[6, 6]
        noise[7] += turn * P[7, 7]
        for i in range(P.shape[0]):
            P[8, i], P[i, 8] = 0.0, 0.0
        P[8, 8] = UNKNOWN_HEADING_SD**2
    return lost


@inner
def heading_lost_kernel(state: FloatArray, P: FloatArray) -> bool:
    """Return whether the heading is unknown and the vehicle moves: a linear filter may find a wrong one."""
    return bool(P[8, 8] > WIDE**2 and not stands_kernel(state, P))


@kernel
def blind_kernel(state: FloatArray, P: FloatArray, H: FloatArray) -> None:
    """Zero the heading column of rows H (m, n) if the heading is unknown and the velocity may be zero.

    The lever arm does not observe it: position is antenna less arm at the present heading (:func:`add_arm`).
    """
    if P[8, 8] > WIDE**2 and stands_kernel(state, P):
        for a in range(H.shape[0]):
            H[a, 8] = 0.0


@inner
def vague_kernel(P: FloatArray) -> bool:
    """Return whether the heading is so uncertain that each correction of it changes what fixes tell."""
    return bool(P[8, 8] > _ROUGH**2)


@kernel
def swing_kernel(
    H: FloatArray, before: FloatArray, after: FloatArray, work: FloatArray, state: FloatArray, P: FloatArray
) -> None:
    """Swing the IMU about the antenna of a fix whose update has turned the attitude.

    A fix measures the antenna. The antenna stays where the linear update put it: a filter state (n + 1,)
    takes what is beyond the first order, and in P (n, n) the errors of position and velocity become those of
    the antenna less the arm as it points now. Otherwise each turn of a vague heading seems to measure it.

    H (6, n) are the rows of the fix, before and after (3, 3) are C_nb around the feedback, and ``work[0]``
    the angles phi (3,) fed back [rad]; the rest of work (3, 3) is memory.
    """
    s, c = np.sin(state[0]), np.cos(state[0])
    meridian, prime = radii_kernel(s)
    phi, arm, moved = work[0], work[1], work[2]
    for block in (0, 3):
        arm[0], arm[1], arm[2] = -H[block + 2, 7], H[block + 2, 6], H[block, 7]  # or its velocity
        _turn_kernel(before, after, arm, moved)
        x, y, z, d, e, f = arm[0], arm[1], arm[2], moved[0], moved[1], moved[2]
        more_n = y * phi[2] - z * phi[1] - d
        more_e = z * phi[0] - x * phi[2] - e
        more_d = x * phi[1] - y * phi[0] - f
        if block == 0:
            state[0] += more_n / (meridian + state[2])
            state[1] += more_e / ((prime + state[2]) * c)
            state[2] -= more_d
        else:
            state[3] += more_n
            state[4] += more_e
            state[5] += more_d
        _shear_kernel(P, block, 6, 0.0, -f, e)
        _shear_kernel(P, block, 7, f, 0.0, -d)
        _shear_kernel(P, block, 8, -e, d, 0.0)
    for axis in range(9, 12):
        for i in range(3):
            arm[i] = H[3 + i, axis]
        _turn_kernel(before, after, arm, moved)
        _shear_kernel(P, 3, axis, moved[0], moved[1], moved[2])


@inner
def _turn_kernel(before: FloatArray, after: FloatArray, arm: FloatArray, moved: FloatArray) -> None:
    """Fill moved (3,) with the change of a vector of the body, arm (3,) in n before, by a turn."""
    for i in range(3):
        moved[i] = -arm[i]
        for k in range(3):
            moved[i] += after[i, k] * (before[0, k] * arm[0] + before[1, k] * arm[1] + before[2, k] * arm[2])


@inner
def _shear_kernel(P: FloatArray, block: int, at: int, d: float, e: float, f: float) -> None:
    """Subtract (d, e, f) times the error ``at`` from the three errors of a block, in P (n, n)."""
    for k in range(P.shape[0]):
        P[block, k] -= d * P[at, k]
        P[block + 1, k] -= e * P[at, k]
        P[block + 2, k] -= f * P[at, k]
    for k in range(P.shape[0]):
        P[k, block] -= d * P[k, at]
        P[k, block + 1] -= e * P[k, at]
        P[k, block + 2] -= f * P[k, at]


@inner
def yaw_kernel(C: FloatArray, H: FloatArray) -> float:
    """Return the yaw [rad] of C_nb and fill its row H (n,), with the effect of tilts at a pitch."""
    level = max(C[0, 0] * C[0, 0] + C[1, 0] * C[1, 0], 1e-6)
    H[6], H[7], H[8] = -C[0, 0] * C[2, 0] / level, -C[1, 0] * C[2, 0] / level, 1.0
    yaw: float = np.arctan2(C[1, 0], C[0, 0])
    return yaw


def add_arm(P: FloatArray, antenna_b: FloatArray) -> None:
    """Add the position error due to a lever arm (3,) with an unknown heading to P (M, n, n)."""
    lost = np.abs(P[:, 8, 8] / UNKNOWN_HEADING_SD**2 - 1.0) < 0.01
    if lost.any():
        for axis in range(2):
            P[lost, axis, axis] += antenna_b[0] ** 2 + antenna_b[1] ** 2
