"""The magnetic field: NOAA's own test values, and an interpolation that nobody notices."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.mathematics import earth
from bench.simulation.signals.magnetic import FIRST_YEAR, LAST_YEAR, field_n, wmm

# Date, height [km], latitude, longitude [deg], X, Y, Z [nT]. WMM2025: README of WMM2025COF.zip, NOAA NCEI,
# 17 December 2024. WMM2020: WMM2020testvalues.pdf, NOAA NCEI, December 2019.
PUBLISHED = [
    (2025.0, 0.0, 80.0, 0.0, 6521.6, 145.9, 54791.5),
    (2025.0, 0.0, -80.0, 240.0, 6117.5, 15751.9, -52022.5),
    (2027.5, 100.0, 80.0, 0.0, 6196.7, 233.8, 52670.5),
    (2027.5, 100.0, -80.0, 240.0, 5984.0, 14760.1, -49317.7),
    (2020.0, 0.0, 80.0, 0.0, 6570.4, -146.3, 54606.0),
    (2020.0, 0.0, 0.0, 120.0, 39624.3, 109.9, -10932.5),
    (2020.0, 0.0, -80.0, 240.0, 5940.6, 15772.1, -52480.8),
    (2020.0, 100.0, 80.0, 0.0, 6261.8, -185.5, 52429.1),
    (2020.0, 100.0, 0.0, 120.0, 37636.7, 104.9, -10474.8),
    (2020.0, 100.0, -80.0, 240.0, 5744.9, 14799.5, -49969.4),
    (2022.5, 0.0, 80.0, 0.0, 6529.9, 1.1, 54713.4),
    (2022.5, 0.0, 0.0, 120.0, 39684.7, -42.2, -10809.5),
    (2022.5, 0.0, -80.0, 240.0, 6016.5, 15776.7, -52251.6),
    (2022.5, 100.0, 80.0, 0.0, 6224.0, -44.5, 52527.0),
    (2022.5, 100.0, 0.0, 120.0, 37694.0, -35.3, -10362.0),
    (2022.5, 100.0, -80.0, 240.0, 5815.0, 14803.0, -49755.3),
]
NT = 1e-9


@pytest.mark.parametrize("row", PUBLISHED, ids=lambda row: f"{row[0]}-{row[2]:g}-{row[1]:g}km")
def test_the_published_test_values(row):
    """To their last digit, and half a digit of interpolation; a year or a kilometer wrong is 20 nT."""
    date, height, lat, lon, *published = row
    lla = np.array([[np.deg2rad(lat), np.deg2rad(lon), 1000.0 * height]])
    assert_allclose(wmm(*lla[0], date) / NT, published, rtol=0, atol=0.05 + 1e-6)
    assert_allclose(field_n(lla, date)[0] / NT, published, rtol=0, atol=0.15)
    assert np.abs(field_n(lla, date + 1.0)[0] / NT - published).max() > 5.0


@pytest.mark.parametrize("lat", [0.0, 47.0, -65.0, 89.99, -89.99])
def test_between_the_corners_of_the_grid_it_is_the_model(lat):
    """Over 12 km around, across a pole and the date line, where n itself turns from row to row."""
    rng = np.random.default_rng(4)
    origin = np.array([np.deg2rad(lat), np.pi - 1e-4, 1500.0])
    away = rng.uniform([-6000.0, -6000.0, -1000.0], [6000.0, 6000.0, 1000.0], (100, 3))
    C_en = earth.matrix_en(origin[0], origin[1])
    lla = earth.to_geodetic(earth.to_ecef(origin) + away @ C_en.T)
    model = np.array([wmm(*row, 2026.5) for row in lla])
    assert_allclose(field_n(lla, 2026.5), model, rtol=0, atol=0.1 * NT)
    spread = np.ptp(np.einsum("kij,kj->ki", earth.matrix_en(lla[:, 0], lla[:, 1]), model), axis=0)
    assert spread.max() > 20 * NT  # the field does change over the area


@pytest.mark.parametrize("date", [FIRST_YEAR - 0.1, LAST_YEAR + 0.1, np.nan])
def test_a_date_without_a_model_is_refused(date):
    with pytest.raises(ValueError, match="modeled from 2010 to 2030; got the date"):
        field_n([[0.8, 0.2, 0.0]], date)


def test_one_model_follows_the_other():
    """At their common date two models differ by what the forecast of five years missed: below 150 nT."""
    place = [[0.8, 0.2, 0.0]]
    for change in (2015.0, 2020.0, 2025.0):
        step = np.linalg.norm(field_n(place, change) - field_n(place, change - 1e-9)) / NT
        assert 0.0 < step < 150.0
    assert np.isfinite(field_n(place, LAST_YEAR)).all()
    assert field_n(np.empty((0, 3)), 2026.0).shape == (0, 3)
