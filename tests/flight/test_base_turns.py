"""From a base leg an approach turns onto the centerline from where the aircraft is: it does not pass it."""

from math import cos, degrees, pi, radians, sin

import numpy as np
import pytest

from bench.core.mathematics import earth, rotation
from bench.simulation.flight.legs.landing import Approach
from tests.flight.plans import fly_here, plan
from tests.flight.test_legs_ground import ALONG, GROUND, KINDS, LAT, LON, final, runway_frame

PASSED = {"aerosonde": 5.0, "navion": 5.0, "jet747": 25.0}
"""Most beyond the centerline [m]."""

RADIUS = {"aerosonde": 130.0, "navion": 520.0, "jet747": 2200.0}
"""Of a turn with 20 deg of bank [m], the wind from behind."""


def draw(name: str, rng, lowest: float, highest: float):
    """Return a bank or none, the place beside the centerline and a flight with room to turn onto it."""
    kind, across = KINDS[name], radians(rng.uniform(lowest, highest)) * rng.choice([-1.0, 1.0])
    asked = radians(20.0) if rng.random() < 0.5 else None
    off = -np.sign(across) * RADIUS[name] * (rng.uniform(1.4, 2.0) + 1 - cos(across))
    away = rng.uniform(1.3, 1.8) * kind.before[0] + 1.5 * RADIUS[name]
    north, east = -away * cos(ALONG) - off * sin(ALONG), -away * sin(ALONG) + off * cos(ALONG)
    lat, lon, _ = earth.displace([LAT, LON, GROUND], [north, east, 0.0])
    start = {**final(kind), "lat": float(lat), "lon": float(lon), "heading": ALONG + across, "rate": 100.0}
    wind = {"wind_speed": rng.uniform(0.0, 0.2) * kind.climb[1], "wind_from": rng.uniform(0.0, 2 * pi)}
    return asked, off, plan(Approach(radians(3.0), 60.0, asked), **{**start, **wind})


def check_intercepts(name: str, seed: int, count: int, lowest: float, highest: float) -> None:
    rng, banks = np.random.default_rng(seed), []
    for _ in range(count):
        asked, off, spec = draw(name, rng, lowest, highest)
        truth = fly_here(spec)
        aside = runway_frame(truth)[1]
        what = f"heading {degrees(spec.heading):.0f} deg, {off:.0f} m off, wind {spec.wind_speed:.1f} m/s"
        assert (-np.sign(off) * aside).max() < PASSED[name], what
        assert abs(aside[-1]) < (5.0 if name == "jet747" else 2.0), what
        bank = np.degrees(np.abs(rotation.to_euler(truth.q_nb)[0]).max())
        assert bank < degrees(asked or radians(30.0)) + 3.0, what
        banks.append(bank / degrees(asked or radians(30.0)))
    assert max(banks) > 0.5


@pytest.mark.parametrize(("name", "seed", "count"), [("aerosonde", 1, 2), ("navion", 2, 1), ("jet747", 3, 1)])
def test_an_approach_from_a_base_leg_does_not_pass_the_centerline(name, seed, count):
    """Headings 62 to 112 deg off the runway's and a wind of up to a fifth of the airspeed, at random."""
    check_intercepts(name, seed, count, 62.0, 112.0)


@pytest.mark.long
@pytest.mark.parametrize("name", ["aerosonde", "navion", "jet747"])
@pytest.mark.parametrize(("lowest", "highest"), [(20.0, 60.0), (62.0, 112.0)])
def test_no_approach_of_thirty_passes_the_centerline(name, lowest, highest):
    check_intercepts(name, 4, 30, lowest, highest)
