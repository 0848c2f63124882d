"""Load an aircraft into JSBSim safely, trim it with our own solver, linearize it.

JSBSim models are not inert data: ``<output>`` writes any file and ``<input>`` opens
sockets. An aircraft is therefore loaded from a copy without them, in a folder that
is deleted. JSBSim's own trim can hang and needs an engine; ours solves the six
equations of steady flight.
"""

from __future__ import annotations

import ctypes
import re
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from bench.arrays import FloatArray
from bench.errors import FlightError
from bench.flight.units import FT
from bench.flight.wind import set_wind
from bench.rotation import conjugate, from_euler, rotate
from bench.specs import AircraftSpec

NAME = re.compile(r"[A-Za-z0-9_-]+")
_SETTLED = 1e-9  # largest acceleration left in a trimmed flight [m/s^2, rad/s^2]
_TRIM_STARTS = [  # angle of attack, sideslip, roll [rad], aileron, elevator, throttle
    np.array([alpha, 0.0, 0.0, 0.0, 0.0, throttle])
    for alpha, throttle in ((0.05, 0.6), (0.0, 0.9), (0.0, 0.6), (0.1, 0.4), (0.1, 0.9))
]
_HISTORY = 5  # past derivatives the integrators of JSBSim keep
_SETTLE = 10.0  # for the lags of guidance to arrive, against corners of 2 rad/s and more [s]
INTEGRATORS = {  # AB2, AB2, local linearization, AB4: five times finer than the default
    "rate/rotational": 3,
    "rate/translational": 3,
    "position/rotational": 8,
    "position/translational": 4,
}
ON_WHEELS = {"rate/rotational": 1, "rate/translational": 1}
"""Euler for the rates on the ground: JSBSim's friction expects it; wheels creep and shiver with others."""
_ACCELERATIONS = (
    ("accelerations/udot-ft_sec2", FT),
    ("accelerations/vdot-ft_sec2", FT),
    ("accelerations/wdot-ft_sec2", FT),
    ("accelerations/pdot-rad_sec2", 1.0),
    ("accelerations/qdot-rad_sec2", 1.0),
    ("accelerations/rdot-rad_sec2", 1.0),
)


@dataclass(frozen=True, slots=True)
class Condition:
    """A steady flight: where, and how it moves through the air."""

    lat: float  # [rad]
    lon: float  # [rad]
    alt: float  # ellipsoidal [m]
    heading: float  # [rad]
    speed: float  # true airspeed [m/s]
    climb_angle: float = 0.0  # of the path through the air [rad]
    wind_n: tuple[float, float, float] = (0.0, 0.0, 0.0)  # velocity of the air mass [m/s], n


@dataclass(frozen=True, slots=True)
class Trim:
    """Attitude and commands that hold a condition."""

    alpha: float  # [rad]
    beta: float  # [rad]
    roll: float  # [rad]
    pitch: float  # [rad]
    aileron: float  # command, -1 to 1
    elevator: float  # command, -1 to 1
    throttle: float  # 0 to 1
    residual: float  # largest acceleration left [m/s^2, rad/s^2]


def load(aircraft: AircraftSpec, dt: float) -> Any:
    """Return a new, silent FGFDMExec with the aircraft and its guidance system, at step dt [s].

    Raises
    ------
    FlightError
        When the model is missing or JSBSim cannot read it.
    """
    import jsbsim

    if not NAME.fullmatch(aircraft.name):
        raise FlightError(f"aircraft {aircraft.name!r}: a name has letters, digits, '_' and '-' only")
    source = aircraft.folder / f"{aircraft.name}.xml"
    if not source.is_file():
        raise FlightError(f"aircraft {aircraft.name}: {source} is missing")
    log = silent_log()
    with tempfile.TemporaryDirectory(prefix="bench-flight-") as scratch:
        _copy_without_io(aircraft.folder, Path(scratch) / "aircraft" / aircraft.name)
        _copy_without_io(aircraft.systems, Path(scratch) / "systems")
        jsbsim.set_logger(log)
        fdm = jsbsim.FGFDMExec(scratch)
        fdm.set_debug_level(0)
        fdm.set_dt(dt)
        try:
            loaded = fdm.load_model_with_paths(
                aircraft.name,
                f"{scratch}/aircraft",
                f"{jsbsim.get_default_root_dir()}/engine",
                f"{scratch}/systems",
            )
            loaded = loaded and fdm.run_ic()  # a property that does not exist shows only here
        except RuntimeError as error:
            _abandon(fdm)
            raise FlightError(f"aircraft {aircraft.name}: {one_line(str(error), scratch)}") from None
        if not loaded:
            _abandon(fdm)
            reason = one_line(" ".join(log.lines), scratch)
            raise FlightError(f"aircraft {aircraft.name}: JSBSim cannot load it: {reason}")
    set_gains(fdm, aircraft)
    return fdm


