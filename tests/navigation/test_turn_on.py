"""A turn-on bias of degrees per second is learnt before a linear filter takes it."""

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import bench
from bench import pipeline
from bench.core.mathematics import rotation
from bench.core.mathematics.earth import EARTH_RATE
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.core.records.data import ImuData
from bench.core.records.sensor_specs import ImuSpec, ThermalSpec, TriadSpec
from bench.evaluation.errors.error_series import DIVERGED_SIGMAS, error_series
from bench.navigation.built_in import load
from bench.navigation.engine.piecewise import join_solutions
from bench.navigation.engine.record_cuts import nothing_known, slice_sensors, take_head
from bench.navigation.error_state_filter.state_blocks import WIND_WALK
from bench.navigation.start import steady_course, turn_on, turning_start
from bench.simulation.flight import fly
from bench.simulation.flight.legs.level import Straight
from bench.simulation.flight.legs.turns import Turn
from bench.simulation.sensors import sense
from tests.builders import Z, at_rest, band, first_rows, take
from tests.flight.plans import plan
from tests.navigation import honesty
from tests.navigation.test_straight_flights import LEG
from tests.weaving import units

MPU = {"sensors.imu": "mpu-6050"}


def with_biases_alone(profile):
    """Return a profile whose unit has no other errors that are steady in straight flight."""
    unit = profile.sensors.imu
    triads = {
        name: replace(getattr(unit, name), temperature_sd=0.0, g_sensitivity_sd=0.0)
        for name in ("gyro", "accel")
    }
    return honesty.with_unit(profile, replace(unit, **triads))


@pytest.mark.parametrize("standing", [False, True])
def test_the_mean_rate_of_a_straight_or_a_standstill_is_the_bias(figure_eight_truth, standing):
    """In flight to a quarter of a degree per second, at rest to hundredths, over 12 runs of 6.7 deg/s."""
    profile = bench.read_profile("figure-eight", MPU)
    truth = first_rows(figure_eight_truth, 5001)
    if standing:  # to hundredths the g-sensitivity shows, too; without air there is no temperature
        profile = with_biases_alone(profile)
        truth = at_rest(25.0, 200.0, truth.lla[0])
    square = []
    for run in range(12):
        sensed = pipeline.sense(profile, truth, run)
        found = turn_on.find_turn_on(sensed.data, sensed.initial)
        assert found is not None
        assert found.until <= 25.0
        assert found.sd < np.deg2rad(0.02 if standing else 0.3)
        now = np.searchsorted(sensed.truth.t, found.until)
        square.append(((found.bias_b - sensed.truth.gyro_bias_b[now]) / found.sd) ** 2)
    assert np.mean(square) < band(36)[1]  # at least as good as it says


def test_what_a_datasheet_leaves_open_of_a_bias_and_of_its_warming():
    """By hand: 1 g on the gyros, 281.65 K at 1000 m, 6.5 K/km on the way, 15 K of its own heat."""
    gyro = TriadSpec(turn_on_bias_sd=3e-3, temperature_sd=1e-4, g_sensitivity_sd=2e-4)
    spec = ImuSpec("unit", gyro, TriadSpec(), thermal=ThermalSpec(298.15, 15.0, 100.0))
    start = SimpleNamespace(t=0.0, lla=np.array([0.8, 0.2, 1000.0]))
    assert steady_course.gyro_error_sd(spec, start) == pytest.approx(
        np.hypot(np.hypot(3e-3, 16.5e-4), 2e-4 * 9.80665)
    )
    for height, change in ((1400.0, 15.0), (400.0, 18.9)):
        heights = np.array([1000.0, np.nan, height])
        warming = turn_on.warming_sd(50.0, heights, spec, start)
        assert warming == pytest.approx(1e-4 * change * (1 - np.exp(-0.5)))
        at_once = replace(spec, thermal=replace(spec.thermal, time_constant=0.0))
        assert turn_on.warming_sd(50.0, heights, at_once, start) == pytest.approx(
            6.5e-7 * abs(height - 1000.0)
        )


def test_a_slow_turn_that_the_course_shows_is_no_bias(figure_eight_truth):
    """0.4 deg/s, 8 deg in the segment: the same gyros in straight flight have the same bias."""
    profile = bench.read_profile("figure-eight", MPU)
    sensed = pipeline.sense(profile, first_rows(figure_eight_truth, 5001))
    straight = turn_on.find_turn_on(sensed.data, sensed.initial)
    rate = np.array([0.0, 0.0, np.deg2rad(0.4)])
    imu, fixes = sensed.data.imu, sensed.data.fixes
    turned_b = rotation.rotate(rotation.conjugate(sensed.initial.q_nb), rate)
    vel_n = rotation.rotate(rotation.from_rotvec(np.outer(fixes.t, rate)), fixes.vel_n)
    data = replace(
        sensed.data,
        imu=replace(imu, dtheta_b=imu.dtheta_b + turned_b * imu.dt[:, None]),
        fixes=replace(fixes, vel_n=vel_n),
    )
    found = turn_on.find_turn_on(data, sensed.initial)
    assert found is not None
    assert found.bias_b == pytest.approx(straight.bias_b, abs=np.deg2rad(0.02))


