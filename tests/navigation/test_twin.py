"""The compiled loose filter says what its plain twin says (tests/twin.py says what the two share).

1e-6 m, 1e-7 m/s and 1e-8 rad over a minute at full rate. What this comparison catches is shown below
by breaking the twin: a sign, a term or a figure that moves the answer beyond the tolerance within seconds,
or half a minute at the latest. It is blind to single elements of F by latitude, height and the slow rates of
the level frame: they move less, and the Jacobian test of the error state looks at each of them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from bench import pipeline
from bench.core.mathematics import rotation
from bench.core.records.data import GnssFixes, ImuData
from bench.core.records.sensor_specs import ImuSpec
from bench.io import config
from bench.navigation.error_state_filter.ranges.ionosphere_anchors import ANCHORS
from bench.navigation.error_state_filter.ranges.range_states import RANGES
from bench.navigation.error_state_filter.ranges.satellite_states import Channels
from bench.navigation.models.loose_tight import Loose, Passage, Tight
from bench.simulation import sensors
from tests import twin
from tests.builders import take
from tests.flight.plans import truth_of
from tests.navigation.test_tight import MATCHED, SKY
from tests.weaving import BARO, IMU, units, weaving

FLIGHT = (60.0,)
TOLERANCE = np.array([1e-6, 1e-7, 1e-8])  # m, m/s, rad
TIGHT_TOLERANCE = np.array([5e-4, 1e-4, 5e-5])

GAUSS_MARKOV = ImuSpec(
    "no-turn-on-bias",
    replace(IMU.gyro, turn_on_bias_sd=0.0, bias_instability=1e-4, bias_correlation=60.0),
    replace(IMU.accel, turn_on_bias_sd=0.0, bias_instability=5e-3, bias_correlation=90.0),
)


def distance(answer, solution):
    """Largest difference of position [m], velocity [m/s] and attitude [rad] over the record."""
    assert_array_equal(answer.t, solution.t)
    C_nb = rotation.matrix(solution.q_nb)
    turned = rotation.to_rotvec(rotation.from_matrix(answer.C_nb @ np.swapaxes(C_nb, 1, 2)))
    return np.array(
        [
            np.abs((answer.lla - solution.lla) * twin.meters(solution.lla)).max(),
            np.abs(answer.vel_n - solution.vel_n).max(),
            np.linalg.norm(turned, axis=1).max(),
        ]
    )


def assert_same(answer, solution):
    """Values within the tolerance of the contract; biases, covariance and NIS to 1e-6 of their own size."""
    assert (distance(answer, solution) < TOLERANCE).all()
    assert np.abs((answer.bias - solution.extra) / solution.extra_sd).max() < 1e-6
    sd = np.sqrt(np.einsum("kii->ki", answer.cov))
    scale = sd[:, :9, None] * sd[:, None, :9]
    assert np.abs((answer.cov[:, :9, :9] - solution.cov) / scale).max() < 1e-6
    assert np.abs(solution.extra_sd / sd[:, 9:] - 1).max() < 1e-6
    one_each = solution.innovations.component == 0
    np.testing.assert_allclose(solution.innovations.nis[one_each], answer.nis, rtol=1e-5, atol=1e-5)
    assert_array_equal(solution.innovations.accepted[one_each], answer.accepted)


def first(data, seconds):
    """The first part of a record of sensors."""
    n = int(np.searchsorted(data.imu.t, seconds + 1e-6))
    imu = ImuData(*(getattr(data.imu, name)[:n] for name in ("t", "dt", "valid", "dtheta_b", "dvel_b")))
    return replace(data, imu=imu, output_t=data.output_t[data.output_t <= seconds + 1e-6])


@pytest.fixture(scope="module")
def short():
    """Half a minute of sensors and what the compiled filter says of them."""
    sensed = sensors.sense(weaving(30.0), units(), 1, 0)
    return sensed, Loose(covariance_hz=None).run(sensed.data, sensed.initial)


@pytest.fixture(scope="module")
def figure_eight():
    """The sensors of the shipped profile, flown."""
    profile = config.read_profile("figure-eight")
    return pipeline.sense(profile, pipeline.fly(profile))


@pytest.mark.parametrize("imu", [IMU, GAUSS_MARKOV], ids=["random-walk biases", "gauss-markov biases"])
def test_the_filter_and_its_twin_agree_over_a_minute(truth, imu):
    sensed = sensors.sense(truth, units(imu), 1, 0)
    solution = Loose(covariance_hz=None).run(sensed.data, sensed.initial)
    assert len(solution.innovations) == 6 * 60 + 300  # the updates took place
    assert_same(twin.navigate(sensed.data, sensed.initial), solution)


def test_the_filter_and_its_twin_agree_on_the_first_80_s_of_the_figure_eight(figure_eight):
    """Half of them without GNSS: errors, and with them differences, are larger there."""
    data = first(figure_eight.data, 80.0)
    t = data.fixes.t
    data = replace(data, fixes=take(data.fixes, (t < 20.0) | (t >= 60.0)))
    solution = Loose(covariance_hz=None).run(data, figure_eight.initial)
    assert_same(twin.navigate(data, figure_eight.initial), solution)


@pytest.mark.long
def test_the_filter_and_its_twin_agree_on_the_whole_figure_eight(recorded):
    """600 s at 100 Hz with a minute without GNSS."""
    profile = config.read_profile("figure-eight")
    sensed = pipeline.sense(profile, truth_of(recorded(profile.flight), 100.0))
    solution = Loose(covariance_hz=None).run(sensed.data, sensed.initial)
    assert_same(twin.navigate(sensed.data, sensed.initial), solution)


def test_without_aiding_and_without_baro_they_agree_too():
    truth = weaving(20.0)
    for spec in (units(baro=None), units(gnss=None), units(gnss=None, baro=None)):
        sensed = sensors.sense(truth, spec, 1, 0)
        solution = Loose(covariance_hz=None).run(sensed.data, sensed.initial)
        assert_same(twin.navigate(sensed.data, sensed.initial), solution)


def satellites_at_end(sensed):
    """The states of satellites, in the order of the twin, and their sd, which are no part of an answer."""
    passage = Passage(Tight(covariance_hz=None), sensed.data, sensed.initial, [])
    passage.update(sensed.data, 0.0, last=True)
    o, run = sensed.data.observations, passage.run
    own, _ = Channels().give_states(o, np.arange(len(o.t)))
    of = dict(zip(zip(o.system, o.sat, strict=True), own + RANGES[0] * o.system, strict=True))
    at = np.array([of[one] for one in sorted(of)]) + run.model.index.gps_range_1
    return run.now.state[at + 1], np.sqrt(run.now.P[at, at])


@pytest.mark.parametrize("wander", [False, True])
def test_tight_and_its_twin_agree_over_a_quarter_of_a_minute(wander):
    """The twin differences what the filter leaves out of H (the Earth rate on the arm, 2e-4 of the rate
    there); the filter reads the vertical delay from a table right to 1e-5 m.

    Ranges that wander hold the position loosely, so it follows the velocity: twice 15 s of its tolerance.
    """
    tolerance = TIGHT_TOLERANCE * ([6, 1, 1] if wander else 1)
    sensed = sensors.sense(weaving(15.0), units(gnss=SKY if wander else MATCHED), 1, 0)
    solution = Tight(covariance_hz=None).run(sensed.data, sensed.initial)
    answer = twin.navigate(sensed.data, sensed.initial, tight=True)
    assert len(answer.nis) > 350
    assert (distance(answer, solution) < tolerance).all()
    sd = np.sqrt(np.einsum("kii->ki", answer.cov))
    close = 3e-3 if wander else 1e-3
    common = list(range(7)) + list(range(len(sd[0]) - 12, len(sd[0]) - 9))  # ranges are in between
    known = list(range(10))
    if wander:
        (own, own_sd), shared = satellites_at_end(sensed), len(ANCHORS) + 1
        common[7:7] = range(7 + len(own), 7 + len(own) + shared)
        known[7:7] = range(10, 10 + shared)
        ranges = slice(7, 7 + len(own))
        assert np.abs((answer.bias[-1, ranges] - own) / own_sd).max() < close
        assert np.abs(own_sd / sd[-1, 9:][ranges] - 1).max() < 1e-3
    off = (answer.bias[:, common] - solution.extra[:, known]) / solution.extra_sd[:, known]
    assert np.abs(off).max() < close
    scale = sd[:, :9, None] * sd[:, None, :9]
    assert np.abs((answer.cov[:, :9, :9] - solution.cov) / scale).max() < 1e-3
    assert np.abs(solution.extra_sd[:, known] / sd[:, 9:][:, common] - 1).max() < 1e-3
    one_each = solution.innovations.component == 0
    np.testing.assert_allclose(solution.innovations.nis[one_each], answer.nis, rtol=2e-3, atol=2e-3)
    for defect in ({"sat_clock_rate": 1e-3}, {"sat_clock": 0.05}):
        (name, size), columns = next(iter(defect.items())), {}
        o = sensed.data.observations
        columns = {f: getattr(o, f) for f in type(o).__slots__}
        columns[name] = columns[name] + size * (o.sat % 2)
        broken = replace(sensed.data, observations=type(o)(**columns))
        answer = twin.navigate(first(broken, 8.0), sensed.initial, tight=True)
        sound = Tight(covariance_hz=None).run(first(sensed.data, 8.0), sensed.initial)
        assert (distance(answer, sound) > tolerance).any()


def test_they_refuse_and_readmit_the_same_fixes(short):
    """A jump of 200 m north from 15 s to 25 s: the gate rejects it, and readmits after three seconds."""
    sensed, _ = short
    fixes = sensed.data.fixes
    lla = fixes.lla.copy()
    lla[(fixes.t >= 15) & (fixes.t < 25), 0] += 200 / 6.37e6
    columns = {name: getattr(fixes, name) for name in GnssFixes.__slots__}
    data = replace(sensed.data, fixes=GnssFixes(**{**columns, "lla": lla}))
    settings = {"gate_probability": 1e-3, "readmit_after_s": 3.0}
    solution = Loose(covariance_hz=None, **settings).run(data, sensed.initial)
    position = solution.innovations.code == solution.innovations.sensor.index("gnss_position")
    refused = ~solution.innovations.accepted[position & (solution.innovations.component == 0)]
    assert_array_equal(refused[14:18], [True, True, True, False])
    assert_same(twin.navigate(data, sensed.initial, **settings), solution)


def test_the_order_of_phi_both_share_is_high_enough(short, monkeypatch):
    """With the whole second order of exp(F T) the twin moves by less than 1e-4 of its own uncertainty."""
    sensed, solution = short

    def series(F, T, decay):
        Phi = np.diag(decay)
        Phi[:9, :15] += (F * T + F @ F * T * T / 2)[:9]
        return Phi

    monkeypatch.setattr(twin, "transition", series)
    answer = twin.navigate(sensed.data, sensed.initial)
    sd = np.sqrt(np.einsum("kii->ki", solution.cov))
    moved = np.concatenate(
        [(answer.lla - solution.lla) * twin.meters(solution.lla), answer.vel_n - solution.vel_n], axis=1
    )
    assert (np.abs(moved) / sd[:, :6]).max() < 1e-4
    assert distance(answer, solution)[2] < 1e-4 * sd[:, 6:].min()
    sd_twin = np.sqrt(np.einsum("kii->ki", answer.cov))[:, :9]
    assert np.abs(sd_twin / sd - 1).max() < 1e-4


def test_what_both_take_for_the_errors_of_the_antenna_is_its_central_difference():
    """But for the Earth rate times the arm, 7e-5 m/s per rad, that both leave out as they say."""
    lla, vel = np.array([0.82, 0.2, 800.0]), np.array([20.0, 15.0, -2.0])
    C = twin.rotation_matrix(np.array([0.4, -0.2, 1.1]))
    lever, w_b = np.array([0.8, 0.3, -0.4]), np.array([0.3, -0.1, 0.2])
    *_, H = twin.antenna(lla, vel, C, lever, w_b)
    found = np.zeros((6, 15))
    for k, row in enumerate(np.diag(twin.STEP)):
        ends = [
            twin.antenna(
                lla + d[:3] / twin.meters(lla),
                vel + d[3:6],
                twin.rotation_matrix(d[6:9]) @ C,
                lever,
                w_b - d[9:12],
            )
            for d in (row, -row)
        ]
        found[:3, k] = (ends[0][0] - ends[1][0]) * twin.meters(lla) / (2 * twin.STEP[k])
        found[3:, k] = (ends[0][1] - ends[1][1]) / (2 * twin.STEP[k])
    arm = np.linalg.norm(lever)
    np.testing.assert_allclose(found[:3], H[:3], rtol=0, atol=1e-6)  # the arm over the radius of the Earth
    np.testing.assert_allclose(found[3:], H[3:], rtol=0, atol=2 * twin.EARTH_RATE * arm)


# --- what the comparison catches ----------------------------------------------------------------------


def _flipped(row, column):
    """One element of F with the wrong sign."""
    sound = twin.jacobian

    def jacobian(*state):
        F = sound(*state)
        F[:, row, column] *= -1
        return F

    return {"jacobian": jacobian}


def _antenna_without(term):
    """One effect of the lever arm forgotten."""
    sound = twin.antenna

    def antenna(lla, vel, C, lever, w_b):
        place, speed, H = sound(lla, vel, C, lever, w_b)
        if term == "arm in the position":
            place = lla
        if term == "arm in the velocity":
            speed = vel
        if term == "Earth rate in the velocity":
            speed = vel + C @ twin.cross(w_b, lever)
        if term == "tilt in the position":
            H[:3, 6:9] = 0
        if term == "tilt in the velocity":
            H[3:, 6:9] = 0
        if term == "gyro bias in the velocity":
            H[3:, 9:12] = 0
        return place, speed, H

    return {"antenna": antenna}


def _strapdown_on_one_interval():
    """Coning and sculling of the interval before forgotten."""
    sound = twin.strapdown
    return {"strapdown": lambda *state: sound(*state[:-1], None)}


def _feedback_on_the_right():
    """The tilt taken off in the body frame."""
    sound = twin.correct

    def correct(lla, vel, C, bias, x):
        lla, vel, _, bias = sound(lla, vel, C, bias, x)
        return lla, vel, C @ twin.rotation_matrix(-x[6:9]), bias

    return {"correct": correct}


def _bias_sd_as_printed():
    """The datasheet's bias instability taken for the standard deviation of the process."""

    def bias_process(triad):
        sd = triad.bias_instability
        return triad.turn_on_bias_sd**2 + sd**2, 2 * sd**2 / triad.bias_correlation, 0.0

    return {"bias_process": bias_process}


