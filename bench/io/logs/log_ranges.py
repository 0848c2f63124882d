"""The ranges of a receiver beside a recorded IMU: its fixes, and the observations for tight coupling."""

from __future__ import annotations

from typing import NamedTuple

from bench.core.records.data import GnssObservations, SkyView
from bench.core.records.sensor_specs import GnssSpec
from bench.io.config.log import SourceSpec
from bench.io.fix_readers import ask_reader
from bench.io.logs.rows import LogRows


class RecordedRanges(NamedTuple):
    """What the ranges of a receiver tell, on the clock of a log [s]."""

    fixes: LogRows
    observations: GnssObservations | None  # if the datasheet that is assumed has a [sky]
    sky: SkyView
    lack: str  # why there are no observations, in words; empty: there are some


def read_ranges(source: SourceSpec, gnss: GnssSpec) -> RecordedRanges:
    """Solve the files of a receiver, with noise, masks, systems and carriers of the datasheet.

    Raises
    ------
    ConfigError
        If a file is wrong, or no ephemeris fits.
    """
    return ask_reader(source.observations[0], "read_ranges", RecordedRanges, source, gnss)
