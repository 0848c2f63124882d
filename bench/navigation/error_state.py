"""The error state: its layout, its linear dynamics F, the transition over a step, and the feedback.

Errors are estimate minus truth: position in metres along n, velocity in n, and
phi_n with ``C_nb_est = exp([phi_n x]) C_nb_true``. F is the Jacobian of the
mechanization (`bench.navigation.mechanization`) in these errors: A-5.1.10 mapped
to north, east, down and metres (equations 1.3: alpha_NED = -phi_n), with the
ellipsoid's own radii and their change with latitude.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from bench.arrays import FloatArray, IntArray, as_float
from bench.compiled import kernel
from bench.earth import EARTH_RATE, WGS84, gravity_gradient_kernel, radii_kernel
from bench.navigation.mechanization import turn_kernel

POS, VEL, PHI, GYRO, ACCEL = 0, 3, 6, 9, 12
"""First index of the blocks every inertial layout begins with."""
CORE = 15
CORE_BLOCKS = (
    ("pos", "m", 3),
    ("vel", "m_s", 3),
    ("phi", "rad", 3),
    ("gyro_bias", "rad_s", 3),
    ("accel_bias", "m_s2", 3),
)
"""The same by name, unit of the values and size."""
_TOP = 9  # states with dynamics of their own: position, velocity, attitude
_E2 = WGS84.e2


@dataclass(frozen=True, slots=True)
class StateLayout:
    """Named blocks of an error state, in order; every index into a state comes from here.

    Examples
    --------
    >>> layout = StateLayout(("baro_bias", "m", 1))
    >>> layout.size, layout.slice("vel"), layout.slice("baro_bias")
    (16, slice(3, 6, None), slice(15, 16, None))
    """

    blocks: tuple[tuple[str, str, int], ...]  # (name, unit of its values, size)

    def __init__(self, *extra: tuple[str, str, int]) -> None:
        object.__setattr__(self, "blocks", (*CORE_BLOCKS, *extra))

    @property
    def size(self) -> int:
        """Number of states."""
        return sum(size for _, _, size in self.blocks)

    def has(self, name: str) -> bool:
        """Say whether the layout holds a block."""
        return any(block == name for block, _, _ in self.blocks)

    def slice(self, name: str) -> slice:
        """Return where a block lies.

        Raises
        ------
        KeyError
            When the layout has no such block.
        """
        start = 0
        for block, _, size in self.blocks:
            if block == name:
                return slice(start, start + size)
            start += size
        raise KeyError(f"no state block {name!r}; there are {', '.join(b for b, _, _ in self.blocks)}")

    def labels(self) -> tuple[str, ...]:
        """Return a name with unit for each state beyond position, velocity and attitude."""
        return tuple(
            f"{name}_{axis}_{unit}" if size == 3 else f"{name}_{unit}"
            for name, unit, size in self.blocks[3:]
            for axis in ("x", "y", "z")[:size]
        )


@kernel
def dynamics_kernel(nav: FloatArray, C: FloatArray, f_n: FloatArray, F: FloatArray) -> None:
    """Fill F (9, 15): d/dt of position, velocity and attitude errors by the core states.

    ``C`` is C_nb and ``f_n`` the specific force [m/s^2], n. Elements that are zero by structure are
    left as they are: the caller hands in zeros.
    """
    s, c = np.sin(nav[0]), np.cos(nav[0])
    alt, v_n, v_e, v_d = nav[2], nav[3], nav[4], nav[5]
    meridian, prime = radii_kernel(s)
    w2 = 1.0 - _E2 * s * s
    r_m, r_p = meridian + alt, prime + alt
    dr_m = 3.0 * meridian * _E2 * s * c / w2  # by latitude
    dr_p = prime * _E2 * s * c / w2
    tan = s / c
    e_n, e_e, e_d = v_e / r_p, -v_n / r_m, -v_e * tan / r_p  # w_en_n
    i_n, i_d = EARTH_RATE * c, -EARTH_RATE * s  # w_ie_n
    k_n, k_e, k_d = 2.0 * i_n + e_n, e_e, 2.0 * i_d + e_d
    # change of w_en_n with latitude and height
    en_lat, en_alt = -e_n * dr_p / r_p, -e_n / r_p
    ee_lat, ee_alt = -e_e * dr_m / r_m, -e_e / r_m
    ed_lat, ed_alt = -v_e / (c * c * r_p) - e_d * dr_p / r_p, -e_d / r_p
    kn_lat, kd_lat = 2.0 * i_d + en_lat, -2.0 * i_n + ed_lat

    gn_alt, gn_lat, gd_alt, gd_lat = gravity_gradient_kernel(s, c, alt)

    F[0, 0], F[0, 2], F[0, 3] = -v_d / r_m, v_n / r_m, 1.0
    F[1, 0], F[1, 1], F[1, 2], F[1, 4] = -e_d, -(v_d + v_n * tan) / r_p, e_n, 1.0
    F[2, 5] = 1.0

    F[3, 0] = (kd_lat * v_e - ee_lat * v_d + gn_lat) / r_m
    F[3, 2] = -(ed_alt * v_e - ee_alt * v_d + gn_alt)
    F[3, 3], F[3, 4], F[3, 5] = v_d / r_m, k_d + e_d, -k_e
    F[4, 0] = (kn_lat * v_d - kd_lat * v_n) / r_m
    F[4, 2] = -(en_alt * v_d - ed_alt * v_n)
    F[4, 3], F[4, 4], F[4, 5] = -k_d, (v_d + v_n * tan) / r_p, k_n
    F[5, 0] = (ee_lat * v_n - kn_lat * v_e + gd_lat) / r_m
    F[5, 2] = -(ee_alt * v_n - en_alt * v_e + gd_alt)
    F[5, 3], F[5, 4] = 2.0 * e_e, -(k_n + e_n)
    F[3, 7], F[3, 8] = f_n[2], -f_n[1]
    F[4, 6], F[4, 8] = -f_n[2], f_n[0]
    F[5, 6], F[5, 7] = f_n[1], -f_n[0]

    F[6, 0], F[6, 2], F[6, 4] = -(i_d + en_lat) / r_m, en_alt, -1.0 / r_p
    F[7, 0], F[7, 2], F[7, 3] = -ee_lat / r_m, ee_alt, 1.0 / r_m
    F[8, 0], F[8, 2], F[8, 4] = -(ed_lat - i_n) / r_m, ed_alt, tan / r_p
    F[6, 7], F[6, 8] = i_d + e_d, -e_e
    F[7, 6], F[7, 8] = -(i_d + e_d), i_n + e_n
    F[8, 6], F[8, 7] = e_e, -(i_n + e_n)
    for i in range(3):
        for j in range(3):
            F[6 + i, 9 + j] = -C[i, j]
            F[3 + i, 12 + j] = -C[i, j]


@kernel
def transition_kernel(F: FloatArray, T: float, G: FloatArray) -> None:
    """Fill G (9, 15) with Phi - I over an interval T [s] (A-5.1.D).

    First order in F T, and second order along the chain gyro bias - tilt - velocity - position, where the
    first order has nothing. Elements that are zero by structure are left as they are.
    """
    half = 0.5 * T * T
    for i in range(9):
        for k in range(15):
            G[i, k] = F[i, k] * T
    for i in range(3):
        for k in range(3):
            G[i, 6 + k] = half * F[3 + i, 6 + k]
            G[i, 12 + k] = half * F[3 + i, 12 + k]
            G[3 + i, 9 + k] = half * (
                F[3 + i, 6] * F[6, 9 + k] + F[3 + i, 7] * F[7, 9 + k] + F[3 + i, 8] * F[8, 9 + k]
            )


@kernel
def _rows_kernel(P: FloatArray, E: FloatArray, G: FloatArray, A: FloatArray, n: int) -> None:
    """Fill A[:9, :n] with the first nine rows of (I + [G, 0]) P; only elements that can differ from zero.

    ``E`` (6, n) are the rows of the errors of gyros and accelerometers, P[9:15] unless other states add to
    them.
    """
    a00, a02, a07, a08, a0x, a0y, a0z = G[0, 0], G[0, 2], G[0, 7], G[0, 8], G[0, 12], G[0, 13], G[0, 14]
    a10, a11, a12, a16, a18 = G[1, 0], G[1, 1], G[1, 2], G[1, 6], G[1, 8]
    a1x, a1y, a1z = G[1, 12], G[1, 13], G[1, 14]
    a26, a27, a2x, a2y, a2z = G[2, 6], G[2, 7], G[2, 12], G[2, 13], G[2, 14]
    T = G[0, 3]
    b00, b02, b03, b04, b05, b07, b08 = G[3, 0], G[3, 2], G[3, 3], G[3, 4], G[3, 5], G[3, 7], G[3, 8]
    b10, b12, b13, b14, b15, b16, b18 = G[4, 0], G[4, 2], G[4, 3], G[4, 4], G[4, 5], G[4, 6], G[4, 8]
    b20, b22, b23, b24, b26, b27 = G[5, 0], G[5, 2], G[5, 3], G[5, 4], G[5, 6], G[5, 7]
    b0g, b0h, b0i, b0x, b0y, b0z = G[3, 9], G[3, 10], G[3, 11], G[3, 12], G[3, 13], G[3, 14]
    b1g, b1h, b1i, b1x, b1y, b1z = G[4, 9], G[4, 10], G[4, 11], G[4, 12], G[4, 13], G[4, 14]
    b2g, b2h, b2i, b2x, b2y, b2z = G[5, 9], G[5, 10], G[5, 11], G[5, 12], G[5, 13], G[5, 14]
    c00, c02, c04, c07, c08, c0g, c0h, c0i = (
        G[6, 0], G[6, 2], G[6, 4], G[6, 7], G[6, 8], G[6, 9], G[6, 10], G[6, 11],
    )  # fmt: skip
    c10, c12, c13, c16, c18, c1g, c1h, c1i = (
        G[7, 0], G[7, 2], G[7, 3], G[7, 6], G[7, 8], G[7, 9], G[7, 10], G[7, 11],
    )  # fmt: skip
    c20, c22, c24, c26, c27, c2g, c2h, c2i = (
        G[8, 0], G[8, 2], G[8, 4], G[8, 6], G[8, 7], G[8, 9], G[8, 10], G[8, 11],
    )  # fmt: skip
    for j in range(n):
        p0, p1, p2, v0, v1, v2 = P[0, j], P[1, j], P[2, j], P[3, j], P[4, j], P[5, j]
        f0, f1, f2, g, h, i = P[6, j], P[7, j], P[8, j], E[0, j], E[1, j], E[2, j]
        x, y, z = E[3, j], E[4, j], E[5, j]
        A[0, j] = p0 + a00 * p0 + a02 * p2 + T * v0 + a07 * f1 + a08 * f2 + a0x * x + a0y * y + a0z * z
        A[1, j] = (
            p1 + a10 * p0 + a11 * p1 + a12 * p2 + T * v1 + a16 * f0 + a18 * f2 + a1x * x + a1y * y + a1z * z
        )
        A[2, j] = p2 + T * v2 + a26 * f0 + a27 * f1 + a2x * x + a2y * y + a2z * z
        A[3, j] = (
            v0 + b00 * p0 + b02 * p2 + b03 * v0 + b04 * v1 + b05 * v2 + b07 * f1 + b08 * f2
            + b0g * g + b0h * h + b0i * i + b0x * x + b0y * y + b0z * z
        )  # fmt: skip
        A[4, j] = (
            v1 + b10 * p0 + b12 * p2 + b13 * v0 + b14 * v1 + b15 * v2 + b16 * f0 + b18 * f2
            + b1g * g + b1h * h + b1i * i + b1x * x + b1y * y + b1z * z
        )  # fmt: skip
        A[5, j] = (
            v2 + b20 * p0 + b22 * p2 + b23 * v0 + b24 * v1 + b26 * f0 + b27 * f1
            + b2g * g + b2h * h + b2i * i + b2x * x + b2y * y + b2z * z
        )  # fmt: skip
        A[6, j] = f0 + c00 * p0 + c02 * p2 + c04 * v1 + c07 * f1 + c08 * f2 + c0g * g + c0h * h + c0i * i
        A[7, j] = f1 + c10 * p0 + c12 * p2 + c13 * v0 + c16 * f0 + c18 * f2 + c1g * g + c1h * h + c1i * i
        A[8, j] = f2 + c20 * p0 + c22 * p2 + c24 * v1 + c26 * f0 + c27 * f1 + c2g * g + c2h * h + c2i * i


@kernel
def _errors_kernel(P: FloatArray, drives: IntArray, factor: FloatArray, E: FloatArray, n: int) -> None:
    """Fill E (6, :n): rows 9 to 14 of P and of every driving state, by its factor."""
    for i in range(6):
        for j in range(n):
            E[i, j] = P[GYRO + i, j]
    for d in range(drives.shape[0]):
        s, i, by = drives[d, 0], drives[d, 1] - GYRO, factor[d]
        for j in range(n):
            E[i, j] += by * P[s, j]


@kernel
def covariance_kernel(
    P: FloatArray,
    G: FloatArray,
    decay: FloatArray,
    noise: FloatArray,
    drives: IntArray,
    factor: FloatArray,
    A: FloatArray,
    B: FloatArray,
    E: FloatArray,
) -> None:
    """Replace P (n, n) by Phi P Phi' + diag(noise).

    Phi is I + G in its first nine rows and diag(decay) in the rest; a state ``drives[d, 0]`` acts on the
    first nine rows like the bias ``drives[d, 1]`` times ``factor[d]``. ``A`` (9, n), ``B`` (n, n) and
    ``E`` (6, n) are memory to work in. P stays exactly symmetric.
    """
    n, top = P.shape[0], A.shape[0]
    if drives.shape[0] > 0:
        _errors_kernel(P, drives, factor, E, n)
        _rows_kernel(P, E, G, A, n)
    else:
        _rows_kernel(P, P[GYRO:CORE], G, A, n)
    for j in range(9, n):
        for i in range(9):
            value = A[i, j] * decay[j]
            B[j, i] = A[i, j]
            P[i, j] = value
            P[j, i] = value
        for i in range(9, n):
            P[i, j] *= decay[i] * decay[j]
    for j in range(9):
        for i in range(9):
            B[j, i] = A[i, j]
    if drives.shape[0] > 0:
        _errors_kernel(B, drives, factor, E, top)
        _rows_kernel(B, E, G, A, top)
    else:
        _rows_kernel(B, B[GYRO:CORE], G, A, top)
    for i in range(9):
        for j in range(i):
            value = 0.5 * (A[i, j] + A[j, i])
            P[i, j] = value
            P[j, i] = value
        P[i, i] = A[i, i]
    for i in range(n):
        P[i, i] += noise[i]


@kernel
def accumulate_kernel(
    Phi: FloatArray, G: FloatArray, decay: FloatArray, drives: IntArray, factor: FloatArray, A: FloatArray
) -> None:
    """Replace Phi (n, n) by the transition of one more step times Phi; ``A`` (9, n) is memory to work in."""
    n = Phi.shape[0]
    for i in range(9):  # short to compile; only a smoother's run comes here
        for j in range(n):
            value = Phi[i, j]
            for k in range(15):
                value += G[i, k] * Phi[k, j]
            for d in range(drives.shape[0]):
                value += G[i, drives[d, 1]] * factor[d] * Phi[drives[d, 0], j]
            A[i, j] = value
    for i in range(9):
        for j in range(n):
            Phi[i, j] = A[i, j]
    for i in range(9, n):
        for j in range(n):
            Phi[i, j] *= decay[i]


@kernel
def backward_kernel(
    h: FloatArray, G: FloatArray, decay: FloatArray, drives: IntArray, factor: FloatArray, row: FloatArray
) -> None:
    """Replace h (n,) by h Phi^-1: what a measurement of before a step says of the errors after it.

    ``G`` is Phi^-1 - I in its first nine rows, from :func:`transition_kernel` with a negative interval;
    ``row`` (15,) is memory to work in.
    """
    for k in range(15):
        value = 0.0
        for i in range(9):
            value += h[i] * G[i, k]
        row[k] = value
    for k in range(9, h.shape[0]):
        h[k] /= decay[k]
    for k in range(15):
        h[k] += row[k]
    for d in range(drives.shape[0]):
        h[drives[d, 0]] += row[drives[d, 1]] * factor[d]


@kernel
def feedback_kernel(state: FloatArray, dx: FloatArray) -> None:
    """Subtract an estimated error dx (n,) from a filter state (n + 1,) (A-5.4.8, A-5.4.9).

    The state is a navigation state (10), then the values of the states from the gyro bias on. ``dx`` is
    zeroed: the error that is left is zero in the mean.
    """
    s, c = np.sin(state[0]), np.cos(state[0])
    meridian, prime = radii_kernel(s)
    state[0] -= dx[0] / (meridian + state[2])
    state[1] -= dx[1] / ((prime + state[2]) * c)
    state[2] += dx[2]
    for i in range(3):
        state[3 + i] -= dx[3 + i]
    turn_kernel(state, -dx[6], -dx[7], -dx[8], True)
    for i in range(GYRO, dx.shape[0]):
        state[i + 1] -= dx[i]
    for i in range(dx.shape[0]):
        dx[i] = 0.0


def dynamics(nav: ArrayLike, C_nb: ArrayLike, f_n: ArrayLike) -> FloatArray:
    """Return F (9, 15), the linear dynamics of position, velocity and attitude errors.

    Parameters
    ----------
    nav : (10,) array
        Navigation state: lat, lon, height, v_n, q_nb.
    C_nb : (3, 3) array
        Attitude the bias errors are turned by.
    f_n : (3,) array
        Specific force [m/s^2], n.
    """
    F = np.zeros((_TOP, CORE))
    dynamics_kernel(
        as_float("nav", nav, (10,)), as_float("C_nb", C_nb, (3, 3)), as_float("f_n", f_n, (3,)), F
    )
    return F
