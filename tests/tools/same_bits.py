"""Hashes of what bench computes, to show that a change of the code's layout changes no bit.

    python tests/tools/same_bits.py AFTER.json            # in the environment of the commit
    python tests/tools/same_bits.py AFTER.json BEFORE.json  # and what differs from an earlier table

It uses the public names of bench and its command line alone, so that it runs on older and newer commits. The
commit, folders, times and durations are masked. A case that fails has its error as hash. Tables hold for one
machine and one set of libraries.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import bench

LOGS = Path(__file__).parents[1] / "logs"
DATA = Path(__file__).parents[1] / "data" / "gnss"
SHORT = """
title    = "Two turns and a climb"
aircraft = "aerosonde"
rate_hz  = 100
[start]
lat_deg = 47.26
lon_deg = 11.34
alt_m   = 1200.0
heading_deg = 85.0
[wind]
from_deg = 250.0
speed_mps = 5.0
[[leg]]
kind = "straight"
duration_s = 12.0
[[leg]]
kind = "turn"
by_deg = 120.0
bank_deg = 25.0
[[leg]]
kind = "climb"
to_alt_m = 1230.0
rate_mps = 1.5
[[leg]]
kind = "turn"
by_deg = -90.0
bank_deg = 20.0
[[gnss_outage]]
start_s = 25.0
duration_s = 8.0
[sensors]
imu  = "adis16475"
gnss = "l1-code"
baro = "bmp388"
[evaluation]
from_s = 5.0
[[estimator]]
use = "loose-15"
[[estimator]]
use = "loose-full"
"""
UNITS: dict[str, dict[str, Any]] = {
    "usual": {},
    "ranges": {"sensors.gnss": "sky-l1", "sensors.imu": "stim300"},
    "white": {"sensors.gnss": "matched-white"},
    "consumer": {"sensors.imu": "mpu-9250", "sensors.gnss": "zed-f9p", "sensors.mag": "rm3100"},
}
"""What differs of the sensors on board, by flight."""
SLOW = ("ukf", "classic-22", "error-ekf", "fixed-gain", "complementary", "least-squares", "invariant-ekf")
"""Filters in Python: on the first of the units alone."""
SCREENS = (
    "list", "list profiles", "list aircraft", "list legs", "list imu", "list gnss", "list estimators",
    "list exports", "list studies", "guide", "guide metrics", "guide conventions", "--help", "run --help",
    "navigate --help", "study --help", "campaign --help", "card --help", "fixes --help", "check --help",
    "serve --help", "study register", "guide --search gate",
)  # fmt: skip
_MASKED = [
    (re.compile(r"\b[0-9a-f]{7,40}\b(?=[^0-9a-f]|$)"), "COMMIT"),
    (re.compile(r"/[^\s\"'<>:]*/(same-bits-\w+|bench|tests)\b"), "FOLDER"),
    (re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d(\.\d+)?)?(Z|[+-]\d\d:\d\d)?"), "TIME"),
    (re.compile(r"\b\d+(\.\d+)?(e-?\d+)? (s|ms|min)( CPU| of CPU)?\b(?= *\.?$)", re.MULTILINE), "DURATION"),
    (re.compile(r"same-bits-\w+"), "FOLDER"),
    (re.compile(r"<dt>versions</dt>.*?</dl>", re.DOTALL), "ORIGIN"),
]


def mask(text: str) -> str:
    """Return a text without what differs from run to run."""
    for root in (Path(bench.__file__).parents[1], Path(__file__).parents[2]):
        text = text.replace(str(root), "ROOT")
    for pattern, word in _MASKED:
        text = pattern.sub(word, text)
    return text


def digest(value: Any) -> str:
    """Return a hash of arrays, records, numbers and texts to the last bit."""
    found = hashlib.sha256()

    def add(one: Any) -> None:
        if isinstance(one, np.ndarray):
            found.update(f"{one.dtype}{one.shape}".encode())
            found.update(np.ascontiguousarray(one).tobytes())
        elif is_dataclass(one) and not isinstance(one, type):
            for field in fields(one):
                found.update(field.name.encode())
                add(getattr(one, field.name))
        elif isinstance(one, dict):
            for key in sorted(one, key=str):
                found.update(str(key).encode())
                add(one[key])
        elif isinstance(one, (list, tuple)):
            found.update(str(len(one)).encode())
            for each in one:
                add(each)
        elif isinstance(one, bytes):
            found.update(one)
        else:
            found.update(mask(repr(one)).encode())

    add(value)
    return found.hexdigest()[:16]


def command(line: str) -> tuple[int, str]:
    """Return the exit status and the masked output of a command, 80 columns wide."""
    from bench.__main__ import main

    output, before = io.TextIOWrapper(io.BytesIO(), encoding="utf-8"), sys.argv
    sys.argv = ["bench", *line.split()]
    status: Any = 0
    try:
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
            status = main()
    except SystemExit as end:
        status = end.code
    finally:
        sys.argv = before
    output.seek(0)
    return int(status or 0), mask(output.read())


def names_of_filters() -> list[str]:
    """Return the names of all built-in filters."""
    return [str(getattr(one, "name", one)) for one in bench.list_estimators()]


def list_cases(folder: Path) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Yield the name of each case and what computes it."""
    source = folder / "short.toml"
    source.write_text(SHORT, encoding="utf-8")
    flights = {}
    for name, changes in UNITS.items():
        profile = bench.read_profile(str(source), changes)
        truth = bench.fly(profile)
        flights[name] = profile, truth, bench.sense(profile, truth, run=1)
        yield f"truth {name}", lambda name=name: flights[name][1]
        yield f"sensors {name}", lambda name=name: flights[name][2]
    for name, (profile, truth, sensed) in flights.items():
        for use in names_of_filters():
            if (use in SLOW and name != "usual") or (use == "graph-smoother" and name != "white"):
                continue

            def solve(
                use: str = use, sensed: Any = sensed, profile: Any = profile, truth: Any = truth
            ) -> Any:
                solution = bench.run_filter(use, sensed.data, sensed.initial)
                return solution, bench.evaluate(profile, truth, solution, sensed)

            yield f"{use} {name}", solve
    options: list[tuple[str, dict[str, Any]]] = [
        ("loose-22", {"covariance_hz": 10.0}), ("loose-15", {"integrity": ["nis", "velocity"]}),
        ("loose-full", {"standstill": True}), ("loose-15", {"adaptive_noise": 20}),
        ("loose-22", {"coordinated": True}), ("loose-full", {"lever_arm_sd": 0.5}),
        ("smoother", {"over": "loose-15"}), ("loose-15", {"compensate_latency": False}),
    ]  # fmt: skip
    _, _, sensed = flights["usual"]
    for use, chosen in options:
        yield (
            f"{use} {chosen}",
            lambda use=use, chosen=chosen: bench.run_filter(use, sensed.data, sensed.initial, chosen),
        )
    profile = bench.read_profile(
        str(source), {"alignment": {"kind": "course", "duration_s": 12.0}, "evaluation.from_s": 14.0}
    )
    told = bench.sense(profile, flights["usual"][1], run=0)
    yield "aligned by course", lambda: bench.run_filter("loose-full", told.data, told.initial)
    for name, use in (
        ("usual", "loose-full"),
        ("ranges", "tight"),
        ("usual", "ukf"),
        ("consumer", "loose-full"),
    ):
        _, _, given = flights[name]

        def in_pieces(use: str = use, given: Any = given, save: bool = False) -> Any:
            filter_ = bench.open_filter(use, given.initial, {}, look_back=0.5)
            found, ends = [], [-np.inf, 3.0, 17.5, 31.0, np.inf]
            for k in range(len(ends) - 1):
                found.append(filter_.update(bench.slice_sensors(given.data, ends[k], ends[k + 1])))
                if save:
                    filter_ = bench.read_filter(bench.write_filter(filter_, folder / f"{use}.npz"))
            return [*found, filter_.finish()]

        yield f"pieces of {use} {name}", in_pieces
        yield f"saved {use} {name}", lambda solve=in_pieces: solve(save=True)

    def gap() -> Any:
        imu = sensed.data.imu
        lost = replace(imu, valid=imu.valid & ~((imu.t > 20.0) & (imu.t < 24.0)))
        return bench.run_filter("loose-full", replace(sensed.data, imu=lost), sensed.initial)

    yield "a gap of the IMU", gap
    for name in ("drive.toml",):
        yield f"log {name}", lambda name=name: bench.navigate(str(LOGS / name)).solutions
    rinex = [str(DATA / f"ESBC00DNK_2020177_GR_{one}.rnx.gz") for one in ("360s", "MN")]
    yield "fixes of RINEX", lambda: bench.solve_rinex(*rinex)
    for name in ("figure-eight", "approach", "gate-to-gate", "gnss-faults"):
        yield f"profile {name}", lambda name=name: bench.read_profile(name)
    for screen in SCREENS:
        yield f"bench {screen}", lambda screen=screen: command(screen)
    place = folder / "run"
    written = f"run {source} --run 2 -o {place} --no-rrd --no-causes"
    yield "bench run", lambda: command(written)
    yield "bench run: page", lambda: mask((place / "report.html").read_text(encoding="utf-8"))
    yield (
        "bench run: JSON",
        lambda: {
            key: value
            for key, value in json.loads((place / "result.json").read_text(encoding="utf-8")).items()
            if key != "provenance"
        },
    )
    yield "bench show", lambda: command(f"show {place}")
    yield "bench compare", lambda: command(f"compare {place} {place}")
    yield (
        "bench export csv",
        lambda: (
            command(f"export {place} --to csv -o {folder / 'csv'}"),
            {one.name: one.read_bytes() for one in sorted((folder / "csv").rglob("*.csv"))},
        ),
    )
    yield "bench campaign", lambda: command(f"campaign {source} --runs 3 --jobs 1 -o {folder / 'many'}")
    yield "bench campaign: page", lambda: mask((folder / "many" / "report.html").read_text(encoding="utf-8"))


def make_table() -> dict[str, str]:
    """Return the hash of every case."""
    table = {}
    os.environ["COLUMNS"], os.environ["NO_COLOR"] = "80", "1"
    with tempfile.TemporaryDirectory(prefix="same-bits-") as scratch:
        for name, compute in list_cases(Path(scratch)):
            try:
                table[name] = digest(compute())
            except Exception as error:
                table[name] = f"{type(error).__name__}: {mask(str(error))[:200]}"
    return table


def main() -> int:
    """Write the table; print what differs from an earlier one."""
    table = make_table()
    Path(sys.argv[1]).write_text(json.dumps(table, indent=1), encoding="utf-8")
    failed = [name for name, found in table.items() if ":" in found]
    print(f"{len(table)} cases, {len(failed)} without a result{''.join(f'; {one}' for one in failed)}")
    if len(sys.argv) < 3:
        return 0
    before = json.loads(Path(sys.argv[2]).read_text(encoding="utf-8"))
    others = [name for name in {**before, **table} if before.get(name) != table.get(name)]
    print(
        "\n".join(f"differs: {name}: {before.get(name)} -> {table.get(name)}" for name in others)
        or "same bits"
    )
    return 1 if others else 0


if __name__ == "__main__":
    sys.exit(main())
