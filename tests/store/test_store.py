"""What is written comes back bit for bit, appears as a whole or not at all, and a truth is flown again when
anything it depends on changed or its files are damaged."""

from __future__ import annotations

import dataclasses
import errno
import json
import math
import os
import re
import shutil
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from numpy.testing import assert_array_equal

import bench
from bench.core.files import disk_arrays, places
from bench.core.records.data import (
    Events,
    GnssFixes,
    ImuData,
    InitialState,
    Innovations,
    NavSolution,
    SensorData,
    Trajectory,
    no_events,
    no_innovations,
)
from bench.core.records.flight_specs import FlightSpec
from bench.core.records.instruments import AirspeedData, BaroData, MagData
from bench.core.records.rotor_speeds import Rotors, no_rotors
from bench.core.records.run_records import ErrorSeries, Sensed, SensorTruth
from bench.core.records.run_result import RunResult
from bench.core.words.exceptions import BenchError
from bench.io import config, results
from bench.io.results import cache_size, truth_cache
from tests.exchange.exported import make_run
from tests.synthetic import turning
from tests.test_house import PACKAGE, imported, modules

RNG = np.random.default_rng(3)


def equal(one: object, other: object) -> None:
    """Every column of two records is the same, bit for bit, and of the same kind."""
    assert type(one) is type(other)
    for field in dataclasses.fields(one):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if isinstance(a, np.ndarray):
            assert a.dtype == b.dtype, field.name
            assert_array_equal(a, b, err_msg=field.name, strict=True)
        elif dataclasses.is_dataclass(a):
            equal(a, b)
        elif isinstance(a, dict):
            assert a.keys() == b.keys()
            for key in a:
                assert_array_equal(a[key], b[key], err_msg=key)
        else:
            assert a == b, field.name


@pytest.fixture(scope="module")
def truth() -> Trajectory:
    flown = turning(4.0, 100.0)
    legs = Events(
        np.array([0.0, 2.0]), np.array([2.0, 4.0]), ("leg", "leg"), ("1 straight", "2 turn: 90 °"), ("", "")
    )
    speed = 400.0 + np.random.default_rng(2).normal(size=(len(flown.t), 4)).cumsum(axis=0)
    return dataclasses.replace(flown, events=legs, rotors=Rotors(flown.t, speed))


@pytest.fixture(scope="module")
def spec() -> FlightSpec:
    return config.read_profile("figure-eight").flight


def solution(m: int, extra: tuple[str, ...], innovations: Innovations) -> NavSolution:
    """A solution of noise; its covariance is not even symmetric: a store changes nothing."""
    cov = RNG.normal(size=(m, 9, 9))
    cov[0, 0, 0] = np.nan
    return NavSolution(
        t=np.arange(m) / 10,
        lla=RNG.normal(size=(m, 3)),
        vel_n=RNG.normal(size=(m, 3)),
        q_nb=RNG.normal(size=(m, 4)),
        gyro_bias_b=RNG.normal(size=(m, 3)),
        accel_bias_b=np.full((m, 3), np.nan),
        cov=cov,
        extra_names=extra,
        extra=RNG.normal(size=(m, len(extra))),
        extra_sd=RNG.normal(size=(m, len(extra))),
        innovations=innovations,
    )


@pytest.fixture(scope="module")
def sensed(truth: Trajectory) -> Sensed:
    n, m, profile = len(truth) - 1, 5, config.read_profile("figure-eight")
    t = np.arange(m) * 1.0
    flags = np.array([True, True, False, True, True])
    data = SensorData(
        imu=ImuData(truth.t[1:], np.full(n, 0.01), np.ones(n, bool), truth.dtheta_b, truth.dvel_b),
        fixes=GnssFixes(
            t,
            t + 0.1,
            flags,
            RNG.normal(size=(m, 3)),
            RNG.normal(size=(m, 3)),
            RNG.normal(size=(m, 3, 3)),
            RNG.normal(size=(m, 3, 3)),
            np.arange(m),
        ),
        baro=BaroData(t, t, flags, RNG.normal(size=m), np.full(m, 0.5)),
        antenna_b=np.zeros(3),
        specs=profile.sensors.assumed,
        output_t=np.arange(41) / 10,
        mag=MagData(t, t + 0.05, flags, RNG.normal(size=(m, 3)), np.full(m, 1e-7)),
        airspeed=AirspeedData(t, t, flags, RNG.normal(size=m), np.full(m, 0.3)),
        date=2025.5,
    )
    initial = InitialState(0.0, np.zeros(3), np.zeros(3), np.array([1.0, 0, 0, 0]), np.eye(9), "given")
    drawn = SensorTruth(
        t,
        *RNG.normal(size=(2, m, 3)),
        {name: RNG.normal(size=(m, width)) for name, width in (("baro", 1), ("mag", 3), ("airspeed", 1))},
    )
    outage = Events(np.array([2.0]), np.array([3.0]), ("gnss_outage",), ("scripted",), ("gnss",))
    return Sensed(data, initial, drawn, outage)


