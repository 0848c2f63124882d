"""Why a run is not consistent: what was put there is named, and nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest

import bench
from bench import pipeline
from bench.core.records.sensor_specs import AssumedSpecs, AxisFigures, SampleClockSpec, SensorsSpec, TriadSpec
from bench.core.records.specs import EstimatorChoice, Profile
from bench.evaluation.causes.candidates import SENSOR_ERRORS, SKY_ERRORS, Candidate, list_candidates
from bench.evaluation.causes.search import advise, describe_causes, find_causes
from bench.evaluation.consistency.block_nees import BlockNees
from bench.navigation.error_state_filter.aiding_sensors import AIDING, imu_errors
from bench.simulation import sensors
from tests.causes import planted

LOOSE = EstimatorChoice("loose-15", "loose-15")


@cache
def flight(name: str) -> Profile:
    return bench.read_profile(name, estimators=["loose-15"])


def why(name: str, run: int, use: str = "loose-15", **options: object) -> dict[str, object]:
    """The metrics of a filter in a run of a shipped profile."""
    profile = bench.read_profile(name, estimators=[use], allow_code=True)
    result = pipeline.run(profile, run, truth=pipeline.fly(profile), **{"causes": None, **options})
    (values,) = result.metrics.values()
    return dict(values)


@pytest.mark.parametrize("run", [0, 2, 5])
def test_a_spoofed_run_names_the_spoof(run):
    check_spoofed(run)


@pytest.mark.slow
@pytest.mark.parametrize("run", [1, 3, 4, 6, 7, 8, 9])
def test_every_spoofed_run_names_the_spoof(run):
    check_spoofed(run)


def check_spoofed(run):
    values = why("gnss-faults", run)
    first, *_ = values["causes"]
    assert (first["cause"], first["block"], first["step"]) == ("fault 4 (spoofing)", "position", 1)
    assert [row["cause"] for row in values["causes"] if row["step"] == 1] == ["fault 4 (spoofing)"]
    assert first["nees"] > 1000 > 100 > first["nees_without"]
    assert "Why: fault 4 (spoofing): without it the NEES of the position is" in values["verdict_text"]
    assert "misalignment not modeled" not in values["verdict_text"]


def test_a_fault_that_is_not_to_blame_is_not_blamed():
    """The largest error comes in fault 1, and is there without it."""
    values = why("gnss-jammed", 0)
    assert values["fault_1_max_h_m"] > 0.9 * values["pos_max_h_m"]
    named = [row["cause"] for row in values["causes"]]
    assert not [name for name in named if name.startswith("fault")]
    assert "ionosphere beyond the broadcast model" in named
    assert "loose-full has states for all of them." in values["verdict_text"]


def test_the_filter_that_is_advised_is_honest():
    """No false stop: on the run whose causes were named the filter with states for them is consistent."""
    values = why("figure-eight", 0)
    assert "loose-full has states for all of them." in values["why_text"]
    assert why("figure-eight", 0, "loose-full")["verdict"] == "consistent"
    assert why("figure-eight", 0, "loose-22")["verdict"] == "overconfident"


def test_an_honest_run_is_not_searched_and_a_run_of_others_only_if_asked():
    assert "causes" not in why("figure-eight-matched", 0)
    assert "causes" not in why("gnss-faults", 0, causes=False)
    own = "tests.causes.test_causes:Own"
    assert "causes" not in why("gnss-faults", 0, own)
    assert why("gnss-faults", 0, own, causes=True)["causes"][0]["cause"] == "fault 4 (spoofing)"


class Own:
    """Somebody's filter, which does not say what it leaves out."""

    def run(self, data, initial):
        return bench.navigation.built_in.load("loose-15", {}).run(data, initial)


def test_the_runs_count_as_cpu_of_the_causes():
    profile = flight("gnss-faults")
    result = pipeline.run(profile, truth=pipeline.fly(profile), causes=None)
    assert result.metrics["loose-15"]["causes_runs"] > 4
    spent = result.provenance["cpu_s"]
    assert spent["causes"] > spent["navigate"]
    assert result.provenance["estimator_cpu_s"]["loose-15"] < spent["causes"]


# --- the candidates ---------------------------------------------------------------------------------------


def large(spec: object) -> dict[str, float]:
    return {f.name: 1.0 for f in fields(spec) if f.type == "float" and getattr(spec, f.name) == 0.0}


