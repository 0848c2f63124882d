"""The Earth's magnetic field by the World Magnetic Model, computed by pygeomag."""

from __future__ import annotations

import datetime
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bench.core.mathematics import earth
from bench.core.mathematics.arrays import FloatArray, as_float

FIRST_YEAR, LAST_YEAR = 2010.0, 2030.0
"""Dates with coefficients: WMM2010 to WMM2025, five years each [decimal years]."""

_CELL = 5000.0  # edge of a cell of the Earth-fixed grid [m], see `field_n`
_CORNERS = np.array(list(product((0, 1), repeat=3)))
# packs the indices of a cell into one number; unique within 2.6 million km
_ONE_NUMBER = np.array([1, 1 << 20, 1 << 40])
_NANOTESLA = 1e-9  # [T]


def field_n(lla: ArrayLike, date: float) -> FloatArray:
    """Return the magnetic field, interpolated in an Earth-fixed grid of 5 km.

    Parameters
    ----------
    lla : (N, 3) array
        Geodetic latitude, longitude [rad], ellipsoidal height [m].
    date : float
        Decimal year, 2010 to 2030.

    Returns
    -------
    field_n : (N, 3) array
        Flux density, north, east, down [T].

    Raises
    ------
    ValueError
        If there is no model for the date, or lla is not finite.

    Notes
    -----
    World Magnetic Model, main field of degree 12. It does not include the fields of the crust, the ionosphere
    and magnetic storms, some hundred nT. The grid needs one model call per corner instead of one per row. It
    is Earth-fixed because n rotates quickly near the poles. The interpolation error is below 0.1 nT.

    Examples
    --------
    >>> print((1e9 * field_n([[np.deg2rad(80.0), 0.0, 0.0]], 2025.0)).round().astype(int))
    [[ 6522   146 54792]]
    """
    lla = as_float("lla", lla, (None, 3))
    _check_date(date)
    place = earth.to_ecef(lla) / _CELL
    cell = np.floor(place).astype(np.int64)
    inside = place - cell
    _, first, kind = np.unique(cell @ _ONE_NUMBER, return_index=True, return_inverse=True)
    field_e = np.zeros((len(lla), 3))
    for corner in _CORNERS:
        found = [_compute_corner(float(date), *map(int, c)) for c in cell[first] + corner]
        values = np.reshape(found, (-1, 3))
        weight = np.prod(np.where(corner, inside, 1.0 - inside), axis=1)
        field_e += weight[:, None] * values[kind]
    to_n = np.swapaxes(earth.matrix_en(lla[:, 0], lla[:, 1]), -1, -2)
    field: FloatArray = np.einsum("kij,kj->ki", to_n, field_e)
    return field


def decimal_year(day: datetime.date) -> float:
    """Convert the beginning of a day to a decimal year.

    Examples
    --------
    >>> decimal_year(datetime.date(2026, 1, 1)), decimal_year(datetime.date(2024, 7, 2))
    (2026.0, 2024.5)
    """
    first = datetime.date(day.year, 1, 1)
    return day.year + (day - first).days / (datetime.date(day.year + 1, 1, 1) - first).days


def _check_date(date: float) -> None:
    if not FIRST_YEAR <= date <= LAST_YEAR:
        raise ValueError(
            f"the magnetic field is modeled from {FIRST_YEAR:g} to {LAST_YEAR:g}; got the date {date:g}"
        )


def wmm(lat: float, lon: float, alt: float, date: float) -> FloatArray:
    """Return the field of the World Magnetic Model (3,) [T], n, at latitude, longitude [rad], height [m]."""
    _check_date(date)
    epoch = min(5.0 * np.floor(date / 5.0), LAST_YEAR - 5.0)
    found = _load_model(int(epoch)).calculate(np.rad2deg(lat), np.rad2deg(lon), alt / 1000.0, date)
    return _NANOTESLA * np.array([found.x, found.y, found.z])


@lru_cache(maxsize=4)
def _load_model(epoch: int) -> Any:
    from pygeomag import GeoMag

    names = {2010: "WMM_2010", 2015: "WMM_2015v2", 2020: "WMM_2020", 2025: "WMM_2025"}
    return GeoMag(coefficients_file=f"wmm/{names[epoch]}.COF")


@lru_cache(maxsize=1 << 16)
def _compute_corner(date: float, x: int, y: int, z: int) -> tuple[float, float, float]:
    """Return the field at a corner of the grid [T], e."""
    lat, lon, alt = earth.to_geodetic(_CELL * np.array([[x, y, z]], np.float64))[0]
    found = earth.matrix_en(lat, lon) @ wmm(lat, lon, alt, date)
    return float(found[0]), float(found[1]), float(found[2])
