"""Truths with known answers, built without JSBSim: a body at rest and a body in a steady level turn.

The increments are closed forms in the frames of the bench, not differences of the record.
"""

from __future__ import annotations

import numpy as np

from bench.core.mathematics import earth, rotation
from bench.core.records.data import AirData, Controls, Trajectory, no_events

ORIGIN = np.array([np.deg2rad(47.0), np.deg2rad(11.0), 1200.0])


def still(
    duration: float, rate: float, attitude: tuple[float, float, float] = (0.1, -0.2, 2.0)
) -> Trajectory:
    """A body at rest at ORIGIN with roll, pitch, heading [rad]: it feels the Earth rate and -gravity."""
    t = np.arange(round(duration * rate) + 1) / rate
    q_nb = rotation.from_euler(*attitude)
    w_ie_n = earth.EARTH_RATE * np.array([np.cos(ORIGIN[0]), 0.0, -np.sin(ORIGIN[0])])
    f_n = -earth.gravity_n(ORIGIN[0], ORIGIN[2])
    q_bn = rotation.conjugate(q_nb)
    return _record(
        t,
        np.tile(ORIGIN, (len(t), 1)),
        np.zeros((len(t), 3)),
        np.tile(q_nb, (len(t), 1)),
        np.tile(rotation.rotate(q_bn, w_ie_n) / rate, (len(t) - 1, 1)),
        np.tile(rotation.rotate(q_bn, f_n) / rate, (len(t) - 1, 1)),
    )


def turning(
    duration: float, rate: float, speed: float = 25.0, turn_rate: float = 0.3, bank: float = 0.65
) -> Trajectory:
    """A level circle flown at constant speed [m/s], turn rate [rad/s] and bank [rad].

    Position moves on the ellipsoid by the circle's meters over the radii at ORIGIN, right to the
    circle's size over the Earth's (1e-5). The rates of Earth and transport are constant in n to the
    same order; Coriolis is left out of the specific force.
    """
    t = np.arange(round(duration * rate) + 1) / rate
    heading = 0.7 + turn_rate * t
    vel_n = speed * np.column_stack([np.cos(heading), np.sin(heading), np.zeros_like(t)])
    radius = speed / turn_rate
    pos_n = radius * np.column_stack(
        [np.sin(heading) - np.sin(0.7), np.cos(0.7) - np.cos(heading), np.zeros_like(t)]
    )
    q_nb = rotation.from_euler(np.full_like(t, bank), np.zeros_like(t), heading)
    tilt_bn = rotation.conjugate(rotation.from_euler(bank, 0.0, 0.0))
    w_n = np.array([0.0, 0.0, turn_rate])  # relative to n; the Earth's part turns with the heading
    f_level = np.array([0.0, speed * turn_rate, -earth.gravity_n(ORIGIN[0], ORIGIN[2])[2]])
    n = len(t) - 1
    return _record(
        t,
        earth.displace(ORIGIN, pos_n),
        vel_n,
        q_nb,
        np.tile(rotation.rotate(tilt_bn, w_n) / rate, (n, 1)) + _earth_part(t, heading, tilt_bn),
        np.tile(rotation.rotate(tilt_bn, f_level) / rate, (n, 1)),
    )


def _earth_part(t, heading, tilt_bn):
    """Integral of w_ie_b over each sample, Simpson's rule."""

    def w_ie_b(h):
        w_level = earth.EARTH_RATE * np.column_stack(
            [
                np.cos(ORIGIN[0]) * np.cos(h),
                -np.cos(ORIGIN[0]) * np.sin(h),
                np.full_like(h, -np.sin(ORIGIN[0])),
            ]
        )
        return rotation.rotate(tilt_bn, w_level)

    middle = 0.5 * (heading[1:] + heading[:-1])
    weights = w_ie_b(heading[:-1]) + 4 * w_ie_b(middle) + w_ie_b(heading[1:])
    return weights * np.diff(t)[:, None] / 6


def _record(t, lla, vel_n, q_nb, dtheta_b, dvel_b):
    coarse = t[:: max(1, round(0.05 / (t[1] - t[0])))]
    one = np.ones(len(coarse))
    air = AirData(
        t=coarse,
        pressure=87700.0 * one,
        temperature=280.0 * one,
        airspeed_true=25.0 * one,
        airspeed_calibrated=23.0 * one,
        alpha=0.05 * one,
        beta=0.0 * one,
        wind_n=np.zeros((len(coarse), 3)),
        engine_speed=500.0 * one,
    )
    controls = Controls(t=coarse, aileron=0.0 * one, elevator=0.0 * one, rudder=0.0 * one, throttle=0.5 * one)
    return Trajectory(t, lla, vel_n, rotation.continuous(q_nb), dtheta_b, dvel_b, air, controls, no_events())
