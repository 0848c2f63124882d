"""Random motions: a filter is consistent on them, and each kind moves as its docstring says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.evaluation.errors.error_series import error_series
from bench.navigation import built_in
from bench.simulation import sensors
from tests.builders import band
from tests.motions import trials
from tests.motions.truths import RATE, make_truth

SEED = 60
UNITS = ("adis16495", "hg4930-ca51", "stim300", "vn-100", "icm-42688-p")


@pytest.mark.parametrize("kind", trials.KINDS)
def test_a_kind_is_a_smooth_motion_that_rests_as_it_says(kind):
    for seed in range(3):
        motion = trials.KINDS[kind](np.random.default_rng([seed, 1]))
        truth = make_truth(motion.vel_n, motion.euler)
        assert 60.0 < truth.t[-1] <= 300.0
        np.testing.assert_allclose(truth.vel_n, motion.vel_n, atol=1e-3)
        still = truth.t < motion.rest
        assert not motion.vel_n[still].any(), motion.rest
        np.testing.assert_allclose(truth.q_nb[still], truth.q_nb[:1].repeat(still.sum(), 0), atol=1e-7)
        assert np.linalg.norm(truth.dvel_b, axis=1).max() * RATE < 12 * 9.81
        assert ("level" in motion.starts) == (motion.rest > 10.0)
        if "course" in motion.starts:
            assert np.hypot(*motion.vel_n[truth.t < 20.0, :2].T).min() > 6.0


def test_truths_at_rest_feel_the_turn_of_the_earth_and_gravity_alone():
    truth = make_truth(np.zeros((101, 3)), np.tile([0.1, -0.2, 1.0], (101, 1)))
    np.testing.assert_allclose(np.linalg.norm(truth.dtheta_b, axis=1) * RATE, 7.292115e-5, rtol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(truth.dvel_b, axis=1) * RATE, 9.8055, atol=1e-3)
    np.testing.assert_allclose(truth.lla, np.tile(truth.lla[0], (101, 1)), atol=1e-12)


def test_loose_full_is_consistent_on_motions_that_resemble_no_profile():
    """Errors may last a run, so each of the 32 runs counts as one sample of 9 degrees of freedom."""
    found = [
        one
        for kind in trials.KINDS
        for k in range(2)
        for one in trials.run_trial(kind, k, SEED, ["loose-full"], UNITS)
    ]
    assert not [one for one in found if one.lost]
    mean = np.mean([one.nees for one in found])
    assert mean < 9.0 * band(9 * len(found))[1], sorted((one.nees, one.kind, one.unit) for one in found)[-4:]


@pytest.mark.slow
def test_a_course_in_strong_wind_ends_within_twice_the_error_of_a_known_heading():
    """40 small planes in a wind of 0.4 of their airspeed or more; the alignment assumes 2 deg, as of a log.

    The medians of the last 20 s. The nose is off the course by 17 deg in the median.
    """
    errors, number = {"course": [], "given": []}, 0
    while len(errors["given"]) < 40:
        number += 1
        r = np.random.default_rng([5, number])
        motion = replace(trials.KINDS["small plane in wind"](r), drift_deg=2.0)
        strong = motion.figures["wind_mps"] > 0.4 * motion.figures["airspeed_mps"]
        unit, receiver = r.choice(trials.list_units()), r.choice(trials.RECEIVERS)
        if not strong or "course" not in motion.starts:
            continue
        truth = make_truth(motion.vel_n, motion.euler)
        for start, found in errors.items():
            spec = trials.choose_start(trials.load_sensors(str(unit), str(receiver)), motion, start)
            drawn = sensors.sense(truth, spec, 5, number)
            series = error_series(truth, built_in.load("loose-full", {}).run(drawn.data, drawn.initial))
            last = series.t > series.t[-1] - 20.0
            off = np.linalg.norm(series.pos_n[last, :2], axis=1), np.abs(series.heading[last])
            found.append([np.nan_to_num(np.sqrt(np.mean(one**2)), nan=np.inf) for one in off])
    course, given = (np.median(found, axis=0) for found in errors.values())
    assert (course < 2.0 * given).all()


def trial(kind, unit, number, nees):
    return trials.Trial(
        kind,
        unit,
        "l1-code",
        "given",
        number,
        "loose-full",
        nees,
        dict.fromkeys(trials.BLOCKS, 1.0),
        0,
        0,
        "",
        {},
    )


@pytest.mark.parametrize("planted", [1.0, 4.0])
def test_a_pair_of_motion_and_unit_that_stands_out_is_named_and_no_other(planted):
    """Run averages of 9 states: 20 pairs of ten runs; one of them is four times too large, or none."""
    random = np.random.default_rng(7)
    found = [
        trial(kind, unit, k, random.chisquare(9) * (planted if (kind, unit) == ("tow", "b") else 1.0))
        for kind in trials.KINDS
        for unit in "ab"
        for k in range(10)
    ]
    lines = trials.list_pairs(found)
    assert [line.partition(":")[0] for line in lines] == ["tow, b"] * (planted > 1.0)
    assert len(list(trials.summarize(found))) == 2 + len(trials.KINDS) + len(lines)
    assert len(list(trials.write_table(found))) == 2 + len(trials.KINDS)
