"""``bench allan``: the Allan deviation of a unit of the catalog or of a log, against its datasheet."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.special import gammaincinv

from bench import report
from bench.arrays import FloatArray, IntArray
from bench.config.datasheets import read_imu
from bench.config.library import sensor_file
from bench.data import AirData, Controls, Trajectory, no_events
from bench.errors import ConfigError
from bench.sensors import imu
from bench.sensors.processes import noise_terms
from bench.signals import allan
from bench.specs import ImuSpec, ThermalSpec, TriadSpec, VibrationSpec

FAST, SLOW = (200.0, 300.0), (1.0, 65536.0)
"""Rate [Hz] and length [s] of the two records of a unit: for white noise and quantization, for slow terms."""
_CHANGE = 8.0  # averaging times from here on are those of the slow record [s]
_INDEPENDENT = 16  # fewest averages that fit a record
_TAIL = 0.0005  # each side of a 99.9 % band
_GRAVITY = 9.80665  # [m/s^2]
_UNITS = {"gyro": ("deg/h", math.degrees(3600.0)), "accel": ("ug", 1e6 / _GRAVITY)}
"""Triad -> unit it is shown in, and that unit per SI."""
_COLUMNS = {
    "gyro": {"rad_s": 1.0, "deg_s": math.radians(1.0)},
    "accel": {"m_s2": 1.0, "g": _GRAVITY},
}
"""Triad -> unit its columns of a log may end in -> factor to SI."""


@dataclass(frozen=True, slots=True)
class Curve:
    """The Allan deviation of one triad, its three axes pooled."""

    triad: str  # "gyro" or "accel"
    tau: FloatArray  # (T,) averaging time [s]
    measured: FloatArray  # (T,) root of the mean Allan variance of the axes [unit/s]
    edf: FloatArray  # (T,) effective degrees of freedom of the measured variance
    low: FloatArray  # (T,) 99.9 % band of the measured value around what is expected [unit/s]
    high: FloatArray  # (T,)
    expected: FloatArray  # (T,) of all terms of the datasheet; NaN without one [unit/s]
    terms: Mapping[str, FloatArray] = field(default_factory=dict)  # of each of them

    @property
    def outside(self) -> int:
        """Number of measured values outside their band."""
        return int(np.sum((self.measured < self.low) | (self.measured > self.high)))


def allan_of(unit: str | None, log: Path | None, *, out: Path | None, seed: int, console: Console) -> bool:
    """Print the Allan deviation of a unit or a log and draw it.

    Parameters
    ----------
    unit : str or None
        A unit of the catalog or the path of a datasheet; with a log, what it is compared with.
    log : Path or None
        A CSV file of a unit at rest; without it the unit's own model is measured.
    out : Path or None
        The picture; ``allan-<unit or log>.png`` when None.
    seed : int
        Of the noise of the model.
    console : Console
        Where the tables go.

    Returns
    -------
    held : bool
        Whether at most one value in a hundred of the model lies outside its 99.9 % band; a log is not judged.

    Raises
    ------
    ConfigError
        When the unit or the log is not there or wrong.
    """
    if out is not None and out.suffix not in (".png", ".svg", ".pdf"):
        raise ConfigError(f"{out}: a picture ends in .png, .svg or .pdf")
    spec = None
    if unit is not None:
        spec = read_imu(*sensor_file("imu", unit, Path()))
    if log is not None:
        curves = of_log(log, spec)
        name = log.stem + (f" and {spec.name}" if spec else "")
    elif spec is not None:
        curves = of_unit(spec, seed)
        name = spec.name
    else:
        raise ConfigError("allan needs a unit of the catalog or --log FILE")
    if not curves:
        raise ConfigError(f"{name}: it has no random error to measure")
    for curve in curves:
        _print(console, curve)
        if log is not None:
            console.print(_fitted(curve), soft_wrap=True)
    picture = out or Path(f"allan-{log.stem if log else name}.png")
    report.allan_picture(picture, f"Allan deviation: {name}", [_panel(curve, spec) for curve in curves])
    console.print(f"picture: {picture}")
    if log is not None:
        return True
    points = sum(len(curve.tau) for curve in curves)
    outside = sum(curve.outside for curve in curves)
    console.print(f"{outside} of {points} values lie outside their 99.9 % band.")
    return outside <= max(1, points // 100)


# --- a unit of the catalog ----------------------------------------------------------------------------


def of_unit(spec: ImuSpec, seed: int = 1) -> list[Curve]:
    """Measure the model of a unit at rest and at one temperature, and compare it with its own figures.

    Averaging times below 8 s come from a record at 200 Hz, the others from one of 18 h at 1 Hz. A skewed
    triad is measured along its own axes. Biases are lines between instants 0.05 s (1 s) apart, which the
    curve takes into account: it shows where little white noise covers it.
    """
    resting = replace(spec, thermal=ThermalSpec(), vibration=VibrationSpec(), accel_cone=0.0, accel_arms=())
    triads = {"gyro": spec.gyro, "accel": spec.accel}
    found: dict[str, list[Curve]] = {name: [] for name, triad in triads.items() if noise_terms(triad)}
    for (rate, length), first, last in ((FAST, 0.0, _CHANGE), (SLOW, _CHANGE, np.inf)):
        record, _ = imu.measure(_still(rate, length), resting, seed, 0)
        spans = allan.octaves(len(record), _INDEPENDENT)
        spans = spans[(spans / rate >= first) & (spans / rate < last)]
        for name, increments in (("gyro", record.dtheta_b), ("accel", record.dvel_b)):
            if name in found:
                step = imu.bias_step(triads[name], 1 / rate)
                found[name].append(_curve(name, increments, 1 / rate, spans, triads[name], step))
    return [_joined(parts) for parts in found.values()]


def _still(rate: float, length: float) -> Trajectory:
    """Return a truth that does not turn and feels 1 g, at 25 degC in calm air."""
    n = round(rate * length)
    t = np.arange(n + 1) / rate
    one = np.ones(2)
    air = AirData(
        t=np.array([0.0, t[-1]]),
        pressure=101325.0 * one,
        temperature=298.15 * one,
        airspeed_true=0 * one,
        airspeed_calibrated=0 * one,
        alpha=0 * one,
        beta=0 * one,
        wind_n=np.zeros((2, 3)),
        engine_speed=0 * one,
    )
    controls = Controls(t=air.t, aileron=0 * one, elevator=0 * one, rudder=0 * one, throttle=0 * one)
    fixed, turn = np.zeros((n + 1, 3)), np.zeros((n + 1, 4))
    turn[:, 0] = 1.0
    force = np.zeros((n, 3))
    force[:, 2] = -_GRAVITY / rate
    return Trajectory(t, fixed, fixed, turn, np.zeros((n, 3)), force, air, controls, no_events())


def _curve(
    name: str,
    increments: FloatArray,
    interval: float,
    spans: IntArray,
    triad: TriadSpec | None,
    step: float = 0.0,
) -> Curve:
    """Return the curve of one record, axes pooled, and its band around the figures of a datasheet.

    ``step`` is that of simulated biases [s].
    """
    by_axis = allan.overlapping(increments, interval, spans)
    measured: FloatArray = np.sqrt(np.mean(by_axis**2, axis=1))
    tau = np.multiply(spans, interval, dtype=float)
    terms = noise_terms(triad, step) if triad is not None else {}
    process = allan.total(*terms.values()) if terms else allan.white(1.0)
    axes = increments.shape[1]
    one_axis = [allan.degrees_of_freedom(process, len(increments), interval, int(m)) for m in spans]
    edf: FloatArray = axes * np.array(one_axis)
    expected = allan.deviation(process, tau) if terms else np.full(len(tau), np.nan)
    centre = expected if terms else measured
    low, high = centre * _quantile(edf, _TAIL), centre * _quantile(edf, 1 - _TAIL)
    by_term = {key: allan.deviation(term, tau) for key, term in terms.items()}
    return Curve(name, tau, measured, edf, low, high, expected, by_term)


def _quantile(edf: FloatArray, probability: float) -> FloatArray:
    """Return that quantile of a measured over the expected Allan deviation."""
    ratio: FloatArray = np.sqrt(2 * gammaincinv(edf / 2, probability) / edf)
    return ratio


def _joined(parts: list[Curve]) -> Curve:
    """Return curves of one triad, one after the other, as one."""
    columns = ("tau", "measured", "edf", "low", "high", "expected")
    return Curve(
        parts[0].triad,
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in columns},
        terms={name: np.concatenate([part.terms[name] for part in parts]) for name in parts[0].terms},
    )


# --- a log --------------------------------------------------------------------------------------------


def of_log(path: Path, spec: ImuSpec | None) -> list[Curve]:
    """Measure a log of a unit at rest; compare it with a datasheet when there is one.

    Parameters
    ----------
    path : Path
        CSV with a header: ``t_s`` and, of a triad, ``gyro_x_rad_s``, ``gyro_y_rad_s``, ``gyro_z_rad_s`` (or
        ``deg_s``), ``accel_x_m_s2`` ... (or ``g``): rates, not increments. Other columns are not read.
    spec : ImuSpec or None
        The datasheet.

    Raises
    ------
    ConfigError
        When the file is missing, not such a table, irregular in time or too short; file and line are named.
    """
    t, triads = read_log(path)
    interval = (t[-1] - t[0]) / (len(t) - 1)
    spans = allan.octaves(len(t), _INDEPENDENT)
    return [
        _curve(name, rates * interval, interval, spans, getattr(spec, name) if spec else None)
        for name, rates in triads.items()
    ]


def read_log(path: Path) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Return the times (N,) [s] and the rates (N, 3) of each triad, in SI; raise as `of_log` does."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = csv.reader(file)
            header = [name.strip() for name in next(rows, [])]
            wanted = _wanted(path, header)
            table = []
            for number, row in enumerate(rows, 2):
                try:
                    table.append([float(row[column]) for column, _ in wanted])
                except (ValueError, IndexError):
                    raise ConfigError(
                        f"{path}: line {number}: needs a number in every column of {', '.join(header)}"
                    ) from None
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: not a text file in UTF-8") from None
    values = np.array(table) * [factor for _, factor in wanted] if table else np.empty((0, 1))
    if len(values) < 2 * _INDEPENDENT:
        raise ConfigError(f"{path}: {len(values)} samples; at least {2 * _INDEPENDENT} are needed")
    if not np.isfinite(values).all():
        line = 2 + int(np.argmin(np.isfinite(values).all(axis=1)))
        raise ConfigError(f"{path}: line {line}: a value is not finite")
    t = values[:, 0]
    step = float(np.median(np.diff(t)))
    wrong = np.flatnonzero(np.abs(np.diff(t) - step) > 0.5 * max(step, 0.0))
    if step <= 0 or len(wrong):
        line = 3 + (int(wrong[0]) if len(wrong) else 0)
        raise ConfigError(
            f"{path}: line {line}: t_s must increase by about {step:g} s, as in the rest of the file"
        )
    names = [name for name in _COLUMNS if any(column.startswith(f"{name}_x_") for column in header)]
    return t, {name: values[:, 1 + 3 * k : 4 + 3 * k] for k, name in enumerate(names)}


def _wanted(path: Path, header: list[str]) -> list[tuple[int, float]]:
    """Return position and factor to SI of the columns to read: time, then three per triad there is."""
    if "t_s" not in header:
        raise ConfigError(f"{path}: line 1: no column 't_s'; the header is {', '.join(header)[:80]!r}")
    wanted = [(header.index("t_s"), 1.0)]
    for triad, units in _COLUMNS.items():
        given = [unit for unit in units if f"{triad}_x_{unit}" in header]
        if len(given) > 1:
            raise ConfigError(f"{path}: line 1: {triad} is there in two units; give one of them")
        for unit in given:
            for axis in "xyz":
                column = f"{triad}_{axis}_{unit}"
                if column not in header:
                    raise ConfigError(f"{path}: line 1: no column {column!r}")
                wanted.append((header.index(column), units[unit]))
    if len(wanted) == 1:
        raise ConfigError(f"{path}: line 1: no column 'gyro_x_rad_s' or 'accel_x_m_s2' with its y and z")
    return wanted


def fit(curve: Curve) -> dict[str, float]:
    """Return N, B and K of a measured curve, in SI: white noise, flat part, rate random walk.

    Least squares of the Allan variances with non-negative N^2, B^2, K^2 and a quantization, each variance
    weighted by its degrees of freedom.
    """
    from scipy.optimize import nnls

    tau = curve.tau
    shapes = np.column_stack([3 / tau**2, 1 / tau, np.ones_like(tau), tau / 3])
    weight = np.sqrt(curve.edf) / curve.measured**2
    _, N2, B2, K2 = nnls(shapes * weight[:, None], curve.measured**2 * weight)[0]
    return {"N": math.sqrt(N2), "B": math.sqrt(B2), "K": math.sqrt(K2)}


# --- how it is shown ----------------------------------------------------------------------------------


def _print(console: Console, curve: Curve) -> None:
    unit, factor = _UNITS[curve.triad]
    table = Table(title=f"{curve.triad}, Allan deviation in {unit}", title_justify="left")
    known = bool(curve.terms)
    comparison = ["datasheet", "ratio", "99.9 % band"] if known else []
    for name in ["tau [s]", "measured", *comparison, "degrees of freedom"]:
        table.add_column(name, justify="right", no_wrap=True)
    for k, tau in enumerate(curve.tau):
        row = [f"{tau:g}", f"{factor * curve.measured[k]:.4g}"]
        if known:
            low, ratio, high = (x[k] / curve.expected[k] for x in (curve.low, curve.measured, curve.high))
            row += [f"{factor * curve.expected[k]:.4g}", f"{ratio:.3f}", f"{low:.3f} to {high:.3f}"]
        inside = not known or curve.low[k] <= curve.measured[k] <= curve.high[k]
        table.add_row(*row, f"{curve.edf[k]:.0f}", style=None if inside else "bold red")
    console.print(table)


def _panel(curve: Curve, spec: ImuSpec | None) -> report.AllanPanel:
    unit, factor = _UNITS[curve.triad]
    texts = _figures(curve.triad, getattr(spec, curve.triad)) if spec else {}
    return report.AllanPanel(
        title={"gyro": "Gyroscopes", "accel": "Accelerometers"}[curve.triad],
        unit=unit,
        tau=curve.tau,
        measured=factor * curve.measured,
        low=factor * curve.low,
        high=factor * curve.high,
        expected=factor * curve.expected if curve.terms else None,
        terms={f"{name}, {texts[name]}": factor * term for name, term in curve.terms.items()},
    )


def _figures(name: str, triad: TriadSpec) -> dict[str, str]:
    """Write the figures of a triad's random errors in the units of datasheets, by the name of the error."""
    unit, factor = _UNITS[name]
    root = "deg/sqrt(h)" if name == "gyro" else "m/s/sqrt(h)"
    per_root = math.degrees(60.0) if name == "gyro" else 60.0
    bit = f"{triad.quantization:.3g} {'rad' if name == 'gyro' else 'm/s'}"
    return {
        "quantization": bit,
        "white noise": f"{per_root * triad.random_walk:.3g} {root}",
        "bias instability": f"{factor * triad.bias_instability:.3g} {unit}",
        "rate random walk": f"{60 * factor * triad.rate_random_walk:.3g} {unit}/sqrt(h)",
    }


def _fitted(curve: Curve) -> str:
    """Say the figures of a measured curve in the units of datasheets."""
    found = fit(curve)
    as_triad = TriadSpec(random_walk=found["N"], bias_instability=found["B"], rate_random_walk=found["K"])
    texts = _figures(curve.triad, as_triad)
    del texts["quantization"]
    return f"{curve.triad}, fitted: " + ", ".join(f"{name} {text}" for name, text in texts.items())