@pytest.fixture(scope="module")
def result(truth, sensed) -> RunResult:
    k = 6
    innovations = Innovations(
        np.repeat([1.0, 2.0], 3),
        ("gnss_position", "baro", "gnss_velocity"),
        np.array([2, 2, 2, 0, 0, 1]),
        np.array([0, 1, 2, 0, 1, 0]),
        RNG.normal(size=k),
        RNG.uniform(size=k),
        RNG.uniform(size=k),
        np.array([True, True, False, True, True, True]),
    )
    m = 41
    errors = ErrorSeries(
        np.arange(m) / 10,
        *(RNG.normal(size=(m, 3)) for _ in range(3)),
        RNG.normal(size=m),
        np.full(m, np.nan),
        9,
    )
    events = Events(np.array([0.5]), np.array([0.5]), ("timeline",), ("1 row left out",), ("imu",))
    loose = dataclasses.replace(solution(m, ("gyro_bias_x_rad_s", "baro_bias_m"), innovations), events=events)
    return RunResult(
        profile={
            "title": "a",
            "leg": [{"kind": "turn"}],
            "evaluation": {"from_s": 0.0, "output_hz": 10.0},
        },
        seed=7,
        run=2,
        metrics={
            "loose-15": {"converged": True, "nees_mean": 9.5},
            "free": {"converged": False, "cep50_m": None},
        },
        errors={"loose-15": errors, "free": errors},
        solutions={"loose-15": loose, "free": solution(m, (), no_innovations())},
        provenance={"versions": {"bench": "0"}},
        records={"truth": truth, "sensed": sensed},
    )


# --- the results folder -------------------------------------------------------------------------------


@pytest.fixture
def saved(tmp_path, result) -> Path:
    with results.make_folder(tmp_path / "runs" / "one") as partial:
        results.save(partial, result)
    return tmp_path / "runs" / "one"


def test_what_is_saved_comes_back(saved, result, truth, sensed):
    again = results.read_result(saved)
    for name in ("profile", "seed", "run", "metrics", "provenance"):
        assert getattr(again, name) == getattr(result, name)
    assert set(again.solutions) == set(again.errors) == {"loose-15", "free"}
    for label in result.solutions:
        equal(again.solutions[label], result.solutions[label])
        equal(again.errors[label], result.errors[label])
    equal(again.truth, truth)
    equal(again.sensors, sensed.data)
    equal(again.sensed, sensed)
    assert again.events.kind == result.events.kind
    imu, fixes, instruments = results.load_sensors(saved)
    equal(imu, sensed.data.imu)
    equal(fixes, sensed.data.fixes)
    assert instruments.keys() == {"baro", "mag", "airspeed"}
    for name, record in instruments.items():
        equal(record, getattr(sensed.data, name))


def test_results_without_rotors_have_none(saved, tmp_path, result, truth):
    """Folders of a bench that did not write them, and of flights without rotors, which write no file."""
    (saved / "truth-rotors.parquet").unlink()
    again = results.read_result(saved).truth
    equal(again, dataclasses.replace(truth, rotors=no_rotors()))
    results.save(tmp_path, dataclasses.replace(result, records={**result.records, "truth": again}))
    assert not (tmp_path / "truth-rotors.parquet").exists()
    assert (tmp_path / "truth-air.parquet").exists()
    with pytest.raises(ValueError, match=r"Trajectory\.rotors: 3 rows for 401 times"):
        dataclasses.replace(truth, rotors=Rotors(truth.t[:3], truth.rotors.speed[:3]))


@pytest.mark.parametrize("values", [1, 300])
def test_what_is_saved_in_groups_of_rows_comes_back(tmp_path, monkeypatch, result, truth, sensed, values):
    monkeypatch.setattr(results.parquet, "GROUP", values)
    monkeypatch.setattr(disk_arrays, "LARGE", 0)
    results.save(tmp_path, result)
    again = results.read_result(tmp_path)
    equal(again.solutions["loose-15"], result.solutions["loose-15"])
    equal(again.errors["loose-15"], result.errors["loose-15"])
    equal(again.truth, truth)
    equal(again.sensed, sensed)


def test_a_csv_written_in_groups_of_rows_is_that_written_at_once(tmp_path, monkeypatch, sensed):
    imu, written = sensed.data.imu, []
    for values in (1 << 21, 1000):
        monkeypatch.setattr(results.parquet, "GROUP", values)
        results.parquet.write_csv(tmp_path / "imu.csv", imu, results.parquet.layout_of(imu))
        written.append((tmp_path / "imu.csv").read_bytes())
    assert written[0] == written[1]
    assert written[0].count(b"\n") == len(imu) + 1 > 300


def test_sensors_that_are_not_on_board_have_no_file(tmp_path, result, truth, sensed):
    none = dict.fromkeys(("fixes", "baro", "mag", "airspeed"))
    bare = dataclasses.replace(sensed, data=dataclasses.replace(sensed.data, **none))
    results.save(tmp_path, dataclasses.replace(result, records={"truth": truth, "sensed": bare}))
    assert results.load_sensors(tmp_path)[1:] == (None, {})


