"""Steady flight: place a model in a state, trim it with a solver of bench, and let it settle.

JSBSim's own trim can hang and needs an engine; ours solves the six equations of steady flight.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.rotation import conjugate, from_euler, rotate
from bench.core.words.exceptions import FlightError
from bench.simulation.flight.jsbsim_units import FT
from bench.simulation.flight.turbulence.wind import set_wind

# alpha, sideslip, roll [rad], aileron, elevator, throttle: what 1 stands for in a search, and the travel
_SCALE = np.array([0.1, 0.1, 0.1, 0.1, 0.1, 1.0])
_LOW, _HIGH = np.array([-0.3, -0.3, -0.5, -1.0, -1.0, 0.0]), np.array([0.4, 0.3, 0.5, 1.0, 1.0, 1.0])
# alpha [rad], elevator, throttle; a search that leaves the travel of a control gets lost: begin elsewhere
_OWN_STARTS = ((0.05, 0.0, 0.6), (0.0, 0.0, 0.9), (0.0, 0.0, 0.6), (0.1, 0.0, 0.4), (0.1, 0.0, 0.9))
_GLIDER_STARTS = ((0.05, 0.0, 1.0), (0.13, -0.15, 1.0), (-0.03, 0.0, 1.0))
_GLIDE = -0.05  # angle of a glide, in place of the throttle: what 1 stands for in a search [rad]
_STEEPEST = 6.0  # glide that is searched for in models of others, in _GLIDE
_FOREIGN_STARTS = ((0.05, 0.0, 0.6), (0.1, -0.1, 0.8), (0.02, 0.1, 0.4))
_ACTUATORS = 200  # steps for actuators to arrive: 0.5 s at 400 Hz
_PARTS = 30.0  # until gear and flaps have moved [s]
_DIFFERENCE = 1e-3  # of a state in a search within travel
_ENGINE_STEP, ENGINE_RUN = 0.01, 20.0  # until spools, propellers and governors are steady [s]
_HISTORY = 5  # past derivatives the integrators of JSBSim keep
_SETTLE = 10.0  # for the lags of guidance to arrive, against corners of 2 rad/s and more [s]
ON_WHEELS = {"rate/rotational": 1, "rate/translational": 1}
"""Euler for the rates on the ground: JSBSim's friction expects it; wheels creep and shiver with others."""
# AB2 for the rates, local linearization, AB4: five times finer than the default
INTEGRATORS = dict.fromkeys(ON_WHEELS, 3) | {"position/rotational": 8, "position/translational": 4}
_ACCELERATIONS = (
    *((f"accelerations/{axis}dot-ft_sec2", FT) for axis in "uvw"),
    *((f"accelerations/{axis}dot-rad_sec2", 1.0) for axis in "pqr"),
)


Say = Callable[[str], None]
"""Called with what is being done besides flying, again and again while it is done."""


def keep_quiet(doing: str) -> None:
    """Report no progress."""


@dataclass(frozen=True, slots=True)
class TrimCondition:
    """A steady flight: position, and motion through the air."""

    lat: float  # [rad]
    lon: float  # [rad]
    alt: float  # ellipsoidal [m]
    heading: float  # [rad]
    speed: float  # true airspeed [m/s]
    climb_angle: float = 0.0  # of the path through the air [rad]
    wind_n: tuple[float, float, float] = (0.0, 0.0, 0.0)  # velocity of the air mass [m/s], n


@dataclass(frozen=True, slots=True)
class Trim:
    """Attitude and control commands of a steady flight."""

    alpha: float  # [rad]
    beta: float  # [rad]
    roll: float  # [rad]
    pitch: float  # [rad]
    aileron: float  # command, -1 to 1
    elevator: float  # command, -1 to 1
    throttle: float  # 0 to 1
    residual: float  # largest acceleration left [m/s^2, rad/s^2]
    climb_angle: float = 0.0  # of the path through the air [rad]


