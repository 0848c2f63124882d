"""The error state: its layout, its linear dynamics F, the transition over a step, and the feedback.

Errors are estimate minus truth: position in meters along n, velocity in n, and the attitude

    C_nb_est = exp([tilt x]) exp([heading x]) C_nb_true,   phi_n = (tilt_N, tilt_E, heading)

a turn about the vertical, then a tilt about a horizontal axis. F is the Jacobian of
`bench.navigation.mechanization`: A-5.1.10 in north, east, down and meters (equations 1.3: alpha_NED =
-phi_n), with the radii of the ellipsoid and their change with latitude.

To first order phi_n is a rotation vector; the order of the two turns counts where a heading is corrected. The
axes of the unit turn with the correction, and so does a tilt that is left: by all of the angle, not by half
of it as that of a rotation vector would. Tilts and biases of accelerometers are told apart by turns, so that
a covariance which stays as it is takes each correction for a turn that was flown (`corrections.axes_kernel`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from bench.core.compilation.compiled import inner, kernel
from bench.core.compilation.wide_rows import LANES, add_row, row_sums, scale_row, set_row, wide
from bench.core.mathematics import earth, rotation
from bench.core.mathematics.arrays import FloatArray, IntArray, as_float
from bench.core.mathematics.earth import EARTH_RATE, WGS84, gravity_gradient_kernel, radii_kernel
from bench.navigation.mechanization import tilt_between_kernel, turn_kernel

POS, VEL, PHI, GYRO, ACCEL = 0, 3, 6, 9, 12
"""First index of the blocks that every layout begins with."""
CORE = 15
CORE_BLOCKS = (
    ("pos", "m", 3),
    ("vel", "m_s", 3),
    ("phi", "rad", 3),
    ("gyro_bias", "rad_s", 3),
    ("accel_bias", "m_s2", 3),
)
"""Name, unit and size of these blocks."""
_TOP = 9  # states with dynamics of their own: position, velocity, attitude
_E2 = WGS84.e2

_BIASES = (9, 10, 11), (12, 13, 14)
ACTING = (
    (0, 2, 3, 7, 8, *_BIASES[1]),
    (0, 1, 2, 4, 6, 8, *_BIASES[1]),
    (5, 6, 7, *_BIASES[1]),
    (0, 2, 3, 4, 5, 7, 8, *_BIASES[0], *_BIASES[1]),
    (0, 2, 3, 4, 5, 6, 8, *_BIASES[0], *_BIASES[1]),
    (0, 2, 3, 4, 6, 7, *_BIASES[0], *_BIASES[1]),
    (0, 2, 4, 7, 8, *_BIASES[0]),
    (0, 2, 3, 6, 8, *_BIASES[0]),
    (0, 2, 4, 6, 7, *_BIASES[0]),
)
"""The states that act on each of the first nine over a step: the elements of G that are not always zero."""
add_transition = row_sums(ACTING, _TOP)
add_biases = row_sums([[k for k in row if k >= GYRO] for row in ACTING], _TOP)


@dataclass(frozen=True, slots=True)
class StateLayout:
    """Named blocks of an error state, in order; the indices of all states come from here.

    Examples
    --------
    >>> layout = StateLayout(("baro_bias", "m", 1))
    >>> layout.size, layout.slice("vel"), layout.slice("baro_bias")
    (16, slice(3, 6, None), slice(15, 16, None))
    """

    blocks: tuple[tuple[str, str, int], ...]  # (name, unit of its values, size)
    size: int = field(compare=False)  # number of states
    _places: dict[str, slice] = field(compare=False, repr=False)

    def __init__(self, *extra: tuple[str, str, int]) -> None:
        blocks = (*CORE_BLOCKS, *extra)
        ends = list(accumulate(size for _, _, size in blocks))
        places = {name: slice(end - size, end) for (name, _, size), end in zip(blocks, ends, strict=True)}
        for name, value in (("blocks", blocks), ("size", ends[-1]), ("_places", places)):
            object.__setattr__(self, name, value)

    def has(self, name: str) -> bool:
        """Return whether the layout has a block of this name."""
        return name in self._places

    def slice(self, name: str) -> slice:
        """Return the rows of a block.

        Raises
        ------
        KeyError
            If the layout has no such block.
        """
        if name in self._places:
            return self._places[name]
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
    """Fill F (9, 15): the rates of position, velocity and attitude errors by the core states.

    ``C`` is C_nb and ``f_n`` the specific force [m/s^2], n. Elements that are always zero are not written:
    F must hold zeros there.
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

    First order in F T; second order from gyro bias over tilt and velocity to position, where the first order
    is zero. Elements that are always zero are not written.
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


