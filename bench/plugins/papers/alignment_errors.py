"""Cost of alignment errors on a route, their propagation, and their estimation from two vectors.

On the sphere an initial heading error leads a leg across track (B-8). An attitude error has three
descriptions (A-5.1.12, A-5.1.13): alpha between the true and the computed local triad, delta at the
computed place, delta_u in inertial axes, which gyro errors alone change. All three are integrated along a
steady course. The error of a quaternion is an integral of the gyro errors along the attitude (B-7),
compared with two exact integrations. A position vector and a velocity vector, known from INS and GNSS,
determine the attitude (B-V); random errors are compared with the covariance. Nothing is flown.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from scipy.integrate import solve_ivp

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.earth import EARTH_RATE
from bench.core.mathematics.units import ARCSEC, DEG, HOUR
from bench.core.records.findings import Findings, FindingTable, make_table, series
from bench.core.records.findings.series import Plot
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import format_number
from bench.evaluation.errors.route_errors import RADIUS, allowed_heading_error, cross_track_error
from bench.experiments.studies.study import Count, Numbers, Positive, Seed, StudyOptions, StudyWorkers
from bench.navigation.models.classic import navigator
from bench.navigation.models.classic.error_dynamics import dynamics_matrix
from bench.navigation.models.classic.navigator import FRD_OF_FUR, NED_OF_ENU, Nav
from bench.plugins.papers.attitude_errors import (
    alpha_of_delta,
    delta_of_alpha,
    delta_of_inertial,
    delta_rate,
    delta_u_rate,
    equatorial_matrix,
    inertial_of_delta,
)
from bench.plugins.papers.mechanizations.error_integral import quaternion_error
from bench.plugins.papers.vector_matching import match_vectors, misalignment

QUESTION = "What position error do alignment errors cause, how do they propagate, and what observes them?"

_ROWS = 9  # epochs of the course in the table
_STEP = 0.01  # of the quaternions [s]
_TURN = np.array([0.05, -0.02, 0.1])  # rates along which their error is integrated [rad/s]


class Options(StudyOptions):
    """Options of the study."""

    heading_deg: Positive = 0.1
    """error of the heading alignment [deg]"""
    lengths_km: Numbers = (50.0, 100.0, 300.0, 1000.0, 3000.0)
    """lengths of the legs [km]"""
    cross_track_m: Positive = 1000.0
    """allowed cross-track error at the end of the leg [m]"""
    lat_deg: Annotated[float, Field(ge=-80, le=80)] = 45.0
    """latitude at the start of the course [deg]"""
    course_deg: Annotated[float, Field(ge=-360, le=360)] = 50.0
    """steady course [deg]"""
    speed_mps: Annotated[float, Field(gt=0, le=1000)] = 200.0
    """ground speed [m/s]"""
    duration_s: Annotated[float, Field(gt=0, le=20_000)] = 5000.0
    """time on the course [s]"""
    gyro_deg_h: Positive = 0.01
    """gyro error of each axis [deg/h]"""
    angles_deg: Numbers = (0.0, 1.0, 10.0, 57.6, 90.0)
    """angles between position vector and velocity vector [deg]"""
    position_m: Positive = 11.2
    """error of the position vector per axis, 1 sigma [m]"""
    velocity_mps: Positive = 0.0707
    """error of the velocity vector per axis, 1 sigma [m/s]"""
    range_km: Positive = 316.0
    """length of the position vector [km]"""
    runs: Count = 1000
    """runs of each angle"""
    seed: Seed = 0
    """seed of the runs"""


def run(options: Options, work: StudyWorkers) -> Findings:
    """Return cross-track errors, and attitude errors along a course, of a quaternion and from two vectors."""
    if min(options.lengths_km) <= 0.0:
        raise ConfigError("study alignment: lengths_km must be above 0")
    work.progress("attitude errors along the course", 0, 2)
    t, errors, apart = travel(options)
    work.progress("two vectors", 1, 2)
    quaternion = list(integrate_errors(options))
    vectors = [match_at(options, angle) for angle in options.angles_deg]
    names = ("t_s", *(f"{name}_{axis}_arcsec" for name in ("alpha", "delta", "delta_u") for axis in "123"))
    rows = np.linspace(0, len(t) - 1, min(_ROWS, len(t))).astype(int)
    course = np.column_stack([t, errors / ARCSEC])[rows].tolist()
    turned = ("t_s", "integral_arcsec", "exact_arcsec", "apart_arcsec")
    told = ("angle_deg", "largest_mrad", "drawn_mrad", "low_mrad", "high_mrad", "observability")
    title = f"Attitude by two vectors, 1 sigma; {options.runs} runs beside the covariance"
    return Findings(
        verdicts=tuple(_tell(options, errors, apart, quaternion, vectors)),
        tables=(
            _fill_route(options),
            make_table(
                "course", f"Attitude errors of {options.gyro_deg_h:g} deg/h on each axis", names, course
            ),
            make_table("quaternion", "Turn of a quaternion by the errors of its rates", turned, quaternion),
            make_table("vectors", title, told, vectors),
        ),
        figures=tuple(_plot(options, t, errors)),
        runs=options.runs,
    )


def _fill_route(options: Options) -> FindingTable:
    heading, off = options.heading_deg * DEG, options.cross_track_m
    rows = [
        (km, cross_track_error(1e3 * km, heading), find_allowed(1e3 * km, off)) for km in options.lengths_km
    ]
    title = f"Across track by {options.heading_deg:g} deg, and the heading error that leads {off:g} m off"
    return make_table("route", title, ("length_km", "cross_track_m", "allowed_deg"), rows)


def find_allowed(length: float, cross_track: float) -> float | None:
    """Return the heading error [deg] that causes a cross-track error [m] on a leg [m]; None if none does."""
    try:
        return allowed_heading_error(length, cross_track) / DEG
    except ValueError:
        return None


def travel(options: Options) -> tuple[FloatArray, FloatArray, float]:
    """Return epochs (M,) [s], alpha, delta and delta_u (M, 9), and the difference between them [rad].

    Each has its own differential equation; alpha is that of the 15 error equations, with position errors.
    """
    course, lat0, height = options.course_deg * DEG, options.lat_deg * DEG, 9000.0
    north = options.speed_mps * math.cos(course) * options.duration_s / RADIUS
    if abs(lat0 + north) > 85.0 * DEG:
        raise ConfigError("study alignment: the course leads within 5 deg of a pole; shorten --duration-s")
    V = options.speed_mps * np.array([math.sin(course), math.cos(course), 0.0])
    eps_b = np.full(3, options.gyro_deg_h * DEG / HOUR)
    C_nb = rotation.matrix(rotation.from_euler(0.0, 0.0, course))
    B = NED_OF_ENU @ C_nb @ FRD_OF_FUR

    def slope(t: float, y: FloatArray) -> FloatArray:
        lat, lon, x, delta = y[0], y[1], y[2:17], y[17:20]
        globe = navigator.ellipsoid(lat, height)
        F = dynamics_matrix(Nav(lat, lon, height, V, B), np.array([0.0, 0.0, globe.g]), globe)
        lon_rate = V[0] / (globe.r1 * math.cos(lat))
        eps = equatorial_matrix(lat) @ B @ eps_b
        felt = np.concatenate([x[:9], eps_b, np.zeros(3)])
        return np.concatenate(
            [
                [V[1] / globe.r2, lon_rate],
                F @ felt,
                delta_rate(lon_rate, delta, eps),
                delta_u_rate(EARTH_RATE * t + lon, eps),
            ]
        )

    alpha = np.array([0.0, 0.0, options.heading_deg * DEG])
    delta = delta_of_alpha(lat0, 0.0, 0.0, alpha)
    inertial = inertial_of_delta(0.0, delta)
    start = np.concatenate([[lat0, 0.0], np.zeros(6), alpha, np.zeros(6), delta, inertial])
    t = np.linspace(0.0, options.duration_s, 201)
    exact: dict[str, Any] = {"rtol": 1e-11, "atol": 1e-16, "method": "DOP853"}
    y = solve_ivp(slope, (0.0, options.duration_s), start, t_eval=t, **exact).y.T
    off = 0.0
    for k, row in enumerate(y):
        by_delta = alpha_of_delta(row[0], row[2], row[3], row[17:20])
        by_inertial = delta_of_inertial(EARTH_RATE * t[k] + row[1], row[20:23])
        both = np.concatenate([by_delta - row[8:11], by_inertial - row[17:20]])
        off = max(off, float(np.abs(both).max()))
    return t, np.hstack([y[:, 8:11], y[:, 17:23]]), off


def integrate_errors(options: Options) -> Iterator[tuple[float, float, float, float]]:
    """Yield time [s] and the turn [arcsec] of a quaternion by the integral of B-7 and by two integrations."""
    t = np.arange(0.0, min(options.duration_s, 600.0) + 0.5 * _STEP, _STEP)
    error = np.full(3, options.gyro_deg_h * DEG / HOUR)
    q, other = (rotation.from_rotvec(np.outer(t, rate)) for rate in (_TURN, _TURN + error))
    found = quaternion_error(t, q, np.tile(error, (len(t), 1)))
    by_integral = 2.0 * rotation.multiply(found, rotation.conjugate(q))[:, 1:]
    exact = rotation.to_rotvec(rotation.multiply(other, rotation.conjugate(q)))
    for k in np.linspace(0, len(t) - 1, min(_ROWS, len(t))).astype(int).tolist():
        sizes = (np.linalg.norm(one[k]) / ARCSEC for one in (by_integral, exact, by_integral - exact))
        yield (float(t[k]), *(float(size) for size in sizes))  # type: ignore[misc]


def match_at(options: Options, angle: float) -> tuple[Any, ...]:
    """Return angle [deg], largest 1 sigma of the attitude by covariance and runs [mrad], observability."""
    across, along = math.sin(angle * DEG), math.cos(angle * DEG)
    position = 1e3 * options.range_km * np.array([1.0, 0.0, 0.0])
    both = np.array([options.speed_mps * np.array([along, across, 0.0]), position])
    sd = np.array([options.velocity_mps, options.position_m])
    match = match_vectors(both, both, sd)
    if not np.isfinite(match.cov).all():
        return angle, None, None, None, None, match.observability
    values, axes = np.linalg.eigh(match.cov)
    rng = np.random.default_rng(options.seed)
    turns = np.array(
        [
            misalignment(np.eye(3), match_vectors(both + sd[:, None] * noise, both, sd).matrix)
            for noise in rng.standard_normal((options.runs, 2, 3))
        ]
    )
    drawn = float(np.sqrt(np.mean(np.square(turns @ axes[:, -1]))))
    half = 1.96 / math.sqrt(2.0 * options.runs)  # of the logarithm of a standard deviation
    ends = (1e3 * drawn * math.exp(-half), 1e3 * drawn * math.exp(half))
    return angle, 1e3 * math.sqrt(values[-1]), 1e3 * drawn, *ends, match.observability


def _tell(
    options: Options,
    errors: FloatArray,
    apart: float,
    quaternion: list[tuple[float, float, float, float]],
    vectors: list[tuple[Any, ...]],
) -> Iterator[str]:
    legs = [
        f"{km:g} km {format_number(cross_track_error(1e3 * km, options.heading_deg * DEG))} m"
        for km in options.lengths_km
    ]
    yield f"{options.heading_deg:g} deg of heading lead across track: {', '.join(legs)}."
    parts = (errors[:, :3], errors[:, 6:])
    alpha, inertial = ([format_number(np.linalg.norm(one[k]) / ARCSEC) for k in (0, -1)] for one in parts)
    yield (
        f"In {options.duration_s:g} s on the course {options.gyro_deg_h:g} deg/h take the attitude error "
        f"from {alpha[0]} to {alpha[1]} arcsec in the local triad and to {inertial[1]} in inertial axes; the "
        f"three descriptions agree within {apart:.1g} rad."
    )
    t, by_integral, exact, off = quaternion[-1]
    yield (
        f"By the integral of the gyro errors a quaternion is turned by {format_number(by_integral)} arcsec "
        f"after {t:g} s, exactly by {format_number(exact)}; they differ by {off:.1g}."
    )
    known = [row for row in vectors if row[1] is not None]
    blind = [f"{row[0]:g} deg" for row in vectors if row[1] is None]
    told = [
        f"{row[0]:g} deg apart {format_number(row[1], 3)} mrad ({format_number(row[2], 3)} drawn)"
        for row in known
    ]
    if told:
        yield f"Vectors of position and velocity give the attitude, worst axis: {'; '.join(told)}."
    if blind:
        yield f"At {', '.join(blind)} they are parallel: the turn about them stays unknown."


def _plot(options: Options, t: FloatArray, errors: FloatArray) -> Iterator[Plot]:
    local, others = ("east", "north", "up"), ("xi", "eta (pole)", "zeta")
    for name, first, axes in (("alpha", 0, local), ("delta", 3, others), ("delta_u", 6, others)):
        lines = []
        for k, axis in enumerate(axes):
            values, color = errors[:, first + k] / ARCSEC, series.AXIS_COLORS[k]
            lines.append(series.draw_line(f"{name} {axis}", t, values, axis, color))
        path = ("alignment", name.replace("_", "-"))
        yield Plot(path, f"attitude error {name} [arcsec]", tuple(lines))
    km = np.geomspace(1.0, 5000.0, 100)
    off = np.array([cross_track_error(1e3 * one, options.heading_deg * DEG) for one in km])
    lines = [series.draw_line("cross-track", km, off, f"{options.heading_deg:g} deg", series.ESTIMATORS[0])]
    path = ("alignment", "route")
    yield Plot(path, "error across track [m]", tuple(lines), across="km", over="length", log="xy")
