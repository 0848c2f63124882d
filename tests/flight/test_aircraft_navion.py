"""The Navion in JSBSim is the aircraft of the published table: trim, five modes, signs; guidance holds it.

Reference: eigenvalues of the textbook state matrices formed here from the table (aircraft/navion/README.md),
at 176 ft/s and the sea-level density, with the drag of the table and a thrust that speed does not change.
"""

import re
import shutil
from dataclasses import replace
from math import cos, pi, radians, sin
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.mathematics import rotation
from bench.core.records.data import Trajectory
from bench.io.config.library import find_aircraft, read_aircraft
from bench.simulation.flight import fly
from bench.simulation.flight.executive import load_aircraft
from bench.simulation.flight.jsbsim_units import FT
from bench.simulation.flight.legs.climbs import Climb, Descend
from bench.simulation.flight.legs.level import Straight
from bench.simulation.flight.legs.turns import Turn
from bench.simulation.flight.trimming import TrimCondition, place, trim_aircraft
from tests.flight import modes
from tests.flight.plans import plan

BESIDE = Path(__file__).parent
NAVION = read_aircraft(find_aircraft("navion", BESIDE), BESIDE)
DT = 1 / 400
LBF, LB = 4.4482216152605, 0.45359237  # [N], [kg]
SLUG = LBF / FT  # [kg]
SLUG_FT2, SLUG_FT3 = SLUG * FT**2, SLUG / FT**3  # [kg m^2], [kg/m^3]
DENSITY = 0.0023769  # at sea level [slug/ft^3]
SPEED = 176 * FT  # [m/s]
LEVEL = TrimCondition(lat=radians(45.0), lon=0.0, alt=100.0, heading=radians(30.0), speed=SPEED)

FLIGHT = modes.Flight(
    mass=2750 * LB,
    Ixx=1048 * SLUG_FT2,
    Iyy=3000 * SLUG_FT2,
    Izz=3530 * SLUG_FT2,
    Ixz=0.0,
    S=184 * FT**2,
    b=33.4 * FT,
    c=5.7 * FT,
    density=DENSITY * SLUG_FT3,
    speed=SPEED,
)
LONGITUDINAL = modes.LongitudinalTable(
    CL=0.41, CD=0.05, CLa=4.44, CDa=0.33, Cma=-0.683, CLad=0.0, Cmad=-4.36, CLq=3.8, Cmq=-9.96
)
LATERAL = modes.LateralTable(
    CYb=-0.564, Clb=-0.074, Cnb=0.071, Clp=-0.410, Cnp=-0.0575, Clr=0.107, Cnr=-0.125
)
PUBLISHED = modes.of_table(FLIGHT, LONGITUDINAL, LATERAL)


def as_tabulated(craft=NAVION):
    """The model in the reference flight: drag of the table, constant thrust."""
    fdm = load_aircraft(craft, DT)
    fdm["aero/CD0"], fdm["aero/k"], fdm["aero/CDa"] = 0.05, 0.0, 0.33
    fdm["motor/power-hp"] = 1e9  # the thrust stays at its limit, throttle times 1000 lbf
    fdm["atmosphere/override/density"] = DENSITY
    return fdm


def changed(folder: Path, edit):
    """A copy of the aircraft with its model edited."""
    shutil.copytree(NAVION.folder, folder / "navion")
    model = folder / "navion" / "navion.xml"
    text = model.read_text()
    assert edit(text) != text
    model.write_text(edit(text))
    return replace(NAVION, folder=folder / "navion")


# --- the modes ----------------------------------------------------------------------------------------


def test_the_five_modes_are_those_of_the_published_table():
    """Fails without the alpha-dot moment or the lift of the pitch rate, and on the aircraft as it flies."""
    found = modes.of_model(as_tabulated(), LEVEL)
    assert modes.beyond(found, PUBLISHED) == {}
    for part in ("Cmad", "CLq"):
        without = modes.of_table(FLIGHT, replace(LONGITUDINAL, **{part: 0.0}), LATERAL)
        assert "short period" in modes.beyond(found, without)
    flying = load_aircraft(NAVION, DT)
    flying["atmosphere/override/density"] = DENSITY
    assert "phugoid" in modes.beyond(modes.of_model(flying, LEVEL), PUBLISHED)