class CovarianceWork(NamedTuple):
    """Memory of :func:`covariance_kernel` and :func:`accumulate_kernel`, rows of whole vectors."""

    E: FloatArray  # (6, n) rows of the biases and of what acts like them; zeros in the first nine columns
    E_Phi: FloatArray  # (6, n) the same of an accumulated transition, whole
    A: FloatArray  # (9, n) the first nine rows of Phi P
    X: FloatArray  # (9, 15) of these the columns of the biases, twice, less what counts twice
    Y: FloatArray  # (6, 15) less the covariance of the biases
    B: FloatArray  # (15, 9) both, transposed
    B_low: FloatArray  # (6, 9) its rows from the biases on
    C: FloatArray  # (9, 9)


def covariance_work(n: int) -> CovarianceWork:
    """Return the memory for n states."""
    B, biases = wide((CORE, _TOP)), CORE - _TOP
    return CovarianceWork(
        E=wide((biases, n)),
        E_Phi=wide((biases, n)),
        A=wide((_TOP, n)),
        X=wide((_TOP, CORE)),
        Y=wide((biases, CORE)),
        B=B,
        B_low=B[_TOP:],
        C=wide((_TOP, _TOP)),
    )


@inner
def _bias_rows_kernel(P: FloatArray, drives: IntArray, factor: FloatArray, first: int, E: FloatArray) -> None:
    """Fill E (6, n) with rows 9 to 14 of P and the rows of the driving states, each by its factor."""
    for i in range(6):
        set_row(E, i, 1.0, P, GYRO + i, first, P.shape[1])
    for d in range(drives.shape[0]):
        add_row(E, drives[d, 1] - GYRO, factor[d], P, drives[d, 0], first, P.shape[1])


@kernel
def covariance_kernel(
    P: FloatArray,
    G: FloatArray,
    decay: FloatArray,
    noise: FloatArray,
    fading: int,
    drives: IntArray,
    factor: FloatArray,
    work: CovarianceWork,
) -> None:
    """Replace P (n, n) by Phi P Phi' + diag(noise), except in the first nine columns of rows 9 and on.

    Those are neither read nor written: :func:`mirror_kernel` fills them. Phi is I + G in its first nine rows
    and diag(decay) in the rest, 1 before the state ``fading``; a state ``drives[d, 0]`` acts on the first
    nine rows like the bias ``drives[d, 1]`` times ``factor[d]``. P and decay are
    `bench.core.compilation.wide_rows.wide`.

    With t the first nine states, e the biases and what acts like them, G = [T, U], A_t = (I + T) P_tt and
    A_e = (I + T) P_te + U P_ee:

        Phi P Phi'_tt = (C + C') / 2,  C = A_t (I + T)' + (2 A_e - U P_ee) U'

    so that only the upper part of P is needed. Row sums over the elements of G that are not always zero give
    A, and C' from the transposed columns.
    """
    E, A, X, Y, B, C = work.E, work.A, work.X, work.Y, work.B, work.C
    n, width = P.shape
    _bias_rows_kernel(P, drives, factor, 8, E)
    for i in range(6):
        E[i, 8] = 0.0  # below the first nine columns of P
        set_row(Y, i, -1.0, E, i, 8, 16)
    add_transition(P, G, P, E, A, 0, width)
    for i in range(9):
        set_row(X, i, 2.0, A, i, 8, 16)
        scale_row(P, i, 1.0, decay, A, i, 8, width)
    for d in range(drives.shape[0]):
        s, e, by = drives[d, 0], drives[d, 1], factor[d]
        for i in range(6):
            Y[i, e] -= by * E[i, s]
        for i in range(9):
            X[i, e] += 2.0 * by * A[i, s]
    add_biases(X, G, X, Y, X, 8, 16)
    for i in range(9):
        for j in range(9):
            B[j, i] = A[i, j]
        for j in range(9, 15):
            B[j, i] = X[i, j]
    add_transition(B, G, B, work.B_low, C, 0, 16)
    for i in range(9):
        for j in range(i):
            value = 0.5 * (C[i, j] + C[j, i])
            P[i, j] = value
            P[j, i] = value
        P[i, i] = C[i, i]
    for i in range(9, n):
        if fading < n:
            first = fading - fading % LANES if i < fading else 8
            scale_row(P, i, decay[i], decay, P, i, first, width)
    for i in range(n):
        P[i, i] += noise[i]


@kernel
def mirror_kernel(P: FloatArray) -> None:
    """Fill the elements that :func:`covariance_kernel` left out, because P is symmetric."""
    for i in range(9, P.shape[0]):
        for j in range(9):
            P[i, j] = P[j, i]


