"""Initial alignment: what an estimator does before it can start where it was not told all of its state.

``level``, at rest: roll and pitch from the mean specific force, heading from the mean rate of the gyros
(gyrocompassing). With db the accelerometer and dw the gyro error, resolved in n,

    phi_N = -db_E / g      phi_E = db_N / g      phi_D = -dw_E / (w_ie cos lat) - phi_N tan lat

(section 10: heading sd 0.59 deg for 0.1 deg/h at 50 deg). ``course``, moving: heading is the course of the
last fix of a stretch, roll and pitch are those that make the strapdown gain the velocity the fixes gained
(fixes without velocity: the mean velocity between two of them, at both ends of the stretch);
with F the mean specific force in n and e the error of the gain over its time,

    phi_E = (e_N + phi_D F_E) / F_D      phi_N = (phi_D F_N - e_E) / F_D

The covariances hold the datasheet's biases, noise and misalignments, ``bias_cov`` what an attitude has in
common with the biases that made it: a filter told of both as strangers would halve the variance of the tilt
as soon as it sees the aircraft stand, and the tilt would not have moved. Where the heading is unknown the two
stay strangers all the same: what they have in common along n would not turn with the heading that is found.
"""

from __future__ import annotations

from bench.data import InitialState, SensorData
from bench.errors import EstimatorError
from bench.navigation.course import align_on_the_move
from bench.navigation.leveling import Rows, align_at_rest

UNKNOWN_SPEED_SD = 300.0  # of a velocity that may be any, each axis: above the airspeed of airliners [m/s]


def complete(sensors: SensorData, initial: InitialState) -> tuple[InitialState, Rows]:
    """Return a start that says all of position, velocity and attitude, and what was done to get it.

    Parameters
    ----------
    sensors : SensorData
        The record; only what has arrived by the end of the alignment is used. That a standstill is over shows
        in the window or the fix that follows: the first second is that of a filter that waits for them.
    initial : InitialState
        ``alignment`` says what is to be found; "given" is returned as it is.

    Returns
    -------
    initial : InitialState
        At the end of the alignment.
    events : list of (t, t_end, kind, text)
        One "alignment" event, none when all was given.

    Raises
    ------
    EstimatorError
        When the record does not allow it, in one line.
    """
    if initial.alignment == "given":
        return initial, []
    if initial.alignment == "level":
        return align_at_rest(sensors, initial)
    if initial.alignment == "course":
        return align_on_the_move(sensors, initial)
    raise EstimatorError(f"alignment = {initial.alignment!r} must be 'given', 'level' or 'course'")
