"""The filters of the league, and the flights of its suites."""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version

from bench.experiments.card.card_suite import Suite, SuiteFlight


@dataclass(frozen=True)
class Entry:
    """A filter: as ``-e`` takes it, the package it is from, and what it is told beside the samples."""

    use: str
    package: str  # "": bench
    told: str
    whole: bool = False  # a smoother, which uses the whole record

    @property
    def label(self) -> str:
        return self.use.rpartition(":")[2]

    @property
    def version(self) -> str:
        """Its version; "" if it is not installed."""
        try:
            return version(self.package or "ins-gnss-bench")
        except PackageNotFoundError:
            return ""


_AHRS, _OTHER = "tests.league.ahrs_filters", "tests.league.other_attitude"
_NORTH, _START = "declination", "initial attitude, declination"
_OWN = "initial state, datasheet"
_TUNED = "tests.league.tuned_filters"
_ALSO_TUNED = (
    ("Madgwick", "ahrs", _START), ("Mahony", "ahrs", _START), ("Aqua", "ahrs", _START),
    ("AhrsEkf", "ahrs", "initial attitude, magnetic model"), ("Fusion", "imufusion", _START),
    ("Vqf", "vqf", _NORTH),
)  # fmt: skip

ATTITUDE_FILTERS = (
    Entry("ahrs", "", "initial state, datasheet, magnetic model"),
    Entry("loose-full", "", "initial state, datasheet; GNSS and barometer, no magnetometer"),
    Entry(f"{_AHRS}:Madgwick", "ahrs", _START),
    Entry(f"{_AHRS}:Mahony", "ahrs", _START),
    Entry(f"{_AHRS}:Aqua", "ahrs", _START),
    Entry(f"{_AHRS}:AhrsEkf", "ahrs", "initial attitude, magnetic model"),
    Entry(f"{_OTHER}:Fusion", "imufusion", _START),
    Entry(f"{_OTHER}:Vqf", "vqf", _NORTH),
    Entry(f"{_OTHER}:BasicVqf", "vqf", _NORTH),
    Entry(f"{_OTHER}:OfflineVqf", "vqf", _NORTH, whole=True),
    *(Entry(f"{_TUNED}:Tuned{name}", package, told) for name, package, told in _ALSO_TUNED),
)
POSITION_FILTERS = (
    Entry("loose-full", "", _OWN),
    Entry("loose-15", "", _OWN),
    Entry("tests.league.gtsam_filters:GtsamFixedLag", "gtsam", f"{_OWN}; no barometer"),
    Entry("tests.league.gtsam_filters:GtsamGal3Ekf", "gtsam", "initial state, IMU noise; no barometer"),
    Entry("tests.league.pyins_filter:PythonIns", "python-ins", f"{_OWN}; no barometer"),
    Entry("classic-22", "filterpy", f"{_OWN}: the published model of bench on filterpy"),
    Entry("smoother", "", _OWN, whole=True),
)

_WEAVE = [
    {"kind": "straight", "duration_s": 60.0},
    {"kind": "s-turns", "by_deg": 60.0, "bank_deg": 30.0, "count": 3},
    {"kind": "straight", "duration_s": 20.0},
]
_SHORT = {
    "leg": [
        {"kind": "straight", "duration_s": 40.0},
        {"kind": "s-turns", "by_deg": 40.0, "bank_deg": 30.0, "count": 2},
    ],
    "gnss_outage": [{"start_s": 40.0, "duration_s": 10.0}],
}
_QUADROTOR = SuiteFlight(
    "quadrotor", "hover-and-sprint",
    {
        "leg": [
            {"kind": "static", "duration_s": 10.0},
            {"kind": "take-off", "to_height_m": 10.0, "rate_mps": 2.0},
            {"kind": "hover", "duration_s": 20.0},
            {"kind": "yaw", "by_deg": 360.0, "rate_deg_s": 45.0},
            {"kind": "orbit", "radius_m": 15.0, "laps": 1.0, "speed_mps": 5.0},
            {"kind": "sprint", "distance_m": 150.0, "speed_mps": 13.0, "off_nose_deg": -145.0},
            {"kind": "hover", "duration_s": 10.0},
        ],
        "evaluation.from_s": 30.0,
    },
)  # fmt: skip
_MATCHED = {"leg": _WEAVE, "sensors.imu": "matched-mems", "sensors.gnss": "matched-white"}
_OUTAGE = {"leg": _WEAVE, "gnss_outage": [{"start_s": 70.0, "duration_s": 30.0}]}

_MAGNETS = [
    {"kind": "mag-step", "start_s": 42.0, "duration_s": 6.0, "step_ut": [15.0, -10.0, 5.0]},
    {"kind": "magnet-passed", "start_s": 60.0, "duration_s": 8.0, "peak_ut": [0.0, 40.0, 10.0]},
]
_BAD_FIXES = [
    {"kind": "spoofing", "start_s": 62.0, "duration_s": 5.0, "step_m": [30.0, -20.0, 5.0]},
    {"kind": "noise-burst", "sensor": "gnss", "start_s": 80.0, "duration_s": 15.0, "times": 5.0},
]

DRAWS = 6
"""Runs of each flight."""

ATTITUDE = Suite(
    "league-attitude", (), draws=DRAWS,
    members=(
        _QUADROTOR,
        SuiteFlight("fixed-wing", "s-turns", {"leg": _WEAVE, "sensors.mag": "rm3100"}),
        replace(
            _QUADROTOR, name="magnets", values={**_QUADROTOR.values, "fault": _MAGNETS}, without="quadrotor"
        ),
    ),
)  # fmt: skip
POSITION = Suite(
    "league-position", (), draws=DRAWS,
    members=(
        SuiteFlight("matched", "s-turns", _MATCHED), SuiteFlight("outage", "s-turns", _OUTAGE),
        SuiteFlight("bad fixes", "s-turns", {**_MATCHED, "fault": _BAD_FIXES}, without="matched"),
    ),
)  # fmt: skip
AUDIT = Suite(
    "league-audit", (), draws=1,
    members=(SuiteFlight("short", "s-turns", {**_SHORT, "sensors.mag": "rm3100"}),),
)  # fmt: skip
"""The flight on which causality is proven: a filter is run up to ten times."""

HELD = {"attitude": "heading", "position": "accuracy"}
"""The error by which the robustness of each kind of filter is measured."""

SUITES = {"attitude": (ATTITUDE, ATTITUDE_FILTERS), "position": (POSITION, POSITION_FILTERS)}


def find_reference(kind: str) -> str:
    """Return the filter whose errors are 1: the reference of bench for that kind of filter."""
    return "ahrs" if kind == "attitude" else "loose-full"
