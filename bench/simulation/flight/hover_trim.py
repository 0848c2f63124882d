"""Hover of a multirotor or a helicopter: its trim in wind, and its stand on the ground."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.flight_specs import HELICOPTER, FlightSpec
from bench.core.words.exceptions import FlightError
from bench.simulation.flight.executive import find_property
from bench.simulation.flight.rotor_cockpit import ROTORS, RotorCockpit
from bench.simulation.flight.standing import come_to_rest, set_down
from bench.simulation.flight.trimming import (
    Say,
    TrimCondition,
    find_root,
    keep_quiet,
    place,
    present_accelerations,
    settle,
    wait,
)

_SCALE = np.array([100.0, 100.0, 100.0, 100.0, 0.1, 0.1])  # rotor speeds [rad/s], roll, pitch [rad]
_PITCHES = np.array([0.1, 0.01, 0.01, 0.1, 0.1, 0.1])  # blades and flapping, roll, pitch [rad]
_HOVERS = 0.3  # share of the fastest speed at which the search begins
_BLADES = (0.1, 0.0, 0.0, 0.1, 0.0, 0.0)  # where the search of a helicopter begins [rad]
_LAGS = 35.0  # time constants after which a rotor turns as told to the last digit
_CLEAR = 10.0  # legs off the ground for the trim of a flight that starts on it [m]
_SETTLED = 1e-9  # largest acceleration a trim may leave [m/s^2, rad/s^2]
_MOST_PITCH = 0.5  # of blades, and of the flapping [rad]
_MULTIROTOR = (
    "rotor/thrust-n_s2",
    "rotor/torque-nm_s2",
    "rotor/lag-rad_sec",
    "rotor/lag-down-rad_sec",
    "rotor/most-rad_sec",
    "rotor/arm-forward-m",
    "rotor/arm-right-m",
    "rotor/density-ratio",
    "guidance/idle-gain",
)
_HELICOPTER = (
    *(f"rotor/{name}-radius-m" for name in ("main", "tail")),
    *(f"rotor/{name}-slope-kg_s" for name in ("main", "tail")),
    *(f"rotor/{name}" for name in ("main-rad_sec", "tail-rad_sec", "tail-behind-m", "flap-lag-sec")),
    *(f"rotor/{name}" for name in ("hub-nm_rad", "cyclic-right", "cyclic-back", "yaw-arm-m")),
    "rotor/direct-rad_sec",
    "guidance/flap-lag-rad_sec",
)
_GAINS = (
    *(f"{loop}-gain" for loop in ("position", "velocity", "height", "climb", "attitude", "yaw")),
    *(f"{loop}-gain" for loop in ("rate", "yaw-rate", "yaw-share")),
    "air-lag-rad_sec",
)


@dataclass(frozen=True, slots=True)
class HoverTrim:
    """A hover at rest over ground."""

    commands: tuple[float, ...]
    """Speeds of the rotors [rad/s]; of a helicopter collective, flap right and back, tail pitch [rad]."""
    roll: float  # [rad]
    pitch: float  # [rad]
    residual: float  # largest acceleration left [m/s^2, rad/s^2]


def trim_hover(fdm: Any, condition: TrimCondition, max_tilt: float, say: Say = keep_quiet) -> HoverTrim:
    """Solve for the hover of a condition, its speed unused, and leave the model there, rotors as trimmed.

    Six accelerations are brought to zero by four rotor speeds, or what a helicopter has, roll and pitch.

    Raises
    ------
    FlightError
        When it hovers at no tilt below ``max_tilt`` [rad].
    """
    if fdm.get_property_manager().get_node("rotor/direct-rad_sec"):  # a helicopter
        lag, least, most = fdm["rotor/direct-rad_sec"], -_MOST_PITCH, _MOST_PITCH
        scale, begin = _PITCHES, np.array(_BLADES)
    else:
        lag = min(fdm["rotor/lag-rad_sec"], fdm["rotor/lag-down-rad_sec"])
        least, most = 0.0, fdm["rotor/most-rad_sec"]
        scale, begin = _SCALE, np.array([_HOVERS * most] * 4 + [0.0, 0.0])
    steps = math.ceil(_LAGS / lag / fdm.get_delta_t())
    fdm["guidance/direct-share"] = 1.0

    def accelerations(x: FloatArray) -> FloatArray:
        say("trimming")
        *commands, roll, pitch = (float(v) for v in x * scale)
        place(fdm, condition, 0.0, 0.0, roll, 0.0, 0.0, 0.0, pitch=pitch, at_rest=True)
        for k in ROTORS:
            fdm[f"guidance/direct{k}-rad_sec"] = commands[k]
        wait(fdm, steps)
        return present_accelerations(fdm)

    x = find_root(accelerations, begin / scale)
    residual = float(np.abs(accelerations(x)).max())
    *commands, roll, pitch = (float(v) for v in x * scale)
    tilt = math.acos(math.cos(roll) * math.cos(pitch))
    if not (residual < _SETTLED and min(commands) > least and max(commands) < most and tilt < max_tilt):
        wind = math.hypot(*condition.wind_n)
        raise FlightError(
            f"no hover found for {fdm.get_model_name()} in a wind of {wind:.3g} m/s: {residual:.2g} m/s^2 or "
            f"rad/s^2 is left at a tilt of {math.degrees(tilt):.0f} deg, {math.degrees(max_tilt):.0f} at most"
        )
    return HoverTrim(tuple(commands), roll, pitch, residual)


def _check_model(fdm: Any, kind: str) -> None:
    """Raise FlightError unless all that the airframe declares and all gains are above 0."""
    airframe = _HELICOPTER if kind == HELICOPTER else _MULTIROTOR
    for name in (*airframe, *(f"guidance/{gain}" for gain in _GAINS)):
        if not (value := find_property(fdm, name).get_double_value()) > 0:
            raise FlightError(f"aircraft {fdm.get_model_name()}: {name} must be above 0; it is {value:g}")


def prepare_hover(fdm: Any, spec: FlightSpec, condition: TrimCondition, say: Say) -> RotorCockpit:
    """Return the guidance of what hovers at the start of a plan, trimmed in a hover or on its legs."""
    _check_model(fdm, spec.aircraft.kind)
    above = _CLEAR if spec.on_ground else 0.0
    trim_hover(fdm, replace(condition, alt=condition.alt + above), spec.aircraft.max_bank, say)
    if spec.on_ground:
        set_down(fdm, condition)
        for k in ROTORS:
            fdm[f"guidance/direct{k}-rad_sec"] = 0.0
        if spec.aircraft.kind == HELICOPTER:  # its rotor turns, and presses it on the ground
            fdm["guidance/direct0-rad_sec"] = fdm["guidance/idle-gain"]
        come_to_rest(fdm, say)
        return RotorCockpit(fdm, spec)
    cockpit = RotorCockpit(fdm, spec)
    cockpit.begin_hover()
    say("settling")
    settle(fdm)
    return cockpit
