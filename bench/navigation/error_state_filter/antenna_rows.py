"""Rows of H for position and velocity of the GNSS antenna, n.

    position   dp - [C l x] phi + C dl
    velocity   dv - [C (w x l) x] phi + C [l x] db_g + C [w x] dl

with l the antenna in b and w the rate of b relative to e. Where the clock of the fixes is off by an estimated
dt, they show the antenna of another time, p + v dt + a dt^2 / 2 and v + a dt. What has a column for a bias
has one for each state that adds to it (`corrections`).
"""

from __future__ import annotations

import numpy as np

from bench.core.compilation.compiled import inner, kernel
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.earth import EARTH_RATE, gravity_kernel, radii_kernel
from bench.navigation.error_state_filter.corrections import (
    drive_rows_kernel,
    motion_factors_kernel,
    newest_kernel,
)
from bench.navigation.error_state_filter.error_state import ACCEL, GYRO, PHI, POS, VEL
from bench.navigation.error_state_filter.propagation import Site
from bench.navigation.error_state_filter.rough_heading import stands_kernel, vague_kernel
from bench.navigation.mechanization import matrix_kernel


@kernel
def antenna_kernel(
    nav: FloatArray,
    C: FloatArray,
    antenna_b: FloatArray,
    w_ib_b: FloatArray,
    lla: FloatArray,
    vel_n: FloatArray,
    H: FloatArray,
    z: FloatArray,
) -> None:
    """Fill z (6,) and H (6, n) of a fix: predicted minus measured position [m] and velocity [m/s], n.

    Elements of H that are always zero are not written: H must hold zeros there.
    """
    s, c = np.sin(nav[0]), np.cos(nav[0])
    meridian, prime = radii_kernel(s)
    r_m, r_p = meridian + nav[2], prime + nav[2]
    x, y, d = antenna_b[0], antenna_b[1], antenna_b[2]
    # rate of b relative to e: without that of the Earth, in b
    p = w_ib_b[0] - EARTH_RATE * (C[0, 0] * c - C[2, 0] * s)
    q = w_ib_b[1] - EARTH_RATE * (C[0, 1] * c - C[2, 1] * s)
    r = w_ib_b[2] - EARTH_RATE * (C[0, 2] * c - C[2, 2] * s)
    sx, sy, sd = q * d - r * y, r * x - p * d, p * y - q * x  # w x l
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
    dlon -= 2.0 * np.pi * np.rint(dlon / (2.0 * np.pi))
    z[0] += (nav[0] - lla[0]) * r_m
    z[1] += dlon * r_p * c
    z[2] += lla[2] - nav[2]
    for i in range(3):
        z[3 + i] += nav[3 + i] - vel_n[i]


@inner
def lever_kernel(C: FloatArray, w_ib_b: FloatArray, at: int, H: FloatArray) -> None:
    """Fill the columns from ``at`` on of H (6, n): the estimated lever arm. The Earth rate is neglected."""
    p, q, r = w_ib_b[0], w_ib_b[1], w_ib_b[2]
    for i in range(3):
        for j in range(3):
            H[i, at + j] = C[i, j]
        H[3 + i, at] = C[i, 1] * r - C[i, 2] * q  # C [w x]
        H[3 + i, at + 1] = C[i, 2] * p - C[i, 0] * r
        H[3 + i, at + 2] = C[i, 0] * q - C[i, 1] * p


@kernel
def steady_arm_kernel(C: FloatArray, w_b: FloatArray, H: FloatArray) -> None:
    """Leave in the heading column of velocities, in H (6, n), a turn w_b (3,) about the vertical alone.

    In a hover the IMU swings about the antenna as much as the antenna about the IMU, and
    `rough_heading.stand_kernel` turns none of the motion of the IMU: the tilting arm alone would find the
    opposite heading.
    """
    turn = C[2, 0] * w_b[0] + C[2, 1] * w_b[1] + C[2, 2] * w_b[2]
    H[3, PHI + 2], H[4, PHI + 2] = -turn * H[1, PHI + 2], turn * H[0, PHI + 2]


