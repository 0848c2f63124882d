"""Delays: register values, the shape of the models, two carriers against one."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.mathematics import earth
from bench.simulation.signals import delays, orbits

MODEL = np.array([3.82e-8, 1.49e-8, -1.79e-7, 0.0, 1.43e5, 0.0, -3.28e5, 1.13e5])


def by_hand(lat, lon, el, az, t, model):
    """B-10b word for word, in semicircles."""
    alpha, beta = model[:4], model[4:]
    E, A, phi, lam = el / np.pi, az, lat / np.pi, lon / np.pi
    psi = 0.0137 / (E + 0.11) - 0.022
    phi_i = np.clip(phi + psi * np.cos(A), -0.416, 0.416)
    lam_i = lam + psi * np.sin(A) / np.cos(phi_i * np.pi)
    phi_m = phi_i + 0.064 * np.cos((lam_i - 1.617) * np.pi)
    t = (4.32e4 * lam_i + t) % 86400
    slant = 1 + 16 * (0.53 - E) ** 3
    amp = max(0.0, sum(a * phi_m**n for n, a in enumerate(alpha)))
    per = max(72000.0, sum(b * phi_m**n for n, b in enumerate(beta)))
    x = 2 * np.pi * (t - 50400) / per
    if abs(x) < 1.57:
        return orbits.C * slant * (5e-9 + amp * (1 - x**2 / 2 + x**4 / 24))
    return orbits.C * slant * 5e-9


def klobuchar(lat, lon, el, az, t):
    return delays.klobuchar_kernel(lat, lon, el, np.sin(az), np.cos(az), t, np.array(MODEL))


def test_klobuchar_of_the_register():
    """B-10b, #55: 23.784 m."""
    delay = klobuchar(*np.deg2rad([40.0, -100.0, 20.0, 210.0]), 20.75 * 3600)
    assert abs(float(delay) - 23.784) < 5e-4


def test_klobuchar_all_over_the_sky_and_the_day():
    draw = np.random.default_rng(1)
    lat, lon = draw.uniform(-1.5, 1.5, 300), draw.uniform(-np.pi, np.pi, 300)
    el, az, t = (
        draw.uniform(0.05, np.pi / 2, 300),
        draw.uniform(-np.pi, 2 * np.pi, 300),
        draw.uniform(-2e5, 6e5, 300),
    )
    expected = [by_hand(*row, MODEL) for row in zip(lat, lon, el, az, t, strict=True)]
    found = [klobuchar(*row) for row in zip(lat, lon, el, az, t, strict=True)]
    assert_allclose(found, expected, rtol=1e-9)
    night = klobuchar(0.8, 0.2, np.pi / 2, 0.0, 0.0)
    assert abs(float(night) - 1.5) < 0.01  # 5 ns


def test_troposphere_of_the_register():
    """B-10: 2.638 m at the zenith, DO-229 mapping, e-fold 7500 m; Saastamoinen's total is about 2.4 m."""
    assert_allclose(delays.zenith_troposphere(0.9, 7500.0, "b-10"), 2.638 / np.e, rtol=1e-12)
    assert_allclose(delays.zenith_troposphere(0.9, 0.0, "b-10"), 2.638, rtol=1e-12)
    five = np.sin(np.deg2rad(5.0))
    assert_allclose(delays.mapping_kernel(five), 1.001 / np.sqrt(0.002001 + five**2))
    dry_and_wet = delays.zenith_troposphere(np.deg2rad(45.0), 0.0)
    assert abs(float(dry_and_wet) - 2.4) < 0.05
    high = delays.zenith_troposphere(0.9, np.array([0.0, 3000.0, 9000.0]))
    pressure = np.array([1013.25, 701.1, 307.4])  # ICAO standard atmosphere, tabulated
    assert_allclose(high / high[0], pressure / pressure[0], atol=0.02)
    with pytest.raises(ValueError, match="must be one of saastamoinen, unb3m, b-10; got 'none'"):
        delays.zenith_troposphere(0.9, 0.0, "none")


@pytest.mark.parametrize(
    ("system", "channel", "gamma"), [(0, 0, (60 / 77) ** 2), (1, -7, (7 / 9) ** 2), (1, 6, (7 / 9) ** 2)]
)
def test_two_carriers_have_no_ionosphere(system, channel, gamma):
    """B-11, #55: below 1e-6 m noise-free at 50 TECU, k = 40.3 TEC; the other system's gamma leaves 0.07 m."""
    f_1, f_2 = orbits.carrier_frequencies(np.array([system]), np.array([channel]))[0]
    assert_allclose((f_2 / f_1) ** 2, gamma, rtol=1e-12)
    clean, tec = 22_345_678.9, 50e16
    one, two = (clean + 40.3 * tec / f**2 for f in (f_1, f_2))
    assert abs(delays.ionosphere_free(one, two, f_1, f_2) - clean) < 1e-6
    other = (60 / 77) ** 2 if system else (7 / 9) ** 2
    assert 0.05 < abs((one - other * two) / (1 - other) - clean) < 0.1


def test_noise_amplification_of_two_carriers():
    """B-11: 2.98 for GPS, 2.96 for GLONASS."""
    for system, expected in ((0, 2.98), (1, 2.96)):
        f_1, f_2 = orbits.carrier_frequencies(np.array([system]), np.array([0]))[0]
        gains = [float(delays.ionosphere_free(*unit, f_1, f_2)) for unit in ((1.0, 0.0), (0.0, 1.0))]
        assert abs(np.hypot(*gains) - expected) < 0.005


def test_the_range_kernel_turns_the_earth_during_the_travel():
    """Against an iteration on the travel time, to 1e-8 m; with the rate 0 the plain distance."""
    draw = np.random.default_rng(2)
    here = earth.to_ecef([0.8, 0.2, 1e3])
    for _ in range(50):
        up = draw.standard_normal(3)
        sat = 26.56e6 * up / np.linalg.norm(up)
        travel = 0.0
        for _ in range(6):
            c, s = np.cos(orbits.GPS_EARTH_RATE * travel), np.sin(orbits.GPS_EARTH_RATE * travel)
            turned = np.array([c * sat[0] + s * sat[1], c * sat[1] - s * sat[0], sat[2]])
            travel = np.linalg.norm(turned - here) / orbits.C
        distance, *e = delays.range_kernel(*sat, *here, orbits.GPS_EARTH_RATE)
        assert abs(distance - orbits.C * travel) < 2e-8
        assert_allclose(e, (turned - here) / (orbits.C * travel), rtol=0, atol=1e-12)
        assert_allclose(delays.range_kernel(*sat, *here, 0.0)[0], np.linalg.norm(sat - here), rtol=1e-14)