def test_every_column_has_a_unit_and_every_vector_a_frame(saved):
    files = list(saved.glob("*.parquet"))
    assert len(files) == 20
    for path in files:
        for field in pq.read_schema(path):
            metadata = {key.decode(): value.decode() for key, value in field.metadata.items()}
            assert metadata["unit"], (path.name, field.name)
            if field.name.endswith(("_n_mps", "_x_rad", "_q_nb_w", "lat_rad", "_x_m_s2", "cov_pos_n_phi_d")):
                assert metadata["frame"], (path.name, field.name)
    schema = pq.read_schema(saved / "solution-loose-15.parquet")

    def says(name):
        return {key.decode(): value.decode() for key, value in schema.field(name).metadata.items()}

    assert says("vel_n_mps") == {"unit": "m/s", "frame": "n"}
    assert says("gyro_bias_x_rad_s") == {"unit": "rad/s", "frame": "b"}
    assert says("cov_pos_n_phi_d") == {"unit": "m rad", "frame": "n"}
    assert says("state_baro_bias_m") == says("sd_baro_bias_m") == {"unit": "m"}


def test_no_bare_nan_in_json(tmp_path):
    value = {
        "a": float("nan"),
        "b": np.float64("inf"),
        "c": np.array([1.0, np.nan]),
        "d": (np.int64(3), True),
    }
    assert json.loads(results.to_json(value)) == {"a": None, "b": None, "c": [1.0, None], "d": [3, True]}
    results.write_json(tmp_path / "a.json", value)
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]


def test_json_is_replaced_as_a_whole(tmp_path):
    results.write_json(tmp_path / "a.json", {"old": 1})
    with pytest.raises(TypeError):
        results.write_json(tmp_path / "a.json", {"new": object()})
    assert json.loads((tmp_path / "a.json").read_text()) == {"old": 1}
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]


@pytest.mark.parametrize("failure", [OSError(errno.ENOSPC, "No space left on device"), KeyboardInterrupt()])
def test_a_failure_leaves_nothing_behind(tmp_path, failure):
    def fail() -> None:
        with results.make_folder(tmp_path / "one") as partial:
            (partial / "truth.parquet").write_text("half")
            raise failure

    with pytest.raises(type(failure)):
        fail()
    assert list(tmp_path.iterdir()) == []


def fill(folder: Path, name: str, *, force: bool = False, kind: str = "results folder") -> None:
    with results.make_folder(folder, force=force, kind=kind) as partial:
        (partial / name).touch()


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_folder_that_exists_is_replaced_only_when_asked(tmp_path):
    folder = tmp_path / "one"
    fill(folder, "old")
    with pytest.raises(BenchError, match="another run"):
        fill(folder, "new")
    with pytest.raises(OSError, match="full"), results.make_folder(folder, force=True):
        raise OSError("full")
    assert names(folder) == [".bench.json", "old"]
    fill(folder, "new", force=True)
    assert names(folder) == [".bench.json", "new"]
    assert json.loads((folder / ".bench.json").read_text()) == {
        "bench": bench.__version__,
        "kind": "results folder",
        "files": ["new"],
    }
    assert list(tmp_path.iterdir()) == [folder]


FOREIGN = {
    "no mark": (lambda folder: (folder / ".bench.json").unlink(), "bench did not write it (no .bench.json"),
    "a mark of others": (lambda folder: (folder / ".bench.json").write_text("[1]"), "bench did not write it"),
    "a file": (lambda folder: (folder / "notes.txt").touch(), "bench did not write notes.txt in it"),
    "a folder": (lambda folder: (folder / "mine").mkdir(), "bench did not write mine in it"),
    "a file below": (
        lambda folder: (folder / "sub" / "b").write_text("b"),
        "bench did not write sub/b in it",
    ),
    "a link": (lambda folder: (folder / "link").symlink_to("result.json"), "bench did not write link in it"),
}


@pytest.mark.parametrize("what", FOREIGN)
def test_a_folder_that_is_not_all_of_bench_is_never_replaced(tmp_path, what):
    """A file named result.json makes no results folder; what a user put into one is not deleted with it."""
    folder = tmp_path / "one"
    with results.make_folder(folder) as partial:
        (partial / "result.json").touch()
        (partial / "sub").mkdir()
        (partial / "sub" / "a").touch()
    results.check_folder(folder, force=True)
    change, reason = FOREIGN[what]
    change(folder)
    before = sorted(folder.rglob("*"))
    for force in (False, True):
        with pytest.raises(BenchError, match=re.escape(f"{folder}: not replaced, {reason}")):
            results.check_folder(folder, force=force)
        with pytest.raises(BenchError, match="not replaced"):
            fill(folder, "new", force=force)
    assert sorted(folder.rglob("*")) == before
    assert list(tmp_path.iterdir()) == [folder]


def test_results_and_exports_do_not_replace_each_other(tmp_path):
    fill(tmp_path / "one", "a", kind="export")
    with pytest.raises(BenchError, match="not replaced, it is no results folder"):
        results.check_folder(tmp_path / "one", force=True)
    results.check_folder(tmp_path / "one", force=True, kind="export")


