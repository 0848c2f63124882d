"""The text of a datasheet from the figures of an IMU."""

from __future__ import annotations

import json
from collections.abc import Mapping

from bench.core.mathematics.units import from_si
from bench.core.records.fields import triad_figures_of
from bench.core.records.sensor_specs import ImuSpec, TriadSpec


def format_sheet(
    spec: ImuSpec,
    title: str,
    source: str,
    sources: Mapping[tuple[str, str], str] | None = None,
    digits: int = 9,
) -> str:
    """Return the text of a datasheet with the figures of the gyros and accelerometers of an IMU.

    Parameters
    ----------
    spec : ImuSpec
        The figures; a figure of 0 is left out.
    title, source : str
        Title, and source of the figures.
    sources : mapping or None
        Source of single figures, by triad and field of `TriadSpec`.
    digits : int
        Significant digits of the figures.

    Examples
    --------
    >>> spec = ImuSpec("mine", TriadSpec(bias_instability=1e-5, bias_correlation=100.0), TriadSpec())
    >>> print(format_sheet(spec, "Mine", "guessed"))
    title = "Mine"
    source = "guessed"
    <BLANKLINE>
    [gyro]
    bias_instability_deg_h = 2.06264806
    bias_correlation_s = 100.0
    <BLANKLINE>
    """
    lines = [f"title = {_quote(title)}", f"source = {_quote(source)}"]
    named = {}
    for name in ("gyro", "accel"):
        triad: TriadSpec = getattr(spec, name)
        rows = []
        for field, figure in triad_figures_of(TriadSpec).items():
            values = triad.by_axis(field)
            if not values.any() or not figure.keys(field, name):
                continue
            key = figure.keys(field, name)[0]
            numbers = [_format(from_si(key, float(value)), digits) for value in values]
            rows.append(f"{key} = " + (numbers[0] if len(set(numbers)) == 1 else f"[{', '.join(numbers)}]"))
            if sources and (name, field) in sources:
                named[f"{name}.{key}"] = sources[name, field]
        if triad.bias_instability and triad.bias_model != TriadSpec().bias_model:
            rows.append(f"bias_model = {_quote(triad.bias_model)}")
        lines += ["", f"[{name}]", *rows] if rows else []
    if named:
        lines += ["", "[sources]", *(f"{_quote(key)} = {_quote(text)}" for key, text in named.items())]
    return "\n".join(lines) + "\n"


def _format(value: float, digits: int) -> str:
    """Return a number as text that TOML reads as a float."""
    text = f"{value:.{digits}g}"
    return text if any(mark in text for mark in ".en") else f"{text}.0"


def _quote(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
