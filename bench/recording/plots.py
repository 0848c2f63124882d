"""Every plot of a recording: errors with the 3 sigma the filter claims, biases, innovations, the flight."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bench import rotation
from bench.arrays import BoolArray, FloatArray
from bench.data import (
    AirData,
    Controls,
    ErrorSeries,
    Events,
    Innovations,
    NavSolution,
    Sensed,
    Trajectory,
    no_air,
    no_controls,
    no_events,
)
from bench.errors import NothingToShowError
from bench.evaluation.consistency import chi2_quantile, nis_by_sensor
from bench.instruments import INSTRUMENTS, Instrument
from bench.units import STANDARD_GRAVITY

TIMELINE = "flight_time"

Colour = tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class Carrier:
    """The motion that carries the vehicle where there is no truth."""

    t: FloatArray  # (N,) [s]
    lla: FloatArray  # (N, 3)
    vel_n: FloatArray  # (N, 3) [m/s], n
    q_nb: FloatArray  # (N, 4)
    air: AirData
    controls: Controls
    events: Events


Motion = Trajectory | Carrier


def carrier(solutions: Mapping[str, NavSolution]) -> Carrier:
    """Return the motion the first estimator that has one says there was, where it is finite."""
    for one in solutions.values():
        good = np.isfinite(np.hstack([one.lla, one.vel_n, one.q_nb])).all(axis=1)
        if good.any():
            rows = (one.t[good], one.lla[good], one.vel_n[good], one.q_nb[good])
            return Carrier(*rows, no_air(), no_controls(), no_events())
    raise NothingToShowError("no estimator has position, velocity and attitude at any instant")


TRUTH: Colour = (110, 190, 90)
FIX: Colour = (255, 205, 50)
OUTAGE: Colour = (255, 150, 0)
FAULT: Colour = (225, 70, 225)
REJECTED: Colour = (255, 60, 60)
BAND: Colour = (150, 150, 150)
AXIS_COLOURS: tuple[Colour, ...] = ((235, 90, 90), (90, 190, 90), (90, 140, 250))  # x, y, z and n, e, d
ESTIMATORS: tuple[Colour, ...] = (
    (70, 150, 255),
    (255, 110, 80),
    (190, 120, 255),
    (0, 195, 195),
    (240, 120, 190),
    (165, 175, 60),
)
ESTIMATOR_NAMES = ("blue", "orange", "violet", "teal", "pink", "olive")

MOST_ROWS = 50.0
"""Poses and plots hold at most this many rows a second [Hz]."""

SLOW = 5.0
"""The same for what only shows how the flight went [Hz]."""

HATCH = 1.0 / 600.0
"""Distance of the strokes that mark an outage, as a fraction of the flight."""

FAR = 20.0
"""A filter whose error is so many times that of the middle one leaves a comparison, and flattens none."""

AXES_N = ("north", "east", "down")
AXES_B = ("x", "y", "z")
DEG_H = np.rad2deg(1.0) * 3600.0  # rad/s to deg/h
MG = 1e3 / STANDARD_GRAVITY  # m/s^2 to mg (standard gravity)

INNOVATIONS = {
    "gnss_position": ("GNSS position", "m"),
    "gnss_velocity": ("GNSS velocity", "m/s"),
    **{row.innovation: (row.quantity, row.unit) for row in INSTRUMENTS.values()},
}
"""Title and unit by sensor."""


@dataclass(frozen=True, slots=True)
class Series:
    """Lines (or marks) that share their times: one entity of a plot."""

    key: str  # last part of the entity path
    t: FloatArray  # (N,) [s]
    values: FloatArray  # (N, k), a column per line, in the unit of the plot
    names: tuple[str, ...]  # k, for the legend
    colours: tuple[Colour, ...]  # k
    widths: tuple[float, ...]  # k [points of the screen]
    marks: bool = False  # dots instead of lines


@dataclass(frozen=True, slots=True)
class Plot:
    """One plot: its entity, the title with the unit, and what it shows."""

    path: str  # entity path
    title: str
    series: tuple[Series, ...]
    scale_from: float = -np.inf  # earlier values do not count for the vertical axis [s]
    far: float = np.inf  # nor a series that reaches so many times farther than the middle one

    def limits(self) -> tuple[float, float]:
        """Return where the vertical axis begins and ends: a little beyond round numbers around the values.

        The viewer writes numbers at powers of ten and their multiples as far as there is room.
        """
        shown = [s.values[s.t >= self.scale_from] for s in self.series]
        shown = [v[np.isfinite(v)] for v in shown]
        reach = np.array([np.abs(v).max(initial=0.0) for v in shown])
        near = reach <= self.far * np.median(reach) if np.isfinite(self.far) else np.ones(len(reach), bool)
        values = np.concatenate([v for v, is_near in zip(shown, near, strict=True) if is_near])
        low, high = (float(values.min()), float(values.max())) if len(values) else (-1.0, 1.0)
        if low < 0.0 < high:
            ten = 10.0 ** np.floor(np.log10(max(-low, high)))
            low, high = -_round_up(-low, ten), _round_up(high, ten)
        else:
            step = round_number(0.3 * (high - low) or 0.1 * abs(high) or 1.0)
            low, high = step * np.floor(low / step), step * np.ceil(high / step)
            if low == high:
                low, high = low - step, high + step
        margin = 0.04 * (high - low)
        return float(low - margin), float(high + margin)


def _round_up(value: float, ten: float) -> float:
    return 10.0 * ten if value > 5.0 * ten else float(0.5 * ten * np.ceil(value / (0.5 * ten)))


Rows = Sequence[Sequence[Plot]]
"""Plots as they stand on a tab, row by row."""

Tabs = Mapping[str, Mapping[str, Rows]]
"""By the name of the tab, then by the label of the estimator."""


def entity(*parts: str) -> str:
    """Return an entity path, with what rerun reserves escaped in each part."""
    import rerun as rr

    return "/" + "/".join(rr.escape_entity_path_part(part) for part in parts)


def thin(t: FloatArray, most: float = MOST_ROWS) -> slice:
    """Return the rows to keep so that no more than ``most`` come in a second [Hz]."""
    if len(t) < 2 or t[-1] <= t[0]:
        return slice(None)
    rate = (len(t) - 1) / (t[-1] - t[0])
    return slice(None, None, max(1, int(np.ceil(rate / most - 1e-6))))


def estimator_colours(labels: Iterable[str]) -> dict[str, Colour]:
    """Return the colour each estimator has in every view."""
    return {label: ESTIMATORS[k % len(ESTIMATORS)] for k, label in enumerate(labels)}


def round_number(value: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not above value.

    Examples
    --------
    >>> round_number(430.0)
    200.0
    """
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= value))


