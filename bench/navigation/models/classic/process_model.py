"""Process model of the 22 states: datasheets (A-5.1.8, A-5.3), GNSS errors (A-5.2), Phi, G (A-5.4.2)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.earth import EARTH_RATE
from bench.core.records.sensor_specs import AssumedSpecs, TriadSpec
from bench.navigation.error_state_filter.rough_heading import motion_share
from bench.navigation.models.classic.error_dynamics import dynamics_matrix, noise_matrix
from bench.navigation.models.classic.navigator import Earth, Nav, Vector, reduced

SIZE = 22
NOISES = 28


@dataclass(frozen=True, slots=True)
class Sigmas:
    """The parameters of the filter's model, standard deviations unless noted otherwise; SI."""

    gyro: float  # angular random walk, sigma_omega [rad/sqrt(s)]
    accel: float  # velocity random walk, sigma_a [m/s/sqrt(s)]
    eps_walk: float  # of the gyro errors, sigma_10..12 [rad/s/sqrt(s)]
    da_walk: float  # of the accelerometer errors, sigma_13..15 [m/s^2/sqrt(s)]
    eps: float  # gyro errors at the start [rad/s]
    da: float  # accelerometer errors at the start [m/s^2]
    h: float  # barometer, white [m]
    xi: float  # barometer bias, walk [m/sqrt(s)]
    bb: float  # barometer bias at the start [m]
    white: tuple[float, ...]  # GNSS sigma_Rs, sigma_Hs [m], sigma_Vs, and that of the vertical velocity [m/s]
    markov: Vector  # GNSS sigma_Rc, sigma_Hc [m], sigma_Vc [m/s]
    lambda_s: float  # decay of the position's Markov part by distance [1/m]
    lambda_st: float  # and by time [1/s]
    lambda_v: float  # decay of the velocity's Markov part [1/s]
    # of a fix at a new set of satellites
    jump_white: Vector = (0.0, 0.0, 0.0)  # sigma_dRs, sigma_dHs [m], sigma_dVs [m/s]
    jump_markov: Vector = (0.0, 0.0, 0.0)  # sigma_dRc, sigma_dHc [m], sigma_dVc [m/s]


def sigmas(specs: AssumedSpecs) -> Sigmas:
    """Return the filter parameters from the assumed datasheets; zeros for a sensor without datasheet.

    Sensor errors are random walks (A-5.1.8): a bias instability of standard deviation s and correlation tau
    starts with the turn-on bias and s together and walks with s sqrt(2 / tau).
    """
    eps, eps_walk = bias_and_walk(specs.imu.gyro)
    da, da_walk = bias_and_walk(specs.imu.accel)
    b, g = specs.baro, specs.gnss
    none = (0.0, 0.0, 0.0)
    return Sigmas(
        gyro=specs.imu.gyro.random_walk,
        accel=specs.imu.accel.random_walk,
        eps_walk=eps_walk,
        da_walk=da_walk,
        eps=eps,
        da=da,
        h=b.white_sd if b else 0.0,
        xi=b.bias_walk if b else 0.0,
        bb=b.bias_sd if b else 0.0,
        white=(g.pos_h_white_sd, g.pos_v_white_sd, *g.vel_white_sd_n[1:]) if g else none,
        markov=(g.pos_h_markov_sd, g.pos_v_markov_sd, g.vel_markov_sd) if g else none,
        lambda_s=g.pos_decay_distance if g else 0.0,
        lambda_st=g.pos_decay_time if g else 0.0,
        lambda_v=g.vel_decay_time if g else 0.0,
    )


def bias_and_walk(triad: TriadSpec) -> tuple[float, float]:
    """Return the standard deviation of a bias at the start and the density of its random walk (A-5.1.8)."""
    if triad.instability_sd == 0:
        return triad.turn_on_bias_sd, 0.0
    start = math.hypot(triad.turn_on_bias_sd, triad.instability_sd)
    return start, triad.instability_sd * math.sqrt(2 / triad.bias_correlation)


def gnss_decay(sig: Sigmas, speed: float, T: float) -> FloatArray:
    """Return diag(W_R x 3, W_V x 3) as (6,) over T [s] at a ground speed [m/s] (A-5.2.2)."""
    w_r = math.exp(-(sig.lambda_s * speed + sig.lambda_st) * T)
    w_v = math.exp(-sig.lambda_v * T)
    return np.array([w_r, w_r, w_r, w_v, w_v, w_v])


