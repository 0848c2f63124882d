"""The ranges of a receiver beside a recorded IMU: its fixes, and the observations for tight coupling."""

from __future__ import annotations

from bench.core.records.sensor_specs import GnssSpec
from bench.io.config.log import SourceSpec
from bench.io.fix_readers import RecordedRanges, ask_reader


def read_ranges(source: SourceSpec, gnss: GnssSpec) -> RecordedRanges:
    """Solve the files of a receiver, with noise, masks, systems and carriers of the datasheet.

    Raises
    ------
    ConfigError
        If a file is wrong, or no ephemeris fits.
    """
    files = (source.observations, source.navigation, source.time_offset)
    return ask_reader(source.observations[0], "read_ranges", RecordedRanges, *files, gnss)
