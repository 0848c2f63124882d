"""Flight data: motion, air, controls, and their measurements by the sensors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bench.core.files import disk_arrays
from bench.core.mathematics import rotation
from bench.core.records.data import Trajectory
from bench.core.records.findings.series import (
    AXES_N,
    AXIS_COLORS,
    BAND,
    ESTIMATORS,
    FIX,
    TRUTH,
    Plot,
    Rows,
    Series,
    draw_dots,
    draw_line,
    thin,
)
from bench.core.records.instruments import INSTRUMENTS, Instrument
from bench.core.records.rotor_speeds import ROTORS
from bench.views.plots.content import Content, Tab


def _plots(content: Content) -> Mapping[str, Rows]:
    truth, sensed = content.motion, content.sensed
    keep = thin(truth.t)
    motion = (truth.t, truth.lla, truth.vel_n, truth.q_nb)
    t, lla, vel_n, q_nb = (disk_arrays.take(column, keep) for column in motion)
    air, controls, fixes = truth.air, truth.controls, sensed.data.fixes
    measured: dict[str, list[Series]] = {}
    for name, record in sensed.data.instruments.items():
        measured.setdefault(INSTRUMENTS[name].trace.plot, []).extend(_trace(INSTRUMENTS[name], record))
    euler = disk_arrays.fill(
        (len(t), 3), lambda rows: np.rad2deg(np.column_stack(rotation.to_euler(q_nb[rows])))
    )
    blue, red, grey = ESTIMATORS[0], ESTIMATORS[1], BAND
    known = isinstance(truth, Trajectory)
    what, color = ("true", TRUTH) if known else ("estimated", ESTIMATORS[0])
    altitude = [draw_line(what, t, lla[:, 2], f"{what} (ellipsoidal)", color)]
    altitude += measured.pop("altitude", [])
    if fixes is not None:
        altitude.append(draw_dots("gnss", fixes.t, fixes.lla[:, 2], "GNSS antenna", FIX))
    speed = [
        draw_line("true_airspeed", air.t, air.airspeed_true, "true airspeed", blue),
        draw_line("calibrated_airspeed", air.t, air.airspeed_calibrated, "calibrated airspeed", grey),
        draw_line("ground_speed", t, np.hypot(vel_n[:, 0], vel_n[:, 1]), "ground speed", color),
    ]
    speed += measured.pop("speed", [])
    attitude = [
        draw_line(name, t, euler[:, k], name, AXIS_COLORS[k]) for k, name in enumerate(("roll", "pitch"))
    ]
    wraps = np.abs(np.diff(euler[:, 2], prepend=euler[0, 2])) > 180.0
    heading = [draw_line("heading", t, np.where(wraps, np.nan, euler[:, 2]), "heading", AXIS_COLORS[2])]
    alpha = draw_line("alpha", air.t, np.rad2deg(air.alpha), "angle of attack", blue)
    beta = draw_line("beta", air.t, np.rad2deg(air.beta), "sideslip", red)
    wind = [
        draw_line(axis, air.t, air.wind_n[:, k], f"to the {axis}" if k < 2 else "down", AXIS_COLORS[k])
        for k, axis in enumerate(AXES_N)
    ]
    surfaces = [
        draw_line(name, controls.t, getattr(controls, name), name, AXIS_COLORS[k])
        for k, name in enumerate(("aileron", "elevator", "rudder"))
    ]
    power = [draw_line("throttle", controls.t, 100.0 * controls.throttle, "throttle", blue)]
    engine = [draw_line("speed", air.t, air.engine_speed * 30.0 / np.pi, "engine speed", red)]
    engine = (_draw_rotors(truth, keep) if isinstance(truth, Trajectory) else []) or engine
    groups = [
        [("altitude", "Altitude [m]", altitude), ("speed", "Speed [m/s]", speed)],
        [("attitude", "Roll and pitch [deg]", attitude), ("heading", "Heading [deg]", heading)],
        [("air_angles", "Air angles [deg]", [alpha, beta]), ("wind", "Wind [m/s]", wind)],
        [
            ("surfaces", "Control surfaces [-1 to 1]", surfaces),
            ("throttle", "Throttle [%]", power),
            ("engine", f"{'Rotor' if len(engine) > 1 else 'Engine'} speed [rpm]", engine),
        ],
        *([(name, _measured_title(name), series)] for name, series in measured.items()),
    ]
    rows = []
    for group in groups:  # a truth from a table has no air data and no controls, an attitude no position
        filled = [(name, title, tuple(filter(_has_values, series))) for name, title, series in group]
        rows.append([Plot(("flight", name), title, series) for name, title, series in filled if series])
    return {"": [row for row in rows if row]}


def _has_values(line: Series) -> bool:
    return bool(np.isfinite(line.values).any())


def _draw_rotors(truth: Trajectory, keep: Any) -> list[Series]:
    """Return the speeds of the rotors [rpm] at some rows; none if there are no rotors."""
    if not len(truth.rotors):
        return []
    t, speed = (disk_arrays.take(column, keep) for column in (truth.t, truth.rotors.speed * 30.0 / np.pi))
    return [
        draw_line(place, t, speed[:, k], place.replace("_", " "), ESTIMATORS[k])
        for k, place in enumerate(ROTORS)
    ]


def _trace(row: Instrument, record: Any) -> list[Series]:
    """Return the measurements of an instrument, a line or dots for each component."""
    told, values = row.trace, row.trace.scale * row.values(record)
    if row.width == 1:
        if told.dots:
            return [draw_dots(row.name, record.t, values[:, 0], told.legend, ESTIMATORS[1])]
        return [draw_line(row.name, record.t, values[:, 0], told.legend, BAND)]
    axes = ("forward", "right", "down")
    return [draw_line(axis, record.t, values[:, k], axis, AXIS_COLORS[k]) for k, axis in enumerate(axes)]


def _measured_title(plot: str) -> str:
    """Return the title of a plot with only measurements of instruments."""
    told = next(row.trace for row in INSTRUMENTS.values() if row.trace.plot == plot)
    return f"{told.legend[0].upper()}{told.legend[1:]} [{told.unit}]"


FLIGHT = Tab("Flight", 70, _plots)