def _gravity_straight_down():
    """The north component of gravity forgotten: 0.8 mgal at 1 km."""
    sound = twin.gravity
    return {"gravity": lambda lat, alt: sound(lat, alt) * np.array([0.0, 1.0, 1.0])}


DEFECTS = {
    **{
        f"F[{row}, {column}] of the wrong sign, {what}": (_flipped, row, column)
        for row, column, what in (
            (0, 0, "height rate on the north error"),
            (1, 0, "meridians that converge"),
            (3, 4, "Coriolis"),
            (5, 2, "gravity with height"),
            (5, 3, "centripetal"),
            (6, 4, "transport rate"),
            (7, 8, "Earth rate"),
            (8, 4, "transport rate about down"),
        )
    },
    **{
        f"{term} forgotten": (_antenna_without, term)
        for term in (
            "arm in the position",
            "arm in the velocity",
            "Earth rate in the velocity",
            "tilt in the position",
            "tilt in the velocity",
            "gyro bias in the velocity",
        )
    },
    "coning and sculling forgotten": (_strapdown_on_one_interval,),
    "tilt fed back in the body frame": (_feedback_on_the_right,),
    "bias instability not scaled": (_bias_sd_as_printed,),
    "gravity straight down": (_gravity_straight_down,),
}


@pytest.mark.parametrize("defect", DEFECTS)
def test_a_defect_moves_the_twin_beyond_the_tolerance(short, monkeypatch, defect):
    sensed, _ = short
    make, *arguments = DEFECTS[defect]
    for name, broken in make(*arguments).items():
        monkeypatch.setattr(twin, name, broken)

    def moved(seconds):
        arguments = first(sensed.data, seconds), sensed.initial
        solution = Loose(covariance_hz=None).run(*arguments)
        return (distance(twin.navigate(*arguments), solution) > TOLERANCE).any()

    assert moved(5.0) or moved(30.0)


def test_a_baro_a_percent_noisier_than_assumed_is_caught(short):
    """The weakest figure of all: R of the barometer off by 1 %."""
    sensed, solution = short
    baro = replace(BARO, white_sd=BARO.white_sd * 1.005)
    data = replace(sensed.data, specs=replace(sensed.data.specs, baro=baro))
    assert (distance(twin.navigate(data, sensed.initial), solution) > TOLERANCE).any()
