"""Position and velocity from fixes alone, and a constant attitude, while the IMU provides no data."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bench.core.mathematics import earth, rotation
from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.core.records.data import Events, GnssFixes, ImuData, NavSolution, SensorData, no_innovations
from bench.core.records.sensor_specs import GnssSpec
from bench.navigation.engine import timeline
from bench.navigation.engine.kept_rows import join_rows, take_rows
from bench.navigation.engine.session import Kept, SessionState
from bench.navigation.error_state_filter.aiding_sensors import fix_variance, weigh_fixes
from bench.navigation.error_state_filter.rough_heading import UNKNOWN_HEADING_SD
from bench.navigation.error_state_filter.state_processes import assumed
from bench.navigation.options import FixAccuracy, GnssOnlyOptions
from bench.navigation.start.fix_track import FixTrack, unknown_arm

_HELD = ("q_nb", "gyro_bias_b", "accel_bias_b", "extra", "extra_sd")
_BRIEF = 0.1  # rate of decay from which on an error of the fixes is as good as white [1/s]
_TILT_SD = 0.5  # of an aircraft whose attitude is not known: banks of 30 deg are usual [rad]
_VIOLENT = GnssOnlyOptions(acceleration=15.0)  # of one that its IMU cannot follow: 3 g in all
_VIOLENT_RATE = 4.0  # and how fast it turns about each axis [rad/s]
_VIOLENT_SWING = 1.5  # that moves the antenna, as long as it coasts: 3 g at 20 m/s [rad/s]


class End(NamedTuple):
    """The last answer of a filter."""

    t: float  # [s]
    lla: FloatArray  # (3,)
    vel_n: FloatArray  # (3,)
    q_nb: FloatArray  # (4,)
    cov: FloatArray  # (9, 9)
    gyro_bias_b: FloatArray  # (3,)
    accel_bias_b: FloatArray  # (3,)
    extra: FloatArray  # (n,)
    extra_sd: FloatArray  # (n,)


def lost_at(t: float, end: End) -> End:
    """Return the end of a filter that diverged at a time [s], with a large attitude sigma only."""
    none, cov = np.full(3, np.nan), np.full((9, 9), np.nan)
    cov[6:, 6:] = np.diag(np.square([_TILT_SD, _TILT_SD, UNKNOWN_HEADING_SD]))
    return end._replace(t=t, lla=none, vel_n=none, cov=cov)


class Coast(SessionState):
    """Continues the answers of a filter from fixes alone, in order of time.

    ``head`` has datasheets and antenna, ``names`` are those of the further states of the filter, which are
    held, and ``accuracy`` is how it weighs fixes.
    """

    end: Kept[End]
    offset: Kept[FloatArray]  # (6,) variance of what all fixes have in common
    _names: Kept[tuple[str, ...]]
    _accuracy: Kept[FixAccuracy]
    _gnss: Kept[GnssSpec]  # as assumed
    _total: Kept[FloatArray]  # (6,) variance of a fix
    _white: Kept[FloatArray]  # (6,) its white part
    _antenna_b: Kept[FloatArray]  # (3,) it follows the antenna
    _arm: Kept[FloatArray]  # (6,) variance of that about the IMU
    _beyond: Kept[bool]  # it moves beyond the range of the IMU
    _used: Kept[bool]  # a fix
    _fixes: Kept[GnssFixes | None]  # not yet used
    _track: Kept[FixTrack | None]

    def __init__(self, head: SensorData, end: End, names: tuple[str, ...], accuracy: FixAccuracy) -> None:
        self.end, self._names, self._accuracy = end, names, accuracy
        self._gnss = gnss = assumed(head.specs, "gnss")
        self._total = fix_variance(gnss, gnss_markov=False)
        self._white = np.where(lasts(gnss, end.vel_n), fix_variance(gnss, gnss_markov=True), self._total)
        self.offset = self._total - self._white
        self._antenna_b, self._arm = head.antenna_b, unknown_arm(head.antenna_b)
        self._beyond, self._used = False, False
        self._fixes, self._track = None, None
        if np.isfinite(np.concatenate([end.lla, end.vel_n, end.q_nb, end.cov[:6, :6].ravel()])).all():
            antenna = earth.displace(end.lla, rotation.rotate(end.q_nb, head.antenna_b))
            cov = end.cov[:6, :6] + np.diag(self.offset)  # as the fixes will see it
            self._track = FixTrack(self._options, end.t, antenna, end.vel_n, cov)

    @property
    def _options(self) -> GnssOnlyOptions:
        """Return the options for maneuvers, by whether the motion is beyond the range of the IMU."""
        return _VIOLENT if self._beyond else GnssOnlyOptions()

    def go_beyond(self) -> None:
        """Switch to the model for motion beyond the range of the IMU: a roll, a spin, a steep turn."""
        self._beyond = True
        self._arm = unknown_arm(self._antenna_b, _VIOLENT_SWING)
        if self._track is not None:
            self._track.expect(_VIOLENT)

    def take(self, fixes: GnssFixes) -> None:
        """Take the next fixes, in the order of their arrival."""
        self._fixes = fixes if self._fixes is None else join_rows(self._fixes, fixes)

    def at(self, t: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return position (3,), velocity (3,) and covariance (9, 9) at a time, in order of time."""
        if self._fixes is not None:
            self._use(int(np.searchsorted(self._fixes.t_arrival, t + timeline.TIME_TOLERANCE, side="right")))
        cov = np.full((9, 9), np.nan)
        if self._track is None:
            return np.full(3, np.nan), np.full(3, np.nan), cov
        ((state,), (P,)) = self._track.at([t])
        offset = self.offset if self._used else -self.offset
        cov[:6, :6], cov[:6, 6:], cov[6:, :6] = P[:6, :6] + np.diag(self._arm + offset), 0.0, 0.0
        elapsed = np.array([t - self.end.t])
        turned = timeline.bridge_variance(elapsed, np.zeros((1, 2)))[0, 1]
        most = np.square([_TILT_SD, _TILT_SD, UNKNOWN_HEADING_SD])
        if self._beyond:  # upside down as well
            turned, most = turned + (_VIOLENT_RATE * elapsed[0]) ** 2, np.full(3, UNKNOWN_HEADING_SD**2)
        held = np.diag(self.end.cov)[6:]
        cov[6:, 6:] = np.diag(np.maximum(held, np.minimum(held + turned, most)))
        return state[:3], state[3:6], cov

    def _use(self, count: int) -> None:
        """Use the first pending fixes."""
        assert self._fixes is not None
        used, self._fixes = (take_rows(self._fixes, rows) for rows in (slice(count), slice(count, None)))
        r = np.maximum(weigh_fixes(used, self._gnss, self._total, self._accuracy) - self.offset, self._white)
        self._used = self._used or count > 0
        for k in range(count):
            if self._track is None:
                self._track = FixTrack.begin(
                    self._options, float(used.t[k]), used.lla[k], used.vel_n[k], r[k]
                )
            else:
                self._track.run(used, np.array([k]), r, np.zeros(1, np.int64), np.empty(0))

    def answers(self, t: FloatArray) -> NavSolution:
        """Return the answers at epochs t (M,), in order of time, with the innovations since the last."""
        m, end = len(t), self.end
        lla, vel_n, cov = np.empty((m, 3)), np.empty((m, 3)), np.empty((m, 9, 9))
        for k in range(m):
            lla[k], vel_n[k], cov[k] = self.at(float(t[k]))
        return NavSolution(
            t=t,
            lla=lla,
            vel_n=vel_n,
            cov=cov,
            extra_names=self._names,
            innovations=self._track.take_innovations() if self._track else no_innovations(),
            events=Events.from_rows([]),
            **{name: np.tile(getattr(end, name), (m, 1)) for name in _HELD},
        )