def test_nothing_is_learnt_of_a_small_bias_or_in_a_turn(figure_eight_truth):
    small = bench.read_profile("figure-eight")
    sensed = pipeline.sense(small, first_rows(figure_eight_truth, 5001))
    assert turn_on.find_turn_on(sensed.data, sensed.initial) is None
    large = pipeline.sense(bench.read_profile("figure-eight", MPU), first_rows(figure_eight_truth, 5001))
    fixes = large.data.fixes
    course = 0.2 * fixes.t  # a circle in half a minute
    speed = np.hypot(fixes.vel_n[:, 0], fixes.vel_n[:, 1])
    circle = np.column_stack([speed * np.cos(course), speed * np.sin(course), np.zeros(len(speed))])
    data = replace(large.data, fixes=replace(fixes, vel_n=circle))
    assert turn_on.find_turn_on(data, large.initial) is None


@pytest.fixture(scope="module")
def turning():
    """A start in a turn: once around at 30 deg of bank, then straight on."""
    return fly(plan(Turn(np.deg2rad(360.0), np.deg2rad(30.0)), Straight(10.0), duration=45.0, rate=100.0))


BANK = np.deg2rad(25.0)  # of the turns that are made here


def coordinated(bias_b, bank=BANK):
    """Return the record of a turn that goes on, with a bias of the gyros, and its start; a car is level."""
    profile = with_biases_alone(bench.read_profile("figure-eight", MPU))
    sensed = pipeline.sense(profile, at_rest(12.0, 200.0, np.array([0.8, 0.2, 500.0])))
    imu, fixes, start = sensed.data.imu, sensed.data.fixes, sensed.initial
    rate = STANDARD_GRAVITY * np.tan(BANK) / 25.0
    turn_b = rate * np.array([0.0, np.sin(bank), np.cos(bank)]) + bias_b
    force_b = np.array([0.0, 0.0, -STANDARD_GRAVITY / np.cos(bank)])
    course = 3.0 + rate * fixes.t
    vel_n = 25.0 * np.column_stack([np.cos(course), np.sin(course), np.zeros(len(course))])
    data = replace(
        sensed.data,
        imu=replace(imu, dtheta_b=np.outer(imu.dt, turn_b), dvel_b=np.outer(imu.dt, force_b)),
        fixes=replace(fixes, vel_n=vel_n),
    )
    q_nb = rotation.from_euler(bank, 0.0, 1.0)  # the nose is not where the course goes
    return data, replace(start, vel_n=25.0 * np.array([np.cos(3.0), np.sin(3.0), 0.0]), q_nb=q_nb)


@pytest.mark.parametrize("bias_deg_s", [(0.0, 0.0, 0.0), (14.0, -9.0, 12.0), (-3.0, 20.0, -17.0)])
def test_in_a_coordinated_turn_the_bias_is_what_the_gyros_show_beyond_it(bias_deg_s):
    """To the rate of the Earth and of the local level; from the near bias of the look before."""
    bias_b = np.deg2rad(bias_deg_s)
    data, start = coordinated(bias_b)
    near = np.zeros(3)
    for until in (4.5, 7.0, 12.0):
        near, sd = turning_start.find_bias(data, start, until, near)
        assert_allclose(near, bias_b, atol=2.5 * EARTH_RATE)
    rare = replace(data, fixes=data.fixes.take(np.arange(len(data.fixes)) % 2 == 0))  # every two seconds
    assert_allclose(turning_start.find_bias(rare, start, 12.0, near)[0], bias_b, atol=2.5 * EARTH_RATE)
    assert turning_start.find_bias(data, start, data.fixes.t_arrival[0] + 0.1, near) is None
    end = data.fixes.t[data.fixes.t_arrival <= 12.0][-2:].mean()
    assert sd == pytest.approx(np.hypot(np.deg2rad(5.0), 0.5 * BANK) / end)


def test_a_car_that_starts_in_a_turn_errs_by_the_bank_it_does_not_have():
    data, start = coordinated(np.deg2rad([2.0, -3.0, 4.0]), bank=0.0)
    bias_b, sd = turning_start.find_bias(data, start, 12.0, np.zeros(3))
    off = np.linalg.norm(bias_b - np.deg2rad([2.0, -3.0, 4.0]))
    assert sd < off < 3.0 * sd  # on three axes


