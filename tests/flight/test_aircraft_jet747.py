"""The jet transport is the published 747: modes, axes, schedule; it trims, holds and flies its profiles.

Reference of the modes: the state matrices that `modes747.py` forms from Etkin's table. The published
numbers are written here a second time, in the form of their tables.
"""

from dataclasses import replace
from math import cos, radians, sin
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.mathematics import rotation
from bench.core.words.exceptions import FlightError
from bench.io.config import read_profile
from bench.io.config.library import read_aircraft
from bench.simulation.flight import fly
from bench.simulation.flight.executive import load_aircraft
from bench.simulation.flight.jsbsim_units import FT
from bench.simulation.flight.legs.climbs import Climb, Descend
from bench.simulation.flight.legs.level import Straight
from bench.simulation.flight.legs.turns import Turn
from bench.simulation.flight.trimming import TrimCondition, place, trim_aircraft
from tests.flight import modes747 as etkin
from tests.flight.modes import linearize
from tests.flight.plans import plan, truth_of
from tests.flight.test_recorder import two_sample_error

FOLDER = Path(__file__).parents[2] / "aircraft" / "jet747"
JET = read_aircraft(FOLDER, FOLDER)
DT = 1 / 400
NEWTON_PER_LBF = 4.4482216152605
SLUG_FT3 = NEWTON_PER_LBF / FT**4  # [kg/m^3]
ALPHA = radians(4.6)  # of the stability axes of Etkin's condition
FT_40K = 40_000 * FT
AT_ETKIN = TrimCondition(lat=radians(45.0), lon=0.0, alt=FT_40K, heading=radians(30.0), speed=etkin.U)
CRUISE = replace(AT_ETKIN, alt=10_668.0, speed=240.0)
APPROACH = replace(AT_ETKIN, alt=400.0, speed=78.0)
LONGITUDINAL, LATERAL = [0, 2, 4, 7], [1, 3, 5, 6]
TRAVEL = radians(20.0)  # of each surface at full command


def reference():
    """The model as Etkin's set, in the air of his condition."""
    fdm = load_aircraft(JET, DT)
    fdm["aero/reference"] = 1
    fdm["atmosphere/override/density"] = etkin.RHO / SLUG_FT3
    return fdm


def modes(fdm, condition):
    A = linearize(fdm, condition, trim_aircraft(fdm, condition))
    return etkin.modes(A[np.ix_(LONGITUDINAL, LONGITUDINAL)], A[np.ix_(LATERAL, LATERAL)])


BOUNDS = {"short period": 0.01, "phugoid": 0.03, "dutch roll": 0.01, "roll": 0.01, "spiral": 0.03}


def test_the_five_modes_are_those_of_the_published_table():
    """Fails on the schedule, which is built from another print of the same measurements."""
    wanted = etkin.modes(etkin.longitudinal(), etkin.lateral())
    found = modes(reference(), AT_ETKIN)
    for mode, bound in BOUNDS.items():
        assert abs(found[mode] - wanted[mode]) < bound * abs(wanted[mode]), mode
    scheduled = modes(load_aircraft(JET, DT), AT_ETKIN)
    assert abs(scheduled["phugoid"] - wanted["phugoid"]) > BOUNDS["phugoid"] * abs(wanted["phugoid"])
    for mode in BOUNDS:
        assert abs(scheduled[mode] - wanted[mode]) < 0.06 * abs(wanted[mode]), mode