def _pale(colour: Colour) -> Colour:
    """Return the colour of the 3 sigma lines that belong to a line of this colour."""
    return tuple((c + g) // 2 for c, g in zip(colour, BAND, strict=True))  # type: ignore[return-value]


def _line(
    key: str, t: FloatArray, values: FloatArray, name: str, colour: Colour, most: float = SLOW
) -> Series:
    keep = thin(t, most)
    return Series(key, t[keep], values[keep, None], (name,), (colour,), (1.5,))


def _dots(
    key: str, t: FloatArray, values: FloatArray, name: str, colour: Colour, size: float = 1.5
) -> Series:
    return Series(key, t, values[:, None], (name,), (colour,), (size,), marks=True)


def _three_sigma(
    key: str, t: FloatArray, value: FloatArray, sd: FloatArray, name: str, colour: Colour
) -> Series:
    """Return a value with 3 sigma either side of zero: three lines on one entity."""
    keep = thin(t)
    values = np.column_stack([value, 3.0 * sd, -3.0 * sd])[keep]
    pale = _pale(colour)
    return Series(key, t[keep], values, (name, "±3σ", "±3σ"), (colour, pale, pale), (1.5, 1.0, 1.0))


def tabs(
    truth: Motion,
    sensed: Sensed,
    solutions: Mapping[str, NavSolution],
    errors: Mapping[str, ErrorSeries],
    evaluation_from: float,
) -> Tabs:
    """Return every plot, by tab and estimator (label "": none); a tab may turn out empty.

    Plots of an estimator are scaled to what comes after the alignment window, comparisons to the filters that
    stay near the middle one.
    """
    found: dict[str, dict[str, Rows]] = {
        name: {} for name in ("Position", "Velocity", "Attitude", "Biases", "Innovations")
    }
    colours = estimator_colours(solutions)
    for label, solution in solutions.items():
        colour, error = colours[label], errors[label]
        with np.errstate(invalid="ignore"):  # a diverged covariance is a result: its sigma is NaN
            sd = np.sqrt(np.einsum("kii->ki", solution.cov))[np.searchsorted(solution.t, error.t)]
        for tab, unit, values, sigma in (
            ("Position", "m", error.pos_n, sd[:, :3]),
            ("Velocity", "m/s", error.vel_n, sd[:, 3:6]),
            ("Attitude", "deg", np.rad2deg(error.phi_n), np.rad2deg(sd[:, 6:])),
        ):
            found[tab][label] = _error_rows(label, tab.lower(), unit, error.t, values, sigma, colour)
        found["Biases"][label] = _bias_rows(label, sensed, solution, colour)
        found["Innovations"][label] = _innovation_rows(label, solution, error, colour)
    for by_label in found.values():
        for label, rows in by_label.items():
            by_label[label] = [[replace(plot, scale_from=evaluation_from) for plot in row] for row in rows]
    found["Flight"] = {"": _flight_rows(truth, sensed)}
    return {"Comparison": {"": _comparison(errors, colours, evaluation_from)}, **found}


def every(tabs: Tabs) -> Iterator[Plot]:
    """Return the plots of all tabs."""
    for by_label in tabs.values():
        for rows in by_label.values():
            for row in rows:
                yield from row


def _comparison(
    errors: Mapping[str, ErrorSeries], colours: Mapping[str, Colour], evaluation_from: float
) -> Rows:
    """Return what two or more estimators have in common, a line each in one plot."""
    sizes: dict[str, Callable[[ErrorSeries], FloatArray]] = {
        "horizontal position error [m]": lambda e: np.hypot(e.pos_n[:, 0], e.pos_n[:, 1]),
        "vertical position error [m]": lambda e: e.pos_n[:, 2],
        "velocity error, 3D [m/s]": lambda e: np.linalg.norm(e.vel_n, axis=1),
        "heading error [deg]": lambda e: np.rad2deg(e.heading),
    }
    rows = []
    for title, size in sizes.items():
        lines = {label: size(error) for label, error in errors.items()}
        series = tuple(
            _line(entity("of", label)[1:], errors[label].t, values, label, colours[label])
            for label, values in lines.items()
            if np.isfinite(values).any()
        )
        if len(series) > 1:
            path = entity("comparison", title.partition(" ")[0])
            rows.append([Plot(path, title, series, evaluation_from, FAR)])
    return rows


def _error_rows(
    label: str, what: str, unit: str, t: FloatArray, values: FloatArray, sd: FloatArray, colour: Colour
) -> Rows:
    rows = []
    for k, axis in enumerate(AXES_N):
        if np.isfinite(values[:, k]).any():
            title = f"{what} error about {axis}" if what == "attitude" else f"{axis} {what} error"
            series = _three_sigma("error", t, values[:, k], sd[:, k], "error", colour)
            path = entity("estimators", label, what, axis)
            rows.append([Plot(path, f"{label}: {title} [{unit}]", (series,))])
    return rows


def _bias_rows(label: str, sensed: Sensed, solution: NavSolution, colour: Colour) -> Rows:
    drawn = sensed.truth
    gyro = [
        (
            f"gyro_bias_{a}",
            f"gyro bias {a} [deg/h]",
            DEG_H,
            solution.gyro_bias_b[:, k],
            drawn.gyro_bias_b[:, k],
        )
        for k, a in enumerate(AXES_B)
    ]
    accel = [
        (
            f"accel_bias_{a}",
            f"accelerometer bias {a} [mg]",
            MG,
            solution.accel_bias_b[:, k],
            drawn.accel_bias_b[:, k],
        )
        for k, a in enumerate(AXES_B)
    ]
    unknown = np.full((len(drawn.t), 1), np.nan)
    others = [
        (
            f"{name}_bias",
            f"{name} bias [{row.unit}]",
            1.0,
            _extra(solution, f"{name}_bias", solution.extra),
            drawn.bias.get(name, unknown)[:, 0],
        )
        for name, row in INSTRUMENTS.items()
    ]
    rows = []
    for group in (gyro, accel, others):
        row = []
        for name, title, unit, estimate, true in group:
            if not np.isfinite(estimate).any():
                continue
            sd = 3.0 * _extra(solution, name, solution.extra_sd)
            keep = thin(solution.t)
            pale = _pale(colour)
            values = unit * np.column_stack([estimate, estimate + sd, estimate - sd])[keep]
            estimated = Series(
                "estimated",
                solution.t[keep],
                values,
                ("estimated", "±3σ", "±3σ"),
                (colour, pale, pale),
                (1.5, 1.0, 1.0),
            )
            drawn_line = [_line("true", drawn.t, unit * true, "true", TRUTH)] if len(drawn.t) else []
            series = (estimated, *drawn_line)
            row.append(Plot(entity("estimators", label, "bias", name), f"{label}: {title}", series))
        if row:
            rows.append(row)
    return rows


def _extra(solution: NavSolution, name: str, columns: FloatArray) -> FloatArray:
    """Return the column of the extra state ``name_<unit>``, NaN when there is none."""
    for k, full in enumerate(solution.extra_names):
        if full.startswith(f"{name}_"):
            return columns[:, k]
    return np.full(len(solution), np.nan)


def _innovation_rows(label: str, solution: NavSolution, error: ErrorSeries, colour: Colour) -> Rows:
    """Return a row per sensor: the innovation of each component, then the NIS; and the NEES."""
    rows: list[list[Plot]] = []
    table = solution.innovations
    for sensor, nis in nis_by_sensor(table).items():
        title, unit = INNOVATIONS.get(sensor, (sensor, "SI"))
        here = table.code == table.sensor.index(sensor)
        components = np.unique(table.component[here])
        row = []
        for component in components:
            axis = AXES_N[component] if len(components) > 1 else "value"
            path = entity("estimators", label, "innovation", sensor, axis)
            name = f"{title} innovation" if axis == "value" else f"{title} innovation {axis}"
            one = here & (table.component == component)
            row.append(Plot(path, f"{label}: {name} [{unit}]", _innovation_series(table, one, colour)))
        path, dof = entity("estimators", label, "nis", sensor), int(nis.dof.max())
        squares = _dots("value", nis.t, nis.nis, "NIS", colour)
        rows.append([*row, _chi_square(path, f"{label}: NIS of {title}", squares, dof)])
    if np.isfinite(error.nees).any():
        nees = _line("value", error.t, error.nees, "NEES", colour, MOST_ROWS)
        plot = _chi_square(entity("estimators", label, "nees"), f"{label}: NEES", nees, error.states)
        if not rows or len(rows[-1]) > 2:
            rows.append([])
        rows[-1].append(plot)
    return rows


def _innovation_series(table: Innovations, rows: BoolArray, colour: Colour) -> tuple[Series, ...]:
    t, z, three, used = table.t[rows], table.z[rows], 3.0 * np.sqrt(table.S[rows]), table.accepted[rows]
    bounds = Series("bounds", t, np.column_stack([three, -three]), ("±3√S", "±3√S"), (BAND, BAND), (1.0, 1.0))
    series = [bounds, _dots("used", t[used], z[used], "used", colour)]
    if not used.all():
        series.append(_dots("rejected", t[~used], z[~used], "rejected", REJECTED, size=3.0))
    return tuple(series)


def _chi_square(path: str, title: str, squares: Series, dof: int) -> Plot:
    """Return a plot of normalized squares with the central 95 % of chi-square."""
    edges = [chi2_quantile(0.025, dof), chi2_quantile(0.975, dof)]
    band = Series(
        "band", squares.t[[0, -1]], np.array([edges, edges]), ("95 % band",) * 2, (BAND, BAND), (1.0, 1.0)
    )
    return Plot(path, f"{title} ({dof} expected)", (band, squares))


def _flight_rows(truth: Motion, sensed: Sensed) -> Rows:
    keep = thin(truth.t, SLOW)
    t, vel_n = truth.t[keep], truth.vel_n[keep]
    air, controls, fixes = truth.air, truth.controls, sensed.data.fixes
    measured: dict[str, list[Series]] = {}
    for name, record in sensed.data.instruments.items():
        measured.setdefault(INSTRUMENTS[name].trace.plot, []).extend(_trace(INSTRUMENTS[name], record))
    euler = np.rad2deg(np.column_stack(rotation.to_euler(truth.q_nb[keep])))
    blue, red, grey = ESTIMATORS[0], ESTIMATORS[1], BAND
    known = isinstance(truth, Trajectory)
    what, colour = ("true", TRUTH) if known else ("estimated", ESTIMATORS[0])
    altitude = [_line(what, t, truth.lla[keep, 2], f"{what} (ellipsoidal)", colour)]
    altitude += measured.pop("altitude", [])
    if fixes is not None:
        altitude.append(_dots("gnss", fixes.t, fixes.lla[:, 2], "GNSS antenna", FIX))
    speed = [
        _line("true_airspeed", air.t, air.airspeed_true, "true airspeed", blue),
        _line("calibrated_airspeed", air.t, air.airspeed_calibrated, "calibrated airspeed", grey),
        _line("ground_speed", t, np.hypot(vel_n[:, 0], vel_n[:, 1]), "ground speed", colour),
    ]
    speed += measured.pop("speed", [])
    attitude = [
        _line(name, t, euler[:, k], name, AXIS_COLOURS[k]) for k, name in enumerate(("roll", "pitch"))
    ]
    wraps = np.abs(np.diff(euler[:, 2], prepend=euler[0, 2])) > 180.0
    heading = [_line("heading", t, np.where(wraps, np.nan, euler[:, 2]), "heading", AXIS_COLOURS[2])]
    angles = [
        _line("alpha", air.t, np.rad2deg(air.alpha), "angle of attack", blue),
        _line("beta", air.t, np.rad2deg(air.beta), "sideslip", red),
    ]
    wind = [
        _line(axis, air.t, air.wind_n[:, k], f"to the {axis}" if k < 2 else "down", AXIS_COLOURS[k])
        for k, axis in enumerate(AXES_N)
    ]
    surfaces = [
        _line(name, controls.t, getattr(controls, name), name, AXIS_COLOURS[k])
        for k, name in enumerate(("aileron", "elevator", "rudder"))
    ]
    power = [_line("throttle", controls.t, 100.0 * controls.throttle, "throttle", blue)]
    engine = [_line("speed", air.t, air.engine_speed * 30.0 / np.pi, "engine speed", red)]
    groups = [
        [("altitude", "Altitude [m]", altitude), ("speed", "Speed [m/s]", speed)],
        [("attitude", "Roll and pitch [deg]", attitude), ("heading", "Heading [deg]", heading)],
        [("air_angles", "Air angles [deg]", angles), ("wind", "Wind [m/s]", wind)],
        [
            ("surfaces", "Control surfaces [-1 to 1]", surfaces),
            ("throttle", "Throttle [%]", power),
            ("engine", "Engine speed [rpm]", engine),
        ],
        *([(name, _measured_title(name), series)] for name, series in measured.items()),
    ]
    told = [  # a truth that was brought as a table says nothing of the air and the controls
        [(name, title, [line for line in series if len(line.t)]) for name, title, series in group]
        for group in groups
    ]
    return [
        [Plot(entity("flight", name), title, tuple(series)) for name, title, series in group if series]
        for group in told
        if any(series for _, _, series in group)
    ]


def _trace(row: Instrument, record: Any) -> list[Series]:
    """Return what an instrument measured, a line or dots for each component."""
    told, values = row.trace, row.trace.scale * row.values(record)
    if row.width == 1:
        if told.dots:
            return [_dots(row.name, record.t, values[:, 0], told.legend, ESTIMATORS[1])]
        return [_line(row.name, record.t, values[:, 0], told.legend, BAND)]
    axes = ("forward", "right", "down")
    return [_line(axis, record.t, values[:, k], axis, AXIS_COLOURS[k]) for k, axis in enumerate(axes)]


def _measured_title(plot: str) -> str:
    """Return the title of a plot that only instruments have a part in."""
    told = next(row.trace for row in INSTRUMENTS.values() if row.trace.plot == plot)
    return f"{told.legend[0].upper()}{told.legend[1:]} [{told.unit}]"


@dataclass(frozen=True, slots=True)
class Shade:
    """Intervals that are hatched in every plot."""

    key: str  # last part of the entity path
    name: str  # for the legend
    colour: Colour
    intervals: tuple[tuple[float, float], ...]  # (start, end) [s]


def shades(events: Events) -> tuple[Shade, ...]:
    """Return what is hatched: where GNSS is lost, and where faults are scripted."""
    told = (("outage", "GNSS outage", OUTAGE, "gnss_outage"), ("fault", "fault", FAULT, "fault"))
    found = (
        Shade(key, name, colour, tuple((start, end) for start, end, _ in events.of(kind)))
        for key, name, colour, kind in told
    )
    return tuple(shade for shade in found if shade.intervals)


def send(stream: Any, plot: Plot, shades: Sequence[Shade]) -> None:
    """Send the series of a plot, and shades over its whole height."""
    for series in plot.series:
        names, colours = list(series.names), [list(colour) for colour in series.colours]
        _send_series(stream, f"{plot.path}/{series.key}", series, names, colours)
    for shade in shades:
        _send_shade(stream, f"{plot.path}/{shade.key}", shade, plot)


def _send_series(
    stream: Any, entity: str, series: Series, names: list[str], colours: list[list[int]]
) -> None:
    import rerun as rr

    style = (
        rr.SeriesPoints(colors=colours, names=names, marker_sizes=series.widths)
        if series.marks
        else rr.SeriesLines(colors=colours, names=names, widths=series.widths)
    )
    stream.log(entity, style, static=True)
    _send_scalars(stream, entity, series.t, series.values)


def _send_scalars(stream: Any, entity: str, t: FloatArray, values: FloatArray) -> None:
    """Send values (N, k); a row of nothing but NaN becomes an empty one, where the lines break."""
    import rerun as rr

    there = ~np.isnan(values).all(axis=1)
    if len(t):
        stream.send_columns(
            entity,
            [rr.TimeColumn(TIMELINE, duration=t)],
            rr.Scalars.columns(scalars=values[there].ravel()).partition(values.shape[1] * there),
        )


def _send_shade(stream: Any, entity: str, shade: Shade, plot: Plot) -> None:
    """Send a hatch over the height of a plot: it has no shaded region, and a wide line ends in round caps."""
    import rerun as rr

    low, high = plot.limits()
    spacing = HATCH * max(float(series.t[-1]) for series in plot.series if len(series.t))
    t, y = [], []
    for start, end in shade.intervals:
        strokes = max(2, round((end - start) / spacing))
        t.append(np.append(np.linspace(start, end, strokes + 1), end + 1e-6))
        y.append(np.append(np.where(np.arange(strokes + 1) % 2, low, high), np.nan))
    stream.log(
        entity,
        rr.SeriesLines(
            colors=[[*shade.colour, 80]],
            names=shade.name,
            widths=1.0,
            aggregation_policy=rr.components.AggregationPolicy.Off,
        ),
        static=True,
    )
    _send_scalars(stream, entity, np.concatenate(t), np.concatenate(y)[:, None])