def test_a_straight_flight_is_no_start_in_a_turn(figure_eight_truth):
    sensed = pipeline.sense(bench.read_profile("figure-eight", MPU), first_rows(figure_eight_truth, 3001))
    assert turning_start.find_bias(sensed.data, sensed.initial, 15.0, np.zeros(3)) is None
    data, start = coordinated(np.zeros(3))
    slow = replace(data, fixes=replace(data.fixes, vel_n=0.1 * data.fixes.vel_n))
    assert turning_start.find_bias(slow, start, 12.0, np.zeros(3)) is None
    assert turning_start.find_bias(data, start, 0.5, np.zeros(3)) is None


def test_a_bias_that_no_unit_has_is_none():
    """As the one near which a filter begins; five times the 6.7 deg/s of the datasheet and more."""
    data, start = coordinated(np.deg2rad([40.0, 0.0, 0.0]))
    assert turn_on.find_turning(data, start, 4.5, np.deg2rad([38.0, 0.0, 0.0])) is None
    data, start = coordinated(np.deg2rad([20.0, 0.0, 0.0]))
    assert turn_on.find_turning(data, start, 4.5, np.deg2rad([18.0, 0.0, 0.0])) is not None
    gyro = replace(data.specs.imu.gyro, turn_on_bias_sd=np.deg2rad(2.0))  # known better than the turn tells
    known = replace(data, specs=replace(data.specs, imu=replace(data.specs.imu, gyro=gyro)))
    assert turn_on.find_turning(known, start, 4.5, np.deg2rad([18.0, 0.0, 0.0])) is None
    known, start = replace(coordinated(np.zeros(3))[0], specs=known.specs), start
    assert turn_on.find_turning(known, start, 4.5, np.zeros(3)) is None
    assert turn_on.find_turning(known, start, 12.0, np.zeros(3)) is not None


def test_a_filter_that_starts_in_a_turn_is_honest(turning):
    """16 runs of 6.7 deg/s: none is lost. Without the first turn the heading is known half as well."""
    profile = replace(bench.read_profile("figure-eight", MPU), seed=23)
    nees, headings = [], {turn_on.LARGE: [], np.inf: []}
    for run in range(16):
        sensed = pipeline.sense(profile, turning, run)
        data = replace(sensed.data, output_t=np.arange(22.0, 44.0, 2.0))
        for largest, found in list(headings.items())[: 2 if run < 4 else 1]:
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(turn_on, "LARGE", largest)
                errors = error_series(turning, load("loose-full", {}).run(data, sensed.initial))
            if run < 4:
                found.append(errors.heading[0])
            if largest != np.inf:
                nees.append(errors.nees.mean())
    assert np.mean(nees) < 9.0 + Z * np.sqrt(18.0 / 16)
    known, plain = (np.sqrt(np.mean(np.square(found))) for found in headings.values())
    assert plain > 2.0 * known


def test_a_smoother_that_starts_in_a_turn_is_honest(turning):
    profile = replace(bench.read_profile("figure-eight", MPU), seed=29)
    nees = []
    for run in range(4):
        sensed = pipeline.sense(profile, turning, run)
        data = replace(sensed.data, output_t=np.arange(2.0, 44.0, 2.0))
        nees.append(error_series(turning, load("smoother", {}).run(data, sensed.initial)).nees.mean())
    assert np.mean(nees) < 9.0 + Z * np.sqrt(18.0 / 4)


def test_what_a_short_stretch_tells_gives_way_to_the_first_turn(turning):
    """The first seconds may be the begin of a turn; the longer that goes on, the better it tells the bias."""
    sensed = pipeline.sense(bench.read_profile("figure-eight", MPU), turning)
    data = replace(sensed.data, output_t=np.array([2.0, 30.0]))
    solution = load("loose-full", {}).run(data, sensed.initial)
    texts = [text for *_, text in solution.events.select("alignment")]
    assert [text.split(" by ")[1].split(",")[0] for text in texts] == ["their mean rate"] + 4 * [
        "the first turn"
    ]
    left = [float(text.split("left ")[1].split(" ")[0]) for text in texts[1:]]
    assert left == sorted(left, reverse=True)


def test_a_unit_that_is_shaken_on_the_ground_learns_its_bias():
    """By the gyros, which may be shaken at 9 Hz, too; not while they swing as of what hovers."""
    profile = with_biases_alone(bench.read_profile("figure-eight", {"sensors.imu": "lsm6dsl"}))
    truth = at_rest(12.0, 200.0, np.array([0.8, 0.2, 500.0]))
    for turn_deg_s, hz in ((0.0, 9.0), (1.0, 9.0), (1.0, 0.7)):
        wave = np.sin(2 * np.pi * hz * truth.t[1:])[:, None] / 200.0
        shaken = replace(
            truth,
            dvel_b=truth.dvel_b + 0.04 * wave * [0.0, 0.0, 1.0],
            dtheta_b=truth.dtheta_b + np.deg2rad(turn_deg_s) * wave * [1.0, 0.0, 0.0],
        )
        sensed = pipeline.sense(profile, shaken)
        found = turn_on.find_turn_on(sensed.data, sensed.initial, 11.0)
        if hz < 1.0:
            assert found is None
            continue
        assert found is not None
        assert np.rad2deg(found.sd) == pytest.approx(0.1 / 11.0, rel=0.25)
        assert_allclose(found.bias_b, sensed.truth.gyro_bias_b[-1], atol=4.0 * found.sd)