@kernel
def accumulate_kernel(
    Phi: FloatArray,
    G: FloatArray,
    decay: FloatArray,
    drives: IntArray,
    factor: FloatArray,
    work: CovarianceWork,
) -> None:
    """Replace Phi (n, n) by the transition of one more step times Phi; arguments as above."""
    _bias_rows_kernel(Phi, drives, factor, 0, work.E_Phi)
    add_transition(Phi, G, Phi, work.E_Phi, Phi, 0, Phi.shape[1])
    for i in range(9, Phi.shape[0]):
        set_row(Phi, i, decay[i], Phi, i, 0, Phi.shape[1])


@kernel
def backward_kernel(
    h: FloatArray, G: FloatArray, decay: FloatArray, drives: IntArray, factor: FloatArray, row: FloatArray
) -> None:
    """Replace h (n,) by h Phi^-1: the row of a measurement made before a step, for the errors after it.

    ``G`` is Phi^-1 - I in its first nine rows, from :func:`transition_kernel` with a negative interval;
    ``row`` (15,) is work memory.
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

    The state is a navigation state (10) and the values of the states from the gyro bias on. ``dx`` is set to
    zero: the remaining error has zero mean.
    """
    s, c = np.sin(state[0]), np.cos(state[0])
    meridian, prime = radii_kernel(s)
    state[0] -= dx[0] / (meridian + state[2])
    state[1] -= dx[1] / ((prime + state[2]) * c)
    state[2] += dx[2]
    for i in range(3):
        state[3 + i] -= dx[3 + i]
    turn_kernel(state, -dx[6], -dx[7], 0.0, True)
    turn_kernel(state, 0.0, 0.0, -dx[8], True)
    for i in range(GYRO, dx.shape[0]):
        state[i + 1] -= dx[i]
    for i in range(dx.shape[0]):
        dx[i] = 0.0


@kernel
def difference_kernel(state: FloatArray, other: FloatArray, d: FloatArray) -> None:
    """Fill d (n,) with the error state by which a filter state (n + 1,) differs from another."""
    earth.difference_kernel(state, other, d)
    for i in range(VEL, PHI):
        d[i] = state[i] - other[i]
    tilt_between_kernel(state, other, d[PHI:GYRO])
    for i in range(GYRO, d.shape[0]):
        d[i] = state[i + 1] - other[i + 1]


def dynamics(nav: ArrayLike, C_nb: ArrayLike, f_n: ArrayLike) -> FloatArray:
    """Return F (9, 15), the linear dynamics of position, velocity and attitude errors.

    Parameters
    ----------
    nav : (10,) array
        Navigation state: lat, lon, height, v_n, q_nb.
    C_nb : (3, 3) array
        Attitude that turns the bias errors from b to n.
    f_n : (3,) array
        Specific force [m/s^2], n.
    """
    F = np.zeros((_TOP, CORE))
    dynamics_kernel(
        as_float("nav", nav, (10,)), as_float("C_nb", C_nb, (3, 3)), as_float("f_n", f_n, (3,)), F
    )
    return F


def state_errors(state: FloatArray, truths: FloatArray) -> FloatArray:
    """Return the errors (..., n) of a filter state (n + 1,) if each of other states (..., n + 1) is true."""
    d = np.empty((*truths.shape[:-1], truths.shape[-1] - 1))
    d[..., POS:VEL] = -earth.difference_n(truths[..., :3], state[:3])
    d[..., VEL:PHI] = state[3:6] - truths[..., 3:6]
    turn = rotation.multiply(state[6:10], rotation.conjugate(truths[..., 6:10]))
    vertical = np.zeros_like(turn)
    vertical[..., ::3] = turn[..., ::3]
    vertical /= np.linalg.norm(vertical, axis=-1, keepdims=True)
    d[..., PHI:GYRO] = rotation.to_rotvec(rotation.multiply(turn, rotation.conjugate(vertical)))
    d[..., GYRO - 1] = rotation.to_rotvec(vertical)[..., 2]
    d[..., GYRO:] = state[10:] - truths[..., 10:]
    return d


def less_errors(state: FloatArray, d: FloatArray) -> FloatArray:
    """Return the truths (..., n + 1) if a filter state (n + 1,) has the errors d (..., n).

    What :func:`feedback_kernel` does; it undoes :func:`state_errors`.
    """
    moved = np.empty((*d.shape[:-1], d.shape[-1] + 1))
    moved[..., :3] = earth.displace(state[:3], -d[..., POS:VEL])
    moved[..., 3:6] = state[3:6] - d[..., VEL:PHI]
    tilt, heading = d[..., PHI:GYRO].copy(), np.zeros((*d.shape[:-1], 3))
    tilt[..., 2], heading[..., 2] = 0.0, d[..., PHI + 2]
    level = rotation.multiply(rotation.from_rotvec(-tilt), state[6:10])
    moved[..., 6:10] = rotation.multiply(rotation.from_rotvec(-heading), level)
    moved[..., 10:] = state[10:] - d[..., GYRO:]
    return moved
