"""Each metric of one run against a series whose answer is known by hand; doubling an error doubles it."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from bench.core.mathematics import rotation
from bench.core.mathematics.units import unit_of
from bench.core.records.data import Events, Innovations, no_innovations
from bench.core.records.run_records import SensorTruth
from bench.core.records.sensor_specs import AssumedSpecs, Fault
from bench.core.records.specs import EvaluationWindow
from bench.evaluation.consistency.chi_square import chi2_quantile
from bench.evaluation.metrics import run_metrics
from bench.evaluation.metrics.run_metrics import METRICS, find_metric, measure
from tests.evaluation.solutions import COV, weaving_truth, without, wrong_solution
from tests.weaving import units

OUTAGES = ((5.0, 9.0), (12.0, 15.0))


@pytest.fixture(scope="module")
def truth():
    return weaving_truth()


def metrics_of(truth, solution, begin=0.0, outages=(), faults=()):
    evaluation = EvaluationWindow(begin)
    return measure(truth, solution, evaluation=evaluation, outages=outages, faults=faults)[1]


def some_innovations():
    """gnss_position (3 components) at 1..19 s, baro at 0.5, 1.5, ...; NIS 1, 2, 3, ...; one is rejected."""
    rows = []
    for k in range(1, 20):
        rows += [(float(k), 0, axis, float(k), k != 4 or axis != 1) for axis in range(3)]
        rows.append((k - 0.5, 1, 2, 0.5, k > 3))
    t, code, component, nis, accepted = (np.array(column) for column in zip(*rows, strict=True))
    return Innovations(
        t,
        ("gnss_position", "baro", "unused"),
        code,
        component,
        np.ones(len(t)),
        np.ones(len(t)),
        nis,
        accepted,
    )


def random_errors(seed, scale, m=201):
    return scale * np.random.default_rng(seed).normal(size=(m, 3))


# --- accuracy -----------------------------------------------------------------------------------------


def test_rmse_of_a_constant_error_is_that_error(truth):
    found = metrics_of(
        truth,
        wrong_solution(truth, pos_n=[3.0, -4.0, 12.0], vel_n=[0.3, 0.4, -1.2], phi_n=[0.01, 0.0, -0.02]),
    )
    expected = {"n": 3.0, "e": 4.0, "d": 12.0, "h": 5.0, "3d": 13.0}
    for axis, value in expected.items():
        assert found[f"pos_rmse_{axis}_m"] == pytest.approx(value, abs=1e-7)
        assert found[f"vel_rmse_{axis}_mps"] == pytest.approx(0.1 * value, abs=1e-12)
    assert found["phi_rmse_n_deg"] == pytest.approx(math.degrees(0.01))
    assert found["phi_rmse_e_deg"] == pytest.approx(0.0, abs=1e-12)
    assert found["phi_rmse_d_deg"] == pytest.approx(math.degrees(0.02))
    assert found["tilt_rmse_deg"] == pytest.approx(math.degrees(0.01))
    assert found["pos_max_h_m"] == pytest.approx(5.0, abs=1e-7)
    assert found["pos_max_v_m"] == pytest.approx(12.0, abs=1e-7)
    assert found["vel_max_mps"] == pytest.approx(1.3, abs=1e-12)


def test_rmse_is_the_root_of_the_mean_square_and_a_maximum_is_one_epoch(truth):
    pos_n = np.zeros((201, 3))
    pos_n[0] = [3.0, -4.0, -7.0]
    found = metrics_of(truth, wrong_solution(truth, pos_n=pos_n))
    assert found["pos_rmse_n_m"] == pytest.approx(3.0 / math.sqrt(201), abs=1e-9)
    assert found["pos_rmse_h_m"] == pytest.approx(5.0 / math.sqrt(201), abs=1e-9)
    assert found["pos_rmse_3d_m"] == pytest.approx(math.sqrt(74.0 / 201), abs=1e-9)
    assert found["pos_max_h_m"] == pytest.approx(5.0, abs=1e-7)
    assert found["pos_max_v_m"] == pytest.approx(7.0, abs=1e-7)
    assert found["cep50_m"] == pytest.approx(0.0, abs=1e-7)


def test_heading_metrics_are_of_the_heading_angle(truth):
    truth = replace(truth, q_nb=rotation.from_euler(0.0, 0.0, 0.001 * truth.t))
    phi_n = np.zeros((201, 3))
    phi_n[:, 2] = np.where(np.arange(201) % 2, 0.03, -0.04)
    found = metrics_of(truth, wrong_solution(truth, phi_n=phi_n))
    assert found["heading_max_deg"] == pytest.approx(math.degrees(0.04))
    mean_square = (100 * 0.03**2 + 101 * 0.04**2) / 201
    assert found["heading_rmse_deg"] == pytest.approx(math.degrees(math.sqrt(mean_square)))


@pytest.mark.parametrize("every", [10, 20, 50, 400])
def test_cep_and_r95_are_the_smallest_radius_of_an_epoch_that_holds_its_share(truth, every):
    """Brute force over the epochs, for 201, 101, 41 and 6 of them."""
    m = len(range(0, len(truth), every))
    pos_n = random_errors(5, 4.0, m)
    errors, found = measure(
        truth, wrong_solution(truth, every=every, pos_n=pos_n), evaluation=EvaluationWindow(0.0), outages=()
    )
    radius = np.hypot(errors.pos_n[:, 0], errors.pos_n[:, 1])
    down = np.abs(errors.pos_n[:, 2])

    def smallest(values, share):
        return min(v for v in values if sum(w <= v for w in values) >= share * m)

    assert found["cep50_m"] == smallest(radius, 0.50)
    assert found["cep95_m"] == smallest(radius, 0.95)
    assert found["r95_m"] == found["cep95_m"]
    assert found["pos_95_v_m"] == smallest(down, 0.95)


def test_doubling_every_error_doubles_every_metric_of_accuracy(truth):
    """Attitude errors are small here, so that heading is linear in them."""

    def judged(factor):
        solution = wrong_solution(
            truth,
            pos_n=factor * random_errors(1, 3.0),
            vel_n=factor * random_errors(2, 0.2),
            phi_n=factor * random_errors(3, 1e-5),
        )
        return metrics_of(truth, solution, 6.0, OUTAGES)

    once, twice = judged(1.0), judged(2.0)
    linear = [
        name
        for name in once
        if (row := find_metric(name)) and row.unit in ("m", "m/s", "deg")
        if not name.startswith(("pos_sigma", "ape", "rpe"))
    ]
    assert len(linear) >= 2 * 20
    for name in linear:
        if once[name] is not None:
            assert twice[name] == pytest.approx(2.0 * once[name], rel=1e-4), name
            assert once[name] > 0, name


# --- the window ---------------------------------------------------------------------------------------


def test_a_metric_begins_at_the_end_of_the_alignment_window_and_its_twin_at_the_start(truth):
    pos_n = np.zeros((201, 3))
    pos_n[:60, 0] = 100.0  # up to 5.9 s
    pos_n[60:, 0] = 2.0
    found = metrics_of(truth, wrong_solution(truth, pos_n=pos_n), begin=6.0)
    assert found["pos_max_h_m"] == pytest.approx(2.0, abs=1e-7)
    assert found["pos_max_h_m_all"] == pytest.approx(100.0, abs=1e-7)
    found = metrics_of(truth, wrong_solution(truth, pos_n=pos_n), begin=5.9)
    assert found["pos_max_h_m"] == pytest.approx(100.0, abs=1e-7)


def test_the_window_cuts_innovations_events_and_outages(truth):
    events = Events(
        np.array([1.0, 2.0, 9.0]),
        np.array([1.0, 2.0, 9.0]),
        ("timeline", "gate", "timeline"),
        ("",) * 3,
        ("",) * 3,
    )
    solution = wrong_solution(truth, innovations=some_innovations(), events=events)
    found = metrics_of(truth, solution, 6.0, OUTAGES)
    assert (found["updates_gnss_position"], found["updates_gnss_position_all"]) == (14.0, 19.0)
    assert (found["rejected_gnss_position"], found["rejected_gnss_position_all"]) == (0.0, 1.0)
    assert (found["rejected_baro"], found["rejected_baro_all"]) == (0.0, 3.0)
    assert (found["events_timeline"], found["events_timeline_all"]) == (1.0, 2.0)
    assert found["outage_1_drift_h_m"] is None  # it began before the window
    assert found["outage_1_drift_h_m_all"] is not None
    assert found["outage_2_drift_h_m"] == found["outage_2_drift_h_m_all"]
    assert "updates_unused" not in found


def test_a_run_that_ends_before_the_window_has_only_metrics_of_the_whole(truth):
    found = metrics_of(truth, wrong_solution(truth, pos_n=[3.0, 4.0, 0.0]), begin=60.0)
    assert found["converged"] is True
    assert found["pos_rmse_h_m"] is None
    assert found["pos_rmse_h_m_all"] == pytest.approx(5.0, abs=1e-7)


# --- outages ------------------------------------------------------------------------------------------


def test_drift_and_growth_of_an_outage_stand_at_the_first_and_last_instant_of_its_half_open_interval(truth):
    """[12, 15): the epoch at 15.0 s already has a fix again and does not count; that at 12.0 s does."""
    pos_n = np.full((201, 3), 50.0)
    pos_n[120] = [3.0, 4.0, 0.0]
    pos_n[149] = [15.0, 20.0, 7.0]
    solution = wrong_solution(truth, pos_n=pos_n)
    found = metrics_of(truth, solution, 0.0, ((12.0, 15.0),))
    assert found["outage_1_drift_h_m"] == pytest.approx(25.0, abs=1e-7)
    assert found["outage_1_growth_h_m"] == pytest.approx(20.0, abs=1e-7)


@pytest.mark.parametrize("rounding", [-1e-12, 0.0, 1e-12])
def test_rounding_of_start_plus_duration_moves_no_epoch(truth, rounding):
    pos_n = np.zeros((201, 3))
    pos_n[:, 0] = np.arange(201)
    found = metrics_of(
        truth, wrong_solution(truth, pos_n=pos_n), 0.0, ((0.3 + rounding, 0.3 + 0.6 + rounding),)
    )
    assert found["outage_1_drift_h_m"] == pytest.approx(8.0, abs=1e-6)
    assert found["outage_1_growth_h_m"] == pytest.approx(5.0, abs=1e-6)


def test_growth_is_the_length_of_a_vector_not_a_difference_of_lengths(truth):
    pos_n = np.zeros((201, 3))
    pos_n[50:90, 0] = np.linspace(5.0, -5.0, 40)
    found = metrics_of(truth, wrong_solution(truth, pos_n=pos_n), 0.0, ((5.0, 9.0),))
    assert found["outage_1_growth_h_m"] == pytest.approx(10.0, abs=1e-6)
    assert found["outage_1_drift_h_m"] == pytest.approx(5.0, abs=1e-6)


def test_an_outage_after_the_end_of_the_run_has_no_drift(truth):
    found = metrics_of(truth, wrong_solution(truth), 0.0, ((5.0, 6.0), (30.0, 40.0)))
    assert "outage_1_drift_h_m" in found
    assert "outage_2_drift_h_m" not in found


# --- heading convergence ------------------------------------------------------------------------------


def heading_case(truth, error_deg, sd_deg=0.01):
    """A level flight, so that phi_d is the heading error and its variance that of the heading."""
    truth = replace(truth, q_nb=np.tile([1.0, 0.0, 0.0, 0.0], (len(truth), 1)))
    phi_n = np.zeros((201, 3))
    phi_n[:, 2] = np.deg2rad(error_deg)
    cov = COV.copy()
    cov[8, 8] = np.deg2rad(sd_deg) ** 2
    return truth, wrong_solution(truth, phi_n=phi_n, cov=cov)


def settles(k, before=5.0, after=0.5):
    error = np.full(201, after)
    error[:k] = before
    return error


LEAVES_AGAIN = np.where(np.arange(201) < 150, settles(30), -1.5)


@pytest.mark.parametrize(
    ("error_deg", "sd_deg", "outages", "expected"),
    [
        (settles(0), 0.01, (), 0.0),
        (settles(77), 0.01, (), 7.7),
        (-settles(77), 0.01, (), 7.7),
        (settles(77, after=1.5), 0.01, (), None),  # above 1 deg to the end
        (settles(77, after=1.5), 0.6, (), 7.7),  # below 3 sigma = 1.8 deg
        (settles(77, before=1.5), 0.6, (), 0.0),
        (LEAVES_AGAIN, 0.01, (), None),
        (LEAVES_AGAIN, 0.01, ((15.0, 18.0),), 3.0),  # it stayed to the outage
        (LEAVES_AGAIN, 0.01, ((14.0, 18.0),), 3.0),
        (LEAVES_AGAIN, 0.01, ((15.1, 18.0),), None),  # it left one epoch before the outage
        (settles(130), 0.01, ((5.0, 9.0),), 13.0),
        (settles(70), 0.01, ((5.0, 9.0), (12.0, 13.0)), 7.0),  # inside an outage: to the next one
        (settles(200), 0.01, (), 20.0),
        (settles(0), 0.01, ((0.0, 2.0),), 0.0),
    ],
)
def test_heading_converges_at_the_first_instant_after_which_it_stays_in(
    truth, error_deg, sd_deg, outages, expected
):
    truth, solution = heading_case(truth, error_deg, sd_deg)
    found = metrics_of(truth, solution, 0.0, outages)["heading_convergence_s"]
    assert found == (None if expected is None else pytest.approx(expected))


def test_heading_convergence_counts_from_the_start_of_the_run(truth):
    truth, solution = heading_case(truth, settles(77))
    found = metrics_of(truth, solution, 6.0)
    assert found["heading_convergence_s"] == pytest.approx(7.7)
    found = metrics_of(truth, solution, 9.0)
    assert found["heading_convergence_s"] == pytest.approx(9.0)
    assert found["heading_convergence_s_all"] == pytest.approx(7.7)


# --- consistency --------------------------------------------------------------------------------------


def test_nees_metrics(truth):
    pos_n = np.zeros((201, 3))
    pos_n[:100, 0] = 8.0  # NEES 64 / 4 = 16, inside 2.70 .. 19.02
    pos_n[100:, 0] = 12.0  # NEES 36, outside
    found = metrics_of(truth, wrong_solution(truth, pos_n=pos_n))
    assert found["nees_mean"] == pytest.approx((100 * 16 + 101 * 36) / 201, rel=1e-6)
    assert found["nees_states"] == 9.0
    assert found["nees_inside_95"] == pytest.approx(100 / 201)
    assert metrics_of(truth, wrong_solution(truth))["nees_inside_95"] == 0.0  # too small is outside too


@pytest.mark.parametrize(
    ("blocks", "states", "low", "high"),
    [((), 9, 5.0, 8.0), (("phi",), 6, 3.0, 7.0), (("vel", "phi"), 3, 1.4, 5.0)],
)
def test_nees_is_held_against_the_states_that_are_estimated(truth, blocks, states, low, high):
    """Errors north of 0.8 to 9 m with 2 m sd: NEES of 0.16, 0.49, 2.25, 6.25, 12.25, 16 and 20.25.

    The 2.5 and 97.5 % points are 0.22 and 9.35 for three states, 1.24 and 14.45 for six, 2.70 and 19.02 for
    nine.
    """
    north = np.resize([0.8, 1.4, 3.0, 5.0, 7.0, 8.0, 9.0], 201)
    solution = without(wrong_solution(truth, pos_n=np.outer(north, [1.0, 0.0, 0.0])), *blocks)
    found = metrics_of(truth, solution)
    assert found["nees_states"] == states
    assert found["nees_inside_95"] == pytest.approx(np.mean((low <= north) & (north <= high)))


def test_coverage_is_the_fraction_of_epochs_within_3_sigma_by_axis(truth):
    pos_n, vel_n, phi_n = np.zeros((3, 201, 3))
    pos_n[:20, 0] = 6.01  # sd 2
    pos_n[20:, 0] = -5.99
    vel_n[:50, 2] = -0.91  # sd 0.3
    phi_n[:100, 1] = 0.0301  # sd 0.01
    found = metrics_of(truth, wrong_solution(truth, pos_n=pos_n, vel_n=vel_n, phi_n=phi_n))
    expected = {"pos_n": 181 / 201, "vel_d": 151 / 201, "phi_e": 101 / 201}
    for block in ("pos", "vel", "phi"):
        for axis in "ned":
            name = f"{block}_{axis}"
            assert found[f"coverage_3sigma_{name}"] == pytest.approx(expected.get(name, 1.0)), name


def test_blocks_and_axes_have_their_nees_their_score_and_their_coverage(truth):
    """Errors of 2 and 0.5 sigma north with a correlation of 0.6 to the east, which only the block sees."""
    P = COV.copy()
    P[0, 1] = P[1, 0] = 0.6 * 4.0
    pos_n = np.zeros((201, 3))
    pos_n[:50, 0], pos_n[50:, 0] = 4.0 * 1.001, 1.0
    found = metrics_of(truth, wrong_solution(truth, pos_n=pos_n, cov=P))
    axis = (50 * (2.0 * 1.001) ** 2 + 151 * 0.25) / 201
    assert found["nees_ratio_pos_n"] == pytest.approx(axis, rel=1e-5)
    assert found["nees_ratio_pos"] == pytest.approx(axis / (1.0 - 0.6**2) / 3.0, rel=1e-5)
    assert found["nees_ratio_vel"] == pytest.approx(0.0, abs=1e-9)
    score = 0.5 * (axis / 0.64 + np.log(np.linalg.det(P[:3, :3])))
    assert found["log_score_pos"] == pytest.approx(score, rel=1e-5)
    assert found["log_score_phi"] == pytest.approx(0.5 * np.log(np.linalg.det(P[6:, 6:])), rel=1e-6)
    assert (found["coverage_1sigma_pos_n"], found["coverage_2sigma_pos_n"]) == pytest.approx([151 / 201] * 2)
    assert found["coverage_3sigma_pos_n"] == found["coverage_1sigma_pos_e"] == 1.0


def test_blocks_without_a_covariance_have_no_nees(truth):
    found = metrics_of(truth, without(wrong_solution(truth), "vel"))
    for start in ("nees_ratio", "log_score", "coverage_2sigma"):
        assert f"{start}_pos{'_n' * start.startswith('cov')}" in found
        assert not [name for name in found if name.startswith(f"{start}_vel")]
    indefinite = COV.copy()
    indefinite[0, 1] = indefinite[1, 0] = 5.0
    lost = metrics_of(truth, wrong_solution(truth, cov=indefinite))
    assert lost["nees_ratio_pos"] is lost["log_score_pos"] is None
    assert lost["nees_ratio_vel"] is not None


def test_nis_metrics_count_a_sub_vector_once_and_keep_refused_updates(truth):
    found = metrics_of(truth, wrong_solution(truth, innovations=some_innovations()))
    assert found["nis_mean_gnss_position"] == pytest.approx(10.0)  # mean of 1..19
    assert found["nis_low_gnss_position"] == pytest.approx(chi2_quantile(0.0005, 57) / 19)
    assert found["nis_high_gnss_position"] == pytest.approx(chi2_quantile(0.9995, 57) / 19)
    assert found["nis_mean_baro"] == pytest.approx(0.5)
    assert found["nis_low_baro"] == pytest.approx(chi2_quantile(0.0005, 19) / 19)
    assert found["rejected_gnss_position"] == 1.0


# --- which metrics there are ---------------------------------------------------------------------------


def full_run(truth):
    events = Events(np.array([1.0]), np.array([1.0]), ("timeline",), ("2 rows left out",), ("imu",))
    return wrong_solution(truth, pos_n=random_errors(1, 2.0), innovations=some_innovations(), events=events)


def fully_judged(truth, faults=()):
    """Every metric there is: a run with biases, and one without aiding for its drift."""
    solution, names = full_run(truth), ("gyro_bias_x_rad_s", "accel_bias_x_m_s2")
    biased = replace(solution, extra_names=names, extra=np.zeros((201, 2)), extra_sd=np.ones((201, 2)))
    ends = np.array([0.0, 20.0])
    drawn = SensorTruth(ends, np.full((2, 3), 1e-4), np.full((2, 3), 1e-2))
    settings = {"evaluation": EvaluationWindow(3.0), "outages": OUTAGES, "faults": faults, "drawn": drawn}
    settings["assumed"] = AssumedSpecs(imu=units().imu, gnss=None)
    far = np.diag([1e6, 1e6, *np.diag(COV)[2:]])
    alone = replace(biased, innovations=no_innovations(), cov=np.tile(far, (201, 1, 1)))
    return measure(truth, alone, **settings)[1] | measure(truth, biased, **settings)[1]


def test_every_row_of_the_table_gives_plain_numbers_under_its_name(truth):
    fault = Fault("spoofing", "gnss", 4.0, 6.0, "spoofing")
    found = fully_judged(truth, [fault])
    assert found.pop("converged") is True
    assert found.pop("reason") is None
    rows = {find_metric(name) for name in found}
    of_paths = {one for one in METRICS if one.name.startswith(("tse_", "fte_", "nse_"))}  # of other flights
    assert rows == set(METRICS) - of_paths
    assert all(type(value) is float for value in found.values() if value is not None)
    assert all((name + "_all") in found for name in found if not name.endswith("_all"))
    json.dumps(found, allow_nan=False)


def test_the_name_of_a_metric_ends_in_its_unit():
    for metric in METRICS:
        assert unit_of(metric.name) == metric.unit.removesuffix("1"), metric.name


def test_a_name_without_a_row_has_no_metric():
    assert find_metric("pos_rmse__m") is None
    assert find_metric("converged") is None


def test_metrics_of_a_block_that_is_not_estimated_are_absent(truth):
    found = metrics_of(truth, without(full_run(truth), "phi"), 3.0, OUTAGES)
    assert found["converged"] is True
    assert not [name for name in found if "phi" in name or "heading" in name or "tilt" in name]
    assert found["nees_states"] == 6.0
    assert found["pos_rmse_h_m"] > 0
    found = metrics_of(truth, without(full_run(truth), "pos", "vel"), 3.0, OUTAGES)
    assert not [n for n in found if n.startswith(("pos", "vel", "outage", "cep", "r95", "coverage_3sigma_v"))]
    assert found["heading_rmse_deg"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e200])
def test_a_run_that_did_not_converge_says_why_and_keeps_what_is_finite(truth, value):
    solution = full_run(truth)
    lla = solution.lla.copy()
    lla[150:, 0] = value
    found = metrics_of(truth, replace(solution, lla=lla), 3.0, OUTAGES)
    assert found["converged"] is False
    assert found["reason"].endswith("epochs)") or "more than 10 sigma" in found["reason"]
    sound = metrics_of(truth, solution, 3.0, OUTAGES)
    for name in ("vel_rmse_3d_mps", "heading_rmse_deg", "coverage_3sigma_phi_d", "nis_mean_baro"):
        assert found[name] == pytest.approx(sound[name])
    json.dumps(found, allow_nan=False)


def test_a_dead_reckoner_that_claims_5_m_keeps_its_table(truth):
    """12 km off with 5 m reported is a verdict beside the figures, which are those without a covariance."""
    claimed = wrong_solution(truth, pos_n=[12e3, 0.0, 0.0], cov=np.diag([25.0, 25.0, 25.0, *[1.0] * 6]))
    found = metrics_of(truth, claimed)
    assert found["converged"] is False
    assert found["pos_rmse_h_m"] == pytest.approx(12e3, rel=1e-3)
    assert found["pos_sigma_h_m"] == pytest.approx(math.sqrt(50.0))
    silent = metrics_of(truth, replace(claimed, cov=np.full_like(claimed.cov, np.nan)))
    assert silent["converged"] is False
    assert silent["pos_rmse_h_m"] == found["pos_rmse_h_m"]


def test_a_covariance_that_is_not_positive_definite_is_reported(truth):
    solution = full_run(truth)
    cov = solution.cov.copy()
    cov[-1, 0, 0] = -1.0
    found = metrics_of(truth, replace(solution, cov=cov))
    assert found["converged"] is False
    assert found["reason"] == "covariance is not positive definite at t = 20 s (1 of 201 epochs)"
    assert found["pos_rmse_h_m"] > 0
    assert found["nees_mean"] is None


def test_an_empty_solution_is_an_error(truth):
    solution = wrong_solution(truth)
    columns = ("t", "lla", "vel_n", "q_nb", "gyro_bias_b", "accel_bias_b", "cov", "extra", "extra_sd")
    empty = replace(solution, **{name: getattr(solution, name)[:0] for name in columns})
    with pytest.raises(ValueError, match=r"NavSolution\.t must hold at least one time"):
        metrics_of(truth, empty)


def test_a_refusal_lasts_from_its_first_to_its_last_instant(monkeypatch):
    monkeypatch.setattr(run_metrics.detection, "find_refusals", lambda case: {"baro": (30.0, 42.5)})
    assert run_metrics.refused(None) == {"baro": 12.5}


def test_a_metric_that_raises_has_no_value_and_says_why(truth, monkeypatch):
    def fail(case):
        raise np.linalg.LinAlgError("SVD did not converge")

    solution = wrong_solution(truth)
    sound = metrics_of(truth, solution)
    rows = [row._replace(function=fail) if row.name == "ape_aligned_rmse_m" else row for row in METRICS]
    monkeypatch.setattr(
        run_metrics.judge_epochs,
        "__kwdefaults__",
        {**run_metrics.judge_epochs.__kwdefaults__, "metrics": rows},
    )
    found = metrics_of(truth, solution)
    assert found.pop("no_value") == {"ape_aligned_rmse_m": "LinAlgError: SVD did not converge"}
    assert found == {name: value for name, value in sound.items() if "ape_aligned" not in name}
