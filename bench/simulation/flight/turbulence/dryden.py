"""Dryden turbulence over ground, as a gust field frozen in the air.

Shaping filters of MIL-F-8785C (3.7.1.2, 3.7.2); those of MIL-STD-1797A are the same, with 2 L_v and 2 L_w for
L_v and L_w. They are filters of the distance through the air, not of time: a step of V dt, in calm air, is
their step, so the airspeed may change and an aircraft that stands in still air meets nothing new. Their
discretization is exact for any step.

What hovers has no airspeed that carries it through the field, and gusts live there all the same: the field
goes by at least at the wind at 20 ft of its severity, along the wind. Its axes turn from there to the path of
a faster flight and back slowly, so that a reversal throws no gust round. Wings keep the rule of the standard:
on the ground they meet the field at the wind there is.

Axes: u along the horizontal path through the air, v to its right, w down; p, q, r are the rates of the air
about the axes of the aircraft, with q = -dw/dx and r = dv/dx: the sign that a turning mass of air has.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import FloatArray, join_last
from bench.core.mathematics.random_streams import stream
from bench.core.records.flight_specs import FlightSpec
from bench.simulation.flight.executive import find_property
from bench.simulation.flight.guidance.shaping import GUIDANCE_RATE
from bench.simulation.flight.jsbsim_units import FT
from bench.simulation.flight.turbulence.thermals import through_thermals

GUSTS = ("u", "v", "w", "p", "q", "r")
"""Columns of gusts: [m/s] and [rad/s]."""

RATES = tuple(f"turbulence/{axis}-rad_sec" for axis in "pqr")
"""Properties of the aerodynamics of an aircraft of the bench that take the rates of the air."""

LIGHT = 3
"""Index of exceedance of light turbulence."""

# Wind 20 ft above ground of MIL-F-8785C for light, moderate and severe turbulence (15, 30, 45 kt), at the
# index of its figure 7 that fits each; a straight line between and beyond [ft/s].
_INDEX = (0.0, 3.0, 4.0, 6.0, 7.0)
_WIND_20FT = (0.0, 25.3, 50.6, 76.0, 88.7)
# figure 7 of MIL-F-8785C as tabulated in FGWinds.cpp of JSBSim: intensity [ft/s] by height [ft] and index 1
# to 7
_HEIGHTS = (500, 1750, 3750, 7500, 15000, 25000, 35000, 45000, 55000, 65000, 75000, 80000)
_INTENSITY = (
    (3.2, 2.2, 1.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    (4.2, 3.6, 3.3, 1.6, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    (6.6, 6.9, 7.4, 6.7, 4.6, 2.7, 0.4, 0.0, 0.0, 0.0, 0.0, 0.0),
    (8.6, 9.6, 10.6, 10.1, 8.0, 6.6, 5.0, 4.2, 2.7, 0.0, 0.0, 0.0),
    (11.8, 13.0, 16.0, 15.1, 11.6, 9.7, 8.1, 8.2, 7.9, 4.9, 3.2, 2.1),
    (15.6, 17.6, 23.0, 23.6, 22.1, 20.0, 16.0, 15.1, 12.1, 7.9, 6.2, 5.1),
    (18.7, 21.5, 28.4, 30.2, 30.7, 31.0, 25.2, 23.1, 17.5, 10.7, 8.4, 7.2),
)
_LEAST, _LOW, _HIGH = (
    10.0,
    1000.0,
    2000.0,
)  # where the low-altitude figures begin and end, the others begin [ft]
_LONG = 1750.0  # scale above [ft]
_STALE = 0.005  # filters are made anew when scale or step changed by more than this part
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(20)  # exact for polynomials to the 39th power
_LEADING, _SIGNS = [1, 1, 0], np.array([-1.0, 1.0, -1.0])
"""Component of each eigenvector of the noise whose sign is fixed, and that sign."""
_TURN = math.radians(90.0)  # fastest turn of the axes of what hovers [rad/s]
_MOVING = 0.5  # the direction of a slower path through the air is not looked at [m/s]


def scales_and_intensities(height: float, severity: float) -> tuple[float, float, float, float]:
    """Return L_u (and L_v), L_w [m], sigma_u (and sigma_v), sigma_w [m/s] at a height above ground [m].

    Below 1000 ft by height and the wind at 20 ft (figures 10 and 11), above 2000 ft 1750 ft and figure 7,
    a straight line between. ``severity`` is the index of figure 7, 1 to 7.

    Examples
    --------
    >>> print(np.round(scales_and_intensities(1000.0, 4), 2))
    [533.4  533.4    3.16   3.16]
    """
    h = max(height / FT, _LEAST)
    low, h_low = np.empty(0), min(h, _LOW)
    wind = float(np.interp(severity, _INDEX, _WIND_20FT))
    shape = 0.177 + 0.000823 * h_low
    low = np.array([h_low / shape**1.2, h_low, 0.1 * wind / shape**0.4, 0.1 * wind])
    sigma = float(np.interp(max(h, _HIGH), _HEIGHTS, _INTENSITY[round(severity) - 1]))
    high = np.array([_LONG, _LONG, sigma, sigma])
    share = min(max((h - _LOW) / (_HIGH - _LOW), 0.0), 1.0)
    length_u, length_w, sigma_u, sigma_w = (float(v) * FT for v in low + share * (high - low))
    return length_u, length_w, sigma_u, sigma_w


def carrying_speed(severity: float) -> float:
    """Return the least speed [m/s] at which the gust field goes by what hovers: the wind at 20 ft.

    Examples
    --------
    >>> print(round(carrying_speed(4), 2))
    15.42
    """
    return FT * float(np.interp(severity, _INDEX, _WIND_20FT))


class GustFilters:
    """Unit filters of the six gusts and their exact step.

    States: u; of v and of w each the two poles and the tail that its rate needs; p.

    Parameters
    ----------
    span : float
        Of the wings [m].
    """

    _STATES = 8

    def __init__(self, span: float) -> None:
        # of q and r: 4 b / pi and 3 b / pi [m]
        self.tail_q, self.tail_r = 4 * span / math.pi, 3 * span / math.pi
        self.states = np.zeros(self._STATES)
        self._made = (math.nan, math.nan, math.nan)

    def make_step(self, length_u: float, length_w: float, step: float) -> tuple[FloatArray, FloatArray]:
        """Return transition and noise factor, (8, 8) each, of a step [m] at these scales [m]."""
        wanted = (length_u, length_w, step)
        if not all(abs(new - old) <= _STALE * old for new, old in zip(wanted, self._made, strict=True)):
            self._step, self._made = self._discretize(*wanted), wanted
        return self._step

    def _discretize(self, length_u: float, length_w: float, step: float) -> tuple[FloatArray, FloatArray]:
        phi, noise = np.zeros((self._STATES, self._STATES)), np.zeros((self._STATES, self._STATES))
        for k, length in ((0, length_u), (7, self.tail_q)):
            phi[k, k] = math.exp(-step / length)
            noise[k, k] = math.sqrt(-math.expm1(-2 * step / length))
        for first, length, tail in ((1, length_u, self.tail_r), (4, length_w, self.tail_q)):
            block = slice(first, first + 3)
            phi[block, block], noise[block, block] = discretize_chain(length, tail, step)
        return phi, noise

    def gusts(self, states: FloatArray, height_figures: tuple[float, float, float, float]) -> FloatArray:
        """Return the gusts (T, 6) of states (T, 8), for a result of :func:`scales_and_intensities`."""
        _, length_w, sigma_u, sigma_w = height_figures
        u, v1, v2, v_tail, w1, w2, w_tail, p = states.T
        root = math.sqrt(3.0)
        v, w = root * v1 + (1 - root) * v2, root * w1 + (1 - root) * w2
        # 0.8 (pi L_w / 4b)^(1/3) / L_w, integrated over all wave numbers
        share_p = 0.8 * (length_w / self.tail_q) ** (1 / 3) * math.pi / (2 * length_w * self.tail_q)
        return join_last(
            [
                sigma_u * u,
                sigma_u * v,
                sigma_w * w,
                sigma_w * math.sqrt(share_p) * p,
                -sigma_w * (w - w_tail) / self.tail_q,
                sigma_u * (v - v_tail) / self.tail_r,
            ]
        )


def discretize_chain(length: float, tail: float, step: float) -> tuple[FloatArray, FloatArray]:
    """Exact step of (1 + sqrt(3) L s) / (1 + L s)^2 followed by a lag: transition and noise factor (3, 3).

    The transition is triangular; the covariance is the integral of what a unit pulse becomes, smooth over a
    step that is shorter than the scales.
    """
    t = np.append(0.5 * step * (_NODES + 1.0), step)
    a, b = t / length, t / tail
    fade, lagged = np.exp(-a), np.exp(-b)
    # integrals over the lag: of exp(-a), and of a exp(-a), which a pulse leaves at the two poles
    first = b * fade * _phi_1(a - b)
    second = a * b * lagged * _phi_2(b - a)
    root = math.sqrt(3.0)
    pulse = np.array([fade, a * fade, root * first + (1 - root) * second])
    phi = np.array(
        [
            [fade[-1], 0.0, 0.0],
            [pulse[1, -1], fade[-1], 0.0],
            [pulse[2, -1], (1 - root) * first[-1], lagged[-1]],
        ]
    )
    inside = pulse[:, :-1]
    values, vectors = np.linalg.eigh((inside * (0.5 * step / length * _WEIGHTS)) @ inside.T)
    # the signs of eigenvectors are free; fixed they do not hang on the last digits of a processor
    signs = _SIGNS * np.where(vectors[_LEADING, range(3)] < 0.0, -1.0, 1.0)
    return phi, vectors * signs * np.sqrt(np.maximum(values, 0.0))


def _phi_1(x: FloatArray) -> FloatArray:
    """Return (exp(x) - 1) / x, 1 at 0."""
    return np.divide(np.expm1(x), x, out=np.ones_like(x), where=x != 0.0)


def _phi_2(x: FloatArray) -> FloatArray:
    """Return ((x - 1) exp(x) + 1) / x^2, 1/2 at 0."""
    near = np.abs(x) < 0.1
    series = np.polyval([1 / 403200, 1 / 45360, 1 / 5760, 1 / 840, 1 / 144, 1 / 30, 1 / 8, 1 / 3, 1 / 2], x)
    far = np.divide((x - 1.0) * np.exp(x) + 1.0, x * x, out=series.copy(), where=~near)
    return np.where(near, series, far)


def through_turbulence(fdm: Any, spec: FlightSpec, dt: float) -> Callable[[], Any]:
    """Return the step function of the model in the turbulence and thermals of the plan.

    The gust is zero at the start, where the aircraft is trimmed, and has its full strength after the
    distance of a few scales. Models of others have no property for the rates of the air: they feel u, v
    and w.
    """
    fdm["atmosphere/turb-type"] = 0
    run = through_thermals(fdm, spec, dt)
    return _Turbulence(fdm, spec, dt, run).step if spec.severity else run


class _Turbulence:
    def __init__(self, fdm: Any, spec: FlightSpec, dt: float, run: Callable[[], Any]) -> None:
        def read(name: str) -> Callable[[], float]:
            found: Callable[[], float] = find_property(fdm, name).get_double_value
            return found

        def write(name: str) -> Callable[[float], None]:
            found: Callable[[float], None] = find_property(fdm, name).set_double_value
            return found

        self._run, self._severity, self._dt = run, spec.severity, dt
        self._carried = carrying_speed(spec.severity) / FT if spec.aircraft.hovers else 0.0
        self._per_tick = round(1 / (GUIDANCE_RATE * dt))
        self._filters = GustFilters(fdm["metrics/bw-ft"] * FT)
        self._rng = stream(spec.turbulence_seed, 0, "turbulence")
        self._agl = read("position/h-agl-ft")
        self._over_ground = [read(f"velocities/v-{axis}-fps") for axis in ("north", "east", "down")]
        self._wind = [read(f"atmosphere/wind-{axis}-fps") for axis in ("north", "east", "down")]
        self._set_n = [write(f"atmosphere/gust-{axis}-fps") for axis in ("north", "east", "down")]
        self._set_rates = [write(name) for name in RATES] if spec.aircraft.guided else []
        self._north, self._east = (
            math.cos(spec.heading),
            math.sin(spec.heading),
        )  # of the path through the air
        self._rows: list[list[float]] = []

    def step(self) -> Any:
        """Write the gusts of the next step and fly it."""
        if not self._rows:
            self._go_on()
        u, v, w, *rates = self._rows.pop()
        if self._carried:
            c, s = self._turn
            self._north, self._east = c * self._north - s * self._east, s * self._north + c * self._east
        else:
            self._follow_path()
        set_north, set_east, set_down = self._set_n
        set_north((self._north * u - self._east * v) / FT)
        set_east((self._east * u + self._north * v) / FT)
        set_down(w / FT)
        for write, rate in zip(self._set_rates, rates, strict=False):
            write(rate)
        return self._run()

    def _follow_path(self) -> None:
        """Lay the axes along the path through the air."""
        read_north, read_east, _ = self._over_ground
        north, east = read_north() - self._wind_fps[0], read_east() - self._wind_fps[1]
        speed = math.hypot(north, east)
        if speed * FT > _MOVING:
            self._north, self._east = north / speed, east / speed

    def _plan_turn(self, north: float, east: float) -> None:
        """Plan the turn of the axes of what hovers, step by step, towards a direction until the next tick."""
        across, along = self._north * east - self._east * north, self._north * north + self._east * east
        most = _TURN * self._dt
        turn = max(-most, min(most, math.atan2(across, along) / self._per_tick))
        self._turn = math.cos(turn), math.sin(turn)

    def _go_on(self) -> None:
        """Draw the gusts of the next 0.05 s, with the wind, height and airspeed at its start."""
        self._wind_fps = [read() for read in self._wind]
        path = [read() - wind for read, wind in zip(self._over_ground, self._wind_fps, strict=True)]
        through_air = math.hypot(*path)
        if through_air < self._carried:
            through_air, path = self._carried, [-wind for wind in self._wind_fps]
        if self._carried:
            calm = math.hypot(*path[:2]) * FT < _MOVING
            self._plan_turn(*((self._north, self._east) if calm else path[:2]))
        figures = scales_and_intensities(self._agl() * FT, self._severity)
        phi, noise = self._filters.make_step(figures[0], figures[1], through_air * FT * self._dt)
        drawn = self._rng.standard_normal((self._per_tick, len(phi))) @ noise.T
        states, x = np.empty_like(drawn), self._filters.states
        for k, row in enumerate(drawn):
            x = states[k] = phi.dot(x) + row
        self._filters.states = x.copy()
        self._rows = self._filters.gusts(states, figures)[::-1].tolist()
