"""The initial state for the estimators of a recording: what the log gives, and nothing more."""

from __future__ import annotations

import numpy as np

from bench import earth
from bench.config.log import LogSpec
from bench.data import InitialState
from bench.errors import ConfigError
from bench.exchange.log_records import LogRecords
from bench.navigation.start.alignment import UNKNOWN_SPEED_SD
from bench.rotation import from_euler, matrix


def find_start(recording: LogRecords, spec: LogSpec) -> InitialState:
    """Return the initial state at or after ``[alignment] at_s``; unknowns are NaN with infinite variance.

    "given": position and velocity of the first usable fix, corrected for the lever arm, and the attitude of
    the log; if no fix has a velocity, zero with a large variance. "level": the position of that fix, with the
    length of the lever arm as additional uncertainty. "course": only the time.

    Raises
    ------
    ConfigError
        If there is no usable fix, or it reports no standard deviation.
    """
    given, fixes = spec.start, recording.fixes
    arm_b = np.asarray(spec.antenna_b)
    t, lla, vel_n, q_nb, variance = (
        given.at,
        np.full(3, np.nan),
        np.full(3, np.nan),
        np.full(4, np.nan),
        np.full(9, np.inf),
    )
    if given.alignment != "course":
        moving = given.alignment == "given"
        usable = fixes.valid & (fixes.t >= given.at)
        full = usable & np.isfinite(fixes.vel_n).all(axis=1)
        if moving and full.any():
            usable = full
        if not usable.any():
            raise ConfigError(
                f"{spec.name}.toml: [alignment] at_s = {given.at:g} s: no usable fix from there on"
            )
        row = int(np.argmax(usable))
        t, lla = float(fixes.t[row]), fixes.lla[row]
        variance[:3] = np.diag(fixes.cov_pos_n[row])
        if moving:
            q_nb = from_euler(*given.attitude)
            lla, vel_n = earth.displace(lla, -matrix(q_nb) @ arm_b), fixes.vel_n[row]
            variance[3:6] = np.diag(fixes.cov_vel_n[row])
            if not full[row]:
                vel_n, variance[3:6] = np.zeros(3), UNKNOWN_SPEED_SD**2
            variance[6:] = np.square([given.tilt_sd, given.tilt_sd, given.heading_sd])
        else:
            variance[:3] += arm_b @ arm_b
        reported = variance[: 6 if moving else 3]
        if not (np.isfinite(reported) & (reported > 0)).all():
            raise ConfigError(
                f"{spec.name}.toml: [alignment] the fix at {t:.2f} s reports no standard "
                "deviation above 0; set at_s to another"
            )
    return InitialState(
        t=t,
        lla=lla,
        vel_n=vel_n,
        q_nb=q_nb,
        cov=np.diag(variance),
        alignment=given.alignment,
        align_for=given.align_for,
        drift_sd=given.drift_sd,
    )
