"""Initial alignment: estimate the missing part of the initial state from the sensors.

``level``, at rest: roll and pitch from the mean specific force, heading from the mean rate of the gyros
(gyrocompassing). With db the accelerometer and dw the gyro error, resolved in n,

    phi_N = -db_E / g      phi_E = db_N / g      phi_D = -dw_E / (w_ie cos lat) - phi_N tan lat

(equations 10: heading sd 0.59 deg for 0.1 deg/h at 50 deg). ``course``, moving: heading is the course of the
last fix of a segment, roll and pitch are those that make the strapdown gain the velocity the fixes gained
(fixes without velocity: the mean velocity between two of them, at both ends of the segment);
with F the mean specific force in n and e the error of the gain over its time,

    phi_E = (e_N + phi_D F_E) / F_D      phi_N = (phi_D F_N - e_E) / F_D

``motion``, for restarts, does the same over a few seconds at any speed. Its heading is unknown: it is the
course, or north below 5 m/s, with a sd of `UNKNOWN_HEADING_SD`. `headings` tries all headings; its hypotheses
turn the tilt with the heading by the covariance of both.

The covariances hold the biases, noise and misalignments of the datasheet; ``bias_cov`` is the covariance of
attitude and biases. Without it the filter treats tilt and accelerometer bias as independent, and halves the
tilt variance at the first zero-velocity update, which observed nothing new. What follows when the heading is
unknown: `headings`.
"""

from __future__ import annotations

import numpy as np

from bench.core.records.data import InitialState, SensorData
from bench.core.words.exceptions import EstimatorError
from bench.navigation.engine.record_cuts import newest_sample
from bench.navigation.engine.session import Kept, SessionState
from bench.navigation.start.course import align_on_the_move
from bench.navigation.start.leveling import Rows, align_at_rest

SETTLED = 2.0  # time after an alignment until which the record may still change it [s]
UNKNOWN_SPEED_SD = 300.0  # of a velocity that may be any, each axis: above the airspeed of airliners [m/s]


def complete(sensors: SensorData, initial: InitialState) -> tuple[InitialState, Rows]:
    """Return a complete initial state, and the events that describe how it was found.

    Parameters
    ----------
    sensors : SensorData
        The record; only data that has arrived by the end of the alignment is used. The end of a standstill
        shows only in the next window or fix, so the filter starts up to a second late.
    initial : InitialState
        ``alignment`` says what has to be found; "given" is returned unchanged.

    Returns
    -------
    initial : InitialState
        At the end of the alignment.
    events : list of (t, t_end, kind, text)
        One "alignment" event; none if the whole state is given.

    Raises
    ------
    EstimatorError
        If the record does not allow the alignment.
    """
    if initial.alignment == "given":
        return initial, []
    if initial.alignment == "level":
        return align_at_rest(sensors, initial)
    if initial.alignment in ("course", "motion"):
        return align_on_the_move(sensors, initial)
    raise EstimatorError(f"alignment = {initial.alignment!r} must be 'given', 'level', 'course' or 'motion'")


class StartSearch(SessionState):
    """Search for an initial alignment in a record that still grows; ``initial`` is as in :func:`complete`."""

    initial: Kept[InitialState]
    tried: Kept[float]  # last sample when it was looked for last [s]

    def __init__(self, initial: InitialState) -> None:
        self.initial, self.tried = initial, -np.inf

    def find(self, record: SensorData, look_back: float, *, last: bool) -> tuple[InitialState, Rows] | None:
        """Return the result of :func:`complete` for the record so far; None while more data may change it.

        Parameters
        ----------
        record : SensorData
            All that has come.
        look_back : float
            Longest time from the validity of a measurement to its arrival [s].
        last : bool
            No more comes.

        Raises
        ------
        EstimatorError
            If the record does not allow the alignment, whatever comes.
        """
        initial, newest = self.initial, newest_sample(record)
        enough = self.tried + SETTLED
        if initial.alignment == "level":
            enough = initial.t + initial.align_for + SETTLED + look_back
        if not last and newest < enough:
            return None
        self.tried = newest
        try:
            found = complete(record, initial)
        except EstimatorError:
            if last or initial.alignment == "level":
                raise
            return None
        return found if last or newest >= found[0].t + SETTLED + look_back else None