def trim_aircraft(
    fdm: Any,
    condition: TrimCondition,
    *,
    guided: bool = True,
    glides: bool = False,
    say: Say = keep_quiet,
) -> Trim:
    """Solve for the steady flight of a condition, and leave the model there.

    Six accelerations are brought to zero by angle of attack, sideslip, roll, aileron, elevator and throttle;
    the rudder stays centered. Models of the bench answer smoothly and at once: a root is found. Those of
    others have actuators with play, and engines that come to a steady state by iteration and are no smooth
    function of the throttle: least squares within the travel of the controls. A glider has no throttle: the
    angle of its path takes its place, and the condition gives none.

    Parameters
    ----------
    fdm : FGFDMExec
        The model.
    condition : Condition
        The flight.
    guided : bool
        Whether the model was made for the bench.
    glides : bool
        Whether it has no engine.
    say : callable
        Called with "trimming" at each state that is tried.

    Raises
    ------
    FlightError
        When no solution within the travel of the controls is found.
    """

    def accelerations(x: FloatArray) -> FloatArray:
        say("trimming")
        alpha, beta, roll, aileron, elevator, last = (float(v) for v in x * _SCALE)
        where = replace(condition, climb_angle=_GLIDE * last) if glides else condition
        place(fdm, where, alpha, beta, roll, aileron, elevator, 0.0 if glides else last)
        if not guided:
            move_surfaces(fdm, aileron, elevator)
            if not glides:
                run_engines(fdm)
        found = present_accelerations(fdm)
        return found if np.isfinite(found).all() else np.full(6, 1e3)

    starts, settled, solve = _OWN if guided else FOREIGN
    if glides:
        starts = _GLIDER_STARTS
        solve = solve if guided else partial(_fit_within_travel, last=_STEEPEST)
    if not guided:  # gear and flaps come to where they are asked to be
        place(fdm, condition, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5)
        wait(fdm, round(_PARTS / fdm.get_delta_t()))
    residual = math.inf
    for alpha, elevator, throttle in starts:
        x = solve(accelerations, np.array([alpha, 0.0, 0.0, 0.0, elevator, throttle]) / _SCALE)
        left = float(np.abs(accelerations(x)).max())
        if left < residual:
            residual, best = left, x
        if residual < settled:
            break
    alpha, beta, roll, aileron, elevator, throttle = (float(v) for v in best * _SCALE)
    angle, throttle = (_GLIDE * throttle, 0.0) if glides else (condition.climb_angle, throttle)
    if not (residual < settled and 0 <= throttle <= 1 and abs(aileron) <= 1 and abs(elevator) <= 1):
        raise FlightError(
            f"no steady flight found for {fdm.get_model_name()} at {condition.speed:g} m/s, "
            f"{condition.alt:g} m: {residual:.2g} m/s^2 or rad/s^2 is left at throttle "
            f"{throttle:.2f} (0 to 1), elevator {elevator:.2f}, aileron {aileron:.2f} (-1 to 1)"
        )
    pitch = float(fdm["attitude/theta-rad"])
    return Trim(alpha, beta, roll, pitch, aileron, elevator, throttle, residual, angle)


def find_root(f: Callable[[FloatArray], FloatArray], start: FloatArray) -> FloatArray:
    """Return where a function (N,) -> (N,) is zero, searched from a start (N,)."""
    from scipy.optimize import root

    x: FloatArray = root(f, start, method="hybr", options={"xtol": 1e-13, "maxfev": 400}).x
    return x


def _fit_within_travel(
    f: Callable[[FloatArray], FloatArray], start: FloatArray, last: float = 1.0
) -> FloatArray:
    from scipy.optimize import least_squares

    low, high = _LOW / _SCALE, np.append(_HIGH[:-1], last) / _SCALE

    def differences(x: FloatArray) -> FloatArray:
        """Return finite-difference steps that actuators resolve, away from the nearer end of the travel."""
        away = np.where(x + _DIFFERENCE < high, _DIFFERENCE, -_DIFFERENCE)
        here = f(x)
        return np.column_stack([(f(x + step) - here) / away[k] for k, step in enumerate(np.diag(away))])

    found = least_squares(f, start, differences, bounds=(low, high), xtol=1e-12, ftol=1e-14, max_nfev=60)
    x: FloatArray = found.x
    return x


_OWN = (_OWN_STARTS, 1e-9, find_root)
FOREIGN = (_FOREIGN_STARTS, 1e-3, _fit_within_travel)  # 0.1 mg
"""Where the search for a trim begins; the largest acceleration it may leave [m/s^2, rad/s^2]; the search."""


def move_surfaces(fdm: Any, aileron: float, elevator: float) -> None:
    """Move the surfaces to their commands, always from the same side, because actuators may have play."""
    for commands in ((-1.0, -1.0), (aileron, elevator)):
        fdm["fcs/aileron-cmd-norm"], fdm["fcs/elevator-cmd-norm"] = commands
        wait(fdm, _ACTUATORS)


def start_engines(fdm: Any) -> None:
    """Start the engines, which makes the mixture full rich, and lean it to what it was asked to be."""
    find = fdm.get_property_manager().get_node
    nodes = (find(f"fcs/mixture-cmd-norm[{n}]") for n in itertools.count())
    mixtures = list(itertools.takewhile(bool, nodes))
    asked = [node.get_double_value() for node in mixtures]
    fdm["propulsion/set-running"] = -1.0
    for node, value in zip(mixtures, asked, strict=True):
        if value > 0:  # else nobody asked
            node.set_double_value(value)
    wait(fdm, 2)