def test_a_roll_is_no_bias(figure_eight_truth):
    """60 deg/s about the nose is more than any such unit errs, though the course stays."""
    profile = bench.read_profile("figure-eight", MPU)
    sensed = pipeline.sense(profile, first_rows(figure_eight_truth, 5001))
    imu = sensed.data.imu
    roll = np.outer(imu.dt, np.deg2rad([60.0, 0.0, 0.0]))
    data = replace(sensed.data, imu=replace(imu, dtheta_b=imu.dtheta_b + roll))
    assert turn_on.find_turn_on(data, sensed.initial, 5.0) is None
    assert turn_on.find_turn_on(sensed.data, sensed.initial, 5.0) is not None


def test_the_first_seconds_are_honest_with_a_bias_of_degrees_per_second(figure_eight_truth):
    """16 runs; all seconds of a run may err together. A filter that learns after 20 s has 20 and more."""
    profile = replace(bench.read_profile("figure-eight", {"sensors.imu": "mpu-9250"}), seed=11)
    truth = first_rows(figure_eight_truth, 4401)
    nees = []
    for run in range(16):
        sensed = pipeline.sense(profile, truth, run)
        data = replace(sensed.data, output_t=np.arange(2.0, 22.0))
        solution = load("loose-full", {}).run(data, sensed.initial)
        errors = error_series(truth, solution)
        sd = np.sqrt(np.einsum("kii->ki", solution.cov)[:, 6:9])
        assert (np.abs(errors.phi_n) < DIVERGED_SIGMAS * sd).all()
        nees.append(errors.nees.mean())
    assert np.mean(nees) < 9.0 + Z * np.sqrt(18.0 / 16)


@pytest.mark.parametrize(("start", "unit"), [("straight", "mpu-9250"), ("turn", "mpu-6050")])
def test_in_pieces_it_begins_again_with_the_same_bits(start, unit, figure_eight_truth, turning, tmp_path):
    """Cut into 0.7 s, saved and gone on with between."""
    profile = bench.read_profile("figure-eight", {"sensors.imu": unit})
    truth = first_rows(turning, 1201) if start == "turn" else first_rows(figure_eight_truth, 2401)
    sensed = pipeline.sense(profile, truth)
    fixes = sensed.data.fixes  # some arrive after a look at the segment and are valid before it
    t = np.where(np.arange(len(fixes)) == 7, np.nan, fixes.t)  # one says no time
    late = replace(sensed.data, fixes=replace(fixes, t=t, t_arrival=fixes.t_arrival + 1.2))
    sensed = replace(sensed, data=late)
    whole = load("loose-full", {}).run(sensed.data, sensed.initial)
    assert len(whole.events.select("alignment")) >= 2
    filter_, found, begin = bench.open_filter("loose-full", sensed.initial, look_back=1.3), [], -np.inf
    for k, end in enumerate(np.arange(0.7, 14.1, 0.7)):
        found.append(filter_.update(bench.slice_sensors(sensed.data, begin, end)))
        begin = end
        if k % 4 == 1:
            filter_ = bench.read_filter(bench.write_filter(filter_, tmp_path / f"{k}.npz"))
    joined = join_solutions([*found, filter_.finish()])
    np.testing.assert_array_equal(joined.lla, whole.lla)
    np.testing.assert_array_equal(joined.cov, whole.cov)
    assert joined.events.rows() == whole.events.rows()


@pytest.mark.slow
def test_loose_full_is_honest_with_a_bias_of_degrees_per_second(figure_eight_truth):
    """6 runs of 5 minutes; without such a start the first turn loses the heading, and the filter is reset."""
    profile = replace(bench.read_profile("figure-eight", {**MPU, "evaluation.output_hz": 1.0}), seed=31)
    truth = first_rows(figure_eight_truth, 60_001)
    uses = [("loose-full", {})]
    (found,) = honesty.judge_draws(profile, truth, "mpu-6050", uses, range(6))
    assert found.failed == 0
    most = 9.0 + Z * max(found.error, 0.6)
    assert found.mean < most
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(turn_on, "LARGE", np.inf)
        sensed = pipeline.sense(profile, truth, 0)
        assert len(load("loose-full", {}).run(sensed.data, sensed.initial).events.select("reset"))


