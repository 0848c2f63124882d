"""The study closed-loop: where the aircraft ends, on a short flight and by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import bench
from bench import pipeline
from bench.core.mathematics import earth
from bench.core.words.exceptions import ConfigError
from bench.experiments.studies import flown_by_filters
from bench.experiments.studies.flown_by_filters import FlownByFilter, compare_misses, measure_miss
from bench.io import config
from tests.test_closed_loop import PROFILE


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    begin, end = PROFILE.index('[[leg]]\nkind = "turn"'), PROFILE.index("[sensors]")
    path = tmp_path_factory.mktemp("closed") / "closed.toml"
    path.write_text((PROFILE[:begin] + PROFILE[end:]).replace("from_s = 10.0", "from_s = 5.0"))
    return path


def test_each_filter_flies_the_same_draws_and_is_held_against_the_flight_by_the_truth(path):
    found = bench.study("closed-loop", profiles=str(path), jobs=1, runs=2, estimators="loose-15,loose-22")
    table = found.tables["closed-loop"].columns
    assert table["filter"] == ["loose-15", "loose-22"]
    assert table["crashed"] == [0, 0]
    profile = config.read_profile(path, {"guidance.navigation": "loose-22"})
    misses = []
    for run in range(2):
        by_filter, by_truth = (
            pipeline.fly(one, run=run).lla[-1] for one in (profile, replace(profile, guidance=None))
        )
        misses.append(np.hypot(*earth.local_ned(by_filter, by_truth)[:2]))
    assert table["miss_max_m"][1] == pytest.approx(max(misses), rel=1e-4)
    assert 0.01 < max(misses) < 30.0
    assert list(found.tables) == ["closed-loop"]  # a straight leg has no path
    assert table["miss_is"] == ["the first", "undecided"]  # two runs
    assert "half of 2 flights miss by less than" in found.verdicts[0]


def test_the_miss_of_a_landing_is_that_of_its_touch_down():
    profile = config.read_profile("approach-closed")
    truth = pipeline.fly(replace(profile, guidance=None))
    flare = truth.events.select("leg")[3]
    down = int(np.searchsorted(truth.t, flare[1] - 1e-6))
    lla = truth.lla.copy()
    lla[down] = earth.displace(truth.lla[down], np.array([30.0, -40.0, 0.0]))
    lla[-1] = earth.displace(truth.lla[-1], np.array([900.0, 0.0, 0.0]))
    assert_allclose(measure_miss(profile, replace(truth, lla=lla), truth), 50.0, atol=1e-3)


def test_misses_of_the_same_draws_are_compared_by_the_median_of_their_ratio():
    first = np.linspace(10.0, 20.0, 12)
    word, ratio = compare_misses(0.5 * first, first)
    assert (word, ratio.value) == ("better", 0.5)
    assert compare_misses(2.0 * first, first)[0] == "worse"
    assert compare_misses(first[::-1], first)[0] == "undecided"
    crashed = np.full(12, np.inf)
    assert compare_misses(crashed, first)[0] == "worse"
    assert compare_misses(crashed, crashed)[1].value == 1.0


def test_a_crash_has_no_miss_and_is_counted(path, monkeypatch):
    fly = flown_by_filters.fly_draw
    monkeypatch.setattr(
        flown_by_filters,
        "fly_draw",
        lambda task: replace(fly(task), miss=np.inf, crashed=True) if task.run else fly(task),
    )
    options = flown_by_filters.Options(profiles=str(path), runs=3, estimators="loose-15")

    class Work:
        progress = staticmethod(lambda *args: None)
        map = staticmethod(lambda what, do, items, first=(): [do(one) for one in items])

    found = flown_by_filters.run(options, Work)
    table = found.tables[0].columns
    assert (table["crashed"], table["miss_m"], table["miss_max_m"]) == ([2], [None], [None])
    assert "most of 3 flights crash" in found.verdicts[0]


def test_the_filters_that_fly_are_those_of_the_option(path):
    with pytest.raises(
        ConfigError, match=r"^study closed-loop: --set guidance\.navigation: --estimators sets"
    ):
        bench.study("closed-loop", profiles=str(path), overrides={"guidance.navigation": "loose-22"}, jobs=1)
    whole = {"guidance": {"navigation": "loose-22", "period_s": 0.5}}
    cases = flown_by_filters.load_cases(flown_by_filters.Options(profiles=str(path), overrides=whole))
    assert [use for _, use in cases] == ["loose-15", "loose-full"]
    for (_, use), profile in cases.items():
        assert (profile.guidance.navigation.use, profile.guidance.period) == (use, 0.5)


def test_several_flights_are_asked_in_turn_and_the_units_of_each_are_compared(path):
    other = path.with_name("other.toml")
    other.write_text(path.read_text())
    missed = {"stim300": 2.0, "vn-100": 6.0}

    class Work:
        progress = staticmethod(lambda *args: None)

        @staticmethod
        def map(what, do, items, first=()):
            if do is not flown_by_filters.fly_draw:
                return items
            return [
                FlownByFilter(missed[task.profile.document["sensors"]["imu"]], False, {}) for task in items
            ]

    options = flown_by_filters.Options(
        profiles=f"{path},{other}", runs=2, estimators="loose-15", units="stim300,vn-100"
    )
    found = flown_by_filters.run(options, Work)
    assert [table.name for table in found.tables] == ["closed-loop-closed", "closed-loop-other"]
    for table in found.tables:
        assert table.columns["imu"] == ["stim300", "vn-100"]
        assert table.columns["miss_m"] == [2.0, 6.0]


def test_the_table_the_words_and_the_picture_of_flights_by_hand():
    """Misses of 1, 2, 3 m and twice that; errors across the path of 3 and 4 m squared, and a crash."""
    squares = ({"tse": 9.0, "fte": 1.0, "nse": 4.0}, {"tse": 16.0, "fte": 4.0, "nse": 4.0}, {})
    first = [FlownByFilter(miss, False, one) for miss, one in zip((1.0, 3.0, 2.0), squares, strict=True)]
    second = [FlownByFilter(2.0 * one.miss, False, {}) for one in first]
    third = [replace(second[0], miss=np.inf, crashed=True), *second[1:]]
    flown = {(None, "a"): first, ("stim300", "a"): second, ("stim300", "b"): third}
    table, across = (one.columns for one in flown_by_filters.tabulate_flown(flown))
    assert (table["imu"], table["filter"]) == (["of the profile", "stim300", "stim300"], ["a", "a", "b"])
    assert (table["runs"], table["crashed"]) == ([3, 3, 3], [0, 0, 1])
    assert (table["miss_m"], table["miss_max_m"]) == ([2.0, 4.0, 6.0], [3.0, 6.0, None])
    assert table["miss_is"] == ["the first", "undecided", "undecided"]
    assert (across["imu"], across["filter"]) == (["of the profile"] * 3, ["a"] * 3)
    assert across["error"] == ["TSE", "FTE", "NSE"]
    assert across["rms_m"] == pytest.approx(np.sqrt([12.5, 2.5, 4.0]))
    assert across["low_m"][2] == across["high_m"][2] == pytest.approx(2.0)
    told = list(flown_by_filters.tell_flown(flown))
    assert told == [
        "a: half of 3 flights miss by less than 2 m; total system error 3.54 m rms across its path.",
        "a with stim300: half of 3 flights miss by less than 4 m; against a undecided, 2 times its miss.",
        "b with stim300: half of 3 flights miss by less than 6 m; 1 crashed; against a undecided, 2 times "
        "its miss.",
    ]
    lines = flown_by_filters.plot_misses(flown).series
    assert [one.key for one in lines] == ["a", "a with stim300", "b with stim300"]
    assert_allclose(lines[0].t, [1.0, 2.0, 3.0])
    assert_allclose(lines[0].values[:, 0], [100.0 / 3.0, 200.0 / 3.0, 100.0])
    assert_allclose(lines[2].values[:, 0], [100.0 / 3.0, 200.0 / 3.0])
    assert len({one.colors for one in lines}) == 3


def test_a_profile_that_the_truth_flies_is_refused():
    with pytest.raises(ConfigError, match=r"approach has no \[guidance\]: no filter flies it"):
        bench.study("closed-loop", profiles="approach", jobs=1, runs=2)
