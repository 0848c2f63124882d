"""loose-full is as consistent as a twin of it whose sensors have no error but those it models exactly.

The tables of the guide come from ``python -m tests.navigation.honesty``.
"""

from dataclasses import replace

import pytest

import bench
from bench.navigation.built_in import load
from tests.builders import Z
from tests.navigation import honesty

OTHER = ("bandwidth", "rounding", "vibration", "distance", "dead zone", "multipath", "GNSS at all")
"""Words of errors that loose-full has no state or noise for."""


@pytest.mark.parametrize("unit", honesty.list_names("catalog/imu"))
def test_every_error_of_a_unit_is_modeled_or_named_and_the_twin_has_none_else(unit):
    profile = bench.read_profile("figure-eight", {"sensors.imu": unit})
    full = load("loose-full", {})
    left = full.unmodeled_errors(profile.sensors.assumed)
    assert all(any(part in words for part in OTHER) for words in left), left
    twin = honesty.without_unmodeled(profile.sensors)
    assert full.unmodeled_errors(twin.assumed) == ()
    for triad in ("gyro", "accel"):  # the runs that both have are of equal size
        own, others = (getattr(sensors.imu, triad) for sensors in (profile.sensors, twin))
        assert own.turn_on_bias_sd == others.turn_on_bias_sd
        assert own.misalignment_sd == others.misalignment_sd
        assert own.random_walk == others.random_walk


def test_a_row_holds_the_filter_and_its_twin_on_the_same_draws(figure_eight_truth):
    """Where no error is unmodeled, filter and twin are one; a receiver assumed too good shows at once."""
    profile = replace(bench.read_profile("figure-eight-matched", {"evaluation.output_hz": 1.0}), seed=5)
    uses = [("loose-full", {})]
    plain = replace(profile, sensors=honesty.without_unmodeled(profile.sensors))
    truth = figure_eight_truth
    own, twin = (honesty.judge_draws(p, truth, "matched-mems", uses, range(2))[0] for p in (profile, plain))
    row = own.row(twin)
    assert (row["ratio"], row["ratio_error"], row["failed"]) == (1.0, 0.0, 0)
    gnss = profile.sensors.assumed.gnss
    small = {name: 0.2 * getattr(gnss, name) for name in ("pos_h_white_sd", "pos_v_white_sd", "vel_white_sd")}
    bad = replace(profile.sensors.assumed, gnss=replace(gnss, **small))
    fooled = replace(profile, sensors=replace(profile.sensors, assumed=bad))
    assert honesty.judge_draws(fooled, truth, "matched-mems", uses, range(2))[0].mean > 3.0 * own.mean


@pytest.mark.parametrize(
    ("ratio", "error", "word"),
    [(1.02, 0.01, "within"), (0.91, 0.01, "undecided"), (1.2, 0.2, "undecided"), (1.14, 0.01, "outside")],
)
def test_the_word_of_a_ratio_follows_its_interval(ratio, error, word):
    """95 % of 150 runs is shown, 1.98 standard errors; the word follows from 99 %, 2.61."""
    half, found = honesty.judge_ratio({"draws": 150, "ratio": ratio, "ratio_error": error})
    assert (round(half / error, 2), found) == (1.98, word)


@pytest.mark.long
@pytest.mark.parametrize("name", honesty.list_names("profiles"))
def test_loose_full_is_as_honest_as_its_twin_on_every_profile(name):
    """150 runs; the ratio of the mean NEES is within 10 %, as far as its 99.9 % interval tells."""
    (row,) = honesty.measure([name], ["own"], ["loose-full"], 150, honesty.SEED, twin=True)
    assert row["failed"] == 0
    assert abs(row["ratio"] - 1.0) < 0.10 + Z * row["ratio_error"]