def test_the_product_of_inertia_is_negative_about_stability_axes():
    """A roll moment turns the nose as Ixz = -0.212e7 says; JSBSim's default sign would not."""
    fdm = reference()
    at = trim_aircraft(fdm, AT_ETKIN)

    def acceleration(aileron, rudder=0.0):
        place(fdm, AT_ETKIN, at.alpha, at.beta, at.roll, aileron, at.elevator, at.throttle)
        fdm["fcs/rudder-cmd-norm"] = rudder
        fdm.suspend_integration()
        fdm.run()
        fdm.resume_integration()
        p, r = (fdm[f"accelerations/{axis}dot-rad_sec2"] for axis in "pr")
        a = at.alpha
        return np.array([p * cos(a) + r * sin(a), r * cos(a) - p * sin(a)])  # stability axes

    force = 0.5 * etkin.RHO * etkin.U**2 * etkin.S * etkin.B * 0.1 * TRAVEL
    d = etkin.CONTROLS
    for change, (cl, cn) in (
        (acceleration(at.aileron + 0.1) - acceleration(at.aileron), (d["Clda"], d["Cnda"])),
        (acceleration(at.aileron, 0.1) - acceleration(at.aileron), (d["Cldr"], d["Cndr"])),
    ):
        moment = force * np.array([cl, cn])
        J = np.array([[etkin.IXX, -etkin.IXZ], [-etkin.IXZ, etkin.IZZ]])
        # the trimmed angle of attack is 0.08 deg below 4.6 deg, which moves the axes
        assert_allclose(change, np.linalg.solve(J, moment), rtol=0.01, atol=2e-3 * abs(change).max())
        flipped = np.linalg.solve(J * [[1, -1], [-1, 1]], moment)
        assert np.abs(flipped - change).max() > 0.04 * np.abs(change).max()


def test_inertia_in_body_axes_is_the_other_published_set():
    """Etkin's stability axes turned back by 4.6 deg meet 18.2, 33.1, 49.7 and 0.97e6 slug ft^2."""
    fdm = load_aircraft(JET, DT)
    found = [fdm[f"inertia/{axis}-slugs_ft2"] for axis in ("ixx", "iyy", "izz", "ixz")]
    assert_allclose(found, [18.2e6, 33.1e6, 49.7e6, -0.97e6], rtol=3e-3)  # the element of the tensor
    assert_allclose(fdm["inertia/weight-lbs"], 636_636.0, rtol=2e-4)


def test_side_force_acts_along_the_body_axis():
    """dv'/dv is rho U S CYb / 2m; in JSBSim's wind axes the drag would add 5 %."""
    fdm = reference()
    A = linearize(fdm, AT_ETKIN, trim_aircraft(fdm, AT_ETKIN))
    assert_allclose(A[1, 1], etkin.lateral()[0, 0], rtol=5e-3)
    assert abs(etkin.CD0 / etkin.LATERAL["CYb"]) > 0.04


def test_commands_have_the_senses_of_the_conventions_and_the_published_size():
    fdm = reference()
    at = trim_aircraft(fdm, AT_ETKIN)

    def response(command):
        place(fdm, AT_ETKIN, at.alpha, at.beta, at.roll, at.aileron, at.elevator, at.throttle)
        before = [fdm[f"accelerations/{axis}dot-rad_sec2"] for axis in "pqr"]
        fdm[command] += 0.1
        fdm.suspend_integration()
        for _ in range(3):  # the elevator moves the angle of attack rate, which comes a frame late
            fdm.run()
        fdm.resume_integration()
        return np.subtract([fdm[f"accelerations/{axis}dot-rad_sec2"] for axis in "pqr"], before)

    assert response("fcs/aileron-cmd-norm")[0] > 1e-3  # right roll
    assert response("fcs/rudder-cmd-norm")[2] < -1e-3  # nose left
    pitch = response("fcs/elevator-cmd-norm")[1]
    q = 0.5 * etkin.RHO * etkin.U**2 * etkin.S
    lift = q * etkin.CONTROLS["CZde"] * 0.1 * TRAVEL / (etkin.W / etkin.G)  # makes wdot, which makes a moment
    own = q * etkin.C * etkin.CONTROLS["Cmde"] * 0.1 * TRAVEL / etkin.IYY
    lag = etkin.LONGITUDINAL["Cmad"] * q * etkin.C**2 / (2 * etkin.U**2) / etkin.IYY
    assert_allclose(pitch, own + lag * lift, rtol=5e-3)  # nose down