def gnss_noise(sig: Sigmas, decay: FloatArray, east: float, north: float, jump: bool) -> FloatArray:
    """Return G_S (6, 6), Markov and jump noise of a channel merged (A-5.4.2, 28 noises)."""
    q = np.sqrt(1.0 - decay**2)
    unit = np.array([east, north, 1.0, 1.0, 1.0, 1.0])
    return np.diag(np.hypot(q * per_axis(sig.markov), float(jump) * per_axis(sig.jump_markov)) * unit)


def per_axis(figures: Sequence[float]) -> FloatArray:
    """Return figures of a fix for its six axes.

    They are those of horizontal position, height and velocity, and of vertical velocity where it has its own.
    """
    r, h, v, *vertical = figures
    return np.array([r, r, h, v, v, *(vertical or [v])])


def model(
    nav: Nav, earth: Earth, a: ArrayLike, sig: Sigmas, T: float, *, jump: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Return Phi_p (22, 22) and G_p (22, 28) over T [s], first order (A-5.1.D, A-5.4.2).

    Phi = E + F T and G sqrt(T); the GNSS block is exact and its noise G_S holds T already.
    """
    F = turn_motion(dynamics_matrix(nav, a, earth), nav, a, earth, sig.accel**2 / T)
    return _first_order(nav, earth, F, _noise(nav, sig), sig, T, jump=jump)


def model_van_loan(
    nav: Nav, earth: Earth, a: ArrayLike, sig: Sigmas, T: float, *, jump: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Return Phi_p (22, 22) and Q_p = G_p G_p' (22, 22), the inertial block by van Loan (A-5.1.D)."""
    F = turn_motion(dynamics_matrix(nav, a, earth), nav, a, earth, sig.accel**2 / T)
    noise = _noise(nav, sig)
    Phi, G = _first_order(nav, earth, F, noise, sig, T, jump=jump)
    Q = G @ G.T
    joint = np.zeros((30, 30))
    joint[:15, :15], joint[:15, 15:], joint[15:, 15:] = -F * T, noise @ noise.T * T, F.T * T
    joint = _exponential(joint)
    Phi[:15, :15] = joint[15:, 15:].T
    Q[:15, :15] = Phi[:15, :15] @ joint[:15, 15:]
    return Phi, Q


def turn_motion(F: FloatArray, nav: Nav, a: ArrayLike, earth: Earth, variance: float) -> FloatArray:
    """Return F in which an attitude error rotates the force due to motion, but not noise of a variance.

    A-5.1.10 turns the measured force, noise included (`dynamics_matrix`). As in
    `bench.navigation.error_state_filter.rough_heading.steady_kernel`.
    """
    s, c = math.sin(nav.lat), math.cos(nav.lat)
    v_e, v_n, v_h = (float(v) for v in nav.V)
    U = 2.0 * EARTH_RATE + v_e / (earth.r1 * c)
    steady = np.array([U * (c * v_h - s * v_n), U * s * v_e + v_n / earth.r2 * v_h])
    more = np.asarray(a, float)[:2] - steady
    a_e, a_n = steady + motion_share(float(more @ more), variance) * more
    F[3, 8], F[4, 8], F[5, 6], F[5, 7] = a_n, -a_e, -a_n, a_e
    return F


def _first_order(
    nav: Nav, earth: Earth, F: FloatArray, noise: FloatArray, sig: Sigmas, T: float, *, jump: bool
) -> tuple[FloatArray, FloatArray]:
    """Return Phi_p and G_p of F (15, 15) and the densities (15, 21) of its noise."""
    decay = gnss_decay(sig, math.hypot(nav.V[0], nav.V[1]), T)
    Phi, G = np.eye(SIZE), np.zeros((SIZE, NOISES))
    Phi[:15, :15] += F * T
    Phi[16:, 16:] = np.diag(decay)
    G[:15, :21] = noise * math.sqrt(T)
    G[15, 21] = sig.xi * math.sqrt(T)
    G[16:, 22:] = gnss_noise(sig, decay, *reduced(nav, earth), jump)
    return Phi, G


def _exponential(A: FloatArray) -> FloatArray:
    """Return exp(A) by its series: over a step F T is all but nilpotent, and a dozen terms are exact.

    Terms after those that are needed change no bit, so their end is looked for at every fourth.
    """
    term, total = np.eye(len(A)), np.eye(len(A))
    for k in range(1, 40):
        term = term @ A
        term /= k
        total += term
        if k % 4 == 0 and (np.abs(term) <= 1e-17 * np.abs(total)).all():
            break
    return total


def _noise(nav: Nav, sig: Sigmas) -> FloatArray:
    process = np.repeat([0.0, 0.0, 0.0, sig.eps_walk, sig.da_walk], 3)
    return noise_matrix(nav.B, process, sig.gyro, sig.accel)
