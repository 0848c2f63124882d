"""Strapdown mechanization in the local level frame: one kernel per record.

A-5.1.2 to A-5.1.4 in north, east, down on the WGS 84 ellipsoid with normal gravity
(`bench.core.mathematics.earth`):

    lat'  = v_N / (R_M + h)      lon' = v_E / ((R_P + h) cos lat)      h' = -v_D
    v_n'  = C_nb f_b + g_n - (2 w_ie_n + w_en_n) x v_n
    C_nb' = C_nb [w_ib_b x] - [w_in_n x] C_nb

The inputs are increments: integrals of w_ib_b and f_b over each interval. Coning and sculling are corrected
with the previous interval (equations 10): both rates are taken as linear over two intervals.
Coriolis, transport rate and gravity are taken at the middle of the interval.

A navigation state is a row of ten: lat, lon [rad], height [m], v_N, v_E, v_D [m/s], q_nb.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from bench.core.compilation.compiled import kernel
from bench.core.mathematics.arrays import FloatArray, as_float
from bench.core.mathematics.earth import EARTH_RATE, WGS84, gravity_kernel, radii_kernel

STATE_SIZE = 10
_A = WGS84.a


@kernel
def matrix_kernel(nav: FloatArray, C: FloatArray) -> None:
    """Fill C (3, 3) with C_nb of the quaternion in a navigation state."""
    w, x, y, z = nav[6], nav[7], nav[8], nav[9]
    C[0, 0] = w * w + x * x - y * y - z * z
    C[0, 1] = 2.0 * (x * y - w * z)
    C[0, 2] = 2.0 * (x * z + w * y)
    C[1, 0] = 2.0 * (x * y + w * z)
    C[1, 1] = w * w - x * x + y * y - z * z
    C[1, 2] = 2.0 * (y * z - w * x)
    C[2, 0] = 2.0 * (x * z - w * y)
    C[2, 1] = 2.0 * (y * z + w * x)
    C[2, 2] = w * w - x * x - y * y + z * z


@kernel
def turn_kernel(nav: FloatArray, x: float, y: float, z: float, left: bool) -> None:
    """Multiply q_nb by the quaternion of a rotation vector [rad], on the left (in n) or the right (in b).

    A turn on the left makes its norm 1 again; one on the right leaves that to the next on the left.
    """
    angle2 = x * x + y * y + z * z
    if angle2 < 1e-2:  # series: the next terms are below 1e-15
        c = 1.0 - angle2 * (1.0 / 8.0 - angle2 * (1.0 / 384.0 - angle2 * (1.0 / 46080.0)))
        s = 0.5 - angle2 * (1.0 / 48.0 - angle2 * (1.0 / 3840.0 - angle2 * (1.0 / 645120.0)))
    else:
        angle = np.sqrt(angle2)
        c = np.cos(0.5 * angle)
        s = np.sin(0.5 * angle) / angle
    x, y, z = s * x, s * y, s * z
    if left:
        x, y, z = -x, -y, -z  # q' = d o q is conjugate(conjugate(q) o conjugate(d))
    sign = -1.0 if left else 1.0
    a, i, j, k = nav[6], sign * nav[7], sign * nav[8], sign * nav[9]
    w = a * c - i * x - j * y - k * z
    p = a * x + i * c + j * z - k * y
    q = a * y - i * z + j * c + k * x
    r = a * z + i * y - j * x + k * c
    scale = 1.0
    if left:
        square = w * w + p * p + q * q + r * r
        scale = 1.5 - 0.5 * square  # one over its root; the next term is below 1e-16
        if abs(square - 1.0) > 1e-8:
            scale = 1.0 / np.sqrt(square)
    sign *= scale
    nav[6], nav[7], nav[8], nav[9] = scale * w, sign * p, sign * q, sign * r


@kernel
def tilt_between_kernel(nav: FloatArray, other: FloatArray, out: FloatArray) -> None:
    """Fill out (3,) with the rotations from the attitude of other to nav: about down, then the tilt.

    The third is the turn about down, at most pi; the first two are a rotation vector along n [rad].
    """
    a, i, j, k = other[6], -other[7], -other[8], -other[9]
    w, x, y, z = nav[6], nav[7], nav[8], nav[9]
    real = w * a - x * i - y * j - z * k
    north = w * i + x * a + y * k - z * j
    east = w * j - x * k + y * a + z * i
    down = w * k + x * j - y * i + z * a
    cosine = np.sqrt(real * real + down * down)  # of half the tilt
    sine = np.sqrt(north * north + east * east)
    sign = -1.0 if real < 0.0 else 1.0
    scale = 2.0 / cosine
    if sine > 0.0:
        scale = 2.0 * np.arctan2(sine, cosine) / (sine * cosine)
    out[0] = scale * (real * north - down * east)
    out[1] = scale * (real * east + down * north)
    out[2] = 2.0 * np.arctan2(sign * down, sign * real)


@kernel
def body_step_kernel(
    dt: float, dth: FloatArray, dv: FloatArray, before: FloatArray, rotvec: FloatArray, dv_start: FloatArray
) -> None:
    """Fill the rotation vector of one interval and its velocity increment in the body axes at its start.

    ``before`` (7,) holds dtheta, dvel and length of the previous interval (zeros if there is none) and is
    overwritten by this one.
    """
    a, b, c = dth[0], dth[1], dth[2]
    u, v, w = dv[0], dv[1], dv[2]
    h = before[6]
    f = dt * dt / (6.0 * h * (h + dt)) if h > 0.0 else 0.0  # 1/12 for equal intervals
    a0, b0, c0, u0, v0, w0 = before[0], before[1], before[2], before[3], before[4], before[5]
    x = a + f * (b0 * c - c0 * b)
    y = b + f * (c0 * a - a0 * c)
    z = c + f * (a0 * b - b0 * a)
    angle2 = x * x + y * y + z * z
    if angle2 < 1e-2:  # series: the next terms are below 1e-14
        m1 = 0.5 - angle2 * (1.0 / 24.0 - angle2 * (1.0 / 720.0 - angle2 * (1.0 / 40320.0)))
        m2 = 1.0 / 6.0 - angle2 * (1.0 / 120.0 - angle2 * (1.0 / 5040.0 - angle2 * (1.0 / 362880.0)))
    else:
        angle = np.sqrt(angle2)
        m1 = (1.0 - np.cos(angle)) / angle2
        m2 = (angle - np.sin(angle)) / (angle2 * angle)
    # rotation during the interval: (I + m1 [r x] + m2 [r x]^2) dv
    p, q, r = y * w - z * v, z * u - x * w, x * v - y * u
    # sculling: f (dtheta0 x dv + dv0 x dtheta)
    dv_start[0] = u + m1 * p + m2 * (y * r - z * q) + f * (b0 * w - c0 * v + v0 * c - w0 * b)
    dv_start[1] = v + m1 * q + m2 * (z * p - x * r) + f * (c0 * u - a0 * w + w0 * a - u0 * c)
    dv_start[2] = w + m1 * r + m2 * (x * q - y * p) + f * (a0 * v - b0 * u + u0 * b - v0 * a)
    rotvec[0], rotvec[1], rotvec[2] = x, y, z
    before[0], before[1], before[2] = a, b, c
    before[3], before[4], before[5] = u, v, w
    before[6] = dt


@kernel
def step_kernel(
    nav: FloatArray, dt: float, rotvec: FloatArray, dv_start: FloatArray, C: FloatArray, dv_n: FloatArray
) -> None:
    """Carry a navigation state over one interval; fill C_nb at its start and C_nb dv_start.

    ``rotvec`` and ``dv_start`` come from :func:`body_step_kernel`.
    """
    matrix_kernel(nav, C)
    f_n = C[0, 0] * dv_start[0] + C[0, 1] * dv_start[1] + C[0, 2] * dv_start[2]
    f_e = C[1, 0] * dv_start[0] + C[1, 1] * dv_start[1] + C[1, 2] * dv_start[2]
    f_d = C[2, 0] * dv_start[0] + C[2, 1] * dv_start[1] + C[2, 2] * dv_start[2]
    dv_n[0], dv_n[1], dv_n[2] = f_n, f_e, f_d

    lat, alt = nav[0], nav[2]
    v_n, v_e, v_d = nav[3], nav[4], nav[5]
    mid = lat + 0.5 * dt * v_n / _A  # the radius matters here below 1e-10 rad
    s, c = np.sin(mid), np.cos(mid)
    mid_alt = alt - 0.5 * dt * v_d
    meridian, prime = radii_kernel(s)
    r_m, r_p = meridian + mid_alt, prime + mid_alt
    g_n, g_d = gravity_kernel(s, c, mid_alt)
    by_m, by_p, by_c = 1.0 / r_m, 1.0 / r_p, 1.0 / c
    tan = s * by_c
    k_n, k_d = 2.0 * EARTH_RATE * c + v_e * by_p, -2.0 * EARTH_RATE * s - v_e * by_p * tan
    k_e = -v_n * by_m
    m_n = v_n + 0.5 * (f_n - dt * (k_e * v_d - k_d * v_e))
    m_e = v_e + 0.5 * (f_e - dt * (k_d * v_n - k_n * v_d))
    m_d = v_d + 0.5 * (f_d + dt * (g_d - (k_n * v_e - k_e * v_n)))
    e_n, e_e = m_e * by_p, -m_n * by_m  # w_en_n
    e_d = -e_n * tan
    i_n, i_d = EARTH_RATE * c, -EARTH_RATE * s  # w_ie_n
    z_n, z_e, z_d = (i_n + e_n) * dt, e_e * dt, (i_d + e_d) * dt  # rotation of n against i
    k_n, k_e, k_d = 2.0 * i_n + e_n, e_e, 2.0 * i_d + e_d

    w_n = v_n + f_n - 0.5 * (z_e * f_d - z_d * f_e) + dt * (g_n - (k_e * m_d - k_d * m_e))
    w_e = v_e + f_e - 0.5 * (z_d * f_n - z_n * f_d) - dt * (k_d * m_n - k_n * m_d)
    w_d = v_d + f_d - 0.5 * (z_n * f_e - z_e * f_n) + dt * (g_d - (k_n * m_e - k_e * m_n))
    nav[0] = lat + 0.5 * dt * (v_n + w_n) * by_m
    nav[1] += 0.5 * dt * (v_e + w_e) * by_p * by_c
    nav[2] = alt - 0.5 * dt * (v_d + w_d)
    nav[3], nav[4], nav[5] = w_n, w_e, w_d
    turn_kernel(nav, rotvec[0], rotvec[1], rotvec[2], False)
    turn_kernel(nav, -z_n, -z_e, -z_d, True)


@kernel
def _propagate_kernel(
    nav: FloatArray,
    before: FloatArray,
    dt: FloatArray,
    dtheta_b: FloatArray,
    dvel_b: FloatArray,
    out: FloatArray,
    C: FloatArray,
    work: FloatArray,
) -> None:
    """Fill out (N, 10) with the state after each interval; ``nav`` becomes the last one."""
    rotvec, dv_start, dv_n = work[0], work[1], work[2]
    for k in range(dt.shape[0]):
        body_step_kernel(dt[k], dtheta_b[k], dvel_b[k], before, rotvec, dv_start)
        step_kernel(nav, dt[k], rotvec, dv_start, C, dv_n)
        for i in range(STATE_SIZE):
            out[k, i] = nav[i]


def propagate(
    lla: ArrayLike,
    vel_n: ArrayLike,
    q_nb: ArrayLike,
    dt: ArrayLike,
    dtheta_b: ArrayLike,
    dvel_b: ArrayLike,
    before: FloatArray | None = None,
) -> FloatArray:
    """Return the states (N + 1, 10) of a free inertial navigator, the start first.

    Parameters
    ----------
    lla, vel_n, q_nb : (3,), (3,), (4,) arrays
        State at the start of the first interval [rad, rad, m], [m/s], scalar first.
    dt : (N,) array
        Length of each interval [s].
    dtheta_b, dvel_b : (N, 3) arrays
        Increments over each interval [rad], [m/s], frame b.
    before : (7,) array or None
        dtheta_b, dvel_b and length of the interval before the first, zeros if there is none; overwritten
        by the last, so that a record can be given in pieces.

    Raises
    ------
    ValueError
        If an array has the wrong shape or a value that is not finite.

    Notes
    -----
    Longitude is not wrapped: it goes on past 180 deg.
    """
    start = np.concatenate(
        [as_float("lla", lla, (3,)), as_float("vel_n", vel_n, (3,)), as_float("q_nb", q_nb, (4,))]
    )
    steps = as_float("dt", dt, (None,))
    n = len(steps)
    out = np.empty((n + 1, STATE_SIZE))
    out[0] = start
    _propagate_kernel(
        start.copy(),
        np.zeros(7) if before is None else before,
        steps,
        as_float("dtheta_b", dtheta_b, (n, 3)),
        as_float("dvel_b", dvel_b, (n, 3)),
        out[1:],
        np.empty((3, 3)),
        np.empty((3, 3)),
    )
    return out