def set_gains(fdm: Any, aircraft: AircraftSpec) -> None:
    """Give guidance the gains and limits of an aircraft.

    Raises
    ------
    FlightError
        When a gain is none.
    """
    for name, gain in aircraft.gains.items():
        if not NAME.fullmatch(name):
            raise FlightError(f"aircraft {aircraft.name}: [guidance] {name!r} is no name of a gain")
        node(fdm, f"guidance/{name}").set_double_value(gain)
    fdm["guidance/bank-limit-rad"] = aircraft.max_bank
    fdm["guidance/climb-limit-mps"] = aircraft.max_climb
    fdm["guidance/descent-limit-mps"] = aircraft.max_descent


def trim(fdm: Any, condition: Condition) -> Trim:
    """Solve for the steady flight of a condition, and leave the model there.

    Six accelerations are brought to zero by angle of attack, sideslip, roll, aileron,
    elevator and throttle; the rudder stays centred.

    Raises
    ------
    FlightError
        When no solution within the travel of the controls is found.
    """
    from scipy.optimize import root

    scale = np.array([0.1, 0.1, 0.1, 0.1, 0.1, 1.0])

    def accelerations(x: FloatArray) -> FloatArray:
        alpha, beta, roll, aileron, elevator, throttle = x * scale
        place(fdm, condition, alpha, beta, roll, aileron, elevator, throttle)
        return present_accelerations(fdm)

    # a search that leaves the travel of a control gets lost where nothing changes any more: begin elsewhere
    for start in _TRIM_STARTS:
        solution = root(accelerations, start / scale, method="hybr", options={"xtol": 1e-13, "maxfev": 400})
        residual = float(np.abs(accelerations(solution.x)).max())
        if residual < _SETTLED:
            break
    alpha, beta, roll, aileron, elevator, throttle = (float(v) for v in solution.x * scale)
    where = f"{fdm.get_model_name()} at {condition.speed:g} m/s, {condition.alt:g} m"
    if not (residual < _SETTLED and 0 <= throttle <= 1 and abs(aileron) <= 1 and abs(elevator) <= 1):
        raise FlightError(
            f"no steady flight found for {where}: {residual:.2g} m/s^2 or rad/s^2 is left at throttle "
            f"{throttle:.2f} (0 to 1), elevator {elevator:.2f}, aileron {aileron:.2f} (-1 to 1)"
        )
    pitch = float(fdm["attitude/theta-rad"])
    return Trim(alpha, beta, roll, pitch, aileron, elevator, throttle, residual)


