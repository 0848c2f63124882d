"""The options of the built-in estimators are declared once; a wrong one stops a profile before the flight."""

import io

import pytest
from rich.console import Console

from bench.config import load_profile
from bench.errors import ConfigError
from bench.navigation.built_in import BUILT_IN, load
from bench.navigation.options import described
from bench.workbench import show


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
        load_profile("figure-eight", {"estimator": rows, "seed": -1})
    seed, fixed, gate, points = caught.value.messages
    assert seed.startswith("figure-eight.toml: seed = -1")
    place = "figure-eight.toml: [[estimator]]"
    assert fixed == f"{place} 1 (loose-15): options: option 'gnss_markov' is fixed to false; leave it out"
    assert gate == f"{place} 1 (loose-15): options: gate_probability = 2 must be between 0 and 1"
    assert points.startswith(f"{place} 2 (points): options: unknown option 'spred'. Did you mean 'spread'?")


def test_the_list_of_estimators_shows_their_options():
    out = io.StringIO()
    show.print_catalog(Console(file=out, width=150), "estimators")
    text = out.getvalue()
    assert "Options of loose-15, loose-22, loose-mems, loose-full, baro-inertial, free-inertial" in text
    assert "Options of smoother: those of loose-15, and" in text
    assert text.count(" magnetometer  ") == 2  # of the compiled filters, and of ukf
    assert "Rate of the covariance step [Hz]" in text
