"""The standard atmosphere and air data against published tables and closed forms."""

from __future__ import annotations

import pytest
from numpy.testing import assert_allclose

from bench.signals import air


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
    found = air.standard(height)
    assert_allclose(found, [pressure, temperature, density], rtol=5e-6)
    assert_allclose(air.pressure_altitude(pressure), height, rtol=0, atol=0.05)
