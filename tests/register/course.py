"""The linear flight of the register's section 7.1, for covariances and linear Monte Carlo with classic-22.

Level at 200 m/s and 50 deg north, one S-turn of 120 s every 600 s, fixes and barometer at 1 Hz, GNSS lost at
1800 s. The register leaves open, and this is assumed here: the height (5 km, no effect seen), the course (40
deg, what fits the outage of the MEMS grade best), that the turn rate is a sine of 3 deg/s, that turns are
banked so that no force is felt sideways, that the first begins at 240 s, and that the flight is straight
without GNSS.
"""

from __future__ import annotations

import math

import numpy as np

from bench.navigation.classic import navigator, observation_model, process_model
from tests.register import equations

DEG = math.pi / 180
G0 = 9.80665
LAT, HEIGHT, SPEED, COURSE = 50 * DEG, 5000.0, 200.0, 40 * DEG
FIRST_TURN, EVERY, TURN, RATE, LOST = 240.0, 600.0, 120.0, 3 * DEG, 1800
EARTH = navigator.ellipsoid(LAT, HEIGHT)


def sigmas(arw, vrw, drift, bias):
    """Figures of a grade in deg/sqrt(h), m/s/sqrt(h), deg/h, ug; middle of the ranges of 5.2 and 5.3."""
    return process_model.Sigmas(
        gyro=arw * DEG / 60,
        accel=vrw / 60,
        eps_walk=0.0,
        da_walk=0.0,
        eps=drift * DEG / 3600,
        da=bias * 1e-6 * G0,
        h=0.75,
        xi=0.035,
        bb=4.0,
        white=(2.0, 2.75, 0.03),
        markov=(6.0, 8.5, 0.1),
        lambda_s=4e-6,
        lambda_st=5e-4,
        lambda_v=0.01,
        jump_white=(2.5, 3.75, 0.11),
        jump_markov=(3.5, 5.0, 0.015),
    )


GRADES = {  # tables 2.4.1 and 2.4.2; the last is the register's own
    "1": sigmas(0.0005, 0.009, 0.005, 10),
    "2": sigmas(0.001, 0.01, 0.01, 50),
    "3": sigmas(0.01, 0.02, 0.1, 100),
    "MEMS": sigmas(0.3, 0.1, 10.0, 5000.0),
}


def place(t, turns=True):
    """Navigator and specific force (3,), east, north, up, at an instant."""
    phase = (t - FIRST_TURN) % EVERY
    course, rate = COURSE, 0.0
    if turns and t >= FIRST_TURN and phase < TURN and t < LOST:
        w = 2 * math.pi / TURN
        rate, course = RATE * math.sin(w * phase), COURSE + RATE / w * (1 - math.cos(w * phase))
    s, c = math.sin(course), math.cos(course)
    bank = math.atan2(SPEED * rate, EARTH.g)
    B = equations.body_to_enu(course, 0.0, bank)
    nav = navigator.Nav(LAT, 0.0, HEIGHT, SPEED * np.array([s, c, 0.0]), B)
    return nav, np.array([SPEED * rate * c, -SPEED * rate * s, EARTH.g]), rate


def start(sig, tilt=0.1 * DEG, heading=0.5 * DEG):
    """P0 of section 7.1; position 10 m and velocity 0.1 m/s are forgotten long before it is read."""
    east, north = navigator.reduced(place(0.0)[0], EARTH)
    r, h, v = sig.markov
    sd = [10 * east, 10 * north, 10, 0.1, 0.1, 0.1, tilt, tilt, heading]
    sd += [sig.eps] * 3 + [sig.da] * 3 + [sig.bb, r * east, r * north, h, v, v, v]
    return np.diag(np.square(sd))


def second(sig, k, turns=True, discretize=process_model.model):
    """Phi and Q or G of each step that leads to second k: one, or ten in a turn (A-5.1.D)."""
    jump = k % 900 == 0
    steps = 10 if turns and place(k - 0.5, turns)[2] else 1
    found = []
    for j in range(steps):
        nav, a, _ = place(k - 1 + (j + 0.5) / steps, turns)
        found.append(discretize(nav, EARTH, a, sig, 1 / steps, jump=jump and j == steps - 1))
    return found


def rows_and_noise(sig, k):
    """H and R of the seven rows at second k, the first alone once GNSS is lost."""
    rows = list(range(7)) if k <= LOST else [0]
    Q = observation_model.measurement_noise(sig, *navigator.reduced(place(0.0)[0], EARTH), k % 900 == 0)
    return observation_model.measurement_matrix()[rows], (Q @ Q.T)[np.ix_(rows, rows)]


def update(P, H, R):
    """Gain, S and Joseph's P (A-5.4.5)."""
    S = H @ P @ H.T + R
    K = np.linalg.solve(S, H @ P).T
    J = np.eye(len(P)) - K @ H
    return K, S, J @ P @ J.T + K @ R @ K.T


def covariance(sig, seconds, turns=True, **spread):
    """Standard deviations (seconds + 1, 22) after every second, the first two in metres."""
    P = start(sig, **spread)
    unit = np.ones(22)
    unit[:2] = navigator.reduced(place(0.0)[0], EARTH)
    out = [np.sqrt(np.diag(P)) / unit]
    for k in range(1, seconds + 1):
        for Phi, G in second(sig, k, turns):
            P = Phi @ P @ Phi.T + G @ G.T
        P = update(P, *rows_and_noise(sig, k))[2]
        out.append(np.sqrt(np.diag(P)) / unit)
    return np.array(out)
