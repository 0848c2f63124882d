"""NMEA sentences as receivers write them before they have a fix."""

from __future__ import annotations

from datetime import datetime

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.words.exceptions import ConfigError
from bench.io.exports.nmea import make_sentence
from bench.io.logs.formats import nmea_sentences


def write(path, dates):
    """Write a second of sentences for each status and date of RMC."""
    lines = []
    for k, (status, day) in enumerate(dates):
        place = "4715.6180,N,01120.6340,E"
        lines.append(make_sentence(f"GPGGA,12000{k}.00,{place},1,08,0.9,545.4,M,46.9,M,,"))
        lines.append(make_sentence(f"GPRMC,12000{k}.00,{status},{place},0.0,0.0,{day},,"))
    path.write_text("".join(lines), newline="")
    return path


def test_a_date_without_a_fix_does_not_count(tmp_path):
    """A receiver without a fix has the date of its own clock, which may be years off."""
    path = write(
        tmp_path / "a.nmea", [("V", "060180"), ("V", ""), ("A", "290226"), ("A", "300326"), ("A", "300326")]
    )
    rows = nmea_sentences.read("nmea", path, "gnss", None)
    begin = (datetime(2026, 3, 30, 12) - datetime(1980, 1, 6)).total_seconds() + 18.0
    assert_allclose(rows.t, begin + np.arange(5.0))
    with pytest.raises(ConfigError, match="no RMC sentence with a date and a fix"):
        nmea_sentences.read("nmea", write(path, [("V", "300326")] * 3), "gnss", None)
