"""The covariance of loose-15 describes its errors where its model is the truth: 40 matched runs.

NEES at 1 Hz after the update and NIS of every sensor, by the tests of
`bench.evaluation.ensembles.ensemble_consistency`.
"""

from dataclasses import replace

import numpy as np
import pytest

from bench import pipeline
from bench.io.config import read_profile
from bench.navigation.models.loose_tight import Loose
from tests.builders import ensemble

RUNS = 40
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def profile():
    return read_profile("figure-eight-matched", {"evaluation.output_hz": 1.0})


def claims(profile, truth, assumed, **options):
    """Return the verdict on the three tests over 40 runs."""
    return ensemble(
        Loose(**options),
        truth,
        lambda run: pipeline.sense(profile, truth, run),
        RUNS,
        profile.evaluation.begin,
        assumed,
    ).claims()


def test_the_matched_filter_knows_its_errors(profile, figure_eight_truth):
    result = claims(profile, figure_eight_truth, profile.sensors.assumed)
    assert not result.rejected, result.reasons
    assert set(result.nis) == {"gnss_position", "gnss_velocity", "baro"}


def test_R_a_fifth_too_small_is_found_in_nees_and_in_every_sensor(profile, five_minutes):  # noqa: N802
    assumed, factor = profile.sensors.assumed, np.sqrt(0.8)
    gnss, baro = assumed.gnss, assumed.baro
    small = replace(
        assumed,
        gnss=replace(
            gnss,
            pos_h_white_sd=gnss.pos_h_white_sd * factor,
            pos_v_white_sd=gnss.pos_v_white_sd * factor,
            vel_white_sd=gnss.vel_white_sd * factor,
        ),
        baro=replace(baro, white_sd=baro.white_sd * factor),
    )
    result = claims(profile, five_minutes, small)
    text = " ".join(result.reasons)
    assert "NEES over its expectation is not 1" in text
    for sensor in ("gnss_position", "gnss_velocity", "baro"):
        assert f"mean NIS of {sensor}" in text


def test_both_profiles_fly_the_same_flight(profile):
    """figure-eight-matched differs in its sensors only, so one truth serves both."""
    assert read_profile("figure-eight").flight == profile.flight
