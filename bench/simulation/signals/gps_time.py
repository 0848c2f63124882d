"""GPS time and the calendar: seconds since 1980-01-06, and the leap seconds of UTC."""

from __future__ import annotations

from datetime import date

from bench.simulation.signals.orbits import DAY

EPOCH = date(1980, 1, 6)
"""First day of GPS time."""
UNIX_TO_GPS = 315964800.0
"""From 1970 to 1980-01-06 [s]."""

# First days of UTC after each leap second since the start of GPS time, IERS Bulletin C.
_LEAPS = tuple(
    date(year, month, 1)
    for year, month in (
        (1981, 7), (1982, 7), (1983, 7), (1985, 7), (1988, 1), (1990, 1), (1991, 1), (1992, 7), (1993, 7),
        (1994, 7), (1996, 1), (1997, 7), (1999, 1), (2006, 1), (2009, 1), (2012, 7), (2015, 7), (2017, 1),
    )
)  # fmt: skip


def leap_seconds(day: date) -> int:
    """Return GPS time minus UTC at the start of a day [s].

    Examples
    --------
    >>> leap_seconds(date(2012, 10, 31)), leap_seconds(date(2020, 6, 25))
    (16, 18)
    """
    return sum(day >= first for first in _LEAPS)


def gps_seconds(year: int, month: int, day: int, second: float = 0.0) -> float:
    """Return seconds since 1980-01-06, without leap seconds, of a calendar day and second of the day."""
    return (date(year, month, day) - EPOCH).days * DAY + second


def may_be_gps(seconds: float) -> bool:
    """Return whether a time [s] may count from 1980-01-06, rather than from a start or within a week."""
    return 1e8 < seconds < 4e9


def to_date(seconds: float) -> date:
    """Return the calendar day of a time in seconds since 1980-01-06."""
    return date.fromordinal(EPOCH.toordinal() + int(seconds // DAY))
