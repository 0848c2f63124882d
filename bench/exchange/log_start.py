"""What the estimators are told of the start of a recording: as much as the log says, and no more."""

from __future__ import annotations

import numpy as np

from bench import earth
from bench.config.log import LogSpec
from bench.data import InitialState
from bench.errors import ConfigError
from bench.exchange.log_records import LogRecords
from bench.navigation.alignment import UNKNOWN_SPEED_SD
from bench.rotation import from_euler, matrix


def find_start(recording: LogRecords, spec: LogSpec) -> InitialState:
    """Return the start at or after ``[alignment] at_s``; what is not told is NaN with infinite variance.

    "given": position and velocity of the first usable fix, less the lever arm, and the attitude of the log;
    where no fix has a velocity, any velocity.
    "level": the position of that fix, as uncertain as the direction of the arm. "course": the time alone.

    Raises
    ------
    ConfigError
        If there is no such fix.
    """
    told, fixes = spec.start, recording.fixes
    arm_b = np.asarray(spec.antenna_b)
    t, lla, vel_n, q_nb, variance = (
        told.at,
        np.full(3, np.nan),
        np.full(3, np.nan),
        np.full(4, np.nan),
        np.full(9, np.inf),
    )
    if told.alignment != "course":
        moving = told.alignment == "given"
        usable = fixes.valid & (fixes.t >= told.at)
        full = usable & np.isfinite(fixes.vel_n).all(axis=1)
        if moving and full.any():
            usable = full
        if not usable.any():
            raise ConfigError(
                f"{spec.name}.toml: [alignment] at_s = {told.at:g} s: no usable fix from there on"
            )
        row = int(np.argmax(usable))
        t, lla = float(fixes.t[row]), fixes.lla[row]
        variance[:3] = np.diag(fixes.cov_pos_n[row])
        if moving:
            q_nb = from_euler(*told.attitude)
            lla, vel_n = earth.displace(lla, -matrix(q_nb) @ arm_b), fixes.vel_n[row]
            variance[3:6] = np.diag(fixes.cov_vel_n[row])
            if not full[row]:
                vel_n, variance[3:6] = np.zeros(3), UNKNOWN_SPEED_SD**2
            variance[6:] = np.square([told.tilt_sd, told.tilt_sd, told.heading_sd])
        else:
            variance[:3] += arm_b @ arm_b
        if not (variance[: 6 if moving else 3] > 0).all():
            raise ConfigError(
                f"{spec.name}.toml: [alignment] the fix at {t:.2f} s reports no spread; set at_s to another"
            )
    return InitialState(
        t=t,
        lla=lla,
        vel_n=vel_n,
        q_nb=q_nb,
        cov=np.diag(variance),
        alignment=told.alignment,
        align_for=told.align_for,
        drift_sd=told.drift_sd,
    )
