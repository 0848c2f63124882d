"""Damage files of every format that bench reads, and check that each is read or rejected by a message.

A base file is accepted whole. Each input is the base after one to four random edits. Reading it must end, or
raise a `BenchError` of one line per message; anything else is a failure. The edits follow from format, seed
and number of the input, so that a failure can be repeated:

    python -m tests.fuzz                    every format, 10,000 inputs each
    python -m tests.fuzz ulog --count 500
    python -m tests.fuzz ulog --only 417    one input, with its traceback
"""

from __future__ import annotations

import argparse
import re
import resource
import shutil
import sys
import tempfile
import time
import traceback
import warnings
import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from mcap.writer import CompressionType
from rosbags.rosbag2 import StoragePlugin

import bench
from bench.cli import exchanging
from bench.cli.command_line import commands  # noqa: F401  (what a verb loads is loaded before the time is taken)
from bench.core.files.places import PACKAGE
from bench.core.records.flight_specs import TableSpec
from bench.core.words.exceptions import BUG, BenchError
from bench.io.config import library, read_profile
from bench.io.config.datasheets import SENSORS
from bench.io.config.log import SourceSpec, load_log
from bench.io.exports import gather
from bench.io.foreign.solutions import read_solution
from bench.io.logs.log_records import read_records
from bench.io.logs.resting_log import read_resting_log
from bench.io.results import parquet
from bench.io.trajectories.trajectory import read_trajectory
from bench.plugins.receiver import almanac
from bench.plugins.receiver.rinex.ephemerides import read_navigation
from bench.plugins.receiver.rinex.observations import read_observations
from tests import fuzz_answers
from tests.data import gnss_file
from tests.exchange import drives, exported, test_log_formats
from tests.fuzz_folders import FOLDERS, Made
from tests.fuzz_formats import READERS, Format

PROFILES, CATALOG, AIRCRAFT = PACKAGE / "profiles", PACKAGE / "catalog", PACKAGE.parent / "aircraft"
LONGEST = 90.0  # CPU time that reading a small file may take [s]
MEMORY = 8_000_000_000  # address space of a process of this script [byte]


class Case(NamedTuple):
    """Files to damage, and what reads them; text is damaged by tokens and lines too."""

    files: list[Path]
    read: Callable[[Path], object]  # gets the path of the damaged file
    text: bool
    quick: Callable[[Path], object] | None = None  # reads the file, and does nothing with it
    edit: Callable[[np.random.Generator, Path, bytes], bytes] | None = None  # what its form allows


# --- damage -------------------------------------------------------------------------------------------

_TOKEN = re.compile(rb"[^\s,;:=\[\]{}\"']+")
_TOKENS = (
    b"nan", b"inf", b"-inf", b"1e9", b"-1e9", b"1e308", b"1e400", b"0", b"-0.0", b"-1", b"1e-320", b"2.5",
    b"", b"x", b'"', b"true", b"[]", b"[[1]]", b"{}", b'"text"', b"null", b"2026-01-01",
    b"99999999999999999999", b"0x10", b"1_000", b"\xc2\xb2", b"\xe9", b"\0", b"\x1b[31m", b"\x85", b"\x1c0",
    b"9" * 400, b"#", b"'''", b"..", b"/",
)  # fmt: skip
_WORDS = (0, 1, 4, 8, 255, 1 << 16, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)


def damage(random: np.random.Generator, whole: bytes, text: bool) -> bytes:
    """Return a copy after one edit or, less often, two to four."""
    data = whole
    for _ in range(min(4, random.geometric(0.6))):
        edits = _BYTE_EDITS + (_TEXT_EDITS * 6 if text else ())
        data = edits[random.integers(len(edits))](random, data)
    return data


def _span(random: np.random.Generator, data: bytes, longest: int = 64) -> tuple[int, int]:
    a = int(random.integers(len(data) + 1))
    return a, min(len(data), a + int(random.integers(1, longest)))


def _set_bytes(random: np.random.Generator, data: bytes) -> bytes:
    a, b = _span(random, data, 5)
    return data[:a] + random.bytes(b - a) + data[b:]


def _insert(random: np.random.Generator, data: bytes) -> bytes:
    a, b = _span(random, data)
    return data[:a] + random.bytes(b - a) + data[a:]