@pytest.mark.parametrize("unit", ["mpu-6050", "icm-42688-p"])
def test_what_is_left_of_a_bias_is_learnt_while_the_course_stays(unit):
    """Ten minutes straight on in six runs: the heading stays known to a few degrees, and the bias is found.

    Without the course both are off by more than they say: 0.2 deg/s turns the heading around in half an hour.
    """
    profile = with_biases_alone(bench.read_profile("long-cruise", {"sensors.imu": unit, **LEG}))
    truth = first_rows(bench.fly(profile), 120_201)
    for run in range(6):
        sensed = pipeline.sense(profile, truth, run)
        data = bench.slice_sensors(sensed.data, -1.0, 600.0)
        solution = load("loose-full", {}).run(replace(data, output_t=np.array([30.0, 590.0])), sensed.initial)
        errors = error_series(truth, solution)
        now = np.searchsorted(sensed.truth.t, solution.t)
        bias = solution.gyro_bias_b - sensed.truth.gyro_bias_b[now]
        sd = np.sqrt(solution.cov[:, 8, 8])
        assert sd.max() < np.deg2rad(6.0)
        assert solution.extra_sd[-1, :3].max() < np.deg2rad(0.03)
        assert (np.abs(bias).max(axis=1) < 4.0 * solution.extra_sd[:, :3].max(axis=1)).all()
        assert (np.abs(errors.phi_n[:, 2]) < 4.0 * sd).all()


def record_of(course_deg, speed=25.0):
    """Fixes of a course [deg], one a second, that arrive 0.1 s later."""
    course, n = np.deg2rad(course_deg), len(course_deg)
    t = np.arange(n) + 1.0
    return SimpleNamespace(
        fixes=SimpleNamespace(
            t_arrival=t + 0.1,
            valid=np.ones(n, np.bool_),
            vel_n=np.column_stack([speed * np.cos(course), speed * np.sin(course), np.zeros(n)]),
        )
    )


def start(speed=25.0):
    return SimpleNamespace(t=0.0, vel_n=np.array([speed, 0.0, 0.0]), lla=np.array([0.8, 0.2, 500.0]))


QUIET = ImuSpec("quiet", TriadSpec(random_walk=1e-4), TriadSpec(random_walk=1e-3))


def course_of(initial, steady=True):
    return steady_course.SteadyCourse(initial, QUIET, steady=steady)


def samples_of(turning, rate=50.0):
    """Samples of a unit that turns by a rate [rad/s] in some of its seconds, and is shaken all the time."""
    n, noise = round(len(turning) * rate), np.random.default_rng(2)
    t, none = np.arange(1, n + 1) / rate, np.ones(n, np.bool_)
    turn = np.repeat(np.asarray(turning, float), round(rate))[:, None] * [0.0, 0.0, 1.0]
    force = noise.normal(scale=0.1, size=(n, 3))
    force[:, 2] -= 9.79
    return ImuData(t, np.full(n, 1 / rate), none, turn / rate, force / rate)


NOTHING = take(samples_of(np.zeros(1)), slice(0))


def test_a_course_is_measured_until_it_has_changed():
    """Across south, where it jumps by 360 deg, and however the record is cut; never again after a turn."""
    course = 172.0 + 9.0 * np.sin(np.arange(100.0) / 5.0)
    course[75:90] += 11.0
    whole = course_of(start())
    t, values, variance = whole.take(record_of(course), NOTHING)
    assert_allclose(t, [1.1, 30.1, 40.1, 50.1, 60.1, 70.1])
    assert_allclose(np.rad2deg(values[:, 0]) % 360.0, course[np.round(t - 1.1).astype(int)], atol=1e-9)
    assert_allclose(variance, np.deg2rad(5.0) ** 2)
    cut, found = course_of(start()), []
    record = record_of(course).fixes
    for first in range(0, 100, 7):
        rows = slice(first, first + 7)
        piece = {name: value[rows] for name, value in vars(record).items()}
        found += cut.take(SimpleNamespace(fixes=SimpleNamespace(**piece)), NOTHING)[0].tolist()
        again = course_of(start())
        again.restore(cut.state())
        cut = again
    assert_allclose(found, t)


def test_a_course_of_a_walk_is_none_and_ends_the_stretch():
    """Below 5 m/s; what flies has an angle to it that the wind changes, the slower the more."""
    speed = np.where(np.arange(60) < 45, 5.1, 4.9)
    found = course_of(start(5.1))
    assert_allclose(found.take(record_of(np.zeros(60), speed), NOTHING)[0], [1.1, 30.1, 40.1])
    for speed, walk in ((25.0, WIND_WALK / 25.0), (5.1, WIND_WALK / 5.1), (4.9, 0.0)):
        (block,) = course_of(start(speed)).blocks()
        (state,) = block.states(None)
        assert (state.name, state.unit, state.size) == ("course_offset", "rad", 1)
        assert state.variance == pytest.approx(np.pi**2 / 3.0)
        assert state.density == pytest.approx(walk**2)
    assert course_of(start(), steady=False).blocks() == []
    assert not len(course_of(start(), steady=False).take(record_of(np.zeros(9)), NOTHING)[0])
    with pytest.raises(ValueError, match=r"^over must be true of gyros that keep the heading$"):
        course_of(start(), steady=False).restore({**found.state(), "over": False})


