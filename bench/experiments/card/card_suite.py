"""The suite of the cards: fixed flights, units, faults and runs."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

from bench.core.records.specs import Profile
from bench.experiments.campaigns.campaign_file import CampaignSpec, Values
from bench.experiments.campaigns.plan import Plan
from bench.io import results
from bench.io.config import read_profile

_EVENTS = ("fault", "gnss_outage")
_TO = "to_heading_deg"

VERSION = 4
"""Version of the suite; it changes with any flight, sensor, fault or number of runs in it."""


@dataclass(frozen=True, eq=False)
class SuiteFlight:
    """A shipped profile with some values replaced."""

    name: str
    profile: str
    values: Values = field(default_factory=dict)
    without: str = ""  # name of the same flight without what happens in this one


@dataclass(frozen=True)
class Suite(CampaignSpec):
    """Flights of a card; each run of a flight is a condition of its own, with its own truth and noise."""

    members: tuple[SuiteFlight, ...] = ()
    draws: int = 8  # runs of each flight
    draw_seed: int | None = None  # of all runs; None: the values of the suite
    runs: int = 1  # of a condition

    def conditions(self) -> Iterator[tuple[str, Values]]:
        """Yield profile and values of each run of each flight, in order."""
        for one in self.members:
            for draw in range(self.draws):
                yield one.profile, vary_flight(one, draw, self.draw_seed)

    def locate(self, condition: int) -> tuple[int, int]:
        """Return the number of the flight and of its run."""
        return divmod(condition, self.draws)

    def profile_of(self, plan: Plan, flight: int, draw: int) -> Profile:
        """Return the profile of a run of a flight, both by number."""
        return plan.cells[flight * self.draws + draw].profile


_LATITUDE, _LONGITUDE = 55.0, 180.0  # where the flights start, to both sides [deg]
_WIND = 5.0  # largest [m/s]


def vary_flight(flight: SuiteFlight, draw: int, seed: int | None = None) -> Values:
    """Return the values of a run of a flight: its own place, heading, wind and noise.

    So a filter that remembers the truth of a run learns nothing about the next. Headings of legs turn with
    the initial heading. A seed gives other values, and moves the times of faults and outages.
    """
    values = {**flight.values, **({} if seed is None else move_events(flight, seed))}
    document = _read_flight(flight)
    start, wind = document["start"], document.get("wind", {})
    rng = np.random.default_rng([0 if seed is None else 1 + seed, draw, *flight.name.encode()])
    latitude, longitude, heading, blows, speed = (
        rng.uniform([-_LATITUDE, -_LONGITUDE, 0.0, 0.0, 0.0], [_LATITUDE, _LONGITUDE, 360.0, 360.0, _WIND])
        .round(1)
        .tolist()
    )
    values |= {"start.lat_deg": latitude, "start.lon_deg": longitude, "start.heading_deg": heading % 360.0}
    if not start.get("on_ground") and not wind.get("layers"):
        values |= {"wind.from_deg": blows % 360.0, "wind.speed_mps": speed}
    legs = document.get("leg", ())
    if any(_TO in leg for leg in legs):
        turned = heading - start["heading_deg"]
        values["leg"] = [
            {**leg, _TO: round((leg[_TO] + turned) % 360.0, 1) % 360.0} if _TO in leg else leg for leg in legs
        ]
    return {**values, "seed": int(rng.integers(10**9))}


@cache
def _read_flight(flight: SuiteFlight) -> Mapping[str, Any]:
    return read_profile(flight.profile, flight.values, estimators=["free-inertial"]).document


_FARTHEST = 20.0  # that a fault is moved [s]
_OF_GAP = 0.4  # of the time to its neighbors


def move_events(flight: SuiteFlight, seed: int) -> Values:
    """Return the faults and outages of a flight, each moved in time by a random amount from the seed.

    So a filter that knows the times of the suite by heart finds others. What lasts from the start on, or
    touches something else, stays; the order stays, too.
    """
    profile = read_profile(flight.profile, flight.values, estimators=["free-inertial"])
    rows = [(key, row) for key in _EVENTS for row in profile.document.get(key, ())]
    spans = [(row["start_s"], row["start_s"] + row["duration_s"]) for _, row in rows]
    end = float(profile.document["duration_s"]) if "duration_s" in profile.document else np.inf
    rng = np.random.default_rng([seed, *flight.name.encode()])
    moved: dict[str, list[Any]] = {}
    for (key, row), (first, last) in zip(rows, spans, strict=True):
        before = max([profile.evaluation.begin, *(b for a, b in spans if a < first)])
        after = min([end, *(a for a, _ in spans if a > first)])
        room = max(0.0, min(_FARTHEST, _OF_GAP * (first - before), _OF_GAP * (after - last)))
        start = round(first + rng.uniform(-room, room), 1)
        moved.setdefault(key, []).append({**row, "start_s": start if room else first})
    return moved


def _drop_imu(start_s: float, duration_s: float) -> Values:
    return {"kind": "dropped", "sensor": "imu", "start_s": start_s, "duration_s": duration_s}


_PLAIN = "s-turns-matched"
LATE = "late-fixes"
"""Name of the flight on which fixes come late."""
_MATCHED: Values = {"sensors.imu": "matched-mems", "sensors.gnss": "matched-white"}
_GAPS = [_drop_imu(100.0, 0.5), _drop_imu(170.0, 2.0), _drop_imu(250.0, 10.0), _drop_imu(340.0, 5.0)]
_LATE = [{"kind": "latency", "sensor": "gnss", "start_s": 0.0, "duration_s": 425.0, "added_s": 0.5}]
_WEAVE = [
    {"kind": "straight", "duration_s": 60.0},
    {"kind": "s-turns", "by_deg": 60.0, "bank_deg": 30.0, "count": 4},
    {"kind": "straight", "duration_s": 30.0},
]
_WIDE = [
    {"kind": "straight", "duration_s": 60.0},
    {"kind": "s-turns", "by_deg": 40.0, "bank_deg": 20.0, "count": 3},
    {"kind": "straight", "duration_s": 20.0},
]
_AWAY = [{"kind": "straight", "duration_s": 240.0}]
_QUICK = (
    SuiteFlight("figure-eight-matched", "figure-eight-matched"),
    SuiteFlight("figure-eight", "figure-eight"),
    SuiteFlight("gnss-faults", "gnss-faults"),
    SuiteFlight(_PLAIN, "s-turns", _MATCHED),
    SuiteFlight("imu-gaps", "s-turns", {**_MATCHED, "fault": _GAPS}, _PLAIN),
    SuiteFlight(LATE, "s-turns", {**_MATCHED, "fault": _LATE}, _PLAIN),
    SuiteFlight("heading-30-deg-off", "s-turns", {**_MATCHED, "initial_error_sd.heading_deg": 30.0}),
    SuiteFlight("start-not-told", "s-turns", {"leg": _WEAVE, "alignment.kind": "course"}),
    SuiteFlight("magnetometer", "s-turns", {"leg": _WEAVE, "sensors.mag": "rm3100"}),
    SuiteFlight("standing-still", "static", {"leg.1.duration_s": 180.0}),
    SuiteFlight("straight-out-mpu-9250", "s-turns", {"leg": _AWAY, "sensors.imu": "mpu-9250"}),
    SuiteFlight("navion", "s-turns", {"leg": _WIDE, "aircraft": "navion", "start.speed_mps": 55.0}),
)
_FULL = (
    *_QUICK,
    SuiteFlight("survey", "survey"),
    SuiteFlight("survey-stim300", "survey", {"sensors.imu": "stim300"}),
    SuiteFlight("survey-icm-42688-p", "survey", {"sensors.imu": "icm-42688-p"}),
    SuiteFlight("gnss-denied-leg", "gnss-denied-leg"),
    SuiteFlight("high-dynamics", "high-dynamics"),
    SuiteFlight("turbulent-loiter", "turbulent-loiter"),
)
QUICK = Suite("card-quick", (), draws=8, members=_QUICK)
FULL = Suite("card", (), draws=40, members=_FULL)


def hash_suite(plan: Plan) -> str:
    """Return a hash of the flights, sensors and runs, independent of the filters."""
    parts = [
        [
            {key: value for key, value in cell.profile.document.items() if key != "estimator"},
            results.hash_spec(cell.profile.sensors),
        ]
        for cell in plan.cells
    ]
    text = json.dumps([VERSION, parts, len(plan.runs)], sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