def violent(imu: ImuData) -> bool:
    """Return whether the specific force of a valid sample exceeds 2 g: `Coast.go_beyond` applies."""
    force = np.linalg.norm(imu.dvel_b[imu.valid], axis=1) / imu.dt[imu.valid]
    return bool((force > 2.0 * STANDARD_GRAVITY).any())


def lasts(gnss: GnssSpec, vel_n: FloatArray) -> BoolArray:
    """Return the correlated errors (6,) of fixes that a track of a few seconds cannot average out."""
    speed = float(np.nan_to_num(np.linalg.norm(vel_n)))
    pos, vel = gnss.pos_decay_time + gnss.pos_decay_distance * speed, gnss.vel_decay_time
    return np.repeat([pos < _BRIEF, vel < _BRIEF], 3)


def fresh_fixes(fixes: GnssFixes, newest: float) -> tuple[GnssFixes, float]:
    """Return the sound fixes newer than all before, in the order of their arrival, and the newest time [s].

    ``newest`` is the latest validity of a sound fix before.
    """
    if not len(fixes):
        return fixes, newest
    sound = fixes.valid & np.isfinite(fixes.t) & np.isfinite(fixes.t_arrival)
    sound &= np.isfinite(fixes.lla).all(axis=1)
    rows, _ = timeline.fresh_rows(fixes.t, fixes.t_arrival, sound, "gnss", newest)
    return fixes.take(rows), max(newest, float(fixes.t[sound].max(initial=-np.inf)))