def test_at_rest_the_nose_points_where_it_did_until_it_moves():
    speed = np.where(np.arange(60) < 45, 0.49, 0.51)
    found = course_of(start(0.0))
    record = record_of(np.linspace(0.0, 359.0, 60), speed)
    t, values, variance = found.take(record, samples_of(np.zeros(60)))
    assert_allclose(t, [1.1, 30.1, 40.1])
    assert (values == 0.0).all()
    assert_allclose(variance, np.deg2rad(0.1) ** 2)


ALL = [1.1, 30.1, 40.1, 50.1, 60.1]


@pytest.mark.parametrize(
    ("turning_s", "measured"),
    [((), ALL), (range(10, 20), ALL), (range(0, 60, 2), ALL), (range(32, 39), ALL[:2]), (range(60), ALL[:1])],
)
def test_what_is_slow_and_turns_does_not_stand(turning_s, measured):
    """For more than half of the time since the angle before; shaken it may be, and the record cut anyhow."""
    turning = np.isin(np.arange(60), list(turning_s)) * 0.02
    record, samples = record_of(np.zeros(60), np.full(60, 0.1)), samples_of(turning)
    assert_allclose(course_of(start(0.0)).take(record, samples)[0], measured)
    cut, found = course_of(start(0.0)), []
    for first in range(0, 60, 7):
        rows = slice(first, first + 7)
        fixes = SimpleNamespace(**{name: value[rows] for name, value in vars(record.fixes).items()})
        inside = (samples.t > (first and first + 0.35)) & (samples.t <= first + 7.35)
        found += cut.take(SimpleNamespace(fixes=fixes), take(samples, inside))[0].tolist()
        again = course_of(start(0.0))
        again.restore(cut.state())
        cut = again
    assert_allclose(found, measured)


def test_what_turns_steadily_after_it_stood_does_not_stand():
    """At 0.57 deg/s from an angle on, which a gyro with a bias may show at rest."""
    unit = ImuSpec("biased", TriadSpec(random_walk=1e-4, turn_on_bias_sd=0.02), QUIET.accel)
    record, turning = record_of(np.zeros(60), np.full(60, 0.1)), 0.01 * (np.arange(60) >= 30)
    for rates, measured in ((turning, ALL[:2]), (np.full(60, 0.01), ALL)):
        found = steady_course.SteadyCourse(start(0.0), unit, steady=True)
        assert_allclose(found.take(record, samples_of(rates))[0], measured)


# --- the segment by hand ------------------------------------------------------------------------------------


def straight_on(bias_b, rate=0.0, unit_sd=0.1):
    """Return the record of a straight flight or slow turn [rad/s] with a bias of the gyros, and its start."""
    gyro = TriadSpec(turn_on_bias_sd=unit_sd)
    spec = replace(units(ImuSpec("unit", gyro, TriadSpec())), output_rate=1.0)
    sensed = sense(at_rest(26.0, 50.0, np.array([0.8, 0.2, 500.0])), spec, 1, 0)
    imu, fixes, start = sensed.data.imu, sensed.data.fixes, sensed.initial
    q_nb = rotation.from_euler(0.1, 0.2, 1.0)
    turn_b = rotation.rotate(rotation.conjugate(q_nb), [0.0, 0.0, rate]) + bias_b
    course = 3.0 + rate * fixes.t
    vel_n = 25.0 * np.column_stack([np.cos(course), np.sin(course), np.zeros(len(course))])
    imu = replace(imu, dtheta_b=np.outer(imu.dt, turn_b))
    return replace(sensed.data, imu=imu, fixes=replace(fixes, vel_n=vel_n)), replace(start, q_nb=q_nb)


def turned_at(data, t, by_deg=0.0, speed=1.0):
    """The record, on another course or at another speed from a fix on."""
    later = data.fixes.t >= t - 1e-6
    turn = rotation.from_rotvec(np.outer(later, [0.0, 0.0, np.deg2rad(by_deg)]))
    vel_n = rotation.rotate(turn, data.fixes.vel_n) * np.where(later, speed, 1.0)[:, None]
    return replace(data, fixes=replace(data.fixes, vel_n=vel_n))


BIAS = np.deg2rad([3.0, -5.0, 4.0])


def test_a_stretch_tells_the_mean_rate_less_that_of_the_course():
    """From its first fix, at 1 s, to its last that has come; the nose may have turned by 5 deg beside it."""
    data, start = straight_on(BIAS, rate=-0.005)
    for until, span in ((11.0, 10.0), (2.0, 1.0), (99.0, 19.0)):
        found = turn_on.find_turn_on(data, start, until)
        assert_allclose(found.bias_b, BIAS, atol=1e-9)
        assert found.sd == pytest.approx(np.deg2rad(5.0) / span)
        assert found.until == pytest.approx(1.0 + span)
        assert not found.turning
    assert turn_on.find_turn_on(data, start, 1.9) is None
    late = replace(data, fixes=replace(data.fixes, t_arrival=data.fixes.t + 0.3))
    assert turn_on.find_turn_on(late, start, 11.0).until == pytest.approx(10.3)


