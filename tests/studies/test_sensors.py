"""The table of units: its front, and that a better class drifts less."""

from __future__ import annotations

import pytest

import bench
from bench.evaluation.ensemble import Estimate
from bench.studies.catalog_units import CLASSES, Unit, find_units, list_units
from bench.studies.unit_table import _Row, find_front, find_law


def test_the_front_of_a_toy_case():
    """By hand: c is beaten by b, of a lower class; d by nobody."""
    grades = {"a": "consumer", "b": "consumer", "c": "industrial", "d": "tactical"}
    drift = {"a": 9.0, "b": 4.0, "c": 5.0, "d": 3.0}
    units = {name: Unit(grade, 0) for name, grade in grades.items()}
    rows = [_Row(unit=name, drift=Estimate(value, value, value)) for name, value in drift.items()]
    assert find_front(rows, units, "drift") == ["b", "d"]


def test_every_unit_of_the_catalog_has_a_class():
    units = list_units()
    assert {unit.grade for unit in units.values()} == {*CLASSES, "synthetic"}
    assert len(units) >= 20
    assert find_units("sensors", ["stim300"])["stim300"].absent == 4
    assert find_law("icm-42688-p") > find_law("stim300") > find_law("hg9900")


@pytest.mark.slow
def test_a_better_class_drifts_less():
    """Navigation and consumer on the leg without GNSS; intervals do not overlap."""
    result = bench.study("sensors", units="hg9900,icm-42688-p", estimators="loose-15", draws=3, jobs=1)
    table = result.tables["drift"].columns
    assert table["class"] == ["navigation", "consumer"]
    assert table["high_m"][0] < table["low_m"][1]
    assert "icm-42688-p (consumer)" in result.verdicts[0]
    assert "hg9900 (navigation)" in result.verdicts[0]
