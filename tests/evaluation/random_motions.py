"""Random motions of five vehicles as an IMU and a receiver record them, without flying an aircraft.

The path is a sum of smooth terms, so velocity, acceleration and attitude are exact to the step of the tables;
rates and specific forces are differences of the attitude and the velocity, not formulas of the checks.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bench.core.mathematics import earth
from bench.core.records.data import GnssFixes, ImuData
from tests.evaluation.seeded import Recorded

RATE = 100  # [Hz]
_FINE = 4  # steps of the tables in an interval of the IMU
ORIGIN = np.array([0.82, 0.19, 600.0])


def _waves(r: np.random.Generator, t: np.ndarray, count: int, slowest: float, fastest: float) -> np.ndarray:
    """Return a sum of sines (N,) of random periods [s] with an rms of 1."""
    periods = np.exp(r.uniform(np.log(fastest), np.log(slowest), count))
    sines = [np.sin(2.0 * np.pi * t / one + r.uniform(0.0, 2.0 * np.pi)) for one in periods]
    return np.asarray(np.sum(sines, axis=0) * np.sqrt(2.0 / count))


def _smooth(values: np.ndarray, t: np.ndarray, seconds: float) -> np.ndarray:
    width = max(3, int(seconds / (t[1] - t[0])))
    kernel = np.hanning(width + 2)[1:-1]
    return np.convolve(np.pad(values, width, "edge"), kernel / kernel.sum(), "same")[width:-width]


def _course_of(r: np.random.Generator, t: np.ndarray, rms: float, slowest: float) -> np.ndarray:
    """Return a course (N,) [rad] whose rate has this rms [rad/s]."""
    return np.asarray(
        r.uniform(0.0, 2 * np.pi) + np.cumsum(rms * _waves(r, t, 4, slowest, 4.0)) * (t[1] - t[0])
    )


def _speed_of(r: np.random.Generator, t: np.ndarray, mean: float, stops: bool) -> np.ndarray:
    """Return a speed (N,) [m/s] that varies, and falls to 0 now and then if it stops."""
    speed = mean * (1.0 + 0.25 * _waves(r, t, 3, 60.0, 8.0))
    if stops:
        speed = speed * (np.sin(2 * np.pi * t / r.uniform(25.0, 60.0) + r.uniform(0, 6)) > -0.6)
    return _smooth(np.maximum(speed, 0.0), t, 4.0)


def _car(r: np.random.Generator, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    speed = _speed_of(r, t, r.uniform(6.0, 25.0), bool(r.integers(2)))
    turn = np.clip(
        r.uniform(0.08, 0.25) * _waves(r, t, 4, 40.0, 5.0),
        -6.0 / np.maximum(speed, 1.0),
        6.0 / np.maximum(speed, 1.0),
    )
    course = np.cumsum(_smooth(turn * np.minimum(speed / 2.0, 1.0), t, 1.0)) * (t[1] - t[0]) + r.uniform(0, 6)
    slope = 0.03 * _waves(r, t, 2, 60.0, 20.0)
    vel = np.column_stack([speed * np.cos(course), speed * np.sin(course), -speed * slope])
    forward = np.gradient(speed, t)
    roll = 0.02 * speed * np.gradient(course, t) / 3.0 + 0.004 * _waves(r, t, 3, 3.0, 0.7)
    pitch = slope - 0.008 * forward + 0.004 * _waves(r, t, 3, 3.0, 0.7)
    return vel, np.column_stack([roll, pitch, course])


def _walk(r: np.random.Generator, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    speed = _speed_of(r, t, r.uniform(0.9, 1.8), bool(r.integers(2)))
    course = _course_of(r, t, r.uniform(0.15, 0.5), 30.0)
    step = 2 * np.pi * r.uniform(1.6, 2.1)
    bob = r.uniform(0.1, 0.3) * np.sin(step * t) * np.minimum(speed, 1.0)
    vel = np.column_stack([speed * np.cos(course), speed * np.sin(course), bob])
    tilt = [r.uniform(0.03, 0.1) * _waves(r, t, 4, 20.0, 1.5) for _ in range(2)]
    return vel, np.column_stack([*tilt, course + 0.08 * _waves(r, t, 3, 5.0, 1.0)])


def _multirotor(r: np.random.Generator, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    size = r.uniform(1.5, 6.0)
    vel = np.column_stack(
        [
            size * _waves(r, t, 4, 40.0, 5.0),
            size * _waves(r, t, 4, 40.0, 5.0),
            0.3 * size * _waves(r, t, 3, 40.0, 8.0),
        ]
    )
    force = np.gradient(vel, t, axis=0) - [0.0, 0.0, 9.81] + 0.02 * vel * [1, 1, 0]
    yaw = _course_of(r, t, r.uniform(0.05, 0.4), 60.0)
    c, s = np.cos(yaw), np.sin(yaw)
    ahead, right = c * force[:, 0] + s * force[:, 1], c * force[:, 1] - s * force[:, 0]
    pitch = np.arctan2(-ahead, -force[:, 2])
    roll = np.arctan2(right, np.hypot(ahead, force[:, 2]))
    return vel, np.column_stack([roll, pitch, yaw])


def _fixed_wing(r: np.random.Generator, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    speed = _smooth(r.uniform(14.0, 60.0) * (1.0 + 0.08 * _waves(r, t, 3, 60.0, 10.0)), t, 2.0)
    bank = _smooth(np.clip(r.uniform(0.2, 0.6) * _waves(r, t, 4, 50.0, 8.0), -1.0, 1.0), t, 1.0)
    heading = np.cumsum(9.81 * np.tan(bank) / speed) * (t[1] - t[0]) + r.uniform(0, 6)
    climb = 0.06 * _waves(r, t, 3, 60.0, 12.0)
    wind = r.normal(size=2) * 0.15 * speed.mean()
    vel = np.column_stack(
        [speed * np.cos(heading) + wind[0], speed * np.sin(heading) + wind[1], -speed * climb]
    )
    return vel, np.column_stack([bank, climb + 0.05 + 0.01 * _waves(r, t, 3, 5.0, 1.0), heading])


def _boat(r: np.random.Generator, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    speed = _smooth(r.uniform(3.0, 10.0) * (1.0 + 0.3 * _waves(r, t, 3, 60.0, 10.0)), t, 3.0)
    course = _course_of(r, t, r.uniform(0.05, 0.2), 60.0)
    heave = r.uniform(0.1, 0.4) * _waves(r, t, 3, 8.0, 3.0)
    vel = np.column_stack([speed * np.cos(course), speed * np.sin(course), heave])
    sway = [r.uniform(0.04, 0.12) * _waves(r, t, 3, 8.0, 3.0) for _ in range(2)]
    return vel, np.column_stack([*sway, course + 0.03 * _waves(r, t, 3, 10.0, 3.0)])


MOTIONS: dict[str, Callable[[np.random.Generator, np.ndarray], tuple[np.ndarray, np.ndarray]]] = {
    "car": _car,
    "walk": _walk,
    "multirotor": _multirotor,
    "fixed wing": _fixed_wing,
    "boat": _boat,
}


def _matrices(euler: np.ndarray) -> np.ndarray:
    (a, b, c), (d, e, f) = np.cos(euler).T, np.sin(euler).T
    rows = [
        [b * c, d * e * c - a * f, a * e * c + d * f],
        [b * f, d * e * f + a * c, a * e * f - d * c],
        [-e, d * b, a * b],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def _correlated(r: np.random.Generator, t: np.ndarray, seconds: float) -> np.ndarray:
    """Return a Gauss-Markov process (M, 3) with an sd of 1."""
    decay = np.exp(-np.diff(t) / seconds)
    out = r.normal(size=(len(t), 3))
    for k, d in enumerate(decay, 1):
        out[k] = d * out[k - 1] + np.sqrt(1 - d * d) * out[k]
    return out


def draw(vehicle: str, seed: int, late: float = 0.0) -> Recorded:
    """Return a recording of a random motion, 90 to 240 s long; ``late`` [s] are its velocities."""
    r = np.random.default_rng([seed, sorted(MOTIONS).index(vehicle)])
    n = int(r.uniform(90.0, 240.0)) * RATE
    t = np.arange(n * _FINE + 1) / (RATE * _FINE)
    vel, euler = MOTIONS[vehicle](r, t)
    a, c = (
        (0.0, 0.0) if vehicle == "multirotor" else r.uniform(-0.03, 0.03, 2)
    )  # an IMU is never mounted well
    C = _matrices(euler) @ _matrices(np.array([[a, c, 0.0]]))
    pos = np.vstack([np.zeros(3), np.cumsum(0.5 * (vel[1:] + vel[:-1]), axis=0)]) * (t[1] - t[0])
    scale = [1.0 / 6.373e6, 1.0 / (6.389e6 * np.cos(ORIGIN[0])), -1.0]
    spin = earth.EARTH_RATE * np.array([np.cos(ORIGIN[0]), 0.0, -np.sin(ORIGIN[0])])
    # rates from R = C_k^T C_k+1, vectors of small rotations; the frame n turns with the Earth
    R = np.swapaxes(C[:-1], 1, 2) @ C[1:]
    angle = 0.5 * np.stack(
        [R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1
    )
    h = t[1] - t[0]
    middle = 0.5 * (C[1:] + C[:-1])
    dtheta = angle + np.einsum("kji,j->ki", middle, spin) * h
    force = (
        np.diff(vel, axis=0) - earth.gravity_n(ORIGIN[0], ORIGIN[2]) * h + 2.0 * h * np.cross(spin, vel[1:])
    )
    dvel = np.einsum("kji,kj->ki", middle, force)
    dtheta, dvel = (x.reshape(n, _FINE, 3).sum(axis=1) for x in (dtheta, dvel))
    dt = np.full(n, 1.0 / RATE)
    shake = 10 ** r.uniform(-2.0, 0.0) if vehicle in ("multirotor", "fixed wing") else 0.05
    noisy_g = dtheta + (r.normal(size=3) * 5e-3 + r.normal(size=(n, 3)) * (2e-3 + 0.01 * shake)) / RATE
    noisy_a = dvel + (r.normal(size=3) * 0.05 + r.normal(size=(n, 3)) * (0.03 + shake)) / RATE
    step = int(r.choice([10, 20, 100])) * _FINE
    rows = np.arange(step, len(t), step)
    arm = r.uniform(-0.3, 0.3, 3)
    rate = np.vstack([angle[:1], angle]) / h
    then = np.maximum(rows - round(late / h), 0)
    at = pos[rows] + np.einsum("kij,j->ki", C[rows], arm)
    swing = np.einsum("kij,kj->ki", C[then], np.cross(rate[then], arm))
    fix_t = t[rows]
    pos_sd, vel_sd = 10 ** r.uniform(-2.0, 0.3), 10 ** r.uniform(-1.7, -0.8)
    wander = pos_sd * _correlated(r, fix_t, 60.0) + 0.3 * pos_sd * r.normal(size=at.shape)
    m = len(rows)
    eye = np.broadcast_to(np.eye(3), (m, 3, 3))
    return Recorded(
        ImuData(t[_FINE::_FINE], dt, np.ones(n, np.bool_), noisy_g, noisy_a),
        GnssFixes(
            t=fix_t,
            t_arrival=fix_t,
            valid=np.ones(m, np.bool_),
            lla=ORIGIN + (at + wander) * scale,
            vel_n=vel[then] + swing + vel_sd * r.normal(size=at.shape),
            cov_pos_n=pos_sd**2 * eye,
            cov_vel_n=vel_sd**2 * eye,
            satellites=np.full(m, 12),
        ),
        None,
        arm,
    )
