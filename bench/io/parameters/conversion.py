"""Write the figures of an IMU in the parameters of another program, and read them back."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bench.core.files.file_checks import check_file
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import from_si, unit_of
from bench.core.records.fields import triad_figures_of
from bench.core.records.sensor_specs import (
    GAUSS_MARKOV_PEAK,
    AxisFigures,
    ImuSpec,
    ThermalSpec,
    TriadSpec,
    VibrationSpec,
)
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import format_number, suggest
from bench.io.parameters.programs import PROGRAMS, TUNINGS, Parameter, Program

_TRIADS = ("gyro", "accel")
_MOST_BYTES = 1_000_000  # of a parameter file
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_NO_TIME = 3600.0  # correlation time of a bias instability of 0 [s]: programs divide by it
_COUNTS = {"one": (1,), "three": (1, 3), "matrix": (9,)}


@dataclass(frozen=True, slots=True)
class Converted:
    """The figures of an IMU in the parameters of another program."""

    program: str
    text: str  # of the file
    lost: tuple[str, ...]  # errors of the datasheet that the program does not have, or has otherwise


def write_parameters(
    spec: ImuSpec, name: str, rate: float | None = None, *, bias_as_walk: bool = False
) -> Converted:
    """Return the figures of an IMU in the parameters of another program.

    Parameters
    ----------
    spec : ImuSpec
        The datasheet.
    name : str
        A key of `PROGRAMS`.
    rate : float or None
        Rate of the samples [Hz], which some parameters depend on.
    bias_as_walk : bool
        Add to K the walk that the bias instability is at short times, sd * sqrt(2 / correlation time).
        Without it a bias instability is never part of K.

    Raises
    ------
    ConfigError
        If there is no such program, it needs a rate, or has no rate random walk for the bias.
    """
    program = _find_program(name)
    if rate is None and (program.needs_rate or any("{rate}" in line for line in program.head)):
        raise ConfigError(f"convert to {name}: its file depends on the rate of the samples; give --rate HZ")
    if bias_as_walk and not any(one.figure == "rate_random_walk" for one in program.parameters):
        raise ConfigError(f"convert to {name}: it has no rate random walk; leave out --bias-as-walk")
    if bias_as_walk:
        spec = replace(spec, gyro=_add_walk(spec.gyro), accel=_add_walk(spec.accel))
    shown = "" if rate is None else f"{rate:.9g}"
    lines = [f"{program.comment} {spec.name} for {program.title}, by bench"]
    if program.head and program.head[0].startswith("%YAML"):
        lines = [program.head[0], *lines]
    lines += [line.format(rate=shown) for line in program.head if not line.startswith("%YAML")]
    for one in program.parameters:
        text = program.line.format(
            key=one.key, values=_lay_out(_convert(spec, one, rate), one.layout or program.layout)
        )
        lines.append(f"{text}  {program.comment} {one.unit}")
    lines += program.tail
    return Converted(name, "\n".join(lines) + "\n", tuple(_list_lost(spec, program)))


def _find_program(name: str) -> Program:
    if name in TUNINGS:
        raise ConfigError(f"no conversion from {name} exists: its parameters are of a whole vehicle")
    if name not in PROGRAMS:
        raise ConfigError(f"program {name!r} is unknown{suggest(name, [*PROGRAMS, *TUNINGS], 'programs')}")
    return PROGRAMS[name]


def _add_walk(triad: TriadSpec) -> TriadSpec:
    """Return a triad with the short-time walk of its bias instability in K, and without bias instability."""
    if not triad.bias_instability:
        return triad
    mean = triad.averaged()
    walk = mean.instability_sd * math.sqrt(2.0 / mean.bias_correlation)
    axes = tuple(one for one in triad.axes if one.name not in ("rate_random_walk", "bias_instability"))
    return replace(
        triad,
        rate_random_walk=math.hypot(mean.rate_random_walk, walk),
        bias_instability=0.0,
        bias_correlation=0.0,
        axes=axes,
    )


def _convert(spec: ImuSpec, one: Parameter, rate: float | None) -> FloatArray:
    """Return a parameter (3,) of another program by axis."""
    triad: TriadSpec = getattr(spec, one.triad)
    instability = one.figure == "instability_sd"
    figure = triad.instability_by_axis if instability else triad.by_axis(one.figure)
    scale = one.scale * (rate**one.rate if rate is not None else 1.0)
    time = triad.bias_correlation or max(spec.gyro.bias_correlation, spec.accel.bias_correlation) or _NO_TIME
    if one.figure == "bias_correlation":
        figure = np.full(3, time)
    scale *= time**one.correlation
    values: FloatArray = (scale * figure) ** one.power
    return values


def _lay_out(values: FloatArray, layout: str) -> str:
    """Return values by axis as the text of one number, of three, or of a matrix by rows."""
    if layout == "one":
        return f"{math.sqrt(float(np.mean(values**2))):.9g}"
    numbers = values if layout == "three" else np.diag(values).ravel()
    return f"[{', '.join(f'{value:.9g}' for value in numbers)}]"


def _list_lost(spec: ImuSpec, program: Program) -> Iterator[str]:
    """Yield one line for each error of a datasheet that a program does not have, or has otherwise."""
    for name in _TRIADS:
        triad: TriadSpec = getattr(spec, name)
        used = {one.figure for one in program.parameters if one.triad == name}
        if "rate_random_walk" in used and not triad.rate_random_walk:
            more = ", which keeps a filter from estimating biases: consider --bias-as-walk"
            yield f"{name} rate random walk: the datasheet has none, 0 is written{more}"
        for field, figure in triad_figures_of(TriadSpec).items():
            value = getattr(triad, field)
            if not value or field in used or (field == "bias_correlation" and "instability_sd" in used):
                continue
            if field == "bias_correlation" or (field == "bias_instability" and "instability_sd" in used):
                continue
            key = figure.keys(field, name)[0]
            words = figure.sought or figure.error or field.replace("_", " ")
            more = "; it is not part of the random walk" if field == "bias_instability" else ""
            yield f"{name} {words} {format_number(from_si(key, value), 3)} {unit_of(key)}: no parameter{more}"
        if triad.bias_instability and "instability_sd" in used and triad.bias_model == "flicker":
            yield f"{name} bias instability: flicker becomes a Gauss-Markov process with the same Allan peak"
        if program.layout == "one" and any(one.name in used for one in triad.axes):
            yield f"{name} axes differ: the root mean square of x, y and z is written"
    times = [one.triad for one in program.parameters if one.figure == "bias_correlation"]
    if times == ["gyro"] and spec.accel.bias_correlation != spec.gyro.bias_correlation:
        yield f"accel correlation time {spec.accel.bias_correlation:g} s: the time of the gyros is used"
    if spec.thermal != ThermalSpec():
        yield "thermal model: no parameter"
    if spec.vibration != VibrationSpec():
        yield "vibration: no parameter"


def read_parameters(path: Path, name: str, rate: float | None = None) -> ImuSpec:
    """Read the noise of an IMU from a parameter file of another program.

    Parameters
    ----------
    path : Path
        The file: text with lines such as ``key: number`` or ``key = [x, y, z]``, each key once.
    name : str
        A key of `PROGRAMS`.
    rate : float or None
        Rate of the samples [Hz], which some parameters depend on.

    Raises
    ------
    ConfigError
        If the file cannot be read, lacks every parameter or has a wrong value, or a rate is missing.
    """
    program, shown = _find_program(name), path.name
    if rate is None and program.needs_rate:
        raise ConfigError(
            f"convert from {name}: its values depend on the rate of the samples; give --rate HZ"
        )
    try:
        check_file(path, shown, _MOST_BYTES)
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ConfigError(f"{shown}: no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{shown}: cannot be read: {' '.join(str(error).split())[:200]}") from None
    text = re.sub(rf"{program.comment}.*", "", text)
    found: dict[str, dict[str, FloatArray]] = {triad: {} for triad in _TRIADS}
    for one in sorted(program.parameters, key=lambda one: one.figure != "bias_correlation"):
        values = _find_values(text, one, program, shown)
        if values is None or one.figure in found[one.triad]:
            continue
        scale = one.scale * (rate**one.rate if rate is not None else 1.0)
        if one.correlation:
            time = float(np.mean(found[one.triad].get("bias_correlation", np.zeros(1))))
            scale *= time**one.correlation if time else math.inf
        found[one.triad][one.figure] = values ** (1.0 / one.power) / scale
    if not any(found.values()):
        wanted = ", ".join(one.key for one in program.parameters)
        raise ConfigError(f"{shown}: has no parameter of {name}; expected {wanted}")
    found["accel"].setdefault("bias_correlation", found["gyro"].get("bias_correlation", np.zeros(1)))
    return ImuSpec(path.stem, _make_triad(found["gyro"]), _make_triad(found["accel"]))


def list_missing(spec: ImuSpec, name: str) -> tuple[str, ...]:
    """Return the keys of a program that a file did not have, or had as 0, by the datasheet read from it."""
    missing = []
    for one in _find_program(name).parameters:
        field = "bias_instability" if one.figure == "instability_sd" else one.figure
        if not getattr(getattr(spec, one.triad), field):
            missing.append(f"{one.key} is missing, or 0")
    return tuple(missing)


def _find_values(text: str, one: Parameter, program: Program, shown: str) -> FloatArray | None:
    """Return the values of a parameter in a file, by axis; None if it is missing."""
    found = re.findall(rf"(?<!\w){re.escape(one.key)}(?!\w)['\"]?[ \t]*[:=(]?(.*)", text)
    if not found:
        return None
    if len(found) > 1:
        raise ConfigError(
            f"{shown}: {one.key} is in it {len(found)} times, expected once; keep one IMU in the file"
        )
    body = re.split(r";|\.reshape", found[0])[0].strip()
    parts = re.sub(r"np\.(array|diag)|[][(){},]", " ", body).split()
    if not all(_NUMBER.fullmatch(part) for part in parts):
        raise ConfigError(f"{shown}: {one.key} = {body[:60]!r} is not a number or a list of numbers")
    values = np.array([float(part) for part in parts])
    counts = _COUNTS[one.layout or program.layout]
    if len(values) not in counts:
        wanted = " or ".join(map(str, counts))
        raise ConfigError(f"{shown}: {one.key} has {len(values)} numbers; expected {wanted}")
    if not (np.isfinite(values) & (values >= 0)).all():
        raise ConfigError(f"{shown}: {one.key} must be finite numbers of 0 or more")
    return values[::4] if len(values) == 9 else values


def _make_triad(found: dict[str, FloatArray]) -> TriadSpec:
    """Return a triad with the figures of a file (1,) or (3,)."""
    figures: dict[str, Any] = {}
    axes = []
    if not found.get("bias_correlation", np.zeros(1)).any():
        found.pop("instability_sd", None)
    for name, values in found.items():
        field, given = name, values
        if name == "instability_sd":
            field, given = "bias_instability", GAUSS_MARKOV_PEAK * values
            figures["bias_model"] = "gauss-markov"
        figures[field] = float(given.max())
        if len(given) == 3 and np.ptp(given) > 1e-6 * given.max() and field != "bias_correlation":
            axes.append(AxisFigures(field, *map(float, given)))
    if not figures.get("bias_instability"):
        figures.pop("bias_correlation", None)
        figures.pop("bias_model", None)
    return TriadSpec(**figures, axes=tuple(axes))


def bound_tuning(spec: ImuSpec, name: str) -> dict[str, list[Any]]:
    """Return the parameters of a filter that no datasheet gives: default, unit, and bound by the IMU.

    Parameters
    ----------
    spec : ImuSpec
        The datasheet.
    name : str
        A key of `TUNINGS`.

    Returns
    -------
    columns : dict
        "parameter", "default", "noise of the IMU" at the step of the filter, which a value should not be
        below, and "unit". "-": the datasheet has no such figure, or it is no bound.
    """
    tuning = TUNINGS[name]
    bounds = [
        float(getattr(getattr(spec, one.triad).averaged(), one.figure)) / math.sqrt(tuning.step)
        if one.figure
        else 0.0
        for one in tuning.parameters
    ]
    return {
        "parameter": [one.key for one in tuning.parameters],
        "default": [f"{one.default:g}" for one in tuning.parameters],
        "noise of the IMU": [f"{bound:.3g}" if bound else "-" for bound in bounds],
        "unit": [one.unit for one in tuning.parameters],
    }