# --- the schedule -------------------------------------------------------------------------------------

COLUMNS = "M h alpha CL CD CLa CDa Cma CLad Cmad CLq Cmq CL_M CD_M Cm_M CLde Cmde"
PUBLISHED = [  # altitude in thousands of ft, alpha in deg; CL_M and Cm_M of the first are per u/V there
    (.198, 0, 8.5, 1.76, .263, 5.67, 1.13, -1.45, 6.7, -3.3, 5.65, -21.4, -1.1111, 0, .3586, .36, -1.40),
    (.25, 0, 5.7, 1.11, .102, 5.70, .66, -1.26, 6.7, -3.2, 5.40, -20.8, 0, 0, 0, .338, -1.34),
    (.5, 20, 6.8, .680, .0393, 4.67, .366, -1.146, 6.53, -3.35, 5.13, -20.7, -.0875, 0, .121, .356, -1.43),
    (.8, 20, .0, .266, .0174, 4.24, .084, -.629, 5.99, -5.40, 5.01, -20.5, .105, .008, -.116, .270, -1.06),
    (.8, 40, 4.6, .660, .0415, 4.92, .425, -1.033, 5.91, -6.41, 6.00, -24.0, .205, .0275, .166, .367, -1.45),
    (.9, 40, 2.4, .521, .0415, 5.57, .527, -1.613, 5.53, -8.82, 6.94, -25.1, -.278, .242, -.114, .300, -1.20),
]  # fmt: skip


class Tunnel:
    """Coefficients of the model at a Mach number, altitude [m] and angle of attack, surfaces centered."""

    def __init__(self) -> None:
        self.fdm = load_aircraft(JET, DT)

    def at(self, mach: float, alt: float, alpha: float) -> dict[str, float]:
        fdm = self.fdm
        # JSBSim's altitude above sea level differs from the ellipsoidal one by millimeters
        air = TrimCondition(radians(45.0), 0.0, max(alt, 30.0), 0.0, 100.0)
        place(fdm, air, alpha, 0.0, 0.0, 0.0, 0.0, 0.0)
        speed = mach * fdm["atmosphere/a-fps"] * FT
        place(fdm, replace(air, speed=speed), alpha, 0.0, 0.0, 0.0, 0.0, 0.0)
        assert_allclose(fdm["velocities/mach"], mach, rtol=1e-9)
        rate = fdm["aero/ci2vel"] * fdm["aero/alphadot-rad_sec"]
        turn = fdm["aero/ci2vel"] * fdm["velocities/q-aero-rad_sec"]
        found = {k: fdm[f"aero/{k}"] for k in ("CD", "CLad", "Cmad", "CLq", "Cmq", "CLde", "Cmde")}
        found["CL"] = fdm["aero/CL"] - found["CLad"] * rate - found["CLq"] * turn
        found["Cm"] = fdm["aero/Cm"] - found["Cmad"] * rate - found["Cmq"] * turn
        return found

    def slopes(self, mach: float, alt: float, alpha: float, low: float, high: float) -> dict[str, float]:
        """Derivatives by alpha, and by Mach over mach + low to mach + high."""
        found, da = {}, 1e-3
        up, down = self.at(mach, alt, alpha + da), self.at(mach, alt, alpha - da)
        fast, slow = self.at(mach + high, alt, alpha), self.at(mach + low, alt, alpha)
        for k in ("CL", "CD", "Cm"):
            found[f"{k}a"] = (up[k] - down[k]) / (2 * da)
            found[f"{k}_M"] = (fast[k] - slow[k]) / (high - low)
        return found


@pytest.fixture(scope="module")
def tunnel():
    return Tunnel()