def test_side_force_acts_along_the_body_axis(tmp_path):
    """In JSBSim's wind axes the drag adds to it: the Dutch roll would be damped 2 % more."""
    damping = PUBLISHED["dutch roll"].real
    Yv = DENSITY * 176 * 184 * -0.564 / (2 * 2750 / 32.174049)  # [1/s]

    def in_wind_axes(text: str) -> str:
        for axis, wind_axis, coefficient in (("X", "DRAG", "CD"), ("Z", "LIFT", "CL")):
            factors = (f"<property> aero/{name} </property>" for name in ("qbar-area", coefficient))
            force = f"<product> {' '.join(factors)} </product>"
            block = f'<axis name="{wind_axis}"><function name="aero/force/{axis}">{force}</function></axis>'
            text = re.sub(rf'<axis name="{axis}">.*?</axis>', block, text, flags=re.DOTALL)
        return text.replace('<axis name="Y">', '<axis name="SIDE">')

    right, wrong = as_tabulated(), as_tabulated(changed(tmp_path, in_wind_axes))
    assert_allclose(modes.linearize(right, LEVEL, trim_aircraft(right, LEVEL))[1, 1], Yv, rtol=2e-3)
    assert abs(modes.linearize(wrong, LEVEL, trim_aircraft(wrong, LEVEL))[1, 1] / Yv - 1) > 0.05
    assert_allclose(modes.of_model(right, LEVEL)["dutch roll"].real, damping, rtol=5e-3)
    assert abs(modes.of_model(wrong, LEVEL)["dutch roll"].real / damping - 1) > 0.02


def test_a_product_of_inertia_would_have_the_published_sign(tmp_path):
    """The table has none: one is put in, and moves the modes as + integral of x z dm does."""
    ixz = 150.0  # [slug ft^2]
    craft = changed(tmp_path, lambda text: re.sub(r'(<ixz unit="SLUG\*FT2">) 0 ', rf"\1 {ixz} ", text))
    found = modes.of_model(as_tabulated(craft), LEVEL)
    plus, minus = (
        modes.of_table(replace(FLIGHT, Ixz=sign * ixz * SLUG_FT2), LONGITUDINAL, LATERAL) for sign in (1, -1)
    )
    assert modes.beyond(found, plus) == {}
    assert "dutch roll" in modes.beyond(found, minus)


# --- trim, signs, engine ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "condition",
    [
        LEVEL,
        replace(LEVEL, speed=40.0),
        replace(LEVEL, speed=62.0),
        replace(LEVEL, speed=60.0, alt=2000.0, wind_n=(0.0, 5.0, 0.0)),
        replace(LEVEL, speed=45.0, climb_angle=0.05, wind_n=(3.0, -4.0, 0.0)),
        replace(LEVEL, speed=40.0, climb_angle=-0.06),
    ],
)
def test_trimmed_flight_does_not_accelerate(condition):
    fdm = load_aircraft(NAVION, DT)
    found = trim_aircraft(fdm, condition)
    assert found.residual < 1e-9
    assert_allclose(fdm["velocities/vt-fps"] * FT, condition.speed, rtol=1e-12)
    assert_allclose(
        -fdm["velocities/v-down-fps"] * FT, condition.speed * sin(condition.climb_angle), atol=1e-9
    )


def test_the_reference_flight_is_trimmed_as_the_table_says():
    """Alpha 0 and no elevator at CL = 0.41; the weight takes 1 % less lift than that."""
    fdm = as_tabulated()
    found = trim_aircraft(fdm, LEVEL)
    lift = 2750 / (0.5 * DENSITY * 176**2 * 184)
    assert_allclose(0.41 + 4.44 * found.alpha + 0.355 * found.elevator * pi / 9, lift, rtol=1e-3)
    assert abs(found.alpha) < 2e-3
    drag = 0.05 * 0.5 * DENSITY * 176**2 * 184
    assert_allclose(fdm["forces/fbx-external-lbs"], drag, rtol=1e-2)


def test_the_drag_in_flight_is_that_of_the_table_at_its_lift():
    fdm = load_aircraft(NAVION, DT)
    place(fdm, LEVEL, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5)
    assert_allclose(fdm["aero/CL"], 0.41, rtol=1e-3)
    assert_allclose(fdm["aero/CD"], 0.05, rtol=2e-3)


def test_lift_stops_growing_where_the_readme_says_and_is_odd_about_its_zero():
    fdm = load_aircraft(NAVION, DT)

    def lift(alpha):
        place(fdm, LEVEL, alpha, 0.0, 0.0, 0.0, 0.0, 0.5)
        return fdm["aero/CL"] - 3.8 * fdm["aero/ci2vel"] * fdm["velocities/q-aero-rad_sec"]

    curve = np.array([lift(alpha) for alpha in np.linspace(0.0, 0.5, 51)])
    assert 1.2 < curve.max() < 1.3
    assert curve[-1] > 0.8 * curve.max()  # it does not break away
    zero = -0.41 / 4.44
    assert_allclose(lift(zero + 0.3), -lift(zero - 0.3), rtol=1e-6)
    assert_allclose(lift(zero), 0.0, atol=1e-6)