def test_a_folder_that_cannot_be_made_is_told_before_the_flight(tmp_path, monkeypatch):
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    (here / "file").touch()
    (here / "empty").mkdir()
    (here / "link").symlink_to("empty")
    (here / "nowhere").symlink_to("absent")
    (here / "loop").symlink_to("loop")
    wrong = {
        ".": "the present folder is not replaced",
        "..": "the present folder is not replaced, nor one that contains it",
        "link": "a symbolic link",
        "nowhere": "a symbolic link",
        "loop": "Too many levels of symbolic links",
        "file": "a file is there",
        "file/a": "no folder can be made in",
        "/proc": "a mount point",
        "/proc/a": "no folder can be made in /proc",
        "x" * 256: "File name too long",
        "/".join(["x" * 200] * 20): "File name too long",
    }
    for name, reason in wrong.items():
        for force in (False, True):
            with pytest.raises(BenchError, match=f"{re.escape(name)}: .*{re.escape(reason)}") as caught:
                results.check_folder(Path(name), force=force)
            assert "\n" not in str(caught.value)
    for name in ("empty", "new", "new/er", "x" * 255):
        results.check_folder(Path(name), force=False)
        fill(Path(name), "a")
    assert names(here) == sorted(["file", "empty", "link", "nowhere", "loop", "new", "x" * 255])


def test_a_failure_takes_back_the_folders_above(tmp_path):
    (tmp_path / "a").mkdir()
    with pytest.raises(KeyboardInterrupt), results.make_folder(tmp_path / "a" / "b" / "c"):
        raise KeyboardInterrupt
    assert list((tmp_path / "a").iterdir()) == []


def test_only_results_of_a_bench_not_newer_are_read(saved):
    path = saved / "result.json"
    text = path.read_text()
    summary = json.loads(text)
    assert summary["format"] == 2
    assert summary["provenance"]["versions"]["bench"] == "0"
    old = json.dumps({key: value for key, value in summary.items() if key != "format"})
    wrong = {
        old: "format 1, expected format 2. Run: bench upgrade",
        "[]": "not written by bench",
        "{": "not written by bench",
        '{"format": 2, "metrics": {}}': "not written by bench",
        '{"format": 2, "profile": {"title": "a", "evaluation": {"output_hz": 10}}, "seed": 1, "run": 0, '
        '"metrics": {}, '
        '"provenance": {}}': "profile.evaluation.from_s must be a number",
        "[" * 100_000: "not written by bench",
        json.dumps({**summary, "format": 3}): "format 3, expected format 2: written by a newer bench",
        json.dumps({key: value for key, value in summary.items() if key != "seed"}): "it has no 'seed'",
    }
    for content, reason in wrong.items():
        path.write_text(content)
        with pytest.raises(BenchError, match=reason) as caught:
            results.read_result(saved)
        assert "\n" not in str(caught.value)
    path.unlink()
    for folder, reason in (
        (saved, r"not a results folder, .* result\.json"),
        (saved / "absent", r"not a results folder, .* result\.json"),
        (saved / "truth.parquet", "is a file; name its folder"),
    ):
        with pytest.raises(BenchError, match=reason):
            results.read_result(folder)


def test_a_copy_of_results_holds_only_files_of_bench(saved, tmp_path):
    (saved / "notes.txt").touch()
    (saved / "flight.rrd").touch()
    (tmp_path / "copy").mkdir()
    results.copy_results(saved, tmp_path / "copy")
    assert names(tmp_path / "copy") == [
        name for name in names(saved) if name not in ("notes.txt", "flight.rrd", ".bench.json")
    ]
    results.read_result(tmp_path / "copy")


def test_provenance_names_what_can_move_a_number():
    said = results.provenance()
    assert set(said["versions"]) == {"bench", "python", "numpy", "scipy", "numba", "jsbsim"}
    json.dumps(said)


def test_the_hash_of_sensors_moves_with_every_figure_and_with_nothing_else():
    sensors = config.read_profile("figure-eight").sensors
    said = results.hash_spec(sensors)
    assert said == results.hash_spec(config.read_profile("figure-eight").sensors)
    for name, figure in (("imu", "accel_arms"), ("gnss", "latency"), ("baro", "bias_sd")):
        spec = getattr(sensors, name)
        before = getattr(spec, figure)
        moved = ((0.01, 0.0, 0.0),) * 3 if figure == "accel_arms" else before + 1e-9
        other = dataclasses.replace(sensors, **{name: dataclasses.replace(spec, **{figure: moved})})
        assert results.hash_spec(other) != said, name


# --- the truth cache ----------------------------------------------------------------------------------