def everything() -> SensorsSpec:
    """Sensors that have every error there is."""
    units = {"baro": "bmp388-physical", "gnss": "l1-code", "radar": "lr-d1", "odometer": "matched-wheel"}
    spec = bench.read_profile(
        "all-sensors", {f"sensors.{kind}": unit for kind, unit in units.items()}
    ).sensors
    triads = {part: TriadSpec(**large(TriadSpec()), noise_shape="sampled") for part in ("gyro", "accel")}
    shaking = replace(spec.imu.vibration, engine_gyro=1.0)
    imu = replace(
        spec.imu, **triads, vibration=shaking, clock=SampleClockSpec(drift=1e-5), accel_arms=((0.0,) * 3,) * 3
    )
    aiding = {
        part: replace(own, **large(own))
        for part in ("gnss", "baro", "mag", "airspeed", "radar", "odometer")
        if (own := getattr(spec, part)) is not None
    }
    return replace(spec, imu=imu, **aiding)


def test_every_error_that_a_filter_may_leave_out_can_be_taken_away():
    """The words come from the filters; without a candidate for one of them its runs would have no cause."""
    spec = everything()
    sky = bench.read_profile("gnss-jammed").sensors
    words = [error for error, size in imu_errors(spec.imu) if size]
    for sensor in AIDING:
        own = getattr(sky if sensor.record == "observations" else spec, sensor.spec)
        words += [error for error, size in sensor.errors(own) if size] if own is not None else []
    assert len(words) > 40
    found = {one.error for one in [*list_candidates(spec, words), *list_candidates(sky, words)]}
    assert set(words) - found == set()
    assert {*SENSOR_ERRORS, *SKY_ERRORS} <= set(words)


def test_what_is_taken_away_leaves_all_other_noise_and_what_is_assumed():
    profile = bench.read_profile("figure-eight")
    truth = pipeline.fly(profile)
    spec = profile.sensors
    candidates = {one.words: one for one in list_candidates(spec, ["gyro misalignment"])}
    whole = sensors.sense(truth, spec, profile.seed, 3).data
    less = sensors.sense(truth, candidates["gyro misalignment"].remove(spec), profile.seed, 3).data
    assert np.array_equal(whole.imu.dvel_b, less.imu.dvel_b)
    assert np.array_equal(whole.fixes.lla, less.fixes.lla)
    assert np.array_equal(whole.baro.alt_baro, less.baro.alt_baro)
    assert not np.array_equal(whole.imu.dtheta_b, less.imu.dtheta_b)
    assert less.specs == whole.specs
    assert less.specs.imu.gyro.misalignment_sd > 0


def test_a_figure_that_is_assumed_otherwise_is_a_candidate():
    profile = bench.read_profile("figure-eight", {"sensors.assumed.gnss": "zed-f9p"})
    candidates = {one.words: one for one in list_candidates(profile.sensors, ())}
    one = candidates["GNSS position noise other than assumed"]
    assert one.assumed
    assert profile.sensors.gnss.pos_h_white_sd != profile.sensors.assumed.gnss.pos_h_white_sd
    assert one.remove(profile.sensors).gnss.pos_h_white_sd == profile.sensors.assumed.gnss.pos_h_white_sd
    assert list_candidates(flight("figure-eight").sensors, ()) == []


def test_a_fault_is_taken_away_alone():
    spec = flight("gnss-faults").sensors
    faults = [one for one in list_candidates(spec, ()) if one.group == "faults"]
    assert len(faults) == len(spec.faults) > 2
    for k, one in enumerate(faults):
        assert one.words.startswith(f"fault {k + 1} (")
        assert one.remove(spec).faults == spec.faults[:k] + spec.faults[k + 1 :]


def test_a_figure_by_axis_becomes_that_which_is_assumed():
    spec = flight("figure-eight").sensors
    own = AxisFigures("scale_factor_sd", 1e-3, 2e-3, 3e-3)
    kept = AxisFigures("misalignment_sd", 1e-4, 2e-4, 3e-4)
    other = AxisFigures("scale_factor_sd", 4e-3, 5e-3, 6e-3)
    whole = replace(spec.imu.gyro, scale_factor_sd=3e-3, misalignment_sd=3e-4, axes=(own, kept))
    imu = replace(spec.imu, gyro=whole)
    axes = replace(whole, scale_factor_sd=6e-3, axes=(other, kept))
    told = replace(spec.assumed, imu=replace(spec.imu, gyro=axes))
    (one,) = list_candidates(replace(spec, imu=imu, assumed=told), ())
    assert one.words == "gyro scale factor other than assumed"
    assert set(one.remove(replace(spec, imu=imu)).imu.gyro.axes) == {kept, other}
    (left,) = [c for c in list_candidates(replace(spec, imu=imu), ["gyro scale factor"]) if c.error]
    assert left.remove(replace(spec, imu=imu)).imu.gyro.axes == (kept,)


def test_a_receiver_that_claims_too_much_is_a_candidate():
    spec = flight("figure-eight").sensors
    (one,) = list_candidates(replace(spec, gnss=replace(spec.gnss, optimism=2.0)), ())
    assert one.words == "standard deviations of the receiver that are wrong"
    assert one.remove(replace(spec, gnss=replace(spec.gnss, optimism=2.0))) == spec


