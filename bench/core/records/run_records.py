"""Records around the data of a filter: true sensor errors, references, and errors of solutions.

Frames and units are those of `bench.core.records.data`. No filter gets any of these.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray, as_float, read_only
from bench.core.records.data import Events, InitialState, NavSolution, SensorData, Trajectory
from bench.core.records.fields import Rebuilt, Record, column, declared, freeze_field, vector
from bench.core.records.instruments import INSTRUMENTS


@declared
class SensorTruth(Record):
    """Slowly varying errors drawn by the sensor models; for the recording and the report, not for filters."""

    t: FloatArray = column("t_s")  # (B,) [s]
    gyro_bias_b: FloatArray = vector("gyro_bias", "rad_s", "b")  # (B, 3)
    accel_bias_b: FloatArray = vector("accel_bias", "m_s2", "b")  # (B, 3)
    bias: Mapping[str, FloatArray] = field(default_factory=dict)
    """Name of an instrument on board -> its slowly varying error (B, k), in its unit and frame."""

    def __post_init__(self) -> None:
        self._freeze()
        shaped = {
            name: as_float(f"SensorTruth.bias[{name!r}]", values, (len(self.t), INSTRUMENTS[name].width))
            for name, values in self.bias.items()
        }
        object.__setattr__(self, "bias", {name: read_only(values) for name, values in shaped.items()})


def no_sensor_truth() -> SensorTruth:
    """Return a table without rows, for real sensors with unknown errors."""
    return SensorTruth(np.empty(0), np.empty((0, 3)), np.empty((0, 3)))


@declared
class SkyView(Record):
    """Satellites above the elevation mask of a measurement-level receiver, received or not.

    A row per epoch and satellite. For the recording and the report, not for filters.
    """

    t: FloatArray = column("t_s")  # (K,) [s]
    system: IntArray = column("system", kind=int)  # (K,) code of `bench.core.records.orbit_sets`
    sat: IntArray = column("sat", kind=int)  # (K,) number within its system
    azimuth: FloatArray = column("azimuth_rad", frame="n")  # (K,) [rad]
    elevation: FloatArray = column("elevation_rad", frame="n")  # (K,) [rad]
    cn0: FloatArray = column("cn0_dbhz")  # (K,) on the first carrier [dB-Hz]; NaN if not received
    used: BoolArray = column("used", kind=bool)  # (K,) in the fix of the epoch


@dataclass(frozen=True, slots=True, repr=False)
class Sensed(Rebuilt):
    """Simulated sensors of one run, from `bench.sense`.

    Attributes
    ----------
    data : SensorData
        Input of the filters.
    initial : InitialState
        Their initial state.
    truth : SensorTruth
        True sensor errors, which no filter gets.
    events : Events
        Outages and faults of this run.
    sky : SkyView or None
        Satellites in view of a measurement-level receiver.

    Examples
    --------
    >>> import bench
    >>> sensed = bench.sense("approach", bench.fly("approach"), run=3)
    >>> sensed.truth.gyro_bias_b.shape[1]
    3
    """

    data: SensorData
    initial: InitialState
    truth: SensorTruth
    events: Events
    sky: SkyView | None = None


@dataclass(frozen=True, slots=True, repr=False)
class Reference(Rebuilt):
    """Motion of a log from another system, for evaluation; no filter gets it."""

    track: NavSolution  # of its own point at its own times; a block that it does not have is NaN
    point_b: FloatArray  # (3,) that point relative to the IMU [m], b

    def __post_init__(self) -> None:
        freeze_field(self, "point_b", float, (3,), finite=True)


@declared
class ErrorSeries(Record):
    """Errors of a solution, estimate minus truth.

    Attributes
    ----------
    t : ndarray, (M,)
        Time [s].
    pos_n, vel_n : ndarray, (M, 3)
        Position [m] and velocity [m/s] error, n.
    phi_n : ndarray, (M, 3)
        Attitude error [rad], n: C_nb_est = exp([phi_n x]) C_nb_true.
    heading : ndarray, (M,)
        Heading error in -pi to pi [rad].
    nees : ndarray, (M,)
        NEES of the estimated blocks; NaN where the covariance is not positive definite.
    states : int
        Number of states in ``nees``.
    """

    t: FloatArray = column("t_s")
    pos_n: FloatArray = vector("pos_err", "m", "n")
    vel_n: FloatArray = vector("vel_err", "mps", "n")
    phi_n: FloatArray = vector("phi", "rad", "n")
    heading: FloatArray = column("heading_err_rad")
    nees: FloatArray = column("nees")
    states: int


@declared
class OffPath(Record):
    """Path deviation of a flight guided by an estimate; NaN without a path."""

    t: FloatArray = column("t_s")  # (M,) [s]
    right: FloatArray = column("right_m")  # (M,) of the truth, to the right of the path [m]
    above: FloatArray = column("above_m")  # (M,) [m]
    course: FloatArray = column("course_rad")  # (M,) direction of the path there [rad]


ShowFlight = Callable[[Trajectory, NavSolution | None], object]
"""Is given each piece of a flight as it is flown, and the estimate at its end if one flies it."""
