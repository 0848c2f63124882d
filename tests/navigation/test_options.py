"""The options of the built-in filters are declared once; a wrong one stops a profile before the flight."""

import io
import re

import pytest
from rich.console import Console

from bench.cli.verbs import show
from bench.core.words.exceptions import ConfigError
from bench.io.config import read_profile
from bench.navigation.built_in import BUILT_IN, load
from bench.navigation.options import (
    ClassicOptions,
    FusionOptions,
    SmootherOptions,
    TightOptions,
    described,
)


@pytest.mark.parametrize("name", BUILT_IN)
def test_every_option_has_words_and_a_default_that_is_right(name):
    row = BUILT_IN[name]
    for option, _, words in described(row.options):
        assert words.endswith("."), option
        default = row.options.model_fields[option].default
        assert option in row.fixed or not row.wrong({option: default}), option
    load(name, {})


def test_all_mistakes_of_a_file_are_told_at_once():
    """The wrong seed is of the file's own check, which comes first."""
    rows = [
        {"use": "loose-15", "options": {"gate_probability": 2, "gnss_markov": True}},
        {"use": "ukf", "label": "points", "options": {"spred": 0.5}},
        {"use": "my_lab:Huber", "options": {"spred": 0.5}},
    ]
    with pytest.raises(ConfigError) as caught:
        read_profile("figure-eight", {"estimator": rows, "seed": -1})
    seed, fixed, gate, points = caught.value.messages
    assert seed.startswith("figure-eight.toml: seed = -1")
    place = "figure-eight.toml: [[estimator]]"
    assert fixed == f"{place} 1 (loose-15): options: option 'gnss_markov' is fixed to false; leave it out"
    assert gate == f"{place} 1 (loose-15): options: gate_probability = 2 must be between 0 and 1"
    assert points.startswith(f"{place} 2 (points): options: unknown option 'spred'. Did you mean 'spread'?")


VELOCITY = "integrity = 'velocity' needs fixes: it compares their positions with velocities"
OFFSET = "time_offset_sd = 0.5 needs fixes: the offset is of their clock"
PERIOD = "must be 0 or more, or 'auto'"


@pytest.mark.parametrize(
    ("model", "given", "told"),
    [
        (
            FusionOptions,
            {"mems": True, "every_error": True},
            "mems = true and every_error = true: the second holds the states of the first",
        ),
        (
            FusionOptions,
            {"nonholonomic": True, "coordinated": True},
            "nonholonomic = true and coordinated = true: a vehicle has wheels on the road or flies",
        ),
        (FusionOptions, {"integrity": ["velocity"], "gnss": False}, VELOCITY),
        (TightOptions, {"integrity": ["velocity"]}, VELOCITY),
        (
            FusionOptions,
            {"gnss_markov": True, "gnss": False},
            "gnss_markov = true needs gnss = true: the states are errors of its fixes",
        ),
        (TightOptions, {"gnss_markov": True}, "gnss_markov = true needs fixes: tight coupling uses none"),
        (FusionOptions, {"time_offset_sd": 0.5, "gnss": False}, OFFSET),
        (TightOptions, {"time_offset_sd": 0.5}, OFFSET),
        (
            FusionOptions,
            {"lever_arm_sd": 0.5, "gnss": False},
            "lever_arm_sd = 0.5 needs gnss = true: only its antenna has an arm",
        ),
        (SmootherOptions, {"over": "tight", "time_offset_sd": 0.5}, OFFSET),
        (
            SmootherOptions,
            {"over": "loose-15", "gnss_markov": True},
            "option 'gnss_markov' is false in over = 'loose-15'; leave it out",
        ),
        (
            ClassicOptions,
            {"integrity": ["velocity"]},
            "integrity = 'velocity' is a test of the compiled filters",
        ),
        (
            ClassicOptions,
            {"form": "ud", "rows": 8},
            "form = 'ud' needs rows = 7: the noise of eight rows is not independent",
        ),
        (
            ClassicOptions,
            {"feedback": False, "correction_period": 5.0},
            "correction_period needs feedback = true: without it there is no correction",
        ),
        (
            ClassicOptions,
            {"outage": "line"},
            "outage = 'line' needs feedback = false: what is fed back is no curve",
        ),
        (ClassicOptions, {"correction_period": True}, f"correction_period = true {PERIOD}"),
        (ClassicOptions, {"correction_period": float("inf")}, f"correction_period = inf {PERIOD}"),
    ],
)
def test_options_that_do_not_go_together_are_told(model, given, told):
    assert model.list_wrong(given, {}) == [told]


@pytest.mark.parametrize(
    ("model", "given"),
    [
        *((FusionOptions, {"gnss": gnss}) for gnss in (True, False)),
        *((FusionOptions, {name: True}) for name in ("mems", "every_error", "nonholonomic", "coordinated")),
        (FusionOptions, {"integrity": ["velocity"], "gnss_markov": True, "time_offset_sd": 0.5}),
        (TightOptions, {"lever_arm_sd": 0.5}),
        (SmootherOptions, {"over": "loose-15", "gnss_markov": False}),
        (ClassicOptions, {"form": "conventional", "rows": 8}),
        (ClassicOptions, {"form": "ud", "correction_period": "auto"}),
        (ClassicOptions, {"feedback": False, "outage": "line"}),
    ],
)
def test_each_of_them_alone_is_right(model, given):
    assert model.list_wrong(given, {}) == []


def test_the_smoother_has_the_states_of_its_forward_filter():
    """What makes the filter it runs over, and no more: every error only where that has it."""
    for over, states in {
        "loose-15": {"gnss_markov": False, "mems": False, "every_error": False},
        "loose-22": {"gnss_markov": True, "mems": False, "every_error": False},
        "loose-mems": {"gnss_markov": True, "mems": True, "every_error": False},
        "loose-full": {"gnss_markov": True, "mems": False, "every_error": True},
        "tight": {"gnss_markov": False, "mems": False, "every_error": True},
    }.items():
        options = SmootherOptions(over=over)
        assert {name: getattr(options, name) for name in states} == states
        assert options.tight == (over == "tight")


def test_the_list_of_estimators_shows_their_options():
    out = io.StringIO()
    show.print_catalog(Console(file=out, width=150), "estimators")
    text = out.getvalue()
    assert "Options of loose-15, loose-22, loose-mems, loose-full, baro-inertial, free-inertial" in text
    assert "Options of smoother: those of loose-15, and" in text
    assert text.count("magnetometer  ") == 3  # of the compiled filters, of ukf and of ahrs
    assert re.search(r"covariance_hz +20 +Rate of the covariance step \[Hz\]", text)
    assert re.search(r"adaptive_noise +- +Number of innovations", text)
