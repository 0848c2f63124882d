"""What follows from the row of an instrument: datasheet, faults, files, stream, needs and plots of each."""

from __future__ import annotations

import struct
from dataclasses import fields, replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from bench.core.files.places import PACKAGE
from bench.core.mathematics.units import to_si
from bench.core.records.fields import columns_of, figures_of
from bench.core.records.instruments import INSTRUMENTS, InstrumentReports, InstrumentSpecs
from bench.core.records.run_result import RunResult
from bench.core.records.sensor_specs import Fault
from bench.io import exports, results
from bench.io.config import fault_tables, list_sensors
from bench.io.config.datasheets import SENSORS
from bench.io.exports import column_files
from bench.io.streams import frames
from bench.navigation.estimator import RECORDS
from bench.simulation.sensors import sense
from bench.views.plots.content import Content
from bench.views.plots.tabs.flight_data import FLIGHT
from tests.weaving import units


@pytest.fixture(scope="module")
def truth(short_truth):
    return short_truth  # it has air data, which some instruments feel


@pytest.fixture(scope="module")
def on_board():
    """One unit of each instrument of the catalog."""
    found = {}
    for name in INSTRUMENTS:
        path = sorted((PACKAGE / "catalog" / name).glob("matched-*.toml"))[0]
        found[name] = SENSORS[name](path, path.name)
    return replace(units(), **found)


@pytest.fixture(scope="module")
def sensed(truth, on_board):
    return sense(truth, on_board, 1, 0)


def test_every_instrument_has_its_places():
    assert (
        [f.name for f in fields(InstrumentSpecs)]
        == [f.name for f in fields(InstrumentReports)]
        == list(INSTRUMENTS)
    )
    assert len({row.frame for row in INSTRUMENTS.values()} | {frames.IMU}) == len(INSTRUMENTS) + 1
    for name, row in INSTRUMENTS.items():
        assert row.name == name
        assert "rate" in figures_of(row.spec)
        assert list(columns_of(row.record))[:3] == ["t", "t_arrival", "valid"]
        assert "sd" in columns_of(row.record)
        assert RECORDS[name] == row.with_article


@pytest.mark.parametrize("name", INSTRUMENTS)
def test_it_is_sensed_saved_exported_streamed_and_drawn(sensed, truth, tmp_path, name):
    row, record = INSTRUMENTS[name], getattr(sensed.data, name)
    assert isinstance(record, row.record)
    assert sensed.truth.bias[name].shape == (len(sensed.truth.t), row.width)
    records = {"truth": truth, "sensed": sensed}
    profile = {"title": "x", "evaluation": {"from_s": 0.0, "output_hz": 10.0}}
    results.save(tmp_path, RunResult(profile, 1, 0, {}, {}, {}, {}, records=records))
    again = results.load_sensors(tmp_path)[2][name]
    assert_array_equal(row.values(again), row.values(record))
    out = exports.gather(tmp_path)
    column_files.write(tmp_path, out, "csv")
    header = (tmp_path / f"{name}.csv").read_text(encoding="utf-8").splitlines()[0]
    assert header.split(",") == [n for told in columns_of(row.record).values() for n in told.names]
    bodies = [
        body for _, body in frames.make_messages(out) if body[:2] == frames.SYNC and body[2] == row.frame
    ]
    assert len(bodies) == len(record)
    payload = struct.unpack(f"<{row.width + 2}dB", bodies[0][8:-2])
    assert payload == (record.t[0], *row.values(record)[0], record.sd[0], record.valid[0])
    rows = FLIGHT.plots(Content(truth, sensed, {}, {}, 0.0))[""]
    shown = [plot for group in rows for plot in group]
    assert any(
        series.names[0] == row.trace.legend or row.width > 1
        for plot in shown
        if plot.path[-1] == row.trace.plot
        for series in plot.series
    )


@pytest.mark.parametrize("name", INSTRUMENTS)
@pytest.mark.parametrize("kind", ["frozen", "noise-burst", "latency", "dropped", "repeated"])
def test_every_fault_of_a_sensor_strikes_it_alone(sensed, truth, on_board, name, kind):
    table = {"kind": kind, "sensor": name, "start_s": 5.0, "duration_s": 4.0}
    table |= {"noise-burst": {"times": 20.0}, "latency": {"added_s": 0.3}}.get(kind, {})
    (fault,) = fault_tables.read_faults([table])
    assert isinstance(fault, Fault)
    struck = sense(truth, replace(on_board, faults=(fault,)), 1, 0)
    for other, row in INSTRUMENTS.items():
        before, after = getattr(sensed.data, other), getattr(struck.data, other)
        same = len(before) == len(after) and all(
            np.array_equal(getattr(before, column), getattr(after, column))
            for column in columns_of(row.record)
        )
        assert same == (other != name)


def test_a_step_strikes_the_instruments_that_have_one(sensed, truth, on_board):
    stepped = [name for name, row in INSTRUMENTS.items() if row.step]
    assert {"baro", "radar"} <= set(stepped)
    for name in stepped:
        row = INSTRUMENTS[name]
        table = {"kind": f"{name}-step", "start_s": 5.0, "duration_s": 4.0, f"step_{row.step}": 7.0}
        (fault,) = fault_tables.read_faults([table])
        struck = sense(truth, replace(on_board, faults=(fault,)), 1, 0)
        before, after = getattr(sensed.data, name), getattr(struck.data, name)
        step = to_si(f"step_{row.step}", 7.0)
        added = row.values(after) - row.values(before)
        inside = (before.t >= 5.0 - 1e-6) & (before.t < 9.0 - 1e-6)
        assert np.allclose(added[inside], step, atol=1e-9)
        assert not added[~inside].any()
        drawn = struck.truth.bias[name] - sensed.truth.bias[name]
        assert drawn.max() == pytest.approx(step)


def test_the_catalog_has_a_unit_of_each():
    assert {row.kind for row in list_sensors()} >= set(INSTRUMENTS)
