"""Laws of mechanics on every shipped profile, found by glob: what is flown is one motion of one body.

Profiles of more than 15 minutes, and those of other aircraft than the Aerosonde, fly with the slow tests.
They are shortened, see SHORTENED and FIRST_LEGS; the flights of SHARED are whole.
The laws share rotations, normal gravity and the figure of the Earth with the bench, nothing of the flight.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_allclose

import bench
from bench.core.mathematics import earth, rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import Trajectory
from bench.core.records.flight_specs import FlightSpec
from bench.io.config import read_profile
from bench.simulation.flight.legs.landing import Approach, Flare, LandingRoll
from bench.simulation.flight.legs.level import Straight
from bench.simulation.flight.legs.runway import Static, TakeOff
from bench.simulation.flight.legs.surfaces import AileronRoll, Doublet, WindUpTurn
from bench.simulation.flight.legs.winch import Winch
from tests.flight.pilot import find_excess, look_at
from tests.flight.plans import record_whole, truth_of
from tests.flight.test_recorder import same_form_error, two_sample_error

_FLIGHTS = {
    path.stem: read_profile(path.stem).flight
    for path in sorted((Path(bench.__file__).parent / "profiles").glob("*.toml"))
}
PROFILES = [name for k, (name, spec) in enumerate(_FLIGHTS.items()) if spec not in [*_FLIGHTS.values()][:k]]
"""Of profiles that differ in sensors only, the first."""

SHARED = {
    "circuit",
    "circuit-navion",
    "climb-cruise-descend",
    "cruise-fl350",
    "figure-eight-matched",
    "high-dynamics",
}
"""Profiles whose flights other test files look at too."""

SHORTENED = {"duration": 20.0, "laps": 1, "count": 1, "strips": 2}
"""Most of a straight or a stand [s], and of what a leg repeats."""

FIRST_LEGS = {
    "airliner": 3,
    "airliner-long": 2,
    "all-sensors": 4,
    "alpine-approach": 3,
    "gate-to-gate": 4,
    "gnss-denied-closed": 1,
    "long-cruise": 3,
    "touch-and-go": 4,
}
"""Legs of longer profiles that are flown here: others have the like of the rest, which `make long` flies."""

ALIKE = {
    "approach-closed",
    "holding-jammed",
    "inspection",
    "mapping",
    "survey-multirotor",
    "waypoints-closed",
}
"""Profiles of legs, air and aircraft that others here have, too: `make long` flies them."""

ROUGH = AileronRoll | Approach | Doublet | Flare | LandingRoll | TakeOff | WindUpTurn | Winch
MM, UM = 1e-3, 1e-6  # [m], and [rad] for microradians


class Flight(NamedTuple):
    name: str
    spec: FlightSpec
    truth: Trajectory
    same_form: tuple[float, float]  # error of the replay [m, rad]

    @property
    def smooth(self) -> bool:
        """Calm air, wheels at rest or in the air, guidance on: no corner in the motion."""
        calm = self.spec.severity == 0 and not self.spec.gusts
        return calm and not any(isinstance(leg, ROUGH) for leg in self.spec.legs)


def _planned(spec: FlightSpec) -> float:
    return spec.duration or sum(leg.duration for leg in spec.legs if isinstance(leg, Straight | Static))


def _marked(name: str):
    spec = _FLIGHTS[name]
    marks = [pytest.mark.long] if name in ALIKE else []
    if spec.aircraft.name != "aerosonde" or _planned(spec) > 900:
        marks.append(pytest.mark.slow)
    return pytest.param((name, FIRST_LEGS.get(name)), id=name, marks=marks)


def _shorten(spec: FlightSpec, first: int | None) -> FlightSpec:
    legs = []
    for leg in spec.legs[:first]:
        values = {name: most for name, most in SHORTENED.items() if getattr(leg, name, 0.0) > most}
        legs.append(replace(leg, **values))
    return spec if tuple(legs) == spec.legs else replace(spec, legs=tuple(legs), duration=None)


_WHOLE = [pytest.param((name, None), id=f"{name}, all", marks=pytest.mark.long) for name in FIRST_LEGS]


@pytest.fixture(scope="module", params=[*map(_marked, PROFILES), *_WHOLE])
def flight(request, recorded) -> Flight:
    name, first = request.param
    spec = _FLIGHTS[name]
    if name in SHARED:
        stretch = recorded(spec)
    else:
        spec = _shorten(spec, first)
        stretch = record_whole(spec)
    return Flight(name, spec, truth_of(stretch, spec.rate), same_form_error(stretch.motion))


def over_ten_minutes(flight: Flight) -> float:
    """How often ten minutes fit into a flight, 1 at least: errors are allowed per ten minutes."""
    return max(1.0, float(flight.truth.t[-1]) / 600.0)


def turned(truth: Trajectory) -> FloatArray:
    """Rotation vector of each step relative to n, (N-1, 3) [rad], b."""
    return rotation.to_rotvec(rotation.multiply(rotation.conjugate(truth.q_nb[:-1]), truth.q_nb[1:]))


def forces_n(truth: Trajectory) -> FloatArray:
    """Velocity that specific force and gravity add over each interval, (N-1, 3) [m/s], n at its middle.

    The increment is turned by the attitude half way, which leaves out sculling within one sample.
    """
    dt = np.diff(truth.t)[:, None]
    q_mid = rotation.multiply(truth.q_nb[:-1], rotation.from_rotvec(0.5 * turned(truth)))
    middle = 0.5 * (truth.lla[:-1] + truth.lla[1:])
    return rotation.rotate(q_mid, truth.dvel_b) + dt * earth.gravity_n(middle[:, 0], middle[:, 2])


def rates_n(truth: Trajectory) -> tuple[FloatArray, FloatArray]:
    """Rate of the Earth and transport rate of n at the middle of each interval, (N-1, 3) [rad/s], n."""
    middle = 0.5 * (truth.lla[:-1] + truth.lla[1:])
    lat, alt = middle[:, 0], middle[:, 2]
    north, east, _ = (0.5 * (truth.vel_n[:-1] + truth.vel_n[1:])).T
    R_M, R_P = earth.radii(lat)
    w_ie = earth.EARTH_RATE * np.stack([np.cos(lat), 0 * lat, -np.sin(lat)], axis=-1)
    w_en = np.stack([east / (R_P + alt), -north / (R_M + alt), -east * np.tan(lat) / (R_P + alt)], axis=-1)
    return w_ie, w_en


def speed_error(truth: Trajectory) -> float:
    vel = 0.5 * (truth.vel_n[:-1] + truth.vel_n[1:])
    work = np.cumsum(np.sum(vel * forces_n(truth), axis=1))
    kinetic = 0.5 * np.sum(truth.vel_n**2, axis=1)
    speed = np.linalg.norm(truth.vel_n, axis=1)
    return float(np.abs((kinetic[1:] - kinetic[0] - work) / np.maximum(speed[1:], 1.0)).max())


def velocity_error(truth: Trajectory) -> float:
    dt = np.diff(truth.t)[:, None]
    w_ie, w_en = rates_n(truth)
    vel = 0.5 * (truth.vel_n[:-1] + truth.vel_n[1:])
    left = np.diff(truth.vel_n, axis=0) - forces_n(truth) + dt * np.cross(2 * w_ie + w_en, vel)
    return float(np.linalg.norm(np.cumsum(left, axis=0), axis=1).max())


def attitude_error(truth: Trajectory) -> tuple[float, float]:
    """Largest angle a step turns, and largest difference to the increment of it [rad]."""
    dt = np.diff(truth.t)[:, None]
    w_ie, w_en = rates_n(truth)
    steps = turned(truth)
    half = rotation.multiply(truth.q_nb[:-1], rotation.from_rotvec(0.5 * steps))
    inertial = steps + dt * rotation.rotate(rotation.conjugate(half), w_ie + w_en)
    largest = np.linalg.norm(steps, axis=1).max(), np.linalg.norm(inertial - truth.dtheta_b, axis=1).max()
    return float(largest[0]), float(largest[1])


def test_kinetic_energy_changes_only_by_the_work_of_f_and_g(flight):
    """d(v^2/2)/dt = v . (f + g): the Coriolis and transport terms do no work.

    Error as a speed. In smooth flight 1.3e-5 m/s at most was measured, from turning each increment by one
    attitude; standard for normal gravity is 1.2e-2 m/s in figure-eight, which climbs 100 m. In rough air
    and at touch-down the force changes within a sample: 4.2e-3 m/s. Blind to a shift of one sample.
    """
    assert speed_error(flight.truth) < (5e-5 if flight.smooth else 1e-2)


def test_specific_force_and_gravity_integrate_to_velocity(flight):
    """The sum over the flight of what f, g, Coriolis and transport leave of the velocity, [m/s], n.

    2.1e-4 at most in smooth flight, 1.2e-3 in rough air, both from sculling within a sample. The rate of the
    Earth left out of Coriolis is 1.2 in figure-eight. At rest, where no increment turns, it is rounding.
    """
    error = velocity_error(flight.truth)
    assert error < (4e-4 if flight.smooth else 3e-3)
    if flight.name == "static":
        assert error < 1e-6


def test_velocity_integrates_to_position(flight):
    """Trapezoids of 5 ms, summed in frame e: blind to what the increments hold.

    Errors are the curvature of the path within a sample, v'' dt^2 / 12, and corners of the velocity.
    """
    truth = flight.truth
    vel_e = np.einsum("kij,kj->ki", earth.matrix_en(truth.lla[:, 0], truth.lla[:, 1]), truth.vel_n)
    moved = np.cumsum(0.5 * np.diff(truth.t)[:, None] * (vel_e[1:] + vel_e[:-1]), axis=0)
    error = np.linalg.norm(earth.to_ecef(truth.lla[1:]) - earth.to_ecef(truth.lla[0]) - moved, axis=1).max()
    assert error < 1 * MM * over_ten_minutes(flight)


def test_attitude_is_continuous_and_turns_by_its_increments(flight):
    """Quaternions of unit length and one sign; what they turn by is the increment but for coning.

    Coning within a sample is 1.2e-9 rad in smooth flight, 1.5e-7 rad in the aileron rolls, and 1e-5 rad when
    a multirotor of half a kilogram touches down in gusts.
    """
    q = flight.truth.q_nb
    assert_allclose(np.linalg.norm(q, axis=1), 1.0, rtol=0, atol=1e-12)
    assert np.sum(q[1:] * q[:-1], axis=1).min() > 0.99
    turned_by, difference = attitude_error(flight.truth)
    assert turned_by < 0.05  # 10 rad/s; a jump would be more
    rough = 3e-5 if flight.spec.aircraft.hovers else 5e-7
    assert difference < (5e-9 if flight.smooth else rough)


def test_increments_replay_the_flight_in_the_form_they_were_made(flight):
    """Below 0.1 mm and 0.1 microradian per ten minutes, touch-down included.

    What is left of smooth flight, 5e-6 m, is rounding; at touch-down JSBSim extrapolates the velocity past
    the corner when it moves the aircraft, which is 4e-5 m, and 2e-4 m of half a kilogram in gusts.
    """
    distance, angle = flight.same_form
    assert distance < (0.5 if flight.spec.aircraft.hovers else 0.1) * MM * over_ten_minutes(flight)
    assert angle < 0.1 * UM * over_ten_minutes(flight)


def test_two_samples_are_enough_for_a_navigator_in_smooth_flight(flight):
    """Coning and sculling corrections of two samples bring smooth flight home within 1 mm, 1 microradian.

    Rough flights, where motion is not a parabola between samples, leave more: 0.1 m by the corners of a
    landing, 30 mm by ten minutes of moderate turbulence, 11 mm by rolls; never a meter, nor a microradian.
    A multirotor answers each gust with its attitude, which leaves 2, and as it touches down 10 microradians.
    """
    distance, angle = two_sample_error(flight.truth)
    assert distance < (1 * MM if flight.smooth else 1.0) * over_ten_minutes(flight)
    assert angle < (20 if flight.spec.aircraft.hovers else 1) * UM * over_ten_minutes(flight)


def test_legs_follow_each_other_on_instants_of_the_sequencer(flight):
    rows = flight.truth.events.select("leg")
    assert [int(text.split()[0]) for _, _, text in rows] == [k + 1 for k in range(len(flight.spec.legs))]
    assert rows[0][0] == 0.0
    assert rows[-1][1] == flight.truth.t[-1]
    for (_, end, _), (start, _, _) in pairwise(rows):
        assert start == end
        assert_allclose(end * 20, round(end * 20), rtol=0, atol=1e-9)


def test_the_laws_are_broken_by_a_truth_that_is_wrong(figure_eight_truth):
    """Each defect is one that a change of units, frames or signs would make."""
    truth = figure_eight_truth
    milli_g = (
        truth.dvel_b + 9.81e-6 * np.diff(truth.t)[:, None]
    )  # a thousandth of what the limit of a MEMS is
    assert speed_error(replace(truth, dvel_b=milli_g)) > 5e-5
    assert velocity_error(replace(truth, dvel_b=milli_g)) > 4e-4
    assert velocity_error(replace(truth, vel_n=truth.vel_n * [1, -1, 1])) > 1.0
    late = np.roll(truth.dtheta_b, 1, axis=0)
    assert attitude_error(replace(truth, dtheta_b=late))[1] > 5e-9


EXCEEDANCES: dict[str, str] = {}
"""Profiles with an exceedance, and what is exceeded."""


def test_only_some_flights_exceed_a_limit(flight):
    texts = [text for _, _, text in flight.truth.events.select("exceedance")]
    assert [text.partition(":")[0] for text in texts] == EXCEEDANCES.get(flight.name, "").split()


def test_a_pilot_would_fly_it_so(flight):
    """The limits of the table of the guide (`tests.tools.pilot_table`), see `pilot.find_excess`."""
    assert find_excess(flight.spec, look_at(flight.spec, flight.truth)) == []