def run_engines(fdm: Any) -> None:
    """Bring running engines to the steady state of the present throttle, with the aircraft frozen in place.

    They start at full throttle. JSBSim's own search for a steady state steps by 0.5 s, at which a propeller
    with a governor oscillates forever: here they run for a while at a fine step.
    """
    dt = fdm.get_delta_t()
    start_engines(fdm)
    held = {name: fdm[f"simulation/integrator/{name}"] for name in INTEGRATORS}
    for name in held:
        fdm[f"simulation/integrator/{name}"] = 0
    frozen = fdm["propulsion/fuel_freeze"]
    fdm["propulsion/fuel_freeze"] = 1.0  # the next state that is tried has the same mass
    fdm.set_dt(_ENGINE_STEP)
    # always as long: the same throttle gives the same thrust
    for _ in range(round(ENGINE_RUN / _ENGINE_STEP)):
        fdm.run()
    fdm.set_dt(dt)
    fdm["propulsion/fuel_freeze"] = frozen
    for name, number in held.items():
        fdm[f"simulation/integrator/{name}"] = number


def place(
    fdm: Any,
    condition: TrimCondition,
    alpha: float,
    beta: float,
    roll: float,
    aileron: float,
    elevator: float,
    throttle: float,
    *,
    pitch: float | None = None,
    rates_b: tuple[float, float, float] = (0.0, 0.0, 0.0),
    at_rest: bool = False,
) -> None:
    """Put the model into a state and evaluate it; without pitch, the climb angle determines the pitch.

    ``at_rest``: over ground, whatever the airspeed of the condition.

    rates_b is the rate of b relative to the Earth [rad/s]. The wind comes after run_ic,
    whose own wind input turns it by 90 degrees; a step without integration lets the model
    see it.
    """
    if pitch is None:
        pitch = _pitch(alpha, beta, roll, condition.climb_angle)
    q_nb = from_euler(roll, pitch, condition.heading)
    u, v, w = np.zeros(3) if at_rest else _ground_velocity_b(condition, alpha, beta, q_nb)
    # lat and alt depend on each other in the initial conditions: two rounds bring both home
    fdm["ic/lat-geod-rad"] = condition.lat
    fdm["ic/long-gc-rad"] = condition.lon
    for _ in range(2):
        fdm["ic/h-sl-ft"] += condition.alt / FT - fdm["ic/geod-alt-ft"]
        fdm["ic/lat-geod-rad"] = condition.lat
    fdm["ic/phi-rad"], fdm["ic/theta-rad"], fdm["ic/psi-true-rad"] = roll, pitch, condition.heading
    fdm["ic/u-fps"], fdm["ic/v-fps"], fdm["ic/w-fps"] = u / FT, v / FT, w / FT
    fdm["ic/p-rad_sec"], fdm["ic/q-rad_sec"], fdm["ic/r-rad_sec"] = rates_b
    fdm["fcs/aileron-cmd-norm"] = aileron
    fdm["fcs/elevator-cmd-norm"] = elevator
    fdm["fcs/rudder-cmd-norm"] = 0.0
    fdm["guidance/throttle-cmd-norm"] = throttle
    fdm.run_ic()
    for name, number in INTEGRATORS.items():  # run_ic resets them
        fdm[f"simulation/integrator/{name}"] = number
    set_wind(fdm, np.asarray(condition.wind_n))
    wait(fdm, 1)


def settle(fdm: Any) -> None:
    """Let all systems with memory settle in the present steady flight, with the position frozen.

    The lags of the systems get ten seconds of steps without integration, the integrators
    a few steps of a nanosecond: their history still holds the flight without wind.
    """
    dt = fdm.get_delta_t()
    wait(fdm, round(_SETTLE / dt))
    fdm.set_dt(1e-9)
    for _ in range(_HISTORY):
        fdm.run()
    fdm.set_dt(dt)


def wait(fdm: Any, steps: int) -> None:
    """Step the systems of the model without moving it."""
    fdm.suspend_integration()
    for _ in range(steps):
        fdm.run()
    fdm.resume_integration()


def present_accelerations(fdm: Any) -> FloatArray:
    """Return the accelerations of b, linear and angular, (6,) [m/s^2, rad/s^2]."""
    return np.array([fdm[name] * unit for name, unit in _ACCELERATIONS])


def _pitch(alpha: float, beta: float, roll: float, climb_angle: float) -> float:
    """Pitch of a path through the air: Stevens, Lewis and Johnson, 3rd ed. (2016), eq. 3.6-3."""
    a = np.cos(alpha) * np.cos(beta)
    b = np.sin(roll) * np.sin(beta) + np.cos(roll) * np.sin(alpha) * np.cos(beta)
    s = np.sin(climb_angle)
    return float(np.arctan((a * b + s * np.sqrt(a**2 - s**2 + b**2)) / (a**2 - s**2)))


def _ground_velocity_b(condition: TrimCondition, alpha: float, beta: float, q_nb: FloatArray) -> FloatArray:
    through_air = np.array([np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)])
    return condition.speed * through_air + rotate(conjugate(q_nb), np.asarray(condition.wind_n))
