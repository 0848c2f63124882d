"""Vibration of the IMU by rotors: its figures that the aircraft knows, and what it needs of the flight."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from bench.core.records.flight_specs import AircraftSpec, Flight, TableSpec
from bench.core.words.exceptions import FlightError
from bench.io.trajectories.trajectory import has_rotor_speeds
from bench.simulation.flight.model_files import rotor_figures
from bench.simulation.sensors.rotor_vibration import list_missing

_PLACE = ("imu_forward", "imu_right", "imu_down")


def complete_rotors(
    on_board: Mapping[str, Any], aircraft: AircraftSpec | None, flight: Flight | None, wrong: list[str]
) -> dict[str, Any]:
    """Return the sensors with the positions and radii of gyration of the aircraft, where the IMU has none.

    Parameters
    ----------
    on_board : mapping
        Kind of sensor -> its spec, or None.
    aircraft : AircraftSpec or None
        What flies; None for a script or a table.
    flight : FlightSpec, ScriptSpec, TableSpec or None
        The flight; None if it is wrong.
    wrong : list of str
        A line is added if the flight has no rotor speeds, or a figure is missing.
    """
    imu = on_board["imu"]
    if imu is None or not imu.vibration.by_rotors or flight is None:
        return dict(on_board)
    named = f"[sensors] imu = {imu.name!r}"
    shaken, table = imu.vibration, isinstance(flight, TableSpec)
    if not (has_rotor_speeds(flight.path) if isinstance(flight, TableSpec) else aircraft and aircraft.hovers):
        what = "the table has no columns rotor_speed" if table else "this is no multirotor"
        wrong.append(f"{named}: [vibration] rotor_accel needs the speeds of four rotors; {what}")
        return dict(on_board)
    if aircraft is not None:
        try:
            known = rotor_figures(aircraft.folder / f"{aircraft.name}.xml")
        except FlightError as error:
            wrong.append(str(error))
            return dict(on_board)
        if not any(getattr(shaken, name) for name in _PLACE):
            known |= dict(zip(_PLACE, aircraft.imu_b, strict=True))
        given = {name: value for name, value in known.items() if not getattr(shaken, name)}
        shaken = replace(shaken, **given)
    if missing := list_missing(shaken):
        wrong.append(f"{named}: [vibration] vibration by rotors needs {', '.join(missing)} above 0")
    return {**on_board, "imu": replace(imu, vibration=shaken)}
