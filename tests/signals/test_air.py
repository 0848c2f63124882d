"""The standard atmosphere and air data against published tables and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.records.instruments import AirspeedSpec
from bench.simulation.signals import air


@pytest.mark.parametrize(
    ("height", "pressure", "density", "temperature"),
    [  # geopotential height [m], [Pa], [kg/m^3], [K]: https://www.av8n.com/physics/altimetry.htm, section 1
        (0.0, 101325.0, 1.224999, 288.15),
        (11000.0, 22632.1, 0.363918, 216.65),
        (20000.0, 5474.89, 0.088035, 216.65),
        (32000.0, 868.019, 0.013225, 228.65),
    ],
)
def test_the_layers_of_the_standard_atmosphere(height, pressure, density, temperature):
    found = air.standard_atmosphere(height)
    assert_allclose(found, [pressure, temperature, density], rtol=5e-6)
    assert_allclose(air.pressure_altitude(pressure), height, rtol=0, atol=0.05)


@pytest.mark.parametrize(
    ("feet", "psi"),  # https://www.engineeringtoolbox.com/standard-atmosphere-d_604.html
    [(5000, 12.228), (10000, 10.108), (20000, 6.759), (30000, 4.373), (45000, 2.149), (60000, 1.049)],
)
def test_pressures_of_a_published_table(feet, psi):
    """To the last digit when its heights are geometric; as the geopotential ones it calls them, 1 % off."""
    height = air.to_geopotential(0.3048 * feet)
    assert_allclose(air.standard_atmosphere(height)[0] / 6894.757, psi, rtol=0, atol=6e-4)
    assert_allclose(air.pressure_altitude(psi * 6894.757), height, rtol=0, atol=4.0)


@pytest.mark.parametrize("deviation", [0.0, -20.0, 15.0])
def test_the_air_weighs_what_it_presses(deviation):
    """dp/dH = -rho g by central differences, in every layer and across their borders; p = rho R T."""
    height = np.array([-500.0, 0.0, 3000.0, 10999.0, 11500.0, 19000.0, 21000.0, 31000.0])
    above, below = (
        air.standard_atmosphere(height + 0.5, deviation)[0],
        air.standard_atmosphere(height - 0.5, deviation)[0],
    )
    pressure, temperature, density = air.standard_atmosphere(height, deviation)
    assert_allclose(above - below, -density * 9.80665, rtol=2e-5)
    assert_allclose(pressure, density * 287.05287 * temperature, rtol=1e-12)
    assert_allclose(temperature - air.standard_atmosphere(height)[1], deviation, atol=1e-9)


def test_a_height_beyond_the_layers_is_refused():
    with pytest.raises(ValueError, match="ends at 32000 m; got 40000 m"):
        air.standard_atmosphere([0.0, 40000.0])


def test_geopotential_and_geometric_height_part_by_the_square_over_the_radius():
    assert_allclose(air.to_geopotential(10000.0), 10000.0 - 10000.0**2 / 6356766.0, atol=0.03)


@pytest.mark.parametrize("pressure", [101325.0, 26500.0])
def test_airspeed_and_impact_pressure_are_each_others_inverse(pressure):
    """Slow flow is Bernoulli's; a backward speed is a negative pressure."""
    speed = np.array([-30.0, 0.0, 0.1, 5.0, 60.0, 250.0])
    impact = air.impact_pressure(speed, pressure, 250.0)
    assert_allclose(air.true_airspeed(impact, pressure, 250.0), speed, rtol=1e-12, atol=1e-9)
    density = pressure / (287.05287 * 250.0)
    assert_allclose(impact[[0, 2, 3]], 0.5 * density * speed[[0, 2, 3]] * np.abs(speed[[0, 2, 3]]), rtol=3e-3)


def test_the_noise_of_a_unit_as_speed_is_the_slope_of_the_pressure():
    """Pressure noise over d(impact)/dV by central differences, beside the noise in speed; bounded at rest."""
    spec = AirspeedSpec("unit", 20.0, pressure_white_sd=2.0, white_sd=0.1)
    speed = np.array([5.0, 25.0, 240.0])
    slope = air.impact_pressure(speed + 0.01, 8e4, 270.0) - air.impact_pressure(speed - 0.01, 8e4, 270.0)
    assert_allclose(air.airspeed_sd(spec, speed, 8e4, 270.0), np.hypot(0.1, 2.0 / (slope / 0.02)), rtol=1e-6)
    still = air.airspeed_sd(spec, [0.0, 0.5, 1.0], 8e4, 270.0)
    assert_allclose(still, still[-1])