# --- the search -------------------------------------------------------------------------------------------


def sized(sizes: dict[str, float], groups: str = "") -> tuple[Sequence[Candidate], dict[str, int]]:
    """Candidates that each add to the NEES of the position; the number of runs is counted."""
    return [
        Candidate(name, (groups or name)[0], lambda spec, name=name: spec - {name}, name) for name in sizes
    ], {}


def search(sizes: dict[str, float], groups: str = "", band: float = 5.0):
    """Search where each candidate adds to an NEES of 3."""
    candidates, _ = sized(sizes, groups)

    def measure(spec):
        mean = 3.0 + sum(sizes.get(name, 0.0) for name in spec) + (500.0 if "else" in spec else 0.0)
        return {"pos": BlockNees(3, mean, 1.0, band, 10.0), "vel": BlockNees(3, 3.0, 1.0, 5.0, 10.0)}

    spec = frozenset([*sizes, "else"] if "else" in groups else sizes)
    return find_causes(spec, candidates, measure(spec), measure)


def steps(causes) -> list[list[str]]:
    return [[one.words for one in step.named] for step in causes.steps]


def test_a_cause_takes_a_third_of_the_excess_and_the_rest_is_searched_again():
    assert steps(search({"a": 100.0, "b": 40.0, "c": 1.0})) == [["a"], ["b"]]
    assert steps(search({"a": 100.0, "b": 85.0, "c": 60.0})) == [["a", "b"], ["c"]]
    assert steps(search({"a": 100.0, "b": 70.0})) == [["a"], ["b"]]  # alike is within a fifth of the best
    assert steps(search({"a": 4.0, "b": 4.0, "c": 4.0})) == [
        ["a", "b", "c"]
    ]  # of the excess, not of the mean
    assert steps(search({"a": 100.0, "b": 1.0})) == [["a"]]  # what is left is consistent
    assert search({"a": 1.0, "b": 0.5}) is None


def test_what_no_candidate_takes_is_not_found():
    causes = search({"a": 100.0, "b": 1.0}, groups="else")
    assert (steps(causes), causes.left) == ([], "pos")
    text = describe_causes(causes, "")
    assert text.startswith("not found: no fault and no unmodeled error explains 30 % of the excess")


def test_what_the_others_do_without_is_no_cause():
    """By chance the NEES is small without "b", too; without "a" it does not matter."""

    def measure(spec):
        mean = 103.0 if {"a", "b"} <= spec else 3.0 + ("a" in spec) * 20.0
        return {"pos": BlockNees(3, mean, 1.0, 5.0, 10.0)}

    candidates, _ = sized({"a": 0.0, "b": 0.0})
    spec = frozenset("ab")
    assert steps(find_causes(spec, candidates, measure(spec), measure)) == [["a"]]


def test_many_small_causes_of_a_sensor_are_named_together():
    assert steps(search({"a": 20.0, "b": 20.0, "c": 20.0, "d": 20.0}, groups="g")) == [list("abcd")]


def test_the_least_filter_that_has_states_for_all_is_advised():
    spec = bench.read_profile("figure-eight").sensors
    gyro = replace(spec.imu.gyro, scale_factor_sd=1e-3)
    on_board = AssumedSpecs(imu=replace(spec.imu, gyro=gyro), gnss=spec.gnss, baro=spec.baro)

    def say(*errors: str, choice: EstimatorChoice = LOOSE, sky: bool = False) -> str:
        return advise(choice, on_board, [Candidate(one, "", lambda spec: spec, one) for one in errors], sky)

    assert say("time-correlated GNSS position error") == "loose-22 has states for it."
    assert say("gyro scale factor") == "loose-mems has states for it."
    assert say("time-correlated GNSS position error", "gyro misalignment") == (
        "loose-full has states for all of them."
    )
    assert say() == ""
    shaken = replace(on_board.imu, vibration=replace(on_board.imu.vibration, engine_gyro=1.0))
    on_board = replace(on_board, imu=shaken)
    assert say("vibration") == "No built-in filter has states for vibration."


# --- planted ----------------------------------------------------------------------------------------------


def test_what_was_planted_is_named():
    answers = list(planted.ask_many(8))
    assert [answer for answer in answers if not answer.good] == []
    assert {len(answer.large) for answer in answers} == {1, 2}


def test_nothing_is_named_where_nothing_was_planted():
    assert [planted.ask((), 100_000 + run).named for run in range(4)] == [frozenset()] * 4


@pytest.mark.long
def test_240_runs_name_what_was_planted():
    answers = list(planted.ask_many(240))
    assert sum(answer.good for answer in answers) >= 0.95 * 240


@pytest.mark.long
def test_200_honest_runs_name_nothing():
    assert sum(bool(planted.ask((), 100_000 + run).named) for run in range(200)) == 0