@pytest.mark.parametrize("row", PUBLISHED, ids=lambda row: f"M{row[0]}-{row[1]}k")
def test_at_each_published_condition_the_model_has_the_published_values_and_slopes(tunnel, row):
    want = dict(zip(COLUMNS.split(), row, strict=True))
    mach, alt, alpha = want["M"], want["h"] * 1000 * FT, radians(want["alpha"])
    found = tunnel.at(mach, alt, alpha)
    for name in ("CL", "CD", "CLad", "Cmad", "CLq", "Cmq", "CLde", "Cmde"):
        assert_allclose(found[name], want[name], rtol=1e-4, atol=1e-6, err_msg=name)
    # beyond the first and the last condition nothing changes with Mach: the slope is taken on the inside
    low, high = (-1e-5 * (mach != 0.198), 1e-5 * (mach != 0.9))
    slopes = tunnel.slopes(mach, alt, alpha, low, high)
    for name in ("CLa", "CDa", "Cma"):
        assert_allclose(slopes[name], want[name], rtol=1e-3, err_msg=name)
    for name in ("CL_M", "CD_M", "Cm_M"):
        assert_allclose(slopes[name], want[name], atol=0.01, err_msg=name)
    # the elevator that trims it is an assumption: it is small everywhere
    assert abs(np.rad2deg(found["Cm"] / want["Cmde"])) < 5.0


LATERAL_COLUMNS = "CYb CYdr Clb Clp Clr Clda Cldr Cnb Cnp Cnr Cnda Cndr"
LATERAL_SETS = {
    0.198: (-1.08, 0.179, -0.281, -0.502, 0.195, 0.053, 0.0, 0.184, -0.222, -0.36, 0.0083, -0.113),
    0.65: (-0.9, 0.12, -0.16, -0.34, 0.13, 0.013, 0.008, 0.16, -0.026, -0.28, 0.0018, -0.10),
    0.9: (-0.9, 0.06, -0.095, -0.32, 0.2, 0.014, 0.005, 0.21, 0.02, -0.33, -0.0028, -0.095),
}


def test_lateral_derivatives_are_the_published_sets_and_straight_lines_in_mach_between(tunnel):
    fdm, alt = tunnel.fdm, 8000.0
    names = LATERAL_COLUMNS.split()
    sets = {mach: dict(zip(names, row, strict=True)) for mach, row in LATERAL_SETS.items()}
    sets[0.8] = etkin.LATERAL | etkin.CONTROLS
    machs = sorted(sets)
    for mach in [*machs, 0.4, 0.72, 0.87]:
        tunnel.at(mach, alt, 0.05)
        for name in names:
            want = np.interp(mach, machs, [sets[m][name] for m in machs])
            assert_allclose(fdm[f"aero/{name}"], want, rtol=1e-6, atol=1e-9, err_msg=f"{name} at M {mach}")


def test_between_its_conditions_the_schedule_meets_a_set_it_is_not_built_from(tunnel):
    """Roskam's low cruise: M 0.65, 20 000 ft, alpha 2.5 deg. Drag is the worst, 20 % low."""
    alt, alpha = 20_000 * FT, radians(2.5)
    found = tunnel.at(0.65, alt, alpha) | tunnel.slopes(0.65, alt, alpha, -1e-3, 1e-3)
    for name, published, bound in (
        ("CL", 0.40, 0.08),
        ("CD", 0.025, 0.22),
        ("CLa", 4.4, 0.03),
        ("Cma", -1.00, 0.13),
        ("Cmad", -4.0, 0.12),
        ("Cmq", -20.5, 0.02),
        ("CLde", 0.32, 0.04),
        ("Cmde", -1.30, 0.06),
    ):
        assert abs(found[name] / published - 1) < bound, name


def test_at_mach_09_the_modes_are_those_of_the_dimensional_derivatives_of_cr_2144():
    """Short period 1.347 rad/s, 0.351; Dutch roll 0.996 rad/s; roll 1.91 s; phugoid 0.0315 rad/s."""
    found = modes(load_aircraft(JET, DT), replace(AT_ETKIN, speed=871.0 * FT))
    short, dutch = found["short period"], found["dutch roll"]
    assert_allclose([abs(short), -short.real / abs(short)], [1.347, 0.351], rtol=0.03)
    assert_allclose(abs(dutch), 0.996, rtol=0.04)
    assert_allclose(-1 / found["roll"].real, 1.91, rtol=0.05)
    assert_allclose(abs(found["phugoid"]), 0.0315, rtol=0.15)


