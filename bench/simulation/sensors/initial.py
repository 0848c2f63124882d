"""Initial state of the filters: the truth plus one draw of the initial error."""

from __future__ import annotations

import numpy as np

from bench.core.mathematics import earth, rotation
from bench.core.records.data import InitialState, Trajectory
from bench.core.records.sensor_specs import SensorsSpec
from bench.simulation.sensors.draws import SensorDraws


def draw_initial_state(truth: Trajectory, spec: SensorsSpec, draws: SensorDraws) -> InitialState:
    """Draw the initial estimate of one run: truth plus an error with the covariance ``InitialState.cov``.

    The ``alignment`` of the spec selects the values that are given; the others are NaN of infinite variance.
    """
    attitude_sd = (spec.initial_tilt_sd, spec.initial_tilt_sd, spec.initial_heading_sd)
    sd = np.array([*spec.initial_pos_sd, *spec.initial_vel_sd, *attitude_sd])
    error = sd * draws.constant("initial", 9)
    q_nb = rotation.multiply(rotation.from_rotvec(error[6:]), truth.q_nb[0])
    given = {"given": 9, "level": 3, "hover": 0, "course": 0}[spec.alignment]  # first states of the nine
    sd[given:] = np.inf
    return InitialState(
        t=float(truth.t[0]),
        lla=earth.displace(truth.lla[0], error[:3]) if given else np.full(3, np.nan),
        vel_n=truth.vel_n[0] + error[3:6] if given > 3 else np.full(3, np.nan),
        q_nb=q_nb if given > 6 else np.full(4, np.nan),
        cov=np.diag(sd**2),
        alignment="motion" if spec.alignment == "hover" else spec.alignment,
        align_for=spec.align_for,
        drift_sd=spec.drift_sd,
    )
