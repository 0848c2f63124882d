"""The unit that a name at an edge of the bench ends in."""

from __future__ import annotations

_ENDINGS = {
    "_deg_h_sqrt_h": "deg/h/sqrt(h)",
    "_deg_s_sqrt_s": "deg/s/sqrt(s)",
    "_ug_sqrt_h": "ug/sqrt(h)",
    "_mg_sqrt_hz": "mg/sqrt(Hz)",
    "_deg_s_per_mps": "deg/s per m/s",
    "_mg_per_mps": "mg per m/s",
    "_deg_h_g2": "deg/h/g^2",
    "_deg_s_g2": "deg/s/g^2",
    "_ug_g2": "ug/g^2",
    "_deg_h_g": "deg/h/g",
    "_deg_s_g": "deg/s/g",
    "_deg_h_k": "deg/h/K",
    "_deg_s_k": "deg/s/K",
    "_ug_k": "ug/K",
    "_mg_k": "mg/K",
    "_hpa_sqrt_h": "hPa/sqrt(h)",
    "_pa_k": "Pa/K",
    "_per_deg2": "1/deg^2",
    "_per_deg": "1/deg",
    "_hpa": "hPa",
    "_arcsec": "arcsec",
    "_rpm": "1/min",
    "_degc": "degC",
    "_deg_s_sqrt_hz": "deg/s/sqrt(Hz)",
    "_deg_sqrt_h": "deg/sqrt(h)",
    "_m_s_sqrt_h": "m/s/sqrt(h)",
    "_ug_sqrt_hz": "ug/sqrt(Hz)",
    "_m_sqrt_s": "m/sqrt(s)",
    "_percent": "%",
    "_deg_h": "deg/h",
    "_deg_s": "deg/s",
    "_rad_s": "rad/s",
    "_m_s2": "m/s^2",
    "_mrad": "mrad",
    "_mps": "m/s",
    "_m_s": "m/s",
    "_deg": "deg",
    "_rad": "rad",
    "_dbhz": "dB-Hz",
    "_chip": "chip",
    "_ppm": "ppm",
    "_ppb": "ppb",
    "_ug": "ug",
    "_mg": "mg",
    "_km": "km",
    "_g": "g",
    "_hz": "Hz",
    "_pa": "Pa",
    "_nt": "nT",
    "_ut": "uT",
    "_db": "dB",
    "_m2": "m^2",
    "_m": "m",
    "_ms": "ms",
    "_us": "us",
    "_ns": "ns",
    "_s": "s",
    "_k": "K",
}
"""Ending -> unit; where two fit, the longer one stands first."""


def unit_of(name: str) -> str:
    """Return the unit that a name ends in, or an empty text.

    Examples
    --------
    >>> unit_of("noise_deg_sqrt_h"), unit_of("lat_deg"), unit_of("seed")
    ('deg/sqrt(h)', 'deg', '')
    """
    return next((unit for ending, unit in _ENDINGS.items() if name.endswith(ending)), "")


def split_unit(name: str) -> tuple[str, str]:
    """Return a name without the ending that is its unit, and the unit.

    Examples
    --------
    >>> split_unit("vel_n_mps"), split_unit("q_nb_w")
    (('vel_n', 'm/s'), ('q_nb_w', ''))
    """
    ending = next((ending for ending in _ENDINGS if name.endswith(ending)), "")
    return name.removesuffix(ending), _ENDINGS.get(ending, "")