def test_controls_turn_the_aircraft_as_the_table_says():
    """One at a time; + is roll right, nose down, nose left."""
    fdm = as_tabulated()
    at = trim_aircraft(fdm, LEVEL)
    q_S = 0.5 * DENSITY * 176**2 * 184  # [lbf]
    travel = pi / 9
    expected = {
        "aileron": np.array([0.134, 0.0, -0.0035]),
        "elevator": np.array([0.0, -0.923, 0.0]),
        "rudder": np.array([0.0107, 0.0, -0.072]),
    }
    scale = q_S * np.array([33.4 / 1048, 5.7 / 3000, 33.4 / 3530])

    def angular_acceleration():
        fdm.suspend_integration()
        fdm.run()
        fdm.resume_integration()
        return np.array([fdm[f"accelerations/{axis}dot-rad_sec2"] for axis in "pqr"])

    for surface, coefficients in expected.items():
        place(fdm, LEVEL, at.alpha, at.beta, at.roll, at.aileron, at.elevator, at.throttle)
        before = angular_acceleration()
        fdm[f"fcs/{surface}-cmd-norm"] += 0.5
        change = angular_acceleration() - before
        wanted = scale * coefficients * 0.5 * travel
        assert_allclose(change, wanted, rtol=1e-3, atol=1e-3 * np.abs(wanted).max(), err_msg=surface)


@pytest.mark.parametrize(
    ("speed", "alt", "throttle"),
    [(0.01, 100.0, 1.0), (20.0, 100.0, 0.5), (45.0, 100.0, 1.0), (55.0, 2500.0, 0.7)],
)
def test_thrust_is_what_the_power_gives_up_to_the_static_limit(speed, alt, throttle):
    fdm = load_aircraft(NAVION, DT)
    place(fdm, replace(LEVEL, speed=speed, alt=alt), 0.0, 0.0, 0.0, 0.0, 0.0, throttle)
    sigma = fdm["atmosphere/rho-slugs_ft3"] / DENSITY
    power = 205 * 745.69987 * (1.132 * sigma - 0.132)  # [W]
    thrust = throttle * min(1000 * LBF, 0.8 * power / speed)
    assert_allclose(fdm["forces/fbx-external-lbs"] * LBF, thrust, rtol=1e-4)
    assert_allclose(fdm["motor/speed-rad_sec"], 2300 * 2 * pi / 60, rtol=1e-9)


# --- on the ground ------------------------------------------------------------------------------------


def test_it_stands_on_its_wheels_and_the_nose_wheel_steers():
    """With brakes on it stays against full power; without, it rolls, and + steering turns right."""
    fdm = load_aircraft(NAVION, DT)
    fdm["ic/h-agl-ft"] = 1.25 / FT
    fdm["ic/psi-true-rad"] = 1.0
    fdm["fcs/left-brake-cmd-norm"] = fdm["fcs/right-brake-cmd-norm"] = 1.0
    fdm.run_ic()

    def run(seconds: float) -> None:
        for _ in range(round(seconds / DT)):
            fdm.run()

    run(15.0)
    assert abs(fdm["velocities/vg-fps"]) < 1e-4
    assert max(abs(fdm[f"velocities/{axis}-rad_sec"]) for axis in "pqr") < 1e-6
    assert abs(fdm["attitude/theta-rad"]) < radians(0.5)
    assert_allclose([fdm[f"gear/unit[{k}]/WOW"] for k in range(3)], 1.0)
    fdm["guidance/throttle-cmd-norm"] = 1.0
    run(3.0)
    assert fdm["velocities/vg-fps"] < 0.1
    fdm["fcs/left-brake-cmd-norm"] = fdm["fcs/right-brake-cmd-norm"] = 0.0
    run(2.0)
    assert_allclose(fdm["velocities/vg-fps"] * FT, 2 * 1000 / 2750 * 9.81, rtol=0.1)
    fdm["guidance/throttle-cmd-norm"] = 0.05
    before = fdm["attitude/psi-rad"]
    fdm["guidance/heading-setpoint-rad"] = before + radians(20.0)
    fdm["guidance/steer-share"], fdm["guidance/steer-gain"] = 1.0, 1.0
    run(1.0)
    assert fdm["fcs/steer-cmd-norm"] > 0.05
    assert fdm["attitude/psi-rad"] - before > radians(4.0)
    fdm["guidance/steer-share"] = 0.0
    fdm["fcs/left-brake-cmd-norm"] = fdm["fcs/right-brake-cmd-norm"] = 1.0
    run(6.0)
    assert fdm["velocities/vg-fps"] < 0.01


# --- under guidance -----------------------------------------------------------------------------------


AT_CG = replace(NAVION, imu_b=(0.0, 0.0, 0.0))  # guidance holds the center of gravity, truth is the IMU


