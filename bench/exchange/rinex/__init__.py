"""Read RINEX 2 and 3 observation and navigation files of GPS and GLONASS; other systems are skipped.

An error is one line with the name of the file and the line number. A file is read line by line; memory grows
only with its number of satellites and epochs.
"""

from bench.exchange.rinex.ephemerides import NavigationFile, merge_navigation, read_navigation
from bench.exchange.rinex.lines import Lines, gps_seconds, leap_seconds, open_lines
from bench.exchange.rinex.observations import ObservationFile, read_observations

__all__ = [
    "Lines",
    "NavigationFile",
    "ObservationFile",
    "gps_seconds",
    "leap_seconds",
    "merge_navigation",
    "open_lines",
    "read_navigation",
    "read_observations",
]