# --- trim, ground, guidance ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    "condition",
    [
        AT_ETKIN,
        replace(CRUISE, wind_n=(-15.0, 20.0, 0.0)),
        APPROACH,
        replace(APPROACH, climb_angle=radians(-3.0), wind_n=(3.0, -4.0, 0.0)),
        replace(CRUISE, alt=6000.0, speed=200.0, climb_angle=0.04),
        replace(CRUISE, alt=12_000.0, speed=262.0),
    ],
)
def test_trimmed_flight_does_not_accelerate(condition):
    fdm = load_aircraft(JET, DT)
    found = trim_aircraft(fdm, condition)
    assert found.residual < 1e-9
    assert 0.0 <= found.throttle <= 0.9
    assert abs(found.elevator) < 0.5
    assert_allclose(fdm["velocities/vt-fps"] * FT, condition.speed, rtol=1e-12)


def test_too_slow_for_its_altitude_is_refused():
    """Full thrust does not carry the drag of 110 m/s at 12 000 m."""
    with pytest.raises(FlightError, match="no steady flight found for jet747 at 110 m/s, 12000 m"):
        trim_aircraft(load_aircraft(JET, DT), replace(CRUISE, alt=12_000.0, speed=110.0))


@pytest.mark.parametrize("alt", [100.0, 10_668.0])
def test_thrust_falls_with_density_to_the_assumed_power_and_not_with_speed(alt):
    fdm, found = load_aircraft(JET, DT), []
    for speed in (100.0, 240.0):
        place(fdm, replace(CRUISE, alt=alt, speed=speed), 0.05, 0.0, 0.0, 0.0, 0.0, 0.5)
        found.append(fdm["forces/fbx-external-lbs"])
    sigma = (1 - 0.0065 * alt / 288.15) ** 4.2559  # ICAO standard atmosphere, troposphere
    assert_allclose(found, 0.5 * 4 * 43_500 * sigma**0.7, rtol=2e-3)


def test_it_stands_on_its_wheels_with_the_brakes_set():
    fdm = load_aircraft(JET, DT)
    fdm["ic/terrain-elevation-ft"], fdm["ic/h-agl-ft"] = 0.0, 5.0 / FT
    fdm.run_ic()
    fdm["fcs/left-brake-cmd-norm"] = fdm["fcs/right-brake-cmd-norm"] = 1.0
    for _ in range(20 * 400):
        fdm.run()
    lat, height = fdm["position/lat-geod-rad"], fdm["position/h-agl-ft"]
    for _ in range(10 * 400):
        fdm.run()
    assert abs(fdm["position/lat-geod-rad"] - lat) * 6.4e6 < 1e-6
    assert abs(fdm["position/h-agl-ft"] - height) * FT < 1e-6
    assert abs(np.rad2deg(fdm["attitude/theta-rad"])) < 0.5


def minute(condition, severity):
    """Largest differences in a minute from altitude [m], airspeed [m/s], wings level and heading [deg]."""
    air = {"alt": condition.alt, "speed": condition.speed, "severity": severity}
    truth = fly(plan(Straight(60.0), aircraft=JET, turbulence_seed=11, **air))
    roll, _, heading = np.rad2deg(rotation.to_euler(truth.q_nb))
    return [
        float(np.abs(column).max())
        for column in (
            truth.lla[:, 2] - condition.alt,
            truth.air.airspeed_true - condition.speed,
            roll,
            heading - 85.0,
        )
    ]


@pytest.mark.parametrize("condition", [CRUISE, APPROACH, replace(CRUISE, alt=6000.0, speed=200.0)])
def test_guidance_holds_a_minute_calm_and_in_moderate_turbulence(condition):
    """The holds README.md states; turbulence does move it."""
    calm, rough = minute(condition, 0), minute(condition, 4)
    assert (np.array(calm) < [0.5, 0.1, 0.5, 0.2]).all(), calm
    assert (np.array(rough) < [20.0, 10.0, 8.0, 4.0]).all(), rough
    assert rough[0] > 2.0


