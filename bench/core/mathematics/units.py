"""Units of measurement at the edges of the bench, and constants that several modules share.

Inside, everything is SI and radians. A name at an edge (a TOML key, a column, a metric) ends in its unit, and
the ending gives the factor to SI.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

STANDARD_GRAVITY = 9.80665  # [m/s^2], exact by definition (3rd CGPM, 1901)
SAME_INSTANT = 1e-6  # times closer than this are the same time [s]: far below any step, far above rounding
DEG = math.pi / 180.0  # [rad]
HOUR = 3600.0  # [s]
ARCSEC = DEG / 3600.0  # [rad]

_G = STANDARD_GRAVITY


class Unit(NamedTuple):
    """A unit of measurement: ``SI = factor * number + offset``."""

    symbol: str
    factor: float = 1.0
    offset: float = 0.0


ENDINGS: Mapping[str, Unit] = {
    "_deg_h_sqrt_h": Unit("deg/h/sqrt(h)", DEG / HOUR / math.sqrt(HOUR)),
    "_deg_s_sqrt_s": Unit("deg/s/sqrt(s)", DEG),
    "_ug_sqrt_h": Unit("ug/sqrt(h)", 1e-6 * _G / math.sqrt(HOUR)),
    "_mg_sqrt_hz": Unit("mg/sqrt(Hz)", 1e-3 * _G),
    "_deg_s_per_mps": Unit("deg/s per m/s", DEG),
    "_mg_per_mps": Unit("mg per m/s", 1e-3 * _G),
    "_deg_h_g2": Unit("deg/h/g^2", DEG / HOUR / _G**2),
    "_deg_s_g2": Unit("deg/s/g^2", DEG / _G**2),
    "_ug_g2": Unit("ug/g^2", 1e-6 / _G),
    "_deg_h_g": Unit("deg/h/g", DEG / HOUR / _G),
    "_deg_s_g": Unit("deg/s/g", DEG / _G),
    "_deg_h_k2": Unit("deg/h/K^2", DEG / HOUR),
    "_deg_s_k2": Unit("deg/s/K^2", DEG),
    "_ug_k2": Unit("ug/K^2", 1e-6 * _G),
    "_deg_h_k": Unit("deg/h/K", DEG / HOUR),
    "_deg_s_k": Unit("deg/s/K", DEG),
    "_ug_k": Unit("ug/K", 1e-6 * _G),
    "_mg_k": Unit("mg/K", 1e-3 * _G),
    "_hpa_sqrt_h": Unit("hPa/sqrt(h)", 100.0 / math.sqrt(HOUR)),
    "_pa_k": Unit("Pa/K"),
    "_per_deg2": Unit("1/deg^2", 1.0 / DEG**2),
    "_per_h": Unit("1/h", 1.0 / HOUR),
    "_per_deg": Unit("1/deg", 1.0 / DEG),
    "_hpa": Unit("hPa", 100.0),
    "_arcsec": Unit("arcsec", ARCSEC),
    "_rpm": Unit("1/min", 2 * math.pi / 60),
    "_degc": Unit("degC", 1.0, 273.15),
    "_deg_s_sqrt_hz": Unit("deg/s/sqrt(Hz)", DEG),
    "_deg_sqrt_h": Unit("deg/sqrt(h)", DEG / math.sqrt(HOUR)),
    "_m_s_sqrt_h": Unit("m/s/sqrt(h)", 1 / math.sqrt(HOUR)),
    "_ug_sqrt_hz": Unit("ug/sqrt(Hz)", 1e-6 * _G),
    "_m_sqrt_s": Unit("m/sqrt(s)"),
    "_percent": Unit("%", 1e-2),
    "_deg_h": Unit("deg/h", DEG / HOUR),
    "_deg_s": Unit("deg/s", DEG),
    "_rad_s": Unit("rad/s"),
    "_m_s2": Unit("m/s^2"),
    "_mrad": Unit("mrad", 1e-3),
    "_km_h": Unit("km/h", 1.0 / 3.6),
    "_mps": Unit("m/s"),
    "_m_s": Unit("m/s"),
    "_deg": Unit("deg", DEG),
    "_rad": Unit("rad"),
    "_dbhz": Unit("dB-Hz"),
    "_chip": Unit("chip"),
    "_ppm": Unit("ppm", 1e-6),
    "_ppb": Unit("ppb", 1e-9),
    "_ug": Unit("ug", 1e-6 * _G),
    "_mg": Unit("mg", 1e-3 * _G),
    "_km": Unit("km", 1e3),
    "_mmps": Unit("mm/s", 1e-3),
    "_mm": Unit("mm", 1e-3),
    "_cm": Unit("cm", 1e-2),
    "_cm3": Unit("cm^3", 1e-6),
    "_dm": Unit("dm", 1e-1),
    "_deg_e7": Unit("deg_e7", 1e-7 * DEG),
    "_100us": Unit("100us", 1e-4),
    "_g": Unit("g", _G),
    "_kg": Unit("kg"),
    "_mw": Unit("mW", 1e-3),
    "_hz": Unit("Hz"),
    "_pa": Unit("Pa"),
    "_nt": Unit("nT", 1e-9),
    "_ut": Unit("uT", 1e-6),
    "_mgauss": Unit("mgauss", 1e-7),
    "_gauss": Unit("gauss", 1e-4),
    "_db": Unit("dB"),
    "_m2": Unit("m^2"),
    "_m": Unit("m"),
    "_ms": Unit("ms", 1e-3),
    "_us": Unit("us", 1e-6),
    "_ns": Unit("ns", 1e-9),
    "_s": Unit("s"),
    "_k": Unit("K"),
}
"""Ending of a name -> its unit; the first that fits counts. dB, dB-Hz and chips are not converted."""

FACTORS: Mapping[str, float] = {unit.symbol: unit.factor for unit in ENDINGS.values()}
"""Symbol of a unit -> factor from it to SI and radians."""

_BARE = Unit("")


def unit_of(name: str) -> str:
    """Return the symbol of the unit at the end of a name; empty if there is none.

    Examples
    --------
    >>> unit_of("noise_deg_sqrt_h"), unit_of("lat_deg"), unit_of("seed")
    ('deg/sqrt(h)', 'deg', '')
    """
    return ENDINGS.get(_find_ending(name), _BARE).symbol


def split_unit(name: str) -> tuple[str, str]:
    """Split a name into the part without its unit and the symbol of the unit.

    Examples
    --------
    >>> split_unit("vel_n_mps"), split_unit("q_nb_w")
    (('vel_n', 'm/s'), ('q_nb_w', ''))
    """
    ending = _find_ending(name)
    return name.removesuffix(ending), ENDINGS.get(ending, _BARE).symbol


def to_si(key: str, value: Any) -> Any:
    """Convert a number, or a tuple of numbers, from the unit at the end of its key to SI and radians.

    Examples
    --------
    >>> to_si("qnh_hpa", 1013.25), to_si("pos_m", (1.0, 2.0, 3.0)), to_si("systems", "gps")
    (101325.0, (1.0, 2.0, 3.0), 'gps')
    """
    unit = ENDINGS.get(_find_ending(key))
    if unit is None or value is None:
        return value
    if isinstance(value, tuple):
        return tuple(to_si(key, part) for part in value)
    return unit.factor * value + unit.offset


def from_si(key: str, value: float) -> float:
    """Convert a number from SI to the unit at the end of its key.

    Examples
    --------
    >>> from_si("reference_degc", 298.15), from_si("rate_hz", 10.0)
    (25.0, 10.0)
    """
    unit = ENDINGS.get(_find_ending(key), _BARE)
    return (value - unit.offset) / unit.factor


def _find_ending(name: str) -> str:
    return next((ending for ending in ENDINGS if name.endswith(ending)), "")