@pytest.mark.parametrize(
    ("t", "change", "span"),
    [
        (7.0, {"by_deg": 11.0}, 5.0),  # to the fix before
        (6.0, {"by_deg": 11.0}, None),  # what has ended has to be 5 s long
        (7.0, {"by_deg": -9.0}, 10.0),
        (7.0, {"speed": 0.19}, 5.0),  # 4.75 m/s is no course
        (7.0, {"speed": 0.21}, 10.0),
    ],
)
def test_a_stretch_ends_where_the_course_leaves_or_is_none(t, change, span):
    data, start = straight_on(BIAS)
    found = turn_on.find_turn_on(turned_at(data, t, **change), start, 11.0)
    if span is None:
        assert found is None
    else:
        assert found.until == pytest.approx(1.0 + span)
        assert found.sd == pytest.approx(np.deg2rad(5.0) / span)


def test_what_a_stretch_tells_has_to_be_better_than_the_datasheet_and_of_a_unit():
    """5 deg/s after 1 s; no bias is larger than five times what is not known of both."""
    data, start = straight_on(BIAS, unit_sd=np.deg2rad(4.0))
    assert turn_on.find_turn_on(data, start, 2.0) is None
    assert turn_on.find_turn_on(data, start, 3.0) is not None
    most = 5.0 * np.hypot(np.rad2deg(0.1), 0.5)
    for part, found in ((0.98, True), (1.02, False), (-1.02, False)):
        data, start = straight_on(np.deg2rad([0.0, 0.0, part * most]))
        assert (turn_on.find_turn_on(data, start, 11.0) is not None) == found


def test_a_bias_is_learnt_where_it_is_large_and_the_attitude_given():
    """From 0.3 deg/s on, which is 18 deg in a minute, and by fixes."""
    for sd, large in ((0.29, False), (0.31, True)):
        data, start = straight_on(BIAS, unit_sd=np.deg2rad(sd))
        assert turn_on.may_be_learnt(data, start) == large
    assert not turn_on.may_be_learnt(replace(data, fixes=None), start)
    assert not turn_on.may_be_learnt(data, replace(start, alignment="level"))
    assert not turn_on.may_be_learnt(data, replace(start, bias_cov=np.ones((9, 6))))
    for sd, loses in ((1.49, False), (1.51, True)):  # 15 deg in ten minutes
        data, _ = straight_on(BIAS, unit_sd=np.deg2rad(sd / 60.0))
        assert steady_course.has_large_bias(data) == loses
        assert not steady_course.has_large_bias(replace(data, fixes=None))


class Watched:
    """A filter that only says what it is given: it estimates the mean rate of each piece as its bias."""

    def __init__(self, log, sd):
        self.log, self.sd, self.end = log, sd, 0.0

    def update(self, piece, look_back, *, last):
        self.end = max(self.end, piece.imu.t.max(initial=0.0))
        mean = piece.imu.dtheta_b.sum(axis=0) / max(piece.imu.dt.sum(), 1e-9)
        self.log.append((self.sd, self.end, look_back, last, np.rad2deg(mean)))
        empty = nothing_known(piece.output_t)
        zero = np.zeros((len(piece.output_t), 3))
        return replace(empty, extra_names=("x", "y", "z"), extra=zero, extra_sd=zero, gyro_bias_b=zero)

    def steady_errors(self):
        return np.arange(6.0), np.ones(6)


def watch(data, start):
    log = []
    filter_ = turn_on.FromTurnOn(
        lambda first, initial, events, sd: Watched(log, sd), take_head(data), start, []
    )
    return filter_, log