def place(
    fdm: Any,
    condition: Condition,
    alpha: float,
    beta: float,
    roll: float,
    aileron: float,
    elevator: float,
    throttle: float,
    *,
    pitch: float | None = None,
    rates_b: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> None:
    """Put the model into a state and evaluate it there; without pitch, the climb angle gives it.

    rates_b is the rate of b relative to the Earth [rad/s]. The wind comes after run_ic,
    whose own wind input turns it by 90 degrees; a step without integration lets the model
    see it.
    """
    if pitch is None:
        pitch = _pitch(alpha, beta, roll, condition.climb_angle)
    u, v, w = _ground_velocity_b(condition, alpha, beta, from_euler(roll, pitch, condition.heading))
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
    """Let everything with a memory arrive at the present steady flight, which does not move on.

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


def node(fdm: Any, name: str) -> Any:
    """Return a property of the model by its JSBSim name.

    Raises
    ------
    FlightError
        When the model does not have it.
    """
    found = fdm.get_property_manager().get_node(name)
    if found is None:
        raise FlightError(f"aircraft {fdm.get_model_name()}: the model has no property {name}")
    return found


def linearize(fdm: Any, condition: Condition, trimmed: Trim, step: float = 1e-4) -> FloatArray:
    """Return the state matrix about a trimmed flight by central differences, (8, 8).

    States: u, v, w [m/s], p, q, r [rad/s], roll, pitch [rad], body axes, no wind.
    """
    V, alpha, beta = condition.speed, trimmed.alpha, trimmed.beta
    x0 = np.array(
        [
            *(V * np.array([np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)])),
            *(0.0, 0.0, 0.0),
            *(trimmed.roll, trimmed.pitch),
        ]
    )

    def derivative(x: FloatArray) -> FloatArray:
        u, v, w, p, q, r, roll, pitch = (float(value) for value in x)
        speed = float(np.linalg.norm(x[:3]))
        moved = Condition(condition.lat, condition.lon, condition.alt, condition.heading, speed)
        place(
            fdm,
            moved,
            float(np.arctan2(w, u)),
            float(np.arcsin(v / speed)),
            roll,
            trimmed.aileron,
            trimmed.elevator,
            trimmed.throttle,
            pitch=pitch,
            rates_b=(p, q, r),
        )
        roll_rate = p + np.tan(pitch) * (q * np.sin(roll) + r * np.cos(roll))
        pitch_rate = q * np.cos(roll) - r * np.sin(roll)
        return np.array([*present_accelerations(fdm), roll_rate, pitch_rate])

    columns = [(derivative(x0 + e) - derivative(x0 - e)) / (2 * step) for e in step * np.eye(8)]
    return np.column_stack(columns)


def present_accelerations(fdm: Any) -> FloatArray:
    """Return the accelerations of b, linear and angular, (6,) [m/s^2, rad/s^2]."""
    return np.array([fdm[name] * unit for name, unit in _ACCELERATIONS])


def _pitch(alpha: float, beta: float, roll: float, climb_angle: float) -> float:
    """Pitch of a path through the air: Stevens, Lewis and Johnson, 3rd ed. (2016), eq. 3.6-3."""
    a = np.cos(alpha) * np.cos(beta)
    b = np.sin(roll) * np.sin(beta) + np.cos(roll) * np.sin(alpha) * np.cos(beta)
    s = np.sin(climb_angle)
    return float(np.arctan((a * b + s * np.sqrt(a**2 - s**2 + b**2)) / (a**2 - s**2)))


def _ground_velocity_b(condition: Condition, alpha: float, beta: float, q_nb: FloatArray) -> FloatArray:
    through_air = np.array([np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)])
    return condition.speed * through_air + rotate(conjugate(q_nb), np.asarray(condition.wind_n))


def _copy_without_io(source: Path, target: Path) -> None:
    """Copy a folder of JSBSim files; ``<input>`` and ``<output>`` of a model are left out."""
    shutil.copytree(source, target)
    for path in sorted(target.rglob("*.xml")):
        try:
            tree = ElementTree.parse(path)
        except ElementTree.ParseError as error:
            raise FlightError(f"{source / path.relative_to(target)}: not well-formed XML: {error}") from None
        model = tree.getroot()
        if b"<!DOCTYPE" in path.read_bytes() or any("}" in str(element.tag) for element in model.iter()):
            # JSBSim sees other names than a reader of plain XML does
            place = source / path.relative_to(target)
            raise FlightError(f"{place}: a DOCTYPE or an XML namespace has no place in a JSBSim file")
        unwanted = [child for child in model if child.tag in ("input", "output")]
        for child in unwanted:
            model.remove(child)
        if unwanted:
            tree.write(path, encoding="utf-8", xml_declaration=True)


def silent_log() -> Any:
    """Return a logger that keeps what JSBSim says and prints nothing."""
    import jsbsim

    class Log(jsbsim.DefaultLogger):
        def __init__(self) -> None:
            super().__init__()
            self.lines: list[str] = []

        def message(self, message: str) -> None:
            if not message.isspace() and "JSBSim startup" not in message:
                self.lines.append(message)

        def file_location(self, filename: str, line: int) -> None:
            self.lines.append(f"{filename}:{line}:")

        def format(self, format: Any) -> None:  # noqa: A002 (the name JSBSim calls)
            pass

        def flush(self) -> None:
            pass

    return Log()


def _abandon(fdm: Any) -> None:
    """Keep a broken model for good: the destructor of one may throw and end the process."""
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(fdm))


def one_line(text: str, scratch: str) -> str:
    """Return what JSBSim said as one line, without the scratch folder."""
    return " ".join(text.replace(f"{scratch}/", "").split())[:300] or "no reason given"
