"""Fly an aircraft that was not made for the bench: of the jsbsim wheel, or of the user.

The guidance system of the bench is added to a copy of it. Three things differ from the
aircraft of the bench: its engines take fcs/throttle-cmd-norm, one for each, which is one
more output of guidance; they have a state, so they are set running at the throttle of
every trim; and its start may need properties of its own (mixture, gear up).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from bench.arrays import FloatArray
from bench.data import Trajectory
from bench.errors import FlightError
from bench.flight import sanity
from bench.flight.foreign import copy_aircraft, executive, read_xml, write_xml
from bench.flight.model import (
    Condition,
    Trim,
    node,
    one_line,
    place,
    present_accelerations,
    set_gains,
    silent_log,
    wait,
)
from bench.flight.recorder import begin, simulation_step
from bench.flight.sequencer import Cockpit, FlownLeg, fly_legs
from bench.flight.shaping import GUIDANCE_RATE
from bench.flight.tape import Tape, motion_of, pieces, truth_of, with_air
from bench.flight.wind import Weather
from bench.specs import AircraftSpec, FlightSpec, ForeignSpec

_SETTLED = 1e-3  # largest acceleration left in a trimmed flight [m/s^2, rad/s^2]: 0.1 mg
_NEIGHBOURS = 3  # steps beyond the end that its truth depends on: 2 by velocity, 1 by increments
_ACTUATORS = 200  # steps for actuators to arrive: 0.5 s at 400 Hz
_ROUNDS = 20  # of JSBSim's search for the steady state of the engines
_PROPERTY = re.compile(r"[A-Za-z0-9_/.\[\]-]+")
_THROTTLE = "guidance/throttle-cmd-norm"
_STARTS = ((0.05, 0.0, 0.6), (0.1, -0.1, 0.8), (0.02, 0.1, 0.4))  # alpha [rad], elevator, throttle


def fly_pieces(spec: FlightSpec, progress: Callable[[float], None], seconds: float) -> Iterator[Trajectory]:
    """Fly a plan with a foreign aircraft, with the working directory as scratch folder.

    Parameters
    ----------
    spec : FlightSpec
        The plan; its rate is a multiple of 20 Hz and its aircraft has a foreign part.
    progress : callable
        Called with the time flown so far [s].
    seconds : float
        Length of a piece [s].

    Returns
    -------
    iterator of Trajectory
        Truth at spec.rate in pieces: the motion of the IMU, a fixed point of the body that is given
        from the centre of gravity at the start. Events hold the flown legs and the sanity report.

    Raises
    ------
    FlightError
        When the aircraft cannot be loaded, trimmed, or flown as planned.
    """
    assert spec.aircraft.foreign is not None
    substeps, dt = simulation_step(spec.rate)
    fdm, cockpit = prepare(spec, dt)
    tape = Tape(fdm, dt)
    steps = range(round(1.0 / (GUIDANCE_RATE * dt)))
    flown: list[FlownLeg] = []
    tape.step()
    for t in fly_legs(cockpit, spec, flown, Weather(fdm, spec)):
        tape.tick()
        for _ in steps:
            fdm.run()
            tape.step()
        progress(t)
    tape.tick()
    for _ in range(_NEIGHBOURS):
        fdm.run()
        tape.step()
    motion, ticks = motion_of(dt, tape.columns(), spec.aircraft.imu_b), tape.ticks()
    events = [(leg.start, leg.end, "leg", leg.text) for leg in flown]
    events += sanity.report(motion, ticks, spec.aircraft.category)
    return pieces(with_air(truth_of(motion, substeps, events), ticks), seconds)


def prepare(spec: FlightSpec, dt: float) -> tuple[Any, Cockpit]:
    """Return the model at the start of the plan in its wind, trimmed or standing, and its guidance."""
    assert spec.aircraft.foreign is not None
    fdm = load(spec.aircraft, spec.aircraft.foreign, dt)
    return fdm, begin(fdm, spec, trim, _run_engines)


def load(aircraft: AircraftSpec, foreign: ForeignSpec, dt: float) -> Any:
    """Return a new, silent FGFDMExec with a safe copy of the aircraft and guidance added, at step dt [s].

    Raises
    ------
    FlightError
        When the model is missing, unsafe or JSBSim cannot read it.
    """
    scratch, log = Path.cwd(), silent_log()
    copy = scratch / "aircraft" / aircraft.name
    guided = Guided(aircraft)
    copy_aircraft(aircraft.folder, copy, guided.add_guidance)
    write_xml(guided.guidance(), copy / "guidance.xml")
    fdm = executive(scratch, foreign.root, dt, log)
    try:
        loaded = fdm.load_model(aircraft.name)
        if loaded:
            for name, value in foreign.properties.items():
                if not _PROPERTY.fullmatch(name):
                    raise FlightError(f"aircraft {aircraft.name}: [properties] {name!r} is no property")
                node(fdm, name).set_double_value(value)
            loaded = fdm.run_ic()  # a property that does not exist shows only here
    except RuntimeError as error:
        raise FlightError(f"aircraft {aircraft.name}: {one_line(str(error), str(scratch))}") from None
    if not loaded:
        reason = one_line(" ".join(log.lines), str(scratch))
        raise FlightError(f"aircraft {aircraft.name}: JSBSim cannot load it: {reason}")
    set_gains(fdm, aircraft)
    return fdm


class Guided:
    """A foreign aircraft with the guidance system of the bench, as XML."""

    def __init__(self, aircraft: AircraftSpec) -> None:
        self.aircraft = aircraft
        self.engines = 0

    def add_guidance(self, model: ElementTree.Element) -> None:
        """Add ``<system file="guidance"/>`` where it runs before every other control."""
        for propulsion in model.findall("propulsion"):
            self.engines += len(propulsion.findall("engine"))
        if not self.engines:
            raise FlightError(f"aircraft {self.aircraft.name}: it has no engine to hold a speed with")
        if any(system.get("file") == "guidance" for system in model.findall("system")):
            return
        controls = ("system", "autopilot", "flight_control")
        first = next((k for k, child in enumerate(model) if child.tag in controls), None)
        if first is None:
            raise FlightError(f"aircraft {self.aircraft.name}: it has no <flight_control> to fly it by")
        model.insert(first, ElementTree.Element("system", {"file": "guidance"}))

    def guidance(self) -> ElementTree.Element:
        """Return the guidance system with an output to the throttle of every engine."""
        system = read_xml(self.aircraft.systems / "guidance.xml", "guidance.xml")
        for component in system.iter():
            outputs = [
                child for child in component.findall("output") if (child.text or "").strip() == _THROTTLE
            ]
            for n in range(self.engines if outputs else 0):
                ElementTree.SubElement(component, "output").text = f"fcs/throttle-cmd-norm[{n}]"
        return system


def _move_surfaces(fdm: Any, aileron: float, elevator: float) -> None:
    """Let the surfaces come to their commands, always from the same side: actuators may have play."""
    for commands in ((-1.0, -1.0), (aileron, elevator)):
        fdm["fcs/aileron-cmd-norm"], fdm["fcs/elevator-cmd-norm"] = commands
        wait(fdm, _ACTUATORS)


def _run_engines(fdm: Any) -> None:
    """Bring running engines to the steady state of the present throttle.

    set-running starts them, at full throttle; the next round finds the throttle commanded.
    """
    fdm["propulsion/set-running"] = -1.0
    wait(fdm, 2)
    for _ in range(_ROUNDS):  # always as many: the same throttle gives the same thrust
        fdm.get_propulsion().get_steady_state()
        wait(fdm, 1)


def trim(fdm: Any, condition: Condition) -> Trim:
    """Solve for the steady flight of a condition with running engines, and leave the model there.

    As `bench.flight.model.trim`, by least squares within the travel of the controls: engines
    that come to a steady state by iteration are no smooth function of the throttle.

    Raises
    ------
    FlightError
        When no solution is found.
    """
    from scipy.optimize import least_squares

    scale = np.array([0.1, 0.1, 0.1, 0.1, 0.1, 1.0])
    low = np.array([-0.3, -0.3, -0.5, -1.0, -1.0, 0.0]) / scale
    high = np.array([0.4, 0.3, 0.5, 1.0, 1.0, 1.0]) / scale

    def left(x: FloatArray) -> FloatArray:
        alpha, beta, roll, aileron, elevator, throttle = (float(v) for v in x * scale)
        place(fdm, condition, alpha, beta, roll, aileron, elevator, throttle)
        _move_surfaces(fdm, aileron, elevator)
        _run_engines(fdm)
        residuals = present_accelerations(fdm)
        return residuals if np.isfinite(residuals).all() else np.full(6, 1e3)

    best = None
    for alpha, elevator, throttle in _STARTS:
        start = np.array([alpha, 0.0, 0.0, 0.0, elevator, throttle]) / scale
        found = least_squares(
            left, start, bounds=(low, high), diff_step=1e-4, xtol=1e-12, ftol=1e-14, max_nfev=60
        )
        if best is None or found.cost < best.cost:
            best = found
        if np.abs(found.fun).max() < _SETTLED:
            break
    assert best is not None
    residual = float(np.abs(left(best.x)).max())
    alpha, beta, roll, aileron, elevator, throttle = (float(v) for v in best.x * scale)
    if not residual < _SETTLED:
        raise FlightError(
            f"no steady flight found for {fdm.get_model_name()} at {condition.speed:g} m/s, "
            f"{condition.alt:g} m: {residual:.2g} m/s^2 or rad/s^2 is left "
            f"at throttle {throttle:.2f}, elevator {elevator:.2f}"
        )
    return Trim(alpha, beta, roll, float(fdm["attitude/theta-rad"]), aileron, elevator, throttle, residual)
