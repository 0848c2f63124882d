"""The Earth: radii and gravity against closed forms, coordinates against round trips and pymap3d.

Register A-2.2.R and A-2.2.G (normative gravity), gates G3 and G4.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.mathematics import earth

ELLIPSOIDS = [earth.WGS84, earth.PZ90_11, earth.KRASOVSKY_1940, earth.INTERNATIONAL_1924]
RNG = np.random.default_rng(5)
LLA = np.column_stack(
    [RNG.uniform(-np.pi / 2, np.pi / 2, 400), RNG.uniform(-np.pi, np.pi, 400), RNG.uniform(-5e3, 4e5, 400)]
)


def closed_form_gravity(lat, alt):
    """Exact normal gravity, NIMA TR8350.2 equations 4-5 to 4-17: (north, down) at geodetic lat, alt."""
    a, b = earth.WGS84.a, earth.WGS84.b
    x, _, z = earth.to_ecef([lat, 0.0, alt])
    E2 = a * a - b * b
    E = np.sqrt(E2)
    d = x * x + z * z - E2
    u = np.sqrt(0.5 * d * (1 + np.sqrt(1 + 4 * E2 * z * z / d**2)))
    beta = np.arctan2(z * np.sqrt(u * u + E2), u * x)
    sb, cb = np.sin(beta), np.cos(beta)
    w = np.sqrt((u * u + E2 * sb * sb) / (u * u + E2))
    q = 0.5 * ((1 + 3 * u * u / E2) * np.arctan2(E, u) - 3 * u / E)
    q0 = 0.5 * ((1 + 3 * b * b / E2) * np.arctan2(E, b) - 3 * b / E)
    q1 = 3 * (1 + u * u / E2) * (1 - u / E * np.arctan2(E, u)) - 1
    rate2 = earth.EARTH_RATE**2
    g_u = (
        -(earth.GM / (u * u + E2) + rate2 * a * a * E / (u * u + E2) * q1 / q0 * (0.5 * sb * sb - 1 / 6)) / w
        + rate2 * u * cb * cb / w
    )
    g_b = (rate2 * a * a / np.sqrt(u * u + E2) * q / q0 - rate2 * np.sqrt(u * u + E2)) * sb * cb / w
    # u and beta directions in the meridian plane (x, z)
    r = np.sqrt(u * u + E2)
    e_u = np.array([u * cb / r, sb]) / w
    e_b = np.array([-sb, u * cb / r]) / w
    g_x, g_z = g_u * e_u + g_b * e_b
    s, c = np.sin(lat), np.cos(lat)
    return -s * g_x + c * g_z, -(c * g_x + s * g_z)


@pytest.mark.parametrize("alt", [0.0, 3e3, 12e3])
def test_gravity_is_the_normal_field_to_a_tenth_of_a_milligal(alt):
    """Gate G4. The north component, linear in height, is right to 1 % of itself."""
    for lat in np.deg2rad(np.arange(-90.0, 91.0, 7.5)):
        north, down = closed_form_gravity(lat, alt)
        ours = earth.gravity_n(lat, alt)
        assert abs(ours[2] - down) < 1e-6  # 0.1 mGal
        assert abs(ours[0] - north) < 0.01 * 8.08e-9 * alt + 1e-11
        assert ours[1] == 0.0


def test_gravity_gate_sees_the_simple_formula_fail():
    """The free-air gradient without latitude is off by more than the gate at 12 km (A-2.2.G3)."""
    lat = np.deg2rad(60.0)
    _, down = closed_form_gravity(lat, 12e3)
    simple = earth.gravity_n(lat, 0.0)[2] * (1 - 2 * 12e3 / earth.WGS84.a)
    assert abs(simple - down) > 1e-5


def test_gravity_kernels_are_the_wrapper_and_its_derivatives():
    for lat, _, alt in LLA[:50]:
        alt = min(alt, 2e4)
        s, c = np.sin(lat), np.cos(lat)
        ours = earth.gravity_n(lat, alt)
        for function in (earth.gravity_kernel, earth.gravity_kernel.py_func):
            assert_allclose(function(s, c, alt), ours[[0, 2]], rtol=1e-14, atol=1e-20)
        h, step = 10.0, 1e-4
        by_alt = (earth.gravity_n(lat, alt + h) - earth.gravity_n(lat, alt - h)) / (2 * h)
        by_lat = (earth.gravity_n(lat + step, alt) - earth.gravity_n(lat - step, alt)) / (2 * step)
        gradient = earth.gravity_gradient_kernel(s, c, alt)
        assert_allclose(gradient, [by_alt[0], by_lat[0], by_alt[2], by_lat[2]], rtol=1e-6, atol=1e-11)
        assert_allclose(earth.gravity_gradient_kernel.py_func(s, c, alt), gradient, rtol=1e-13)


@pytest.mark.parametrize("ellipsoid", ELLIPSOIDS, ids=lambda e: e.name)
def test_radii_are_those_of_the_ellipse(ellipsoid):
    """A-2.2.R by geometry: R_M is arc length per latitude, R_P cos lat the distance from the axis."""
    lat = np.deg2rad(np.linspace(-85, 85, 18))
    R_M, R_P = earth.radii(lat, ellipsoid)
    step = 1e-5
    low, high = (
        earth.to_ecef(np.column_stack([lat + d, 0 * lat, 0 * lat]), ellipsoid) for d in (-step, step)
    )
    assert_allclose(np.linalg.norm(high - low, axis=1) / (2 * step), R_M, rtol=1e-9)
    here = earth.to_ecef(np.column_stack([lat, 0 * lat, 0 * lat]), ellipsoid)
    assert_allclose(here[:, 0], R_P * np.cos(lat), rtol=1e-14)
    # at the equator R_M = b^2/a, at the pole both are a^2/b
    assert_allclose(earth.radii(0.0, ellipsoid)[0], ellipsoid.b**2 / ellipsoid.a, rtol=1e-14)
    assert_allclose(earth.radii(np.pi / 2, ellipsoid), [ellipsoid.a**2 / ellipsoid.b] * 2, rtol=1e-14)


def test_radii_kernel_is_the_wrapper():
    for lat in LLA[:50, 0]:
        for function in (earth.radii_kernel, earth.radii_kernel.py_func):
            assert_allclose(function(np.sin(lat)), earth.radii(lat), rtol=1e-14)


def test_e2_of_each_ellipsoid():
    """Equations 1.6: printed squares of the eccentricity."""
    printed = [0.00669437999014, 0.006694366, 0.00669342162, 0.00672267]
    assert_allclose([e.e2 for e in ELLIPSOIDS], printed, rtol=1e-6)


@pytest.mark.parametrize("ellipsoid", ELLIPSOIDS, ids=lambda e: e.name)
def test_geodetic_round_trip(ellipsoid):
    back = earth.to_geodetic(earth.to_ecef(LLA, ellipsoid), ellipsoid)
    assert_allclose(back[:, :2], LLA[:, :2], rtol=0, atol=2e-15 * 8)
    assert_allclose(back[:, 2], LLA[:, 2], rtol=0, atol=5e-9)


def test_geodetic_at_poles_and_satellite_height():
    for lla in ([np.pi / 2, 0.0, 1000.0], [-np.pi / 2, 0.0, -100.0], [0.9, -3.0, 2.02e7]):
        back = earth.to_geodetic(earth.to_ecef(lla))
        assert_allclose(back[0], lla[0], atol=1e-14)
        assert_allclose(back[2], lla[2], atol=2e-8)


def test_agrees_with_pymap3d():
    import pymap3d

    for lla in LLA[:60]:
        assert_allclose(earth.to_ecef(lla), pymap3d.geodetic2ecef(*lla, deg=False), rtol=0, atol=2e-9)
        assert_allclose(
            earth.to_geodetic(earth.to_ecef(lla)),
            pymap3d.ecef2geodetic(*earth.to_ecef(lla), deg=False),
            rtol=0,
            atol=1e-8,
        )
        origin = lla + np.array([1e-3, -2e-3, 50.0])
        theirs = pymap3d.geodetic2ned(*lla, *origin, deg=False)
        assert_allclose(earth.local_ned(lla, origin), theirs, rtol=0, atol=1e-8)


def test_matrix_en_has_the_axes_of_the_level_frame():
    """North is the direction of growing latitude, east of longitude, down of falling height."""
    for lla in LLA[:50]:
        C_en = earth.matrix_en(lla[0], lla[1])
        assert_allclose(C_en.T @ C_en, np.eye(3), atol=1e-12)
        for axis, step in enumerate([[1e-7, 0, 0], [0, 1e-7, 0], [0, 0, -1.0]]):
            move = earth.to_ecef(lla + np.array(step)) - earth.to_ecef(lla - np.array(step))
            assert_allclose(move / np.linalg.norm(move), C_en[:, axis], atol=1e-5)


def test_difference_is_the_local_displacement_and_displace_its_inverse():
    here = LLA[np.abs(LLA[:, 0]) < 1.4]
    d = RNG.normal(scale=100.0, size=(len(here), 3))
    moved = earth.displace(here, d)
    assert_allclose(earth.difference_n(moved, here), d, atol=1e-8)
    rigid = np.array([earth.local_ned(m, h) for m, h in zip(moved, here, strict=True)])
    assert_allclose(rigid, d, atol=0.05)  # 300 m apart: curvature d^2 tan(lat) / R
    assert np.abs(rigid - d).max() > 1e-4


def test_difference_wraps_at_the_date_line():
    east, west = [0.5, np.pi - 1e-7, 0.0], [0.5, -np.pi + 1e-7, 0.0]
    _, R_P = earth.radii(0.5)
    assert_allclose(earth.difference_n(west, east)[1], 2e-7 * R_P * np.cos(0.5), rtol=1e-6)
