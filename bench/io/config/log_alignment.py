"""Check of the alignment of a log against what the log contains."""

from __future__ import annotations

from bench.io.config.log_tables import SIDEWAYS, LogTable, find_kind
from bench.simulation.signals.magnetic import FIRST_YEAR, LAST_YEAR

_GIVEN_KEYS = ("roll_deg", "pitch_deg", "heading_deg", "tilt_sd_deg", "heading_sd_deg")


def check_start(table: LogTable) -> list[str]:
    """Return a line for what the alignment lacks, and for what would have no effect."""
    asked, found = table.alignment, find_kind(table)
    kind = f"kind = {found!r}"
    present = [key for key in _GIVEN_KEYS if getattr(asked, key) is not None]
    wrong = []
    if found == "given":
        wrong += [
            f"[alignment] {key} is missing; {kind} needs it" for key in _GIVEN_KEYS[:3] if key not in present
        ]
        wrong += [f"[alignment] duration_s has no effect with {kind}"] if asked.duration_s is not None else []
    else:
        given = [key for key in present if not (key == "heading_sd_deg" and asked.heading)]
        wrong += [f"[alignment] {key} is for kind = 'given', not for {kind}" for key in given]
    if asked.heading and found not in ("level", "hover"):
        wrong.append(f"[alignment] heading is for kind = 'level' or 'hover', not for {kind}")
    if asked.heading == "magnetometer" and table.mag is None:
        wrong.append("[alignment] heading = 'magnetometer' needs a table [mag]")
    if found != "course" and asked.drift_deg is not None:
        wrong.append(f"[alignment] drift_deg is for kind = 'course', not for {kind}")
    if table.vehicle in SIDEWAYS and found == "course":
        wrong.append(f"[alignment] {kind}: the course of a {table.vehicle} gives no heading; use 'hover'")
    if table.mag is not None:
        year = None if table.date is None else table.date.year
        if year is None or not FIRST_YEAR <= year < LAST_YEAR:
            known = f"of {FIRST_YEAR:g} to {LAST_YEAR - 1:g}, by which the magnetic field is known"
            wrong.append(f"[mag] needs a date above all tables, {known}: date = 2024-05-31")
    if (table.gnss is None) != (table.place is not None):
        wrong.append(
            "place has no effect with [gnss]"
            if table.place
            else "[gnss] is missing: for filters without "
            "fixes, such as 'ahrs', give place = [latitude, longitude, height]"
        )
    elif table.gnss is None and (found not in ("given", "level") or asked.heading):
        wrong.append(f"[alignment] without [gnss]: kind 'level' or 'given' without heading, not {found!r}")
    return wrong
