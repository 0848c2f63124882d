"""Predicted drift of an unaided INS in closed form, from the values of a datasheet.

The horizontal channel of an INS is a pendulum with the Schuler period of 84.4 minutes, ``w^2 = g / R``::

    accelerometer bias b_a, tilt a    (b_a + g a) (1 - cos wT) / w^2       T^2 / 2 for small T
    gyro bias b_g                     R b_g (T - sin(wT) / w)              g T^3 / 6
    velocity error dv                 dv sin(wT) / w                       dv T
    accelerometer white noise N_a     N_a sqrt(T/2 - sin(2wT)/(4w)) / w    N_a sqrt(T^3 / 3)
    gyro white noise N_g              g N_g sqrt(3T/2 - 2 sin(wT)/w + sin(2wT)/(4w)) / w^2

Accelerometer errors and tilt are bounded by the pendulum; a gyro bias moves the position on and on. The first
two are A-2.4.4 and A-2.4.7 of the equations; the noise terms are the integrals of their impulse responses.
A bias turns with the vehicle, so that circles cancel much of it: with the headings of the flight, the first
two are the integrals of their impulse responses along them. Scale factors, misalignments and the vertical
channel are not included.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal

import numpy as np

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.core.records.sensor_specs import ImuSpec
from bench.evaluation.metrics.case import Case, find_outage_rows

RADIUS = 6_371_000.0  # mean radius of the Earth [m]
SCHULER = math.sqrt(STANDARD_GRAVITY / RADIUS)  # [rad/s]
RAYLEIGH_MEDIAN = math.sqrt(2.0 * math.log(2.0))
"""Median of the length of a normal horizontal error, over its standard deviation by axis [1]."""
RAYLEIGH_95 = math.sqrt(-2.0 * math.log(0.05))
"""95 % quantile of the length of a normal horizontal error, over its standard deviation by axis [1]."""
HORIZONTAL = (
    *("gnss", "pseudorange", "range_rate", "airspeed"),
    *("odometer", "zero", "standstill", "nonholonomic"),
)
"""How the names of updates begin that limit the horizontal drift."""
_CLAIMED = 0.2  # least reported error of an unaided filter, over the law [1]


def accel_bias_drift(T: float) -> float:
    """Return the horizontal drift per accelerometer bias after a time T [s] without aiding [m per m/s^2]."""
    return 2.0 * math.sin(0.5 * SCHULER * T) ** 2 / SCHULER**2


def gyro_bias_drift(T: float) -> float:
    """Return the horizontal drift per gyro bias after a time T [s] without aiding [m per rad/s]."""
    return RADIUS * (T - math.sin(SCHULER * T) / SCHULER)


def tilt_drift(T: float) -> float:
    """Return the horizontal drift per tilt at the start after a time T [s] without aiding [m per rad]."""
    return STANDARD_GRAVITY * accel_bias_drift(T)


def velocity_drift(T: float) -> float:
    """Return the horizontal drift per velocity error at the start after a time T [s] [m per m/s]."""
    return math.sin(SCHULER * T) / SCHULER


def accel_noise_drift(T: float) -> float:
    """Return the horizontal drift per velocity random walk after a time T [s] [m per m/s/sqrt(s)]."""
    x = SCHULER * T
    return math.sqrt(max(0.5 * x - 0.25 * math.sin(2 * x), 0.0) / SCHULER**3)


def gyro_noise_drift(T: float) -> float:
    """Return the horizontal drift per angular random walk after a time T [s] [m per rad/sqrt(s)]."""
    x = SCHULER * T
    grown = max(1.5 * x - 2.0 * math.sin(x) + 0.25 * math.sin(2 * x), 0.0)
    return STANDARD_GRAVITY * math.sqrt(grown / SCHULER**5)


def drift_sd(
    T: float,
    imu: ImuSpec,
    *,
    heading: FloatArray | None = None,
    calibrated: bool = True,
    position: float = 0.0,
    velocity: float = 0.0,
    tilt: float = 0.0,
) -> float:
    """Return the standard deviation by axis of the horizontal drift of an unaided INS [m].

    Parameters are those of :func:`split_drift`.
    """
    parts = split_drift(
        T, imu, heading=heading, calibrated=calibrated, position=position, velocity=velocity, tilt=tilt
    )
    return math.hypot(*parts.values())


def split_drift(
    T: float,
    imu: ImuSpec,
    *,
    heading: FloatArray | None = None,
    calibrated: bool = True,
    position: float = 0.0,
    velocity: float = 0.0,
    tilt: float = 0.0,
) -> dict[str, float]:
    """Return the standard deviation by axis of the horizontal drift of an unaided INS by its source [m].

    Parameters
    ----------
    T : float
        Time without aiding [s].
    imu : ImuSpec
        The datasheet: bias instabilities and white noise; the turn-on biases as well if not ``calibrated``.
    heading : (K,) array or None
        Headings at even steps over that time [rad]; None: constant.
    position, velocity, tilt : float
        Standard deviations by axis at the start [m], [m/s], [rad].
    """
    w, x = SCHULER, SCHULER * T
    accel, gyro = imu.accel.averaged(), imu.gyro.averaged()
    b_a, b_g = accel.bias_instability, gyro.bias_instability
    if not calibrated:
        b_a, b_g = math.hypot(b_a, accel.turn_on_bias_sd), math.hypot(b_g, gyro.turn_on_bias_sd)
    by_accel, by_gyro = accel_bias_drift(T), gyro_bias_drift(T)
    if heading is not None and len(heading) > 1:
        left = x * np.linspace(1.0, 0.0, len(heading))  # phase of the pendulum that is left at each step
        turn = np.exp(1j * heading)
        by_accel = abs(np.trapezoid(np.sin(left) / w * turn, dx=T / (len(heading) - 1)))
        by_gyro = abs(np.trapezoid(RADIUS * (1.0 - np.cos(left)) * turn, dx=T / (len(heading) - 1)))
    return {
        "position": position,
        "velocity": abs(velocity * velocity_drift(T)),
        "tilt": tilt * tilt_drift(T),
        "accelerometer bias": b_a * by_accel,
        "gyro bias": b_g * by_gyro,
        "accelerometer noise": accel.random_walk * accel_noise_drift(T),
        "gyro noise": gyro.random_walk * gyro_noise_drift(T),
    }


def _radii(sd: float) -> dict[str, float | None]:
    """Return the root mean square and the 95 % radius of a horizontal error with this sd by axis [m]."""
    return {"rms": math.sqrt(2.0) * sd, "95": RAYLEIGH_95 * sd}


def _is_unaided(case: Case) -> bool:
    return not any(name.startswith(HORIZONTAL) for name in case.nis)


def headings(case: Case, first: int, last: int) -> FloatArray | None:
    """Return estimated headings (K,) between two rows, about one a second [rad]; None if one is missing."""
    count = max(2, round(float(case.t[last] - case.t[first])) + 1)
    rows = first + np.round(np.linspace(0, last - first, count)).astype(np.int64)
    heading = rotation.to_euler(case.solution.q_nb[rows])[2]
    return heading if np.isfinite(heading).all() else None


def outage_drift(case: Case) -> dict[str, float]:
    """Horizontal error at the last epoch of each outage [m]."""
    return {key: float(np.hypot(*case.pos_n[last, :2])) for key, (_, last) in find_outage_rows(case).items()}


def outage_growth(case: Case) -> dict[str, float]:
    """Growth of the horizontal error over each outage: length of (last minus first error) [m]."""
    return {
        key: float(np.hypot(*(case.pos_n[last, :2] - case.pos_n[first, :2])))
        for key, (first, last) in find_outage_rows(case).items()
    }


def outage_law(radius: Literal["rms", "95"], case: Case) -> Mapping[str, float | None]:
    """Growth in each outage by datasheets, or by the covariance if more [m]: rms and 95 % radius.

    From the datasheet of the IMU, with a perfect start but for the slow velocity error of the receiver, which
    no filter tells from the motion; or the growth that the filter reports, if that is more: no flight shows
    every bias and tilt before an outage.
    """
    if case.assumed is None or _is_unaided(case):
        return {}
    gnss = case.assumed.gnss
    velocity = 0.0 if gnss is None else gnss.vel_markov_sd
    found: dict[str, float | None] = {}
    for key, (first, last) in find_outage_rows(case).items():
        T, heading = float(case.t[last] - case.t[first]), headings(case, first, last)
        law = drift_sd(T, case.assumed.imu, heading=heading, velocity=velocity)
        begin, end = np.square(case.sd[[first, last], :2]).mean(axis=1)
        found[key] = _radii(math.sqrt(np.fmax(law**2, end - begin)))[radius]
    return found


def inertial_law(case: Case) -> Mapping[str, float | None]:
    """Horizontal error that the datasheets give for an end without aiding [m]: rms and 95 % radius.

    With the turn-on biases and the errors at the start that the filter reports there. Absent if
    the horizontal error that the filter reports at the end is far smaller: it is aided, but does not say by
    what.
    """
    start = case.start
    if case.assumed is None or not _is_unaided(case):
        return {}
    variance = np.diag(start.cov[0])
    sd = np.sqrt(np.where(np.isfinite(variance), variance, 0.0))
    position, velocity, tilt = (float(np.sqrt(np.mean(sd[k : k + 2] ** 2))) for k in (0, 3, 6))
    law = drift_sd(
        float(case.t[-1] - start.t[0]),
        case.assumed.imu,
        heading=headings(case, 0, len(case.t) - 1),
        calibrated=False,
        position=position,
        velocity=velocity,
        tilt=tilt,
    )
    if not np.hypot(*case.sd[-1, :2]) > _CLAIMED * law:
        return {}
    return _radii(law)


def inertial_end(case: Case) -> Mapping[str, float | None]:
    """Horizontal error at the end of a run without horizontal aiding [m]."""
    return {"": float(np.hypot(*case.pos_n[-1, :2]))} if inertial_law(case) else {}