@pytest.fixture
def cache(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("BENCH_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache" / "truth"


class Flights:
    """Counts how often the truth is flown; gives it in pieces."""

    def __init__(self, *pieces: Trajectory) -> None:
        self.pieces, self.count = pieces, 0

    def __call__(self) -> Iterator[Trajectory]:
        self.count += 1
        return iter(self.pieces)


def cut(truth: Trajectory, *rows: int) -> list[Trajectory]:
    """A truth in pieces that end at these rows; air and controls follow by time, events come last."""
    pieces = []
    for start, stop in pairwise((0, *rows, len(truth) - 1)):
        after = truth.t[start] if start else -np.inf
        parts = {}
        for name in ("air", "controls"):
            part = getattr(truth, name)
            taken = (part.t > after) & (part.t <= truth.t[stop])
            columns = {f.name: getattr(part, f.name)[taken] for f in dataclasses.fields(part)}
            parts[name] = dataclasses.replace(part, **columns)
        points = {name: getattr(truth, name)[start : stop + 1] for name in ("t", "lla", "vel_n", "q_nb")}
        between = {name: getattr(truth, name)[start:stop] for name in ("dtheta_b", "dvel_b")}
        events = truth.events if stop == len(truth) - 1 else no_events()
        spun = Rotors(points["t"], truth.rotors.speed[start : stop + 1])
        pieces.append(Trajectory(**points, **between, **parts, events=events, rotors=spun))
    return pieces


def test_a_truth_is_flown_once_and_mapped_from_disk(cache, spec, truth):
    flights = Flights(truth)
    for _ in range(3):
        equal(results.cached_truth(spec, flights), truth)
    assert flights.count == 1
    cached = results.cached_truth(spec, flights)
    column = cached.lla
    while not isinstance(column, np.memmap):
        column = column.base
        assert column is not None, "lla is a copy"
    assert not cached.lla.flags.writeable
    (entry,) = cache.iterdir()
    assert len(entry.name) == 32


def test_pieces_become_the_files_that_the_whole_becomes(cache, spec, truth):
    results.cached_truth(spec, Flights(truth))
    (entry,) = cache.iterdir()
    whole = {path.name: path.read_bytes() for path in entry.iterdir()}
    for name, array in truth_cache.get_columns(truth).items():
        np.save(cache / "column.npy", array)
        assert whole[f"{name}.npy"] == (cache / "column.npy").read_bytes(), name
    (cache / "column.npy").unlink()
    shutil.rmtree(entry)
    flights = Flights(*cut(truth, 1, 150, 151, 399))
    equal(results.cached_truth(spec, flights), truth)
    assert {path.name: path.read_bytes() for path in entry.iterdir()} == whole


@pytest.mark.parametrize("size", [7, 100, 400, 6000])
def test_a_truth_is_read_in_pieces(cache, spec, truth, monkeypatch, size):
    monkeypatch.setattr(truth_cache, "PIECE", size)
    flights = Flights(*cut(truth, 250))
    for _ in range(2):
        pieces = list(results.truth_pieces(spec, flights))
        assert len(pieces) == math.ceil(400 / size)
        assert all(len(piece) == size + 1 for piece in pieces[:-1])
        assert not any(len(piece.events) for piece in pieces[:-1])
        equal(truth_cache.join_pieces(pieces), truth)
    assert flights.count == 1


def test_what_is_said_of_a_truth_is_kept_beside_it(cache, spec, truth):
    """Made once; made anew when it is damaged, when its sources change, and when the truth is damaged."""
    flights, calls = Flights(truth), []

    def say(pieces):
        calls.append(sum(len(piece) - 1 for piece in pieces) + 1)
        return {"samples": calls[-1], "legs": [(0.0, 1.5, "climb")]}

    def said(*sources):
        return results.cached_summary(spec, flights, say, sources)

    first = said("bench/evaluation/errors/replay.py")
    assert first == {"samples": 401, "legs": [[0.0, 1.5, "climb"]]}
    assert said("bench/evaluation/errors/replay.py") == first
    assert (calls, flights.count) == ([401], 1)
    said("bench/evaluation/errors/replay.py", "bench/core/mathematics/rotation.py")
    assert (calls, flights.count) == ([401] * 2, 1)
    (entry,) = cache.iterdir()
    edits = ('{"samples"', "[]", '{"samples": 3}', "", "x" * 64 + '\n{"samples": 3}')
    for count, text in enumerate(edits, 3):
        for path in entry.glob("summary-*.json"):
            path.write_text(text)
        assert said("bench/evaluation/errors/replay.py") == first
        assert (calls, flights.count) == ([401] * count, 1)
    _flip(entry / "lla.npy")
    assert said("bench/evaluation/errors/replay.py") == first
    assert (calls, flights.count) == ([401] * (count + 1), 2)


def test_a_cache_that_cannot_be_written_costs_no_truth(cache, spec, truth, caplog):
    cache.parent.write_text("no folder")
    flights = Flights(*cut(truth, 100, 200))
    equal(truth_cache.join_pieces(results.truth_pieces(spec, flights)), truth)
    equal(results.cached_truth(spec, flights), truth)
    assert results.cached_summary(spec, flights, lambda pieces: {"pieces": len(list(pieces))}, ()) == {
        "pieces": 3
    }
    assert "is not cached" in caplog.text


def test_a_truth_without_events_is_cached_too(cache, spec, truth):
    none = dataclasses.replace(truth, events=Events.from_rows([]))
    flights = Flights(none)
    for _ in range(2):
        equal(results.cached_truth(spec, flights), none)
    assert flights.count == 1


def _truncate(path):
    path.write_bytes(path.read_bytes()[:-100])


def _flip(path):
    text = bytearray(path.read_bytes())
    text[-9] ^= 1
    path.write_bytes(bytes(text))


@pytest.mark.parametrize("damage", [_truncate, _flip, Path.unlink, lambda p: p.write_bytes(b"")])
@pytest.mark.parametrize("name", ["lla.npy", "air.t.npy", "texts.json", "index.json"])
def test_a_damaged_entry_is_told_and_flown_again(cache, spec, truth, damage, name, caplog):
    flights = Flights(truth)
    results.cached_truth(spec, flights)
    (entry,) = cache.iterdir()
    damage(entry / name)
    equal(results.cached_truth(spec, flights), truth)
    assert flights.count == 2
    equal(results.cached_truth(spec, flights), truth)
    assert flights.count == 2
    damage(entry / name)
    equal(truth_cache.join_pieces(results.truth_pieces(spec, flights)), truth)
    assert flights.count == 3
    assert list(cache.iterdir()) == [entry]
    told = f"the truth in {entry} is damaged; it is flown again"
    absent = name == "index.json" and damage is Path.unlink  # then there is no entry
    assert caplog.messages == ([] if absent else [told] * 2)


def test_nothing_is_unpickled(cache, spec, truth):
    """An entry whose column is a pickle is flown again, not executed."""
    flights = Flights(truth)
    results.cached_truth(spec, flights)
    (entry,) = cache.iterdir()
    np.save(entry / "lla.npy", np.array([print], dtype=object), allow_pickle=True)
    index = cache_size.read_hashed(entry / "index.json")
    index["lla.npy"] = truth_cache.hash_file(entry / "lla.npy")
    cache_size.write_hashed(entry / "index.json", index)
    equal(results.cached_truth(spec, flights), truth)
    assert flights.count == 2


def test_a_failed_flight_or_write_leaves_no_entry(cache, spec, truth, monkeypatch, caplog):
    def crash():
        raise RuntimeError("ground")

    with pytest.raises(RuntimeError):
        results.cached_truth(spec, crash)

    def full(*args, **keywords):
        raise OSError(errno.ENOSPC, "No space left on device")

    def crash_later():
        yield from cut(truth, 100)[:1]
        raise RuntimeError("ground")

    for fly in (crash, crash_later):
        with pytest.raises(RuntimeError):
            list(results.truth_pieces(spec, fly))
    with pytest.raises(RuntimeError):
        results.cached_truth(spec, crash_later)
    assert list(cache.iterdir()) == []
    monkeypatch.setattr(truth_cache.GrowingColumn, "append", full)
    equal(results.cached_truth(spec, Flights(*cut(truth, 100))), truth)
    assert list(cache.iterdir()) == []
    assert "No space left on device" in caplog.text


MAKE_NO_TRUTH = {
    "bench.core.compilation.call_at": "calls kernels that are listed",
    "bench.core.compilation.compiled": "makes machine code of functions that are listed",
    "bench.core.files.disk_arrays": "where arrays lie, not what they hold",
    "bench.core.files.durable": "writes files",
    "bench.core.words.exceptions": "messages",
    "bench.core.files.file_checks": "rejects files",
    "bench.io.logs.file_kinds": "names files that are rejected",
    "bench.io.logs.rows": "of logs",
    "bench.core.compilation.inner_numba": "makes machine code of functions that are listed",
    "bench.core.compilation.kernel_locks": "who compiles a kernel",
    "bench.core.records.instruments": "of the sensors",
    "bench.core.records.orbit_sets": "of the receivers",
    "bench.core.records.run_records": "of the sensors and the filters",
    "bench.core.records.sensor_specs": "of the sensors",
    "bench.core.records.sky_spec": "of the receivers",
    "bench.core.files.memory_limit": "limits",
    "bench.core.files.places": "where files lie",
    "bench.core.files.scratch": "folders for a while",
    "bench.core.files.spawned": "starts processes",
    "bench.simulation.signals.air": "of the receivers",
    "bench.simulation.signals.gps_time": "of the receivers",
    "bench.simulation.signals.orbits": "of the receivers",
    "bench.core.compilation.vector_rows": "makes machine code of functions that are listed",
    "bench.core.words.renames": "messages",
    "bench.core.words.wording": "messages",
}
"""Modules that flights and tracks import and truth does not depend on -> why."""


def test_every_module_that_makes_truth_counts_in_the_key():
    known = modules()
    todo = [name for name in known if name.startswith("bench.simulation.flight.")]
    assert todo, "the flight is found nowhere"
    todo.append("bench.io.trajectories.trajectory")
    found = set()
    while todo:
        name = todo.pop()
        if name not in found and name != "bench":
            found.add(name)
            todo += imported(name, known[name], known)
    sources = [places.locate_source(name) for name in truth_cache.SOURCES]
    uncounted = {name for name in found if not {known[name], *known[name].parents} & {*sources}}
    assert uncounted == set(MAKE_NO_TRUTH)


def test_the_key_follows_everything_truth_depends_on(spec, tmp_path, monkeypatch):
    own = dataclasses.replace(spec.aircraft, folder=tmp_path / "aircraft", systems=tmp_path / "systems")
    shutil.copytree(spec.aircraft.folder, own.folder)
    shutil.copytree(spec.aircraft.systems, own.systems)
    here = dataclasses.replace(spec, aircraft=own)
    start = truth_cache.truth_key(here)
    assert truth_cache.truth_key(here) == start
    seen = {start}

    def moved(flight: FlightSpec = here) -> bool:
        key = truth_cache.truth_key(flight)
        new = key not in seen
        seen.add(key)
        return new

    changes = {
        "lat": 0.5,
        "speed": 26.0,
        "severity": 3,
        "turbulence_seed": 1,
        "duration": None,
        "legs": spec.legs[:-1],
        "rate": 100.0,
    }
    for name, value in changes.items():
        assert moved(dataclasses.replace(here, **{name: value})), name
    gains = dict(own.gains) | {"bank-gain": 4.0}
    assert moved(dataclasses.replace(here, aircraft=dataclasses.replace(own, gains=gains)))
    assert moved(dataclasses.replace(here, aircraft=dataclasses.replace(own, imu_b=(0.0, 0.1, 0.0))))
    for path in (own.folder / f"{own.name}.xml", own.systems / "guidance.xml"):
        path.write_text(path.read_text() + "\n")
        assert moved(), path.name
    monkeypatch.setattr(truth_cache, "list_versions", lambda: {"jsbsim": "2"})
    assert moved()


@pytest.mark.parametrize("flown_by", [(), ("a filter",)], ids=["by the truth", "by an estimate"])
def test_the_key_follows_every_module_that_makes_truth(spec, tmp_path, monkeypatch, flown_by):
    """A module that is not there is never just left out."""
    package = tmp_path / "bench"
    shutil.copytree(PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__", "*.png", "guide"))
    monkeypatch.setattr(places, "PACKAGE", package)
    seen = {truth_cache.truth_key(spec, flown_by)}
    for name in (*truth_cache.SOURCES, *(truth_cache.LOOP_SOURCES if flown_by else ())):
        place = places.locate_source(name)
        for file in [place] if place.is_file() else sorted(place.rglob("*.py"))[-1:]:
            file.write_bytes(file.read_bytes() + b"\n")
            key = truth_cache.truth_key(spec, flown_by)
            assert key not in seen, name
            seen.add(key)
    places.locate_source(truth_cache.SOURCES[-1]).unlink()
    with pytest.raises(ImportError, match=truth_cache.SOURCES[-1]):
        truth_cache.truth_key(spec, flown_by)


def test_entries_nobody_reads_are_removed(cache, spec, truth):
    results.cached_truth(spec, Flights(truth))
    (entry,) = cache.iterdir()
    old = entry.stat().st_mtime - 31 * 86400
    os.utime(entry, (old, old))
    results.cached_truth(dataclasses.replace(spec, speed=26.0), Flights(truth))
    assert entry not in list(cache.iterdir())
    assert len(list(cache.iterdir())) == 1


def test_an_index_that_was_changed_and_a_file_that_it_does_not_name_change_nothing(cache, spec, truth):
    flights = Flights(truth)
    results.cached_truth(spec, flights)
    (entry,) = cache.iterdir()
    np.save(entry / "own.npy", np.zeros(3))
    for _ in range(2):
        equal(truth_cache.join_pieces(results.truth_pieces(spec, flights)), truth)
        equal(results.cached_truth(spec, flights), truth)
    assert flights.count == 1
    text = (entry / "index.json").read_text()
    _flip(entry / "lla.npy")
    code = truth_cache.hash_file(entry / "lla.npy")
    (entry / "index.json").write_text(re.sub(r'("lla.npy": )"\w+"', rf'\1"{code}"', text))
    equal(results.cached_truth(spec, flights), truth)
    assert flights.count == 2


@pytest.fixture
def three(cache, spec, truth) -> list[Path]:
    """Three flights in the cache, the second one used last."""
    entries = []
    for k, speed in enumerate((25.0, 26.0, 27.0)):
        flight = dataclasses.replace(spec, speed=speed)
        results.cached_truth(flight, Flights(truth))
        entries.append(cache / truth_cache.truth_key(flight))
        os.utime(entries[-1], (time.time() - 100 + k,) * 2)
    results.cached_truth(dataclasses.replace(spec, speed=26.0), Flights(truth))
    return entries


def test_the_least_recently_used_flights_go_first(cache, spec, truth, three, monkeypatch):
    size = results.measure_cache().size / 3
    assert results.measure_cache()[1:] == (3, 3 * size, 2_000_000_000)
    results.trim_cache(int(2.5 * size))
    assert set(cache.iterdir()) == set(three[1:])
    monkeypatch.setenv("BENCH_CACHE_GB", str(2.5 * size / 1e9))
    fourth = dataclasses.replace(spec, speed=28.0)
    results.cached_truth(fourth, Flights(truth))
    assert set(cache.iterdir()) == {three[1], cache / truth_cache.truth_key(fourth)}
    monkeypatch.setenv("BENCH_CACHE_GB", "0")
    results.cached_truth(dataclasses.replace(spec, speed=29.0), Flights(truth))
    assert results.measure_cache().flights == 1
    results.trim_cache(0)
    assert list(cache.iterdir()) == []


def test_a_flight_that_is_being_read_stays(cache, spec, truth, three, monkeypatch):
    monkeypatch.setattr(truth_cache, "PIECE", 100)
    pieces = results.truth_pieces(dataclasses.replace(spec, speed=25.0), Flights(truth))
    first = next(pieces)
    results.trim_cache(0)
    assert list(cache.iterdir()) == [three[0]]
    equal(truth_cache.join_pieces([first, *pieces]), truth)
    results.trim_cache(0)
    assert list(cache.iterdir()) == []


def test_a_limit_that_is_no_number_is_told_before_the_flight(cache, spec, truth, monkeypatch):
    for text in ("x", "-1", "nan", "inf"):
        monkeypatch.setenv("BENCH_CACHE_GB", text)
        flights = Flights(truth)
        with pytest.raises(BenchError, match=r"BENCH_CACHE_GB = .* must be a number of GB"):
            results.cached_truth(spec, flights)
        assert flights.count == 0


# --- tables ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "circle"
    make_run(folder)
    return folder


def test_every_file_of_a_folder_is_a_table_of_the_result(folder):
    """The columns of the table are those of the file, in value and metadata."""
    loaded = bench.read_result(folder)
    names = {"truth": "truth", "truth-air": "air", "truth-controls": "controls", "truth-rotors": "rotors"}
    for path in folder.glob("*.parquet"):
        kind, _, name = path.stem.partition("-")
        if path.stem.endswith("events") or kind == "events":
            continue
        record = names.get(path.stem) or {"solution": "solutions"}.get(kind) or kind
        table = bench.to_arrow(loaded, *((name,) if kind == "sensors" else (record, name or None)))
        stored = pq.read_table(path)
        table = table.drop_columns("estimator") if "estimator" in table.column_names else table
        assert table.column_names == stored.column_names, path.name
        for field in table.schema:
            assert field.metadata == stored.schema.field(field.name).metadata, (path.name, field.name)
            a, b = (t.column(field.name).to_numpy() for t in (table, stored))
            assert_array_equal(a, b)


def test_estimators_are_one_table_and_a_state_that_one_lacks_is_null(result):
    table = bench.to_arrow(result, "solutions")
    assert table.column_names[:2] == ["estimator", "t_s"]
    assert set(table.column("estimator").to_pylist()) == {"loose-15", "free"}
    assert table.column("state_baro_bias_m").null_count == len(result.solutions["free"])
    assert table.schema.field("vel_n_mps").metadata[b"unit"] == b"m/s"
    assert len(bench.to_arrow(result, "errors", "free")) == len(result.errors["free"])


def test_pandas_gets_the_same_numbers(result):
    pytest.importorskip("pandas")
    frame = bench.to_arrow(result, "errors").to_pandas()
    rows = frame[frame["estimator"] == "loose-15"]
    assert_array_equal(rows["pos_err_n_m"], result.errors["loose-15"].pos_n[:, 0])


def test_what_is_not_there_is_said_with_what_is(result):
    with pytest.raises(
        BenchError, match=r"the result has no 'lidar'; there are events, truth, air, .*errors"
    ):
        bench.to_arrow(result, "lidar")
    with pytest.raises(BenchError, match="the result has no 'ukf'; there are loose-15, free"):
        bench.to_arrow(result, "errors", "ukf")


@pytest.mark.parametrize("name", ["all-sensors", "circuit", "gnss-faults"])
def test_the_start_and_the_datasheets_come_back(name, tmp_path):
    """Of a sky what a receiver does not know is not stored."""
    specs = bench.read_profile(name, {"sensors.imu.gyro.noise_deg_sqrt_h.x": 0.7}).sensors.assumed
    assert specs.imu.gyro.axes
    initial = InitialState(
        0.0, np.full(3, np.nan), np.full(3, np.nan), np.full(4, np.nan), np.diag(np.full(9, np.inf)), "course"
    )
    data = SensorData(imu=None, fixes=None, antenna_b=np.zeros(3), specs=specs, output_t=np.zeros(1))
    results.write_json(tmp_path / results.START, results.make_start_document(data, initial))
    document = results.load_start(tmp_path)
    back = results.read_assumed_specs(document)
    if specs.gnss is not None and specs.gnss.sky is not None:
        assert back.gnss.sky.day == specs.gnss.sky.day
    else:
        assert back == specs
    again = results.read_initial_state(document)
    assert_array_equal(again.cov, initial.cov)
    assert np.isnan(again.lla).all()


def test_a_filter_runs_on_a_loaded_folder_as_on_the_run(folder):
    made, sensed = make_run(folder.parent / "again")
    loaded = bench.read_result(folder)
    equal(loaded.truth, made)
    for label in ("loose-15", "free-inertial"):
        first = bench.run_filter(label, sensed.data, sensed.initial)
        equal(bench.run_filter(label, loaded.sensors, loaded.sensed.initial), first)


def test_a_result_shows_itself_in_a_line_and_as_a_table(result):
    assert repr(result) == "<RunResult 'a', seed 7, run 2: loose-15 -, free ->"
    shown = result._repr_html_()
    assert "<td>nees_mean</td><td>9.5</td><td>-</td>" in shown
    assert "<td>converged</td><td>True</td><td>False</td>" in shown
    assert "cep50_m" not in shown  # no filter has it
