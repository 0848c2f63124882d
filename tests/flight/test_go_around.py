"""An approach that is broken off: how low, how slow and where it goes; what becomes of flaps and gear."""

from dataclasses import replace
from math import radians

import numpy as np
import pytest

from bench.core.mathematics import earth, rotation
from bench.core.records.flight_specs import LegStart
from bench.core.words.exceptions import ConfigError, FlightError
from bench.io.config import read_profile
from bench.simulation.flight.guidance.sequencer import fly_legs
from bench.simulation.flight.legs.go_around import GoAround
from bench.simulation.flight.legs.landing import Approach, Flare, LandingRoll
from bench.simulation.flight.legs.level import Configuration, Straight
from bench.simulation.flight.legs.turns import Turn
from bench.simulation.flight.recorder import prepare
from tests.flight.plans import fly_here, plan
from tests.flight.test_exceedances import exceedances
from tests.flight.test_legs_ground import (
    ALONG,
    GROUND,
    KINDS,
    LANDING,
    LAT,
    LON,
    final,
    height_of_cg,
    runway_frame,
)

SINKS = {"aerosonde": 4.0, "navion": 8.0, "jet747": 20.0}
"""Most below the decision height [m]: the sink of 1.2 to 4.2 m/s is stopped in about 4 s."""


def broken_off(name: str, *after, **changes):
    """From below the glide path, along it down to twice the height of a flare, up by 80 m."""
    kind = LANDING[name]
    decision = 2 * kind.aircraft.runway.flare_height + 10.0
    leg = GoAround(
        radians(3.0),
        60.0,
        decision=decision,
        to_height=decision + 80.0,
        rate=kind.climb[0],
        speed=kind.climb[1],
    )
    away = (decision + 40.0) / np.tan(radians(3.0))  # on the path 40 m above the decision height
    lat, lon, _ = earth.displace([LAT, LON, GROUND], [-away * np.cos(ALONG), -away * np.sin(ALONG), 0.0])
    start = {
        **final(kind),
        "rate": 100.0,
        "alt": GROUND + decision + 30.0,
        "lat": float(lat),
        "lon": float(lon),
    }
    start |= changes
    return plan(leg, *(after or (Straight(3.0),)), **start)


@pytest.mark.parametrize(
    ("name", "severity", "seed"),
    [("aerosonde", 0, 1), ("aerosonde", 4, 2), ("navion", 0, 1), ("navion", 4, 3), ("jet747", 4, 4)],
)
def test_an_aircraft_goes_around(name, severity, seed):
    """In calm and moderate air: the height lost, the margin over the stall, the way along the centerline.

    The approach is flown at 1.3 times the speed of the stall; 1.1 times is the least.
    """
    spec = broken_off(name, severity=severity, turbulence_seed=seed)
    leg, figures = spec.legs[0], spec.aircraft.runway
    truth = fly_here(spec)
    assert exceedances(truth) == []
    height = height_of_cg(truth, spec.aircraft) - figures.height
    below = leg.decision - height.min()
    assert 0.5 < below < SINKS[name]
    lowest = int(np.argmin(height))
    later = truth.air.t > truth.t[lowest] - 5.0
    assert truth.air.airspeed_true[later].min() > 1.1 / 1.3 * figures.approach_speed
    end = round(truth.events.select("leg")[0][1] * 100)
    assert truth.controls.throttle.max() > 0.99
    climbing = height[lowest:end]
    assert np.diff(climbing).min() > (-0.005 if severity == 0 else -0.05)
    assert height[end] == pytest.approx(leg.to_height, abs=4.0 + severity)
    off = runway_frame(truth)[1]
    assert np.abs(off[lowest:end]).max() < (2.0 if severity == 0 else 40.0)
    bank = np.degrees(np.abs(rotation.to_euler(truth.q_nb)[0]))
    assert bank[lowest:end].max() < (4.0 if severity == 0 else 18.0)


def test_a_circuit_after_a_go_around_ends_on_the_runway():
    after = Turn(-np.pi, radians(25.0)), Straight(110.0), Turn(-np.pi, radians(25.0))
    spec = broken_off("aerosonde", *after, Approach(radians(3.5), 60.0), Flare(), LandingRoll(1.0))
    truth = fly_here(spec)
    assert exceedances(truth) == []
    assert np.linalg.norm(truth.vel_n[-1]) < 1e-3
    assert abs(runway_frame(truth)[1][-1]) < 2.0


def test_flaps_and_gear_come_in_on_the_way_up():
    """The Cessna with half of its flaps, and a gear that its model does not move."""
    craft = replace(LANDING["c172x"].aircraft, configuration=("flaps", "gear"))
    spec = broken_off("c172x", Straight(1.0), aircraft=craft)
    spec = replace(spec, legs=(Configuration(0.5, None, 2.0), *spec.legs))
    fdm, cockpit = prepare(spec, 0.0025)
    flaps, gear, height, seen = [], [], [], []
    for _ in fly_legs(cockpit, spec, seen):
        for _ in range(20):
            fdm.run()
        flaps.append(fdm["fcs/flap-cmd-norm"])
        gear.append(fdm["gear/gear-cmd-norm"])
        height.append(cockpit.alt_agl())
    rows, flaps = np.arange(len(flaps)), np.array(flaps)
    lowest = int(np.argmin(height))
    assert np.allclose(flaps[(rows > 50) & (rows < lowest)], 0.5)
    assert flaps[-1] == gear[-1] == 0.0
    moving = np.flatnonzero((flaps > 0.0) & (flaps < 0.5) & (rows > lowest))
    decision = spec.legs[1].decision + craft.runway.height
    assert 3.0 < len(moving) / 20.0 < 6.0
    assert decision + 8.0 < height[moving[0]] < decision + 14.0


def test_a_decision_below_the_flare_is_no_go_around():
    craft, runway = KINDS["navion"].aircraft, broken_off("navion").runway
    start = LegStart(craft, GROUND + 200.0, runway, "air")
    leg = broken_off("navion").legs[0]
    assert leg.check(start) == []
    assert leg.alt_after(start) == GROUND + leg.to_height
    assert "is below the 9 m at which the navion flares" in replace(leg, decision=8.0).check(start)[0]
    assert "is not 20 m above the decision height" in replace(leg, to_height=40.0).check(start)[0]
    assert runway.heading == ALONG


def test_a_decision_height_above_the_aircraft_ends_the_flight_at_once():
    spec = broken_off("navion")
    high = replace(spec.legs[0], decision=900.0, to_height=1000.0)
    with pytest.raises(FlightError, match=r"the glide path ends 90\d m above the runway, the aircraft is at"):
        fly_here(replace(spec, legs=(high,)))


def test_a_go_around_is_a_leg_of_a_profile():
    stated = {"leg.2.kind": "go-around", "leg.2.decision_m": 60.0, "leg.2.to_height_m": 200.0}
    with pytest.raises(ConfigError, match="rate_mps") as caught:
        read_profile("alpine-approach", stated)
    assert "go-around" in str(caught.value)
