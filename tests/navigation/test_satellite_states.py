"""What wanders in the ranges has states: consistent, and a state goes on to the satellite that rises."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.core.records.sensor_specs import Fault
from bench.evaluation.errors.error_series import error_series
from bench.navigation.built_in import load
from bench.navigation.error_state_filter.ranges import satellite_states
from bench.navigation.error_state_filter.ranges.range_states import RANGES
from bench.navigation.error_state_filter.ranges.satellite_states import Channels
from bench.navigation.models.loose_tight import Passage, Tight
from bench.simulation import sensors
from tests.builders import band, ensemble
from tests.navigation.test_tight import SKY, shifted, taken
from tests.weaving import units, weaving

SKY_ERRORS = {
    "gps_space_sd": 3.0, "glonass_space_sd": 4.0, "space_correlation": 3600.0, "ionosphere_sd": 0.0,
    "ionosphere_share": 0.0, "troposphere_sd": 0.3, "troposphere_correlation": 3600.0,
    "multipath_zenith_sd": 0.0, "multipath_horizon_sd": 0.0, "clock_g": 0.0, "clock_h_m1": 0.0,
}  # fmt: skip
WANDERING = replace(SKY, sky=replace(SKY.sky, **SKY_ERRORS))
UNITS = replace(units(gnss=WANDERING), output_rate=1.0)
CHANGE, GONE = 60.0, 20.0


@pytest.mark.slow
def test_ranges_that_wander_are_known_to_their_covariance():
    """Errors of minutes and meters in 40 runs: all three tests pass. As white, they are not."""
    truth = weaving(300.0)
    brief = {"space_correlation": 75.0, "troposphere_correlation": 75.0}  # drawn anew at each epoch
    sky = replace(WANDERING.sky, **brief)
    spec = replace(units(gnss=replace(WANDERING, sky=sky)), output_rate=1.0)
    found = ensemble(load("tight", {}), truth, lambda run: sensors.sense(truth, spec, 5, run), 40, 60.0)
    result = found.claims()
    assert not result.rejected, result.reasons
    unknown = replace(WANDERING, sky=replace(sky, gps_space_sd=0.0, glonass_space_sd=0.0))
    blind = replace(spec, assumed=replace(spec.assumed, gnss=unknown))
    white = ensemble(load("tight", {}), truth, lambda run: sensors.sense(truth, blind, 5, run), 10, 60.0)
    assert white.averages().mean() > 9 * band(90)[1]


# --- which satellite has which state --------------------------------------------------------------------


@pytest.fixture
def few(monkeypatch):
    """Five states for each constellation, and a sky of which half is seen, then the other half."""
    monkeypatch.setattr(satellite_states, "PLACES", np.array([[0, 5], [16, 21], [28, 33], [40, 45]]))
    monkeypatch.setattr(satellite_states, "GONE", GONE)
    truth = weaving(CHANGE + GONE + 60.0)

    def sense(run, spec=UNITS):
        drawn = sensors.sense(truth, spec, 9, run)
        o = drawn.data.observations
        seen = taken(o, (o.sat % 2 == 0) == (o.t < CHANGE))
        return replace(drawn, data=replace(drawn.data, observations=seen))

    return truth, sense


def test_a_state_goes_to_the_satellite_that_has_none_once_another_is_gone(few):
    _, sense = few
    o, channels = sense(0).data.observations, Channels()
    rows = np.arange(len(o.t))
    own, fresh = channels.give_states(o, rows)
    for system in (0, 1):
        late = (o.t >= CHANGE) & (o.system == system)
        before = np.unique(o.sat[(o.system == system) & ~late])
        assert 3 <= len(before) <= 5
        assert (own[(o.system == system) & ~late] >= 0).all()
        assert (own[late & (o.t < CHANGE + GONE - 1.5)] >= 0).sum() < late.sum() / 2  # those that were free
        for t in (CHANGE - 1.0, CHANGE + GONE + 1.0):  # each state has one satellite
            now = own[(o.t == t) & (o.system == system)]
            assert len(np.unique(now[now >= 0])) == (now >= 0).sum() >= 3
    _, first = np.unique(1000 * o.system + own, return_index=True)  # with its satellite
    first = first[own[first] >= 0]
    assert fresh[first].all()
    again = np.flatnonzero(fresh)[~np.isin(np.flatnonzero(fresh), first)]
    assert len(again) >= 4
    assert o.t[again].min() == CHANGE + GONE - 1.0
    parts, found = Channels(), []  # in pieces, and from a copy, the same
    for piece in np.array_split(rows, 7):
        parts = parts.copy()
        found.append(np.array(parts.give_states(o, piece)))
    np.testing.assert_array_equal(np.hstack(found), [own, fresh])


@pytest.mark.parametrize("estimator", ["tight", "smoother"])
def test_what_a_state_knew_of_another_satellite_is_forgotten(few, estimator):
    """Innovations and errors of 12 runs, where satellites of meters of error exchange their states."""
    truth, sense = few
    filter_ = load(estimator, {"over": "tight"} if estimator == "smoother" else {})
    nis, nees = [], []
    for run in range(12):
        drawn = sense(run)
        solution = filter_.run(drawn.data, drawn.initial)
        table = solution.innovations
        ranges = (table.code == table.sensor.index("pseudorange")) & (table.t > CHANGE + GONE - 1.5)
        nis.append(table.nis[ranges])
        errors = error_series(truth, solution)
        nees.append(errors.nees[[20, 70, 79, 80, 82, 90, 120]])
    values = np.concatenate(nis)
    low, high = band(len(values))
    assert low < values.mean() < high
    low, high = band(12 * 9)
    assert (np.mean(nees, axis=0) / 9 < high).all(), np.mean(nees, axis=0)
    assert (np.mean(nees, axis=0) / 9 > low).all(), np.mean(nees, axis=0)


def test_the_error_of_the_satellite_before_does_not_matter_to_the_next(few):
    """5 m more on one satellite for a minute: where its state goes on, the innovations are the same."""
    _, sense = few
    drawn = sense(0)
    o = drawn.data.observations
    rows = np.arange(len(o.t))
    own, fresh = Channels().give_states(o, rows)
    new = rows[(fresh == 1) & (o.t > CHANGE + GONE - 1.5)][0]
    before = (own == own[new]) & (o.system == o.system[new]) & (o.t < CHANGE)
    found = []
    for data in (drawn.data, replace(drawn.data, observations=shifted(o, before, 5.0))):
        solution = Tight().run(data, drawn.initial)
        table = solution.innovations
        ranges = (table.code == table.sensor.index("pseudorange")) & (table.t == o.t[new])
        found.append(table.z[ranges])
    assert np.abs(found[0] - found[1]).max() < 2.0


def test_satellites_that_wait_for_a_state_are_counted(few):
    """Those that rise while the states of the others are still held; none where ranges have no states."""
    _, sense = few
    drawn = sense(0)
    o = drawn.data.observations
    own, _ = Channels().give_states(o, np.arange(len(o.t)))
    assert (own < 0).sum() > 20
    said = f"satellites: {(own < 0).sum()} rows left out: all states of their system are taken"
    assert said in Tight().run(drawn.data, drawn.initial).events.text
    none = replace(WANDERING.sky, gps_space_sd=0.0, glonass_space_sd=0.0)
    drawn = sense(0, replace(UNITS, assumed=replace(UNITS.assumed, gnss=replace(WANDERING, sky=none))))
    assert not [text for text in Tight().run(drawn.data, drawn.initial).events.text if "states" in text]


# --- a satellite at fault -------------------------------------------------------------------------------


def test_a_satellite_whose_clock_runs_away_is_left_out_until_it_is_right():
    """By 0.5 m/s for 40 s: its state does not follow it far, and the others outvote it."""
    truth = weaving(150.0)
    o = sensors.sense(truth, UNITS, 3, 0).data.observations
    row = int(np.flatnonzero(o.sat == np.bincount(o.sat[o.system == 0]).argmax())[0])
    fault = Fault(
        "pseudorange", "gnss", 60.0, 100.0, "runaway",
        satellites=((int(o.system[row]), int(o.sat[row])),), step=(0.0,), ramp=(0.5,),
    )  # fmt: skip
    drawn = sensors.sense(truth, replace(UNITS, faults=(fault,)), 3, 0)
    solution = Tight().run(drawn.data, drawn.initial)
    ((start, end, text),) = solution.events.select("refused")
    assert text.startswith(f"G{o.sat[row]:02d} range")
    assert 60.0 < start < 75.0
    assert end == 99.0
    errors = error_series(truth, solution)
    assert errors.nees[errors.t > 60.0].mean() < 9 * band(9)[1]


def test_states_that_no_satellite_has_had_take_no_part(few, monkeypatch):
    """The filter works without them: its answers have the same bits as with all of them, also where a state
    begins on the way, and after a piece of the record."""
    _, sense = few
    drawn = sense(0)
    o = drawn.data.observations
    model = Passage(Tight(), drawn.data, drawn.initial, []).run.model
    channels = Channels()
    channels.give_states(o, np.flatnonzero(o.t < CHANGE))
    used = channels.used(model.index, model.layout.size)
    assert 10 <= model.layout.size - len(used) == sum(RANGES[:2]) - (channels.held >= 0).sum()
    narrow = Tight().run(drawn.data, drawn.initial)
    monkeypatch.setattr(Channels, "used", lambda _, index, n: np.arange(n))
    whole = Tight().run(drawn.data, drawn.initial)
    for name in ("lla", "vel_n", "q_nb", "cov", "extra", "extra_sd"):
        np.testing.assert_array_equal(getattr(narrow, name), getattr(whole, name))
    assert not any("range" in name for name in narrow.extra_names)
    assert narrow.extra_names[-1] == "troposphere_1"