def test_a_filter_begins_again_whenever_the_stretch_tells_more():
    """After 1.5, 2.5, 3.5, 5, 10 and 20 s; what it gets is less the bias, and what it says is not."""
    data, start = straight_on(BIAS)
    filter_, log = watch(data, start)
    edges = np.arange(0.0, 25.5, 0.9)
    found = [filter_.update(slice_sensors(data, *edge), 0.2, last=False) for edge in pairwise(edges)]
    spans = np.array([1.0, 2.0, 4.0, 9.0, 19.0])  # until 1.5 s there is one fix
    texts = [row for one in found for row in one.events.rows()]
    assert [row[3] for row in texts] == [
        f"turn-on bias of the gyros by their mean rate, left {5.0 / span:.2g} deg/s" for span in spans
    ]
    assert [row[:2] for row in texts] == [(0.0, pytest.approx(1.0 + span)) for span in spans]
    again = [one for one, before in zip(log[1:], log, strict=False) if one[0] != before[0]]
    assert [one[0] for one in again] == [pytest.approx(np.deg2rad(5.0) / span) for span in spans]
    assert [round(one[1], 6) for one in again] == [2.5, 3.5, 5.0, 10.0, 20.0]
    for _, _, _, _, mean in again:
        assert_allclose(mean, 0.0, atol=1e-6)
    assert_allclose(log[0][4], [3.0, -5.0, 4.0])
    for one in found:
        late = one.t > 2.5
        assert_allclose(one.gyro_bias_b[late], np.tile(BIAS, (late.sum(), 1)))
        assert_allclose(one.extra[late], np.tile(BIAS, (late.sum(), 1)))
        assert not one.gyro_bias_b[~late].any()
    mean, sd = filter_.steady_errors()
    assert_allclose(mean, np.arange(6.0) + np.append(BIAS, np.zeros(3)))
    assert_allclose(sd, 1.0)
    assert len(filter_.record.imu) == 0  # is not kept beyond the segment
    assert filter_.end == pytest.approx(25.2)


def test_what_is_looked_at_counts_from_the_start():
    """At 3 s, where there is a fix: after 4.5 s, and no longer than until 23 s."""
    data, start = straight_on(BIAS)
    start = replace(start, t=3.0)
    filter_, log = watch(data, start)
    filter_.update(slice_sensors(data, 2.9, 5.4), 0.2, last=False)
    assert [one[0] for one in log] == [None, *[pytest.approx(np.deg2rad(5.0))] * 2]
    assert [one[1] for one in log[:2]] == [pytest.approx(4.5, abs=0.021)] * 2
    found = turn_on.find_turn_on(data, start)
    assert found.until == pytest.approx(23.0)
    assert found.sd == pytest.approx(np.deg2rad(5.0) / 20.0)


def test_a_filter_begins_as_before_where_the_course_leaves_at_once():
    """What a second of a segment told is taken back; the turn tells nothing of gyros known so well."""
    data, start = straight_on(BIAS)
    data = turned_at(data, 4.0, by_deg=170.0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(turn_on, "find_turning", lambda *_: None)
        filter_, log = watch(data, start)
        found = [filter_.update(slice_sensors(data, -1.0, 2.9), 0.2, last=False)]
        found.append(filter_.update(slice_sensors(data, 2.9, 6.0), 0.2, last=False))
    texts = [row for one in found for row in one.events.rows()]
    assert texts[-1][:4] == (
        0.0,
        5.0,
        "alignment",
        "turn-on bias of the gyros as before: the course has left",
    )
    assert filter_.found is None
    assert log[-1][0] is None


def test_a_better_estimate_of_a_bias_replaces_one_of_its_kind():
    filter_, _ = watch(*straight_on(BIAS))
    plain, turning = turn_on.TurnOn(BIAS, 0.02, 5.0), turn_on.TurnOn(BIAS, 0.9, 5.0, turning=True)
    assert not filter_.is_other(None)
    assert filter_.is_other(plain)
    filter_.found = plain
    assert filter_.is_other(None)
    assert filter_.is_other(turning)
    assert filter_.is_other(replace(plain, sd=0.019))
    assert not filter_.is_other(replace(plain, sd=0.02))
    filter_.found = turning
    assert filter_.is_other(plain)
    assert not filter_.is_other(replace(turning, sd=0.95))


def test_another_antenna_ends_the_search_for_a_bias():
    """The record from the start on is that of the one before."""
    data, start = straight_on(BIAS)
    filter_, log = watch(data, start)
    filter_.update(slice_sensors(data, -1.0, 2.0), 0.2, last=False)
    filter_.update(replace(slice_sensors(data, 2.0, 9.0), antenna_b=np.ones(3)), 0.2, last=False)
    assert [one[0] for one in log] == [None, None]


def test_a_smoother_knows_the_whole_stretch_from_its_first_answer_on():
    data, start = straight_on(BIAS)
    log = []

    def run(piece, initial, sd):
        return Watched(log, sd).update(piece, 0.0, last=True)

    solution, bias_b = turn_on.smooth_from_turn_on(run, data, start)
    assert_allclose(bias_b, BIAS, atol=1e-9)
    ((sd, _, _, _, mean),) = log
    assert sd == pytest.approx(np.deg2rad(5.0) / 19.0)
    assert_allclose(mean, 0.0, atol=1e-6)
    assert_allclose(solution.gyro_bias_b, np.tile(BIAS, (len(solution), 1)))
    (event,) = solution.events.rows()
    assert event[3] == "turn-on bias of the gyros by their mean rate, left 0.26 deg/s"
    small, start = straight_on(BIAS, unit_sd=1e-4)
    solution, bias_b = turn_on.smooth_from_turn_on(run, small, start)
    assert log[-1][0] is None
    assert not bias_b.any()
    assert not len(solution.events)
