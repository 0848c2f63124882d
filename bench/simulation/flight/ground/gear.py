"""Wheels of a model of JSBSim: where they are, and their struts."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

from bench.core.records.flight_specs import AircraftSpec
from bench.simulation.flight.executive import find_property
from bench.simulation.flight.jsbsim_units import INCH
from bench.simulation.flight.model_files import read_xml

_SLOWER = {"LBS/FT/SEC": "LBS/FT", "N/M/SEC": "N/M"}  # unit of a damper: unit of the spring in its ratio
_RATIO = {("LBS/FT", "N/M"): 14.593902937206364, ("N/M", "LBS/FT"): 1 / 14.593902937206364}


@dataclass(frozen=True, slots=True)
class Wheel:
    """A wheel on a strut."""

    unit: str  # its property of JSBSim: "gear/unit[0]"
    forward: float  # place ahead of the center of gravity at the start [m]
    right: float  # and to its right [m]
    lead: float  # damping over stiffness of the strut [s]; 0 unless both are constants
    steer: float  # most angle of its steering [rad]; 0: it is fixed


def find_wheels(aircraft: AircraftSpec, fdm: Any) -> tuple[Wheel, ...]:
    """Return the wheels of a loaded model, in the order of its file; others are bare contact points.

    Raises
    ------
    FlightError
        If the file cannot be read or the model lacks a property.
    """
    model = read_xml(aircraft.folder / f"{aircraft.name}.xml", f"{aircraft.name}.xml")
    center = [fdm[f"inertia/cg-{axis}-in"] for axis in "xy"]
    found = []
    for number, contact in enumerate(model.iterfind("ground_reactions/contact")):
        if contact.get("type") == "BOGEY":
            unit = f"gear/unit[{number}]"
            x, y = (find_property(fdm, f"{unit}/{axis}-position").get_double_value() for axis in "xy")
            place = (center[0] - x) * INCH, (y - center[1]) * INCH
            found.append(Wheel(unit, *place, _find_lead(contact), _find_steering(contact)))
    return tuple(found)


def _find_lead(contact: ElementTree.Element) -> float:
    spring, damper = contact.find("spring_coeff"), contact.find("damping_coeff")
    if spring is None or damper is None or damper.get("type") == "SQUARE":
        return 0.0
    units = _SLOWER.get(damper.get("unit", "LBS/FT/SEC"), "LBS/FT"), spring.get("unit", "LBS/FT")
    stiffness, damping = float(spring.text or 0.0), float(damper.text or 0.0)
    return _RATIO.get(units, 1.0) * damping / stiffness if stiffness > 0 else 0.0


def _find_steering(contact: ElementTree.Element) -> float:
    most = contact.find("max_steer")
    if most is None:
        return 0.0
    angle = float(most.text or 0.0)
    return abs(angle if most.get("unit", "DEG") == "RAD" else math.radians(angle))