def flown(*legs, speed: float = SPEED, aircraft=AT_CG, **changes) -> Trajectory:
    return fly(plan(*legs, aircraft=aircraft, speed=speed, **changes))


def departures(truth: Trajectory, alt: float = 1200.0) -> dict[str, float]:
    """Largest departure from a straight level flight heading 85 deg at SPEED."""
    roll, _, heading = (np.rad2deg(angle) for angle in rotation.to_euler(truth.q_nb))
    return {
        "alt_m": np.abs(truth.lla[:, 2] - alt).max(),
        "roll_deg": np.abs(roll).max(),
        "heading_deg": np.abs(heading - 85.0).max(),
        "mean_speed_mps": abs(truth.air.airspeed_true.mean() - SPEED),
    }


CALM_HOLD = {"alt_m": 0.1, "roll_deg": 0.1, "heading_deg": 0.05, "mean_speed_mps": 0.01}
ROUGH_HOLD = {"alt_m": 30.0, "roll_deg": 8.0, "heading_deg": 10.0, "mean_speed_mps": 4.0}


def outside(found: dict[str, float], hold: dict[str, float]) -> dict[str, float]:
    return {name: value for name, value in found.items() if not value <= hold[name]}


def test_a_calm_minute_is_held():
    assert outside(departures(flown(Straight(60.0))), CALM_HOLD) == {}


@pytest.mark.parametrize("seed", [1, 2])
def test_a_minute_of_moderate_turbulence_is_held(seed):
    truth = flown(Straight(60.0), severity=4, turbulence_seed=seed)
    assert outside(departures(truth), ROUGH_HOLD) == {}
    assert truth.air.airspeed_true.std() > 1.5  # the air did move
    assert truth.air.airspeed_true.min() > 35.0  # 1.15 times the stall
    assert max(np.abs(truth.controls.elevator).max(), np.abs(truth.controls.aileron).max()) < 0.5


def test_turbulence_shows_a_slack_altitude_loop_and_a_slack_bank_loop():
    loose = {"altitude-gain": 0.02, "climb-integral-gain": 0.05, "bank-gain": 0.5, "roll-rate-gain": 0.1}
    slack = {**NAVION.gains, **loose}
    truth = flown(
        Straight(60.0), severity=4, turbulence_seed=2, aircraft=replace(AT_CG, gains=slack, rough_gains={})
    )
    assert {"alt_m", "roll_deg"} <= set(outside(departures(truth), ROUGH_HOLD))


@pytest.mark.parametrize("speed", [42.0, SPEED, 58.0])
def test_turns_climbs_and_descents_end_where_they_should(speed):
    """Altitude within 4 m in a 30 deg turn, a new level reached without going 4 m beyond, at three speeds."""
    legs = (Turn(radians(90.0), radians(30.0)), Straight(10.0), Climb(1230.0, 1.5), Straight(10.0))
    legs = (*legs, Turn(radians(-90.0), radians(30.0)), Descend(1200.0, 2.0), Straight(10.0))
    truth = flown(*legs, speed=speed)
    roll, _, heading = (np.rad2deg(angle) for angle in rotation.to_euler(truth.q_nb))
    alt = truth.lla[:, 2]
    first, second = (round(truth.events.select("leg")[k][1] * 100) for k in (0, 3))
    assert_allclose(alt[:first], 1200.0, atol=4.0)
    assert alt.max() < 1234.0
    assert_allclose(roll[:first].max(), 30.0, atol=1.5)
    assert_allclose(alt[second], 1230.0, atol=1.0)
    assert_allclose([heading[-1], alt[-1]], [85.0, 1200.0], atol=1.0)
    assert_allclose(truth.air.airspeed_true, speed, atol=3.5)
    rate = truth.dtheta_b * 100.0
    assert np.abs(np.diff(rate, axis=0)).max() < 0.02  # onsets are smooth
    assert np.abs(truth.air.beta).max() < radians(6.0)


def test_a_steep_turn_and_the_steepest_climb_of_the_limits_are_flown():
    truth = flown(Turn(radians(360.0), NAVION.max_bank), Straight(10.0))
    assert_allclose(truth.lla[:, 2], 1200.0, atol=6.0)
    load_factor = -truth.dvel_b[:, 2] * 100.0 / 9.81
    assert_allclose(load_factor.max(), 1 / cos(NAVION.max_bank), atol=0.2)
    climb = flown(Climb(300.0, NAVION.max_climb), speed=45.0, alt=200.0)
    assert_allclose(-climb.vel_n[:, 2].min(), NAVION.max_climb, atol=0.4)
    descent = flown(Descend(1080.0, NAVION.max_descent))
    assert_allclose(descent.vel_n[:, 2].max(), NAVION.max_descent, atol=0.4)