def _delete(random: np.random.Generator, data: bytes) -> bytes:
    a, b = _span(random, data)
    return data[:a] + data[b:]


def _repeat(random: np.random.Generator, data: bytes) -> bytes:
    a, b = _span(random, data, 512)
    return data[:b] + data[a:]


def _truncate(random: np.random.Generator, data: bytes) -> bytes:
    return data[: random.integers(len(data) + 1)]


def _set_word(random: np.random.Generator, data: bytes) -> bytes:
    a = int(random.integers(len(data) // 4 + 1)) * 4
    word = _WORDS[random.integers(len(_WORDS))].to_bytes(4, "little" if random.integers(2) else "big")
    return data[:a] + word + data[a + 4 :]


def _set_token(random: np.random.Generator, data: bytes) -> bytes:
    places = [match.span() for match in _TOKEN.finditer(data)]
    if not places:
        return data
    a, b = places[random.integers(len(places))]
    return data[:a] + _TOKENS[random.integers(len(_TOKENS))] + data[b:]


def _set_columns(random: np.random.Generator, data: bytes) -> bytes:
    """As `_set_token`, but the columns after it stay in place."""
    places = [match.span() for match in _TOKEN.finditer(data)]
    if not places:
        return data
    a, b = places[random.integers(len(places))]
    return data[:a] + _TOKENS[random.integers(len(_TOKENS))].rjust(b - a)[: b - a] + data[b:]


def _swap_tokens(random: np.random.Generator, data: bytes) -> bytes:
    places = [match.span() for match in _TOKEN.finditer(data)]
    if len(places) < 2:
        return data
    (a, b), (c, d) = sorted(places[k] for k in random.choice(len(places), 2, replace=False))
    return data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:]


def _edit_lines(random: np.random.Generator, data: bytes) -> bytes:
    lines = data.splitlines(keepends=True)
    if not lines:
        return data
    k, n = int(random.integers(len(lines))), int(random.integers(len(lines)))
    which = random.integers(3)
    if which == 0:
        del lines[k]
    elif which == 1:
        lines.insert(n, lines[k])
    else:
        lines[k], lines[n] = lines[n], lines[k]
    return b"".join(lines)


_BYTE_EDITS = (_set_bytes, _insert, _delete, _repeat, _truncate, _set_word)
_TEXT_EDITS = (_set_token, _set_columns, _swap_tokens, _edit_lines)


# --- formats ------------------------------------------------------------------------------------------


def _cut_lines(path: Path, source: str, count: int) -> Path:
    lines = gnss_file(source).read_bytes().splitlines(keepends=True)[:count]
    path.write_bytes(b"".join(lines))
    return path


def _make_rinex(folder: Path, which: str) -> Case:
    """Six epochs of RINEX 2, or two of RINEX 3, with the records they need; one of the files is damaged."""
    if which.startswith("2"):
        seen = _cut_lines(folder / "site.05o", "07590920.05o", 17 + 6 * 9)
        sky = _cut_lines(folder / "site.05n", "07590920.05n", 8 + 40 * 8)
    else:
        lines = gnss_file("ESBC00DNK_2020177_GR_360s.rnx").read_bytes().splitlines(keepends=True)
        end = [k for k, line in enumerate(lines) if line.startswith(b">")][2]
        seen = folder / "site.rnx"
        seen.write_bytes(b"".join(lines[:end]))
        sky = _cut_lines(folder / "sky.rnx", "ESBC00DNK_2020177_GR_MN.rnx", 400)
    changed = seen if which.endswith("o") else sky

    def read(path: Path) -> object:
        files = (path, sky) if which.endswith("o") else (seen, path)
        solved = bench.solve_rinex(*files)
        solved.write_csv(folder / "fixes.csv")
        return solved.figures()

    quick = read_observations if which.endswith("o") else read_navigation
    return Case([changed], read, True, quick)


def _make_yuma(folder: Path) -> Case:
    path = folder / "yuma.txt"
    path.write_bytes(gnss_file("yuma_2022-02-17.txt").read_bytes()[:4000].rsplit(b"\n\n", 1)[0] + b"\n")
    return Case([path], lambda path: almanac.read_yuma(path, 1.3e9), text=True)


def _make_short_drive() -> dict[str, dict[str, np.ndarray]]:
    """The drive of the tests from 20 s on, 4 s: 10 Hz of the IMU, 5 Hz of the others."""
    whole = drives.sensed()

    def cut(columns: dict[str, np.ndarray], every: int) -> dict[str, np.ndarray]:
        rows = np.flatnonzero((columns["t"] > 20.0) & (columns["t"] <= 24.0))[::every]
        return {name: values[rows] for name, values in columns.items()}

    return {name: cut(columns, 10 if name == "imu" else 1) for name, columns in whole.items()}


_START = """
[alignment]
kind = "given"
roll_deg = 0.0
pitch_deg = 0.0
heading_deg = 20.0
[evaluation]
from_s = 0.0
withhold = 3
"""


def _make_log(folder: Path, form: str) -> Case:
    """A log in which one format gives the IMU, the fixes and, if it can, the barometer; it is navigated."""
    made = _make_short_drive()
    for name, sheet in (("imu", drives.IMU_SHEET), ("gnss", drives.GNSS_SHEET), ("baro", drives.BARO_SHEET)):
        (folder / f"{name}.toml").write_text(sheet)
    drives.write_csv(folder / "imu.csv", drives.imu_columns(made["imu"]))
    drives.write_csv(folder / "gnss.csv", drives.gnss_columns(made["gnss"]))
    tables = {"imu": drives.imu_columns(made["imu"]), "gnss": drives.gnss_columns(made["gnss"])}
    names, baro, binary, formats = {"imu": "imu.csv", "gnss": "gnss.csv"}, "", form != "csv", ""
    files: list[Path] = []
    if form == "parquet":
        names = {name: f"{name}.parquet" for name in tables}
        for name, columns in tables.items():
            parquet.write_frame(folder / names[name], columns)
    elif form == "ulog":
        test_log_formats.ulog(folder / "log.ulg", made)
        names, baro = dict.fromkeys(names, "log.ulg"), "log.ulg"
    elif form == "ros1":
        test_log_formats.rosbag(folder / "log.bag", made, ros2=False)
        names, baro = dict.fromkeys(names, "log.bag"), "log.bag"
    elif form == "ros2":
        test_log_formats.rosbag(folder / "log", made)
        names, baro = dict.fromkeys(names, "log"), "log"
        files = sorted((folder / "log").iterdir())
    elif form == "mcap":
        test_log_formats.rosbag(folder / "log", made, plugin=StoragePlugin.MCAP)
        shutil.copy(next((folder / "log").glob("*.mcap")), folder / "log.mcap")
        names, baro = dict.fromkeys(names, "log.mcap"), "log.mcap"
    elif form == "mcap-json":
        test_log_formats.json_mcap(folder / "log.mcap", made, CompressionType.NONE)
        names, baro = dict.fromkeys(names, "log.mcap"), "log.mcap"
    elif form == "navego":
        test_log_formats.navego(folder / "log.mat", made)
        names, formats = dict.fromkeys(names, "log.mat"), 'format = "navego"'
    elif form == "kf-gins":
        test_log_formats.kf_gins(folder, made)
        names, formats, binary = {name: f"{name}.txt" for name in names}, 'format = "kf-gins"', False
    elif form == "rtklib":
        test_log_formats.rtklib(folder / "log.pos", made)
        names, binary = {"imu": "imu.csv", "gnss": "log.pos"}, False
        start = test_log_formats.SINCE_1980
    more = f'[baro]\nfile = "{baro}"\n' if baro else ""
    shift = f"time_offset_s = {-start:.1f}" if form == "rtklib" else ""
    text = f"""
[imu]
file = "{names["imu"]}"
{formats}
[gnss]
file = "{names["gnss"]}"
{formats}
{shift}
{more}
[sensors.assumed]
imu = "imu.toml"
gnss = "gnss.toml"
baro = "baro.toml"
{_START}"""
    (folder / "drive.toml").write_text(text)
    if form == "toml":
        return Case([folder / "drive.toml"], lambda path: load_log(str(path)), text=True)
    files = files or sorted({folder / name for name in names.values() if name != "imu.csv" or form == "csv"})
    spec = load_log(str(folder / "drive.toml"))
    if form.startswith(("ros", "mcap")):
        imu = replace(spec.imu, time_offset=-test_log_formats.EPOCH)
        spec = replace(spec, imu=imu, gnss=SourceSpec(folder / "gnss.csv"), instruments={})
    return Case(
        files, lambda _: bench.navigate(folder / "drive.toml"), not binary, lambda _: read_records(spec)
    )


def _make_table(folder: Path, what: str) -> Case:
    """A trajectory, a solution or a log at rest, as CSV, Parquet or MATLAB file."""
    n, kind = 40, what.partition("-")[2]
    t = 0.1 * np.arange(n)
    columns = {"t_s": t, "lat_deg": 47.0 + 1e-5 * t, "lon_deg": 11.0 + 0 * t, "alt_m": 600.0 + t}
    columns |= {"roll_deg": 0 * t, "pitch_deg": 0 * t, "heading_deg": 20.0 + t}
    if what.startswith("solution"):
        columns |= {f"{stem}_{a}_m": 1.0 + 0 * t for stem in ("sd_pos",) for a in "ned"}
    if what.startswith("resting"):
        rest = 0.001 * np.random.default_rng(1).normal(size=(6, n)) + np.array([[0, 0, 0, 0, 0, -9.8]]).T
        columns = {"t_s": t} | {f"gyro_{a}_rad_s": rest[k] for k, a in enumerate("xyz")}
        columns |= {f"accel_{a}_m_s2": rest[3 + k] for k, a in enumerate("xyz")}
    path = folder / f"table.{kind}"
    if kind == "csv":
        drives.write_csv(path, columns)
    elif kind == "parquet":
        parquet.write_frame(path, columns)
    else:
        from scipy.io import savemat

        savemat(path, columns)
    readers: dict[str, Callable[[Path], object]] = {
        "trajectory": lambda path: list(read_trajectory(TableSpec("table", path, 10.0, None))),
        "solution": read_solution,
        "resting": read_resting_log,
    }
    return Case([path], readers[what.partition("-")[0]], text=kind == "csv")


def _copy(folder: Path, files: list[Path]) -> list[Path]:
    for k, path in enumerate(files):
        (folder / str(k)).mkdir()
        shutil.copy(path, folder / str(k))
    return sorted(folder.glob("*/*.toml"))


def _make_profiles(folder: Path) -> Case:
    """The shipped profiles."""
    return Case(_copy(folder, sorted(PROFILES.glob("*.toml"))), lambda path: read_profile(str(path)), True)


def _make_datasheets(folder: Path) -> Case:
    """The datasheets of the catalog."""
    sources = [path for path in sorted(CATALOG.glob("*/*.toml")) if path.parent.name in SENSORS]
    files = _copy(folder, sources)
    kinds = {folder / str(k) / path.name: path.parent.name for k, path in enumerate(sources)}
    return Case(files, lambda path: SENSORS[kinds[path]](path, path.name), True)


def _make_aircraft(folder: Path) -> Case:
    """The shipped aircraft."""
    names = [path.parent.name for path in sorted(AIRCRAFT.glob("*/aircraft.toml"))]
    for name in names:
        shutil.copytree(AIRCRAFT / name, folder / "aircraft" / name)
    files = [folder / "aircraft" / name / "aircraft.toml" for name in names]
    return Case(files, lambda path: library.read_aircraft(path.parent, folder), True)


def _make_results(folder: Path) -> Case:
    """A results folder, of which one file is damaged; read, exported, and used to score a solution."""
    exported.make_run(folder / "run", 15.0, 20.0)
    drives.write_csv(
        folder / "his.csv", {"t_s": np.arange(3.0), **{f"vel_{a}_mps": np.ones(3) for a in "ned"}}
    )

    def read(path: Path) -> object:
        run = bench.read_result(folder / "run")
        for record in ("truth", "sensed"):
            getattr(run, record)
        gather(folder / "run", ["truth", "solution:made"])
        return exchanging.score_solution(folder / "his.csv", folder / "run")

    return Case(sorted((folder / "run").iterdir()), read, text=False)


def _make_file(folder: Path, form: Format) -> Case:
    path = folder / form.name
    path.write_bytes(form.make())
    return Case([path], form.read, form.text)


def _make_folder(folder: Path, make: Callable[[Path], Made]) -> Case:
    files, read, edit = make(folder)
    return Case(files, read, text=False, edit=edit)


def _make_answers(folder: Path) -> Case:
    files, read, look = fuzz_answers.make_answers(folder)
    return Case(files, read, text=False, quick=look, edit=fuzz_answers.edit)


def _text_of_results(case: Case, path: Path) -> bool:
    return case.text or path.suffix in (".json", ".jsonl", ".yaml")


FORMATS: dict[str, Callable[[Path], Case]] = {
    **{f"rinex-{which}": lambda f, which=which: _make_rinex(f, which) for which in ("2o", "2n", "3o", "3n")},
    "yuma": _make_yuma,
    **{
        f"log-{form}": lambda f, form=form: _make_log(f, form)
        for form in (
            "csv", "parquet", "ulog", "ros1", "ros2", "mcap", "mcap-json", "navego", "kf-gins", "rtklib",
            "toml",
        )
    },
    **{
        what: lambda f, what=what: _make_table(f, what)
        for what in (
            "trajectory-csv", "trajectory-parquet", "trajectory-mat", "solution-csv", "solution-mat",
            "resting-csv",
        )
    },
    "profile": _make_profiles,
    "datasheet": _make_datasheets,
    "aircraft": _make_aircraft,
    "results": _make_results,
    "answer": _make_answers,
    **{name: lambda f, form=form: _make_file(f, form) for name, form in READERS.items()},
    **{name: lambda f, make=make: _make_folder(f, make) for name, make in FOLDERS.items()},
}  # fmt: skip
"""Format -> the function that makes its base in a folder."""


# --- outcomes -----------------------------------------------------------------------------------------


def judge(read: Callable[[Path], object], path: Path) -> tuple[str, str]:
    """Read a file; return "read", "rejected" or "failed", and what was raised."""
    begun = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            read(path)
        outcome = "read", ""
    except BenchError as error:
        lines = [line for message in error.messages for line in message.split("\n  ")]
        plain = all(line and "\n" not in line and len(line) < 2000 for line in lines)
        outcome = ("refused" if plain and lines and error.status != BUG else "failed"), repr(error)[:300]
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        outcome = "failed", f"{type(error).__name__} at {place.filename}:{place.lineno}: {error}"[:300]
    if time.process_time() - begun > LONGEST:
        outcome = "failed", f"more than {LONGEST:g} s"
    return outcome


def run(
    name: str, seed: int, numbers: range, folder: Path, *, quick: bool = False
) -> tuple[Counter[str], list[str]]:
    """Damage and read the inputs of a format; return the counts of outcomes, and the failures."""
    case = FORMATS[name](folder)
    read = case.quick if quick and case.quick is not None else case.read
    wholes = [path.read_bytes() for path in case.files]
    read(case.files[0])  # kernels are compiled here
    outcome, why = judge(read, case.files[0])
    if outcome != "read":
        raise AssertionError(f"{name}: the base is not accepted: {why}")
    counts, failures = Counter[str](), []
    for number in numbers:
        random = np.random.default_rng([seed, zlib.crc32(name.encode()), number])
        k = int(random.integers(len(case.files)))
        path = case.files[k]
        if case.edit is not None and random.random() < 0.7:
            damaged = case.edit(random, path, wholes[k])
        else:
            damaged = damage(random, wholes[k], _text_of_results(case, path))
        path.write_bytes(damaged)
        outcome, why = judge(read, path)
        path.write_bytes(wholes[k])
        counts[outcome] += 1
        if outcome == "failed":
            failures.append(f"{name} --seed {seed} --only {number} ({path.name}): {why}")
    return counts, failures


def main() -> int:
    """Run the formats named on the command line; return 1 if an input failed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("formats", nargs="*", metavar="FORMAT", help=", ".join(FORMATS))
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", type=int)
    asked = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    bad = 0
    for name in asked.formats or FORMATS:
        numbers = range(asked.count) if asked.only is None else range(asked.only, asked.only + 1)
        with tempfile.TemporaryDirectory(prefix="bench-fuzz-") as folder:
            begun = time.process_time()
            counts, failures = run(name, asked.seed, numbers, Path(folder))
        spent = time.process_time() - begun
        print(f"{name}: {dict(counts)}, {spent:.0f} s", flush=True)
        print("".join(f"  {failure}\n" for failure in failures[:50]), end="", flush=True)
        bad += len(failures)
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