@inner
def antenna_rows_kernel(
    site: Site, antenna_b: FloatArray, lla: FloatArray, vel_n: FloatArray, H: FloatArray, z: FloatArray
) -> None:
    """Fill z (6,) and H (6, n) as :func:`antenna_kernel` does, with all states that the antenna depends on.

    The lever arm is the estimated one if the layout has it.
    """
    now, _, index, _, work = site
    at = index.antenna_b
    for i in range(3):
        work.lever[i] = now.state[at + 1 + i] if at >= 0 else antenna_b[i]
    matrix_kernel(now.state, work.C)
    antenna_kernel(now.state, work.C, work.lever, work.last[0], lla, vel_n, H, z)
    if newest_kernel(work.last, work.known[3], work.motion):
        for i in range(3):
            for j in range(3):
                H[3 + i, PHI + j] = 0.0
    elif vague_kernel(now.P) and stands_kernel(now.state, now.P):
        steady_arm_kernel(work.C, work.last[0], H)
    motion_factors_kernel(work.motion, work.drives, work.known, work.factor)
    drive_rows_kernel(H[3:], work.drives, work.factor)
    if at >= 0:
        lever_kernel(work.C, work.motion[0], at, H)


@inner
def fix_rows_kernel(site: Site, values: FloatArray, H: FloatArray, z: FloatArray) -> None:
    """Fill z (6,) and H (6, n) of a fix: position (3,), velocity (3,) of an antenna at (3,) in b."""
    if site.where.time_offset >= 0:
        none = site.work.vectors[0]
        none[:] = 0.0
        antenna_rows_kernel(site, values[6:], values[:3], none, H, z)
        _late_rows_kernel(site, values[3:6], H, z)
    else:
        antenna_rows_kernel(site, values[6:], values[:3], values[3:6], H, z)


@inner
def _late_rows_kernel(site: Site, vel_n: FloatArray, H: FloatArray, z: FloatArray) -> None:
    """Shift z (6,) and H (6, n) to the time stamp of a fix by the estimated clock offset.

    z[3:] is the velocity of the antenna, from which the measured ``vel_n`` (3,) is not yet taken. The
    acceleration is that of the IMU, without Coriolis: 2 mm/s at 50 m/s, 0.25 s.
    """
    now, _, index, _, work = site
    at = index.time_offset
    state, C, f, motion = now.state, work.C, work.force_n, work.motion
    n, ahead, factor = now.P.shape[0], state[at + 1], work.factor
    half = 0.5 * ahead * ahead
    for i in range(3):
        for k in range(n):
            H[i, k] += ahead * H[3 + i, k]
    g = work.vectors[0]
    g[1] = 0.0
    g[0], g[2] = gravity_kernel(np.sin(state[0]), np.cos(state[0]), state[2])
    for i in range(3):
        motion[1, i] = C[0, i] * f[0] + C[1, i] * f[1] + C[2, i] * f[2]
        a = f[i] + g[i]
        H[i, at] = z[3 + i] + ahead * a
        H[3 + i, at] = a
        z[i] += ahead * z[3 + i] + half * a
        z[3 + i] += ahead * a - vel_n[i]
    motion_factors_kernel(motion, work.drives, work.known, factor)
    for block in range(2):
        by = half if block == 0 else ahead
        for i in range(3):
            row, j, k = H[3 * block + i], (i + 1) % 3, (i + 2) % 3
            row[PHI + j] += by * f[k]  # -[f x]
            row[PHI + k] -= by * f[j]
            for axis in range(3):
                row[ACCEL + axis] -= by * C[i, axis]
            for d in range(work.drives.shape[0]):
                error = work.drives[d, 1] - ACCEL
                if error >= 0:
                    row[work.drives[d, 0]] -= by * C[i, error] * factor[d]
