"""The mechanizations and attitude algorithms by name, behind one call: :func:`navigate`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray, as_float
from bench.navigation import mechanization
from bench.navigation.models.classic.navigator import FRD_OF_FUR
from bench.plugins.papers.mechanizations.attitude import make_attitude
from bench.plugins.papers.mechanizations.coning import step_increments
from bench.plugins.papers.mechanizations.earth_series import EarthModel
from bench.plugins.papers.mechanizations.triads import Ecef, Enu, Inertial, Nhe, Triad, WanderAzimuth
from bench.plugins.papers.mechanizations.vectors import ZERO, add, cross, scale

FRAMES: dict[str, type[Triad]] = {
    "nhe": Nhe,
    "enu": Enu,
    "wander-azimuth": WanderAzimuth,
    "ecef": Ecef,
    "inertial": Inertial,
}


class Rates(NamedTuple):
    """Rates of the tasks of the three-rate mechanization (A-2.2.6 to A-2.2.14); None: every sample."""

    fast: float | None = None
    """Attitude [Hz]."""
    medium: float | None = None
    """Velocity [Hz]."""
    slow: float | None = None
    """Position, rates of the frame, radii and gravity [Hz]."""
    lead: bool = True
    """Take the slow figures at the middle of their interval, by the interval before; False: at its start."""


class IntervalMotion(NamedTuple):
    """Motion at the end of each slow interval, the start first."""

    t: FloatArray
    """(M,) since the start [s]."""
    nav: FloatArray
    """(M, 10) lat, lon [rad], height [m], velocity [m/s] north, east, down, q_nb."""


def navigate(
    name: str,
    start: ArrayLike,
    interval: float,
    dtheta_b: ArrayLike,
    dvel_b: ArrayLike,
    *,
    rates: Rates = Rates(),  # noqa: B008 - immutable
    attitude: str = "rotation-vector",
    earth: EarthModel = EarthModel(),  # noqa: B008
) -> IntervalMotion:
    """Return the motion of a free inertial navigator.

    Parameters
    ----------
    name : str
        A key of :data:`FRAMES`; "ned" is the compiled mechanization of the filters, at every sample.
    start : (10,) array
        A row of :attr:`IntervalMotion.nav`.
    interval : float
        Between samples [s].
    dtheta_b, dvel_b : (N, 3) arrays
        Increments of the samples [rad], [m/s]; body forward, right, down.
    rates : Rates
        Of the three tasks. The samples in an attitude step, 1 to 4, correct coning and sculling of the
        rotation vector; the other attitudes take their sum.
    attitude : str
        One of `attitude.ATTITUDES`.
    earth : EarthModel
        Radii and gravity.

    Raises
    ------
    ValueError
        If a name is unknown, a rate does not divide the one before, or the increments do not fill the slow
        intervals.
    """
    nav = as_float("start", start, (10,))
    dtheta, dvel = as_float("dtheta_b", dtheta_b, (None, 3)), as_float("dvel_b", dvel_b, (None, 3))
    if name == "ned":
        return _navigate_ned(nav, interval, dtheta, dvel, rates, attitude, earth)
    if name not in FRAMES:
        raise ValueError(f"no mechanization {name!r}; choose from ned, {', '.join(FRAMES)}")
    fast, medium, slow = _divide(interval, rates)
    if len(dtheta) % (fast * medium * slow):
        raise ValueError(
            f"{len(dtheta)} samples do not fill slow intervals of {fast * medium * slow}; give a multiple"
        )
    frame = FRAMES[name](nav, earth, lead=rates.lead)
    body = make_attitude(attitude, frame.C, frame.to_nhe)
    corrected = attitude == "rotation-vector"
    theta, dv = step_increments(dtheta @ FRD_OF_FUR, dvel @ FRD_OF_FUR, fast, corrected=corrected)
    T = interval * fast
    T_medium, T_slow = T * medium, T * medium * slow
    places: list[tuple[float, ...]] = []
    C_nb: list[FloatArray] = []
    fallen = ZERO
    turned = scale(frame.w_in, T)
    for k, turn in enumerate(theta.tolist(), start=1):
        x, y, z = (body.C @ dv[k - 1]).tolist()
        felt = (x, y, z)
        fallen = add(fallen, add(felt, cross(turned, felt), -0.5))  # the triad turns meanwhile
        body.step(turn, turned)
        if k % medium == 0:
            frame.accelerate(fallen, T_medium)
            fallen = ZERO
            if k % (medium * slow) == 0:
                frame.move(T_slow)
                turned = scale(frame.w_in, T)
                lla, vel_n, to_n = frame.read()
                places.append((*lla, *vel_n))
                C_nb.append(to_n @ body.C)
    q_nb = rotation.from_matrix(np.reshape(C_nb, (-1, 3, 3)) @ FRD_OF_FUR.T)
    out = np.vstack([nav, np.hstack([np.reshape(places, (-1, 6)), q_nb])])
    return IntervalMotion(T_slow * np.arange(len(out), dtype=float), out)


def _divide(interval: float, rates: Rates) -> tuple[int, int, int]:
    """Return samples per attitude step, attitude steps per velocity step, velocity steps per slow step."""
    counts, before, of = [], 1.0 / interval, "IMU"
    for task, rate in zip(("fast", "medium", "slow"), rates[:3], strict=True):
        rate = before if rate is None else rate
        count = round(before / rate) if rate > 0 else 0
        if count < 1 or abs(count * rate - before) > 1e-6 * before:
            raise ValueError(f"the {task} rate, {rate:g} Hz, must divide the rate of the {of}, {before:g} Hz")
        counts.append(count)
        before, of = rate, f"{task} task"
    return counts[0], counts[1], counts[2]


def _navigate_ned(
    nav: FloatArray,
    interval: float,
    dtheta: FloatArray,
    dvel: FloatArray,
    rates: Rates,
    attitude: str,
    earth: EarthModel,
) -> IntervalMotion:
    if rates != Rates() or attitude != "rotation-vector" or earth != EarthModel():
        raise ValueError(
            "ned has one rate, the rotation vector, and exact radii and gravity of WGS 84; choose nhe or enu "
            "for others"
        )
    n = len(dtheta)
    out = mechanization.propagate(nav[:3], nav[3:6], nav[6:10], np.full(n, interval), dtheta, dvel)
    return IntervalMotion(interval * np.arange(n + 1, dtype=float), out)
