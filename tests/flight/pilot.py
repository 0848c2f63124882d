"""What a pilot would look at in a flight: bank, load, speed, sideslip, surfaces at their stops, height."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from bench.core.mathematics import rotation
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.core.records.data import Trajectory
from bench.core.records.flight_specs import FlightSpec
from bench.simulation.signals.terrain import ground_at

STOP = 0.999  # of the travel of a surface


class Pilot(NamedTuple):
    """Figures of the part of a flight in which it is in the air; NaN where there is none."""

    bank: float  # most, either side [deg]
    load: tuple[float, float]  # least and most specific force along -z of the body [g]
    speed: tuple[float, float]  # least and most true airspeed [m/s]
    slip: float  # most, either side [deg]; NaN of a multirotor, which flies sideways
    stopped: float  # time in which aileron, elevator or rudder is at its stop [%]
    height: float  # least above the ground between take-off and approach [m]

    def cells(self) -> list[str]:
        """Return the cells of its row."""

        def shown(value: float, form: str) -> str:
            return "-" if np.isnan(value) else format(value, form)

        load, speed = (
            " to ".join(shown(v, f) for v in pair) for pair, f in ((self.load, ".2f"), (self.speed, ".0f"))
        )
        return [
            shown(self.bank, ".0f"),
            load,
            speed,
            shown(self.slip, ".1f"),
            shown(self.stopped, ".1f"),
            shown(self.height, ".0f"),
        ]


def look_at(spec: FlightSpec, truth: Trajectory) -> Pilot:
    """Measure a flight."""
    ground = spec.ground_alt if spec.terrain is None else ground_at(spec.terrain, *truth.lla[:, :2].T)
    height = truth.lla[:, 2] - ground
    flies = height > (spec.aircraft.rest_height or 0.0) + 1.0
    if not flies.any():
        return Pilot(*(np.nan,), (np.nan, np.nan), (np.nan, np.nan), np.nan, np.nan, np.nan)
    between = flies.copy()
    for leg, (begin, end, _) in zip(spec.legs, truth.events.select("leg"), strict=True):
        if leg.needs != "air" or leg.leaves != "air":
            between &= (truth.t < begin) | (truth.t > end)
    air, controls = truth.air, truth.controls
    slow = np.interp(air.t, truth.t, flies.astype(float)) > 0.5
    surfaces = np.abs([controls.aileron, controls.elevator, controls.rudder])[:, slow]
    load = -truth.dvel_b[:, 2] / np.diff(truth.t) / STANDARD_GRAVITY
    load, speed, hovers = load[flies[1:]], air.airspeed_true[slow], spec.aircraft.hovers
    bank = np.degrees(np.abs(rotation.to_euler(truth.q_nb)[0]))[flies].max()
    return Pilot(
        float(bank),
        (float(load.min()), float(load.max())),
        (float(speed.min()), float(speed.max())),
        np.nan if hovers else float(np.degrees(np.abs(air.beta[slow]).max())),
        np.nan if hovers else float(100.0 * (surfaces > STOP).any(axis=0).mean()),
        float(height[between].min()) if between.any() else np.nan,
    )


def asked_bank(spec: FlightSpec) -> float:
    """Return the largest bank that the legs of a flight ask for [deg]."""
    asked: list[Any] = [getattr(leg, "bank", None) for leg in spec.legs]
    asked += [
        np.radians(30.0) for leg in spec.legs if leg.kind == "approach" and not getattr(leg, "bank", None)
    ]
    return float(np.degrees(max((bank for bank in asked if bank), default=0.0)))