@pytest.mark.parametrize(("alt", "speed"), [(400.0, 80.0), (10_668.0, 240.0)])
def test_turns_climbs_and_descents_end_where_they_should(alt, speed):
    legs = (Turn(radians(90.0), radians(25.0)), Climb(alt + 150.0, 6.0), Descend(alt, 6.0), Straight(40.0))
    truth = fly(plan(*legs, aircraft=JET, alt=alt, speed=speed))
    roll, _, heading = np.rad2deg(rotation.to_euler(truth.q_nb))
    assert_allclose(roll.max(), 25.0, atol=1.5)
    assert_allclose(truth.lla[:, 2].max(), alt + 150.0, atol=15.0)
    assert_allclose([heading[-1], truth.lla[-1, 2]], [175.0, alt], atol=1.0)
    assert_allclose(truth.air.airspeed_true, speed, atol=5.0)
    distance, angle = two_sample_error(truth)  # at 100 Hz
    assert distance < 5e-3
    assert angle < 5e-6


# --- the profiles -------------------------------------------------------------------------------------


def test_climb_cruise_descend_is_flown(recorded):
    """17 minutes in light turbulence: 8000 m and 6000 m are reached, the last heading is 90 deg.

    That its truth replays is a law of every shipped flight: test_laws.py.
    """
    profile = read_profile("climb-cruise-descend")
    truth = truth_of(recorded(profile.flight), profile.flight.rate)
    assert truth.t[-1] == profile.flight.duration
    rows = truth.events.select("leg")
    assert len(rows) == len(profile.flight.legs)
    by_kind = {text.split()[1].rstrip(":"): round(end * 200) for _, end, text in rows}
    assert_allclose(truth.lla[by_kind["climb"], 2], 8000.0, atol=2.0)
    assert_allclose(truth.lla[by_kind["descend"], 2], 6000.0, atol=2.0)
    assert_allclose(np.rad2deg(rotation.to_euler(truth.q_nb)[2])[-1], 90.0, atol=2.0)
    assert_allclose(truth.air.airspeed_true, 200.0, atol=8.0)
    assert truth.air.pressure.min() > 300e2  # what the barometer is specified to
    outage = profile.sensors.gnss_outages[0]
    assert any(start <= outage[0] and outage[1] <= end for start, end, text in rows if "straight" in text)


@pytest.mark.slow
def test_the_airliner_cruises_at_its_level_and_mach(recorded):
    """10 668 m are 10 650 m of geopotential height: 239.09 hPa by ISO 2533, 238.42 at FL350 itself.

    Mach by the speed of sound, 20.0468 sqrt(T).
    """
    spec = read_profile("cruise-fl350").flight
    truth = truth_of(recorded(spec), spec.rate)
    air, legs = truth.air, truth.events.select("leg")
    assert [text.split(":")[0][2:] for _, _, text in legs][1::2] == ["climb", "turn", "descend"]
    begin, end = legs[2][0] + 30.0, legs[4][1]
    level, cruise = (truth.t > begin) & (truth.t < end), (air.t > begin) & (air.t < end)
    assert_allclose(truth.lla[level, 2], 35_000 * 0.3048, atol=5.0)
    assert_allclose(air.pressure[cruise], 23_909.0, rtol=1e-3)
    mach = air.airspeed_true / (20.0468 * np.sqrt(air.temperature))
    assert_allclose(mach[cruise], 0.78, atol=0.005)
    assert mach.max() < 0.8
    assert 0.4 < truth.controls.throttle[cruise].mean() < 0.55  # it is half of what the engines have there
    assert truth.controls.throttle.max() < 1.0
    assert truth.events.select("exceedance") == []
    assert 1100.0 < truth.t[-1] < 1300.0
