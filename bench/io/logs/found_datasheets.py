"""Datasheets from recordings: of an IMU in a file of NaveGo, of a barometer in autopilot parameters.

A sheet is written beside the log, which names it, so that a person can read and correct it.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bench.core.files.places import PACKAGE
from bench.core.mathematics.units import ENDINGS
from bench.core.records.sensor_specs import GAUSS_MARKOV_PEAK
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import one_line, quote_toml
from bench.io.logs.mat_files.mat_file import find_structure, read_mat

_ONE = "bias_correlation"  # a figure that a datasheet has once for all axes
_FIELDS: Mapping[str, Mapping[str, tuple[str, str]]] = {
    "gyro": {
        "noise": ("arw", "_deg_sqrt_h"),
        "rate_random_walk": ("arrw", "_deg_h_sqrt_h"),
        "bias_instability": ("gb_dyn", "_deg_h"),
        "bias_correlation": ("gb_corr", "_s"),
        "turn_on_bias_sd": ("gb_sta", "_deg_h"),
    },
    "accel": {
        "noise": ("vrw", "_m_s_sqrt_h"),
        "rate_random_walk": ("vrrw", "_ug_sqrt_h"),
        "bias_instability": ("ab_dyn", "_ug"),
        "bias_correlation": ("ab_corr", "_s"),
        "turn_on_bias_sd": ("ab_sta", "_ug"),
    },
}
"""Figure of a datasheet, by triad -> its field in NaveGo, its unit here.

Units and meaning by ins-gnss/ins_gnss.m of github.com/rodralez/NaveGo: SI, a row of x, y, z each; ``gb_dyn``
is the standard deviation of a Gauss-Markov process with the correlation time ``gb_corr``.
"""


def read_imu_sheet(path: Path, structure: str) -> str:
    """Return the datasheet in a structure of a NaveGo file, as the text of one; empty if it has none.

    One without the white noise of both triads is none. What is zero, infinite or no number is left out.

    Raises
    ------
    bench.ConfigError
        If the file cannot be read, or has no such structure.
    """
    fields = find_structure(read_mat(path), structure, path.name)
    tables, sources, missing = [], [], []
    for triad, every in _FIELDS.items():
        figures: dict[str, str] = {}
        for figure, (field, ending) in every.items():
            factor = GAUSS_MARKOV_PEAK if figure == "bias_instability" else 1.0
            values = _read_axes(fields, field)
            if values is None:
                missing.append(f"{triad}.{figure}")
                continue
            figures[f"{figure}{ending}"] = _write_axes(values * factor / ENDINGS[ending].factor, figure)
            sources.append(f'"{triad}.{figure}{ending}" = {quote_toml(f"{structure}.{field}")}')
        if not any(key.startswith("noise_") for key in figures):
            return ""
        if "bias_correlation_s" in figures:
            figures["bias_model"] = '"gauss-markov"'
        tables += ["", f"[{triad}]", *(f"{key} = {value}" for key, value in figures.items())]
    left = f"# Not in the file: {', '.join(missing)}." if missing else ""
    head = [
        f"# The IMU of {one_line(path.name)}, by the figures in its structure {one_line(structure)}.",
        *([left] if left else []),
        f"title = {quote_toml(f'IMU of {path.name}')}",
        f"source = {quote_toml(f'{path.name}, structure {structure}')}",
    ]
    return "\n".join([*head, *tables, "", "[sources]", *sources]) + "\n"


def _read_axes(fields: Mapping[str, Any], name: str) -> Any:
    """Return a figure for x, y and z (3,); None if it is no positive number, or one for all is missing."""
    value = fields.get(name)
    if not isinstance(value, np.ndarray) or value.size not in (1, 3):
        return None
    axes = np.broadcast_to(value.reshape(-1), 3)
    return axes if (np.isfinite(axes) & (axes > 0.0)).all() else None


def _write_axes(values: Any, figure: str) -> str:
    """Return a figure as TOML: a number, or one for each axis."""
    axes = [float(f"{one:.9g}") for one in values]
    return f"{max(axes)}" if figure == _ONE or len(set(axes)) == 1 else f"{axes}"


def write_baro_sheet(path: Path, sd: float, says: str, like: str) -> str:
    """Return the datasheet of a barometer with the noise that an autopilot assumes, and the rest of ``like``.

    Parameters
    ----------
    path : Path
        The log.
    sd : float
        Standard deviation of a height [m].
    says : str
        The parameter.
    like : str
        A barometer of the catalog.
    """
    if not sd > 0.0:
        raise ConfigError(f"{path.name}: {says} = {sd:g} is not a standard deviation")
    text = (PACKAGE / "catalog" / "baro" / f"{like}.toml").read_text(encoding="utf-8")
    lines = [f"# The barometer of {one_line(path.name)}: its noise by {says}, all else as {like}."]
    for line in text.splitlines():
        key = line.partition(" = ")[0]
        if key == "title":
            lines.append(f"title = {quote_toml(f'Barometer of {path.name}')}")
        elif key == "white_sd_m":
            lines.append(f"white_sd_m = {sd:g}")
        elif key == '"baro.white_sd_m"':
            lines.append(f'"baro.white_sd_m" = {quote_toml(f"{path.name}, parameter {says}")}')
        elif not line.startswith("#"):
            lines.append(line)
    return "\n".join(lines) + "\n"
